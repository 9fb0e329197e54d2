//! Board support for the emulated MPS2: registers, interrupts, and the link to the simulated
//! machine.
//!
//! QEMU's machines `mps2-an386` (Cortex-M4F) and `mps2-an500` (Cortex-M7) run the same image. The
//! host is connected to UART0, as on any board. The machine is at the other end of two named pipes,
//! which semihosting reads and writes ([`haptimill_firmware::pil`] documents the data). All memory
//! accesses and instructions that need `unsafe` are in this crate and in `haptimill_board_cortex`.
//!
//! | image | feature | content |
//! | --- | --- | --- |
//! | `haptimill-mps2` | | the product |
//! | `faults` | `faults` | the same with fault injection: [`faults`] |
//! | `logging` | `defmt` | the same with logging over UART2: [`log`] |
//! | `checks` | `checks` | the checks of `haptimill-checks`, on the chip |
//!
//! Semihosting lets an image open any file of the user who runs it. Callers must run only images
//! that they built themselves.
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
