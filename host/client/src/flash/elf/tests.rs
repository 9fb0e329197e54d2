//! ELF files that the tests build byte by byte.

use crate::flash::{Board, Chip, Writing};
use proptest::prelude::*;

pub fn chip() -> &'static Chip {
    match &Board::named("stm32").unwrap().writing {
        Writing::Program(chip) => chip,
        Writing::Drive(_) => panic!(),
    }
}

/// A header of a segment.
pub struct Segment {
    pub kind: u32,
    pub address: u32,
    pub bytes: Vec<u8>,
}

impl Segment {
    fn load(address: u32, bytes: &[u8]) -> Self {
        Self {
            kind: super::LOAD,
            address,
            bytes: bytes.to_vec(),
        }
    }
}

/// An ELF file with these segments behind the headers.
pub fn elf(segments: &[Segment]) -> Vec<u8> {
    let mut file = vec![0x7F, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    file.extend([2, 0, 40, 0, 1, 0, 0, 0]);
    // Entry, headers of segments, headers of sections, flags.
    for word in [0x0800_0009_u32, 52, 0, 0x0500_0400] {
        file.extend(word.to_le_bytes());
    }
    for half in [52, 32, segments.len() as u16, 40, 0, 0] {
        file.extend(half.to_le_bytes());
    }
    let mut offset = 52 + 32 * segments.len() as u32;
    for segment in segments {
        let length = segment.bytes.len() as u32;
        // The address in the RAM differs, as that of data that are copied at the start.
        let ram = segment.address ^ 0x2800_0000;
        let words = [
            segment.kind,
            offset,
            ram,
            segment.address,
            length,
            length,
            4,
            4,
        ];
        for word in words {
            file.extend(word.to_le_bytes());
        }
        offset += length;
    }
    for segment in segments {
        file.extend(&segment.bytes);
    }
    file
}

/// A vector table, then code.
fn vectors(stack: u32, reset: u32) -> Vec<u8> {
    let words = [stack, reset, 0xBE00_BE00];
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// The segments of a sound image, not in the order of their addresses: vector table and code, data
/// behind a gap, and segments that are not loaded.
fn sound() -> Vec<Segment> {
    vec![
        Segment::load(0x0800_0010, &[1, 2, 3, 4]),
        Segment::load(0x0800_0000, &vectors(0x1001_0000, 0x0800_0009)),
        Segment::load(0x2000_0000, &[]),
        Segment {
            kind: 0x6474_E551,
            address: 0,
            bytes: vec![9; 4],
        },
    ]
}

/// A sound image, and the contents of the flash.
pub fn image() -> (Vec<u8>, Vec<u8>) {
    let mut contents = vectors(0x1001_0000, 0x0800_0009);
    contents.extend([0xFF, 0xFF, 0xFF, 0xFF, 1, 2, 3, 4]);
    (elf(&sound()), contents)
}

#[test]
fn the_contents_are_the_load_segments() {
    let (file, contents) = image();
    assert_eq!(chip().contents(&file), Ok(contents));
}

#[test]
fn each_defect_is_named() {
    let (file, _) = image();
    let refused = |file: &[u8], what: &str| {
        let error = chip().contents(file).unwrap_err();
        assert!(error.contains(what), "{what}: {error}");
    };
    let changed = |at: usize, byte: u8, what: &str| {
        let mut file = file.clone();
        file[at] = byte;
        refused(&file, what);
    };
    refused(&[], "is no ELF file of 32 bits");
    changed(0, 0, "is no ELF file of 32 bits");
    changed(4, 2, "is no ELF file of 32 bits");
    changed(16, 1, "type 1, machine 40");
    changed(18, 243, "type 2, machine 243");
    changed(42, 31, "a header of a segment has 31 bytes");
    changed(44, 0, "has no vector table");
    refused(&file[..51], "is truncated: its header");
    refused(&file[..83], "is truncated: header of segment 0");
    // The last bytes are those of the segment that is not loaded.
    refused(&file[..file.len() - 5], "is truncated: segment 1");
    let image = |index: usize, segment: Segment| {
        let mut segments = sound();
        segments[index] = segment;
        elf(&segments)
    };
    let table = vectors(0x1001_0000, 0x0800_0009);
    for address in [0x07FF_FFFF, 0x080F_FFFD, 0x2000_0000, 0xFFFF_FFFF] {
        refused(
            &image(0, Segment::load(address, &[1, 2, 3, 4])),
            "has a segment outside of the flash: segment 0 has 4 bytes at",
        );
    }
    let last = image(0, Segment::load(0x080F_FFFC, &[1, 2, 3, 4]));
    assert_eq!(chip().contents(&last).map(|it| it.len()), Ok(1 << 20));
    refused(
        &image(0, Segment::load(0x0800_0008, &[1])),
        "two segments overlap at 0x08000008",
    );
    refused(
        &image(1, Segment::load(0x0800_0004, &table)),
        "has its vector table elsewhere: its first segment is at 0x08000004",
    );
}

#[test]
fn the_vector_table_is_checked() {
    let checked = |stack: u32, reset: u32| {
        let segment = Segment::load(0x0800_0000, &vectors(stack, reset));
        chip().contents(&elf(&[segment]))
    };
    for stack in [0x1000_0004, 0x1001_0000, 0x2000_0004, 0x2002_0000] {
        assert!(checked(stack, 0x0800_0009).is_ok(), "{stack:#x}");
    }
    for stack in [0, 0x1000_0000, 0x1001_0004, 0x2002_0004, 0x2000_1001] {
        let error = checked(stack, 0x0800_0009).unwrap_err();
        assert!(error.contains("is not in the RAM"), "{stack:#x}: {error}");
    }
    for reset in [0x0800_0008, 0x0800_000D, 0x07FF_FFFF, 0x2000_0001] {
        let error = checked(0x1001_0000, reset).unwrap_err();
        assert!(error.contains("its reset vector"), "{reset:#x}: {error}");
    }
}

proptest! {
    /// Bytes of any content are read or refused.
    #[test]
    fn no_bytes_are_a_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        magic in any::<bool>(),
    ) {
        let mut file = if magic { super::MAGIC.to_vec() } else { Vec::new() };
        file.extend(bytes);
        if let Ok(contents) = chip().contents(&file) {
            prop_assert!(contents.len() <= 1 << 20);
        }
    }

    /// So is an image with other words and another length.
    #[test]
    fn no_damage_is_a_panic(
        words in prop::collection::vec((0_usize..50, any::<u32>(), any::<bool>()), 1..4),
        length in 0_usize..220,
    ) {
        let (mut file, _) = image();
        for (at, word, is_large) in words {
            let word = if is_large { word | 0xFFFF_FF00 } else { word & 0xFF };
            file[4 * at..4 * at + 4].copy_from_slice(&word.to_le_bytes());
        }
        file.truncate(length);
        if let Ok(contents) = chip().contents(&file) {
            prop_assert!(contents.len() <= 1 << 20);
        }
    }
}
