//! Cutter compensation (G41, G42): moves the path sideways by the radius of the cutter.
//!
//! The first move leads to a point beside its end. Afterwards each move is shifted sideways. At an
//! outside corner an arc about the corner joins the shifted moves; at an inside corner they are cut
//! at their intersection. For that, the last move is held until the next one is known.

use super::canonical::Step;
use super::output::{Leg, Output};
use super::path::Arc;
use super::tool_table::PerLetter;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Angle up to which a corner is passed straight, radians, as LinuxCNC does.
const SMOOTH: f64 = 0.05;

/// Longest run of moves without motion in the plane, and of other steps, that are held.
const MAX_HELD: usize = 1000;

/// Problem and remedy.
type Refusal = (String, String);

/// A move, or another step, that is held back.
#[derive(Debug)]
enum Held {
    Leg(Leg),
    Step(Step),
}

/// Compensation in force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Active {
    /// 1 left of the path (G41), -1 right (G42).
    pub side: f64,
    /// Radius of the cutter, mm.
    pub radius: f64,
    /// Axes of the plane: indices of X, Y, Z.
    pub plane: [usize; 2],
    /// Whether no move was compensated yet.
    pub is_first: bool,
    /// Programmed end of the last move, in the plane.
    programmed: [f64; 2],
    /// Direction of the last move at its end, radians.
    direction: f64,
}

impl Active {
    pub(crate) fn new(side: f64, radius: f64, plane: [usize; 2]) -> Self {
        Self {
            side,
            radius,
            plane,
            is_first: true,
            programmed: [0.0; 2],
            direction: 0.0,
        }
    }

    /// Returns the point beside `point`, for a motion in a direction.
    fn beside(&self, point: [f64; 2], direction: f64) -> [f64; 2] {
        let (sin, cos) = libm::sincos(direction + self.side * FRAC_PI_2);
        [point[0] + self.radius * cos, point[1] + self.radius * sin]
    }
}

/// Cutter compensation.
#[derive(Debug, Default)]
pub(crate) struct Compensation {
    pub active: Option<Active>,
    held: Vec<Held>,
}

fn angle_between(from: f64, to: f64) -> f64 {
    let turn = libm::fmod(to - from, TAU);
    if turn > PI {
        turn - TAU
    } else if turn < -PI {
        turn + TAU
    } else {
        turn
    }
}

fn in_plane(at: &PerLetter, plane: [usize; 2]) -> [f64; 2] {
    [at[plane[0]], at[plane[1]]]
}

fn set_in_plane(at: &mut PerLetter, plane: [usize; 2], point: [f64; 2]) {
    at[plane[0]] = point[0];
    at[plane[1]] = point[1];
}

fn direction(from: [f64; 2], to: [f64; 2]) -> f64 {
    libm::atan2(to[1] - from[1], to[0] - from[0])
}

fn distance(from: [f64; 2], to: [f64; 2]) -> f64 {
    libm::hypot(to[0] - from[0], to[1] - from[1])
}

/// A line or circle in the plane.
#[derive(Debug, Clone, Copy)]
enum Curve {
    Line { point: [f64; 2], direction: f64 },
    Circle { centre: [f64; 2], radius: f64 },
}

/// Returns the intersection of two curves that is nearest to a point.
fn intersection(first: Curve, second: Curve, near: [f64; 2]) -> Option<[f64; 2]> {
    let points = match (first, second) {
        (
            Curve::Line { point, direction },
            Curve::Line {
                point: other,
                direction: turned,
            },
        ) => {
            let (sin, cos) = libm::sincos(direction);
            let (other_sin, other_cos) = libm::sincos(turned);
            let cross = cos * other_sin - sin * other_cos;
            if cross.abs() < 1e-12 {
                return None;
            }
            let along =
                ((other[0] - point[0]) * other_sin - (other[1] - point[1]) * other_cos) / cross;
            let found = [point[0] + along * cos, point[1] + along * sin];
            [found, found]
        }
        (Curve::Line { point, direction }, Curve::Circle { centre, radius })
        | (Curve::Circle { centre, radius }, Curve::Line { point, direction }) => {
            let (sin, cos) = libm::sincos(direction);
            let to = [centre[0] - point[0], centre[1] - point[1]];
            let along = to[0] * cos + to[1] * sin;
            let off = to[1] * cos - to[0] * sin;
            let half = radius * radius - off * off;
            if half < 0.0 {
                return None;
            }
            let half = half.sqrt();
            [along - half, along + half].map(|s| [point[0] + s * cos, point[1] + s * sin])
        }
        (
            Curve::Circle { centre, radius },
            Curve::Circle {
                centre: other,
                radius: size,
            },
        ) => {
            let apart = distance(centre, other);
            if apart < 1e-9 {
                return None;
            }
            let along = (apart * apart + radius * radius - size * size) / (2.0 * apart);
            let half = radius * radius - along * along;
            if half < 0.0 {
                return None;
            }
            let half = half.sqrt();
            let (cos, sin) = (
                (other[0] - centre[0]) / apart,
                (other[1] - centre[1]) / apart,
            );
            [half, -half].map(|across| {
                [
                    centre[0] + along * cos - across * sin,
                    centre[1] + along * sin + across * cos,
                ]
            })
        }
    };
    points
        .into_iter()
        .min_by(|a, b| distance(*a, near).total_cmp(&distance(*b, near)))
}

