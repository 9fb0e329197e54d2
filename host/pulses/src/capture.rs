//! Levels of digital lines over time, from a VCD file.

use crate::SECOND;
use std::collections::HashMap;
use std::fmt;
use std::io::BufRead;
use vcd::{Command, IdCode, Parser, ScopeItem, Value};

/// Largest number of level changes that a capture holds.
const MAX_CHANGES: usize = 100_000_000;

/// A digital line.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Signal {
    /// Name with the scopes around it, separated by dots.
    pub name: String,
    /// Level at the start of the capture.
    pub initial: bool,
    /// Times at which the level changes, in fs, ascending.
    pub changes: Vec<i64>,
}

impl Signal {
    /// Level just after a time.
    #[must_use]
    pub fn level_at(&self, time: i64) -> bool {
        self.initial ^ (self.changes_until(time) % 2 == 1)
    }

    /// Number of changes at or before a time.
    #[must_use]
    pub fn changes_until(&self, time: i64) -> usize {
        self.changes.partition_point(|change| *change <= time)
    }

    /// Times at which the level becomes `level`, with the time of the change after it, if the
    /// capture has it.
    pub fn changes_to(&self, level: bool) -> impl Iterator<Item = (i64, Option<i64>)> + '_ {
        let first = usize::from(self.initial == level);
        (first..self.changes.len()).step_by(2).map(|at| {
            let next = self.changes.get(at + 1).copied();
            (self.changes[at], next)
        })
    }

    /// Name without its scopes.
    #[must_use]
    pub fn short_name(&self) -> &str {
        self.name.rsplit('.').next().unwrap_or(&self.name)
    }
}

/// Digital lines over time.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Capture {
    /// Unit of the file's times, fs.
    pub resolution: i64,
    /// Time of the first entry, fs.
    pub start: i64,
    /// Time of the last entry, fs.
    pub end: i64,
    /// The lines.
    pub signals: Vec<Signal>,
}

/// Reason why a capture cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CaptureError {
    /// The file is not a VCD file, or breaks off; line and reason.
    Syntax(u64, String),
    /// The header has no time scale.
    NoTimescale,
    /// A time is less than the one before it; line.
    TimeReversed(u64),
    /// A time is beyond 2.5 hours; line.
    TimeTooLarge(u64),
    /// A line has an unknown level in the middle of the capture; line of the file and name.
    Unknown(u64, String),
    /// The file has more level changes than are supported.
    TooLarge,
    /// The header has no line of one bit.
    NoSignals,
}

impl fmt::Display for CaptureError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Syntax(line, why) => write!(
                out,
                "line {line}: {why}; the file must be a value change dump (VCD, IEEE 1364)"
            ),
            Self::NoTimescale => write!(
                out,
                "the header has no $timescale, so its times have no unit; export the capture again with one"
            ),
            Self::TimeReversed(line) => {
                write!(out, "line {line}: the time is before the one above it")
            }
            Self::TimeTooLarge(line) => write!(
                out,
                "line {line}: the time is beyond 2.5 hours; export a shorter part"
            ),
            Self::Unknown(line, name) => write!(
                out,
                "line {line}: the level of '{name}' is unknown (x or z); the analyser must record levels of 0 and 1"
            ),
            Self::TooLarge => write!(
                out,
                "the file has more than {MAX_CHANGES} level changes; export a shorter part"
            ),
            Self::NoSignals => write!(out, "the header declares no line of one bit"),
        }
    }
}

impl std::error::Error for CaptureError {}

/// A line while it is read.
struct Reading {
    signal: Signal,
    level: Option<bool>,
}

