//! Polar mill: its keys and their reader.

use super::{ModelFile, length, raw_length};
use crate::document::Section;
use haptimill_kinematics::polar_mill::{PolarMill, PolarMillGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "polar_mill"
    kinematics "a slide r that moves the tool radially over a table theta, which turns the workpiece right-handed about +z, and a vertical slide. r is the distance of the tip from the axis of the table. The table may have `wrap = true`." {
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin with the table at 0, from the axis of the table");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin with the table at 0, from the axis of the table");
    }
    plant "the true offsets, and the errors of the assembly." {
        x_off = real(-2000.0, 2000.0, "mm").is("x of the workpiece's origin, as in `[kinematics]`");
        y_off = real(-2000.0, 2000.0, "mm").is("y of the workpiece's origin");
        r_zero = real(-10.0, 10.0, "mm").is("true place of the tip along the slide where r is 0").or(0.0);
        across = real(-10.0, 10.0, "mm").is("distance by which the tip passes the axis of the table, along y of the machine").or(0.0);
        theta_zero_deg = real(-5.0, 5.0, "deg").is("true angle of the table where theta is 0").or(0.0);
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = PolarMill;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];
    const HAS_SINGULARITY: bool = true;

    fn read(section: &Section<'_, '_>, singularity_margin: f64) -> PolarMillGeometry {
        PolarMillGeometry {
            origin: [kinematics::x_off, kinematics::y_off].map(|key| length(section, key)),
            singularity_margin: raw_length(singularity_margin),
        }
    }
}
