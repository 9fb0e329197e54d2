//! The recording of a job: every control period, binary, hashed. The trace (CSV), the summary and the report are made from it.
//!
//! It keeps two things of a job. The *records* say how the job went: of a controller in this process or on an emulated board one for every control period,
//! of one behind a port one for every telemetry frame. The *periods* are all that the controller sensed and said since its power-on, homing
//! included; a new controller that is given the same must say the same, bit by bit, which is what `haptimill replay` proves. A controller behind a port
//! began before this program looked, and is seen through its telemetry only: such a recording has no periods.
//!
//! ## Format, versions 3 and 4
//!
//! Version 4 is version 3 with a longer record, for a controller with a haptic arm; a recording of one without is still of version 3, to the last bit.
//!
//! All numbers are little-endian. The file is a header and then blocks, each with its own check; a recording that was cut off is readable up to its last
//! whole block, one that was damaged up to the damage. No clock time is in it, so the same job gives the same bytes.
//!
//! | header | |
//! | --- | --- |
//! | 8 bytes | magic `HMRECORD` |
//! | u16 | version: 3, or 4 with a haptic arm |
//! | u16 | size of a record: [`RECORD_BYTES`], with a haptic arm [`HAND_BYTES`] more |
//! | u32 | size of the header in bytes, all of this table |
//! | u32 | CRC-32 (ISO-HDLC, as all here) of the configuration |
//! | u32 n, n bytes | the controller's configuration, postcard |
//! | u16 n, n bytes | name of the machine, UTF-8 |
//! | u16 n, n bytes | name of the program, UTF-8 |
//! | u8 n, n x (u8 m, m bytes) | names of the pose coordinates |
//! | u8 n, n x (u8 m, m bytes) | names of the joints |
//! | u16 n, n bytes | version of the program that recorded |
//! | u64 | schema of its messages |
//! | u32 n, n bytes | the machine file |
//! | u32 n, n bytes | the part program; empty when the recorder was not given it |
//! | u32 | CRC-32 of the header up to here |
//!
//! | block | |
//! | --- | --- |
//! | 4 bytes | what it has: `RECS` records, `PERI` periods (see [`haptimill_hil_sim::io_log`]), `EVNT` events, `DONE` nothing: the recording is whole |
//! | u32 n | bytes of its contents |
//! | u32 | how many records, periods or events; in `DONE` how many records there are in all |
//! | u32 | CRC-32 of the contents |
//! | u32 | CRC-32 of the four fields above |
//! | n bytes | the contents |
//!
//! An event is a u64 (control period), a u8 (0 news, 1 warning, 2 error), a u16 n, and a sentence of n bytes, UTF-8.
//!
//! | offset | record | |
//! | --- | --- | --- |
//! | 0 | u64 | control period |
//! | 8 | u32 | setpoint that the motion is heading for |
//! | 12 | u32 | line of the program, 0 when there is none |
//! | 16 | u16 | path rate, 65535 for the programmed one |
//! | 18 | i16 | spindle, rev/min; counter-clockwise below 0 |
//! | 20 | u8 | state, in the order of [`State`] |
//! | 21 | u8 | flags, see [`flag`] |
//! | 22 | u16 | 0 |
//! | 24 | 6 x i32 | wanted pose, axis units |
//! | 48 | 6 x i32 | wanted joints, axis units |
//! | 72 | 6 x i32 | measured joints, axis units |
//! | 96 | 6 x i32 | following error of the joints, axis units |
//! | 120 | 6 x i32 | drive command: DAC code, or steps emitted |
//! | 144 | 6 x i32 | the tool in the work, axis units: see [`flag::TOOL_TRUE`] |
//! | 168 | 6 x i32 | the programmed pose at this time, axis units: see [`flag::PROGRAMMED`] |
//! | 192 | 3 x i32 | peak force on the tool in x, y, z of the work, 2^-16 N: see [`flag::FORCE`] |
//! | 204 | 3 x i32 | the opposite end of what it was in the last revolution of the spindle, 2^-16 N |
//! | 216 | 3 x i32 | by how much the tool yields, 2^-20 mm |
//! | 228 | 3 x i32 | the true force on the tool, 2^-16 N, if [`flag::TOOL_TRUE`] is set |
//! | 240 | u32 | version 4: 1 if the hand is known, 2 if the button on its handle is held, see [`flag::HAND_KNOWN`] |
//! | 244 | 3 x i32 | the tip of the handle in the frame of the arm's base, 2^-20 mm |
//! | 256 | 3 x i32 | what the arm does to the hand, 2^-16 N |
//! | 268 | 3 x i32 | what the law of reflection alone makes of the force on the tool, 2^-16 N |
//! | 280 | 3 x i32 | what the virtual walls push, 2^-16 N |

