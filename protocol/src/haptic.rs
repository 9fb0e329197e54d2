//! What is said of a haptic arm: where the hand is, what it shall feel, and what is wrong with the arm.
//!
//! Lengths `i32` in 2^-20 mm, forces 2^-16 N where nothing else is said, in the frame of the arm's base, which is parallel to that of the work. A *component* is 0 for x, 1 for y, 2 for z.
//!
//! Misuse: queuing what is here. A hand has only a present; of two messages the later one is true.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Components of a force or a place: x, y, z.
pub const COMPONENTS: usize = 3;

/// Where a hand is: what leads a tool from afar.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hand {
    /// The tip.
    pub tip: [i32; COMPONENTS],
    /// Its rate, 2^-12 mm/s.
    pub rate: [i32; COMPONENTS],
    /// The x and the z axis of the handle, 32767 for 1.
    pub axes: [[i16; COMPONENTS]; 2],
    /// The button is held: the hand leads.
    pub engaged: bool,
}

/// How a hand stands, from the controller of its arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HandTelemetry {
    /// The control period.
    pub period: u64,
    /// Where it is.
    pub hand: Hand,
    /// What it is made to feel, 2^-8 N.
    pub force: [i16; COMPONENTS],
    /// What the law of reflection alone would have made it feel, 2^-8 N.
    pub reflected: [i16; COMPONENTS],
    /// What the virtual walls push, 2^-8 N.
    pub wall: [i16; COMPONENTS],
    /// Credit of energy at the hand, below 0 debt, 2^-8 N mm: the lesser one of all motion and of swings.
    pub energy: i16,
    /// The motors' amplifiers are on.
    pub enabled: bool,
    /// What is wrong with the arm.
    pub problem: Option<HandProblem>,
}

/// The reflection of one axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReflectAxis {
    /// Percent of the force on the tool, to 100.
    pub percent: u8,
    /// The most that it makes, 2^-16 N, to 10 N.
    pub most: i32,
}

/// What part of the force on the tool the hand feels (docs/control.md 3.4).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Reflection {
    /// x, y, z.
    pub axes: [ReflectAxis; COMPONENTS],
    /// Force against the motion of the hand where the reflection is too weak to be felt, 2^-16 N s/mm; 0 for none.
    pub boost: u16,
    /// Where it is strong enough, 2^-16 N.
    pub boost_below: i32,
}

/// A face of the box in which the hand is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Wall {
    /// Where it is, 2^-20 mm; none for where the tip is now.
    pub at: Option<i32>,
    /// How fast it moves, 2^-12 mm/s.
    pub rate: i32,
}

/// What is wrong with a haptic arm, or with the way to it. Its motors are off, or the tool does not follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HandProblem {
    /// The readings of a leg do not fit those of the others: an encoder has jumped, sticks, or is wired backwards.
    Encoder {
        /// The leg.
        leg: u8,
        /// How much a side of the platform seems too long, 2^-20 mm.
        by: i32,
    },
    /// Illegal transitions of an encoder.
    Illegal {
        /// The leg.
        leg: u8,
        /// 0 for the slide d, 1 for theta3, 2 for theta4.
        sensor: u8,
    },
    /// A reading outside of what the joint can do.
    Range {
        /// The leg.
        leg: u8,
        /// 0 for the slide d, 1 for theta3, 2 for theta4.
        sensor: u8,
    },
    /// The arm is near a pose in which it cannot push the hand in every direction.
    Singular,
    /// The amplifiers report a fault.
    Drive,
}
