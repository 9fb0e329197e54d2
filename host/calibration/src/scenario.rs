//! Measurement and compensation in one run: the machine has errors, the laser measures them, and
//! the controller compensates them. The results are the remaining errors of volume, test piece and
//! circle test.

use crate::ball_bar::{self, CircleResult, CircleTest};
use crate::calibrate::{Calibration, Plan, calibrate, carriage_errors};
use crate::comparison::{
    Comparison, Omission, SideTable, omissions, side_table, squareness, table_5_1,
};
use crate::cut::{Cmm, MPE_P, PROGRAM, mpe_e, surface};
use crate::drive::{Machine, SLOW};
use crate::statistics::SINGULAR;
use haptimill_client::Error;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::compensation::{CHAIN, MAX_NODES};
use haptimill_volumetric::Vector;
use haptimill_volumetric::chain::Model;
use haptimill_volumetric::errors::ErrorSet;
use haptimill_volumetric::file::{self, Limits};
use haptimill_volumetric::grid::{Grid, Sizes};
use haptimill_volumetric::part::{Features, HALF_SIDE, Row};
use nalgebra::{Matrix3x6, Matrix6, Vector6};
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The machine of the scenario, and its errors.
pub const MACHINE: &str = include_str!("../../../machines/vmc3.toml");

/// Name of [`MACHINE`] in messages.
pub const MACHINE_NAME: &str = "machines/vmc3.toml (built in)";

/// Nodes of exact tables along x, y and z: the most that the controller holds, so that its tables
/// are those of the file.
const NODES: [usize; 3] = [MAX_NODES; 3];

/// States of the worn machine.
pub const WORN: [&str; 3] = [
    "errors x 10, no compensation",
    "errors x 10, exact tables",
    "errors x 10, measured tables",
];

/// Feeds of the circle test, mm/s.
pub const FEEDS: [f64; 3] = [10.0, 30.0, 60.0];

/// Feed and waits between the points of the grid.
const GRID_FEED: f64 = 100.0;
const GRID_WAIT: f64 = 1.2;
const GRID_WINDOW: f64 = 0.3;

/// The tool at standstill over the grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Points, mm.
    pub points: Vec<Vector>,
    /// Errors of the tool at standstill, mm.
    pub errors: Vec<Vector>,
}

impl Volume {
    /// Sizes of the errors.
    #[must_use]
    pub fn sizes(&self) -> Sizes {
        Sizes::of(self.errors.iter().copied())
    }

    /// The error of a model over points.
    #[must_use]
    pub fn of(points: Vec<Vector>, error: impl Fn(Vector) -> Vector) -> Self {
        let errors = points.iter().map(|point| error(*point)).collect();
        Self { points, errors }
    }

    /// The errors less the best-fitting rigid translation and rotation of the whole workpiece,
    /// which the readings do not contain.
    #[must_use]
    pub fn without_motion(&self) -> Self {
        let pairs = || self.points.iter().zip(&self.errors);
        let mut matrix = Matrix6::zeros();
        let mut right = Vector6::zeros();
        for (point, error) in pairs() {
            let motion = motion(*point);
            matrix += motion.tr_mul(&motion);
            right += motion.tr_mul(error);
        }
        // Points on one line leave a rotation undetermined: the smallest motion is taken.
        let found = matrix.svd(true, true).solve(&right, SINGULAR);
        let found = found.unwrap_or_else(|_| Vector6::zeros());
        let rest = pairs().map(|(point, error)| error - motion(*point) * found);
        Self {
            points: self.points.clone(),
            errors: rest.collect(),
        }
    }
}

/// Effect of three translations, mm, and three rotations, 0.01 rad, on a point.
fn motion(point: Vector) -> Matrix3x6<f64> {
    let mut effect = Matrix3x6::identity();
    let turns = point.cross_matrix() * -0.01;
    effect.fixed_columns_mut::<3>(3).copy_from(&turns);
    effect
}

