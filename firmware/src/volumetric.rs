//! Volumetric compensation: the commanded pose is moved by the known geometric errors of the
//! machine, so that the tool reaches its programmed position.
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
//! Delta = sum of t_k(q_k) + sum of r_k(q_k) x a_k + (b0z z - c0y y, -a0z z, 0)
//! ```
//!
//! The arm a_k has those coordinates of the tool that lie between the carriage k and the tool, from
//! the point at which the axis was measured. The rate of the correction is its change from the
//! period before, and the acceleration is the change of that rate: both include the fade, and both
//! fit the positions at a node, where the slope changes. They are half a period and a period late.
//! A rate that changes by 3 m/s^2 times the steepest slope, 0.001, is 0.3 um/s off at 200 us.
//!
//! | quantity | unit | bound |
//! | --- | --- | --- |
//! | value of a translation, a rotation at a node | 2^shift nm, nrad | 2^15 |
//! | the same between nodes | 2^(shift - 14) nm, nrad | 2^29 |
//! | arm | 2^-18 mm | 2^30 |
//! | sum of translations and of rotations times arms | 2^(shift - 32) pm | 2^62 |
//! | correction | 2^-8 pm | 2^43 |
//! | its change in a period | 2^-8 pm | 2^31, 8.4 um |
//! | the change of that | 2^-8 pm | 2^28, 1.0 um |
//! | position in a segment | 2^-31 | 2^31 |
//!
//! With these bounds no sum overflows, so none is checked. The change in a period is the difference
//! of the lower 32 bits: the bound is 40 times what the steepest tables give at 1 m/s.

use crate::config::volumetric::{CORRECTION, ERROR_AXES, ERRORS, ErrorAxis, VolumetricConfig};
use crate::motion::PoseCommand;
use haptimill_math::{Acceleration, Coordinate, Rate};

/// Time of a fade from 0 to 1, microseconds.
const FADE_US: u32 = 1_000_000;

/// The fade is a fraction of 2^30.
const ONE: u32 = 1 << 30;

/// Axis units per pm, 2^-32: 2^20 per mm.
const UNITS_PER_PM: i64 = 4_503_600;

/// One unit of a translation in units of the sum.
const TRANSLATION: i32 = 1000 << 18;

/// Largest part of a segment, 2^-31.
const MAX_PART: i32 = i32::MAX;

/// Correction of a coordinate in one period.
#[derive(Debug, Clone, Copy, Default)]
struct Correction {
    /// Axis units.
    units: i32,
    /// The lower 32 bits of the correction in 2^-8 pm.
    fine: i32,
    /// Change from the period before, 2^-8 pm.
    change: i32,
}

/// State of volumetric compensation.
#[derive(Debug, Default)]
pub struct Compensation {
    /// Requested by the host.
    requested: bool,
    /// Periods of the fade so far, and of a whole fade.
    faded: u32,
    fade: u32,
    constants: Constants,
    /// Corrections of this period and of the one before.
    corrections: [Correction; ERROR_AXES],
    before: [Correction; ERROR_AXES],
    /// The corrected pose of this period.
    corrected: PoseCommand,
}

/// Compensation allowed in a state of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fade {
    /// Compensation may be in effect.
    In,
    /// The position is not known: no compensation.
    Out,
    /// Nothing may move: the part of the correction in effect stays.
    Frozen,
}

/// Values derived from the configuration.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Constants {
    axes: [AxisConstants; ERROR_AXES],
    /// Axis units per second in a change of 2^-8 pm per period, 2^-32.
    rate: i32,
    /// Units of an acceleration in a change of 2^-8 pm per period squared, 2^-24.
    acceleration: i32,
    /// 2^30 divided by the periods of a whole fade.
    fade: u32,
    /// Binary places between a sum of the tables and 2^-8 pm.
    scale: u32,
}

