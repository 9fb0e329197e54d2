//! Installs the system packages that boards, emulated runs and the scripts of the pages need.
//!
//! The decision is separate from the installation, so that it can be tested on a computer where
//! nothing is missing.

use crate::board::{BOARDS, DEBIAN_PACKAGES};
use std::process::Command;

/// The emulator, and the name of its Debian package.
const EMULATOR: &str = "qemu-system-arm";

/// What runs the scripts of the pages outside of a browser: its program and its Debian package.
const SCRIPTS: (&str, &str) = ("node", "nodejs");

/// Installs what is needed to build for a chip and to emulate it. If that is impossible, the error
/// says how to install it.
pub fn provide() -> Result<(), String> {
    provide_by(&here, &mut |arguments| {
        let status = Command::new("apt-get")
            .args(arguments)
            .env("DEBIAN_FRONTEND", "noninteractive")
            .status();
        status.is_ok_and(|status| status.success())
    })
}

/// Installed tools.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Tools {
    /// A toolchain that builds for every board.
    toolchain: bool,
    emulator: bool,
    scripts: bool,
}

/// Returns the tools installed on this computer.
fn here() -> Tools {
    let runs = |program: &str| {
        let output = Command::new(program).arg("--version").output();
        output.is_ok_and(|output| output.status.success())
    };
    Tools {
        toolchain: BOARDS.iter().all(|board| board.toolchain().is_some()),
        emulator: runs(EMULATOR),
        scripts: runs(SCRIPTS.0),
    }
}

/// Returns the missing packages.
fn missing(tools: Tools) -> Vec<&'static str> {
    let compiler = if tools.toolchain {
        &[]
    } else {
        DEBIAN_PACKAGES
    };
    let emulator: &[&str] = if tools.emulator { &[] } else { &[EMULATOR] };
    let scripts: &[&str] = if tools.scripts { &[] } else { &[SCRIPTS.1] };
    [compiler, emulator, scripts].concat()
}

/// Installs missing packages with `apt`, which returns its success, and checks again.
fn provide_by(
    check: &dyn Fn() -> Tools,
    apt: &mut dyn FnMut(&[&str]) -> bool,
) -> Result<(), String> {
    let packages = missing(check());
    if packages.is_empty() {
        return Ok(());
    }
    let install = [&["install", "-y", "--no-install-recommends"][..], &packages].concat();
    println!("== packages: apt-get {}", install.join(" "));
    // A failed update is accepted: the present package list may suffice.
    apt(&["update"]);
    if apt(&install) {
        let left = missing(check());
        if left.is_empty() {
            return Ok(());
        }
        return Err(format!(
            "apt-get has installed {}, and a tool is still missing; `cargo xtask board mps2` names it",
            left.join(" ")
        ));
    }
    let compiler = if packages.contains(&DEBIAN_PACKAGES[0]) {
        "\n(instead of the compiler packages, `rustup target add thumbv7em-none-eabihf` does)"
    } else {
        ""
    };
    Err(format!(
        "boards, emulated runs and pages need packages that cannot be installed from here. As root: apt-get update && apt-get install {}{compiler}. \
         Without them: cargo xtask test --native-only",
        packages.join(" ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    const NOTHING: Tools = Tools {
        toolchain: false,
        emulator: false,
        scripts: false,
    };
    const ALL: Tools = Tools {
        toolchain: true,
        emulator: true,
        scripts: true,
    };

    /// Returns the calls of apt and the result, for the tools before and after an installation that
    /// succeeds or fails.
    fn tried(before: Tools, works: bool, after: Tools) -> (Vec<String>, Result<(), String>) {
        let (installed, mut calls) = (Cell::new(false), Vec::new());
        let done = provide_by(
            &|| if installed.get() { after } else { before },
            &mut |arguments| {
                calls.push(arguments.join(" "));
                let install = arguments[0] == "install";
                installed.set(installed.get() || install && works);
                works || !install
            },
        );
        (calls, done)
    }

    #[test]
    fn nothing_is_installed_where_nothing_is_missing() {
        assert_eq!(tried(ALL, true, ALL), (vec![], Ok(())));
    }

    #[test]
    fn what_is_missing_is_installed_and_nothing_else() {
        let (calls, done) = tried(NOTHING, true, ALL);
        let install = "install -y --no-install-recommends";
        let compiler = "rustc-web cargo-web rust-web-src lld-22";
        let everything = format!("{install} {compiler} qemu-system-arm nodejs");
        assert_eq!((calls, done), (vec!["update".into(), everything], Ok(())));
        let without_emulator = Tools {
            emulator: false,
            ..ALL
        };
        let (calls, _) = tried(without_emulator, true, ALL);
        assert_eq!(calls[1], format!("{install} qemu-system-arm"));
        let without_compiler = Tools {
            toolchain: false,
            ..ALL
        };
        let (calls, _) = tried(without_compiler, true, ALL);
        assert_eq!(calls[1], format!("{install} {compiler}"));
    }

    #[test]
    fn what_cannot_be_installed_is_named_with_its_command() {
        let (_, done) = tried(NOTHING, false, NOTHING);
        let problem = done.expect_err("nothing was installed");
        for word in [
            "apt-get install rustc-web cargo-web rust-web-src lld-22 qemu-system-arm nodejs",
            "rustup target add",
            "--native-only",
        ] {
            assert!(problem.contains(word), "{problem}");
        }
        let without_emulator = Tools {
            emulator: false,
            ..ALL
        };
        let (_, done) = tried(without_emulator, false, without_emulator);
        let problem = done.expect_err("nothing was installed");
        assert!(
            problem.contains("apt-get install qemu-system-arm"),
            "{problem}"
        );
        assert!(!problem.contains("rustup"), "{problem}");
    }

    #[test]
    fn an_installation_that_does_not_help_is_reported() {
        let still = Tools {
            toolchain: false,
            ..ALL
        };
        let (_, done) = tried(NOTHING, true, still);
        let problem = done.expect_err("there is no compiler");
        assert!(problem.contains("rustc-web"), "{problem}");
        assert!(!problem.contains("qemu"), "{problem}");
    }
}
