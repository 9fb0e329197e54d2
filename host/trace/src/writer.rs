//! Writer of a recording file. The caller fills blocks in memory; a writing thread encodes, hashes
//! and writes them to disk.
//!
//! A full block is sent to the thread, and its memory returns when it is on disk. A slow disk costs
//! the memory of a few blocks, then time of the caller, but no record.

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

/// Periods in a batch: 160 kB.
const BATCH_PERIODS: usize = 256;

/// Largest number of blocks and batches in the queue.
const BLOCKS: usize = 24;

/// Task of the writing thread.
enum Task {
    /// Writes a block.
    Block {
        kind: Kind,
        count: u32,
        contents: Vec<u8>,
    },
    /// Writes an I/O log and continues it.
    IoLog(Box<IoLog>),
    /// Appends periods to the I/O log.
    Periods(Vec<Period>),
}

/// Memory that the writing thread returns.
struct Memory {
    blocks: SyncSender<Vec<u8>>,
    batches: SyncSender<Vec<Period>>,
}

/// Writer of a file. Dropped without [`FileRecorder::finish`], it leaves a readable, truncated
/// recording.
pub(super) struct FileRecorder {
    block: Vec<u8>,
    /// Whether records have the values of a haptic arm.
    has_haptic_arm: bool,
    record_bytes: usize,
    /// Periods that are not sent yet, if there is an I/O log.
    periods: Option<Vec<Period>>,
    full: Option<SyncSender<Task>>,
    empty: Receiver<Vec<u8>>,
    empty_batches: Receiver<Vec<Period>>,
    writer: Option<JoinHandle<io::Result<Written>>>,
    records: u64,
    disk: Arc<Disk>,
    /// Recording has ended because the disk is nearly full.
    ended: bool,
}

/// State of the disk, from the writing thread.
#[derive(Debug, Default)]
struct Disk {
    /// Less than [`RESERVE_BYTES`] are free.
    full: AtomicBool,
    /// A write failed.
    failed: AtomicBool,
}

/// Space on the disk that a recording leaves free, for its queued blocks and for the report.
pub const RESERVE_BYTES: u64 = 64 << 20;

/// Bytes between two checks of the free space.
const SPACE_CHECK_BYTES: u64 = 1 << 20;

/// Returns the free bytes of the disk of a file, if the system reports them.
pub(super) type FreeSpace = fn(&File) -> Option<u64>;

#[cfg(unix)]
pub(super) fn free_space(file: &File) -> Option<u64> {
    let disk = rustix::fs::fstatvfs(file).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(not(unix))]
pub(super) fn free_space(_: &File) -> Option<u64> {
    None
}

/// Returns the free bytes of the disk of a folder, if the system reports them.
#[must_use]
pub fn free_bytes(folder: &Path) -> Option<u64> {
    File::open(folder).ok().and_then(|file| free_space(&file))
}

/// Result of the writing thread.
struct Written {
    bytes: u64,
    sha256: [u8; 32],
}

/// Result of a complete recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    /// Records written.
    pub records: u64,
    /// Size of the file.
    pub bytes: u64,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
    /// Whether the recording ends before the job because the disk was nearly full.
    pub disk_full: bool,
}

