//! Missing, invalid and endless inputs: reported with their place before any motion, before any
//! byte is sent to a port, and before earlier results are changed.
#![cfg(unix)]

use crate::scene;
mod commands;
mod disk;

use scene::{TestFolder, haptimill};
use std::io::Read;
use std::net::TcpListener;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A port that counts the received bytes and never answers.
struct UnusedPort {
    port: String,
    bytes: Arc<AtomicUsize>,
}

impl UnusedPort {
    fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = format!("tcp:{}", listener.local_addr().unwrap());
        let bytes = Arc::<AtomicUsize>::default();
        let count = Arc::clone(&bytes);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let (mut stream, count) = (stream.unwrap(), Arc::clone(&count));
                std::thread::spawn(move || {
                    let mut buffer = [0; 256];
                    while let Ok(read @ 1..) = stream.read(&mut buffer) {
                        count.fetch_add(read, Ordering::SeqCst);
                    }
                });
            }
        });
        Self { port, bytes }
    }
}

const OLD: [&str; 6] = [
    "recording.hmr",
    "trace.csv",
    "summary.json",
    "report.html",
    "teleop.csv",
    "master.hmr",
];

/// A folder with earlier results.
fn write_old_results(folder: &TestFolder, name: &str) -> String {
    let out = folder.path(name);
    std::fs::create_dir_all(&out).unwrap();
    for file in OLD {
        std::fs::write(Path::new(&out).join(file), format!("old {file}")).unwrap();
    }
    out
}

/// The first difference of the folder from what [`write_old_results`] wrote.
fn changed_result(out: &str) -> Option<String> {
    for file in OLD {
        match std::fs::read_to_string(Path::new(out).join(file)) {
            Ok(text) if text == format!("old {file}") => {}
            Ok(_) => return Some(format!("{file} is changed")),
            Err(error) => return Some(format!("{file}: {error}")),
        }
    }
    let count = std::fs::read_dir(out).map_or(0, Iterator::count);
    (count != OLD.len()).then(|| format!("{count} files"))
}

/// Runs a row with an input. Returns what is wrong.
fn refuse(unused: &UnusedPort, (row, code): (&str, i32), input: &str) -> Result<(), String> {
    let folder = TestFolder::new();
    let out = write_old_results(&folder, "out");
    let good = folder.file("good.ngc", "G21 G90 F600\nG1 X1\nG1 X0\nM30\n");
    let line = row
        .replace("{}", input)
        .replace("OUT", &out)
        .replace("PORT", &unused.port)
        .replace("NONE", &folder.path("none"))
        .replace("GOOD", &good);
    let words: Vec<&str> = line.split_whitespace().collect();
    let begun = Instant::now();
    let ran = haptimill(&words);
    let problem = if ran.code != code {
        format!("exit code {}", ran.code)
    } else if !ran.err.contains(input) {
        "no place".to_string()
    } else if ran.err.len() > 20_000 {
        format!("{} bytes of complaints", ran.err.len())
    } else if begun.elapsed() > LONGEST {
        "too slow".to_string()
    } else if let Some(changed) = changed_result(&out) {
        changed
    } else if unused.bytes.load(Ordering::SeqCst) > 0 {
        "bytes on the port".to_string()
    } else {
        return Ok(());
    };
    let err: String = ran.err.chars().take(400).collect();
    Err(format!("{line}\n    {problem}: {err}"))
}

/// Time after which a refusal counts as hanging. It is no speed limit: a pipe is given up after
/// ten seconds.
const LONGEST: Duration = Duration::from_secs(120);

/// Runs rows with inputs on a few threads, and fails with all that is wrong.
#[track_caller]
fn expect_refused(rows: &[String], code: i32, inputs: &[&str], threads: usize) {
    let unused = UnusedPort::new();
    let pairs: Vec<_> = rows
        .iter()
        .flat_map(|row| inputs.iter().map(move |input| (row, *input)))
        .collect();
    let next = AtomicUsize::new(0);
    let wrong = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some((row, input)) = pairs.get(next.fetch_add(1, Ordering::SeqCst)) {
                    if let Err(what) = refuse(&unused, (row, code), input) {
                        wrong.lock().unwrap().push(what);
                    }
                }
            });
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(
        wrong.is_empty(),
        "{} of {}:\n{}",
        wrong.len(),
        pairs.len(),
        wrong.join("\n")
    );
}

#[test]
fn invalid_input_files_are_reported_before_any_action() {
    let folder = TestFolder::new();
    let broken = folder.file("broken", "G1 X1 [[broken\n\"\u{0}");
    let missing = folder.path("missing");
    let directory = folder.path("directory");
    std::fs::create_dir(&directory).unwrap();
    let inputs = [&*missing, &*directory, &*broken, "/dev/zero"];
    expect_refused(&commands::rows().0, 3, &inputs, 2);
}

/// Master devices, serial lines and ports.
#[test]
fn missing_devices_are_reported_before_any_action() {
    let missing = TestFolder::new().path("missing");
    expect_refused(&commands::port_rows(), 5, &[&missing], 2);
}

/// A new command, or a new option with a file, needs a row, or a reason for none.
#[test]
fn every_command_and_input_has_a_row() {
    let (rows, missing) = commands::rows();
    assert!(missing.is_empty(), "{missing:?}");
    assert!(rows.len() > 80, "{} rows", rows.len());
}

