//! Preview of a part program: one offline HTML page with the planned path of the tool tip in 3D,
//! coloured by feed, rapid moves apart; feed over time; the extremes of the joints; and the stops.
//!
//! A [`Preview`] takes the setpoints of a planner one by one. Between them it evaluates the same
//! cubics as the controller.

mod page;
mod trace;

use haptimill_gcode::{Coordinates, Place, Step, ToolLength};
use haptimill_planner::{Figures, MachineModel, Planned, Settings};
use haptimill_protocol::message::{AxisValues, RATE_SHIFT};
use trace::{Point, Trace};

/// Largest change of direction between two points of the drawn path, degrees.
const TURN_DEG: f64 = 2.0;
/// Most points of the drawn path between two setpoints.
const MAX_POINTS: f64 = 64.0;

/// Stroke of a joint: mm, or degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name.
    pub name: String,
    /// `mm` or `deg`.
    pub unit: &'static str,
    /// Lower end of the stroke; minus infinity if the joint wraps around.
    pub low: f64,
    /// Upper end of the stroke; infinity if the joint wraps around.
    pub high: f64,
}

/// Lowest and highest position of a joint, with the lines of the program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Lowest position and its line.
    pub low: (f64, u32),
    /// Highest position and its line.
    pub high: (f64, u32),
}

/// A stop of the program, or a command.
#[derive(Debug, Clone, PartialEq)]
struct Event {
    time_s: f64,
    line: u32,
    what: String,
}

/// Preview of a program. Callers add each step after the setpoints before it, and each setpoint.
#[derive(Debug)]
pub struct Preview<M> {
    settings: Settings,
    model: M,
    joints: Vec<Joint>,
    /// Indices of x, y and z of the tool tip in the pose, where the machine has them.
    tip: [Option<usize>; 3],
    pose: Coordinates,
    rates: Coordinates,
    period: u64,
    cut: Trace,
    rapid: Trace,
    extents: Vec<Option<Extent>>,
    events: Vec<Event>,
}

impl<M: MachineModel> Preview<M> {
    /// Creates the preview of a program that starts at a pose, mm and degrees. `tip` has the
    /// indices of x, y and z of the tool tip in the pose, of those that the machine has.
    pub fn new(
        start: Coordinates,
        settings: Settings,
        tip: [Option<usize>; 3],
        model: M,
        joints: Vec<Joint>,
    ) -> Self {
        let mut preview = Self {
            tip,
            extents: vec![None; joints.len()],
            settings,
            model,
            joints,
            pose: start,
            rates: [0.0; 6],
            period: 0,
            cut: Trace::default(),
            rapid: Trace::default(),
            events: Vec::new(),
        };
        preview.extend_joints(&start, 0);
        preview
    }

    /// Adds a setpoint.
    pub fn add(&mut self, planned: &Planned) {
        let setpoint = &planned.setpoint;
        let duration = f64::from(setpoint.periods) * self.period_s();
        let to = self.engineering_units(&setpoint.pose, 1.0);
        let rates = self.engineering_units(&setpoint.rates, f64::from(1u32 << RATE_SHIFT));
        let start_s = self.time_s();
        let cubic = Cubic {
            duration,
            from: self.unwound(&to),
            to,
            rates: [self.rates, rates],
        };
        let line = planned.place.line;
        let moves = self.rates != [0.0; 6] || rates != [0.0; 6] || cubic.from != cubic.to;
        if moves {
            let tool = planned.tool;
            let count = self.points(&cubic, tool);
            let first = self.point(start_s, (&cubic.from, &self.rates), tool, line);
            let trace = if planned.is_rapid {
                self.cut.end();
                &mut self.rapid
            } else {
                self.rapid.end();
                &mut self.cut
            };
            trace.begin(first);
            for index in 1..=count {
                let u = f64::from(index) / f64::from(count);
                let (pose, rates) = cubic.at(u);
                let point = self.point(start_s + u * duration, (&pose, &rates), tool, line);
                if planned.is_rapid {
                    self.rapid.push(point);
                } else {
                    self.cut.push(point);
                }
                self.extend_joints(&pose, line);
            }
        }
        self.pose = to;
        self.rates = rates;
        self.period += u64::from(setpoint.periods);
    }

    /// Adds what a step does at standstill, at the time of the last setpoint. Moves are ignored.
    pub fn add_step(&mut self, step: &Step) {
        let what = match step {
            Step::Move(_) => return,
            Step::Dwell { seconds, .. } => format!("dwell of {seconds} s"),
            Step::Spindle { rpm: 0, .. } => "spindle off".into(),
            Step::Spindle { rpm, .. } => format!("spindle {rpm} rev/min"),
            Step::Pause { .. } => "pause".into(),
            Step::Coolant { mist, flood, .. } => match (mist, flood) {
                (false, false) => "coolant off".into(),
                (true, false) => "mist".into(),
                (false, true) => "flood".into(),
                (true, true) => "mist and flood".into(),
            },
            Step::ToolChange { tool, .. } => format!("tool {tool}"),
            Step::Output { number, .. } => format!("output {number}"),
            Step::Wait { number, .. } => format!("wait for input {number}"),
            Step::Probe { .. } => "probe move".into(),
            Step::Message { text, .. } => format!("message: {text}"),
        };
        let Place { line, .. } = step.place();
        self.events.push(Event {
            time_s: self.time_s(),
            line,
            what,
        });
    }

