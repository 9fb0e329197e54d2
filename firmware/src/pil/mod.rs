//! A controller and a machine that are apart: [`Inputs`] and [`Outputs`] as frames of one size, exchanged once a control period.
//!
//! ```text
//! board                                    simulator
//!   Hello     ------------------------------->
//!             <-------------------------------  Begin { period_us }
//!             <-------------------------------  Period { inputs, arrived }
//!   Done      ------------------------------->
//!                        ... and so on ...
//!             <-------------------------------  End
//!   Ended     ------------------------------->
//! ```
//!
//! The bytes of the host do not stand in the frames: they go over the board's own serial line. A frame says how many were put on it before
//! (`arrived`), so the board waits until its receive interrupt has seen them all; and how many were said (`said`), so the simulator waits for
//! these. What the board heard in the period stands in [`Done`], for the simulator to compare with what it should have heard.
//!
//! A frame is a row of little-endian words: kind and version, contents, check. The check (FNV-1a over words) finds frames that are cut, shifted or of
//! another version; it is no CRC, because the transport (a pipe, or memory) does not flip bits.
//!
//! The board works on frames as words, where they are, and on its inputs and outputs, where they are ([`read`], [`Says`]): on an emulated chip moving them about
//! took longer than the control period. The simulator has them as values ([`ToBoard`], [`FromBoard`]), and in bytes.
//!
//! Misuse: a frame has no place for what is longer than a period; whoever skips a frame is out of step for good.

mod fields;
mod words;

use crate::io::{Inputs, Outputs};
use crate::profiler::STAGES;
use crate::snapshot::Snapshot;
use fields::{
    put_axis, put_done, put_force, put_hand, take_axis, take_done, take_force, take_hand,
};
pub use words::seal;
use words::{Reader, Writer, check, from_bytes, to_bytes};

/// Words of a frame to the board.
pub const TO_BOARD_WORDS: usize = 56;
/// Words of a frame from the board.
pub const FROM_BOARD_WORDS: usize = 105;
/// Bytes of a frame to the board.
pub const TO_BOARD_BYTES: usize = 4 * TO_BOARD_WORDS;
/// Bytes of a frame from the board.
pub const FROM_BOARD_BYTES: usize = 4 * FROM_BOARD_WORDS;

/// What the simulator says.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one of them exists, on the stack, once a period"
)]
pub enum ToBoard {
    /// A run begins, with a new controller.
    Begin {
        /// Control period, microseconds.
        period_us: u16,
    },
    /// A control period. Of the inputs, what belongs to the serial line (`received`, `waiting`, `lost_bytes`, `urgent`) is the board's own.
    Period {
        /// What is sensed.
        inputs: Inputs,
        /// Bytes that were put on the serial line since the last frame.
        arrived: u32,
    },
    /// The run is over.
    End,
}

/// What the board says.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one of them exists, on the stack, once a period"
)]
pub enum FromBoard {
    /// It has started.
    Hello,
    /// A control period is done.
    Done(Done),
    /// It stops.
    Ended {
        /// Bytes of stack that were ever used.
        stack_bytes: u32,
        /// The most bytes that ever waited in the receive ring.
        ring_peak: u32,
    },
}

/// A control period that is done.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Done {
    /// Number of the period.
    pub period: u64,
    /// What is to be done; `transmit` is empty here.
    pub outputs: Outputs,
    /// Bytes that were said on the serial line.
    pub said: u16,
    /// What the board heard.
    pub heard: Heard,
    /// Ticks of the board's counter in each stage, in the order of [`Stage`].
    pub stages: [u32; STAGES],
    /// How the controller stands, if it is configured.
    pub snapshot: Option<Snapshot>,
}

/// What came over the serial line for a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Heard {
    /// Bytes handed to the controller.
    pub received: u16,
    /// Bytes that wait.
    pub waiting: u16,
    /// Bytes lost for want of room.
    pub lost_bytes: u16,
    /// The urgent stop was seen.
    pub urgent: bool,
}