impl Output {
    /// Adds a move: compensated if compensation is in force, else as it is.
    pub(crate) fn travel(&mut self, leg: Leg) -> Result<(), Refusal> {
        match self.compensation.active {
            None => {
                self.leg(&leg);
                Ok(())
            }
            Some(active) if active.is_first => self.enter(leg, active),
            Some(active) => self.follow(leg, active),
        }
    }

    /// Adds another step after the held moves.
    pub(crate) fn push(&mut self, step: Step) {
        if self.compensation.held.is_empty() {
            self.steps.push_back(step);
        } else {
            self.compensation.held.push(Held::Step(step));
            if self.compensation.held.len() > MAX_HELD {
                self.release();
            }
        }
    }

    /// Gives out the held moves.
    pub(crate) fn release(&mut self) {
        for held in std::mem::take(&mut self.compensation.held) {
            match held {
                Held::Leg(leg) => self.leg(&leg),
                Held::Step(step) => self.steps.push_back(step),
            }
        }
    }

    fn hold(&mut self, leg: Leg) {
        self.compensation.held.push(Held::Leg(leg));
    }

    /// Returns the end of the last held move, or the position.
    fn end(&self) -> PerLetter {
        self.compensation
            .held
            .iter()
            .rev()
            .find_map(|held| match held {
                Held::Leg(leg) => Some(leg.to),
                Held::Step(_) => None,
            })
            .unwrap_or(*self.at())
    }

    fn enter(&mut self, mut leg: Leg, mut active: Active) -> Result<(), Refusal> {
        let plane = active.plane;
        let (here, programmed) = (in_plane(self.at(), plane), in_plane(&leg.to, plane));
        if leg.arc.is_none() && distance(here, programmed) < 1e-9 {
            // No motion in the plane: the entry is still to come.
            self.leg(&leg);
            return Ok(());
        }
        if distance(here, programmed) <= active.radius {
            self.enter_anyhow(leg, active, programmed, direction(here, programmed));
            return Err((
                format!(
                    "the first move with cutter compensation is {:.4} mm long, not longer than \
                     the radius {:.4} mm of the cutter",
                    distance(here, programmed),
                    active.radius
                ),
                "begin with a longer straight move beside the contour".into(),
            ));
        }
        match &mut leg.arc {
            None => active.direction = direction(here, programmed),
            Some(arc) => {
                let turn = arc.sweep.signum();
                let last = arc.angle + arc.sweep;
                active.direction = last + turn * FRAC_PI_2;
                let end = active.beside(programmed, active.direction);
                // The arc from here to the end beside the contour that has the same direction at
                // its end: its centre is on the old radius at the end.
                let towards = direction(end, arc.centre);
                let half = 0.5 * distance(here, end);
                let cos = libm::cos(direction(end, here) - towards);
                if cos <= 1e-4 {
                    let last = active.direction;
                    self.enter_anyhow(leg, active, programmed, last);
                    return Err((
                        "no arc leads from here beside the contour".into(),
                        "begin with a larger arc, or with a straight move".into(),
                    ));
                }
                let radius = half / cos;
                let (sin, cos) = libm::sincos(towards);
                let centre = [end[0] + radius * cos, end[1] + radius * sin];
                *arc = arc_between(arc, centre, here, end);
            }
        }
        let end = active.beside(programmed, active.direction);
        set_in_plane(&mut leg.to, plane, end);
        active.is_first = false;
        active.programmed = programmed;
        self.compensation.active = Some(active);
        self.hold(leg);
        Ok(())
    }

