//! What really happened at the haptic arm and at the tool while a hand led it, a thousand times a second: for scenarios on a simulated machine.

use haptimill_hil_sim::Plant;
use haptimill_hil_sim::haptics::HapticGroundTruth;

/// Raw force units in a newton, and units of length in a millimetre.
const NEWTON: f64 = 65_536.0;
const MM: f64 = (1 << 20) as f64;

/// One moment. Places in mm from where hand and tool were when it began, forces in N; x, y, z.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HandSample {
    /// Seconds since the hand formed its intention.
    pub time: f64,
    /// Tip of the handle.
    pub hand: [f64; 3],
    /// Its velocity, mm/s.
    pub velocity: [f64; 3],
    /// Where the tool is wanted: what the hand, or a program, leads it to.
    pub desired: [f64; 3],
    /// Where the tool really is.
    pub tool: [f64; 3],
    /// By how much the tool yields, p_c.
    pub yielded: [f64; 3],
    /// Force on the tool of largest magnitude in the last revolution, as the controller measures it.
    pub high: [f64; 3],
    /// The opposite end of what it was in that revolution.
    pub low: [f64; 3],
    /// Force of the haptic arm's motors at the handle.
    pub reflected: [f64; 3],
    /// Force of the hand on the handle.
    pub push: [f64; 3],
    /// Force of the reference part on the ball.
    pub contact: [f64; 3],
    /// Part of its pace that the hand keeps.
    pub pace: f64,
    /// The hand has done what it meant to do.
    pub done: bool,
}

/// What was seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HandCourse {
    /// The moments, in order.
    pub samples: Vec<HandSample>,
}

impl HandCourse {
    /// The samples as a table (CSV), a row every so many: mm, N, s.
    #[must_use]
    pub fn table(&self, every: usize) -> String {
        const VECTORS: [&str; 9] = [
            "hand_mm",
            "hand_mm_s",
            "desired_mm",
            "tool_mm",
            "yielded_mm",
            "high_n",
            "reflected_n",
            "hand_n",
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
                s.hand,
                s.velocity,
                s.desired,
                s.tool,
                s.yielded,
                s.high,
                s.reflected,
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

    /// The samples of a span of time.
    #[must_use]
    pub fn between(&self, from: f64, to: f64) -> &[HandSample] {
        let first = self.samples.partition_point(|sample| sample.time < from);
        let last = self.samples.partition_point(|sample| sample.time < to);
        &self.samples[first..last.max(first)]
    }

    /// The sample at a time; the nearest there is.
    #[must_use]
    pub fn at(&self, time: f64) -> HandSample {
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
pub struct HandRecorder {
    course: HandCourse,
    /// Time at which it began, ns, and where hand, desired place and tool were.
    begun: Option<(u64, [[f64; 3]; 3])>,
}

/// Nanoseconds between samples.
const EVERY_NS: u64 = 1_000_000;

impl HandRecorder {
    /// Looks at a machine at the end of a period; a machine without a haptic arm leaves no samples.
    pub fn look(&mut self, plant: &Plant, snapshot: &haptimill_firmware::snapshot::Snapshot) {
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
        let (begun, origins) = *self
            .begun
            .get_or_insert((now, [truth.tip, commanded, [x, y, z]]));
        let from = |place: [f64; 3], origin: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| place[axis] - origin[axis])
        };
        let [fx, fy, fz, ..] = truth.reflected;
        self.course.samples.push(HandSample {
            time: (now - begun) as f64 * 1e-9,
            hand: from(truth.tip, origins[0]),
            velocity: truth.tip_velocity,
            desired: from(commanded, origins[1]),
            tool: from([x, y, z], origins[2]),
            yielded: three(&snapshot.force.yielded).map(|raw: f64| raw / MM),
            high: three(&snapshot.force.high).map(|raw: f64| raw / NEWTON),
            low: three(&snapshot.force.low).map(|raw: f64| raw / NEWTON),
            reflected: [fx, fy, fz],
            push: truth.hand,
            contact: truth.contact,
            pace: truth.pace,
            done: truth.done,
        });
    }

    /// What was seen.
    #[must_use]
    pub fn into_course(self) -> HandCourse {
        self.course
    }
}
