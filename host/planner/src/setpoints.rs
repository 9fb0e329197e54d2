//! Setpoints: samples of the trajectory on whole control periods, in protocol units.

use super::block::check_motion;
use super::limits::{MachineModel, Settings};
use super::override_mode::ModeFinder;
use super::trajectory::{CUBIC_ERROR_MM, Cursor, Knot, Trajectory};
use haptimill_gcode::{Coordinates, Place, Problem, ToolLength};
use haptimill_protocol::message::{Action, AxisValues, OverrideMode, RATE_SHIFT};
use haptimill_protocol::setpoint::Setpoint;
use std::collections::VecDeque;

/// A setpoint with its place in the program.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Setpoint.
    pub setpoint: Setpoint,
    /// Place of the motion towards it.
    pub place: Place,
    /// Whether that is a rapid move; true for a standstill.
    pub is_rapid: bool,
    /// Tool that makes the pose of the tip from that of the setpoint.
    pub tool: ToolLength,
    /// Number of messages of the program before that motion.
    pub(crate) messages: u32,
}

/// Longest standstill in one setpoint, periods.
const LONGEST_REST: u64 = 60_000;

/// Rounds a pose to axis units.
pub(crate) fn quantise_pose(pose: &Coordinates, settings: &Settings) -> AxisValues {
    // Checked poses are within the range of i32; half a turn wraps around.
    settings
        .pose
        .iter()
        .zip(pose)
        .map(|(axis, value)| (value * axis.units).round() as i64 as i32)
        .collect()
}

fn quantise_rates(rates: &Coordinates, settings: &Settings) -> AxisValues {
    let scale = f64::from(1u32 << RATE_SHIFT);
    settings
        .pose
        .iter()
        .zip(rates)
        .map(|(axis, rate)| (rate * axis.units / scale).round() as i32)
        .collect()
}

/// Makes setpoints while the trajectory grows.
#[derive(Debug)]
pub(crate) struct Emitter {
    period: f64,
    /// Shortest segment, periods.
    shortest: u64,
    cursor: Cursor,
    /// Period of the last setpoint.
    last: u64,
    /// Period in which the run of motion begins.
    begin: u64,
    /// Knots of the run from the last setpoint on.
    knots: VecDeque<(u64, Knot)>,
    /// First piece whose knot was not looked at, and the piece at the last setpoint.
    next_piece: usize,
    span_piece: usize,
    mode_finder: ModeFinder,
    /// Override mode behind the setpoint before the last one.
    override_mode: OverrideMode,
    /// How far the trajectory is known, and whether the motion stops there.
    known: (f64, bool),
    /// Setpoints that are made.
    pub made: Vec<Planned>,
    /// Their number since the start.
    pub count: usize,
    /// Number of messages of the program before the next one.
    pub messages: u32,
    /// Tool of the run of motion.
    pub tool: ToolLength,
    /// Largest rate of each joint at the setpoints.
    pub peak_joint_rates: [f64; 6],
}

impl Emitter {
    pub(crate) fn new(settings: &Settings) -> Self {
        let period = f64::from(settings.period_us) * 1e-6;
        Self {
            period,
            shortest: (settings.shortest_span_s / period).round() as u64,
            cursor: Cursor::default(),
            last: 0,
            begin: 0,
            knots: VecDeque::new(),
            next_piece: 0,
            span_piece: 0,
            mode_finder: ModeFinder::new(settings.braking_s[0], settings.braking_s[1]),
            override_mode: OverrideMode::FEED,
            known: (0.0, false),
            made: Vec::new(),
            count: 0,
            messages: 0,
            tool: ToolLength::default(),
            peak_joint_rates: [0.0; 6],
        }
    }

    /// Returns the time of the last setpoint, seconds.
    pub(crate) fn time(&self) -> f64 {
        self.last as f64 * self.period
    }

    fn push(
        &mut self,
        at: u64,
        pose: &Coordinates,
        rates: &Coordinates,
        (place, is_rapid): (Place, bool),
        settings: &Settings,
    ) {
        let setpoint = Setpoint {
            // Durations are at most the longest standstill.
            periods: (at - self.last) as u16,
            pose: quantise_pose(pose, settings),
            rates: quantise_rates(rates, settings),
            action: Action::None,
        };
        self.made.push(Planned {
            setpoint,
            place,
            is_rapid,
            tool: self.tool,
            messages: self.messages,
        });
        self.count += 1;
        self.last = at;
    }

    /// Adds a standstill of at least one period.
    pub(crate) fn rest(
        &mut self,
        pose: &Coordinates,
        seconds: f64,
        place: Place,
        settings: &Settings,
    ) {
        let mut left = ((seconds / self.period).round() as u64).max(1);
        while left > 0 {
            let now = left.min(LONGEST_REST);
            self.push(self.last + now, pose, &[0.0; 6], (place, true), settings);
            left -= now;
        }
    }

