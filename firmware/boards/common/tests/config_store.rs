//! Configurations in a simulated flash whose power is cut at each word of a write.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use haptimill_board_common::config_store::{ConfigStore, PAGE, Saved, StoreError};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const SECTOR: usize = 4096;
const SLOT: u32 = 8192;
/// The slots do not begin at the start of the flash.
const START: u32 = 4096;
const BYTES: usize = START as usize + 2 * SLOT as usize;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// The power was cut.
    Cut,
    /// Out of bounds, or not aligned.
    Place,
}

impl NorFlashError for Fault {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// A NOR flash: erasing sets bits, programming clears them. Both go on word by word until the power
/// is cut; the word at which it is cut gets some of its bits.
#[derive(Debug, Clone)]
struct Memory {
    bytes: Vec<u8>,
    /// Words until the power is cut.
    left: Option<usize>,
    /// Words that were erased or programmed.
    words: usize,
    /// State of the pseudo-random numbers for the bits of a cut word.
    random: u32,
    /// Bits of this byte stay set.
    worn: Option<usize>,
}

impl Memory {
    fn new() -> Self {
        Self {
            bytes: vec![0xFF; BYTES],
            left: None,
            words: 0,
            random: 1,
            worn: None,
        }
    }

    fn random(&mut self) -> u32 {
        self.random = self
            .random
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        self.random ^ self.random >> 16
    }

