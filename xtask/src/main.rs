//! The chores of the project. `cargo xtask help` lists them.

use std::env;
use std::process::{Command, ExitCode};
use std::time::Instant;

const HELP: &str = "\
The chores of the project.

  cargo xtask test     everything that must hold: format, lints, all tests, documentation
  cargo xtask bench    all benchmarks (criterion); figures in target/criterion
  cargo xtask help     this text
";

/// One step of a chore.
struct Step {
    name: &'static str,
    arguments: &'static [&'static str],
    /// Settings of the environment.
    environment: &'static [(&'static str, &'static str)],
    /// A component that a toolchain may lack, with what to do then.
    component: Option<(&'static str, &'static str)>,
}

const TEST: &[Step] = &[
    Step {
        name: "format",
        arguments: &["fmt", "--all", "--check"],
        environment: &[],
        component: Some(("fmt", "rustup component add rustfmt")),
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
        name: "documentation",
        arguments: &["doc", "--quiet", "--workspace", "--no-deps"],
        environment: &[("RUSTDOCFLAGS", "-D warnings")],
        component: None,
    },
    Step {
        name: "tests",
        arguments: &["test", "--workspace"],
        environment: &[],
        component: None,
    },
];

const BENCH: &[Step] = &[Step {
    name: "benchmarks",
    arguments: &["bench", "--workspace", "--benches"],
    environment: &[],
    component: None,
}];

fn main() -> ExitCode {
    let chore = env::args().nth(1).unwrap_or_default();
    match chore.as_str() {
        "test" => run(TEST),
        "bench" => run(BENCH),
        "help" | "" => {
            print!("{HELP}");
            ExitCode::SUCCESS
        }
        other => {
            eprintln!("xtask: there is no chore '{other}'\n\n{HELP}");
            ExitCode::from(2)
        }
    }
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

fn run(steps: &[Step]) -> ExitCode {
    let mut left_out = Vec::new();
    for step in steps {
        if let Some((component, remedy)) = step.component
            && !has(component)
        {
            left_out.push(format!(
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
                    "== {}: well, {:.0} s",
                    step.name,
                    start.elapsed().as_secs_f64()
                );
            }
            Ok(status) => {
                eprintln!(
                    "xtask: '{}' failed ({status}); to repeat it alone: cargo {}",
                    step.name,
                    step.arguments.join(" ")
                );
                return ExitCode::FAILURE;
            }
            Err(error) => {
                eprintln!("xtask: cannot start cargo: {error}");
                return ExitCode::FAILURE;
            }
        }
    }
    for line in &left_out {
        println!("LEFT OUT  {line}");
    }
    ExitCode::SUCCESS
}
