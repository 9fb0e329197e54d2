//! Planner: from a part program to a trajectory, and to its setpoints.
//!
//! A [`Plan`] is complete before anything moves. Every block and every setpoint is checked against
//! soft limits and the machine's geometry. The trajectory is cubic in time between setpoints, as
//! the controller interpolates it.
//!
//! - Along a block: seven phases of constant jerk, no acceleration at the block's ends. A setpoint
//!   is at every change of jerk.
//! - On an arc, setpoints are so close that the cubic stays within 0.1 um of the circle.
//! - A corner of up to 120 degrees is passed at constant speed and rounded within
//!   [`Settings::tolerance_mm`]. The motion stops at sharper corners, with G61, and between moves
//!   of the tip and moves of rotary axes alone. Between a line and an arc, the speed keeps the step
//!   of centripetal acceleration below [`Settings::curvature_step`] of the limit.
//! - Limits of rate, acceleration and jerk hold for every pose coordinate, of rate and acceleration
//!   for every joint. A rapid move is limited to them. A feed that exceeds a rate is refused, with
//!   the largest possible feed. Acceleration and look-ahead may keep a move below its feed.
//!
//! Setpoints are on whole control periods, phases are not: the trajectory is evaluated at the
//! period nearest to each change of jerk. Only standstills begin and end on whole periods.
//!
//! All computations are f64 with the transcendental functions of the crate libm, so a plan has the
//! same bits on every host.
//!
//! A path is checked at the setpoints and at samples of the blocks (at most 1 mm, 1 degree apart),
//! not between them. A pause (M0) takes no time in the plan.

mod block;
mod corner;
mod limits;
mod lookahead;
mod profile;
mod setpoints;
mod trajectory;

pub use limits::{JointLimits, MachineModel, PoseLimits, PoseProblem, Settings};
pub use trajectory::Cursor;

use block::Block;
use haptimill_gcode::{
    Coordinates, LISTED_PROBLEMS, Move, Path, Place, Problem, Program, Refused, Step,
};
use haptimill_protocol::message::{Action, AxisValues};
use haptimill_protocol::setpoint::Setpoint;
use lookahead::Junctions;
use profile::Phase;
use setpoints::Emitter;
use trajectory::{Bump, Knot, Piece, Trajectory};

/// Largest change of rate without rounding: the resolution of the setpoints (2^-12 mm/s, 2^-24
/// turn/s).
const NO_CORNER: f64 = 2e-5;

/// Longest plan, seconds: a hundred hours.
const LONGEST_PLAN_S: f64 = 360_000.0;

/// A checked trajectory.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Start pose, axis units.
    pub start: AxisValues,
    /// Setpoints; the last one is at standstill.
    pub setpoints: Vec<Setpoint>,
    /// Control period, seconds.
    pub period_s: f64,
    /// Figures of the plan.
    pub figures: Figures,
    places: Vec<Place>,
    trajectory: Trajectory,
}

/// Figures of a plan.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Figures {
    /// Duration, seconds, without pauses.
    pub duration_s: f64,
    /// Length of the programmed path of the tool tip in the workpiece, mm, rapid moves included.
    pub path_length_mm: f64,
    /// Number of moves.
    pub blocks: usize,
    /// Largest path speed of the tip, mm/s.
    pub peak_tip_mm_s: f64,
    /// Largest rate of each joint at the setpoints, mm/s or deg/s.
    pub peak_joint_rates: [f64; 6],
}

impl Plan {
    /// Plans a program.
    ///
    /// # Errors
    ///
    /// Returns every problem with the place of its block: reach, stroke, singularity, soft limits,
    /// feed.
    pub fn new(
        program: &Program,
        settings: &Settings,
        model: &impl MachineModel,
    ) -> Result<Plan, Refused> {
        let mut builder = Builder::new(program, settings, model);
        builder.check_start();
        let mut moves: Vec<&Move> = Vec::new();
        for step in &program.steps {
            let (place, action, seconds) = match step {
                Step::Move(step) => {
                    moves.push(step);
                    continue;
                }
                Step::Message { .. } => continue,
                Step::Dwell { place, seconds } => (*place, Action::None, *seconds),
                Step::Spindle { place, rpm } => (*place, Action::Spindle(*rpm), 0.0),
                // The operator changes the tool during a pause.
                Step::Pause { place } | Step::ToolChange { place, .. } => {
                    (*place, Action::Pause, 0.0)
                }
                Step::Probe { .. }
                | Step::Coolant { .. }
                | Step::Output { .. }
                | Step::Wait { .. } => {
                    builder.note(Problem {
                        place: step.place(),
                        what: "a job of this machine has no probe, coolant, inputs and outputs"
                            .into(),
                        remedy: "remove the block".into(),
                    });
                    continue;
                }
            };
            builder.run(&std::mem::take(&mut moves));
            builder.wait(place, action, seconds);
        }
        builder.run(&moves);
        builder.finish()
    }

