//! Table for the terminal.

use super::ExperimentResult;
use super::comparison::Comparison;
use super::expected::{Band, ExpectedSource};
use std::fmt::Write as _;

/// Formats a value for the tables.
pub(super) fn value(number: f64) -> String {
    match number.abs() {
        _ if !number.is_finite() => "none".to_string(),
        large if large >= 100.0 => format!("{number:.0}"),
        middle if middle >= 10.0 => format!("{number:.1}"),
        middle if middle >= 1.0 => format!("{number:.2}"),
        // A value rounded to zero has no sign.
        small if small < 0.0005 => "0.000".to_string(),
        _ => format!("{number:.3}"),
    }
}

/// Formats a band with its unit and origin.
pub(super) fn band(band: &Band, unit: &str) -> String {
    let space = if unit.is_empty() { "" } else { " " };
    // The band of the incline has many digits.
    let short = |end: f64| (end * 1e4).round() / 1e4;
    let shown = Band {
        low: band.low.map(short),
        high: band.high.map(short),
        ..*band
    };
    format!("{shown}{space}{unit} ({})", band.source)
}

/// Whether a result is inside its band, for the tables.
pub(super) const fn verdict(comparison: &Comparison) -> &'static str {
    if comparison.is_inside {
        "inside"
    } else {
        "OUTSIDE"
    }
}

/// Formats all results; ends with a line feed.
#[must_use]
pub fn table(results: &[ExperimentResult]) -> String {
    let mut rows = Vec::new();
    let mut reasons = Vec::new();
    for result in results {
        if let Some(why) = &result.not_run {
            rows.push([
                result.name.clone(),
                result.title.clone(),
                String::new(),
                String::new(),
                String::new(),
                format!("not run: {why}"),
            ]);
        }
        for comparison in &result.comparisons {
            let mut last = verdict(comparison).to_string();
            if let Some(reason) = &comparison.reason {
                let known = reasons.iter().position(|known| known == reason);
                let number = known.unwrap_or_else(|| {
                    reasons.push(reason.clone());
                    reasons.len() - 1
                });
                let _ = write!(last, " [{}]", number + 1);
            }
            let space = if comparison.unit.is_empty() { "" } else { " " };
            rows.push([
                result.name.clone(),
                comparison.name.clone(),
                comparison.thesis.clone(),
                band(&comparison.band, &comparison.unit),
                format!("{}{space}{}", value(comparison.simulated), comparison.unit),
                last,
            ]);
        }
    }
    let heading = ["", "result", "thesis", "band", "simulated", ""].map(String::from);
    let mut widths = [0; 6];
    for row in rows.iter().chain([&heading]) {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = cell.chars().count().max(*width);
        }
    }
    let mut text = String::new();
    for row in [&heading].into_iter().chain(&rows) {
        let mut line = String::new();
        for (width, cell) in widths.iter().zip(row) {
            let _ = write!(line, "{cell:<width$}  ");
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    for (index, reason) in reasons.iter().enumerate() {
        let _ = writeln!(text, "[{}] {reason}", index + 1);
    }
    text.push_str(&counts(results));
    text
}

/// Counts of the results inside their bands, a line each: stated and derived ones of the
/// experiments of the fit and of the others, those that are inputs, and all others by their source.
/// Each line ends with a line feed.
pub(super) fn counts(results: &[ExperimentResult]) -> String {
    let mut text = String::new();
    let not_run = results.iter().filter(|result| result.not_run.is_some());
    let sum = |counts: &mut dyn Iterator<Item = (usize, usize)>| {
        counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    };
    let of = |keep: &dyn Fn(&ExperimentResult) -> bool, source| {
        let kept = results.iter().filter(|result| keep(result));
        sum(&mut kept.map(|result| result.count_of(source)))
    };
    for (title, fitted) in [("fitted", true), ("held out of the fit", false)] {
        let [stated, derived] = [ExpectedSource::Stated, ExpectedSource::Derived]
            .map(|source| of(&|r| r.fitted == fitted, source));
        if stated.1 + derived.1 > 0 {
            let _ = writeln!(
                text,
                "{title}: {} of {} stated, {} of {} derived",
                stated.0, stated.1, derived.0, derived.1
            );
        }
    }
    let (inputs, all) = sum(&mut results.iter().map(ExperimentResult::count_of_inputs));
    if all > 0 {
        let _ = writeln!(text, "chosen by input: {inputs} of {all}");
    }
    let [stated, derived, own] = [
        ExpectedSource::Stated,
        ExpectedSource::Derived,
        ExpectedSource::Own,
    ]
    .map(|source| of(&|_| true, source));
    let _ = write!(
        text,
        "inside: {} of {} stated, {} of {} derived, {} of {} own",
        stated.0, stated.1, derived.0, derived.1, own.0, own.1
    );
    match not_run.count() {
        0 => text.push('\n'),
        count => {
            let plural = if count == 1 { "" } else { "s" };
            let _ = writeln!(text, ", {count} experiment{plural} not run");
        }
    }
    text
}
