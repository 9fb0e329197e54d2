//! Outlines: on the paths of the drawing, or beside its contours.

use super::nothing;
use super::tabs::TabGrid;
use super::{Job, Options, Ordering, Side, chained, measured, note_lost, time};
use crate::drawing::{Drawing, Problem};
use crate::geometry::{Path, Point, Segment, Vertex, distance};
use crate::order::edges::{self, Condition, Ends};
use crate::order::{Effort, order_passes, order_paths};
use crate::shape::Region;
use crate::toolpath::{
    Cut, Depths, PathStep, Tab, cut_path, cut_path_with_leads, cut_path_with_tabs, join_cuts,
    leads, tabs_of,
};

/// Largest number of entities for which the greedy conditions are shown beside the order of the
/// file where this one is asked for.
const SHOWN: usize = 3_000;

pub(super) fn outline(drawing: &Drawing, options: &Options) -> Result<Job, Vec<Problem>> {
    if drawing.paths.is_empty() {
        return Err(nothing("paths to trace"));
    }
    if options.side == Side::On {
        return Ok(trace(drawing, options));
    }
    let region = Region::of(drawing, &chained(drawing, options))?;
    let sign = if options.side == Side::Inside {
        1.0
    } else {
        -1.0
    };
    let radius = options.tool_mm / 2.0;
    let finished = region.inset(sign * radius);
    let mut job = Job::default();
    note_lost(&region, &finished, drawing, options, &mut job)?;
    // The material that stays is on the right of the tool (climb) or on its left.
    let material_left = (options.side == Side::Outside) != options.conventional;
    let direct = |path: Path| if material_left { path.reversed() } else { path };
    let directed =
        |region: &Region| -> Vec<Path> { region.loops().into_iter().map(direct).collect() };
    let rough =
        (options.finish_mm > 0.0).then(|| region.inset(sign * (radius + options.finish_mm)));
    let contours = rough.iter().chain([&finished]);
    job.doubtful.extend(contours.flat_map(Region::doubtful));
    let mut passes: Vec<Vec<Path>> = rough.iter().map(directed).collect();
    let loops = directed(&finished);
    // All passes leave their tabs at the same places, those of the last one.
    let tabs = tabs_of_all(&loops, options);
    job.tabs = tabs.concat();
    passes.push(loops);
    // A pass that is nearer than the tool is wide would cut through a tab.
    let reach = options.tool_mm.max(1.5 * options.finish_mm);
    let waste = Waste {
        region: &finished,
        enclosed: options.side == Side::Inside,
        tabs: TabGrid::new(job.tabs.clone(), reach),
        reach,
    };
    let depths = options.depths();
    let floor = Depths {
        levels: vec![-options.depth_mm],
        ..depths.clone()
    };
    let mut at = options.reference;
    let mut file = Vec::new();
    for (pass, paths) in passes.iter().enumerate() {
        let before = rough.as_ref().filter(|_| pass > 0);
        let depths = |path: &Path| match before {
            Some(rough) if is_roughed(path, rough, options) => &floor,
            _ => &depths,
        };
        for path in paths {
            let cut = with_leads(path, depths(path), options, &waste, &mut Vec::new());
            file.push(cut);
        }
        // Inner contours first: the part must not come loose before they are cut.
        for level in by_depth(paths) {
            let tour = order_paths(&level, at, Effort::default());
            for path in tour.apply(&level) {
                let cut = with_leads(&path, depths(&path), options, &waste, &mut job.notices);
                at = cut.end();
                job.toolpath.cuts.push(cut);
            }
        }
    }
    job.notices.dedup();
    if let Some(loops) = passes.last() {
        note_tabs(loops, &tabs, drawing, options, &mut job);
    }
    job.candidates = vec![
        measured(&file, Condition::File.name(), options),
        measured(&job.toolpath.cuts, "inner contours first", options),
    ];
    Ok(job)
}

/// Whether the pass before the last one went along all of a contour of the last one: what is left
/// there is the finishing allowance, and up to half more of it at right-angled corners.
pub(super) fn is_roughed(path: &Path, rough: &Region, options: &Options) -> bool {
    const TOLERANCE: f64 = 1e-3;
    let limit = 1.5 * options.finish_mm + TOLERANCE;
    rough.is_beside(path, limit, options.tool_mm / 8.0)
}

