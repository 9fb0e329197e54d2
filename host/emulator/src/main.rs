//! The program of the emulator: a board with its pins wired to a simulated machine, for
//! `haptimill run --port emu:pico2`. `haptimill_client::session::pins` has the other end.

use haptimill_client::session::Line as _;
use haptimill_client::session::pins::{Answer, Turn, read_bytes};
use haptimill_emulator::checks::{Checks, write_vcd};
use haptimill_emulator::image::flash;
use haptimill_emulator::pico2::Pico2;
use haptimill_hil_sim::plant::Plant;
use haptimill_machine_file::MachineFile;
use std::io::{self, BufWriter, Read, Write};
use std::path::PathBuf;
use std::process::ExitCode;

const HELP: &str = "usage: haptimill-emulator --image FILE [--vcd FILE]
Runs an image of the Pico 2 with its pins wired to a simulated machine, for
`haptimill run FILE --port emu:pico2`, which sends machine and bytes on standard input.";

struct Arguments {
    image: PathBuf,
    vcd: Option<PathBuf>,
}

fn arguments() -> Option<Arguments> {
    let (mut image, mut vcd) = (None, None);
    let mut words = std::env::args_os().skip(1);
    while let Some(word) = words.next() {
        let slot = match word.to_str() {
            Some("--image") => &mut image,
            Some("--vcd") => &mut vcd,
            _ => return None,
        };
        *slot = Some(PathBuf::from(words.next()?));
    }
    Some(Arguments { image: image?, vcd })
}

fn main() -> ExitCode {
    let Some(arguments) = arguments() else {
        eprintln!("{HELP}");
        return ExitCode::from(2);
    };
    let (mut input, mut output) = (io::stdin().lock(), io::stdout().lock());
    let answer = run(&arguments, &mut input, &mut output).unwrap_or_else(Answer::Failed);
    // The host may be gone.
    match answer.write(&mut output) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}

/// Serves the host until it closes its end; returns the last answer.
fn run(
    arguments: &Arguments,
    input: &mut impl Read,
    output: &mut impl Write,
) -> Result<Answer, String> {
    let text = |input: &mut dyn Read| match read_bytes(&mut { input }) {
        Ok(Some(bytes)) => String::from_utf8(bytes).map_err(|error| error.to_string()),
        Ok(None) => Err("the host has ended".to_string()),
        Err(error) => Err(error.to_string()),
    };
    let file = text(input)?;
    let machine =
        MachineFile::parse(&file, &text(input)?).map_err(|problems| problems.to_string())?;
    let path = &arguments.image;
    let image = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let flash = flash(&image).map_err(|error| format!("{}: {error}", path.display()))?;
    let config = machine.plant().map_err(|problems| problems.to_string())?;
    let plant = Plant::new(&config, machine.config.period_us).map_err(|problems| {
        let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
        problems.join("\n")
    })?;
    let mut board = Pico2::new(&flash, plant)?;
    board.connect_chips(&machine);
    let gone = |error: io::Error| format!("the host is gone: {error}");
    let mut sent = Vec::new();
    let mut time_us = 0;
    loop {
        let turn = Turn {
            time_us,
            sent: std::mem::take(&mut sent),
            truth: *board.plant().truth(),
            records: board.take_records(),
        };
        Answer::Turn(Box::new(turn)).write(output).map_err(gone)?;
        let Some(bytes) = read_bytes(input).map_err(gone)? else {
            break;
        };
        time_us = board
            .exchange(&bytes, &mut sent)
            .map_err(|error| error.to_string())?;
    }
    if let Some(path) = &arguments.vcd {
        std::fs::File::create(path)
            .map(BufWriter::new)
            .and_then(|mut file| {
                write_vcd(&board, &machine, &mut file)?;
                file.flush()
            })
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    let checks = Checks::of(&mut board, &machine);
    Ok(match checks.passed() {
        true => Answer::Passed(checks.to_string()),
        false => Answer::Faulty(checks.to_string()),
    })
}
