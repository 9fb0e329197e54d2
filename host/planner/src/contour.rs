//! Contour error: the distance of a point from the programmed path.

use super::trajectory::{Cursor, Trajectory};
use haptimill_gcode::{Coordinates, Path};

/// Length of path that is searched before and after the programmed pose, mm.
const WINDOW_MM: f64 = 2.0;
/// Largest number of paths that are searched on either side.
const WINDOW_PATHS: usize = 64;

/// See [`super::Plan::contour_error`].
pub(super) fn error(
    trajectory: &Trajectory,
    cursor: &mut Cursor,
    time: f64,
    pose: &Coordinates,
) -> f64 {
    let Some(piece) = trajectory.seek(cursor, time) else {
        return 0.0;
    };
    let here = piece.path as usize;
    let s = piece.along((time - piece.time).max(0.0)).0;
    let paths = &trajectory.paths;
    let mut least = distance(&paths[here].1, pose, s);
    let mut way = s;
    for (_, path) in paths[..here].iter().rev().take(WINDOW_PATHS) {
        if way > WINDOW_MM {
            break;
        }
        least = least.min(distance(path, pose, path.length));
        way += path.tip_length();
    }
    let mut way = paths[here].1.length - s;
    for (_, path) in paths[here + 1..].iter().take(WINDOW_PATHS) {
        if way > WINDOW_MM {
            break;
        }
        least = least.min(distance(path, pose, 0.0));
        way += path.tip_length();
    }
    least
}

/// Returns the distance of the tip: in the first three coordinates.
fn distance(path: &Path, pose: &Coordinates, near: f64) -> f64 {
    let point = path.at(path.nearest(pose, near));
    let squared: f64 = (0..3)
        .map(|k| (point[k] - pose[k]) * (point[k] - pose[k]))
        .sum();
    squared.sqrt()
}
