//! A mill whose table turns about two axes: homogeneous transforms from the machine frame along the
//! chain of the tool and along the chain of the workpiece, with the errors of a real assembly.
//!
//! Units: mm and degrees. The tool points down along z. The chain of the workpiece is: to the
//! trunnion's axis, its misalignment, turn by a about x, to the table's axis, its misalignment,
//! turn by c about z, to the origin of the workpiece.

use super::{DEGREE, Geometry, PICTURE_MM, round_table};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{Vector, cross, dot, minus, plus, times};
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.trunnion]`: offsets in mm in the machine frame, and errors. Offsets
/// that differ from those of `[kinematics]` are errors of position.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrunnionConfig {
    /// y of the trunnion's axis.
    pub tilt_y: f64,
    /// z of the trunnion's axis.
    pub tilt_z: f64,
    /// x of the table's axis with the trunnion at 0.
    pub table_x: f64,
    /// y of the table's axis with the trunnion at 0.
    pub table_y: f64,
    /// x of the workpiece's origin with both axes at 0.
    pub x_off: f64,
    /// y of the workpiece's origin with both axes at 0.
    pub y_off: f64,
    /// z of the workpiece's origin with both axes at 0.
    pub z_off: f64,
    /// Tool length.
    pub tl: f64,
    /// The trunnion's axis is turned about y by this angle, +-5 degrees.
    #[serde(default)]
    pub tilt_about_y_deg: f64,
    /// The trunnion's axis is turned about z by this angle, +-5 degrees.
    #[serde(default)]
    pub tilt_about_z_deg: f64,
    /// The table's axis is turned about x by this angle, +-5 degrees.
    #[serde(default)]
    pub table_about_x_deg: f64,
    /// The table's axis is turned about y by this angle, +-5 degrees.
    #[serde(default)]
    pub table_about_y_deg: f64,
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

/// A rotation and a displacement: the upper three rows of a homogeneous matrix, by its columns.
#[derive(Debug, Clone, Copy)]
struct Transform {
    columns: [Vector; 3],
    origin: Vector,
}

impl Transform {
    const NONE: Self = Self {
        columns: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        origin: [0.0; 3],
    };

    fn moved(by: Vector) -> Self {
        Self {
            origin: by,
            ..Self::NONE
        }
    }

    /// Rotation about a coordinate axis, right-handed.
    fn turned(axis: usize, degrees: f64) -> Self {
        let (sin, cos) = libm::sincos(degrees * DEGREE);
        let (one, two) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut turned = Self::NONE;
        turned.columns[one][one] = cos;
        turned.columns[one][two] = sin;
        turned.columns[two][two] = cos;
        turned.columns[two][one] = -sin;
        turned
    }

    fn direction(&self, [x, y, z]: Vector) -> Vector {
        let [a, b, c] = self.columns;
        plus(plus(times(a, x), times(b, y)), times(c, z))
    }

    fn point(&self, point: Vector) -> Vector {
        plus(self.direction(point), self.origin)
    }

    /// This one, then the other in its frame.
    fn then(&self, other: &Self) -> Self {
        Self {
            columns: other.columns.map(|column| self.direction(column)),
            origin: self.point(other.origin),
        }
    }

    /// The columns are orthonormal, so the inverse is the transpose.
    fn direction_back(&self, vector: Vector) -> Vector {
        self.columns.map(|column| dot(column, vector))
    }

    fn point_back(&self, point: Vector) -> Vector {
        self.direction_back(minus(point, self.origin))
    }
}

/// The mill.
#[derive(Debug, Clone)]
pub struct Trunnion {
    config: TrunnionConfig,
}

/// Pose coordinates and joints of trunnion and table.
const A: usize = 3;
const C: usize = 4;

impl Trunnion {
    /// Frames of the trunnion and of the table, from the machine frame: origin on the axis, the
    /// axis along x, or along z.
    fn axes(&self, a: f64, c: f64) -> [Transform; 2] {
        let config = &self.config;
        let tilt = Transform::moved([0.0, config.tilt_y, config.tilt_z])
            .then(&Transform::turned(1, config.tilt_about_y_deg))
            .then(&Transform::turned(2, config.tilt_about_z_deg))
            .then(&Transform::turned(0, a));
        let apart = [config.table_x, config.table_y - config.tilt_y, 0.0];
        let table = tilt
            .then(&Transform::moved(apart))
            .then(&Transform::turned(0, config.table_about_x_deg))
            .then(&Transform::turned(1, config.table_about_y_deg))
            .then(&Transform::turned(2, c));
        [tilt, table]
    }

    /// The workpiece frame.
    fn workpiece(&self, a: f64, c: f64) -> Transform {
        let config = &self.config;
        let origin = [
            config.x_off - config.table_x,
            config.y_off - config.table_y,
            config.z_off - config.tilt_z,
        ];
        let [_, table] = self.axes(a, c);
        table.then(&Transform::moved(origin))
    }

    /// Directions in which the slides move the tool.
    fn ways(&self) -> [Vector; 3] {
        let config = &self.config;
        [
            [1.0, 0.0, 0.0],
            [config.squareness_xy, 1.0, 0.0],
            [config.squareness_xz, config.squareness_yz, 1.0],
        ]
    }

    /// Tip of the tool in the machine frame.
    fn tip(&self, joints: &JointArray) -> Vector {
        let [x, y, z] = self.ways();
        let tip = plus(
            plus(times(x, joints[0]), times(y, joints[1])),
            times(z, joints[2]),
        );
        minus(tip, [0.0, 0.0, self.config.tl])
    }
}

impl Geometry for Trunnion {
    type Config = TrunnionConfig;

    fn check(config: &TrunnionConfig, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Linear, Linear, Rotary, Rotary] {
            check.refuse(
                "geometry: trunnion".into(),
                "needs three linear joints x, y, z and then the rotary ones a and c".into(),
            );
        }
        for (name, value, max) in [
            ("tilt_y", config.tilt_y, 2000.0),
            ("tilt_z", config.tilt_z, 2000.0),
            ("table_x", config.table_x, 2000.0),
            ("table_y", config.table_y, 2000.0),
            ("x_off", config.x_off, 2000.0),
            ("y_off", config.y_off, 2000.0),
            ("z_off", config.z_off, 2000.0),
            ("tl", config.tl, 2000.0),
            ("tilt_about_y_deg", config.tilt_about_y_deg, 5.0),
            ("tilt_about_z_deg", config.tilt_about_z_deg, 5.0),
            ("table_about_x_deg", config.table_about_x_deg, 5.0),
            ("table_about_y_deg", config.table_about_y_deg, 5.0),
            ("squareness_xy", config.squareness_xy, 0.1),
            ("squareness_xz", config.squareness_xz, 0.1),
            ("squareness_yz", config.squareness_yz, 0.1),
        ] {
            check.within(format!("geometry: trunnion: {name}"), value, -max, max);
        }
    }

    fn new(config: &TrunnionConfig, _: &JointArray) -> Result<Self, String> {
        Ok(Self {
            config: config.clone(),
        })
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let frame = self.workpiece(joints[A], joints[C]);
        *pose = *joints;
        pose[..3].copy_from_slice(&frame.point_back(self.tip(joints)));
        true
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        let frame = self.workpiece(pose[A], pose[C]);
        ToolPose {
            tip: [pose[0], pose[1], pose[2]],
            axis: frame.direction_back([0.0, 0.0, 1.0]),
        }
    }

    /// The head above the tip, the table, its cradle on the trunnion's axis, and the stands of the
    /// trunnion.
    fn links(&self, joints: &JointArray, _: &JointArray) -> Vec<Vec<Vector>> {
        let config = &self.config;
        let workpiece = self.workpiece(joints[A], joints[C]);
        let [tilt, table] = self.axes(joints[A], joints[C]);
        let tip = self.tip(joints);
        let height = config.z_off - config.tilt_z;
        let centre = table.point([0.0, 0.0, height]);
        let end = |side: f64, up: f64| tilt.point([config.table_x + side * PICTURE_MM, 0.0, up]);
        let foot = |side: f64| plus(end(side, 0.0), [0.0, 0.0, -1.5 * PICTURE_MM]);
        let lines = [
            vec![
                end(-1.0, 0.0),
                end(-1.0, height),
                end(1.0, height),
                end(1.0, 0.0),
            ],
            vec![end(-1.0, 0.0), end(1.0, 0.0)],
            vec![foot(-1.0), end(-1.0, 0.0)],
            vec![foot(1.0), end(1.0, 0.0)],
            round_table(centre, [table.columns[0], table.columns[1]]),
            vec![plus(tip, [0.0, 0.0, 2.0 * PICTURE_MM]), tip],
        ];
        let place = |line: &Vec<Vector>| line.iter().map(|at| workpiece.point_back(*at)).collect();
        lines.iter().map(place).collect()
    }

    fn workpiece_axes(&self, pose: &JointArray) -> [Vector; 3] {
        self.workpiece(pose[A], pose[C]).columns
    }

    /// Virtual work: a slide moves the tool, a rotary axis moves the workpiece under it.
    fn joint_loads(
        &self,
        joints: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        above: f64,
    ) -> Option<JointArray> {
        let [tilt, table] = self.axes(joints[A], joints[C]);
        let force = self.workpiece(joints[A], joints[C]).direction(force);
        let at = plus(self.tip(joints), [0.0, 0.0, above]);
        let mut loads = JointArray::default();
        for (load, way) in loads.iter_mut().zip(self.ways()) {
            *load = dot(force, way);
        }
        for (joint, frame, axis) in [(A, tilt, 0), (C, table, 2)] {
            let path = cross(frame.columns[axis], minus(at, frame.origin));
            loads[joint] = -1e-3 * dot(force, path);
        }
        Some(loads)
    }
}
