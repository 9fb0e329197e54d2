//! Reader of SVG: shapes, paths, groups, references, units, transforms.
//!
//! Fill and stroke do not matter: every shape is its outline. What is not drawn (definitions,
//! metadata) is not part of the drawing; everything else that is left out is reported.

use super::svg_style::{Builder, inherited, property};
use super::text::Anchor;
use super::{COORDINATE_LIMIT, ENTITY_LIMIT, ReadOptions, text_remedy};
use crate::curves::{TOLERANCE, fit_ellipse, map_path};
use crate::drawing::{Drawing, Entity, Problem};
use crate::geometry::{Path, Point};
use kurbo::Affine;
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::BTreeMap;
use std::str::FromStr;
use svgtypes::{Align, AspectRatio, Length, LengthUnit, PointsParser, Transform, ViewBox};

/// Millimetres per CSS pixel.
const PIXEL_MM: f64 = 25.4 / 96.0;

/// Deepest nesting of elements and references.
const DEPTH: usize = 64;

const REPAIR: &str = "repair or delete the element in the drawing program";

struct Reader<'a, 'o> {
    document: &'a Document<'a>,
    /// Positions of the line ends: the document itself searches them from its beginning.
    line_ends: Vec<usize>,
    options: &'o ReadOptions<'o>,
    drawing: Drawing,
    left_out: BTreeMap<String, Vec<Entity>>,
    /// Size of the page in user units, for percentages.
    page: [f64; 2],
}

/// Reads an SVG drawing. The lower left corner of the page is the origin, y points up.
pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Drawing, Problem> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()]
            .iter()
            .filter(|&&one| one == b'\n')
            .count();
        Problem::at_line(
            line,
            "the file is not UTF-8 text",
            "save the drawing again as SVG",
        )
    })?;
    let parsing = ParsingOptions {
        allow_dtd: true,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, parsing).map_err(|error| {
        let line = error.pos().row as usize;
        let what = format!("the file is not well-formed XML: {error}");
        Problem::at_line(
            line,
            what,
            "the file is damaged or truncated; save the drawing again",
        )
    })?;
    let root = document.root_element();
    if root.tag_name().name() != "svg" {
        return Err(Problem::general(
            format!(
                "the file is XML with the root '{}' and no SVG",
                root.tag_name().name()
            ),
            "pass an SVG or an ASCII DXF drawing",
        ));
    }
    let mut reader = Reader {
        document: &document,
        line_ends: text.match_indices('\n').map(|(at, _)| at).collect(),
        options,
        drawing: Drawing::default(),
        left_out: BTreeMap::new(),
        page: [100.0, 100.0],
    };
    let map = reader.page(root)?;
    reader.children(root, map, "", 0)?;
    let Reader {
        mut drawing,
        left_out,
        ..
    } = reader;
    for (reason, entities) in left_out {
        let shown: Vec<String> = entities.iter().take(3).map(ToString::to_string).collect();
        let more = match entities.len() {
            0..=3 => String::new(),
            count => format!("; and {} more", count - 3),
        };
        drawing
            .notices
            .push(format!("left out, {reason}: {}{more}", shown.join("; ")));
    }
    Ok(drawing)
}