    /// Begins a contour with a move that was refused, so that the next ones are judged by
    /// themselves: it ends beside the contour.
    fn enter_anyhow(&mut self, leg: Leg, active: Active, programmed: [f64; 2], direction: f64) {
        let active = Active {
            is_first: false,
            programmed,
            direction,
            ..active
        };
        self.compensation.active = Some(active);
        self.compensation.held.clear();
        let mut at = leg.to;
        set_in_plane(&mut at, active.plane, active.beside(programmed, direction));
        self.place_at(at);
    }

    /// Adds a move after the first one. One that is refused ends beside the contour, so that the
    /// next ones are judged by themselves.
    fn follow(&mut self, leg: Leg, active: Active) -> Result<(), Refusal> {
        let refused = leg.clone();
        self.join(leg, active).inspect_err(|_| {
            let programmed = in_plane(&refused.to, active.plane);
            let last = match &refused.arc {
                Some(arc) => arc.angle + arc.sweep + arc.sweep.signum() * FRAC_PI_2,
                None if distance(active.programmed, programmed) < 1e-9 => active.direction,
                None => direction(active.programmed, programmed),
            };
            self.enter_anyhow(refused, active, programmed, last);
        })
    }

    fn join(&mut self, mut leg: Leg, mut active: Active) -> Result<(), Refusal> {
        let plane = active.plane;
        let programmed = in_plane(&leg.to, plane);
        let corner = active.programmed;
        if leg.arc.is_none() && distance(corner, programmed) < 1e-9 {
            let end = in_plane(&self.end(), plane);
            set_in_plane(&mut leg.to, plane, end);
            self.hold(leg);
            if self.compensation.held.len() > MAX_HELD {
                return Err((
                    format!("more than {MAX_HELD} moves outside the plane in a row"),
                    "switch the compensation off (G40) before them".into(),
                ));
            }
            return Ok(());
        }
        let (leaving, last, curve) = match &mut leg.arc {
            None => {
                let along = direction(corner, programmed);
                let point = active.beside(corner, along);
                let curve = Curve::Line {
                    point,
                    direction: along,
                };
                (along, along, curve)
            }
            Some(arc) => {
                let turn = arc.sweep.signum();
                // Left of a counter-clockwise arc is its inner side.
                let change = -active.side * turn * active.radius;
                arc.radius = arc.radius.map(|radius| radius + change);
                if arc.radius[0].min(arc.radius[1]) <= 1e-6 {
                    return Err((
                        format!(
                            "the radius of the arc is not larger than the radius {:.4} mm of the \
                             cutter on its inner side",
                            active.radius
                        ),
                        "use a smaller cutter, or a larger arc".into(),
                    ));
                }
                let curve = Curve::Circle {
                    centre: arc.centre,
                    radius: arc.radius[0],
                };
                (
                    arc.angle + turn * FRAC_PI_2,
                    arc.angle + arc.sweep + turn * FRAC_PI_2,
                    curve,
                )
            }
        };
        let (before, start) = (
            active.beside(corner, active.direction),
            active.beside(corner, leaving),
        );
        let turn = angle_between(active.direction, leaving);
        let mut from = before;
        if turn.abs() > SMOOTH {
            let reverses = turn.abs() > PI - 1e-6;
            if reverses && self.is_outside_of_arc(&active) {
                // The move goes back along the arc, whose outer side the tool cuts: their first
                // intersection is ahead on the move.
                let (sin, cos) = libm::sincos(leaving);
                let ahead = [before[0] + 1e-3 * cos, before[1] + 1e-3 * sin];
                from = self.cut(curve, &active, before, ahead)?;
            } else if reverses || turn * active.side < 0.0 {
                self.go_around(&leg, &active, corner, before, start);
                from = start;
            } else {
                from = self.cut(curve, &active, before, before)?;
            }
        }
        self.release();
        let end = active.beside(programmed, last);
        set_in_plane(&mut leg.to, plane, end);
        match &mut leg.arc {
            Some(arc) => {
                let angle = direction(arc.centre, from);
                // The cut removes a part of the beginning.
                let removed = angle_between(arc.angle, angle);
                arc.angle = angle;
                arc.sweep -= removed;
                arc.radius[0] = distance(arc.centre, from);
                arc.radius[1] = distance(arc.centre, end);
                if arc.sweep * (arc.sweep + removed) <= 0.0 {
                    return Err(unreachable_corner());
                }
            }
            None => {
                let along = libm::cos(direction(from, end) - leaving);
                if distance(from, end) > 1e-9 && along < 0.0 {
                    return Err(unreachable_corner());
                }
            }
        }
        active.programmed = programmed;
        active.direction = last;
        self.compensation.active = Some(active);
        self.hold(leg);
        Ok(())
    }

