//! A hand leads a machine from afar: the live loop between what a person moves and the controller that follows.
//!
//! A [`Source`] says where the hand is: a haptic arm on a controller of its own ([`arm`]), or keys and sticks that move a handle that does not exist ([`held`]). The loop ([`Teleop`]) hands
//! each new word of it to the controller of the machine as a latest value with its age, and brings what the tool feels back to the source. Nothing is queued: a hand has only a present.
//!
//! ```text
//! master arm -> its controller -> MasterTelemetry -> host -> MasterPose { epoch, age } -> machine controller -> tool
//! hand <- arm's controller <- Feel <- host <- Telemetry { force } <- machine's controller <- force sensor
//! ```
//!
//! What keeps it safe is in the controllers: the machine holds when the newest word is older than `stale_ms`, and goes on only when told to; the arm lets go of the hand 100 ms after the last
//! word of the force. The loop never goes on by itself after a hold.
//!
//! With both controllers in the simulator the loop runs in virtual time and leaves the same bits every time. With a port on either side it runs in real time.
//!
//! Misuse: a source that says the same place again and again with age 0. It would look alive when it is not; say a word when there is news, and nothing otherwise.

pub mod arm;
pub mod held;
pub mod latency;
mod outcome;
mod run;
pub mod script;

pub use arm::{Arm, PersonLine};
pub use latency::{Felt, Latency, LatencyFigures};
pub use outcome::{Ended, Outcome, Row, Stop};
pub use run::{Teleop, TeleopOptions};
pub use script::{Heard, Order, Script};

use haptimill_client::Error;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterPose};

/// G_P, the scale from hand to tool, may be this.
pub const SCALES: std::ops::RangeInclusive<f64> = 0.1..=2.0;

/// Where a hand is, and how old that is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Word {
    /// The hand.
    pub hand: MasterPose,
    /// How long ago it was so, microseconds.
    pub age_us: u64,
}

/// What a hand feels, N.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Feeling {
    /// What it is made to feel.
    pub force: [f64; COMPONENTS],
    /// What the law of reflection alone makes of the force on the tool.
    pub reflected: [f64; COMPONENTS],
}

/// Whether a source can lead.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Standing {
    /// It can.
    Ready,
    /// Not now, and why: it is not heard.
    Waiting(String),
    /// Not until somebody has looked after it, and why: it is heard, and off by a fault.
    Off(String),
}

impl Standing {
    /// Why it cannot, if it cannot.
    #[must_use]
    pub fn why(&self) -> Option<&str> {
        match self {
            Self::Ready => None,
            Self::Waiting(why) | Self::Off(why) => Some(why),
        }
    }
}

/// Something that says where a hand is.
pub trait Source {
    /// Looks whether there is a source at all; called before anything moves.
    ///
    /// # Errors
    /// What is there is no source, or does not answer.
    fn prepare(&mut self) -> Result<(), Error> {
        Ok(())
    }

    /// Goes on to a time of the loop, microseconds; gives the newest word, if there is a new one.
    ///
    /// # Errors
    /// It will never lead: what is there is no source. A link that is lost is no error, see [`Source::standing`].
    fn advance(&mut self, now_us: u64) -> Result<Option<Word>, Error>;

    /// Whether it can lead now.
    fn standing(&self) -> Standing;

    /// What the tool feels now: forces on it along x, y, z, 2^-6 N.
    fn feel(&mut self, _force: [i16; COMPONENTS]) {}

    /// What the hand is made to feel, if it is made to feel anything.
    fn feeling(&self) -> Option<Feeling> {
        None
    }

    /// What its controller made of the forces that it was told, one moment after the other.
    fn felt(&mut self) -> Option<Felt> {
        None
    }

    /// The law of reflection, where there is one.
    fn reflection(&self) -> Option<ForceFeedback> {
        None
    }

    /// Its fault was looked after.
    fn reset(&mut self) {}

    /// What went wrong with it, in words.
    fn happened(&mut self) -> Option<String> {
        None
    }

    /// What the operator orders on it.
    fn order(&mut self) -> Option<Order> {
        None
    }

    /// Time from here to its controller and back, microseconds; 0 where there is none.
    fn round_trip_us(&self) -> u32 {
        0
    }
}
