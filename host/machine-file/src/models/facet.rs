//! Faceting machine (docs/control.md 2.9): its keys and their reader.

use super::{ModelFile, length};
use crate::document::Section;
use crate::scale::{PER_DEG, to_i64};
use haptimill_kinematics::facet::{Facet, FacetGeometry};
use haptimill_machine_keys::{self as keys, model_keys};
use haptimill_math::Angle;

model_keys! {
    "facet"
    kinematics "lengths under the names of docs/control.md 2.9." {
        l2 = real(-2000.0, 2000.0, "mm").is("from the lift to the tilt axis, along x");
        l3 = real(-1000.0, 1000.0, "mm").is("from the tilt axis to the spin axis");
        l4 = real(-1000.0, 1000.0, "mm").is("from the tilt axis to the tip, along the spin axis");
        z_lap = real(-2000.0, 2000.0, "mm").is("z of the lap in the base frame");
        lap_dir = plus_minus().is("direction of the lap along z of the base; -1: below");
        theta2_zero_deg = real(-180.0, 180.0, "deg").is("tilt of the chain where the joint theta2 reads 0");
    }
    plant "the true lengths, and errors of the lap." {
        l2 = real(-2000.0, 2000.0, "mm").is("from the lift to the tilt axis, as in `[kinematics]`");
        l3 = real(-1000.0, 1000.0, "mm").is("from the tilt axis to the spin axis");
        l4 = real(-1000.0, 1000.0, "mm").is("from the tilt axis to the tip");
        z_lap = real(-2000.0, 2000.0, "mm").is("z of the lap in the base frame");
        lap_dir = other("1 or -1").is("direction of the lap along z of the base");
        theta2_zero_deg = real(-180.0, 180.0, "deg").is("tilt of the chain where the joint reads 0");
        lap_about_x_deg = real(-1.0, 1.0, "deg").is("rotation of the lap about its x axis").or(0.0);
        lap_about_y_deg = real(-1.0, 1.0, "deg").is("rotation of the lap about its y axis").or(0.0);
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = Facet;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];

    fn read(section: &Section<'_, '_>, _: f64) -> FacetGeometry {
        let length = |key| length(section, key);
        FacetGeometry {
            l2: length(kinematics::l2),
            l3: length(kinematics::l3),
            l4: length(kinematics::l4),
            z_lap: length(kinematics::z_lap),
            lap_in_z: section.value(kinematics::lap_dir) > 0.0,
            // 180 degrees are -180 degrees.
            theta2_zero: Angle(to_i64(section.value(kinematics::theta2_zero_deg) * PER_DEG) as i32),
        }
    }
}
