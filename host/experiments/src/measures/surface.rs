//! Measures of the cut surface.

use super::context::Context;
use super::statistics::worst;
use haptimill_hil_sim::process::metrology::{Groove, Ring};

/// Depth at which grooves are measured below the uncut top, mm: clear of the corner, which the
/// height map rounds off.
const LEVEL_MM: f64 = 0.2;

/// Radius of the ball-end mill, mm.
const CUTTER_RADIUS_MM: f64 = 4.0;

/// Rays on which a ring is measured.
const RAYS: usize = 360;

/// Half the width at [`LEVEL_MM`] of a groove that the ball cuts at a depth, mm.
fn half_width(depth: f64) -> f64 {
    let above_centre = CUTTER_RADIUS_MM - (depth - LEVEL_MM);
    (CUTTER_RADIUS_MM * CUTTER_RADIUS_MM - above_centre * above_centre).sqrt()
}

fn nominal_depth(context: &Context) -> f64 {
    context.measurement.depth_mm.unwrap_or(f64::NAN)
}

fn depths(context: &Context) -> impl Iterator<Item = f64> {
    let points = context.measurement.points_mm.iter();
    points.map(|[x, y]| context.data.stock.depth(*x, *y))
}

/// Depth at the first point.
pub(super) fn depth(context: &Context) -> f64 {
    depths(context).next().unwrap_or(f64::NAN)
}

/// Increase of the depth from the second point to the first, per mm towards -x.
pub(super) fn depth_gradient(context: &Context) -> f64 {
    let depths: Vec<f64> = depths(context).collect();
    match (&depths[..], &context.measurement.points_mm[..]) {
        ([to, from], [[x_to, _], [x_from, _]]) => (to - from) / (x_from - x_to),
        _ => f64::NAN,
    }
}

/// Largest deviation from the nominal depth at any point.
pub(super) fn depth_error(context: &Context) -> f64 {
    let nominal = nominal_depth(context);
    worst(depths(context).map(|depth| (depth - nominal).abs()))
}

/// Length along x between the centres of the ends.
pub(super) fn groove_length(context: &Context) -> f64 {
    let area = context.data.stock.extents(LEVEL_MM);
    area.map_or(f64::NAN, |area| {
        area.x_max - area.x_min - 2.0 * half_width(nominal_depth(context))
    })
}

fn worst_groove(context: &Context, error: impl Fn(&Groove) -> f64) -> f64 {
    let sections = context.measurement.sections_mm.iter();
    worst(sections.map(|[from, to]| {
        let groove = context.data.stock.groove(*from, *to, LEVEL_MM);
        groove.map_or(f64::NAN, |groove| error(&groove).abs())
    }))
}

/// Largest deviation of the width from the swept volume of the tool in any section.
pub(super) fn groove_width_error(context: &Context) -> f64 {
    let paths = context.measurement.path_width_mm.unwrap_or(0.0);
    let cutter = 2.0 * half_width(nominal_depth(context));
    worst_groove(context, |groove| groove.width() - paths - cutter)
}

/// Largest deviation of the depth from the nominal one in any section.
pub(super) fn groove_depth_error(context: &Context) -> f64 {
    let nominal = nominal_depth(context);
    worst_groove(context, |groove| groove.depth - nominal)
}

fn ring(context: &Context, value: impl Fn(&Ring) -> f64) -> f64 {
    let ring = context.data.stock.ring(LEVEL_MM, RAYS);
    ring.as_ref().map_or(f64::NAN, value)
}

/// Size of the circle along an axis.
pub(super) fn ring_extent(context: &Context) -> f64 {
    ring(context, |ring| match context.axis() {
        0 => ring.extent_x,
        _ => ring.extent_y,
    })
}

/// Least-squares roundness of the middle of the groove.
pub(super) fn ring_roundness(context: &Context) -> f64 {
    ring(context, |ring| ring.middle.roundness)
}

/// Deviation of the width of the groove from the swept volume of the tool.
pub(super) fn ring_width_error(context: &Context) -> f64 {
    let cutter = 2.0 * half_width(nominal_depth(context));
    ring(context, |ring| {
        (2.0 * (ring.outer.radius - ring.inner.radius) / 2.0 - cutter).abs()
    })
}
