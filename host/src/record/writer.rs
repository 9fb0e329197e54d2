//! Writing a recording: the caller fills blocks of memory, a second thread hashes them and writes them to disk.
//!
//! A block is handed over when it is full and comes back when it is on disk, so a disk that is too slow for a while costs memory of a few blocks
//! and then time, never a record.

use super::{Header, RECORD_BYTES, Record};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

/// Records in a block: 492 kB.
const BLOCK_RECORDS: usize = 2048;

/// Blocks under way.
const BLOCKS: usize = 8;

/// Writes a recording. Dropped without [`Recorder::finish`], it leaves what was recorded so far readable.
pub struct Recorder {
    block: Vec<u8>,
    full: Option<SyncSender<Vec<u8>>>,
    empty: Receiver<Vec<u8>>,
    writer: Option<JoinHandle<io::Result<[u8; 32]>>>,
    records: u64,
    header_bytes: u64,
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
}

impl Recorder {
    /// Creates (or overwrites) a file and writes its header.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path, header: &Header) -> io::Result<Self> {
        let mut file = File::create(path)?;
        let header = header.encode();
        let header_bytes = header.len() as u64;
        let (full, blocks) = sync_channel::<Vec<u8>>(BLOCKS);
        let (back, empty) = sync_channel::<Vec<u8>>(BLOCKS + 1);
        let writer = std::thread::spawn(move || {
            let mut hash = Sha256::new();
            hash.update(&header);
            file.write_all(&header)?;
            for mut block in blocks {
                hash.update(&block);
                file.write_all(&block)?;
                block.clear();
                // The recorder may be gone already; its blocks are then of no use.
                let _ = back.try_send(block);
            }
            file.flush()?;
            Ok(hash.finalize().into())
        });
        Ok(Self {
            block: Vec::with_capacity(BLOCK_RECORDS * RECORD_BYTES),
            full: Some(full),
            empty,
            writer: Some(writer),
            records: 0,
            header_bytes,
        })
    }

    /// Records a period. A failure of the disk is said by [`Recorder::finish`].
    #[inline]
    pub fn record(&mut self, record: &Record) {
        self.block.extend_from_slice(&record.encode());
        self.records += 1;
        if self.block.len() == BLOCK_RECORDS * RECORD_BYTES {
            self.hand_over();
        }
    }

    /// Hands what was recorded so far to the disk, unless that is behind: this never waits. If the process dies later, what was spilled stays.
    pub fn spill(&mut self) {
        let Some(full) = &self.full else {
            return;
        };
        if self.block.is_empty() {
            return;
        }
        match full.try_send(std::mem::take(&mut self.block)) {
            Err(TrySendError::Full(block)) => self.block = block,
            // Handed over; or the writer ended with an error, which `finish` tells.
            Ok(()) | Err(TrySendError::Disconnected(_)) => self.block = self.fresh_block(),
        }
    }

    /// Records so far.
    pub fn records(&self) -> u64 {
        self.records
    }

    fn fresh_block(&self) -> Vec<u8> {
        let fresh = self.empty.try_recv();
        fresh.unwrap_or_else(|_| Vec::with_capacity(BLOCK_RECORDS * RECORD_BYTES))
    }

    #[cold]
    fn hand_over(&mut self) {
        let fresh = self.fresh_block();
        let block = std::mem::replace(&mut self.block, fresh);
        if let Some(full) = &self.full {
            // Fails only when the writer ended with an error, which `finish` tells.
            let _ = full.send(block);
        }
    }

    /// Writes the rest and waits until all is handed to the system.
    ///
    /// # Errors
    /// The disk is full, or the like; the file ends where it did.
    pub fn finish(mut self) -> io::Result<Recorded> {
        let hash = self.close()?;
        let mut sha256 = String::with_capacity(64);
        for byte in hash {
            // Writing to a string cannot fail.
            let _ = write!(sha256, "{byte:02x}");
        }
        Ok(Recorded {
            records: self.records,
            bytes: self.header_bytes + self.records * RECORD_BYTES as u64,
            sha256,
        })
    }

    fn close(&mut self) -> io::Result<[u8; 32]> {
        if !self.block.is_empty() {
            self.hand_over();
        }
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
            let _ = self.close();
        }
    }
}
