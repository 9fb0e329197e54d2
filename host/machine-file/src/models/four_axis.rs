//! Mill with three slides and a rotary axis: its keys and their reader.

use super::ModelFile;
use crate::document::Section;
use haptimill_kinematics::cartesian::{CartesianGeometry, FourAxis};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "four_axis"
    kinematics "each joint is the coordinate of its name; the model has no keys. The rotary axis has limits of up to 470 turns." {}
    plant "place of the rotary axis, which is along x." {
        axis_y = real(-2000.0, 2000.0, "mm").is("y of the rotary axis");
        axis_z = real(-2000.0, 2000.0, "mm").is("z of the rotary axis");
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = FourAxis;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];

    fn read(_: &Section<'_, '_>, _: f64) -> CartesianGeometry {
        CartesianGeometry {}
    }
}
