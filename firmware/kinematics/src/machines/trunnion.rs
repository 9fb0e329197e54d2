//! Kinematics of a mill whose table turns about two axes: tool on slides x, y, z; a trunnion A
//! that tilts about x; a table C that turns on the trunnion about z.
//!
//! The pose is `[x, y, z, a, c]`: the tip of the tool in the workpiece frame, and the angles of
//! trunnion and table, which turn the workpiece right-handed about +x and +z. The joints are `[lx,
//! ly, lz, a, c]`. Neither rotary axis needs to meet the other, or the origin of the workpiece.
//! With the offsets of [`TrunnionGeometry`], docs/control.md 2.8:
//!
//! ```text
//! (p, q) = R(c) (x - c_x + x_off, y - c_y + y_off)                                        (C33)
//! (v, h) = R(a) (q + c_y - a_y, z + z_off - a_z)                                          (C34)
//! l_x = p + c_x,   l_y = v + a_y,   l_z = h + a_z + t_l                                   (C35)
//! ```
//!
//! Every pose has joints and every joint position has a pose. Both are refused only where a result
//! is beyond the range of a coordinate. There is no singularity, because the angles are given and
//! not computed from a direction of the tool.

use crate::descriptor::{AxisKind, CoordinateDescriptor, Descriptor, JointDescriptor, Role};
use crate::machine::Machine;
use crate::planar::{Moving, Turn, held, per_turn, tangential_rate, turned};
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::scale::{round_shift, saturate, scale, total};
use haptimill_math::trig::sin_cos;
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 5;
/// Index of the trunnion in a pose and in the joints.
const A: usize = 3;
/// Index of the table in a pose and in the joints.
const C: usize = 4;

/// Offsets of a trunnion mill, 2^-20 mm, in the machine frame: the frame in which the slides move
/// the tip of a tool of length 0.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TrunnionGeometry {
    /// y of the trunnion's axis.
    pub tilt_y: Length,
    /// z of the trunnion's axis.
    pub tilt_z: Length,
    /// x of the table's axis with the trunnion at 0.
    pub table_x: Length,
    /// y of the table's axis with the trunnion at 0.
    pub table_y: Length,
    /// Origin of the workpiece frame with both rotary axes at 0.
    pub origin: [Length; 3],
    /// Tool length.
    pub tool: Length,
}

/// The trunnion mill.
///
/// Sums of at most five lengths are below 2^34, and rotated below 2^35.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Trunnion {
    /// From the table's axis, and from the trunnion's in z, to the origin of the workpiece.
    origin: [i64; 3],
    /// From the trunnion's axis to the table's, y.
    apart: i64,
    /// From joints to (p, v, h).
    axes: [i64; 3],
}

/// Sine and cosine of the turn back by an angle.
fn back(angle: Angle) -> (i32, i32) {
    let (sine, cosine) = sin_cos(angle);
    (-sine, cosine)
}

impl Trunnion {
    /// The tip relative to the table's axis, and its height above the trunnion's.
    #[inline(always)]
    fn on_table(&self, pose: &Pose) -> ([i64; 2], i64) {
        let [x, y, z, ..] = pose.0.map(|value| i64::from(value.0));
        let [origin_x, origin_y, origin_z] = self.origin;
        ([total(x, origin_x), total(y, origin_y)], total(z, origin_z))
    }

    /// The positions of the slides.
    #[inline(always)]
    fn slides(&self, [p, v, h]: [i64; 3]) -> Result<[Coordinate; 3], PoseError> {
        let [x, y, z] = self.axes;
        held([total(p, x), total(v, y), total(h, z)])
    }

    /// (p, q) and (v, h) of a pose.
    #[inline(always)]
    fn solve_positions(&self, pose: &Pose) -> ([i64; 2], [i64; 2]) {
        let (flat, height) = self.on_table(pose);
        let [p, q] = turned(flat, sin_cos(pose.0[C].angle()));
        let across = [total(q, self.apart), height];
        ([p, q], turned(across, sin_cos(pose.0[A].angle())))
    }
}

impl Machine for Trunnion {
    type Geometry = TrunnionGeometry;

