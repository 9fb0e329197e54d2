//! Drivers of the chips on a motion board, generic over embedded-hal 1.0.
//!
//! | module | chip | on the board |
//! | --- | --- | --- |
//! | [`tmc2209`] | Analog Devices (Trinamic) TMC2209 | step motor driver to 2 A, configured by a one-wire UART |
//! | [`tmc5160`] | Analog Devices (Trinamic) TMC5160 | step motor driver for external transistors, configured by SPI |
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
//! buses were tried, and a model of the TMC2209, no chip.

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

/// A current that the chip cannot set with this sense resistor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CurrentError {
    /// The current asked for, mA rms.
    pub wanted_ma: u16,
    /// The least and the largest current, mA rms.
    pub range_ma: (u16, u16),
}
