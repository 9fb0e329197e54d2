//! Comparison of the model with a measured side of the part, in the form of the thesis's table 5.1.

use crate::statistics::{Spline, class, fit_polynomial, pearson, t_of_correlation};
use haptimill_volumetric::gdt::fit_line;
use std::fmt;

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

impl SideTable {
    /// Reads a table: a header, then a line for each of `rows` positions with the position and the
    /// readings of the runs; further columns are ignored.
    ///
    /// # Errors
    /// Missing lines or values, and what is no number.
    pub fn read(text: &str, runs: usize, rows: usize) -> Result<Self, TableProblem> {
        let lines = text.lines().enumerate();
        let lines = lines.filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
        let mut table = Self {
            positions: Vec::new(),
            runs: vec![Vec::new(); runs],
        };
        for (index, line) in lines.skip(1) {
            let line_number = index + 1;
            let values: Vec<&str> = line.split(',').map(str::trim).collect();
            let value = |column: usize| {
                let text = values.get(column).copied().unwrap_or_default();
                let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
                value.ok_or_else(|| TableProblem {
                    line: line_number,
                    what: format!(
                        "value {} is \"{text}\" and no number; probe the point again",
                        column + 1
                    ),
                })
            };
            table.positions.push(value(0)?);
            for run in 0..runs {
                let reading = value(run + 1)?;
                table.runs[run].push(reading);
            }
        }
        let found = table.positions.len();
        if found != rows {
            let what = format!(
                "has {found} of {rows} rows; probe the missing points again, the comparison needs \
                 all of them"
            );
            return Err(TableProblem { line: 0, what });
        }
        Ok(table)
    }

    /// Residuals of the mean of the runs from its least squares line, mm: the straightness profile.
    #[must_use]
    pub fn profile(&self) -> Vec<f64> {
        let count = self.runs.len() as f64;
        let points: Vec<[f64; 2]> = self
            .positions
            .iter()
            .enumerate()
            .map(|(row, at)| {
                [
                    *at,
                    self.runs.iter().map(|run| run[row]).sum::<f64>() / count,
                ]
            })
            .collect();
        fit_line(&points)
            .map(|line| line.residuals)
            .unwrap_or_default()
    }
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
}

/// Compares the profile of the model with a measured one at the same ascending positions; `None`
/// where no trend curve fits.
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
    Some(Comparison {
        side,
        trend,
        r_squared: r * r,
        r,
        class: class(r),
        t: t_of_correlation(r, positions.len()),
    })
}

impl fmt::Display for Comparison {
    /// As table 5.1: direction, trend, R squared, class, t.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let trend = match self.trend {
            Trend::Polynomial(degree) => format!("polynomial of degree {degree}"),
            Trend::Spline => "cubic spline".to_string(),
        };
        write!(
            f,
            "{:<4} {trend:<24} R2 {:.2}  {:<9} t {:.2}",
            self.side, self.r_squared, self.class, self.t
        )
    }
}
