//! Columns: the named values of a record, for the trace, plots and MCAP messages.

use super::{Axes, Quantity, Record, Recording, flag};
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::COMPONENTS;
use haptimill_machine_file::{IoNames, MachineFile};

/// Axis units per millimetre.
const MM: f64 = (1 << 20) as f64;

/// A column.
#[derive(Debug, Clone)]
pub struct Column {
    /// Name, with its unit: `x_commanded_mm`.
    pub name: String,
    /// Group of columns: `commanded`, `joint_error`, `state`.
    pub group: &'static str,
    /// Unit: `mm`, `deg`, `n`, `n_m`, `s`, `rpm`, `steps`; empty for a plain number.
    pub unit: &'static str,
    field: Field,
}

/// Accessor of a row of a record.
type Row = fn(&Record) -> &Axes;
type Forces = fn(&Record) -> &[i32; COMPONENTS];

/// Values of all axes of a record: positions, which count on over turns, or differences.
#[derive(Clone, Copy)]
enum Places {
    Positions(Quantity),
    Differences(Row),
}

#[derive(Debug, Clone, Copy)]
enum Field {
    Time,
    Period,
    State,
    Setpoint,
    Line,
    SpeedFactor,
    Spindle,
    Flag(u8),
    EnablingSwitch,
    /// Component of an axis of the handle: 0 for its x axis, 1 for its z axis.
    Direction(usize, usize),
    Input(usize),
    Output(usize),
    /// Whether it is an output, its index, and the value of the code 32768.
    Analog(bool, usize, f64),
    Axis(Row, usize, f64),
    Place(Quantity, usize, f64),
    Force(Forces, usize, f64),
}

/// Value of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A measured value and its number of decimals.
    Real(f64, usize),
    /// A whole number.
    Whole(i64),
    /// True or false.
    Flag(bool),
    /// The state of the controller.
    State(haptimill_protocol::message::State),
}

impl Value {
    /// Returns the value as a number, for plots.
    #[must_use]
    pub fn number(self) -> f64 {
        match self {
            Self::Real(value, _) => value,
            Self::Whole(value) => value as f64,
            Self::Flag(set) => f64::from(u8::from(set)),
            Self::State(state) => f64::from(state.number()),
        }
    }
}

impl Column {
    fn plain(name: &str, group: &'static str, unit: &'static str, field: Field) -> Self {
        Self {
            name: name.to_string(),
            group,
            unit,
            field,
        }
    }

    /// Returns the value of a record; `None` if the record does not have it. `time_s` counts from
    /// the first record.
    #[must_use]
    pub fn value(&self, record: &Record, time_s: f64) -> Option<Value> {
        let tool = flag::TOOL_TRUE | flag::TOOL_MEASURED;
        let is_present = match self.group {
            "programmed" => record.has(flag::PROGRAMMED),
            "tool" => record.has(tool),
            "force_high" | "force_low" | "displacement" => record.has(flag::FORCE),
            "force_true" => record.has(flag::FORCE) && record.has(flag::TOOL_TRUE),
            "master" | "master_axes" | "master_force" | "master_feedback" | "master_fixture" => {
                record.haptic_flags & flag::HAPTIC_KNOWN != 0
            }
            _ => true,
        };
        let scaled = |raw: i32, scale: f64| Value::Real(f64::from(raw) * scale, 6);
        is_present.then(|| match self.field {
            Field::Time => Value::Real(time_s, 6),
            Field::Period => Value::Whole(record.period as i64),
            Field::State => Value::State(record.state),
            Field::Setpoint => Value::Whole(i64::from(record.setpoint)),
            Field::Line => Value::Whole(i64::from(record.line)),
            Field::SpeedFactor => Value::Real(
                f64::from(record.speed_factor)
                    / f64::from(haptimill_protocol::message::FULL_SPEED_FACTOR),
                5,
            ),
            Field::Spindle => Value::Whole(i64::from(record.spindle_rpm)),
            Field::Flag(flag) => Value::Flag(record.has(flag)),
            Field::Direction(row, component) => {
                let direction = f64::from(record.haptic.axes[row][component]);
                Value::Real(direction / f64::from(i16::MAX), 6)
            }
            Field::EnablingSwitch => Value::Flag(record.haptic_flags & flag::ENABLING_SWITCH != 0),
            Field::Input(input) => Value::Flag(record.io.inputs >> input & 1 != 0),
            Field::Output(output) => Value::Flag(record.io.outputs >> output & 1 != 0),
            Field::Analog(output, index, full_scale) => {
                let io = &record.io;
                let codes = if output {
                    io.analog_outputs
                } else {
                    io.analog_inputs
                };
                scaled(i32::from(codes[index]), full_scale / 32_768.0)
            }
            Field::Axis(row, axis, scale) => scaled(row(record)[axis], scale),
            Field::Place(quantity, axis, scale) => {
                Value::Real(record.unwound(quantity, axis) as f64 * scale, 6)
            }
            Field::Force(row, axis, scale) => scaled(row(record)[axis], scale),
        })
    }

