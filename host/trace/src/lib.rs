//! Recording of a job: binary, with checks and a hash. Trace (CSV), summary and report are made
//! from it.
//!
//! A recording has two parts. The *records* are the states of the job: one per control period of a
//! controller in this process or on an emulated board, one per telemetry frame of a controller
//! behind a port. The *periods* are the I/O log: inputs and outputs of the controller since its
//! power-on, homing included. `haptimill replay` gives the inputs to a new controller and compares
//! the outputs bit by bit. A controller behind a port was started earlier and sends only telemetry:
//! its recording has no periods.
//!
//! A [`Recorder`] may keep a part of the records only ([`Keep`]): such a recording has no periods
//! either, and cannot be replayed.
//!
//! ## Format, versions 5 and 7
//!
//! Version 7 has a longer record, for a controller with a haptic arm. A recording of a controller
//! without one is of version 5.
//!
//! All numbers are little-endian. The file is a header and then blocks, each with a check. A
//! truncated recording is readable up to its last complete block, a damaged one up to the damage.
//! The file contains no clock time: the same job gives the same bytes.
//!
//! | header | |
//! | --- | --- |
//! | 8 bytes | magic `HMRECORD` |
//! | u16 | version: 5, or 7 with a haptic arm |
//! | u16 | size of a record: [`RECORD_BYTES`], with a haptic arm [`HAPTIC_BYTES`] more |
//! | u32 | size of the header in bytes, all of this table |
//! | u32 | CRC-32 (ISO-HDLC, as all here) of the configuration |
//! | u32 n, n bytes | the controller's configuration, postcard |
//! | u16 n, n bytes | name of the machine, UTF-8 |
//! | u16 n, n bytes | name of the program, UTF-8 |
//! | u8 n, n x (u8 m, m bytes) | names of the pose coordinates |
//! | u8 n, n x (u8 m, m bytes) | names of the joints |
//! | u16 n, n bytes | version of the recording program |
//! | u64 | schema hash of its messages |
//! | u32 n, n bytes | the machine file |
//! | u32 n, n bytes | the part program, or nothing |
//! | u32 | CRC-32 of the header up to here |
//!
//! | block | |
//! | --- | --- |
//! | 4 bytes | content: `RECS` records, `PERI` periods (see [`haptimill_hil_sim::io_log`]), `EVNT` events, `DONE` none: the recording is complete |
//! | u32 n | bytes of the content |
//! | u32 | number of records, periods or events; in `DONE` the number of all records |
//! | u32 | CRC-32 of the content |
//! | u32 | CRC-32 of the four fields above |
//! | n bytes | the content |
//!
//! An event is a u64 (control period), a u8 (0 information, 1 warning, 2 error), a u16 n, and a
//! sentence of n bytes, UTF-8.
//!
//! | offset | record | |
//! | --- | --- | --- |
//! | 0 | u64 | control period |
//! | 8 | u32 | setpoint that the motion is heading for |
//! | 12 | u32 | line of the program, or 0 |
//! | 16 | u16 | speed factor, 32768 for the programmed speed |
//! | 18 | i16 | spindle, rev/min; counter-clockwise below 0 |
//! | 20 | u8 | state, in the order of [`State`] |
//! | 21 | u8 | flags, see [`flag`] |
//! | 22 | u16 | 0 |
//! | 24 | 6 x i32 | commanded pose, axis units |
//! | 48 | 6 x i32 | commanded joints, axis units |
//! | 72 | 6 x i32 | measured joints, axis units |
//! | 96 | 6 x i32 | following error of the joints, axis units |
//! | 120 | 6 x i32 | drive command: DAC code, or steps emitted |
//! | 144 | 6 x i32 | tool pose in workpiece coordinates, axis units: see [`flag::TOOL_TRUE`] |
//! | 168 | 6 x i32 | programmed pose at this time, axis units: see [`flag::PROGRAMMED`] |
//! | 192 | 3 x i32 | peak force on the tool in x, y, z of the workpiece, 2^-16 N: see [`flag::FORCE`] |
//! | 204 | 3 x i32 | opposite extreme of the same spindle revolution, 2^-16 N |
//! | 216 | 3 x i32 | compliant displacement, 2^-20 mm |
//! | 228 | 3 x i32 | true force on the tool, 2^-16 N, if [`flag::TOOL_TRUE`] is set |
//! | 240 | u16 | levels of the named inputs, one bit each; 1 is active |
//! | 242 | u16 | values of the named outputs, one bit each; 1 is on |
//! | 244 | 4 x i16 | codes of the named analog inputs |
//! | 252 | 4 x i16 | codes of the named analog outputs |
//! | 260 | u32 | version 7: flags of the haptic arm, see [`flag::HAPTIC_KNOWN`] |
//! | 264 | 3 x i32 | tip of the handle in the frame of the arm's base, 2^-20 mm |
//! | 276 | 3 x i32 | force of the arm on the operator, 2^-16 N |
//! | 288 | 3 x i32 | force feedback alone, 2^-16 N |
//! | 300 | 3 x i32 | force of the virtual fixtures, 2^-16 N |
//! | 312 | 6 x i16 | directions of the x and z axes of the handle in that frame, 32767 for 1 |

