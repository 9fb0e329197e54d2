//! The section `[compensation]`: error tables for the controller, from the text of an error file
//! (docs/volumetric.md).

use super::document::Section;
use super::scale::{PER_MM, to_i32};
use super::{MachineFile, Problems};
use haptimill_firmware::config::volumetric::{
    ERROR_AXES, ERROR_VALUES, ERRORS, ErrorAxis, VolumetricConfig,
};
use haptimill_firmware::config::{BACKLASH_NODES, JointSettings, PoseAxis};
use haptimill_machine_keys::controller::compensation as keys;
use haptimill_math::Coordinate;
use haptimill_volumetric::errors::{Approach, Axis, ErrorSet, Function, Shape, interpolate};
use haptimill_volumetric::file::{self, Limits, NOT_TO_COMPENSATE};

/// Largest number of nodes of an axis: all tables together have room for three such axes.
pub const MAX_NODES: usize = ERROR_VALUES / ERRORS / ERROR_AXES;

/// Chain of a machine file without a section `[compensation]`: a table that moves along y, and a
/// spindle along x, then z.
pub const CHAIN: &str = "wYbXZt";

/// Largest negative lost motion that counts as none, mm: the noise of an instrument.
const NO_LOST_MOTION: f64 = 0.001;

/// Difference between a function and its table in the controller that is never too large, mm, rad:
/// the noise of an instrument.
const SMALL_REST: [f64; 2] = [1e-4, 5e-7];

/// Largest such difference, as a part of the largest value of the function.
const LARGEST_REST: f64 = 0.5;

/// Reads the section. `pose` has the soft limits. Where a positioning error depends on the
/// direction, its joint in `joints` gets the difference as lost motion.
pub(super) fn read<'a>(
    section: &Section<'_, '_>,
    pose: &[PoseAxis],
    joints: impl IntoIterator<Item = &'a mut JointSettings>,
) -> Option<VolumetricConfig> {
    let chain = section.text("chain", "write the bodies from w to t, such as \"wYbXZt\"");
    let arms = chain.and_then(|chain| {
        let arms = arms(chain);
        if arms.is_none() {
            let what = format!("\"{chain}\" is no chain of w, X, Y, Z, b and t");
            section.report("chain", what, "write it from w to t, such as \"wYbXZt\"");
        }
        arms
    });
    let text = section.text("errors", "write the text of an error file");
    let points = [
        keys::x_measured_at_mm,
        keys::y_measured_at_mm,
        keys::z_measured_at_mm,
    ];
    let measured_at = points.map(|key| point(section, key.name));
    section.finish();
    let (arms, text) = (arms?, text?);
    let travel = travel(pose)?;
    let limits = Limits {
        travel: Some(travel),
        ..Limits::default()
    };
    let is_remainder = |line: &str| line.starts_with('#') && line.contains(NOT_TO_COMPENSATE);
    if text.lines().any(is_remainder) {
        section.report(
            "errors",
            "they were measured while the controller compensated: they are what remained",
            "measure again with --compensation off",
        );
        return None;
    }
    match file::read(text, &limits) {
        Ok(errors) => {
            if let Some(what) = too_fine(&errors, &travel) {
                let remedy = format!(
                    "smooth the function, or give at most {MAX_NODES} evenly spaced nodes over \
                     the travel to all functions of the axis"
                );
                section.report("errors", what, remedy);
            }
            add_lost_motion(section, &errors, joints);
            Some(config(&errors, &travel, arms, measured_at))
        }
        Err(problem) => {
            let place = match problem.line {
                0 => String::new(),
                line => format!("line {line} of the text: "),
            };
            section.report("errors", format!("{place}{}", problem.what), problem.remedy);
            None
        }
    }
}

/// Adds the differences between the directions of the positioning errors to the lost motion of the
/// joints: a tool that is behind by half the lost motion upwards is ahead by half of it downwards.
fn add_lost_motion<'a>(
    section: &Section<'_, '_>,
    errors: &ErrorSet,
    joints: impl IntoIterator<Item = &'a mut JointSettings>,
) {
    for (index, joint) in joints.into_iter().enumerate() {
        let of = joint
            .gantry
            .as_ref()
            .map_or(index, |gantry| usize::from(gantry.of));
        let Some(&axis) = Axis::ALL.get(of) else {
            continue;
        };
        let positioning = Function {
            moving: axis,
            direction: axis,
            rotates: false,
        };
        let Shape::Table(table) = errors.function(positioning) else {
            continue;
        };
        if table.down.is_none() || joint.wraps() {
            continue;
        }
        let mm = |place: Coordinate| f64::from(place.0) / PER_MM;
        let known: Vec<f64> = joint
            .backlash_table
            .iter()
            .map(|lost_motion| mm(*lost_motion))
            .collect();
        let (low, high) = (mm(joint.low), mm(joint.high));
        let place = |node: usize, count: usize| {
            low + (high - low) * node as f64 / (count.max(2) - 1) as f64
        };
        let places: Vec<f64> = (0..known.len())
            .map(|node| place(node, known.len()))
            .collect();
        let mut nodes = Vec::new();
        for node in 0..BACKLASH_NODES {
            let at = place(node, BACKLASH_NODES);
            let before = match known.is_empty() {
                true => mm(joint.backlash),
                false => interpolate(&places, &known, at),
            };
            let lost_motion =
                before + table.value(at, Approach::Down) - table.value(at, Approach::Up);
            if lost_motion < -NO_LOST_MOTION {
                let what = format!(
                    "{positioning} is {:.2} um larger upwards than downwards at {at:.1} mm: the lost \
                     motion would be negative",
                    -1e3 * (lost_motion - before)
                );
                section.report(
                    "errors",
                    what,
                    "lower the lost motion of the joint, or swap up and down",
                );
                return;
            }
            nodes.push(lost_motion.max(0.0));
        }
        let nodes = nodes
            .into_iter()
            .map(|lost_motion| Coordinate(to_i32(lost_motion * PER_MM)));
        joint.backlash_table = nodes.collect();
        let largest = joint.backlash_table.iter().max();
        joint.backlash = largest.copied().unwrap_or(joint.backlash);
    }
}

