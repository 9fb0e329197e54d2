//! The design in the report as cutters know it: views of the gem, proportions, and the cutting
//! table by tier.

use super::escape;
use crate::design::{Side, Stage};
use crate::gem::Gem;
use core::fmt::Write as _;
use haptimill_hil_sim::polyhedron::Face;
use haptimill_hil_sim::vector::{Vector, dot};

/// Width of the largest view without its margin, px.
const VIEW_PX: f64 = 250.0;

/// Margin of a view, in which the positions of the wheel are written, px.
const MARGIN_PX: f64 = 26.0;

/// A tier is named in a view if its largest facet there has this area for a letter, px^2.
const LETTER_PX2: f64 = 130.0;

/// Views, proportions and cutting table of a design.
pub fn section(body: &mut String, gem: &Gem) {
    body.push_str("<h2>Design</h2><div class=views>");
    let views = [
        (
            "from above",
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
        ),
        (
            "from the side",
            [1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, -1.0, 0.0],
        ),
        (
            "from below",
            [1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, -1.0],
        ),
    ];
    for (name, right, up, towards) in views {
        let view = View {
            gem,
            right,
            up,
            towards,
            scale: VIEW_PX / gem.rough.diameter_mm.max(gem.rough.height_mm),
        };
        let _ = write!(
            body,
            "<figure>{}<figcaption>{name}</figcaption></figure>",
            view.svg()
        );
    }
    body.push_str(
        "</div><p>Dashed: the rough. Numbers around a view are positions of the wheel.</p>",
    );
    proportions(body, gem);
    tiers(body, gem);
}

/// A picture of the gem along an axis.
struct View<'a> {
    gem: &'a Gem,
    /// Directions of the picture in the frame of the design.
    right: Vector,
    up: Vector,
    /// Direction to the eye.
    towards: Vector,
    /// Pixels of a millimetre.
    scale: f64,
}

impl View<'_> {
    /// A point in the picture, px from the middle of the rough.
    fn at(&self, point: Vector) -> [f64; 2] {
        let middle = self.gem.rough_middle_mm * self.up[2];
        [
            self.scale * dot(point, self.right),
            -self.scale * (dot(point, self.up) - middle),
        ]
    }

    fn ring(&self, face: &Face) -> Vec<[f64; 2]> {
        let corners = self.gem.body.corners(face);
        corners.map(|corner| self.at(corner)).collect()
    }

    /// Whether the view is along the axis of the stone.
    fn is_plan(&self) -> bool {
        self.up[2] == 0.0
    }

    fn svg(&self) -> String {
        let rough = &self.gem.rough;
        let half_x = 0.5 * self.scale * rough.diameter_mm;
        let half_y = match self.is_plan() {
            true => half_x,
            false => 0.5 * self.scale * rough.height_mm,
        };
        let (x, y) = (half_x + MARGIN_PX, half_y + MARGIN_PX);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0:.0}\" height=\"{1:.0}\" \
             viewBox=\"{2:.1} {3:.1} {0:.1} {1:.1}\">",
            2.0 * x,
            2.0 * y,
            -x,
            -y
        );
        let dashed = "fill=\"none\" stroke=\"#b9a27a\" stroke-dasharray=\"4 3\"";
        let _ = match self.is_plan() {
            true => write!(svg, "<circle r=\"{half_x:.2}\" {dashed}/>"),
            false => write!(
                svg,
                "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" {dashed}/>",
                -half_x,
                -half_y,
                2.0 * half_x,
                2.0 * half_y
            ),
        };
        for face in self.seen() {
            let points: Vec<String> = self
                .ring(face)
                .iter()
                .map(|[x, y]| format!("{x:.2},{y:.2}"))
                .collect();
            // Light comes from the upper left, so that neighbours differ.
            let light: f64 = 0.6 * dot(face.plane.normal, self.towards)
                + 0.35 * dot(face.plane.normal, self.up)
                - 0.25 * dot(face.plane.normal, self.right);
            let _ = write!(
                svg,
                "<polygon points=\"{}\" fill=\"hsl(208 48% {:.0}%)\" stroke=\"#16324f\" \
                 stroke-width=\"0.8\" stroke-linejoin=\"round\"/>",
                points.join(" "),
                70.0 + 24.0 * light
            );
        }
        self.names(&mut svg);
        if self.is_plan() {
            self.positions(&mut svg, half_x + 0.55 * MARGIN_PX);
        }
        svg.push_str("</svg>");
        svg
    }

    fn seen(&self) -> impl Iterator<Item = &Face> {
        let faces = self.gem.body.faces().iter();
        faces.filter(|face| dot(face.plane.normal, self.towards) > 1e-6)
    }

    /// Writes the name of each tier on its largest facet of the view, if there is room for it.
    fn names(&self, svg: &mut String) {
        let area = |face: &Face| {
            let facing = dot(face.plane.normal, self.towards);
            self.scale * self.scale * facing * self.gem.body.area(face)
        };
        for tier in self.gem.design.tiers() {
            let mut largest: Option<(&Face, f64)> = None;
            for face in self.seen().filter(|face| tier.facets.contains(&face.tag)) {
                // Of facets of one size the first one is taken, whatever the last digits are.
                if largest.is_none_or(|(_, max)| area(face) > 1.001 * max) {
                    largest = Some((face, area(face)));
                }
            }
            let letters = tier.name.chars().count() as f64;
            let Some((face, _)) = largest.filter(|it| it.1 > LETTER_PX2 * letters) else {
                continue;
            };
            let ring = self.ring(face);
            let mean = |axis: usize| {
                let sum: f64 = ring.iter().map(|at| at[axis]).sum();
                sum / ring.len() as f64
            };
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"#16324f\">{}</text>",
                mean(0),
                mean(1),
                escape(&tier.name)
            );
        }
    }

    /// Writes the positions of the wheel at the quarters of a turn.
    fn positions(&self, svg: &mut String, radius: f64) {
        for azimuth in [0.0_f64, 90.0, 180.0, 270.0] {
            let (y, x) = libm::sincos(azimuth.to_radians());
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"#6b7885\">{}</text>",
                radius * dot([x, y, 0.0], self.right),
                -radius * dot([x, y, 0.0], self.up),
                self.gem.design.index_at(azimuth)
            );
        }
    }
}

