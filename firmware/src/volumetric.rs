//! Volumetric compensation: the commanded pose is moved by the known geometric errors of the
//! machine, so that the tool goes where the program wants it.
//!
//! The corrected pose is c = p - f Delta(p), with the error Delta of the tool relative to the
//! workpiece, from measured tables ([`VolumetricConfig`]), and the fade f from 0 to 1. One pass is
//! enough: what it leaves is Delta times the slope of Delta, below 1 nm for 5 um that change by
//! 50 nm per mm.
//!
//! The error is the sum of the translations, of the rotations times their arms, and of the
//! squareness errors times the distance:
//!
//! ```text
//! Delta = sum of t_k(q_k) + sum of r_k(q_k) x a_k + (c0y, b0z, a0z part)
//! ```
//!
//! The arm a_k has those coordinates of the tool that lie between the carriage k and the tool, from
//! the point at which the axis was measured. Rates and accelerations are the derivatives of the
//! same sum. Within a segment of a table they are exact. At a node the slope changes, and the rate
//! with it: by a thousandth of the axis's rate at most, the bound of the tables.
//!
//! | quantity | unit | bound |
//! | --- | --- | --- |
//! | translation, rotation | 2^-8 nm, 2^-8 nrad | 2^28 |
//! | their rates | the same per second | 2^30 |
//! | their accelerations | nm/s^2, nrad/s^2 | 2^26 |
//! | arm, its rate, its acceleration | 2^-12 mm, per second, per second squared | 2^24, 2^23, 2^27 |
//! | sum | 2^-20 pm, per second, per second squared | 2^61 |
//! | position in a table | 2^-24 of a segment | 2^32 |
//!
//! With these bounds no sum overflows, so none is checked. An acceleration beyond 32 m/s^2 is
//! corrected as 32 m/s^2.

use crate::config::volumetric::{CORRECTION, ERROR_AXES, ERRORS, VolumetricConfig};
use crate::motion::PoseCommand;
use haptimill_math::scale::saturate;
use haptimill_math::{Acceleration, Coordinate, Rate};

/// Time of a fade from 0 to 1, microseconds.
const FADE_US: u32 = 1_000_000;

/// The fade is a fraction of 2^30.
const ONE: i64 = 1 << 30;

/// Axis units per pm, 2^-32: 2^20 per mm.
const UNITS_PER_PM: i64 = 4_503_600;

/// Largest acceleration that is corrected, 2^-12 mm/s^2: 32 m/s^2.
const ACCELERATION: i32 = 1 << 27;

/// One unit of a translation in units of the sum, and of its acceleration.
const TRANSLATION: i32 = 1000 << 12;
const TRANSLATION_ACCELERATION: i32 = 1000 << 20;

/// Error functions of one axis in a segment: the values at its lower node, and the changes to the
/// upper one, nm or nrad.
#[derive(Debug, Clone, Copy, Default)]
struct Segment {
    values: [i32; ERRORS],
    slopes: [i32; ERRORS],
}

/// An error function at a position.
#[derive(Debug, Clone, Copy, Default)]
struct Function {
    value: i32,
    rate: i32,
    acceleration: i32,
}

/// Position, rate and acceleration of a sum.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Error {
    position: i64,
    rate: i64,
    acceleration: i64,
}

/// State of volumetric compensation.
#[derive(Debug, Default)]
pub struct Compensation {
    /// The host wants it.
    requested: bool,
    /// The fade goes towards 1.
    rises: bool,
    /// Periods of the fade so far, and of a whole fade.
    faded: u32,
    fade: u32,
    /// 2^50 divided by the node pitch of each axis.
    reciprocals: [u32; ERROR_AXES],
    /// Segment of each axis, and its number.
    segments: [Segment; ERROR_AXES],
    numbers: [u8; ERROR_AXES],
    /// The corrected pose of this period.
    corrected: PoseCommand,
}

