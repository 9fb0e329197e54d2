//! Comparison of the model with a measured side of the part, in the form of the thesis's table 5.1.

use crate::cut::MPE_P;
use crate::statistics::{
    Spline, choose_degree, class, fit_polynomial, p_of_t, pearson, t_of_correlation,
};
use haptimill_volumetric::Vector;
use haptimill_volumetric::chain::Model;
use haptimill_volumetric::errors::{
    Approach, ClosedForm, ErrorSet, Function, Kind, Shape, Table, even_nodes,
};
use haptimill_volumetric::gdt::{fit_line, range};
use haptimill_volumetric::part::{Features, HALF_SIDE};
use std::fmt::{self, Write as _};

/// A side that a coordinate measuring machine probed: positions along it, and readings of each run.
#[derive(Debug, Clone, PartialEq)]
pub struct SideTable {
    /// Positions, mm.
    pub positions: Vec<f64>,
    /// Readings by run, mm.
    pub runs: Vec<Vec<f64>>,
}

/// Problem of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableProblem {
    /// Line, from 1; 0 for the whole table.
    pub line: usize,
    /// What is wrong, and what to do.
    pub what: String,
}

impl fmt::Display for TableProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.line > 0 {
            write!(f, "line {}: ", self.line)?;
        }
        f.write_str(&self.what)
    }
}

impl std::error::Error for TableProblem {}

impl TableProblem {
    fn at(line: usize, what: impl Into<String>) -> Self {
        Self {
            line,
            what: what.into(),
        }
    }
}

/// Largest distance of a reading of a side from its nominal place, mm: five times the set-up errors
/// of the published tables. Beyond it are other units and other sides.
pub const MAX_OFF: f64 = 2.0;

/// Smallest distance of two positions, mm: a tenth of that of the published tables.
const MIN_APART: f64 = 1.0;

/// A line of a table.
struct Row<'a> {
    line: usize,
    values: Vec<&'a str>,
}

impl<'a> Row<'a> {
    fn new(line: usize, text: &'a str) -> Self {
        Self {
            line,
            values: text.split(',').map(str::trim).collect(),
        }
    }

    /// The value of a column, within `reach` of `about`, mm.
    fn coordinate(&self, column: usize, about: f64, reach: f64) -> Result<f64, TableProblem> {
        let text = self.values.get(column).copied().unwrap_or_default();
        let number = column + 1;
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        let Some(value) = value else {
            let what = format!("value {number} is \"{text}\" and no number; probe the point again");
            return Err(TableProblem::at(self.line, what));
        };
        if (value - about).abs() <= reach {
            return Ok(value);
        }
        let what = format!(
            "value {number} is {text} mm, the side has {} to {} mm there; write mm, from the centre \
             of the part",
            about - reach,
            about + reach
        );
        Err(TableProblem::at(self.line, what))
    }
}

impl SideTable {
    /// Reads a table: a header, then a line for each of `rows` positions with the position and the
    /// readings of the runs; further columns are ignored. `along` is the letter of the coordinate
    /// along the side; the header must not name the other one. Coordinates are those of the part,
    /// mm:
    /// positions within its side, each once, and readings within [`MAX_OFF`] of its nominal place
    /// at -80.
    ///
    /// # Errors
    /// The first of: a first line without names, a value that is missing or no number, a coordinate
    /// off the side, a position that is there twice, too few or too many lines.
    pub fn read(text: &str, along: char, runs: usize, rows: usize) -> Result<Self, TableProblem> {
        let lines = text.lines().enumerate();
        let mut lines = lines
            .map(|(index, line)| (index + 1, line))
            .filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
        let mut table = Self {
            positions: Vec::new(),
            runs: vec![Vec::new(); runs],
        };
        let mut places: Vec<usize> = Vec::new();
        let mut last = 0;
        if let Some((line, header)) = lines.next() {
            last = line;
            let first = header.split(',').next().unwrap_or_default();
            if first.trim().parse::<f64>().is_ok() {
                let what = "has numbers where the names of the columns belong; begin the table \
                            with a line as x_mm,y_run1_mm,y_run2_mm,y_run3_mm";
                return Err(TableProblem::at(line, what));
            }
            let letter = first
                .trim()
                .chars()
                .next()
                .map(|it| it.to_ascii_lowercase());
            if matches!(letter, Some('x' | 'y')) && letter != Some(along) {
                let what = format!(
                    "the first column is \"{}\" and the side is along {along}; exchange the files of \
                     the two sides",
                    first.trim()
                );
                return Err(TableProblem::at(line, what));
            }
        }
        for (line, text) in lines {
            last = line;
            let row = Row::new(line, text);
            let position = row.coordinate(0, 0.0, HALF_SIDE)?;
            let twice = table.positions.iter().zip(&places);
            let mut twice = twice.filter(|(at, _)| (position - **at).abs() < MIN_APART);
            if let Some((at, before)) = twice.next() {
                let what = format!(
                    "position {position} mm is less than {MIN_APART} mm from {at} mm in line \
                     {before}; give every position once"
                );
                return Err(TableProblem::at(line, what));
            }
            table.positions.push(position);
            places.push(line);
            for (run, readings) in table.runs.iter_mut().enumerate() {
                readings.push(row.coordinate(run + 1, -HALF_SIDE, MAX_OFF)?);
            }
            if table.positions.len() > rows {
                let what = format!("is row {} of {rows}; remove it", rows + 1);
                return Err(TableProblem::at(line, what));
            }
        }
        let found = table.positions.len();
        if found != rows {
            let what = format!(
                "the table has {found} of {rows} rows and ends here{}; probe the missing points \
                 again, the comparison needs all of them",
                widest_gap(&table.positions)
            );
            return Err(TableProblem::at(last, what));
        }
        Ok(table)
    }