mod blocks;
mod column;
mod difference;
mod export;
mod header;
#[cfg(feature = "mcap")]
mod mcap;
mod reader;
pub mod replay;
#[cfg(test)]
mod tests;
mod writer;

pub use column::{Column, Selection, Value, columns};
pub use difference::{Difference, difference, unequal};
pub use export::{Thinning, export_csv, export_table};
pub use header::Header;
#[cfg(feature = "mcap")]
pub use mcap::write_mcap;
pub use reader::{Happening, Periods, Recording, RecordingError, Records};
pub use writer::{RESERVE_BYTES, Recorded, Recorder, free_bytes};

pub use haptimill_hil_sim::io_log::{IoLog, Period};

use haptimill_firmware::io::COMPONENTS;
use haptimill_firmware::snapshot::{ForceSnapshot, HapticSnapshot, Snapshot};
use haptimill_protocol::message::{MAX_AXES, State};

/// Samples a second in an MCAP file, unless another number is asked for.
pub const MCAP_RATE: f64 = 1000.0;

/// What a file got.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct McapWritten {
    /// Channels.
    pub channels: usize,
    /// Messages.
    pub messages: u64,
    /// Bytes.
    pub bytes: u64,
}

/// Whether this build writes MCAP.
pub const MCAP: bool = cfg!(feature = "mcap");

/// Writes no MCAP: this build cannot.
///
/// # Errors
/// Always.
#[cfg(not(feature = "mcap"))]
pub fn write_mcap(
    _: &Recording,
    _: &mut (impl std::io::Write + std::io::Seek),
    _: f64,
) -> Result<McapWritten, RecordingError> {
    Err(RecordingError::NoMcap)
}

/// Size of a record of a machine without a haptic arm.
pub const RECORD_BYTES: usize = 240;

/// How much longer it is with one.
pub const HAND_BYTES: usize = 52;

const MAGIC: &[u8; 8] = b"HMRECORD";

/// The version without a hand, and with one.
const VERSION: u16 = 3;
const HAND_VERSION: u16 = 4;

/// Check of everything in a recording.
const CRC: crc::Crc<u32, crc::Table<16>> =
    crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);

/// Flags of a record.
pub mod flag {
    /// All axes have their reference.
    pub const HOMED: u8 = 1;
    /// The position is known to be right since homing.
    pub const POSITION_KEPT: u8 = 2;
    /// `tool` is where the simulator's tool really was.
    pub const TOOL_TRUE: u8 = 4;
    /// `tool` is what the controller measured through its own kinematics.
    pub const TOOL_MEASURED: u8 = 8;
    /// `programmed` is there: a job is under way.
    pub const PROGRAMMED: u8 = 16;
    /// A fault is latched.
    pub const FAULT: u8 = 32;
    /// The machine has a force sensor.
    pub const FORCE: u8 = 64;
    /// Of the hand: it is known. Through a port it is when the controller was asked to report it.
    pub const HAND_KNOWN: u32 = 1;
    /// Of the hand: the button on the handle is held.
    pub const HAND_HELD: u32 = 2;
}

/// Values of all axes, in axis units; those that the machine lacks are 0.
pub type Axes = [i32; MAX_AXES];

/// One control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Record {
    /// Number of the period.
    pub period: u64,
    /// The setpoint that the motion is heading for.
    pub setpoint: u32,
    /// Line of the program, 0 when there is none.
    pub line: u32,
    /// Speed along the path, 65535 for the programmed one.
    pub path_rate: u16,
    /// Spindle, rev/min.
    pub spindle_rpm: i16,
    /// State of the controller.
    pub state: State,
    /// See [`flag`].
    pub flags: u8,
    /// Wanted pose.
    pub commanded: Axes,
    /// Wanted joints.
    pub joints_commanded: Axes,
    /// Measured joints.
    pub joints: Axes,
    /// Following error of the joints, wanted less measured.
    pub following_error: Axes,
    /// Drive command: DAC code, or steps emitted.
    pub drive: Axes,
    /// The tool in the work.
    pub tool: Axes,
    /// The programmed pose at this time, whatever the controller makes of it.
    pub programmed: Axes,
    /// Peak force, its opposite end, and by how much the tool yields.
    pub force: ForceSnapshot,
    /// The true force on the tool, 2^-16 N.
    pub true_force: [i32; COMPONENTS],
    /// The hand, where there is a haptic arm.
    pub hand: HapticSnapshot,
    /// What is known of it, see [`flag::HAND_KNOWN`].
    pub hand_flags: u32,
}

