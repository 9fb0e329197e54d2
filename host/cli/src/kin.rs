//! The firmware's kinematics for a table of poses or joint positions.
//!
//! Numbers are mm and degrees with nine decimals (the resolution of the firmware is 0.95 nm and
//! 84 ndeg). Columns are found by their name in the first row. Every invalid cell is reported with
//! file, line and column; then nothing is computed.

use haptimill_firmware::config::Config;
use haptimill_kinematics::Model;
use haptimill_kinematics::h4::H4;
use haptimill_kinematics::{Joints, Kinematics, MAX_AXES, Pose, PoseError};
use haptimill_machine_file::model::pose_error_code;
use haptimill_math::Coordinate;
use std::fmt::Write;

const PER_MM: f64 = (1 << 20) as f64;
const PER_DEG: f64 = 4_294_967_296.0 / 360.0;

/// Inverse kinematics: `xw_mm, yw_mm, zw_mm, theta_deg, alpha_deg` to
/// `l1_mm, l2_mm, l3_mm, l4_mm, status`.
///
/// With `strokes`, joints beyond the strokes of the machine are `out_of_stroke`, with joint
/// positions; without, only the geometry is checked. An `alpha_deg` outside the range of a
/// coordinate (180 or more, or below -180) is always `out_of_stroke`, without joint positions.
///
/// # Errors
/// One line for each invalid cell, `name:line:column: problem`.
pub fn inverse_table(
    config: &Config,
    strokes: bool,
    name: &str,
    csv: &[u8],
) -> Result<Vec<u8>, String> {
    let columns = ["xw_mm", "yw_mm", "zw_mm", "theta_deg", "alpha_deg"];
    let rows = read(name, csv, columns)?;
    let machine = config.kinematics();
    let arm = arm(config)?;
    let mut out = String::from("l1_mm,l2_mm,l3_mm,l4_mm,status\n");
    for row in rows {
        let answer = pose(&row).map(|pose| (arm.inverse(&pose), machine.inverse(&pose)));
        match answer {
            Ok((Ok(joints), whole)) => {
                let slides = joints.0.iter().take(4).map(|l| f64::from(l.0) / PER_MM);
                line(&mut out, slides, whole.err().filter(|_| strokes));
            }
            Ok((Err(error), _)) | Err(error) => line(&mut out, [].into_iter(), Some(error)),
        }
    }
    Ok(out.into_bytes())
}

/// The H-4 kinematics of a machine.
fn arm(config: &Config) -> Result<H4, String> {
    match &config.model {
        Model::H4(geometry) => Ok(H4::new(geometry)),
        _ => Err(format!(
            "{} is no H-4 arm; the tables are those of an H-4 arm",
            config.name
        )),
    }
}

/// Forward kinematics in the frame of the machine base: `l1_mm, l2_mm, l3_mm, l4_mm` to
/// `x_mm, y_mm, z_mm, theta_deg, status`; `strokes` as for [`inverse_table`].
///
/// # Errors
/// One line for each invalid cell, `name:line:column: problem`.
pub fn forward_table(
    config: &Config,
    strokes: bool,
    name: &str,
    csv: &[u8],
) -> Result<Vec<u8>, String> {
    let rows = read(name, csv, ["l1_mm", "l2_mm", "l3_mm", "l4_mm"])?;
    let machine = config.kinematics();
    let arm = arm(config)?;
    let mut out = String::from("x_mm,y_mm,z_mm,theta_deg,status\n");
    for row in rows {
        let mut joints = Joints::default();
        let fits = row.iter().zip(&mut joints.0).all(|(value, joint)| {
            let raw = fixed(*value, PER_MM);
            raw.is_some_and(|raw| {
                *joint = raw;
                true
            })
        });
        // A position outside the range of a coordinate is out of reach of every rod.
        let base = if fits {
            arm.base_pose(&joints)
        } else {
            Err(PoseError::Unreachable)
        };
        match base {
            Ok(base) => {
                let lengths = [base.x, base.y, base.z].map(|l| f64::from(l.0) / PER_MM);
                let theta = f64::from(base.theta.0) / PER_DEG;
                let values = lengths.into_iter().chain([theta]);
                line(
                    &mut out,
                    values,
                    machine
                        .base_pose(&joints)
                        .and_then(Result::err)
                        .filter(|_| strokes),
                );
            }
            Err(error) => line(&mut out, [].into_iter(), Some(error)),
        }
    }
    Ok(out.into_bytes())
}

/// The nearest fixed-point coordinate, none outside the range.
fn fixed(value: f64, scale: f64) -> Option<Coordinate> {
    let raw = (value * scale).round();
    let range = f64::from(i32::MIN)..=f64::from(i32::MAX);
    range.contains(&raw).then_some(Coordinate(raw as i32))
}