mod blocks;
mod column;
mod difference;
mod export;
mod header;
#[cfg(feature = "mcap")]
mod mcap;
mod reader;
mod recorder;
pub mod replay;
#[cfg(test)]
mod tests;
mod writer;

pub use column::{Column, Selection, Value, columns};
pub use difference::{Difference, difference, first_unequal_field};
pub use export::{Thinning, write_csv, write_table};
pub use header::Header;
#[cfg(feature = "mcap")]
pub use mcap::write_mcap;
pub use reader::{Periods, RecordedEvent, Recording, RecordingError, Records};
pub use recorder::{Keep, Recorder, earlier_file};
pub use writer::{RESERVE_BYTES, Recorded, free_bytes};

pub use haptimill_hil_sim::io_log::{IoLog, Period};

use haptimill_firmware::io::COMPONENTS;
use haptimill_firmware::snapshot::{ForceSnapshot, HapticSnapshot, IoSnapshot, Snapshot};
use haptimill_protocol::message::{MAX_AXES, State};

/// Default number of samples per second in an MCAP file.
pub const MCAP_RATE: f64 = 1000.0;

/// Size of a written MCAP file.
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

/// Stands in for the MCAP writer in a build without MCAP.
///
/// # Errors
///
/// Returns [`RecordingError::NoMcap`].
#[cfg(not(feature = "mcap"))]
pub fn write_mcap(
    _: &Recording,
    _: &mut (impl std::io::Write + std::io::Seek),
    _: f64,
) -> Result<McapWritten, RecordingError> {
    Err(RecordingError::NoMcap)
}

/// Size of a record of a machine without a haptic arm.
pub const RECORD_BYTES: usize = 260;

/// Additional size of a record of a machine with a haptic arm.
pub const HAPTIC_BYTES: usize = 64;

/// Place of the directions of the handle in the bytes of the haptic arm.
const AXES_AT: usize = 52;

const MAGIC: &[u8; 8] = b"HMRECORD";

/// Format versions without and with a haptic arm.
const VERSION: u16 = 5;
const HAPTIC_VERSION: u16 = 7;

/// Check of header and blocks.
const CRC: crc::Crc<u32, crc::Table<16>> =
    crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);

/// Flags of a record.
pub mod flag {
    /// All joints are homed, and their positions are known to be right.
    pub const HOMED: u8 = 1;
    /// `tool` is the ground truth of the simulator.
    pub const TOOL_TRUE: u8 = 4;
    /// `tool` is measured by the controller through its kinematics.
    pub const TOOL_MEASURED: u8 = 8;
    /// `programmed` is valid: a job is active.
    pub const PROGRAMMED: u8 = 16;
    /// A fault is latched.
    pub const FAULT: u8 = 32;
    /// The machine has a force sensor.
    pub const FORCE: u8 = 64;
    /// Volumetric compensation is in full effect.
    pub const COMPENSATED: u8 = 128;
    /// Flag of the haptic arm: its values are valid. A controller behind a port reports them only
    /// on request.
    pub const HAPTIC_KNOWN: u32 = 1;
    /// Flag of the haptic arm: the button on the handle is pressed.
    pub const ENABLING_SWITCH: u32 = 2;
}

pub use haptimill_firmware::snapshot::Axes;

