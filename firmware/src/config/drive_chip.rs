//! Chip of a step drive that the board sets over a bus of its own.
//!
//! The controller only checks these settings and passes them on; boards know the chips.

use super::{Config, JointSettings};
use serde::{Deserialize, Serialize};

/// Settings of the chip of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DriveChip {
    /// What it is, which is also how the board reaches it. A machine has chips of one kind.
    pub kind: ChipKind,
    /// Its place at the bus, from 0: the address of a TMC2209, the position of a TMC5160 in the
    /// chain.
    pub place: u8,
    /// Microsteps of a full step, a power of two from 1 to 256.
    pub microsteps: u16,
    /// Current of the moving motor, mA rms.
    pub run_ma: u16,
    /// Current of the motor at standstill, mA rms; at most `run_ma`.
    pub hold_ma: u16,
    /// Sense resistors, mOhm.
    pub sense_mohm: u16,
}

/// Kinds of chips of step drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ChipKind {
    /// TMC2209, at a one-wire UART.
    Tmc2209,
    /// TMC5160, in a chain of such chips at an SPI.
    Tmc5160,
}

impl ChipKind {
    /// Number of places at the bus of a board.
    #[must_use]
    pub const fn places(self) -> u8 {
        match self {
            Self::Tmc2209 => 4,
            Self::Tmc5160 => 5,
        }
    }

    /// Resistance of the chip beside the sense resistor, mOhm.
    #[must_use]
    pub const fn internal_mohm(self) -> u16 {
        match self {
            Self::Tmc2209 => 20,
            Self::Tmc5160 => 0,
        }
    }

    /// Voltages over both resistances that the chip can regulate for a moving motor, uV rms. Those
    /// of a TMC2209 are from code 0 of its range of 180 mV to code 31 of that of 325 mV, those of a
    /// TMC5160 from scaler 32 to scaler 256 of 325 mV, at code 31.
    #[must_use]
    pub const fn microvolts(self) -> core::ops::RangeInclusive<u64> {
        match self {
            Self::Tmc2209 => 3_977..=229_810,
            Self::Tmc5160 => 28_727..=229_810,
        }
    }
}

impl DriveChip {
    /// Whether the chip can regulate the current of the moving motor.
    #[must_use]
    pub const fn has_current(&self) -> bool {
        let resistance = self.sense_mohm as u64 + self.kind.internal_mohm() as u64;
        let voltage = self.run_ma as u64 * resistance;
        let range = self.kind.microvolts();
        *range.start() <= voltage && voltage <= *range.end()
    }
}

impl Config {
    /// Whether the settings of a chip are within its range, and it has a place of its own. All
    /// chips are of one kind, and those of a chain are at its first places.
    pub(super) fn is_sound_chip(&self, chip: &DriveChip) -> bool {
        let chips = || self.joints.iter().filter_map(JointSettings::chip);
        let alone = chips().filter(|it| it.place == chip.place).count() == 1;
        let of_one_kind = chips().all(|it| it.kind == chip.kind);
        let places = match chip.kind {
            ChipKind::Tmc2209 => usize::from(chip.kind.places()),
            ChipKind::Tmc5160 => chips().count().min(usize::from(chip.kind.places())),
        };
        let microsteps = chip.microsteps.is_power_of_two() && chip.microsteps <= 256;
        let currents = chip.sense_mohm > 0 && chip.has_current() && chip.hold_ma <= chip.run_ma;
        usize::from(chip.place) < places && alone && of_one_kind && microsteps && currents
    }
}
