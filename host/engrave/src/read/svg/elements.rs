//! Shape elements of SVG: their attributes as paths.

use super::Reader;
use super::shape::{Builder, ellipse, rectangle};
use crate::geometry::{Path, Point};
use kurbo::Affine;
use roxmltree::Node;
use svgtypes::NumberListParser;

impl Reader<'_, '_> {
    /// Paths of a shape, and the number of its dots; `None` for an element that is not one.
    pub fn shape(&self, node: Node, map: Affine) -> Result<Option<(Vec<Path>, usize)>, String> {
        let or = |name: &str, axis, default: f64| -> Result<f64, String> {
            Ok(self.length(node, name, axis)?.unwrap_or(default))
        };
        let mut builder = Builder::new(map);
        match node.tag_name().name() {
            "path" => {
                let data = node.attribute("d").unwrap_or("");
                builder
                    .data(data)
                    .map_err(|error| format!("path data: {error}"))?;
            }
            "line" => {
                builder.move_to([or("x1", 0, 0.0)?, or("y1", 1, 0.0)?]);
                builder.line_to([or("x2", 0, 0.0)?, or("y2", 1, 0.0)?]);
                builder.finish(false);
            }
            name @ ("polyline" | "polygon") => {
                let text = node.attribute("points").unwrap_or("");
                let numbers: Result<Vec<f64>, _> = NumberListParser::from(text).collect();
                let Some(numbers) = numbers.ok().filter(|all| all.len() % 2 == 0) else {
                    return Err("its points are not pairs of numbers".into());
                };
                let points: Vec<Point> = numbers.chunks_exact(2).map(|at| [at[0], at[1]]).collect();
                if let Some((&first, rest)) = points.split_first() {
                    builder.move_to(first);
                    rest.iter().for_each(|&at| builder.line_to(at));
                    builder.finish(name == "polygon");
                }
            }
            "rect" => {
                let at = [or("x", 0, 0.0)?, or("y", 1, 0.0)?];
                let size = [or("width", 0, 0.0)?, or("height", 1, 0.0)?];
                if size.iter().any(|&side| side < 0.0) {
                    return Err("its width or height is negative".into());
                }
                let (rx, ry) = (self.length(node, "rx", 0)?, self.length(node, "ry", 1)?);
                let radii = [rx.or(ry).unwrap_or(0.0), ry.or(rx).unwrap_or(0.0)];
                rectangle(&mut builder, at, size, radii);
            }
            "circle" | "ellipse" => {
                let centre = [or("cx", 0, 0.0)?, or("cy", 1, 0.0)?];
                let (rx, ry) = if node.tag_name().name() == "circle" {
                    let r = or("r", 0, 0.0)?;
                    (r, r)
                } else {
                    // A radius that is not stated is that of the other axis.
                    let (rx, ry) = (self.length(node, "rx", 0)?, self.length(node, "ry", 1)?);
                    (rx.or(ry).unwrap_or(0.0), ry.or(rx).unwrap_or(0.0))
                };
                if rx < 0.0 || ry < 0.0 {
                    return Err("its radius is negative".into());
                }
                return Ok(Some((vec![ellipse(map, centre, rx, ry)], 0)));
            }
            _ => return Ok(None),
        }
        Ok(Some((builder.paths, builder.dots)))
    }
}
