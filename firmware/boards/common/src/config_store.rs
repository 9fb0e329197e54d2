//! A configuration in two slots of a flash memory. A write goes to the slot that is not in use, so
//! a power cut at any moment leaves the configuration before it, or the new one.
//!
//! | bytes of a slot | |
//! | --- | --- |
//! | 0 | mark |
//! | 4 | number of the write; of two valid slots the later one counts |
//! | 8 | length of the configuration, bytes |
//! | 12 | CRC-32 of the configuration |
//! | 16 | CRC-32 of the bytes before |
//! | [`PAGE`] | the configuration |
//!
//! The page of the head is programmed last.

use embedded_storage::nor_flash::NorFlash;

pub use embedded_storage::nor_flash;
use haptimill_protocol::frame::{Crc32, crc32};

/// Bytes that are programmed at a time: a page of common flash memories.
pub const PAGE: usize = 256;
/// Bytes of the head.
const HEAD: usize = 20;
/// Mark of a slot: "HMcf".
const MARK: u32 = 0x6663_4D48;

/// Why a configuration was not kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StoreError<E> {
    /// It is empty, or exceeds a slot.
    Length,
    /// What is read back is not what was written: the flash is worn out.
    Worn,
    /// The flash reports an error.
    Flash(E),
}

impl<E> From<E> for StoreError<E> {
    fn from(error: E) -> Self {
        Self::Flash(error)
    }
}

/// What [`ConfigStore::save`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Saved {
    /// The configuration is in the flash now.
    Written,
    /// It was there before; the flash was not worn.
    Unchanged,
}

/// Head of a slot.
#[derive(Debug, Clone, Copy)]
struct Head {
    number: u32,
    length: usize,
    crc: u32,
}

impl Head {
    fn encode(&self) -> [u8; PAGE] {
        let mut page = [0xFF; PAGE];
        let words = [MARK, self.number, self.length as u32, self.crc];
        for (bytes, word) in page.chunks_exact_mut(4).zip(words) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        let crc = crc32(&page[..HEAD - 4]);
        page[HEAD - 4..HEAD].copy_from_slice(&crc.to_le_bytes());
        page
    }

    fn decode(page: &[u8; PAGE]) -> Option<Self> {
        let word =
            |at: usize| u32::from_le_bytes([page[at], page[at + 1], page[at + 2], page[at + 3]]);
        let sound = word(0) == MARK && word(HEAD - 4) == crc32(&page[..HEAD - 4]);
        sound.then(|| Self {
            number: word(4),
            length: word(8) as usize,
            crc: word(12),
        })
    }
}

/// Two slots of a flash.
#[derive(Debug)]
pub struct ConfigStore<F> {
    flash: F,
    /// Address of the first slot, and bytes of each.
    address: u32,
    slot: u32,
}

