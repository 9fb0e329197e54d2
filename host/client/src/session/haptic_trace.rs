//! A sampled trace of haptic arm and tool during teleoperation, at 1 kHz, from the ground truth of
//! a simulated machine.

use haptimill_hil_sim::Plant;
use haptimill_hil_sim::haptics::HapticGroundTruth;

/// Raw force units in a newton, and units of length in a millimetre.
const NEWTON: f64 = 65_536.0;
const MM: f64 = (1 << 20) as f64;

/// One sample. Positions in mm from the start of handle and tool, forces in N; x, y, z.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HapticTraceSample {
    /// Seconds since the start of the trace.
    pub time: f64,
    /// Tip of the handle.
    pub master: [f64; 3],
    /// Its velocity, mm/s.
    pub velocity: [f64; 3],
    /// Commanded position of the tool.
    pub commanded: [f64; 3],
    /// True position of the tool.
    pub tool: [f64; 3],
    /// Compliant displacement of the tool, p_c.
    pub displacement: [f64; 3],
    /// Measured force on the tool of largest magnitude in the last revolution.
    pub high: [f64; 3],
    /// Opposite extreme of that force in that revolution.
    pub low: [f64; 3],
    /// Force of the motors at the handle.
    pub feedback: [f64; 3],
    /// Force of the operator on the handle.
    pub push: [f64; 3],
    /// Force of the reference part on the ball.
    pub contact: [f64; 3],
    /// Speed of the operator as a fraction of the intended one.
    pub pace: f64,
    /// The trajectory of the operator is completed.
    pub done: bool,
}

/// The trace.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HapticTrace {
    /// The samples, in order of time.
    pub samples: Vec<HapticTraceSample>,
}

impl HapticTrace {
    /// The samples as CSV, one of every `every`: mm, N, s.
    #[must_use]
    pub fn to_csv(&self, every: usize) -> String {
        const VECTORS: [&str; 9] = [
            "master_mm",
            "master_mm_s",
            "desired_mm",
            "tool_mm",
            "displacement_mm",
            "high_n",
            "feedback_n",
            "master_n",
            "part_n",
        ];
        let mut text = String::from("time_s");
        for name in VECTORS {
            for axis in ["x", "y", "z"] {
                let (what, unit) = name.split_once('_').unwrap_or((name, ""));
                text.push_str(&format!(",{what}_{axis}_{unit}"));
            }
        }
        text.push_str(",pace\n");
        for s in self.samples.iter().step_by(every.max(1)) {
            text.push_str(&format!("{:.3}", s.time));
            let rows = [
                s.master,
                s.velocity,
                s.commanded,
                s.tool,
                s.displacement,
                s.high,
                s.feedback,
                s.push,
                s.contact,
            ];
            for value in rows.iter().flatten() {
                text.push_str(&format!(",{:.4}", value + 0.0));
            }
            text.push_str(&format!(",{:.3}\n", s.pace));
        }
        text
    }

    /// The samples in an interval of time.
    #[must_use]
    pub fn between(&self, from: f64, to: f64) -> &[HapticTraceSample] {
        let first = self.samples.partition_point(|sample| sample.time < from);
        let last = self.samples.partition_point(|sample| sample.time < to);
        &self.samples[first..last.max(first)]
    }

    /// The sample at a time, or the last one.
    #[must_use]
    pub fn at(&self, time: f64) -> HapticTraceSample {
        let index = self.samples.partition_point(|sample| sample.time < time);
        let last = self.samples.len().saturating_sub(1);
        self.samples
            .get(index.min(last))
            .copied()
            .unwrap_or_default()
    }
}

/// Takes samples of a simulated machine.
#[derive(Debug, Clone, Default)]
pub struct HapticTraceRecorder {
    trace: HapticTrace,
    /// Start time, ns, and the positions of handle, commanded tool and tool then.
    start: Option<(u64, [[f64; 3]; 3])>,
}

/// Nanoseconds between samples.
const EVERY_NS: u64 = 1_000_000;

impl HapticTraceRecorder {
    /// Samples a machine at the end of a period; one without a haptic arm gives no samples.
    pub fn sample(&mut self, plant: &Plant, snapshot: &haptimill_firmware::snapshot::Snapshot) {
        let Some(arm) = plant.haptic() else {
            return;
        };
        let now = plant.time_ns();
        if !now.is_multiple_of(EVERY_NS) {
            return;
        }
        let truth: &HapticGroundTruth = arm.truth();
        let three = |raw: &[i32]| std::array::from_fn(|axis| f64::from(raw[axis]));
        let commanded: [f64; 3] = three(&snapshot.commanded).map(|raw: f64| raw / MM);
        let [x, y, z, ..] = plant.truth().pose;
        let (start, origins) = *self
            .start
            .get_or_insert((now, [truth.tip, commanded, [x, y, z]]));
        let from = |position: [f64; 3], origin: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| position[axis] - origin[axis])
        };
        let [fx, fy, fz, ..] = truth.feedback;
        self.trace.samples.push(HapticTraceSample {
            time: (now - start) as f64 * 1e-9,
            master: from(truth.tip, origins[0]),
            velocity: truth.tip_velocity,
            commanded: from(commanded, origins[1]),
            tool: from([x, y, z], origins[2]),
            displacement: three(&snapshot.force.displacement).map(|raw: f64| raw / MM),
            high: three(&snapshot.force.high).map(|raw: f64| raw / NEWTON),
            low: three(&snapshot.force.low).map(|raw: f64| raw / NEWTON),
            feedback: [fx, fy, fz],
            push: truth.operator,
            contact: truth.contact,
            pace: truth.pace,
            done: truth.done,
        });
    }

    /// The trace.
    #[must_use]
    pub fn into_trace(self) -> HapticTrace {
        self.trace
    }
}