/// State of the machine in a control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Record {
    /// Number of the period.
    pub period: u64,
    /// The setpoint that the motion is heading for.
    pub setpoint: u32,
    /// Line of the program, or 0.
    pub line: u32,
    /// Speed factor, 32768 for the programmed speed.
    pub speed_factor: u16,
    /// Spindle, rev/min.
    pub spindle_rpm: i16,
    /// State of the controller.
    pub state: State,
    /// See [`flag`].
    pub flags: u8,
    /// Commanded pose.
    pub commanded: Axes,
    /// Commanded joints.
    pub joints_commanded: Axes,
    /// Measured joints.
    pub joints: Axes,
    /// Following error of the joints: commanded minus measured.
    pub following_error: Axes,
    /// Drive command: DAC code, or steps emitted.
    pub drive: Axes,
    /// Tool pose in workpiece coordinates.
    pub tool: Axes,
    /// Programmed pose at this time, whatever the controller commands.
    pub programmed: Axes,
    /// Peak force, its opposite extreme, and the compliant displacement.
    pub force: ForceSnapshot,
    /// The true force on the tool, 2^-16 N.
    pub true_force: [i32; COMPONENTS],
    /// Named inputs and outputs.
    pub io: IoSnapshot,
    /// Haptic arm, if the machine has one.
    pub haptic: HapticSnapshot,
    /// Flags of the haptic arm, see [`flag::HAPTIC_KNOWN`].
    pub haptic_flags: u32,
    /// Turns beside the angles of axes that wrap around, by [`Quantity`]. They are not in the file;
    /// a reader counts them from the first record on.
    pub turns: [Axes; 5],
}

/// A quantity with a position of each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Commanded pose.
    Commanded,
    /// Programmed pose.
    Programmed,
    /// Tool pose.
    Tool,
    /// Measured joints.
    Joints,
    /// Commanded joints.
    JointsCommanded,
}

impl Record {
    /// Positions of a quantity; axes that wrap around are within half a turn of 0.
    #[must_use]
    pub fn positions(&self, quantity: Quantity) -> &Axes {
        match quantity {
            Quantity::Commanded => &self.commanded,
            Quantity::Programmed => &self.programmed,
            Quantity::Tool => &self.tool,
            Quantity::Joints => &self.joints,
            Quantity::JointsCommanded => &self.joints_commanded,
        }
    }

    /// Position of an axis in axis units, counted on over the turns since the first record.
    #[must_use]
    pub fn unwound(&self, quantity: Quantity, axis: usize) -> i64 {
        let turns = self.turns[quantity as usize][axis];
        (i64::from(turns) << 32) + i64::from(self.positions(quantity)[axis])
    }

    /// Counts the turns of the axes that wrap around (one bit each of pose and joints) on from the
    /// record before. Poses and joints that belong together are less than half a turn apart.
    pub fn count_turns(&mut self, wrapping: [u8; 2], before: Option<&Self>) {
        use Quantity::{Commanded, Joints, JointsCommanded, Programmed, Tool};
        let groups = [
            (Commanded, &[Programmed, Tool] as &[Quantity]),
            (Joints, &[JointsCommanded]),
        ];
        for (mask, (first, others)) in wrapping.into_iter().zip(groups) {
            for axis in (0..MAX_AXES).filter(|axis| mask >> axis & 1 != 0) {
                let base = before.map_or(0, |before| before.unwound(first, axis));
                let base = self.count_turn(first, axis, base);
                for other in others {
                    self.count_turn(*other, axis, base);
                }
            }
        }
    }

    /// Sets the turns of an axis so that it is less than half a turn from `near`; returns its
    /// unwound position.
    fn count_turn(&mut self, quantity: Quantity, axis: usize, near: i64) -> i64 {
        let value = self.positions(quantity)[axis];
        let unwound = near + i64::from(value.wrapping_sub(near as i32));
        self.turns[quantity as usize][axis] = ((unwound - i64::from(value)) >> 32) as i32;
        unwound
    }

    /// Whether a flag is set.
    pub fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// Sets the values of the controller; ground truth and programmed pose are not changed.
    pub fn set_snapshot(&mut self, period: u64, snapshot: &Snapshot) {
        self.period = period;
        self.setpoint = snapshot.setpoint;
        self.speed_factor = snapshot.speed_factor;
        self.spindle_rpm = snapshot.spindle_rpm;
        self.state = snapshot.state;
        self.commanded = snapshot.commanded;
        self.joints_commanded = snapshot.joints_commanded;
        self.joints = snapshot.joints;
        self.following_error = snapshot.following_error;
        self.drive = snapshot.drive;
        self.force = snapshot.force;
        self.io = snapshot.io;
        self.haptic = snapshot.haptic;
        self.haptic_flags |= flag::HAPTIC_KNOWN;
        for (set, flag) in [
            (snapshot.homed, flag::HOMED),
            (snapshot.fault, flag::FAULT),
            (snapshot.compensated, flag::COMPENSATED),
        ] {
            self.flags = self.flags & !flag | if set { flag } else { 0 };
        }
    }

