//! From a drawing to a tool path.

mod area;
mod options;
mod outline;
mod tabs;

pub use area::{check_area, check_pocket};
pub use options::{Operation, Options, Ordering, Side};

use crate::drawing::{Drawing, Problem, short};
use crate::geometry::{Path, Point, distance};
use crate::order::edges::Condition;
use crate::order::{Effort, order_paths};
use crate::shape::clear::{ClearOptions, clear};
use crate::shape::{Clearing, Region, Strand};
use crate::times::Times;
use crate::toolpath::{Cut, Depths, Lengths, PathStep, Tab, Toolpath, cut_path, levels, passes};
use outline::{Waste, is_roughed, outline, with_leads};
use serde::Serialize;
use std::collections::HashMap;
use tabs::TabGrid;

/// The job in one order.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Candidate {
    /// What the order is.
    pub name: String,
    /// Its lengths from the reference and back to it.
    #[serde(flatten)]
    pub lengths: Lengths,
}

/// A job that is ready to be written.
#[derive(Debug, Clone, Default)]
pub struct Job {
    /// The tool path.
    pub toolpath: Toolpath,
    /// Orders side by side; the first is the order of the file.
    pub candidates: Vec<Candidate>,
    /// Whether the order is proven to be the shortest.
    pub proven: bool,
    /// Gaps that are cut through.
    pub links: usize,
    /// Tabs of the contours.
    pub tabs: Vec<Tab>,
    /// Entities beside which a contour of the tool may be wrong.
    pub doubtful: Vec<usize>,
    /// What the person should know.
    pub notices: Vec<String>,
}

/// Plans a job.
///
/// # Errors
/// Every problem of the drawing for this operation.
pub fn plan(drawing: &Drawing, options: &Options) -> Result<Job, Vec<Problem>> {
    options.check().map_err(|problem| vec![problem])?;
    let mut job = match options.operation {
        Operation::Outline => outline(drawing, options)?,
        Operation::Pocket => pocket(drawing, options)?,
        Operation::Drill => return drill(drawing, options),
    };
    note_doubtful(drawing, &mut job);
    if let Some(&(_, first)) = drawing.points.first() {
        let more = match drawing.points.len() {
            1 => String::new(),
            count => format!("; and {} more", count - 1),
        };
        job.notices.push(format!(
            "left out, a point is for --operation drill: {}{more}",
            drawing.entities[first]
        ));
    }
    Ok(job)
}

fn nothing(what: &str) -> Vec<Problem> {
    vec![Problem::general(
        format!("the drawing has no {what}"),
        "check the layers and the notices about what was left out",
    )]
}

fn chained(drawing: &Drawing, options: &Options) -> Vec<Path> {
    crate::chain::chain(drawing.paths.clone(), options.join_mm)
}

/// Notes or refuses what the tool is too wide for.
fn note_lost(
    region: &Region,
    reached: &Region,
    drawing: &Drawing,
    options: &Options,
    job: &mut Job,
) -> Result<(), Vec<Problem>> {
    let mut problems = Vec::new();
    let kept = reached.loops();
    let (before, after) = (region.boundaries(), reached.boundaries());
    for one in region.loops() {
        let entity = &drawing.entities[one.entity];
        if !kept.iter().any(|path| path.entity == one.entity) && kept.is_empty() {
            problems.push(Problem::of(
                entity,
                format!(
                    "a tool of {} mm does not fit into its contour",
                    options.tool_mm
                ),
                "use a thinner tool with --tool",
            ));
        } else if !kept.iter().any(|path| path.entity == one.entity) {
            job.notices.push(format!(
                "{entity}: no pass of its own: a tool of {} mm is too wide beside it, or passes \
                 of other contours cover it; use a thinner tool with --tool",
                options.tool_mm
            ));
        } else if let Some((at, off)) = region.min_reached(
            &one,
            reached,
            options.tool_mm,
            after.get(&one.entity) > before.get(&one.entity),
        ) {
            job.notices.push(format!(
                "{entity}: a tool of {} mm does not reach {:.3}, {:.3}: it ends {off:.3} mm away, \
                 at a neck, slot or corner that is too narrow; use a thinner tool with --tool",
                options.tool_mm, at[0], at[1]
            ));
        }
    }
    if problems.is_empty() {
        Ok(())
    } else {
        Err(problems)
    }
}

/// Notes the entities of which a contour may be wrong.
fn note_doubtful(drawing: &Drawing, job: &mut Job) {
    job.doubtful.sort_unstable();
    job.doubtful.dedup();
    let all = job.doubtful.iter();
    job.notices.extend(all.into_iter().map(|&entity| {
        format!(
            "{}: a contour of the tool beside it may be wrong, because every way to compute it \
             failed its check; look at it with --preview, or use another diameter with --tool",
            drawing.entities[entity]
        )
    }));
}