impl Record {
    /// Whether a flag is set.
    pub fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// What the controller knew of itself in a period; truth and programmed geometry are left as they are.
    pub fn set_reading(&mut self, period: u64, snapshot: &Snapshot) {
        self.period = period;
        self.setpoint = snapshot.setpoint;
        self.path_rate = snapshot.path_rate;
        self.spindle_rpm = snapshot.spindle_rpm;
        self.state = snapshot.state;
        self.commanded = snapshot.commanded;
        self.joints_commanded = snapshot.joints_commanded;
        self.joints = snapshot.joints;
        self.following_error = snapshot.following_error;
        self.drive = snapshot.drive;
        self.force = snapshot.force;
        self.hand = snapshot.hand;
        self.hand_flags |= flag::HAND_KNOWN;
        for (set, flag) in [
            (snapshot.homed, flag::HOMED),
            (snapshot.position_kept, flag::POSITION_KEPT),
            (snapshot.fault, flag::FAULT),
        ] {
            self.flags = self.flags & !flag | if set { flag } else { 0 };
        }
    }

    /// The hand of the record, as the bytes behind those of [`Record::encode`].
    pub fn encode_hand(&self) -> [u8; HAND_BYTES] {
        let hand = &self.hand;
        let cells = [hand.tip, hand.force, hand.reflected, hand.wall];
        let mut bytes = [0; HAND_BYTES];
        bytes[..4].copy_from_slice(&self.hand_flags.to_le_bytes());
        let slots = bytes[4..].as_chunks_mut::<4>().0;
        for (slot, value) in slots.iter_mut().zip(cells.as_flattened()) {
            *slot = value.to_le_bytes();
        }
        bytes
    }

    /// Takes the hand from those bytes.
    pub fn decode_hand(&mut self, bytes: &[u8; HAND_BYTES]) {
        let word = |at: usize| std::array::from_fn(|i| bytes[at + i]);
        self.hand_flags = u32::from_le_bytes(word(0));
        let three = |row: usize| {
            std::array::from_fn(|axis| i32::from_le_bytes(word(4 + 12 * row + 4 * axis)))
        };
        self.hand = HapticSnapshot {
            tip: three(0),
            force: three(1),
            reflected: three(2),
            wall: three(3),
        };
    }

    /// The record as bytes, without the hand.
    pub fn encode(&self) -> [u8; RECORD_BYTES] {
        let mut bytes = [0; RECORD_BYTES];
        bytes[0..8].copy_from_slice(&self.period.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.setpoint.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.line.to_le_bytes());
        bytes[16..18].copy_from_slice(&self.path_rate.to_le_bytes());
        bytes[18..20].copy_from_slice(&self.spindle_rpm.to_le_bytes());
        bytes[20] = self.state.number();
        bytes[21] = self.flags;
        let rows = [
            &self.commanded,
            &self.joints_commanded,
            &self.joints,
            &self.following_error,
            &self.drive,
            &self.tool,
            &self.programmed,
        ];
        let force = &self.force;
        let forces = [&force.high, &force.low, &force.yielded, &self.true_force];
        let cells = rows
            .into_iter()
            .flatten()
            .chain(forces.into_iter().flatten());
        for (cell, value) in bytes[24..].as_chunks_mut::<4>().0.iter_mut().zip(cells) {
            *cell = value.to_le_bytes();
        }
        bytes
    }

    /// The record of bytes, without the hand; `None` when the state is not known.
    pub fn decode(bytes: &[u8; RECORD_BYTES]) -> Option<Self> {
        let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let word = |at: usize| i32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let axes = |at: usize| std::array::from_fn(|axis| word(at + 4 * axis));
        let forces = |at: usize| std::array::from_fn(|component| word(at + 4 * component));
        Some(Self {
            period: u64::from_le_bytes(std::array::from_fn(|i| bytes[i])),
            setpoint: word(8) as u32,
            line: word(12) as u32,
            path_rate: half(16),
            spindle_rpm: half(18) as i16,
            state: *State::ALL.get(usize::from(bytes[20]))?,
            flags: bytes[21],
            commanded: axes(24),
            joints_commanded: axes(48),
            joints: axes(72),
            following_error: axes(96),
            drive: axes(120),
            tool: axes(144),
            programmed: axes(168),
            force: ForceSnapshot {
                high: forces(192),
                low: forces(204),
                yielded: forces(216),
            },
            true_force: forces(228),
            hand: HapticSnapshot::default(),
            hand_flags: 0,
        })
    }
}
