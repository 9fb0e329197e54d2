//! Trunnion mill (docs/control.md 2.8): its keys and their reader.

use super::{ModelFile, length};
use crate::document::Section;
use haptimill_kinematics::trunnion::{Trunnion, TrunnionGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "trunnion"
    kinematics "offsets under the names of docs/control.md 2.8, in the frame in which the slides move the tip of a tool of length 0." {
        tilt_y = real(-2000.0, 2000.0, "mm").is("y of the trunnion's axis");
        tilt_z = real(-2000.0, 2000.0, "mm").is("z of the trunnion's axis");
        table_x = real(-2000.0, 2000.0, "mm").is("x of the table's axis with the trunnion at 0");
        table_y = real(-2000.0, 2000.0, "mm").is("y of the table's axis with the trunnion at 0");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin");
        z_off = real(-2000.0, 2000.0, "mm").is("z of the workpiece's origin");
        tl = real(0.0, 1000.0, "mm").is("tool length: from the spindle nose to the tip");
    }
    plant "the true offsets, and the errors of the assembly." {
        tilt_y = real(-2000.0, 2000.0, "mm").is("y of the trunnion's axis, as in `[kinematics]`");
        tilt_z = real(-2000.0, 2000.0, "mm").is("z of the trunnion's axis");
        table_x = real(-2000.0, 2000.0, "mm").is("x of the table's axis with the trunnion at 0");
        table_y = real(-2000.0, 2000.0, "mm").is("y of the table's axis with the trunnion at 0");
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin");
        z_off = real(-2000.0, 2000.0, "mm").is("z of the workpiece's origin");
        tl = real(-2000.0, 2000.0, "mm").is("tool length");
        tilt_about_y_deg = real(-5.0, 5.0, "deg").is("rotation of the trunnion's axis about y").or(0.0);
        tilt_about_z_deg = real(-5.0, 5.0, "deg").is("rotation of the trunnion's axis about z").or(0.0);
        table_about_x_deg = real(-5.0, 5.0, "deg").is("rotation of the table's axis about x").or(0.0);
        table_about_y_deg = real(-5.0, 5.0, "deg").is("rotation of the table's axis about y of the trunnion").or(0.0);
        squareness_xy = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in x per mm of y").or(0.0);
        squareness_xz = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in x per mm of z").or(0.0);
        squareness_yz = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in y per mm of z").or(0.0);
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = Trunnion;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];

    fn read(section: &Section<'_, '_>, _: f64) -> TrunnionGeometry {
        let length = |key| length(section, key);
        TrunnionGeometry {
            tilt_y: length(kinematics::tilt_y),
            tilt_z: length(kinematics::tilt_z),
            table_x: length(kinematics::table_x),
            table_y: length(kinematics::table_y),
            origin: [kinematics::x_off, kinematics::y_off, kinematics::z_off].map(length),
            tool: length(kinematics::tl),
        }
    }
}
