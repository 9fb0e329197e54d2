//! Header of a recording.

use super::{CRC, HAPTIC_BYTES, HAPTIC_VERSION, MAGIC, RECORD_BYTES, VERSION};
use haptimill_protocol::message::MAX_AXES;
use haptimill_protocol::schema::SCHEMA_HASH;

/// Size of the start of the header, up to and including the field with the header size.
pub(super) const START_BYTES: usize = 16;

/// Header of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Header {
    /// The controller's configuration, postcard: control period, kinds of the axes, scale of the
    /// drives.
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
    /// Version of the recording program.
    pub software: String,
    /// Schema hash of the messages of that program.
    pub schema: u64,
    /// Text of the machine file.
    pub machine_text: String,
    /// Text of the part program, or empty.
    pub program_text: Vec<u8>,
    /// Whether the controller has a haptic arm; every record then has its values.
    pub has_haptic_arm: bool,
}

impl Header {
    /// Creates the header of a job.
    ///
    /// # Errors
    ///
    /// Returns an error if the configuration cannot be encoded.
    pub fn of(
        machine: &haptimill_machine_file::MachineFile,
        program: &str,
    ) -> Result<Self, postcard::Error> {
        let (config, config_crc) = machine.encoded()?;
        let names = |axes: &[haptimill_machine_file::AxisLimits]| {
            axes.iter().map(|axis| axis.name.clone()).collect()
        };
        Ok(Self {
            config,
            config_crc,
            machine: machine.config.name.to_string(),
            program: program.to_string(),
            pose: names(&machine.pose),
            joints: names(&machine.joints),
            software: env!("CARGO_PKG_VERSION").to_string(),
            schema: SCHEMA_HASH,
            machine_text: machine.text.clone(),
            program_text: Vec::new(),
            has_haptic_arm: machine.config.haptic.is_some(),
        })
    }

    /// Returns the size of a record.
    #[must_use]
    pub const fn record_bytes(&self) -> usize {
        if self.has_haptic_arm {
            RECORD_BYTES + HAPTIC_BYTES
        } else {
            RECORD_BYTES
        }
    }

    /// Adds the text of the part program.
    #[must_use]
    pub fn with_program(mut self, text: &[u8]) -> Self {
        self.program_text = text.to_vec();
        self
    }

    /// Encodes the header. Names are truncated to the range of their length field.
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let version = if self.has_haptic_arm {
            HAPTIC_VERSION
        } else {
            VERSION
        };
        bytes.extend_from_slice(&version.to_le_bytes());
        bytes.extend_from_slice(&(self.record_bytes() as u16).to_le_bytes());
        bytes.extend_from_slice(&[0; 4]);
        bytes.extend_from_slice(&self.config_crc.to_le_bytes());
        put_long(&mut bytes, &self.config);
        put_short(&mut bytes, &self.machine);
        put_short(&mut bytes, &self.program);
        for names in [&self.pose, &self.joints] {
            bytes.push(names.len().min(MAX_AXES) as u8);
            for name in names.iter().take(MAX_AXES) {
                let name = &name.as_bytes()[..name.len().min(255)];
                bytes.push(name.len() as u8);
                bytes.extend_from_slice(name);
            }
        }
        put_short(&mut bytes, &self.software);
        bytes.extend_from_slice(&self.schema.to_le_bytes());
        put_long(&mut bytes, self.machine_text.as_bytes());
        put_long(&mut bytes, &self.program_text);
        let whole = (bytes.len() + 4) as u32;
        bytes[START_BYTES - 4..START_BYTES].copy_from_slice(&whole.to_le_bytes());
        bytes.extend_from_slice(&CRC.checksum(&bytes).to_le_bytes());
        bytes
    }

    /// Decodes the bytes between start and check of a header; `None` if they end too early.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        Cursor(bytes).header()
    }
}

fn put_short(bytes: &mut Vec<u8>, text: &str) {
    let text = &text.as_bytes()[..text.len().min(usize::from(u16::MAX))];
    bytes.extend_from_slice(&(text.len() as u16).to_le_bytes());
    bytes.extend_from_slice(text);
}

fn put_long(bytes: &mut Vec<u8>, content: &[u8]) {
    bytes.extend_from_slice(&(content.len() as u32).to_le_bytes());
    bytes.extend_from_slice(content);
}

/// Decodes bytes in order; `None` where they end too early.
pub(super) struct Cursor<'a>(pub(super) &'a [u8]);

impl<'a> Cursor<'a> {
    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    pub(super) fn number(&mut self, bytes: usize) -> Option<u64> {
        let taken = self.take(bytes)?.iter().rev();
        Some(taken.fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
    }

    fn content(&mut self, length_bytes: usize) -> Option<&'a [u8]> {
        let count = self.number(length_bytes)?;
        self.take(usize::try_from(count).ok()?)
    }

    pub(super) fn text(&mut self, length_bytes: usize) -> Option<String> {
        let content = self.content(length_bytes)?;
        Some(String::from_utf8_lossy(content).into_owned())
    }

    fn names(&mut self) -> Option<Vec<String>> {
        let count = self.number(1)?;
        (0..count).map(|_| self.text(1)).collect()
    }

    fn header(mut self) -> Option<Header> {
        Some(Header {
            config_crc: self.number(4)? as u32,
            config: self.content(4)?.to_vec(),
            machine: self.text(2)?,
            program: self.text(2)?,
            pose: self.names()?,
            joints: self.names()?,
            software: self.text(2)?,
            schema: self.number(8)?,
            machine_text: self.text(4)?,
            program_text: self.content(4)?.to_vec(),
            has_haptic_arm: false,
        })
    }
}
