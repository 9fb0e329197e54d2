//! Writing a recording: the caller fills blocks of memory, a second thread codes, checks, hashes and writes them to disk.
//!
//! A block is handed over when it is full, and the memory of one comes back when it is on disk, so a disk that is too slow for a while costs memory of a
//! few blocks and then time, never a record.

use super::blocks::{Head, Kind};
use super::{Header, IoLog, Period, Record};
use haptimill_firmware::io::{Inputs, Outputs};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

/// Records in a block: 492 kB.
const BLOCK_RECORDS: usize = 2048;

/// Periods that are handed over at once: 160 kB.
const BATCH_PERIODS: usize = 256;

/// Blocks and batches under way.
const BLOCKS: usize = 24;

/// What the second thread is given.
enum Task {
    /// A block as it stands on disk.
    Block {
        kind: Kind,
        count: u32,
        contents: Vec<u8>,
    },
    /// A tape to be written, and to go on with.
    IoLog(Box<IoLog>),
    /// The next periods of the tape.
    Periods(Vec<Period>),
}

/// Memory that the second thread gives back.
struct Memory {
    blocks: SyncSender<Vec<u8>>,
    batches: SyncSender<Vec<Period>>,
}

/// Writes a recording. Dropped without [`Recorder::finish`], it leaves what was recorded so far readable.
pub struct Recorder {
    block: Vec<u8>,
    /// Records have the hand of a haptic arm.
    hand: bool,
    record_bytes: usize,
    /// Periods that are not handed over yet, if a tape was taken up.
    periods: Option<Vec<Period>>,
    full: Option<SyncSender<Task>>,
    empty: Receiver<Vec<u8>>,
    empty_batches: Receiver<Vec<Period>>,
    writer: Option<JoinHandle<io::Result<Written>>>,
    records: u64,
    disk: Arc<Disk>,
    /// Nothing is recorded any more, for want of space.
    ended: bool,
}

/// What the second thread found out about the disk.
#[derive(Debug, Default)]
struct Disk {
    /// Less than [`RESERVE_BYTES`] are free.
    full: AtomicBool,
    /// A write failed.
    failed: AtomicBool,
}

/// Space on the disk that a recording leaves free: for its blocks under way, and for what is made from it.
pub const RESERVE_BYTES: u64 = 64 << 20;

/// Bytes between two looks at the free space.
const LOOK_BYTES: u64 = 1 << 20;

/// Bytes that are free on the disk of a file; none where the system does not say.
type FreeSpace = fn(&File) -> Option<u64>;

#[cfg(unix)]
fn free_space(file: &File) -> Option<u64> {
    let disk = rustix::fs::fstatvfs(file).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(not(unix))]
fn free_space(_: &File) -> Option<u64> {
    None
}

/// Bytes that are free on the disk of a folder; none where the system does not say.
#[must_use]
pub fn free_bytes(folder: &Path) -> Option<u64> {
    File::open(folder).ok().and_then(|file| free_space(&file))
}

/// What the second thread did.
struct Written {
    bytes: u64,
    sha256: [u8; 32],
}

/// A recording that is whole and on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    /// Records written.
    pub records: u64,
    /// Size of the file.
    pub bytes: u64,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
    /// It ends before the job does, because the disk was nearly full.
    pub disk_full: bool,
}

