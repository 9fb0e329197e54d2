//! The `[kinematics]` section of a trunnion mill (docs/control.md 2.8).

use super::document::Section;
use super::scale::{PER_MM, to_i32};
use haptimill_kinematics::trunnion::TrunnionGeometry;
use haptimill_machine_keys::controller::kinematics as keys;
use haptimill_math::Length;

/// Reads the geometry.
pub fn read_geometry(section: Section<'_, '_>) -> TrunnionGeometry {
    let length = |key| Length(to_i32(section.value(key) * PER_MM));
    let geometry = TrunnionGeometry {
        tilt_y: length(keys::tilt_y),
        tilt_z: length(keys::tilt_z),
        table_x: length(keys::table_x),
        table_y: length(keys::table_y),
        origin: [keys::x_off, keys::y_off, keys::z_off].map(length),
        tool: length(keys::tl),
    };
    section.finish();
    geometry
}
