//! Setpoints: samples of the trajectory on whole control periods, in protocol units.

use super::block::{Block, check_pose};
use super::limits::{MachineModel, Settings};
use super::trajectory::{Cursor, Knot, Piece, Trajectory};
use haptimill_gcode::{AxisKind, Coordinates, Place, Problem};
use haptimill_protocol::message::{Action, AxisValues, RATE_SHIFT};
use haptimill_protocol::setpoint::Setpoint;

/// Largest deviation of the cubic between setpoints from the trajectory: mm, degrees.
const CUBIC_ERROR_MM: f64 = 1e-4;
/// Longest standstill in one setpoint, periods.
const LONGEST_REST: u64 = 60_000;

/// Returns the axis units per mm or degree.
fn units(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => 1_048_576.0,
        AxisKind::Rotary => 4_294_967_296.0 / 360.0,
    }
}

/// Rounds a pose to axis units.
pub(crate) fn quantise_pose(pose: &Coordinates, settings: &Settings) -> AxisValues {
    // Checked poses are within the range of i32; half a turn wraps around.
    settings
        .pose
        .iter()
        .zip(pose)
        .map(|(axis, value)| (value * units(axis.kind)).round() as i64 as i32)
        .collect()
}

fn quantise_rates(rates: &Coordinates, settings: &Settings) -> AxisValues {
    let scale = f64::from(1u32 << RATE_SHIFT);
    settings
        .pose
        .iter()
        .zip(rates)
        .map(|(axis, rate)| (rate * units(axis.kind) / scale).round() as i32)
        .collect()
}

/// Makes setpoints while the trajectory grows.
pub(crate) struct Emitter<'a> {
    settings: &'a Settings,
    period: f64,
    cursor: Cursor,
    /// Period of the last setpoint.
    last: u64,
    pub setpoints: Vec<Setpoint>,
    /// Place of each setpoint in the program.
    pub places: Vec<Place>,
    /// Problems of setpoints.
    pub problems: Vec<Problem>,
}

impl<'a> Emitter<'a> {
    pub(crate) fn new(settings: &'a Settings) -> Self {
        Self {
            settings,
            period: f64::from(settings.period_us) * 1e-6,
            cursor: Cursor::default(),
            last: 0,
            setpoints: Vec::new(),
            places: Vec::new(),
            problems: Vec::new(),
        }
    }

    /// Returns the time of the last setpoint, seconds.
    pub(crate) fn time(&self) -> f64 {
        self.last as f64 * self.period
    }

    fn push(&mut self, at: u64, pose: &Coordinates, rates: &Coordinates, place: Place) {
        let setpoint = Setpoint {
            // Durations are at most the longest standstill.
            periods: (at - self.last) as u16,
            pose: quantise_pose(pose, self.settings),
            rates: quantise_rates(rates, self.settings),
            action: Action::None,
        };
        self.setpoints.push(setpoint);
        self.places.push(place);
        self.last = at;
    }

    /// Adds a standstill of at least one period.
    pub(crate) fn rest(&mut self, pose: &Coordinates, seconds: f64, place: Place) {
        let mut left = ((seconds / self.period).round() as u64).max(1);
        while left > 0 {
            let now = left.min(LONGEST_REST);
            self.push(self.last + now, pose, &[0.0; 6], place);
            left -= now;
        }
    }

    /// Adds an action at standstill: to the last setpoint if it has none, otherwise to a new one.
    pub(crate) fn act(&mut self, pose: &Coordinates, action: Action, place: Place) {
        if self
            .setpoints
            .last()
            .is_none_or(|setpoint| setpoint.action != Action::None)
        {
            self.rest(pose, 0.0, place);
        }
        if let Some(setpoint) = self.setpoints.last_mut() {
            setpoint.action = action;
        }
    }