/// The constants of one axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
struct AxisConstants {
    /// Position of the first node.
    first: i32,
    /// Largest distance from it within the last segment.
    max: i32,
    /// 2^50 divided by the node pitch.
    reciprocal: i32,
    /// Its first value.
    start: usize,
    /// The arm of its rotations.
    arm: [Arm; ERROR_AXES],
}

/// A coordinate of the arm of the rotations of an axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
struct Arm {
    /// All bits where the arm has this coordinate, otherwise 0.
    mask: i32,
    /// Its zero, 2^-18 mm.
    zero: i32,
}

impl Arm {
    fn new(tables: &ErrorAxis, along: usize) -> Self {
        let mask = -i32::from(tables.arm >> along & 1);
        let zero = tables.measured_at[along].0 >> 2 & mask;
        Self { mask, zero }
    }

    /// The arm with the tool at `at`, 2^-18 mm.
    #[inline(always)]
    const fn of(self, at: i32) -> i32 {
        (at & self.mask).wrapping_sub(self.zero)
    }
}

impl Constants {
    #[cold]
    #[inline(never)]
    fn new(config: &VolumetricConfig, period_us: u16, fade: u32) -> Self {
        let bounded = |value: i64| value.min(i64::from(i32::MAX)) as i32;
        let frequency = 1_000_000 / i64::from(period_us.max(1));
        Self {
            axes: core::array::from_fn(|axis| {
                let tables = &config.axes[axis];
                let spans = i64::from(tables.nodes.max(2)) - 1;
                AxisConstants {
                    first: tables.first.0,
                    max: bounded(spans * i64::from(tables.pitch.0) - 1),
                    reciprocal: bounded((1_i64 << 50) / i64::from(tables.pitch.0.max(1))),
                    start: config.start(axis),
                    arm: core::array::from_fn(|along| Arm::new(tables, along)),
                }
            }),
            rate: bounded((UNITS_PER_PM * frequency) >> 8),
            acceleration: bounded((UNITS_PER_PM * frequency * frequency) >> 24),
            fade: ONE / fade,
            scale: 24 - u32::from(config.shift.min(23)),
        }
    }
}

impl Compensation {
    /// Compensation that is off until it may fade in.
    #[must_use]
    #[cold]
    #[inline(never)]
    pub fn new(config: &VolumetricConfig, period_us: u16) -> Self {
        let fade = (FADE_US / u32::from(period_us.max(1))).max(1);
        Self {
            requested: true,
            fade,
            constants: Constants::new(config, period_us, fade),
            ..Self::default()
        }
    }

    /// Requests compensation, or none. It fades.
    pub const fn request(&mut self, requested: bool) {
        self.requested = requested;
    }

    /// Whether the host requests compensation.
    #[must_use]
    pub const fn is_requested(&self) -> bool {
        self.requested
    }

    /// Constants, for the integrity check.
    #[must_use]
    pub const fn constants(&self) -> (u32, Constants) {
        (self.fade, self.constants)
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
        if self.is_complete() {
            return 100;
        }
        let part = self.faded.wrapping_mul(self.constants.fade);
        let percent = (part >> 7).wrapping_mul(100).wrapping_add(1 << 22) >> 23;
        if percent < 100 { percent as u8 } else { 99 }
    }

    /// Switches the correction off without a fade. Callers must make the corrected pose the
    /// commanded one, or have the drives off.
    pub const fn reset(&mut self) {
        self.faded = 0;
        self.corrections = [Correction::NONE; ERROR_AXES];
    }

    /// Begins a period: one period of the fade. Compensation that the host does not request fades
    /// out where it may fade in.
    #[inline]
    pub const fn advance(&mut self, fade: Fade) {
        self.before = self.corrections;
        match fade {
            Fade::In if self.requested => {
                if self.faded < self.fade {
                    self.faded += 1;
                }
            }
            Fade::In | Fade::Out => self.faded = self.faded.saturating_sub(1),
            Fade::Frozen => {}
        }
    }

