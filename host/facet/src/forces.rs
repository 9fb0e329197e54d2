//! The job in the report: times and forces of each lap, and of two runs side by side.

use crate::job::{Job, Mode};
use crate::page::{class, escape, micrometres, minutes};
use crate::run::{Cutting, OperationResult};
use crate::{Side, Stage};
use core::fmt::Write as _;

/// A run of a job.
pub type Run<'a> = (&'a Job, &'a Cutting);

/// Name of a mode.
const fn name(mode: Mode) -> &'static str {
    match mode {
        Mode::Feed => "by feed",
        Mode::Force => "by force to the depth",
        Mode::Both => "by feed, with the force held",
    }
}

/// Time and forces of a stage on a lap.
struct StageFigures<'a> {
    lap: &'a str,
    side: &'static str,
    stage: Stage,
    count: usize,
    seconds: f64,
    peak_n: f64,
    /// Least and largest mean of a turn.
    turns_n: [f64; 2],
}

fn figures<'a>((job, cutting): Run<'a>) -> Vec<StageFigures<'a>> {
    let mut all = Vec::new();
    for (number, pass) in job.passes.iter().enumerate() {
        let mut stages: Vec<Stage> = Vec::new();
        for operation in &pass.operations {
            if !stages.contains(&operation.stage) {
                stages.push(operation.stage);
            }
        }
        for stage in stages {
            let mut figures = StageFigures {
                lap: &job.settings.laps[pass.lap].name,
                side: match pass.mount.side {
                    Side::Pavilion => "pavilion",
                    Side::Crown => "crown",
                },
                stage,
                count: 0,
                seconds: 0.0,
                peak_n: 0.0,
                turns_n: [f64::INFINITY, 0.0],
            };
            let done = cutting.operations.iter().filter(|it| it.pass == number);
            for result in done {
                let is_of_stage = pass
                    .operations
                    .iter()
                    .any(|it| it.facet == result.facet && it.stage == stage);
                if !is_of_stage {
                    continue;
                }
                figures.count += 1;
                figures.seconds += result.seconds;
                figures.peak_n = figures.peak_n.max(result.force.peak_n);
                let [min, max] = &mut figures.turns_n;
                *min = min.min(result.force.min_turn_n);
                *max = max.max(result.force.max_turn_n);
            }
            all.push(figures);
        }
    }
    all
}

/// Table of laps and stages.
pub fn stages(body: &mut String, run: Run) {
    let _ = write!(
        body,
        "<h2>Job</h2><p>Ground {}. Forces are those of the contact with the most turns of the \
         lap; turns are means over whole turns of its middle half.</p><table><tr><th>lap\
         <th>side<th>stage<th>facets<th>time<th>peak, N<th>least turn, N<th>largest turn, N",
        name(run.0.settings.mode)
    );
    for it in figures(run).iter().filter(|it| it.count > 0) {
        let [min, max] = it.turns_n;
        let _ = write!(
            body,
            "<tr><td>{}<td>{}<td>{}<td>{}<td>{}<td>{:.2}<td>{min:.2}<td>{max:.2}",
            escape(it.lap),
            it.side,
            it.stage.name(),
            it.count,
            minutes(it.seconds),
            it.peak_n
        );
    }
    body.push_str("</table>");
}

/// Errors, times and forces of two runs of a design, and how the force of a facet of each lap went.
pub fn beside(body: &mut String, runs: [Run; 2], bounds: [f64; 2]) {
    let names = runs.map(|(job, _)| name(job.settings.mode));
    let _ = write!(
        body,
        "<h2>Side by side</h2><p>The same design on the same laps.</p><table><tr><th><th>{}<th>{}",
        names[0], names[1]
    );
    let measured = runs.map(|(_, cutting)| &cutting.measured);
    let angles = measured.map(|it| it.worst_angle_deg());
    let points = measured.map(|it| it.worst_meet_mm());
    let cell = |is_over: bool, text: String| format!("<td{}>{text}", class(is_over));
    let mut row = |what: &str, cells: [String; 2]| {
        let _ = write!(body, "<tr><td>{what}{}{}", cells[0], cells[1]);
    };
    row(
        "largest angle error",
        angles.map(|it| cell(it > bounds[0], format!("{it:.4} deg"))),
    );
    let depths = measured.map(|it| format!("<td>{:.1} um", 1e3 * it.worst_depth_mm()));
    row("largest depth error", depths);
    row(
        "largest meet error",
        points.map(|it| cell(it > bounds[1], micrometres(it))),
    );
    let seconds = |cutting: &Cutting| cutting.operations.iter().map(|it| it.seconds).sum();
    let times = runs.map(|(_, cutting)| format!("<td>{}", minutes(seconds(cutting))));
    row("on the machine", times);
    let _ = write!(
        body,
        "</table><table><tr><th>lap<th>side<th>stage<th>{0}, time<th>{1}, time<th>{0}, turns in N\
         <th>{1}, turns in N",
        names[0], names[1]
    );
    let [ours, theirs] = runs.map(figures);
    for (one, other) in ours.iter().zip(&theirs).filter(|(one, _)| one.count > 0) {
        let turns = |it: &StageFigures| format!("{:.2} to {:.2}", it.turns_n[0], it.turns_n[1]);
        let _ = write!(
            body,
            "<tr><td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}",
            escape(one.lap),
            one.side,
            one.stage.name(),
            minutes(one.seconds),
            minutes(other.seconds),
            turns(one),
            turns(other)
        );
    }
    body.push_str("</table>");
    for lap in 0..runs[0].0.settings.laps.len() {
        chart(body, runs, lap);
    }
}

