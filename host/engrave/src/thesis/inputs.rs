//! Inputs of the experiments: the lines of figure 4.8, and shapes that stand in for lost drawings.

use super::TOOL;
use crate::drawing::Drawing;
use crate::geometry::Point;
use crate::order::edges::Ends;
use crate::order::rows::Line;
use crate::read::{ReadOptions, read};
use serde::Deserialize;

/// Figure 4.10: the lines of figure 4.8 in the order of the file; x and y of start and end.
pub const FIGURE_4_10: [[f64; 4]; 4] = [
    [10.0, 30.0, 20.0, 40.0],
    [20.0, 40.0, 40.0, 30.0],
    [20.0, 20.0, 40.0, 10.0],
    [40.0, 25.0, 40.0, 20.0],
];

/// A text as closed lines, by `host/engrave/letters.py`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Text {
    /// Its letters.
    pub text: String,
    /// Its font.
    pub font: String,
    /// Height of capitals, units of the font.
    capital: f64,
    /// x and y of the corners of each contour, units of the font.
    contours: Vec<Vec<f64>>,
}

impl Text {
    /// The texts of the thesis.
    ///
    /// # Errors
    /// The mistake in the built-in data; none is known.
    pub fn all() -> Result<Vec<Self>, String> {
        #[derive(Deserialize)]
        struct File {
            text: Vec<Text>,
        }
        toml::from_str(include_str!("../../data/letters.toml"))
            .map(|file: File| file.text)
            .map_err(|error| format!("host/engrave/data/letters.toml: {error}"))
    }

    /// Its edges in the order of the text, with capitals of this height, mm. The first letter
    /// begins at the origin.
    #[must_use]
    pub fn edges(&self, height: f64) -> Vec<Ends> {
        let size = height / self.capital;
        let corners = |contour: &Vec<f64>| -> Vec<Point> {
            let pairs = contour.chunks_exact(2);
            pairs.map(|at| [at[0] * size, at[1] * size]).collect()
        };
        let edges = self.contours.iter().flat_map(|one| polygon(&corners(one)));
        edges.map(|[start, end]| Ends { start, end }).collect()
    }
}

/// Corners of a rectangle, counter-clockwise from its lower left.
#[must_use]
pub fn rectangle(low: Point, high: Point) -> Vec<Point> {
    vec![low, [high[0], low[1]], high, [low[0], high[1]]]
}

/// Edges of a closed polygon.
#[must_use]
pub fn polygon(corners: &[Point]) -> Vec<Line> {
    (0..corners.len())
        .map(|k| [corners[k], corners[(k + 1) % corners.len()]])
        .collect()
}

/// Five squares of 15 mm, edge by edge.
#[must_use]
pub fn five_squares() -> Vec<Ends> {
    let corners = [
        [80.0, 10.0],
        [10.0, 10.0],
        [80.0, 60.0],
        [10.0, 60.0],
        [45.0, 35.0],
    ];
    corners
        .iter()
        .flat_map(|&at: &Point| polygon(&rectangle(at, [at[0] + 15.0, at[1] + 15.0])))
        .map(|[start, end]| Ends { start, end })
        .collect()
}

/// The outlines of the pockets S1, S2 and S3 (section 4.2.2), which the tool clears: a square, a
/// square with an island, the letter H of 25 x 35 mm with strokes of 5 mm.
#[must_use]
pub fn outlines() -> [Vec<Vec<Point>>; 3] {
    let r = TOOL / 2.0;
    let h = [
        [10.0, 10.0],
        [15.0, 10.0],
        [15.0, 25.0],
        [30.0, 25.0],
        [30.0, 10.0],
        [35.0, 10.0],
        [35.0, 45.0],
        [30.0, 45.0],
        [30.0, 30.0],
        [15.0, 30.0],
        [15.0, 45.0],
        [10.0, 45.0],
    ];
    [
        vec![rectangle([10.0, 10.0], [30.0, 30.0])],
        vec![
            rectangle([10.0 - r, 10.0 - r], [50.0 + r, 50.0 + r]),
            rectangle([20.0, 20.0], [40.0, 40.0]),
        ],
        vec![h.to_vec()],
    ]
}

