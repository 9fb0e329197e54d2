//! Sampled trace of a pass: positions of the tool and forces on it, in mm, N and s.

use haptimill_trace::{Record, Recording, RecordingError, flag};
use serde::Serialize;
use std::collections::VecDeque;

/// Sampling rate of the thesis, Hz.
const SAMPLE_RATE: f64 = 1000.0;

/// Raw units of force in 1 N, and of length in 1 mm.
const NEWTON: f64 = 65_536.0;
const MM: f64 = (1 << 20) as f64;

/// Spindle speed of all experiments, rev/min.
const SPINDLE_RPM: f64 = 5000.0;

/// Origin of peak and low forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceSource {
    /// Measured by the controller: sensor, conditioning, extremes over a revolution.
    Controller,
    /// True force of the simulated cut, extremes over a revolution: the machine has no force
    /// sensor.
    TrueForce,
}

impl ForceSource {
    /// Description for the pages.
    #[must_use]
    pub const fn description(self) -> &'static str {
        match self {
            Self::Controller => "measured by the controller",
            Self::TrueForce => {
                "true force of the simulated cut over a revolution, not measured by the controller"
            }
        }
    }
}

/// One sample.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sample {
    /// Time since the first motion along x or y of the program, s; negative while the tool plunges.
    pub time: f64,
    /// Commanded position, mm: the programmed one, or along teleoperated axes that of the master.
    pub commanded: [f64; 3],
    /// True position of the tool, mm.
    pub tool: [f64; 3],
    /// The program moves along this axis.
    pub is_moving: [bool; 3],
    /// Force on the tool of largest magnitude in the last revolution, with its sign, N.
    pub peak_force: [f64; 3],
    /// Opposite end of the force in that revolution, N.
    pub low_force: [f64; 3],
    /// True force on the tool of largest magnitude in the last revolution, with its sign, N.
    pub true_force: [f64; 3],
    /// p_c, mm.
    pub compliant_displacement: [f64; 3],
    /// Integral of the peak force along x since the start, N s.
    pub impulse: f64,
}

impl Sample {
    /// Position of the tool minus commanded position, mm.
    #[must_use]
    pub fn tool_error(&self, axis: usize) -> f64 {
        self.tool[axis] - self.commanded[axis]
    }
}

/// Tool and spindle in a control period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Period {
    /// True position of the tool, mm.
    pub tool: [f64; 3],
    /// Turns of the spindle.
    pub turns: f64,
}

/// Samples of a pass, 1000 per second.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledTrace {
    /// Origin of the forces.
    pub source: ForceSource,
    /// The samples, in order of time.
    pub samples: Vec<Sample>,
    /// All control periods.
    pub periods: Vec<Period>,
    /// Duration of a control period, s.
    pub period_s: f64,
    /// Time of the first control period, s.
    pub first_period: f64,
}

/// Sliding window of the true force over one revolution.
struct Revolution {
    length: usize,
    samples: VecDeque<[f64; 3]>,
}

impl Revolution {
    fn push(&mut self, force: [f64; 3]) {
        if self.samples.len() == self.length {
            self.samples.pop_front();
        }
        self.samples.push_back(force);
    }

    /// Peak and low force, as the controller defines them.
    fn extremes(&self) -> ([f64; 3], [f64; 3]) {
        let (mut high, mut low) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let values = self.samples.iter().map(|force| force[axis]);
            let (min, max) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), v| {
                (l.min(v), m.max(v))
            });
            (high[axis], low[axis]) = if max.abs() >= min.abs() {
                (max, min)
            } else {
                (min, max)
            };
        }
        (high, low)
    }
}

