//! Compares the canonical motion of the interpreter with LinuxCNC's `rs274`.
//!
//! Both interpret the same files. Ends of moves, arcs and feeds are compared in mm and degrees.
//! `rs274` prints four decimals, in inches for programs in inches, which gives the tolerance.

mod generate;
mod throughput;

use crate::root;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

const USAGE: &str = "cargo xtask gcode [--rs274 PROGRAM] [--verbose] [--generate NUMBER] \
                     [--throughput] [FILE or FOLDER ...]";

/// A move: kind, end in mm and degrees, and further values.
#[derive(Debug, Clone, PartialEq)]
struct Element {
    /// T traverse, F feed, A arc, P probe, N NURBS (without values).
    kind: char,
    end: [f64; 6],
    feed: f64,
    /// Centre in the plane and signed turns begun, of an arc.
    arc: Option<([usize; 2], [f64; 2], f64)>,
    /// Error of the printed numbers, mm.
    error: f64,
}

/// Result of one interpreter for one file.
#[derive(Debug, Default)]
struct Run {
    elements: Vec<Element>,
    refusal: Option<String>,
}

/// Runs the comparison.
///
/// # Errors
///
/// A program cannot be started, or the motion of a file differs.
pub fn gcode(options: &[&str]) -> Result<(), String> {
    let mut rs274 = "rs274".to_owned();
    let (mut verbose, mut measures) = (false, false);
    let mut generated = 0u64;
    let mut files = Vec::new();
    let mut rest = options.iter();
    while let Some(option) = rest.next() {
        match *option {
            "--rs274" => rs274 = (*rest.next().ok_or(USAGE)?).to_owned(),
            "--verbose" => verbose = true,
            "--throughput" => measures = true,
            "--generate" => {
                generated = rest
                    .next()
                    .and_then(|text| text.parse().ok())
                    .ok_or(USAGE)?;
            }
            option if option.starts_with("--") => return Err(USAGE.into()),
            path => collect(Path::new(path), &mut files)?,
        }
    }
    let folder = root().join("target").join("gcode-comparison");
    std::fs::create_dir_all(&folder).map_err(|error| error.to_string())?;
    if measures {
        return throughput::run(&rs274, &folder);
    }
    for seed in 0..generated {
        let path = folder.join(format!("generated-{seed:05}.ngc"));
        write(&path, &generate::program(seed))?;
        files.push(path);
    }
    if files.is_empty() {
        return Err(USAGE.into());
    }
    files.sort();
    files.dedup();
    let tools = folder.join("tools.tbl");
    write(&tools, &tool_table())?;
    let ours = run_ours(&files, &tools)?;
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut differing = 0;
    for (index, file) in files.iter().enumerate() {
        let theirs = run_theirs(&rs274, file, &tools, &folder)?;
        let ours = &ours[index];
        let (class, text) = match (&ours.refusal, &theirs.refusal) {
            (Some(_), Some(_)) => ("both refuse", String::new()),
            (Some(ours), None) => ("only rs274 accepts", ours.clone()),
            (None, Some(theirs)) => ("only the interpreter accepts", theirs.clone()),
            (None, None) => match compare(&ours.elements, &theirs.elements) {
                None => ("equal motion", String::new()),
                Some(text) => {
                    differing += 1;
                    ("different motion", text)
                }
            },
        };
        *counts.entry(class).or_default() += 1;
        if verbose || class.starts_with("only") || class.starts_with("different") {
            println!("{class}: {} {text}", file.display());
        }
    }
    for (class, count) in &counts {
        println!("{count:5} {class}");
    }
    if differing > 0 {
        return Err(format!("the motion of {differing} files differs"));
    }
    Ok(())
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) -> Result<(), String> {
    if path.is_dir() {
        let entries = std::fs::read_dir(path).map_err(|error| error.to_string())?;
        for entry in entries {
            let path = entry.map_err(|error| error.to_string())?.path();
            if path.is_dir() || path.extension().is_some_and(|end| end == "ngc") {
                collect(&path, files)?;
            }
        }
    } else {
        let path = path
            .canonicalize()
            .map_err(|error| format!("{}: {error}", path.display()))?;
        files.push(path);
    }
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()))
}

/// Tools 1 to 99 in inches: lengths of a hundredth, diameters of a thousandth of the number times
/// ten.
fn tool_table() -> String {
    (1..100)
        .map(|number| {
            format!(
                "T{number} P{number} Z{:.4} D{:.4} ;\n",
                f64::from(number) * 0.01,
                f64::from(number) * 0.01
            )
        })
        .collect()
}

