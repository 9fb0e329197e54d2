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

use crate::io::{
    AxisInputs, DriveCommand, ForceSample, HapticInputs, HapticOutputs, Inputs, LegInputs, Outputs,
    StepSegment,
};
use crate::probe::{STAGES, Stage};
use crate::reading::Reading;
use haptimill_protocol::message::State;

/// Words of a frame to the board.
pub const TO_BOARD_WORDS: usize = 56;
/// Words of a frame from the board.
pub const FROM_BOARD_WORDS: usize = 105;
/// Bytes of a frame to the board.
pub const TO_BOARD_BYTES: usize = 4 * TO_BOARD_WORDS;
/// Bytes of a frame from the board.
pub const FROM_BOARD_BYTES: usize = 4 * FROM_BOARD_WORDS;

/// Grows whenever a frame changes.
const VERSION: u32 = 5;

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
    pub reading: Option<Reading>,
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
            reading: self.reading.as_ref(),
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
            let pair = words.take();
            inputs.missed = pair as u16;
            inputs.transmit_room = (pair >> 16) as u16;
            inputs.time_ns = words.take();
            let arrived = words.take();
            inputs.emergency_stop = words.take() & 1 != 0;
            inputs.force = take_force(&mut words);
            inputs.haptic = take_hand(&mut words);
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
    pub reading: Option<&'a Reading>,
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
                words.put(*stack_bytes);
                words.put(*ring_peak);
            }
        }
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

fn put_force(words: &mut Writer<'_>, force: &ForceSample) {
    let [x, y, z] = force.codes.map(|code| u32::from(code as u16));
    words.put(x | y << 16);
    words.put(z | u32::from(force.conversions) << 16 | u32::from(force.overload) << 24);
}

#[inline(always)]
fn take_force(words: &mut Reader<'_>) -> ForceSample {
    let (pair, rest) = (words.take(), words.take());
    ForceSample {
        codes: [pair, pair >> 16, rest].map(|code| code as u16 as i16),
        conversions: (rest >> 16) as u8,
        overload: rest >> 24 & 1 != 0,
    }
}

fn put_hand(words: &mut Writer<'_>, hand: &HapticInputs) {
    words.put(u32::from(hand.engaged) | u32::from(hand.drives_ready) << 1);
    for leg in &hand.legs {
        leg.counts
            .iter()
            .for_each(|&counts| words.put(counts as u32));
        let [first, second, third] = leg.illegal.map(u32::from);
        words.put(first | second << 16);
        words.put(third);
    }
}

#[inline(always)]
fn take_hand(words: &mut Reader<'_>) -> HapticInputs {
    let bits = words.take();
    let mut hand = HapticInputs {
        engaged: bits & 1 != 0,
        drives_ready: bits & 2 != 0,
        ..HapticInputs::default()
    };
    for leg in &mut hand.legs {
        let counts = [words.take(), words.take(), words.take()].map(|word| word as i32);
        let (pair, third) = (words.take(), words.take());
        *leg = LegInputs {
            counts,
            illegal: [pair as u16, (pair >> 16) as u16, third as u16],
        };
    }
    hand
}

#[inline(always)]
fn put_currents(words: &mut Writer<'_>, hand: &HapticOutputs) {
    words.put(u32::from(hand.enabled));
    for [force, torque] in hand.currents {
        words.put(u32::from(force as u16) | u32::from(torque as u16) << 16);
    }
}

fn take_currents(words: &mut Reader<'_>) -> HapticOutputs {
    let mut hand = HapticOutputs {
        enabled: words.take() & 1 != 0,
        ..HapticOutputs::default()
    };
    for leg in &mut hand.currents {
        let pair = words.take();
        *leg = [pair as i16, (pair >> 16) as i16];
    }
    hand
}

fn put_axis(words: &mut Writer<'_>, axis: &AxisInputs) {
    words.put(axis.counts as u32);
    words.put(axis.edge_time_ns);
    words.put(axis.index_counts as u32);
    words.put(axis.steps as u32);
    let bits = [axis.home, axis.limit_low, axis.limit_high, axis.drive_ready];
    let bits = bits
        .iter()
        .rev()
        .fold(0, |all, &bit| all << 1 | u32::from(bit));
    words.put(u32::from(axis.illegal) | u32::from(axis.index_pulses) << 16 | bits << 24);
}

