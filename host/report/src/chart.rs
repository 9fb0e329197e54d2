//! Charts as SVG: axes with units, a grid, lines, a legend. All SVG is written here.

use super::markup::{escape, put};

/// A line of a chart.
pub struct Line {
    /// Label in the legend.
    pub label: String,
    /// CSS colour.
    pub colour: &'static str,
    /// Width in pixels.
    pub width: f64,
    /// Points in the units of the axes, in pieces between gaps.
    pub pieces: Vec<Vec<(f64, f64)>>,
}

/// A chart.
pub struct Chart {
    /// Label of the horizontal axis, with its unit.
    pub x_label: String,
    /// Label of the vertical axis, with its unit.
    pub y_label: String,
    /// The lines, the first one lowest.
    pub lines: Vec<Line>,
    /// Width in pixels.
    pub width: f64,
    /// Height in pixels.
    pub height: f64,
    /// Both axes have the same scale.
    pub equal: bool,
    /// The vertical axis includes 0.
    pub from_zero: bool,
    /// Image behind the lines; the axes then have its range.
    pub backdrop: Option<Backdrop>,
}

/// A part of a chart, with shaded areas behind its lines and points on them.
pub struct View<'a> {
    /// Identifier of the element.
    pub id: &'a str,
    /// Range of the horizontal axis.
    pub x: (f64, f64),
    /// Range of the vertical axis.
    pub y: (f64, f64),
    /// Shaded areas: their ranges of x and y; ends outside of the axes are cut off.
    pub shaded: Vec<[(f64, f64); 2]>,
    /// Points and their colours.
    pub points: Vec<((f64, f64), &'static str)>,
}

/// Image in the coordinates of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Backdrop {
    /// The image as a `data:` URL.
    pub data: String,
    /// Left and right edge.
    pub x: (f64, f64),
    /// Lower and upper edge.
    pub y: (f64, f64),
}

/// Colours on white that are distinct for all kinds of colour vision (Okabe and Ito).
pub const COLOURS: [&str; 6] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9",
];

/// Colour of a shaded area.
pub const SHADED: &str = "#dcefe7";

const LEFT: f64 = 68.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 44.0;
/// Width beside a tick label of the vertical axis: the label of the axis, and a gap on both sides.
const LABEL_MARGIN: f64 = 30.0;

struct Scale {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Scale {
    fn at(&self, value: f64) -> f64 {
        self.from + (value - self.low) / (self.high - self.low) * (self.to - self.from)
    }

    fn clamped(&self, value: f64) -> f64 {
        self.at(value.clamp(self.low, self.high))
    }
}

/// The parts of a line within ranges of x and y.
fn within(piece: &[(f64, f64)], x: (f64, f64), y: (f64, f64)) -> Vec<Vec<(f64, f64)>> {
    let mut parts: Vec<Vec<(f64, f64)>> = Vec::new();
    for pair in piece.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        // Parts of the way from a to b at which the borders are crossed.
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for (start, way, (low, high)) in [(a.0, dx, x), (a.1, dy, y)] {
            if way == 0.0 {
                if start < low || start > high {
                    (from, to) = (1.0, 0.0);
                }
                continue;
            }
            let (one, other) = ((low - start) / way, (high - start) / way);
            from = from.max(one.min(other));
            to = to.min(one.max(other));
        }
        if from > to {
            continue;
        }
        let at = |part: f64| (a.0 + dx * part, a.1 + dy * part);
        let begin = if from == 0.0 { a } else { at(from) };
        let end = if to == 1.0 { b } else { at(to) };
        match parts.last_mut() {
            Some(part) if from == 0.0 && part.last() == Some(&a) => part.push(end),
            _ => parts.push(vec![begin, end]),
        }
    }
    parts
}

impl Chart {
    /// The chart as an `<svg>` element.
    pub fn svg(&self) -> String {
        self.element("", &[], None)
    }

    /// A part of the chart as an `<svg>` element.
    pub fn svg_of(&self, view: &View<'_>) -> String {
        let id = format!("id=\"{}\" ", escape(view.id));
        self.element(&id, &[], Some(view))
    }

