//! Programs of others that operate the machine: senders for Grbl, and a browser.
//!
//! They are installed from their registries into `target/clients`, so that these tasks need a
//! network, Node.js and Python, and are no part of `cargo xtask test`.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

const STREAMER: &str = "grbl-streamer==2.0.2";
const CNCJS: &str = "cncjs@1.11.5";
const PLAYWRIGHT: &str = "playwright-core@1.65.1";

/// Port of cncjs on the loopback address.
const CNCJS_PORT: &str = "18765";

/// Starts a program, with the remedy if there is none.
fn run(what: &str, command: &mut Command) -> Result<(), String> {
    let name = command.get_program().to_string_lossy().into_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{what}: {name} ended with {status}")),
        Err(error) => Err(format!(
            "{what}: {name} cannot be started: {error}; install it"
        )),
    }
}

/// Builds the host command and returns its path.
fn build(root: &Path) -> Result<PathBuf, String> {
    let arguments = ["build", "--quiet", "--package", "haptimill"];
    run(
        "build",
        Command::new("cargo").args(arguments).current_dir(root),
    )?;
    Ok(root.join("target/debug/haptimill"))
}

fn install_npm(folder: &Path, package: &str) -> Result<(), String> {
    let options = ["install", "--no-audit", "--no-fund", "--silent", "--prefix"];
    run(
        package,
        Command::new("npm").args(options).arg(folder).arg(package),
    )
}

/// A bridge that is ended with this value.
struct Bridge {
    child: Child,
    pty: String,
}

impl Bridge {
    fn start(command: &Path, root: &Path) -> Result<Self, String> {
        let mut child = Command::new(command)
            .args(["bridge", "grbl", "--machine", "machines/mill3-servo.toml"])
            .current_dir(root)
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| format!("{}: {error}", command.display()))?;
        let mut pty = String::new();
        if let Some(out) = child.stdout.take() {
            BufReader::new(out)
                .read_line(&mut pty)
                .map_err(|error| error.to_string())?;
        }
        let pty = pty.trim().to_string();
        Ok(Self { child, pty })
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Lets grbl-streamer and cncjs home a simulated mill and complete a program.
pub fn senders(root: &Path) -> Result<(), String> {
    let command = build(root)?;
    let folder = root.join("target/clients");
    let python = folder.join("python");
    let scripts = root.join("host/cli/tests/senders");
    let program = scripts.join("job.ngc");
    let options = ["-m", "pip", "install", "--quiet", "--target"];
    run(
        STREAMER,
        Command::new("python3")
            .args(options)
            .arg(&python)
            .arg(STREAMER),
    )?;
    install_npm(&folder, CNCJS)?;
    let bridge = Bridge::start(&command, root)?;
    let mut streamer = Command::new("python3");
    streamer
        .arg(scripts.join("streamer.py"))
        .arg(&bridge.pty)
        .arg(&program);
    run(STREAMER, streamer.env("PYTHONPATH", &python))?;
    drop(bridge);
    let bridge = Bridge::start(&command, root)?;
    let mut cncjs = Command::new("node");
    cncjs
        .arg(scripts.join("cncjs.js"))
        .arg(&folder)
        .arg(&bridge.pty);
    run(CNCJS, cncjs.arg(&program).arg(CNCJS_PORT))
}

/// Operates the page of `haptimill serve` in Chromium, and writes its pictures to a folder.
pub fn browser(root: &Path) -> Result<(), String> {
    let command = build(root)?;
    let folder = root.join("target/clients");
    install_npm(&folder, PLAYWRIGHT)?;
    let mut script = Command::new("node");
    script
        .arg(root.join("host/web/tests/browser.js"))
        .arg(&folder)
        .arg(command);
    run("browser", script.current_dir(root))
}
