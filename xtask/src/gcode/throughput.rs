//! CPU time and memory of the interpreter and of `haptimill run --check`, beside `rs274 -g`.

use crate::root;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Blocks of each program.
const BLOCKS: u32 = 200_000;

/// Rounds: each runs the three commands one after another, and gives a pair of ratios.
const ROUNDS: usize = 5;

/// Largest ratios of CPU time to `rs274 -g`, of the interpreter and of `--check`, largest memory of
/// `--check`, MiB, and largest CPU time to the first setpoint of a stream, seconds.
const MAX: [f64; 4] = [0.5, 1.0, 32.0, 0.1];

/// Names and texts of the programs: a wave of short moves within the built-in machine.
fn programs() -> Vec<(&'static str, String)> {
    let head = "G21 G90 G17\nG0 X0 Y0 Z30\nF600\n";
    let names = ["lines", "CAM lines", "arcs", "5-axis"];
    let mut texts: Vec<String> = names.map(|_| head.to_owned()).into();
    for block in 0..BLOCKS {
        let angle = f64::from(block) * 0.01;
        let radius = 10.0 + 5.0 * (0.013 * angle).sin();
        let (sin, cos) = angle.sin_cos();
        let (x, y, z) = (radius * cos, radius * sin, 30.0 + 0.5 * (0.7 * angle).sin());
        let number = 10 * (block + 1);
        // Writing to a string cannot fail.
        let _ = writeln!(texts[0], "G1 X{x:.4} Y{y:.4} Z{z:.4}");
        let _ = writeln!(
            texts[1],
            "N{number} G01 X{x:.3} Y{y:.3} Z{z:.3} F{}",
            500 + block % 100
        );
        // Half circles of 1 mm, there and back.
        let (code, x) = if block % 2 == 0 { (2, 1) } else { (3, 0) };
        let _ = writeln!(
            texts[2],
            "G{code} X{x} Y0 I{} J0",
            if x == 1 { 0.5 } else { -0.5 }
        );
        let (b, a) = (2.0 * (0.31 * angle).sin(), 2.0 * (0.23 * angle).cos());
        let _ = writeln!(
            texts[3],
            "G1 X{x:.4} Y{y:.4} Z{z:.4} B{b:.4} A{a:.4}",
            x = radius * cos
        );
    }
    names
        .into_iter()
        .zip(texts.into_iter().map(|text| text + "M2\n"))
        .collect()
}

/// CPU seconds and peak memory in KiB of a command.
fn measure(command: &[&str], folder: &Path) -> Result<(f64, u64), String> {
    // The shell's `time` counts the CPU time of the command alone.
    let mut child = Command::new("bash")
        .args([
            "-c",
            "TIMEFORMAT='cpu %U %S'; time \"$@\" > /dev/null",
            "bash",
        ])
        .args(command)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| format!("bash: {error}"))?;
    let mut peak = 0;
    let status = loop {
        peak = peak.max(peak_of_children(child.id()));
        if let Some(status) = child.try_wait().map_err(|error| error.to_string())? {
            break status;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let output = child
        .wait_with_output()
        .map_err(|error| error.to_string())?;
    let errors = String::from_utf8_lossy(&output.stderr);
    let cpu = errors
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix("cpu "));
    let cpu: f64 = cpu
        .map(|text| {
            text.split(' ')
                .filter_map(|word| word.parse::<f64>().ok())
                .sum()
        })
        .ok_or_else(|| format!("{command:?}: {errors}"))?;
    if !status.success() {
        return Err(format!("{command:?}: {errors}"));
    }
    Ok((cpu, peak))
}

/// Largest memory so far of the children of a process, KiB.
fn peak_of_children(parent: u32) -> u64 {
    let children = format!("/proc/{parent}/task/{parent}/children");
    let children = std::fs::read_to_string(children).unwrap_or_default();
    let of = |child: &str| {
        let status = std::fs::read_to_string(format!("/proc/{child}/status")).ok()?;
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmHWM:"))?;
        line.trim().trim_end_matches(" kB").parse().ok()
    };
    children
        .split_whitespace()
        .filter_map(of)
        .max()
        .unwrap_or(0)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// CPU seconds to the first setpoint of a stream, from the start of a process.
fn first_setpoint(command: &str, file: &str) -> Result<f64, String> {
    let output = Command::new(command)
        .arg(file)
        .output()
        .map_err(|error| format!("{command}: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let seconds = text
        .trim()
        .strip_suffix(" CPU s")
        .and_then(|text| text.rsplit(' ').next())
        .and_then(|word| word.parse().ok());
    seconds.ok_or_else(|| format!("{command} {file}: {text}"))
}

/// Prints the ratios of CPU time to `rs274 -g`, as medians of paired runs, the peak memory, and the
/// CPU time to the first setpoint.
///
/// # Errors
///
/// A program cannot be built or started, it refuses a file, or a figure is above [`MAX`].
pub(super) fn run(rs274: &str, folder: &Path) -> Result<(), String> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    for target in [
        &["--package", "haptimill-gcode", "--example", "canonical"][..],
        &["--package", "haptimill", "--bin", "haptimill"],
        &[
            "--package",
            "haptimill-machine-file",
            "--example",
            "first_setpoint",
        ],
    ] {
        let status = Command::new(&cargo)
            .current_dir(root())
            .args(["build", "--release", "--quiet"])
            .args(target)
            .status()
            .map_err(|error| error.to_string())?;
        if !status.success() {
            return Err("the build failed".into());
        }
    }
    let built = root().join("target/release");
    let text = |path: PathBuf| path.to_string_lossy().into_owned();
    let canonical = text(built.join("examples/canonical"));
    let haptimill = text(built.join("haptimill"));
    let stream = text(built.join("examples/first_setpoint"));
    let tools = text(folder.join("tools.tbl"));
    let parameters = text(folder.join("parameters.var"));
    super::write(Path::new(&tools), &super::tool_table())?;
    println!(
        "{BLOCKS} blocks, release profile, median of {ROUNDS} paired runs; CPU time over rs274 -g"
    );
    println!("program     rs274 s  interpreter  --check  MiB of --check  first setpoint s");
    let mut beyond = Vec::new();
    for (name, program) in programs() {
        let file = text(folder.join(format!("throughput-{}.ngc", name.replace(' ', "-"))));
        super::write(Path::new(&file), &program)?;
        let (mut theirs, mut alone, mut whole) = (Vec::new(), Vec::new(), Vec::new());
        let mut memory = 0;
        for _ in 0..ROUNDS {
            super::write(Path::new(&parameters), "")?;
            let (base, _) = measure(
                &[rs274, "-g", "-t", &tools, "-v", &parameters, &file],
                folder,
            )?;
            let (interpreter, _) = measure(&[&canonical, "--count", &file], folder)?;
            let (check, peak) = measure(&[&haptimill, "run", &file, "--check"], folder)?;
            theirs.push(base);
            alone.push(interpreter / base);
            whole.push(check / base);
            memory = memory.max(peak);
        }
        let figures = [
            median(&mut alone),
            median(&mut whole),
            memory as f64 / 1024.0,
            first_setpoint(&stream, &file)?,
        ];
        let [alone, whole, memory, first] = figures;
        println!(
            "{name:<12}{:7.2}{alone:13.2}{whole:9.2}{memory:10.1}{first:19.3}",
            median(&mut theirs)
        );
        if figures.iter().zip(MAX).any(|(figure, max)| *figure > max) {
            beyond.push(name);
        }
    }
    if !beyond.is_empty() {
        let names = beyond.join(", ");
        return Err(format!("{names}: above {MAX:?}"));
    }
    Ok(())
}
