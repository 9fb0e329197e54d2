//! DXF drawings: every entity kind, the listings of the thesis, and bad files.

mod blocks;
mod curves;
mod left_out;
mod refusals;

use haptimill_engrave::drawing::{Drawing, Problem};
use haptimill_engrave::geometry::{Path, Point, distance};
use haptimill_engrave::read::{ReadOptions, read};

fn draw(text: &str) -> Drawing {
    let drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(drawing.problems, []);
    drawing
}

/// The mistake of a drawing that cannot be read, or the first of its entities.
fn mistake(text: impl AsRef<[u8]>) -> Problem {
    match read(text.as_ref(), &ReadOptions::default()) {
        Err(problem) => problem,
        Ok(drawing) => drawing.problems.into_iter().next().expect("a problem"),
    }
}

fn near(a: Point, b: Point) -> bool {
    distance(a, b) < 1e-4
}

fn ends(path: &Path) -> (Point, Point) {
    (path.start().unwrap(), path.end().unwrap())
}
