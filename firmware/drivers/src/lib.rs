//! Drivers of the chips on a motion board, generic over embedded-hal 1.0.
//!
//! | module | chip | on the board |
//! | --- | --- | --- |
//! | [`tmc2209`] | Analog Devices (Trinamic) TMC2209 | step motor driver to 2 A, configured by a one-wire UART |
//! | [`tmc5160`] | Analog Devices (Trinamic) TMC5160 | step motor driver for external transistors, configured in a chain at an SPI |
//! | [`ad5644`] | Analog Devices AD5644R | four 14-bit outputs for torque drives, SPI |
//! | [`ads8688`] | Texas Instruments ADS8684, ADS8688 | 16-bit inputs of +-10.24 V for the force sensor, SPI |
//! | [`shift_register`] | 74HC165, 74HC595 | switches, alarms and chip selects on three SPI pins |
//! | [`spindle`] | none | spindle by PWM and a direction line, with a curve of duty over speed |
//! | [`thermistor`], [`supply`] | NTC resistor, voltage divider | temperature and supply from codes of a converter |
//! | [`input_filter`] | none | noise filter of digital inputs, with counters |
//!
//! These run when a board starts or in its main program, never in the control period: f32 is used
//! here, and micromath's functions are approximate (each use states its error, and a test checks
//! it). Bit positions and formulas are those of the data sheets of the chips. Only mocks of their
//! buses were tried, and models of the TMC2209 and the TMC5160, no chip.

#![no_std]

pub mod ad5644;
pub mod ads8688;
pub mod input_filter;
pub mod shift_register;
pub mod spindle;
pub mod supply;
pub mod thermistor;
pub mod tmc2209;
pub mod tmc5160;

use core::future::poll_fn;
use core::mem::replace;
use core::task::Poll;

/// Full microsteps of a full step, as both step motor drivers code them.
///
/// # Errors
/// [`MicrostepError`] unless the number is a power of two from 1 to 256.
pub(crate) const fn microstep_code(microsteps: u16) -> Result<u32, MicrostepError> {
    if microsteps == 0 || microsteps > 256 || !microsteps.is_power_of_two() {
        return Err(MicrostepError(microsteps));
    }
    Ok(8 - microsteps.trailing_zeros())
}

/// A number of microsteps that the chip does not have; it has powers of two from 1 to 256.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MicrostepError(pub u16);

/// Currents of a step motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Currents {
    /// While it moves, mA rms.
    pub run_ma: u16,
    /// While it stands, mA rms; at most `run_ma`.
    pub hold_ma: u16,
    /// Sense resistor, mOhm; on most modules 110 with a TMC2209, 75 with a TMC5160.
    pub sense_mohm: u16,
}

/// A current that the chip cannot set with this sense resistor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CurrentError {
    /// The current asked for, mA rms.
    pub wanted_ma: u16,
    /// The least and the largest current, mA rms.
    pub range_ma: (u16, u16),
}

/// Settings that a step motor driver does not have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SettingError {
    /// The current cannot be set.
    Current(CurrentError),
    /// The number of microsteps does not exist.
    Microsteps(MicrostepError),
}

/// Reason why a configured step motor driver does not drive its motor as commanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// It was reset since it was configured: its currents and microsteps are those of the factory.
    Reset,
    /// It switched the motor off because of its temperature.
    Overheated,
    /// A phase is shorted to ground or to the supply; it switched the motor off.
    Shorted,
    /// It switched the motor off, and its temperature and its phases are sound again.
    SwitchedOff,
    /// The supply is too low.
    Undervoltage,
}

impl Trouble {
    /// The trouble by the flags of GSTAT, which both drivers have, and by their states.
    pub(crate) fn of(flags: u32, is_overheated: bool, is_shorted: bool) -> Option<Self> {
        let found = [
            (flags & 1 != 0, Self::Reset),
            (is_overheated, Self::Overheated),
            (is_shorted, Self::Shorted),
            (flags >> 1 & 1 != 0, Self::SwitchedOff),
            (flags >> 2 & 1 != 0, Self::Undervoltage),
        ];
        let first = found.into_iter().find(|(is_so, _)| *is_so);
        first.map(|(_, trouble)| trouble)
    }
}

/// Returns to the caller of the future once.
pub async fn turn() {
    let mut was_here = false;
    poll_fn(|_| {
        if replace(&mut was_here, true) {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    })
    .await;
}
