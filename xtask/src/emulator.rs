//! The emulator of boards with an RP2350: takes the pinned packages from the registry, applies the
//! project's repairs, and tests them.

use crate::board::Variant;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};

/// Packages that are repaired, with their versions; each has a patch `NAME-VERSION.patch`.
const PACKAGES: [(&str, &str); 2] = [("rp2350-emu", "0.2.6"), ("picoem-common", "0.2.2")];

/// Folder of the program.
const FOLDER: &str = "host/emulator";

/// Board whose image runs in the emulator.
const BOARD: &str = "pico2";
/// Variants of the image that are tested, too.
const UART: Variant<'_> = Variant {
    option: Some("uart"),
    log: false,
    period_us: None,
};
const ENCODERS: Variant<'_> = Variant {
    option: Some("encoders"),
    log: false,
    period_us: None,
};
const SPI: Variant<'_> = Variant {
    option: Some("spi"),
    log: false,
    period_us: None,
};
const PERIOD_320_US: Variant<'_> = Variant {
    option: None,
    log: false,
    period_us: Some("320"),
};
const LOG: Variant<'_> = Variant {
    option: None,
    log: true,
    period_us: None,
};

/// What is done with the repaired emulator.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Build the program and the images of the board, for `haptimill run --port emu:pico2`.
    Build,
    /// Test the repairs and the image of the board.
    Test,
    /// As `Test`, with the tests that take many minutes.
    LongTest,
    /// Run the slot of the experiment E7 with the image of the board.
    Slot,
}

/// Repairs the emulator, and builds or tests it.
///
/// # Errors
/// A package cannot be fetched, a patch does not fit, the image cannot be built, or a test fails.
pub fn emulator(root: &Path, task: Task) -> Result<(), String> {
    let folder = root.join(FOLDER);
    repair(root, &folder)?;
    // An image keeps one processor busy for most of its build, so the tests are built beside it.
    let mut tests = crate::cargo();
    tests
        .current_dir(&folder)
        .args(["test", "--release", "--locked", "--no-run"]);
    let building = match task {
        Task::Test | Task::LongTest => Some(start(&mut tests)?),
        Task::Build | Task::Slot => None,
    };
    let images = images(root, task);
    if let Some(mut building) = building {
        ended("cargo", building.wait())?;
    }
    let images = images?;
    let mut cargo = crate::cargo();
    cargo.current_dir(&folder).envs(images.iter().cloned());
    match task {
        Task::Build => cargo.args(["build", "--release", "--locked"]),
        Task::Test | Task::LongTest => {
            // A test keeps one processor busy.
            let all = ["--", "--nocapture", "--test-threads=2", "--include-ignored"];
            let words = if task == Task::Test { &all[..3] } else { &all };
            cargo.args(["test", "--release", "--locked"]).args(words)
        }
        Task::Slot => cargo
            .args(["test", "--release", "--locked", "--test", "programs", "--"])
            .args(["--nocapture", "--include-ignored", "the_whole_slot"]),
    };
    succeed(&mut cargo)?;
    if task == Task::Build {
        println!(
            "{}",
            folder.join("target/release/haptimill-emulator").display()
        );
        for (_, image) in images {
            println!("{}", image.display());
        }
    }
    Ok(())
}

/// Builds the images that a task needs; returns the variables of the tests and the files.
fn images(root: &Path, task: Task) -> Result<Vec<(&'static str, PathBuf)>, String> {
    let board = crate::named(BOARD)?;
    let uf2 = |variant| board.uf2(&board.build_variant(root, true, variant)?);
    let mut images = Vec::new();
    if matches!(task, Task::Test | Task::LongTest) {
        images.push(("HAPTIMILL_UART_IMAGE", uf2(&UART)?));
        images.push(("HAPTIMILL_320_US_IMAGE", uf2(&PERIOD_320_US)?));
        // Its ELF file has the texts of the log.
        let log = board.build_variant(root, true, &LOG)?;
        images.push(("HAPTIMILL_LOG_IMAGE", log));
    }
    if task != Task::Slot {
        images.push(("HAPTIMILL_ENCODER_IMAGE", uf2(&ENCODERS)?));
        images.push(("HAPTIMILL_SPI_IMAGE", uf2(&SPI)?));
    }
    // Last: the path of the ELF file then has the image that the board has without options.
    images.push(("HAPTIMILL_IMAGE", board.uf2(&board.build(root, true)?)?));
    Ok(images)
}