fn measured(cuts: &[Cut], name: &str, options: &Options) -> Candidate {
    Candidate {
        name: name.into(),
        lengths: Toolpath::lengths_of(cuts, options.reference),
    }
}

/// Time of cuts, s.
fn time(cuts: &[Cut], options: &Options) -> f64 {
    let lengths = Toolpath::lengths_of(cuts, options.reference);
    Times::of(&lengths, &options.speeds).total()
}

/// Refuses a pocket of more rows than memory and time allow.
fn check_rows(paths: &[Path], options: &Options) -> Result<(), Problem> {
    const MAX: f64 = 1e6;
    let closed = paths.iter().filter(|path| path.closed);
    let boxes = closed.filter_map(Path::bounds);
    // A row ends at two contours; each contour has at most as many as it is wide.
    let width: f64 = boxes
        .map(|[low, high]| (high[0] - low[0]).hypot(high[1] - low[1]))
        .sum();
    let spacing = options.tool_mm * options.overlap;
    let passes = passes(options.depth_mm, options.step_mm);
    let rows = width / spacing * passes;
    if rows <= MAX {
        return Ok(());
    }
    Err(Problem::general(
        format!(
            "rows {} mm apart through contours of {width:.1} mm together, in {passes} \
             passes, are {} rows",
            short(spacing),
            short(rows.ceil())
        ),
        format!(
            "at most {MAX} rows are planned: use a wider tool, a larger --overlap, or fewer passes"
        ),
    ))
}

fn pocket(drawing: &Drawing, options: &Options) -> Result<Job, Vec<Problem>> {
    if drawing.paths.is_empty() {
        return Err(nothing("contours to clear"));
    }
    let paths = chained(drawing, options);
    // Before the region, because its search for crossings takes long in a large drawing.
    check_rows(&paths, options).map_err(|problem| vec![problem])?;
    let region = Region::of(drawing, &paths)?;
    let mut job = Job::default();
    let reached = region.inset(options.tool_mm / 2.0);
    job.doubtful.extend(reached.doubtful());
    note_lost(&region, &reached, drawing, options, &mut job)?;
    let one_way = Options {
        clearing: Clearing::OneWay,
        ..options.clone()
    };
    let plain = cleared(&region, &reached, &one_way, &mut Job::default());
    job.candidates
        .push(measured(&plain, "one-way rows, not linked", options));
    job.toolpath.cuts = cleared(&region, &reached, options, &mut job);
    job.notices.dedup();
    job.candidates
        .push(measured(&job.toolpath.cuts, "chosen", options));
    Ok(job)
}

/// The cuts that clear a region in all depths, and the last pass along the walls. Adds links and
/// notices to the job.
fn cleared(region: &Region, reached: &Region, options: &Options, job: &mut Job) -> Vec<Cut> {
    let clearing = ClearOptions {
        clearing: options.clearing,
        tool_mm: options.tool_mm,
        allowance_mm: options.finish_mm,
        spacing_mm: options.tool_mm * options.overlap,
        angle_deg: options.angle_deg,
        conventional: options.conventional,
    };
    let strands = clear(region, &clearing, options.reference, &mut job.doubtful);
    let depths = options.depths();
    let mut cuts = Vec::new();
    let mut above = 0.0;
    for &z in &depths.levels {
        for strand in &strands {
            job.links += strand.links;
            cuts.push(cut_strand(strand, above, z, depths.slope));
        }
        above = z;
    }
    if options.finish_mm > 0.0 {
        let direct = |path: Path| {
            if options.conventional {
                path.reversed()
            } else {
                path
            }
        };
        let loops: Vec<Path> = reached.loops().into_iter().map(direct).collect();
        let at = cuts.last().map_or(options.reference, Cut::end);
        let floor = Depths {
            levels: vec![-options.depth_mm],
            slope: None,
            tabs: None,
        };
        let all = Depths {
            tabs: None,
            ..options.depths()
        };
        let rough = region.inset(options.tool_mm / 2.0 + options.finish_mm);
        job.doubtful.extend(rough.doubtful());
        let waste = Waste {
            region: reached,
            enclosed: true,
            tabs: TabGrid::default(),
            reach: 0.0,
        };
        for path in order_paths(&loops, at, Effort::default()).apply(&loops) {
            let depths = if is_roughed(&path, &rough, options) {
                &floor
            } else {
                &all
            };
            let cut = with_leads(&path, depths, options, &waste, &mut job.notices);
            cuts.push(cut);
        }
    }
    cuts
}

/// Cuts a strand at one depth, with a ramp at its start if there is one.
fn cut_strand(strand: &Strand, above: f64, z: f64, slope: Option<f64>) -> Cut {
    let path = Path::from_segments(&strand.segments, strand.entity);
    match slope {
        None => cut_path(
            &path,
            &Depths {
                levels: vec![z],
                slope: None,
                tabs: None,
            },
        ),
        Some(slope) => {
            // A ramp from the floor of the pass above.
            let depths = Depths {
                levels: vec![z - above],
                slope: Some(slope),
                tabs: None,
            };
            let mut cut = cut_path(&path, &depths);
            cut.z += above;
            for step in &mut cut.steps {
                match step {
                    PathStep::Along(_, depth) | PathStep::Vertical(depth) => *depth += above,
                }
            }
            cut
        }
    }
}

