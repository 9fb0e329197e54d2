//! Whether a job is within the area of a machine.

use super::Job;
use crate::drawing::{Drawing, Problem, short};
use crate::geometry::Point;
use crate::toolpath::PathStep;

/// Low and high corner, mm.
type Corners = [Point; 2];

/// Refuses a job of which a part is outside an area (low and high corner, mm).
///
/// # Errors
/// Each entity with a path of the tool outside.
pub fn check_area(
    job: &Job,
    drawing: &Drawing,
    area: Corners,
    name: &str,
) -> Result<(), Vec<Problem>> {
    let reaches = job.toolpath.cuts.iter().map(|cut| {
        let mut bounds = [cut.start, cut.start];
        for step in &cut.steps {
            if let PathStep::Along(segment, _) = step {
                let [l, h] = segment.bounds();
                for axis in 0..2 {
                    bounds[0][axis] = bounds[0][axis].min(l[axis]);
                    bounds[1][axis] = bounds[1][axis].max(h[axis]);
                }
            }
        }
        (cut.entity, bounds)
    });
    check(reaches, drawing, area, name)
}

/// Refuses the contours of a pocket of which a part is outside an area (low and high corner, mm),
/// before the pocket is planned: a drawing in the wrong unit would take hours. The tool runs along
/// a contour at half of its diameter.
///
/// # Errors
/// Each entity whose contour takes the tool outside.
pub fn check_pocket(
    drawing: &Drawing,
    tool_mm: f64,
    area: Corners,
    name: &str,
) -> Result<(), Vec<Problem>> {
    let half = tool_mm / 2.0;
    let reaches = drawing.paths.iter().filter_map(|path| {
        let [low, high] = path.bounds()?;
        let bounds = [low.map(|at| at + half), high.map(|at| at - half)];
        // A contour that is narrower than the tool is not cut.
        (0..2)
            .all(|axis| bounds[0][axis] < bounds[1][axis])
            .then_some((path.entity, bounds))
    });
    check(reaches, drawing, area, name)
}

/// A coordinate for a message.
fn place(value: f64) -> String {
    if value.abs() < 1e9 {
        format!("{value:.3}")
    } else {
        short(value)
    }
}

/// One problem for each entity with a reach outside of the area.
fn check(
    reaches: impl Iterator<Item = (usize, Corners)>,
    drawing: &Drawing,
    [low, high]: Corners,
    name: &str,
) -> Result<(), Vec<Problem>> {
    let mut problems: Vec<Problem> = Vec::new();
    let mut seen = vec![false; drawing.entities.len()];
    for (entity, bounds) in reaches {
        let within = (0..2).all(|axis| {
            bounds[0][axis] >= low[axis] - 1e-6 && bounds[1][axis] <= high[axis] + 1e-6
        });
        if !within && !std::mem::replace(&mut seen[entity], true) {
            problems.push(Problem::of(
                &drawing.entities[entity],
                format!(
                    "the tool runs from {}, {} to {}, {}, outside of {name}: {}, {} \
                     to {}, {}",
                    place(bounds[0][0]),
                    place(bounds[0][1]),
                    place(bounds[1][0]),
                    place(bounds[1][1]),
                    low[0],
                    low[1],
                    high[0],
                    high[1]
                ),
                "move the drawing with --origin or --at, scale it with --scale, or check its unit \
                 with --unit",
            ));
        }
    }
    if problems.is_empty() {
        Ok(())
    } else {
        Err(problems)
    }
}
