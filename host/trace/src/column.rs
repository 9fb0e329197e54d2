//! What stands in a record, by name: the columns of a trace, the lines of a plot, the fields of an MCAP message.

use super::{Axes, Record, Recording, flag};
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::COMPONENTS;

/// Axis units of a millimetre.
const MM: f64 = (1 << 20) as f64;

/// A column.
#[derive(Debug, Clone)]
pub struct Column {
    /// Name, with its unit: `x_commanded_mm`.
    pub name: String,
    /// What it is a part of: `commanded`, `joint_error`, `state`.
    pub group: &'static str,
    /// Unit: `mm`, `deg`, `n`, `n_m`, `s`, `rpm`, `steps`; empty for a plain number.
    pub unit: &'static str,
    field: Field,
}

/// Where a row of a record is.
type Row = fn(&Record) -> &Axes;
type Forces = fn(&Record) -> &[i32; COMPONENTS];

#[derive(Debug, Clone, Copy)]
enum Field {
    Time,
    Period,
    State,
    Setpoint,
    Line,
    PathRate,
    Spindle,
    Flag(u8),
    Held,
    Axis(Row, usize, f64),
    Force(Forces, usize, f64),
}

/// What stands in a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A measure, and the decimals that it is written with.
    Real(f64, usize),
    /// A count or a number.
    Whole(i64),
    /// Yes or no.
    Flag(bool),
    /// The state of the controller.
    State(haptimill_protocol::message::State),
}

impl Value {
    /// As a number, for pictures.
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

    /// What stands in it; `None` where the record has no such thing. `time_s` is since the first record.
    #[must_use]
    pub fn value(&self, record: &Record, time_s: f64) -> Option<Value> {
        let tool = flag::TOOL_TRUE | flag::TOOL_MEASURED;
        let there = match self.group {
            "programmed" => record.has(flag::PROGRAMMED),
            "tool" => record.has(tool),
            "force_high" | "force_low" | "yielded" => record.has(flag::FORCE),
            "force_true" => record.has(flag::FORCE) && record.has(flag::TOOL_TRUE),
            "hand" | "hand_force" | "hand_reflected" | "hand_wall" => {
                record.hand_flags & flag::HAND_KNOWN != 0
            }
            _ => true,
        };
        let scaled = |raw: i32, scale: f64| Value::Real(f64::from(raw) * scale, 6);
        there.then(|| match self.field {
            Field::Time => Value::Real(time_s, 6),
            Field::Period => Value::Whole(record.period as i64),
            Field::State => Value::State(record.state),
            Field::Setpoint => Value::Whole(i64::from(record.setpoint)),
            Field::Line => Value::Whole(i64::from(record.line)),
            Field::PathRate => Value::Real(f64::from(record.path_rate) / 65_535.0, 5),
            Field::Spindle => Value::Whole(i64::from(record.spindle_rpm)),
            Field::Flag(flag) => Value::Flag(record.has(flag)),
            Field::Held => Value::Flag(record.hand_flags & flag::HAND_HELD != 0),
            Field::Axis(row, axis, scale) => scaled(row(record)[axis], scale),
            Field::Force(row, axis, scale) => scaled(row(record)[axis], scale),
        })
    }

    /// Whether the column is there in every record.
    #[must_use]
    pub fn is_always_there(&self) -> bool {
        !matches!(
            self.group,
            "programmed"
                | "tool"
                | "force_high"
                | "force_low"
                | "yielded"
                | "force_true"
                | "hand"
                | "hand_force"
                | "hand_reflected"
                | "hand_wall"
        )
    }
}

