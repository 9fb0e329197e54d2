//! Reading a recording.

use super::{Header, MAGIC, RECORD_BYTES, Record, VERSION};
use haptimill_firmware::config::{AxisKind, Config, Drive};
use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A recording on disk.
#[derive(Debug, Clone)]
pub struct Recording {
    path: PathBuf,
    header: Header,
    config: Config,
    header_bytes: u64,
    records: u64,
    cut_bytes: u64,
}

/// Why a recording cannot be read.
#[derive(Debug)]
pub enum RecordingError {
    /// The disk says no.
    Io(PathBuf, io::Error),
    /// It is no recording, or not one of this version.
    Format(PathBuf, String),
}

impl fmt::Display for RecordingError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(path, error) => write!(out, "{}: {error}", path.display()),
            Self::Format(path, what) => write!(out, "{}: {what}", path.display()),
        }
    }
}

impl std::error::Error for RecordingError {}

impl Recording {
    /// Opens a recording and reads its header.
    ///
    /// # Errors
    /// It cannot be read, or is none.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::Io(path.to_path_buf(), error);
        let format = |what: &str| RecordingError::Format(path.to_path_buf(), what.to_string());
        let mut file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut start = [0; 16];
        let short = |_| format("is no recording: it is too short");
        file.read_exact(&mut start).map_err(short)?;
        if &start[..8] != MAGIC {
            return Err(format("is no recording of haptimill"));
        }
        let version = u16::from_le_bytes([start[8], start[9]]);
        let record_bytes = u16::from_le_bytes([start[10], start[11]]);
        if version != VERSION || usize::from(record_bytes) != RECORD_BYTES {
            return Err(format(&format!(
                "is a recording of version {version}, this program reads version {VERSION}"
            )));
        }
        let header_bytes = u32::from_le_bytes([start[12], start[13], start[14], start[15]]);
        let header_bytes = u64::from(header_bytes);
        if header_bytes < 16 || header_bytes > length {
            return Err(format("is cut off in its header"));
        }
        let mut body = vec![0; (header_bytes - 16) as usize];
        file.read_exact(&mut body).map_err(io)?;
        let header = Cursor(&body).header();
        let header = header.ok_or_else(|| format("has a damaged header"))?;
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&header.config);
        if crc != header.config_crc {
            return Err(format("has a damaged configuration"));
        }
        let config: Config = postcard::from_bytes(&header.config)
            .map_err(|_| format("has a configuration of another version"))?;
        let rest = length - header_bytes;
        Ok(Self {
            path: path.to_path_buf(),
            header,
            config,
            header_bytes,
            records: rest / RECORD_BYTES as u64,
            cut_bytes: rest % RECORD_BYTES as u64,
        })
    }

    /// What the recording says of itself.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The configuration of the controller that was recorded.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Whole records.
    pub fn records(&self) -> u64 {
        self.records
    }

    /// Bytes behind the last whole record: not 0 when the recording was cut off.
    pub fn cut_bytes(&self) -> u64 {
        self.cut_bytes
    }

    /// Length of a control period in seconds.
    pub fn period_s(&self) -> f64 {
        f64::from(self.config.period_us) / 1e6
    }

    /// Millimetres or degrees per axis unit, for each pose coordinate.
    pub fn pose_units(&self) -> Vec<f64> {
        let axes = self.config.pose.iter();
        axes.map(|axis| per_axis_unit(axis.kind)).collect()
    }

    /// Millimetres or degrees per axis unit, for each joint.
    pub fn joint_units(&self) -> Vec<f64> {
        let axes = self.config.joints.iter();
        axes.map(|axis| per_axis_unit(axis.kind)).collect()
    }

    /// Scale and unit of each joint's drive command: newtons or newton metres per DAC code, or 1 per step.
    pub fn drive_units(&self) -> Vec<(f64, &'static str)> {
        let unit = |kind| match kind {
            AxisKind::Linear => "n",
            AxisKind::Rotary => "n_m",
        };
        let joints = self.config.joints.iter();
        joints
            .map(|joint| match joint.drive {
                Drive::Torque { full_scale, .. } => (
                    f64::from(full_scale.0) / 65_536.0 / 8192.0,
                    unit(joint.kind),
                ),
                Drive::Steps { .. } => (1.0, "steps"),
            })
            .collect()
    }

    /// The records, from the first.
    ///
    /// # Errors
    /// The file cannot be opened again.
    pub fn iter(&self) -> Result<Records, RecordingError> {
        let io = |error| RecordingError::Io(self.path.clone(), error);
        let mut file = File::open(&self.path).map_err(io)?;
        file.seek(SeekFrom::Start(self.header_bytes)).map_err(io)?;
        Ok(Records {
            path: self.path.clone(),
            file: BufReader::with_capacity(1 << 20, file),
            left: self.records,
        })
    }
}

/// Millimetres or degrees of one axis unit.
pub(crate) fn per_axis_unit(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => 1.0 / f64::from(1 << 20),
        AxisKind::Rotary => 360.0 / 4_294_967_296.0,
    }
}

/// The records of a recording.
pub struct Records {
    path: PathBuf,
    file: BufReader<File>,
    left: u64,
}

impl Iterator for Records {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.left = self.left.checked_sub(1)?;
        let mut bytes = [0; RECORD_BYTES];
        if let Err(error) = self.file.read_exact(&mut bytes) {
            self.left = 0;
            return Some(Err(RecordingError::Io(self.path.clone(), error)));
        }
        let damaged = || RecordingError::Format(self.path.clone(), "has a damaged record".into());
        Some(Record::decode(&bytes).ok_or_else(damaged))
    }
}

/// Takes a header apart; `None` where it ends too soon.
struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn number(&mut self, bytes: usize) -> Option<usize> {
        let taken = self.take(bytes)?.iter().rev();
        Some(taken.fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
    }

    fn text(&mut self, length_bytes: usize) -> Option<String> {
        let count = self.number(length_bytes)?;
        Some(String::from_utf8_lossy(self.take(count)?).into_owned())
    }

    fn names(&mut self) -> Option<Vec<String>> {
        let count = self.number(1)?;
        (0..count).map(|_| self.text(1)).collect()
    }

    fn header(mut self) -> Option<Header> {
        Some(Header {
            config_crc: self.number(4)? as u32,
            config: {
                let count = self.number(4)?;
                self.take(count)?.to_vec()
            },
            machine: self.text(2)?,
            program: self.text(2)?,
            pose: self.names()?,
            joints: self.names()?,
        })
    }
}