    /// Adds an action at standstill: to the last setpoint if it has none, otherwise to a new one.
    /// The last setpoint must not be taken before.
    pub(crate) fn act(
        &mut self,
        pose: &Coordinates,
        action: Action,
        place: Place,
        settings: &Settings,
    ) {
        let last = self.made.last();
        if last.is_none_or(|planned| planned.setpoint.action != Action::None) {
            self.rest(pose, 0.0, place, settings);
        }
        if let Some(planned) = self.made.last_mut() {
            planned.setpoint.action = action;
        }
    }

    /// Begins a run of motion at a pose, whose pieces follow those of the trajectory; returns its
    /// time.
    pub(crate) fn begin(
        &mut self,
        trajectory: &Trajectory,
        slows: bool,
        pose: &Coordinates,
        settings: &Settings,
    ) -> f64 {
        // The override mode of the run is the action of the last setpoint. If that has another
        // action, the override mode changes at the first setpoint of the run; a move at feed that
        // `slows` after a rapid move must not begin like one.
        let last = self.made.last();
        if slows && last.is_none_or(|last| last.setpoint.action != Action::None) {
            let place = last.map_or_else(Place::default, |last| last.place);
            self.rest(pose, 0.0, place, settings);
        }
        self.mode_finder.begin(trajectory.pieces.len());
        self.begin = self.last;
        self.knots.clear();
        self.knots.push_back((self.last, Knot::Step));
        self.next_piece = trajectory.pieces.len() + 1;
        self.span_piece = trajectory.pieces.len();
        self.time()
    }

    /// Follows [`Trajectory::discard`], which removed so many pieces.
    pub(crate) fn discard(&mut self, pieces: usize) {
        self.next_piece = self.next_piece.saturating_sub(pieces);
        self.span_piece = self.span_piece.saturating_sub(pieces);
        self.mode_finder.discard(pieces);
        self.cursor = Cursor::default();
    }

    /// Returns the period of the standstill at the end of a run.
    fn end_of_run(&self, time: f64) -> u64 {
        ((time / self.period).ceil() as u64).max(self.begin + 1)
    }

    /// Ends a run of motion without its setpoints.
    pub(crate) fn skip(&mut self, time: f64, pose: &Coordinates, settings: &Settings) {
        let end = self.end_of_run(time);
        let nowhere = (Place::default(), true);
        self.push(end, pose, &[0.0; 6], nowhere, settings);
    }

    /// Adds the setpoints of the run of motion as far as the trajectory goes, up to `time`; at its
    /// `end`, up to its standstill.
    ///
    /// # Errors
    ///
    /// Returns the first setpoint that the machine cannot reach.
    pub(crate) fn advance(
        &mut self,
        trajectory: &Trajectory,
        time: f64,
        is_end: bool,
        settings: &Settings,
        model: &impl MachineModel,
    ) -> Result<(), Problem> {
        let end = if is_end {
            self.end_of_run(time)
        } else {
            (time / self.period).floor() as u64
        };
        self.known = (time, is_end);
        self.add_knots(trajectory, end, is_end);
        let ahead = if is_end { 2 } else { 3 };
        let mut result = Ok(());
        while self.knots.len() >= ahead {
            let (from, to) = (self.knots[0].0, self.knots[1].0);
            self.knots.pop_front();
            let to_s = to as f64 * self.period;
            // The shortest of the durations that the pieces allow.
            let mut span = settings.longest_span_s;
            while let Some(piece) = trajectory.pieces.get(self.span_piece) {
                span = span.min(piece.longest);
                let next = trajectory.pieces.get(self.span_piece + 1);
                if next.is_none_or(|next| next.time > to_s) {
                    break;
                }
                self.span_piece += 1;
            }
            let at_rest = is_end && to == end;
            let made = self.subdivide(trajectory, [from, to], span, at_rest, settings, model);
            result = result.and(made);
        }
        result
    }

    /// A setpoint is at every knot, at least the shortest duration apart; a step of acceleration
    /// has priority over a change of jerk. The last knot may still move.
    fn add_knots(&mut self, trajectory: &Trajectory, end: u64, is_end: bool) {
        while let Some(piece) = trajectory.pieces.get(self.next_piece) {
            let at = (piece.time / self.period).round() as u64;
            let is_near_end = at + self.shortest > end;
            if is_near_end && !is_end {
                return;
            }
            self.next_piece += 1;
            let Some(&(last, kind)) = self.knots.back() else {
                return;
            };
            if piece.knot == Knot::None || is_near_end {
                continue;
            }
            if at >= last + self.shortest {
                self.knots.push_back((at, piece.knot));
            } else if piece.knot == Knot::Step && kind == Knot::Jerk && at > last {
                self.knots.pop_back();
                if self.knots.back().is_some_and(|(before, _)| at > *before) {
                    self.knots.push_back((at, piece.knot));
                }
            }
        }
        if is_end {
            self.knots.push_back((end, Knot::Step));
        }
    }

