//! ELF files of ARM chips: their load segments, as the flash has them.

use std::ops::Range;

/// Start of a file: ELF, 32 bits, little endian.
const MAGIC: [u8; 6] = [0x7F, b'E', b'L', b'F', 1, 1];
/// An executable file, and ARM.
const EXECUTABLE: u16 = 2;
const ARM: u16 = 40;
/// Bytes of the header of the file, and of that of a segment.
const HEADER: usize = 52;
const SEGMENT: usize = 32;
/// A segment that is loaded.
const LOAD: u32 = 1;
/// Contents of flash that is erased.
const ERASED: u8 = 0xFF;

/// The contents of the flash of a chip, from its first address to the last one that a load segment
/// has. Gaps between the segments are as erased flash. `flash` and `ram` are the addresses of its
/// memories.
///
/// # Errors
/// The file is no ELF file of an ARM chip, or is truncated; a segment is outside of the flash, or
/// overlaps another one; the vector table is not at the first address of the flash, its stack
/// pointer not in the RAM, or its reset vector not in a segment.
pub fn read(file: &[u8], flash: &Range<u32>, ram: &[Range<u32>]) -> Result<Vec<u8>, String> {
    let mut contents = Vec::new();
    for (address, bytes) in segments(file, flash)? {
        let start = (address - flash.start) as usize;
        if contents.is_empty() && start > 0 {
            return Err(format!(
                "has its vector table elsewhere: its first segment is at {address:#010x}, the flash \
                 at {:#010x}",
                flash.start
            ));
        }
        if start < contents.len() {
            return Err(format!(
                "is damaged: two segments overlap at {address:#010x}"
            ));
        }
        contents.resize(start, ERASED);
        contents.extend_from_slice(bytes);
    }
    check_vectors(&contents, flash.start, ram)?;
    Ok(contents)
}

/// Checks the first two words: the stack pointer and the reset vector.
fn check_vectors(contents: &[u8], start: u32, ram: &[Range<u32>]) -> Result<(), String> {
    let (Some(stack), Some(reset)) = (word(contents, 0), word(contents, 4)) else {
        return Err("has no vector table".to_string());
    };
    // The stack grows down from its pointer.
    let is_in = |ram: &Range<u32>| ram.start < stack && stack <= ram.end;
    if !stack.is_multiple_of(4) || !ram.iter().any(is_in) {
        return Err(format!(
            "has no vector table of this chip: its stack pointer {stack:#010x} is not in the RAM"
        ));
    }
    let end = start + contents.len() as u32;
    if reset.is_multiple_of(2) || !(start..end).contains(&reset) {
        return Err(format!(
            "has no vector table of this chip: its reset vector {reset:#010x} is not an odd address \
             in its segments"
        ));
    }
    Ok(())
}

/// The load segments with contents, by their addresses in the flash.
fn segments<'a>(file: &'a [u8], flash: &Range<u32>) -> Result<Vec<(u32, &'a [u8])>, String> {
    if !file.starts_with(&MAGIC) {
        return Err("is no ELF file of 32 bits".to_string());
    }
    let truncated = |what: &str| format!("is truncated: {what}");
    if file.len() < HEADER {
        return Err(truncated("its header"));
    }
    let (Some(kind), Some(machine)) = (half(file, 16), half(file, 18)) else {
        return Err(truncated("its header"));
    };
    if (kind, machine) != (EXECUTABLE, ARM) {
        return Err(format!(
            "is no executable file of an ARM chip: type {kind}, machine {machine}"
        ));
    }
    let (Some(table), Some(size), Some(count)) = (word(file, 28), half(file, 42), half(file, 44))
    else {
        return Err(truncated("its header"));
    };
    if usize::from(size) != SEGMENT {
        return Err(format!(
            "is damaged: a header of a segment has {size} bytes"
        ));
    }
    let mut found = Vec::new();
    for number in 0..usize::from(count) {
        let header = part(
            file,
            (table as usize).saturating_add(number * SEGMENT),
            SEGMENT,
        )
        .ok_or_else(|| truncated(&format!("header of segment {number}")))?;
        let field = |at: usize| word(header, at).unwrap_or(0);
        let (offset, address, length) = (field(4), field(12), field(16));
        if field(0) != LOAD || length == 0 {
            continue;
        }
        let bytes = part(file, offset as usize, length as usize)
            .ok_or_else(|| truncated(&format!("segment {number}")))?;
        if address < flash.start || u64::from(address) + u64::from(length) > u64::from(flash.end) {
            return Err(format!(
                "has a segment outside of the flash: segment {number} has {length} bytes at \
                 {address:#010x}, the flash is {:#010x} to {:#010x}",
                flash.start, flash.end
            ));
        }
        found.push((address, bytes));
    }
    found.sort_by_key(|(address, _)| *address);
    Ok(found)
}

/// A part of a file, if the file has it.
fn part(file: &[u8], at: usize, length: usize) -> Option<&[u8]> {
    file.get(at..)?.get(..length)
}

fn half(file: &[u8], at: usize) -> Option<u16> {
    let bytes = part(file, at, 2)?;
    Some(u16::from_le_bytes([bytes[0], bytes[1]]))
}

fn word(file: &[u8], at: usize) -> Option<u32> {
    let bytes = part(file, at, 4)?;
    Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}

#[cfg(test)]
pub(super) mod tests;
