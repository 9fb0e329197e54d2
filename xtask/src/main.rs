//! Developer tasks of the project. `cargo xtask help` lists them.

mod board;
mod clients;
mod commits;
mod cycles;
mod emulator;
mod figures;
mod fuzz;
mod gcode;
mod lint;
mod mutations;
mod names;
mod provide;
mod release;
mod structure;
mod uf2;

use board::Board;
use fuzz::{fuzz, short_fuzz};
use lint::lint;
use provide::provide;
use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Instant;

const HELP: &str = "\
Developer tasks of the project.

  cargo xtask test                 run all checks: format, line lengths, names of machines, lints,
                                   tests, documentation, boards, emulated runs
  cargo xtask test --native-only   the same without boards and emulated runs; lists what it skipped
  cargo xtask keys                 rewrite the tables of docs/machine-files.md from the table of keys
  cargo xtask lint                 list lines over 100 columns, general code that names a machine,
                                   dependency cycles, commit subjects and figures that do not agree
  cargo xtask structure            count lines, dependency cycles, long comments and glossary terms
  cargo xtask structure FOLDER     the same for the sources below FOLDER
  cargo xtask board NAME           build the image of a board (mps2, pico2, stm32), print its size, check it against the budget
  cargo xtask board NAME --uf2     build the image, check boot block, vectors and memory map, write it as UF2 (pico2)
  cargo xtask board NAME --uart    as `board NAME`, with a UART as the line to the host (pico2)
  cargo xtask board NAME --encoders as `board NAME`, with encoders and shift registers (pico2)
  cargo xtask board NAME --spi     as `board NAME`, with TMC5160 at an SPI as chips of the drives (pico2)
  cargo xtask board NAME --log     as `board NAME`, with a log over RTT (pico2, stm32); also after --uart, --encoders or --spi
  cargo xtask board NAME --period US   as `board NAME`, with another control period (pico2); also after --uart, --encoders or --spi
  cargo xtask board NAME --image   build the image and print only its path
  cargo xtask board NAME --image OTHER   the same with another image of the board (mps2: haptics, faults, checks, logging)
  cargo xtask images               build the images that one can flash, named after the commit, with checksums, in target/images
  cargo xtask instructions         count the instructions of control periods and rewrite docs/instructions.md
  cargo xtask emulator             repair the emulator of the RP2350 (host/emulator), test the repairs,
                                   and run the images of the Pico 2 with a simulated mill
  cargo xtask emulator --build     build the emulator and the images, for `haptimill run --port emu:pico2`
  cargo xtask emulator --long      as `emulator`, with the slot of `--slot`, and with homing and straight moves
                                   of three and five joints at 1,000,000 steps/s
  cargo xtask emulator --slot      run the slot of the experiment E7 (examples/e7-slot.ngc) on the
                                   emulated Pico 2, with every pulse edge checked
  cargo xtask emulator --period US measure the worst control period of the image with this control period,
                                   with three and with five joints at 1,000,000 steps/s, and of the H-4 mill
  cargo xtask machines             run every machine file in the simulator and rewrite docs/machines.md
  cargo xtask machines FILE        run one file of machines/ and print what it does
  cargo xtask log FILE ...         run a part program on the emulated board (options of haptimill run) and print its log
  cargo xtask fuzz [OPTION ...]    run random episodes against all checks, by seed (docs/fuzzing.md; --help lists the options)
  cargo xtask fuzz --mutations     apply mutations to a copy of the sources and show that the fuzz test finds each
  cargo xtask bench                run all benchmarks (criterion); results in target/criterion
  cargo xtask gcode FILE ...       compare the motion of part programs with LinuxCNC's rs274 (docs/gcode.md)
  cargo xtask gcode --throughput   compare the time of `run --check` with that of rs274
  cargo xtask senders              let grbl-streamer and cncjs operate a simulated mill through
                                   `haptimill bridge grbl` (needs a network, node and python3)
  cargo xtask browser              operate the page of `haptimill serve` in Chromium; pictures in
                                   target/clients (needs a network, node and chromium)
  cargo xtask help                 print this text
";

/// One step of a task.
struct Step<'a> {
    name: &'a str,
    arguments: &'a [&'a str],
    /// Environment variables.
    environment: &'a [(&'a str, &'a str)],
    /// Toolchain component that may be missing, and the command that installs it.
    component: Option<(&'a str, &'a str)>,
}

