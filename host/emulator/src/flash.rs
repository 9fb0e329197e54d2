//! Flash chip at the QMI of the RP2350 in its direct mode: a W25Q32 with the commands that an image
//! uses, and the times of its data sheet.
//!
//! The memory-mapped window of the emulated chip keeps the contents of the start: an image reads
//! what it has written by the command 03h only.

use std::ops::Range;

/// Bytes of the chip.
pub const BYTES: usize = 4 << 20;
/// Bytes of a sector and of a page.
pub const SECTOR: usize = 4096;
/// Bytes of a page.
pub const PAGE: usize = 256;
/// Typical times of a sector erase and of a page program (W25Q32JV, 9.6), in cycles of 150 MHz.
const ERASE_CYCLES: u64 = 45_000 * 150;
/// Time of a page program.
const PROGRAM_CYCLES: u64 = 400 * 150;

/// Bits of DIRECT_CSR: direct mode, chip select.
const DIRECT: u32 = 1;
const SELECT: u32 = 1 << 2;
/// Bit of DIRECT_TX: nothing is received.
const NO_PUSH: u32 = 1 << 20;
/// Bits of DIRECT_TX that other transfers than bytes over one line need: width of the data, lines.
const WIDE: u32 = 1 << 18 | 0b11 << 16;

/// What the chip does for a time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Work {
    /// It erases a sector from this address on.
    Erase(usize),
    /// It programs these bytes from this address on.
    Program(usize, Vec<u8>),
}

impl Work {
    /// Addresses that it changes.
    #[must_use]
    pub fn place(&self) -> Range<usize> {
        match self {
            Self::Erase(at) => *at..at + SECTOR,
            Self::Program(at, bytes) => *at..at + bytes.len(),
        }
    }
}

/// The chip.
#[derive(Debug)]
pub struct Flash {
    bytes: Vec<u8>,
    /// Bytes since the chip was selected.
    command: Vec<u8>,
    is_selected: bool,
    is_direct: bool,
    may_write: bool,
    /// What it does, and the cycle at which that ends.
    work: Option<(Work, u64)>,
    /// Cycle at which the line is free.
    free_at: u64,
    /// Cycles of a bit.
    divider: u64,
    /// Sectors that were erased and pages that were programmed, with the cycles at which that
    /// ended.
    pub done: Vec<(Work, u64)>,
    /// Commands that the chip ignores: unknown ones, writes without permission, any but the status
    /// while it works, transfers over several lines.
    pub ignored: Vec<Vec<u8>>,
}

impl Flash {
    /// A chip with these contents from its start on, otherwise erased.
    #[must_use]
    pub fn new(contents: &[u8]) -> Self {
        let mut bytes = contents.to_vec();
        bytes.resize(BYTES, 0xFF);
        Self {
            bytes,
            command: Vec::new(),
            is_selected: false,
            is_direct: false,
            may_write: false,
            work: None,
            free_at: 0,
            divider: 6,
            done: Vec::new(),
            ignored: Vec::new(),
        }
    }

    /// The contents.
    #[must_use]
    pub fn contents(&self) -> &[u8] {
        &self.bytes
    }

    /// Changes the contents, for a test that damages them.
    pub fn contents_mut(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    /// What it does now.
    #[must_use]
    pub fn work(&self) -> Option<&Work> {
        self.work.as_ref().map(|(work, _)| work)
    }

    /// The direct mode is on: nothing can be read in the memory-mapped window.
    #[must_use]
    pub const fn is_direct(&self) -> bool {
        self.is_direct
    }

    /// Contents that a power cut now leaves: of what the chip works on any bits may have changed.
    #[must_use]
    pub fn after_cut(&self, seed: u32) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        let mut random = seed | 1;
        if let Some((work, _)) = &self.work {
            let place = work.place();
            for (at, byte) in place.clone().zip(&mut bytes[place]) {
                random ^= random << 13;
                random ^= random >> 17;
                random ^= random << 5;
                let mask = (random >> 8) as u8;
                match work {
                    Work::Erase(_) => *byte |= mask,
                    Work::Program(from, written) => *byte &= written[at - from] | mask,
                }
            }
        }
        bytes
    }