impl<F: NorFlash> ConfigStore<F> {
    /// Two slots of these bytes from an address on. `None` if they are not whole sectors of the
    /// flash, or reach beyond its end.
    pub fn new(flash: F, address: u32, slot: u32) -> Option<Self> {
        let sector = F::ERASE_SIZE as u32;
        let end = slot
            .checked_mul(2)
            .and_then(|both| both.checked_add(address));
        let fits = end.is_some_and(|end| end as usize <= flash.capacity());
        let sound = address.is_multiple_of(sector)
            && slot.is_multiple_of(sector)
            && slot as usize > PAGE
            && PAGE.is_multiple_of(F::WRITE_SIZE)
            && PAGE.is_multiple_of(F::READ_SIZE);
        (sound && fits).then_some(Self {
            flash,
            address,
            slot,
        })
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Most bytes of a configuration.
    const fn capacity(&self) -> usize {
        self.slot as usize - PAGE
    }

    const fn start(&self, index: u32) -> u32 {
        self.address + index * self.slot
    }

    fn head(&mut self, index: u32) -> Result<Option<Head>, F::Error> {
        let mut page = [0; PAGE];
        self.flash.read(self.start(index), &mut page)?;
        let max = self.capacity();
        Ok(Head::decode(&page).filter(|head| head.length <= max))
    }

    /// Reads a slot page by page until `check` is false for one; returns whether it was true for
    /// all.
    fn all_pages(
        &mut self,
        index: u32,
        length: usize,
        mut check: impl FnMut(usize, &[u8]) -> bool,
    ) -> Result<bool, F::Error> {
        let mut page = [0; PAGE];
        let places = (self.start(index) + PAGE as u32..).step_by(PAGE);
        for (at, from) in places.zip((0..length).step_by(PAGE)) {
            self.flash.read(at, &mut page)?;
            if !check(from, &page[..PAGE.min(length - from)]) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Finds the valid configuration: its slot and its head.
    fn find(&mut self) -> Result<Option<(u32, Head)>, F::Error> {
        let (first, second) = (self.head(0)?, self.head(1)?);
        let mut slots = [(0, first), (1, second)];
        if let (Some(first), Some(second)) = (first, second)
            && second.number.wrapping_sub(first.number).cast_signed() > 0
        {
            slots.reverse();
        }
        for (index, head) in slots {
            let Some(head) = head else {
                continue;
            };
            let mut crc = Crc32::new();
            self.all_pages(index, head.length, |_, bytes| {
                crc.add(bytes);
                true
            })?;
            if crc.value() == head.crc {
                return Ok(Some((index, head)));
            }
        }
        Ok(None)
    }

    /// Whether a slot has this configuration.
    fn has(&mut self, index: u32, head: &Head, config: &[u8]) -> Result<bool, F::Error> {
        if head.length != config.len() {
            return Ok(false);
        }
        self.all_pages(index, head.length, |from, bytes| {
            config[from..].starts_with(bytes)
        })
    }

    /// Reads the configuration; `None` if there is none, or it exceeds the buffer. The buffer takes
    /// whole pages.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn load<'b>(&mut self, buffer: &'b mut [u8]) -> Result<Option<&'b [u8]>, F::Error> {
        let Some((index, head)) = self.find()? else {
            return Ok(None);
        };
        let Some(bytes) = buffer.get_mut(..head.length.next_multiple_of(PAGE)) else {
            return Ok(None);
        };
        self.flash.read(self.start(index) + PAGE as u32, bytes)?;
        let config = &bytes[..head.length];
        Ok((crc32(config) == head.crc).then_some(config))
    }

    /// Keeps a configuration.
    ///
    /// # Errors
    /// It is too long, the flash reports an error, or does not keep what was written. The
    /// configuration before it stays valid then.
    pub fn save(&mut self, config: &[u8]) -> Result<Saved, StoreError<F::Error>> {
        if config.is_empty() || config.len() > self.capacity() {
            return Err(StoreError::Length);
        }
        let found = self.find()?;
        let (index, number) = match &found {
            Some((index, head)) if self.has(*index, head, config)? => return Ok(Saved::Unchanged),
            Some((index, head)) => (1 - index, head.number.wrapping_add(1)),
            None => (0, 0),
        };
        let start = self.start(index);
        self.flash.erase(start, start + self.slot)?;
        let mut page = [0xFF; PAGE];
        let places = (start + PAGE as u32..).step_by(PAGE);
        for (at, bytes) in places.zip(config.chunks(PAGE)) {
            page[..bytes.len()].copy_from_slice(bytes);
            page[bytes.len()..].fill(0xFF);
            self.flash.write(at, &page)?;
        }
        let head = Head {
            number,
            length: config.len(),
            crc: crc32(config),
        };
        self.flash.write(start, &head.encode())?;
        match self.find()? {
            Some((kept, head)) if kept == index && self.has(index, &head, config)? => {
                Ok(Saved::Written)
            }
            _ => Err(StoreError::Worn),
        }
    }
}
