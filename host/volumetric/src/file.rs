//! Errors as CSV files.
//!
//! Two forms, distinguished by their headers. Lines that begin with `#` are comments.
//!
//! ```csv
//! function,position_mm,direction,value,unit
//! EXX,-325,,0.12,um
//! EC0Y,,,25,urad
//! ```
//!
//! is a table; `direction` is `up`, `down`, or empty for both. The header [`FORM_HEADER`] announces
//! closed forms. A problem names the line and the remedy.

use crate::errors::{ClosedForm, ErrorSet, Function, Shape, Squareness, Table};
use core::f64::consts::TAU;
use core::fmt;
use csv::StringRecord;
use std::fmt::Write as _;

/// Header of a table.
pub const TABLE_HEADER: &str = "function,position_mm,direction,value,unit";

/// What the comment of a file says that was measured while the controller compensated.
pub const NOT_TO_COMPENSATE: &str = "do not compensate with this file";

/// Header of closed forms.
pub const FORM_HEADER: &str = "function,unit,mean,slope_per_mm,amplitude,wavelength_mm,phase_rad,\
                               amplitude_2,wavelength_2_mm,phase_2_rad";

/// What a controller accepts; a file beyond it is refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Travel of each axis that the nodes must cover, mm; `None` does not check it.
    pub travel: Option<[(f64, f64); 3]>,
    /// Largest distance between two nodes, mm.
    pub gap: f64,
    /// Largest translation, mm.
    pub translation: f64,
    /// Largest rotation and squareness, radians.
    pub rotation: f64,
    /// Largest change of a translation, mm per mm.
    pub translation_slope: f64,
    /// Largest change of a rotation, radians per mm.
    pub rotation_slope: f64,
}

impl Default for Limits {
    /// Gap: five targets a metre, as ISO 230-2 asks for. The others are those of the controller.
    fn default() -> Self {
        Self {
            travel: None,
            gap: 200.0,
            translation: 0.5,
            rotation: 1e-3,
            translation_slope: 1e-3,
            rotation_slope: 2e-6,
        }
    }
}

/// Problem of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileProblem {
    /// Line, from 1; 0 for the whole file.
    pub line: u64,
    /// What is wrong.
    pub what: String,
    /// What to do.
    pub remedy: String,
}

impl fmt::Display for FileProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.line > 0 {
            write!(f, "line {}: ", self.line)?;
        }
        write!(f, "{}; {}", self.what, self.remedy)
    }
}

impl core::error::Error for FileProblem {}

pub(crate) fn problem(
    line: u64,
    what: impl Into<String>,
    remedy: impl Into<String>,
) -> FileProblem {
    FileProblem {
        line,
        what: what.into(),
        remedy: remedy.into(),
    }
}

/// Reads the 21 errors from the text of a file.
///
/// # Errors
/// The first problem.
pub fn read(text: &str, limits: &Limits) -> Result<ErrorSet, FileProblem> {
    let form = text
        .lines()
        .find(|line| !line.starts_with('#') && !line.trim().is_empty())
        .is_some_and(|line| columns_of(line) == columns_of(FORM_HEADER));
    if form {
        read_forms(&rows(text, FORM_HEADER)?, limits)
    } else {
        read_tables(&rows(text, TABLE_HEADER)?, limits)
    }
}

fn columns_of(header: &str) -> Vec<&str> {
    header.split(',').map(str::trim).collect()
}

/// Line of the header, from 1: the first one that is no comment and not empty.
fn line_of_header(text: &str) -> u64 {
    let comments = text
        .lines()
        .take_while(|line| line.starts_with('#') || line.trim().is_empty());
    comments.count() as u64 + 1
}

/// The rows of a file with a header.
pub(crate) fn rows(text: &str, header: &str) -> Result<Vec<Row>, FileProblem> {
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let line = line_of_header(text);
    let found = reader
        .headers()
        .map_err(|error| problem(line, error.to_string(), "save the file as UTF-8"))?;
    let found: Vec<&str> = found.iter().collect();
    if found != columns_of(header) {
        return Err(problem(
            line,
            format!("the header is \"{}\"", found.join(",")),
            format!("write \"{header}\""),
        ));
    }
    let columns = found.len();
    let mut rows = Vec::new();
    for record in reader.records() {
        let record =
            record.map_err(|error| problem(0, error.to_string(), "save the file as UTF-8"))?;
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != columns {
            let what = format!("has {} values, the header has {columns}", record.len());
            return Err(problem(line, what, "complete the line"));
        }
        rows.push(Row { line, record });
    }
    Ok(rows)
}