    /// Joins two moves at an outside corner.
    fn go_around(
        &mut self,
        leg: &Leg,
        active: &Active,
        corner: [f64; 2],
        before: [f64; 2],
        start: [f64; 2],
    ) {
        self.release();
        let mut to = *self.at();
        set_in_plane(&mut to, active.plane, start);
        let angle = direction(corner, before);
        let sweep = libm::fmod(direction(corner, start) - angle, TAU);
        // Left of the path the tool goes around clockwise.
        let sweep = if sweep * active.side > 0.0 {
            sweep - active.side * TAU
        } else {
            sweep
        };
        let arc = Arc {
            plane: active.plane,
            centre: corner,
            radius: [active.radius; 2],
            angle,
            sweep,
        };
        let is_rapid = leg.move_feed == super::output::MoveFeed::Rapid;
        self.leg(&Leg {
            to,
            arc: (!is_rapid).then_some(arc),
            ..leg.clone()
        });
    }

    /// Whether the last held move is an arc with the tool on its outer side.
    fn is_outside_of_arc(&self, active: &Active) -> bool {
        match self.compensation.held.first() {
            Some(Held::Leg(Leg { arc: Some(arc), .. })) => arc.sweep * active.side < 0.0,
            _ => false,
        }
    }

    /// Cuts the held moves at an inside corner; returns the intersection that is nearest to a
    /// point. `before` is the end of the held moves without the cut.
    fn cut(
        &mut self,
        next: Curve,
        active: &Active,
        before: [f64; 2],
        near: [f64; 2],
    ) -> Result<[f64; 2], Refusal> {
        let plane = active.plane;
        let at = *self.at();
        // The last move with a motion in the plane is the first of the held ones.
        let Some(Held::Leg(last)) = self.compensation.held.first() else {
            return Ok(before);
        };
        let from = in_plane(&at, plane);
        let curve = match &last.arc {
            None => Curve::Line {
                point: before,
                direction: active.direction,
            },
            Some(arc) => Curve::Circle {
                centre: arc.centre,
                radius: arc.radius[1],
            },
        };
        let point = intersection(curve, next, near).ok_or_else(unreachable_corner)?;
        for held in &mut self.compensation.held {
            let Held::Leg(leg) = held else { continue };
            set_in_plane(&mut leg.to, plane, point);
            match &mut leg.arc {
                None => {
                    let along = direction(from, point);
                    let is_motion = distance(from, point) > 1e-9;
                    if is_motion && libm::cos(along - direction(from, before)) < 0.0 {
                        return Err(unreachable_corner());
                    }
                }
                Some(arc) => {
                    let removed =
                        angle_between(direction(arc.centre, point), direction(arc.centre, before));
                    let sweep = arc.sweep - removed;
                    if sweep * arc.sweep <= 0.0 {
                        return Err(unreachable_corner());
                    }
                    arc.sweep = sweep;
                    arc.radius[1] = distance(arc.centre, point);
                }
            }
        }
        Ok(point)
    }
}

fn unreachable_corner() -> Refusal {
    (
        "the cutter cannot reach this inside corner without cutting into the contour".into(),
        "use a smaller cutter, or longer moves before and after the corner".into(),
    )
}

/// Returns the arc about a centre between two points, in the direction of another arc.
fn arc_between(arc: &Arc, centre: [f64; 2], from: [f64; 2], to: [f64; 2]) -> Arc {
    let angle = direction(centre, from);
    let turn = arc.sweep.signum();
    let mut sweep = libm::fmod(direction(centre, to) - angle, TAU);
    if sweep * turn <= 0.0 {
        sweep += turn * TAU;
    }
    Arc {
        plane: arc.plane,
        centre,
        radius: [distance(centre, from), distance(centre, to)],
        angle,
        sweep,
    }
}
