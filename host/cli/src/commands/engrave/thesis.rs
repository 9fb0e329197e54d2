//! The cutting tests of the thesis on the simulated engraver: `haptimill scenario run engraver`.
//!
//! Each test runs twice through controller and simulator, without the analysis of the path and with
//! it. Time and path are those of the simulated tool.

use super::ENGRAVER;
use haptimill_calibration::drive::Machine;
use haptimill_client::{Error, ErrorKind};
use haptimill_engrave::curves::distance_to_segment;
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::gcode::{Rates, program};
use haptimill_engrave::geometry::{Path, Point};
use haptimill_engrave::job::{Operation, Options, Ordering, plan};
use haptimill_engrave::shape::Clearing;
use haptimill_engrave::thesis::{
    self, FEED, LIFT_S, REFERENCE, Row, TOOL, Verdict, five_squares, of_kind, outlines,
};
use haptimill_machine_file::MachineFile;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Control periods between two samples: 2 ms, in which the tool moves by two steps.
const EVERY: u64 = 10;

/// Depth of the cuts, mm.
const DEPTH: f64 = 0.5;

/// Lifted moves, mm above the plate: 2 mm above the floor of the cuts.
const LIFT: f64 = 1.5;

/// Rate of lifts and plunges, mm/s.
const LIFT_RATE: f64 = 2.0 * (DEPTH + LIFT) / LIFT_S;

/// Largest distance of the simulated tool from a drawing that counts as none, mm: two steps.
const TWO_STEPS: f64 = 0.01;

/// What the simulator shows of a job.
struct Simulated {
    /// Time of the program, s.
    time: f64,
    /// Largest distance of the cutting tool from the drawing, mm.
    off: f64,
}

/// Runs a job.
fn simulate(
    machine: &mut Machine,
    drawing: &Drawing,
    options: &Options,
) -> Result<Simulated, Error> {
    let internal = |what: String| Error::new(ErrorKind::Internal, what);
    let job = plan(drawing, options).map_err(|problems| internal(format!("{problems:?}")))?;
    let rates = Rates {
        feed: FEED * 60.0,
        plunge: 60.0 * LIFT_RATE,
        speed: 10_000.0,
        lift_mm: LIFT,
    };
    let text = program(&job.toolpath, rates, REFERENCE, &[]);
    let samples = machine.run("the job", &text)?;
    let [Some(first), Some(last)] = [samples.first(), samples.last()] else {
        return Err(internal("a job without samples".into()));
    };
    // The tool cuts where it is deeper than half of the depth.
    let cutting = samples
        .iter()
        .filter(|sample| sample.tool[2] < -DEPTH / 2.0);
    let nearest = |at: Point| {
        let segments = drawing.paths.iter().flat_map(Path::segments);
        segments
            .map(|segment| distance_to_segment(at, &segment))
            .fold(f64::INFINITY, f64::min)
    };
    Ok(Simulated {
        time: last.time - first.time,
        off: cutting
            .map(|sample| nearest([sample.tool[0], sample.tool[1]]))
            .fold(0.0, f64::max),
    })
}

/// Repeats the cutting tests.
///
/// # Errors
/// The simulator refuses a job, or the command is interrupted.
pub fn rows(
    interrupted: &Arc<AtomicBool>,
    progress: &mut dyn FnMut(&str),
) -> Result<Vec<Row>, Error> {
    // The machine of the thesis has one rate for cuts and lifted moves, and its own for z.
    let slow = |text: &str, from: f64, to: f64| {
        text.replace(
            &format!("rate_mm_s = {from:?}\n"),
            &format!("rate_mm_s = {to:?}\n"),
        )
    };
    let text = slow(&slow(ENGRAVER.1, 20.0, FEED), 4.0, LIFT_RATE);
    let file = MachineFile::parse(ENGRAVER.0, &text)?;
    let mut machine = Machine::new(&file, EVERY, interrupted)?;
    let outline = |ordering| Options {
        ordering,
        tool_mm: TOOL,
        depth_mm: DEPTH,
        ..Options::default()
    };
    let pocket = |clearing| Options {
        operation: Operation::Pocket,
        clearing,
        ..outline(Ordering::Greedy)
    };
    let edges = [outline(Ordering::File), outline(Ordering::Greedy)];
    let pockets = [pocket(Clearing::OneWay), pocket(Clearing::Zigzag)];
    let [square, _, letter] = outlines();
    let mut rows = Vec::new();
    let mut both = |name: &str, drawing: &Drawing, options: &[Options; 2]| {
        progress(&format!("simulator: {name}"));
        let mut one = |options| simulate(&mut machine, drawing, options);
        Ok::<_, Error>([one(&options[0])?, one(&options[1])?])
    };
    let found = both("figure 4.8", &thesis::figure_4_8(), &edges)?;
    for (name, found) in ["without", "with"].into_iter().zip(found) {
        rows.push(Row {
            section: "5.1",
            what: format!("simulated tool {name} analysis against the drawing, figure 4.8"),
            stated: "equal".into(),
            ours: format!("{:.4} mm", found.off),
            verdict: if found.off < TWO_STEPS {
                Verdict::Agrees
            } else {
                Verdict::Differs
            },
            reason: "a step is 0.005 mm; two of them count as equal",
        });
    }
    for (figure, stated, shape, drawing, options) in [
        (
            "5.6 (edges, picture)",
            17.89,
            "five squares",
            thesis::drawing(&five_squares()),
            &edges,
        ),
        (
            "5.10 (pocket, 1 object)",
            68.31,
            "S1",
            thesis::closed(&square),
            &pockets,
        ),
        (
            "5.14 (pocket, text)",
            79.26,
            "S3",
            thesis::closed(&letter),
            &pockets,
        ),
    ] {
        let [plain, analysed] = both(shape, &drawing, options)?;
        let saved = 100.0 * (1.0 - analysed.time / plain.time);
        rows.push(Row {
            section: "5.2",
            what: format!("time saved in the simulator, figure {figure}; here {shape}"),
            stated: format!("{stated:.2} %"),
            ours: format!("{saved:.2} %: {:.1} s, {:.1} s", plain.time, analysed.time),
            verdict: of_kind(stated, saved),
            reason: "the drawing is lost, a shape of its kind stands in; 4 s a lift, the contour of a \
                     pocket in both",
        });
    }
    Ok(rows)
}
