//! Missing, invalid and endless inputs: reported with their place before any motion, before any
//! byte is sent to a port, and before earlier results are changed.
#![cfg(unix)]

mod scene;

use scene::{TestFolder, haptimill};
use std::io::Read;
use std::net::TcpListener;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
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

#[track_caller]
fn expect_old_results(out: &str, why: &str) {
    for file in OLD {
        let path = Path::new(out).join(file);
        let text =
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{why}: {file}: {error}"));
        assert_eq!(text, format!("old {file}"), "{why}");
    }
    assert_eq!(std::fs::read_dir(out).unwrap().count(), OLD.len(), "{why}");
}

/// Every command that reads a file or opens a device; `{}` is the input.
const FILES: [(&[&str], i32); 19] = [
    (&["run", "{}", "--out", "OUT"], 3),
    (&["run", "{}", "--port", "PORT", "--out", "OUT"], 3),
    (&["run", "GOOD", "--machine", "{}", "--out", "OUT"], 3),
    (
        &[
            "run",
            "GOOD",
            "--machine",
            "{}",
            "--port",
            "PORT",
            "--out",
            "OUT",
        ],
        3,
    ),
    (&["run", "GOOD", "--stock", "{}", "--out", "OUT"], 3),
    (
        &["scenario", "run", "e7", "--machine", "{}", "--out", "OUT"],
        3,
    ),
    (
        &["teleop", "--master", "sim", "--stock", "{}", "--out", "OUT"],
        3,
    ),
    (
        &[
            "teleop",
            "--master",
            "sim",
            "--machine",
            "{}",
            "--out",
            "OUT",
        ],
        3,
    ),
    (
        &[
            "teleop",
            "--master",
            "sim",
            "--master-machine",
            "{}",
            "--out",
            "OUT",
        ],
        3,
    ),
    (
        &[
            "teleop",
            "--master",
            "script:{}",
            "--port",
            "PORT",
            "--out",
            "OUT",
        ],
        3,
    ),
    (
        &[
            "teleop",
            "--master",
            "PORT",
            "--master-machine",
            "{}",
            "--port",
            "PORT",
            "--out",
            "OUT",
        ],
        3,
    ),
    (&["jog", "x=1", "--machine", "{}", "--port", "PORT"], 3),
    (&["home", "--machine", "{}", "--port", "PORT"], 3),
    (&["enable", "--machine", "{}", "--port", "PORT"], 3),
    (&["status", "--machine", "{}", "--port", "PORT"], 3),
    (&["force", "tare", "--machine", "{}", "--port", "PORT"], 3),
    (&["machine", "check", "{}"], 3),
    (&["kin", "ik", "--in", "{}", "--out", "OUT/trace.csv"], 3),
    (
        &[
            "kin",
            "fk",
            "--machine",
            "{}",
            "--in",
            "examples/dome.ngc",
            "--out",
            "OUT/trace.csv",
        ],
        3,
    ),
];

/// The same for commands that read recordings, and for `sim serve`.
const OTHERS: [(&[&str], i32); 9] = [
    (&["replay", "{}"], 3),
    (&["trace", "info", "{}"], 3),
    (&["trace", "csv", "{}", "--out", "OUT/trace.csv"], 3),
    (
        &[
            "trace",
            "plot",
            "{}",
            "x_tool_mm",
            "--out",
            "OUT/report.html",
        ],
        3,
    ),
    (&["trace", "diff", "{}", "{}"], 3),
    (&["sim", "serve", "--machine", "{}", "--for", "1"], 3),
    (
        &[
            "sim",
            "serve",
            "--machine",
            "machines/haptic-master.toml",
            "--operator",
            "{}",
            "--for",
            "1",
        ],
        3,
    ),
    (
        &[
            "sim",
            "serve",
            "--listen",
            "tcp:127.0.0.1:0",
            "--token-file",
            "{}",
            "--for",
            "1",
        ],
        3,
    ),
    (&["run", "GOOD", "--port", "{}", "--out", "OUT"], 5),
];

/// Runs a command of the table with an input.
#[track_caller]
fn expect_refused(
    folder: &TestFolder,
    unused: &UnusedPort,
    (command, code): (&[&str], i32),
    input: &str,
) {
    let out = write_old_results(folder, "out");
    let good = folder.file("good.ngc", "G21 G90 F600\nG1 X1\nG1 X0\nM30\n");
    let words: Vec<String> = command
        .iter()
        .map(|word| {
            word.replace("{}", input)
                .replace("OUT", &out)
                .replace("PORT", &unused.port)
                .replace("GOOD", &good)
        })
        .collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let begun = Instant::now();
    let ran = haptimill(&words);
    let why = format!("{words:?}: {ran:?}");
    assert_eq!(ran.code, code, "{why}");
    assert!(ran.err.contains(input), "no place: {why}");
    assert!(
        ran.err.len() < 20_000,
        "{} bytes of complaints",
        ran.err.len()
    );
    assert!(begun.elapsed() < Duration::from_secs(60), "{why}");
    expect_old_results(&out, &why);
    assert_eq!(unused.bytes.load(Ordering::SeqCst), 0, "{why}");
}

