//! Plots of the columns of a recording over time: SVG images, and sketches on the terminal.

use super::chart::{COLOURS, Chart, Line, document};
use super::series::Columns;
use haptimill_protocol::message::State;
use haptimill_trace::{Column, Recording, RecordingError, Thinning};
use std::fmt::Write as _;

/// Lines per chart.
const LINES: usize = 6;
const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 300.0;

/// Column with names instead of numbers.
const STATE: &str = "state";

/// Unit of a column; columns with the same unit share a chart.
fn unit_of(column: &Column) -> &'static str {
    if column.name == STATE {
        STATE
    } else {
        column.unit
    }
}

/// Columns of a recording, thinned to the resolution of a chart without loss of peaks.
pub struct Plot {
    from_s: f64,
    to_s: f64,
    columns: Vec<(Column, Columns)>,
}

impl Plot {
    /// Reads columns between two times, in s since the first record; `to_s` can be infinite.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn of(
        recording: &Recording,
        columns: &[Column],
        thinning: &Thinning,
    ) -> Result<Self, RecordingError> {
        let mut end = 0.0;
        if thinning.to_s.is_finite() {
            end = thinning.to_s;
        } else if let Some(first) = recording.iter()?.next() {
            let last = recording.last()?.map_or(0, |record| record.period);
            end = last.saturating_sub(first?.period) as f64 * recording.period_s();
        }
        let end = end.max(thinning.from_s + recording.period_s());
        let mut plot = Self {
            from_s: thinning.from_s,
            to_s: end,
            columns: columns
                .iter()
                .map(|column| {
                    (
                        column.clone(),
                        Columns::new(thinning.from_s, end * (1.0 + 1e-12)),
                    )
                })
                .collect(),
        };
        thinning.apply(recording, |record, time_s| {
            for (column, series) in &mut plot.columns {
                if let Some(value) = column.value(record, time_s) {
                    series.add(time_s, value.number());
                }
            }
            Ok(())
        })?;
        Ok(plot)
    }

    /// Whether no column has a value.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.columns
            .iter()
            .all(|(_, series)| series.line().is_empty())
    }

    /// SVG image with a chart for each unit.
    #[must_use]
    pub fn svg(&self) -> String {
        let mut units: Vec<&'static str> = Vec::new();
        for (column, _) in &self.columns {
            if !units.contains(&unit_of(column)) {
                units.push(unit_of(column));
            }
        }
        let states = State::ALL.map(|state| format!("{state:?}"));
        let mut charts = Vec::new();
        for unit in units {
            let of_unit = self.columns.iter();
            let of_unit: Vec<_> = of_unit
                .filter(|(column, _)| unit_of(column) == unit)
                .collect();
            let names = if unit == STATE { &states[..] } else { &[] };
            let chunks = of_unit.chunks(LINES);
            charts.extend(chunks.map(|chunk| (self.chart(unit, chunk), names)));
        }
        document(&charts, WIDTH, HEIGHT)
    }

    fn chart(&self, unit: &str, columns: &[&(Column, Columns)]) -> Chart {
        let lines = columns
            .iter()
            .zip(COLOURS)
            .map(|((column, series), colour)| Line {
                label: column.name.clone(),
                colour,
                width: 1.3,
                pieces: series.line(),
            });
        Chart {
            x_label: if self.from_s > 0.0 {
                format!("time after {} s, s", self.from_s)
            } else {
                "time, s".to_string()
            },
            y_label: match unit {
                "n" => "N".to_string(),
                "n_m" => "N m".to_string(),
                "rpm" => "rev/min".to_string(),
                other => other.to_string(),
            },
            lines: lines.collect(),
            width: WIDTH,
            height: HEIGHT,
            equal: false,
            from_zero: false,
            backdrop: None,
        }
    }

    /// Sketch of each column on the terminal in Braille dots, `width` by `height` characters: the
    /// largest and the smallest value at a vertical axis, and a dotted line at zero.
    #[must_use]
    pub fn sketch(&self, width: usize, height: usize) -> String {
        let mut text = String::new();
        for (column, series) in &self.columns {
            let line = series.line();
            let points = line.iter().flatten();
            let (low, high) = points.fold(
                (f64::INFINITY, f64::NEG_INFINITY),
                |(low, high), (_, value)| (low.min(*value), high.max(*value)),
            );
            // Writing to a string cannot fail.
            if low > high {
                let _ = writeln!(text, "{}: no values", column.name);
                continue;
            }
            let _ = writeln!(
                text,
                "{}: {low:.4} to {high:.4}, from {:.3} to {:.3} s",
                column.name, self.from_s, self.to_s
            );
            let (top, bottom) = (format!("{high:.4}"), format!("{low:.4}"));
            let label = top.len().max(bottom.len());
            let mut dots = Dots::new(width.saturating_sub(label + 2).max(1), height.max(1));
            let (span, rise) = (self.to_s - self.from_s, (high - low).max(1e-12));
            let place = |(time, value): (f64, f64)| {
                let x = (time / span * dots.columns() as f64) as usize;
                let y = (high - value) / rise * (dots.rows() - 1) as f64;
                (x.min(dots.columns() - 1), y.round() as usize)
            };
            let pieces: Vec<Vec<(usize, usize)>> = line
                .iter()
                .map(|piece| piece.iter().map(|point| place(*point)).collect())
                .collect();
            let zero = (low < 0.0 && high > 0.0).then(|| place((0.0, 0.0)).1);
            if let Some(row) = zero {
                dots.dotted(row);
            }
            for piece in pieces {
                dots.line(&piece);
            }
            let rows = dots.text();
            for (index, row) in rows.lines().enumerate() {
                let value = match index {
                    0 => top.as_str(),
                    _ if index + 1 == height => bottom.as_str(),
                    _ if zero.is_some_and(|row| row / 4 == index) => "0",
                    _ => "",
                };
                let _ = writeln!(text, "{value:>label$} │{row}");
            }
        }
        text
    }
}