/// Extent of a run of the scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Extent {
    /// Points of the volume.
    pub grid: Grid,
    /// The calibration.
    pub plan: Plan,
    /// Feeds of the circle test, mm/s.
    pub feeds: Vec<f64>,
    /// Also measures a machine with errors ten times as large.
    pub worn: bool,
    /// Sides along x and along y from a measuring machine, mm, instead of those of the simulated
    /// one.
    pub sides: Option<[SideTable; 2]>,
}

impl Default for Extent {
    fn default() -> Self {
        Self {
            grid: Grid::part(),
            plan: Plan::default(),
            feeds: FEEDS.to_vec(),
            worn: true,
            sides: None,
        }
    }
}

impl Extent {
    /// Few points and targets, and fast circles.
    #[must_use]
    pub fn coarse() -> Self {
        let side = vec![-80.0, 0.0, 80.0];
        Self {
            grid: Grid {
                places: [side.clone(), side, vec![0.0, -38.0]],
            },
            plan: Plan {
                interval: 25.0,
                wait: 0.4,
                ..Plan::default()
            },
            feeds: vec![30.0, 45.0, 60.0],
            worn: true,
            sides: None,
        }
    }
}

/// Results with one state of the compensation.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Name of the state.
    pub name: &'static str,
    /// Errors over the volume.
    pub volume: Volume,
    /// The cut surface of the test piece.
    pub surface: Features<Vector>,
    /// Characteristics of the test piece, measured without noise and with the noise of the
    /// coordinate measuring machine.
    pub rows: Vec<[Row; 2]>,
    /// Circular deviation at standstill on the circle of the circle tests, mm.
    pub still: f64,
    /// The circle tests, with their feeds, mm/s.
    pub circles: Vec<(f64, CircleResult)>,
}

/// Result of the scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioResult {
    /// Without compensation, with exact tables, with measured ones.
    pub states: Vec<State>,
    /// Errors ten times as large, in the states of [`WORN`]; empty without the worn machine.
    pub worn: Vec<Volume>,
    /// Sides along x and along y, cut without compensation, by the measuring machine.
    pub sides: [SideTable; 2],
    /// Table 5.1 of the thesis: the sides cut without compensation, against the measured errors.
    pub comparison: Vec<Comparison>,
    /// The calibration.
    pub calibration: Calibration,
}

/// The errors in the text of an error file, which must span the travel of the machine; `name` is
/// the name of the file in messages.
///
/// # Errors
/// Problems of the file.
pub fn errors_of(machine: &MachineFile, name: &str, text: &str) -> Result<ErrorSet, Error> {
    let limits = Limits {
        travel: Some(travel(machine)),
        ..Limits::default()
    };
    file::read(text, &limits).map_err(|problem| Error::in_file(name, problem))
}

/// The machine of the scenario.
///
/// # Errors
/// Problems of the built-in file.
pub fn machine() -> Result<MachineFile, Error> {
    Ok(MachineFile::parse(MACHINE_NAME, MACHINE)?)
}

/// Its errors.
///
/// # Errors
/// Problems of the built-in file.
pub fn truth(machine: &MachineFile) -> Result<(String, ErrorSet), Error> {
    let plant = machine.plant()?;
    let text = carriage_errors(machine, &plant)?.0;
    let errors = file::read(text, &Limits::default())
        .map_err(|problem| Error::in_file(&machine.file, problem))?;
    Ok((text.to_string(), errors))
}

/// Travel of the first three coordinates, mm.
#[must_use]
pub fn travel(machine: &MachineFile) -> [(f64, f64); 3] {
    core::array::from_fn(|axis| {
        let limits = machine.pose.get(axis);
        limits.map_or((0.0, 0.0), |limits| (limits.low, limits.high))
    })
}

/// The machine with exact tables of its own errors.
///
/// # Errors
/// The controller refuses the tables.
pub fn with_exact_tables(machine: &MachineFile) -> Result<MachineFile, Error> {
    let (_, errors) = truth(machine)?;
    let tables = errors.tabulated(&travel(machine), NODES);
    let text = file::write(&tables, "exact tables");
    Ok(machine.with_errors("exact tables", &text, CHAIN)?)
}