#[test]
fn invalid_input_files_are_reported_before_any_action() {
    let (folder, unused) = (TestFolder::new(), UnusedPort::new());
    let broken = folder.file("broken", "G1 X1 [[broken\n\"\u{0}");
    let missing = folder.path("missing");
    let directory = folder.path("directory");
    std::fs::create_dir(&directory).unwrap();
    for row in FILES.into_iter().chain(OTHERS) {
        for input in [&missing, &directory, &broken] {
            expect_refused(&folder, &unused, row, input);
        }
    }
}

/// Master devices, and ports.
#[test]
fn missing_devices_are_reported_before_any_action() {
    let (folder, unused) = (TestFolder::new(), UnusedPort::new());
    let missing = folder.path("missing");
    for master in ["joystick:{}", "mouse3d:{}", "{}"] {
        let row = [
            "teleop", "--master", master, "--port", "PORT", "--out", "OUT",
        ];
        expect_refused(&folder, &unused, (&row, 5), &missing);
        let row = ["teleop", "--master", master, "--out", "OUT"];
        expect_refused(&folder, &unused, (&row, 5), &missing);
    }
    for row in [
        &["teleop", "--master", "sim", "--port", "{}", "--out", "OUT"][..],
        &["jog", "x=1", "--port", "{}"],
        &["home", "--port", "{}"],
        &["stop", "--port", "{}"],
    ] {
        expect_refused(&folder, &unused, (row, 5), &missing);
    }
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
    expect_old_results(&out, "arm");
}

#[test]
fn endless_inputs_are_refused() {
    let (folder, unused) = (TestFolder::new(), UnusedPort::new());
    for row in FILES.into_iter().chain(OTHERS.into_iter().take(8)) {
        expect_refused(&folder, &unused, row, "/dev/zero");
    }
}

/// An endless pipe times out. The commands run in parallel, because each waits.
#[test]
fn endless_pipes_time_out() {
    let (folder, unused) = (TestFolder::new(), UnusedPort::new());
    let pipe = folder.path("pipe");
    rustix::fs::mknodat(
        rustix::fs::CWD,
        &pipe,
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::from_raw_mode(0o600),
        0,
    )
    .unwrap();
    assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
    std::thread::scope(|scope| {
        for row in FILES.into_iter().chain(OTHERS.into_iter().take(8)) {
            let (folder, unused, pipe) = (&folder, &unused, &pipe);
            scope.spawn(move || {
                let own = TestFolder::new();
                let _ = folder;
                expect_refused(&own, unused, row, pipe);
            });
        }
    });
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

/// A file size limit is a write error with a message, and does not kill the process during motion.
#[test]
fn file_size_limit_stops_a_job_with_a_message() {
    let folder = TestFolder::new();
    let turns: String = (0..10).map(|_| "G1 X20\nG1 X0\n").collect();
    let program = folder.file("long.ngc", format!("G21 G90 F600\n{turns}M30\n"));
    let table = folder.file(
        "poses.csv",
        format!(
            "x_mm,y_mm,z_mm,theta_deg,alpha_deg\n{}",
            "0,0,21,0,0\n".repeat(20_000)
        ),
    );
    let out = folder.path("out");
    let sliced = folder.path("slides.csv");
    for (blocks, command) in [
        (2000, format!("run {program} --quiet --out {out}")),
        (2000, format!("teleop --master sim --quiet --out {out}")),
        (20, format!("kin ik --in {table} --out {sliced}")),
    ] {
        let ran = std::process::Command::new("sh")
            .current_dir(scene::root())
            .arg("-c")
            .arg(format!("ulimit -f {blocks}; exec \"$0\" {command}"))
            .arg(env!("CARGO_BIN_EXE_haptimill"))
            .output()
            .unwrap();
        let err = String::from_utf8_lossy(&ran.stderr);
        assert_eq!(ran.status.code(), Some(9), "{command}: {ran:?}");
        assert!(err.contains("File too large"), "{command}: {err}");
        if !command.starts_with("kin") {
            assert!(err.contains("stopped"), "{command}: {err}");
            // The recording is kept and readable.
            haptimill(&["trace", "info", &format!("{out}/recording.hmr")]).expect_code(0);
        }
    }
}
