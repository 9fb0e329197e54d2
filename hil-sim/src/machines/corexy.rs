//! A machine with crossed belts, from the lengths of the belts: each goes from a motor at the frame
//! along a rail of y to a pulley on the beam, and along the beam to the carriage of the tool. A
//! belt is a closed loop of constant length, so this way gets longer by what its motor pays out.
//!
//! Units: mm and degrees; the tool points down along z. The simulated joints have a mass each. The
//! belts of a real machine also couple the motors, where the beam with its load is heavier than the
//! carriage; this coupling is left out.

use super::Geometry;
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.corexy]`: places in mm, and errors of the assembly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorexyConfig {
    /// y of both motors, seen from the tool where the belts are at zero.
    pub motors_y: f64,
    /// Distance of motor a from the line of its pulley on the beam, +-50 mm.
    #[serde(default)]
    pub aside_a: f64,
    /// The same of motor b.
    #[serde(default)]
    pub aside_b: f64,
    /// Squareness error of y to x: displacement of the tool in x per mm of y, +-0.1.
    #[serde(default)]
    pub squareness_xy: f64,
    /// Squareness error of z to x: displacement of the tool in x per mm of z, +-0.1.
    #[serde(default)]
    pub squareness_xz: f64,
    /// Squareness error of z to y: displacement of the tool in y per mm of z, +-0.1.
    #[serde(default)]
    pub squareness_yz: f64,
}

/// The machine.
#[derive(Debug, Clone)]
pub struct Corexy {
    config: CorexyConfig,
}

/// The straight piece of a belt beside a rail.
#[derive(Debug, Clone, Copy)]
struct Piece {
    length: f64,
    /// Its change per mm of the beam.
    slope: f64,
}

/// Places of the carriage on the beam and of the beam on its rails, with the pieces of both belts.
#[derive(Debug, Clone, Copy)]
struct Place {
    carriage: f64,
    beam: f64,
    pieces: [Piece; 2],
}

/// Newton's method ends at this step, mm.
const CLOSED: f64 = 1e-12;

impl Corexy {
    /// The pieces of both belts with the beam this far along its rails.
    fn pieces(&self, beam: f64) -> [Piece; 2] {
        let along = beam - self.config.motors_y;
        [self.config.aside_a, self.config.aside_b].map(|aside| {
            let length = libm::hypot(along, aside);
            Piece {
                length,
                slope: along / length,
            }
        })
    }

    /// Where the belts hold beam and carriage; `None` where the beam would be at the motors.
    ///
    /// Belt a comes to the carriage from the left and its motor pays out a; belt b comes from the
    /// right and its motor winds b.
    fn place(&self, joints: &JointArray) -> Option<Place> {
        let [a, b, ..] = *joints;
        let at_zero = self.pieces(0.0).map(|piece| piece.length);
        // Both pieces beside the rails: the pieces on the beam are its whole length together.
        let length = at_zero[0] + at_zero[1] + a - b;
        let mut beam = self.config.motors_y + 0.5 * length;
        for _ in 0..50 {
            let pieces = self.pieces(beam);
            let [left, right] = pieces;
            if !beam.is_finite() || beam <= self.config.motors_y {
                return None;
            }
            let step = (length - left.length - right.length) / (left.slope + right.slope);
            beam += step;
            if step.abs() < CLOSED.max(beam.abs() * f64::EPSILON) {
                let carriage = a - (left.length - at_zero[0]);
                return Some(Place {
                    carriage,
                    beam,
                    pieces,
                });
            }
        }
        None
    }
}

impl Geometry for Corexy {
    type Config = CorexyConfig;

    fn check(config: &CorexyConfig, kinds: &[JointKind], check: &mut Check) {
        if kinds != [JointKind::Linear; 3] {
            check.refuse(
                "geometry: corexy".into(),
                "needs three linear joints: the belts a and b, and z".into(),
            );
        }
        for (name, value, low, high) in [
            ("motors_y", config.motors_y, -4000.0, -1.0),
            ("aside_a", config.aside_a, -50.0, 50.0),
            ("aside_b", config.aside_b, -50.0, 50.0),
            ("squareness_xy", config.squareness_xy, -0.1, 0.1),
            ("squareness_xz", config.squareness_xz, -0.1, 0.1),
            ("squareness_yz", config.squareness_yz, -0.1, 0.1),
        ] {
            check.within(format!("geometry: corexy: {name}"), value, low, high);
        }
    }

    fn new(config: &CorexyConfig, joints: &JointArray) -> Result<Self, String> {
        let machine = Self {
            config: config.clone(),
        };
        match machine.place(joints) {
            Some(_) => Ok(machine),
            None => Err("the beam is beyond the motors of the belts".into()),
        }
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let Some(place) = self.place(joints) else {
            return false;
        };
        let z = joints[2];
        *pose = [0.0; MAX_AXES];
        pose[0] =
            place.carriage + self.config.squareness_xy * place.beam + self.config.squareness_xz * z;
        pose[1] = place.beam + self.config.squareness_yz * z;
        pose[2] = z;
        true
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose::upright([pose[0], pose[1], pose[2]])
    }

    /// The tensions of the belts balance the force along the beam and along the rails.
    fn joint_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        [x, y, z]: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let [left, right] = self.place(joints)?.pieces;
        let along_rails = y + self.config.squareness_xy * x;
        let mut loads = [0.0; MAX_AXES];
        // The tensions add up to x; beside the rails, belt a pulls against belt b.
        let both = left.slope + right.slope;
        loads[0] = (right.slope * x + along_rails) / both;
        loads[1] = (left.slope * x - along_rails) / both;
        loads[2] = z + self.config.squareness_xz * x + self.config.squareness_yz * y;
        Some(loads)
    }
}