#[inline(always)]
fn take_axis(words: &mut Reader<'_>) -> AxisInputs {
    let (counts, edge_time_ns) = (words.take() as i32, words.take());
    let (index_counts, steps) = (words.take() as i32, words.take() as i32);
    let rest = words.take();
    let bit = |index: u32| rest >> (24 + index) & 1 != 0;
    AxisInputs {
        counts,
        edge_time_ns,
        illegal: rest as u16,
        index_counts,
        index_pulses: (rest >> 16) as u8,
        steps,
        home: bit(0),
        limit_low: bit(1),
        limit_high: bit(2),
        drive_ready: bit(3),
    }
}

#[inline(always)]
fn put_done(words: &mut Writer<'_>, done: &Told<'_>) {
    words.put_long(done.period);
    for command in &done.outputs.axes {
        let (kind, row) = match command {
            DriveCommand::Off => (0, [0; 3]),
            DriveCommand::Torque(code) => (1 | u32::from(*code as u16) << 16, [0; 3]),
            DriveCommand::Steps(steps) => (
                2 | u32::from(steps.count as u16) << 16,
                [steps.delay, steps.interval, steps.ramp as u32],
            ),
        };
        words.put(kind);
        row.into_iter().for_each(|word| words.put(word));
    }
    put_currents(words, &done.outputs.haptic);
    words.put(u32::from(done.outputs.spindle_rpm as u16) | u32::from(done.said) << 16);
    let heard = &done.heard;
    words.put(u32::from(heard.received) | u32::from(heard.waiting) << 16);
    words.put(u32::from(heard.lost_bytes) | u32::from(heard.urgent) << 16);
    done.stages.iter().for_each(|&ticks| words.put(ticks));
    let Some(reading) = done.reading else {
        return;
    };
    let state = u32::from(reading.state.number());
    let flags = u32::from(reading.homed)
        | u32::from(reading.position_kept) << 1
        | u32::from(reading.fault) << 2
        | u32::from(reading.more) << 3;
    words.put(1 | state << 8 | flags << 16 | u32::from(reading.queued & 0xFFF) << 20);
    words.put(reading.setpoint);
    words.put(u32::from(reading.path_rate) | u32::from(reading.spindle_rpm as u16) << 16);
    words.put_long(reading.program_time);
    for row in [
        &reading.wanted,
        &reading.joints_wanted,
        &reading.joints,
        &reading.following_error,
        &reading.drive,
    ] {
        words.put_row(row);
    }
    let (force, hand) = (&reading.force, &reading.hand);
    for row in [
        &force.high,
        &force.low,
        &force.yielded,
        &hand.tip,
        &hand.force,
        &hand.reflected,
        &hand.wall,
    ] {
        words.put_row(row);
    }
}

fn take_done(words: &mut Reader<'_>) -> Result<Done, FrameError> {
    let mut done = Done {
        period: words.take_long(),
        ..Done::default()
    };
    for command in &mut done.outputs.axes {
        let kind = words.take();
        let (delay, interval, ramp) = (words.take(), words.take(), words.take() as i32);
        let value = (kind >> 16) as i16;
        *command = match kind & 0xFFFF {
            0 => DriveCommand::Off,
            1 => DriveCommand::Torque(value),
            2 => DriveCommand::Steps(StepSegment {
                count: value,
                delay,
                interval,
                ramp,
            }),
            _ => return Err(FrameError::Content),
        };
    }
    done.outputs.haptic = take_currents(words);
    let pair = words.take();
    done.outputs.spindle_rpm = pair as i16;
    done.said = (pair >> 16) as u16;
    let (pair, rest) = (words.take(), words.take());
    done.heard = Heard {
        received: pair as u16,
        waiting: (pair >> 16) as u16,
        lost_bytes: rest as u16,
        urgent: rest >> 16 & 1 != 0,
    };
    for ticks in &mut done.stages {
        *ticks = words.take();
    }
    let head = words.take();
    if head & 1 == 0 {
        return Ok(done);
    }
    let state = State::ALL.get((head >> 8 & 0xFF) as usize);
    let mut reading = Reading {
        state: *state.ok_or(FrameError::Content)?,
        homed: head >> 16 & 1 != 0,
        position_kept: head >> 17 & 1 != 0,
        fault: head >> 18 & 1 != 0,
        more: head >> 19 & 1 != 0,
        queued: (head >> 20) as u16,
        setpoint: words.take(),
        ..Reading::default()
    };
    let pair = words.take();
    reading.path_rate = pair as u16;
    reading.spindle_rpm = (pair >> 16) as i16;
    reading.program_time = words.take_long();
    let rows = [
        &mut reading.wanted,
        &mut reading.joints_wanted,
        &mut reading.joints,
        &mut reading.following_error,
        &mut reading.drive,
    ];
    let force = &mut reading.force;
    let forces = [&mut force.high, &mut force.low, &mut force.yielded];
    let hand = &mut reading.hand;
    let hands = [
        &mut hand.tip,
        &mut hand.force,
        &mut hand.reflected,
        &mut hand.wall,
    ];
    for value in rows
        .into_iter()
        .flatten()
        .chain(forces.into_iter().chain(hands).flatten())
    {
        *value = words.take() as i32;
    }
    done.reading = Some(reading);
    Ok(done)
}