/// Length, width and height, and their ratios to the width, as cutters state them.
fn proportions(body: &mut String, gem: &Gem) {
    let ends = |axis: usize| {
        let mut direction = [0.0; 3];
        direction[axis] = 1.0;
        [
            -gem.body.reach(direction.map(|it| -it)),
            gem.body.reach(direction),
        ]
    };
    let [x, y, z] = [0, 1, 2].map(|axis| ends(axis)[1] - ends(axis)[0]);
    let (width, length, across) = if x < y { (x, y, 0) } else { (y, x, 1) };
    let mut ratios = vec![("L/W", length / width), ("H/W", z / width)];
    let of = |stage: Stage| {
        let faces = gem.body.faces().iter();
        let faces = faces.filter(move |face| gem.design.facets[face.tag].stage == stage);
        faces.flat_map(|face| gem.body.corners(face))
    };
    let range = |corners: &mut dyn Iterator<Item = Vector>, axis: usize| {
        corners.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
            [low.min(at[axis]), high.max(at[axis])]
        })
    };
    let table = range(&mut of(Stage::Table), across);
    if table[0] < table[1] {
        ratios.push(("T/W", (table[1] - table[0]) / width));
    }
    let girdle = range(&mut of(Stage::Girdle), 2);
    if girdle[0] < girdle[1] {
        ratios.push(("C/W", (ends(2)[1] - girdle[1]) / width));
        ratios.push(("P/W", (girdle[0] - ends(2)[0]) / width));
    }
    ratios.push(("Vol/W^3", gem.body.volume() / (width * width * width)));
    let design = &gem.design;
    let girdles = gem.body.faces().iter();
    let girdles = girdles.filter(|face| design.facets[face.tag].stage == Stage::Girdle);
    let girdles = girdles.count();
    let _ = write!(
        body,
        "<div class=sum><div><b>{length:.3} x {width:.3} x {z:.3} mm</b>length, width, height</div>\
         <div><b>{} + {girdles}</b>facets, on the girdle</div><div><b>{}</b>index wheel{}</div>\
         <div><b>{}</b>refractive index</div><div><b>{}</b>symmetry</div></div>",
        gem.body.faces().len() - girdles,
        design.gear,
        if design.reversed { ", clockwise" } else { "" },
        design.refractive_index,
        design.symmetry.text()
    );
    let ratios: Vec<String> = ratios
        .iter()
        .map(|(name, ratio)| format!("{name} = {ratio:.3}"))
        .collect();
    let _ = write!(
        body,
        "<p>{}</p><p>W is the smaller one of x and y, T the table, C and P the crown and the \
         pavilion beyond the corners of the girdle.</p>",
        ratios.join(" &nbsp; ")
    );
}

/// The tiers in the order of the cut, by side.
fn tiers(body: &mut String, gem: &Gem) {
    let tiers = gem.design.tiers();
    body.push_str(
        "<h2>Cutting table</h2><table class=tiers><tr><th>tier<th>stage<th>angle, deg<th>index\
         <th>note",
    );
    let mut side = None;
    for tier in &tiers {
        if side != Some(tier.side) {
            let name = match tier.side {
                Side::Pavilion => "Side of the pavilion",
                Side::Crown => "Side of the crown",
            };
            let over = match side {
                None => "",
                Some(_) => ": the stone is turned over before",
            };
            let _ = write!(body, "<tr><th colspan=5>{name}{over}");
            side = Some(tier.side);
        }
        let _ = write!(
            body,
            "<tr><td>{}<td>{}<td>{:.2}<td>{}<td>{}",
            escape(&tier.name),
            tier.stage.name(),
            tier.angle_deg,
            // Lines may break between positions.
            tier.index_text().replace('-', "-<wbr>"),
            escape(&tier.note)
        );
    }
    body.push_str("</table>");
}
