//! Haptic arm messages: the master pose, the force feedback, and problems of the arm.
//!
//! Lengths are `i32` in 2^-20 mm. Forces are 2^-16 N unless stated otherwise. The frame is that of
//! the arm's base, which is parallel to the workpiece frame. A *component* is 0 for x, 1 for y, 2
//! for z.
//!
//! Callers must not queue these messages: only the newest one is valid.

pub use crate::force::{COMPONENT_NAMES, COMPONENTS};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Pose of a master, also of a remote master.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MasterPose {
    /// Position of the tip, 2^-20 mm.
    pub tip: [i32; COMPONENTS],
    /// Rate of the tip, 2^-12 mm/s.
    pub rate: [i32; COMPONENTS],
    /// Directions of the x and z axes of the handle, 32767 for 1.
    pub axes: [[i16; COMPONENTS]; 2],
    /// The enabling switch is pressed.
    pub enabling_switch: bool,
}

/// State of a master, from the controller of its arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MasterTelemetry {
    /// The control period.
    pub period: u64,
    /// Master pose.
    pub pose: MasterPose,
    /// Force on the operator, 2^-8 N.
    pub force: [i16; COMPONENTS],
    /// Force of the force feedback law alone, 2^-8 N.
    pub feedback: [i16; COMPONENTS],
    /// Force of the virtual fixtures, 2^-8 N.
    pub fixture: [i16; COMPONENTS],
    /// Energy surplus, below 0 deficit, 2^-8 N mm: the smaller one of the passivity observer and
    /// the oscillation damper.
    pub energy: i16,
    /// The amplifiers of the motors are on.
    pub enabled: bool,
    /// Problem of the arm.
    pub problem: Option<MasterProblem>,
}

/// Force feedback of one axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceFeedbackAxis {
    /// Percentage of the force on the tool, 0 to 100.
    pub percent: u8,
    /// Largest force feedback, 2^-16 N, up to 10 N.
    pub limit: i32,
}

/// Settings of the force feedback law (docs/control.md 3.4).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceFeedback {
    /// x, y, z.
    pub axes: [ForceFeedbackAxis; COMPONENTS],
    /// Velocity-proportional damping term where force feedback is too weak to be felt, 2^-16 N
    /// s/mm; 0 for none.
    pub damping: u16,
    /// Force feedback above which the damping term is off, 2^-16 N.
    pub damping_below: i32,
}

/// Virtual fixture: a face of the box around the master's tip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VirtualFixture {
    /// Position of the face, 2^-20 mm; `None` for the present position of the tip.
    pub at: Option<i32>,
    /// Rate of the face, 2^-12 mm/s.
    pub rate: i32,
}

/// Problem of a haptic arm or of the connection to it. Its motors are off, or the tool does not
/// follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MasterProblem {
    /// The readings of a leg contradict those of the others: an encoder has jumped, is stuck, or is
    /// wired backwards.
    Encoder {
        /// The leg.
        leg: u8,
        /// Length by which a side of the platform appears too long, 2^-20 mm.
        by: i32,
    },
    /// An encoder made illegal transitions.
    Illegal {
        /// The leg.
        leg: u8,
        /// 0 for the slide d, 1 for theta3, 2 for theta4.
        sensor: u8,
    },
    /// A reading is outside the range of its joint.
    Range {
        /// The leg.
        leg: u8,
        /// 0 for the slide d, 1 for theta3, 2 for theta4.
        sensor: u8,
    },
    /// The arm is near a pose in which it cannot exert a force in every direction.
    Singular,
    /// The amplifiers report a fault.
    Drive,
}
