//! Reader of SVG: shapes, paths, groups, references, units, transforms.
//!
//! Every shape is its outline, however it is painted. What is not drawn (definitions,
//! metadata) is not part of the drawing; everything else that is left out is reported.

use super::svg_shape::{Builder, ellipse, rectangle};
use super::svg_style::{Paint, Styles};
use super::svg_text::font_size;
use super::{COORDINATE_LIMIT, ENTITY_LIMIT, ReadOptions};
use crate::drawing::{Drawing, Entity, Problem};
use crate::geometry::{Path, Point};
use kurbo::Affine;
use roxmltree::{Document, Node, NodeId, ParsingOptions};
use std::collections::{BTreeMap, HashMap};
use std::str::FromStr;
use svgtypes::{Align, AspectRatio, Length, LengthUnit, NumberListParser, Transform, ViewBox};

/// Millimetres per CSS pixel.
pub const PIXEL_MM: f64 = 25.4 / 96.0;

/// Deepest nesting of elements and references.
const DEPTH: usize = 64;

/// Reason why a part of a path is left out.
const DOTS: &str = "parts of them have no length";

const REPAIR: &str = "repair or delete the element in the drawing program";

pub struct Reader<'a, 'o> {
    /// Positions of the line ends: the document itself searches them from its beginning.
    line_ends: Vec<usize>,
    pub options: &'o ReadOptions<'o>,
    pub drawing: Drawing,
    /// Entities that a notice is about, by its beginning.
    noted: BTreeMap<String, Vec<Entity>>,
    /// Elements by their id.
    pub ids: HashMap<&'a str, Node<'a, 'a>>,
    /// Style sheets.
    pub styles: Styles,
    paints: HashMap<NodeId, Paint>,
    /// Whether a group of the document is an Inkscape layer.
    layered: bool,
    /// Elements seen so far, with those of references.
    seen: usize,
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
        line_ends: text.match_indices('\n').map(|(at, _)| at).collect(),
        options,
        drawing: Drawing::default(),
        noted: BTreeMap::new(),
        styles: Styles::new(&document),
        paints: HashMap::new(),
        ids: HashMap::new(),
        layered: document.descendants().any(is_layer),
        seen: 0,
        page: [100.0, 100.0],
    };
    for node in document.descendants() {
        if let Some(id) = node.attribute("id") {
            reader.ids.entry(id).or_insert(node);
        }
    }
    let map = Affine::scale(options.scale.unwrap_or(1.0)) * reader.page(root)?;
    reader.children(root, map, "", 0)?;
    let Reader {
        mut drawing, noted, ..
    } = reader;
    for (reason, entities) in noted {
        let shown: Vec<String> = entities.iter().take(3).map(ToString::to_string).collect();
        let more = match entities.len() {
            0..=3 => String::new(),
            count => format!("; and {} more", count - 3),
        };
        drawing
            .notices
            .push(format!("{reason}: {}{more}", shown.join("; ")));
    }
    Ok(drawing)
}

