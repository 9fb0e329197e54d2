//! Why a chip was reset, from what its watchdog keeps over a reset.

/// Mark that a program leaves while its watchdog runs: "HMrn".
pub const RUNNING: u32 = 0x6E72_4D48;
/// Mark of a cause that the program left: "HMil".
pub const ENDED: u32 = 0x6C69_4D48;

/// Why the chip was reset; its value is the number of flashes of a lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Cause {
    /// Power, the reset pin, or the boot loader after it took a new image.
    Power = 1,
    /// No control period was completed in time.
    Watchdog = 2,
    /// A panic.
    Panic = 3,
    /// A processor fault, or an interrupt without a handler.
    Fault = 4,
}

impl Cause {
    /// The cause by the mark and the cause that were kept, and by whether the watchdog made the
    /// reset. A boot loader restarts the chip by the watchdog, too: a reset by the watchdog is one
    /// of the program only with its mark.
    #[must_use]
    pub const fn of(mark: u32, kept: u32, by_watchdog: bool) -> Self {
        match (mark, kept) {
            (ENDED, 3) => Self::Panic,
            (ENDED, 4) => Self::Fault,
            (RUNNING, _) if by_watchdog => Self::Watchdog,
            _ => Self::Power,
        }
    }
}
