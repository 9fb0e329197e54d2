//! Operator trajectory: a path, and the speed that the operator would keep without resistance.
//!
//! Positions are those of the tip, in mm from its home, in the axes of the master's base. Times are
//! seconds since the trajectory was set. The path has no fixed timing: the perceived force reduces
//! the speed ([`crate::operator`]).

use crate::vector::{Vector, dot, length, minus, plus, times};
use core::f64::consts::{PI, TAU};
use serde::{Deserialize, Serialize};

/// Motion that the operator intends.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Trajectory {
    /// Hold the handle where it is.
    #[default]
    Hold,
    /// Move it along straight lines, one after the other.
    Strokes(Vec<Stroke>),
    /// Move the ball along the edge of a reference part.
    Trace(Trace),
    /// Follow a target that is set externally in every period.
    Live(Live),
}

/// A straight line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stroke {
    /// Earliest start, s; a stroke in progress ends first.
    pub at_s: f64,
    /// End point, mm.
    pub to_mm: [f64; 3],
    /// Speed without resistance, mm/s.
    pub pace_mm_s: f64,
    /// Parts of that speed in the four quarters of the line; an operator has slow places.
    #[serde(default = "even")]
    pub quarters: [f64; 4],
    /// Time from standstill to that speed, s.
    pub ramp_s: f64,
    /// Time from that speed to standstill, s; 0 is `ramp_s`.
    #[serde(default)]
    pub stop_s: f64,
}

impl Stroke {
    /// Acceleration and deceleration of the hand, mm/s^2.
    fn accelerations(&self) -> (f64, f64) {
        let stop_s = if self.stop_s > 0.0 {
            self.stop_s
        } else {
            self.ramp_s
        };
        (
            self.pace_mm_s / self.ramp_s.max(1e-3),
            self.pace_mm_s / stop_s.max(1e-3),
        )
    }
}

/// One or more rounds along the edge of a part, with a light contact force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trace {
    /// Earliest start, s; the hand holds until then.
    pub at_s: f64,
    /// Centre of the path, x and y, mm.
    pub centre_mm: [f64; 2],
    /// Radius that converts the position along the edge to an angle, mm. The part determines the
    /// real radius.
    pub radius_mm: f64,
    /// Number of rounds, counter-clockwise as seen from above; negative is clockwise.
    pub turns: f64,
    /// Speed without resistance, mm/s.
    pub pace_mm_s: f64,
    /// Parts of that speed in the four quarters of the path; an operator has slow places.
    #[serde(default = "even")]
    pub quarters: [f64; 4],
    /// Time from standstill to that speed, and back, s.
    pub ramp_s: f64,
    /// Contact force away from the centre, N; negative is towards it.
    pub press_n: f64,
}

/// The same speed in all quarters.
const fn even() -> [f64; 4] {
    [1.0; 4]
}

/// Externally set target of the tip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Live {
    /// Position, mm.
    pub place_mm: [f64; 3],
    /// Velocity of the position, mm/s.
    pub velocity_mm_s: [f64; 3],
    /// The enabling switch on the handle is pressed.
    pub enabling_switch: bool,
}

/// Desired motion at one time.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct IntendedMotion {
    /// Position of the tip from home, mm.
    pub place: Vector,
    /// Velocity of that position, mm/s.
    pub velocity: Vector,
    /// Unit vector of the path; 0 at standstill.
    pub along: Vector,
    /// Direction in which the hand controls the force instead of the position, and that force, N.
    pub press: Option<(Vector, f64)>,
    /// The trajectory is complete.
    pub done: bool,
}

/// A trajectory in progress.
#[derive(Debug, Clone)]
pub struct Carried {
    trajectory: Trajectory,
    time: f64,
    /// Number of completed strokes.
    index: usize,
    /// Start of the present stroke, mm.
    start: Vector,
    /// Desired position, mm.
    place: Vector,
    speed: f64,
    /// Start angle of a trace, and angle covered so far, rad.
    angle: f64,
    turned: f64,
}

/// Speed for the remaining path: at most `limit`, slow enough to stop in time, and within the
/// limits of acceleration and deceleration.
fn paced(speed: f64, limit: f64, remaining: f64, (up, down): (f64, f64), dt: f64) -> f64 {
    let stopping = libm::sqrt(2.0 * down * remaining);
    limit
        .clamp(speed - down * dt, speed + up * dt)
        .min(stopping)
}

/// Quarter of a path that a part of it, 0 to 1, is in.
const fn quarter(part: f64) -> usize {
    let quarter = (4.0 * part) as usize;
    if quarter > 3 { 3 } else { quarter }
}

