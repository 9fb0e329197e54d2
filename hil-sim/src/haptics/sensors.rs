//! The nine encoders of the haptic arm and their faults.
//!
//! Each leg has one encoder on its slide d, one on its turn theta3 and one on its hinge theta4.
//! They are incremental and have no index. The counters are 0 at the position of the handle at
//! power-on, and the configuration of the controller must have that position (the rail, or a rest,
//! holds the handle there). All else is as for the encoders of the slides
//! ([`crate::joint::encoder`]): ideal discs; from the first fault on, edge-by-edge simulation
//! through the decoder of a board, which counts illegal transitions.
//!
//! Units: mm and radians at the joints, x4 counts at the controller. The model assumes a constant
//! rate of the joints within a control period.

use crate::check::Check;
use crate::joint::encoder::{Encoder, EncoderCondition, Track};
use crate::joint::mechanics::JointArray;
use crate::random::Random;
use haptimill_firmware::io::{LEGS, LegInputs};
use serde::{Deserialize, Serialize};

/// Number of encoders of a leg.
pub const SENSORS: usize = 3;

/// d (mm), theta3 and theta4 (rad) of each leg.
pub type Readings = [[f64; SENSORS]; LEGS];

/// Configuration of the encoders.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HapticEncoders {
    /// Counts per mm of a slide, after x4 decoding.
    pub slide_counts_per_mm: f64,
    /// Counts per turn of theta3, after x4 decoding, including the transmission.
    pub turn_counts_per_turn: f64,
    /// Counts per turn of theta4, after x4 decoding.
    pub hinge_counts_per_turn: f64,
    /// Encoders that count backwards: slide, turn and hinge of each leg.
    pub reversed: [[bool; SENSORS]; LEGS],
}

impl Default for HapticEncoders {
    /// 5 um on the slides; 160,000 counts per turn (5000 lines with a transmission of 1 to 8) are 5
    /// um at the ball joint.
    fn default() -> Self {
        Self {
            slide_counts_per_mm: 200.0,
            turn_counts_per_turn: 160_000.0,
            hinge_counts_per_turn: 160_000.0,
            reversed: [[false; SENSORS]; LEGS],
        }
    }
}

impl HapticEncoders {
    pub(super) fn check(&self, check: &mut Check) {
        for (name, value, min) in [
            ("slide_counts_per_mm", self.slide_counts_per_mm, 0.1),
            ("turn_counts_per_turn", self.turn_counts_per_turn, 100.0),
            ("hinge_counts_per_turn", self.hinge_counts_per_turn, 100.0),
        ] {
            check.within(format!("haptic: encoders: {name}"), value, min, 1e8);
        }
    }
}

/// All encoders of the arm.
#[derive(Debug, Clone)]
pub struct Sensors {
    encoders: [[Encoder; SENSORS]; LEGS],
    /// Joint positions at the end of the last period.
    last: Readings,
    period_ns: u64,
}

impl Sensors {
    /// Creates encoders whose counters are 0 at `start`.
    pub fn new(config: &HapticEncoders, start: &Readings, period_ns: u64, seed: u64) -> Self {
        let turn = core::f64::consts::TAU;
        let scales = [
            config.slide_counts_per_mm,
            config.turn_counts_per_turn / turn,
            config.hinge_counts_per_turn / turn,
        ];
        Self {
            encoders: core::array::from_fn(|leg| {
                core::array::from_fn(|sensor| {
                    let stream = 64 + (SENSORS * leg + sensor) as u64;
                    Encoder::without_index(
                        scales[sensor],
                        config.reversed[leg][sensor],
                        start[leg][sensor],
                        Random::new(seed, stream),
                    )
                })
            }),
            last: *start,
            period_ns,
        }
    }

    /// Follows the joints from their last positions to `now` within a period that starts at
    /// `time_ns`.
    pub fn follow(&mut self, now: &Readings, time_ns: u64) {
        for (encoders, (last, now)) in self.encoders.iter_mut().zip(self.last.iter().zip(now)) {
            let mut rows: [JointArray; 2] = Default::default();
            rows[0][..SENSORS].copy_from_slice(last);
            rows[1][..SENSORS].copy_from_slice(now);
            for (lane, encoder) in encoders.iter_mut().enumerate() {
                let (from, to) = (last[lane], now[lane]);
                let track = Track::new(&rows, lane, from.min(to), from.max(to));
                encoder.follow(&track, time_ns, self.period_ns);
            }
        }
        self.last = *now;
    }

    /// Inputs of a leg for the controller.
    pub fn leg(&self, leg: usize) -> LegInputs {
        let readings = [0, 1, 2].map(|sensor: usize| self.encoders[leg][sensor].reading());
        LegInputs {
            counts: readings.map(|reading| reading.counts),
            illegal: readings.map(|reading| reading.illegal),
        }
    }

    /// Sets the injected faults of an encoder.
    pub fn set_condition(&mut self, leg: usize, sensor: usize, condition: EncoderCondition) {
        self.encoders[leg][sensor].set_condition(condition);
    }

    /// Adds a slip of `counts` to a counter.
    pub fn slip(&mut self, leg: usize, sensor: usize, counts: i32) {
        self.encoders[leg][sensor].slip(counts);
    }
}
