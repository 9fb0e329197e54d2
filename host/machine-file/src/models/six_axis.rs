//! Machine with three slides and three rotary axes: its keys and their reader.

use super::ModelFile;
use crate::document::Section;
use haptimill_kinematics::cartesian::{CartesianGeometry, SixAxis};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "six_axis"
    kinematics "each joint is the coordinate of its name; the model has no keys. The rotary axes a and b have limits within a turn, c of up to 470 turns." {}
    plant "the rotary axes carry neither the tool nor the workpiece; the section has no keys." {}
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = SixAxis;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];

    fn read(_: &Section<'_, '_>, _: f64) -> CartesianGeometry {
        CartesianGeometry {}
    }
}
