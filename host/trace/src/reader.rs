//! Reading a recording.

use super::blocks::{HEAD_BYTES, Head, Kind};
use super::header::{Cursor, START_BYTES};
use super::{CRC, HAPTIC_BYTES, HAPTIC_VERSION, Header, MAGIC, RECORD_BYTES, Record, VERSION};
use haptimill_firmware::config::{AxisKind, Config, Drive};
use haptimill_hil_sim::io_log::{IoLogDecoder, Period};
use sha2::{Digest, Sha256};
use std::collections::VecDeque;
use std::fmt::{self, Write as _};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Longest header that is read; it contains machine file and part program.
const MAX_HEADER_BYTES: u64 = 1 << 30;

/// A recording on disk.
#[derive(Debug, Clone)]
pub struct Recording {
    path: PathBuf,
    header: Header,
    config: Config,
    blocks: Vec<BlockPlace>,
    records: u64,
    periods: u64,
    bytes: u64,
    cut_bytes: u64,
    whole: bool,
}

/// Place of a block in its file.
#[derive(Debug, Clone, Copy)]
struct BlockPlace {
    head: Head,
    /// Offset of its content.
    offset: u64,
}

/// Recorded event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedEvent {
    /// Control period.
    pub period: u64,
    /// 0 for information, 1 for a warning, 2 for an error.
    pub level: u8,
    /// A sentence.
    pub text: String,
}

/// Error of reading or exporting a recording.
#[derive(Debug)]
pub enum RecordingError {
    /// The file cannot be read.
    Io(PathBuf, io::Error),
    /// The file is not a recording of this version, or is damaged.
    Format(PathBuf, String),
    /// The output cannot be written.
    Write(io::Error),
    /// This build does not write MCAP.
    NoMcap,
}

impl fmt::Display for RecordingError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(path, error) => write!(out, "{}: {error}", path.display()),
            Self::Format(path, what) => write!(out, "{}: {what}", path.display()),
            Self::Write(error) => write!(out, "trace: {error}"),
            Self::NoMcap => out.write_str(
                "this haptimill was built without MCAP; build it with: cargo build --release --features mcap",
            ),
        }
    }
}

impl std::error::Error for RecordingError {}

impl Recording {
    /// A recording without records yet, for the evaluation of records while they are made.
    ///
    /// # Errors
    ///
    /// Returns an error if the configuration in the header cannot be read.
    pub fn of_header(path: &Path, header: &Header) -> Result<Self, RecordingError> {
        let config = postcard::from_bytes(&header.config).map_err(|error| {
            let what = format!("has a configuration that cannot be read: {error}");
            RecordingError::Format(path.to_path_buf(), what)
        })?;
        Ok(Self {
            path: path.to_path_buf(),
            header: header.clone(),
            config,
            blocks: Vec::new(),
            records: 0,
            periods: 0,
            bytes: 0,
            cut_bytes: 0,
            whole: false,
        })
    }

