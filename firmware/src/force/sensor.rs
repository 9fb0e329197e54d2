//! Conversion of the codes of a three-component sensor to the force on the tool, with validity
//! checks.
//!
//! The sensor is a quartz element under the workpiece with a charge amplifier and a 14-bit
//! converter (docs/control.md 1.2, 7.1 items 24-26). It measures the force of the tool on the
//! workpiece. All other modules use the reaction on the tool (docs/control.md 1.3), so a channel
//! usually has a negative scale.
//!
//! | check | condition | reason for its limit |
//! | --- | --- | --- |
//! | silent | no new conversion for `silent_samples` periods | see **Silent** |
//! | overload | amplifier signal, or 3 codes in a row beyond `saturation` | see **Overload** |
//! | stuck | the same code `stuck_samples` times in a row | see **Stuck** |
//! | drift | the mean force of the unloaded tool is beyond `drift` | see **Drift** |
//! | limit | a force beyond `limit`, not saturated | see **Limit** |
//!
//! **Silent.** Conversions are counted, so that an old value cannot pass for a new one.
//!
//! **Overload.** Beyond 95 % of the range the peak is unknown. A single sample may be a spark.
//!
//! **Drift.** Charge leaks, and the zero of an amplifier wanders. Cutting hides drift, so only the
//! unloaded tool is checked.
//!
//! **Limit.** Beyond it tool, workpiece or sensor are at risk: the spindle is stopped, or the feed
//! is wrong.
//!
//! **Stuck.** A converter behind a quartz element and a charge amplifier has noise. With a standard
//! deviation of s codes, a code repeats with a probability of at most erf(1 / (2 sqrt 2 s)),
//! reached when the signal is in the middle of a code: 0.90 for s = 0.3. 500 repetitions (0.1 s at
//! 200 us) then have a probability of 1e-22, less than once in the life of the machine (1e13
//! samples per century and channel). Noise below 0.25 codes (0.954; 500 times: 6e-11, once in 40
//! days) needs more samples or dither. 0 disables the check, for a sensor without noise.
//!
//! **Tare.** The mean of `tare_samples` becomes the zero. A tare is refused if the codes vary by
//! more than `tare_spread` (the spindle runs, the machine moves, a person touches the table), if a
//! channel with noise does not vary (it is stuck), near saturation, and if samples are missing. The
//! weight of the vise turns with the workpiece. [`Conditioner::set_rotation`] subtracts the change
//! of its share since the tare.
//!
//! Codes are clamped to 14 bits and scales are limited to 0.5 N per code, so a force is below 2^15
//! codes * 0.5 N: no input overflows.

use crate::digest::impl_digest;
use haptimill_math::force::Force;
use haptimill_math::scale::{multiply_shift, saturate};
use haptimill_math::trig::{ONE, sin_cos};
use haptimill_math::{Angle, scale};
use serde::{Deserialize, Serialize};

pub use crate::io::{COMPONENTS, ForceSample};
pub use haptimill_protocol::force::{ForceProblem, TareRefusal};

/// Largest code of a 14-bit converter.
pub const CODE_MAX: i16 = 8191;

/// Consecutive samples beyond saturation that are an overload.
const OVERLOAD_SAMPLES: u8 = 3;

/// Time constant of the mean of the drift check: 2^9 samples (0.1 s at 200 us).
const DRIFT_SHIFT: u32 = 9;

/// One channel of the sensor.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Channel {
    /// Force on the tool per code, 2^-32 N, up to 0.5 N; negative if a positive code is a push of
    /// the tool on the workpiece. 10 N/V at 1.2207 mV per code: 52,428,800.
    pub per_code: i32,
    /// Codes of this magnitude or more are saturated: 7782 is 95 %.
    pub saturation: i16,
}

