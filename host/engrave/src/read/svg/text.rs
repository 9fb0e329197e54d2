//! Text of SVG as outlines of a font.

use super::Reader;
use super::page::{PIXEL_MM, unit_mm};
use super::style::Styles;
use crate::curves::TOLERANCE;
use crate::read::text::Anchor;
use crate::read::text_remedy;
use kurbo::Affine;
use roxmltree::Node;
use std::str::FromStr;
use svgtypes::{Length, LengthUnit};

/// Attributes that move single letters, which the outlines do not follow.
const MOVED: [&str; 4] = ["dx", "dy", "rotate", "textLength"];

impl<'a> Reader<'a, '_> {
    /// Adds a text as outlines, or refuses it by name.
    pub fn text(&mut self, node: Node<'a, 'a>, map: Affine, layer: &str) {
        let shown: String = words(node.descendants()).chars().take(40).collect();
        if shown.is_empty() {
            self.leave_out("its text is empty", node, layer);
            return;
        }
        let Some(font) = self.options.font else {
            if self.options.skip_text {
                self.leave_out(&format!("'{shown}' is text without a font"), node, layer);
                return;
            }
            let what = format!("'{shown}' is text, which has no outlines of its own");
            self.refuse_text(node, layer, what, text_remedy());
            return;
        };
        let below = || node.descendants().filter(Node::is_element);
        let moved = below().find_map(|one| {
            let moved = MOVED.iter().copied().find(|&name| {
                let value = one.attribute(name).unwrap_or("0");
                value.contains(|digit: char| matches!(digit, '1'..='9'))
            });
            let kind = one.tag_name().name();
            moved.or_else(|| matches!(kind, "textPath" | "flowRoot").then_some(kind))
        });
        let nested = below().any(|one| {
            let inner = one.parent_element().is_some_and(|outer| outer != node);
            one != node && inner && (one.has_attribute("x") || one.has_attribute("y"))
        });
        if let Some(name) = moved.or(nested.then_some("a line within a line")) {
            let what = format!("'{shown}': letters placed by {name} are not supported");
            let remedy = "convert the text to paths in the drawing program";
            self.refuse_text(node, layer, what, remedy);
            return;
        }
        let mut paths = Vec::new();
        for (line, text) in lines(node) {
            let size = font_size(&self.styles, line);
            let first = |name: &str| {
                let value = line.attribute(name).or_else(|| node.attribute(name))?;
                let length = Length::from_str(value.split([',', ' ']).next()?).ok()?;
                Some(match length.unit {
                    LengthUnit::None | LengthUnit::Px => length.number,
                    unit => length.number * unit_mm(unit) / PIXEL_MM,
                })
            };
            let at = (first("x").unwrap_or(0.0), first("y").unwrap_or(0.0));
            let anchor = match self.styles.inherited(line, "text-anchor") {
                Some("middle") => Anchor::Middle,
                Some("end") => Anchor::End,
                _ => Anchor::Start,
            };
            let map = map * Affine::translate(at) * Affine::scale_non_uniform(size, -size);
            match font.outline(&text, anchor, map, TOLERANCE) {
                Ok(mut outline) => paths.append(&mut outline),
                Err(what) => {
                    let what = format!("'{shown}': {what}");
                    self.refuse_text(node, layer, what, "choose another font with --font");
                    return;
                }
            }
        }
        self.add(node, layer, paths);
    }

    fn refuse_text(&mut self, node: Node, layer: &str, what: String, remedy: &str) {
        let mut problem = self.located(node, layer, what);
        problem.remedy = remedy.into();
        self.drawing.problems.push(problem);
    }
}

/// The words of the text among these nodes.
fn words<'a>(nodes: impl Iterator<Item = Node<'a, 'a>>) -> String {
    let parts = nodes.filter(Node::is_text);
    let all: String = parts.filter_map(|one| one.text()).collect();
    all.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Lines of a text with the element that places each: a span with a position begins a line, other
/// content goes on with the line before it.
fn lines<'a>(node: Node<'a, 'a>) -> Vec<(Node<'a, 'a>, String)> {
    let mut lines: Vec<(Node, Vec<Node>)> = vec![(node, Vec::new())];
    for child in node.children() {
        if child.has_attribute("x") || child.has_attribute("y") {
            lines.push((child, Vec::new()));
        }
        if let Some((_, nodes)) = lines.last_mut() {
            nodes.extend(child.descendants());
        }
    }
    let lines = lines.into_iter();
    let lines = lines.map(|(line, nodes)| (line, words(nodes.into_iter())));
    lines.filter(|(_, text)| !text.is_empty()).collect()
}

/// Size of a font in user units.
pub fn font_size(styles: &Styles, node: Node) -> f64 {
    let Some(text) = styles.inherited(node, "font-size") else {
        return 16.0;
    };
    match Length::from_str(text) {
        Ok(length) if matches!(length.unit, LengthUnit::None | LengthUnit::Px) => length.number,
        Ok(length) => length.number * unit_mm(length.unit) / PIXEL_MM,
        Err(_) => 16.0,
    }
}
