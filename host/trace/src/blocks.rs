//! Blocks of a recording: kind, length and check.

use super::CRC;

/// Size of the head of a block.
pub(super) const HEAD_BYTES: usize = 20;

/// Content of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Records,
    Periods,
    Events,
    End,
}

const TAGS: [(Kind, &[u8; 4]); 4] = [
    (Kind::Records, b"RECS"),
    (Kind::Periods, b"PERI"),
    (Kind::Events, b"EVNT"),
    (Kind::End, b"DONE"),
];

/// Head of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) kind: Kind,
    /// Bytes of the content.
    pub(super) bytes: u32,
    /// Number of records, periods or events.
    pub(super) count: u32,
    /// CRC-32 of the content.
    pub(super) crc: u32,
}

impl Head {
    pub(super) fn of(kind: Kind, count: u32, contents: &[u8]) -> Self {
        Self {
            kind,
            bytes: contents.len() as u32,
            count,
            crc: CRC.checksum(contents),
        }
    }

    pub(super) fn encode(&self) -> [u8; HEAD_BYTES] {
        let mut bytes = [0; HEAD_BYTES];
        let tag = TAGS.iter().find(|(kind, _)| *kind == self.kind);
        if let Some((_, tag)) = tag {
            bytes[..4].copy_from_slice(*tag);
        }
        bytes[4..8].copy_from_slice(&self.bytes.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.count.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.crc.to_le_bytes());
        let check = CRC.checksum(&bytes[..16]);
        bytes[16..].copy_from_slice(&check.to_le_bytes());
        bytes
    }

    /// Decodes a head; `None` if its check fails or its count does not fit the size of a record.
    pub(super) fn decode(bytes: &[u8; HEAD_BYTES], record_bytes: usize) -> Option<Self> {
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let (kind, _) = TAGS.iter().find(|(_, tag)| bytes[..4] == tag[..])?;
        let head = Self {
            kind: *kind,
            bytes: word(4),
            count: word(8),
            crc: word(12),
        };
        let sound = CRC.checksum(&bytes[..16]) == word(16)
            && match kind {
                Kind::Records => {
                    u64::from(head.bytes) == u64::from(head.count) * record_bytes as u64
                }
                // Each has at least one byte.
                Kind::Periods | Kind::Events => head.count <= head.bytes,
                Kind::End => head.bytes == 0,
            };
        sound.then_some(head)
    }
}
