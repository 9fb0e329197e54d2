//! The firmware's kinematics for a table of poses or joint positions.
//!
//! The columns are the pose coordinates or the joints of the machine, under the names of its
//! descriptor with the unit behind (`x_mm`, `a_deg`). Numbers are mm and degrees with nine decimals
//! (the resolution of the firmware is 0.95 nm and 84 ndeg). Columns are found by their name in the
//! first row. Every invalid cell is reported with file, line and column; then nothing is computed.

use haptimill_firmware::config::Config;
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_kinematics::{BoundedKinematics, JointLimits, Joints, Kinematics, Pose, PoseError};
use haptimill_machine_file::model::pose_error_code;
use haptimill_machine_file::scale::{PER_MM, per_unit};
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;
use std::fmt::Write;

/// Status of a row with a number that no coordinate of the controller holds.
const OUT_OF_RANGE: &str = "out_of_range";

/// Largest number of rows of a grid.
const MAX_ROWS: usize = 1_000_000;

/// Direction of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From poses to joint positions.
    Inverse,
    /// From joint positions to poses.
    Forward,
}

/// Values of one column of a grid: from `low` to `high`, `step` apart.
#[derive(Debug, Clone, PartialEq)]
pub struct GridColumn {
    /// Name of the coordinate or joint.
    pub name: String,
    /// First value, mm or degrees.
    pub low: f64,
    /// The last value is at most this.
    pub high: f64,
    /// Distance of the values; above 0.
    pub step: f64,
}

impl std::str::FromStr for GridColumn {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "write NAME=LOW:HIGH:STEP, as x=-100:100:50".to_string();
        let (name, range) = text.split_once('=').ok_or_else(wrong)?;
        let numbers: Vec<f64> = range
            .split(':')
            .map(|number| number.trim().parse().map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        let [low, high, step] = numbers[..] else {
            return Err(wrong());
        };
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err("write finite numbers".to_string());
        }
        if high < low || step <= 0.0 {
            return Err("write a LOW of at most HIGH and a STEP above 0".to_string());
        }
        let name = name.trim().to_string();
        Ok(Self {
            name,
            low,
            high,
            step,
        })
    }
}

/// Kinematics of a machine for tables.
#[derive(Debug, Clone)]
pub struct Table {
    direction: Direction,
    config: Config,
    /// Rows beyond the strokes are `out_of_stroke`.
    strokes: bool,
    bounded: BoundedKinematics,
    unbounded: BoundedKinematics,
    /// The machine has a singularity: its distance is a column.
    is_singular: bool,
}

/// Result of a row: the numbers that it has, and its status.
struct Row {
    values: Option<Vec<f64>>,
    /// Distance from the singularity, mm.
    singularity: Option<f64>,
    status: &'static str,
}

impl Table {
    /// A table of a machine. With `strokes`, joints beyond their strokes are `out_of_stroke`, with
    /// numbers; without, only the geometry is checked.
    #[must_use]
    pub fn new(config: &Config, direction: Direction, strokes: bool) -> Self {
        let endless = JointLimits {
            low: Coordinate(i32::MIN),
            high: Coordinate(i32::MAX),
            rate: Rate(i32::MAX),
        };
        let mut table = Self {
            direction,
            config: config.clone(),
            strokes,
            bounded: config.kinematics(),
            unbounded: BoundedKinematics::new(&config.model, [endless; MAX_AXES]),
            is_singular: false,
        };
        table.is_singular = table
            .home()
            .is_some_and(|(pose, _)| table.unbounded.singularity_distance(&pose).is_some());
        table
    }

    /// Names and kinds of the pose coordinates or the joints.
    fn axes(&self, pose: bool) -> Vec<(&'static str, AxisKind)> {
        let machine = self.config.model.descriptor();
        if pose {
            let axes = machine.pose.iter();
            axes.map(|axis| (axis.name, axis.kind)).collect()
        } else {
            let axes = machine.joints.iter();
            axes.map(|axis| (axis.name, axis.kind)).collect()
        }
    }

    fn inputs(&self) -> Vec<(&'static str, AxisKind)> {
        self.axes(self.direction == Direction::Inverse)
    }