    /// The chart as an `<svg>` element with more attributes; if there are `names`, the ticks of
    /// the vertical axis are at 0, 1, 2 and so on, and have these names.
    fn element(&self, attributes: &str, names: &[String], view: Option<&View<'_>>) -> String {
        let (_, y) = self.scales(LEFT, view);
        let labels = labels(&y, names);
        let widths = labels.iter().map(|(_, label)| width(label));
        let left = widths.fold(LEFT, |left, width| left.max(width + LABEL_MARGIN).ceil());
        let (x, y) = self.scales(left, view);
        let mut svg = format!(
            "<svg {attributes}viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{} against {}\">",
            self.width,
            self.height,
            escape(&self.y_label),
            escape(&self.x_label)
        );
        if let Some(backdrop) = &self.backdrop {
            let (left, right) = (x.at(backdrop.x.0), x.at(backdrop.x.1));
            let (top, bottom) = (y.at(backdrop.y.1), y.at(backdrop.y.0));
            put(
                &mut svg,
                format_args!(
                    "<image x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" \
                     preserveAspectRatio=\"none\" href=\"{}\"/>",
                    right - left,
                    bottom - top,
                    backdrop.data
                ),
            );
        }
        for [along, across] in view.iter().flat_map(|view| &view.shaded) {
            let (left, right) = (x.clamped(along.0), x.clamped(along.1));
            let (bottom, top) = (y.clamped(across.0), y.clamped(across.1));
            put(
                &mut svg,
                format_args!(
                    "<rect class=\"band\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" \
                     height=\"{:.1}\" fill=\"{SHADED}\"/>",
                    right - left,
                    bottom - top
                ),
            );
        }
        self.axes(&mut svg, &x, &y, names);
        for line in &self.lines {
            let mut path = String::new();
            let mut add = |piece: &[(f64, f64)]| {
                for (index, (px, py)) in piece.iter().enumerate() {
                    let command = if index == 0 { 'M' } else { 'L' };
                    put(
                        &mut path,
                        format_args!("{command}{:.1} {:.1}", x.at(*px), y.at(*py)),
                    );
                }
            };
            for piece in &line.pieces {
                if self.backdrop.is_some() || view.is_some() {
                    // The range is not that of the lines.
                    for part in within(piece, (x.low, x.high), (y.low, y.high)) {
                        add(&part);
                    }
                } else {
                    add(piece);
                }
            }
            put(
                &mut svg,
                format_args!(
                    "<path d=\"{path}\" stroke=\"{}\" stroke-width=\"{}\"/>",
                    line.colour, line.width
                ),
            );
        }
        for ((px, py), colour) in view.iter().flat_map(|view| &view.points) {
            put(
                &mut svg,
                format_args!(
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4.5\" fill=\"{colour}\"/>",
                    x.clamped(*px),
                    y.clamped(*py)
                ),
            );
        }
        self.legend(&mut svg);
        svg.push_str("</svg>");
        svg
    }

    /// Scales of both axes; the vertical axis is `left` from the left edge.
    fn scales(&self, left: f64, view: Option<&View<'_>>) -> (Scale, Scale) {
        let (mut x, mut y) = view.map_or_else(|| self.ranges(), |view| (view.x, view.y));
        let (plot_width, plot_height) = (self.width - left - RIGHT, self.height - TOP - BOTTOM);
        if self.equal {
            let per_pixel = ((x.1 - x.0) / plot_width).max((y.1 - y.0) / plot_height);
            widen(&mut x, per_pixel * plot_width);
            widen(&mut y, per_pixel * plot_height);
        }
        let x = Scale {
            low: x.0,
            high: x.1,
            from: left,
            to: self.width - RIGHT,
        };
        let y = Scale {
            low: y.0,
            high: y.1,
            from: self.height - BOTTOM,
            to: TOP,
        };
        (x, y)
    }

    fn ranges(&self) -> ((f64, f64), (f64, f64)) {
        let mut x = (f64::INFINITY, f64::NEG_INFINITY);
        let mut y = if self.from_zero { (0.0, 0.0) } else { x };
        for (px, py) in self.lines.iter().flat_map(|l| &l.pieces).flatten() {
            x = (x.0.min(*px), x.1.max(*px));
            y = (y.0.min(*py), y.1.max(*py));
        }
        if let Some(backdrop) = &self.backdrop {
            return (backdrop.x, backdrop.y);
        }
        if !self.equal {
            x.0 = x.0.min(0.0);
        }
        for range in [&mut x, &mut y] {
            if range.0 > range.1 {
                *range = (0.0, 1.0);
            }
            let span = range.1 - range.0;
            // The resolution of a coordinate is 1e-6 mm.
            let min = 1e-6 * range.0.abs().max(range.1.abs()).max(1.0);
            widen(range, min.max(span));
        }
        let margin = 0.06 * (y.1 - y.0);
        y.1 += margin;
        if !(self.from_zero && y.0 == 0.0) {
            y.0 -= margin;
        }
        if self.equal {
            let margin = 0.04 * (x.1 - x.0);
            x = (x.0 - margin, x.1 + margin);
        }
        (x, y)
    }

