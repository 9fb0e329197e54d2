//! The statements of the thesis on the faceting machine, repeated: a table of stated and found
//! results, and a stone that the thesis does not cut.
//!
//! The equations, tables and sections are numbered as in the thesis. Its printed equations (4.5)
//! and (4.9) to (4.13) have mistakes (docs/control.md 2.9); the rows show their effect.

use crate::calibrate::{Reading, calibrate};
use crate::gem::Gem;
use crate::job::{Job, JobSettings, Mode};
use crate::reach::index_wraps;
use crate::run::{Cutting, RunOptions, cut};
use core::f64::consts::PI;
use haptimill_client::{Error, ErrorKind};
use haptimill_kinematics::facet::FacetGeometry;
use haptimill_kinematics::facet::chain::{Chain, ChainJoints, ChainPose};
use haptimill_machine_file::MachineFile;
use haptimill_math::{Angle, Coordinate, Length};
use serde::{Deserialize, Serialize};

/// A statement beside what is found here.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Equation or section of the thesis.
    pub section: &'static str,
    /// What is compared.
    pub what: String,
    /// As the thesis prints it, or the aim where it states nothing.
    pub stated: String,
    /// As found here.
    pub ours: String,
    /// Whether both agree.
    pub agrees: bool,
    /// Why not, or where the stated value is from.
    pub reason: &'static str,
}

/// A square stone of 13 facets, the unit is that of GemCad.
pub const SMALL: &str = "GemCad 5.0\ng 64 0.0\ny 4 y\nI 1.54\nH Square of 13 facets\n\
a -90 1.0 0 n G 16 32 48\na -45 0.72 0 n P 16 32 48\n\
a 40 0.70 0 n C 16 32 48\na 0 0.3 0 n T\n";

/// Width of that stone, mm.
pub const SMALL_MM: f64 = 2.5;

/// Numbers of the thesis: `data/thesis.toml`, which also has the source of each.
#[derive(Deserialize)]
struct Stated {
    lengths: [Lengths; 2],
    positions: Positions,
}

/// Lengths of the arm in one reading of their unit.
#[derive(Deserialize)]
struct Lengths {
    name: String,
    l2_l3_l4_mm: [f64; 3],
}

/// Rows of the table of positions.
#[derive(Deserialize)]
struct Positions {
    row_4: Position,
    row_7: Position,
}

#[derive(Deserialize)]
struct Position {
    /// d1 in mm, theta2 and theta3 in degrees.
    joints: [f64; 3],
}

impl Position {
    /// d1 in mm, theta2 and theta3 in radians.
    fn radians(&self) -> [f64; 3] {
        let [d1, theta2, theta3] = self.joints;
        [d1, theta2.to_radians(), theta3.to_radians()]
    }
}

impl Stated {
    fn read() -> Result<Self, Error> {
        toml::from_str(include_str!("../data/thesis.toml")).map_err(|error| {
            let what = format!("host/facet/data/thesis.toml: {error}");
            Error::new(ErrorKind::Internal, what)
        })
    }
}

/// Steps of a turn in the grid of poses: an odd number, so that no pose is at a quarter turn.
const GRID: i32 = 101;

fn chain([l2, l3, l4]: [f64; 3]) -> Chain {
    let length = |mm: f64| Length((mm * f64::from(1 << 20)).round() as i32);
    Chain::new(&FacetGeometry {
        l2: length(l2),
        l3: length(l3),
        l4: length(l4),
        ..FacetGeometry::default()
    })
}

fn joints(d1_mm: f64, theta2: f64, theta3: f64) -> ChainJoints {
    let angle = |radians: f64| {
        let turns = radians / (2.0 * PI);
        Angle(((turns - turns.round()) * 4_294_967_296.0).round() as i64 as i32)
    };
    ChainJoints {
        d1: Coordinate((d1_mm * f64::from(1 << 20)).round() as i32),
        theta2: angle(theta2),
        theta3: angle(theta3),
    }
}

fn numbers(frame: &ChainPose) -> ([[f64; 3]; 3], [f64; 3]) {
    let rotation = frame
        .rotation
        .map(|row| row.map(|entry| f64::from(entry) / f64::from(1 << 30)));
    let position = frame
        .position
        .map(|at| f64::from(at.0) / f64::from(1 << 20));
    (rotation, position)
}

fn determinant(m: &[[f64; 3]; 3]) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
}