impl Compensation {
    /// Compensation that is off until it may fade in.
    #[must_use]
    #[cold]
    #[inline(never)]
    pub fn new(config: &VolumetricConfig, period_us: u16) -> Self {
        Self {
            requested: true,
            fade: FADE_US / u32::from(period_us.max(1)),
            reciprocals: core::array::from_fn(|axis| {
                let pitch = i64::from(config.axes[axis].pitch.0.max(1));
                ((1_i64 << 50) / pitch).min(i64::from(i32::MAX)) as u32
            }),
            numbers: [u8::MAX; ERROR_AXES],
            ..Self::default()
        }
    }

    /// Asks for compensation, or for none. It fades.
    pub const fn request(&mut self, requested: bool) {
        self.requested = requested;
    }

    /// Whether the host wants compensation.
    #[must_use]
    pub const fn is_requested(&self) -> bool {
        self.requested
    }

    /// Constants, for the integrity check.
    #[must_use]
    pub const fn constants(&self) -> (u32, [u32; ERROR_AXES]) {
        (self.fade, self.reciprocals)
    }

    /// Whether the pose is corrected at all.
    #[must_use]
    #[inline]
    pub const fn is_active(&self) -> bool {
        self.faded != 0
    }

    /// Whether the whole correction is in effect.
    #[must_use]
    #[inline]
    pub const fn is_complete(&self) -> bool {
        self.faded >= self.fade
    }

    /// Part of the fade that is over, percent: 100 where the whole correction is in effect.
    #[must_use]
    pub const fn percent(&self) -> u8 {
        let fade = if self.fade == 0 { 1 } else { self.fade };
        (self.faded as u64 * 100 / fade as u64) as u8
    }

    /// Switches the correction off without a fade. Callers must make the corrected pose the
    /// commanded one, or have the drives off.
    pub const fn reset(&mut self) {
        self.faded = 0;
    }

    /// One period of the fade: towards 1 where compensation is requested and `allowed`, otherwise
    /// towards 0.
    #[inline]
    pub const fn advance(&mut self, allowed: bool) {
        self.rises = self.requested && allowed;
        if !self.rises {
            self.faded = self.faded.saturating_sub(1);
        } else if self.faded < self.fade {
            self.faded += 1;
        }
    }

    /// The corrected pose of this period, with its rates and accelerations.
    #[inline(never)]
    pub fn correct(
        &mut self,
        config: &VolumetricConfig,
        commanded: &PoseCommand,
        period_us: u16,
    ) -> &PoseCommand {
        let mut errors = self.errors(config, commanded);
        if self.faded < self.fade {
            self.weigh(&mut errors, period_us);
        }
        self.corrected = *commanded;
        let corrected = &mut self.corrected;
        for (axis, error) in errors.iter().enumerate() {
            let place = &mut corrected.pose.0[axis];
            *place = Coordinate(place.0.saturating_sub(error.units()));
            let rate = &mut corrected.rates[axis];
            *rate = rate.saturating_sub(Rate(scaled(error.rate >> 24)));
            let acceleration = &mut corrected.accelerations[axis];
            let own = Acceleration(scaled(error.acceleration >> 32));
            *acceleration = acceleration.saturating_sub(own);
        }
        &self.corrected
    }

    /// The error at a corrected pose, axis units: what [`correct`](Self::correct) took away there.
    #[must_use]
    #[inline(never)]
    pub fn error_at(&self, config: &VolumetricConfig, pose: &[Coordinate]) -> [i32; ERROR_AXES] {
        let mut probe = Self {
            rises: self.rises,
            faded: self.faded,
            fade: self.fade,
            reciprocals: self.reciprocals,
            numbers: [u8::MAX; ERROR_AXES],
            ..Self::default()
        };
        let mut command = PoseCommand::default();
        let slots = command.pose.0.iter_mut().zip(pose);
        slots.for_each(|(slot, value)| *slot = *value);
        let mut errors = probe.errors(config, &command);
        if self.faded < self.fade {
            self.weigh(&mut errors, 1);
        }
        errors.map(|error| error.units())
    }