/// Field of dots, eight per character.
struct Dots {
    width: usize,
    cells: Vec<u8>,
}

impl Dots {
    fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            cells: vec![0; width * height],
        }
    }

    fn columns(&self) -> usize {
        2 * self.width
    }

    fn rows(&self) -> usize {
        4 * self.cells.len() / self.width
    }

    fn set(&mut self, x: usize, y: usize) {
        /// Bits of the dots of a character, by column and row.
        const BITS: [[u8; 4]; 2] = [[1, 2, 4, 64], [8, 16, 32, 128]];
        if let Some(cell) = self.cells.get_mut(y / 4 * self.width + x / 2) {
            *cell |= BITS[x % 2][y % 4];
        }
    }

    /// Draws a dotted line in a row.
    fn dotted(&mut self, row: usize) {
        for x in (0..self.columns()).step_by(4) {
            self.set(x, row);
        }
    }

    /// Draws a line through points; x must not decrease.
    fn line(&mut self, points: &[(usize, usize)]) {
        let mut before = points.first().copied().unwrap_or_default();
        for &(x, y) in points {
            let steps = x.abs_diff(before.0).max(y.abs_diff(before.1)).max(1);
            for step in 0..=steps {
                let between = |from: usize, to: usize| {
                    let part = step as f64 / steps as f64;
                    (from as f64 + (to as f64 - from as f64) * part).round() as usize
                };
                self.set(between(before.0, x), between(before.1, y));
            }
            before = (x, y);
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        for row in self.cells.chunks(self.width) {
            let row: String = row
                .iter()
                .filter_map(|dots| char::from_u32(0x2800 + u32::from(*dots)))
                .collect();
            text += row.trim_end_matches('\u{2800}');
            text.push('\n');
        }
        text
    }
}