/// Converts a row to a pose. Numbers outside the range of a coordinate are unreachable; angles are
/// never wrapped.
fn pose(row: &[f64; 5]) -> Result<Pose, PoseError> {
    let mut pose = [Coordinate(0); MAX_AXES];
    for (value, coordinate) in row[..3].iter().zip(&mut pose) {
        *coordinate = fixed(*value, PER_MM).ok_or(PoseError::Unreachable)?;
    }
    if row[3].abs() >= 90.0 {
        return Err(PoseError::Tilt);
    }
    pose[3] = fixed(row[3], PER_DEG).ok_or(PoseError::Tilt)?;
    // The rotary table is a joint: outside the range of a coordinate it is out of stroke.
    pose[4] = fixed(row[4], PER_DEG).ok_or(PoseError::OutOfStroke {
        axis: 4,
        by: if row[4] < 0.0 { i32::MIN } else { i32::MAX },
    })?;
    Ok(Pose(pose))
}

/// Writes a row of four numbers, or four empty cells, and the status.
fn line(out: &mut String, values: impl Iterator<Item = f64>, error: Option<PoseError>) {
    let mut cells = 0;
    for value in values {
        // Writing to a string cannot fail. Adding zero turns -0 into 0.
        let _ = write!(out, "{:.9},", value + 0.0);
        cells += 1;
    }
    for _ in cells..4 {
        out.push(',');
    }
    out.push_str(error.map_or("ok", pose_error_code));
    out.push('\n');
}

/// Largest number of listed problems; a table in the wrong format has one in each cell.
const MOST_PROBLEMS: usize = 20;

/// Reads the named columns of a table.
fn read<const N: usize>(
    name: &str,
    csv: &[u8],
    columns: [&str; N],
) -> Result<Vec<[f64; N]>, String> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(csv);
    let mut record = csv::ByteRecord::new();
    let unreadable = |error: csv::Error| format!("{name}: {error}");
    if !reader.read_byte_record(&mut record).map_err(unreadable)? {
        return Err(format!("{name}:1:1: the table is empty"));
    }
    // A byte order mark before the first name is not part of it.
    let header = |cell: &[u8]| {
        let cell = cell.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(cell);
        String::from_utf8_lossy(cell).trim().to_string()
    };
    let header: Vec<String> = record.iter().map(header).collect();
    let mut problems = Vec::new();
    let mut places = [0; N];
    for (column, place) in columns.iter().zip(&mut places) {
        let mut found = (0..header.len()).filter(|index| header[*index] == *column);
        match (found.next(), found.next()) {
            (Some(first), Some(second)) => problems.push(format!(
                "{name}:1:1: column {column} is there twice, {} and {} in the row; leave one",
                first + 1,
                second + 1
            )),
            (Some(found), None) => *place = found,
            (None, _) => problems.push(format!(
                "{name}:1:1: column {column} is missing; the first row must name {}",
                columns.join(", ")
            )),
        }
    }
    if !problems.is_empty() {
        return Err(problems.join("\n"));
    }
    let mut rows = Vec::new();
    while reader.read_byte_record(&mut record).map_err(unreadable)? {
        let line = record.position().map_or(0, csv::Position::line);
        let mut row = [f64::NAN; N];
        let before = |place| record.iter().take(place).map(|cell| cell.len() + 1);
        if record.len() > header.len() {
            problems.push(format!(
                "{name}:{line}:{}: the row has {} fields, the first row names {}; write decimals with a point, and a comma between fields only",
                1 + before(header.len()).sum::<usize>(),
                record.len(),
                header.len()
            ));
        }
        for ((place, column), value) in places.iter().zip(columns).zip(&mut row) {
            let at = 1 + before(*place).sum::<usize>();
            let Some(cell) = record.get(*place) else {
                problems.push(format!("{name}:{line}:{at}: {column} is missing"));
                continue;
            };
            let text = String::from_utf8_lossy(cell);
            match text.parse::<f64>() {
                Ok(number) if number.is_finite() => *value = number,
                _ => problems.push(format!(
                    "{name}:{line}:{at}: {column}: `{text}` is not a finite number; write one, as 12.5"
                )),
            }
        }
        rows.push(row);
        if problems.len() >= MOST_PROBLEMS {
            problems.truncate(MOST_PROBLEMS);
            problems.push(format!("{name}: and perhaps more"));
            break;
        }
    }
    if problems.is_empty() {
        Ok(rows)
    } else {
        Err(problems.join("\n"))
    }
}
