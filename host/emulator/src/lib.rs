//! Runs images of boards with an RP2350 in an emulator, cycle by cycle, with their pins.
//!
//! The emulator is `rp2350-emu` with the repairs of `patches/`. `tests/` has their tests, but none
//! for the D registers of the FPU. It does not show misses of the flash cache, the two cycles of
//! the input synchronisers of the PIO, and contention on the bus. Times of code are lower bounds;
//! times of pulses do not depend on code. It does not model pads and functions of pins, but for
//! that of the SPIs: another pin that an image forgot to assign works here. Of the USB it models
//! the device controller by transactions (patch of `peripherals/usb.rs`), and a host
//! ([`usb_host`]); not the wire and its errors.

pub mod chain;
pub mod checks;
pub mod chip;
pub mod drive_chips;
pub mod encoders;
pub mod flash;
pub mod image;
pub mod pico2;
pub mod rtt;
pub mod signals;
pub mod usb_host;
