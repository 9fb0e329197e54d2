//! Common code of the tests of the controller on an emulated chip.
use clap::{Args, FromArgMatches, Subcommand};
use haptimill::commands::CliError;
use haptimill::commands::run::{self, RunArgs};
use haptimill::commands::scenario::{self, ScenarioCommand};
use haptimill::commands::teleop::{self, TeleopArgs};
use haptimill_client::port::Board;
use haptimill_client::session::pil::{self, Emulator, EmulatorOptions};
use haptimill_firmware::io::Outputs;
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::remote::RemoteController;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_machine_file::MachineFile;
use haptimill_tests::Bench;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// The chips.
pub const BOARDS: [Board; 2] = [Board::Mps2, Board::Mps2M7];

/// A controller on an emulated chip.
pub type Remote = RemoteController<Emulator>;

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Returns a folder for the results of one test.
pub fn results(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// Runs a part program as the command line does.
pub fn run(program: &Path, port: &str, out: &Path, more: &[&str]) -> Result<(), CliError> {
    let program = program.display().to_string();
    let out = out.display().to_string();
    let mut words = vec!["run", &program, "--port", port, "--out", &out, "--quiet"];
    words.extend(more);
    let command = RunArgs::augment_args(clap::Command::new("run"));
    let matches = command.try_get_matches_from(words).expect("arguments");
    run::run(RunArgs::from_arg_matches(&matches).expect("arguments"))
}

/// Runs a part program that must succeed. Returns the time that it took.
pub fn run_timed(program: &Path, port: &str, out: &Path, more: &[&str]) -> Duration {
    let start = Instant::now();
    run(program, port, out, more).expect("runs");
    start.elapsed()
}

/// Runs a scenario as the command line does.
pub fn scenario(name: &str, port: &str, out: &Path) -> Result<(), CliError> {
    let out = out.display().to_string();
    let words = ["scenario", "run", name, "--port", port, "--out", &out];
    let command = ScenarioCommand::augment_subcommands(clap::Command::new("scenario"));
    let matches = command.try_get_matches_from(words).expect("arguments");
    scenario::run(ScenarioCommand::from_arg_matches(&matches).expect("arguments"))
}

/// Runs a teleoperation by a script as the command line does.
pub fn teleoperate(script: &Path, port: &str, out: &Path) -> Result<(), CliError> {
    let script = format!("script:{}", script.display());
    let out = out.display().to_string();
    let words = [
        "teleop", "--master", &script, "--port", port, "--out", &out, "--quiet",
    ];
    let command = TeleopArgs::augment_args(clap::Command::new("teleop"));
    let matches = command.try_get_matches_from(words).expect("arguments");
    teleop::run(TeleopArgs::from_arg_matches(&matches).expect("arguments"))
}

/// Returns the first seconds of the dome, a 5-axis program.
pub fn part_of_dome(blocks: usize) -> PathBuf {
    let text = std::fs::read_to_string(root().join("examples/dome.ngc")).expect("there");
    let beginning: Vec<&str> = text.lines().take(blocks).collect();
    let file = results(&format!("dome-{blocks}.ngc"));
    std::fs::write(&file, beginning.join("\n") + "\nM5\nM30\n").expect("written");
    file
}

/// Returns a program that moves x, y and z all the time: a turn of the circle of E11 with a fall.
pub fn helix() -> PathBuf {
    let file = results("helix.ngc");
    let text = "G21 G17 G90 G94\nG0 Z23.232\nS5000 M3\nG2 I-15 Z19.232 F240\nM5\nM30\n";
    std::fs::write(&file, text).expect("written");
    file
}

/// Returns the image of the board with this name, for example `faults`.
pub fn image(name: &'static str) -> PathBuf {
    pil::other_image(Board::Mps2, name).expect("builds")
}

/// Starts the controller on a chip.
pub fn remote(board: Board, image: &Path, words: &[&str]) -> Remote {
    let setup = EmulatorOptions {
        arguments: words.iter().map(ToString::to_string).collect(),
        ..EmulatorOptions::default()
    };
    let emulator = Emulator::start_with(board, image, &setup).expect("starts");
    let machine = MachineFile::built_in().expect("sound");
    RemoteController::begin(emulator, machine.config.period_us).expect("begins")
}

/// Returns the built-in machine around the product's image.
pub fn bench(board: Board, options: &RigOptions) -> Bench<Remote> {
    Bench::with(options, remote(board, &image("haptimill-mps2"), &[]))
}

/// Runs an image without a machine. Returns its exit code and its console output.
pub fn run_alone(board: Board, image: &Path, words: &[&str]) -> (Option<i32>, String) {
    alone(board, image, words, &[])
}

/// The same, with its time counted in instructions.
pub fn run_counted(board: Board, image: &Path, words: &[&str]) -> (Option<i32>, String) {
    alone(board, image, words, &["-icount", "shift=10,sleep=off"])
}

fn alone(board: Board, image: &Path, words: &[&str], more: &[&str]) -> (Option<i32>, String) {
    let mut option = "enable=on,target=native,arg=image".to_string();
    for word in words {
        option += ",arg=";
        option += word;
    }
    let mut child = Command::new("qemu-system-arm")
        .args([
            "-M",
            board.machine(),
            "-display",
            "none",
            "-monitor",
            "none",
        ])
        .args(more)
        .args(["-serial", "null", "-semihosting-config", &option, "-kernel"])
        .arg(image)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the emulator is installed");
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().expect("a child") {
            break status;
        }
        // A guard against a hang, not a measure of speed.
        if begun.elapsed() > Duration::from_secs(600) {
            child.kill().expect("killed");
            break child.wait().expect("a child");
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let mut console = String::new();
    let mut pipe = child.stderr.take().expect("piped");
    std::io::Read::read_to_string(&mut pipe, &mut console).expect("text");
    (status.code(), console)
}

/// Outputs and state of a controller in a period.
#[derive(Debug, Clone, PartialEq)]
pub struct PeriodResult {
    pub period: u64,
    pub missed: u16,
    pub outputs: Outputs,
    pub snapshot: Option<Snapshot>,
}

/// Returns outputs and state of a bench's controller in the last period.
pub fn period_result<C: Control>(bench: &Bench<C>) -> PeriodResult {
    let rig = &bench.rig;
    PeriodResult {
        period: rig.inputs().period,
        missed: rig.inputs().missed,
        outputs: rig.outputs().clone(),
        snapshot: rig.control().snapshot(rig.inputs()),
    }
}

/// Returns the first period in which two controllers differ, with the values of both.
#[track_caller]
pub fn assert_same(what: &str, native: &[PeriodResult], emulated: &[PeriodResult]) {
    for (native, emulated) in native.iter().zip(emulated) {
        assert!(
            native == emulated,
            "{what}, period {}\nnative   {native:?}\nemulated {emulated:?}",
            native.period
        );
    }
    assert_eq!(native.len(), emulated.len(), "{what}");
}
