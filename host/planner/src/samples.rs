//! Samples of a path, and what they tell of the motion between them.

use super::limits::Settings;
use haptimill_gcode::{Path, WordKind};

/// The samples of a path: at most 1 mm, 1 degree of a rotary axis and 20 degrees of arc apart.
///
/// Over 1 mm the joints are nearly linear in the pose, so on an arc their derivatives are sine
/// waves of its angle. That bounds them between the samples.
pub(super) struct Samples {
    /// Number of intervals between them.
    pub intervals: usize,
    /// Cosine of the angle between two samples, and 1 / sine^2; 0 where the angle does not matter.
    cosine: f64,
    per_sine_squared: f64,
    /// Bounds of the second and third derivatives, in parts of the largest difference quotients.
    bounds: [f64; 2],
}

impl Samples {
    /// A sine wave has no visible peak between samples that are closer, radians: below 5e-5.
    const CLOSE: f64 = 0.02;

    pub fn of(path: &Path, settings: &Settings) -> Self {
        let mut count = path.tip_length().max(1.0);
        for (k, axis) in settings.pose.iter().enumerate() {
            if axis.kind == WordKind::Rotary {
                count = count.max((path.to[k] - path.from[k]).abs());
            }
        }
        let sweep = path.arc.map_or(0.0, |arc| arc.sweep.abs());
        let intervals = count.max(sweep.to_degrees() / 20.0).ceil();
        let angle = sweep / intervals;
        let (sine, cosine) = libm::sincos(angle);
        let mut samples = Self {
            intervals: intervals as usize,
            cosine,
            per_sine_squared: 0.0,
            bounds: [1.0; 2],
        };
        if angle > Self::CLOSE {
            samples.per_sine_squared = 1.0 / (sine * sine);
            // The mean over an interval is the value in its middle times this.
            let (sine, cosine) = libm::sincos(0.5 * angle);
            let mean = sine / (0.5 * angle);
            samples.bounds = [1.0 / (mean * cosine), 1.0 / (mean * mean * cosine)];
        }
        samples
    }

    /// Returns the length of a path at a sample.
    pub fn length(&self, index: usize, path: &Path) -> f64 {
        path.length * index as f64 / self.intervals as f64
    }

    /// Returns the largest magnitude between two samples, ends included.
    pub fn peak(&self, first: f64, second: f64) -> f64 {
        let ends = first.abs().max(second.abs());
        // The slopes of the sine wave at the samples differ in sign if its peak is between them.
        let slopes = [second - first * self.cosine, second * self.cosine - first];
        if self.per_sine_squared == 0.0 || slopes[0] * slopes[1] >= 0.0 {
            return ends;
        }
        let chord = first * first + second * second - 2.0 * first * second * self.cosine;
        ends.max((chord * self.per_sine_squared).sqrt())
    }
}

/// Derivatives of the joints by length.
#[derive(Default)]
pub(super) struct JointDerivatives {
    /// The sample before: its length, first and second derivatives.
    before: Option<(f64, [f64; 6], [f64; 6])>,
    /// Largest magnitude of each joint: first, second, third.
    pub largest: [[f64; 3]; 6],
}

impl JointDerivatives {
    /// Adds a sample. `largest` has the derivatives at this sample alone then.
    pub fn sample_alone(&mut self, s: f64, joints: &[f64; 6], samples: &Samples) {
        self.largest = [[0.0; 3]; 6];
        self.sample(s, joints, samples);
        for (largest, joint) in self.largest.iter_mut().zip(joints) {
            largest[0] = joint.abs();
        }
    }

    /// Adds a sample.
    pub fn sample(&mut self, s: f64, joints: &[f64; 6], samples: &Samples) {
        let mut seconds = [0.0; 6];
        let [second_bound, third_bound] = samples.bounds;
        for (k, largest) in self.largest.iter_mut().enumerate() {
            let Some((at, rates, before)) = &self.before else {
                largest[0] = largest[0].max(joints[k].abs());
                continue;
            };
            largest[0] = largest[0].max(samples.peak(rates[k], joints[k]));
            seconds[k] = (joints[k] - rates[k]) / (s - at);
            largest[1] = largest[1].max(seconds[k].abs() * second_bound);
            // The second derivative of the first interval is the first one.
            if *at > 0.0 {
                let third = (seconds[k] - before[k]) / (s - at);
                largest[2] = largest[2].max(third.abs() * third_bound);
            }
        }
        self.before = Some((s, *joints, seconds));
    }
}

