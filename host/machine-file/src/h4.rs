//! The `[kinematics]` section of an H-4 arm with its rotary table (docs/control.md 2.5-2.6, 7.2).

use super::document::{Section, real};
use super::scale::{PER_MM, to_i32};
use haptimill_kinematics::h4::H4Geometry;
use haptimill_math::Length;

/// Reads the geometry. `singularity_margin`, in mm, is a value of `[supervision]`.
pub fn read_geometry(section: Section<'_, '_>, singularity_margin: f64) -> H4Geometry {
    let length = |key| section.number(key, real(-1000.0, 1000.0, "mm"));
    let (a, b, e) = (length("a"), length("b"), length("e"));
    let c = section.number("c", real(1.0, 500.0, "mm"));
    let (d, w) = (length("d"), length("w"));
    let r = section.number("r", real(16.0, 1000.0, "mm"));
    let ge = length("ge");
    let tl = section.number("tl", real(0.0, 1000.0, "mm"));
    let (p, h) = (length("p"), length("h"));
    // Offsets may be large: the home position is more than a metre from the arm's origin.
    let offset = |key| section.number(key, real(-2000.0, 2000.0, "mm"));
    let (x_off, y_off, z_off) = (offset("x_off"), offset("y_off"), offset("z_off"));
    let below = section.choice("branch", &[("below", true), ("above", false)]);

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