    const DESCRIPTOR: Descriptor = {
        use AxisKind::{Linear, Rotary};
        Descriptor {
            code: "trunnion",
            pose: &[
                CoordinateDescriptor::new("x", Linear, 'X', Role::ToolX),
                CoordinateDescriptor::new("y", Linear, 'Y', Role::ToolY),
                CoordinateDescriptor::new("z", Linear, 'Z', Role::ToolZ),
                CoordinateDescriptor::new("a", Rotary, 'A', Role::WorkpieceRotation),
                CoordinateDescriptor::new("c", Rotary, 'C', Role::TableRotation),
            ],
            joints: &[
                JointDescriptor::new("lx", Linear),
                JointDescriptor::new("ly", Linear),
                JointDescriptor::new("lz", Linear),
                JointDescriptor::new("a", Rotary),
                JointDescriptor::new("c", Rotary),
            ],
            errors: &[],
        }
    };

    fn new(geometry: &TrunnionGeometry) -> Self {
        let [x, y, z] = geometry.origin.map(|length| i64::from(length.0));
        let [tilt_y, tilt_z, table_x, table_y, tool] = [
            geometry.tilt_y,
            geometry.tilt_z,
            geometry.table_x,
            geometry.table_y,
            geometry.tool,
        ]
        .map(|length| i64::from(length.0));
        Self {
            origin: [x - table_x, y - table_y, z - tilt_z],
            apart: table_y - tilt_y,
            axes: [table_x, tilt_y, tilt_z + tool],
        }
    }

    /// Every geometry is sound: the arithmetic holds all lengths.
    fn is_sound(_: &TrunnionGeometry) -> bool {
        true
    }

    #[inline]
    fn sensor_rotation(&self, pose: &Pose) -> [Angle; 2] {
        [pose.0[A].angle(), pose.0[C].angle()]
    }

    /// A slide moves alone: with turned rotary axes the tip then moves along several coordinates of
    /// the workpiece. While a rotary axis is searched the slides are at rest, so the tip moves in
    /// the workpiece frame.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        rates[Self::search_coordinate(joint)] = rate;
        let turn = Rate(saturate(rate));
        let ([x, y], height) = self.on_table(pose);
        match joint {
            A => {
                let (sine, cosine) = sin_cos(pose.0[C].angle());
                let [_, q] = turned([x, y], (sine, cosine));
                let across = tangential_rate(height, turn);
                rates[0] = scale(across, sine, 30);
                rates[1] = scale(across, cosine, 30);
                rates[2] = -tangential_rate(total(q, self.apart), turn);
            }
            C => {
                rates[0] = tangential_rate(y, turn);
                rates[1] = -tangential_rate(x, turn);
            }
            _ => {
                let alone = |slide: usize| if joint == slide { rate } else { 0 };
                let [q, height] = turned([alone(1), alone(2)], back(pose.0[A].angle()));
                let [along_x, along_y] = turned([alone(0), q], back(pose.0[C].angle()));
                [rates[0], rates[1], rates[2]] = [along_x, along_y, height];
            }
        }
        rates
    }
}