impl<'a> Reader<'a, '_> {
    /// Map of the root's user units to mm with y up.
    fn page(&mut self, root: Node<'a, 'a>) -> Result<Affine, Problem> {
        let view = match root.attribute("viewBox") {
            None => None,
            Some(text) => Some(ViewBox::from_str(text).map_err(|error| {
                Problem::of(&self.entity(root, ""), format!("viewBox: {error}"), REPAIR)
            })?),
        };
        let size = |name: &str| -> Result<Option<f64>, Problem> {
            let Some(text) = root.attribute(name) else {
                return Ok(None);
            };
            let length = Length::from_str(text).map_err(|error| {
                Problem::of(&self.entity(root, ""), format!("{name}: {error}"), REPAIR)
            })?;
            Ok((length.unit != LengthUnit::Percent).then(|| length.number * unit_mm(length.unit)))
        };
        let (width, height) = (size("width")?, size("height")?);
        let (x, y, w, h) = match (&view, width, height) {
            (Some(view), ..) => (view.x, view.y, view.w, view.h),
            (None, Some(width), Some(height)) => (0.0, 0.0, width / PIXEL_MM, height / PIXEL_MM),
            (None, ..) => {
                self.drawing.notices.push(
                    "the drawing states no size of its page: its upper left corner is the origin, \
                     and y is negative below it"
                        .into(),
                );
                (0.0, 0.0, 100.0, 0.0)
            }
        };
        self.page = [w, h];
        let physical = |text: &str| text.ends_with(|one: char| one.is_ascii_alphabetic());
        let stated = root.attribute("width").is_some_and(physical)
            || root.attribute("height").is_some_and(physical);
        if let Some(unit) = self.options.unit_mm {
            return Ok(Affine::new([
                unit,
                0.0,
                0.0,
                -unit,
                -x * unit,
                (y + h) * unit,
            ]));
        }
        if !stated {
            self.drawing.notices.push(
                "the drawing states no physical size: 1 unit is taken as 1 CSS pixel, 25.4/96 mm; \
                 --unit mm sets another"
                    .into(),
            );
        }
        let (sx, sy) = match (width, height) {
            (Some(width), Some(height)) => (width / w, height / h),
            (Some(width), None) => (width / w, width / w),
            (None, Some(height)) => (height / h, height / h),
            (None, None) => (PIXEL_MM, PIXEL_MM),
        };
        let keeps = root
            .attribute("preserveAspectRatio")
            .map(AspectRatio::from_str);
        let stretches = keeps.is_some_and(|one| one.is_ok_and(|one| one.align == Align::None));
        if stretches || h == 0.0 {
            return Ok(Affine::new([sx, 0.0, 0.0, -sy, -x * sx, (y + h) * sy]));
        }
        // The drawing in the middle of its page, as browsers place it.
        let scale = sx.min(sy);
        let left = (w * sx - w * scale) / 2.0;
        let low = (h * sy - h * scale) / 2.0;
        Ok(Affine::new([
            scale,
            0.0,
            0.0,
            -scale,
            left - x * scale,
            low + (y + h) * scale,
        ]))
    }

    fn entity(&self, node: Node, layer: &str) -> Entity {
        let start = node.range().start;
        Entity {
            kind: node.tag_name().name().to_string(),
            handle: node.attribute("id").map(str::to_string),
            layer: layer.to_string(),
            line: 1 + self.line_ends.partition_point(|&end| end < start),
        }
    }

    fn leave_out(&mut self, reason: &str, node: Node, layer: &str) {
        let entity = self.entity(node, layer);
        self.left_out
            .entry(reason.to_string())
            .or_default()
            .push(entity);
    }

    fn children(
        &mut self,
        node: Node<'a, 'a>,
        map: Affine,
        layer: &str,
        depth: usize,
    ) -> Result<(), Problem> {
        for child in node.children().filter(Node::is_element) {
            self.element(child, map, layer, depth + 1)?;
        }
        Ok(())
    }

    fn element(
        &mut self,
        node: Node<'a, 'a>,
        map: Affine,
        layer: &str,
        depth: usize,
    ) -> Result<(), Problem> {
        let name = node.tag_name().name();
        let ours = matches!(
            node.tag_name().namespace(),
            None | Some("http://www.w3.org/2000/svg")
        );
        let undrawn = matches!(
            name,
            "defs"
                | "metadata"
                | "title"
                | "desc"
                | "symbol"
                | "marker"
                | "clipPath"
                | "mask"
                | "pattern"
                | "linearGradient"
                | "radialGradient"
                | "filter"
                | "style"
                | "script"
        );
        if !ours || undrawn {
            return Ok(());
        }
        if depth > DEPTH || self.drawing.entities.len() > ENTITY_LIMIT {
            self.drawing.problems.push(Problem::of(
                &self.entity(node, layer),
                "it is nested too deep, contains itself, or is one of too many",
                "unlink the clones in the drawing program",
            ));
            return Ok(());
        }
        if property(node, "display") == Some("none") {
            self.leave_out("it is hidden (display none)", node, layer);
            return Ok(());
        }
        for clip in ["clip-path", "mask"] {
            if property(node, clip).is_some_and(|value| value != "none") {
                self.leave_out(&format!("only the {clip} and not the element"), node, layer);
            }
        }
        let map = match node.attribute("transform") {
            None => map,
            Some(text) => match Transform::from_str(text) {
                Ok(t) => map * Affine::new([t.a, t.b, t.c, t.d, t.e, t.f]),
                Err(error) => {
                    self.problem(node, layer, format!("transform: {error}"));
                    return Ok(());
                }
            },
        };
        match name {
            "g" | "a" | "svg" | "switch" => {
                let map = if name == "svg" {
                    map * self.inner_page(node)
                } else {
                    map
                };
                let label = group_label(node).unwrap_or(layer);
                return self.children(node, map, label, depth);
            }
            "use" => return self.reference(node, map, layer, depth),
            "text" => {
                self.text(node, map, layer);
                return Ok(());
            }
            _ => {}
        }
        if inherited(node, "visibility").is_some_and(|value| value != "visible") {
            self.leave_out("it is not visible", node, layer);
            return Ok(());
        }
        match self.shape(node, map) {
            Ok(Some(paths)) => self.add(node, layer, paths),
            Ok(None) => self.leave_out(&format!("{name} is not a path"), node, layer),
            Err(what) => self.problem(node, layer, what),
        }
        Ok(())
    }

    fn problem(&mut self, node: Node, layer: &str, what: impl std::fmt::Display) {
        let problem = Problem::of(&self.entity(node, layer), what, REPAIR);
        self.drawing.problems.push(problem);
    }

    fn add(&mut self, node: Node, layer: &str, mut paths: Vec<Path>) {
        paths.retain(|path| path.length() > 1e-9);
        if paths.is_empty() {
            self.leave_out("it has no length", node, layer);
            return;
        }
        let finite = |at: Point| at.iter().all(|value| value.abs() <= COORDINATE_LIMIT);
        let inside = paths
            .iter()
            .all(|path| path.vertices.iter().all(|vertex| finite(vertex.at)));
        if !inside {
            let what = format!("a point is farther than {COORDINATE_LIMIT} mm from the origin");
            self.problem(node, layer, what);
            return;
        }
        let index = self.drawing.add_entity(self.entity(node, layer));
        for path in &mut paths {
            path.entity = index;
        }
        self.drawing.paths.append(&mut paths);
    }

    /// Map of a nested `svg` element.
    fn inner_page(&self, node: Node) -> Affine {
        let value = |name: &str, axis: usize| self.length(node, name, axis).ok().flatten();
        let at = (value("x", 0).unwrap_or(0.0), value("y", 1).unwrap_or(0.0));
        let place = Affine::translate(at);
        let view = node
            .attribute("viewBox")
            .and_then(|text| ViewBox::from_str(text).ok());
        let Some(view) = view else { return place };
        let (width, height) = (value("width", 0), value("height", 1));
        let scale = |size: Option<f64>, of: f64| size.map_or(1.0, |size| size / of);
        let scale = scale(width, view.w).min(scale(height, view.h));
        place * Affine::scale(scale) * Affine::translate((-view.x, -view.y))
    }

    fn reference(
        &mut self,
        node: Node<'a, 'a>,
        map: Affine,
        layer: &str,
        depth: usize,
    ) -> Result<(), Problem> {
        let link = node
            .attributes()
            .find(|one| one.name() == "href")
            .map(|one| one.value());
        let id = link.and_then(|link| link.strip_prefix('#'));
        let target = id.and_then(|id| {
            self.document
                .descendants()
                .find(|node| node.attribute("id") == Some(id))
        });
        let Some(target) = target else {
            self.problem(
                node,
                layer,
                format!("there is no element {}", link.unwrap_or("?")),
            );
            return Ok(());
        };
        let value = |name: &str, axis| self.length(node, name, axis).ok().flatten().unwrap_or(0.0);
        let map = map * Affine::translate((value("x", 0), value("y", 1)));
        if target.tag_name().name() == "symbol" {
            let map = map * self.inner_page(target);
            return self.children(target, map, layer, depth + 1);
        }
        self.element(target, map, layer, depth + 1)
    }

    /// A length in user units.
    fn length(&self, node: Node, name: &str, axis: usize) -> Result<Option<f64>, String> {
        let Some(text) = node.attribute(name) else {
            return Ok(None);
        };
        let length = Length::from_str(text).map_err(|error| format!("{name}: {error}"))?;
        if !length.number.is_finite() {
            return Err(format!("{name} is no finite number"));
        }
        Ok(Some(match length.unit {
            LengthUnit::None | LengthUnit::Px => length.number,
            LengthUnit::Percent => length.number / 100.0 * self.page[axis],
            LengthUnit::Em => length.number * font_size(node),
            LengthUnit::Ex => length.number * font_size(node) / 2.0,
            unit => length.number * unit_mm(unit) / PIXEL_MM,
        }))
    }

    /// Paths of a shape; `None` for an element that is not one.
    fn shape(&self, node: Node, map: Affine) -> Result<Option<Vec<Path>>, String> {
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
                let points: Vec<Point> = PointsParser::from(text).map(|(x, y)| [x, y]).collect();
                let numbers = text.split([',', ' ', '\n', '\t', '\r']);
                let numbers = numbers.filter(|word| !word.is_empty()).count();
                if numbers % 2 != 0 || points.len() != numbers / 2 {
                    return Err("its points are not pairs of numbers".into());
                }
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
                let (rx, ry) = match self.length(node, "r", 0)? {
                    Some(r) => (r, r),
                    None => (or("rx", 0, 0.0)?, or("ry", 1, 0.0)?),
                };
                if rx < 0.0 || ry < 0.0 {
                    return Err("its radius is negative".into());
                }
                return Ok(Some(vec![ellipse(map, centre, rx, ry)]));
            }
            _ => return Ok(None),
        }
        Ok(Some(builder.paths))
    }

    fn text(&mut self, node: Node, map: Affine, layer: &str) {
        let entity = self.entity(node, layer);
        let words = |node: Node| -> String {
            let parts = node.descendants().filter(Node::is_text);
            let all: String = parts.filter_map(|one| one.text()).collect();
            all.split_whitespace().collect::<Vec<_>>().join(" ")
        };
        let shown: String = words(node).chars().take(40).collect();
        let Some(font) = self.options.font else {
            if self.options.skip_text {
                self.leave_out(&format!("'{shown}' is text without a font"), node, layer);
                return;
            }
            let what = format!("'{shown}' is text, which has no outlines of its own");
            self.drawing
                .problems
                .push(Problem::of(&entity, what, text_remedy()));
            return;
        };
        let spans: Vec<Node> = node
            .children()
            .filter(|child| child.tag_name().name() == "tspan")
            .collect();
        let positioned = spans.iter().any(|span| span.attribute("x").is_some());
        let lines = if positioned { spans } else { vec![node] };
        let mut paths = Vec::new();
        for line in lines {
            let size = font_size(line);
            let first = |name: &str| {
                let value = line.attribute(name).or_else(|| node.attribute(name))?;
                value
                    .split([',', ' '])
                    .next()?
                    .trim_end_matches("px")
                    .parse::<f64>()
                    .ok()
            };
            let at = (first("x").unwrap_or(0.0), first("y").unwrap_or(0.0));
            let anchor = match inherited(line, "text-anchor") {
                Some("middle") => Anchor::Middle,
                Some("end") => Anchor::End,
                _ => Anchor::Start,
            };
            let map = map * Affine::translate(at) * Affine::scale_non_uniform(size, -size);
            match font.outline(&words(line), anchor, map) {
                Ok(mut outline) => paths.append(&mut outline),
                Err(what) => {
                    let what = format!("'{shown}': {what}");
                    let remedy = "choose another font with --font";
                    self.drawing
                        .problems
                        .push(Problem::of(&entity, what, remedy));
                    return;
                }
            }
        }
        self.add(node, layer, paths);
    }
}