/// The machine with errors that are `by` times as large.
///
/// # Errors
/// The errors cannot be read.
pub fn worn(machine: &MachineFile, by: f64) -> Result<MachineFile, Error> {
    let (_, errors) = truth(machine)?;
    let tables = errors.scaled(by).tabulated(&travel(machine), NODES);
    let scaled = file::write(&tables, "worn");
    with_truth(machine, "worn", &scaled)
}

/// The machine with these errors of its simulated carriages instead of its own; `name` is the name
/// of the error file in messages.
///
/// # Errors
/// The errors cannot be read, or the simulated machine has no carriages.
pub fn with_truth(machine: &MachineFile, name: &str, text: &str) -> Result<MachineFile, Error> {
    errors_of(machine, name, text)?;
    let (own, _) = truth(machine)?;
    let changed = machine.text.replace(own.trim_end(), text.trim_end());
    let file = format!("{} with the errors of {name}", machine.file);
    Ok(MachineFile::parse(&file, &changed)?)
}

/// Drives a machine over the grid.
///
/// # Errors
/// The run fails.
pub fn measure_volume(machine: &mut Machine, grid: &Grid) -> Result<Volume, Error> {
    let points = grid.points();
    let targets: Vec<[f64; 3]> = points
        .iter()
        .map(|point| [point.x, point.y, point.z])
        .collect();
    let stood = machine.visit(&targets, GRID_FEED, GRID_WAIT, GRID_WINDOW)?;
    let errors = stood.iter().zip(&points);
    let errors = errors
        .map(|(sample, point)| Vector::from_fn(|axis, _| sample.tool[axis] - point[axis]))
        .collect();
    Ok(Volume { points, errors })
}

/// Waits until the compensation of a machine with tables is in full effect.
fn ready(file: &MachineFile, interrupted: &Arc<AtomicBool>) -> Result<Machine, Error> {
    let mut machine = Machine::new(file, SLOW, interrupted)?;
    if file.config.volumetric.is_some() {
        machine.compensate(true)?;
    }
    Ok(machine)
}

fn measure_state(
    name: &'static str,
    machine: &mut Machine,
    extent: &Extent,
    progress: &mut dyn FnMut(&str),
) -> Result<State, Error> {
    let [x, y, z] = extent.grid.places.each_ref().map(Vec::len);
    progress(&format!("{name}: grid of {x} x {y} x {z} points"));
    let volume = measure_volume(machine, &extent.grid)?;
    progress(&format!("{name}: test piece"));
    let samples = machine.run("a160.ngc", PROGRAM)?;
    let cut = surface(&samples)?;
    let exact = Cmm::ideal().measure(&cut)?;
    let rows = exact.into_iter().zip(Cmm::default().measure(&cut)?);
    let rows = rows.map(<[Row; 2]>::from).collect();
    progress(&format!("{name}: circle tests"));
    let still = ball_bar::at_standstill(machine, &CircleTest::at(GRID_FEED))?;
    let mut circles = Vec::new();
    for feed in &extent.feeds {
        circles.push((*feed, ball_bar::run(machine, &CircleTest::at(*feed))?));
    }
    Ok(State {
        name,
        volume,
        surface: cut,
        rows,
        still,
        circles,
    })
}

/// Runs the scenario on a machine.
///
/// # Errors
/// A run fails.
pub fn run(
    file: &MachineFile,
    extent: &Extent,
    interrupted: &Arc<AtomicBool>,
    progress: &mut dyn FnMut(&str),
) -> Result<ScenarioResult, Error> {
    let mut machine = ready(file, interrupted)?;
    let before = measure_state("no compensation", &mut machine, extent, progress)?;
    progress("calibration");
    let calibration = calibrate(&mut machine, file, &extent.plan, |line| progress(line))?;
    let mut machine = ready(&with_exact_tables(file)?, interrupted)?;
    let exact = measure_state("exact tables", &mut machine, extent, progress)?;
    let text = file::write(&calibration.errors, "measured");
    let mut machine = ready(
        &file.with_errors("measured errors", &text, CHAIN)?,
        interrupted,
    )?;
    let measured = measure_state("measured tables", &mut machine, extent, progress)?;
    let worn = if extent.worn {
        measure_worn(&worn(file, 10.0)?, extent, interrupted, progress)?
    } else {
        Vec::new()
    };
    let sides = extent.sides.clone().unwrap_or_else(|| {
        let runs = Cmm::default().probe(&before.surface);
        [0, 3].map(|side| side_table(&runs, side))
    });
    Ok(ScenarioResult {
        comparison: table_5_1(&calibration.errors, &sides),
        sides,
        states: vec![before, exact, measured],
        worn,
        calibration,
    })
}

