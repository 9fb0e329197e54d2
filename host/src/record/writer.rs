//! Writing a recording: the caller fills blocks of memory, a second thread checks, hashes and writes them to disk.
//!
//! A block is handed over when it is full, and the memory of one comes back when it is on disk, so a disk that is too slow for a while costs memory of a
//! few blocks and then time, never a record.

use super::blocks::{HEAD_BYTES, Head, Kind};
use super::{Header, RECORD_BYTES, Record, Tape};
use haptimill_firmware::io::{Inputs, Outputs};
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

/// A block for the disk.
struct Full {
    kind: Kind,
    count: u32,
    contents: Vec<u8>,
}

/// Writes a recording. Dropped without [`Recorder::finish`], it leaves what was recorded so far readable.
pub struct Recorder {
    block: Vec<u8>,
    tape: Option<Tape>,
    full: Option<SyncSender<Full>>,
    empty: Receiver<Vec<u8>>,
    writer: Option<JoinHandle<io::Result<Written>>>,
    records: u64,
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
}

impl Recorder {
    /// Creates (or overwrites) a file and writes its header.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path, header: &Header) -> io::Result<Self> {
        let file = File::create(path)?;
        let header = header.encode();
        let (full, blocks) = sync_channel(BLOCKS);
        let (back, empty) = sync_channel::<Vec<u8>>(BLOCKS + 1);
        let writer = std::thread::spawn(move || {
            write(file, &header, &blocks, |mut memory| {
                memory.clear();
                // The recorder may be gone already; its memory is then of no use.
                let _ = back.try_send(memory);
            })
        });
        Ok(Self {
            block: Vec::with_capacity(BLOCK_RECORDS * RECORD_BYTES),
            tape: None,
            full: Some(full),
            empty,
            writer: Some(writer),
            records: 0,
        })
    }

    /// Goes on with a tape that has all periods of the controller up to now; [`Recorder::period`] must be told each that follows.
    pub fn take_up(&mut self, mut tape: Tape) {
        if !tape.is_whole() {
            return;
        }
        for block in tape.take() {
            send(&self.full, Kind::Periods, block.count, block.bytes);
        }
        self.tape = Some(tape);
    }

    /// Takes down a period of the tape that was taken up; without one, nothing.
    #[inline]
    pub fn period(&mut self, inputs: &Inputs, outputs: &Outputs) {
        let Some(tape) = &mut self.tape else {
            return;
        };
        tape.add(inputs, outputs);
        for block in tape.take() {
            send(&self.full, Kind::Periods, block.count, block.bytes);
        }
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

    /// Records what happened, in words; `level` is 0 for news, 1 for a warning, 2 for an error.
    pub fn event(&mut self, period: u64, level: u8, text: &str) {
        let text = &text.as_bytes()[..text.len().min(usize::from(u16::MAX))];
        let mut contents = period.to_le_bytes().to_vec();
        contents.push(level);
        contents.extend_from_slice(&(text.len() as u16).to_le_bytes());
        contents.extend_from_slice(text);
        send(&self.full, Kind::Events, 1, contents);
    }

    /// Hands the records so far to the disk, unless that is behind: this never waits. If the process dies later, what was spilled stays.
    pub fn spill(&mut self) {
        let Some(full) = &self.full else {
            return;
        };
        if self.block.is_empty() {
            return;
        }
        match full.try_send(records(std::mem::take(&mut self.block))) {
            Err(TrySendError::Full(block)) => self.block = block.contents,
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
        let block = records(std::mem::replace(&mut self.block, fresh));
        send(&self.full, block.kind, block.count, block.contents);
    }

    /// Writes the rest and waits until all is handed to the system.
    ///
    /// # Errors
    /// The disk is full, or the like; the file ends where it did.
    pub fn finish(mut self) -> io::Result<Recorded> {
        self.rest();
        send(&self.full, Kind::End, self.records as u32, Vec::new());
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
        })
    }

    /// Hands over blocks that are not full.
    fn rest(&mut self) {
        if !self.block.is_empty() {
            self.hand_over();
        }
        if let Some(mut tape) = self.tape.take() {
            tape.close();
            for block in tape.take() {
                send(&self.full, Kind::Periods, block.count, block.bytes);
            }
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

fn records(contents: Vec<u8>) -> Full {
    Full {
        kind: Kind::Records,
        count: (contents.len() / RECORD_BYTES) as u32,
        contents,
    }
}

fn send(full: &Option<SyncSender<Full>>, kind: Kind, count: u32, contents: Vec<u8>) {
    if let Some(full) = full {
        // Fails only when the writer ended with an error, which `finish` tells.
        let _ = full.send(Full {
            kind,
            count,
            contents,
        });
    }
}

/// The second thread.
fn write(
    mut file: File,
    header: &[u8],
    blocks: &Receiver<Full>,
    give_back: impl Fn(Vec<u8>),
) -> io::Result<Written> {
    let mut hash = Sha256::new();
    hash.update(header);
    file.write_all(header)?;
    let mut bytes = header.len() as u64;
    for block in blocks {
        let head = Head::of(block.kind, block.count, &block.contents).encode();
        hash.update(head);
        hash.update(&block.contents);
        file.write_all(&head)?;
        file.write_all(&block.contents)?;
        bytes += (HEAD_BYTES + block.contents.len()) as u64;
        if block.kind == Kind::Records {
            give_back(block.contents);
        }
    }
    file.flush()?;
    Ok(Written {
        bytes,
        sha256: hash.finalize().into(),
    })
}