    /// Encodes the haptic arm; the bytes follow those of [`Record::encode`].
    pub fn encode_haptic(&self) -> [u8; HAPTIC_BYTES] {
        let haptic = &self.haptic;
        let cells = [haptic.tip, haptic.force, haptic.feedback, haptic.fixture];
        let mut bytes = [0; HAPTIC_BYTES];
        bytes[..4].copy_from_slice(&self.haptic_flags.to_le_bytes());
        let slots = bytes[4..].as_chunks_mut::<4>().0;
        for (slot, value) in slots.iter_mut().zip(cells.as_flattened()) {
            *slot = value.to_le_bytes();
        }
        let slots = bytes[AXES_AT..].as_chunks_mut::<2>().0;
        for (slot, value) in slots.iter_mut().zip(haptic.axes.as_flattened()) {
            *slot = value.to_le_bytes();
        }
        bytes
    }

    /// Decodes the haptic arm.
    pub fn decode_haptic(&mut self, bytes: &[u8; HAPTIC_BYTES]) {
        let word = |at: usize| std::array::from_fn(|i| bytes[at + i]);
        self.haptic_flags = u32::from_le_bytes(word(0));
        let three = |row: usize| {
            std::array::from_fn(|axis| i32::from_le_bytes(word(4 + 12 * row + 4 * axis)))
        };
        self.haptic = HapticSnapshot {
            tip: three(0),
            force: three(1),
            feedback: three(2),
            fixture: three(3),
            axes: std::array::from_fn(|row| {
                std::array::from_fn(|axis| {
                    let at = AXES_AT + 6 * row + 2 * axis;
                    i16::from_le_bytes([bytes[at], bytes[at + 1]])
                })
            }),
        };
    }

    /// Encodes the record without the haptic arm.
    pub fn encode(&self) -> [u8; RECORD_BYTES] {
        let mut bytes = [0; RECORD_BYTES];
        bytes[0..8].copy_from_slice(&self.period.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.setpoint.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.line.to_le_bytes());
        bytes[16..18].copy_from_slice(&self.speed_factor.to_le_bytes());
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
        let forces = [
            &force.high,
            &force.low,
            &force.displacement,
            &self.true_force,
        ];
        let cells = rows
            .into_iter()
            .flatten()
            .chain(forces.into_iter().flatten());
        for (cell, value) in bytes[24..].as_chunks_mut::<4>().0.iter_mut().zip(cells) {
            *cell = value.to_le_bytes();
        }
        let io = &self.io;
        bytes[240..242].copy_from_slice(&io.inputs.to_le_bytes());
        bytes[242..244].copy_from_slice(&io.outputs.to_le_bytes());
        let codes = io.analog_inputs.iter().chain(&io.analog_outputs);
        for (cell, code) in bytes[244..].as_chunks_mut::<2>().0.iter_mut().zip(codes) {
            *cell = code.to_le_bytes();
        }
        bytes
    }

    /// Decodes a record without the haptic arm; `None` if the state is not known.
    pub fn decode(bytes: &[u8; RECORD_BYTES]) -> Option<Self> {
        let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let word = |at: usize| i32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let axes = |at: usize| std::array::from_fn(|axis| word(at + 4 * axis));
        let forces = |at: usize| std::array::from_fn(|component| word(at + 4 * component));
        Some(Self {
            period: u64::from_le_bytes(std::array::from_fn(|i| bytes[i])),
            setpoint: word(8) as u32,
            line: word(12) as u32,
            speed_factor: half(16),
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
                displacement: forces(216),
            },
            true_force: forces(228),
            io: IoSnapshot {
                inputs: half(240),
                outputs: half(242),
                analog_inputs: std::array::from_fn(|input| half(244 + 2 * input) as i16),
                analog_outputs: std::array::from_fn(|output| half(252 + 2 * output) as i16),
            },
            haptic: HapticSnapshot::default(),
            haptic_flags: 0,
            turns: Default::default(),
        })
    }
}