impl Recorder {
    /// Creates (or overwrites) a file and writes its header.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path, header: &Header) -> io::Result<Self> {
        Self::create_with(path, header, free_space)
    }

    pub(super) fn create_with(path: &Path, header: &Header, space: FreeSpace) -> io::Result<Self> {
        let file = File::create(path)?;
        let (hand, record_bytes) = (header.hand, header.record_bytes());
        let header = header.encode();
        let (full, tasks) = sync_channel(BLOCKS);
        let (blocks, empty) = sync_channel(BLOCKS + 1);
        let (batches, empty_batches) = sync_channel(BLOCKS + 1);
        let memory = Memory { blocks, batches };
        let disk = Arc::<Disk>::default();
        let seen = Arc::clone(&disk);
        let writer = std::thread::spawn(move || {
            let written = write(file, &header, &tasks, &memory, &seen, space);
            seen.failed.store(written.is_err(), Ordering::Relaxed);
            written
        });
        Ok(Self {
            block: Vec::with_capacity(BLOCK_RECORDS * record_bytes),
            hand,
            record_bytes,
            periods: None,
            full: Some(full),
            empty,
            empty_batches,
            writer: Some(writer),
            records: 0,
            disk,
            ended: false,
        })
    }

    /// Goes on with a tape that has all periods of the controller up to now; [`Recorder::period`] must be told each that follows.
    pub fn take_up(&mut self, io_log: IoLog) {
        if io_log.is_whole() {
            self.send(Task::IoLog(Box::new(io_log)));
            self.periods = Some(Vec::with_capacity(BATCH_PERIODS));
        }
    }

    /// Takes down a period of the tape that was taken up; without one, nothing.
    #[inline]
    pub fn period(&mut self, inputs: &Inputs, outputs: &Outputs) {
        if self.has_ended() {
            return;
        }
        let Some(periods) = &mut self.periods else {
            return;
        };
        periods.push(Period {
            inputs: inputs.clone(),
            outputs: outputs.clone(),
        });
        if periods.len() == BATCH_PERIODS {
            let fresh = self.empty_batches.try_recv();
            let fresh = fresh.unwrap_or_else(|_| Vec::with_capacity(BATCH_PERIODS));
            let batch = std::mem::replace(periods, fresh);
            self.send(Task::Periods(batch));
        }
    }

    /// Records a period. A failure of the disk is said by [`Recorder::finish`].
    #[inline]
    pub fn record(&mut self, record: &Record) {
        // Of a tape its period was asked first: both end together.
        if self.ended || (self.periods.is_none() && self.has_ended()) {
            return;
        }
        self.block.extend_from_slice(&record.encode());
        if self.hand {
            self.block.extend_from_slice(&record.encode_hand());
        }
        self.records += 1;
        if self.block.len() == BLOCK_RECORDS * self.record_bytes {
            self.hand_over();
        }
    }

    /// Whether the recording has ended before the job, for want of space or by an error of the disk.
    #[inline]
    #[must_use]
    pub fn is_broken(&self) -> bool {
        self.disk.full.load(Ordering::Relaxed) || self.disk.failed.load(Ordering::Relaxed)
    }

    #[inline]
    fn has_ended(&mut self) -> bool {
        self.ended |= self.disk.full.load(Ordering::Relaxed);
        self.ended
    }

    /// Records what happened, in words; `level` is 0 for news, 1 for a warning, 2 for an error.
    pub fn event(&mut self, period: u64, level: u8, text: &str) {
        let text = &text.as_bytes()[..text.len().min(usize::from(u16::MAX))];
        let mut contents = period.to_le_bytes().to_vec();
        contents.push(level);
        contents.extend_from_slice(&(text.len() as u16).to_le_bytes());
        contents.extend_from_slice(text);
        self.send(Task::Block {
            kind: Kind::Events,
            count: 1,
            contents,
        });
    }

    /// Hands the records so far to the disk, unless that is behind: this never waits. If the process dies later, what was spilled stays.
    pub fn spill(&mut self) {
        let Some(full) = &self.full else {
            return;
        };
        if self.block.is_empty() {
            return;
        }
        match full.try_send(records(std::mem::take(&mut self.block), self.record_bytes)) {
            Err(TrySendError::Full(Task::Block { contents, .. })) => self.block = contents,
            // Handed over; or the writer ended with an error, which `finish` tells.
            _ => self.block = self.fresh_block(),
        }
    }

    /// Records so far.
    pub fn records(&self) -> u64 {
        self.records
    }

    fn fresh_block(&self) -> Vec<u8> {
        let fresh = self.empty.try_recv();
        fresh.unwrap_or_else(|_| Vec::with_capacity(BLOCK_RECORDS * self.record_bytes))
    }

    #[cold]
    fn hand_over(&mut self) {
        let fresh = self.fresh_block();
        let block = std::mem::replace(&mut self.block, fresh);
        self.send(records(block, self.record_bytes));
    }

    fn send(&self, task: Task) {
        if let Some(full) = &self.full {
            // Fails only when the writer ended with an error, which `finish` tells.
            let _ = full.send(task);
        }
    }

    /// Writes the rest and waits until all is handed to the system.
    ///
    /// # Errors
    /// The disk is full, or the like; the file ends where it did.
    pub fn finish(mut self) -> io::Result<Recorded> {
        self.rest();
        self.send(Task::Block {
            kind: Kind::End,
            count: self.records as u32,
            contents: Vec::new(),
        });
        let written = self.close()?;
        let mut sha256 = String::with_capacity(64);
        for byte in written.sha256 {
            // Writing to a string cannot fail.
            let _ = write!(sha256, "{byte:02x}");
        }
        Ok(Recorded {
            records: self.records,
            bytes: written.bytes,
            sha256,
            disk_full: self.ended,
        })
    }

    /// Hands over blocks that are not full.
    fn rest(&mut self) {
        if !self.block.is_empty() {
            self.hand_over();
        }
        if let Some(periods) = self.periods.take() {
            // Ends the tape too.
            self.send(Task::Periods(periods));
            self.send(Task::IoLog(Box::default()));
        }
    }

    fn close(&mut self) -> io::Result<Written> {
        self.full = None;
        let gone = || Err(io::Error::other("the writing thread ended unexpectedly"));
        match self.writer.take() {
            Some(writer) => writer.join().unwrap_or_else(|_| gone()),
            None => gone(),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if self.writer.is_some() {
            self.rest();
            let _ = self.close();
        }
    }
}

