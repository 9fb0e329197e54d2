//! The curves of a pass that a hand led: hand and tool, forces, what is reflected.

use super::page::{card, over};
use super::{Cut, Pass};
use haptimill_client::session::HapticTraceSample;
use haptimill_report::chart::{COLOURS, Line, escape};
use haptimill_report::series::Columns;

const AXES: [&str; 3] = ["X", "Y", "Z"];
/// The hand's time, which is not that of the way: it holds before the tool moves, and after.
const SINCE: &str = "time since the hand took over, s";
const WANTED: &str = "#b7c0ca";

fn line(
    samples: &[HapticTraceSample],
    label: &str,
    (colour, width): (&'static str, f64),
    value: impl Fn(&HapticTraceSample) -> f64,
) -> Line {
    let begin = samples.first().map_or(0.0, |sample| sample.time);
    let end = samples.last().map_or(1.0, |sample| sample.time);
    let mut columns = Columns::new(begin, end);
    for sample in samples {
        columns.add(sample.time, value(sample));
    }
    let mut pieces = columns.line();
    for point in pieces.iter_mut().flatten() {
        point.0 += begin;
    }
    Line {
        label: label.to_string(),
        colour,
        width,
        pieces,
    }
}

/// The curves of the hand in a pass; nothing when no hand led it.
pub(super) fn curves(page: &mut String, pass: &Pass, cut: &Cut) {
    let (Some(led), Some(course)) = (&pass.led, &cut.hand) else {
        return;
    };
    let samples = &course.samples[..];
    let title = match pass.title {
        "" => "The hand".to_string(),
        title => format!("The hand, {}", escape(title)),
    };
    page.push_str(&format!("<h2>{title}</h2>"));
    let axes = if led.axes.is_empty() {
        &[0][..]
    } else {
        led.axes
    };
    let mut lines = Vec::new();
    for axis in axes.iter().map(|axis| usize::from(*axis)) {
        let name = AXES[axis];
        let thin = (COLOURS[axis], 1.4);
        let hand = line(
            samples,
            &format!("{name} of the hand"),
            (WANTED, 4.0),
            |s| s.hand[axis],
        );
        lines.push(hand);
        if !led.axes.is_empty() {
            lines.push(line(samples, &format!("{name} of the tool"), thin, |s| {
                s.tool[axis]
            }));
        }
    }
    card(
        page,
        "Tip of the handle, and the tool, from where they were when the hand took over",
        &over(SINCE, "way, mm", lines, 290.0, true),
    );
    let reflected = (0..3)
        .filter(|axis| led.reflect[*axis].0 > 0 || led.wall_mm_s.is_some() && *axis == 0)
        .map(|axis| {
            let label = format!("along {}", AXES[axis]);
            line(samples, &label, (COLOURS[axis], 1.4), |s| s.reflected[axis])
        })
        .collect();
    card(
        page,
        "What the motors of the haptic arm push at the handle",
        &over(SINCE, "force, N", reflected, 250.0, true),
    );
    let along = |axis: usize| move |s: &HapticTraceSample| s.push[axis];
    let push = axes
        .iter()
        .map(|axis| usize::from(*axis))
        .map(|axis| {
            let label = format!("along {}", AXES[axis]);
            line(samples, &label, (COLOURS[axis], 1.4), along(axis))
        })
        .collect();
    card(
        page,
        "What the hand pushes, friction of the arm included",
        &over(SINCE, "force, N", push, 220.0, true),
    );
}
