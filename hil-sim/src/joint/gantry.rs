//! Gantries: two joints that carry the ends of one beam.
//!
//! The beam resists racking, the distance between its ends along the joints, as a spring with
//! damping. The tool is at its middle: the geometry sees the mean of the two ends, and a force on
//! the tool loads both ends alike.

use super::mechanics::{Bodies, JointArray};
use super::{JointConfig, JointKind};
use crate::check::Check;

/// Part of critical damping of the racking.
const DAMPING: f64 = 0.1;

/// A beam between two joints.
#[derive(Debug, Clone)]
pub struct Gantry {
    /// Joint of the first motor, which is one of the geometry.
    first: usize,
    /// Joint of the second motor.
    second: usize,
    /// Stiffness against racking, effort per axis unit.
    stiffness: f64,
    /// Damping of it, effort per axis unit per second.
    damping: f64,
}

impl Gantry {
    /// The gantries of a machine. The joints must have passed their check.
    pub fn all(joints: &[JointConfig]) -> Vec<Self> {
        let seconds = joints.iter().enumerate();
        let pairs = seconds.filter_map(|(second, joint)| {
            let name = joint.gantry_of.as_ref()?;
            let first = joints.iter().position(|it| it.name == *name)?;
            let slide = joint.inertia * (1.0 - joint.motor_share) / joint.kind.acceleration_unit();
            let stiffness = joint.racking_stiffness;
            Some(Self {
                first,
                second,
                stiffness,
                damping: DAMPING * 2.0 * libm::sqrt(stiffness * slide),
            })
        });
        pairs.collect()
    }

    /// Joint of the first motor.
    pub const fn first(&self) -> usize {
        self.first
    }

    /// Joint of the second motor.
    pub const fn second(&self) -> usize {
        self.second
    }

    /// Adds the efforts of the beam to the loads of its ends.
    #[inline]
    pub fn load(&self, bodies: &Bodies, load: &mut JointArray) {
        let racking = bodies.slide[self.second] - bodies.slide[self.first];
        let rate = bodies.slide_rate[self.second] - bodies.slide_rate[self.first];
        let effort = self.stiffness * racking + self.damping * rate;
        load[self.first] += effort;
        load[self.second] -= effort;
    }

    /// Replaces the place of the first joint by the middle of the beam.
    pub fn put_middle(&self, joints: &mut JointArray) {
        joints[self.first] = (joints[self.first] + joints[self.second]) / 2.0;
    }

    /// Divides the load of the first joint, which is that of the beam, between the two.
    pub fn divide(&self, loads: &mut JointArray) {
        let half = loads[self.first] / 2.0;
        loads[self.first] = half;
        loads[self.second] = half;
    }
}

/// Adds the problems of the gantries of a machine.
pub(crate) fn check(joints: &[JointConfig], substep_us: f64, check: &mut Check) {
    let substep = substep_us * 1e-6;
    let mut firsts: Vec<&str> = Vec::new();
    for (index, joint) in joints.iter().enumerate() {
        let at = format!("joint {index} ({})", joint.name);
        let slide = joint.inertia * (1.0 - joint.motor_share) / joint.kind.acceleration_unit();
        let stiffest = (0.045 / (substep * substep) * slide).min(1e6);
        check.within(
            format!("{at}: racking_stiffness"),
            joint.racking_stiffness,
            0.0,
            stiffest,
        );
        check.within(format!("{at}: racked"), joint.racked, -100.0, 100.0);
        let mut refuse = |key: &str, problem: String| check.refuse(format!("{at}: {key}"), problem);
        let Some(name) = &joint.gantry_of else {
            if joint.racking_stiffness != 0.0 || joint.racked != 0.0 {
                let problem = "has no gantry_of, so its beam cannot rack; remove the key";
                let key = if joint.racked == 0.0 {
                    "racking_stiffness"
                } else {
                    "racked"
                };
                refuse(key, problem.into());
            }
            if joints[..index].iter().any(|it| it.gantry_of.is_some()) {
                let problem = "is after the second motor of a gantry; exchange them";
                refuse("name", problem.into());
            }
            continue;
        };
        let first = joints.iter().find(|it| it.name == *name);
        let Some(first) = first.filter(|it| it.gantry_of.is_none()) else {
            let problem = format!("\"{name}\" is no other joint with one motor; name one");
            refuse("gantry_of", problem);
            continue;
        };
        if firsts.contains(&name.as_str()) {
            refuse(
                "gantry_of",
                format!("\"{name}\" has a second motor already"),
            );
        }
        firsts.push(name);
        if first.kind != joint.kind || joint.kind != JointKind::Linear {
            refuse(
                "gantry_of",
                "needs two linear joints; correct `kind`".into(),
            );
        }
        if joint.preset != first.preset {
            let problem = format!("is not {}, as of \"{name}\"; write it", first.preset);
            refuse("preset", problem);
        }
        if joint.start_spread != 0.0 {
            let problem = "the joint starts with the other end of its beam; remove the key, or \
                           write `racked`";
            refuse("start_spread", problem.into());
        }
    }
}
