//! What the tests of the controller on an emulated chip have in common.
#![allow(dead_code, reason = "each test binary uses a part")]

use clap::{Args, FromArgMatches};
use haptimill::commands::CliError;
use haptimill::commands::run::{self, RunArgs};
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

/// A place for results that belongs to one test.
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

/// The image of the board with this name, `faults` for instance.
pub fn image(name: &'static str) -> PathBuf {
    pil::other_image(Board::Mps2, name).expect("builds")
}

/// The controller on a chip, begun.
pub fn remote(board: Board, image: &Path, words: &[&str]) -> Remote {
    let setup = EmulatorOptions {
        arguments: words.iter().map(ToString::to_string).collect(),
        ..EmulatorOptions::default()
    };
    let emulator = Emulator::start_with(board, image, &setup).expect("starts");
    let machine = MachineFile::built_in().expect("sound");
    RemoteController::begin(emulator, machine.config.period_us).expect("begins")
}

/// The built-in machine around the product's image.
pub fn bench(board: Board, options: &RigOptions) -> Bench<Remote> {
    Bench::with(options, remote(board, &image("haptimill-mps2"), &[]))
}

/// How an image ends that is run without a machine around it: its exit code, and what it said on its console.
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
        // A guard against a hang, no measure of speed.
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

/// What a controller did in a period.
#[derive(Debug, Clone, PartialEq)]
pub struct Deed {
    pub period: u64,
    pub missed: u16,
    pub outputs: Outputs,
    pub snapshot: Option<Snapshot>,
}

/// What the controller of a bench did in the last period.
pub fn deed<C: Control>(bench: &Bench<C>) -> Deed {
    let rig = &bench.rig;
    Deed {
        period: rig.inputs().period,
        missed: rig.inputs().missed,
        outputs: rig.outputs().clone(),
        snapshot: rig.control().snapshot(rig.inputs()),
    }
}

/// The first period in which two controllers did not do the same, with what both did.
#[track_caller]
pub fn assert_same(what: &str, native: &[Deed], emulated: &[Deed]) {
    for (native, emulated) in native.iter().zip(emulated) {
        assert!(
            native == emulated,
            "{what}, period {}\nnative   {native:?}\nemulated {emulated:?}",
            native.period
        );
    }
    assert_eq!(native.len(), emulated.len(), "{what}");
}
