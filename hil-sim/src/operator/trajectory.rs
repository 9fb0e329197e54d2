//! What the person means to do with the handle: a way, and a pace that the person would keep if nothing resisted.
//!
//! Places are those of the tip, in mm from its home, in the axes of the master's base. Times are seconds since the intention was formed. An intention is no trajectory in time:
//! the pace is slowed by what the hand feels ([`crate::operator`]), so the way takes as long as it takes.

use crate::vector::{Vector, dot, length, minus, plus, times};
use core::f64::consts::{PI, TAU};
use serde::{Deserialize, Serialize};

/// What the person means to do.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Trajectory {
    /// To hold the handle where it is.
    #[default]
    Hold,
    /// To move it along straight lines, one after the other.
    Strokes(Vec<Stroke>),
    /// To lead the ball round along the edge of a reference part.
    Trace(Trace),
    /// What is said from outside, anew in every period.
    Live(Live),
}

/// A straight line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stroke {
    /// Not before this time; a stroke that still goes on is ended first.
    pub at_s: f64,
    /// Where to.
    pub to_mm: [f64; 3],
    /// The pace without resistance, mm/s.
    pub pace_mm_s: f64,
    /// Time from standstill to that pace, and back, s.
    pub ramp_s: f64,
}

/// Once (or more) round the edge of a part, pressing lightly against it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trace {
    /// Not before this time; until then the hand holds.
    pub at_s: f64,
    /// The middle, x and y.
    pub centre_mm: [f64; 2],
    /// Radius that the hand has in mind: what its place along the edge is told by. The part decides the real one.
    pub radius_mm: f64,
    /// Turns, counter-clockwise as seen from above; negative the other way round.
    pub turns: f64,
    /// The pace without resistance, mm/s.
    pub pace_mm_s: f64,
    /// Time from standstill to that pace, and back, s.
    pub ramp_s: f64,
    /// How hard the hand presses away from the middle (negative: towards it), N.
    pub press_n: f64,
}

/// Where somebody outside wants the tip at this moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Live {
    /// The place.
    pub place_mm: [f64; 3],
    /// How fast it moves, mm/s.
    pub velocity_mm_s: [f64; 3],
    /// The button on the handle is held.
    pub engaged: bool,
}

/// What the person wants at a moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DesiredMotion {
    /// Place of the tip from home, mm.
    pub place: Vector,
    /// Velocity of that place, mm/s.
    pub velocity: Vector,
    /// Unit vector of the way; 0 at rest.
    pub along: Vector,
    /// A direction in which the hand presses instead of minding the place, and the force in it, N.
    pub press: Option<(Vector, f64)>,
    /// The way that was meant is done.
    pub done: bool,
}

/// An intention while it is carried out.
#[derive(Debug, Clone)]
pub struct Carried {
    trajectory: Trajectory,
    time: f64,
    /// Strokes that are done.
    index: usize,
    /// Where the wish stands.
    place: Vector,
    speed: f64,
    /// Angle at which a trace began, and how far it has come, rad.
    angle: f64,
    turned: f64,
}

/// Speed for the remaining way: no more than `limit`, slow enough to stop in time, changed by no more than the acceleration allows.
fn paced(speed: f64, limit: f64, remaining: f64, acceleration: f64, dt: f64) -> f64 {
    let stopping = libm::sqrt(2.0 * acceleration * remaining);
    let change = acceleration * dt;
    limit.clamp(speed - change, speed + change).min(stopping)
}

impl Carried {
    /// An intention formed with the tip at a place.
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
            place: tip,
            speed: 0.0,
            angle,
            turned: 0.0,
        }
    }

    /// The intention.
    pub const fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Says anew what is wanted, when the intention is a live one.
    pub const fn live(&mut self, live: Live) {
        if let Trajectory::Live(said) = &mut self.trajectory {
            *said = live;
        }
    }

    /// One period of `dt` seconds: `pace` of the speed is kept (1 all, 0 none), the tip is at `tip`.
    pub fn advance(&mut self, dt: f64, pace: f64, tip: Vector) -> DesiredMotion {
        self.time += dt;
        let still = DesiredMotion {
            place: self.place,
            ..DesiredMotion::default()
        };
        match &self.trajectory {
            Trajectory::Hold => DesiredMotion {
                done: true,
                ..still
            },
            Trajectory::Live(live) => {
                self.place = live.place_mm;
                let speed = length(live.velocity_mm_s);
                DesiredMotion {
                    place: live.place_mm,
                    velocity: live.velocity_mm_s,
                    along: match speed > 1e-3 {
                        true => times(live.velocity_mm_s, 1.0 / speed),
                        false => [0.0; 3],
                    },
                    ..DesiredMotion::default()
                }
            }
            Trajectory::Strokes(strokes) => {
                let Some(stroke) = strokes.get(self.index) else {
                    return DesiredMotion {
                        done: true,
                        ..still
                    };
                };
                if self.time < stroke.at_s {
                    return still;
                }
                let way = minus(stroke.to_mm, self.place);
                let remaining = length(way);
                if remaining < 1e-6 {
                    self.place = stroke.to_mm;
                    self.speed = 0.0;
                    self.index += 1;
                    return still;
                }
                let acceleration = stroke.pace_mm_s / stroke.ramp_s.max(1e-3);
                let limit = stroke.pace_mm_s * pace;
                self.speed = paced(self.speed, limit, remaining, acceleration, dt);
                let along = times(way, 1.0 / remaining);
                let step = (self.speed * dt).min(remaining).max(remaining.min(1e-9));
                self.place = plus(self.place, times(along, step));
                DesiredMotion {
                    place: self.place,
                    velocity: times(along, self.speed),
                    along,
                    ..DesiredMotion::default()
                }
            }
            Trajectory::Trace(trace) => self.trace(*trace, dt, pace, tip),
        }
    }

    fn trace(&mut self, trace: Trace, dt: f64, pace: f64, tip: Vector) -> DesiredMotion {
        let [x, y] = trace.centre_mm;
        let outwards = [tip[0] - x, tip[1] - y, 0.0];
        let distance = length(outwards);
        let press = (distance > 1e-6).then(|| (times(outwards, 1.0 / distance), trace.press_n));
        let side = if trace.turns < 0.0 { -1.0 } else { 1.0 };
        let remaining = ((trace.turns.abs() * TAU) - self.turned) * trace.radius_mm;
        let done = remaining < 1e-6;
        if self.time >= trace.at_s && !done {
            let acceleration = trace.pace_mm_s / trace.ramp_s.max(1e-3);
            let limit = trace.pace_mm_s * pace;
            self.speed = paced(self.speed, limit, remaining, acceleration, dt);
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
        DesiredMotion {
            place: self.place,
            velocity: times(along, self.speed),
            along: if moving { along } else { [0.0; 3] },
            press,
            done,
        }
    }

    /// How far a trace has come, degrees.
    pub fn turned_deg(&self) -> f64 {
        self.turned * 180.0 / PI
    }
}

/// What is left of a vector without its part along a unit vector.
pub(super) fn without(vector: Vector, unit: Vector) -> Vector {
    minus(vector, times(unit, dot(vector, unit)))
}