/// The tabs of each path.
fn tabs_of_all(paths: &[Path], options: &Options) -> Vec<Vec<Tab>> {
    let of_path = |path: &Path| match options.tabs {
        Some(tabs) if path.closed => tabs_of(path, &tabs, options.tool_mm),
        _ => Vec::new(),
    };
    paths.iter().map(of_path).collect()
}

/// Notes the contours that are cut through because their tabs do not fit, and those with narrower
/// tabs.
fn note_tabs(
    paths: &[Path],
    tabs_of_paths: &[Vec<Tab>],
    drawing: &Drawing,
    options: &Options,
    job: &mut Job,
) {
    let Some(tabs) = options.tabs else {
        return;
    };
    let needed = tabs.length(options.tool_mm);
    let all = paths.iter().zip(tabs_of_paths);
    for (path, placed) in all.filter(|(path, _)| path.closed) {
        if needed >= path.length() {
            job.notices.push(format!(
                "{}: cut through without tabs: {} tabs of {} mm with a tool of {} mm need {needed:.1} \
                 mm, the contour has {:.1} mm; use fewer or narrower tabs",
                drawing.entities[path.entity],
                tabs.count,
                tabs.width_mm,
                options.tool_mm,
                path.length()
            ));
            continue;
        }
        let widths = placed.iter().map(|tab| tab.width_mm);
        let narrowest = widths.fold(tabs.width_mm, f64::min);
        if narrowest < 0.99 * tabs.width_mm {
            job.notices.push(format!(
                "{}: its tabs are {:.2} mm wide instead of {} mm, because it is too small and round \
                 for them; use narrower tabs",
                drawing.entities[path.entity],
                narrowest.max(0.0),
                tabs.width_mm
            ));
        }
    }
}

/// Groups closed paths by the number of others around them, the innermost first.
fn by_depth(paths: &[Path]) -> Vec<Vec<Path>> {
    let boxes: Vec<_> = paths.iter().map(Path::bounds).collect();
    let around = |index: usize| {
        let Some([low, high]) = boxes[index] else {
            return 0;
        };
        let holds = |other: &Option<[Point; 2]>| {
            other.is_some_and(|[l, h]| {
                l[0] < low[0] && l[1] < low[1] && h[0] > high[0] && h[1] > high[1]
            })
        };
        boxes.iter().filter(|other| holds(other)).count()
    };
    let depths: Vec<usize> = (0..paths.len()).map(around).collect();
    let deepest = depths.iter().copied().max().unwrap_or(0);
    let level = |depth: usize| {
        let all = paths.iter().zip(&depths).filter(|(_, at)| **at == depth);
        all.map(|(path, _)| path.clone()).collect::<Vec<_>>()
    };
    (0..=deepest)
        .rev()
        .map(level)
        .filter(|level| !level.is_empty())
        .collect()
}

/// Where the tool's centre may be beside contours, and the tabs there.
pub(super) struct Waste<'r> {
    /// The region that the contours bound.
    pub region: &'r Region,
    /// Whether the waste is in it, instead of around it.
    pub enclosed: bool,
    /// Tabs of all contours.
    pub tabs: TabGrid,
    /// A contour nearer to a tab than this leaves it, mm.
    pub reach: f64,
}

impl Waste<'_> {
    /// Whether a lead stays in the waste; its end on the contour is at `contact`.
    fn holds(&self, lead: &Segment, contact: Point) -> bool {
        const COUNT: u32 = 32;
        // A lead leaves the contour along its tangent, and offsets are this exact.
        const EXACT: f64 = 1e-4;
        let points: Vec<Point> = (0..=COUNT)
            .map(|k| lead.point(f64::from(k) / f64::from(COUNT)))
            .filter(|at| distance(*at, contact) > 1e-3)
            .collect();
        let is_inside = |at: &Point| {
            self.region.contains(*at) == self.enclosed
                || self.region.distance_within(*at, EXACT).is_some()
        };
        let crosses = |pair: &[Point]| {
            self.region.is_left_between(pair[0], pair[1])
                && pair
                    .iter()
                    .all(|at| self.region.distance_within(*at, EXACT).is_none())
        };
        points.iter().all(is_inside) && !points.windows(2).any(crosses)
    }
}