impl FileRecorder {
    /// Creates (or overwrites) a file and writes its header.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be created.
    pub fn create_with(path: &Path, header: &Header, free_space: FreeSpace) -> io::Result<Self> {
        let file = File::create(path)?;
        let (has_haptic_arm, record_bytes) = (header.has_haptic_arm, header.record_bytes());
        let header = header.encode();
        let (full, tasks) = sync_channel(BLOCKS);
        let (blocks, empty) = sync_channel(BLOCKS + 1);
        let (batches, empty_batches) = sync_channel(BLOCKS + 1);
        let memory = Memory { blocks, batches };
        let disk = Arc::<Disk>::default();
        let thread_disk = Arc::clone(&disk);
        let writer = std::thread::spawn(move || {
            let written = write(file, &header, &tasks, &memory, &thread_disk, free_space);
            thread_disk
                .failed
                .store(written.is_err(), Ordering::Relaxed);
            written
        });
        Ok(Self {
            block: Vec::with_capacity(BLOCK_RECORDS * record_bytes),
            has_haptic_arm,
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

    /// Writes an I/O log with all periods of the controller up to now. Callers must pass each later
    /// period to [`FileRecorder::period`].
    pub fn start_io_log(&mut self, io_log: IoLog) {
        if io_log.is_whole() {
            self.send(Task::IoLog(Box::new(io_log)));
            self.periods = Some(Vec::with_capacity(BATCH_PERIODS));
        }
    }

    /// Records a period of the I/O log, if there is one.
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

    /// Appends a record. [`FileRecorder::finish`] returns an error of the disk.
    #[inline]
    pub fn record(&mut self, record: &Record) {
        // With an I/O log, `period` has checked the disk already: both end together.
        if self.ended || (self.periods.is_none() && self.has_ended()) {
            return;
        }
        self.block.extend_from_slice(&record.encode());
        if self.has_haptic_arm {
            self.block.extend_from_slice(&record.encode_haptic());
        }
        self.records += 1;
        if self.block.len() == BLOCK_RECORDS * self.record_bytes {
            self.send_block();
        }
    }

    /// Whether the recording has ended before the job, because the disk is nearly full or failed.
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

    /// Records an event; `level` is 0 for information, 1 for a warning, 2 for an error.
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

    /// Sends the records so far to the writing thread, without waiting if its queue is full. They
    /// are on disk even if the process is killed later.
    pub fn spill(&mut self) {
        let Some(full) = &self.full else {
            return;
        };
        if self.block.is_empty() {
            return;
        }
        match full.try_send(record_block(
            std::mem::take(&mut self.block),
            self.record_bytes,
        )) {
            Err(TrySendError::Full(Task::Block { contents, .. })) => self.block = contents,
            // Sent; or the thread ended with an error, which `finish` returns.
            _ => self.block = self.fresh_block(),
        }
    }

    /// Returns the number of records so far.
    pub fn records(&self) -> u64 {
        self.records
    }

    fn fresh_block(&self) -> Vec<u8> {
        let fresh = self.empty.try_recv();
        fresh.unwrap_or_else(|_| Vec::with_capacity(BLOCK_RECORDS * self.record_bytes))
    }

    #[cold]
    fn send_block(&mut self) {
        let fresh = self.fresh_block();
        let block = std::mem::replace(&mut self.block, fresh);
        self.send(record_block(block, self.record_bytes));
    }

    fn send(&self, task: Task) {
        if let Some(full) = &self.full {
            // Fails only if the thread ended with an error, which `finish` returns.
            let _ = full.send(task);
        }
    }

    /// Writes the remaining blocks and waits for the writing thread.
    ///
    /// # Errors
    ///
    /// Returns an error of the disk; the file is truncated there.
    pub fn finish(mut self) -> io::Result<Recorded> {
        self.send_rest();
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

    /// Sends blocks that are not full.
    fn send_rest(&mut self) {
        if !self.block.is_empty() {
            self.send_block();
        }
        if let Some(periods) = self.periods.take() {
            // An empty I/O log ends the present one.
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

impl Drop for FileRecorder {
    fn drop(&mut self) {
        if self.writer.is_some() {
            self.send_rest();
            let _ = self.close();
        }
    }
}

fn record_block(contents: Vec<u8>, record_bytes: usize) -> Task {
    Task::Block {
        kind: Kind::Records,
        count: (contents.len() / record_bytes) as u32,
        contents,
    }
}

/// The writing thread.
struct Writer<'a> {
    disk: &'a Disk,
    free_space: FreeSpace,
    /// Bytes at the next check of the free space.
    check_at: u64,
    file: File,
    hash: Sha256,
    bytes: u64,
}

impl Writer<'_> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hash.update(bytes);
        self.bytes += bytes.len() as u64;
        if self.bytes >= self.check_at {
            self.check_at = self.bytes + SPACE_CHECK_BYTES;
            let low = (self.free_space)(&self.file).is_some_and(|free| free < RESERVE_BYTES);
            self.disk.full.fetch_or(low, Ordering::Relaxed);
        }
        self.file.write_all(bytes)
    }

    fn block(&mut self, kind: Kind, count: u32, contents: &[u8]) -> io::Result<()> {
        self.put(&Head::of(kind, count, contents).encode())?;
        self.put(contents)
    }

    /// Writes the complete blocks of an I/O log.
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
    free_space: FreeSpace,
) -> io::Result<Written> {
    let mut writer = Writer {
        disk,
        free_space,
        check_at: 0,
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
                    // The recorder may have ended; its memory is not needed then.
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
