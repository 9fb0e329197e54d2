//! Contents of the flash from the file of an image: UF2, or ELF.

/// Start of the flash.
pub const FLASH: u32 = 0x1000_0000;
/// Largest flash that is accepted, bytes.
const MOST: usize = 16 << 20;

/// Words of a UF2 block: start, second start, end; and the family of the RP2350's Arm cores.
const UF2_START: u32 = 0x0A32_4655;
const UF2_SECOND: u32 = 0x9E5D_5157;
const UF2_END: u32 = 0x0AB1_6F30;
const UF2_ARM: u32 = 0xE48B_FF59;

/// Little-endian word at an offset.
fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn half(bytes: &[u8], at: usize) -> Option<usize> {
    Some(usize::from(u16::from_le_bytes(
        bytes.get(at..at + 2)?.try_into().ok()?,
    )))
}

/// Contents of the flash; bytes that the file does not have are erased (0xFF).
///
/// # Errors
/// The file is neither UF2 nor ELF, or has contents outside of the flash.
pub fn flash(file: &[u8]) -> Result<Vec<u8>, String> {
    let pieces = match word(file, 0) {
        Some(UF2_START) => uf2(file)?,
        Some(0x464C_457F) => elf(file).ok_or("the ELF file is cut off")?,
        _ => return Err("the file is neither a UF2 nor an ELF image".to_string()),
    };
    let mut flash = Vec::new();
    for (address, bytes) in pieces {
        let from = address.checked_sub(FLASH).map(|from| from as usize);
        let end = from.and_then(|from| from.checked_add(bytes.len()));
        let (Some(from), Some(end)) = (from, end.filter(|end| *end <= MOST)) else {
            return Err(format!(
                "the image has contents at {address:#x}, outside of the flash"
            ));
        };
        if flash.len() < end {
            flash.resize(end, 0xFF);
        }
        flash[from..end].copy_from_slice(bytes);
    }
    if flash.len() < 8 {
        return Err("the image has no vector table".to_string());
    }
    Ok(flash)
}

type Pieces<'a> = Vec<(u32, &'a [u8])>;

fn uf2(file: &[u8]) -> Result<Pieces<'_>, String> {
    if !file.len().is_multiple_of(512) {
        return Err("the UF2 file is cut off".to_string());
    }
    file.chunks(512)
        .enumerate()
        .map(|(number, block)| {
            let field = |at| word(block, at).unwrap_or_default();
            let length = field(16) as usize;
            let sound = (field(0), field(4), field(508)) == (UF2_START, UF2_SECOND, UF2_END);
            if !sound || length > 476 || field(20) as usize != number {
                return Err(format!("block {number} of the UF2 file is damaged"));
            }
            if field(28) != UF2_ARM {
                return Err(format!(
                    "block {number} of the UF2 file is for another chip"
                ));
            }
            Ok((field(12), &block[32..32 + length]))
        })
        .collect()
}

fn elf(file: &[u8]) -> Option<Pieces<'_>> {
    let (table, size, count) = (word(file, 28)? as usize, half(file, 42)?, half(file, 44)?);
    let mut pieces = Vec::new();
    for index in 0..count {
        let at = table + index * size;
        let (kind, offset) = (word(file, at)?, word(file, at + 4)? as usize);
        let (address, length) = (word(file, at + 12)?, word(file, at + 16)? as usize);
        if kind == 1 && length > 0 {
            pieces.push((address, file.get(offset..offset + length)?));
        }
    }
    Some(pieces)
}