/// Measures how much of a control period is left in the worst one, with an image that has this
/// period, in us.
///
/// # Errors
/// As [`emulator`]; or less is left than the test requires.
pub fn margin(root: &Path, period_us: &str) -> Result<(), String> {
    let folder = root.join(FOLDER);
    repair(root, &folder)?;
    let board = crate::named(BOARD)?;
    let image = |option| {
        let variant = Variant {
            option,
            log: false,
            period_us: Some(period_us),
        };
        board.uf2(&board.build_variant(root, true, &variant)?)
    };
    let mut cargo = crate::cargo();
    cargo
        .current_dir(&folder)
        .env("HAPTIMILL_ENCODER_IMAGE", image(Some("encoders"))?)
        .env("HAPTIMILL_IMAGE", image(None)?)
        .env("HAPTIMILL_PERIOD_US", period_us)
        .args(["test", "--release", "--locked", "--test", "margin", "--"])
        .args(["--nocapture", "--test-threads=2", "--include-ignored"]);
    succeed(&mut cargo)
}

/// Puts the repaired sources into `target/patched/`, unless they are there already.
fn repair(root: &Path, folder: &Path) -> Result<(), String> {
    let patched = folder.join("target/patched");
    for (name, version) in PACKAGES {
        let package = format!("{name}-{version}");
        let patch = folder.join("patches").join(format!("{package}.patch"));
        let text = fs::read(&patch).map_err(|error| format!("{}: {error}", patch.display()))?;
        let target = patched.join(&package);
        let applied = target.join("applied.patch");
        if fs::read(&applied).is_ok_and(|before| before == text) {
            continue;
        }
        let source = source(root, name, version)?;
        if target.exists() {
            fs::remove_dir_all(&target)
                .map_err(|error| format!("{}: {error}", target.display()))?;
        }
        copy(&source, &target)?;
        let mut git = Command::new("git");
        // Inside a repository `git apply` would skip files without a word: their paths are not
        // those of the repository.
        git.current_dir(&target)
            .env("GIT_CEILING_DIRECTORIES", &patched)
            .arg("apply")
            .arg(&patch);
        succeed(&mut git)?;
        fs::write(&applied, text).map_err(|error| format!("{}: {error}", applied.display()))?;
    }
    Ok(())
}

/// Folder of the sources of a package of the registry.
fn source(root: &Path, name: &str, version: &str) -> Result<PathBuf, String> {
    let scratch = root.join("target/emulator-sources").join(name);
    let problem = |error| format!("{}: {error}", scratch.display());
    fs::create_dir_all(scratch.join("src")).map_err(problem)?;
    fs::write(scratch.join("src/lib.rs"), "").map_err(problem)?;
    let manifest = format!(
        "[package]\nname = \"sources\"\nversion = \"0.0.0\"\n[workspace]\n[dependencies]\n{name} = \"={version}\"\n"
    );
    fs::write(scratch.join("Cargo.toml"), manifest).map_err(problem)?;
    let output = crate::cargo()
        .current_dir(&scratch)
        .args(["metadata", "--format-version", "1"])
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let end = format!("{name}-{version}/Cargo.toml");
    let found = text
        .split('"')
        .find(|word| word.ends_with(&end))
        .and_then(|manifest| Path::new(manifest).parent());
    found.map(Path::to_path_buf).ok_or_else(|| {
        format!(
            "the package {name} {version} cannot be fetched: {}",
            String::from_utf8_lossy(&output.stderr)
        )
    })
}

/// Copies a folder.
fn copy(from: &Path, to: &Path) -> Result<(), String> {
    let problem = |error| format!("{}: {error}", from.display());
    fs::create_dir_all(to).map_err(|error| format!("{}: {error}", to.display()))?;
    for entry in fs::read_dir(from).map_err(problem)? {
        let entry = entry.map_err(problem)?;
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if entry.file_type().map_err(problem)?.is_dir() {
            copy(&path, &target)?;
        } else {
            let copied = fs::copy(&path, &target);
            copied.map_err(|error| format!("{}: {error}", path.display()))?;
        }
    }
    Ok(())
}

/// Starts a command.
fn start(command: &mut Command) -> Result<Child, String> {
    let name = command.get_program().to_string_lossy().into_owned();
    command
        .spawn()
        .map_err(|error| format!("{name} cannot be started: {error}"))
}

/// Runs a command that must succeed.
fn succeed(command: &mut Command) -> Result<(), String> {
    let status = start(command)?.wait();
    let name = command.get_program().to_string_lossy().into_owned();
    ended(&name, status)
}

/// An error unless the command with this name succeeded.
fn ended(name: &str, status: std::io::Result<ExitStatus>) -> Result<(), String> {
    match status {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{name} failed ({status})")),
        Err(error) => Err(format!("{name} cannot be waited for: {error}")),
    }
}