    /// Applies the fade: 3 s^2 - 2 s^3, which begins and ends with rate zero. Its own acceleration,
    /// at most 6 per second squared, is left out: 0.03 mm/s^2 for an error of 5 um.
    #[inline(never)]
    fn weigh(&self, errors: &mut [Error; ERROR_AXES], period_us: u16) {
        let part = i64::from(self.faded) * ONE / i64::from(self.fade.max(1));
        let square = (part * part) >> 30;
        let weight = (square * (3 * ONE - 2 * part)) >> 30;
        let slope = 6 * ((part * (ONE - part)) >> 30);
        let duration_us = i64::from(self.fade) * i64::from(period_us);
        let rate = slope * 1_000_000 / duration_us.max(1);
        let rate = if self.rises { rate } else { -rate };
        // 2^52 is 4 mm, or 4 mm/s; accelerations have 2^61.
        let times =
            |value: i64, weight: i64| ((value.clamp(-(1 << 52), 1 << 52) >> 22) * weight) >> 8;
        for error in errors {
            let Error {
                position,
                rate: own,
                acceleration,
            } = *error;
            error.position = times(position, weight);
            error.rate = times(own, weight) + times(position, rate);
            let second = ((acceleration >> 31) * weight) << 1;
            error.acceleration = second + 2 * times(own, rate);
        }
    }

    /// Errors of x, y and z at a pose.
    #[inline]
    fn errors(&mut self, config: &VolumetricConfig, at: &PoseCommand) -> [Error; ERROR_AXES] {
        let mut sum = [Error::default(); ERROR_AXES];
        for axis in 0..ERROR_AXES {
            let functions = self.functions(config, axis, at);
            let [tx, ty, tz, rx, ry, rz] = &functions;
            for (sum, translation) in sum.iter_mut().zip([tx, ty, tz]) {
                sum.translate(translation);
            }
            let tables = &config.axes[axis];
            // The vector product r x a, by the coordinates of the arm.
            let [x, y, z] = &mut sum;
            if tables.arm & 1 != 0 {
                let arm = Arm::of(tables.measured_at[0], at, 0);
                y.turn(rz, &arm);
                z.turn(ry, &arm.negative());
            }
            if tables.arm & 2 != 0 {
                let arm = Arm::of(tables.measured_at[1], at, 1);
                z.turn(rx, &arm);
                x.turn(rz, &arm.negative());
            }
            if tables.arm & 4 != 0 {
                let arm = Arm::of(tables.measured_at[2], at, 2);
                x.turn(ry, &arm);
                y.turn(rx, &arm.negative());
            }
        }
        let [c0y, b0z, a0z] = config.squareness;
        let [x, y, _] = &mut sum;
        let (along_y, along_z) = (Arm::of(Coordinate(0), at, 1), Arm::of(Coordinate(0), at, 2));
        x.turn(&Function::constant(-c0y), &along_y);
        x.turn(&Function::constant(b0z), &along_z);
        y.turn(&Function::constant(-a0z), &along_z);
        sum
    }

    /// Error functions of an axis.
    #[inline(never)]
    fn functions(
        &mut self,
        config: &VolumetricConfig,
        axis: usize,
        at: &PoseCommand,
    ) -> [Function; ERRORS] {
        let tables = &config.axes[axis];
        // Below 2^31, as the pitch is at least 1 mm.
        let reciprocal = self.reciprocals[axis] as i32;
        let from = at.pose.0[axis].0.saturating_sub(tables.first.0);
        let last = i64::from(tables.nodes.max(2) - 1) << 24;
        let place = product(from, reciprocal) >> 26;
        let inside = (0..last).contains(&place);
        let place = place.clamp(0, last - 1);
        let number = (place >> 24) as u8;
        if number != self.numbers[axis] {
            self.numbers[axis] = number;
            self.segments[axis] = Segment::of(config, axis, number);
        }
        let part = (place & 0xFF_FFFF) as i32;
        // Beyond its ends a table is constant.
        let (speed, gain) = if inside {
            let acceleration = at.accelerations[axis].0;
            let acceleration = acceleration.clamp(-ACCELERATION, ACCELERATION);
            (
                // 2^-16 segments per second, 2^-8 segments per second squared.
                (product(at.rates[axis].0, reciprocal) >> 34) as i32,
                (product(acceleration, reciprocal) >> 34) as i32,
            )
        } else {
            (0, 0)
        };
        let segment = &self.segments[axis];
        let mut functions = [Function::default(); ERRORS];
        let rows = segment.values.iter().zip(&segment.slopes);
        for (function, (value, slope)) in functions.iter_mut().zip(rows) {
            function.value = (value << 8).wrapping_add((product(*slope, part) >> 16) as i32);
            function.rate = (product(*slope, speed) >> 8) as i32;
            function.acceleration = (product(*slope, gain) >> 8) as i32;
        }
        functions
    }
}

