//! A five-bar arm: the triangle of the elbows and the tip, from its sides, with unequal links and
//! the errors of a real assembly.
//!
//! Units: mm and degrees. The tool points down along the slide. The base with both motors may lean;
//! everything below is in its frame, with the middle between the motors as the origin.

use super::Geometry;
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{Vector, dot, minus, plus, times};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.five_bar]`: lengths in mm, and errors; lists have the left arm first.
/// Lengths that differ from those of `[kinematics]` are errors of the links.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FiveBarConfig {
    /// Distance of the axes of the motors, along x.
    pub base: f64,
    /// From the motors to the elbows.
    pub proximal: [f64; 2],
    /// From the elbows to the tip of the tool.
    pub distal: [f64; 2],
    /// x of the workpiece's origin, from the middle between the motors.
    pub x_off: f64,
    /// y of the workpiece's origin, from the middle between the motors.
    pub y_off: f64,
    /// True angles of the proximal links where their joints are at 0, +-5 degrees.
    #[serde(default)]
    pub zero_deg: [f64; 2],
    /// The base leans by this angle about x, +-5 degrees.
    #[serde(default)]
    pub column_about_x_deg: f64,
    /// The base leans by this angle about y, +-5 degrees.
    #[serde(default)]
    pub column_about_y_deg: f64,
}

/// A place or direction in the plane of the links.
type Planar = [f64; 2];

/// The arm.
#[derive(Debug, Clone)]
pub struct FiveBar {
    config: FiveBarConfig,
    /// Directions of the base's x, y and z.
    column: [Vector; 3],
}

/// The links at joint positions.
#[derive(Debug, Clone, Copy)]
struct Links {
    /// From the motors to the elbows.
    proximal: [Planar; 2],
    /// Directions of the distal links.
    distal: [Planar; 2],
    tip: Planar,
}

/// The z component of a vector product.
fn turning(a: Planar, b: Planar) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// A vector turned about x, and then about y.
fn leaning([x, y, z]: Vector, about_x_deg: f64, about_y_deg: f64) -> Vector {
    let (sine, cosine) = libm::sincos(about_x_deg.to_radians());
    let (y, z) = (cosine * y - sine * z, sine * y + cosine * z);
    let (sine, cosine) = libm::sincos(about_y_deg.to_radians());
    [cosine * x + sine * z, y, cosine * z - sine * x]
}

impl FiveBar {
    /// The links, with the tip on the left of the way from the left elbow to the right one. `None`
    /// where the distal links do not meet.
    fn links(&self, joints: &JointArray) -> Option<Links> {
        let config = &self.config;
        let proximal: [Planar; 2] = core::array::from_fn(|arm| {
            let (sine, cosine) = libm::sincos((joints[arm] + config.zero_deg[arm]).to_radians());
            [-config.proximal[arm] * sine, config.proximal[arm] * cosine]
        });
        let elbows: [Planar; 2] = core::array::from_fn(|arm| {
            let motor = [-0.5, 0.5][arm] * config.base;
            [motor + proximal[arm][0], proximal[arm][1]]
        });
        let [dx, dy] = [0, 1].map(|axis| elbows[1][axis] - elbows[0][axis]);
        let apart = libm::hypot(dx, dy);
        let [left, right] = config.distal;
        // The angle of the triangle at the left elbow. A value that is no number gives no pose.
        let cosine = (left * left + apart * apart - right * right) / (2.0 * left * apart);
        if cosine.is_nan() || cosine.abs() >= 1.0 {
            return None;
        }
        let (sine, cosine) = libm::sincos(libm::atan2(dy, dx) + libm::acos(cosine));
        let tip = [elbows[0][0] + left * cosine, elbows[0][1] + left * sine];
        let distal = core::array::from_fn(|arm| {
            [0, 1].map(|axis| (tip[axis] - elbows[arm][axis]) / config.distal[arm])
        });
        Some(Links {
            proximal,
            distal,
            tip,
        })
    }
}

impl Geometry for FiveBar {
    type Config = FiveBarConfig;

    fn check(config: &FiveBarConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Rotary, Rotary, Linear] {
            check.refuse(
                "geometry: five_bar".into(),
                "needs the rotary joints theta1 and theta2 and then the linear one z".into(),
            );
        }
        let [proximal_left, proximal_right] = config.proximal;
        let [distal_left, distal_right] = config.distal;
        let [zero_left, zero_right] = config.zero_deg;
        for (name, value, min, max) in [
            ("base", config.base, 0.0, 2000.0),
            ("proximal", proximal_left, 1.0, 2000.0),
            ("proximal", proximal_right, 1.0, 2000.0),
            ("distal", distal_left, 1.0, 2000.0),
            ("distal", distal_right, 1.0, 2000.0),
            ("x_off", config.x_off, -2000.0, 2000.0),
            ("y_off", config.y_off, -2000.0, 2000.0),
            ("zero_deg", zero_left, -5.0, 5.0),
            ("zero_deg", zero_right, -5.0, 5.0),
            ("column_about_x_deg", config.column_about_x_deg, -5.0, 5.0),
            ("column_about_y_deg", config.column_about_y_deg, -5.0, 5.0),
        ] {
            check.within(format!("geometry: five_bar: {name}"), value, min, max);
        }
    }

    fn new(config: &FiveBarConfig, joints: &JointArray) -> Result<Self, String> {
        let (about_x, about_y) = (config.column_about_x_deg, config.column_about_y_deg);
        let machine = Self {
            config: config.clone(),
            column: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
                .map(|axis| leaning(axis, about_x, about_y)),
        };
        match machine.links(joints) {
            Some(_) => Ok(machine),
            None => Err("the distal links do not meet".into()),
        }
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let Some(links) = self.links(joints) else {
            return false;
        };
        let [x, y, z] = self.column;
        let [ahead, aside] = links.tip;
        let tip = plus(plus(times(x, ahead), times(y, aside)), times(z, joints[2]));
        *pose = [0.0; MAX_AXES];
        let origin = [self.config.x_off, self.config.y_off, 0.0];
        pose[..3].copy_from_slice(&minus(tip, origin));
        true
    }

    fn links(&self, joints: &JointArray, _: &JointArray) -> Vec<Vec<Vector>> {
        let Some(links) = Self::links(self, joints) else {
            return Vec::new();
        };
        let [x, y, z] = self.column;
        let origin = [self.config.x_off, self.config.y_off, 0.0];
        let at = |[ahead, aside]: Planar, up: f64| {
            let point = plus(plus(times(x, ahead), times(y, aside)), times(z, up));
            minus(point, origin)
        };
        let mut lines: Vec<Vec<Vector>> = [-0.5, 0.5]
            .iter()
            .zip(links.proximal)
            .map(|(side, [ahead, aside])| {
                let motor = side * self.config.base;
                let elbow = [motor + ahead, aside];
                vec![at([motor, 0.0], 0.0), at(elbow, 0.0), at(links.tip, 0.0)]
            })
            .collect();
        lines.push(vec![at(links.tip, 0.0), at(links.tip, joints[2])]);
        lines
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose {
            tip: [pose[0], pose[1], pose[2]],
            axis: self.column[2],
        }
    }

    /// The forces in the distal links balance the force on the tool in their plane; a motor holds
    /// the moment of its link's force at the elbow. The height of the force above the tip loads no
    /// joint.
    fn joint_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let links = self.links(joints)?;
        let [x, y, up] = self.column;
        let force_in_plane = [dot(force, x), dot(force, y)];
        let [left, right] = links.distal;
        let opening = turning(left, right);
        if opening.abs() < 1e-6 {
            return None;
        }
        let pushes = [
            turning(force_in_plane, right) / opening,
            turning(left, force_in_plane) / opening,
        ];
        let mut loads = [0.0; MAX_AXES];
        for arm in 0..2 {
            let push = links.distal[arm].map(|part| part * pushes[arm]);
            loads[arm] = 1e-3 * turning(links.proximal[arm], push);
        }
        loads[2] = dot(force, up);
        Some(loads)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm() -> FiveBar {
        let config = FiveBarConfig {
            base: 160.0,
            proximal: [220.5, 219.0],
            distal: [279.25, 281.0],
            x_off: 3.0,
            y_off: 300.0,
            zero_deg: [0.5, -0.75],
            column_about_x_deg: 1.5,
            column_about_y_deg: -2.0,
        };
        FiveBar::new(&config, &[48.0, -45.0, 10.0, 0.0, 0.0, 0.0]).expect("the links meet")
    }

    /// The tip has the lengths of the distal links from both elbows, which have those of the
    /// proximal links from the motors.
    #[test]
    fn the_links_keep_their_lengths() {
        let arm = arm();
        for (first, second) in [(30.0, -40.0), (85.0, -30.0), (48.0, -48.0), (50.0, -70.0)] {
            let joints = [first, second, 0.0, 0.0, 0.0, 0.0];
            let links = arm.links(&joints).expect("the links meet");
            for index in 0..2 {
                let [x, y] = links.proximal[index];
                let motor = [-80.0, 80.0][index];
                let distal = libm::hypot(links.tip[0] - motor - x, links.tip[1] - y);
                assert!((libm::hypot(x, y) - arm.config.proximal[index]).abs() < 1e-9);
                assert!((distal - arm.config.distal[index]).abs() < 1e-9, "{distal}");
                let angle = (-x).atan2(y).to_degrees() - arm.config.zero_deg[index];
                assert!((angle - joints[index]).abs() < 1e-9, "{angle}");
            }
            assert!(links.tip[1] > links.proximal[0][1].max(links.proximal[1][1]));
        }
    }

    /// Virtual work: a small motion of a joint moves the tip against the force.
    #[test]
    fn loads_do_the_work_of_the_force() {
        let mut arm = arm();
        let force = [31.0, -17.0, 5.0];
        for (first, second) in [(30.0, -40.0), (85.0, -30.0), (48.0, -48.0)] {
            let joints = [first, second, 12.0, 0.0, 0.0, 0.0];
            let mut pose = [0.0; MAX_AXES];
            assert!(arm.follow(&joints, &mut pose));
            let loads = arm.joint_loads(&joints, &pose, force, 7.0).expect("loads");
            for joint in 0..3 {
                let step = 1e-4;
                let tips = [-step, step].map(|by| {
                    let mut moved = joints;
                    moved[joint] += by;
                    let mut pose = [0.0; MAX_AXES];
                    assert!(arm.follow(&moved, &mut pose));
                    [pose[0], pose[1], pose[2]]
                });
                let work = dot(force, minus(tips[1], tips[0])) / (2.0 * step);
                // N mm per degree, and N, to N m and N.
                let want = match joint {
                    2 => work,
                    _ => work.to_degrees() * 1e-3,
                };
                assert!(
                    (loads[joint] - want).abs() < 1e-6,
                    "{joint}: {loads:?} {want}"
                );
            }
        }
    }

    #[test]
    fn elbows_too_far_apart_hold_no_tip() {
        let mut arm = arm();
        let mut pose = [0.0; MAX_AXES];
        assert!(!arm.follow(&[90.0, -90.0, 0.0, 0.0, 0.0, 0.0], &mut pose));
    }
}