#[cfg(test)]
mod tests {
    use super::{JointDerivatives, Samples};
    use crate::limits::{PoseLimits, Settings};
    use haptimill_gcode::{Arc, Path, WordKind};
    use proptest::prelude::*;

    /// Joint rates of a machine whose joints are linear in the pose.
    fn joints(weights: &[[f64; 2]; 6], tangent: &[f64; 6]) -> [f64; 6] {
        weights.map(|[x, y]| x * tangent[0] + y * tangent[1])
    }

    fn settings() -> Settings {
        let axis = |letter| PoseLimits {
            letter,
            kind: WordKind::Linear,
            units: 1.0,
            low: -100.0,
            high: 100.0,
            rate: 40.0,
            acceleration: 200.0,
            jerk: 5000.0,
        };
        Settings::new(vec![axis('X'), axis('Y')], Vec::new(), 200)
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            rng_seed: proptest::test_runner::RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]

        /// The samples of an arc bound the derivatives of the joints between them. The truth is the
        /// arc in closed form, at 2000 points.
        #[test]
        fn samples_bound_the_derivatives_of_an_arc(
            radius in 0.05_f64..30.0,
            start in -3.2_f64..3.2,
            sweep in prop_oneof![0.01_f64..6.2, -6.2_f64..-0.01],
            weights in prop::array::uniform6(prop::array::uniform2(-2.0_f64..2.0)),
        ) {
            let kinds = [WordKind::Linear; 2];
            let point = |angle: f64| {
                [radius * angle.cos(), radius * angle.sin(), 0.0, 0.0, 0.0, 0.0]
            };
            let arc = Arc {
                plane: [0, 1],
                centre: [0.0; 2],
                radius: [radius; 2],
                angle: start,
                sweep,
            };
            let Some(path) = Path::arc(&kinds, point(start), point(start + sweep), arc) else {
                return Ok(());
            };
            let samples = Samples::of(&path, &settings());
            let mut derivatives = JointDerivatives::default();
            for index in 0..=samples.intervals {
                let s = samples.length(index, &path);
                let (_, tangent) = path.at_with_tangent(s);
                derivatives.sample(s, &joints(&weights, &tangent), &samples);
            }
            for (weights, largest) in weights.iter().zip(derivatives.largest) {
                let mut truth = [0.0_f64; 3];
                for index in 0..=2000 {
                    let (sin, cos) = (start + sweep * f64::from(index) / 2000.0).sin_cos();
                    let along = weights[1] * cos - weights[0] * sin;
                    let across = weights[0] * cos + weights[1] * sin;
                    truth[0] = truth[0].max(along.abs());
                    truth[1] = truth[1].max(across.abs() / radius);
                    truth[2] = truth[2].max(along.abs() / (radius * radius));
                }
                let max = weights[0].hypot(weights[1]);
                prop_assert!(largest[0] >= truth[0] * (1.0 - 1e-4), "{largest:?} {truth:?}");
                prop_assert!(largest[0] <= truth[0] + 2e-4 * max, "{largest:?} {truth:?}");
                // A half circle has the peaks of all derivatives within its samples.
                if sweep.abs() > 3.6 {
                    prop_assert!(largest[1] >= truth[1] * (1.0 - 1e-3), "{largest:?} {truth:?}");
                    prop_assert!(largest[1] <= truth[1] * 1.03, "{largest:?} {truth:?}");
                    prop_assert!(largest[2] >= truth[2] * (1.0 - 1e-3), "{largest:?} {truth:?}");
                    prop_assert!(largest[2] <= truth[2] * 1.04, "{largest:?} {truth:?}");
                }
            }
        }
    }
}
