//! Thinning of a recording to the resolution of a chart, without loss of peaks.

/// Extremes of a quantity in equal intervals of time.
pub struct Columns {
    begin: f64,
    width: f64,
    columns: Vec<Option<[f64; 2]>>,
    /// Time of the last value, and the smallest time between two values.
    last: Option<f64>,
    spacing: f64,
}

/// A longer gap, in spacings of the values, interrupts the line; a few lost reports do not.
const BRIDGED: f64 = 4.0;

/// Intervals per chart.
const COLUMNS: usize = 700;

impl Columns {
    /// Empty intervals from `begin` to `end`, in s.
    pub fn new(begin: f64, end: f64) -> Self {
        Self {
            begin,
            width: ((end - begin) / COLUMNS as f64).max(1e-12),
            columns: vec![None; COLUMNS],
            last: None,
            spacing: f64::INFINITY,
        }
    }

    /// Adds a value; a value outside the time range is ignored.
    pub fn add(&mut self, time: f64, value: f64) {
        let column = (time - self.begin) / self.width;
        if !value.is_finite() || column < 0.0 {
            return;
        }
        if let Some(last) = self.last.replace(time)
            && time > last
        {
            self.spacing = self.spacing.min(time - last);
        }
        if let Some(column) = self.columns.get_mut(column as usize) {
            let [low, high] = column.get_or_insert([value; 2]);
            *low = low.min(value);
            *high = high.max(value);
        }
    }

    /// Largest magnitude of all values.
    pub fn largest(&self) -> f64 {
        let all = self.columns.iter().flatten().flatten();
        all.fold(0.0, |max, value| max.max(value.abs()))
    }

    /// Line through the extremes, interrupted where values are missing. Times count from `begin`.
    pub fn line(&self) -> Vec<Vec<(f64, f64)>> {
        let mut pieces: Vec<Vec<(f64, f64)>> = Vec::new();
        let bridged = (BRIDGED * self.spacing / self.width).max(1.0);
        let mut before: Option<usize> = None;
        for (index, column) in self.columns.iter().enumerate() {
            let Some([low, high]) = *column else {
                continue;
            };
            let near = |before: usize| (index - before) as f64 <= bridged;
            if !before.replace(index).is_some_and(near) {
                pieces.push(Vec::new());
            }
            let Some(piece) = pieces.last_mut() else {
                continue;
            };
            let time = (index as f64 + 0.5) * self.width;
            // The nearer end is first, so that the line does not cross itself.
            let before = piece.last().map_or(low, |(_, value)| *value);
            let ends = if (before - low).abs() <= (before - high).abs() {
                [low, high]
            } else {
                [high, low]
            };
            piece.push((time, ends[0]));
            if low != high {
                piece.push((time, ends[1]));
            }
        }
        pieces
    }
}

/// Points of a path at a spacing, and between two of them the one with the largest error.
pub struct PathPoints {
    spacing: f64,
    last: Option<[f64; 3]>,
    best: Option<(f64, [[f64; 3]; 2])>,
    /// Programmed point and tool.
    pub points: Vec<[[f64; 3]; 2]>,
}

impl PathPoints {
    /// An empty path; its points will be `spacing` mm apart.
    pub fn new(spacing: f64) -> Self {
        Self {
            spacing,
            last: None,
            best: None,
            points: Vec::new(),
        }
    }

    /// Adds a programmed point and the position of the tool at the same time.
    pub fn add(&mut self, programmed: [f64; 3], tool: [f64; 3]) {
        let pair = [programmed, tool];
        let error = super::contour::distance(&programmed, &tool);
        if self.best.is_none_or(|(max, _)| error > max) {
            self.best = Some((error, pair));
        }
        let far = |last: [f64; 3]| {
            super::contour::distance(&last, &programmed) >= self.spacing
                || super::contour::distance(&last, &tool) >= 4.0 * self.spacing
        };
        if self.last.is_none_or(far) {
            let best = self.best.take().map(|(_, pair)| pair);
            self.points.extend(best.filter(|best| *best != pair));
            self.points.push(pair);
            self.last = Some(programmed);
        }
    }
}
