//! State of the controller.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// State of the controller.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// Drives off.
    #[default]
    Disabled,
    /// Drives on, no motion.
    Idle,
    /// Homing: search for the references.
    Homing,
    /// A job runs (also while it waits for late setpoints).
    Run,
    /// A jog moves or decelerates the machine.
    Jog,
    /// A job waits, or decelerates to wait.
    Hold,
    /// A fault is latched; drives off or holding, see [`Fault`].
    ///
    /// [`Fault`]: super::Fault
    Fault,
    /// Emergency stop is latched; drives off.
    EmergencyStop,
}

impl State {
    /// All states in order. Recorders and links number a state by its index here.
    pub const ALL: [Self; 8] = [
        Self::Disabled,
        Self::Idle,
        Self::Homing,
        Self::Run,
        Self::Jog,
        Self::Hold,
        Self::Fault,
        Self::EmergencyStop,
    ];

    /// Whether the drives are off. In a fault they may be off, too: that depends on the fault.
    #[must_use]
    pub const fn has_drives_off(self) -> bool {
        matches!(self, Self::Disabled | Self::EmergencyStop)
    }

    /// Returns the index in [`State::ALL`].
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }
}