/// Label of a group: that of an Inkscape layer, else its id.
fn group_label<'a>(node: Node<'a, '_>) -> Option<&'a str> {
    let label = node
        .attributes()
        .find(|one| one.name() == "label" && one.namespace().is_some());
    label
        .map(|one| one.value())
        .or_else(|| node.attribute("id"))
}

fn font_size(node: Node) -> f64 {
    let Some(text) = inherited(node, "font-size") else {
        return 16.0;
    };
    match Length::from_str(text) {
        Ok(length) if matches!(length.unit, LengthUnit::None | LengthUnit::Px) => length.number,
        Ok(length) => length.number * unit_mm(length.unit) / PIXEL_MM,
        Err(_) => 16.0,
    }
}

/// Millimetres per absolute unit.
fn unit_mm(unit: LengthUnit) -> f64 {
    match unit {
        LengthUnit::In => 25.4,
        LengthUnit::Cm => 10.0,
        LengthUnit::Mm => 1.0,
        LengthUnit::Pt => 25.4 / 72.0,
        LengthUnit::Pc => 25.4 / 6.0,
        LengthUnit::Em => 16.0 * PIXEL_MM,
        LengthUnit::Ex => 8.0 * PIXEL_MM,
        LengthUnit::None | LengthUnit::Px | LengthUnit::Percent => PIXEL_MM,
    }
}

