//! An encoded message that waits to be sent.

use super::SendError;
use crate::frame::{MAX_PAYLOAD, Words};
use crate::wire;
use serde::Serialize;

/// An encoded message.
#[derive(Debug, Default)]
pub struct Payload {
    bytes: Words<MAX_PAYLOAD>,
    length: usize,
}

impl Payload {
    /// The encoded bytes.
    pub(super) fn bytes(&self) -> &[u8] {
        self.bytes.0.get(..self.length).unwrap_or_default()
    }

    /// Encodes a message, in place of the one before.
    pub(super) fn encode(&mut self, message: &impl Serialize) -> Result<(), SendError> {
        let length = wire::write(message, &mut self.bytes.0).unwrap_or(usize::MAX);
        if length > MAX_PAYLOAD {
            return Err(SendError::TooLong);
        }
        self.length = length;
        Ok(())
    }
}
