//! Linear delta: its keys and their reader.

use super::{ModelFile, length, raw_length};
use crate::document::Section;
use haptimill_kinematics::Machine;
use haptimill_kinematics::linear_delta::{LinearDelta, LinearDeltaGeometry};
use haptimill_machine_keys::{self as keys, model_keys};

model_keys! {
    "linear_delta"
    kinematics "three vertical slides s1, s2, s3 with rods that hold a level platform. The columns are counter-clockwise about the origin, which is within their triangle. The tip is below the upper ends of the rods." {
        rods = list(3, 50.0, 600.0, "mm").is("lengths of the rods, between the centres of their ends");
        radii = list(3, 50.0, 400.0, "mm")
            .is("horizontal distances of the upper ends of the rods from the origin, less those of the lower ends from the tip");
        angles_deg = list(3, -360.0, 720.0, "deg").is("directions of the columns, from +x to +y");
        height = real(-2000.0, 2000.0, "mm")
            .is("height of the upper ends of the rods above the lower ones at z = 0 with the slides at 0");
    }
    plant "the true lengths, and the errors of the assembly." {
        rods = list(3, 1.0, 2000.0, "mm").is("lengths of the rods, as in `[kinematics]`");
        radii = list(3, 1.0, 2000.0, "mm").is("distances of the columns");
        angles_deg = list(3, -360.0, 720.0, "deg").is("directions of the columns");
        height = real(-2000.0, 2000.0, "mm").is("height of the upper ends at z = 0 with the slides at 0");
        lean_out_deg = list(3, -5.0, 5.0, "deg").is("angles by which the columns lean outwards").or_text("[0, 0, 0]");
        lean_along_deg = list(3, -5.0, 5.0, "deg")
            .is("angles by which the columns lean counter-clockwise about the origin").or_text("[0, 0, 0]");
    }
}

/// The model in a machine file.
pub(super) struct File;

impl ModelFile for File {
    type Machine = LinearDelta;

    const SECTIONS: [keys::Section; 2] = [kinematics::SECTION, plant::SECTION];
    const HAS_SINGULARITY: bool = true;

    fn read(section: &Section<'_, '_>, singularity_margin: f64) -> LinearDeltaGeometry {
        let rods: [f64; 3] = section.values(kinematics::rods);
        let radii: [f64; 3] = section.values(kinematics::radii);
        let angles: [f64; 3] = section.values(kinematics::angles_deg);
        let column = |index: usize| {
            let (sine, cosine) = angles[index].to_radians().sin_cos();
            [cosine, sine].map(|part| raw_length(part * radii[index]))
        };
        let geometry = LinearDeltaGeometry {
            rods: rods.map(raw_length),
            columns: [column(0), column(1), column(2)],
            height: length(section, kinematics::height),
            singularity_margin: raw_length(singularity_margin),
        };
        let read = [rods, radii, angles].concat();
        let read = read.iter().all(|value| value.is_finite());
        if read && rods.iter().any(|rod| *rod <= singularity_margin) {
            let what = format!(
                "a rod is not above the singularity margin of {singularity_margin} mm: no pose is \
                 possible"
            );
            section.report("rods", what, "lower singularity_margin_mm in [supervision]");
        } else if read && !LinearDelta::is_sound(&geometry) {
            let what = "the columns make no triangle with sides of 80 mm or more about the origin";
            let remedy = "write them counter-clockwise, such as [210, 330, 90]";
            section.report("angles_deg", what, remedy);
        }
        geometry
    }
}