/// Joints of a frame by (4.9), (4.12) and (4.13) as printed: d1 in mm, angles in radians.
fn printed_inverse(frame: &ChainPose, [_, l3, l4]: [f64; 3]) -> [f64; 3] {
    let (r, p) = numbers(frame);
    let theta2 = (r[0][2] / r[2][2]).atan();
    let theta3 = (r[1][0] / r[1][1]).atan();
    let d1 = p[2] + l3 * theta2.sin() - l4 * theta2.cos();
    [d1, theta2, theta3]
}

/// Whether joints are found within 1 um and 10 urad.
fn is_found(found: [f64; 3], at: [f64; 3]) -> bool {
    let turn = |k: usize| {
        let off = (found[k] - at[k]) / (2.0 * PI);
        2.0 * PI * (off - off.round()).abs()
    };
    (found[0] - at[0]).abs() < 1e-3 && turn(1) < 1e-5 && turn(2) < 1e-5
}

fn our_inverse(chain: &Chain, frame: &ChainPose) -> Option<[f64; 3]> {
    let found = chain.inverse(frame).ok()?;
    let radians = |angle: Angle| f64::from(angle.0) / 4_294_967_296.0 * 2.0 * PI;
    Some([
        f64::from(found.d1.0) / f64::from(1 << 20),
        radians(found.theta2),
        radians(found.theta3),
    ])
}

fn lost(what: &str) -> Error {
    Error::new(ErrorKind::Internal, format!("the chain has no {what}"))
}

/// Rows of the kinematics.
///
/// # Errors
/// A frame of the chain cannot be computed, or the built-in numbers of the thesis are wrong;
/// neither is known.
pub fn kinematics() -> Result<Vec<Row>, Error> {
    let mut rows = Vec::new();
    let stated = Stated::read()?;
    let printed = stated.lengths[0].l2_l3_l4_mm;
    let frame = |chain: &Chain, at: &ChainJoints| chain.forward(at).map_err(|_| lost("frame"));

    let [d1, theta2, theta3] = stated.positions.row_4.radians();
    let at = joints(d1, theta2, theta3);
    let right = numbers(&frame(&chain(printed), &at)?).0;
    let mut wrong = right;
    wrong[1] = wrong[1].map(|entry| -entry);
    rows.push(Row {
        section: "4.5",
        what: "determinant of the rotation at theta2 45, theta3 60 deg".into(),
        stated: format!("{:+.6}", determinant(&wrong)),
        ours: format!("{:+.6}", determinant(&right)),
        agrees: false,
        reason: "the signs of r21 and r22 are printed wrong: the product of (4.1) to (4.4) has \
                 sin theta3 and cos theta3",
    });
    for read in &stated.lengths {
        let (name, lengths) = (&read.name, read.l2_l3_l4_mm);
        let chain = chain(lengths);
        let (mut all, mut theirs, mut ours) = (0_u32, 0_u32, 0_u32);
        let angle = |k: i32| PI * (2.0 * f64::from(k) / f64::from(GRID) - 1.0);
        for (i, j) in (0..GRID).flat_map(|i| (0..GRID).map(move |j| (i, j))) {
            let at = [25.0, angle(i), angle(j)];
            let frame = frame(&chain, &joints(at[0], at[1], at[2]))?;
            all += 1;
            theirs += u32::from(is_found(printed_inverse(&frame, lengths), at));
            ours += u32::from(our_inverse(&chain, &frame).is_some_and(|it| is_found(it, at)));
        }
        let part = |count: u32| format!("{:.1} %", 100.0 * f64::from(count) / f64::from(all));
        rows.push(Row {
            section: "4.9-13",
            what: format!("poses whose joints are found, lengths {name}"),
            stated: part(theirs),
            ours: part(ours),
            agrees: theirs == ours,
            reason: "the printed arc tangents of one argument know half a turn; here both angles \
                     are those of two arguments",
        });
    }
    let at = stated.positions.row_7.radians();
    let frame_7 = frame(&chain(printed), &joints(at[0], at[1], at[2]))?;
    let theirs = printed_inverse(&frame_7, printed);
    let ours = our_inverse(&chain(printed), &frame_7).ok_or_else(|| lost("joints"))?;
    let text = |at: [f64; 3]| {
        let [theta2, theta3] = [at[1].to_degrees(), at[2].to_degrees()];
        format!("{:.4} mm, {theta2:.3}, {theta3:.3} deg", at[0])
    };
    rows.push(Row {
        section: "4.13",
        what: format!("joints of the frame at {}", text(at)),
        stated: text(theirs),
        ours: text(ours),
        agrees: is_found(theirs, ours),
        reason: "as above",
    });
    for read in &stated.lengths {
        let (name, lengths) = (&read.name, read.l2_l3_l4_mm);
        let chain = chain(lengths);
        let mut readings = [Reading { x: 0.0, z: None }; 3];
        for (k, reading) in readings.iter_mut().enumerate() {
            let theta2 = 0.5 * PI * k as f64;
            let (_, p) = numbers(&frame(&chain, &joints(100.0, theta2, 0.0))?);
            *reading = Reading {
                x: p[0],
                z: Some(p[2] - 100.0),
            };
        }
        let found = calibrate(readings[0], readings[1], readings[2]);
        let text = |values: [f64; 3]| values.map(|mm| format!("{mm:.3}")).join(" / ");
        let (stated, ours) = (text(lengths), text([found.l2, found.l3, found.l4]));
        rows.push(Row {
            section: "4.2",
            what: format!("L2 / L3 / L4 from three readings of the tip, lengths {name}"),
            agrees: stated == ours,
            stated,
            ours,
            reason: "the unit of L3 and L4 is not certain; three readings decide it",
        });
    }
    Ok(rows)
}

