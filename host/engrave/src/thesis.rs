//! The experiments of the thesis, repeated: inputs, and a table of stated and found results.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002 (tables and
//! figures by its numbers), with its paper of IEEE ISIC 2002. The drawings of its cutting tests are
//! lost; shapes of the same kind stand in for them.

mod inputs;
mod stated;

pub use inputs::{
    FIGURE_4_10, Text, closed, drawing, figure_4_8, five_squares, hatch, outlines, pockets,
    polygon, rectangle,
};

use crate::drawing::Drawing;
use crate::geometry::{Path, Point, distance};
use crate::job::{Options, Ordering, plan};
use crate::order::edges::{Condition, Ends, analyse, order};
use crate::order::rows::{Line, Totals, contours, totals, zigzag};
use crate::toolpath::PathStep;
use inputs::lines_of_figure_4_8;
use serde::Serialize;
use stated::{CuttingTest, ExpectedPocket, PaperJob, Stated};

/// Where every job begins and ends.
pub const REFERENCE: Point = [0.0, 0.0];

/// Diameter of the cutter of the pockets, mm.
pub const TOOL: f64 = 0.9;

/// Feed of all tests, mm/s; lifted moves have the same.
pub const FEED: f64 = 5.0;

/// Time of a lift and a plunge, s: 2 mm up and down at 1 mm/s. The thesis does not state it.
pub const LIFT_S: f64 = 4.0;

/// Totals of a pocket without and with the analysis of section 4.2.2.
#[must_use]
pub fn pocket(loops: &[Vec<Point>]) -> (usize, Totals, Totals) {
    let rows = hatch(loops);
    let outlines: Vec<Vec<Line>> = loops.iter().map(|one| polygon(one)).collect();
    let plain: Vec<Line> = outlines.iter().flatten().chain(&rows).copied().collect();
    let mut analysed = zigzag(&rows, REFERENCE);
    let last = analysed.last().map_or(REFERENCE, |line| line[1]);
    analysed.extend(contours(&outlines, last));
    let anywhere = |_: Point, _: Point| true;
    (
        rows.len(),
        totals(&plain, REFERENCE, None, &anywhere),
        totals(&analysed, REFERENCE, Some(TOOL), &anywhere),
    )
}

/// Part of the time that the analysis saves, percent, at 5 mm/s and 4 s a lift.
#[must_use]
pub fn saved(before: &Totals, after: &Totals) -> f64 {
    saved_with(before, after, LIFT_S)
}

/// Part of the time that the analysis saves, percent, at 5 mm/s and this time of a lift, s.
#[must_use]
pub fn saved_with(before: &Totals, after: &Totals, lift_s: f64) -> f64 {
    let time = |one: &Totals| (one.cut_mm + one.air_mm) / FEED + one.lifts as f64 * lift_s;
    100.0 * (1.0 - time(after) / time(before))
}

/// How a result compares with the stated one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It is the stated one.
    Agrees,
    /// The drawing of the thesis is lost: the result of another shape is close, see [`of_kind`].
    SameKind,
    /// It is another one; the reason says why.
    Differs,
}

/// Largest difference of the time saved by a shape of the same kind, percentage points.
pub const KIND: f64 = 8.0;

/// A result of an experiment beside that of the thesis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Section of the thesis.
    pub section: &'static str,
    /// What is compared.
    pub what: String,
    /// As the thesis prints it.
    pub stated: String,
    /// As found here.
    pub ours: String,
    /// Whether both agree.
    pub verdict: Verdict,
    /// Why not, or what differs between the experiments.
    pub reason: &'static str,
}

/// Agrees or differs.
const fn equal(agrees: bool) -> Verdict {
    if agrees {
        Verdict::Agrees
    } else {
        Verdict::Differs
    }
}

/// The verdict on the time that another shape saves, percent: within [`KIND`] points, and between
/// half and twice the stated one, so that a small one can differ, too.
#[must_use]
pub fn of_kind(stated: f64, ours: f64) -> Verdict {
    if (stated - ours).abs() <= KIND && (0.5..=2.0).contains(&(ours / stated)) {
        Verdict::SameKind
    } else {
        Verdict::Differs
    }
}

const ROUNDED: &str = "the printed total is a sum of rounded legs; the order is that of the text";
const STANDS_IN: &str = "the drawing is lost, a shape of its kind stands in; 4 s a lift, which the \
                         thesis does not state";
