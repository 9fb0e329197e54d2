//! How far a point is from the programmed path.

use super::trajectory::{Cursor, Trajectory};
use haptimill_gcode::{Coordinates, Path};

/// Way before and after the place at the time that is searched, mm.
const WINDOW_MM: f64 = 2.0;
/// And no more paths than this to either side.
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

/// Distance in the first three coordinates, which are the tip's.
fn distance(path: &Path, pose: &Coordinates, near: f64) -> f64 {
    let point = path.at(path.nearest(pose, near));
    let squared: f64 = (0..3)
        .map(|k| (point[k] - pose[k]) * (point[k] - pose[k]))
        .sum();
    squared.sqrt()
}
