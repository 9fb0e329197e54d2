//! Contents of the flash from the file of an image: UF2, or ELF.

use haptimill_client::flash::uf2;

/// Start of the flash.
pub const FLASH: u32 = 0x1000_0000;
/// Largest flash that is accepted, bytes.
const MAX: usize = 16 << 20;

/// Family of the RP2350's Arm cores in UF2 files.
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
        _ if uf2::is_uf2(file) => {
            uf2::read(file, UF2_ARM).map_err(|what| format!("the file {what}"))?
        }
        Some(0x464C_457F) => elf(file).ok_or("the ELF file is cut off")?,
        _ => return Err("the file is neither a UF2 nor an ELF image".to_string()),
    };
    let mut flash = Vec::new();
    for (address, bytes) in pieces {
        let from = address.checked_sub(FLASH).map(|from| from as usize);
        let end = from.and_then(|from| from.checked_add(bytes.len()));
        let (Some(from), Some(end)) = (from, end.filter(|end| *end <= MAX)) else {
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

type Pieces<'a> = Vec<uf2::Piece<'a>>;

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
