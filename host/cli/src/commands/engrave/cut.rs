//! Cuts the plate on the simulated machine.

use super::super::{CliError, Exit, output, run};
use super::args::EngraveArgs;
use clap::Parser;
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::plate::{Plate, PlateReport};
use haptimill_engrave::preview::area;
use haptimill_engrave::toolpath::Tab;
use haptimill_machine_file::MachineFile;
use haptimill_trace::{Recording, flag};
use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Distance of the points of the compared surface, as a part of the tool's diameter.
const CELL: f64 = 1.0 / 20.0;

/// Deviation of the tool from its commanded position at standstill above which steps are lost, mm.
/// A lost electrical turn is ten steps of the engraver: 0.05 mm in x and y.
const LOST_MM: f64 = 0.008;

/// The same on the way: away from the reference the geometry of a machine adds to it.
const LOST_ON_THE_WAY_MM: f64 = 0.02;

/// Control periods without a new commanded position after which an axis is at standstill.
const STANDSTILL: u32 = 500;

/// Thickness of the plate below the floor of the cut, mm.
const BELOW: f64 = 2.0;

/// The plate after the run.
pub(super) struct Cut {
    /// Its surface against the drawing.
    pub(super) surface: PlateReport,
    /// True minus commanded position of the tool at the end, mm.
    pub(super) off_mm: [f64; 3],
    /// The first standstill above the plate where steps are lost: line of the program, and true
    /// minus commanded position there, mm. Steps that are lost to and fro cancel out at the end.
    pub(super) lost_at: Option<(u32, [f64; 3])>,
}

/// Standstill of the axes above the plate.
#[derive(Default)]
struct Standstill {
    commanded: [f64; 3],
    /// Periods without motion, by axis.
    periods: [u32; 3],
    lost_at: Option<(u32, [f64; 3])>,
}

impl Standstill {
    /// Takes the next period: true and commanded position, mm, and line of the program.
    fn add(&mut self, at: [f64; 3], commanded: [f64; 3], line: u32) {
        for ((count, new), old) in self.periods.iter_mut().zip(commanded).zip(self.commanded) {
            *count = if new == old { *count + 1 } else { 0 };
        }
        self.commanded = commanded;
        // Cutting forces bend the machine.
        if self.lost_at.is_some() || at[2] <= 0.0 {
            return;
        }
        let off = std::array::from_fn(|axis| at[axis] - commanded[axis]);
        if (0..3)
            .any(|axis| self.periods[axis] >= STANDSTILL && off[axis].abs() > LOST_ON_THE_WAY_MM)
        {
            self.lost_at = Some((line, off));
        }
    }
}

impl Cut {
    /// Whether the machine is not where its controller takes it to be.
    pub(super) fn lost_steps(&self) -> bool {
        self.lost_at.is_some() || self.off_mm.iter().any(|off| off.abs() > LOST_MM)
    }

    /// What of the surface is not as the drawing asks, if the comparison resolves it.
    pub(super) fn differs(&self) -> Option<String> {
        let PlateReport {
            uncut_mm2,
            over_cut_mm2,
            largest_patch_mm2,
            ..
        } = self.surface;
        self.surface.differs().then(|| {
            format!(
                "the surface is not that of the drawing: {uncut_mm2:.2} mm2 uncut, \
                 {over_cut_mm2:.2} mm2 over-cut, the largest patch {largest_patch_mm2:.2} mm2; see \
                 the notices of the job and the --preview"
            )
        })
    }

    /// What ends the command with a fault.
    pub(super) fn wrong(&self) -> Option<String> {
        let lost = self.lost_steps().then(|| self.lost());
        lost.or_else(|| self.differs())
    }

    /// Describes it.
    pub(super) fn lost(&self) -> String {
        let [x, y, z] = self.off_mm;
        let at = format!("at the end the tool is {x:.4}, {y:.4}, {z:.4} mm off");
        if self.lost_steps() {
            let first = self.lost_at.map(|(line, [x, y, z])| {
                format!("first seen in line {line}, {x:.4}, {y:.4}, {z:.4} mm off; ")
            });
            format!(
                "lost: {}{at}; lower the feed or the acceleration, or take less depth at once",
                first.unwrap_or_default()
            )
        } else {
            format!("none lost: {at}")
        }
    }
}

/// The arguments of `haptimill run`, as that command reads them.
#[derive(Debug, Parser)]
struct RunLine {
    #[command(flatten)]
    args: run::RunArgs,
}

/// Runs the part program on the simulated machine with a plate on its table, and cuts a plate along
/// the true path of the tool. The job leaves `tabs`.
///
/// # Errors
/// See [`Exit`].
pub(super) fn cut(
    args: &EngraveArgs,
    machine: &MachineFile,
    drawing: &Drawing,
    tabs: &[Tab],
) -> Result<Cut, CliError> {
    let program = args.out();
    let mut folder = program.clone();
    folder.set_extension("out");
    let write = |name: &str, text: String| -> Result<PathBuf, CliError> {
        let path = folder.join(name);
        std::fs::create_dir_all(&folder).map_err(|error| output::write_error(&folder, error))?;
        output::save(&path, text)?;
        Ok(path)
    };
    let machine_path = write("machine.toml", with_tool(&machine.text, args.tool))?;
    let stock_path = write("stock.toml", stock(args, drawing))?;
    let words: [OsString; 9] = [
        "run".into(),
        program.into(),
        "--machine".into(),
        machine_path.into(),
        "--stock".into(),
        stock_path.into(),
        "--out".into(),
        folder.clone().into(),
        "--quiet".into(),
    ];
    let mut line =
        RunLine::try_parse_from(words).map_err(|error| CliError::new(Exit::Internal, error))?;
    line.args.silent = args.json;
    run::run(line.args)?;
    measure(
        args,
        drawing,
        tabs,
        &folder.join(haptimill_report::RECORDING_FILE),
    )
}