impl Kinematics for Trunnion {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let ([p, _], [v, h]) = self.solve_positions(pose);
        let [x, y, z] = self.slides([p, v, h])?;
        Ok(Joints([x, y, z, pose.0[A], pose.0[C], Coordinate::ZERO]))
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let (at, height) = self.on_table(pose);
        let rate = |axis: usize| i64::from(rates[axis].0);
        let push = |axis: usize| i64::from(accelerations[axis].0);
        let flat = Moving {
            at,
            rate: [rate(0), rate(1)],
            push: [push(0), push(1)],
        }
        .turned(sin_cos(pose.0[C].angle()), rates[C], accelerations[C]);
        let across = Moving {
            at: [total(flat.at[1], self.apart), height],
            rate: [flat.rate[1], rate(2)],
            push: [flat.push[1], push(2)],
        }
        .turned(sin_cos(pose.0[A].angle()), rates[A], accelerations[A]);
        let [x, y, z] = self.slides([flat.at[0], across.at[0], across.at[1]])?;
        // A rate or acceleration beyond the range is held at its end, which is above every limit.
        Ok(JointMotion {
            joints: Joints([x, y, z, pose.0[A], pose.0[C], Coordinate::ZERO]),
            rates: [
                Rate(saturate(flat.rate[0])),
                Rate(saturate(across.rate[0])),
                Rate(saturate(across.rate[1])),
                rates[A],
                rates[C],
                Rate::ZERO,
            ],
            accelerations: [
                Acceleration(saturate(flat.push[0])),
                Acceleration(saturate(across.push[0])),
                Acceleration(saturate(across.push[1])),
                accelerations[A],
                accelerations[C],
                Acceleration::ZERO,
            ],
        })
    }

    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        let [x, y, z, ..] = joints.0.map(|value| i64::from(value.0));
        let [axis_x, axis_y, axis_z] = self.axes;
        let [q, height] = turned(
            [total(y, -axis_y), total(z, -axis_z)],
            back(joints.0[A].angle()),
        );
        let flat = turned(
            [total(x, -axis_x), total(q, -self.apart)],
            back(joints.0[C].angle()),
        );
        let [origin_x, origin_y, origin_z] = self.origin;
        let [x, y, z] = held([
            total(flat[0], -origin_x),
            total(flat[1], -origin_y),
            total(height, -origin_z),
        ])?;
        Ok(Pose([x, y, z, joints.0[A], joints.0[C], Coordinate::ZERO]))
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        let ([p, q], [v, h]) = self.solve_positions(pose);
        self.slides([p, v, h])?;
        let (tilt_sine, tilt_cosine) = sin_cos(pose.0[A].angle());
        let (sine, cosine) = sin_cos(pose.0[C].angle());
        let one = 1_i64 << 32;
        // Q30, and a product of two of them, to Q32.
        let wide = |value: i32| i64::from(value) << 2;
        let both = |a: i32, b: i32| round_shift(i64::from(a) * i64::from(b), 28);
        let lever = per_turn(p);
        Ok(Jacobian([
            [wide(cosine), wide(-sine), 0, 0, -per_turn(q), 0],
            [
                both(tilt_cosine, sine),
                both(tilt_cosine, cosine),
                wide(-tilt_sine),
                -per_turn(h),
                scale(lever, tilt_cosine, 30),
                0,
            ],
            [
                both(tilt_sine, sine),
                both(tilt_sine, cosine),
                wide(tilt_cosine),
                per_turn(v),
                scale(lever, tilt_sine, 30),
                0,
            ],
            [0, 0, 0, one, 0, 0],
            [0, 0, 0, 0, one, 0],
            [0; MAX_AXES],
        ]))
    }

    /// A centred form: the pose in the middle, and how far each turned vector may be from its own,
    /// with terms of first and second order in the half angle.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let mut middle = Pose::default();
        let mut half = [0_u32; AXES];
        for (axis, half) in half.iter_mut().enumerate() {
            let (low, high) = (low.0[axis], high.0[axis]);
            let width = high.wrapping_sub(low).0 as u32;
            *half = width.div_ceil(2);
            middle.0[axis] = Coordinate(low.0.wrapping_add((width / 2) as i32));
        }
        let [by_x, by_y, by_z, by_a, by_c] = half;
        let (flat, height) = self.on_table(&middle);
        let table = Turn::of(middle.0[C].angle(), by_c);
        let tilt = Turn::of(middle.0[A].angle(), by_a);
        let flat = table.swept(flat, [i64::from(by_x), i64::from(by_y)]);
        let across = tilt.swept(
            [total(flat.middle[1], self.apart), height],
            [flat.half[1], i64::from(by_z)],
        );
        let mut bounds = BoxBounds::default();
        for (ends, sign) in bounds.joints.iter_mut().zip([-1, 1]) {
            let end = |middle: i64, half: i64| total(middle, sign * half);
            let [x, y, z] = self.slides([
                end(flat.middle[0], flat.half[0]),
                end(across.middle[0], across.half[0]),
                end(across.middle[1], across.half[1]),
            ])?;
            ends.0[..3].copy_from_slice(&[x, y, z]);
        }
        for axis in [A, C] {
            bounds.joints[0].0[axis] = low.0[axis];
            bounds.joints[1].0[axis] = high.0[axis];
        }
        for (bound, rates) in bounds.rates.iter_mut().zip(rates) {
            let [x, y, z, a, c, _] = rates.map(|rate| rate.0.unsigned_abs());
            let plane = table.speeds(&flat, [i64::from(x), i64::from(y)], c);
            let upright = tilt.speeds(&across, [plane[1], i64::from(z)], a);
            let narrow = |speed: i64| u32::try_from(speed).unwrap_or(u32::MAX);
            *bound = [
                narrow(plane[0]),
                narrow(upright[0]),
                narrow(upright[1]),
                a,
                c,
                0,
            ];
        }
        Ok(bounds)
    }
}