    /// The corrected pose of this period, with its rates and accelerations. Another pose in the
    /// same period replaces the first one.
    #[inline(never)]
    pub fn correct(&mut self, config: &VolumetricConfig, commanded: &PoseCommand) -> &PoseCommand {
        let corrected = &mut self.corrected;
        // Field by field: a copy of the whole is a call.
        corrected.pose = commanded.pose;
        corrected.rates = commanded.rates;
        corrected.accelerations = commanded.accelerations;
        let [x, y, z, ..] = &mut corrected.pose.0;
        x.0 = x.0.saturating_sub(self.before[0].units);
        y.0 = y.0.saturating_sub(self.before[1].units);
        z.0 = z.0.saturating_sub(self.before[2].units);
        let [x, y, z] = self.errors(config, &self.corrected.pose.0);
        self.take(0, x, commanded);
        self.take(1, y, commanded);
        self.take(2, z, commanded);
        &self.corrected
    }

    /// Takes the error of an axis, 2^-8 pm, away from its commanded position, rate and
    /// acceleration.
    #[inline(always)]
    fn take(&mut self, axis: usize, error: i64, commanded: &PoseCommand) {
        let (before, corrected) = (&self.before[axis], &mut self.corrected);
        let (fine, units) = (error as i32, units(error));
        let change = fine.wrapping_sub(before.fine);
        self.corrections[axis] = Correction {
            units,
            fine,
            change,
        };
        let at = commanded.pose.0[axis].0;
        corrected.pose.0[axis] = Coordinate(at.saturating_sub(units));
        let rate = upper(change, self.constants.rate);
        corrected.rates[axis] = corrected.rates[axis].saturating_sub(Rate(rate));
        let change = change.wrapping_sub(before.change);
        let acceleration = (product(change, self.constants.acceleration) >> 24) as i32;
        let own = &mut corrected.accelerations[axis];
        *own = own.saturating_sub(Acceleration(acceleration));
    }

    /// What [`correct`](Self::correct) took away last, axis units. A measured pose is off the
    /// corrected one by the following error; the error there differs by that times the slope of the
    /// errors: 1 um per mm for the steepest translations. To evaluate the tables there would double
    /// the cost of a period.
    #[must_use]
    #[inline]
    pub fn taken(&self) -> [i32; ERROR_AXES] {
        self.corrections.map(|correction| correction.units)
    }

    /// Errors at a pose with the fade, 2^-8 pm.
    #[inline(always)]
    fn errors(&self, config: &VolumetricConfig, pose: &[Coordinate]) -> [i64; ERROR_AXES] {
        let mut errors = self.constants.errors(config, pose);
        if self.faded < self.fade {
            let weight = self.weight();
            for error in &mut errors {
                // In two parts, as the whole product has more than 64 bits.
                let lower = u64::from(*error as u32).wrapping_mul(u64::from(weight)) >> 30;
                let upper = product((*error >> 32) as i32, weight as i32) << 2;
                *error = upper.wrapping_add(lower as i64);
            }
        }
        errors
    }

    /// Weight of the errors in the fade, 2^-30: 3 s^2 - 2 s^3, which begins and ends with rate
    /// zero.
    #[inline(always)]
    const fn weight(&self) -> u32 {
        let part = self.faded.wrapping_mul(self.constants.fade) as i32;
        let square = (product(part, part) >> 30) as i32;
        let cube = (product(square, part) >> 30) as i32;
        square.wrapping_mul(3).wrapping_sub(cube.wrapping_mul(2)) as u32
    }
}

impl Correction {
    const NONE: Self = Self {
        units: 0,
        fine: 0,
        change: 0,
    };
}