    fn outputs(&self) -> Vec<(&'static str, AxisKind)> {
        self.axes(self.direction == Direction::Forward)
    }

    /// Pose and joints at the presets; none of a configuration without that pose.
    fn home(&self) -> Option<(Pose, Joints)> {
        let mut joints = Joints::default();
        for (slot, joint) in joints.0.iter_mut().zip(&self.config.joints) {
            *slot = joint.preset;
        }
        Some((self.bounded.forward(&joints).ok()?, joints))
    }

    /// Computes a table: one row for each row of `csv`, with the results only.
    ///
    /// # Errors
    /// One line for each invalid cell, `name:line:column: problem`.
    pub fn of_csv(&self, name: &str, csv: &[u8]) -> Result<Vec<u8>, String> {
        let columns = columns(&self.inputs());
        let rows = read(name, csv, &columns)?;
        let mut out = self.header(&[]);
        for row in rows {
            self.write(&mut out, &[], &self.row(&row));
        }
        Ok(out.into_bytes())
    }

    /// Computes a table over a grid. Coordinates that the grid does not name stay at the presets.
    /// The rows begin with the coordinates of the grid.
    ///
    /// # Errors
    /// A column that the machine does not have or that occurs twice, or too many rows.
    pub fn of_grid(&self, grid: &[GridColumn]) -> Result<Vec<u8>, String> {
        let inputs = self.inputs();
        let (pose, joints) = self
            .home()
            .ok_or("the presets of the machine give no pose; correct the machine file")?;
        let start = if self.direction == Direction::Inverse {
            pose.0
        } else {
            joints.0
        };
        let mut values: Vec<Vec<f64>> = inputs
            .iter()
            .zip(start)
            .map(|((_, kind), at)| vec![f64::from(at.0) / per_unit(*kind)])
            .collect();
        let mut named = vec![false; inputs.len()];
        for column in grid {
            let place = inputs.iter().position(|(name, _)| *name == column.name);
            let place = place.ok_or_else(|| {
                let names: Vec<&str> = inputs.iter().map(|(name, _)| *name).collect();
                let known = names.join(", ");
                let what = match self.direction {
                    Direction::Inverse => "coordinate",
                    Direction::Forward => "joint",
                };
                format!(
                    "--grid: there is no {what} '{}'; this machine has {known}",
                    column.name
                )
            })?;
            if std::mem::replace(&mut named[place], true) {
                return Err(format!("--grid {}: occurs twice; leave one", column.name));
            }
            // A step that divides the range reaches its end in spite of rounding.
            let steps = ((column.high - column.low) / column.step + 1e-9).floor();
            if steps >= MAX_ROWS as f64 {
                return Err(too_many_rows());
            }
            values[place] = (0..=steps as usize)
                .map(|step| column.low + step as f64 * column.step)
                .collect();
        }
        let rows = values
            .iter()
            .try_fold(1_usize, |rows, column| rows.checked_mul(column.len()))
            .filter(|rows| *rows <= MAX_ROWS)
            .ok_or_else(too_many_rows)?;
        let mut out = self.header(&inputs);
        for index in 0..rows {
            // The last coordinate changes fastest.
            let mut rest = index;
            let mut row = vec![0.0; values.len()];
            for (slot, column) in row.iter_mut().zip(&values).rev() {
                *slot = column[rest % column.len()];
                rest /= column.len();
            }
            self.write(&mut out, &row, &self.row(&row));
        }
        Ok(out.into_bytes())
    }

