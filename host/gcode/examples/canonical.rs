//! Prints the canonical motion of part programs, for comparisons with another interpreter, or
//! measures the interpreter.
//!
//! `canonical FILE...` prints for each file `= FILE`, its moves in mm and degrees, and `! PROBLEM`
//! for each problem. `canonical --count FILE` only counts the steps and prints CPU time and peak
//! memory (Linux). `--tools FILE` names a tool table in LinuxCNC's format, in inches.

use haptimill_gcode::{
    Feed, Interpreter, Move, Options, ProgramAxis, Step, Tool, ToolTable, WordKind, file_name,
};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

const LETTERS: [char; 6] = ['X', 'Y', 'Z', 'A', 'B', 'C'];

fn main() -> std::io::Result<()> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    let mut arguments = std::env::args().skip(1);
    let mut options = Options {
        axes: LETTERS
            .iter()
            .map(|letter| ProgramAxis {
                letter: *letter,
                kind: if "ABC".contains(*letter) {
                    WordKind::Rotary
                } else {
                    WordKind::Linear
                },
                wraps: false,
            })
            .collect(),
        optional_stop: true,
        coolant: true,
        outputs: true,
        ..Options::default()
    };
    let mut count = false;
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--count" => count = true,
            "--tools" => options.tools = tools(&arguments.next().unwrap_or_default())?,
            file => {
                let path = Path::new(file);
                options.folders = path.parent().map(Path::to_owned).into_iter().collect();
                let mut interpreter = Interpreter::new(File::open(path)?, &options);
                if count {
                    let (mut steps, mut problems) = (0u64, 0u64);
                    for step in &mut interpreter {
                        match step {
                            Ok(_) => steps += 1,
                            Err(_) => problems += 1,
                        }
                    }
                    writeln!(out, "{steps} steps, {problems} problems {}", resources())?;
                } else {
                    writeln!(out, "= {file}")?;
                    print(&mut interpreter, file, &mut out)?;
                }
            }
        }
    }
    out.flush()
}

fn print(interpreter: &mut Interpreter, file: &str, out: &mut impl Write) -> std::io::Result<()> {
    while let Some(step) = interpreter.next() {
        match step {
            Ok(Step::Move(step)) => print_move(&step, None, out)?,
            Ok(Step::Probe { step, .. }) => print_move(&step, Some('P'), out)?,
            Ok(Step::Dwell { seconds, .. }) => writeln!(out, "D {seconds}")?,
            Ok(_) => {}
            Err(problem) => writeln!(
                out,
                "! {}:{}:{}: {}; {}",
                file_name(file, interpreter.called(), problem.place.file),
                problem.place.line,
                problem.place.column,
                problem.what,
                problem.remedy
            )?,
        }
    }
    Ok(())
}

/// Prints a move: line, kind, end, feed, and of an arc its plane, centre and sweep.
fn print_move(step: &Move, kind: Option<char>, out: &mut impl Write) -> std::io::Result<()> {
    let (mut letter, feed) = match step.feed {
        Feed::Rapid => ('T', 0.0),
        Feed::PerMinute(feed) => ('F', feed),
    };
    if step.path.arc.is_some() {
        letter = 'A';
    }
    write!(out, "{} {}", kind.unwrap_or(letter), step.place.line)?;
    for value in step.path.to {
        write!(out, " {value:.7}")?;
    }
    write!(out, " {feed:.7}")?;
    if let Some(arc) = &step.path.arc {
        let [first, second] = arc.plane;
        let [a, b] = arc.centre;
        write!(out, " {first} {second} {a:.7} {b:.7} {:.9}", arc.sweep)?;
    }
    writeln!(out)
}

/// Reads tool numbers, Z offsets and diameters of a tool table.
fn tools(file: &str) -> std::io::Result<ToolTable> {
    let text = std::fs::read_to_string(file)?;
    let mut tools = ToolTable::new();
    for line in text.lines() {
        let mut tool = Tool::default();
        let mut number = None;
        for word in line.split(';').next().unwrap_or("").split_whitespace() {
            let value = |text: &str| text.parse::<f64>().unwrap_or(0.0) * 25.4;
            match word.split_at(1) {
                ("T", text) => number = text.parse().ok(),
                ("Z", text) => tool.offset[2] = value(text),
                ("D", text) => tool.diameter = value(text),
                _ => {}
            }
        }
        if let Some(number) = number {
            tools.insert(number, tool);
        }
    }
    Ok(tools)
}

/// Returns CPU seconds and peak memory of this process.
fn resources() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .unwrap_or("unknown")
        .trim();
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // User and system time are the 14th and 15th values, in hundredths of a second.
    let ticks: u64 = stat
        .rsplit(')')
        .next()
        .unwrap_or("")
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|value| value.parse::<u64>().ok())
        .sum();
    format!("cpu_s={} peak={peak}", ticks as f64 / 100.0)
}
