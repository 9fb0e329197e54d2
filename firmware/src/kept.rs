//! The configuration that a board keeps without a supply: its bytes behind a mark of their format.

use crate::comm::server::CONFIG_BYTES;
use haptimill_protocol::schema::schema_hash;

/// Bytes of the mark.
const PREFIX: usize = 8;

/// Largest number of bytes to be kept.
pub const MAX_BYTES: usize = PREFIX + CONFIG_BYTES;

/// The mark: the hash of all messages, which has the version of the protocol. Two images with the
/// same hash read a configuration alike.
#[must_use]
pub const fn prefix() -> [u8; PREFIX] {
    schema_hash().to_le_bytes()
}

/// The configuration behind the mark; `None` if another image kept it.
#[must_use]
pub fn configuration(kept: &[u8]) -> Option<&[u8]> {
    kept.strip_prefix(&prefix())
}
