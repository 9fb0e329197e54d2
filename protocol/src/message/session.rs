//! Start of a session: the host's hello and the controller's welcome.

use super::Refusal;
use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// First message of a session, from the host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// The host's [`PROTOCOL_VERSION`].
    ///
    /// [`PROTOCOL_VERSION`]: super::PROTOCOL_VERSION
    pub version: u16,
    /// The host's [`schema_hash`](crate::schema::schema_hash).
    pub schema: u64,
    /// Session number, chosen by the host, different for each session. Frames of another session
    /// are ignored.
    pub session: u32,
}

/// The controller's answer to [`Hello`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Welcome {
    /// The controller's [`PROTOCOL_VERSION`].
    ///
    /// [`PROTOCOL_VERSION`]: super::PROTOCOL_VERSION
    pub version: u16,
    /// The controller's [`schema_hash`](crate::schema::schema_hash).
    pub schema: u64,
    /// Session number of the [`Hello`].
    pub session: u32,
    /// Why the session is refused, if it is.
    pub refused: Option<HelloRefusal>,
    /// Name of the machine in the active configuration; empty when there is none.
    pub machine: String<24>,
    /// CRC-32 of the active configuration as sent by [`Command::Configure`]; 0 when there is none.
    ///
    /// [`Command::Configure`]: super::Command::Configure
    pub config_crc: u32,
    /// Length of the control period in microseconds.
    pub period_us: u16,
    /// Pose coordinates of the machine; 0 when not configured.
    pub axes: u8,
    /// Setpoints that the queue holds.
    pub queue: u16,
    /// What the board keeps without a supply.
    pub kept: Kept,
}

/// Configuration that a board keeps without a supply, and activates after a reset.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kept {
    /// The board keeps none.
    #[default]
    Unsupported,
    /// There is none, or only damaged ones.
    Nothing,
    /// CRC-32 of the configuration, as in [`Welcome::config_crc`].
    Config(u32),
    /// An image with other messages kept one. It is ignored.
    OtherVersion,
    /// The controller refuses it. It is ignored.
    Refused(Refusal),
}

/// Reason why a session is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HelloRefusal {
    /// Another session is alive and the machine moves or may move.
    Busy,
    /// Versions differ.
    Version,
    /// Versions agree and the message schemas do not.
    Schema,
}
