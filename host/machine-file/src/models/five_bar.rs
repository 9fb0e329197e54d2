//! Five-bar arm: its keys and their reader.

use super::{ModelFile, length, raw_length};
use crate::document::Section;
use haptimill_kinematics::five_bar::{FiveBar, FiveBarGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "five_bar"
    kinematics "two motors on one line, each with an arm of two links, that hold the tool together, and a vertical slide. The angles theta1 and theta2 are those of the left and the right proximal link from +y, right-handed about +z. Both elbows are on the outer side." {
        base = real(0.0, 1000.0, "mm").is("distance of the axes of the motors, along x");
        proximal = real(16.0, 1000.0, "mm").is("length of both links from a motor to its elbow");
        distal = real(16.0, 1000.0, "mm").is("length of both links from an elbow to the tip of the tool");
        x_off = real(-1500.0, 1500.0, "mm").is("x of the workpiece's origin, from the middle between the motors");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin, from the middle between the motors");
    }
    plant "the true lengths, and the errors of the assembly; lists have the left arm first." {
        base = real(0.0, 2000.0, "mm").is("distance of the axes of the motors, as in `[kinematics]`");
        proximal = list(2, 1.0, 2000.0, "mm").is("lengths of the proximal links");
        distal = list(2, 1.0, 2000.0, "mm").is("lengths of the distal links");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin");
        zero_deg = list(2, -5.0, 5.0, "deg")
            .is("true angles of the proximal links where theta1 and theta2 are 0").or_text("[0, 0]");
        column_about_x_deg = real(-5.0, 5.0, "deg").is("angle by which the base leans about x").or(0.0);
        column_about_y_deg = real(-5.0, 5.0, "deg").is("angle by which the base leans about y").or(0.0);
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = FiveBar;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];
    const HAS_SINGULARITY: bool = true;

    fn read(section: &Section<'_, '_>, singularity_margin: f64) -> FiveBarGeometry {
        let distal = section.value(kinematics::distal);
        if singularity_margin >= distal {
            let what = format!(
                "{distal} mm is not above the singularity margin of {singularity_margin} mm: no \
                 pose is possible"
            );
            section.report(
                "distal",
                what,
                "lower singularity_margin_mm in [supervision]",
            );
        }
        FiveBarGeometry {
            half_base: raw_length(section.value(kinematics::base) / 2.0),
            proximal: length(section, kinematics::proximal),
            distal: raw_length(distal),
            origin: [kinematics::x_off, kinematics::y_off].map(|key| length(section, key)),
            singularity_margin: raw_length(singularity_margin),
        }
    }
}