pub(crate) struct Row {
    pub(crate) line: u64,
    record: StringRecord,
}

impl Row {
    pub(crate) fn text(&self, column: usize) -> &str {
        self.record.get(column).unwrap_or_default()
    }

    pub(crate) fn number(&self, column: usize, name: &str) -> Result<f64, FileProblem> {
        let text = self.text(column);
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| {
            let what = if text.is_empty() {
                format!("{} has a gap: {name} is empty", self.text(0))
            } else {
                format!("{name} = \"{text}\" is not a number")
            };
            problem(self.line, what, "measure the point, or remove the line")
        })
    }

    /// Value of one unit, in mm or radians.
    pub(crate) fn unit(&self, column: usize, rotates: bool) -> Result<f64, FileProblem> {
        let unit = self.text(column);
        let known = [
            ("um", false, 1e-3),
            ("mm", false, 1.0),
            ("nm", false, 1e-6),
            ("urad", true, 1e-6),
            ("arcsec", true, core::f64::consts::PI / 648_000.0),
        ];
        let found = known
            .into_iter()
            .find(|(name, turns, _)| *name == unit && *turns == rotates);
        found.map(|(.., value)| value).ok_or_else(|| {
            let (kind, units) = if rotates {
                ("rotation", "urad or arcsec")
            } else {
                ("translation", "um, mm or nm")
            };
            let what = format!("{} is a {kind}, its unit is \"{unit}\"", self.text(0));
            problem(self.line, what, format!("write {units}"))
        })
    }

    /// The function of the row, or the index of a squareness error.
    pub(crate) fn name(&self) -> Result<Name, FileProblem> {
        let name = self.text(0);
        if let Some(function) = Function::of_name(name) {
            return Ok(Name::Function(function));
        }
        let plain = name.replace('_', "");
        let plain = plain.strip_prefix('E').unwrap_or(&plain);
        let mut squareness = Squareness::NAMES.iter();
        let found = squareness.position(|known| known[1..] == *plain);
        found.map(Name::Squareness).ok_or_else(|| {
            let all: Vec<String> = Function::all()
                .map(|function| function.to_string())
                .collect();
            let remedy = format!(
                "the names are {} and {}",
                all.join(", "),
                Squareness::NAMES.join(", ")
            );
            problem(
                self.line,
                format!("\"{name}\" is no error of an axis"),
                remedy,
            )
        })
    }
}

pub(crate) enum Name {
    Function(Function),
    Squareness(usize),
}

/// Every error occurs once.
#[derive(Default)]
struct Found {
    functions: [Option<u64>; 18],
    squareness: [Option<f64>; 3],
}

impl Found {
    fn squareness(&mut self, row: &Row, index: usize, value: f64) -> Result<(), FileProblem> {
        if self.squareness[index].replace(value).is_some() {
            let what = format!("{} is there twice", row.text(0));
            return Err(problem(row.line, what, "remove one"));
        }
        Ok(())
    }

    fn finish(&self) -> Result<Squareness, FileProblem> {
        for function in Function::all() {
            if self.functions[function.index()].is_none() {
                let what = format!("{function} has no line");
                return Err(problem(0, what, "measure it, or write 0 at both ends"));
            }
        }
        let mut values = [0.0; 3];
        for (index, value) in self.squareness.iter().enumerate() {
            values[index] = value.ok_or_else(|| {
                let what = format!("{} has no line", Squareness::NAMES[index]);
                problem(0, what, "measure it, or write 0")
            })?;
        }
        Ok(Squareness::of_values(values))
    }
}

fn read_forms(rows: &[Row], limits: &Limits) -> Result<ErrorSet, FileProblem> {
    let mut set = ErrorSet::default();
    let mut found = Found::default();
    for row in rows {
        let number = |column: usize| row.number(column, "a value");
        match row.name()? {
            Name::Squareness(index) => {
                let value = number(2)? * row.unit(1, true)?;
                check_size(row.line, row.text(0), value, limits.rotation, "urad", 1e-6)?;
                found.squareness(row, index, value)?;
            }
            Name::Function(function) => {
                let unit = row.unit(1, function.rotates)?;
                if let Some(line) = found.functions[function.index()].replace(row.line) {
                    let what = format!("{function} is in line {line} already");
                    return Err(problem(row.line, what, "remove one"));
                }
                let sine = |column: usize| -> Result<[f64; 3], FileProblem> {
                    Ok([
                        number(column)? * unit,
                        number(column + 1)?,
                        number(column + 2)?,
                    ])
                };
                let form = ClosedForm {
                    mean: number(2)? * unit,
                    slope: number(3)? * unit,
                    sines: [sine(4)?, sine(7)?],
                };
                check_form(row.line, function, &form, limits)?;
                set.set(function, Shape::ClosedForm(form));
            }
        }
    }
    set.squareness = found.finish()?;
    Ok(set)
}