    /// The table as text, for [`SideTable::read`]: columns as in the tables 4.1 and 4.2 of the
    /// thesis. `along` and `across` are the names of the coordinates.
    #[must_use]
    pub fn write(&self, along: &str, across: &str) -> String {
        let mut text = format!("{along}_mm");
        // Writing to a string does not fail.
        for run in 1..=self.runs.len() {
            let _ = write!(text, ",{across}_run{run}_mm");
        }
        let _ = writeln!(text, ",{across}_mean_mm");
        for (row, [at, mean]) in self.means().into_iter().enumerate() {
            let _ = write!(text, "{at}");
            for run in &self.runs {
                let _ = write!(text, ",{:.5}", run[row]);
            }
            let _ = writeln!(text, ",{mean:.5}");
        }
        text
    }

    /// Positions and means of the runs there.
    fn means(&self) -> Vec<[f64; 2]> {
        let count = self.runs.len() as f64;
        let rows = self.positions.iter().enumerate();
        let sum = |row: usize| self.runs.iter().map(|run| run[row]).sum::<f64>();
        rows.map(|(row, at)| [*at, sum(row) / count]).collect()
    }

    /// Residuals of the mean of the runs from its least squares line, mm: the straightness profile.
    #[must_use]
    pub fn profile(&self) -> Vec<f64> {
        fit_line(&self.means())
            .map(|line| line.residuals)
            .unwrap_or_default()
    }

    /// Slope of this line; 0 without one.
    #[must_use]
    pub fn slope(&self) -> f64 {
        fit_line(&self.means()).map_or(0.0, |line| line.slope)
    }
}

/// Names the largest gap between positions, if it is wider than others.
fn widest_gap(positions: &[f64]) -> String {
    let mut positions = positions.to_vec();
    positions.sort_by(f64::total_cmp);
    let mut gaps: Vec<[f64; 2]> = positions.windows(2).map(|two| [two[0], two[1]]).collect();
    let width = |gap: &[f64; 2]| gap[1] - gap[0];
    gaps.sort_by(|a, b| width(a).total_cmp(&width(b)));
    match (gaps.first(), gaps.last()) {
        (Some(min), Some(max)) if width(max) > 1.5 * width(min) => {
            format!("; its largest gap is from {} to {} mm", max[0], max[1])
        }
        _ => String::new(),
    }
}

/// Squareness of a side along y to one along x, radians, in the sign of `EC0Y`. It does not depend
/// on the set-up of the part.
#[must_use]
pub fn squareness([x, y]: &[SideTable; 2]) -> f64 {
    -(x.slope() + y.slope())
}

/// Level of significance of a correlation, two-tailed.
pub const SIGNIFICANCE: f64 = 0.05;

/// Runs and points of a side in the tables of the thesis.
pub const RUNS: usize = 3;
/// See [`RUNS`].
pub const POINTS: usize = 15;

/// The positions along a side, mm: the targets of the laser in the thesis.
#[must_use]
pub fn positions() -> Vec<f64> {
    even_nodes((-70.0, 70.0), POINTS)
}

