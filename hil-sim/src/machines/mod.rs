//! Machine geometries of the simulator, one file each.
//!
//! A geometry is written in f64 from the loop-closure equations, independently of the firmware's
//! formulas. A new one is a file with a [`Geometry`] and a row in the list below; the row gives it
//! its key in `[plant.geometry]`.

pub mod carriage_errors;
pub mod cartesian;
pub mod corexy;
pub mod facet;
pub mod five_bar;
pub mod four_axis;
pub mod h4;
pub mod linear_delta;
pub mod polar_mill;
pub mod scara;
pub mod six_axis;
pub mod trunnion;

use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::{LEVEL, Vector, plus, times};
use carriage_errors::CarriageErrors;
use serde::{Deserialize, Serialize};

/// A degree in radians.
const DEGREE: f64 = core::f64::consts::PI / 180.0;

/// Radius of a table, and half the length of an axis, of which the machine file has no size, mm:
/// for pictures.
const PICTURE_MM: f64 = 80.0;

/// The edge of a table about a centre, with the directions of two of its radii.
fn round_table(centre: Vector, [first, second]: [Vector; 2]) -> Vec<Vector> {
    let place = |step: u32| {
        let (sin, cos) = libm::sincos(f64::from(step) * 15.0 * DEGREE);
        let from_centre = plus(times(first, cos), times(second, sin));
        plus(centre, times(from_centre, PICTURE_MM))
    };
    (0..=24).map(place).collect()
}

/// A machine as a picture shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The links of an arm, and what holds the workpiece and turns, as polylines; none where all
    /// joints are slides of the tool.
    pub links: Vec<Vec<Vector>>,
    /// Unit vector from the tip to the spindle.
    pub tool_axis: Vector,
}

/// Geometry of a simulated machine: it follows the joints with the pose of the tool.
pub trait Geometry: Sized {
    /// Section of the machine file, mm and degrees.
    type Config;

    /// Adds the problems of a configuration, with joints of these kinds.
    fn check(config: &Self::Config, kinds: &[JointKind], check: &mut Check);

    /// The geometry with its joints at these positions.
    ///
    /// # Errors
    /// Reason why the joints hold no pose.
    fn new(config: &Self::Config, joints: &JointArray) -> Result<Self, String>;

    /// Text of the error file of the carriages and the errors that it describes; `None` where the
    /// section has no such file, or an empty one.
    ///
    /// # Errors
    /// Problem of the error file.
    fn carriage_errors(config: &Self::Config) -> Result<Option<(&str, CarriageErrors)>, String> {
        let _ = config;
        Ok(None)
    }

    /// Writes the pose of the joints, mm and degrees, and returns whether there is one. The joints
    /// have moved little since the last call.
    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool;

    /// Whether joints of these kinds carry a tool that can cut.
    #[must_use]
    fn has_tool(kinds: &[JointKind]) -> bool {
        let _ = kinds;
        true
    }

    /// Tool in the workpiece frame at a pose.
    fn tool_pose(&self, pose: &JointArray) -> ToolPose;

    /// Moves the pose so that the tip of the tool is at this place in the workpiece frame; the
    /// inverse of [`Geometry::tool_pose`] for the tip. By default the pose has the place itself.
    fn place_tip(&self, tip: Vector, pose: &mut JointArray) {
        pose[..3].copy_from_slice(&tip);
    }

    /// The links of an arm, and what holds the workpiece and turns, as polylines in the workpiece
    /// frame, mm, for a picture; none where all joints are slides of the tool.
    fn links(&self, joints: &JointArray, pose: &JointArray) -> Vec<Vec<Vector>> {
        let _ = (joints, pose);
        Vec::new()
    }

    /// Directions of x, y and z of the workpiece frame in the machine frame, at a pose.
    fn workpiece_axes(&self, pose: &JointArray) -> [Vector; 3] {
        let _ = pose;
        LEVEL
    }

    /// Directions of x, y and z of the force sensor in the machine frame, at a pose: those in which
    /// the pose has x, y and z.
    fn sensor_axes(&self, pose: &JointArray) -> [Vector; 3] {
        self.workpiece_axes(pose)
    }

    /// Directions of x, y and z of the tool's own frame in the workpiece frame, at a pose; of use
    /// for a tool that is not round.
    fn tool_axes(&self, pose: &JointArray) -> [Vector; 3] {
        let _ = pose;
        LEVEL
    }