/// Interprets files with the crate of this project.
fn run_ours(files: &[PathBuf], tools: &Path) -> Result<Vec<Run>, String> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let output = Command::new(cargo)
        .current_dir(root())
        .args(["run", "--quiet", "--package", "haptimill-gcode"])
        .args(["--example", "canonical", "--", "--tools"])
        .arg(tools)
        .args(files)
        .output()
        .map_err(|error| error.to_string())?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let mut runs: Vec<Run> = Vec::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        if line.starts_with("= ") {
            runs.push(Run::default());
            continue;
        }
        let Some(run) = runs.last_mut() else { continue };
        if let Some(problem) = line.strip_prefix("! ") {
            run.refusal.get_or_insert(problem.to_owned());
            continue;
        }
        let Some(kind) = line.chars().next().filter(|kind| "TFAP".contains(*kind)) else {
            continue;
        };
        let values: Vec<f64> = line
            .split_whitespace()
            .skip(2)
            .filter_map(|word| word.parse().ok())
            .collect();
        let mut end = [0.0; 6];
        end.copy_from_slice(values.get(..6).ok_or("a short line")?);
        run.elements.push(Element {
            kind,
            end,
            feed: values[6],
            arc: values
                .get(7..12)
                .map(|arc| ([arc[0] as usize, arc[1] as usize], [arc[2], arc[3]], arc[4])),
            error: 0.0,
        });
    }
    Ok(runs)
}

/// Modes of `rs274` that its numbers depend on.
struct Modes {
    unit: f64,
    origin: [f64; 6],
    g92: [f64; 6],
    tool: [f64; 6],
    rotation: f64,
    plane: [usize; 3],
    feed: f64,
    feed_mode: f64,
}

impl Modes {
    fn machine(&self, values: &[f64]) -> [f64; 6] {
        let mut at = [0.0; 6];
        for (axis, place) in at.iter_mut().enumerate() {
            let scale = if axis < 3 { self.unit } else { 1.0 };
            *place = values.get(axis).copied().unwrap_or(0.0) * scale + self.g92[axis];
        }
        let (sin, cos) = self.rotation.to_radians().sin_cos();
        [at[0], at[1]] = [at[0] * cos - at[1] * sin, at[0] * sin + at[1] * cos];
        for (axis, place) in at.iter_mut().enumerate() {
            *place += self.origin[axis] + self.tool[axis];
        }
        at
    }

    fn lengths(&self, values: &[f64]) -> [f64; 6] {
        std::array::from_fn(|axis| {
            values.get(axis).copied().unwrap_or(0.0) * if axis < 3 { self.unit } else { 1.0 }
        })
    }
}