    /// Returns the programmed pose at a time, on the exact lines and arcs, mm and degrees. For
    /// calls in sequence; see [`Cursor`].
    pub fn programmed(&self, cursor: &mut Cursor, time_s: f64) -> Coordinates {
        self.trajectory.programmed(cursor, time_s)
    }

    /// Returns pose and rates of the trajectory, with its corners rounded: mm, degrees, and per
    /// second.
    pub fn intended(&self, cursor: &mut Cursor, time_s: f64) -> (Coordinates, Coordinates) {
        self.trajectory.intended(cursor, time_s)
    }

    /// Returns the place in the program of the motion towards a setpoint; the last one for a number
    /// beyond the end.
    pub fn place_of(&self, setpoint: usize) -> Place {
        self.places
            .get(setpoint)
            .or(self.places.last())
            .copied()
            .unwrap_or_default()
    }

    /// Returns the line of the program of the motion towards a setpoint.
    pub fn line_of(&self, setpoint: usize) -> u32 {
        self.place_of(setpoint).line
    }
}

struct Builder<'a, M: MachineModel> {
    program: &'a Program,
    settings: &'a Settings,
    model: &'a M,
    trajectory: Trajectory,
    emitter: Emitter<'a>,
    problems: Vec<Problem>,
    more: usize,
    at: Coordinates,
    figures: Figures,
}

impl<'a, M: MachineModel> Builder<'a, M> {
    fn new(program: &'a Program, settings: &'a Settings, model: &'a M) -> Self {
        let start = program.start;
        // Path 0 is the start pose, so that every time has a path.
        let standing = Path {
            from: start,
            to: start,
            arc: None,
            length: 1.0,
            measure: haptimill_gcode::Measure::Tip,
        };
        let mut trajectory = Trajectory {
            paths: vec![(Place::default(), standing)],
            ..Trajectory::default()
        };
        trajectory.pieces.push(resting(0.0, 0, 1.0));
        Self {
            program,
            settings,
            model,
            trajectory,
            emitter: Emitter::new(settings),
            problems: Vec::new(),
            more: 0,
            at: start,
            figures: Figures::default(),
        }
    }

    fn note(&mut self, problem: Problem) {
        if self.problems.len() < LISTED_PROBLEMS {
            self.problems.push(problem);
        } else {
            self.more += 1;
        }
    }

    fn check_start(&mut self) {
        if let Err((what, _)) = block::check_pose(&self.program.start, self.settings, self.model) {
            let what = format!("the machine cannot be at the start of the program: {what}");
            self.note(Problem {
                place: Place {
                    line: 1,
                    column: 1,
                    ..Place::default()
                },
                what,
                remedy: "home the machine".into(),
            });
        }
    }

    fn wait(&mut self, place: Place, action: Action, seconds: f64) {
        if action == Action::None {
            self.emitter.rest(&self.at, seconds, place);
        } else {
            self.emitter.act(&self.at, action, place);
        }
    }

    /// Plans moves without a standstill between them.
    fn run(&mut self, moves: &[&Move]) {
        let Some(last) = moves.last() else { return };
        self.at = last.path.to;
        let mut blocks = Vec::with_capacity(moves.len());
        for step in moves {
            match block::prepare(step, self.settings, self.model) {
                Ok(block) => blocks.push(block),
                Err(problem) => self.note(problem),
            }
        }
        if !self.problems.is_empty() {
            return;
        }
        let junctions = Junctions::of(&blocks, self.settings);
        let first_piece = self.trajectory.pieces.len();
        let mut time = self.emitter.time();
        for (index, block) in blocks.iter().enumerate() {
            time = self.lay(block, index, &junctions, time);
            if time > LONGEST_PLAN_S {
                let what = "at its feeds the program takes more than 100 hours up to here";
                let remedy = "write higher feeds, or divide the program";
                return self.note(Problem {
                    place: block.place,
                    what: what.into(),
                    remedy: remedy.into(),
                });
            }
        }
        self.emitter
            .run(&self.trajectory, &blocks, first_piece, time, self.model);
        let path = (self.trajectory.paths.len() - 1) as u32;
        let length = self.trajectory.paths[path as usize].1.length;
        self.trajectory.pieces.push(resting(time, path, length));
        for problem in std::mem::take(&mut self.emitter.problems) {
            self.note(problem);
        }
    }