impl<'a> Reader<'a, '_> {
    /// Map of the root's user units to mm with y up.
    fn page(&mut self, root: Node<'a, 'a>) -> Result<Affine, Problem> {
        let view: Option<ViewBox> = match root.attribute("viewBox") {
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
        if h == 0.0 {
            return Ok(Affine::scale_non_uniform(sx, -sy));
        }
        let view = ViewBox { x, y, w, h };
        let size = [w * sx, h * sy];
        let up = Affine::new([1.0, 0.0, 0.0, -1.0, 0.0, size[1]]);
        Ok(up * fit_view(view, size, aspect(root)))
    }

    pub fn entity(&self, node: Node, layer: &str) -> Entity {
        let start = node.range().start;
        Entity {
            kind: node.tag_name().name().to_string(),
            handle: node.attribute("id").map(str::to_string),
            layer: layer.to_string(),
            line: 1 + self.line_ends.partition_point(|&end| end < start),
        }
    }

    pub fn leave_out(&mut self, reason: &str, node: Node, layer: &str) {
        self.note(format!("left out, {reason}"), node, layer);
    }

    pub fn note(&mut self, what: String, node: Node, layer: &str) {
        let entity = self.entity(node, layer);
        self.noted.entry(what).or_default().push(entity);
    }

    /// How an element is painted, by its own properties and those of its ancestors.
    fn paint(&mut self, node: Node) -> Paint {
        let mut chain = Vec::new();
        let mut paint = Paint::default();
        for one in node.ancestors() {
            if let Some(&known) = self.paints.get(&one.id()) {
                paint = known;
                break;
            }
            chain.push(one);
        }
        for one in chain.into_iter().rev() {
            let property = |name| self.styles.property(one, name);
            if let Some(value) = property("visibility") {
                paint.hidden = value != "visible";
            }
            if let Some(value) = property("fill") {
                paint.unfilled = value == "none";
            }
            if let Some(value) = property("stroke") {
                paint.stroked = value != "none";
            }
            if let Some(value) = property("stroke-dasharray") {
                paint.dashed =
                    value != "none" && value.contains(|digit: char| matches!(digit, '1'..='9'));
            }
            let markers = ["marker", "marker-start", "marker-mid", "marker-end"];
            for value in markers.into_iter().filter_map(property) {
                paint.marked = value != "none";
            }
            if one.has_children() {
                self.paints.insert(one.id(), paint);
            }
        }
        paint
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
        // References within references can multiply: the copies are counted, also those of nothing.
        self.seen += 1;
        if self.seen > ENTITY_LIMIT {
            return Err(Problem::general(
                format!("the drawing has more than {ENTITY_LIMIT} elements with its references"),
                "unlink the clones in the drawing program, or split the drawing",
            ));
        }
        if depth > DEPTH {
            self.drawing.problems.push(Problem::of(
                &self.entity(node, layer),
                "it is nested too deep, or contains itself",
                "unlink the clones in the drawing program",
            ));
            return Ok(());
        }
        if self.styles.property(node, "display") == Some("none") {
            self.leave_out("it is hidden (display none)", node, layer);
            return Ok(());
        }
        let opacity = self.styles.property(node, "opacity");
        if opacity.is_some_and(|text| text.trim_end_matches('%').parse() == Ok(0.0)) {
            self.note("cut although they are transparent".into(), node, layer);
        }
        let transform = self.styles.property(node, "transform");
        let map = match transform {
            None => map,
            Some(text) => match Transform::from_str(text) {
                Ok(t) => map * Affine::new([t.a, t.b, t.c, t.d, t.e, t.f]),
                Err(error) => {
                    self.problem(node, layer, format!("transform: {error}"));
                    return Ok(());
                }
            },
        };
        let first = self.drawing.paths.len();
        self.drawn(node, map, layer, depth)?;
        self.clip(node, map, layer, first);
        Ok(())
    }

    /// An element after its own transform.
    fn drawn(
        &mut self,
        node: Node<'a, 'a>,
        map: Affine,
        layer: &str,
        depth: usize,
    ) -> Result<(), Problem> {
        let name = node.tag_name().name();
        match name {
            "g" | "a" | "svg" | "switch" => {
                let drawn = node.children().filter(|child| {
                    child.is_element() && child.tag_name().name() != "foreignObject"
                });
                if name == "switch" && drawn.count() > 1 {
                    let what = "all alternatives of a switch are cut";
                    self.note(what.into(), node, layer);
                }
                let layer = self.layer_of(node, layer);
                if name == "svg" {
                    let first = self.drawing.paths.len();
                    let inner = map * self.inner_page(node, None);
                    self.children(node, inner, layer, depth)?;
                    self.clip_to_frame(node, map, layer, first);
                    return Ok(());
                }
                return self.children(node, map, layer, depth);
            }
            "use" => return self.reference(node, map, layer, depth),
            "text" | "flowRoot" => {
                self.text(node, map, layer);
                return Ok(());
            }
            _ => {}
        }
        let paint = self.paint(node);
        if paint.hidden {
            self.leave_out("it is not visible", node, layer);
            return Ok(());
        }
        if paint.dashed {
            self.note("dashed lines are cut whole".into(), node, layer);
        }
        if paint.marked && matches!(name, "path" | "line" | "polyline" | "polygon") {
            self.note("left out, their markers (arrow heads)".into(), node, layer);
        }
        if paint.unfilled && !paint.stroked {
            self.note(
                "cut although they have neither fill nor stroke".into(),
                node,
                layer,
            );
        }
        match self.shape(node, map) {
            Ok(Some((paths, dots))) => {
                if dots > 0 && !paths.is_empty() {
                    self.leave_out(DOTS, node, layer);
                }
                self.add(node, layer, paths);
            }
            Ok(None) => self.leave_out(&format!("{name} is not a path"), node, layer),
            Err(what) => self.problem(node, layer, what),
        }
        Ok(())
    }

    /// Layer of what a group holds. In a document with Inkscape layers only they count; otherwise
    /// the outermost groups with a label or an id do.
    fn layer_of<'l>(&self, node: Node<'a, 'a>, layer: &'l str) -> &'l str
    where
        'a: 'l,
    {
        let counts = if self.layered {
            is_layer(node)
        } else {
            layer.is_empty()
        };
        if counts {
            group_label(node).unwrap_or(layer)
        } else {
            layer
        }
    }

    pub fn located(&self, node: Node, layer: &str, what: impl std::fmt::Display) -> Problem {
        Problem::of(&self.entity(node, layer), what, REPAIR)
    }

    fn problem(&mut self, node: Node, layer: &str, what: impl std::fmt::Display) {
        let problem = self.located(node, layer, what);
        self.drawing.problems.push(problem);
    }

    pub fn add(&mut self, node: Node, layer: &str, mut paths: Vec<Path>) {
        let count = paths.len();
        paths.retain(|path| path.length() > 1e-9);
        if paths.is_empty() {
            self.leave_out("it has no length", node, layer);
            return;
        }
        if paths.len() < count {
            self.leave_out(DOTS, node, layer);
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

    /// Map of a nested `svg` element, or of a symbol by its reference.
    fn inner_page(&self, node: Node, reference: Option<Node>) -> Affine {
        let of = |node: Node, name: &str, axis: usize| self.length(node, name, axis).ok().flatten();
        let place = Affine::translate(self.place(node));
        let view = node
            .attribute("viewBox")
            .and_then(|text| ViewBox::from_str(text).ok());
        let Some(view) = view else { return place };
        let size = |name: &str, axis: usize| {
            let stated = reference.and_then(|one| of(one, name, axis));
            let size = stated
                .or_else(|| of(node, name, axis))
                .unwrap_or(self.page[axis]);
            if size > 0.0 {
                size
            } else {
                [view.w, view.h][axis]
            }
        };
        place * fit_view(view, [size("width", 0), size("height", 1)], aspect(node))
    }

    /// Upper left corner of a nested `svg` element.
    pub fn place(&self, node: Node) -> (f64, f64) {
        let at = |name: &str, axis: usize| self.length(node, name, axis).ok().flatten();
        (at("x", 0).unwrap_or(0.0), at("y", 1).unwrap_or(0.0))
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
        let target = id.and_then(|id| self.ids.get(id).copied());
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
            let map = map * self.inner_page(target, Some(node));
            let first = self.drawing.paths.len();
            self.children(target, map, layer, depth + 1)?;
            self.clip(target, map, layer, first);
            return Ok(());
        }
        self.element(target, map, layer, depth + 1)
    }

    /// A length in user units.
    pub fn length(&self, node: Node, name: &str, axis: usize) -> Result<Option<f64>, String> {
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
            LengthUnit::Em => length.number * font_size(&self.styles, node),
            LengthUnit::Ex => length.number * font_size(&self.styles, node) / 2.0,
            unit => length.number * unit_mm(unit) / PIXEL_MM,
        }))
    }

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