/// Checks of the sources.
const CHECKS: &[Step] = &[
    Step {
        name: "format",
        arguments: &["fmt", "--all", "--check"],
        environment: &[],
        component: Some(("fmt", "rustup component add rustfmt")),
    },
    Step {
        name: "line lengths and names of machines",
        arguments: &["xtask", "lint"],
        environment: &[],
        component: None,
    },
    Step {
        name: "lints",
        arguments: &[
            "clippy",
            "--quiet",
            "--workspace",
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ],
        environment: &[],
        component: Some(("clippy", "rustup component add clippy")),
    },
    Step {
        name: "lints with logging",
        arguments: &[
            "clippy",
            "--quiet",
            "--package",
            "haptimill-firmware",
            "--features",
            "defmt",
            "--",
            "-D",
            "warnings",
        ],
        environment: &[],
        component: Some(("clippy", "rustup component add clippy")),
    },
    Step {
        name: "documentation",
        arguments: &["doc", "--quiet", "--workspace", "--no-deps"],
        environment: &[("RUSTDOCFLAGS", "-D warnings")],
        component: None,
    },
];

/// All tests that need no emulator. Tests of served machines mostly wait for the simulator, which
/// runs in real time, so more of them run at a time than there are processors.
const TESTS: &[Step] = &[Step {
    name: "tests",
    arguments: &["test", "--workspace", "--no-fail-fast"],
    environment: &[("RUST_TEST_THREADS", "4")],
    component: None,
}];

/// The feature of the tests that need the image of a board and its emulator.
const EMULATED: &str = "haptimill-tests/emulated";

const BENCH: &[Step] = &[Step {
    name: "benchmarks",
    arguments: &["bench", "--workspace", "--benches"],
    environment: &[],
    component: None,
}];

const KEYS: &[Step] = &[Step {
    name: "tables of keys",
    arguments: &[
        "run",
        "--quiet",
        "--package",
        "haptimill-machine-file",
        "--example",
        "key_tables",
        "--",
        "docs/machine-files.md",
    ],
    environment: &[],
    component: None,
}];

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words[..] {
        ["test"] => test(),
        ["test", "--native-only"] => test_natively(),
        ["lint"] => lint(&root())
            .and(names::lint(&root()))
            .and(cycles::lint(&root()))
            .and(commits::lint(&root()))
            .and(figures::lint(&root())),
        ["structure"] => structure::structure(&root()),
        ["structure", folder] => structure::structure(Path::new(folder)),
        ["board", name, "--uf2"] => uf2(name),
        ["board", name, "--image"] => image(name, None),
        ["board", name, "--image", other] => image(name, Some(other)),
        ["board", name, ref choice @ ..] if let Some(variant) = board::Variant::of(choice) => {
            board(name, &variant)
        }
        ["images"] => images(),
        ["instructions"] => instructions(),
        ["emulator"] => emulator::emulator(&root(), emulator::Task::Test),
        ["emulator", "--build"] => emulator::emulator(&root(), emulator::Task::Build),
        ["emulator", "--slot"] => emulator::emulator(&root(), emulator::Task::Slot),
        ["emulator", "--long"] => emulator::emulator(&root(), emulator::Task::LongTest)
            .and_then(|()| emulator::margin(&root(), board::FIVE_JOINTS_US)),
        ["emulator", "--period", period] => emulator::margin(&root(), period),
        ["machines"] => run(&[machines(&[("HAPTIMILL_WRITE", "1")])]),
        ["machines", file] => {
            let name = file.trim_start_matches("machines/");
            run(&[machines(&[("HAPTIMILL_MACHINE", name)])])
        }
        ["log", program, ref more @ ..] => log(program, more),
        ["bench"] => run(BENCH),
        ["keys"] => run(KEYS),
        ["fuzz", ref options @ ..] => fuzz(options),
        ["gcode", ref options @ ..] => gcode::gcode(options),
        ["senders"] => clients::senders(&root()),
        ["browser"] => clients::browser(&root()),
        ["help"] | [] => {
            print!("{HELP}");
            Ok(())
        }
        _ => {
            eprintln!("xtask: '{}' is not a task\n\n{HELP}", words.join(" "));
            return ExitCode::from(2);
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("xtask: {problem}");
            ExitCode::FAILURE
        }
    }
}

/// The step that runs machine files in the simulator.
const fn machines<'a>(environment: &'a [(&'a str, &'a str)]) -> Step<'a> {
    Step {
        name: "machines",
        arguments: &[
            "test",
            "--package",
            "haptimill",
            "--test",
            "all",
            "machines::",
            "--",
            "--nocapture",
        ],
        environment,
        component: None,
    }
}

/// Returns the root of the workspace.
fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_path_buf()
}

/// Runs all checks and tests.
fn test() -> Result<(), String> {
    run(CHECKS)?;
    provide()?;
    for board in board::BOARDS {
        if has("fmt") {
            board.check_format(&root())?;
        }
        let image = board.build(&root(), false)?;
        board.measure(&image)?;
        if board.has_uf2 {
            board.uf2(&image)?;
        }
        board.build_others(&root())?;
    }
    run(TESTS)?;
    // Controller and simulated machine take turns: a test keeps one processor busy.
    emulated("emulated runs", "--test-threads=2", &[])?;
    short_fuzz()?;
    emulator::emulator(&root(), emulator::Task::Test)
}

