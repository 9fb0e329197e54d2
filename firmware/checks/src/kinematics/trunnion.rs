//! The trunnion mill as a subject. Its reference values follow from turning points about the two
//! axes as lines in space.

use super::subject::{MM, Margin, Margins, Reals, Sequence, Subject};
use core::f64::consts::PI;
use haptimill_kinematics::trunnion::{Trunnion, TrunnionGeometry};
use haptimill_kinematics::{Joints, MAX_AXES, Machine, PoseError};
use haptimill_math::{Coordinate, Length};
use heapless::Vec;

/// The range of a coordinate, mm.
const RANGE: f64 = 2048.0;

/// Offsets in mm, in the frame of the machine.
#[derive(Clone, Copy)]
pub struct Offsets {
    /// A point of the trunnion's axis, which runs along x.
    pub tilt: [f64; 3],
    /// A point of the table's axis with the trunnion at 0; it runs along z then.
    pub table: [f64; 3],
    /// Origin of the workpiece with both axes at 0.
    pub origin: [f64; 3],
    /// Tool length.
    pub tool: f64,
}

/// Axes that meet each other and the origin of the workpiece.
pub const MEETING: Offsets = Offsets {
    tilt: [0.0, 0.0, 0.0],
    table: [0.0, 0.0, 0.0],
    origin: [0.0, 0.0, 0.0],
    tool: 0.0,
};

/// Axes apart from each other, and every offset in use, with no round and no equal values.
pub const APART: Offsets = Offsets {
    tilt: [0.0, -31.625, -217.25],
    table: [18.375, 12.0625, 0.0],
    origin: [-41.5, 73.8125, -166.125],
    tool: 111.6875,
};

/// A trunnion mill with its reference values and its kinematics.
pub struct TrunnionMill {
    offsets: Offsets,
    machine: Trunnion,
}

/// A point turned about the line through `at`, parallel to the axis, right-handed.
fn about(axis: usize, at: [f64; 3], angle: f64, point: [f64; 3]) -> [f64; 3] {
    let (one, two) = ((axis + 1) % 3, (axis + 2) % 3);
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    let (a, b) = (point[one] - at[one], point[two] - at[two]);
    let mut turned = point;
    turned[one] = at[one] + c * a - s * b;
    turned[two] = at[two] + s * a + c * b;
    turned
}

impl TrunnionMill {
    /// Creates the mill of these offsets.
    #[must_use]
    pub fn new(offsets: Offsets) -> Self {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        let geometry = TrunnionGeometry {
            tilt_y: raw(offsets.tilt[1]),
            tilt_z: raw(offsets.tilt[2]),
            table_x: raw(offsets.table[0]),
            table_y: raw(offsets.table[1]),
            origin: offsets.origin.map(raw),
            tool: raw(offsets.tool),
        };
        Self {
            offsets,
            machine: Trunnion::new(&geometry),
        }
    }

    fn slides(&self, pose: &Reals) -> [f64; 3] {
        let o = &self.offsets;
        let at_rest = core::array::from_fn(|i| pose[i] + o.origin[i]);
        let turned = about(2, o.table, pose[4], at_rest);
        let [x, y, z] = about(0, o.tilt, pose[3], turned);
        [x, y, z + o.tool]
    }

    fn tip(&self, joints: &Reals) -> [f64; 3] {
        let o = &self.offsets;
        let tip = [joints[0], joints[1], joints[2] - o.tool];
        let level = about(0, o.tilt, -joints[3], tip);
        let at_rest = about(2, o.table, -joints[4], level);
        core::array::from_fn(|i| at_rest[i] - o.origin[i])
    }
}

impl Subject for TrunnionMill {
    type Machine = Trunnion;

    fn machine(&self) -> &Trunnion {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let mut pose = [0.0; MAX_AXES];
        for value in &mut pose[..3] {
            *value = sequence.between(-900.0, 900.0);
        }
        for value in &mut pose[3..5] {
            *value = sequence.between(-PI, PI);
        }
        pose
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let mut joints = self.random_pose(sequence);
        let near = RANGE + sequence.logarithmic(-7.0, 1.0);
        let side = if sequence.next() & 1 == 0 { 1.0 } else { -1.0 };
        joints[sequence.below(3) as usize] = side * near;
        let [x, y, z] = self.tip(&joints);
        [x, y, z, joints[3], joints[4], 0.0]
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let mut joints = Joints::default();
        for joint in &mut joints.0[..5] {
            *joint = Coordinate(sequence.next() as i32);
        }
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        let mut margins: Vec<Margin, 12> = Vec::new();
        let slides = self.slides(pose);
        for value in slides.iter().chain(&pose[..3]) {
            margins.extend([Margin::mm(RANGE - value.abs(), |error| {
                *error == PoseError::Unreachable
            })]);
        }
        Margins(margins)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        let [x, y, z] = self.slides(pose);
        Some([x, y, z, pose[3], pose[4], 0.0])
    }

    fn solve(&self, joints: &Reals, _: &Reals) -> Option<Reals> {
        let [x, y, z] = self.tip(joints);
        Some([x, y, z, joints[3], joints[4], 0.0])
    }
}