/// A port without a haptic arm as master: the machine is not homed.
#[test]
fn silent_haptic_arm_prevents_motion() {
    let (folder, unused) = (TestFolder::new(), UnusedPort::new());
    let served = scene::SimServer::on_tcp(&[]);
    let out = write_old_results(&folder, "out");
    let ran = served.run(&["teleop", "--master", &unused.port, "--out", &out]);
    assert_eq!(ran.code, 5, "{ran:?}");
    assert!(ran.err.contains("does not answer"), "{ran:?}");
    let status = served.status();
    assert_eq!(
        (&status["state"], &status["homed"]),
        (&"Disabled".into(), &false.into()),
        "{status:#}"
    );
    assert_eq!(changed_result(&out), None);
}

/// Makes a pipe that nobody writes.
fn make_pipe(folder: &TestFolder, name: &str) -> String {
    let pipe = folder.path(name);
    rustix::fs::mknodat(
        rustix::fs::CWD,
        &pipe,
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::from_raw_mode(0o600),
        0,
    )
    .unwrap();
    assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
    pipe
}

/// An endless pipe times out. The commands run in parallel, because each waits.
#[test]
fn endless_pipes_time_out() {
    let folder = TestFolder::new();
    let pipe = make_pipe(&folder, "pipe");
    expect_refused(&commands::rows().0, 3, &[&pipe], 40);
}

/// Standard input of a running session: its memory stays bounded, and the machine stops, because a
/// `stop` would not arrive any more.
#[test]
fn endless_commands_stop_a_teleoperation() {
    let folder = TestFolder::new();
    let machine = scene::SimServer::on_tcp(&[]);
    let arm = scene::SimServer::on_tcp(&["--machine", "machines/haptic-master.toml"]);
    let out = folder.path("out");
    let mut session = vec!["teleop", "--port", &machine.port, "--master", &arm.port];
    session.extend(["--out", &out, "--stale", "1000", "--for", "100"]);
    let zeros = std::fs::File::open("/dev/zero").unwrap();
    let ran = scene::start_with(&session, zeros.into()).end();
    let said = format!("{}{}", ran.out, ran.err);
    assert!(
        said.contains("a line of more than 256 bytes; the machine stops"),
        "{ran:?}"
    );
    assert_ne!(ran.code, 0, "{ran:?}");
}

/// A file of a called subroutine may be opened in the middle of a job.
#[test]
fn a_called_file_that_is_a_pipe_is_refused() {
    let folder = TestFolder::new();
    make_pipe(&folder, "drill.ngc");
    let program = folder.file("call.ngc", "G21 G90 F600\nG1 X1\nO<drill> call\nM30\n");
    let out = folder.path("out");
    for more in [&[][..], &["--stream"]] {
        let run = ["run", &program, "--out", &out, "--quiet"];
        let ran = haptimill(&[&run[..], more].concat()).expect_code(3);
        assert!(ran.err.contains("drill.ngc is no regular file"), "{ran:?}");
        assert!(ran.err.contains("call.ngc:3:"), "{ran:?}");
    }
}

/// Results of minutes of motion: the place for them is checked before the first motion.
#[test]
fn identification_checks_its_outputs_before_motion() {
    let folder = TestFolder::new();
    let machine = folder.machine_with("");
    let file = folder.file("file", "");
    let identify = ["identify", "--yes", "--machine", &machine, "--out"];
    let out = format!("{file}/out");
    let ran = haptimill(&[&identify[..], &[&out]].concat()).expect_code(9);
    assert!(ran.err.contains(&out), "{ran:?}");
    assert!(!ran.out.contains("homes"), "{ran:?}");
    // Another command writes its results there.
    let out = folder.path("out");
    std::fs::create_dir(&out).unwrap();
    let lock = std::fs::File::open(&out).unwrap();
    lock.lock().unwrap();
    let ran = haptimill(&[&identify[..], &[&out]].concat()).expect_code(9);
    assert!(ran.err.contains("another run"), "{ran:?}");
    assert!(!ran.out.contains("homes"), "{ran:?}");
}

/// A pipe with an end is read like a file.
#[test]
fn program_is_read_from_a_pipe() {
    let ran = std::process::Command::new("sh")
        .arg("-c")
        .arg("printf 'G21 G90 F600\\nG1 X1\\nG1 X0\\nM30\\n' | \"$0\" run /dev/stdin --check")
        .arg(env!("CARGO_BIN_EXE_haptimill"))
        .output()
        .unwrap();
    assert!(ran.status.success(), "{ran:?}");
}

/// Very many lines and problems are counted, not listed.
#[test]
fn a_million_problems_are_counted_and_the_first_are_listed() {
    let folder = TestFolder::new();
    let keys: String = (0..40_000).map(|i| format!("key{i} = 1\n")).collect();
    let cases = [
        ("line.ngc", "Q".repeat(4 << 20)),
        ("lines.ngc", "Q1\n".repeat(1 << 20)),
        ("line.toml", "=".repeat(1_000_000)),
        ("lines.toml", "= =\n".repeat(250_000)),
        ("keys.toml", format!("format = 2\n{keys}")),
        ("quotes.toml", "\" \n".repeat(300_000)),
    ];
    for (name, text) in cases {
        let file = folder.file(name, text);
        let command: &[&str] = match name.ends_with(".ngc") {
            true => &["run", &file, "--check"],
            false => &["machine", "check", &file],
        };
        let begun = Instant::now();
        let ran = haptimill(command);
        assert_eq!(
            ran.code,
            3,
            "{name}: {}",
            &ran.err[..ran.err.len().min(2000)]
        );
        let lines = ran.err.lines().count();
        assert!(lines <= 53, "{name}: {lines} lines");
        assert!(ran.err.len() < 20_000, "{name}: {} bytes", ran.err.len());
        assert!(ran.err.contains(" more"), "{name}: {}", ran.err);
        assert!(begun.elapsed() < Duration::from_secs(60), "{name}");
    }
}