/// Cuts a closed path, with leads where they stay in the waste and off the tabs: at its start, else
/// in the middle or at a quarter of one of its longest segments.
pub(super) fn with_leads(
    path: &Path,
    depths: &Depths,
    options: &Options,
    waste: &Waste,
    notices: &mut Vec<String>,
) -> Cut {
    const TRIES: usize = 8;
    let places = waste.tabs.beside(path, waste.reach);
    let Some(radius) = options.lead_mm else {
        return cut_path_with_tabs(path, depths, &places);
    };
    let mut longest: Vec<(f64, usize)> = path
        .segments()
        .enumerate()
        .map(|(index, one)| (one.length(), index))
        .collect();
    longest.sort_by(|a, b| b.0.total_cmp(&a.0));
    longest.truncate(TRIES);
    let starts = [0.5, 0.25, 0.75].into_iter().flat_map(|part| {
        let indices = longest.iter().map(|&(_, index)| index);
        indices.map(move |index| path.rotated(index, part))
    });
    let found = std::iter::once(path.clone())
        .chain(starts)
        .find_map(|path| led(&path, radius, depths, options, &places, waste));
    found.unwrap_or_else(|| {
        notices.push("some contours have no room for a lead: the tool plunges on them".into());
        cut_path_with_tabs(path, depths, &places)
    })
}

/// Cuts a closed path with leads at its start, if they cut nothing but waste.
fn led(
    path: &Path,
    radius: f64,
    depths: &Depths,
    options: &Options,
    places: &[Point],
    waste: &Waste,
) -> Option<Cut> {
    // The waste is on the other side of the tool than the material.
    let leads = leads(path, radius, !options.conventional)?;
    let contact = path.start()?;
    if !waste.holds(&leads.into, contact) || !waste.holds(&leads.out, contact) {
        return None;
    }
    // A pass that goes straight to the floor has leads that no pass before it has cut.
    let levels = options.depths().levels;
    let cut = cut_path_with_leads(path, depths, places, &leads, &levels);
    // A tab reaches to where the tool leaves its way over it, the tool is half as wide as it, and
    // the pass before the last one is farther outside.
    let room = options.tool_mm / 2.0 + options.finish_mm;
    let top = options
        .tabs
        .map_or(f64::NEG_INFINITY, |tabs| tabs.height_mm - options.depth_mm);
    let cuts_tab = |step: &PathStep| match step {
        PathStep::Along(one, z) if *one == leads.into || *one == leads.out => {
            *z < top - 1e-9 && waste.tabs.meets(one, room)
        }
        _ => false,
    };
    (!cut.steps.iter().any(cuts_tab)).then_some(cut)
}

/// Traces the paths of the drawing with the tool's centre on them.
fn trace(drawing: &Drawing, options: &Options) -> Job {
    let mut job = Job::default();
    let chains = chained(drawing, options);
    let commands: Vec<Path> = drawing.paths.iter().flat_map(single_commands).collect();
    let ends: Vec<Ends> = commands
        .iter()
        .filter_map(|path| {
            Some(Ends {
                start: path.start()?,
                end: path.end()?,
            })
        })
        .collect();
    let depths = options.depths();
    let cut_all =
        |paths: &[Path]| -> Vec<Cut> { paths.iter().map(|path| cut_path(path, &depths)).collect() };
    let shown = if options.ordering == Ordering::File && ends.len() > SHOWN {
        &Condition::ALL[..1]
    } else {
        &Condition::ALL[..]
    };
    // The conditions decide by one pass; the lengths are those of all passes. The thesis compares
    // the air, the default the time of the job.
    let cost = |cuts: &[Cut], air_mm: f64| match options.ordering {
        Ordering::Short => time(cuts, options),
        _ => air_mm,
    };
    let of_conditions = || {
        let (mut best, mut min) = (Vec::new(), f64::INFINITY);
        let mut candidates = Vec::new();
        for &condition in shown {
            let order = edges::order(&ends, condition, options.reference).order;
            let cuts = cut_all(&join_continuous(
                order.iter().map(|&index| &commands[index]),
            ));
            let candidate = measured(&cuts, condition.name(), options);
            let is_file = condition == Condition::File;
            let cost = cost(&cuts, candidate.lengths.air_mm);
            if cost < min && (is_file || options.ordering != Ordering::File) {
                (best, min) = (cuts, cost);
            }
            candidates.push(candidate);
        }
        (best, min, candidates)
    };
    let (mut best, name);
    if options.ordering == Ordering::Short {
        let passes = depths.levels.len();
        let (tour, (others, min, candidates)) = std::thread::scope(|scope| {
            let others = scope.spawn(of_conditions);
            let tour = order_passes(&chains, passes, options.reference, Effort::default());
            let others = others.join();
            (
                tour,
                others.unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
            )
        });
        job.candidates = candidates;
        let mut paths = tour.apply(&chains);
        let tabs = tabs_of_all(&paths, options);
        note_tabs(&paths, &tabs, drawing, options, &mut job);
        job.tabs = tabs.concat();
        if depths.tabs.is_none() {
            paths = join_meeting(paths, passes.is_multiple_of(2));
        }
        best = join_cuts(cut_all(&paths), edges::CONTINUOUS, &options.speeds);
        // Chains stay whole in the tour, not in the orders above: one of these may take less time.
        // What counts is what is cut: after a ramp a closed path ends beside its start. Only in the
        // tour have all contours their tabs.
        if depths.tabs.is_some() || time(&best, options) <= min + 1e-9 {
            job.proven = tour.proven;
            name = "chains, reversed and started anywhere";
        } else {
            best = others;
            name = "chosen: best of the above";
        }
    } else {
        // In these orders only circles have tabs.
        let tabs = tabs_of_all(&commands, options);
        note_tabs(&commands, &tabs, drawing, options, &mut job);
        job.tabs = tabs.concat();
        (best, _, job.candidates) = of_conditions();
        name = match options.ordering {
            Ordering::File => "chosen: file order",
            _ => "chosen: best of the above",
        };
    }
    let chosen = measured(&best, name, options);
    job.candidates.push(chosen);
    job.toolpath.cuts = best;
    job
}