impl Done {
    const fn told(&self) -> Told<'_> {
        Told {
            period: self.period,
            outputs: &self.outputs,
            said: self.said,
            heard: self.heard,
            stages: &self.stages,
            snapshot: self.snapshot.as_ref(),
        }
    }
}

impl Heard {
    /// What inputs say was heard.
    #[must_use]
    pub fn of(inputs: &Inputs) -> Self {
        Self {
            received: inputs.received.len() as u16,
            waiting: inputs.waiting,
            lost_bytes: inputs.lost_bytes,
            urgent: inputs.urgent,
        }
    }
}

/// Why a frame cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// The check says that it was damaged, or that the two ends are out of step.
    Check,
    /// Another version of this software made it.
    Version,
    /// It says something that does not exist.
    Content,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Check => "a frame of the plant link is damaged",
            Self::Version => "the image is of another version than this program; build it anew",
            Self::Content => "a frame of the plant link makes no sense",
        })
    }
}

impl core::error::Error for FrameError {}

/// What the simulator says to a board that takes the inputs where it keeps them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// As [`ToBoard::Begin`].
    Begin {
        /// Control period, microseconds.
        period_us: u16,
    },
    /// As [`ToBoard::Period`].
    Period {
        /// Bytes that were put on the serial line since the last frame.
        arrived: u32,
    },
    /// As [`ToBoard::End`].
    End,
}

/// Reads a frame to the board. What is sensed goes to `inputs`; what belongs to the serial line stays there as it was.
///
/// # Errors
/// See [`FrameError`]; `inputs` are as they were.
#[inline]
pub fn read(frame: &[u32; TO_BOARD_WORDS], inputs: &mut Inputs) -> Result<Order, FrameError> {
    let (kind, mut words) = Reader::begin(frame)?;
    match kind {
        1 => Ok(Order::Begin {
            period_us: words.take() as u16,
        }),
        2 => {
            inputs.period = words.take_long();
            let [pair, time_ns, arrived, bits] = words.take_all();
            inputs.missed = pair as u16;
            inputs.transmit_room = (pair >> 16) as u16;
            inputs.time_ns = time_ns;
            inputs.emergency_stop = bits & 1 != 0;
            inputs.force = take_force(&mut words);
            take_hand(&mut words, &mut inputs.haptic);
            for axis in &mut inputs.axes {
                *axis = take_axis(&mut words);
            }
            Ok(Order::Period { arrived })
        }
        3 => Ok(Order::End),
        _ => Err(FrameError::Content),
    }
}

impl ToBoard {
    /// The frame.
    #[must_use]
    pub fn encode(&self) -> [u8; TO_BOARD_BYTES] {
        let mut bytes = self.encode_unsealed();
        seal(&mut bytes);
        bytes
    }

    /// The frame without its check; see [`seal`].
    #[must_use]
    pub fn encode_unsealed(&self) -> [u8; TO_BOARD_BYTES] {
        let mut frame = [0; TO_BOARD_WORDS];
        let mut words = Writer::begin(&mut frame);
        match self {
            Self::Begin { period_us } => {
                words.head(1);
                words.put(u32::from(*period_us));
            }
            Self::Period { inputs, arrived } => {
                words.head(2);
                words.put_long(inputs.period);
                words.put(u32::from(inputs.missed) | u32::from(inputs.transmit_room) << 16);
                words.put(inputs.time_ns);
                words.put(*arrived);
                words.put(u32::from(inputs.emergency_stop));
                put_force(&mut words, &inputs.force);
                put_hand(&mut words, &inputs.haptic);
                for axis in &inputs.axes {
                    put_axis(&mut words, axis);
                }
            }
            Self::End => words.head(3),
        }
        words.end();
        to_bytes(&frame)
    }

