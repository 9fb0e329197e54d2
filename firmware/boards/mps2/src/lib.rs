//! The MPS2 board under emulation: its registers, its interrupts, its link to the simulated machine.
//!
//! QEMU's machines `mps2-an386` (Cortex-M4F) and `mps2-an500` (Cortex-M7) run the same image. The host talks to UART0, as it would to
//! any board; the machine is at the other end of two named pipes, which semihosting reads and writes ([`haptimill_firmware::pil`] says what
//! goes over them). Memory accesses and instructions that the compiler cannot vouch for stand in this crate and nowhere else.
//!
//! | image | feature | what it is |
//! | --- | --- | --- |
//! | `haptimill-mps2` | | the product |
//! | `faults` | `faults` | the same, and something goes wrong in it: [`faults`] |
//! | `logging` | `defmt` | the same, and it logs over UART2: [`log`] |
//! | `checks` | `checks` | the checks of `haptimill-checks`, on the chip |
//!
//! Misuse: semihosting lets an image open any file of the user who runs it; run only your own.
#![no_std]

mod copy;
pub mod counter;
pub mod ending;
#[cfg(feature = "faults")]
pub mod faults;
#[cfg(feature = "defmt")]
pub mod log;
mod registers;
pub mod semihosting;
pub mod serial;
pub mod serve;
pub mod stack;
pub mod tick;
pub mod wiring;