/// A probed side of the square as a table: every run interpolated to [`positions`], linear also
/// beyond its ends. Side 0 is along x, side 3 along y.
#[must_use]
pub fn side_table(runs: &[Features<Vector>], side: usize) -> SideTable {
    let positions = positions();
    let along = usize::from(!side.is_multiple_of(2));
    let run = |points: &Features<Vector>| {
        let points = points.sides[side].iter();
        let mut pairs: Vec<[f64; 2]> = points
            .map(|point| [point[along], point[1 - along]])
            .collect();
        pairs.sort_by(|a, b| a[0].total_cmp(&b[0]));
        positions.iter().map(|at| linear(&pairs, *at)).collect()
    };
    SideTable {
        runs: runs.iter().map(run).collect(),
        positions,
    }
}

/// Linear interpolation between ascending points; the first and the last piece go on beyond them.
#[must_use]
pub fn linear(points: &[[f64; 2]], at: f64) -> f64 {
    let after = points.partition_point(|point| point[0] <= at);
    let last = points.len().saturating_sub(1);
    let upper = after.clamp(1.min(last), last);
    match (points.get(upper.saturating_sub(1)), points.get(upper)) {
        (Some([a, v]), Some([b, w])) if b > a => v + (at - a) / (b - a) * (w - v),
        (Some([_, v]), _) => *v,
        _ => 0.0,
    }
}

/// A probed side of the square.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Side B, at y = -80 mm.
    AlongX,
    /// Side L, at x = -80 mm.
    AlongY,
}

/// Height at which the sides are probed, mm.
const SIDE_HEIGHT: f64 = -30.0;

/// Straightness profile of a side that a machine with these errors cuts, by a model, mm.
#[must_use]
pub fn model_profile(errors: &ErrorSet, model: Model, positions: &[f64], side: Side) -> Vec<f64> {
    let off = |u: f64| match side {
        Side::AlongX => {
            model
                .error(errors, Vector::new(u, -HALF_SIDE, SIDE_HEIGHT))
                .y
        }
        Side::AlongY => {
            model
                .error(errors, Vector::new(-HALF_SIDE, u, SIDE_HEIGHT))
                .x
        }
    };
    let table = SideTable {
        positions: positions.to_vec(),
        runs: vec![positions.iter().map(|u| off(*u)).collect()],
    };
    table.profile()
}

/// Straightness of the two sides without some of the errors of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Omission {
    /// What is left out.
    pub name: &'static str,
    /// Straightness of the sides along x and along y, mm.
    pub straightness: [f64; 2],
}

/// Which errors the straightness of the sides depends on: the errors of a machine, with a kind of
/// them left out in turn.
#[must_use]
pub fn omissions(errors: &ErrorSet, model: Model) -> Vec<Omission> {
    let positions = positions();
    let bends = |function: Function| matches!(function.kind(), Kind::Pitch | Kind::Yaw);
    let mut level = errors.clone();
    for function in Function::all().filter(|function| bends(*function)) {
        let shape = errors.function(function);
        let values = positions.iter().map(|u| shape.value(*u, Approach::Any));
        let mean = values.sum::<f64>() / positions.len() as f64;
        level.set(function, less(shape, mean));
    }
    let without = |kind: Kind| errors.without(|function| function.kind() == kind);
    [
        ("all errors", errors.clone()),
        ("without positioning", without(Kind::Positioning)),
        ("without straightness", without(Kind::Straightness)),
        ("pitch and yaw less their means", level),
        ("without pitch", without(Kind::Pitch)),
        ("without yaw", without(Kind::Yaw)),
        (
            "without rotations",
            errors.without(|function| function.rotates),
        ),
    ]
    .map(|(name, errors)| Omission {
        name,
        straightness: [Side::AlongX, Side::AlongY]
            .map(|side| range(&model_profile(&errors, model, &positions, side))),
    })
    .into()
}

/// An error function less a constant.
fn less(shape: &Shape, by: f64) -> Shape {
    let moved = |values: &Vec<f64>| values.iter().map(|value| value - by).collect();
    match shape {
        Shape::Table(table) => Shape::Table(Table {
            nodes: table.nodes.clone(),
            up: moved(&table.up),
            down: table.down.as_ref().map(moved),
        }),
        Shape::ClosedForm(form) => Shape::ClosedForm(ClosedForm {
            mean: form.mean - by,
            ..*form
        }),
    }
}