    fn axes(&self, svg: &mut String, x: &Scale, y: &Scale, names: &[String]) {
        let (left, right, bottom) = (x.from, self.width - RIGHT, self.height - BOTTOM);
        // The grid does not hide an image.
        let grid = match self.backdrop {
            Some(_) => "grid faint",
            None => "grid",
        };
        let (step, decimals) = tick_step(x.high - x.low, (right - left) / 90.0);
        for tick in ticks(x, step) {
            let at = x.at(tick);
            put(
                svg,
                format_args!(
                    "<line class=\"{grid}\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" \
                     y2=\"{bottom}\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">\
                     {:.decimals$}</text>",
                    bottom + 16.0,
                    tick + 0.0
                ),
            );
        }
        for (tick, label) in labels(y, names) {
            let at = y.at(tick);
            put(
                svg,
                format_args!(
                    "<line class=\"{grid}\" x1=\"{left:.0}\" x2=\"{right}\" y1=\"{at:.1}\" \
                     y2=\"{at:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                    left - 7.0,
                    at + 4.0,
                    escape(&label)
                ),
            );
        }
        put(
            svg,
            format_args!(
                "<rect class=\"frame\" x=\"{left:.0}\" y=\"{TOP}\" width=\"{:.1}\" \
                 height=\"{:.1}\"/>",
                right - left,
                bottom - TOP
            ),
        );
        put(
            svg,
            format_args!(
                "<text class=\"label\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                (left + right) / 2.0,
                self.height - 8.0,
                escape(&self.x_label)
            ),
        );
        let middle = (TOP + bottom) / 2.0;
        put(
            svg,
            format_args!(
                "<text class=\"label\" transform=\"translate(15 {middle:.1}) rotate(-90)\" \
                 text-anchor=\"middle\">{}</text>",
                escape(&self.y_label)
            ),
        );
    }

    fn legend(&self, svg: &mut String) {
        let mut at = LEFT;
        for line in &self.lines {
            put(
                svg,
                format_args!(
                    "<line x1=\"{at:.1}\" x2=\"{:.1}\" y1=\"14\" y2=\"14\" stroke=\"{}\" \
                     stroke-width=\"{}\"/><text x=\"{:.1}\" y=\"18\">{}</text>",
                    at + 20.0,
                    line.colour,
                    line.width.max(2.0),
                    at + 26.0,
                    escape(&line.label)
                ),
            );
            at += 46.0 + 6.6 * line.label.chars().count() as f64;
        }
    }
}

/// Widens a range about its middle to at least `span`.
fn widen(range: &mut (f64, f64), span: f64) {
    let missing = (span - (range.1 - range.0)).max(0.0);
    *range = (range.0 - missing / 2.0, range.1 + missing / 2.0);
}

/// Step of 1, 2 or 5 times a power of ten for about `count` ticks, and its number of decimals.
fn tick_step(span: f64, count: f64) -> (f64, usize) {
    let rough = span / count.max(2.0);
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|step| *step >= rough * 0.999)
        .unwrap_or(10.0 * power);
    let decimals = (-step.log10() + 1e-9).ceil().clamp(0.0, 9.0) as usize;
    (step, decimals)
}

/// Ticks of a vertical axis and their labels: numbers, or the names of 0, 1, 2 and so on.
fn labels(y: &Scale, names: &[String]) -> Vec<(f64, String)> {
    if names.is_empty() {
        let (step, decimals) = tick_step(y.high - y.low, (y.from - y.to) / 42.0);
        let label = |tick| (tick, format!("{:.decimals$}", tick + 0.0));
        return ticks(y, step).map(label).collect();
    }
    let named = (0_u32..).map(f64::from).zip(names.iter().cloned());
    named
        .filter(|(tick, _)| (y.low..=y.high).contains(tick))
        .collect()
}

/// Width of a label in pixels in a wide font; the font of the viewer is not known.
fn width(label: &str) -> f64 {
    let wide = |letter: char| if ".-".contains(letter) { 4.3 } else { 7.7 };
    label.chars().map(wide).sum()
}

fn ticks(scale: &Scale, step: f64) -> impl Iterator<Item = f64> {
    let first = (scale.low / step).ceil() as i64;
    let last = (scale.high / step).floor() as i64;
    // The number is bounded for the case that a defect makes the range absurd.
    (first..=last.min(first.saturating_add(50))).map(move |n| n as f64 * step)
}

/// Style of a stand-alone image.
const DOCUMENT_STYLE: &str = "\
text{font:12px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;fill:#3b4754}.label{fill:#1d2733;font-size:12.5px}\
path{fill:none;stroke-linejoin:round;stroke-linecap:round}.grid{stroke:#e8ebef;stroke-width:1}.frame{fill:none;stroke:#b9c1ca;stroke-width:1}";