impl Constants {
    /// Errors of x, y and z at a pose, 2^-8 pm.
    #[inline(never)]
    fn errors(&self, config: &VolumetricConfig, pose: &[Coordinate]) -> [i64; ERROR_AXES] {
        let Some(&[Coordinate(x), Coordinate(y), Coordinate(z)]) = pose.first_chunk() else {
            return [0; ERROR_AXES];
        };
        let at = [x >> 2, y >> 2, z >> 2];
        let [for_x, for_y, for_z] = &self.axes;
        let sums = for_x.errors(config, x, at, [0; ERROR_AXES]);
        let sums = for_y.errors(config, y, at, sums);
        let [ex, ey, ez] = for_z.errors(config, z, at, sums);
        let [c0y, b0z, a0z] = config.squareness;
        let square = product(b0z, at[2]).wrapping_sub(product(c0y, at[1]));
        // The mask tells the compiler that a shift stays within a word.
        let fine = |sum: i64| sum >> (self.scale & 31);
        [
            fine(ex).wrapping_add(square >> 10),
            fine(ey).wrapping_sub(product(a0z, at[2]) >> 10),
            fine(ez),
        ]
    }
}

impl AxisConstants {
    /// Adds the errors of one axis at a position to sums.
    #[inline(always)]
    fn errors(
        &self,
        config: &VolumetricConfig,
        position: i32,
        at: [i32; ERROR_AXES],
        [ex, ey, ez]: [i64; ERROR_AXES],
    ) -> [i64; ERROR_AXES] {
        // Beyond its ends a table is constant.
        let from = position.saturating_sub(self.first);
        let place = product(from.max(0).min(self.max), self.reciprocal);
        let (number, part) = ((place >> 50) as usize, (place >> 19) as i32 & MAX_PART);
        let node = self.start.wrapping_add(number.wrapping_mul(ERRORS));
        let values = config.values.get(node..node.wrapping_add(2 * ERRORS));
        let Some(values) = values.and_then(|values| values.first_chunk()) else {
            return [ex, ey, ez];
        };
        let [tx, ty, tz, rx, ry, rz] = [
            between(values, 0, part),
            between(values, 1, part),
            between(values, 2, part),
            between(values, 3, part),
            between(values, 4, part),
            between(values, 5, part),
        ];
        let [ax, ay, az] = [
            self.arm[0].of(at[0]),
            self.arm[1].of(at[1]),
            self.arm[2].of(at[2]),
        ];
        // A sum of products is one instruction each; a difference is three.
        let (minus_x, minus_y, minus_z) = (ax.wrapping_neg(), ay.wrapping_neg(), az.wrapping_neg());
        let sum = |to: i64, t, a, arm, b, other| {
            to.wrapping_add(product(t, TRANSLATION))
                .wrapping_add(product(a, arm))
                .wrapping_add(product(b, other))
        };
        [
            sum(ex, tx, ry, az, rz, minus_y),
            sum(ey, ty, rz, ax, rx, minus_z),
            sum(ez, tz, rx, ay, ry, minus_x),
        ]
    }
}

/// An error function between two nodes, in 2^-14 of the unit of its values. The difference of two
/// values is below 2^16: 2^15 times it fits.
#[inline(always)]
fn between(values: &[i16; 2 * ERRORS], function: usize, part: i32) -> i32 {
    let low = i32::from(values[function]);
    let high = i32::from(values[function + ERRORS]);
    (low << 14).wrapping_add(upper((high - low) << 15, part))
}

/// Product of two numbers.
#[inline(always)]
const fn product(a: i32, b: i32) -> i64 {
    (a as i64).wrapping_mul(b as i64)
}

/// The upper 32 bits of a product.
#[inline(always)]
const fn upper(a: i32, b: i32) -> i32 {
    (product(a, b) >> 32) as i32
}

/// A correction of 2^-8 pm in axis units, within the largest correction.
#[inline(always)]
fn units(fine: i64) -> i32 {
    let units = upper((fine >> 12) as i32, 16 * UNITS_PER_PM as i32);
    units.clamp(-CORRECTION, CORRECTION)
}