fn point(section: &Section<'_, '_>, key: &'static str) -> [f64; 3] {
    if section.has(key) {
        section.numbers(key, super::document::real(-1000.0, 1000.0, "mm"))
    } else {
        [0.0; 3]
    }
}

/// Soft limits of the first three coordinates, mm; `None` where there are fewer.
fn travel(pose: &[PoseAxis]) -> Option<[(f64, f64); ERROR_AXES]> {
    let limits = pose.iter().map(|axis| {
        let mm = |place: Coordinate| f64::from(place.0) / PER_MM;
        (mm(axis.low), mm(axis.high))
    });
    let limits: Vec<_> = limits.take(ERROR_AXES).collect();
    limits.try_into().ok()
}

/// Coordinates of the arm of each axis, one bit each: where the tool is, seen from its carriage. On
/// the side of the tool these are the axes between it and the tool, on the side of the workpiece
/// also the axis itself.
///
/// `None` where the text is no chain of w, X, Y, Z, b and t.
#[must_use]
pub fn arms(chain: &str) -> Option<[u8; ERROR_AXES]> {
    let letters: Vec<char> = chain
        .chars()
        .filter(|letter| !letter.is_whitespace())
        .collect();
    let bodies = letters.strip_prefix(&['w'])?.strip_suffix(&['t'])?;
    let base = bodies.iter().position(|body| *body == 'b')?;
    let place = |axis: Axis| bodies.iter().position(|body| *body == axis.letter());
    if bodies.len() != ERROR_AXES + 1 {
        return None;
    }
    let mut arms = [0; ERROR_AXES];
    for axis in Axis::ALL {
        let here = place(axis)?;
        for other in Axis::ALL {
            let there = place(other)?;
            let moves_tool = there > here || (there == here && here < base);
            arms[axis.index()] |= u8::from(moves_tool) << other.index();
        }
    }
    Some(arms)
}

/// Nodes of an axis: those of its tables, where all six share evenly spaced ones over the travel;
/// otherwise as many as there is room for.
fn nodes_of(errors: &ErrorSet, moving: Axis, (low, high): (f64, f64)) -> usize {
    let functions: Vec<Function> = Function::all()
        .filter(|function| function.moving == moving)
        .collect();
    let table = |function: Function| match errors.function(function) {
        Shape::Table(table) => Some(&table.nodes),
        Shape::ClosedForm(_) => None,
    };
    let shared = functions.first().copied().and_then(table);
    let even = shared.filter(|nodes| {
        let pitch = (high - low) / (nodes.len().max(2) - 1) as f64;
        let places = nodes.iter().enumerate();
        let even = places
            .into_iter()
            .all(|(index, node)| (node - low - pitch * index as f64).abs() < 1e-4);
        let same = functions
            .iter()
            .all(|function| table(*function) == Some(*nodes));
        even && same && (2..=MAX_NODES).contains(&nodes.len())
    });
    even.map_or(MAX_NODES, Vec::len)
}

