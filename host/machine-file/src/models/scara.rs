//! SCARA arm: its keys and their reader.

use super::{ModelFile, length};
use crate::document::Section;
use haptimill_kinematics::scara::{Scara, ScaraGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "scara"
    kinematics "a shoulder and an elbow that turn about vertical axes, and a vertical slide. The angles are theta1 from +x to the upper arm and theta2 from there to the forearm, right-handed about +z. The workspace is an annulus about the shoulder." {
        upper = real(16.0, 1000.0, "mm").is("length from the axis of the shoulder to that of the elbow");
        fore = real(16.0, 1000.0, "mm").is("length from the axis of the elbow to the tip of the tool");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin, from the shoulder");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin, from the shoulder");
        elbow = word(&["right", "left"])
            .is("side of the elbow, seen from the shoulder to the tip: theta2 is positive or negative");
    }
    plant "the true lengths, and the errors of the assembly." {
        upper = real(1.0, 2000.0, "mm").is("length of the upper arm, as in `[kinematics]`");
        fore = real(1.0, 2000.0, "mm").is("length of the forearm");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin");
        shoulder_zero_deg = real(-5.0, 5.0, "deg").is("true angle of the shoulder where theta1 is 0").or(0.0);
        elbow_zero_deg = real(-5.0, 5.0, "deg").is("true angle of the elbow where theta2 is 0").or(0.0);
        column_about_x_deg = real(-5.0, 5.0, "deg").is("angle by which the column leans about x").or(0.0);
        column_about_y_deg = real(-5.0, 5.0, "deg").is("angle by which the column leans about y").or(0.0);
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = Scara;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];
    const HAS_SINGULARITY: bool = true;

    fn read(section: &Section<'_, '_>, singularity_margin: f64) -> ScaraGeometry {
        let fore = section.value(kinematics::fore);
        if singularity_margin >= fore {
            let what = format!(
                "{fore} mm is not above the singularity margin of {singularity_margin} mm: no pose \
                 is possible"
            );
            section.report("fore", what, "lower singularity_margin_mm in [supervision]");
        }
        let right = section.choice(kinematics::elbow, &[("right", true), ("left", false)]);
        ScaraGeometry {
            upper: length(section, kinematics::upper),
            fore: super::raw_length(fore),
            origin: [kinematics::x_off, kinematics::y_off].map(|key| length(section, key)),
            right: right.unwrap_or(true),
            singularity_margin: super::raw_length(singularity_margin),
        }
    }
}
