//! PIL (processor in the loop) link between a controller on a board and the simulated plant:
//! [`Inputs`] and [`Outputs`] as frames of fixed size, exchanged once per control period.
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
//! The frames do not contain the bytes of the host: these go over the board's own serial line. A
//! frame to the board counts the bytes put on that line before it (`arrived`), and the board waits
//! until its receive interrupt has seen them all. A frame from the board counts the bytes that the
//! board transmitted (`transmitted`), and the simulator waits for them. [`Done`] contains what the
//! board received in the period, which the simulator compares with what it sent.
//!
//! A frame is an array of little-endian words: kind and version, contents, check. The check (FNV-1a
//! over words) finds frames that are cut, shifted or of another version. It is no CRC, because the
//! transport (a pipe, or memory) does not flip bits.
//!
//! The board works in place: on frames as words, and on its own inputs and outputs ([`read`],
//! [`FromBoardRef`]). On an emulated chip, copying them took longer than the control period. The
//! simulator uses values ([`ToBoard`], [`FromBoard`]) and bytes.
//!
//! Callers must handle every frame. A frame describes one period, so an end that skips one stays
//! out of step.

mod fields;
mod words;

use crate::io::{Inputs, Outputs, Storage};
use crate::profiler::STAGES;
use crate::snapshot::Snapshot;
use fields::{
    put_analog, put_done, put_force, put_haptic, put_joint, take_analog, take_done, take_force,
    take_haptic, take_joint,
};
pub use words::seal;
use words::{Reader, Writer, check, from_bytes, to_bytes};

/// Size of a frame to the board, in words.
pub const TO_BOARD_WORDS: usize = 59;
/// Size of a frame from the board, in words.
pub const FROM_BOARD_WORDS: usize = 116;
/// Size of a frame to the board, in bytes.
pub const TO_BOARD_BYTES: usize = 4 * TO_BOARD_WORDS;
/// Size of a frame from the board, in bytes.
pub const FROM_BOARD_BYTES: usize = 4 * FROM_BOARD_WORDS;

/// Frame from the simulator to the board.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one of them exists, on the stack, once a period"
)]
pub enum ToBoard {
    /// A run starts, with a new controller.
    Begin {
        /// Control period, in microseconds.
        period_us: u16,
    },
    /// A control period. The board fills in the serial-line inputs itself: `received`, `waiting`,
    /// `lost_bytes`, `out_of_band_stop`.
    Period {
        /// Inputs of the plant.
        inputs: Inputs,
        /// Bytes put on the serial line since the last frame.
        arrived: u32,
    },
    /// The run has ended.
    End,
}

/// Frame from the board to the simulator.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one of them exists, on the stack, once a period"
)]
pub enum FromBoard {
    /// The board has started.
    Hello,
    /// A control period has run.
    Done(Done),
    /// The board stops.
    Ended {
        /// Largest use of the stack, in bytes.
        stack_bytes: u32,
        /// Largest number of bytes that waited in the receive ring.
        ring_peak: u32,
    },
}

/// Results of a control period.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Done {
    /// Number of the period.
    pub period: u64,
    /// Outputs, with an empty `transmit`.
    pub outputs: Outputs,
    /// Bytes transmitted on the serial line.
    pub transmitted: u16,
    /// Serial-line inputs of the board.
    pub line_inputs: LineInputs,
    /// Ticks of the board's counter in each stage, in the order of
    /// [`Stage`](crate::profiler::Stage).
    pub stages: [u32; STAGES],
    /// State of the controller, if it is configured.
    pub snapshot: Option<Snapshot>,
}

/// Serial-line inputs of a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LineInputs {
    /// Bytes passed to the controller.
    pub received: u16,
    /// Bytes that wait in the receive ring.
    pub waiting: u16,
    /// Bytes lost because the ring was full.
    pub lost_bytes: u16,
    /// The out-of-band stop was recognised.
    pub out_of_band_stop: bool,
}

impl Done {
    const fn by_reference(&self) -> DoneRef<'_> {
        DoneRef {
            period: self.period,
            outputs: &self.outputs,
            transmitted: self.transmitted,
            line_inputs: self.line_inputs,
            stages: &self.stages,
            snapshot: self.snapshot.as_ref(),
        }
    }
}

impl LineInputs {
    /// The serial-line part of the inputs.
    #[must_use]
    pub fn of(inputs: &Inputs) -> Self {
        Self {
            received: inputs.received.len() as u16,
            waiting: inputs.waiting,
            lost_bytes: inputs.lost_bytes,
            out_of_band_stop: inputs.out_of_band_stop,
        }
    }
}

/// Why a frame cannot be decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// The check differs: the frame is damaged, or the two ends are out of step.
    Check,
    /// Another version of this software made the frame.
    Version,
    /// The frame has an unknown kind or value.
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

/// Frame to a board that keeps its inputs in place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// As [`ToBoard::Begin`].
    Begin {
        /// Control period, in microseconds.
        period_us: u16,
    },
    /// As [`ToBoard::Period`].
    Period {
        /// Bytes put on the serial line since the last frame.
        arrived: u32,
    },
    /// As [`ToBoard::End`].
    End,
}

