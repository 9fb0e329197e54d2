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
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::scale::{multiply_high, round_shift, saturate, scale, total};
use haptimill_math::trig::{ONE, QUARTER_PI_Q31, sin_cos};
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Number of pose coordinates, and of joints.
const AXES: usize = 5;
/// Index of the trunnion in a pose and in the joints.
const A: usize = 3;
/// Index of the table in a pose and in the joints.
const C: usize = 4;

/// 2 pi, Q28.
const TWO_PI_Q28: i32 = 1_686_629_713;

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

/// A vector in the plane that a rotary axis turns, with its derivatives: 2^-20 mm, mm/s and 2^-12
/// mm/s^2.
#[derive(Debug, Clone, Copy, Default)]
struct Moving {
    at: [i64; 2],
    rate: [i64; 2],
    push: [i64; 2],
}

/// A vector turned by an angle of this sine and cosine.
#[inline(always)]
fn turned([a, b]: [i64; 2], (sine, cosine): (i32, i32)) -> [i64; 2] {
    [
        total(scale(a, cosine, 30), scale(b, -sine, 30)),
        total(scale(a, sine, 30), scale(b, cosine, 30)),
    ]
}

/// A length per radian as a length per turn.
#[inline(always)]
fn per_turn(lever: i64) -> i64 {
    scale(lever, TWO_PI_Q28, 28)
}

/// Speed of a lever that turns at a rate, and of a speed the acceleration.
#[inline(always)]
fn swing(lever: i64, rate: Rate) -> i64 {
    scale(per_turn(lever), rate.0, 32)
}

impl Moving {
    /// The vector turned by an angle that moves: with r' = R r, rate R v + w x r', and acceleration
    /// R a + w' x r' + w x (2 R v + w x r').
    #[inline(always)]
    fn turned(self, angle: (i32, i32), rate: Rate, push: Acceleration) -> Self {
        let at = turned(self.at, angle);
        let along = turned(self.rate, angle);
        let [ahead, aside] = at.map(|lever| swing(lever, rate));
        let speed = [
            total(along[0], aside.wrapping_neg()),
            total(along[1], ahead),
        ];
        // Speeds are below 2^36, accelerations in 2^-20 mm/s^2 below 2^45.
        let [ahead, aside] =
            [total(speed[0], along[0]), total(speed[1], along[1])].map(|speed| swing(speed, rate));
        let [spin, spin_aside] = at.map(|lever| scale(per_turn(lever), push.0, 24));
        let along = turned(self.push, angle);
        Self {
            at,
            rate: speed,
            push: [
                total(along[0], -round_shift(total(aside, spin_aside), 8)),
                total(along[1], round_shift(total(ahead, spin), 8)),
            ],
        }
    }
}

/// The coordinates, or the error if one is beyond its range.
#[inline(always)]
fn held([x, y, z]: [i64; 3]) -> Result<[Coordinate; 3], PoseError> {
    let leaves = |value: i64| value ^ value as i32 as i64;
    if leaves(x) | leaves(y) | leaves(z) != 0 {
        return Err(PoseError::Unreachable);
    }
    Ok([x, y, z].map(|value| Coordinate(value as i32)))
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
    fn place(&self, pose: &Pose) -> ([i64; 2], [i64; 2]) {
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
                CoordinateDescriptor::new("c", Rotary, 'C', Role::None),
            ],
            joints: &[
                JointDescriptor::new("lx", Linear),
                JointDescriptor::new("ly", Linear),
                JointDescriptor::new("lz", Linear),
                JointDescriptor::new("a", Rotary),
                JointDescriptor::new("c", Rotary),
            ],
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
    fn workpiece_rotation(&self, pose: &Pose) -> Angle {
        pose.0[A].angle()
    }

    /// While a rotary axis is searched the slides stand still, so the tip moves in the workpiece
    /// frame.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let mut rates = [0; MAX_AXES];
        rates[Self::search_coordinate(joint)] = rate;
        let turn = Rate(saturate(rate));
        let ([x, y], height) = self.on_table(pose);
        match joint {
            A => {
                let (sine, cosine) = sin_cos(pose.0[C].angle());
                let [_, q] = turned([x, y], (sine, cosine));
                let across = swing(height, turn);
                rates[0] = scale(across, sine, 30);
                rates[1] = scale(across, cosine, 30);
                rates[2] = -swing(total(q, self.apart), turn);
            }
            C => {
                rates[0] = swing(y, turn);
                rates[1] = -swing(x, turn);
            }
            _ => {}
        }
        rates
    }
}

