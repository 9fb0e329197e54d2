//! The list of machines, one module each, and the dispatch over it.
//!
//! A new machine is a module with a [`Machine`] and a row in the list below. The row gives the
//! configuration its variant and all functions here their arm.

pub mod cartesian;
pub mod corexy;
pub mod facet;
pub mod five_bar;
pub mod h4;
pub mod linear_delta;
pub mod polar_mill;
pub mod scara;
pub mod trunnion;

use crate::descriptor::{Descriptor, NO_MACHINE};
use crate::machine::Machine;
use crate::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::{Angle, Length};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Defines the configuration's model, the machine behind it, and the dispatch.
macro_rules! machines {
    ($($(#[$doc:meta])* $name:ident($machine:ty);)*) => {
        /// Kind of machine and its lengths.
        #[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub enum Model {
            $($(#[$doc])* $name(<$machine as Machine>::Geometry),)*
            /// No machine: a haptic arm alone, which moves the tool of a remote machine.
            None,
        }

        /// The descriptors of all machines, in the order of [`Model`].
        pub const DESCRIPTORS: &[&Descriptor] = &[$(&<$machine>::DESCRIPTOR),*];

        impl Model {
            /// Coordinates and joints of the machine.
            #[must_use]
            pub const fn descriptor(&self) -> &'static Descriptor {
                match self {
                    $(Self::$name(_) => const { &<$machine>::DESCRIPTOR },)*
                    Self::None => &NO_MACHINE,
                }
            }

            /// Whether a joint may move alone, to search its home switch.
            #[must_use]
            pub fn joints_move_alone(&self) -> bool {
                match self {
                    $(Self::$name(_) => <$machine as Machine>::joints_move_alone(),)*
                    Self::None => true,
                }
            }

            /// Whether the lengths are within the range of the arithmetic and make a machine.
            #[must_use]
            pub fn is_sound(&self) -> bool {
                match self {
                    // A function of the same name of the machine itself has other bounds.
                    $(Self::$name(geometry) => <$machine as Machine>::is_sound(geometry),)*
                    Self::None => true,
                }
            }
        }

        /// A machine of the list.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub(crate) enum AnyMachine {
            $($name($machine),)*
            None,
        }

        impl AnyMachine {
            pub(crate) fn new(model: &Model) -> Self {
                match model {
                    $(Model::$name(geometry) => Self::$name(<$machine as Machine>::new(geometry)),)*
                    Model::None => Self::None,
                }
            }

            pub(crate) const fn descriptor(&self) -> &'static Descriptor {
                match self {
                    $(Self::$name(_) => const { &<$machine>::DESCRIPTOR },)*
                    Self::None => &NO_MACHINE,
                }
            }

            #[inline]
            pub(crate) fn solve(
                &self,
                pose: &Pose,
                rates: &Rates,
                accelerations: &Accelerations,
                motion: &mut JointMotion,
            ) -> Result<(), PoseError> {
                match self {
                    $(Self::$name(machine) => machine.solve(pose, rates, accelerations, motion),)*
                    Self::None => {
                        *motion = JointMotion::default();
                        Ok(())
                    }
                }
            }

            #[inline]
            pub(crate) fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
                match self {
                    $(Self::$name(machine) => machine.inverse(pose),)*
                    Self::None => Ok(Joints::default()),
                }
            }

            #[inline]
            pub(crate) fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
                match self {
                    $(Self::$name(machine) => machine.forward(joints),)*
                    Self::None => Ok(Pose::default()),
                }
            }

            pub(crate) fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
                match self {
                    $(Self::$name(machine) => machine.jacobian(pose),)*
                    Self::None => Err(PoseError::Unreachable),
                }
            }

            #[inline]
            pub(crate) fn box_bounds(
                &self,
                low: &Pose,
                high: &Pose,
                rates: &[Rates],
            ) -> Result<BoxBounds, PoseError> {
                match self {
                    $(Self::$name(machine) => machine.box_bounds(low, high, rates),)*
                    Self::None => Ok(BoxBounds::default()),
                }
            }

            pub(crate) fn singularity_distance(
                &self,
                pose: &Pose,
            ) -> Option<Result<Length, PoseError>> {
                match self {
                    $(Self::$name(machine) => Machine::singularity_distance(machine, pose),)*
                    Self::None => None,
                }
            }

            #[inline]
            pub(crate) fn sensor_rotation(&self, pose: &Pose) -> [Angle; 2] {
                match self {
                    $(Self::$name(machine) => machine.sensor_rotation(pose),)*
                    Self::None => [Angle::ZERO; 2],
                }
            }

            pub(crate) fn search_coordinate(&self, joint: usize) -> usize {
                match self {
                    $(Self::$name(_) => <$machine>::search_coordinate(joint),)*
                    Self::None => joint,
                }
            }

            pub(crate) fn search_rates(
                &self,
                joint: usize,
                pose: &Pose,
                rate: i64,
            ) -> [i64; MAX_AXES] {
                match self {
                    $(Self::$name(machine) => machine.search_rates(joint, pose, rate),)*
                    Self::None => [0; MAX_AXES],
                }
            }
        }
    };
}

machines! {
    /// The hybrid H-4 arm with its rotary table.
    H4(h4::H4);
    /// A machine whose joints move the tool along x, y and z.
    Cartesian(cartesian::Cartesian);
    /// Slides x, y, z, and a table that turns about z on a trunnion that tilts about x.
    Trunnion(trunnion::Trunnion);
    /// A lift with a tilting, spinning dop over a lap on two slides.
    Facet(facet::Facet);
    /// Shoulder and elbow about vertical axes, and a vertical slide.
    Scara(scara::Scara);
    /// Slides x, y, z, and a rotary axis a.
    FourAxis(cartesian::FourAxis);
    /// Three vertical slides with rods that hold a level platform.
    LinearDelta(linear_delta::LinearDelta);
    /// Two arms of two links, from motors on one line to one tool, and a vertical slide.
    FiveBar(five_bar::FiveBar);
    /// A radial slide over a table that turns about z, and a vertical slide.
    PolarMill(polar_mill::PolarMill);
    /// Three slides and three rotary axes, each joint a pose coordinate.
    SixAxis(cartesian::SixAxis);
    /// Two crossed belts that move the tool along x and y, and a vertical slide.
    Corexy(corexy::Corexy);
}
