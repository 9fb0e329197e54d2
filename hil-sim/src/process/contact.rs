//! An elastic body that the tool touches without cutting, for sweeps over the contact stiffness.

use crate::check::{Check, PlantError};
use crate::process::ToolPose;
use crate::vector::Vector;

/// Elastic half space with a plane face.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticWall {
    /// A point of the undeformed face, mm.
    pub point: Vector,
    /// Unit vector out of the body, towards the tool.
    pub normal: Vector,
    /// Stiffness k_e, N/mm.
    pub stiffness: f64,
    /// Damping, N s/mm. It acts only while the face is pressed, and the contact force never pulls.
    /// The force is held for a control period T, which adds energy to an oscillating tool like a
    /// damping of -k_e T / 2. A wall that neither adds nor removes energy has that much damping
    /// (0.1 N s/mm at 1000 N/mm and 200 us).
    pub damping: f64,
    /// Radius of the touching ball, mm; 0 for a point contact at the tip.
    pub radius: f64,
}

impl ElasticWall {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        let mut square = 0.0;
        for i in 0..3 {
            check.within(format!("wall: point {i}"), self.point[i], -2000.0, 2000.0);
            square += self.normal[i] * self.normal[i];
        }
        check.within(
            "wall: length of normal".into(),
            square,
            0.999_999,
            1.000_001,
        );
        check.within("wall: stiffness".into(), self.stiffness, 0.0, 1e6);
        check.within("wall: damping".into(), self.damping, 0.0, 1e4);
        check.within("wall: radius".into(), self.radius, 0.0, 100.0);
        check.done()
    }

    /// Penetration of the tool, mm; negative in the air. `pose` must be in the same frame as the
    /// wall.
    pub fn depth(&self, pose: &ToolPose) -> f64 {
        let mut outside = -self.radius;
        for i in 0..3 {
            let nearest = pose.tip[i] + self.radius * pose.axis[i];
            outside += (nearest - self.point[i]) * self.normal[i];
        }
        -outside
    }

    /// Force on the tool, N, for a tool velocity in mm/s.
    pub fn force(&self, pose: &ToolPose, velocity: Vector) -> Vector {
        let depth = self.depth(pose);
        if depth <= 0.0 {
            return [0.0; 3];
        }
        let closing = -(velocity[0] * self.normal[0]
            + velocity[1] * self.normal[1]
            + velocity[2] * self.normal[2]);
        let push = (self.stiffness * depth + self.damping * closing).max(0.0);
        self.normal.map(|part| part * push)
    }
}
