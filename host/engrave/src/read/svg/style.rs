//! Properties of SVG elements: inline styles, style sheets, attributes.

use roxmltree::{Document, Node, NodeId};
use simplecss::{AttributeOperator, Element, PseudoClass, StyleSheet};
use std::collections::HashMap;

/// How an element is painted.
#[derive(Debug, Clone, Copy, Default)]
pub struct Paint {
    pub hidden: bool,
    pub unfilled: bool,
    pub stroked: bool,
    pub dashed: bool,
    /// Whether its fill is a pattern.
    pub patterned: bool,
    /// Width of its stroke in user units, if one is stated.
    pub width: Option<f64>,
    /// Markers at its vertices, as arrow heads.
    pub marked: bool,
}

/// Properties that matter to a path or a text; others of a style sheet are not kept.
const PROPERTIES: [&str; 37] = [
    "alignment-baseline",
    "baseline-shift",
    "clip-path",
    "direction",
    "display",
    "dominant-baseline",
    "fill",
    "filter",
    "font",
    "font-size",
    "font-stretch",
    "font-variant",
    "inline-size",
    "letter-spacing",
    "marker",
    "marker-end",
    "marker-mid",
    "marker-start",
    "mask",
    "offset-path",
    "opacity",
    "rotate",
    "scale",
    "shape-inside",
    "stroke",
    "stroke-dasharray",
    "stroke-width",
    "text-anchor",
    "text-decoration",
    "text-transform",
    "transform",
    "transform-box",
    "transform-origin",
    "translate",
    "visibility",
    "word-spacing",
    "writing-mode",
];

/// The style sheets of a document.
#[derive(Default)]
pub struct Styles {
    /// Declarations of an element, the one that counts most last.
    declarations: HashMap<NodeId, Vec<(String, String)>>,
}

impl Styles {
    /// Reads the `style` elements.
    pub fn new(document: &Document) -> Self {
        let sheets = document
            .descendants()
            .filter(|node| node.is_element() && node.tag_name().name() == "style");
        let text: String = sheets
            .flat_map(|node| node.children())
            .filter_map(|child| child.text())
            .collect();
        let mut styles = Self::default();
        if text.trim().is_empty() {
            return styles;
        }
        // The rules are sorted by their specificity.
        let sheet = StyleSheet::parse(&text);
        for rule in &sheet.rules {
            let kept = |name: &str| PROPERTIES.contains(&name);
            if !rule.declarations.iter().any(|one| kept(one.name)) {
                continue;
            }
            for node in document.descendants().filter(Node::is_element) {
                if rule.selector.matches(&Selected(node)) {
                    let all = styles.declarations.entry(node.id()).or_default();
                    let matched = rule.declarations.iter().filter(|one| kept(one.name));
                    all.extend(matched.map(|one| (one.name.into(), one.value.into())));
                }
            }
        }
        styles
    }

    /// A property of the element itself: inline style, style sheet, attribute.
    pub fn property<'s>(&'s self, node: Node<'s, '_>, name: &str) -> Option<&'s str> {
        self.stated(node, name)
            .or_else(|| node.attribute(name))
            .filter(|value| *value != "inherit")
    }

    /// A property of inline style or style sheet that no attribute states.
    pub fn declared<'s>(&'s self, node: Node<'s, '_>, name: &str) -> Option<&'s str> {
        self.stated(node, name)
            .filter(|value| !matches!(*value, "inherit" | "initial" | "unset"))
    }

    fn stated<'s>(&'s self, node: Node<'s, '_>, name: &str) -> Option<&'s str> {
        let style = node.attribute("style").unwrap_or("");
        let inline = style.split(';').find_map(|declaration| {
            let (key, value) = declaration.split_once(':')?;
            (key.trim() == name).then(|| value.trim())
        });
        inline.or_else(|| {
            let all = self.declarations.get(&node.id())?;
            let found = all.iter().rev().find(|(key, _)| key == name);
            found.map(|(_, value)| value.as_str())
        })
    }

    /// A property that descendants inherit.
    pub fn inherited<'s>(&'s self, node: Node<'s, '_>, name: &str) -> Option<&'s str> {
        node.ancestors().find_map(|node| self.property(node, name))
    }
}

/// An element as selectors see it.
struct Selected<'a, 'input>(Node<'a, 'input>);

impl Element for Selected<'_, '_> {
    fn parent_element(&self) -> Option<Self> {
        self.0.parent_element().map(Selected)
    }

    fn prev_sibling_element(&self) -> Option<Self> {
        self.0.prev_sibling_element().map(Selected)
    }

    fn has_local_name(&self, name: &str) -> bool {
        self.0.tag_name().name() == name
    }

    fn attribute_matches(&self, name: &str, operator: AttributeOperator) -> bool {
        self.0
            .attribute(name)
            .is_some_and(|value| operator.matches(value))
    }

    fn pseudo_class_matches(&self, class: PseudoClass) -> bool {
        matches!(class, PseudoClass::FirstChild) && self.0.prev_sibling_element().is_none()
    }
}