    /// Loads of the joints by a force on the tool in the workpiece frame, N, at a point `from_tip`
    /// mm from the tip. `None` where the geometry is singular.
    fn tool_loads(
        &self,
        joints: &JointArray,
        pose: &JointArray,
        force: [f64; 3],
        from_tip: Vector,
    ) -> Option<JointArray> {
        self.joint_loads(joints, pose, force, from_tip[2])
    }

    /// Loads of the joints, N and N m, by a force on the tool in the workpiece frame, N, which acts
    /// on the axis of the tool `above` mm from the tip. `None` where the geometry is singular.
    fn joint_loads(
        &self,
        joints: &JointArray,
        pose: &JointArray,
        force: [f64; 3],
        above: f64,
    ) -> Option<JointArray>;
}

/// Defines the configuration and the dispatch.
macro_rules! geometries {
    ($($(#[$doc:meta])* $name:ident($key:literal, $machine:ty);)*) => {
        /// Section `[plant.geometry]`: one subsection, named after the model.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub enum GeometryConfig {
            $($(#[$doc])* #[serde(rename = $key)] $name(<$machine as Geometry>::Config),)*
        }

        impl GeometryConfig {
            /// Name of the model, as in the machine file.
            #[must_use]
            pub const fn model(&self) -> &'static str {
                match self {
                    $(Self::$name(_) => $key,)*
                }
            }

            pub(crate) fn check(&self, kinds: &[JointKind], check: &mut Check) {
                match self {
                    $(Self::$name(config) => <$machine>::check(config, kinds, check),)*
                }
            }

            /// Text of the error file of the carriages and the errors that it describes; `None`
            /// where the section has no such file, or an empty one.
            ///
            /// # Errors
            /// Problem of the error file.
            pub fn carriage_errors(&self) -> Result<Option<(&str, CarriageErrors)>, String> {
                match self {
                    $(Self::$name(config) => <$machine>::carriage_errors(config),)*
                }
            }

            /// Pose of joint positions, mm and degrees, of the machine that is assembled there;
            /// `None` where it cannot be assembled.
            #[must_use]
            pub fn pose(&self, joints: &JointArray) -> Option<JointArray> {
                let mut pose = JointArray::default();
                let mut machine = AnyGeometry::new(self, joints).ok()?;
                machine.follow(joints, &mut pose).then_some(pose)
            }
        }

        impl GeometryConfig {
            /// Tool in the workpiece frame at joint positions, mm and degrees; `None` where the
            /// machine cannot be assembled.
            #[must_use]
            pub fn tool(&self, joints: &JointArray) -> Option<ToolPose> {
                let mut pose = JointArray::default();
                let mut machine = AnyGeometry::new(self, joints).ok()?;
                machine.follow(joints, &mut pose).then(|| machine.tool_pose(&pose))
            }

            /// Directions of x, y and z of the workpiece frame and of the force sensor in the
            /// machine frame, at joint positions, mm and degrees; `None` where the machine cannot
            /// be assembled.
            #[must_use]
            pub fn frames(&self, joints: &JointArray) -> Option<[[Vector; 3]; 2]> {
                let mut pose = JointArray::default();
                let mut machine = AnyGeometry::new(self, joints).ok()?;
                let frames = |machine: &AnyGeometry, pose| {
                    [machine.workpiece_axes(pose), machine.sensor_axes(pose)]
                };
                machine.follow(joints, &mut pose).then(|| frames(&machine, &pose))
            }

            /// Loads of the joints, N and N m, by a force in the workpiece frame, N, on the axis of
            /// the tool `above` mm from its tip; `None` where the machine is singular, or cannot be
            /// assembled.
            #[must_use]
            pub fn loads(
                &self,
                joints: &JointArray,
                force: [f64; 3],
                above: f64,
            ) -> Option<JointArray> {
                let mut pose = JointArray::default();
                let mut machine = AnyGeometry::new(self, joints).ok()?;
                if !machine.follow(joints, &mut pose) {
                    return None;
                }
                match &machine {
                    $(AnyGeometry::$name(machine) => {
                        Geometry::joint_loads(machine, joints, &pose, force, above)
                    })*
                }
            }

            /// The machine with its joints at these positions, mm and degrees, in the workpiece
            /// frame, mm; `None` where it cannot be assembled there.
            #[must_use]
            pub fn picture(&self, joints: &JointArray) -> Option<Picture> {
                let mut pose = JointArray::default();
                let mut machine = AnyGeometry::new(self, joints).ok()?;
                if !machine.follow(joints, &mut pose) {
                    return None;
                }
                Some(match &machine {
                    $(AnyGeometry::$name(machine) => Picture {
                        links: Geometry::links(machine, joints, &pose),
                        tool_axis: Geometry::tool_pose(machine, &pose).axis,
                    },)*
                })
            }
        }

        /// A geometry of the list.
        #[derive(Debug, Clone)]
        #[allow(clippy::large_enum_variant, reason = "a plant has one geometry")]
        pub(crate) enum AnyGeometry {
            $($name($machine),)*
        }

        impl AnyGeometry {
            pub(crate) fn new(
                config: &GeometryConfig,
                joints: &JointArray,
            ) -> Result<Self, String> {
                match config {
                    $(GeometryConfig::$name(config) => {
                        Ok(Self::$name(<$machine as Geometry>::new(config, joints)?))
                    })*
                }
            }

            pub(crate) fn has_tool(&self, kinds: &[JointKind]) -> bool {
                match self {
                    $(Self::$name(_) => <$machine as Geometry>::has_tool(kinds),)*
                }
            }

            pub(crate) fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
                match self {
                    $(Self::$name(machine) => Geometry::follow(machine, joints, pose),)*
                }
            }

            pub(crate) fn place_tip(&self, tip: Vector, pose: &mut JointArray) {
                match self {
                    $(Self::$name(machine) => Geometry::place_tip(machine, tip, pose),)*
                }
            }

            pub(crate) fn tool_pose(&self, pose: &JointArray) -> ToolPose {
                match self {
                    $(Self::$name(machine) => machine.tool_pose(pose),)*
                }
            }

            pub(crate) fn workpiece_axes(&self, pose: &JointArray) -> [Vector; 3] {
                match self {
                    $(Self::$name(machine) => machine.workpiece_axes(pose),)*
                }
            }

            pub(crate) fn sensor_axes(&self, pose: &JointArray) -> [Vector; 3] {
                match self {
                    $(Self::$name(machine) => machine.sensor_axes(pose),)*
                }
            }

            pub(crate) fn tool_axes(&self, pose: &JointArray) -> [Vector; 3] {
                match self {
                    $(Self::$name(machine) => machine.tool_axes(pose),)*
                }
            }

            pub(crate) fn tool_loads(
                &self,
                joints: &JointArray,
                pose: &JointArray,
                force: [f64; 3],
                from_tip: Vector,
            ) -> Option<JointArray> {
                match self {
                    $(Self::$name(machine) => {
                        Geometry::tool_loads(machine, joints, pose, force, from_tip)
                    })*
                }
            }
        }
    };
}

geometries! {
    /// The H-4 arm and its table.
    H4("h4", h4::H4);
    /// Joints that move the tool along x, y and z.
    Cartesian("cartesian", cartesian::Cartesian);
    /// Slides x, y, z, and a table that turns about z on a trunnion that tilts about x.
    Trunnion("trunnion", trunnion::Trunnion);
    /// A lift with a tilting, spinning dop over a lap on two slides.
    Facet("facet", facet::Facet);
    /// Shoulder and elbow about vertical axes, and a vertical slide.
    Scara("scara", scara::Scara);
    /// Slides x, y, z, and a workpiece that turns about an axis along x.
    FourAxis("four_axis", four_axis::FourAxis);
    /// Three vertical slides with rods that hold a level platform.
    LinearDelta("linear_delta", linear_delta::LinearDelta);
    /// Two arms of two links, from motors on one line to one tool, and a vertical slide.
    FiveBar("five_bar", five_bar::FiveBar);
    /// A radial slide over a table that turns about z, and a vertical slide.
    PolarMill("polar_mill", polar_mill::PolarMill);
    /// Three slides, and three rotary axes beside the tool and the workpiece.
    SixAxis("six_axis", six_axis::SixAxis);
    /// Two crossed belts that move the tool along x and y, and a vertical slide.
    Corexy("corexy", corexy::Corexy);
    /// Joints that carry nothing: the pose is the joint positions.
    Joints("joints", cartesian::BareJoints);
}