    /// Opens a recording, reads its header and finds its blocks. The content of a block is checked
    /// when it is read.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read or is not a recording.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |error| RecordingError::Io(path.to_path_buf(), error);
        let format = |what: String| RecordingError::Format(path.to_path_buf(), what);
        // Opening a pipe may block for ever, and a device has no size.
        let kind = path.metadata().map_err(io)?;
        if !kind.is_file() && !kind.is_dir() {
            return Err(format(
                "is a pipe or a device; a recording is a regular file".to_string(),
            ));
        }
        let file = File::open(path).map_err(io)?;
        let bytes = file.metadata().map_err(io)?.len();
        let mut file = BufReader::with_capacity(1 << 12, file);
        let (header, header_bytes) = read_header(&mut file, bytes, &io, &format)?;
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&header.config);
        let config: Option<Config> = postcard::from_bytes(&header.config).ok();
        let config = config.filter(|_| crc == header.config_crc).ok_or_else(|| {
            format(format!(
                "has a configuration that this program cannot read; use haptimill {}, which recorded it",
                header.software
            ))
        })?;
        let mut recording = Self {
            path: path.to_path_buf(),
            header,
            config,
            blocks: Vec::new(),
            records: 0,
            periods: 0,
            bytes,
            cut_bytes: 0,
            whole: false,
        };
        recording.find_blocks(&mut file, header_bytes)?;
        Ok(recording)
    }

    fn find_blocks(&mut self, file: &mut BufReader<File>, from: u64) -> Result<(), RecordingError> {
        let io = |error| RecordingError::Io(self.path.clone(), error);
        let mut at = from;
        while at < self.bytes {
            if self.whole {
                return Err(damaged(&self.path, at, "bytes follow the end"));
            }
            let left = self.bytes - at;
            let mut head = [0; HEAD_BYTES];
            if left < HEAD_BYTES as u64 {
                break;
            }
            file.read_exact(&mut head).map_err(io)?;
            let head = Head::decode(&head, self.header.record_bytes())
                .ok_or_else(|| damaged(&self.path, at, "no block begins there"))?;
            let whole = HEAD_BYTES as u64 + u64::from(head.bytes);
            if left < whole {
                break;
            }
            match head.kind {
                Kind::Records => self.records += u64::from(head.count),
                Kind::Periods => self.periods += u64::from(head.count),
                Kind::Events => {}
                Kind::End => {
                    if head.count != self.records as u32 {
                        return Err(damaged(
                            &self.path,
                            at,
                            "records are missing before the end",
                        ));
                    }
                    self.whole = true;
                }
            }
            let offset = at + HEAD_BYTES as u64;
            self.blocks.push(BlockPlace { head, offset });
            file.seek_relative(i64::from(head.bytes)).map_err(io)?;
            at += whole;
        }
        self.cut_bytes = self.bytes - at;
        Ok(())
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Returns the configuration of the recorded controller.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the number of records.
    pub fn records(&self) -> u64 {
        self.records
    }

    /// Returns the number of periods since the power-on of the controller; 0 for a recording of
    /// telemetry.
    pub fn periods(&self) -> u64 {
        self.periods
    }

    /// Returns the size of the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the bytes of the periods in the file.
    pub fn period_bytes(&self) -> u64 {
        let all = self.of(Kind::Periods);
        all.iter().map(|place| u64::from(place.head.bytes)).sum()
    }

    /// Whether the recording is complete; otherwise it is truncated.
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// Returns the number of bytes after the last complete block.
    pub fn cut_bytes(&self) -> u64 {
        self.cut_bytes
    }

    /// Returns the control period in seconds.
    pub fn period_s(&self) -> f64 {
        f64::from(self.config.period_us) / 1e6
    }

    /// Returns the pose coordinates and the joints that wrap around, one bit each.
    fn wrapping(&self) -> [u8; 2] {
        [self.config.wrapping(), self.config.wrapping_joints()]
    }

    /// Returns millimetres or degrees per axis unit for each pose coordinate.
    pub fn pose_units(&self) -> Vec<f64> {
        let axes = self.config.pose.iter();
        axes.map(|axis| per_axis_unit(axis.kind)).collect()
    }

    /// Returns millimetres or degrees per axis unit for each joint.
    pub fn joint_units(&self) -> Vec<f64> {
        let axes = self.config.joints.iter();
        axes.map(|joint| per_axis_unit(joint.kind)).collect()
    }

    /// Returns scale and unit of each joint's drive command: newtons or newton metres per DAC code,
    /// or 1 per step.
    pub fn drive_units(&self) -> Vec<(f64, &'static str)> {
        let unit = |kind: AxisKind| if kind.is_rotary() { "n_m" } else { "n" };
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

    /// Returns the records in order.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened again.
    pub fn iter(&self) -> Result<Records, RecordingError> {
        Ok(Records {
            blocks: self.contents(Kind::Records)?,
            has_haptic_arm: self.header.has_haptic_arm,
            wrapping: self.wrapping(),
            before: None,
            block: Vec::new(),
            at: 0,
        })
    }

    /// Returns the last record, if there is one.
    ///
    /// # Errors
    ///
    /// Returns an error if the last block of records is damaged.
    pub fn last(&self) -> Result<Option<Record>, RecordingError> {
        let mut blocks = self.contents(Kind::Records)?;
        let last = blocks.left.len().saturating_sub(1);
        blocks.left.drain(..last);
        let records = Records {
            blocks,
            has_haptic_arm: self.header.has_haptic_arm,
            wrapping: self.wrapping(),
            before: None,
            block: Vec::new(),
            at: 0,
        };
        records.last().transpose()
    }

    /// Returns the periods since the power-on of the controller.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened again.
    pub fn read_periods(&self) -> Result<Periods, RecordingError> {
        Ok(Periods {
            blocks: self.contents(Kind::Periods)?,
            decoder: None,
        })
    }

    /// Returns the recorded events.
    ///
    /// # Errors
    ///
    /// Returns an error if a block is damaged.
    pub fn events(&self) -> Result<Vec<RecordedEvent>, RecordingError> {
        let mut events = Vec::new();
        let mut blocks = self.contents(Kind::Events)?;
        while let Some(block) = blocks.next() {
            let (place, contents) = block?;
            let mut cursor = Cursor(&contents);
            for _ in 0..place.head.count {
                let mut event = || {
                    Some(RecordedEvent {
                        period: cursor.number(8)?,
                        level: cursor.number(1)? as u8,
                        text: cursor.text(2)?,
                    })
                };
                let what = "an event cannot be decoded";
                events.push(event().ok_or_else(|| damaged(&self.path, place.offset, what))?);
            }
        }
        Ok(events)
    }

    /// Returns the SHA-256 of the file, hexadecimal: `trace_sha256` in the summary of the job.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read.
    pub fn sha256(&self) -> Result<String, RecordingError> {
        let io = |error| RecordingError::Io(self.path.clone(), error);
        let mut hash = Sha256::new();
        let mut file = File::open(&self.path).map_err(io)?;
        let mut buffer = vec![0; 1 << 16];
        loop {
            match file.read(&mut buffer).map_err(io)? {
                0 => break,
                count => hash.update(&buffer[..count]),
            }
        }
        let mut text = String::with_capacity(64);
        for byte in hash.finalize() {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
        }
        Ok(text)
    }

    /// Reads and checks the content of all blocks.
    ///
    /// # Errors
    ///
    /// Returns the first block that is damaged or cannot be read.
    pub fn verify(&self) -> Result<(), RecordingError> {
        let mut blocks = self.read(self.blocks.iter().copied().collect())?;
        while let Some(block) = blocks.next() {
            block?;
        }
        Ok(())
    }

    fn of(&self, kind: Kind) -> VecDeque<BlockPlace> {
        let all = self.blocks.iter().copied();
        all.filter(|place| place.head.kind == kind).collect()
    }

    fn contents(&self, kind: Kind) -> Result<Blocks, RecordingError> {
        self.read(self.of(kind))
    }

    fn read(&self, left: VecDeque<BlockPlace>) -> Result<Blocks, RecordingError> {
        let io = |error| RecordingError::Io(self.path.clone(), error);
        Ok(Blocks {
            path: self.path.clone(),
            file: File::open(&self.path).map_err(io)?,
            left,
        })
    }
}

/// Reads the header; returns it and its size.
fn read_header(
    file: &mut BufReader<File>,
    bytes: u64,
    io: &dyn Fn(io::Error) -> RecordingError,
    format: &dyn Fn(String) -> RecordingError,
) -> Result<(Header, u64), RecordingError> {
    let mut start = [0; START_BYTES];
    if bytes < START_BYTES as u64 {
        return Err(format("is not a recording: it is too short".into()));
    }
    file.read_exact(&mut start).map_err(io)?;
    if &start[..8] != MAGIC {
        return Err(format(
            "is not a recording of haptimill; the recording of a run is recording.hmr in its folder".into(),
        ));
    }
    let version = u16::from_le_bytes([start[8], start[9]]);
    let record_bytes = u16::from_le_bytes([start[10], start[11]]);
    let hand = match (version, usize::from(record_bytes)) {
        (VERSION, RECORD_BYTES) => false,
        (HAPTIC_VERSION, bytes) if bytes == RECORD_BYTES + HAPTIC_BYTES => true,
        _ => {
            return Err(format(format!(
                "is a recording of version {version}, this program reads versions {VERSION} and {HAPTIC_VERSION}; use the version of haptimill that recorded it"
            )));
        }
    };
    let header_bytes = u64::from(u32::from_le_bytes([
        start[12], start[13], start[14], start[15],
    ]));
    let damage = || format("is damaged in its header (before byte 16); take it from a copy".into());
    if header_bytes < START_BYTES as u64 + 4 || header_bytes > MAX_HEADER_BYTES {
        return Err(damage());
    }
    if header_bytes > bytes {
        return Err(format(format!(
            "is truncated in its header, at byte {bytes} of {header_bytes}; it has no records"
        )));
    }
    let mut header = start.to_vec();
    header.resize(header_bytes as usize, 0);
    file.read_exact(&mut header[START_BYTES..]).map_err(io)?;
    let (content, check) = header.split_at(header.len() - 4);
    if CRC.checksum(content).to_le_bytes() != check {
        return Err(format(format!(
            "is damaged in its header (before byte {header_bytes}); take it from a copy"
        )));
    }
    let mut header = Header::decode(&content[START_BYTES..]).ok_or_else(damage)?;
    header.has_haptic_arm = hand;
    Ok((header, header_bytes))
}

/// Returns the error of a damaged file, with the remedy.
fn damaged(path: &Path, at: u64, what: &str) -> RecordingError {
    RecordingError::Format(
        path.to_path_buf(),
        format!(
            "is damaged at byte {at}: {what}; take it from a copy, or read what is before: head -c {at} FILE > PART"
        ),
    )
}

/// Returns millimetres or degrees per axis unit.
pub(crate) fn per_axis_unit(kind: AxisKind) -> f64 {
    let one = if kind.is_rotary() { 360.0 } else { 1.0 };
    one / (1_u64 << kind.unit_bits()) as f64
}

/// Reads and checks the content of blocks of one kind.
struct Blocks {
    path: PathBuf,
    file: File,
    left: VecDeque<BlockPlace>,
}

impl Blocks {
    fn next(&mut self) -> Option<Result<(BlockPlace, Vec<u8>), RecordingError>> {
        let place = self.left.pop_front()?;
        let read = self.read(place);
        if read.is_err() {
            self.left.clear();
        }
        Some(read.map(|contents| (place, contents)))
    }

    fn read(&mut self, place: BlockPlace) -> Result<Vec<u8>, RecordingError> {
        let io = |error| RecordingError::Io(self.path.clone(), error);
        let mut contents = vec![0; place.head.bytes as usize];
        self.file.seek(SeekFrom::Start(place.offset)).map_err(io)?;
        self.file.read_exact(&mut contents).map_err(io)?;
        if CRC.checksum(&contents) != place.head.crc {
            let at = place.offset - HEAD_BYTES as u64;
            return Err(damaged(
                &self.path,
                at,
                "the check of the block there fails",
            ));
        }
        Ok(contents)
    }
}

/// The records of a recording.
pub struct Records {
    blocks: Blocks,
    has_haptic_arm: bool,
    /// Pose coordinates and joints that wrap around, one bit each, and the record before.
    wrapping: [u8; 2],
    before: Option<Record>,
    block: Vec<u8>,
    at: usize,
}

impl Iterator for Records {
    type Item = Result<Record, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let rest = self.block.get(self.at..).unwrap_or_default();
            if let Some((bytes, _)) = rest.split_first_chunk::<RECORD_BYTES>() {
                self.at += RECORD_BYTES;
                let mut record = Record::decode(bytes);
                if let (true, Some(record), Some((haptic, _))) = (
                    self.has_haptic_arm,
                    &mut record,
                    rest[RECORD_BYTES..].split_first_chunk::<HAPTIC_BYTES>(),
                ) {
                    record.decode_haptic(haptic);
                    self.at += HAPTIC_BYTES;
                }
                let foreign = || {
                    RecordingError::Format(
                        self.blocks.path.clone(),
                        "has a record with an unknown state".into(),
                    )
                };
                if let Some(record) = &mut record
                    && self.wrapping != [0; 2]
                {
                    record.count_turns(self.wrapping, self.before.as_ref());
                    self.before = Some(*record);
                }
                return Some(record.ok_or_else(foreign));
            }
            match self.blocks.next()? {
                Ok((_, contents)) => (self.block, self.at) = (contents, 0),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// Periods of a recording, in order.
pub struct Periods {
    blocks: Blocks,
    decoder: Option<IoLogDecoder>,
}

impl Iterator for Periods {
    type Item = Result<Period, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(decoder) = &mut self.decoder
                && let Some(period) = decoder.next()
            {
                return Some(period.map_err(|at| {
                    RecordingError::Format(
                        self.blocks.path.clone(),
                        format!(
                            "has periods that this version of haptimill cannot read (byte {at} of a block); use the version that recorded it"
                        ),
                    )
                }));
            }
            match self.blocks.next()? {
                Ok((place, contents)) => {
                    self.decoder = Some(IoLogDecoder::new(place.head.count, contents))
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }
}
