//! The log of an image: the up channel of RTT in its RAM, which a debug probe reads, too.

use crate::chip::Chip;
use std::ops::Range;

/// Mark of the control block, in words.
const MARK: [u32; 4] = [0x4747_4553, 0x5220_5245, 0x5454, 0];
/// Offsets in the control block (SEGGER RTT): address and size of the buffer of the first up
/// channel, offsets of the next byte of the image and of the reader in it.
const BUFFER: u32 = 28;
const SIZE: u32 = 32;
const WRITTEN: u32 = 36;
const READ: u32 = 40;

/// The reader of a log.
#[derive(Debug)]
pub struct Rtt {
    /// Address of the control block.
    block: u32,
    /// All bytes of the log.
    pub bytes: Vec<u8>,
    /// No probe reads it now.
    pub is_unread: bool,
}

impl Rtt {
    /// Looks for the control block in a part of the RAM; `None` if the image does not log.
    pub fn find(chip: &mut Chip, ram: Range<u32>) -> Option<Self> {
        let is_mark = |chip: &mut Chip, at: u32| {
            let mut words = MARK.iter().zip((at..).step_by(4));
            words.all(|(word, at)| chip.memory(at) == *word)
        };
        let block = ram.step_by(4).find(|at| is_mark(chip, *at))?;
        Some(Self {
            block,
            bytes: Vec::new(),
            is_unread: false,
        })
    }

    /// Takes what the image has written since the last call, if a probe reads it.
    pub fn read(&mut self, chip: &mut Chip) {
        let [buffer, size, written, mut read] =
            [BUFFER, SIZE, WRITTEN, READ].map(|at| chip.memory(self.block + at));
        if self.is_unread || read == written {
            return;
        }
        while read != written {
            let at = buffer + read;
            let word = chip.memory(at & !3);
            self.bytes.push(word.to_le_bytes()[(at & 3) as usize]);
            read = (read + 1) % size;
        }
        chip.set_memory(self.block + READ, read);
    }
}