    /// What a frame says.
    ///
    /// # Errors
    /// See [`FrameError`].
    pub fn decode(bytes: &[u8; TO_BOARD_BYTES]) -> Result<Self, FrameError> {
        let mut inputs = Inputs::default();
        Ok(match read(&from_bytes(bytes), &mut inputs)? {
            Order::Begin { period_us } => Self::Begin { period_us },
            Order::Period { arrived } => Self::Period { inputs, arrived },
            Order::End => Self::End,
        })
    }
}

/// A control period that is done, as [`Done`] has it, where it lies.
#[derive(Debug)]
pub struct Told<'a> {
    /// Number of the period.
    pub period: u64,
    /// What is to be done.
    pub outputs: &'a Outputs,
    /// Bytes that were said on the serial line.
    pub said: u16,
    /// What the board heard.
    pub heard: Heard,
    /// Ticks of the board's counter in each stage.
    pub stages: &'a [u32; STAGES],
    /// How the controller stands, if it is configured.
    pub snapshot: Option<&'a Snapshot>,
}

/// What a board says of what lies where it is, as [`FromBoard`] has it by value.
#[derive(Debug)]
pub enum Says<'a> {
    /// As [`FromBoard::Hello`].
    Hello,
    /// As [`FromBoard::Done`].
    Done(Told<'a>),
    /// As [`FromBoard::Ended`].
    Ended {
        /// Bytes of stack that were ever used.
        stack_bytes: u32,
        /// The most bytes that ever waited in the receive ring.
        ring_peak: u32,
    },
}

impl Says<'_> {
    /// Writes its frame.
    #[inline]
    pub fn write(&self, frame: &mut [u32; FROM_BOARD_WORDS]) {
        self.fill(frame);
        if let Some((last, words)) = frame.split_last_mut() {
            *last = check(words);
        }
    }

    #[inline(always)]
    fn fill(&self, frame: &mut [u32; FROM_BOARD_WORDS]) {
        let mut words = Writer::begin(frame);
        match self {
            Self::Hello => words.head(1),
            Self::Done(done) => {
                words.head(2);
                put_done(&mut words, done);
            }
            Self::Ended {
                stack_bytes,
                ring_peak,
            } => {
                words.head(3);
                words.put_all([*stack_bytes, *ring_peak]);
            }
        }
        words.end();
    }
}

impl FromBoard {
    const fn says(&self) -> Says<'_> {
        match self {
            Self::Hello => Says::Hello,
            Self::Done(done) => Says::Done(done.told()),
            Self::Ended {
                stack_bytes,
                ring_peak,
            } => Says::Ended {
                stack_bytes: *stack_bytes,
                ring_peak: *ring_peak,
            },
        }
    }

    /// The frame.
    #[must_use]
    pub fn encode(&self) -> [u8; FROM_BOARD_BYTES] {
        let mut frame = [0; FROM_BOARD_WORDS];
        self.says().write(&mut frame);
        to_bytes(&frame)
    }

    /// The frame without its check; see [`seal`].
    #[must_use]
    pub fn encode_unsealed(&self) -> [u8; FROM_BOARD_BYTES] {
        let mut frame = [0; FROM_BOARD_WORDS];
        self.says().fill(&mut frame);
        to_bytes(&frame)
    }

    /// What a frame says.
    ///
    /// # Errors
    /// See [`FrameError`].
    pub fn decode(bytes: &[u8; FROM_BOARD_BYTES]) -> Result<Self, FrameError> {
        let frame: [u32; FROM_BOARD_WORDS] = from_bytes(bytes);
        let (kind, mut words) = Reader::begin(&frame)?;
        match kind {
            1 => Ok(Self::Hello),
            2 => take_done(&mut words).map(Self::Done),
            3 => Ok(Self::Ended {
                stack_bytes: words.take(),
                ring_peak: words.take(),
            }),
            _ => Err(FrameError::Content),
        }
    }
}

#[cfg(test)]
mod tests;