    /// Lowest and highest position of each joint; `None` before the first setpoint of a pose that
    /// the machine reaches.
    pub fn extents(&self) -> &[Option<Extent>] {
        &self.extents
    }

    /// The 3D view of the path alone, for another page.
    #[must_use]
    pub fn scene(&self) -> haptimill_viewer::Scene {
        page::scene(self)
    }

    /// Returns the page. `program` and `machine` are names, `figures` those of the plan.
    #[must_use]
    pub fn page(&self, program: &str, machine: &str, figures: &Figures) -> String {
        page::page(self, program, machine, figures)
    }

    fn period_s(&self) -> f64 {
        f64::from(self.settings.period_us) * 1e-6
    }

    fn time_s(&self) -> f64 {
        self.period as f64 * self.period_s()
    }

    /// Axis values to mm and degrees.
    fn engineering_units(&self, values: &AxisValues, scale: f64) -> Coordinates {
        let mut converted = Coordinates::default();
        for ((slot, axis), value) in converted.iter_mut().zip(&self.settings.pose).zip(values) {
            *slot = f64::from(*value) * scale / axis.units;
        }
        converted
    }

    /// The present pose, with the rotary coordinates that wrap around within half a turn of `to`.
    fn unwound(&self, to: &Coordinates) -> Coordinates {
        let mut from = self.pose;
        for ((slot, axis), to) in from.iter_mut().zip(&self.settings.pose).zip(to) {
            if axis.high == f64::INFINITY {
                *slot += ((to - *slot) / 360.0).round() * 360.0;
            }
        }
        from
    }

    /// Points to draw on a segment.
    fn points(&self, cubic: &Cubic, tool: ToolLength) -> u32 {
        let direction = |u: f64| {
            let (pose, rates) = cubic.at(u);
            self.tip_of(&tool.tip_rates(&pose, &rates))
        };
        let directions = [0.05, 0.5, 0.95].map(direction);
        let angle = |u: &[f64; 3], v: &[f64; 3]| {
            let dot: f64 = u.iter().zip(v).map(|(a, b)| a * b).sum();
            let lengths = norm(u) * norm(v);
            if lengths > 0.0 {
                (dot / lengths).clamp(-1.0, 1.0).acos().to_degrees()
            } else {
                0.0
            }
        };
        let turn = angle(&directions[0], &directions[1]) + angle(&directions[1], &directions[2]);
        (turn / TURN_DEG).ceil().clamp(1.0, MAX_POINTS) as u32
    }

    fn tip_of(&self, values: &Coordinates) -> [f64; 3] {
        self.tip
            .map(|index| index.map_or(0.0, |index| values[index]))
    }

    fn point(
        &self,
        time_s: f64,
        (pose, rates): (&Coordinates, &Coordinates),
        tool: ToolLength,
        line: u32,
    ) -> Point {
        Point {
            place: self.tip_of(&tool.tip_pose(pose)),
            speed: norm(&self.tip_of(&tool.tip_rates(pose, rates))),
            time_s,
            line,
        }
    }

    fn extend_joints(&mut self, pose: &Coordinates, line: u32) {
        // The planner has refused the poses that the machine cannot reach.
        let Ok(joints) = self.model.joints(pose) else {
            return;
        };
        for (extent, at) in self.extents.iter_mut().zip(joints) {
            let here = (at, line);
            let extent = extent.get_or_insert(Extent {
                low: here,
                high: here,
            });
            if at < extent.low.0 {
                extent.low = here;
            }
            if at > extent.high.0 {
                extent.high = here;
            }
        }
    }
}

fn norm(vector: &[f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// The motion between two setpoints.
struct Cubic {
    duration: f64,
    from: Coordinates,
    to: Coordinates,
    rates: [Coordinates; 2],
}

impl Cubic {
    /// Pose and rates at a part of the duration.
    fn at(&self, u: f64) -> (Coordinates, Coordinates) {
        let t = self.duration;
        let (mut pose, mut rates) = (Coordinates::default(), Coordinates::default());
        for k in 0..pose.len() {
            let (p, q) = (self.from[k], self.to[k]);
            let (v, w) = (self.rates[0][k] * t, self.rates[1][k] * t);
            let (b, c) = (3.0 * (q - p) - 2.0 * v - w, v + w - 2.0 * (q - p));
            pose[k] = p + u * (v + u * (b + u * c));
            rates[k] = (v + u * (2.0 * b + u * 3.0 * c)) / t;
        }
        (pose, rates)
    }
}