/// Checks the largest value and slope that a closed form may have over the travel.
fn check_form(
    line: u64,
    function: Function,
    form: &ClosedForm,
    limits: &Limits,
) -> Result<(), FileProblem> {
    let axis = function.moving.index();
    let (low, high) = limits.travel.map_or((0.0, 0.0), |travel| travel[axis]);
    let reach = low.abs().max(high.abs());
    let sines = form.sines.iter().filter(|[_, length, _]| *length != 0.0);
    let waves: f64 = sines.clone().map(|[amplitude, ..]| amplitude.abs()).sum();
    let steep = sines.map(|[amplitude, length, _]| (TAU * amplitude / length).abs());
    let slope = form.slope.abs() + steep.sum::<f64>();
    let size = form.mean.abs() + form.slope.abs() * reach + waves;
    let largest = if function.rotates {
        limits.rotation
    } else {
        limits.translation
    };
    let (unit, one) = (function.unit(), function.file_unit());
    check_size(line, &function.to_string(), size, largest, unit, one)?;
    check_slope(line, function, slope, limits)
}

/// Nodes and values of a function in one direction.
#[derive(Debug, Clone, Default)]
struct Column {
    nodes: Vec<f64>,
    values: Vec<f64>,
}

fn read_tables(rows: &[Row], limits: &Limits) -> Result<ErrorSet, FileProblem> {
    let mut found = Found::default();
    let mut columns: [[Column; 3]; 18] = Default::default();
    for row in rows {
        let function = match row.name()? {
            Name::Squareness(index) => {
                let value = row.number(3, "value")? * row.unit(4, true)?;
                check_size(row.line, row.text(0), value, limits.rotation, "urad", 1e-6)?;
                found.squareness(row, index, value)?;
                continue;
            }
            Name::Function(function) => function,
        };
        let position = row.number(1, "position_mm")?;
        check_place(row.line, function, position, limits)?;
        let value = row.number(3, "value")? * row.unit(4, function.rotates)?;
        let largest = if function.rotates {
            limits.rotation
        } else {
            limits.translation
        };
        let name = function.to_string();
        check_size(
            row.line,
            &name,
            value,
            largest,
            function.unit(),
            function.file_unit(),
        )?;
        let direction = match row.text(2) {
            "" => 0,
            "up" => 1,
            "down" => 2,
            other => {
                let what = format!("direction = \"{other}\"");
                return Err(problem(
                    row.line,
                    what,
                    "write up, down, or nothing for both",
                ));
            }
        };
        let column = &mut columns[function.index()][direction];
        if let Some(before) = column.nodes.last() {
            check_step(row.line, function, *before, position, limits)?;
            let last = column.values.last().copied().unwrap_or_default();
            check_slope(
                row.line,
                function,
                (value - last) / (position - before),
                limits,
            )?;
        }
        column.nodes.push(position);
        column.values.push(value);
        found.functions[function.index()].get_or_insert(row.line);
    }
    let squareness = found.finish()?;
    let mut set = ErrorSet::default();
    set.squareness = squareness;
    for function in Function::all() {
        let line = found.functions[function.index()].unwrap_or_default();
        let table = join(function, line, &columns[function.index()])?;
        check_cover(function, line, &table.nodes, limits)?;
        set.set(function, Shape::Table(table));
    }
    Ok(set)
}

fn check_size(
    line: u64,
    name: &str,
    value: f64,
    largest: f64,
    unit: &str,
    one: f64,
) -> Result<(), FileProblem> {
    if value.abs() <= largest {
        return Ok(());
    }
    let what = format!(
        "{name} is {:.4} {unit}, the controller takes at most {:.4}",
        value / one,
        largest / one
    );
    Err(problem(line, what, "check the unit, and the machine"))
}

