//! Reader of SVG: shapes, paths, groups, references, units, transforms.
//!
//! Every shape is its outline, however it is painted. What is not drawn (definitions,
//! metadata) is not part of the drawing; everything else that is left out is reported.

mod clip;
mod elements;
mod page;
mod shape;
mod style;
mod text;

use super::{COORDINATE_LIMIT, ENTITY_LIMIT, FAR_LIMIT, FAR_REMEDY, ReadOptions};
use crate::drawing::{Drawing, Entity, Problem};
use crate::geometry::{Path, Point};
use encoding_rs::{Encoding, UTF_8};
use kurbo::Affine;
use roxmltree::{Document, Node, NodeId, ParsingOptions};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::str::FromStr;
use style::{Paint, Styles};
use svgtypes::{Length, LengthUnit, Transform};

/// Deepest nesting of elements and references.
const DEPTH: usize = 64;

/// Reason why a part of a path is left out.
const DOTS: &str = "parts of them have no length";

/// Reason why an element is left out.
const HIDDEN: &str = "it is not visible";

/// Strokes wider than this, mm, have a notice. The strokes of most drawings are thinner.
const WIDE: f64 = 1.0;

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
    /// Layers that hold the present one, the outermost first.
    outer: Vec<String>,
    /// Elements seen so far, with those of references.
    seen: usize,
    /// Size of the page in user units, for percentages.
    page: [f64; 2],
}

/// The text of a file: UTF-8, or in the encoding that its XML declaration names.
fn decode(bytes: &[u8]) -> Result<Cow<'_, str>, Problem> {
    let Err(error) = std::str::from_utf8(bytes).map(|_| ()) else {
        return Ok(String::from_utf8_lossy(bytes));
    };
    let declared = || {
        let head = String::from_utf8_lossy(&bytes[..bytes.len().min(200)]);
        let declaration = head.strip_prefix("<?xml")?.split("?>").next()?;
        let value = declaration.split("encoding=").nth(1)?;
        let name = value.split(['"', '\'']).nth(1)?;
        let encoding = Encoding::for_label(name.as_bytes()).filter(|one| *one != UTF_8)?;
        encoding.decode_without_bom_handling_and_without_replacement(bytes)
    };
    declared().map(|text| Cow::Owned(text.into_owned())).ok_or_else(|| {
        let good = &bytes[..error.valid_up_to()];
        Problem::at_line(
            1 + good.iter().filter(|&&one| one == b'\n').count(),
            "the file is not UTF-8 text, and its XML declaration names no other encoding that it has",
            "save the drawing again as SVG",
        )
    })
}

