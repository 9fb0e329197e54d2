//! The `[kinematics]` section of an H-4 arm with its rotary table (docs/control.md 2.5-2.6, 7.2).

use super::document::Section;
use super::scale::{PER_MM, to_i32};
use haptimill_kinematics::h4::H4Geometry;
use haptimill_machine_keys::controller::kinematics as keys;
use haptimill_math::Length;

/// Reads the geometry. `singularity_margin`, in mm, is a value of `[supervision]`.
pub fn read_geometry(section: Section<'_, '_>, singularity_margin: f64) -> H4Geometry {
    let (a, b, e) = (
        section.value(keys::a),
        section.value(keys::b),
        section.value(keys::e),
    );
    let (c, d, w) = (
        section.value(keys::c),
        section.value(keys::d),
        section.value(keys::w),
    );
    let (r, ge, tl) = (
        section.value(keys::r),
        section.value(keys::ge),
        section.value(keys::tl),
    );
    let (p, h) = (section.value(keys::p), section.value(keys::h));
    let x_off = section.value(keys::x_off);
    let (y_off, z_off) = (section.value(keys::y_off), section.value(keys::z_off));
    let below = section.choice(keys::branch, &[("below", true), ("above", false)]);

    let lateral = a - b - e;
    if lateral <= 0.0 {
        let what = format!("E = a - b - e is {lateral} mm: the rails must be outside the platform");
        section.report("a", what, "raise a, or lower b or e");
    } else if lateral >= r {
        let what = format!(
            "rods of {r} mm are shorter than E = a - b - e = {lateral} mm: no pose is possible"
        );
        section.report("r", what, "raise r, or lower a - b - e");
    } else if lateral.hypot(d - c) >= r {
        let what = format!(
            "rods of {r} mm are too short for E = {lateral} mm and d - c = {} mm at theta = 0: no pose is possible",
            d - c
        );
        section.report("r", what, "raise r, or bring d nearer to c");
    }
    if (p + x_off).abs() > 2000.0 {
        let what = format!("p + x_off is {} mm, beyond +-2000 mm", p + x_off);
        section.report("x_off", what, "lower it");
    }
    section.finish();

    let length = |value: f64| Length(to_i32(value * PER_MM));
    H4Geometry {
        lateral: length(lateral),
        half_spacing: length(c),
        half_height: length(d),
        joint_offset: length(w),
        rod: length(r),
        rail_offset: length(ge),
        tool: length(tl),
        x_offset: length(p + x_off),
        y_offset: length(y_off),
        z_offset: length(z_off),
        table_height: length(h),
        below: below.unwrap_or(true),
        singularity_margin: length(singularity_margin),
    }
}
