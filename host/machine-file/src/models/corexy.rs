//! Machine with crossed belts: its keys and their reader.

use super::ModelFile;
use crate::document::Section;
use haptimill_kinematics::corexy::{Corexy, CorexyGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "corexy"
    kinematics "two motors at rest move the tool by a belt each, and a slide moves it along z. The joints a = x + y and b = x - y are mm of belt; the model has no keys. A home switch of a belt measures a or b, not x or y. In homing each motor moves alone, along a diagonal: the frame must have room for the strokes of both belts at once, |x + y| and |x - y|." {}
    plant "places of the motors, and errors of the assembly." {
        motors_y = real(-4000.0, -1.0, "mm").is("y of both motors, seen from the tool where the belts are at zero");
        aside_a = real(-50.0, 50.0, "mm").is("distance of motor a from the line of its pulley on the beam").or(0.0);
        aside_b = real(-50.0, 50.0, "mm").is("distance of motor b from the line of its pulley on the beam").or(0.0);
        squareness_xy = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in x per mm of y").or(0.0);
        squareness_xz = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in x per mm of z").or(0.0);
        squareness_yz = real(-0.1, 0.1, "mm/mm").is("displacement of the tool in y per mm of z").or(0.0);
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = Corexy;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];

    fn read(_: &Section<'_, '_>, _: f64) -> CorexyGeometry {
        CorexyGeometry {}
    }
}
