//! Trace: the polylines of one kind of motion.

/// Relative change of speed within which points of a straight motion are left out.
const SAME_SPEED: f64 = 1e-3;
/// Distance from a straight motion within which its points are left out, mm.
const STRAIGHT_MM: f64 = 1e-4;

/// A point of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// X, Y, Z of the tip in the workpiece, mm.
    pub place: [f64; 3],
    /// Speed of the tip, mm/s.
    pub speed: f64,
    pub time_s: f64,
    pub line: u32,
}

/// Polylines.
#[derive(Debug, Default)]
pub(crate) struct Trace {
    pub points: Vec<Point>,
    /// Index of the first point of each polyline.
    pub starts: Vec<u32>,
    is_open: bool,
}

impl Trace {
    /// Begins a polyline at a point, unless one is open.
    pub(crate) fn begin(&mut self, first: Point) {
        if !self.is_open {
            self.starts.push(self.points.len() as u32);
            self.points.push(first);
            self.is_open = true;
        }
    }

    pub(crate) fn end(&mut self) {
        self.is_open = false;
    }

    /// Adds a point. A straight motion at constant speed has only its ends.
    pub(crate) fn push(&mut self, point: Point) {
        let first = self.starts.last().map_or(0, |first| *first as usize);
        if let [.., before, last] = self.points[first..]
            && before.line == last.line
            && last.line == point.line
            && is_between(&before, &last, &point)
        {
            self.points.pop();
        }
        self.points.push(point);
    }
}

fn is_between(before: &Point, last: &Point, next: &Point) -> bool {
    let span = next.time_s - before.time_s;
    if span <= 0.0 {
        return false;
    }
    let part = (last.time_s - before.time_s) / span;
    let mixed = |from: f64, to: f64| from + part * (to - from);
    let speed = mixed(before.speed, next.speed);
    (last.speed - speed).abs() <= SAME_SPEED * speed.max(1e-3)
        && (0..3)
            .all(|k| (last.place[k] - mixed(before.place[k], next.place[k])).abs() <= STRAIGHT_MM)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, speed: f64, time_s: f64) -> Point {
        Point {
            place: [x, 0.0, 0.0],
            speed,
            time_s,
            line: 1,
        }
    }

    #[test]
    fn a_straight_motion_at_constant_speed_keeps_its_ends() {
        let mut trace = Trace::default();
        trace.begin(point(0.0, 10.0, 0.0));
        for k in 1..=5 {
            let t = f64::from(k) * 0.1;
            trace.push(point(10.0 * t, 10.0, t));
        }
        assert_eq!(trace.points, [point(0.0, 10.0, 0.0), point(5.0, 10.0, 0.5)]);
        trace.push(point(5.5, 0.0, 0.6));
        assert_eq!(trace.points.len(), 3, "the speed changes");
        trace.end();
        trace.begin(point(5.5, 0.0, 0.9));
        trace.push(point(6.0, 1.0, 1.0));
        assert_eq!(trace.starts, [0, 3]);
    }
}