impl Capture {
    /// Reads a VCD file. Vectors, reals and strings are skipped.
    ///
    /// # Errors
    /// See [`CaptureError`].
    pub fn read_vcd(file: impl BufRead) -> Result<Self, CaptureError> {
        let mut parser = Parser::new(file);
        let header = parser
            .parse_header()
            .map_err(|error| CaptureError::Syntax(parser.line(), error.to_string()))?;
        let timescale = header.timescale.filter(|(count, _)| *count > 0);
        let (count, unit) = timescale.ok_or(CaptureError::NoTimescale)?;
        let unit_fs = SECOND / i64::try_from(unit.divisor()).unwrap_or(SECOND);
        let resolution = i64::from(count) * unit_fs.max(1);
        let mut lines = Vec::new();
        let mut by_code: HashMap<IdCode, Vec<usize>> = HashMap::new();
        collect("", &header.items, &mut lines, &mut by_code);
        if lines.is_empty() {
            return Err(CaptureError::NoSignals);
        }
        let (mut first, mut now, mut changes) = (None, 0, 0);
        while let Some(command) = parser.next() {
            let line = parser.line();
            match command.map_err(|error| CaptureError::Syntax(line, error.to_string()))? {
                Command::Timestamp(stamp) => {
                    let time = i64::try_from(stamp)
                        .ok()
                        .and_then(|stamp| stamp.checked_mul(resolution))
                        .ok_or(CaptureError::TimeTooLarge(line))?;
                    if first.is_some() && time < now {
                        return Err(CaptureError::TimeReversed(line));
                    }
                    first.get_or_insert(time);
                    now = time;
                }
                Command::ChangeScalar(code, value) => {
                    for at in by_code.get(&code).into_iter().flatten() {
                        changes += 1;
                        change(&mut lines[*at], value, now, line)?;
                    }
                    if changes > MAX_CHANGES {
                        return Err(CaptureError::TooLarge);
                    }
                }
                _ => {}
            }
        }
        Ok(Self {
            resolution,
            start: first.unwrap_or(0),
            end: now,
            signals: lines.into_iter().map(|line| line.signal).collect(),
        })
    }

    /// The line with this name. Without scopes the name must be unique.
    ///
    /// # Errors
    /// No or several lines have the name; the text lists what there is.
    pub fn find(&self, name: &str) -> Result<&Signal, String> {
        if let Some(signal) = self.signals.iter().find(|signal| signal.name == name) {
            return Ok(signal);
        }
        let mut found = self
            .signals
            .iter()
            .filter(|signal| signal.short_name() == name);
        match (found.next(), found.next()) {
            (Some(signal), None) => Ok(signal),
            (Some(_), Some(_)) => Err(format!(
                "several lines are named '{name}'; write the name with its scope: {}",
                self.names()
            )),
            _ => Err(format!(
                "no line is named '{name}'; there are {}",
                self.names()
            )),
        }
    }

    /// Names of all lines, for messages.
    #[must_use]
    pub fn names(&self) -> String {
        let names: Vec<_> = self.signals.iter().map(|line| line.name.as_str()).collect();
        names.join(", ")
    }
}

/// Collects the lines of one bit of a scope and the scopes in it.
fn collect(
    scope: &str,
    items: &[ScopeItem],
    lines: &mut Vec<Reading>,
    by_code: &mut HashMap<IdCode, Vec<usize>>,
) {
    for item in items {
        match item {
            ScopeItem::Scope(inner) => {
                let path = format!("{scope}{}.", inner.identifier);
                collect(&path, &inner.items, lines, by_code);
            }
            ScopeItem::Var(var) if var.size == 1 => {
                by_code.entry(var.code).or_default().push(lines.len());
                lines.push(Reading {
                    signal: Signal {
                        name: format!("{scope}{}", var.reference),
                        ..Signal::default()
                    },
                    level: None,
                });
            }
            _ => {}
        }
    }
}

/// Applies a value of the file to a line.
fn change(reading: &mut Reading, value: Value, time: i64, line: u64) -> Result<(), CaptureError> {
    let level = match value {
        Value::V0 => false,
        Value::V1 => true,
        // Unknown until the first known level: many programs write that at the start.
        Value::X | Value::Z if reading.level.is_none() => return Ok(()),
        Value::X | Value::Z => {
            return Err(CaptureError::Unknown(line, reading.signal.name.clone()));
        }
    };
    match reading.level {
        None => reading.signal.initial = level,
        Some(before) if before != level => reading.signal.changes.push(time),
        Some(_) => {}
    }
    reading.level = Some(level);
    Ok(())
}
