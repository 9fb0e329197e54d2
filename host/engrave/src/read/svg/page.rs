//! Page of an SVG: units, view boxes, and the map of user units to millimetres.

use super::text::font_size;
use super::{REPAIR, Reader};
use crate::drawing::Problem;
use kurbo::Affine;
use roxmltree::Node;
use std::str::FromStr;
use svgtypes::{Align, AspectRatio, Length, LengthUnit, ViewBox};

/// Millimetres per CSS pixel.
pub const PIXEL_MM: f64 = 25.4 / 96.0;

impl<'a> Reader<'a, '_> {
    /// Map of the root's user units to mm with y up.
    pub(super) fn page(&mut self, root: Node<'a, 'a>) -> Result<Affine, Problem> {
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

    /// Map of a nested `svg` element, or of a symbol by its reference.
    pub(super) fn inner_page(&self, node: Node, reference: Option<Node>) -> Affine {
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

    /// The point that a transform is about, in user units: `left`, `center`, `right`, `top`,
    /// `bottom`, lengths, and percentages of the page.
    pub(super) fn transform_origin(&self, node: Node, text: &str) -> Result<(f64, f64), String> {
        let refused = || format!("transform-origin: '{text}' is not read");
        let words: Vec<&str> = text.split_whitespace().collect();
        let nested = node
            .ancestors()
            .skip(1)
            .filter(|one| matches!(one.tag_name().name(), "svg" | "symbol"));
        let has_own_page = nested.count() > 1;
        let part = |axis: usize, part: f64| -> Result<f64, String> {
            if has_own_page || self.page[1] == 0.0 {
                return Err(refused());
            }
            Ok(part * self.page[axis])
        };
        let along = |axis: usize, word: &str| match (axis, word) {
            (0, "left") | (1, "top") => Ok(0.0),
            (_, "center") => part(axis, 0.5),
            (0, "right") | (1, "bottom") => part(axis, 1.0),
            _ => {
                let length = Length::from_str(word).map_err(|_| refused())?;
                match length.unit {
                    LengthUnit::None | LengthUnit::Px => Ok(length.number),
                    LengthUnit::Percent => part(axis, length.number / 100.0),
                    LengthUnit::Em | LengthUnit::Ex => Err(refused()),
                    unit => Ok(length.number * unit_mm(unit) / PIXEL_MM),
                }
            }
        };
        match words.as_slice() {
            [y @ ("top" | "bottom")] => Ok((part(0, 0.5)?, along(1, y)?)),
            [x] => Ok((along(0, x)?, part(1, 0.5)?)),
            [y @ ("top" | "bottom"), x] | [x, y] | [x, y, _]
                if !(matches!(*x, "top" | "bottom") || matches!(*y, "left" | "right")) =>
            {
                Ok((along(0, x)?, along(1, y)?))
            }
            [y, x] => Ok((along(0, x)?, along(1, y)?)),
            _ => Err(refused()),
        }
    }

    /// Upper left corner of a nested `svg` element.
    pub fn place(&self, node: Node) -> (f64, f64) {
        let at = |name: &str, axis: usize| self.length(node, name, axis).ok().flatten();
        (at("x", 0).unwrap_or(0.0), at("y", 1).unwrap_or(0.0))
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
