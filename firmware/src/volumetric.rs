//! Volumetric compensation: the commanded pose is moved by the known geometric errors of the
//! machine, so that the tool goes where the program wants it.
//!
//! The corrected pose is c = p - f Delta(c), with the error Delta of the tool relative to the
//! workpiece, from measured tables ([`VolumetricConfig`]), and the fade f from 0 to 1. The machine
//! makes the error of the pose to which it moves, so Delta belongs at c. Each period evaluates it
//! at the commanded pose less the correction of the period before. At rest that converges to the
//! solution within a few periods. Evaluated at p, it would leave Delta times the slope of Delta:
//! 23 nm for errors of 50 um.
//!
//! The error is the sum of the translations, of the rotations times their arms, and of the
//! squareness errors times the distance:
//!
//! ```text
//! Delta = sum of t_k(q_k) + sum of r_k(q_k) x a_k + (c0y, b0z, a0z part)
//! ```
//!
//! The arm a_k has those coordinates of the tool that lie between the carriage k and the tool, from
//! the point at which the axis was measured. That point is constant, so a segment of a table has
//! its share in the translations, and all rotations about one coordinate with the same arm are
//! summed before they are multiplied. Rates and accelerations are the derivatives of the same sum.
//! Within a segment of a table they are exact. At a node the slope changes, and the rate with it:
//! by a thousandth of the axis's rate at most, the bound of the tables.
//!
//! | quantity | unit | bound |
//! | --- | --- | --- |
//! | value of a translation, a rotation at a node | 2^-4 nm, nrad | 2^25, 2^20 |
//! | sum of translations, of rotations | 2^-8 nm, 2^-8 nrad | 2^30 |
//! | their rates | the same per second | 2^31 |
//! | their accelerations | nm/s^2, nrad/s^2 | 2^27 |
//! | arm, its rate, its acceleration | 2^-12 mm, per second, per second squared | 2^23, 2^23, 2^27 |
//! | error | 2^-20 pm, per second, per second squared | 2^61 |
//! | position in a table | 2^-24 of a segment | 2^32 |
//!
//! With these bounds no sum overflows, so none is checked. An acceleration beyond 32 m/s^2 is
//! corrected as 32 m/s^2.

use crate::config::volumetric::{CORRECTION, ERROR_AXES, ERRORS, VolumetricConfig};
use crate::motion::PoseCommand;
use haptimill_math::scale::saturate;
use haptimill_math::{Acceleration, Coordinate, Rate};

/// Order of the error functions of an axis in its table.
const TX: usize = 0;
const TY: usize = 1;
const TZ: usize = 2;
const RX: usize = 3;
const RY: usize = 4;
const RZ: usize = 5;

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
/// upper one. Translations, 2^-4 nm, have the share of the point at which the axis was measured;
/// rotations are nrad.
#[derive(Debug, Clone, Copy, Default)]
struct Segment {
    values: [i32; ERRORS],
    slopes: [i32; ERRORS],
}

/// Position of an axis in its segment.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Part of the segment, 2^-24.
    part: i32,
    /// 2^-16 segments per second.
    speed: i32,
    /// 2^-8 segments per second squared.
    gain: i32,
}

/// A sum of error functions: values at the lower nodes in the unit of [`Segment`], and the products
/// of the slopes with the members of [`Place`].
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    value: i32,
    position: i64,
    rate: i64,
    acceleration: i64,
}

impl Sum {
    #[inline(always)]
    const fn add(&mut self, segment: &Segment, function: usize, place: &Place) {
        let slope = segment.slopes[function];
        self.value = self.value.wrapping_add(segment.values[function]);
        self.position = self.position.wrapping_add(product(slope, place.part));
        self.rate = self.rate.wrapping_add(product(slope, place.speed));
        self.acceleration = self.acceleration.wrapping_add(product(slope, place.gain));
    }
}

/// The axes whose carriage is followed by that of a coordinate on the way to the tool.
#[derive(Debug, Clone, Copy)]
struct Carries([bool; ERROR_AXES]);

impl Carries {
    #[inline(always)]
    const fn of(config: &VolumetricConfig, along: u8) -> Self {
        let bit = 1 << along;
        Self([
            config.axes[0].arm & bit != 0,
            config.axes[1].arm & bit != 0,
            config.axes[2].arm & bit != 0,
        ])
    }
}