/// The stages in the order in which [`Done::stages`] has them.
pub const STAGE_ORDER: [Stage; STAGES] = [
    Stage::Hear,
    Stage::Sense,
    Stage::Decide,
    Stage::Yield,
    Stage::Place,
    Stage::Drive,
    Stage::Feel,
    Stage::Tell,
    Stage::Gate,
];

/// FNV-1a over words.
#[inline]
fn check(words: &[u32]) -> u32 {
    words.iter().fold(BASIS, |hash, word| step(hash, *word))
}

const BASIS: u32 = 0x811C_9DC5;

const fn step(hash: u32, word: u32) -> u32 {
    (hash ^ word).wrapping_mul(0x0100_0193)
}

/// Puts the check, which is the last word, into a frame whose other words are there: for those who keep frames without it, as recordings do.
pub fn seal(frame: &mut [u8]) {
    let (words, _) = frame.as_chunks_mut::<4>();
    if let Some((last, words)) = words.split_last_mut() {
        let sum = words
            .iter()
            .fold(BASIS, |hash, word| step(hash, u32::from_le_bytes(*word)));
        *last = sum.to_le_bytes();
    }
}

/// A frame while it is written: its words, one after the other; those that are left are zeros. Beyond the end nothing is written.
struct Writer<'a> {
    frame: &'a mut [u32],
    at: usize,
}

impl<'a> Writer<'a> {
    #[inline(always)]
    fn begin(frame: &'a mut [u32]) -> Self {
        frame.fill(0);
        Self { frame, at: 0 }
    }

    #[inline(always)]
    fn head(&mut self, kind: u32) {
        self.put(kind | VERSION << 16);
    }

    #[inline(always)]
    fn put(&mut self, word: u32) {
        debug_assert!(self.at + 1 < self.frame.len(), "the frame is too short");
        if let Some(slot) = self.frame.get_mut(self.at) {
            *slot = word;
            self.at += 1;
        }
    }

    #[inline(always)]
    fn put_long(&mut self, long: u64) {
        self.put(long as u32);
        self.put((long >> 32) as u32);
    }

    #[inline(always)]
    fn put_row(&mut self, row: &[i32]) {
        row.iter().for_each(|&value| self.put(value as u32));
    }
}

/// A frame while it is read, word by word; beyond the end are zeros.
struct Reader<'a> {
    words: core::slice::Iter<'a, u32>,
}

impl<'a> Reader<'a> {
    /// The kind of a frame, and its contents.
    #[inline(always)]
    fn begin(frame: &'a [u32]) -> Result<(u32, Self), FrameError> {
        let (last, words) = frame.split_last().ok_or(FrameError::Check)?;
        if check(words) != *last {
            return Err(FrameError::Check);
        }
        let mut reader = Self {
            words: words.iter(),
        };
        let head = reader.take();
        if head >> 16 != VERSION {
            return Err(FrameError::Version);
        }
        Ok((head & 0xFFFF, reader))
    }

    #[inline(always)]
    fn take(&mut self) -> u32 {
        self.words.next().copied().unwrap_or(0)
    }

    #[inline(always)]
    fn take_long(&mut self) -> u64 {
        u64::from(self.take()) | u64::from(self.take()) << 32
    }
}

fn to_bytes<const N: usize, const B: usize>(words: &[u32; N]) -> [u8; B] {
    const { assert!(B == 4 * N) };
    let mut bytes = [0; B];
    for (cell, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *cell = word.to_le_bytes();
    }
    bytes
}

fn from_bytes<const N: usize, const B: usize>(bytes: &[u8; B]) -> [u32; N] {
    const { assert!(B == 4 * N) };
    let mut words = [0; N];
    for (word, cell) in words.iter_mut().zip(bytes.as_chunks::<4>().0) {
        *word = u32::from_le_bytes(*cell);
    }
    words
}

#[cfg(test)]
mod tests;
