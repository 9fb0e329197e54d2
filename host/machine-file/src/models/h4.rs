//! H-4 arm with its rotary table (docs/control.md 2.5-2.6, 7.2): its keys and their reader.

use super::{ModelFile, raw_length};
use crate::document::Section;
use haptimill_kinematics::h4::{H4, H4Geometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "h4"
    kinematics "lengths under the names of docs/control.md 1.1." {
        a = real(-1000.0, 1000.0, "mm").is("lateral offset of the rails")
            .bounded("E = a - b - e above 0 and below r");
        b = real(-1000.0, 1000.0, "mm").is("lateral offset of the slides");
        e = real(-1000.0, 1000.0, "mm").is("lateral offset of the platform");
        c = real(1.0, 500.0, "mm")
            .is("half the distance of the two platform joints along the tool axis");
        d = real(-1000.0, 1000.0, "mm").is("half the height difference of the rail pairs");
        w = real(-1000.0, 1000.0, "mm").is("offset of a slide's joint along x");
        r = real(16.0, 1000.0, "mm").is("length of the rods").bounded("above sqrt(E^2 + (d - c)^2)");
        ge = real(-1000.0, 1000.0, "mm").is("z offset of the rails");
        tl = real(0.0, 1000.0, "mm").is("tool length: from the lower platform joint to the tip");
        p = real(-1000.0, 1000.0, "mm").is("x offset of the table");
        h = real(-1000.0, 1000.0, "mm").is("height of the arm's origin above the table axis");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin")
            .bounded("p + x_off within +-1000");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin")
            .bounded("within +-1000 for the controller");
        z_off = real(-2000.0, 2000.0, "mm").is("z of the workpiece's origin")
            .bounded("within +-1000 for the controller");
        branch = word(&["below", "above"]).is("assembly branch: platform below or above the rails");
    }
    plant "the true lengths." {
        a = other("E = a - b - e is 1 to 2000 mm").is("as in `[kinematics]`, like all keys here");
        b = other("as `a`").is("lateral offset of the slides");
        c = real(1.0, 2000.0, "mm")
            .is("half the distance of the two platform joints along the tool axis");
        d = real(-2000.0, 2000.0, "mm").is("half the height difference of the rail pairs");
        e = other("as `a`").is("lateral offset of the platform");
        w = real(-2000.0, 2000.0, "mm").is("offset of a slide's joint along x");
        r = real(1.0, 2000.0, "mm").is("length of the rods");
        ge = real(-2000.0, 2000.0, "mm").is("z offset of the rails");
        tl = real(-2000.0, 2000.0, "mm").is("tool length");
        p = real(-2000.0, 2000.0, "mm").is("x offset of the table");
        h = real(-2000.0, 2000.0, "mm").is("height of the arm's origin above the table axis");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin");
        z_off = real(-2000.0, 2000.0, "mm").is("z of the workpiece's origin");
        branch = word(&["below", "above"]).is("assembly branch");
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = H4;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];
    const HAS_SINGULARITY: bool = true;

    fn read(section: &Section<'_, '_>, singularity_margin: f64) -> H4Geometry {
        read_geometry(section, singularity_margin)
    }
}

fn read_geometry(section: &Section<'_, '_>, singularity_margin: f64) -> H4Geometry {
    let (a, b, e) = (
        section.value(kinematics::a),
        section.value(kinematics::b),
        section.value(kinematics::e),
    );
    let (c, d, w) = (
        section.value(kinematics::c),
        section.value(kinematics::d),
        section.value(kinematics::w),
    );
    let (r, ge, tl) = (
        section.value(kinematics::r),
        section.value(kinematics::ge),
        section.value(kinematics::tl),
    );
    let (p, h) = (section.value(kinematics::p), section.value(kinematics::h));
    let x_off = section.value(kinematics::x_off);
    let (y_off, z_off) = (
        section.value(kinematics::y_off),
        section.value(kinematics::z_off),
    );
    let below = section.choice(kinematics::branch, &[("below", true), ("above", false)]);

    if singularity_margin > 100.0 {
        let what =
            format!("needs a singularity margin of 1 to 100 mm, and it is {singularity_margin}");
        section.report(
            "model",
            what,
            "lower singularity_margin_mm in [supervision]",
        );
    }
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
    let length = raw_length;
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