    /// The chip of the processor is reset: the direct mode ends, and what the flash does goes on.
    pub fn reset_of_processor(&mut self) {
        self.is_direct = false;
        self.select(false, 0);
        self.divider = 6;
        self.free_at = 0;
    }

    /// Carries a write to DIRECT_CSR out.
    pub fn control(&mut self, value: u32, now: u64) {
        self.is_direct = value & DIRECT != 0;
        self.divider = match value >> 22 & 0xFF {
            0 => 256,
            divider => u64::from(divider),
        };
        self.select(value & SELECT != 0, now);
    }

    /// Whether the line can take the next byte.
    #[must_use]
    pub const fn is_free(&self, now: u64) -> bool {
        now >= self.free_at
    }

    /// Carries a write to DIRECT_TX out; returns what is received with it.
    pub fn exchange(&mut self, value: u32, now: u64) -> Option<u16> {
        self.free_at = now + 8 * self.divider;
        self.finish(now);
        let answer = if self.is_selected && value & WIDE == 0 {
            self.command.push(value as u8);
            self.answer()
        } else {
            self.ignored.push(vec![value as u8]);
            0xFF
        };
        (value & NO_PUSH == 0).then_some(u16::from(answer))
    }

    /// What the chip sends with the newest byte of the command.
    fn answer(&self) -> u8 {
        match (self.command.as_slice(), &self.work) {
            ([0x05, _, ..], work) => u8::from(work.is_some()) | u8::from(self.may_write) << 1,
            ([0x03, a, b, c, rest @ ..], None) if !rest.is_empty() => {
                let at = usize::from(*a) << 16 | usize::from(*b) << 8 | usize::from(*c);
                self.bytes[(at + rest.len() - 1) % BYTES]
            }
            _ => 0xFF,
        }
    }

    /// Ends what is done by now.
    pub fn finish(&mut self, now: u64) {
        let Some((work, end)) = self.work.take_if(|(_, end)| now >= *end) else {
            return;
        };
        let place = work.place();
        match &work {
            Work::Erase(_) => self.bytes[place].fill(0xFF),
            Work::Program(_, written) => {
                for (byte, written) in self.bytes[place].iter_mut().zip(written) {
                    *byte &= written;
                }
            }
        }
        self.may_write = false;
        self.done.push((work, end));
    }

    /// Selects the chip or not; at the end of a selection it carries its command out.
    fn select(&mut self, is_selected: bool, now: u64) {
        if self.is_selected == is_selected {
            return;
        }
        self.is_selected = is_selected;
        self.finish(now);
        let command = std::mem::take(&mut self.command);
        if is_selected || command.is_empty() {
            return;
        }
        let place = match command.as_slice() {
            [_, a, b, c, ..] => usize::from(*a) << 16 | usize::from(*b) << 8 | usize::from(*c),
            _ => 0,
        } % BYTES;
        let is_busy = self.work.is_some();
        match command.as_slice() {
            // Status; end of a continuous read mode.
            [0x05, ..] | [0xFF, ..] => {}
            [0x03, _, _, _, ..] | [0x06] | [0x20, _, _, _] | [0x02, _, _, _, _, ..] if is_busy => {
                self.ignored.push(command);
            }
            [0x03, _, _, _, ..] => {}
            [0x06] => self.may_write = true,
            [0x20, _, _, _] if self.may_write => {
                let sector = place / SECTOR * SECTOR;
                self.work = Some((Work::Erase(sector), now + ERASE_CYCLES));
            }
            // The chip wraps around at the end of a page: an image programs whole pages.
            [0x02, _, _, _, bytes @ ..]
                if self.may_write
                    && place.is_multiple_of(PAGE)
                    && !bytes.is_empty()
                    && bytes.len() <= PAGE =>
            {
                let bytes = bytes.to_vec();
                self.work = Some((Work::Program(place, bytes), now + PROGRAM_CYCLES));
            }
            _ => self.ignored.push(command),
        }
    }
}