    /// Adds the pieces of a block and the rounding at its end; returns the time of its end.
    fn lay(&mut self, block: &Block, index: usize, junctions: &Junctions, mut time: f64) -> f64 {
        let (into, out) = (junctions.speeds[index], junctions.speeds[index + 1]);
        let reach = [
            junctions.corners[index].reach(into),
            junctions.corners[index + 1].reach(out),
        ];
        let path = self.trajectory.paths.len() as u32;
        self.trajectory
            .paths
            .push((block.place, block.path.clone()));
        self.figures.path_length_mm += block.path.tip_length();
        self.figures.blocks += 1;

        let rounded = [index, index + 1].map(|junction| {
            let speed = junctions.speeds[junction];
            junctions.corners[junction]
                .change
                .iter()
                .any(|part| part.abs() * speed > NO_CORNER)
        });
        let mut phases = Vec::with_capacity(9);
        let steady = |length: f64, speed: f64| Phase {
            duration: length / speed,
            acceleration: 0.0,
            jerk: 0.0,
        };
        if reach[0] > 0.0 {
            phases.push(steady(reach[0], into));
        }
        let peak = block.along.phases(
            block.path.length - reach[0] - reach[1],
            into,
            out,
            &mut phases,
        );
        if reach[1] > 0.0 {
            phases.push(steady(reach[1], out));
        }
        if block.path.tip_length() > 0.0 {
            self.figures.peak_tip_mm_s = self.figures.peak_tip_mm_s.max(peak);
        }
        let is_arc = |path: &Path| path.arc.is_some();
        let bends = is_arc(&block.path)
            || self
                .trajectory
                .paths
                .iter()
                .rev()
                .nth(1)
                .is_some_and(|(_, path)| is_arc(path));
        let (mut s, mut speed) = (0.0, into);
        let last = phases.len() - 1;
        for (number, phase) in phases.iter().enumerate() {
            let Phase {
                duration,
                acceleration,
                jerk,
            } = *phase;
            let steady_before = self
                .trajectory
                .pieces
                .last()
                .is_some_and(|piece| piece.jerk == 0.0);
            // A rounding begins in the last phase of its block, has its middle between the blocks,
            // and ends in the first phase of the next block.
            let rounding = (rounded[0] && number <= 1) || (rounded[1] && number == last);
            let knot = if number == 0 && bends {
                Knot::Step
            } else if rounding || !steady_before || jerk != 0.0 {
                Knot::Jerk
            } else {
                Knot::None
            };
            self.trajectory.pieces.push(Piece {
                time,
                s,
                speed,
                acceleration,
                jerk,
                path,
                knot,
            });
            s += duration * (speed + duration * (0.5 * acceleration + duration * jerk / 6.0));
            speed += duration * (acceleration + 0.5 * duration * jerk);
            time += duration;
        }
        if rounded[1] {
            let change = junctions.corners[index + 1].change.map(|part| part * out);
            self.trajectory.bumps.push(Bump {
                time,
                half: reach[1] / out,
                change,
            });
        }
        time
    }

    fn finish(mut self) -> Result<Plan, Refused> {
        if self.emitter.setpoints.is_empty() {
            self.emitter.rest(
                &self.at,
                0.0,
                Place {
                    line: self.program.lines,
                    column: 1,
                    ..Place::default()
                },
            );
        }
        self.figures.duration_s = self.emitter.time();
        if !self.problems.is_empty() {
            self.problems.sort_by_key(|problem| problem.place);
            return Err(Refused {
                file: self.program.file.clone(),
                called: self.program.called.clone(),
                problems: self.problems,
                more: self.more,
            });
        }
        let mut plan = Plan {
            start: setpoints::quantise_pose(&self.program.start, self.settings),
            setpoints: self.emitter.setpoints,
            period_s: f64::from(self.settings.period_us) * 1e-6,
            figures: self.figures,
            places: self.emitter.places,
            trajectory: self.trajectory,
        };
        plan.figures.peak_joint_rates = plan.peak_joint_rates(self.model);
        Ok(plan)
    }
}

impl Plan {
    fn peak_joint_rates(&self, model: &impl MachineModel) -> [f64; 6] {
        let mut peak = [0.0f64; 6];
        let mut cursor = Cursor::default();
        let mut periods = 0u64;
        for setpoint in &self.setpoints {
            periods += u64::from(setpoint.periods);
            let (pose, rates) = self.intended(&mut cursor, periods as f64 * self.period_s);
            for (peak, rate) in peak.iter_mut().zip(model.joint_rates(&pose, &rates)) {
                *peak = peak.max(rate.abs());
            }
        }
        peak
    }
}

/// Returns the piece of a standstill at the end of a path.
fn resting(time: f64, path: u32, s: f64) -> Piece {
    Piece {
        time,
        s,
        speed: 0.0,
        acceleration: 0.0,
        jerk: 0.0,
        path,
        knot: Knot::None,
    }
}
