//! Text as outlines of a TrueType or OpenType font.

use crate::curves::fit_cubic;
use crate::drawing::Problem;
use crate::geometry::{Path, Point, Segment};
use kurbo::{Affine, CubicBez, QuadBez};
use ttf_parser::{Face, OutlineBuilder};

/// A font.
pub struct Font<'a> {
    face: Face<'a>,
}

/// Where a line of text begins along its baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// The text begins at the point.
    Start,
    /// The middle of the text is at the point.
    Middle,
    /// The text ends at the point.
    End,
}

impl<'a> Font<'a> {
    /// Reads the first face of a font file.
    ///
    /// # Errors
    /// The bytes are not a font.
    pub fn new(bytes: &'a [u8]) -> Result<Self, Problem> {
        let face = Face::parse(bytes, 0).map_err(|error| {
            Problem::general(
                format!("the font cannot be read: {error}"),
                "pass a TrueType or OpenType font (.ttf, .otf)",
            )
        })?;
        Ok(Self { face })
    }

    /// Units of an em.
    fn em(&self) -> f64 {
        f64::from(self.face.units_per_em())
    }

    /// Box of the outline of a letter, in units of the font.
    fn letter(&self, one: char) -> Option<ttf_parser::Rect> {
        let glyph = self.face.glyph_index(one)?;
        self.face.glyph_bounding_box(glyph)
    }

    /// Height of a capital letter, in ems: the one that the font states, else that of its H.
    #[must_use]
    pub fn capital_height(&self) -> f64 {
        let stated = self.face.capital_height().filter(|&height| height > 0);
        let height = stated.or_else(|| self.letter('H').map(|one| one.y_max));
        let height = height.filter(|&height| height > 0);
        height.map_or(0.7, |height| f64::from(height) / self.em())
    }

    /// How far letters reach below the baseline, in ems: the p, else what the font states.
    #[must_use]
    pub fn descent(&self) -> f64 {
        let lowest = self.letter('p').map(|one| one.y_min);
        let lowest = lowest.unwrap_or_else(|| self.face.descender());
        (-f64::from(lowest) / self.em()).max(0.0)
    }

    /// Outlines of a line of text with its baseline along x from the origin and an em of 1,
    /// mapped by `map`. Curves are arcs within the tolerance.
    ///
    /// # Errors
    /// The characters that the font does not have.
    pub fn outline(
        &self,
        text: &str,
        anchor: Anchor,
        map: Affine,
        tolerance: f64,
    ) -> Result<Vec<Path>, String> {
        let missing: String = text
            .chars()
            .filter(|&one| self.face.glyph_index(one).is_none())
            .collect();
        if !missing.is_empty() {
            return Err(format!("the font has no glyph for '{missing}'"));
        }
        let shift = match anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -self.width(text) / 2.0,
            Anchor::End => -self.width(text),
        };
        let mut x = shift * self.em();
        let mut paths = Vec::new();
        for one in text.chars() {
            let Some(glyph) = self.face.glyph_index(one) else {
                continue;
            };
            let map = map * Affine::scale(1.0 / self.em()) * Affine::translate((x, 0.0));
            let mut outline = Outline {
                map,
                tolerance,
                start: [0.0; 2],
                at: [0.0; 2],
                segments: Vec::new(),
                paths: &mut paths,
            };
            self.face.outline_glyph(glyph, &mut outline);
            x += f64::from(self.face.glyph_hor_advance(glyph).unwrap_or(0));
        }
        Ok(paths)
    }

    /// Width of a line of text, in ems.
    #[must_use]
    pub fn width(&self, text: &str) -> f64 {
        let glyphs = text.chars().filter_map(|one| self.face.glyph_index(one));
        let advances = glyphs.filter_map(|glyph| self.face.glyph_hor_advance(glyph));
        advances.map(f64::from).sum::<f64>() / self.em()
    }
}

/// Collects the outlines of a glyph.
struct Outline<'p> {
    map: Affine,
    tolerance: f64,
    start: Point,
    at: Point,
    segments: Vec<Segment>,
    paths: &'p mut Vec<Path>,
}

impl Outline<'_> {
    fn image(&self, x: f32, y: f32) -> Point {
        crate::curves::map_point(self.map, [f64::from(x), f64::from(y)])
    }

    fn cubic(&mut self, b: Point, c: Point, d: Point) {
        let point = |at: Point| kurbo::Point::new(at[0], at[1]);
        let cubic = CubicBez::new(point(self.at), point(b), point(c), point(d));
        fit_cubic(cubic, self.tolerance, &mut self.segments);
        self.at = d;
    }
}

impl OutlineBuilder for Outline<'_> {
    fn move_to(&mut self, x: f32, y: f32) {
        self.start = self.image(x, y);
        self.at = self.start;
        self.segments.clear();
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let to = self.image(x, y);
        if to != self.at {
            self.segments.push(Segment {
                from: self.at,
                to,
                bulge: 0.0,
            });
            self.at = to;
        }
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let point = |at: Point| kurbo::Point::new(at[0], at[1]);
        let (b, c) = (self.image(x1, y1), self.image(x, y));
        let cubic = QuadBez::new(point(self.at), point(b), point(c)).raise();
        self.cubic([cubic.p1.x, cubic.p1.y], [cubic.p2.x, cubic.p2.y], c);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let (b, c, d) = (self.image(x1, y1), self.image(x2, y2), self.image(x, y));
        self.cubic(b, c, d);
    }

    fn close(&mut self) {
        if self.at != self.start {
            self.segments.push(Segment {
                from: self.at,
                to: self.start,
                bulge: 0.0,
            });
        }
        let mut path = Path::from_segments(&self.segments, 0);
        if path.vertices.len() > 2 {
            path.vertices.pop();
            path.closed = true;
            self.paths.push(path);
        }
        self.segments.clear();
        self.at = self.start;
    }
}