fn check_place(
    line: u64,
    function: Function,
    position: f64,
    limits: &Limits,
) -> Result<(), FileProblem> {
    let Some(travel) = limits.travel else {
        return Ok(());
    };
    let (low, high) = travel[function.moving.index()];
    if (low..=high).contains(&position) {
        return Ok(());
    }
    let what =
        format!("{function} has a position at {position} mm, the travel is {low} to {high} mm");
    Err(problem(
        line,
        what,
        "use the coordinates of the machine file",
    ))
}

fn check_step(
    line: u64,
    function: Function,
    before: f64,
    position: f64,
    limits: &Limits,
) -> Result<(), FileProblem> {
    if position <= before {
        let what = format!("{function} has {position} mm after {before} mm");
        return Err(problem(line, what, "sort the positions upwards, each once"));
    }
    if position - before > limits.gap {
        let what = format!(
            "{function} has a gap of {} mm before {position} mm, at most {} mm are allowed",
            position - before,
            limits.gap
        );
        return Err(problem(line, what, "measure between them"));
    }
    Ok(())
}

fn check_slope(
    line: u64,
    function: Function,
    slope: f64,
    limits: &Limits,
) -> Result<(), FileProblem> {
    let steepest = if function.rotates {
        limits.rotation_slope
    } else {
        limits.translation_slope
    };
    if slope.abs() <= steepest {
        return Ok(());
    }
    let one = function.file_unit();
    let unit = function.unit();
    let what = format!(
        "{function} changes by {:.3} {unit} per mm, the controller takes at most {:.3}",
        slope / one,
        steepest / one
    );
    Err(problem(
        line,
        what,
        "check the value: a servo loop does not follow such a step",
    ))
}

/// The table of one function, from its lines for both directions, or from those for each.
fn join(
    function: Function,
    line: u64,
    [both, up, down]: &[Column; 3],
) -> Result<Table, FileProblem> {
    match (
        both.nodes.is_empty(),
        up.nodes.is_empty(),
        down.nodes.is_empty(),
    ) {
        (false, true, true) => Ok(Table::both(both.nodes.clone(), both.values.clone())),
        (true, false, false) if up.nodes == down.nodes => Ok(Table {
            nodes: up.nodes.clone(),
            up: up.values.clone(),
            down: Some(down.values.clone()),
        }),
        (true, false, false) => {
            let what = format!("{function} has other positions upwards than downwards");
            Err(problem(line, what, "measure both at the same targets"))
        }
        (true, ..) => {
            let what = format!("{function} has one direction");
            Err(problem(
                line,
                what,
                "add the other, or leave the direction empty",
            ))
        }
        (false, ..) => {
            let what = format!("{function} has lines with and without a direction");
            Err(problem(line, what, "use one form"))
        }
    }
}

fn check_cover(
    function: Function,
    line: u64,
    nodes: &[f64],
    limits: &Limits,
) -> Result<(), FileProblem> {
    let (Some(first), Some(last)) = (nodes.first(), nodes.last()) else {
        return Ok(());
    };
    if nodes.len() < 2 {
        let what = format!("{function} has one position");
        return Err(problem(line, what, "measure at two at least"));
    }
    let Some(travel) = limits.travel else {
        return Ok(());
    };
    let (low, high) = travel[function.moving.index()];
    if first - low > limits.gap || high - last > limits.gap {
        let what =
            format!("{function} covers {first} to {last} mm of the travel {low} to {high} mm");
        return Err(problem(line, what, "measure the ends of the travel"));
    }
    Ok(())
}

/// Writes an error set with tables as a file; closed forms are refused by their caller's choice of
/// nodes, see [`ErrorSet::tabulated`].
#[must_use]
pub fn write(set: &ErrorSet, comment: &str) -> String {
    let mut text = String::new();
    for line in comment.lines() {
        // Writing to a string does not fail.
        let _ = writeln!(text, "# {line}");
    }
    let _ = writeln!(text, "{TABLE_HEADER}");
    for function in Function::all() {
        let Shape::Table(table) = set.function(function) else {
            continue;
        };
        let (one, unit) = (function.file_unit(), function.unit());
        let columns = match &table.down {
            None => vec![("", &table.up)],
            Some(down) => vec![("up", &table.up), ("down", down)],
        };
        for (direction, values) in columns {
            for (node, value) in table.nodes.iter().zip(values) {
                let value = value / one;
                let _ = writeln!(text, "{function},{node:.4},{direction},{value:.4},{unit}");
            }
        }
    }
    for (name, value) in Squareness::NAMES.iter().zip(set.squareness.values()) {
        let _ = writeln!(text, "{name},,,{:.4},urad", value / 1e-6);
    }
    text
}