/// Horizontal rows half a diameter apart between the edges of loops, from the top, left to right
/// (equation 4.1 and figure 4.7).
#[must_use]
pub fn hatch(loops: &[Vec<Point>]) -> Vec<Line> {
    let spacing = TOOL / 2.0;
    let ys = || loops.iter().flatten().map(|at| at[1]);
    let low = (ys().fold(f64::INFINITY, f64::min) / spacing).floor() as i64 + 1;
    let high = (ys().fold(f64::NEG_INFINITY, f64::max) / spacing).ceil() as i64 - 1;
    let mut rows = Vec::new();
    for k in (low..=high).rev() {
        let y = k as f64 * spacing;
        let mut crossings: Vec<f64> = loops
            .iter()
            .flat_map(|corners| polygon(corners))
            .filter(|[a, b]| (a[1] <= y) != (b[1] <= y))
            .map(|[a, b]| a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
            .collect();
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            if pair[1] - pair[0] > 1e-9 {
                rows.push([[pair[0], y], [pair[1], y]]);
            }
        }
    }
    rows
}

/// Offset contours of the three pockets: a square, the material around a square, the letter H.
#[must_use]
pub fn pockets() -> [Vec<Vec<Point>>; 3] {
    let r = TOOL / 2.0;
    // The letter H of 25 x 35 mm with strokes of 5 mm, made smaller by the radius of the cutter.
    let h = [
        [10.0 + r, 10.0 + r],
        [15.0 - r, 10.0 + r],
        [15.0 - r, 25.0 + r],
        [30.0 + r, 25.0 + r],
        [30.0 + r, 10.0 + r],
        [35.0 - r, 10.0 + r],
        [35.0 - r, 45.0 - r],
        [30.0 + r, 45.0 - r],
        [30.0 + r, 30.0 - r],
        [15.0 - r, 30.0 - r],
        [15.0 - r, 45.0 - r],
        [10.0 + r, 45.0 - r],
    ];
    [
        vec![rectangle([10.0 + r, 10.0 + r], [30.0 - r, 30.0 - r])],
        vec![
            rectangle([10.0, 10.0], [50.0, 50.0]),
            rectangle([20.0 - r, 20.0 - r], [40.0 + r, 40.0 + r]),
        ],
        vec![h.to_vec()],
    ]
}

/// Lines as a drawing.
#[must_use]
pub fn drawing(lines: &[Ends]) -> Drawing {
    let entities = lines.iter().map(|Ends { start, end }| {
        let ([x, y], [u, v]) = (start, end);
        format!("0\nLINE\n8\n0\n10\n{x}\n20\n{y}\n11\n{u}\n21\n{v}\n")
    });
    of_entities(&entities.collect::<String>())
}

/// Closed polygons as a drawing.
#[must_use]
pub fn closed(polygons: &[Vec<Point>]) -> Drawing {
    let entities = polygons.iter().map(|corners| {
        let points = corners.iter().map(|[x, y]| format!("10\n{x}\n20\n{y}\n"));
        let points: String = points.collect();
        format!(
            "0\nLWPOLYLINE\n8\n0\n90\n{}\n70\n1\n{points}",
            corners.len()
        )
    });
    of_entities(&entities.collect::<String>())
}

fn of_entities(entities: &str) -> Drawing {
    let text = format!("0\nSECTION\n2\nENTITIES\n{entities}0\nENDSEC\n0\nEOF\n");
    read(text.as_bytes(), &ReadOptions::default()).unwrap_or_default()
}

/// Figures 4.8 to 4.12 as a drawing.
#[must_use]
pub fn figure_4_8() -> Drawing {
    drawing(&lines_of_figure_4_8())
}

/// The lines of figure 4.8 in the order of the file.
pub(super) fn lines_of_figure_4_8() -> [Ends; 4] {
    FIGURE_4_10.map(|[x, y, u, v]| Ends {
        start: [x, y],
        end: [u, v],
    })
}
