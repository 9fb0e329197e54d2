//! Contours that cross or cover each other.

use crate::drawing::{Drawing, Problem};
use cavalier_contours::polyline::{PlineSource, Polyline};

/// Finds loops that cross or cover each other.
pub(super) fn find(drawing: &Drawing, loops: &[Polyline<f64>], problems: &mut Vec<Problem>) {
    let mut order: Vec<(usize, _)> = loops
        .iter()
        .enumerate()
        .filter_map(|(k, one)| Some((k, one.extents()?)))
        .collect();
    order.sort_by(|a, b| a.1.min_x.total_cmp(&b.1.min_x));
    for (place, (index, one)) in order.iter().enumerate() {
        for (other, two) in &order[place + 1..] {
            if two.min_x > one.max_x {
                break;
            }
            if two.min_y > one.max_y || two.max_y < one.min_y {
                continue;
            }
            let meets = loops[*index].find_intersects(&loops[*other]);
            let at = meets.basic_intersects.first().map(|one| one.point);
            let at = at.or_else(|| meets.overlapping_intersects.first().map(|one| one.point1));
            if let Some(at) = at {
                let entity = |index: usize| {
                    let entity = loops[index].get_userdata_values().next().unwrap_or(0);
                    &drawing.entities[entity as usize]
                };
                let what = format!(
                    "its contour meets that of {} at {:.3}, {:.3}",
                    entity(*other),
                    at.x,
                    at.y
                );
                problems.push(Problem::of(
                    entity(*index),
                    what,
                    "unite the contours in the drawing program, or choose layers with --layer",
                ));
            }
        }
    }
}