/// Interprets a file with `rs274`, in a folder of its own: it rewrites its parameter file.
fn run_theirs(rs274: &str, file: &Path, tools: &Path, folder: &Path) -> Result<Run, String> {
    let parameters = folder.join("parameters.var");
    write(&parameters, "")?;
    let output = Command::new("timeout")
        .arg("20")
        .arg(rs274)
        .arg("-g")
        .arg("-t")
        .arg(tools)
        .arg("-v")
        .arg(&parameters)
        .arg(file)
        .current_dir(file.parent().unwrap_or(folder))
        .env("HOME", folder)
        .output()
        .map_err(|error| format!("{rs274}: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    let mut run = Run::default();
    let mut modes = Modes {
        unit: 1.0,
        origin: [0.0; 6],
        g92: [0.0; 6],
        tool: [0.0; 6],
        rotation: 0.0,
        plane: [0, 1, 2],
        feed: 0.0,
        feed_mode: 0.0,
    };
    let mut ended = false;
    for line in text.lines() {
        ended |= line.contains("PROGRAM_END()");
        element(line, &mut modes, &mut run.elements);
    }
    if !output.status.success() || !ended {
        let message = errors
            .lines()
            .chain(text.lines().filter(|line| !line.contains(" N")))
            .rfind(|line| !line.trim().is_empty() && *line != "executing")
            .unwrap_or("no program end")
            .to_owned();
        if !output.status.success() {
            run.refusal = Some(message);
        }
    }
    Ok(run)
}

/// Reads a line of `rs274`.
fn element(line: &str, modes: &mut Modes, elements: &mut Vec<Element>) {
    let Some((head, rest)) = line.split_once('(') else {
        return;
    };
    let name = head.split_whitespace().next_back().unwrap_or("");
    // A block number of six digits touches the name: `N100100STRAIGHT_FEED`.
    let digit = |letter: char| letter.is_ascii_digit();
    let name = match name.strip_prefix('N') {
        Some(rest) if rest.starts_with(digit) => rest.trim_start_matches(digit),
        _ => name,
    };
    let inner = rest.trim_end().trim_end_matches(')');
    let values: Vec<f64> = inner
        .split([',', ' '])
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    let mut push = |kind, end, feed, arc, unit: f64| {
        elements.push(Element {
            kind,
            end,
            feed,
            arc,
            error: 1.5e-4 * unit.max(1.0),
        });
    };
    match name {
        "USE_LENGTH_UNITS" => {
            modes.unit = if inner.contains("INCH") { 25.4 } else { 1.0 };
        }
        "SET_G5X_OFFSET" => modes.origin = modes.lengths(values.get(1..).unwrap_or(&[])),
        "SET_G92_OFFSET" => modes.g92 = modes.lengths(&values),
        "USE_TOOL_LENGTH_OFFSET" => modes.tool = modes.lengths(&values),
        "SET_XY_ROTATION" => modes.rotation = values.first().copied().unwrap_or(0.0),
        "SELECT_PLANE" => {
            modes.plane = match inner {
                text if text.contains("XZ") => [2, 0, 1],
                text if text.contains("YZ") => [1, 2, 0],
                _ => [0, 1, 2],
            };
        }
        "SET_FEED_RATE" => modes.feed = values.first().copied().unwrap_or(0.0),
        "SET_FEED_MODE" => modes.feed_mode = values.last().copied().unwrap_or(0.0),
        "STRAIGHT_TRAVERSE" => push('T', modes.machine(&values), 0.0, None, modes.unit),
        "STRAIGHT_FEED" => {
            let feed = modes.feed * modes.unit;
            push('F', modes.machine(&values), feed, None, modes.unit);
        }
        "STRAIGHT_PROBE" => push('P', modes.machine(&values), 0.0, None, modes.unit),
        "NURBS_FEED" => push('N', [0.0; 6], 0.0, None, modes.unit),
        "ARC_FEED" if values.len() >= 6 => {
            let [first, second, normal] = modes.plane;
            let mut end = [0.0; 6];
            (end[first], end[second], end[normal]) = (values[0], values[1], values[5]);
            for (end, value) in end[3..].iter_mut().zip(values.iter().skip(6)) {
                *end = *value;
            }
            let mut centre = end;
            (centre[first], centre[second]) = (values[2], values[3]);
            let (end, centre) = (modes.machine(&end), modes.machine(&centre));
            let feed = modes.feed * modes.unit;
            let arc = ([first, second], [centre[first], centre[second]], values[4]);
            push('A', end, feed, Some(arc), modes.unit);
        }
        _ => {}
    }
}

/// Returns the first difference of two motions.
fn compare(ours: &[Element], theirs: &[Element]) -> Option<String> {
    let mut at = [0.0f64; 6];
    let mut index = 0;
    let mut after_spline = false;
    for (number, theirs) in theirs.iter().enumerate() {
        if theirs.kind == 'N' {
            // `rs274` prints no coordinates of a spline: its pieces are passed over.
            after_spline = true;
            continue;
        }
        let is_move = theirs.arc.is_some() || !near(&at, &theirs.end, 2.0 * theirs.error);
        if after_spline {
            while ours
                .get(index)
                .is_some_and(|ours| differs(ours, theirs).is_some())
            {
                index += 1;
            }
            after_spline = false;
        }
        if let Some(ours) = ours.get(index)
            && differs(ours, theirs).is_none()
        {
            at = theirs.end;
            index += 1;
            continue;
        }
        if !is_move {
            at = theirs.end;
            continue;
        }
        let text = match ours.get(index) {
            None => format!("move {number} of rs274 is missing: {theirs:?}"),
            Some(ours) => format!(
                "move {number}: {}; {ours:?} instead of {theirs:?}",
                differs(ours, theirs).unwrap_or_default()
            ),
        };
        return Some(text);
    }
    match ours.get(index) {
        Some(more) if !after_spline && !near(&at, &more.end, 1e-3) => {
            Some(format!("a move more than rs274: {more:?}"))
        }
        _ => None,
    }
}

fn near(a: &[f64; 6], b: &[f64; 6], tolerance: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}

/// Returns how two moves differ.
fn differs(ours: &Element, theirs: &Element) -> Option<String> {
    if ours.kind != theirs.kind {
        return Some("kind".into());
    }
    let error = 2.0 * theirs.error;
    if !near(&ours.end, &theirs.end, error) {
        return Some("end".into());
    }
    if let (Some(ours), Some(theirs)) = (&ours.arc, &theirs.arc) {
        if ours.0 != theirs.0 {
            return Some("plane".into());
        }
        let off = (0..2)
            .map(|k| (ours.1[k] - theirs.1[k]).abs())
            .fold(0.0, f64::max);
        // The centre of an arc by radius near half a turn is ill-conditioned.
        if off > 2.0 * error {
            return Some(format!("centre, by {off:.6} mm"));
        }
        let turns = (ours.2.abs() / std::f64::consts::TAU - 1e-6)
            .ceil()
            .max(1.0);
        if ours.2.signum() != theirs.2.signum() || (turns - theirs.2.abs()).abs() > 0.5 {
            return Some("turns".into());
        }
    }
    // `rs274` prints the feed with four decimals, in units of the program.
    let off = (ours.feed - theirs.feed).abs();
    if matches!(theirs.kind, 'F' | 'A') && off > 1e-3 + 1e-4 * theirs.feed {
        return Some(format!("feed, {} and {}", ours.feed, theirs.feed));
    }
    None
}