impl Carried {
    /// Starts a trajectory with the tip at a position.
    pub fn new(trajectory: Trajectory, tip: Vector) -> Self {
        let angle = match &trajectory {
            Trajectory::Trace(trace) => {
                libm::atan2(tip[1] - trace.centre_mm[1], tip[0] - trace.centre_mm[0])
            }
            _ => 0.0,
        };
        Self {
            trajectory,
            time: 0.0,
            index: 0,
            start: tip,
            place: tip,
            speed: 0.0,
            angle,
            turned: 0.0,
        }
    }

    /// The trajectory.
    pub const fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Sets the target of a live trajectory; no effect on others.
    pub const fn live(&mut self, live: Live) {
        if let Trajectory::Live(target) = &mut self.trajectory {
            *target = live;
        }
    }

    /// Advances by one period of `dt` seconds. `pace` is the fraction of the speed that is kept (1
    /// all, 0 none); the tip is at `tip`.
    pub fn advance(&mut self, dt: f64, pace: f64, tip: Vector) -> IntendedMotion {
        self.time += dt;
        let still = IntendedMotion {
            place: self.place,
            ..IntendedMotion::default()
        };
        match &self.trajectory {
            Trajectory::Hold => IntendedMotion {
                done: true,
                ..still
            },
            Trajectory::Live(live) => {
                self.place = live.place_mm;
                let speed = length(live.velocity_mm_s);
                IntendedMotion {
                    place: live.place_mm,
                    velocity: live.velocity_mm_s,
                    along: match speed > 1e-3 {
                        true => times(live.velocity_mm_s, 1.0 / speed),
                        false => [0.0; 3],
                    },
                    ..IntendedMotion::default()
                }
            }
            Trajectory::Strokes(strokes) => {
                let Some(stroke) = strokes.get(self.index) else {
                    return IntendedMotion {
                        done: true,
                        ..still
                    };
                };
                if self.time < stroke.at_s {
                    return still;
                }
                let unit_direction = minus(stroke.to_mm, self.place);
                let remaining = length(unit_direction);
                if remaining < 1e-6 {
                    self.place = stroke.to_mm;
                    self.start = self.place;
                    self.speed = 0.0;
                    self.index += 1;
                    return still;
                }
                let whole = length(minus(stroke.to_mm, self.start));
                let part = 1.0 - (remaining / whole).min(1.0);
                let limit = stroke.pace_mm_s * stroke.quarters[quarter(part)] * pace;
                self.speed = paced(self.speed, limit, remaining, stroke.accelerations(), dt);
                let along = times(unit_direction, 1.0 / remaining);
                let step = (self.speed * dt).min(remaining).max(remaining.min(1e-9));
                self.place = plus(self.place, times(along, step));
                IntendedMotion {
                    place: self.place,
                    velocity: times(along, self.speed),
                    along,
                    ..IntendedMotion::default()
                }
            }
            Trajectory::Trace(trace) => self.trace(*trace, dt, pace, tip),
        }
    }

    fn trace(&mut self, trace: Trace, dt: f64, pace: f64, tip: Vector) -> IntendedMotion {
        let [x, y] = trace.centre_mm;
        let outwards = [tip[0] - x, tip[1] - y, 0.0];
        let distance = length(outwards);
        let press = (distance > 1e-6).then(|| (times(outwards, 1.0 / distance), trace.press_n));
        let side = if trace.turns < 0.0 { -1.0 } else { 1.0 };
        let remaining = ((trace.turns.abs() * TAU) - self.turned) * trace.radius_mm;
        let done = remaining < 1e-6;
        if self.time >= trace.at_s && !done {
            let acceleration = trace.pace_mm_s / trace.ramp_s.max(1e-3);
            let part = self.turned / (trace.turns.abs() * TAU);
            let limit = trace.pace_mm_s * trace.quarters[quarter(part)] * pace;
            let limits = (acceleration, acceleration);
            self.speed = paced(self.speed, limit, remaining, limits, dt);
            let step = (self.speed * dt).min(remaining).max(remaining.min(1e-9));
            self.turned += step / trace.radius_mm;
        } else {
            self.speed = 0.0;
        }
        let (sin, cos) = libm::sincos(self.angle + side * self.turned);
        self.place[0] = x + trace.radius_mm * cos;
        self.place[1] = y + trace.radius_mm * sin;
        let along = [-side * sin, side * cos, 0.0];
        let moving = self.speed > 0.0;
        IntendedMotion {
            place: self.place,
            velocity: times(along, self.speed),
            along: if moving { along } else { [0.0; 3] },
            press,
            done,
        }
    }

    /// Angle that a trace has covered, degrees.
    pub fn turned_deg(&self) -> f64 {
        self.turned * 180.0 / PI
    }
}

/// Part of a vector perpendicular to a unit vector.
pub(super) fn without(vector: Vector, unit: Vector) -> Vector {
    minus(vector, times(unit, dot(vector, unit)))
}