    /// Whether every record has a value of this column.
    #[must_use]
    pub fn is_always_present(&self) -> bool {
        !matches!(
            self.group,
            "programmed"
                | "tool"
                | "force_high"
                | "force_low"
                | "displacement"
                | "force_true"
                | "master"
                | "master_force"
                | "master_feedback"
                | "master_fixture"
        )
    }
}

/// Returns all columns of a recording, in the order of the trace.
#[must_use]
pub fn columns(recording: &Recording) -> Vec<Column> {
    let (header, config) = (recording.header(), recording.config());
    let mut all = vec![
        Column::plain("time_s", "time", "s", Field::Time),
        Column::plain("period", "time", "", Field::Period),
        Column::plain("state", "state", "", Field::State),
        Column::plain("setpoint", "state", "", Field::Setpoint),
        Column::plain("line", "state", "", Field::Line),
        Column::plain("speed_factor", "state", "", Field::SpeedFactor),
        Column::plain("spindle_rpm", "state", "rpm", Field::Spindle),
        Column::plain("homed", "state", "", Field::Flag(flag::HOMED)),
    ];
    if config.volumetric.is_some() {
        let field = Field::Flag(flag::COMPENSATED);
        all.push(Column::plain("compensated", "state", "", field));
    }
    let pose: [(&'static str, Places); 3] = [
        ("commanded", Places::Positions(Quantity::Commanded)),
        ("programmed", Places::Positions(Quantity::Programmed)),
        ("tool", Places::Positions(Quantity::Tool)),
    ];
    let joints: [(&'static str, Places); 3] = [
        (
            "joint_commanded",
            Places::Positions(Quantity::JointsCommanded),
        ),
        ("joint_measured", Places::Positions(Quantity::Joints)),
        (
            "joint_error",
            Places::Differences(|record| &record.following_error),
        ),
    ];
    let kinds: Vec<AxisKind> = config.pose.iter().map(|axis| axis.kind).collect();
    let scales = recording.pose_units();
    for (group, row) in pose {
        all.extend(axis_columns(group, row, &header.pose, &kinds, &scales));
    }
    let kinds: Vec<AxisKind> = config.joints.iter().map(|axis| axis.kind).collect();
    let scales = recording.joint_units();
    for (group, row) in joints {
        all.extend(axis_columns(group, row, &header.joints, &kinds, &scales));
    }
    for (axis, (name, (scale, unit))) in header
        .joints
        .iter()
        .zip(recording.drive_units())
        .enumerate()
    {
        let field = Field::Axis(|record| &record.drive, axis, scale);
        all.push(Column::plain(
            &format!("{name}_drive_{unit}"),
            "drive",
            unit,
            field,
        ));
    }
    const NEWTON: f64 = 1.0 / 65_536.0;
    let forces: [(&'static str, &'static str, Forces, f64); 4] = [
        ("force_high", "n", |record| &record.force.high, NEWTON),
        ("force_low", "n", |record| &record.force.low, NEWTON),
        (
            "displacement",
            "mm",
            |record| &record.force.displacement,
            1.0 / MM,
        ),
        ("force_true", "n", |record| &record.true_force, NEWTON),
    ];
    for (group, unit, row, scale) in forces {
        all.extend(component_columns(group, unit, row, scale));
    }
    all.extend(io_columns(recording));
    if header.has_haptic_arm {
        all.extend(component_columns(
            "master",
            "mm",
            |record| &record.haptic.tip,
            1.0 / MM,
        ));
        all.push(Column::plain(
            "master_enabling_switch",
            "master",
            "",
            Field::EnablingSwitch,
        ));
        for (row, handle_axis) in [(0, 'x'), (1, 'z')] {
            for (component, name) in ["x", "y", "z"].iter().enumerate() {
                let name = format!("{name}_master_axis_{handle_axis}");
                let field = Field::Direction(row, component);
                all.push(Column::plain(&name, "master_axes", "", field));
            }
        }
        let masters: [(&'static str, Forces); 3] = [
            ("master_force", |record| &record.haptic.force),
            ("master_feedback", |record| &record.haptic.feedback),
            ("master_fixture", |record| &record.haptic.fixture),
        ];
        for (group, row) in masters {
            all.extend(component_columns(group, "n", row, NEWTON));
        }
    }
    all
}

/// Returns the columns of the named inputs and outputs: `input_door`, `output_coolant`. A recording
/// whose machine file cannot be read names them by number.
fn io_columns(recording: &Recording) -> Vec<Column> {
    let config = &recording.config().io;
    if config.is_empty() {
        return Vec::new();
    }
    let file = MachineFile::parse("recording", &recording.header().machine_text);
    let names = file.map_or_else(|_| IoNames::default(), |file| file.io);
    let name = |names: &[String], index: usize| {
        let known = names.get(index).cloned();
        known.unwrap_or_else(|| (index + 1).to_string())
    };
    let mut all = Vec::new();
    for index in 0..config.inputs.len() {
        let name = format!("input_{}", name(&names.inputs, index));
        all.push(Column::plain(&name, "input", "", Field::Input(index)));
    }
    for index in 0..config.outputs.len() {
        let name = format!("output_{}", name(&names.outputs, index));
        all.push(Column::plain(&name, "output", "", Field::Output(index)));
    }
    let analog = [
        (
            "input",
            false,
            &names.analog_inputs,
            config.analog_inputs.len(),
        ),
        (
            "output",
            true,
            &names.analog_outputs,
            config.analog_outputs.len(),
        ),
    ];
    for (group, is_output, names, count) in analog {
        for index in 0..count {
            let (name, full_scale) = names.get(index).map_or_else(
                || (format!("analog_{}", index + 1), 32_768.0),
                |known| (known.name.clone(), known.full_scale),
            );
            let field = Field::Analog(is_output, index, full_scale);
            all.push(Column::plain(&format!("{group}_{name}"), group, "", field));
        }
    }
    all
}

/// Returns the columns of all axes.
fn axis_columns(
    group: &'static str,
    row: Places,
    names: &[String],
    kinds: &[AxisKind],
    scales: &[f64],
) -> impl Iterator<Item = Column> {
    let axes = names.iter().zip(kinds).zip(scales).enumerate();
    axes.map(move |(axis, ((name, kind), scale))| {
        let unit = if kind.is_rotary() { "deg" } else { "mm" };
        let field = match row {
            Places::Positions(quantity) => Field::Place(quantity, axis, *scale),
            Places::Differences(row) => Field::Axis(row, axis, *scale),
        };
        Column::plain(&format!("{name}_{group}_{unit}"), group, unit, field)
    })
}

/// Returns the columns of x, y and z.
fn component_columns(
    group: &'static str,
    unit: &'static str,
    row: Forces,
    scale: f64,
) -> impl Iterator<Item = Column> {
    ["x", "y", "z"].iter().enumerate().map(move |(axis, name)| {
        let field = Field::Force(row, axis, scale);
        Column::plain(&format!("{name}_{group}_{unit}"), group, unit, field)
    })
}

/// Selection of columns by name, such as `x_*_mm,l?_drive_n`: a star matches any letters, a
/// question mark one letter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection(Vec<String>);

impl Selection {
    /// Reads a list of names.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let names = text
            .split(',')
            .map(str::trim)
            .filter(|name| !name.is_empty());
        Self(names.map(str::to_string).collect())
    }

    /// Returns the selected columns, each once, in the order of the names.
    ///
    /// # Errors
    ///
    /// Returns a message if a name matches no column.
    pub fn of(&self, columns: &[Column]) -> Result<Vec<Column>, String> {
        let mut chosen: Vec<Column> = Vec::new();
        for pattern in &self.0 {
            let pattern = pattern.as_bytes();
            let mut found = false;
            for column in columns
                .iter()
                .filter(|column| matches(pattern, column.name.as_bytes()))
            {
                found = true;
                if chosen.iter().all(|known| known.name != column.name) {
                    chosen.push(column.clone());
                }
            }
            if !found {
                return Err(format!(
                    "no column matches \"{}\"; `haptimill trace info FILE` lists them, a star matches any letters",
                    String::from_utf8_lossy(pattern)
                ));
            }
        }
        if chosen.is_empty() {
            return Err("name a column; `haptimill trace info FILE` lists them".to_string());
        }
        Ok(chosen)
    }
}

/// Whether a name matches a pattern.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    // Position of the last star, and the end of the part of the name that it matches.
    let (mut p, mut n, mut star) = (0, 0, None);
    while n < name.len() {
        match pattern.get(p) {
            Some(b'*') => {
                star = Some((p, n));
                p += 1;
            }
            Some(&letter) if letter == b'?' || letter == name[n] => {
                p += 1;
                n += 1;
            }
            _ => match star {
                Some((at, matched)) => {
                    star = Some((at, matched + 1));
                    (p, n) = (at + 1, matched + 1);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|&letter| letter == b'*')
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stars_and_question_marks_match() {
        for (pattern, name, fits) in [
            ("x_*_mm", "x_commanded_mm", true),
            ("x_*_mm", "x_commanded_deg", false),
            ("l?_drive_n", "l3_drive_n", true),
            ("l?_drive_n", "alpha_drive_n", false),
            ("*", "state", true),
            ("*_*_*", "a_b_c_d", true),
            ("state", "states", false),
            ("", "state", false),
        ] {
            assert_eq!(
                matches(pattern.as_bytes(), name.as_bytes()),
                fits,
                "{pattern} {name}"
            );
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(5), failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn star_matches_any_part_of_a_name(name in "[a-c]{0,9}", from in 0usize..9, to in 0usize..9) {
            let (from, to) = (from.min(name.len()), to.min(name.len()));
            let (from, to) = (from.min(to), from.max(to));
            let pattern = format!("{}*{}", &name[..from], &name[to..]);
            prop_assert!(matches(pattern.as_bytes(), name.as_bytes()), "{pattern}");
            let longer = format!("{name}d");
            prop_assert!(!matches(name.as_bytes(), longer.as_bytes()));
        }
    }
}