/// The machine file with the radius of the job's tool.
fn with_tool(text: &str, tool_mm: f64) -> String {
    let mut section = "";
    let mut out = String::with_capacity(text.len() + 16);
    for line in text.lines() {
        if line.starts_with('[') {
            section = line.trim_end();
        }
        if section == "[plant.cutter]" && line.starts_with("radius_mm") {
            let _ = writeln!(out, "radius_mm = {:?}", tool_mm / 2.0);
        } else {
            out.push_str(line);
            out.push('\n');
        }
    }
    out
}

/// The stock file of the plate.
fn stock(args: &EngraveArgs, drawing: &Drawing) -> String {
    let [low, high] = area(drawing, &args.options());
    // The simulator's map costs time; the forces need no finer one.
    let cell = (args.tool / 10.0).max((high[0] - low[0]).max(high[1] - low[1]) / 1000.0);
    let span = |axis: usize| ((high[axis] - low[axis]) / cell).ceil() * cell;
    let (x, y) = (low[0] + span(0), low[1] + span(1));
    let area = format!(
        "{{ x_min = {:?}, x_max = {x:?}, y_min = {:?}, y_max = {y:?} }}",
        low[0], low[1]
    );
    format!(
        "top_mm = 0.0\nbottom_mm = {:?}\nstock = {area}\nmap = {area}\ncell_mm = {cell:?}\n",
        -args.depth - BELOW
    )
}

/// Cuts a plate along the recorded true path of the tool and compares it with the drawing.
fn measure(
    args: &EngraveArgs,
    drawing: &Drawing,
    tabs: &[Tab],
    path: &Path,
) -> Result<Cut, CliError> {
    let failed = |error: &dyn std::fmt::Display| {
        CliError::new(Exit::Internal, format!("{}: {error}", path.display()))
    };
    let recording = Recording::open(path).map_err(|error| failed(&error))?;
    let units = recording.pose_units();
    let options = args.options();
    let mut plate = Plate::new(area(drawing, &options), args.tool * CELL);
    let step = args.tool * CELL / 4.0;
    let mut last: Option<[f64; 3]> = None;
    let mut off_mm = [0.0; 3];
    let mut standstill = Standstill::default();
    for record in recording.iter().map_err(|error| failed(&error))? {
        let record = record.map_err(|error| failed(&error))?;
        if !record.has(flag::TOOL_TRUE) {
            continue;
        }
        let at: [f64; 3] = std::array::from_fn(|axis| f64::from(record.tool[axis]) * units[axis]);
        let commanded = std::array::from_fn(|axis| f64::from(record.commanded[axis]) * units[axis]);
        off_mm = std::array::from_fn(|axis| at[axis] - commanded[axis]);
        standstill.add(at, commanded, record.line);
        match last {
            Some(from) => {
                let moved = (0..3)
                    .map(|axis| (at[axis] - from[axis]).powi(2))
                    .sum::<f64>()
                    .sqrt();
                if moved < step && (at[2] - from[2]).abs() < 1e-4 {
                    continue;
                }
                plate.sweep(args.tool / 2.0, from, at);
            }
            None => plate.sweep(args.tool / 2.0, at, at),
        }
        last = Some(at);
    }
    Ok(Cut {
        surface: plate.compare(drawing, &options, tabs),
        off_mm,
        lost_at: standstill.lost_at,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Periods at standstill above the plate with a true position.
    fn stand(standstill: &mut Standstill, periods: u32, at: [f64; 3], line: u32) {
        for _ in 0..periods {
            standstill.add(at, [10.0, 20.0, 1.0], line);
        }
    }

    #[test]
    fn steps_that_are_lost_to_and_fro_are_seen_between() {
        let mut seen = Standstill::default();
        stand(&mut seen, 600, [10.002, 19.998, 1.001], 1);
        // Lag in motion, bending in the cut, and a short halt are no loss.
        for k in 0..600 {
            seen.add(
                [f64::from(k), 20.05, 1.0],
                [f64::from(k) + 0.05, 20.05, 1.0],
                2,
            );
            seen.add([10.05, 20.05, -0.5], [10.0, 20.0, -0.5], 3);
        }
        stand(&mut seen, 499, [10.05, 20.0, 1.0], 4);
        seen.add([10.05, 20.0, 1.0], [10.1, 20.1, 1.1], 5);
        assert_eq!(seen.lost_at, None);
        stand(&mut seen, 600, [10.05, 20.0, 1.0], 6);
        stand(&mut seen, 600, [10.0, 20.0, 1.0], 7);
        let (line, off) = seen.lost_at.unwrap();
        assert!(line == 6 && (off[0] - 0.05).abs() < 1e-9, "{line} {off:?}");
    }

    /// A patch that the grid resolves is a fault, some cells at corners are not. Lost steps come
    /// first.
    #[test]
    fn a_surface_with_a_wrong_patch_is_a_fault() {
        let cut = |uncut_mm2, largest_patch_mm2, off| Cut {
            surface: PlateReport {
                cell_mm: 0.05,
                uncut_mm2,
                largest_patch_mm2,
                ..PlateReport::default()
            },
            off_mm: [off, 0.0, 0.0],
            lost_at: None,
        };
        assert_eq!(cut(0.5, 0.01, 0.0).wrong(), None);
        let text = cut(0.5, 0.3, 0.0).wrong().unwrap();
        assert!(text.contains("0.50 mm2 uncut"), "{text}");
        assert!(cut(0.5, 0.3, 0.1).wrong().unwrap().contains("lost"));
    }
}