/// A sum of error functions at a position.
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

/// The error tables at a pose: the segments that were used last, so that a period loads only those
/// that it enters.
#[derive(Debug, Default)]
struct Tables {
    /// 2^50 divided by the node pitch of each axis.
    reciprocals: [u32; ERROR_AXES],
    /// Segment of each axis, and its number.
    segments: [Segment; ERROR_AXES],
    numbers: [u8; ERROR_AXES],
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
    tables: Tables,
    /// What the last period took away from each coordinate, axis units.
    correction: [i32; ERROR_AXES],
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
            tables: Tables::new(core::array::from_fn(|axis| {
                let pitch = i64::from(config.axes[axis].pitch.0.max(1));
                ((1_i64 << 50) / pitch).min(i64::from(i32::MAX)) as u32
            })),
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
        (self.fade, self.tables.reciprocals)
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
        self.correction = [0; ERROR_AXES];
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
        self.corrected = *commanded;
        for (axis, units) in self.correction.iter().enumerate() {
            let place = &mut self.corrected.pose.0[axis];
            *place = Coordinate(place.0.saturating_sub(*units));
        }
        let mut errors = self.tables.errors(config, &self.corrected);
        if self.faded < self.fade {
            self.weigh(&mut errors, period_us);
        }
        let corrected = &mut self.corrected;
        for (axis, error) in errors.iter().enumerate() {
            let units = error.units();
            self.correction[axis] = units;
            let place = commanded.pose.0[axis].0;
            corrected.pose.0[axis] = Coordinate(place.saturating_sub(units));
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
        let mut tables = Tables::new(self.tables.reciprocals);
        let mut command = PoseCommand::default();
        let slots = command.pose.0.iter_mut().zip(pose);
        slots.for_each(|(slot, value)| *slot = *value);
        let mut errors = tables.errors(config, &command);
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
}

impl Tables {
    fn new(reciprocals: [u32; ERROR_AXES]) -> Self {
        Self {
            reciprocals,
            segments: Default::default(),
            numbers: [u8::MAX; ERROR_AXES],
        }
    }

    /// Errors of x, y and z at a pose.
    // The image is built for size, which inlines no closure and unrolls no loop: the sums are
    // written out.
    #[inline(never)]
    fn errors(&mut self, config: &VolumetricConfig, at: &PoseCommand) -> [Error; ERROR_AXES] {
        let places = [
            self.place(config, 0, at),
            self.place(config, 1, at),
            self.place(config, 2, at),
        ];
        let [mut ex, mut ey, mut ez] = [
            Error::of(&self.translation(TX, &places)),
            Error::of(&self.translation(TY, &places)),
            Error::of(&self.translation(TZ, &places)),
        ];
        let [c0y, b0z, a0z] = config.squareness;
        // The vector product r x a, by the coordinates of the arm.
        let (arm, carries) = (Arm::of(at, 0), Carries::of(config, 0));
        ey.turn(&self.rotation(RZ, carries, 0, &places), &arm);
        ez.turn(&self.rotation(RY, carries, 0, &places), &arm.negative());
        let (arm, carries) = (Arm::of(at, 1), Carries::of(config, 1));
        ez.turn(&self.rotation(RX, carries, 0, &places), &arm);
        ex.turn(&self.rotation(RZ, carries, c0y, &places), &arm.negative());
        let (arm, carries) = (Arm::of(at, 2), Carries::of(config, 2));
        ex.turn(&self.rotation(RY, carries, b0z, &places), &arm);
        ey.turn(&self.rotation(RX, carries, a0z, &places), &arm.negative());
        [ex, ey, ez]
    }

    /// Position of an axis in its table. Loads the segment if it is another one.
    #[inline(never)]
    fn place(&mut self, config: &VolumetricConfig, axis: usize, at: &PoseCommand) -> Place {
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
        // Beyond its ends a table is constant.
        let (speed, gain) = if inside {
            let acceleration = at.accelerations[axis].0;
            let acceleration = acceleration.clamp(-ACCELERATION, ACCELERATION);
            (
                (product(at.rates[axis].0, reciprocal) >> 34) as i32,
                (product(acceleration, reciprocal) >> 34) as i32,
            )
        } else {
            (0, 0)
        };
        Place {
            part: (place & 0xFF_FFFF) as i32,
            speed,
            gain,
        }
    }