const LETTERS: &str = "the drawing is lost; the text in a free font of the same kind stands in. What the \
                       conditions save depends on where the font begins its contours; 4 s a lift";
const FROM_RULES: &str = "computed from the rules of section 4.2; the thesis prints no lengths";

/// Largest distance of the cuts of a job from the entities of its drawing, and of these from the
/// cuts, mm.
fn deviation(drawing: &Drawing, ordering: Ordering) -> Option<f64> {
    let options = Options {
        ordering,
        ..Options::default()
    };
    let job = plan(drawing, &options).ok()?;
    let mut cuts = Vec::new();
    for cut in &job.toolpath.cuts {
        for step in &cut.steps {
            if let PathStep::Along(segment, _) = step {
                cuts.push(Path::from_segments(&[*segment], 0));
            }
        }
    }
    let points = |paths: &[Path]| -> Vec<Point> {
        let segments = paths.iter().flat_map(Path::segments);
        segments
            .flat_map(|one| (0..=16).map(move |k| one.point(f64::from(k) / 16.0)))
            .collect()
    };
    let (a, b) = (points(&cuts), points(&drawing.paths));
    let far = |from: &[Point], to: &[Point]| {
        let nearest = |at: &Point| to.iter().map(|one| distance(*at, *one)).fold(1e9, f64::min);
        from.iter().map(nearest).fold(0.0, f64::max)
    };
    Some(far(&a, &b).max(far(&b, &a)))
}

