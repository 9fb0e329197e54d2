//! Images of the RP2350: checks of their memory map, and UF2 files.

/// Start of the flash.
const FLASH: u32 = 0x1000_0000;
/// Largest flash of a board, bytes.
const MAX: usize = 4 << 20;
/// The boot ROM looks for the boot block in the first 4 KiB.
const BOOT_BYTES: usize = 4096;

/// First and last word of a boot block, and its word for an image: executable, secure, Arm, RP2350.
const BLOCK_START: u32 = 0xFFFF_DED3;
const BLOCK_END: u32 = 0xAB12_3579;
const IMAGE: u32 = 0x1021_0142;

/// Bytes of the flash in a UF2 block, and the family of the RP2350's Arm cores in secure state.
const PAYLOAD: usize = 256;
const FAMILY: u32 = 0xE48B_FF59;

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn half(bytes: &[u8], at: usize) -> Option<usize> {
    Some(usize::from(u16::from_le_bytes(
        bytes.get(at..at + 2)?.try_into().ok()?,
    )))
}

/// Contents of the flash: the load segments of an ELF file at their physical addresses.
fn flash(elf: &[u8]) -> Result<Vec<u8>, String> {
    let cut = "the ELF file is cut off";
    let table = word(elf, 28).ok_or(cut)? as usize;
    let (size, count) = (half(elf, 42).ok_or(cut)?, half(elf, 44).ok_or(cut)?);
    let mut flash = Vec::new();
    for index in 0..count {
        let field = |at: usize| word(elf, table + index * size + at).ok_or(cut);
        let (kind, offset, address, length) = (
            field(0)?,
            field(4)? as usize,
            field(12)?,
            field(16)? as usize,
        );
        if kind != 1 || length == 0 {
            continue;
        }
        let from = address.checked_sub(FLASH).map(|from| from as usize);
        let Some(from) = from.filter(|from| from + length <= MAX) else {
            return Err(format!(
                "{length} bytes at {address:#010x} are not in the flash"
            ));
        };
        if flash.len() < from + length {
            flash.resize(from + length, 0xFF);
        }
        let bytes = elf.get(offset..offset + length).ok_or(cut)?;
        flash[from..from + length].copy_from_slice(bytes);
    }
    Ok(flash)
}

/// Checks the memory map of an image, and returns the contents of its flash.
///
/// # Errors
/// The vector table, the boot block or an address is wrong.
pub fn check(elf: &[u8]) -> Result<Vec<u8>, String> {
    let flash = flash(elf)?;
    let stack = word(&flash, 0).ok_or("the flash is empty")?;
    let reset = word(&flash, 4).ok_or("the flash is empty")?;
    if !(0x2000_0000..=0x2008_2000).contains(&stack) || stack % 8 != 0 {
        return Err(format!(
            "the stack of the vector table begins at {stack:#010x}, not in the RAM"
        ));
    }
    let end = FLASH + flash.len() as u32;
    if reset & 1 == 0 || !(FLASH..end).contains(&reset) {
        return Err(format!(
            "the reset vector is {reset:#010x}, not an address of code in the flash"
        ));
    }
    let words: Vec<u32> = (0..BOOT_BYTES.min(flash.len()) / 4)
        .filter_map(|at| word(&flash, 4 * at))
        .collect();
    let block = words
        .windows(5)
        .find(|block| block[0] == BLOCK_START && block[1] == IMAGE)
        .ok_or("the first 4 KiB have no boot block: the boot ROM would not start the image")?;
    // One word of items, a loop of one block, and the end.
    if block[2] != 0x0000_01FF || block[3] != 0 || block[4] != BLOCK_END {
        return Err("the boot block is damaged".to_string());
    }
    Ok(flash)
}

/// The UF2 file of these contents of the flash.
pub fn file(flash: &[u8]) -> Vec<u8> {
    let count = flash.len().div_ceil(PAYLOAD);
    let mut file = Vec::with_capacity(512 * count);
    for (number, bytes) in flash.chunks(PAYLOAD).enumerate() {
        let mut block = [0; 512];
        let address = FLASH + (number * PAYLOAD) as u32;
        // Start, second start, "family is given", address, length, number, blocks, family.
        let head = [
            0x0A32_4655,
            0x9E5D_5157,
            0x2000,
            address,
            PAYLOAD as u32,
            number as u32,
            count as u32,
            FAMILY,
        ];
        for (at, word) in head.into_iter().enumerate() {
            block[4 * at..4 * at + 4].copy_from_slice(&word.to_le_bytes());
        }
        block[32..32 + PAYLOAD].fill(0xFF);
        block[32..32 + bytes.len()].copy_from_slice(bytes);
        block[508..].copy_from_slice(&0x0AB1_6F30_u32.to_le_bytes());
        file.extend_from_slice(&block);
    }
    file
}

#[cfg(test)]
mod tests {
    use super::{check, file};

    /// An ELF file with one load segment at the start of the flash.
    fn elf(flash: &[u8], address: u32) -> Vec<u8> {
        let mut elf = vec![0; 84];
        elf[28] = 52;
        elf[42] = 32;
        elf[44] = 1;
        let mut put = |at: usize, word: u32| elf[at..at + 4].copy_from_slice(&word.to_le_bytes());
        put(52, 1);
        put(56, 84);
        put(64, address);
        put(68, flash.len() as u32);
        elf.extend_from_slice(flash);
        elf
    }

    fn sound() -> Vec<u8> {
        let words = [
            0x2002_0000_u32,
            0x1000_0041,
            0xFFFF_DED3,
            0x1021_0142,
            0x0000_01FF,
            0,
            0xAB12_3579,
        ];
        let mut flash: Vec<u8> = words.into_iter().flat_map(u32::to_le_bytes).collect();
        flash.resize(700, 0x55);
        flash
    }

    #[test]
    fn a_sound_image_becomes_blocks_of_its_flash() {
        let flash = check(&elf(&sound(), 0x1000_0000)).unwrap();
        assert_eq!(flash, sound());
        let file = file(&flash);
        assert_eq!(file.len(), 3 * 512);
        let payload: Vec<u8> = file
            .chunks(512)
            .flat_map(|block| &block[32..288])
            .copied()
            .collect();
        assert_eq!(payload[..700], flash);
        assert!(payload[700..].iter().all(|byte| *byte == 0xFF));
        assert_eq!(file[512 + 12..512 + 16], 0x1000_0100_u32.to_le_bytes());
    }

    #[test]
    fn each_defect_of_the_memory_map_is_named() {
        let defects: [(usize, u8, &str); 4] = [
            (3, 0x30, "stack"),
            (7, 0x20, "reset vector"),
            (8, 0, "no boot block"),
            (24, 0, "damaged"),
        ];
        for (at, byte, problem) in defects {
            let mut flash = sound();
            flash[at] = byte;
            let error = check(&elf(&flash, 0x1000_0000)).unwrap_err();
            assert!(error.contains(problem), "{error}");
        }
        let error = check(&elf(&sound(), 0x2000_0000)).unwrap_err();
        assert!(error.contains("not in the flash"), "{error}");
    }
}