/// A path as commands of one line or arc each; a circle is one command.
fn single_commands(path: &Path) -> Vec<Path> {
    if path.closed && path.vertices.len() == 2 {
        return vec![path.clone()];
    }
    path.segments()
        .map(|segment| Path::from_segments(&[segment], path.entity))
        .collect()
}

/// Joins paths of a tour that meet, so that all passes go along them without a lift. In an even
/// number of passes (`returning`) the tool ends a path where it began.
fn join_meeting(paths: Vec<Path>, returning: bool) -> Vec<Path> {
    let mut out: Vec<Path> = Vec::with_capacity(paths.len());
    for next in paths {
        match out.last_mut() {
            Some(last) if meets(last, &next, returning) => {
                let both_closed = last.closed && next.closed;
                // The tool comes back to the start of an open path, so that comes last.
                *last = if returning && !last.closed {
                    joined(&next, last)
                } else {
                    joined(last, &next)
                };
                if both_closed {
                    last.vertices.pop();
                    last.closed = true;
                }
            }
            _ => out.push(next),
        }
    }
    out
}

/// Whether the tool is at the start of a path after the one before it, and both can be one path.
fn meets(last: &Path, next: &Path, returning: bool) -> bool {
    let end = if returning { last.start() } else { last.end() };
    let near = |(a, b)| distance(a, b) <= edges::CONTINUOUS;
    end.zip(next.start()).is_some_and(near) && (!returning || last.closed || next.closed)
}

/// Both paths as an open one.
fn joined(first: &Path, second: &Path) -> Path {
    let opened = |path: &Path| {
        let mut path = path.clone();
        if path.closed {
            path.closed = false;
            path.vertices.extend(
                path.vertices
                    .first()
                    .map(|one| Vertex { bulge: 0.0, ..*one }),
            );
        }
        path
    };
    let (mut path, second) = (opened(first), opened(second));
    if let (Some(joint), Some(start)) = (path.vertices.last_mut(), second.vertices.first()) {
        joint.bulge = start.bulge;
        path.vertices.extend_from_slice(&second.vertices[1..]);
    }
    path
}

/// Joins commands that begin where the one before ends.
fn join_continuous<'p>(commands: impl Iterator<Item = &'p Path>) -> Vec<Path> {
    let mut out: Vec<Path> = Vec::new();
    for command in commands {
        let follows = out.last().is_some_and(|last| {
            let ends = last.end().zip(command.start());
            !last.closed
                && !command.closed
                && ends.is_some_and(|(a, b)| distance(a, b) <= edges::CONTINUOUS)
        });
        match out.last_mut() {
            Some(last) if follows => {
                if let (Some(joint), Some(first)) =
                    (last.vertices.last_mut(), command.vertices.first())
                {
                    joint.bulge = first.bulge;
                    last.vertices.extend_from_slice(&command.vertices[1..]);
                }
            }
            _ => out.push(command.clone()),
        }
    }
    out
}
