//! Selection of samples for a measure.

use super::statistics::Point;
use super::{Quantity, quantity};
use crate::definition::{Event, Experiment, Measurement, Pass, Window, WorkAxis};
use crate::pass_data::PassData;
use crate::sampled_trace::Sample;
use haptimill_client::session::{HapticTrace, HapticTraceSample};

/// Time left out at both ends of a window for a settled value, s.
const SETTLING_S: f64 = 0.3;

/// Distance at which the master has reached a position, mm.
const REACHED_MM: f64 = 0.5;

/// Input of a measure.
pub(super) struct Context<'a> {
    pub experiment: &'a Experiment,
    pub pass: &'a Pass,
    pub data: &'a PassData,
    pub measurement: &'a Measurement,
}

/// Samples without the first and last [`SETTLING_S`].
pub(super) fn settled<T>(samples: &[T], time: impl Fn(&T) -> f64) -> &[T] {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return samples;
    };
    let (first, last) = (time(first) + SETTLING_S, time(last) - SETTLING_S);
    let begin = samples.partition_point(|sample| time(sample) < first);
    let end = samples.partition_point(|sample| time(sample) < last);
    &samples[begin..end.max(begin)]
}

impl<'a> Context<'a> {
    /// A measurement in its pass; none if the pass was not run.
    pub fn new(
        experiment: &'a Experiment,
        passes: &'a [PassData],
        measurement: &'a Measurement,
    ) -> Option<Self> {
        let index = experiment.pass_of(measurement)?;
        Some(Self {
            experiment,
            pass: experiment.passes.get(index)?,
            data: passes.get(index)?,
            measurement,
        })
    }

    /// What is added to a time of the measures for the same time in the sampled trace, s. Both
    /// records of a teleoperated pass have the forces of the controller: the time of the largest
    /// one is that of the sample with the most similar forces.
    pub fn trace_offset(&self) -> f64 {
        let Some(record) = &self.data.teleoperation else {
            return 0.0;
        };
        let size = |force: [f64; 3]| force.into_iter().map(f64::abs).fold(0.0, f64::max);
        // The force of a revolution is in several samples: the first one counts in both records.
        let samples = record.samples.iter().rev();
        let Some(largest) = samples.max_by(|a, b| size(a.high).total_cmp(&size(b.high))) else {
            return 0.0;
        };
        let difference = |sample: &Sample| {
            let by = |axis: usize| sample.peak_force[axis] - largest.high[axis];
            size([by(0), by(1), by(2)])
        };
        let trace = self.data.trace.samples.iter();
        let same = trace.min_by(|a, b| difference(a).total_cmp(&difference(b)));
        same.map_or(0.0, |same| same.time - largest.time)
    }

    /// Time and quantity of all samples from one time to another.
    pub fn curve(&self, quantity: &Quantity, from: f64, to: f64) -> Vec<Point> {
        let axis = self.axis();
        match (quantity.programmed, quantity.teleoperated) {
            (_, Some(value)) if self.pass.teleoperation.is_some() => {
                let samples = self.teleoperation().between(from, to).iter();
                samples.map(|s| (s.time, value(s, axis))).collect()
            }
            (Some(value), _) => {
                let samples = self.data.trace.between(from, to).iter();
                samples.map(|s| (s.time, value(s, axis))).collect()
            }
            _ => Vec::new(),
        }
    }
    pub fn axis(&self) -> usize {
        self.measurement.axis.map_or(0, WorkAxis::index)
    }

    /// Windows of the measurement; one without bounds when it names none.
    pub fn windows(&self) -> Vec<Window> {
        let names = &self.measurement.windows;
        let windows = names
            .iter()
            .filter_map(|name| self.experiment.windows.get(name));
        let windows: Vec<Window> = windows.cloned().collect();
        if windows.is_empty() {
            vec![Window::default()]
        } else {
            windows
        }
    }

    /// Samples of a programmed pass.
    pub fn programmed_samples(&self) -> Vec<Sample> {
        let trace = &self.data.trace;
        let mut samples = Vec::new();
        for window in self.windows() {
            let found: Vec<Sample> = if window.from_s.is_some() || window.to_s.is_some() {
                let from = window.from_s.unwrap_or(f64::NEG_INFINITY);
                trace
                    .between(from, window.to_s.unwrap_or(f64::INFINITY))
                    .to_vec()
            } else {
                let is_inside = |sample: &Sample| {
                    let [_, y, z] = sample.commanded;
                    let is_at_z = window.z_mm.is_none_or(|at| (z - at).abs() < 0.005);
                    let on_line = |at: f64| (y - at).abs() < 1e-4 && sample.is_moving[0];
                    let is_moving = |axis: WorkAxis| sample.is_moving[axis.index()];
                    is_at_z
                        && window.y_mm.is_none_or(on_line)
                        && window.moving.is_none_or(is_moving)
                };
                trace.cut_path().into_iter().filter(is_inside).collect()
            };
            samples.extend_from_slice(if self.measurement.settled {
                settled(&found, |sample| sample.time)
            } else {
                &found
            });
        }
        samples
    }