    fn subdivide(
        &mut self,
        trajectory: &Trajectory,
        [from, to]: [u64; 2],
        span: f64,
        at_rest: bool,
        settings: &Settings,
        model: &impl MachineModel,
    ) -> Result<(), Problem> {
        let periods = to - from;
        let max = ((span / self.period).floor() as u64).clamp(1, LONGEST_REST);
        let count = periods.div_ceil(max);
        let mut result = Ok(());
        for index in 1..=count {
            let start = from + periods * (index - 1) / count;
            let at = from + periods * index / count;
            let at_rest = at_rest && index == count;
            let made = self.join(trajectory, [start, at], at_rest, settings, model);
            result = result.and(made);
        }
        result
    }

    /// Adds one segment, or two halves if its cubic deviates from the trajectory because of an
    /// omitted knot.
    fn join(
        &mut self,
        trajectory: &Trajectory,
        [from, to]: [u64; 2],
        at_rest: bool,
        settings: &Settings,
        model: &impl MachineModel,
    ) -> Result<(), Problem> {
        if to - from >= 2 * self.shortest.max(1) && !self.is_near(trajectory, from, to) {
            let middle = from + (to - from) / 2;
            let first = self.join(trajectory, [from, middle], false, settings, model);
            let second = self.join(trajectory, [middle, to], at_rest, settings, model);
            return first.and(second);
        }
        let time = to as f64 * self.period;
        let (mut pose, mut rates) = trajectory.intended(&mut self.cursor, time);
        // Place of the motion towards the setpoint; a setpoint at a corner may be up to a period
        // late.
        let before = time - self.period;
        let piece = trajectory.seek(&mut self.cursor, before);
        let (path, s) = piece.map_or((0, 0.0), |piece| {
            (piece.path, piece.along(before - piece.time).0)
        });
        let leg = trajectory.leg(path);
        let place = leg.place_at(s);
        if at_rest {
            // The exact end, without the rounding errors of the phases.
            (pose, rates) = (leg.tool.machine_pose(&leg.path.to), [0.0; 6]);
        }
        let checked = check_motion(&pose, &rates, settings, model);
        if let Ok(joint_rates) = &checked {
            for (peak, rate) in self.peak_joint_rates.iter_mut().zip(joint_rates) {
                *peak = peak.max(rate.abs());
            }
        }
        let is_rapid = leg.is_rapid;
        self.messages = leg.messages;
        let is_fixed = leg.is_fixed;
        self.set_override_mode(trajectory, [from, to], is_fixed);
        self.push(to, &pose, &rates, (place, is_rapid), settings);
        checked.map(|_| ()).map_err(|(what, remedy)| Problem {
            place,
            what,
            remedy,
        })
    }

    /// Sets the override mode of the motion between two periods, as the action of the last
    /// setpoint. An action that is there has priority: the override mode changes one setpoint
    /// later.
    fn set_override_mode(&mut self, trajectory: &Trajectory, span: [u64; 2], is_fixed: bool) {
        let span = span.map(|period| period as f64 * self.period);
        let of_overrides = self
            .mode_finder
            .mode(trajectory, span, self.known, self.period);
        let mode = if is_fixed {
            OverrideMode::FIXED
        } else {
            of_overrides
        };
        if mode == self.override_mode {
            return;
        }
        if let Some(last) = self.made.last_mut()
            && last.setpoint.action == Action::None
        {
            last.setpoint.action = Action::OverrideMode(mode);
            self.override_mode = mode;
        }
    }

    /// Whether the cubic between two periods is near the trajectory, at seven samples.
    fn is_near(&mut self, trajectory: &Trajectory, from: u64, to: u64) -> bool {
        let (start, t) = (from as f64 * self.period, (to - from) as f64 * self.period);
        let (p0, v0) = trajectory.intended(&mut self.cursor, start);
        let (p1, v1) = trajectory.intended(&mut self.cursor, start + t);
        (1..8).all(|part| {
            let u = f64::from(part) / 8.0;
            let (u2, u3) = (u * u, u * u * u);
            let (pose, _) = trajectory.intended(&mut self.cursor, start + u * t);
            (0..6).all(|k| {
                let cubic = (2.0 * u3 - 3.0 * u2 + 1.0) * p0[k]
                    + (u3 - 2.0 * u2 + u) * t * v0[k]
                    + (3.0 * u2 - 2.0 * u3) * p1[k]
                    + (u3 - u2) * t * v1[k];
                (cubic - pose[k]).abs() <= CUBIC_ERROR_MM
            })
        })
    }
}
