//! Kinematics of a gem-faceting machine: a lift d1 carries an arm that tilts by theta2 and spins
//! the dop by theta3; the stone at its end is ground on a lap, which two slides carry.
//!
//! The pose is `[x, y, height, angle, index]`: the tip of the dop in the lap frame, the angle of
//! the dop's axis from the normal of the lap, and the spin. The joints are `[lap_x, lap_y, d1,
//! theta2, index]`. The lap frame has its origin in the centre of the lap, x along x of the base,
//! and z away from the lap. A facet at the distance h from the tip is on the lap at the height h.
//!
//! With u = 1 for a lap in the direction of z of the base and u = -1 for one below, and the frames
//! of [`chain`] (docs/control.md 2.9):
//!
//! ```text
//! theta2 = angle + (u > 0 ? 0 : 180 deg)                                                  (C38)
//! lap_x = L2 + L3 c2 + L4 s2 - x,   lap_y = -y                                            (C39)
//! d1 = z_lap - u height + L3 s2 - L4 c2                                                   (C40)
//! ```
//!
//! The joint theta2 reads `theta2_zero` less than the angle of the chain. Every pose has joints and
//! every joint position has a pose; both are refused only where a result is beyond the range of a
//! coordinate. The height is held while the arm tilts, because d1 moves by L3 c2 + L4 s2 for each
//! radian; lap_x moves by L4 c2 - L3 s2, so the tip also keeps its place on the lap.

pub mod chain;

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::planar::{Moving, Turn, held, per_turn, turned};
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::scale::{saturate, total};
use haptimill_math::trig::sin_cos;
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 5;
/// Index of the angle in a pose, and of theta2 in the joints.
const ANGLE: usize = 3;
/// Index of the spin in a pose and in the joints.
const INDEX: usize = 4;

/// Largest magnitude of L3 and of L4: 1024 mm.
const MAX_ARM: i64 = 1 << 30;

/// Lengths of a faceting machine, 2^-20 mm, and the place of the lap.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FacetGeometry {
    /// L2: from the lift to the tilt axis, along x.
    pub l2: Length,
    /// L3: from the tilt axis to the spin axis, across the spin axis.
    pub l3: Length,
    /// L4: from the tilt axis to the tip, along the spin axis.
    pub l4: Length,
    /// z of the lap in the base frame.
    pub z_lap: Length,
    /// The lap is in the direction of z of the base; otherwise against it.
    pub lap_in_z: bool,
    /// Angle theta2 of the chain at which the joint theta2 reads 0.
    pub theta2_zero: Angle,
}

/// The faceting machine.
///
/// Lengths are below 2^31, the turned (L3, -L4) below 2^32, and sums of four of them below 2^34.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Facet {
    l2: i64,
    /// (L3, -L4): turned by theta2 it is (p_x - L2, d1 - p_z).
    arm: [i64; 2],
    z_lap: i64,
    /// -u: the sign of the height in d1.
    up: i64,
    /// theta2 of the chain less the angle of the pose.
    to_chain: Angle,
    /// The joint theta2 less the angle of the pose.
    to_joint: Angle,
}

impl Facet {
    /// The turned arm at an angle of the pose: (p_x - L2, d1 - p_z).
    #[inline(always)]
    fn arm(&self, angle: Angle) -> [i64; 2] {
        turned(self.arm, sin_cos(angle.wrapping_add(self.to_chain)))
    }

    /// The heights of the slides and of the lift.
    #[inline(always)]
    fn slides(&self, pose: &Pose, arm: [i64; 2]) -> Result<[Coordinate; 3], PoseError> {
        let [x, y, z, ..] = pose.0.map(|value| i64::from(value.0));
        held([
            total(total(self.l2, arm[0]), -x),
            -y,
            total(total(self.z_lap, self.up * z), arm[1]),
        ])
    }

    /// The angle of the joint theta2 at an angle of the pose.
    #[inline(always)]
    const fn tilt(&self, angle: Coordinate) -> Coordinate {
        Coordinate(angle.0.wrapping_add(self.to_joint.0))
    }

    /// The joints of the chain: d1, theta2, theta3.
    #[must_use]
    pub fn chain(&self, joints: &Joints) -> chain::ChainJoints {
        let offset = self.to_chain.wrapping_sub(self.to_joint);
        chain::ChainJoints {
            d1: joints.0[2],
            theta2: joints.0[ANGLE].angle().wrapping_add(offset),
            theta3: joints.0[INDEX].angle(),
        }
    }
}

impl Machine for Facet {
    type Geometry = FacetGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::{Linear, Rotary};
        Descriptor {
            code: "facet",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("height", Linear, 'Z', Role::ToolZ),
                CoordinateDescriptor::new("angle", Rotary, 'A', Role::None),
                CoordinateDescriptor::new("index", Rotary, 'C', Role::None),
            ],
            joints: &[
                JointDescriptor::new("lap_x", Linear),
                JointDescriptor::new("lap_y", Linear),
                JointDescriptor::new("d1", Linear),
                JointDescriptor::new("theta2", Rotary),
                JointDescriptor::new("index", Rotary),
            ],
            errors: &[],
        }
    };

    fn new(geometry: &FacetGeometry) -> Self {
        let [l2, l3, l4, z_lap] = [geometry.l2, geometry.l3, geometry.l4, geometry.z_lap]
            .map(|length| i64::from(length.0));
        let to_chain = if geometry.lap_in_z {
            Angle::ZERO
        } else {
            Angle::HALF
        };
        Self {
            l2,
            arm: [l3, -l4],
            z_lap,
            up: if geometry.lap_in_z { -1 } else { 1 },
            to_chain,
            to_joint: to_chain.wrapping_sub(geometry.theta2_zero),
        }
    }

    fn is_sound(geometry: &FacetGeometry) -> bool {
        [geometry.l3, geometry.l4]
            .iter()
            .all(|length| i64::from(length.0).abs() <= MAX_ARM)
    }

    /// The slides of the lap move against x and y of the tip, the lift against its height where the
    /// lap is in the direction of z. While the tilt is searched, slides and lift hold still, so the
    /// tip moves on its circle.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        match joint {
            0 | 1 => rates[joint] = -rate,
            2 => rates[joint] = self.up * rate,
            ANGLE => {
                let [across, along] = self.arm(pose.0[ANGLE].angle());
                let turn = Rate(saturate(rate));
                rates[ANGLE] = rate;
                rates[0] = crate::planar::tangential_rate(-along, turn);
                rates[2] = -self.up * crate::planar::tangential_rate(across, turn);
            }
            _ => rates[Self::search_coordinate(joint)] = rate,
        }
        rates
    }
}

