//! The recording of a job: every control period, binary, hashed. The trace (CSV), the summary and the report are made from it.
//!
//! ## Format, version 2
//!
//! All numbers are little-endian. The file is a header and then records of one size, nothing else; a recording that was cut off is
//! readable up to its last whole record. No clock time is in it, so the same job gives the same bytes.
//!
//! | header | |
//! | --- | --- |
//! | 8 bytes | magic `HMRECORD` |
//! | u16 | version, 2 |
//! | u16 | size of a record, [`RECORD_BYTES`] |
//! | u32 | size of the header in bytes, this table included |
//! | u32 | CRC-32 (ISO-HDLC) of the configuration |
//! | u32 n, n bytes | the controller's configuration, postcard |
//! | u16 n, n bytes | name of the machine, UTF-8 |
//! | u16 n, n bytes | name of the program, UTF-8 |
//! | u8 n, n x (u8 m, m bytes) | names of the pose coordinates |
//! | u8 n, n x (u8 m, m bytes) | names of the joints |
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

mod difference;
mod export;
mod reader;
#[cfg(test)]
pub(crate) mod tests;
mod writer;

pub use difference::{Difference, difference};
pub use export::export_csv;
pub use reader::{Recording, RecordingError, Records};
pub use writer::{Recorded, Recorder};

use haptimill_firmware::io::COMPONENTS;
use haptimill_firmware::reading::ForceReading;
use haptimill_protocol::message::{MAX_AXES, State};

/// Size of a record.
pub const RECORD_BYTES: usize = 240;

const MAGIC: &[u8; 8] = b"HMRECORD";
const VERSION: u16 = 2;

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
    pub wanted: Axes,
    /// Wanted joints.
    pub joints_wanted: Axes,
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
    pub force: ForceReading,
    /// The true force on the tool, 2^-16 N.
    pub true_force: [i32; COMPONENTS],
}

const STATES: [State; 8] = [
    State::Disabled,
    State::Idle,
    State::Homing,
    State::Run,
    State::Jog,
    State::Hold,
    State::Fault,
    State::EmergencyStop,
];

impl Record {
    /// Whether a flag is set.
    pub fn has(&self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// The record as bytes.
    pub fn encode(&self) -> [u8; RECORD_BYTES] {
        let mut bytes = [0; RECORD_BYTES];
        bytes[0..8].copy_from_slice(&self.period.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.setpoint.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.line.to_le_bytes());
        bytes[16..18].copy_from_slice(&self.path_rate.to_le_bytes());
        bytes[18..20].copy_from_slice(&self.spindle_rpm.to_le_bytes());
        bytes[20] = state_number(self.state);
        bytes[21] = self.flags;
        let rows = [
            &self.wanted,
            &self.joints_wanted,
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

    /// The record of bytes; `None` when the state is not known.
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
            state: *STATES.get(usize::from(bytes[20]))?,
            flags: bytes[21],
            wanted: axes(24),
            joints_wanted: axes(48),
            joints: axes(72),
            following_error: axes(96),
            drive: axes(120),
            tool: axes(144),
            programmed: axes(168),
            force: ForceReading {
                high: forces(192),
                low: forces(204),
                yielded: forces(216),
            },
            true_force: forces(228),
        })
    }
}

/// The number of a state in a record: its place in the enumeration.
fn state_number(state: State) -> u8 {
    match state {
        State::Disabled => 0,
        State::Idle => 1,
        State::Homing => 2,
        State::Run => 3,
        State::Jog => 4,
        State::Hold => 5,
        State::Fault => 6,
        State::EmergencyStop => 7,
    }
}

/// What a recording says of itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Header {
    /// The controller's configuration, postcard; it has the control period, the kinds of the axes and the scale of the drives.
    pub config: Vec<u8>,
    /// CRC-32 (ISO-HDLC) of the configuration.
    pub config_crc: u32,
    /// Name of the machine.
    pub machine: String,
    /// Name of the program.
    pub program: String,
    /// Names of the pose coordinates.
    pub pose: Vec<String>,
    /// Names of the joints.
    pub joints: Vec<String>,
}

impl Header {
    /// The header of a job.
    ///
    /// # Errors
    /// The configuration cannot be encoded.
    pub fn of(
        machine: &crate::machine::MachineFile,
        program: &str,
    ) -> Result<Self, postcard::Error> {
        let (config, config_crc) = machine.encoded()?;
        let names = |axes: &[crate::machine::AxisLimits]| {
            axes.iter().map(|axis| axis.name.clone()).collect()
        };
        Ok(Self {
            config,
            config_crc,
            machine: machine.config.name.to_string(),
            program: program.to_string(),
            pose: names(&machine.pose),
            joints: names(&machine.joints),
        })
    }

    /// The header as bytes. Names are cut at what their length can say.
    fn encode(&self) -> Vec<u8> {
        let mut body = Vec::new();
        body.extend_from_slice(&self.config_crc.to_le_bytes());
        body.extend_from_slice(&(self.config.len() as u32).to_le_bytes());
        body.extend_from_slice(&self.config);
        for text in [&self.machine, &self.program] {
            let bytes = &text.as_bytes()[..text.len().min(usize::from(u16::MAX))];
            body.extend_from_slice(&(bytes.len() as u16).to_le_bytes());
            body.extend_from_slice(bytes);
        }
        for names in [&self.pose, &self.joints] {
            body.push(names.len().min(MAX_AXES) as u8);
            for name in names.iter().take(MAX_AXES) {
                let bytes = &name.as_bytes()[..name.len().min(255)];
                body.push(bytes.len() as u8);
                body.extend_from_slice(bytes);
            }
        }
        let mut bytes = MAGIC.to_vec();
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&(RECORD_BYTES as u16).to_le_bytes());
        bytes.extend_from_slice(&(16 + body.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&body);
        bytes
    }
}
