//! Corrupted files for the parsers of the host.
//!
//! A parser must return a value or an error with text, without a panic, within a bounded time.

use super::rng::Rng;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_gcode::{Options, read};
use haptimill_machine_file::{MachineFile, stock};
use haptimill_teleop::script::Script;
use haptimill_trace::{Header, Recorder, Recording};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Longest time of a parser, for files of at most some hundred kilobytes.
const LONGEST: Duration = Duration::from_secs(5);

const TEXTS: [&str; 5] = [
    include_str!("../../../machines/h4.toml"),
    include_str!("../../../machines/h4-step.toml"),
    include_str!("../../../machines/haptic-master.toml"),
    include_str!("../../../examples/block.toml"),
    include_str!("../../../examples/teleop.toml"),
];

const PROGRAMS: [&str; 3] = [
    include_str!("../../../examples/e11-circle.ngc"),
    include_str!("../../../examples/e9-pocket.ngc"),
    include_str!("../../../examples/e2-depth-sweep.ngc"),
];

/// Returns a small, valid recording.
fn recording() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let path = scratch("valid");
        let machine = MachineFile::built_in().expect("sound");
        let header = Header::of(&machine, "tests").expect("encodes");
        let mut recorder = Recorder::create(&path, &header).expect("a file");
        let mut controller = Controller::new(200);
        let mut outputs = Outputs::default();
        for period in 0..300_u64 {
            let inputs = Inputs {
                period,
                ..Inputs::default()
            };
            outputs.transmit.clear();
            controller.tick(&inputs, &mut outputs, &mut ());
            recorder.period(&inputs, &outputs);
            if period % 100 == 0 {
                recorder.event(period, 1, "an event");
            }
        }
        recorder.finish().expect("written");
        let bytes = std::fs::read(&path).expect("there");
        let _ = std::fs::remove_file(&path);
        bytes
    })
}

fn scratch(name: &str) -> PathBuf {
    let thread = format!("{:?}", std::thread::current().id());
    let thread: String = thread.chars().filter(char::is_ascii_digit).collect();
    std::env::temp_dir().join(format!(
        "haptimill-fuzz-{}-{thread}-{name}.hmr",
        std::process::id()
    ))
}

fn mutate(bytes: &mut Vec<u8>, rng: &mut Rng) {
    const TOKENS: [&str; 22] = [
        "nan",
        "inf",
        "-inf",
        "1e308",
        "-1",
        "0",
        "9999999999999999999",
        "\"",
        "[[",
        "]]",
        "=",
        "\n",
        "G2 I0 J0",
        "X1e30",
        "(",
        "#",
        "N99999999999",
        "\u{0}",
        "\u{FFFD}",
        "1_0",
        "true",
        "G1 X Y",
    ];
    for _ in 0..=rng.below(6) {
        let at = if bytes.is_empty() {
            0
        } else {
            rng.index(bytes.len())
        };
        let end = (at + rng.index(60)).min(bytes.len());
        match rng.below(8) {
            0 | 1 if !bytes.is_empty() => bytes[at] ^= 1 << rng.below(8),
            2 => {
                bytes.drain(at..end);
            }
            3 => {
                let part = bytes[at..end].to_vec();
                let to = rng.index(bytes.len() + 1);
                bytes.splice(to..to, part);
            }
            4 | 5 => {
                let token = rng.choose(&TOKENS);
                bytes.splice(at..end.min(at + 4), token.bytes());
            }
            6 if !bytes.is_empty() && rng.chance(0.3) => bytes.truncate(at),
            _ => {
                let digits: Vec<usize> = (0..bytes.len())
                    .filter(|index| bytes[*index].is_ascii_digit())
                    .collect();
                if !digits.is_empty() {
                    let digit = digits[rng.index(digits.len())];
                    bytes[digit] = b'0' + rng.below(10) as u8;
                }
            }
        }
    }
}

/// Corrupts a file and parses it.
///
/// # Errors
/// The parser panicked, took too long, or returned an error without text.
pub fn corrupt(seed: u64) -> Result<(), String> {
    let mut rng = Rng::new(seed, 905);
    let which = rng.index(12);
    let mut bytes = match which {
        0..=4 => TEXTS[which].as_bytes().to_vec(),
        5..=7 => PROGRAMS[which - 5].as_bytes().to_vec(),
        _ => recording().to_vec(),
    };
    mutate(&mut bytes, &mut rng);
    let begun = Instant::now();
    let parsed = catch_unwind(AssertUnwindSafe(|| parse(which, &bytes)));
    let took = begun.elapsed();
    match parsed {
        Err(_) => Err(format!(
            "the parser of file {which} panicked, file seed {seed}"
        )),
        Ok(Some(message)) if message.trim().is_empty() => Err(format!(
            "the parser of file {which} returned an error without text, file seed {seed}"
        )),
        Ok(_) if took > LONGEST => Err(format!(
            "the parser of file {which} took {took:?}, file seed {seed}"
        )),
        Ok(_) => Ok(()),
    }
}

/// Returns the text of the parser's error.
fn parse(which: usize, bytes: &[u8]) -> Option<String> {
    let text = || String::from_utf8_lossy(bytes).into_owned();
    match which {
        0..=2 => MachineFile::parse("fuzz.toml", &text())
            .err()
            .map(|problems| problems.to_string()),
        3 => stock::parse("fuzz.toml", &text())
            .err()
            .map(|problems| problems.to_string()),
        4 => Script::parse("fuzz.toml", &text())
            .err()
            .map(|error| error.to_string()),
        5..=7 => {
            let options = Options::of_letters("XYZBA", [0.0, 0.0, 21.232, 0.0, 0.0, 0.0]);
            read("fuzz.ngc", bytes, &options)
                .err()
                .map(|refused| refused.to_string())
        }
        _ => {
            let path = scratch("corrupted");
            if std::fs::write(&path, bytes).is_err() {
                return None;
            }
            let error = read_recording(&path).err();
            let _ = std::fs::remove_file(&path);
            error
        }
    }
}

/// Reads all records of a recording and replays it.
fn read_recording(path: &std::path::Path) -> Result<(), String> {
    let recording = Recording::open(path).map_err(|error| error.to_string())?;
    for record in recording.iter().map_err(|error| error.to_string())? {
        record.map_err(|error| error.to_string())?;
    }
    recording.events().map_err(|error| error.to_string())?;
    recording.verify().map_err(|error| error.to_string())?;
    for period in recording
        .read_periods()
        .map_err(|error| error.to_string())?
    {
        period.map_err(|error| error.to_string())?;
    }
    let _ = haptimill_trace::replay::replay(&recording).map_err(|error| error.to_string())?;
    Ok(())
}