/// Runs all checks and tests that need neither the image of a board nor an emulator.
fn test_natively() -> Result<(), String> {
    run(CHECKS)?;
    run(TESTS)?;
    short_fuzz()?;
    println!(
        "SKIPPED  boards and emulated runs (--native-only): the controller was not tested on a chip"
    );
    Ok(())
}

/// Finds a board by name.
fn named(name: &str) -> Result<&'static Board, String> {
    Board::named(name).ok_or_else(|| {
        let names: Vec<&str> = board::BOARDS.iter().map(|board| board.name).collect();
        format!("there is no board '{name}'; there is {}", names.join(", "))
    })
}

/// Builds the product image of a board, or a variant of it, and prints its size.
fn board(name: &str, variant: &board::Variant<'_>) -> Result<(), String> {
    let board = named(name)?;
    let image = board.build_variant(&root(), false, variant)?;
    board.measure(&image)?;
    println!("{}", image.display());
    if board.has_uf2 {
        println!("{}", board.uf2(&image)?.display());
    }
    Ok(())
}

/// Builds the product image of a board as a UF2 file and prints its path.
fn uf2(name: &str) -> Result<(), String> {
    let board = named(name)?;
    let image = board.build(&root(), true)?;
    println!("{}", board.uf2(&image)?.display());
    Ok(())
}

/// Builds an image of a board and prints its path.
fn image(name: &str, other: Option<&str>) -> Result<(), String> {
    let board = named(name)?;
    let image = match other {
        Some(other) => board.build_other(&root(), other)?,
        None => board.build(&root(), true)?,
    };
    println!("{}", image.display());
    Ok(())
}

/// Builds the images of a release and prints their paths.
fn images() -> Result<(), String> {
    for file in release::images(&root())? {
        println!("{}", file.display());
    }
    Ok(())
}

/// Runs a part program on the emulated board with the logging image, and prints its log, also after
/// a failed run.
fn log(program: &str, more: &[&str]) -> Result<(), String> {
    provide()?;
    let image = named("mps2")?.build_other(&root(), "logging")?;
    let image = image.display().to_string();
    let folder = root().join("target").join("log");
    let file = folder.join("log.bin").display().to_string();
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let cargo = |arguments: &[&str]| {
        let status = cargo()
            .args(["run", "--quiet", "--release"])
            .args(arguments)
            .status();
        status.map_err(|error| format!("cargo cannot be started: {error}"))
    };
    let out = folder.display().to_string();
    let command = [
        "--package",
        "haptimill",
        "--",
        "run",
        program,
        "--port",
        "pil:mps2",
    ];
    let options = ["--image", &image, "--log", &file, "--out", &out];
    let ran = cargo(&[&command[..], &options, more].concat())?;
    let manifest = root().join("tests/log/Cargo.toml").display().to_string();
    let decoded = cargo(&["--manifest-path", &manifest, "--", &image, &file])?;
    if ran.success() && decoded.success() {
        Ok(())
    } else {
        Err("the run ended with an error".to_string())
    }
}

/// Rewrites the table of instructions.
fn instructions() -> Result<(), String> {
    provide()?;
    emulated(
        "instructions",
        "instructions::",
        &[("HAPTIMILL_WRITE", "1")],
    )
}

/// Runs the tests of emulated runs, with one more argument. They need a board's image and the
/// emulator, so they are built only where both exist.
fn emulated(name: &str, last: &str, environment: &[(&str, &str)]) -> Result<(), String> {
    run(&[Step {
        name,
        arguments: &[
            "test",
            "--workspace",
            "--features",
            EMULATED,
            "--test",
            "emulated",
            "--no-fail-fast",
            "--",
            "--nocapture",
            last,
        ],
        environment,
        component: None,
    }])
}

fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

fn has(component: &str) -> bool {
    cargo()
        .args([component, "--version"])
        .output()
        .is_ok_and(|output| output.status.success())
}

fn run(steps: &[Step]) -> Result<(), String> {
    let mut skipped = Vec::new();
    for step in steps {
        if let Some((component, remedy)) = step.component
            && !has(component)
        {
            skipped.push(format!(
                "{}: this toolchain has no 'cargo {component}'; {remedy}",
                step.name
            ));
            continue;
        }
        println!("== {}: cargo {}", step.name, step.arguments.join(" "));
        let start = Instant::now();
        let status = cargo()
            .args(step.arguments)
            .envs(step.environment.iter().copied())
            .status();
        match status {
            Ok(status) if status.success() => {
                println!(
                    "== {}: passed, {:.0} s",
                    step.name,
                    start.elapsed().as_secs_f64()
                );
            }
            Ok(status) => {
                return Err(format!(
                    "'{}' failed ({status}); to repeat it alone: cargo {}",
                    step.name,
                    step.arguments.join(" ")
                ));
            }
            Err(error) => {
                return Err(format!("cannot start cargo: {error}"));
            }
        }
    }
    for line in &skipped {
        println!("SKIPPED  {line}");
    }
    Ok(())
}