    /// Record of a teleoperated pass.
    pub fn teleoperation(&self) -> &HapticTrace {
        static EMPTY: HapticTrace = HapticTrace {
            samples: Vec::new(),
        };
        self.data.teleoperation.as_ref().unwrap_or(&EMPTY)
    }

    /// Start and end of a window of a teleoperated pass, s.
    pub fn bounds(&self, window: &Window) -> (f64, f64) {
        let event = window.to_event.as_ref().map(|event| self.time_of(event));
        let to = event.or(window.to_s).unwrap_or(f64::INFINITY);
        let from = window.from_fraction.map(|fraction| fraction * to);
        (from.or(window.from_s).unwrap_or(f64::NEG_INFINITY), to)
    }

    /// Samples of a teleoperated pass.
    pub fn teleoperated_samples(&self) -> Vec<HapticTraceSample> {
        let mut samples = Vec::new();
        for window in self.windows() {
            let (from, to) = self.bounds(&window);
            let found = self.teleoperation().between(from, to).iter();
            let is_inside = |sample: &&HapticTraceSample| {
                let range = window.feedback_n;
                range.is_none_or(|[low, high]| (low..high).contains(&sample.feedback[0]))
            };
            let found: Vec<HapticTraceSample> = found.filter(is_inside).copied().collect();
            samples.extend_from_slice(if self.measurement.settled {
                settled(&found, |sample| sample.time)
            } else {
                &found
            });
        }
        samples
    }

    /// Time and quantity of the selected samples.
    pub fn values(&self) -> Vec<Point> {
        let name = self.measurement.quantity.as_deref().unwrap_or_default();
        let axis = self.axis();
        let Some(quantity) = quantity(name) else {
            return Vec::new();
        };
        if self.pass.teleoperation.is_some() {
            let samples = self.teleoperated_samples();
            let value = quantity.teleoperated.unwrap_or(|_, _| f64::NAN);
            samples.iter().map(|s| (s.time, value(s, axis))).collect()
        } else {
            let samples = self.programmed_samples();
            let value = quantity.programmed.unwrap_or(|_, _| f64::NAN);
            samples.iter().map(|s| (s.time, value(s, axis))).collect()
        }
    }

    pub fn magnitudes(&self) -> Vec<Point> {
        let values = self.values().into_iter();
        values.map(|(time, value)| (time, value.abs())).collect()
    }

    pub fn times(&self) -> Vec<f64> {
        if self.pass.teleoperation.is_some() {
            let samples = self.teleoperated_samples();
            samples.iter().map(|sample| sample.time).collect()
        } else {
            let samples = self.programmed_samples();
            samples.iter().map(|sample| sample.time).collect()
        }
    }

    /// Quantity at a time.
    pub fn value_at(&self, time: f64) -> f64 {
        let name = self.measurement.quantity.as_deref().unwrap_or_default();
        let axis = self.axis();
        let Some(quantity) = quantity(name) else {
            return f64::NAN;
        };
        match (quantity.programmed, quantity.teleoperated) {
            (_, Some(value)) if self.pass.teleoperation.is_some() => {
                value(&self.teleoperation().at(time), axis)
            }
            (Some(value), _) => value(&self.data.trace.at(time), axis),
            _ => f64::NAN,
        }
    }

    pub fn at(&self) -> f64 {
        self.value_at(self.measurement.at_s.unwrap_or(f64::NAN))
    }

    pub fn event_time(&self) -> f64 {
        let event = self.measurement.event.as_ref();
        event.map_or(f64::NAN, |event| self.time_of(event))
    }

    /// Time of an event; not a number when it does not occur.
    pub fn time_of(&self, event: &str) -> f64 {
        let Some(event) = self.experiment.events.get(event) else {
            return f64::NAN;
        };
        let Event {
            from_s,
            to_s,
            master_x_mm,
            completed,
        } = *event;
        let (from, to) = (
            from_s.unwrap_or(f64::NEG_INFINITY),
            to_s.unwrap_or(f64::INFINITY),
        );
        let has_occurred = |sample: &&HapticTraceSample| {
            let is_near = |x: f64| (sample.master[0] - x).abs() < REACHED_MM;
            completed && sample.done || master_x_mm.is_some_and(is_near)
        };
        let mut samples = self.teleoperation().between(from, to).iter();
        let first = samples.find(has_occurred);
        first.map_or(f64::NAN, |sample| sample.time)
    }
}