/// Sensor settings and the limits of its checks.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ForceSensor {
    /// x, y, z in workpiece coordinates.
    pub channels: [Channel; COMPONENTS],
    /// Largest accepted number of control periods without a new sample.
    pub silent_samples: u16,
    /// Consecutive equal codes that are a stuck channel; 0 disables the check.
    pub stuck_samples: u16,
    /// Largest mean force of the unloaded tool.
    pub drift: Force,
    /// Largest force.
    pub limit: Force,
    /// Number of samples of a tare, 16 to 32768.
    pub tare_samples: u16,
    /// Largest accepted spread of the codes during a tare, highest minus lowest.
    pub tare_spread: u16,
    /// Weight on the sensor that turns with the workpiece; 0 if none does.
    pub weight: Force,
}

impl ForceSensor {
    /// Whether the settings are consistent.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.channels.iter().all(|channel| {
            channel.per_code != 0
                && channel.per_code.unsigned_abs() <= 1 << 31
                && channel.per_code != i32::MIN
                && (64..=CODE_MAX).contains(&channel.saturation)
        }) && self.silent_samples >= 1
            && self.drift.0 > 0
            && self.limit.0 > 0
            && self.limit <= Force::MAX
            && (16..=32_768).contains(&self.tare_samples)
            && self.tare_spread >= 1
            && self.weight.0 >= 0
            && self.weight <= Force::MAX
    }

    /// Largest force that a channel can measure.
    #[must_use]
    pub fn range(&self, component: usize) -> Force {
        self.channels.get(component).map_or(Force::ZERO, |channel| {
            let raw = multiply_shift(channel.per_code, i32::from(channel.saturation), 16);
            Force(saturate(raw.abs())).held()
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Tare {
    left: u16,
    sums: [i32; COMPONENTS],
    lows: [i16; COMPONENTS],
    highs: [i16; COMPONENTS],
}

/// State of one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Memory {
    /// Zero, in codes with 8 more bits.
    zero: i32,
    code: i16,
    repeated: u16,
    saturated: u8,
    /// Mean force of the unloaded tool, with [`DRIFT_SHIFT`] more bits.
    mean: i64,
}

/// Whether a problem is an excessive force rather than a broken sensor. A saturated channel may be
/// either and counts as a force.
#[must_use]
pub const fn is_force(problem: &ForceProblem) -> bool {
    matches!(
        problem,
        ForceProblem::Limit { .. } | ForceProblem::Overload { .. }
    )
}

/// Conversion and checks of the sensor's samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conditioner {
    sensor: ForceSensor,
    memories: [Memory; COMPONENTS],
    forces: [Force; COMPONENTS],
    /// Share of the weight now, minus its share at the tare.
    weight: [Force; COMPONENTS],
    rotation: [Angle; 2],
    /// Direction upwards in the frame of the sensor at the tare, Q30.
    tared_at: [i32; COMPONENTS],
    tared: bool,
    conversions: u8,
    silent: u16,
    tare: Option<Tare>,
    last_tare: Option<Result<(), TareRefusal>>,
}

impl_digest!(Conditioner { fields { sensor }, nested {}, skip { memories, forces, weight, rotation, tared_at, tared, conversions, silent, tare, last_tare } });

impl Conditioner {
    /// Creates the conditioner of a sound sensor, without a tare.
    #[must_use]
    pub fn new(sensor: &ForceSensor) -> Self {
        Self {
            sensor: sensor.clone(),
            memories: [Memory::default(); COMPONENTS],
            forces: [Force::ZERO; COMPONENTS],
            weight: [Force::ZERO; COMPONENTS],
            rotation: [Angle::ZERO; 2],
            tared_at: [0, 0, ONE],
            tared: false,
            conversions: 0,
            silent: 0,
            tare: None,
            last_tare: None,
        }
    }

    /// The sensor.
    #[must_use]
    pub const fn sensor(&self) -> &ForceSensor {
        &self.sensor
    }

    /// Force on the tool, clamped to [`Force::MAX`].
    #[must_use]
    pub const fn forces(&self) -> &[Force; COMPONENTS] {
        &self.forces
    }

    /// Whether a tare succeeded.
    #[must_use]
    pub const fn tared(&self) -> bool {
        self.tared
    }

    /// Begins a tare; it ends after `tare_samples`, see [`Conditioner::tare_result`].
    pub fn begin_tare(&mut self) {
        self.last_tare = None;
        self.tare = Some(Tare {
            left: self.sensor.tare_samples,
            sums: [0; COMPONENTS],
            lows: [i16::MAX; COMPONENTS],
            highs: [i16::MIN; COMPONENTS],
        });
    }

    /// Cancels a running tare because the machine moves; the zero does not change.
    #[inline]
    pub fn interrupt_tare(&mut self) {
        self.end_tare(Err(TareRefusal::Interrupted));
    }

    /// Whether a tare runs.
    #[must_use]
    pub const fn taring(&self) -> bool {
        self.tare.is_some()
    }

    /// Takes the result of the last tare.
    #[inline]
    pub const fn take_tare_result(&mut self) -> Option<Result<(), TareRefusal>> {
        self.last_tare.take()
    }

    /// Result of the last tare; `None` during a tare and before the first.
    #[must_use]
    pub const fn tare_result(&self) -> Option<Result<(), TareRefusal>> {
        self.last_tare
    }

    /// Sets the rotation of the sensor for the share of the weight: tilt about x (docs/control.md
    /// (3.15)-(3.16)), then turn about the normal of the table. The share is the weight along the
    /// direction upwards, as a reaction on the tool would appear. It computes sines, so callers may
    /// call it once in some control periods.
    #[inline]
    pub fn set_rotation(&mut self, angles: [Angle; 2]) {
        if self.sensor.weight.0 == 0 || angles == self.rotation {
            return;
        }
        self.rotation = angles;
        self.update_effective_zero();
    }

    /// Direction upwards in the frame of the sensor, Q30.
    fn upwards(&self) -> [i32; COMPONENTS] {
        let [tilt, turn] = self.rotation;
        let (sine, cosine) = sin_cos(tilt);
        if turn == Angle::ZERO {
            return [0, sine, cosine];
        }
        let (across, along) = sin_cos(turn);
        let part = |factor| saturate(multiply_shift(sine, factor, 30));
        [part(across), part(along), cosine]
    }

    #[inline(never)]
    fn update_effective_zero(&mut self) {
        let now = self.upwards();
        for (component, share) in self.weight.iter_mut().enumerate() {
            // Q30, differences within 2^31.
            let then = i64::from(self.tared_at[component]);
            let difference = saturate(i64::from(now[component]) - then);
            *share = Force(saturate(multiply_shift(
                self.sensor.weight.0,
                difference,
                30,
            )));
        }
    }

    /// Processes the sample of a control period; `unloaded` states that nothing touches the tool,
    /// as far as the controller knows. Returns the problem that ends force control.
    #[inline]
    pub fn take(&mut self, sample: &ForceSample, unloaded: bool) -> Option<ForceProblem> {
        if sample.conversions == self.conversions {
            self.silent = self.silent.saturating_add(1);
            if self.silent > self.sensor.silent_samples {
                self.end_tare(Err(TareRefusal::Silent));
                return Some(ForceProblem::Silent);
            }
            return None;
        }
        self.conversions = sample.conversions;
        self.silent = 0;
        let mut found = sample.overload.then_some(ForceProblem::Overload {
            component: COMPONENTS as u8,
        });
        for component in 0..COMPONENTS {
            let code = sample.codes[component].clamp(-CODE_MAX - 1, CODE_MAX);
            let problem = self.check_component(component, code, unloaded);
            // An excessive force stops the machine even without force control, so it has priority.
            let graver =
                !found.as_ref().is_some_and(is_force) && problem.as_ref().is_some_and(is_force);
            found = if graver { problem } else { found.or(problem) };
        }
        if self.tare.is_some() {
            self.accumulate_tare(&sample.codes);
        }
        found
    }

    #[inline]
    fn check_component(
        &mut self,
        component: usize,
        code: i16,
        unloaded: bool,
    ) -> Option<ForceProblem> {
        let name = component as u8;
        let channel = &self.sensor.channels[component];
        let memory = &mut self.memories[component];
        memory.repeated = if code == memory.code {
            memory.repeated.saturating_add(1)
        } else {
            0
        };
        memory.code = code;
        memory.saturated = if code.unsigned_abs() >= channel.saturation.unsigned_abs() {
            memory.saturated.saturating_add(1)
        } else {
            0
        };
        // Below 2^23 and 2^31; in 2^-40 N, to 2^-16 N.
        let off = (i32::from(code) << 8).wrapping_sub(memory.zero);
        // Below 2^53 >> 24 and 2^28: words.
        let force = (multiply_shift(off, channel.per_code, 24) as i32)
            .wrapping_sub(self.weight[component].0);
        let force = Force(force).held();
        self.forces[component] = force;
        let drifted = if unloaded && self.tared {
            memory.mean += i64::from(force.0) - (memory.mean >> DRIFT_SHIFT);
            Force((memory.mean >> DRIFT_SHIFT) as i32)
        } else {
            memory.mean = 0;
            Force::ZERO
        };
        if memory.saturated >= OVERLOAD_SAMPLES {
            Some(ForceProblem::Overload { component: name })
        } else if self.sensor.stuck_samples > 0 && memory.repeated >= self.sensor.stuck_samples {
            Some(ForceProblem::Stuck { component: name })
        } else if memory.saturated == 0 && force.magnitude() > self.sensor.limit.magnitude() {
            // Also before the first tare: the zero is then that of the amplifier.
            Some(ForceProblem::Limit {
                component: name,
                force: force.0,
            })
        } else if drifted.magnitude() > self.sensor.drift.magnitude() {
            Some(ForceProblem::Drift {
                component: name,
                force: drifted.0,
            })
        } else {
            None
        }
    }

    #[inline(never)]
    fn accumulate_tare(&mut self, codes: &[i16; COMPONENTS]) {
        let Some(tare) = &mut self.tare else {
            return;
        };
        for (component, code) in codes.iter().enumerate() {
            let code = (*code).clamp(-CODE_MAX - 1, CODE_MAX);
            // At most 32768 samples of 2^13: 2^28.
            tare.sums[component] += i32::from(code);
            tare.lows[component] = tare.lows[component].min(code);
            tare.highs[component] = tare.highs[component].max(code);
        }
        tare.left = tare.left.saturating_sub(1);
        if tare.left == 0 {
            let result = self.judge_tare();
            self.end_tare(result);
        }
    }

    fn judge_tare(&mut self) -> Result<(), TareRefusal> {
        let Some(tare) = self.tare else {
            return Err(TareRefusal::Silent);
        };
        let samples = i64::from(self.sensor.tare_samples.max(1));
        let mut zeros = [0; COMPONENTS];
        for (component, zero) in zeros.iter_mut().enumerate() {
            let name = component as u8;
            // Within 16 bits.
            let spread = i32::from(tare.highs[component]) - i32::from(tare.lows[component]);
            if spread > i32::from(self.sensor.tare_spread) {
                return Err(TareRefusal::Moving {
                    component: name,
                    spread: spread as u16,
                });
            }
            if spread == 0 && self.sensor.stuck_samples > 0 {
                return Err(TareRefusal::Stuck { component: name });
            }
            let mean = ((i64::from(tare.sums[component]) << 8) + samples / 2).div_euclid(samples);
            *zero = scale::saturate(mean);
            let half = i32::from(self.sensor.channels[component].saturation) << 7;
            if zero.unsigned_abs() > half.unsigned_abs() {
                return Err(TareRefusal::Offset { component: name });
            }
        }
        for (memory, zero) in self.memories.iter_mut().zip(zeros) {
            memory.zero = zero;
            memory.mean = 0;
        }
        self.tared = true;
        self.tared_at = self.upwards();
        self.update_effective_zero();
        Ok(())
    }

    /// Stores the result; a refused tare keeps the previous zero.
    #[inline]
    fn end_tare(&mut self, result: Result<(), TareRefusal>) {
        if self.tare.take().is_some() {
            self.last_tare = Some(result);
        }
    }
}