/// Decodes a frame to the board. The inputs of the plant go to `inputs`; the serial-line inputs
/// there stay unchanged.
///
/// # Errors
/// See [`FrameError`]; `inputs` stay unchanged.
#[inline]
pub fn read(frame: &[u32; TO_BOARD_WORDS], inputs: &mut Inputs) -> Result<Request, FrameError> {
    let (kind, mut words) = Reader::begin(frame)?;
    match kind {
        1 => Ok(Request::Begin {
            period_us: words.take() as u16,
        }),
        2 => {
            inputs.period = words.take_long();
            let [pair, time_ns, arrived, bits, digital] = words.take_all();
            inputs.missed = pair as u16;
            inputs.transmit_room = (pair >> 16) as u16;
            inputs.time_ns = time_ns;
            inputs.emergency_stop = bits & 1 != 0;
            inputs.storage = Storage::of_code((bits >> 8) as u8);
            inputs.digital = digital;
            inputs.analog = take_analog(&mut words);
            inputs.force = take_force(&mut words);
            take_haptic(&mut words, &mut inputs.haptic);
            for joint in &mut inputs.joints {
                *joint = take_joint(&mut words);
            }
            Ok(Request::Period { arrived })
        }
        3 => Ok(Request::End),
        _ => Err(FrameError::Content),
    }
}

impl ToBoard {
    /// Encodes the frame.
    #[must_use]
    pub fn encode(&self) -> [u8; TO_BOARD_BYTES] {
        let mut bytes = self.encode_unsealed();
        seal(&mut bytes);
        bytes
    }

    /// Encodes the frame without its check; see [`seal`].
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
                words.put(u32::from(inputs.emergency_stop) | (inputs.storage as u32) << 8);
                words.put(inputs.digital);
                put_analog(&mut words, inputs.analog);
                put_force(&mut words, &inputs.force);
                put_haptic(&mut words, &inputs.haptic);
                for joint in &inputs.joints {
                    put_joint(&mut words, joint);
                }
            }
            Self::End => words.head(3),
        }
        words.end();
        to_bytes(&frame)
    }

    /// Decodes a frame.
    ///
    /// # Errors
    /// See [`FrameError`].
    pub fn decode(bytes: &[u8; TO_BOARD_BYTES]) -> Result<Self, FrameError> {
        let mut inputs = Inputs::default();
        Ok(match read(&from_bytes(bytes), &mut inputs)? {
            Request::Begin { period_us } => Self::Begin { period_us },
            Request::Period { arrived } => Self::Period { inputs, arrived },
            Request::End => Self::End,
        })
    }
}

/// Results of a control period by reference; see [`Done`].
#[derive(Debug)]
pub struct DoneRef<'a> {
    /// Number of the period.
    pub period: u64,
    /// Outputs of the period.
    pub outputs: &'a Outputs,
    /// Bytes transmitted on the serial line.
    pub transmitted: u16,
    /// Serial-line inputs of the board.
    pub line_inputs: LineInputs,
    /// Ticks of the board's counter in each stage, in the order of
    /// [`Stage`](crate::profiler::Stage).
    pub stages: &'a [u32; STAGES],
    /// State of the controller, if it is configured.
    pub snapshot: Option<&'a Snapshot>,
}

/// Frame from the board, with its contents by reference; see [`FromBoard`].
#[derive(Debug)]
pub enum FromBoardRef<'a> {
    /// As [`FromBoard::Hello`].
    Hello,
    /// As [`FromBoard::Done`].
    Done(DoneRef<'a>),
    /// As [`FromBoard::Ended`].
    Ended {
        /// Largest use of the stack, in bytes.
        stack_bytes: u32,
        /// Largest number of bytes that waited in the receive ring.
        ring_peak: u32,
    },
}

impl FromBoardRef<'_> {
    /// Writes the frame.
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
    const fn by_reference(&self) -> FromBoardRef<'_> {
        match self {
            Self::Hello => FromBoardRef::Hello,
            Self::Done(done) => FromBoardRef::Done(done.by_reference()),
            Self::Ended {
                stack_bytes,
                ring_peak,
            } => FromBoardRef::Ended {
                stack_bytes: *stack_bytes,
                ring_peak: *ring_peak,
            },
        }
    }

    /// Encodes the frame.
    #[must_use]
    pub fn encode(&self) -> [u8; FROM_BOARD_BYTES] {
        let mut frame = [0; FROM_BOARD_WORDS];
        self.by_reference().write(&mut frame);
        to_bytes(&frame)
    }

    /// Encodes the frame without its check; see [`seal`].
    #[must_use]
    pub fn encode_unsealed(&self) -> [u8; FROM_BOARD_BYTES] {
        let mut frame = [0; FROM_BOARD_WORDS];
        self.by_reference().fill(&mut frame);
        to_bytes(&frame)
    }

    /// Decodes a frame.
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