    /// Changes a word: `set` bits become 1, `clear` bits become 0.
    fn change(&mut self, at: usize, set: u32, clear: u32) -> Result<(), Fault> {
        let cut = self.left == Some(0);
        let mask = if cut { self.random() } else { u32::MAX };
        let old = u32::from_le_bytes(self.bytes[at..at + 4].try_into().unwrap());
        let new = (old | set & mask) & !(clear & mask);
        self.bytes[at..at + 4].copy_from_slice(&new.to_le_bytes());
        if let Some(worn) = self.worn {
            self.bytes[worn] = 0xFF;
        }
        if cut {
            return Err(Fault::Cut);
        }
        self.left = self.left.map(|left| left - 1);
        self.words += 1;
        Ok(())
    }
}

impl ErrorType for Memory {
    type Error = Fault;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Fault> {
        let from = offset as usize;
        let source = self.bytes.get(from..from + bytes.len());
        bytes.copy_from_slice(source.ok_or(Fault::Place)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = PAGE;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Fault> {
        let (from, to) = (from as usize, to as usize);
        if !from.is_multiple_of(SECTOR) || !to.is_multiple_of(SECTOR) || to > self.bytes.len() {
            return Err(Fault::Place);
        }
        (from..to)
            .step_by(4)
            .try_for_each(|at| self.change(at, u32::MAX, 0))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Fault> {
        let from = offset as usize;
        let aligned = from.is_multiple_of(PAGE) && bytes.len().is_multiple_of(PAGE);
        if !aligned || from + bytes.len() > self.bytes.len() {
            return Err(Fault::Place);
        }
        for (at, word) in (from..).step_by(4).zip(bytes.chunks(4)) {
            self.change(at, 0, !u32::from_le_bytes(word.try_into().unwrap()))?;
        }
        Ok(())
    }
}

fn store(memory: Memory) -> ConfigStore<Memory> {
    ConfigStore::new(memory, START, SLOT).expect("whole sectors within the flash")
}

/// What a flash holds.
fn loaded(memory: &Memory) -> Option<Vec<u8>> {
    let mut buffer = [0; SLOT as usize];
    let config = store(memory.clone()).load(&mut buffer).unwrap();
    config.map(<[u8]>::to_vec)
}

/// The flash after a write, and what the write returned.
fn saved(memory: &Memory, config: &[u8]) -> (Memory, Result<Saved, StoreError<Fault>>) {
    let mut store = store(memory.clone());
    let result = store.save(config);
    (store.into_flash(), result)
}

fn config(length: usize, seed: u8) -> Vec<u8> {
    let bytes = (0..length).map(|at| (at as u8).wrapping_mul(31).wrapping_add(seed));
    bytes.collect()
}

/// The power is cut at each word of a write in turn. Afterwards the flash holds the configuration
/// before, or from the last words on the new one; and it takes the new one.
#[test]
fn a_power_cut_at_each_word_keeps_one_configuration() {
    let (old, new) = (config(700, 1), config(900, 2));
    let (before, result) = saved(&saved(&Memory::new(), &config(10, 0)).0, &old);
    assert_eq!(result, Ok(Saved::Written));
    let (whole, result) = saved(&before, &new);
    assert_eq!(result, Ok(Saved::Written));
    let words = whole.words - before.words;
    // The slot is erased, then four pages and the head are programmed.
    assert_eq!(words, (SLOT as usize + 5 * PAGE) / 4);
    let (mut kept_old, mut kept_new) = (0, 0);
    for cut in 0..words {
        let mut memory = before.clone();
        memory.left = Some(cut);
        memory.random = cut as u32;
        let (mut after, result) = saved(&memory, &new);
        assert_eq!(result, Err(StoreError::Flash(Fault::Cut)), "word {cut}");
        after.left = None;
        match loaded(&after) {
            Some(kept) if kept == old => kept_old += 1,
            Some(kept) if kept == new => kept_new += 1,
            other => panic!("word {cut}: {other:?}"),
        }
        let (again, result) = saved(&after, &new);
        assert!(result.is_ok(), "word {cut}: {result:?}");
        assert_eq!(loaded(&again), Some(new.clone()), "word {cut}");
    }
    println!("{words} cuts: {kept_old} kept the old configuration, {kept_new} the new one");
    assert!(kept_old > words - PAGE / 4);
}

#[test]
fn an_empty_flash_has_no_configuration_and_an_equal_one_is_not_written_again() {
    let memory = Memory::new();
    assert_eq!(loaded(&memory), None);
    let (memory, result) = saved(&memory, &config(300, 3));
    assert_eq!(result, Ok(Saved::Written));
    let (after, result) = saved(&memory, &config(300, 3));
    assert_eq!(result, Ok(Saved::Unchanged));
    assert_eq!(after.words, memory.words);
}

#[test]
fn lengths_and_places_are_checked() {
    let max = SLOT as usize - PAGE;
    let (memory, result) = saved(&Memory::new(), &config(max, 4));
    assert_eq!(result, Ok(Saved::Written));
    assert_eq!(loaded(&memory), Some(config(max, 4)));
    for length in [0, max + 1] {
        let (after, result) = saved(&memory, &config(length, 5));
        assert_eq!(result, Err(StoreError::Length), "{length}");
        assert_eq!(after.words, memory.words);
    }
    for (start, slot) in [
        (1, SLOT),
        (START, 100),
        (START + SECTOR as u32, SLOT),
        (0, u32::MAX),
    ] {
        assert!(ConfigStore::new(Memory::new(), start, slot).is_none());
    }
}

/// A flash that does not keep its bits is reported, and the configuration before stays valid.
#[test]
fn a_worn_flash_is_reported() {
    let old = config(300, 6);
    let (mut memory, _) = saved(&Memory::new(), &old);
    // The second slot is the next one.
    memory.worn = Some((START + SLOT) as usize + PAGE + 7);
    let (after, result) = saved(&memory, &config(300, 7));
    assert_eq!(result, Err(StoreError::Worn));
    assert_eq!(loaded(&after), Some(old));
}

proptest! {
    #![proptest_config(ProptestConfig {
        rng_seed: RngSeed::Fixed(21),
        ..ProptestConfig::with_cases(200)
    })]

    /// Any sequence of writes, each of which may be cut: the flash always holds the last one that
    /// was completed, or one that was cut after it.
    #[test]
    fn writes_and_cuts_in_any_order(
        steps in prop::collection::vec(
            (1_usize..2000, any::<u8>(), prop::option::of(0_usize..3000), any::<u32>()),
            1..12,
        ),
        damage in prop::option::of(any::<u32>()),
    ) {
        let mut memory = Memory::new();
        let mut valid: Vec<Option<Vec<u8>>> = vec![None];
        let mut all = vec![None];
        for (length, seed, cut, random) in steps {
            let config = config(length, seed);
            all.push(Some(config.clone()));
            memory.left = cut;
            memory.random = random;
            let (after, result) = saved(&memory, &config);
            memory = after;
            memory.left = None;
            match result {
                Ok(_) => valid = vec![Some(config)],
                Err(StoreError::Flash(Fault::Cut)) => valid.push(Some(config)),
                Err(other) => prop_assert!(false, "{other:?}"),
            }
            prop_assert!(valid.contains(&loaded(&memory)));
        }
        // A configuration with a flipped bit is never taken.
        if let Some(damage) = damage {
            let at = damage as usize % BYTES;
            memory.bytes[at] ^= 1 << (damage >> 29);
            prop_assert!(all.contains(&loaded(&memory)));
        }
    }
}