fn rectangle(builder: &mut Builder, [x, y]: Point, [w, h]: [f64; 2], radii: [f64; 2]) {
    let [rx, ry] = [
        radii[0].min(w / 2.0).max(0.0),
        radii[1].min(h / 2.0).max(0.0),
    ];
    if rx == 0.0 || ry == 0.0 {
        builder.move_to([x, y]);
        for at in [[x + w, y], [x + w, y + h], [x, y + h]] {
            builder.line_to(at);
        }
        builder.finish(true);
        return;
    }
    builder.move_to([x + rx, y]);
    let corners = [
        ([x + w - rx, y], [x + w, y + ry]),
        ([x + w, y + h - ry], [x + w - rx, y + h]),
        ([x + rx, y + h], [x, y + h - ry]),
        ([x, y + ry], [x + rx, y]),
    ];
    for (line, arc) in corners {
        builder.line_to(line);
        builder.arc_to([rx, ry], 0.0, false, true, arc);
    }
    builder.finish(true);
}

/// A circle or ellipse that starts at 0 degrees and runs counter-clockwise in the drawing plane.
fn ellipse(map: Affine, centre: Point, rx: f64, ry: f64) -> Path {
    if (rx - ry).abs() <= 1e-12 * rx {
        let mut path = map_path(map, &Path::circle(centre, rx, 0), TOLERANCE);
        if path.vertices.iter().all(|vertex| vertex.bulge < 0.0) {
            path = path.reversed();
        }
        return path;
    }
    let map = map * Affine::translate((centre[0], centre[1])) * Affine::scale_non_uniform(rx, ry);
    let mut segments = Vec::new();
    fit_ellipse(
        map,
        [0.0; 2],
        1.0,
        [0.0, -std::f64::consts::TAU],
        TOLERANCE,
        &mut segments,
    );
    let mut path = Path::from_segments(&segments, 0);
    if path.vertices.len() > 2 {
        path.vertices.pop();
        path.closed = true;
    }
    path
}
