//! Readings of a double ball bar as CSV: the circle test of ISO 230-4.
//!
//! ```csv
//! angle_deg,direction,reading_um
//! 0.0,ccw,1.25
//! 0.0,cw,-0.75
//! ```
//!
//! The angle counts counter-clockwise from x to y. A reading is the measured length of the bar less
//! its nominal length. A problem names the line and the remedy.

use crate::file::{FileProblem, problem, rows};

/// Header of the file.
pub const HEADER: &str = "angle_deg,direction,reading_um";

/// Angles between two readings, degrees, at most.
pub const LARGEST_GAP: f64 = 5.0;

/// Readings, counter-clockwise and clockwise: angle in degrees from 0 to 360, ascending, and radial
/// deviation in mm.
pub type CircleReadings = [Vec<[f64; 2]>; 2];

/// Reads a file.
///
/// # Errors
/// The first problem: the header, a number, a direction, or a gap of more than 5 degrees.
pub fn read(text: &str) -> Result<CircleReadings, FileProblem> {
    let mut both: CircleReadings = Default::default();
    for row in rows(text, HEADER)? {
        let direction = match row.text(1) {
            "ccw" => 0,
            "cw" => 1,
            other => {
                let what = format!("direction = \"{other}\"");
                return Err(problem(row.line, what, "write ccw or cw"));
            }
        };
        let angle = row.number(0, "angle_deg")?.rem_euclid(360.0);
        both[direction].push([angle, row.number(2, "reading_um")? * 1e-3]);
    }
    for (readings, name) in both.iter_mut().zip(["ccw", "cw"]) {
        readings.sort_by(|a, b| a[0].total_cmp(&b[0]));
        // A circle that ends where it began has two readings there.
        let of_angle = readings.chunk_by(|a, b| a[0] == b[0]);
        let mean = |same: &[[f64; 2]]| {
            let sum = same.iter().map(|[_, reading]| reading).sum::<f64>();
            [same[0][0], sum / same.len() as f64]
        };
        *readings = of_angle.map(mean).collect();
        check(readings, name)?;
    }
    Ok(both)
}

/// Checks that readings of one direction go around the circle.
fn check(readings: &[[f64; 2]], name: &str) -> Result<(), FileProblem> {
    let Some([first, _]) = readings.first() else {
        let what = format!("no readings with direction {name}");
        return Err(problem(0, what, "measure the circle in both directions"));
    };
    let next = readings[1..].iter().map(|[angle, _]| *angle);
    for ([angle, _], next) in readings.iter().zip(next.chain([first + 360.0])) {
        if next - angle > LARGEST_GAP {
            let what = format!(
                "{name} has no reading between {angle} and {} degrees",
                next % 360.0
            );
            let remedy = format!("readings may be {LARGEST_GAP} degrees apart; measure the gap");
            return Err(problem(0, what, remedy));
        }
    }
    Ok(())
}
