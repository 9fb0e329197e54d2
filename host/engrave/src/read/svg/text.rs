//! Text of SVG as outlines of a font.

use super::page::{PIXEL_MM, unit_mm};
use super::style::Styles;
use super::{HIDDEN, Reader};
use crate::curves::TOLERANCE;
use crate::read::text::Anchor;
use crate::read::text_remedy;
use kurbo::Affine;
use roxmltree::Node;
use std::str::FromStr;
use svgtypes::{Length, LengthUnit};

/// Attributes that move single letters, which the outlines do not follow.
const MOVED: [&str; 4] = ["dx", "dy", "rotate", "textLength"];

/// Properties that the outlines do not follow, each with the values that change nothing.
const UNFOLLOWED: [(&str, &[&str]); 13] = [
    ("letter-spacing", &["normal"]),
    ("word-spacing", &["normal"]),
    ("baseline-shift", &["baseline"]),
    ("writing-mode", &["lr-tb", "lr", "horizontal-tb"]),
    ("dominant-baseline", &["auto", "alphabetic"]),
    ("alignment-baseline", &["auto", "baseline", "alphabetic"]),
    ("text-transform", &["none"]),
    ("font-variant", &["normal", "none"]),
    ("direction", &["ltr"]),
    ("inline-size", &["auto"]),
    ("shape-inside", &["none", "auto"]),
    ("text-decoration", &["none"]),
    ("font-stretch", &["normal", "100%"]),
];

/// Those of [`UNFOLLOWED`] that move no letter: the text is cut without them, with a notice.
const DECORATIONS: [&str; 2] = ["text-decoration", "font-stretch"];

impl<'a> Reader<'a, '_> {
    /// Whether characters are shown: `None` where they take no space either.
    fn is_shown(&self, characters: Node<'a, 'a>) -> Option<bool> {
        let removed = |one: Node| self.styles.property(one, "display") == Some("none");
        if characters.ancestors().any(removed) {
            return None;
        }
        let visibility = self.styles.inherited(characters, "visibility");
        Some(visibility.is_none_or(|value| value == "visible"))
    }

    /// The properties of a text that its outlines do not follow.
    fn unfollowed(&self, node: Node<'a, 'a>) -> Vec<&'static str> {
        let below = || node.descendants().filter(Node::is_element);
        let states = |one: Node<'a, 'a>, name: &str, neutral: &[&str]| {
            self.styles.inherited(one, name).is_some_and(|value| {
                let word = value.split_whitespace().next().unwrap_or("");
                let length = word.trim_end_matches(|one: char| one.is_alphabetic() || one == '%');
                !neutral.contains(&word) && length.parse() != Ok(0.0)
            })
        };
        let mut found: Vec<&str> = UNFOLLOWED
            .into_iter()
            .filter(|(name, neutral)| below().any(|one| states(one, name, neutral)))
            .map(|(name, _)| name)
            .collect();
        // The shorthand sets the size where no font-size is nearer.
        let is_short = |one: Node<'a, 'a>| {
            let mut stated = one.ancestors().filter_map(|one| {
                let short = self.styles.declared(one, "font").is_some();
                (short || self.styles.property(one, "font-size").is_some()).then_some(short)
            });
            stated.next() == Some(true)
        };
        if below().any(is_short) {
            found.insert(0, "the shorthand font, use font-size");
        }
        found
    }

    /// Adds a text as outlines, or refuses it by name.
    pub fn text(&mut self, node: Node<'a, 'a>, map: Affine, layer: &str) {
        let all: String = words(node.descendants()).chars().take(40).collect();
        if all.is_empty() {
            self.leave_out("its text is empty", node, layer);
            return;
        }
        let characters: Vec<Node> = node
            .descendants()
            .filter(|one| one.is_text() && !one.text().unwrap_or("").trim().is_empty())
            .collect();
        let seen = |one: &&Node<'a, 'a>| self.is_shown(**one) == Some(true);
        let visible = characters.iter().filter(seen).count();
        if visible == 0 {
            self.leave_out(HIDDEN, node, layer);
            return;
        }
        let spaced = |one: &&Node<'a, 'a>| self.is_shown(**one).is_some();
        let spaced = characters.iter().filter(spaced).count();
        let kept: Vec<Node> = node
            .descendants()
            .filter(|one| self.is_shown(*one).is_some())
            .collect();
        let shown: String = words(kept.into_iter()).chars().take(40).collect();
        if spaced < characters.len() {
            self.leave_out("parts of them are hidden (display none)", node, layer);
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
        if visible < spaced {
            let what = format!("'{shown}': a part of it is not visible, which is not supported");
            let remedy = "delete that part, or convert the text to paths in the drawing program";
            self.refuse_text(node, layer, what, remedy);
            return;
        }
        let (noted, refused): (Vec<_>, Vec<_>) = self
            .unfollowed(node)
            .into_iter()
            .partition(|name| DECORATIONS.contains(name));
        if !refused.is_empty() {
            let what = format!("'{shown}': its {} is not supported", refused.join(", "));
            let remedy = "convert the text to paths in the drawing program";
            self.refuse_text(node, layer, what, remedy);
            return;
        }
        for name in noted {
            self.note(format!("text is cut without its {name}"), node, layer);
        }
        if let Some(name) = moved.or(nested.then_some("a line within a line")) {
            let what = format!("'{shown}': letters placed by {name} are not supported");
            let remedy = "convert the text to paths in the drawing program";
            self.refuse_text(node, layer, what, remedy);
            return;
        }
        let mut paths = Vec::new();
        for (line, text) in lines(node, &|one| self.is_shown(one).is_some()) {
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

/// Lines of a text, of the characters that count, with the element that places each: a span with a
/// position begins a line, other content goes on with the line before it.
fn lines<'a>(
    node: Node<'a, 'a>,
    counts: &dyn Fn(Node<'a, 'a>) -> bool,
) -> Vec<(Node<'a, 'a>, String)> {
    let mut lines: Vec<(Node, Vec<Node>)> = vec![(node, Vec::new())];
    for child in node.children() {
        if child.has_attribute("x") || child.has_attribute("y") {
            lines.push((child, Vec::new()));
        }
        if let Some((_, nodes)) = lines.last_mut() {
            nodes.extend(child.descendants().filter(|one| counts(*one)));
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
