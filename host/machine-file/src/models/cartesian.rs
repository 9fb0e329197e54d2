//! Cartesian machine: its keys and their reader.

use super::ModelFile;
use crate::document::Section;
use haptimill_kinematics::cartesian::{Cartesian, CartesianGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "cartesian"
    kinematics "each joint is the coordinate of its name; the model has no keys." {}
    plant "errors of the directions of the three slides." {
        squareness_xy = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in x per mm of y").or(0.0);
        squareness_xz = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in x per mm of z").or(0.0);
        squareness_yz = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in y per mm of z").or(0.0);
        errors = text("the text of an error file (docs/volumetric.md)")
            .is("geometric errors of the slides").or_text("no errors");
        error_model = word(&["physical", "thesis"])
            .is("how they act on the tool").or_text("\"physical\"");
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = Cartesian;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];

    fn read(_: &Section<'_, '_>, _: f64) -> CartesianGeometry {
        CartesianGeometry {}
    }
}