/// Repeats the experiments.
///
/// # Errors
/// The mistake in the built-in numbers of the thesis; none is known.
pub fn rows() -> Result<Vec<Row>, String> {
    let stated = Stated::read()?;
    let mut rows = Vec::new();
    let drawing = figure_4_8();
    for (name, ordering) in [("without", Ordering::File), ("with", Ordering::Greedy)] {
        let off = deviation(&drawing, ordering).unwrap_or(f64::INFINITY);
        rows.push(Row {
            section: "5.1",
            what: format!("path {name} analysis against the drawing, figure 4.8"),
            stated: "equal".into(),
            ours: format!("{off:.4} mm"),
            verdict: equal(off < 1e-9),
            reason: "",
        });
    }
    for (name, loops) in ["S1", "S2", "S3"].into_iter().zip(pockets()) {
        let sorted = |rows: &[Line]| {
            // A row is the same in either direction.
            let mut rows: Vec<Line> = rows.to_vec();
            for row in &mut rows {
                row.sort_by(|a, b| a[0].total_cmp(&b[0]));
            }
            rows.sort_by(|a, b| {
                a[0][1]
                    .total_cmp(&b[0][1])
                    .then(a[0][0].total_cmp(&b[0][0]))
            });
            rows
        };
        let drawn = hatch(&loops);
        let same = sorted(&drawn) == sorted(&zigzag(&drawn, REFERENCE));
        rows.push(Row {
            section: "5.1",
            what: format!("rows with analysis against those of the drawing, {name}"),
            stated: "equal".into(),
            ours: if same { "equal" } else { "other rows" }.into(),
            verdict: equal(same),
            reason: "",
        });
    }
    let commands = lines_of_figure_4_8();
    let printed = stated.figure_4_8_air_mm;
    for (condition, stated) in Condition::ALL.into_iter().zip(printed) {
        let air = order(&commands, condition, REFERENCE).air_mm;
        let agrees = (air - stated).abs() < 0.5;
        rows.push(Row {
            section: "4.2.1",
            what: format!("air of figure 4.8, {}", condition.name()),
            stated: format!("{stated:.0} mm"),
            ours: format!("{air:.3} mm"),
            verdict: equal(agrees),
            reason: if agrees { "" } else { ROUNDED },
        });
    }
    let best = analyse(&commands, REFERENCE);
    rows.push(Row {
        section: "4.2.1",
        what: "chosen order of figure 4.8".into(),
        stated: "condition 2, lines 1 2 4 3".into(),
        ours: format!(
            "{}, lines {}",
            best.condition.name(),
            best.order
                .iter()
                .map(|k| (k + 1).to_string())
                .collect::<Vec<_>>()
                .join(" ")
        ),
        verdict: equal(best.condition == Condition::FirstLift && best.order == [0, 1, 3, 2]),
        reason: "",
    });
    // Time that the analysis of edges saves, percent.
    let edges = |commands: &[Ends]| {
        let total = |order: &[usize]| {
            let lines: Vec<Line> = order
                .iter()
                .map(|&k| [commands[k].start, commands[k].end])
                .collect();
            totals(&lines, REFERENCE, None, &|_, _| true)
        };
        let file = order(commands, Condition::File, REFERENCE).order;
        saved(&total(&file), &total(&analyse(commands, REFERENCE).order))
    };
    let squares = five_squares();
    let found = pockets().map(|loops| pocket(&loops));
    let percent = |k: usize| saved(&found[k].1, &found[k].2);
    let texts = Text::all()?;
    let of_text = |text: &Option<String>, height: Option<f64>| {
        let text = texts.iter().find(|one| Some(&one.text) == text.as_ref())?;
        let height = height?;
        let shape = format!("{} in {}, {height} mm", text.text, text.font);
        Some((shape, edges(&text.edges(height))))
    };
    // The shapes that stand in for those of the tests without a text, in the order of the tests.
    let here = [
        ("five squares", edges(&squares)),
        ("no text", f64::NAN),
        ("S1", percent(0)),
        ("S2", percent(1)),
        ("S3", percent(2)),
        ("S3", percent(2)),
    ];
    let row = |section, what: String, stated: f64, is_text, saved: f64| Row {
        section,
        what,
        stated: format!("{stated:.2} %"),
        ours: format!("{saved:.2} %"),
        verdict: of_kind(stated, saved),
        reason: if is_text { LETTERS } else { STANDS_IN },
    };
    for (test, (shape, saved)) in stated.cutting_test.iter().zip(here) {
        let CuttingTest { figure, job, .. } = test;
        let stated = 100.0 * (1.0 - test.analysed_min / test.plain_min);
        let text = of_text(&test.text, test.height_mm);
        let is_text = text.is_some();
        let (shape, saved) = text.unwrap_or_else(|| (shape.into(), saved));
        let what = format!("time saved, figure {figure} ({job}); here {shape}");
        rows.push(row("5.2", what, stated, is_text, saved));
    }
    for job in &stated.paper {
        let PaperJob { figure, .. } = job;
        let stated = 100.0 * (1.0 - job.analysed_s / job.plain_s);
        let text = of_text(&job.text, job.height_mm);
        let is_text = text.is_some();
        let (shape, saved) = text.unwrap_or_else(|| ("five squares".into(), edges(&squares)));
        let what = format!("time saved, figure {figure} of ISIC 2002; here {shape}");
        rows.push(row("5.3", what, stated, is_text, saved));
    }
    let expected = &stated.from_rules.squares_air_mm;
    for (condition, stated) in Condition::ALL.into_iter().zip(expected) {
        let ours = format!("{:.3}", order(&squares, condition, REFERENCE).air_mm);
        rows.push(Row {
            section: "5.4",
            what: format!("air of five squares, {}", condition.name()),
            stated: format!("{stated} mm"),
            verdict: equal(ours == *stated),
            ours: format!("{ours} mm"),
            reason: FROM_RULES,
        });
    }
    for (expected, (all, before, after)) in stated.from_rules.pocket.iter().zip(&found) {
        let ExpectedPocket {
            name,
            rows: count,
            plain,
            analysed,
            saved: saving,
        } = expected;
        let plain_ours = format!(
            "{:.2} / {:.3} mm, {}",
            before.cut_mm, before.air_mm, before.lifts
        );
        let ours = format!(
            "{:.2} / {:.3} mm, {}, {}",
            after.cut_mm, after.air_mm, after.lifts, after.links
        );
        let saved = [0.0, 2.0, 4.0, 6.0].map(|lift_s| {
            let percent = saved_with(before, after, lift_s);
            format!("{percent:.2}")
        });
        let saved = format!("{} %", saved.join(" / "));
        let mut push = |what: String, stated: &str, ours: String, agrees: bool| {
            rows.push(Row {
                section: "5.4",
                what,
                stated: stated.into(),
                ours,
                verdict: equal(agrees),
                reason: FROM_RULES,
            });
        };
        let agrees = plain_ours == *plain;
        let what = format!("{name}, without analysis: cut / air, lifts");
        push(what, plain, plain_ours, agrees);
        let agrees = ours == *analysed && all == count;
        let what = format!("{name}, {count} rows: cut / air, lifts, links");
        push(what, analysed, ours, agrees);
        let agrees = saved == *saving;
        let what = format!("{name}, time saved with lifts of 0, 2, 4, 6 s");
        push(what, saving, saved, agrees);
    }
    Ok(rows)
}
