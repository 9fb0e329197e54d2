//! A recording as measurements are taken from it: where the tool was and what it felt, in mm, N and s.

use haptimill_trace::{Record, Recording, RecordingError, flag};
use serde::Serialize;
use std::collections::VecDeque;

/// Samples a second: the rate at which the thesis recorded.
const SAMPLES: f64 = 1000.0;

/// Raw force units in a newton, and units of length in a millimetre.
const NEWTON: f64 = 65_536.0;
const MM: f64 = (1 << 20) as f64;

/// Spindle speed when the recording does not tell, rev/min.
const RPM: f64 = 5000.0;

/// Where "high" and "low" forces are from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceSource {
    /// The controller's: sensor, conditioning, extremes over a revolution.
    Controller,
    /// The true force of the simulated cut, its extremes over a revolution: this controller has no force sensing.
    TrueForce,
}

impl ForceSource {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Controller => "measured by the controller",
            Self::TrueForce => {
                "true force of the simulated cut over a revolution, not measured by the controller"
            }
        }
    }
}

/// One moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sample {
    /// Seconds since the way began: the first motion along x or y of the program. Negative while the tool plunges.
    pub time: f64,
    /// Desired place, mm: the programmed one, and along axes that a hand led the one that it led to.
    pub desired: [f64; 3],
    /// Where the tool really was, mm.
    pub tool: [f64; 3],
    /// The program moves along this axis.
    pub moves: [bool; 3],
    /// Force of largest magnitude in the last revolution, N, on the tool, sign kept.
    pub high: [f64; 3],
    /// The opposite end of what it was in that revolution, N.
    pub low: [f64; 3],
    /// p_c, mm.
    pub yielded: [f64; 3],
    /// Integral of `high` along x over time since the start, N s.
    pub impulse: f64,
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    /// Where the forces are from.
    pub source: ForceSource,
    /// The moments, in order.
    pub samples: Vec<Sample>,
}

/// The last revolution of the true force.
struct Revolution {
    samples: usize,
    last: VecDeque<[f64; 3]>,
}

impl Revolution {
    fn take(&mut self, force: [f64; 3]) {
        if self.last.len() == self.samples {
            self.last.pop_front();
        }
        self.last.push_back(force);
    }

    /// High and low, as the controller defines them.
    fn extremes(&self) -> ([f64; 3], [f64; 3]) {
        let (mut high, mut low) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let values = self.last.iter().map(|force| force[axis]);
            let (least, most) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), v| {
                (l.min(v), m.max(v))
            });
            (high[axis], low[axis]) = if most.abs() >= least.abs() {
                (most, least)
            } else {
                (least, most)
            };
        }
        (high, low)
    }
}

impl Course {
    /// Reads a recording of a way that a hand led along some axes, or none.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn of(recording: &Recording, led: &[u8]) -> Result<Self, RecordingError> {
        let source = match recording.config().force {
            Some(_) => ForceSource::Controller,
            None => ForceSource::TrueForce,
        };
        let period_s = recording.period_s();
        let every = (1.0 / (SAMPLES * period_s)).round().max(1.0) as u64;
        let mut revolution = Revolution {
            samples: (60.0 / RPM / period_s).round().max(1.0) as usize,
            last: VecDeque::new(),
        };
        let mut samples = Vec::new();
        let mut impulse = 0.0;
        let mut before: Option<[i32; 3]> = None;
        let mut begun = None;
        for (index, record) in (0_u64..).zip(recording.iter()?) {
            let record = record?;
            let newtons = |raw: [i32; 3]| raw.map(|value| f64::from(value) / NEWTON);
            if source == ForceSource::TrueForce {
                revolution.take(newtons(record.true_force));
            } else {
                impulse += f64::from(record.force.high[0]) / NEWTON * period_s;
            }
            if !record.has(flag::PROGRAMMED) || index % every != 0 {
                continue;
            }
            let programmed = std::array::from_fn(|axis| record.programmed[axis]);
            let last = before.replace(programmed).unwrap_or(programmed);
            let moves: [bool; 3] = std::array::from_fn(|axis| programmed[axis] != last[axis]);
            let time = index as f64 * period_s;
            if moves[0] || moves[1] {
                begun.get_or_insert(time);
            }
            let (high, low) = match source {
                ForceSource::Controller => (newtons(record.force.high), newtons(record.force.low)),
                ForceSource::TrueForce => revolution.extremes(),
            };
            let mut sample = sample(&record, time, moves, (high, low), impulse);
            for axis in led.iter().map(|axis| usize::from(*axis)) {
                sample.desired[axis] = f64::from(record.commanded[axis]) / MM;
            }
            samples.push(sample);
        }
        let begun = begun.unwrap_or(0.0);
        for sample in &mut samples {
            sample.time -= begun;
        }
        Ok(Self { source, samples })
    }

    /// The samples of a span of time, s since the way began.
    #[must_use]
    pub fn between(&self, from: f64, to: f64) -> &[Sample] {
        let first = self.samples.partition_point(|sample| sample.time < from);
        let last = self.samples.partition_point(|sample| sample.time < to);
        &self.samples[first..last.max(first)]
    }

    /// The sample at a time; the nearest there is.
    #[must_use]
    pub fn at(&self, time: f64) -> Sample {
        let index = self.samples.partition_point(|sample| sample.time < time);
        let last = self.samples.len().saturating_sub(1);
        self.samples
            .get(index.min(last))
            .copied()
            .unwrap_or_default()
    }

    /// The samples in which the program moves along x or y in the material: from the start of the way until the tool is lifted.
    #[must_use]
    pub fn way(&self) -> Vec<Sample> {
        let begins = self.samples.partition_point(|sample| sample.time < 0.0);
        let depth = self.at(0.0).desired[2] + 0.01;
        self.samples[begins..]
            .iter()
            .take_while(|sample| sample.desired[2] < depth)
            .filter(|sample| sample.moves[0] || sample.moves[1])
            .copied()
            .collect()
    }
}

fn sample(
    record: &Record,
    time: f64,
    moves: [bool; 3],
    (high, low): ([f64; 3], [f64; 3]),
    impulse: f64,
) -> Sample {
    let mm = |raw: i32| f64::from(raw) / MM;
    Sample {
        time,
        desired: std::array::from_fn(|axis| mm(record.programmed[axis])),
        tool: std::array::from_fn(|axis| mm(record.tool[axis])),
        moves,
        high,
        low,
        yielded: record.force.yielded.map(mm),
        impulse,
    }
}

/// Mean of a value over samples; not a number without any.
pub(super) fn mean(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).sum::<f64>() / samples.len() as f64
}

/// Largest of a value over samples; not a number without any.
pub(super) fn largest(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).fold(f64::NAN, f64::max)
}

/// Smallest of a value over samples; not a number without any.
pub(super) fn smallest(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(value).fold(f64::NAN, f64::min)
}