/// Reads an SVG drawing. The lower left corner of the page is the origin, y points up.
pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Drawing, Problem> {
    let text = decode(bytes)?;
    let parsing = ParsingOptions {
        allow_dtd: true,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(&text, parsing).map_err(|error| {
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
        outer: Vec::new(),
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
    pub fn entity(&self, node: Node, layer: &str) -> Entity {
        let start = node.range().start;
        Entity {
            kind: node.tag_name().name().to_string(),
            handle: node.attribute("id").map(str::to_string),
            layer: layer.to_string(),
            outer: self.outer.clone(),
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

    /// Keeps the names of the layers that a hidden element is or holds, or else of its own layer:
    /// a choice of them is no mistake in the name.
    fn hide_layers(&mut self, node: Node<'a, 'a>, layer: &str) {
        let groups = node.descendants().filter(|one| match self.layered {
            true => is_layer(*one),
            false => *one == node && one.tag_name().name() == "g" && layer.is_empty(),
        });
        let mut names: Vec<String> = groups
            .filter_map(|one| group_label(one).map(str::to_string))
            .collect();
        names.push(layer.to_string());
        names.retain(|name| !name.is_empty());
        self.drawing.hidden_layers.append(&mut names);
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
                let id = value
                    .strip_prefix("url(")
                    .and_then(|rest| rest.split(')').next());
                let id = id.map(|id| id.trim_matches(['"', '\'', ' ']).trim_start_matches('#'));
                let target = id.and_then(|id| self.ids.get(id));
                paint.patterned = target.is_some_and(|one| one.tag_name().name() == "pattern");
            }
            if let Some(value) = property("stroke-width") {
                paint.width = stroke_width(value);
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
            self.hide_layers(node, layer);
            return Ok(());
        }
        let opacity = self.styles.property(node, "opacity");
        if opacity.is_some_and(|text| text.trim_end_matches('%').parse() == Ok(0.0)) {
            self.note("cut although they are transparent".into(), node, layer);
        }
        let filter = self.styles.property(node, "filter");
        if filter.is_some_and(|value| value != "none") {
            self.note("cut without their filter".into(), node, layer);
        }
        let map = match self.transform(node) {
            Ok(own) => map * own,
            Err(what) => {
                self.problem(node, layer, what);
                return Ok(());
            }
        };
        let first = self.drawing.paths.len();
        self.drawn(node, map, layer, depth)?;
        self.clip(node, map, layer, first);
        Ok(())
    }

    /// The transform of an element about its origin.
    fn transform(&self, node: Node) -> Result<Affine, String> {
        for name in ["translate", "rotate", "scale", "offset-path"] {
            let stated = self.styles.declared(node, name);
            if let Some(value) = stated.filter(|&value| value != "none") {
                return Err(format!(
                    "{name}: {value}; this property is not read, use the attribute transform"
                ));
            }
        }
        let stated = self.styles.property(node, "transform");
        let Some(text) = stated.filter(|&text| text != "none") else {
            return Ok(Affine::IDENTITY);
        };
        let t = Transform::from_str(text).map_err(|error| format!("transform: {error}"))?;
        let own = Affine::new([t.a, t.b, t.c, t.d, t.e, t.f]);
        let reference = self.styles.property(node, "transform-box");
        if let Some(value) = reference.filter(|&value| value != "view-box") {
            return Err(format!(
                "transform-box: {value}; transforms are read about the page only"
            ));
        }
        match self.styles.property(node, "transform-origin") {
            None => Ok(own),
            Some(text) => {
                let origin = self.transform_origin(node, text)?;
                Ok(Affine::translate(origin) * own * Affine::translate((-origin.0, -origin.1)))
            }
        }
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
                let present = self.outer.len();
                let outer = layer;
                let layer = self.layer_of(node, layer);
                if !outer.is_empty() && layer != outer {
                    self.outer.push(outer.to_string());
                }
                if name == "svg" {
                    let first = self.drawing.paths.len();
                    let inner = map * self.inner_page(node, None);
                    self.children(node, inner, layer, depth)?;
                    self.clip_to_frame(node, map, layer, first);
                } else {
                    self.children(node, map, layer, depth)?;
                }
                self.outer.truncate(present);
                return Ok(());
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
            self.leave_out(HIDDEN, node, layer);
            self.hide_layers(node, layer);
            return Ok(());
        }
        if paint.dashed {
            self.note("dashed lines are cut whole".into(), node, layer);
        }
        if paint.marked && matches!(name, "path" | "line" | "polyline" | "polygon") {
            self.note("left out, their markers (arrow heads)".into(), node, layer);
        }
        if paint.patterned {
            let what = "cut without their pattern: its shapes are left out";
            self.note(what.into(), node, layer);
        }
        let width = paint.width.unwrap_or(1.0) * map.determinant().abs().sqrt();
        if paint.stroked && width > WIDE {
            let what = format!("strokes wider than {WIDE} mm are cut along their middle");
            self.note(what, node, layer);
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
        let limit = match self.options.moved {
            true => FAR_LIMIT,
            false => COORDINATE_LIMIT,
        };
        let finite = |at: Point| at.iter().all(|value| value.abs() <= limit);
        let inside = paths
            .iter()
            .all(|path| path.vertices.iter().all(|vertex| finite(vertex.at)));
        if !inside {
            let what = format!("a point is farther than {limit:e} mm from the origin");
            let problem = Problem::of(&self.entity(node, layer), what, FAR_REMEDY);
            self.drawing.problems.push(problem);
            return;
        }
        let index = self.drawing.add_entity(self.entity(node, layer));
        for path in &mut paths {
            path.entity = index;
        }
        self.drawing.paths.append(&mut paths);
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
}

/// Width of a stroke in user units; `None` for a part of the page.
fn stroke_width(value: &str) -> Option<f64> {
    let length = Length::from_str(value).ok()?;
    match length.unit {
        LengthUnit::None | LengthUnit::Px => Some(length.number),
        LengthUnit::Percent => None,
        unit => Some(length.number * page::unit_mm(unit) / page::PIXEL_MM),
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
