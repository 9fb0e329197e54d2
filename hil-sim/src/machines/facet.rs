//! A gem-faceting machine: products of the link transforms of its D-H table, from the base to the
//! tip of the dop, and the lap on two slides, with the errors of a real assembly.
//!
//! Units: mm and degrees. Modified D-H parameters of the chain, angles in degrees:
//!
//! | link | alpha | a | d | theta |
//! | --- | --- | --- | --- | --- |
//! | lift | 0 | 0 | d1 | 0 |
//! | tilt | -90 | L2 | 0 | theta2 |
//! | spin | 90 | L3 | 0 | theta3 |
//! | tip | 0 | 0 | L4 | 0 |
//!
//! The workpiece frame is the lap: its origin is the centre, z points away from the lap. The tool
//! is the stone; its own frame is that of the tip.

use super::{DEGREE, Geometry, round_table};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{Vector, cross, dot, minus, plus, times};
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.facet]`: lengths in mm. Lengths that differ from those of
/// `[kinematics]` are errors of position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FacetConfig {
    /// From the lift to the tilt axis, along x.
    pub l2: f64,
    /// From the tilt axis to the spin axis.
    pub l3: f64,
    /// From the tilt axis to the tip, along the spin axis.
    pub l4: f64,
    /// z of the lap in the base frame.
    pub z_lap: f64,
    /// Direction of the lap along z of the base: 1 or -1.
    pub lap_dir: f64,
    /// theta2 of the chain where the joint theta2 reads 0, degrees.
    pub theta2_zero_deg: f64,
    /// The lap is turned about its x axis by this angle, +-1 degree.
    #[serde(default)]
    pub lap_about_x_deg: f64,
    /// The lap is turned about its y axis by this angle, +-1 degree.
    #[serde(default)]
    pub lap_about_y_deg: f64,
}

/// Rows of the upper part of a homogeneous matrix.
type Transform = [[f64; 4]; 3];

/// Transform of a link.
fn link(alpha_deg: f64, a: f64, d: f64, theta_deg: f64) -> Transform {
    let (sin_alpha, cos_alpha) = libm::sincos(alpha_deg * DEGREE);
    let (sin, cos) = libm::sincos(theta_deg * DEGREE);
    [
        [cos, -sin, 0.0, a],
        [sin * cos_alpha, cos * cos_alpha, -sin_alpha, -sin_alpha * d],
        [sin * sin_alpha, cos * sin_alpha, cos_alpha, cos_alpha * d],
    ]
}

/// One transform, then the other in its frame.
fn then(first: &Transform, second: &Transform) -> Transform {
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let turned: f64 = (0..3).map(|k| first[i][k] * second[k][j]).sum();
            if j == 3 { turned + first[i][3] } else { turned }
        })
    })
}

/// A column of a transform.
fn column(of: &Transform, index: usize) -> Vector {
    [of[0][index], of[1][index], of[2][index]]
}

/// The machine.
#[derive(Debug, Clone)]
pub struct Facet {
    config: FacetConfig,
    /// Directions of x, y and z of the lap in the base.
    lap: [Vector; 3],
}

impl Facet {
    /// The frames of tilt and tip in the base.
    fn frames(&self, joints: &JointArray) -> [Transform; 2] {
        let config = &self.config;
        let lift = link(0.0, 0.0, joints[2], 0.0);
        let tilt = then(
            &lift,
            &link(-90.0, config.l2, 0.0, joints[3] + config.theta2_zero_deg),
        );
        let spin = then(&tilt, &link(90.0, config.l3, 0.0, joints[4]));
        [tilt, then(&spin, &link(0.0, 0.0, config.l4, 0.0))]
    }

    /// The origin of the lap in the base.
    fn lap_origin(&self, joints: &JointArray) -> Vector {
        // The slides run along x and along y of a lap that is not turned.
        let y = -self.config.lap_dir;
        [joints[0], y * joints[1], self.config.z_lap]
    }

    /// A direction of the base in the lap frame.
    fn to_lap(&self, direction: Vector) -> Vector {
        self.lap.map(|axis| dot(axis, direction))
    }

    /// A direction of the lap frame in the base.
    fn to_base(&self, [x, y, z]: Vector) -> Vector {
        let [a, b, c] = self.lap;
        plus(plus(times(a, x), times(b, y)), times(c, z))
    }

    /// Joints of a pose, as far as the rotation of the stone needs them.
    fn turned(&self, pose: &JointArray) -> Transform {
        let base = if self.config.lap_dir > 0.0 {
            0.0
        } else {
            180.0
        };
        let mut joints = JointArray::default();
        joints[3] = pose[3] + base - self.config.theta2_zero_deg;
        joints[4] = pose[4];
        self.frames(&joints)[1]
    }
}

impl Geometry for Facet {
    type Config = FacetConfig;

    fn check(config: &FacetConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Linear, Linear, Rotary, Rotary] {
            check.refuse(
                "geometry: facet".into(),
                "needs three linear joints lap_x, lap_y, d1 and then the rotary ones theta2 and \
                 index"
                    .into(),
            );
        }
        for (name, value, max) in [
            ("l2", config.l2, 2000.0),
            ("l3", config.l3, 1000.0),
            ("l4", config.l4, 1000.0),
            ("z_lap", config.z_lap, 2000.0),
            ("theta2_zero_deg", config.theta2_zero_deg, 180.0),
            ("lap_about_x_deg", config.lap_about_x_deg, 1.0),
            ("lap_about_y_deg", config.lap_about_y_deg, 1.0),
        ] {
            check.within(format!("geometry: facet: {name}"), value, -max, max);
        }
        if config.lap_dir.abs() != 1.0 {
            let what = format!("{} is neither 1 nor -1; write one of them", config.lap_dir);
            check.refuse("geometry: facet: lap_dir".into(), what);
        }
    }

    fn new(config: &FacetConfig, _: &JointArray) -> Result<Self, String> {
        let level = [
            [1.0, 0.0, 0.0],
            [0.0, -config.lap_dir, 0.0],
            [0.0, 0.0, -config.lap_dir],
        ];
        let about_x = link(config.lap_about_x_deg, 0.0, 0.0, 0.0);
        let (sin, cos) = libm::sincos(config.lap_about_y_deg * DEGREE);
        let about_y: Transform = [
            [cos, 0.0, sin, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [-sin, 0.0, cos, 0.0],
        ];
        let tilted = then(&about_y, &about_x);
        let lap = [0, 1, 2].map(|index| {
            let [x, y, z] = column(&tilted, index);
            plus(
                plus(times(level[0], x), times(level[1], y)),
                times(level[2], z),
            )
        });
        Ok(Self {
            config: config.clone(),
            lap,
        })
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let [_, tip] = self.frames(joints);
        let away = minus(column(&tip, 3), self.lap_origin(joints));
        *pose = *joints;
        pose[..3].copy_from_slice(&self.to_lap(away));
        let base = if self.config.lap_dir > 0.0 {
            0.0
        } else {
            180.0
        };
        let angle = joints[3] + self.config.theta2_zero_deg - base;
        pose[3] = angle - 360.0 * libm::round(angle / 360.0);
        true
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        let axis = self.to_lap(column(&self.turned(pose), 2));
        ToolPose {
            tip: [pose[0], pose[1], pose[2]],
            // From the tip to the machine.
            axis: times(axis, -1.0),
        }
    }

    /// The arm from the top of the lift to the tip, the lift, and the lap.
    fn links(&self, joints: &JointArray, _: &JointArray) -> Vec<Vec<Vector>> {
        let [tilt, tip] = self.frames(joints);
        let lap = self.lap_origin(joints);
        let place = |base: Vector| self.to_lap(minus(base, lap));
        let top = place([0.0, 0.0, joints[2]]);
        let arm = [top, place(column(&tilt, 3)), place(column(&tip, 3))];
        let edge = round_table([0.0; 3], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        vec![arm.to_vec(), vec![place([0.0; 3]), top], edge]
    }

    fn tool_axes(&self, pose: &JointArray) -> [Vector; 3] {
        let tip = self.turned(pose);
        [0, 1, 2].map(|index| self.to_lap(column(&tip, index)))
    }

    fn workpiece_axes(&self, _: &JointArray) -> [Vector; 3] {
        self.lap
    }

    fn joint_loads(
        &self,
        joints: &JointArray,
        pose: &JointArray,
        force: [f64; 3],
        above: f64,
    ) -> Option<JointArray> {
        let from_tip = times(self.tool_pose(pose).axis, above);
        self.tool_loads(joints, pose, force, from_tip)
    }

    /// Virtual work: the slides move the lap under the stone, the other joints the stone.
    fn tool_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        from_tip: Vector,
    ) -> Option<JointArray> {
        let [tilt, tip] = self.frames(joints);
        let force = self.to_base(force);
        let at = plus(column(&tip, 3), self.to_base(from_tip));
        let mut loads = JointArray::default();
        loads[0] = -force[0];
        loads[1] = self.config.lap_dir * force[1];
        loads[2] = force[2];
        // The tilt turns about z of its own frame, the spin about z of the tip.
        for (joint, frame) in [(3, &tilt), (4, &tip)] {
            let path = cross(column(frame, 2), minus(at, column(frame, 3)));
            loads[joint] = 1e-3 * dot(force, path);
        }
        Some(loads)
    }
}
