//! Clip paths and masks of SVG elements.

use super::Reader;
use crate::geometry::{Path, Point};
use kurbo::{Affine, Rect};
use roxmltree::Node;
use std::str::FromStr;
use svgtypes::Transform;

/// Distance by which a path may reach over a clip path, mm.
const MARGIN_MM: f64 = 0.01;

impl<'a> Reader<'a, '_> {
    /// Refuses an element whose clip path or mask hides a part of its paths, which are those from
    /// the index `first` on. A clip path that holds all of them changes nothing: many programs
    /// write one around the page.
    pub fn clip(&mut self, node: Node<'a, 'a>, map: Affine, layer: &str, first: usize) {
        for name in ["clip-path", "mask"] {
            let value = self.styles.property(node, name);
            let Some(value) = value.filter(|&value| value != "none") else {
                continue;
            };
            let id = value.trim_start_matches("url(").trim_end_matches(')');
            let id = id.trim_matches(['"', '\'', ' ']).trim_start_matches('#');
            // A reference to nothing clips nothing.
            let Some(&target) = self.ids.get(id) else {
                continue;
            };
            let bounds = self.drawing.paths[first..].iter().filter_map(Path::bounds);
            let corners: Vec<Point> = bounds
                .flat_map(|[l, h]| [l, [h[0], l[1]], h, [l[0], h[1]]])
                .collect();
            let whole = name == "clip-path" && self.holds(target, map, &corners);
            if corners.is_empty() || whole {
                continue;
            }
            self.refuse_hidden(node, layer, name, &format!("{name} '{id}'"));
        }
    }

    /// Refuses a nested `svg` element whose frame hides a part of its paths, as [`Reader::clip`].
    /// `map` is that of its parent.
    pub fn clip_to_frame(&mut self, node: Node<'a, 'a>, map: Affine, layer: &str, first: usize) {
        let overflow = self.styles.property(node, "overflow");
        if matches!(overflow, Some("visible" | "auto")) {
            return;
        }
        let size = |name, axis| self.length(node, name, axis).ok().flatten();
        let (Some(width), Some(height)) = (size("width", 0), size("height", 1)) else {
            return;
        };
        let (x, y) = self.place(node);
        let frame = Rect::new(x, y, x + width, y + height);
        let scale = map.determinant().abs().sqrt().max(1e-9);
        let frame = frame.inflate(MARGIN_MM / scale, MARGIN_MM / scale);
        let back = map.inverse();
        let paths = self.drawing.paths[first..].iter();
        let hides = paths.filter_map(Path::bounds).any(|[l, h]| {
            let corners = [l, [h[0], l[1]], h, [l[0], h[1]]];
            corners
                .iter()
                .any(|[x, y]| !frame.contains(back * kurbo::Point::new(*x, *y)))
        });
        if hides {
            self.refuse_hidden(node, layer, "frame", "frame (overflow hidden)");
        }
    }

    /// Refuses an element of which a part is hidden, or notes that it is cut whole.
    fn refuse_hidden(&mut self, node: Node<'a, 'a>, layer: &str, kind: &str, name: &str) {
        if self.options.ignore_clips {
            self.note(format!("cut whole, without their {kind}"), node, layer);
            return;
        }
        let what = format!("its {name} hides a part of it, which would be cut");
        let remedy = "apply the clip in the drawing program (in Inkscape: Path > Intersection), or \
                      cut the element whole with --ignore-clips";
        let mut problem = self.located(node, layer, what);
        problem.remedy = remedy.into();
        self.drawing.problems.push(problem);
    }

    /// Whether a clip path is one convex polygon around all points.
    fn holds(&self, clip: Node<'a, 'a>, map: Affine, points: &[Point]) -> bool {
        if clip.attribute("clipPathUnits") == Some("objectBoundingBox") {
            return false;
        }
        let mut elements = clip.children().filter(Node::is_element);
        let (Some(shape), None) = (elements.next(), elements.next()) else {
            return false;
        };
        let transform = |node: Node| match node.attribute("transform") {
            None => Some(Affine::IDENTITY),
            Some(text) => {
                let t = Transform::from_str(text).ok()?;
                Some(Affine::new([t.a, t.b, t.c, t.d, t.e, t.f]))
            }
        };
        let (Some(outer), Some(inner)) = (transform(clip), transform(shape)) else {
            return false;
        };
        let paths = match self.shape(shape, map * outer * inner) {
            Ok(Some((paths, _))) => paths,
            _ => return false,
        };
        let [path] = paths.as_slice() else {
            return false;
        };
        let straight = path.vertices.iter().all(|vertex| vertex.bulge == 0.0);
        if !straight || path.vertices.len() < 3 {
            return false;
        }
        // A polygon is convex, and the points are in it, where all of both are on one side of
        // every edge.
        let count = path.vertices.len();
        let side = |k: usize, at: Point| {
            let (a, b) = (path.vertices[k].at, path.vertices[(k + 1) % count].at);
            let edge = [b[0] - a[0], b[1] - a[1]];
            let length = edge[0].hypot(edge[1]);
            (edge[0] * (at[1] - a[1]) - edge[1] * (at[0] - a[0])) / length.max(1e-9)
        };
        let corners = path.vertices.iter().map(|vertex| vertex.at);
        let all: Vec<Point> = corners.chain(points.iter().copied()).collect();
        [1.0, -1.0]
            .into_iter()
            .any(|sign| (0..count).all(|k| all.iter().all(|&at| sign * side(k, at) >= -MARGIN_MM)))
    }
}