/// The volume of a worn machine: without compensation, with exact tables, with measured ones.
fn measure_worn(
    file: &MachineFile,
    extent: &Extent,
    interrupted: &Arc<AtomicBool>,
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Volume>, Error> {
    progress("worn machine: grid");
    let grid = &extent.grid;
    let mut machine = ready(file, interrupted)?;
    let before = measure_volume(&mut machine, grid)?;
    progress("worn machine: calibration");
    let calibration = calibrate(&mut machine, file, &extent.plan, |line| progress(line))?;
    progress("worn machine: grid with exact and with measured tables");
    let exact = measure_volume(&mut ready(&with_exact_tables(file)?, interrupted)?, grid)?;
    let text = file::write(&calibration.errors, "measured");
    let measured = file.with_errors("measured errors", &text, CHAIN)?;
    let measured = measure_volume(&mut ready(&measured, interrupted)?, grid)?;
    Ok(vec![before, exact, measured])
}

/// The numbers of the scenario as text.
#[must_use]
pub fn table(outcome: &ScenarioResult) -> String {
    let mut text = String::from("volumetric error at standstill, um        largest      rms\n");
    // Writing to a string does not fail.
    let mut row = |name: &str, sizes: Sizes| {
        let (largest, rms) = (sizes.largest * 1e3, sizes.rms * 1e3);
        let _ = writeln!(text, "{name:<40} {largest:>8.3} {rms:>8.3}");
    };
    for state in &outcome.states {
        row(state.name, state.volume.sizes());
    }
    let without_motion = "  without the best-fitting rigid motion";
    if let Some(measured) = outcome.states.last() {
        row(without_motion, measured.volume.without_motion().sizes());
    }
    for (name, volume) in WORN.iter().zip(&outcome.worn) {
        row(name, volume.sizes());
    }
    if let Some(measured) = outcome.worn.last() {
        row(without_motion, measured.without_motion().sizes());
    }
    let _ = write!(text, "\n{:<48}", "test piece, um");
    for state in &outcome.states {
        let _ = write!(text, " {:>16}", state.name);
    }
    let rows = outcome.states.first().map_or(0, |state| state.rows.len());
    for index in 0..rows {
        let name = &outcome.states[0].rows[index][0].name;
        let _ = write!(text, "\n{name:<48}");
        for state in &outcome.states {
            let row = &state.rows[index][0];
            let um = row.value * 1e3;
            let mark = match (row.passes(), row.value.abs() < MPE_P) {
                (false, _) => "!",
                (true, true) => "*",
                (true, false) => " ",
            };
            let _ = write!(text, " {um:>15.3}{mark}");
        }
    }
    let _ = writeln!(
        text,
        "\n* below MPE_P = {:.1} um of the measuring machine, whose MPE_E is {:.2} um over the \
         square; ! beyond the tolerance\n\n\
         {:<40} feed    G ccw     G cw        H                F",
        MPE_P * 1e3,
        mpe_e(2.0 * HALF_SIDE) * 1e3,
        "circle test, um; feed 0 is standstill"
    );
    for state in &outcome.states {
        let (name, still) = (state.name, state.still * 1e3);
        let _ = writeln!(text, "{name:<40}    0 {still:>8.2}");
        for (feed, circle) in &state.circles {
            let [ccw, cw] = circle.deviation.map(|value| value * 1e3);
            let hysteresis = circle.hysteresis * 1e3;
            let [max, min] = circle.radial.map(|value| value * 1e3);
            let _ = writeln!(
                text,
                "{name:<40} {feed:>4} {ccw:>8.2} {cw:>8.2} {hysteresis:>8.2} {min:>8.2} to \
                 {max:.2}"
            );
        }
    }
    text.push_str("\nsides before compensation, measured errors against the part (table 5.1)\n");
    for line in &outcome.comparison {
        let _ = writeln!(text, "{line}");
    }
    let square = squareness(&outcome.sides) * 1e6;
    let _ = writeln!(text, "squareness of the two sides {square:.1} urad\n");
    text + &omission_table(outcome)
}

impl ScenarioResult {
    /// Straightness of the sides by the measured errors, with a kind of them left out in turn.
    #[must_use]
    pub fn omissions(&self) -> Vec<Omission> {
        omissions(&self.calibration.errors, Model::default())
    }
}

/// Omission of errors as text.
#[must_use]
pub fn omission_table(outcome: &ScenarioResult) -> String {
    let mut text = format!(
        "{:<48} {:>8} {:>8}\n",
        "straightness by the measured errors, um", "X", "Y"
    );
    for line in outcome.omissions() {
        let [x, y] = line.straightness.map(|value| value * 1e3);
        // Writing to a string does not fail.
        let _ = writeln!(text, "{:<48} {x:>8.3} {y:>8.3}", line.name);
    }
    text
}

/// The numbers of the scenario as JSON, um and urad.
#[must_use]
pub fn summary(outcome: &ScenarioResult) -> String {
    let sizes = |volume: &Volume| {
        let (sizes, rest) = (volume.sizes(), volume.without_motion().sizes());
        serde_json::json!({
            "largest_um": sizes.largest * 1e3,
            "rms_um": sizes.rms * 1e3,
            "largest_without_motion_um": rest.largest * 1e3,
        })
    };
    let states: Vec<_> = outcome
        .states
        .iter()
        .map(|state| {
            let rows: Vec<_> = state
                .rows
                .iter()
                .map(|[exact, read]| {
                    serde_json::json!({
                        "name": exact.name,
                        "value_um": exact.value * 1e3,
                        "measured_um": read.value * 1e3,
                        "tolerance_um": exact.tolerance.map(|tolerance| tolerance * 1e3),
                        "passes": exact.passes(),
                        "measurable": exact.value.abs() >= MPE_P,
                    })
                })
                .collect();
            let circles: Vec<_> = state
                .circles
                .iter()
                .map(|(feed, circle)| {
                    serde_json::json!({
                        "feed_mm_s": feed,
                        "deviation_um": circle.deviation.map(|value| value * 1e3),
                        "hysteresis_um": circle.hysteresis * 1e3,
                        "radial_um": circle.radial.map(|value| value * 1e3),
                        "squareness_urad": circle.squareness * 1e6,
                    })
                })
                .collect();
            serde_json::json!({
                "name": state.name,
                "volume": sizes(&state.volume),
                "test_piece": rows,
                "circle_at_standstill_um": state.still * 1e3,
                "circles": circles,
            })
        })
        .collect();
    let all = serde_json::json!({
        "states": states,
        "comparison": outcome.comparison.iter().map(|line| serde_json::json!({
            "side": line.side,
            "r_squared": line.r_squared,
            "class": line.class,
            "t": line.t,
            "p": line.p,
            "rmse_um": line.rmse * 1e3,
            "slope": line.slope,
            "straightness_um": line.straightness * 1e3,
            "measurable": line.is_measurable(),
        })).collect::<Vec<_>>(),
        "omission": outcome.omissions().iter().map(|line| serde_json::json!({
            "name": line.name,
            "straightness_um": line.straightness.map(|value| value * 1e3),
        })).collect::<Vec<_>>(),
        "squareness_of_sides_urad": squareness(&outcome.sides) * 1e6,
        "worn": outcome.worn.iter().map(sizes).collect::<Vec<_>>(),
    });
    format!("{all:#}\n")
}