    /// Adds the setpoints of a run of motion from the last setpoint to the standstill at `end`.
    pub(crate) fn run(
        &mut self,
        trajectory: &Trajectory,
        blocks: &[Block],
        first_piece: usize,
        end: f64,
        model: &impl MachineModel,
    ) {
        let begin = self.last;
        let end = ((end / self.period).ceil() as u64).max(begin + 1);
        let shortest = (self.settings.shortest_span_s / self.period).round() as u64;
        let pieces = &trajectory.pieces[first_piece..];
        let first_path = pieces.first().map_or(0, |piece| piece.path);

        // A setpoint is at every knot, at least the shortest duration apart; a step of acceleration
        // has priority over a change of jerk.
        let mut knots: Vec<(u64, Knot)> = vec![(begin, Knot::Step)];
        for piece in pieces
            .iter()
            .skip(1)
            .filter(|piece| piece.knot != Knot::None)
        {
            let at = (piece.time / self.period).round() as u64;
            let (last, kind) = knots[knots.len() - 1];
            if at + shortest > end {
                continue;
            }
            if at >= last + shortest {
                knots.push((at, piece.knot));
            } else if piece.knot == Knot::Step && kind == Knot::Jerk && at > last {
                knots.pop();
                if at > knots[knots.len() - 1].0 {
                    knots.push((at, piece.knot));
                }
            }
        }
        knots.push((end, Knot::Step));

        let mut index = 0;
        for pair in knots.windows(2) {
            let (from, to) = (pair[0].0, pair[1].0);
            // The shortest of the durations that the pieces allow.
            let mut span = self.settings.longest_span_s;
            while let Some(piece) = pieces.get(index) {
                let block = &blocks[(piece.path - first_path) as usize];
                let next = pieces
                    .get(index + 1)
                    .map_or(end as f64 * self.period, |next| next.time);
                span = span.min(longest_on(piece, next - piece.time, block));
                if next > to as f64 * self.period || index + 1 == pieces.len() {
                    break;
                }
                index += 1;
            }
            self.subdivide(trajectory, from, to, span, to == end, model);
        }
    }

    fn subdivide(
        &mut self,
        trajectory: &Trajectory,
        from: u64,
        to: u64,
        span: f64,
        at_rest: bool,
        model: &impl MachineModel,
    ) {
        let periods = to - from;
        let most = ((span / self.period).floor() as u64).clamp(1, LONGEST_REST);
        let count = periods.div_ceil(most);
        for index in 1..=count {
            let start = from + periods * (index - 1) / count;
            let at = from + periods * index / count;
            self.join(trajectory, start, at, at_rest && index == count, model);
        }
    }

    /// Adds one segment, or two halves if its cubic deviates from the trajectory because of an
    /// omitted knot.
    fn join(
        &mut self,
        trajectory: &Trajectory,
        from: u64,
        to: u64,
        at_rest: bool,
        model: &impl MachineModel,
    ) {
        let shortest = (self.settings.shortest_span_s / self.period).round() as u64;
        if to - from >= 2 * shortest.max(1) && !self.is_near(trajectory, from, to) {
            let middle = from + (to - from) / 2;
            self.join(trajectory, from, middle, false, model);
            self.join(trajectory, middle, to, at_rest, model);
            return;
        }
        let time = to as f64 * self.period;
        let (mut pose, mut rates) = trajectory.intended(&mut self.cursor, time);
        // Place of the motion towards the setpoint; a setpoint at a corner may be up to a period
        // late.
        let piece = trajectory.seek(&mut self.cursor, time - self.period);
        let (place, path) = &trajectory.paths[piece.map_or(0, |piece| piece.path as usize)];
        let place = *place;
        if at_rest {
            // The exact end, without the rounding errors of the phases.
            (pose, rates) = (path.to, [0.0; 6]);
        }
        if let Err((what, remedy)) = check_pose(&pose, self.settings, model) {
            self.problems.push(Problem {
                place,
                what,
                remedy,
            });
        }
        self.push(to, &pose, &rates, place);
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

/// Returns the longest segment duration on a piece for which the cubic stays near its arc.
fn longest_on(piece: &Piece, duration: f64, block: &Block) -> f64 {
    let fastest = piece
        .speed
        .max(piece.speed + duration * (piece.acceleration + 0.5 * duration * piece.jerk));
    let acceleration = piece
        .acceleration
        .abs()
        .max((piece.acceleration + duration * piece.jerk).abs());
    let curvature = block.fourth_derivative(fastest, acceleration, piece.jerk.abs());
    // Error of a cubic Hermite segment: T^4 / 384 times the fourth derivative.
    if curvature > 0.0 {
        libm::sqrt(libm::sqrt(384.0 * CUBIC_ERROR_MM / curvature))
    } else {
        f64::INFINITY
    }
}