/// Keeps the first of holes that are at the same place.
fn drill_once(holes: &mut Vec<Path>, drawing: &Drawing, job: &mut Job) {
    /// Nearer than this, mm, two holes are one.
    const SAME: f64 = 1e-3;
    /// The squares beside the farthest one have numbers, too.
    const FARTHEST: f64 = 1e18;
    let mut kept: HashMap<[i64; 2], Vec<Point>> = HashMap::new();
    let mut again = Vec::new();
    holes.retain(|hole| {
        let Some(at) = hole.start() else { return false };
        let [column, row] =
            at.map(|value| (value / SAME).floor().clamp(-FARTHEST, FARTHEST) as i64);
        let mut near = (column - 1..=column + 1)
            .flat_map(|x| (row - 1..=row + 1).map(move |y| [x, y]))
            .filter_map(|square| kept.get(&square))
            .flatten();
        if near.any(|other| distance(*other, at) < SAME) {
            again.push(hole.entity);
            return false;
        }
        kept.entry([column, row]).or_default().push(at);
        true
    });
    if let Some(&first) = again.first() {
        let more = match again.len() {
            1 => String::new(),
            count => format!("; and {} more", count - 1),
        };
        job.notices.push(format!(
            "left out, a duplicate of a hole that is drilled: {}{more}",
            drawing.entities[first]
        ));
    }
}

fn drill(drawing: &Drawing, options: &Options) -> Result<Job, Vec<Problem>> {
    let mut job = Job::default();
    let point = |at: Point, entity: usize| Path {
        vertices: vec![crate::geometry::Vertex { at, bulge: 0.0 }],
        closed: false,
        entity,
    };
    let mut holes: Vec<Path> = drawing
        .points
        .iter()
        .map(|&(at, entity)| point(at, entity))
        .collect();
    let mut others: Vec<usize> = Vec::new();
    for path in &drawing.paths {
        match drawing.circle_centre(path) {
            Some(centre) => holes.push(point(centre, path.entity)),
            None => others.push(path.entity),
        }
    }
    if holes.is_empty() {
        return Err(nothing("points or circles to drill"));
    }
    drill_once(&mut holes, drawing, &mut job);
    others.dedup();
    if !others.is_empty() {
        let shown = others
            .iter()
            .take(3)
            .map(|&one| drawing.entities[one].to_string());
        let shown: Vec<String> = shown.collect();
        let more = match others.len() {
            0..=3 => String::new(),
            count => format!("; and {} more", count - 3),
        };
        job.notices.push(format!(
            "not drilled, neither points nor circles: {}{more}",
            shown.join("; ")
        ));
    }
    let depths = levels(options.depth_mm, options.step_mm);
    let drilled = |hole: &Path| {
        // Between two passes the tool comes up to the surface and clears the chips.
        let mut steps = Vec::new();
        for &z in &depths[1..] {
            steps.extend([PathStep::Vertical(0.0), PathStep::Vertical(z)]);
        }
        Cut {
            start: hole.start().unwrap_or_default(),
            z: depths[0],
            steps,
            entity: hole.entity,
        }
    };
    let file: Vec<Cut> = holes.iter().map(drilled).collect();
    job.candidates
        .push(measured(&file, Condition::File.name(), options));
    let tour = order_paths(&holes, options.reference, Effort::default());
    job.toolpath.cuts = tour.apply(&holes).iter().map(drilled).collect();
    if time(&job.toolpath.cuts, options) <= time(&file, options) + 1e-9 {
        job.proven = tour.proven;
    } else {
        job.toolpath.cuts = file;
    }
    let chosen = measured(&job.toolpath.cuts, "shortest found", options);
    job.candidates.push(chosen);
    Ok(job)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::Entity;

    #[test]
    fn contours_that_may_be_wrong_are_named_once() {
        let mut drawing = Drawing::default();
        for handle in ["A1", "A2"] {
            drawing.add_entity(Entity {
                kind: "LWPOLYLINE".into(),
                handle: Some(handle.into()),
                layer: "Cut".into(),
                ..Entity::default()
            });
        }
        let mut job = Job {
            doubtful: vec![1, 1, 1],
            ..Job::default()
        };
        note_doubtful(&drawing, &mut job);
        assert_eq!(job.notices.len(), 1);
        let notice = &job.notices[0];
        for part in [
            "LWPOLYLINE handle A2 on layer Cut",
            "may be wrong",
            "--preview",
        ] {
            assert!(notice.contains(part), "{part}: {notice}");
        }
    }
}