/// Describes a function that changes between the nodes of the controller's tables, so that
/// compensation would leave more than half of it, or make it worse.
fn too_fine(errors: &ErrorSet, travel: &[(f64, f64); ERROR_AXES]) -> Option<String> {
    Function::all().find_map(|function| {
        let Shape::Table(table) = errors.function(function) else {
            return None;
        };
        let (low, high) = travel[function.moving.index()];
        let count = nodes_of(errors, function.moving, (low, high));
        let pitch = (high - low) / (count - 1) as f64;
        let places: Vec<f64> = (0..count).map(|node| low + pitch * node as f64).collect();
        let at_places = places.iter().map(|at| table.value(*at, Approach::Any));
        let values: Vec<f64> = at_places.collect();
        let inside = table.nodes.iter().filter(|at| (low..=high).contains(at));
        let (mut max, mut rest, mut place) = (0.0_f64, 0.0_f64, low);
        for at in inside {
            let value = table.value(*at, Approach::Any);
            let off = (value - interpolate(&places, &values, *at)).abs();
            max = max.max(value.abs());
            if off > rest {
                (rest, place) = (off, *at);
            }
        }
        let small = SMALL_REST[usize::from(function.rotates)];
        (rest > small.max(LARGEST_REST * max)).then(|| {
            let (rest, max) = (1e3 * rest, 1e3 * max);
            let (scale, unit) = if function.rotates {
                (1e3, "urad")
            } else {
                (1.0, "um")
            };
            format!(
                "{function} changes between the nodes of the controller, which are {pitch:.1} mm \
                 apart: at {place:.1} mm its table is off by {:.2} of {:.2} {unit}",
                scale * rest,
                scale * max
            )
        })
    })
}

fn config(
    errors: &ErrorSet,
    travel: &[(f64, f64); ERROR_AXES],
    arms: [u8; ERROR_AXES],
    measured_at: [[f64; 3]; ERROR_AXES],
) -> VolumetricConfig {
    let counts = Axis::ALL.map(|axis| nodes_of(errors, axis, travel[axis.index()]));
    let mut raw: Vec<f64> = Vec::new();
    let mut axes = Vec::new();
    for axis in Axis::ALL {
        let ((low, high), count) = (travel[axis.index()], counts[axis.index()]);
        let pitch = (high - low) / (count - 1) as f64;
        for node in 0..count {
            let at = low + pitch * node as f64;
            let functions = Function::all().filter(|function| function.moving == axis);
            // nm of mm, nrad of rad. A pair of directions counts with its mean here.
            raw.extend(functions.map(|function| {
                let unit = if function.rotates { 1e9 } else { 1e6 };
                errors.function(function).value(at, Approach::Any) * unit
            }));
        }
        // Rounded up: the last node must not fall short of the travel.
        let units = (pitch * PER_MM).ceil();
        axes.push(ErrorAxis {
            first: Coordinate(to_i32(low * PER_MM)),
            pitch: Coordinate(to_i32(units)),
            nodes: u8::try_from(count).unwrap_or(u8::MAX),
            arm: arms[axis.index()],
            measured_at: measured_at[axis.index()].map(|mm| Coordinate(to_i32(mm * PER_MM))),
        });
    }
    let largest = raw
        .iter()
        .fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let shift = (0..=5_u8).find(|shift| largest / f64::from(1_u32 << shift) <= 32767.0);
    let shift = shift.unwrap_or(5);
    let scale = f64::from(1_u32 << shift);
    VolumetricConfig {
        axes: axes
            .try_into()
            .unwrap_or_else(|_| core::array::from_fn(|_| no_axis())),
        values: raw
            .iter()
            .map(|value| (value / scale).round() as i16)
            .collect(),
        shift,
        squareness: errors.squareness.values().map(|angle| to_i32(angle * 1e9)),
    }
}

/// An axis that the controller refuses.
const fn no_axis() -> ErrorAxis {
    ErrorAxis {
        first: Coordinate(0),
        pitch: Coordinate(0),
        nodes: 0,
        arm: 0,
        measured_at: [Coordinate(0); ERROR_AXES],
    }
}

impl MachineFile {
    /// Returns the machine with these errors in its section `[compensation]`, which it gets if it
    /// has none; `chain` is then its chain. `name` is the name of the error file in messages.
    ///
    /// # Errors
    ///
    /// Returns the problems of the extended file.
    pub fn with_errors(&self, name: &str, errors: &str, chain: &str) -> Result<Self, Problems> {
        let file = format!("{} with {name}", self.file);
        let text = match self.text.parse::<toml_edit::DocumentMut>() {
            Ok(mut document) => {
                let section = document.entry("compensation").or_insert(toml_edit::table());
                if let Some(table) = section.as_table_like_mut() {
                    if !table.contains_key("chain") {
                        table.insert("chain", toml_edit::value(chain));
                    }
                    table.insert("errors", toml_edit::value(errors));
                }
                document.to_string()
            }
            // The text was read before, so this does not happen.
            Err(_) => self.text.clone(),
        };
        Self::parse(&file, &text)
    }
}

#[cfg(test)]
mod tests {
    use super::arms;

    /// Arms of the chains of common mills: bit 0 is x, bit 1 y, bit 2 z.
    #[test]
    fn arms_of_chains() {
        assert_eq!(arms("wYbXZt"), Some([0b100, 0b111, 0b000]));
        assert_eq!(arms("w X Y b Z t"), Some([0b111, 0b110, 0b000]));
        assert_eq!(arms("wbXYZt"), Some([0b110, 0b100, 0b000]));
        for wrong in ["", "wXYZt", "wXYbt", "wXXbZt", "XYbZ", "wXYbZQt"] {
            assert_eq!(arms(wrong), None, "{wrong}");
        }
    }
}