impl SampledTrace {
    /// Samples a recording. `teleoperated` are the indices of the axes that the master moves.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn new(recording: &Recording, teleoperated: &[usize]) -> Result<Self, RecordingError> {
        let source = match recording.config().force {
            Some(_) => ForceSource::Controller,
            None => ForceSource::TrueForce,
        };
        let period_s = recording.period_s();
        let every = (1.0 / (SAMPLE_RATE * period_s)).round().max(1.0) as u64;
        let mut revolution = Revolution {
            length: (60.0 / SPINDLE_RPM / period_s).round().max(1.0) as usize,
            samples: VecDeque::new(),
        };
        let mut samples = Vec::new();
        let mut periods = Vec::new();
        let mut impulse = 0.0;
        let mut before: Option<[i32; 3]> = None;
        let mut start = None;
        for (index, record) in (0_u64..).zip(recording.iter()?) {
            let record = record?;
            let newtons = |raw: [i32; 3]| raw.map(|value| f64::from(value) / NEWTON);
            let mm = |axis: usize| f64::from(record.tool[axis]) / MM;
            periods.push(Period {
                tool: std::array::from_fn(mm),
                turns: f64::from(record.spindle_rpm) / 60.0 * period_s,
            });
            revolution.push(newtons(record.true_force));
            if source == ForceSource::Controller {
                impulse += f64::from(record.force.high[0]) / NEWTON * period_s;
            }
            if !record.has(flag::PROGRAMMED) || index % every != 0 {
                continue;
            }
            let programmed = std::array::from_fn(|axis| record.programmed[axis]);
            let last = before.replace(programmed).unwrap_or(programmed);
            let is_moving: [bool; 3] = std::array::from_fn(|axis| programmed[axis] != last[axis]);
            let time = index as f64 * period_s;
            if is_moving[0] || is_moving[1] {
                start.get_or_insert(time);
            }
            let of_revolution = revolution.extremes();
            let (high, low) = match source {
                ForceSource::Controller => (newtons(record.force.high), newtons(record.force.low)),
                ForceSource::TrueForce => of_revolution,
            };
            let mut sample = sample(&record, time, is_moving, (high, low), impulse);
            sample.true_force = of_revolution.0;
            for &axis in teleoperated {
                sample.commanded[axis] = f64::from(record.commanded[axis]) / MM;
            }
            samples.push(sample);
        }
        let start = start.unwrap_or(0.0);
        for sample in &mut samples {
            sample.time -= start;
        }
        Ok(Self {
            source,
            samples,
            periods,
            period_s,
            first_period: -start,
        })
    }

    /// Samples from one time until before another, s.
    #[must_use]
    pub fn between(&self, from: f64, to: f64) -> &[Sample] {
        let first = self.samples.partition_point(|sample| sample.time < from);
        let last = self.samples.partition_point(|sample| sample.time < to);
        &self.samples[first..last.max(first)]
    }

    /// First sample at or after a time; the last one when there is none.
    #[must_use]
    pub fn at(&self, time: f64) -> Sample {
        let index = self.samples.partition_point(|sample| sample.time < time);
        let last = self.samples.len().saturating_sub(1);
        self.samples
            .get(index.min(last))
            .copied()
            .unwrap_or_default()
    }

    /// Samples in which the program moves along x or y, from the first such motion until the tool
    /// is retracted.
    #[must_use]
    pub fn cut_path(&self) -> Vec<Sample> {
        let begin = self.samples.partition_point(|sample| sample.time < 0.0);
        let retracted = self.at(0.0).commanded[2] + 0.01;
        self.samples[begin..]
            .iter()
            .take_while(|sample| sample.commanded[2] < retracted)
            .filter(|sample| sample.is_moving[0] || sample.is_moving[1])
            .copied()
            .collect()
    }
}

fn sample(
    record: &Record,
    time: f64,
    is_moving: [bool; 3],
    (peak_force, low_force): ([f64; 3], [f64; 3]),
    impulse: f64,
) -> Sample {
    let mm = |raw: i32| f64::from(raw) / MM;
    Sample {
        time,
        commanded: std::array::from_fn(|axis| mm(record.programmed[axis])),
        tool: std::array::from_fn(|axis| mm(record.tool[axis])),
        is_moving,
        peak_force,
        low_force,
        true_force: [0.0; 3],
        compliant_displacement: record.force.displacement.map(mm),
        impulse,
    }
}
