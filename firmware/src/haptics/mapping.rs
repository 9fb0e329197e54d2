//! Master-to-tool mapping: docs/control.md (3.1)-(3.8) without a division by zero.
//!
//! When the master starts to move the tool (the enabling switch is pressed, a coordinate is
//! assigned to it, the scale changes), the positions of master and tool are latched for each
//! coordinate. From then on
//!
//! ```text
//! X_sd = G_P (X_m - X_mr) + X_sr          R_sd = (R_m R_mr^T) R_sr
//! ```
//!
//! At that moment the tool's target is its own position, so nothing jumps. Of R_sd the tool can
//! follow only its axis. With s the tool axis at the latch, R_mr^T s =: h is a fixed direction in
//! the handle, and R_m h is the target direction of the tool axis. (3.27)-(3.28) give theta and
//! alpha.
//!
//! Callers must latch the position at which a moving tool comes to standstill. The present position
//! of a moving tool would pull it back.

use super::MasterPose;
use haptimill_kinematics::haptic_arm::Vector;
use haptimill_math::root::hypot;
use haptimill_math::scale::{multiply_shift, round_shift, saturate};
use haptimill_math::trig::{atan2, sin_cos};
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Number of coordinates that a master can move: x, y, z, and theta and alpha by the direction of
/// the tool.
pub const MASTER_COORDINATES: usize = 5;

/// Index of the first of the two angles.
const THETA: usize = 3;

/// Position scale of 1.
pub const SCALE_ONE: u16 = 1 << 12;

/// Handle in a control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HandleFrame {
    /// Tip, 2^-20 mm.
    pub tip: Vector,
    /// n, o and a, Q30.
    pub axes: [Vector; 3],
    /// The enabling switch is pressed.
    pub enabling_switch: bool,
}

impl HandleFrame {
    /// The frame of a remote master from a sample that is `age` control periods old, with
    /// `per_second` control periods per second. The motion is extrapolated for at most 0.02 s.
    #[must_use]
    pub fn of(master: &MasterPose, age: u32, per_second: u32) -> Self {
        let age = i64::from(age.min(per_second / 50));
        let on = |axis: usize| {
            // 2^-12 mm/s times control periods: below 2^31 * 2^9 * 2^8.
            let displacement =
                (i64::from(master.rate[axis]) << 8) * age / i64::from(per_second.max(1));
            saturate(i64::from(master.tip[axis]) + displacement)
        };
        let wide = |axis: [i16; 3]| axis.map(|part| i32::from(part) << 15);
        let (n, a) = (wide(master.axes[0]), wide(master.axes[1]));
        let product = |i: usize, j: usize| {
            (multiply_shift(a[i], n[j], 30) - multiply_shift(a[j], n[i], 30)) as i32
        };
        Self {
            tip: [on(0), on(1), on(2)],
            axes: [n, [product(1, 2), product(2, 0), product(0, 1)], a],
            enabling_switch: master.enabling_switch,
        }
    }
}

/// Master-to-tool mapping with its latched positions.
#[derive(Debug, Clone, Copy, Default)]
pub struct MasterMapping {
    scale: i64,
    /// Latched coordinates, one bit each.
    latched: u8,
    master: Vector,
    tool: [i32; MASTER_COORDINATES],
    /// Tool axis at the latch, in handle coordinates.
    latched_axis: Vector,
    targets: [Option<Coordinate>; MAX_AXES],
}

impl MasterMapping {
    /// Creates a mapping with a position scale, 2^-12.
    #[must_use]
    pub fn new(scale: u16) -> Self {
        Self {
            scale: i64::from(scale),
            ..Self::default()
        }
    }

    /// Releases all coordinates.
    pub const fn release(&mut self) {
        self.latched = 0;
        self.targets = [None; MAX_AXES];
    }

    /// Releases one coordinate; it is latched again when the master moves it next.
    pub const fn release_one(&mut self, axis: usize) {
        if axis < MASTER_COORDINATES {
            self.latched &= !(1 << axis);
            self.targets[axis] = None;
        }
    }

    /// Sets the position scale and latches the present targets.
    pub fn set_scale(&mut self, scale: u16, frame: Option<&HandleFrame>) {
        self.scale = i64::from(scale);
        for axis in 0..THETA {
            if let (Some(target), Some(frame)) = (self.targets[axis], frame) {
                (self.master[axis], self.tool[axis]) = (frame.tip[axis], target.0);
            } else {
                self.release_one(axis);
            }
        }
    }

