//! Guides of the handle: a rail, or the edge of a reference part that the steel ball at the tip
//! touches.
//!
//! Both are bodies in the master's base frame, in mm and N. Positions are relative to the home pose
//! of the handle, as everywhere in [`crate::operator`].

use crate::check::{Check, PlantError};
use crate::vector::{Vector, dot, minus, times};
use serde::{Deserialize, Serialize};

/// A rail that lets the handle move along one straight line through home, without rotation
/// (docs/control.md 1.2): a stiff spring with a damper across it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rail {
    /// Free direction; a vector of any length but 0.
    pub direction: [f64; 3],
    /// Stiffness across, N/mm.
    #[serde(default = "Rail::stiffness")]
    pub stiffness: f64,
    /// Damping across, N s/mm.
    #[serde(default = "Rail::damping")]
    pub damping: f64,
    /// Rotational stiffness, N mm/rad.
    #[serde(default = "Rail::turn_stiffness")]
    pub turn_stiffness: f64,
    /// Rotational damping, N mm s/rad.
    #[serde(default = "Rail::turn_damping")]
    pub turn_damping: f64,
    /// Coulomb friction along, N.
    #[serde(default = "Rail::coulomb")]
    pub coulomb: f64,
}

impl Rail {
    const fn stiffness() -> f64 {
        300.0
    }

    const fn damping() -> f64 {
        0.4
    }

    const fn turn_stiffness() -> f64 {
        2e6
    }

    const fn turn_damping() -> f64 {
        1000.0
    }

    const fn coulomb() -> f64 {
        0.2
    }

    /// A rail along a direction: 300 N/mm across and 2 kN m/rad in rotation, like a small linear
    /// guide, and 0.2 N of friction along. Chosen values.
    pub const fn along(direction: [f64; 3]) -> Self {
        Self {
            direction,
            stiffness: Self::stiffness(),
            damping: Self::damping(),
            turn_stiffness: Self::turn_stiffness(),
            turn_damping: Self::turn_damping(),
            coulomb: Self::coulomb(),
        }
    }

    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        let square = dot(self.direction, self.direction);
        check.within("rail: direction: length squared".into(), square, 1e-6, 1e12);
        check.within("rail: stiffness".into(), self.stiffness, 0.0, 500.0);
        check.within("rail: damping".into(), self.damping, 0.0, 5.0);
        check.within("rail: turn_stiffness".into(), self.turn_stiffness, 0.0, 2e6);
        check.within("rail: turn_damping".into(), self.turn_damping, 0.0, 5e3);
        check.within("rail: coulomb".into(), self.coulomb, 0.0, 100.0);
        check.done()
    }

    /// Unit vector of the free direction.
    pub fn unit_direction(&self) -> Vector {
        let square = dot(self.direction, self.direction);
        times(self.direction, 1.0 / libm::sqrt(square))
    }

    /// Force on the handle, N, at a position from home (mm) with a velocity (mm/s).
    pub fn force(&self, place: Vector, velocity: Vector) -> Vector {
        let unit_direction = self.unit_direction();
        let across =
            |vector: Vector| minus(vector, times(unit_direction, dot(vector, unit_direction)));
        let (off, rate) = (across(place), across(velocity));
        core::array::from_fn(|i| -self.stiffness * off[i] - self.damping * rate[i])
    }
}

/// A round reference part with its axis along z; the operator moves the ball at the tip along its
/// edge. Positions from the tip's home, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferencePart {
    /// Position of its axis, x and y.
    pub centre_mm: [f64; 2],
    /// Its radius.
    pub radius_mm: f64,
    /// True for a hole with the ball inside; false for a disc with the ball outside.
    pub hole: bool,
    /// Radius of the ball, whose centre is the tip.
    pub ball_radius_mm: f64,
    /// Lower and upper end of the edge in z; beyond them there is no contact.
    pub edge_mm: [f64; 2],
    /// Stiffness of the contact, N/mm; handle and clamping dominate it over steel on steel.
    pub stiffness: f64,
    /// Damping, N s/mm; the contact force never pulls.
    pub damping: f64,
    /// Coefficient of friction between ball and edge.
    pub friction: f64,
}

impl Default for ReferencePart {
    /// A hole of 35 mm for the ball of 5 mm (docs/control.md 4.1, E12), beside the tip's home
    /// towards -X: the tip can move on a circle of 30 mm. Stiffness and friction are chosen values.
    fn default() -> Self {
        Self {
            centre_mm: [-15.0, 0.0],
            radius_mm: 17.5,
            hole: true,
            ball_radius_mm: 2.5,
            edge_mm: [-10.0, 5.0],
            stiffness: 40.0,
            damping: 0.05,
            friction: 0.15,
        }
    }
}

/// Contact of the ball with the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Unit vector out of the part, towards the ball.
    pub normal: Vector,
    /// Horizontal unit vector along the edge.
    pub tangent: Vector,
    /// Force along the normal, N.
    pub push: f64,
    /// Penetration of the ball into the part, mm.
    pub depth: f64,
}

impl ReferencePart {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems, including a ball that does not fit into the hole.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        let field = |key: &str| format!("part: {key}");
        for (axis, value) in self.centre_mm.into_iter().enumerate() {
            check.within(field(&format!("centre_mm {axis}")), value, -500.0, 500.0);
        }
        check.within(field("ball_radius_mm"), self.ball_radius_mm, 0.1, 100.0);
        let min = if self.hole {
            self.ball_radius_mm * 1.001
        } else {
            0.1
        };
        check.within(field("radius_mm"), self.radius_mm, min, 500.0);
        let [low, high] = self.edge_mm;
        check.within(field("edge_mm: low"), low, -500.0, 500.0);
        check.within(field("edge_mm: high"), high, low, 500.0);
        check.within(field("stiffness"), self.stiffness, 0.0, 200.0);
        check.within(field("damping"), self.damping, 0.0, 1.0);
        check.within(field("friction"), self.friction, 0.0, 2.0);
        check.done()
    }

    /// Radius of the path of the ball's centre at contact without force, mm.
    pub fn path_radius(&self) -> f64 {
        if self.hole {
            self.radius_mm - self.ball_radius_mm
        } else {
            self.radius_mm + self.ball_radius_mm
        }
    }

    /// Contact with the tip at a position and a velocity; `None` without contact.
    pub fn touch(&self, tip: Vector, velocity: Vector) -> Option<Touch> {
        if !(self.edge_mm[0]..=self.edge_mm[1]).contains(&tip[2]) {
            return None;
        }
        let (x, y) = (tip[0] - self.centre_mm[0], tip[1] - self.centre_mm[1]);
        let distance = libm::sqrt(x * x + y * y);
        if distance < 1e-9 {
            return None;
        }
        let outwards = [x / distance, y / distance, 0.0];
        let side = if self.hole { -1.0 } else { 1.0 };
        let depth = -side * (distance - self.path_radius());
        if depth <= 0.0 {
            return None;
        }
        let normal = times(outwards, side);
        let push = self.stiffness * depth - self.damping * dot(velocity, normal);
        Some(Touch {
            normal,
            tangent: [-outwards[1], outwards[0], 0.0],
            push: push.max(0.0),
            depth,
        })
    }
}
