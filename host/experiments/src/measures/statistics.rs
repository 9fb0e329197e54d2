//! Statistics of a quantity over time. Without values a statistic is not a number.

/// Time and value.
pub(super) type Point = (f64, f64);

pub(super) fn mean(values: &[Point]) -> f64 {
    values.iter().map(|(_, value)| value).sum::<f64>() / values.len() as f64
}

pub(super) fn largest(values: &[Point]) -> f64 {
    values.iter().map(|(_, v)| *v).fold(f64::NAN, f64::max)
}

pub(super) fn smallest(values: &[Point]) -> f64 {
    values.iter().map(|(_, v)| *v).fold(f64::NAN, f64::min)
}

pub(super) fn slope(values: &[Point]) -> f64 {
    let map = |value: &dyn Fn(Point) -> f64| -> f64 {
        let mapped: Vec<Point> = values
            .iter()
            .map(|point| (point.0, value(*point)))
            .collect();
        mean(&mapped)
    };
    let (time, value) = (map(&|point| point.0), mean(values));
    let products = map(&|point| (point.0 - time) * (point.1 - value));
    products / map(&|point| (point.0 - time) * (point.0 - time))
}

pub(super) fn first_time(values: &[Point], condition: impl Fn(f64) -> bool) -> f64 {
    let first = values.iter().find(|(_, value)| condition(*value));
    first.map_or(f64::NAN, |(time, _)| *time)
}

/// Time in which the values rise from 10 to 90 % of the way from the first to the largest one.
pub(super) fn change_time(values: &[Point]) -> f64 {
    let start = values.first().map_or(f64::NAN, |(_, value)| *value);
    let way = largest(values) - start;
    let reach = |part: f64| first_time(values, |value| value >= start + part * way);
    reach(0.9) - reach(0.1)
}

/// Time of the largest value times a sign.
pub(super) fn time_of_max(values: &[Point], sign: f64) -> f64 {
    let best = values
        .iter()
        .max_by(|a, b| (sign * a.1).total_cmp(&(sign * b.1)));
    best.map_or(f64::NAN, |(time, _)| *time)
}

/// Largest value; not a number when one of them is not, or there is none.
pub(super) fn worst(values: impl Iterator<Item = f64>) -> f64 {
    let larger = |a: f64, b: f64| if a >= b || a.is_nan() { a } else { b };
    values.reduce(larger).unwrap_or(f64::NAN)
}