    /// Sum of a translation over the axes.
    #[inline(always)]
    fn translation(&self, function: usize, places: &[Place; ERROR_AXES]) -> Function {
        let mut sum = Sum::default();
        sum.add(&self.segments[0], function, &places[0]);
        sum.add(&self.segments[1], function, &places[1]);
        sum.add(&self.segments[2], function, &places[2]);
        Function {
            value: (sum.value << 4).wrapping_add((sum.position >> 20) as i32),
            rate: (sum.rate >> 12) as i32,
            acceleration: (sum.acceleration >> 12) as i32,
        }
    }

    /// Sum of a rotation over the axes that carry a coordinate, and of a constant one, nrad.
    #[inline(always)]
    fn rotation(
        &self,
        function: usize,
        carries: Carries,
        angle: i32,
        places: &[Place; ERROR_AXES],
    ) -> Function {
        let mut sum = Sum::default();
        if carries.0[0] {
            sum.add(&self.segments[0], function, &places[0]);
        }
        if carries.0[1] {
            sum.add(&self.segments[1], function, &places[1]);
        }
        if carries.0[2] {
            sum.add(&self.segments[2], function, &places[2]);
        }
        Function {
            value: (sum.value.wrapping_add(angle) << 8).wrapping_add((sum.position >> 16) as i32),
            // Two axes at 2048 mm/s with the steepest rotations exceed 32 bits.
            rate: saturate(sum.rate >> 8),
            acceleration: (sum.acceleration >> 8) as i32,
        }
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
    #[inline(always)]
    fn of(at: &PoseCommand, along: usize) -> Self {
        let acceleration = at.accelerations[along].0;
        Self {
            length: at.pose.0[along].0 >> 8,
            rate: at.rates[along].0 >> 8,
            acceleration: acceleration.clamp(-ACCELERATION, ACCELERATION),
        }
    }

    #[inline(always)]
    const fn negative(&self) -> Self {
        Self {
            length: self.length.wrapping_neg(),
            rate: self.rate.wrapping_neg(),
            acceleration: self.acceleration.wrapping_neg(),
        }
    }
}

impl Segment {
    /// The segment of an axis that begins at a node.
    #[inline(never)]
    fn of(config: &VolumetricConfig, axis: usize, number: u8) -> Self {
        let lower = node(config, axis, usize::from(number));
        let upper = node(config, axis, usize::from(number) + 1);
        Self {
            values: lower,
            slopes: core::array::from_fn(|index| upper[index].wrapping_sub(lower[index])),
        }
    }
}

/// The error functions of an axis at a node, in the units of [`Segment`]: t - r x m, with m the
/// carried coordinates of the point at which the axis was measured.
#[inline(never)]
fn node(config: &VolumetricConfig, axis: usize, number: usize) -> [i32; ERRORS] {
    let start = config.start(axis) + number * ERRORS;
    let mut values = core::array::from_fn(|index| {
        let value = config.values.get(start + index).copied();
        i32::from(value.unwrap_or_default()) << config.shift
    });
    let tables = &config.axes[axis];
    let carried = |along: usize| tables.arm >> along & 1 != 0;
    let [mx, my, mz] = [0, 1, 2].map(|along| {
        if carried(along) {
            tables.measured_at[along].0
        } else {
            0
        }
    });
    let [rx, ry, rz] = [values[RX], values[RY], values[RZ]];
    // 2^-20 pm to 2^-4 nm: 16 / 1000 of 2^32.
    let share = |sum: i64| (product(saturate(sum >> 20), 68_719_477) >> 32) as i32;
    let shares = [
        share(product(ry, mz).wrapping_sub(product(rz, my))),
        share(product(rz, mx).wrapping_sub(product(rx, mz))),
        share(product(rx, my).wrapping_sub(product(ry, mx))),
    ];
    for (value, share) in values.iter_mut().zip(shares) {
        *value = (*value << 4).wrapping_sub(share);
    }
    values
}

impl Error {
    /// The error of a translation alone.
    #[inline(always)]
    const fn of(translation: &Function) -> Self {
        Self {
            position: product(translation.value, TRANSLATION),
            rate: product(translation.rate, TRANSLATION),
            acceleration: product(translation.acceleration, TRANSLATION_ACCELERATION),
        }
    }

    /// Adds a rotation times a coordinate of its arm.
    #[inline(always)]
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