fn records(contents: Vec<u8>, record_bytes: usize) -> Task {
    Task::Block {
        kind: Kind::Records,
        count: (contents.len() / record_bytes) as u32,
        contents,
    }
}

/// The second thread.
struct Writer<'a> {
    disk: &'a Disk,
    space: FreeSpace,
    /// Bytes at the next look at the free space.
    look_at: u64,
    file: File,
    hash: Sha256,
    bytes: u64,
}

impl Writer<'_> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hash.update(bytes);
        self.bytes += bytes.len() as u64;
        if self.bytes >= self.look_at {
            self.look_at = self.bytes + LOOK_BYTES;
            let low = (self.space)(&self.file).is_some_and(|free| free < RESERVE_BYTES);
            self.disk.full.fetch_or(low, Ordering::Relaxed);
        }
        self.file.write_all(bytes)
    }

    fn block(&mut self, kind: Kind, count: u32, contents: &[u8]) -> io::Result<()> {
        self.put(&Head::of(kind, count, contents).encode())?;
        self.put(contents)
    }

    /// Whole blocks of a tape.
    fn io_log(&mut self, io_log: &mut IoLog) -> io::Result<()> {
        for block in io_log.take() {
            self.block(Kind::Periods, block.count, &block.bytes)?;
        }
        Ok(())
    }
}

fn write(
    file: File,
    header: &[u8],
    tasks: &Receiver<Task>,
    memory: &Memory,
    disk: &Disk,
    space: FreeSpace,
) -> io::Result<Written> {
    let mut writer = Writer {
        disk,
        space,
        look_at: 0,
        file,
        hash: Sha256::new(),
        bytes: 0,
    };
    writer.put(header)?;
    let mut io_log = Box::<IoLog>::default();
    for task in tasks {
        match task {
            Task::Block {
                kind,
                count,
                mut contents,
            } => {
                writer.block(kind, count, &contents)?;
                if kind == Kind::Records {
                    contents.clear();
                    // The recorder may be gone already; its memory is then of no use.
                    let _ = memory.blocks.try_send(contents);
                }
            }
            Task::IoLog(next) => {
                io_log.close();
                writer.io_log(&mut io_log)?;
                io_log = next;
                writer.io_log(&mut io_log)?;
            }
            Task::Periods(mut periods) => {
                for period in &periods {
                    io_log.add(&period.inputs, &period.outputs);
                }
                writer.io_log(&mut io_log)?;
                periods.clear();
                let _ = memory.batches.try_send(periods);
            }
        }
    }
    writer.file.flush()?;
    Ok(Written {
        bytes: writer.bytes,
        sha256: writer.hash.finalize().into(),
    })
}
