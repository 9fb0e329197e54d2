//! UF2 files, which boot ROMs with mass storage take: blocks of 512 bytes with an address each.

/// Words of a block: start, second start, end.
const START: u32 = 0x0A32_4655;
const SECOND: u32 = 0x9E5D_5157;
const END: u32 = 0x0AB1_6F30;
/// Flag: the family of the chip is given.
const HAS_FAMILY: u32 = 0x2000;
/// Bytes of a block, and the most that it carries.
const BLOCK: usize = 512;
const PAYLOAD: usize = 476;

/// Contents at an address.
pub type Piece<'a> = (u32, &'a [u8]);

/// Whether a file begins as UF2 files do.
#[must_use]
pub fn is_uf2(file: &[u8]) -> bool {
    file.starts_with(&START.to_le_bytes())
}

/// The contents of a UF2 file for a family of chips, in its order.
///
/// # Errors
/// The file is no UF2 file, is damaged, incomplete, or for another chip; the message names the
/// block.
pub fn read(file: &[u8], family: u32) -> Result<Vec<Piece<'_>>, String> {
    if !is_uf2(file) {
        return Err("is no UF2 file".to_string());
    }
    if !file.len().is_multiple_of(BLOCK) {
        return Err(format!(
            "is truncated: {} bytes are not a whole number of blocks of {BLOCK}",
            file.len()
        ));
    }
    let blocks = file.len() / BLOCK;
    file.chunks(BLOCK)
        .enumerate()
        .map(|(number, block)| {
            let field = |at: usize| {
                u32::from_le_bytes([block[at], block[at + 1], block[at + 2], block[at + 3]])
            };
            let length = field(16) as usize;
            let sound = (field(0), field(4), field(508)) == (START, SECOND, END);
            if !sound || length > PAYLOAD || field(20) as usize != number {
                return Err(format!("is damaged: block {number}"));
            }
            if field(24) as usize != blocks {
                return Err(format!(
                    "is incomplete: it has {blocks} of {} blocks",
                    field(24)
                ));
            }
            if field(8) & HAS_FAMILY == 0 || field(28) != family {
                return Err(format!(
                    "is for another chip: block {number} has the family {:#010x}, not {family:#010x}",
                    field(28)
                ));
            }
            Ok((field(12), &block[32..32 + length]))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::read;

    const FAMILY: u32 = 0xE48B_FF59;

    /// A file of two blocks.
    fn file() -> Vec<u8> {
        let mut file = Vec::new();
        for number in 0..2_u32 {
            let mut block = [0xFF; 512];
            let words = [
                super::START,
                super::SECOND,
                super::HAS_FAMILY,
                0x1000_0000 + 256 * number,
                256,
                number,
                2,
                FAMILY,
            ];
            for (at, word) in words.into_iter().enumerate() {
                block[4 * at..4 * at + 4].copy_from_slice(&word.to_le_bytes());
            }
            block[32..288].fill(number as u8 + 1);
            block[508..].copy_from_slice(&super::END.to_le_bytes());
            file.extend(block);
        }
        file
    }

    #[test]
    fn the_blocks_are_read_in_order() {
        let file = file();
        let pieces = read(&file, FAMILY).unwrap();
        assert_eq!(pieces[0], (0x1000_0000, &[1; 256][..]));
        assert_eq!(pieces[1], (0x1000_0100, &[2; 256][..]));
        assert_eq!(pieces.len(), 2);
    }

    #[test]
    fn each_defect_is_named() {
        let damaged = |at: usize, byte: u8| {
            let mut file = file();
            file[at] = byte;
            read(&file, FAMILY).unwrap_err()
        };
        assert!(damaged(0, 0).contains("no UF2 file"));
        assert!(damaged(512, 0).contains("damaged: block 1"));
        assert!(damaged(512 + 508, 0).contains("damaged: block 1"));
        assert!(damaged(512 + 20, 7).contains("damaged: block 1"));
        assert!(damaged(17, 9).contains("damaged: block 0"));
        assert!(damaged(28, 0).contains("another chip: block 0"));
        let cut = &file()[..512];
        assert!(read(cut, FAMILY).unwrap_err().contains("1 of 2 blocks"));
        let cut = &file()[..700];
        assert!(read(cut, FAMILY).unwrap_err().contains("truncated"));
        assert!(read(&[], FAMILY).unwrap_err().contains("no UF2 file"));
    }
}