/// All columns of a recording, in the order of the trace.
#[must_use]
pub fn columns(recording: &Recording) -> Vec<Column> {
    let (header, config) = (recording.header(), recording.config());
    let mut all = vec![
        Column::plain("time_s", "time", "s", Field::Time),
        Column::plain("period", "time", "", Field::Period),
        Column::plain("state", "state", "", Field::State),
        Column::plain("setpoint", "state", "", Field::Setpoint),
        Column::plain("line", "state", "", Field::Line),
        Column::plain("path_rate", "state", "", Field::PathRate),
        Column::plain("spindle_rpm", "state", "rpm", Field::Spindle),
        Column::plain("homed", "state", "", Field::Flag(flag::HOMED)),
        Column::plain(
            "position_kept",
            "state",
            "",
            Field::Flag(flag::POSITION_KEPT),
        ),
    ];
    let pose: [(&'static str, Row); 3] = [
        ("commanded", |record| &record.commanded),
        ("programmed", |record| &record.programmed),
        ("tool", |record| &record.tool),
    ];
    let joints: [(&'static str, Row); 3] = [
        ("joint_commanded", |record| &record.joints_commanded),
        ("joint_measured", |record| &record.joints),
        ("joint_error", |record| &record.following_error),
    ];
    let kinds: Vec<AxisKind> = config.pose.iter().map(|axis| axis.kind).collect();
    let scales = recording.pose_units();
    for (group, row) in pose {
        all.extend(axes(group, row, &header.pose, &kinds, &scales));
    }
    let kinds: Vec<AxisKind> = config.joints.iter().map(|axis| axis.kind).collect();
    let scales = recording.joint_units();
    for (group, row) in joints {
        all.extend(axes(group, row, &header.joints, &kinds, &scales));
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
        ("yielded", "mm", |record| &record.force.yielded, 1.0 / MM),
        ("force_true", "n", |record| &record.true_force, NEWTON),
    ];
    for (group, unit, row, scale) in forces {
        all.extend(three(group, unit, row, scale));
    }
    if header.hand {
        all.extend(three("hand", "mm", |record| &record.hand.tip, 1.0 / MM));
        all.push(Column::plain("hand_held", "hand", "", Field::Held));
        let masters: [(&'static str, Forces); 3] = [
            ("hand_force", |record| &record.hand.force),
            ("hand_reflected", |record| &record.hand.reflected),
            ("hand_wall", |record| &record.hand.wall),
        ];
        for (group, row) in masters {
            all.extend(three(group, "n", row, NEWTON));
        }
    }
    all
}

/// The columns of all axes.
fn axes(
    group: &'static str,
    row: Row,
    names: &[String],
    kinds: &[AxisKind],
    scales: &[f64],
) -> impl Iterator<Item = Column> {
    let axes = names.iter().zip(kinds).zip(scales).enumerate();
    axes.map(move |(axis, ((name, kind), scale))| {
        let unit = match kind {
            AxisKind::Linear => "mm",
            AxisKind::Rotary => "deg",
        };
        let field = Field::Axis(row, axis, *scale);
        Column::plain(&format!("{name}_{group}_{unit}"), group, unit, field)
    })
}

/// The columns of x, y and z.
fn three(
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

/// Columns by name, as `x_*_mm,l?_drive_n`: a star stands for any letters, a question mark for one.
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

    /// Those of the columns that are named, each once, in the order of the names.
    ///
    /// # Errors
    /// A name that no column has, in words.
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
                    "there is no column \"{}\"; `haptimill trace info FILE` lists them, a star stands for any letters",
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

/// Whether a name is of a pattern.
fn matches(pattern: &[u8], name: &[u8]) -> bool {
    // Where the last star was, and how much of the name it has taken.
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
                Some((at, taken)) => {
                    star = Some((at, taken + 1));
                    (p, n) = (at + 1, taken + 1);
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
    fn patterns_are_what_they_seem() {
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
        fn a_name_with_letters_starred_out_still_matches(name in "[a-c]{0,9}", from in 0usize..9, to in 0usize..9) {
            let (from, to) = (from.min(name.len()), to.min(name.len()));
            let (from, to) = (from.min(to), from.max(to));
            let pattern = format!("{}*{}", &name[..from], &name[to..]);
            prop_assert!(matches(pattern.as_bytes(), name.as_bytes()), "{pattern}");
            let longer = format!("{name}d");
            prop_assert!(!matches(name.as_bytes(), longer.as_bytes()));
        }
    }
}