/// Table 5.1 of the thesis: the straightness of side B (along x) and of side L (along y) by the
/// model with these errors, and by a measuring machine.
#[must_use]
pub fn table_5_1(errors: &ErrorSet, [x, y]: &[SideTable; 2]) -> Vec<Comparison> {
    let model = Model::default();
    let of_x = model_profile(errors, model, &x.positions, Side::AlongX);
    let of_y = model_profile(errors, model, &y.positions, Side::AlongY);
    let degree = choose_degree(&x.positions, &of_x, 5).map_or(3, |fit| fit.coefficients.len() - 1);
    let trend = Trend::Polynomial(degree);
    let lines = [
        compare("X", &x.positions, &of_x, &x.profile(), trend),
        compare("Y", &y.positions, &of_y, &y.profile(), Trend::Spline),
    ];
    lines.into_iter().flatten().collect()
}

/// Trend curve of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trend {
    /// Polynomial of this degree.
    Polynomial(usize),
    /// Natural cubic spline through the values.
    Spline,
}

/// One line of the comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Side.
    pub side: &'static str,
    /// Trend curve.
    pub trend: Trend,
    /// Part of the variance of the measured profile that the trend explains.
    pub r_squared: f64,
    /// Correlation, with its class.
    pub r: f64,
    /// See `r`.
    pub class: &'static str,
    /// Student's t of the correlation.
    pub t: f64,
    /// Probability of this t without a correlation, two-tailed.
    pub p: f64,
    /// Root mean square of the measured profile less the trend, mm.
    pub rmse: f64,
    /// Slope of the regression of the measured profile on the trend.
    pub slope: f64,
    /// Straightness of the measured profile, mm.
    pub straightness: f64,
}

impl Comparison {
    /// Whether the measuring machine is specified for a deviation as small as the straightness.
    #[must_use]
    pub fn is_measurable(&self) -> bool {
        self.straightness >= MPE_P
    }
}

/// Compares the profile of the model with a measured one at the same positions; `None` where no
/// trend curve fits, or with fewer than three points.
#[must_use]
pub fn compare(
    side: &'static str,
    positions: &[f64],
    model: &[f64],
    measured: &[f64],
    trend: Trend,
) -> Option<Comparison> {
    let curve: Vec<f64> = match trend {
        Trend::Polynomial(degree) => {
            let fitted = fit_polynomial(positions, model, degree)?;
            positions.iter().map(|u| fitted.value(*u)).collect()
        }
        Trend::Spline => {
            let mut order: Vec<usize> = (0..positions.len()).collect();
            order.sort_by(|a, b| positions[*a].total_cmp(&positions[*b]));
            let pick = |values: &[f64]| order.iter().map(|i| values[*i]).collect::<Vec<_>>();
            let spline = Spline::new(&pick(positions), &pick(model))?;
            positions.iter().map(|u| spline.value(*u)).collect()
        }
    };
    let r = pearson(&curve, measured);
    let count = positions.len();
    let pairs = || curve.iter().zip(measured);
    let squares: f64 = pairs().map(|(curve, read)| (read - curve).powi(2)).sum();
    let points: Vec<[f64; 2]> = pairs().map(|(curve, read)| [*curve, *read]).collect();
    let t = t_of_correlation(r, count);
    // Two points always correlate.
    let degrees = u32::try_from(count.checked_sub(2)?).ok()?;
    if degrees == 0 {
        return None;
    }
    Some(Comparison {
        side,
        trend,
        r_squared: r * r,
        r,
        class: class(r),
        t,
        p: p_of_t(t, degrees),
        rmse: (squares / count as f64).sqrt(),
        slope: fit_line(&points).map_or(0.0, |line| line.slope),
        straightness: range(measured),
    })
}

impl fmt::Display for Comparison {
    /// As table 5.1: direction, trend, R squared, class, t.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let trend = match self.trend {
            Trend::Polynomial(degree) => format!("polynomial of degree {degree}"),
            Trend::Spline => "cubic spline".to_string(),
        };
        let verdict = if self.p < SIGNIFICANCE { "" } else { "not " };
        let limit = if self.is_measurable() {
            String::new()
        } else {
            format!(", below MPE_P {:.1} um", MPE_P * 1e3)
        };
        write!(
            f,
            "{:<4} {trend:<24} R2 {:.2}  {:<9} t {:.2} p {:.1e} {verdict}significant; rmse {:.2} um, \
             slope {:.2}; straightness {:.2} um{limit}",
            self.side,
            self.r_squared,
            self.class,
            self.t,
            self.p,
            self.rmse * 1e3,
            self.slope,
            self.straightness * 1e3
        )
    }
}