/// Product of two numbers.
#[inline(always)]
const fn product(a: i32, b: i32) -> i64 {
    (a as i64).wrapping_mul(b as i64)
}

/// 16 pm, or 4096 pm/s^2, to axis units, or 256 axis units.
#[inline]
const fn scaled(value: i64) -> i32 {
    (product(saturate(value), 16 * UNITS_PER_PM as i32) >> 32) as i32
}

/// A coordinate of an arm, its rate and its acceleration.
#[derive(Debug, Clone, Copy)]
struct Arm {
    length: i32,
    rate: i32,
    acceleration: i32,
}

impl Arm {
    #[inline]
    fn of(measured_at: Coordinate, at: &PoseCommand, along: usize) -> Self {
        let acceleration = at.accelerations[along].0;
        Self {
            length: at.pose.0[along].0.saturating_sub(measured_at.0) >> 8,
            rate: at.rates[along].0 >> 8,
            acceleration: acceleration.clamp(-ACCELERATION, ACCELERATION),
        }
    }

    #[inline]
    const fn negative(&self) -> Self {
        Self {
            length: self.length.wrapping_neg(),
            rate: self.rate.wrapping_neg(),
            acceleration: self.acceleration.wrapping_neg(),
        }
    }
}

impl Function {
    /// A rotation that does not change, nrad.
    const fn constant(angle: i32) -> Self {
        Self {
            value: angle << 8,
            rate: 0,
            acceleration: 0,
        }
    }
}

impl Segment {
    /// The segment of an axis that begins at a node.
    #[inline(never)]
    fn of(config: &VolumetricConfig, axis: usize, number: u8) -> Self {
        let start = config.start(axis) + usize::from(number) * ERRORS;
        let value = |place: usize| {
            let value = config.values.get(place).copied().unwrap_or_default();
            i32::from(value) << config.shift
        };
        let values = core::array::from_fn(|index| value(start + index));
        let next = |index: usize| value(start + ERRORS + index);
        Self {
            values,
            slopes: core::array::from_fn(|index| next(index).wrapping_sub(values[index])),
        }
    }
}

impl Error {
    /// Adds a translation.
    #[inline]
    const fn translate(&mut self, by: &Function) {
        self.position = self.position.wrapping_add(product(by.value, TRANSLATION));
        self.rate = self.rate.wrapping_add(product(by.rate, TRANSLATION));
        let acceleration = product(by.acceleration, TRANSLATION_ACCELERATION);
        self.acceleration = self.acceleration.wrapping_add(acceleration);
    }

    /// Adds a rotation times a coordinate of its arm.
    #[inline]
    const fn turn(&mut self, by: &Function, arm: &Arm) {
        self.position = self.position.wrapping_add(product(by.value, arm.length));
        let rate = product(by.rate, arm.length).wrapping_add(product(by.value, arm.rate));
        self.rate = self.rate.wrapping_add(rate);
        let acceleration = (product(by.acceleration, arm.length) << 8)
            .wrapping_add(product(by.rate, arm.rate) << 1)
            .wrapping_add(product(by.value, arm.acceleration));
        self.acceleration = self.acceleration.wrapping_add(acceleration);
    }

    /// The position in axis units, within the largest correction.
    #[inline]
    fn units(&self) -> i32 {
        scaled(self.position >> 24).clamp(-CORRECTION, CORRECTION)
    }
}