/// A stand-alone SVG image of charts of the same size, one below the other. Each may have names
/// for 0, 1, 2 and so on of its vertical axis.
pub fn document(charts: &[(Chart, &[String])], width: f64, height: f64) -> String {
    let total = height * charts.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{total}\" \
         viewBox=\"0 0 {width} {total}\"><style>{DOCUMENT_STYLE}</style>\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    for (index, (chart, names)) in charts.iter().enumerate() {
        let y = height * index as f64;
        let place = format!("x=\"0\" y=\"{y}\" width=\"{width}\" height=\"{height}\" ");
        svg += &chart.element(&place, names, None);
        svg.push('\n');
    }
    svg += "</svg>\n";
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(values: [f64; 2], equal: bool) -> Chart {
        Chart {
            x_label: "time, s".into(),
            y_label: "mm".into(),
            lines: vec![Line {
                label: "error".into(),
                colour: COLOURS[0],
                width: 1.0,
                pieces: vec![vec![(0.0, values[0]), (2e-4, values[1])]],
            }],
            width: 1000.0,
            height: 300.0,
            equal,
            from_zero: false,
            backdrop: None,
        }
    }

    /// Right ends of the tick labels of the vertical axis, and the labels.
    fn tick_labels(svg: &str) -> Vec<(f64, &str)> {
        let texts = svg.split("<text x=\"").skip(1);
        let texts = texts.filter(|text| text.contains("text-anchor=\"end\""));
        texts
            .map(|text| {
                let (x, rest) = text.split_once('"').unwrap();
                let (_, label) = rest.split_once('>').unwrap();
                (x.parse().unwrap(), label.split_once('<').unwrap().0)
            })
            .collect()
    }

    #[test]
    fn tick_labels_fit_beside_the_axis_and_are_distinct() {
        for values in [
            [0.0, 0.0],
            [0.0, 3e-9],
            [-26.768, -26.768],
            [-26.768, -26.767_999],
            [885.0, 885.000_001],
            [-0.004, 0.001],
        ] {
            for equal in [false, true] {
                let svg = chart(values, equal).svg();
                let labels = tick_labels(&svg);
                for (index, (end, label)) in labels.iter().enumerate() {
                    let begin = end - width(label);
                    assert!(begin >= 23.0, "{values:?} {label} begins at {begin}");
                    let again = labels[..index].iter().any(|(_, other)| other == label);
                    assert!(!again, "{values:?} has {label} twice");
                }
                assert!(!labels.is_empty());
            }
        }
        // Short labels do not move the axis.
        assert!(chart([-30.0, 12.5], false).svg().contains("x1=\"68\""));
    }

    #[test]
    fn lines_beside_the_image_are_cut_off() {
        let line = [
            (-5.0, 5.0),
            (5.0, 5.0),
            (5.0, 8.0),
            (5.0, 20.0),
            (8.0, 20.0),
            (8.0, 0.0),
        ];
        let parts = within(&line, (0.0, 10.0), (0.0, 10.0));
        let expected = [
            vec![(0.0, 5.0), (5.0, 5.0), (5.0, 8.0), (5.0, 10.0)],
            vec![(8.0, 10.0), (8.0, 0.0)],
        ];
        assert_eq!(parts, expected);
        assert!(within(&[(-1.0, 0.0), (0.5, 12.0)], (0.0, 1.0), (0.0, 1.0)).is_empty());
        // A closed way is one part.
        let square = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 1.0)];
        assert_eq!(within(&square, (0.0, 9.0), (0.0, 9.0)), [square.to_vec()]);
    }

    #[test]
    fn a_view_has_its_area_and_cuts_off_what_is_outside() {
        let view = View {
            id: "row",
            x: (1e-4, 2e-4),
            y: (0.0, 10.0),
            shaded: vec![[(0.0, f64::INFINITY), (f64::NEG_INFINITY, 5.0)]],
            points: vec![((1.5e-4, 5.0), COLOURS[1])],
        };
        let svg = chart([0.0, 20.0], false).svg_of(&view);
        assert!(svg.starts_with("<svg id=\"row\""), "{svg}");
        // The plot is 918 x 226 pixels from (68, 30) on; the line leaves it at the top.
        let area = "<rect class=\"band\" x=\"68.0\" y=\"143.0\" width=\"918.0\" height=\"113.0\"";
        assert!(svg.contains(area), "{svg}");
        assert!(svg.contains("<circle cx=\"527.0\" cy=\"143.0\""), "{svg}");
        assert!(!svg.contains("L986"), "{svg}");
    }

    #[test]
    fn names_are_at_whole_numbers_only() {
        let names = ["Disabled", "Idle", "Homing", "Run", "Jog"].map(str::to_string);
        let svg = chart([1.0, 3.0], false).element("", &names, None);
        let labels: Vec<&str> = tick_labels(&svg).iter().map(|(_, label)| *label).collect();
        assert_eq!(labels, ["Idle", "Homing", "Run"]);
    }
}