impl Kinematics for Trunnion {
    fn axes(&self) -> usize {
        AXES
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let ([p, _], [v, h]) = self.place(pose);
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
        let back = |angle: Angle| {
            let (sine, cosine) = sin_cos(angle);
            (-sine, cosine)
        };
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
        let ([p, q], [v, h]) = self.place(pose);
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

/// What was rounded in the bound of a length, or of a rate, in axis units (per second).
const ROUNDED: i64 = 16;
const ROUNDED_RATE: i64 = 64;

/// A range of angles about its middle: Q30.
struct Turn {
    angle: (i32, i32),
    /// Largest sine, and 1 less the least cosine, of an angle within half the range.
    sine: u32,
    versine: u32,
    /// Bounds of the magnitudes of sine and cosine over the range.
    most_sine: u32,
    most_cosine: u32,
}

/// Box about a vector of a plane.
struct Swept {
    middle: [i64; 2],
    half: [i64; 2],
}

/// Product of a magnitude with a number in Q30 of at most 2, rounded up.
#[inline(always)]
fn share(value: i64, part: u32) -> i64 {
    total(multiply_high(value << 2, part), 1)
}

impl Turn {
    fn of(angle: Angle, half: u32) -> Self {
        let angle = sin_cos(angle);
        // Radians, rounded up.
        let by = ((u64::from(half) * u64::from(QUARTER_PI_Q31.unsigned_abs())) >> 30) + 1;
        let one = ONE.unsigned_abs();
        // Below 2^32, so its square fits.
        let versine = ((by * by) >> 31).min(u64::from(2 * one)) as u32;
        let sine = by.min(u64::from(one)) as u32;
        let (sine, versine) = if half == 0 { (0, 0) } else { (sine, versine) };
        let most = |value: i32| value.unsigned_abs().saturating_add(sine).min(one);
        Self {
            angle,
            sine,
            versine,
            most_sine: most(angle.0),
            most_cosine: most(angle.1),
        }
    }

    /// The box of the vectors of a box, turned by all angles of the range.
    fn swept(&self, middle: [i64; 2], [a, b]: [i64; 2]) -> Swept {
        let middle = turned(middle, self.angle);
        let (sine, cosine) = (self.angle.0.unsigned_abs(), self.angle.1.unsigned_abs());
        let moved = a | b | i64::from(self.sine) != 0;
        let half = [
            total(share(a, cosine), share(b, sine)),
            total(share(a, sine), share(b, cosine)),
        ];
        let most = [
            total(middle[0].abs(), half[0]),
            total(middle[1].abs(), half[1]),
        ];
        let swung =
            |along: i64, aside: i64| total(share(aside, self.sine), share(along, self.versine));
        let half = [
            total(total(half[0], swung(most[0], most[1])), ROUNDED),
            total(total(half[1], swung(most[1], most[0])), ROUNDED),
        ];
        Swept {
            middle,
            half: if moved { half } else { [0; 2] },
        }
    }

    /// Bounds of the speeds of the vectors of a box, which move with these speeds before they are
    /// turned, and turn at this rate.
    fn speeds(&self, swept: &Swept, [a, b]: [i64; 2], rate: u32) -> [i64; 2] {
        let round = |axis: usize| {
            let lever = total(swept.middle[axis].abs(), swept.half[axis]);
            multiply_high(per_turn(lever), rate)
        };
        let along = [
            total(share(a, self.most_cosine), share(b, self.most_sine)),
            total(share(a, self.most_sine), share(b, self.most_cosine)),
        ];
        [
            total(total(along[0], round(1)), ROUNDED_RATE),
            total(total(along[1], round(0)), ROUNDED_RATE),
        ]
    }
}