/// Rows of a stone that is cut by feed or by force, of which the thesis has none.
fn cutting(name: &str, cutting: &Cutting) -> Vec<Row> {
    const NOTHING: &str = "the thesis cuts no stone: the aim is that of docs/faceting.md";
    let measured = &cutting.measured;
    let row = |what: &str, aim: f64, unit: &str, found: f64| Row {
        section: "-",
        what: format!("{what}, square of 13 facets cut by {name}"),
        stated: format!("at most {aim} {unit}"),
        ours: format!("{found:.4} {unit}"),
        agrees: found <= aim,
        reason: NOTHING,
    };
    let faces = measured.missing.len() + measured.strange;
    vec![
        row(
            "largest error of a facet's normal",
            0.02,
            "deg",
            measured.worst_angle_deg(),
        ),
        row(
            "largest error of a meet point",
            0.02,
            "mm",
            measured.worst_meet_mm(),
        ),
        Row {
            section: "-",
            what: format!("facets that are missing or not of the design, cut by {name}"),
            stated: "none".into(),
            ours: faces.to_string(),
            agrees: faces == 0,
            reason: NOTHING,
        },
    ]
}

/// Repeats the statements, and cuts a small stone by feed and by force. `progress` gets the name
/// of the next step.
///
/// # Errors
/// The machine cannot grind, or it stopped.
pub fn rows(
    machine: &MachineFile,
    options: &RunOptions,
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, Error> {
    let mut rows = kinematics()?;
    let refused =
        |error: &dyn core::fmt::Display| Error::new(ErrorKind::Internal, error.to_string());
    let design = crate::read("small.asc", SMALL.as_bytes()).map_err(|error| refused(&error))?;
    let gem = Gem::new("small.asc", design, SMALL_MM, None).map_err(|error| refused(&error))?;
    for (name, mode) in [("feed", Mode::Feed), ("force", Mode::Force)] {
        progress(&format!("cutting a stone by {name}"));
        let settings = JobSettings {
            mode,
            index_wraps: index_wraps(machine),
            ..JobSettings::default()
        };
        let job = Job::new(&gem, settings).map_err(|error| refused(&error))?;
        let done = cut(&gem, &job, machine, options, &mut |_, _| {})?.whole()?;
        rows.extend(cutting(name, &done));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct Results {
        results: Vec<PrintedResult>,
    }

    /// A result of the printed equations, and of the corrected ones.
    #[derive(Deserialize)]
    struct PrintedResult {
        section: String,
        printed: String,
        corrected: String,
    }

    /// A quarter of the joint space is right by the printed inverse, all of it here.
    #[test]
    fn printed_equations_are_right_in_one_quadrant() {
        let rows = kinematics().unwrap();
        let found = |section: &str| -> Vec<&Row> {
            rows.iter().filter(|row| row.section == section).collect()
        };
        let text = include_str!("../tests/data/thesis_results.toml");
        let Results { results } = toml::from_str(text).unwrap();
        assert_eq!(results.len(), 3);
        for result in results {
            let rows = found(&result.section);
            assert!(!rows.is_empty(), "{}", result.section);
            for row in rows {
                assert_eq!(
                    (&row.stated, &row.ours),
                    (&result.printed, &result.corrected)
                );
            }
        }
        for row in found("4.2") {
            assert!(row.agrees, "{row:?}");
        }
    }
}