    /// Whether the master moves any coordinate.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        self.latched != 0
    }

    /// Target positions of the coordinates that the master moves.
    #[must_use]
    pub const fn targets(&self) -> &[Option<Coordinate>; MAX_AXES] {
        &self.targets
    }

    /// Computes the targets of a control period. The master moves the coordinates of `mask` (one
    /// bit each); `standstill_position` returns the position at which a coordinate comes to
    /// standstill if nothing moves it.
    pub fn follow(
        &mut self,
        frame: &HandleFrame,
        mask: u8,
        standstill_position: impl Fn(usize) -> Coordinate,
    ) {
        self.targets = [None; MAX_AXES];
        let fresh = mask & !self.latched;
        for axis in 0..THETA {
            if mask & (1 << axis) == 0 {
                continue;
            }
            if fresh & (1 << axis) != 0 {
                (self.master[axis], self.tool[axis]) =
                    (frame.tip[axis], standstill_position(axis).0);
            }
            // Below 2^32 * 2^13.
            let displacement =
                (i64::from(frame.tip[axis]) - i64::from(self.master[axis])) * self.scale;
            let target = i64::from(self.tool[axis]) + round_shift(displacement, 12);
            self.targets[axis] = Some(Coordinate(saturate(target)));
        }
        let angles = mask >> THETA & 3;
        if angles != 0 {
            if fresh >> THETA & 3 != 0 {
                self.hold(
                    frame,
                    standstill_position(THETA),
                    standstill_position(THETA + 1),
                );
            }
            let [theta, alpha] = self.angles(frame);
            for (bit, angle) in [theta, alpha].into_iter().enumerate() {
                if angles & (1 << bit) != 0 {
                    self.targets[THETA + bit] = Some(angle);
                }
            }
        }
        self.latched = mask & ((1 << MASTER_COORDINATES) - 1);
    }

    /// Latches the tool axis: (sin theta, cos theta sin alpha, cos theta cos alpha) in handle
    /// coordinates.
    #[cold]
    fn hold(&mut self, frame: &HandleFrame, theta: Coordinate, alpha: Coordinate) {
        let ((s, c), (sa, ca)) = (sin_cos(theta.angle()), sin_cos(alpha.angle()));
        let axis = [
            s,
            multiply_shift(c, sa, 30) as i32,
            multiply_shift(c, ca, 30) as i32,
        ];
        self.latched_axis = frame
            .axes
            .map(|column| round_shift(dot(column, axis), 30) as i32);
    }

    /// Theta and alpha from (3.27), (3.28).
    fn angles(&self, frame: &HandleFrame) -> [Coordinate; 2] {
        let row = |k: usize| {
            let parts = [frame.axes[0][k], frame.axes[1][k], frame.axes[2][k]];
            round_shift(dot(parts, self.latched_axis), 30) as i32
        };
        let [i, j, k] = [row(0), row(1), row(2)];
        let flat = hypot(j, k).min(i32::MAX as u32) as i32;
        [atan2(i, flat).into(), atan2(j, k).into()]
    }
}

fn dot(a: Vector, b: Vector) -> i64 {
    // Both are directions: below 3 * 2^60.
    (0..3)
        .map(|axis| i64::from(a[axis]) * i64::from(b[axis]))
        .sum()
}

/// Last sample of a remote master.
#[derive(Debug, Clone, Copy, Default)]
pub struct RemoteMaster {
    master: MasterPose,
    /// Control periods since the sample; `None` without a sample.
    age: Option<u32>,
}

impl RemoteMaster {
    /// Sets a new sample that is `age` control periods old.
    pub const fn set_sample(&mut self, master: &MasterPose, age: u32) {
        self.master = *master;
        self.age = Some(age);
    }

    /// Forgets the sample.
    pub const fn reset(&mut self) {
        self.age = None;
    }

    /// Advances the age by one control period.
    pub const fn grow(&mut self) {
        if let Some(age) = &mut self.age {
            *age = age.saturating_add(1);
        }
    }

    /// Age of the sample in control periods; `None` without a sample.
    #[must_use]
    pub const fn age(&self) -> Option<u32> {
        self.age
    }

    /// Extrapolated frame of the master; `None` without a sample.
    #[must_use]
    pub fn frame(&self, per_second: u32) -> Option<HandleFrame> {
        self.age
            .map(|age| HandleFrame::of(&self.master, age, per_second))
    }

    /// Rates of the master, 2^-20 mm/s.
    #[must_use]
    pub fn rates(&self) -> [Rate; 3] {
        self.master.rate.map(|rate| Rate(rate.saturating_mul(256)))
    }
}