    /// Computes a row.
    fn row(&self, values: &[f64]) -> Row {
        let mut input = [Coordinate::ZERO; MAX_AXES];
        for ((slot, value), (_, kind)) in input.iter_mut().zip(values).zip(self.inputs()) {
            let Some(value) = fixed(*value, per_unit(kind)) else {
                return Row {
                    values: None,
                    singularity: None,
                    status: OUT_OF_RANGE,
                };
            };
            *slot = value;
        }
        let (answer, bounded, pose) = match self.direction {
            Direction::Inverse => {
                let pose = Pose(input);
                let answer = self.unbounded.inverse(&pose).map(|joints| joints.0);
                (answer, self.bounded.inverse(&pose).err(), Some(pose))
            }
            Direction::Forward => {
                let joints = Joints(input);
                let answer = self.unbounded.forward(&joints);
                let bounded = self.bounded.forward(&joints).err();
                (answer.map(|pose| pose.0), bounded, answer.ok())
            }
        };
        let distance = pose.and_then(|pose| self.unbounded.singularity_distance(&pose)?.ok());
        let singularity = distance.map(|distance| f64::from(distance.0) / PER_MM);
        let machine = self.unbounded.descriptor();
        match answer {
            Ok(values) => {
                let outputs = self.outputs();
                let values = values.iter().zip(outputs);
                let values = values.map(|(value, (_, kind))| f64::from(value.0) / per_unit(kind));
                let error: Option<PoseError> = bounded.filter(|_| self.strokes);
                Row {
                    values: Some(values.collect()),
                    singularity,
                    status: error.map_or("ok", |error| pose_error_code(error, machine)),
                }
            }
            Err(error) => Row {
                values: None,
                singularity,
                status: pose_error_code(error, machine),
            },
        }
    }

    fn header(&self, given: &[(&'static str, AxisKind)]) -> String {
        let mut names = columns(given);
        let results = columns(&self.outputs());
        // A coordinate and a joint may have one name; a column name is there once.
        let results: Vec<String> = results
            .into_iter()
            .map(|name| match self.direction {
                _ if !names.contains(&name) => name,
                Direction::Inverse => format!("joint_{name}"),
                Direction::Forward => format!("pose_{name}"),
            })
            .collect();
        names.extend(results);
        if self.is_singular {
            names.push("singularity_mm".to_string());
        }
        names.push("status\n".to_string());
        names.join(",")
    }

    /// Writes a row; numbers that it does not have are empty cells.
    fn write(&self, out: &mut String, given: &[f64], row: &Row) {
        let mut cell = |value: Option<f64>| {
            if let Some(value) = value {
                // Writing to a string cannot fail. Adding zero turns -0 into 0.
                let _ = write!(out, "{:.9}", value + 0.0);
            }
            out.push(',');
        };
        given.iter().for_each(|value| cell(Some(*value)));
        for index in 0..self.outputs().len() {
            cell(
                row.values
                    .as_ref()
                    .and_then(|values| values.get(index).copied()),
            );
        }
        if self.is_singular {
            cell(row.singularity);
        }
        out.push_str(row.status);
        out.push('\n');
    }
}

fn too_many_rows() -> String {
    format!("--grid: has more than {MAX_ROWS} rows; raise a step")
}

/// Names of the columns of axes.
fn columns(axes: &[(&'static str, AxisKind)]) -> Vec<String> {
    axes.iter()
        .map(|(name, kind)| {
            if kind.is_rotary() {
                format!("{name}_deg")
            } else {
                format!("{name}_mm")
            }
        })
        .collect()
}

/// The nearest fixed-point coordinate, none outside the range. Angles are never wrapped.
fn fixed(value: f64, scale: f64) -> Option<Coordinate> {
    let raw = (value * scale).round();
    let range = f64::from(i32::MIN)..=f64::from(i32::MAX);
    range.contains(&raw).then_some(Coordinate(raw as i32))
}

/// Largest number of listed problems; a table in the wrong format has one in each cell.
const MAX_PROBLEMS: usize = 20;

/// Reads the named columns of a table.
fn read(name: &str, csv: &[u8], columns: &[String]) -> Result<Vec<Vec<f64>>, String> {
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
    let mut places = vec![0; columns.len()];
    for (column, place) in columns.iter().zip(&mut places) {
        let mut found = (0..header.len()).filter(|index| header[*index] == *column);
        match (found.next(), found.next()) {
            (Some(first), Some(second)) => problems.push(format!(
                "{name}:1:1: column {column} occurs twice, {} and {} in the row; leave one",
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
        let mut row = vec![f64::NAN; columns.len()];
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
        if problems.len() >= MAX_PROBLEMS {
            problems.truncate(MAX_PROBLEMS);
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