/// Whether an element is a layer of Inkscape.
fn is_layer(node: Node) -> bool {
    let mode = |one: roxmltree::Attribute| one.name() == "groupmode" && one.value() == "layer";
    node.attributes().any(mode)
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

/// How a viewport shows its content.
fn aspect(node: Node) -> AspectRatio {
    let stated = node.attribute("preserveAspectRatio");
    let parsed = stated.and_then(|text| AspectRatio::from_str(text).ok());
    parsed.unwrap_or_default()
}

/// Map of the user units of a view box to a viewport of a size, y down.
fn fit_view(view: ViewBox, size: [f64; 2], aspect: AspectRatio) -> Affine {
    let scale = [size[0] / view.w, size[1] / view.h];
    let origin = Affine::translate((-view.x, -view.y));
    let parts = match aspect.align {
        Align::None => {
            return Affine::scale_non_uniform(scale[0], scale[1]) * origin;
        }
        Align::XMinYMin => [0.0, 0.0],
        Align::XMidYMin => [0.5, 0.0],
        Align::XMaxYMin => [1.0, 0.0],
        Align::XMinYMid => [0.0, 0.5],
        Align::XMidYMid => [0.5, 0.5],
        Align::XMaxYMid => [1.0, 0.5],
        Align::XMinYMax => [0.0, 1.0],
        Align::XMidYMax => [0.5, 1.0],
        Align::XMaxYMax => [1.0, 1.0],
    };
    let scale = if aspect.slice {
        scale[0].max(scale[1])
    } else {
        scale[0].min(scale[1])
    };
    let rest = [size[0] - view.w * scale, size[1] - view.h * scale];
    Affine::translate((parts[0] * rest[0], parts[1] * rest[1])) * Affine::scale(scale) * origin
}

/// Millimetres per absolute unit.
pub fn unit_mm(unit: LengthUnit) -> f64 {
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