/// The facet of a lap whose contact has the most turns, with its result in both runs.
fn longest<'a>(
    runs: [Run<'a>; 2],
    lap: usize,
) -> Option<(&'a OperationResult, &'a OperationResult)> {
    let [(job, ours), (_, theirs)] = runs;
    let on_lap = |it: &&OperationResult| job.passes[it.pass].lap == lap;
    let max = ours.operations.iter().filter(on_lap);
    let one = max.max_by_key(|it| it.turns.len())?;
    let other = theirs
        .operations
        .iter()
        .find(|it| it.pass == one.pass && it.facet == one.facet)?;
    Some((one, other))
}

/// Largest number of points of a line.
const POINTS: usize = 400;

/// Curves of the mean force of each turn of the lap, on one facet.
fn chart(body: &mut String, runs: [Run; 2], lap: usize) {
    const COLOURS: [&str; 2] = ["#1f5fa8", "#b3541e"];
    let job = runs[0].0;
    let settings = &job.settings.laps[lap];
    let Some((one, other)) = longest(runs, lap) else {
        return;
    };
    let lines = [one, other].map(|it| &it.turns);
    let turn_s = 60.0 / settings.rpm.abs();
    let longest = lines
        .map(|turns| turns.len())
        .into_iter()
        .max()
        .unwrap_or(0) as f64
        * turn_s;
    let forces = lines.iter().flat_map(|turns| turns.iter());
    let highest = forces
        .map(|turn| turn.force_n)
        .fold(1.3 * settings.force_n, f64::max);
    if longest == 0.0 {
        return;
    }
    let x = |seconds: f64| 50.0 + 840.0 * seconds / longest;
    let y = |newton: f64| 180.0 - 160.0 * newton / highest;
    let [low, high] = [0.9, 1.1].map(|part| y(part * settings.force_n));
    let _ = write!(
        body,
        "<h3>Lap {}: force on one facet</h3><svg viewBox=\"0 0 900 220\" width=\"100%\" \
         font-size=\"12\"><path d=\"M50 20V180H890\" fill=\"none\" stroke=\"#9aa5b1\"/>\
         <rect x=\"50\" width=\"840\" y=\"{high:.1}\" height=\"{:.1}\" fill=\"#dfe7ef\"/>",
        escape(&settings.name),
        low - high
    );
    let _ = write!(
        body,
        "<text x=\"44\" y=\"{:.1}\" text-anchor=\"end\">{} N</text><text x=\"44\" y=\"184\" \
         text-anchor=\"end\">0</text><text x=\"890\" y=\"196\" text-anchor=\"end\">{longest:.1} s\
         </text>",
        y(settings.force_n) + 4.0,
        settings.force_n
    );
    for ((turns, colour), (of, _)) in lines.iter().zip(COLOURS).zip(runs) {
        let every = turns.len().div_ceil(POINTS).max(1);
        let points: Vec<String> = turns
            .iter()
            .enumerate()
            .step_by(every)
            .map(|(k, turn)| {
                let seconds = (k + 1) as f64 * turn_s;
                format!("{:.1} {:.1}", x(seconds), y(turn.force_n))
            })
            .collect();
        if !points.is_empty() {
            let _ = write!(
                body,
                "<path d=\"M{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
                points.join("L")
            );
        }
        let row = if colour == COLOURS[0] { 60.0 } else { 320.0 };
        let _ = write!(
            body,
            "<text x=\"{row}\" y=\"212\" fill=\"{colour}\">{}</text>",
            name(of.settings.mode)
        );
    }
    body.push_str(
        "</svg><p>Mean of each turn of the lap until the stone is within 10 um of its depth. The \
         band is the force of the lap within 10 %.</p>",
    );
}