impl Kinematics for Facet {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let [x, y, z] = self.slides(pose, self.arm(pose.0[ANGLE].angle()))?;
        let tilt = self.tilt(pose.0[ANGLE]);
        Ok(Joints([x, y, z, tilt, pose.0[INDEX], Coordinate::ZERO]))
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let angle = pose.0[ANGLE].angle().wrapping_add(self.to_chain);
        let arm = Moving {
            at: self.arm,
            ..Moving::default()
        }
        .turned(sin_cos(angle), rates[ANGLE], accelerations[ANGLE]);
        let [x, y, z] = self.slides(pose, arm.at)?;
        let rate = |axis: usize| i64::from(rates[axis].0);
        let push = |axis: usize| i64::from(accelerations[axis].0);
        // A rate or acceleration beyond the range is held at its end, which is above every limit.
        Ok(JointMotion {
            joints: Joints([
                x,
                y,
                z,
                self.tilt(pose.0[ANGLE]),
                pose.0[INDEX],
                Coordinate::ZERO,
            ]),
            rates: [
                Rate(saturate(total(arm.rate[0], -rate(0)))),
                Rate(saturate(-rate(1))),
                Rate(saturate(total(arm.rate[1], self.up * rate(2)))),
                rates[ANGLE],
                rates[INDEX],
                Rate::ZERO,
            ],
            accelerations: [
                Acceleration(saturate(total(arm.push[0], -push(0)))),
                Acceleration(saturate(-push(1))),
                Acceleration(saturate(total(arm.push[1], self.up * push(2)))),
                accelerations[ANGLE],
                accelerations[INDEX],
                Acceleration::ZERO,
            ],
        })
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let angle = Coordinate(joints.0[ANGLE].0.wrapping_sub(self.to_joint.0));
        let [across, along] = self.arm(angle.angle());
        let [x, y, z, ..] = joints.0.map(|value| i64::from(value.0));
        let [x, y, z] = held([
            total(total(self.l2, across), -x),
            -y,
            self.up * total(z, -total(self.z_lap, along)),
        ])?;
        Ok(Pose([x, y, z, angle, joints.0[INDEX], Coordinate::ZERO]))
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        let [across, along] = self.arm(pose.0[ANGLE].angle());
        self.slides(pose, [across, along])?;
        let one = 1_i64 << 32;
        Ok(Jacobian([
            [-one, 0, 0, -per_turn(along), 0, 0],
            [0, -one, 0, 0, 0, 0],
            [0, 0, self.up * one, per_turn(across), 0, 0],
            [0, 0, 0, one, 0, 0],
            [0, 0, 0, 0, one, 0],
            [0; MAX_AXES],
        ]))
    }

    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let mut middle = Pose::default();
        let mut half = [0_u32; AXES];
        for (axis, half) in half.iter_mut().enumerate() {
            let (low, high) = (low.0[axis], high.0[axis]);
            let width = high.wrapping_sub(low).0 as u32;
            *half = width.div_ceil(2);
            middle.0[axis] = Coordinate(low.0.wrapping_add((width / 2) as i32));
        }
        let [by_x, by_y, by_z, by_angle, _] = half.map(i64::from);
        let angle = middle.0[ANGLE].angle().wrapping_add(self.to_chain);
        let turn = Turn::of(angle, by_angle as u32);
        let arm = turn.swept(self.arm, [0; 2]);
        let [x, y, z, ..] = middle.0.map(|value| i64::from(value.0));
        let at = [
            total(total(self.l2, arm.middle[0]), -x),
            -y,
            total(total(self.z_lap, self.up * z), arm.middle[1]),
        ];
        let by = [total(arm.half[0], by_x), by_y, total(arm.half[1], by_z)];
        let mut bounds = BoxBounds::default();
        for (ends, sign) in bounds.joints.iter_mut().zip([-1, 1]) {
            let end = |axis: usize| total(at[axis], sign * by[axis]);
            let slides = held([end(0), end(1), end(2)])?;
            ends.0[..3].copy_from_slice(&slides);
        }
        for (ends, pose) in bounds.joints.iter_mut().zip([low, high]) {
            ends.0[ANGLE] = self.tilt(pose.0[ANGLE]);
            ends.0[INDEX] = pose.0[INDEX];
        }
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            let [x, y, z, angle, index, _] = rates.map(|rate| rate.0.unsigned_abs());
            let swung = turn.speeds(&arm, [0; 2], angle);
            let narrow = |speed: i64| u32::try_from(speed).unwrap_or(u32::MAX);
            *bound = [
                narrow(total(swung[0], i64::from(x))),
                y,
                narrow(total(swung[1], i64::from(z))),
                angle,
                index,
                0,
            ];
        }
        Ok(bounds)
    }
}
