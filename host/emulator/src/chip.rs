//! An emulated chip with its pins.

use rp2350_emu::{Config, Emulator, EmulatorBuilder};
use std::sync::atomic::Ordering::Relaxed;

/// Address of the flash.
const FLASH: u32 = 0x1000_0000;

/// Clock of the chip once its image has set it, Hz.
pub const CLOCK_HZ: u64 = 150_000_000;

/// A chip that runs an image.
pub struct Chip {
    emulator: Emulator,
}

impl Chip {
    /// A chip with these contents of the flash, at its vector table: the boot ROM is not emulated.
    ///
    /// # Errors
    /// The emulator cannot be built.
    pub fn new(flash: &[u8]) -> Result<Self, String> {
        Self::with_quantum(flash, 1)
    }

    /// As [`Chip::new`]; cores and devices take turns after this number of cycles. Edges within it
    /// are lost, and the times of all others are rounded up to its end.
    ///
    /// # Errors
    /// The emulator cannot be built.
    pub fn with_quantum(flash: &[u8], cycles: u32) -> Result<Self, String> {
        let mut emulator = EmulatorBuilder::new(Config::default())
            .step_quantum(cycles)
            .build()
            .map_err(|error| error.to_string())?;
        emulator.load_flash(flash);
        emulator.reset();
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|byte| flash[at + byte]));
        for core in 0..2 {
            let core = emulator.core_mut(core);
            core.regs.msp = word(0);
            core.regs.r[13] = word(0);
            core.regs.set_pc(word(4) & !1);
            core.ppb.vtor = FLASH;
        }
        // The second core waits.
        emulator.bus.atomics.set_halted(1);
        Ok(Self { emulator })
    }

    /// Drives pins from outside: one bit each.
    pub fn drive(&mut self, pins: u32, levels: u32) {
        self.emulator.bus.gpio_external_mask = pins;
        self.emulator.bus.gpio_external_in.store(levels, Relaxed);
    }

    /// Runs a quantum, one cycle in [`Chip::new`]; returns the levels of all pins.
    ///
    /// # Errors
    /// The emulator cannot go on.
    pub fn cycle(&mut self) -> Result<u32, String> {
        self.emulator.step().map_err(|error| error.to_string())?;
        Ok(self.emulator.bus.gpio_in.load(Relaxed))
    }

    /// Reads a register of a device.
    pub fn register(&mut self, address: u32) -> u32 {
        self.emulator.mmio_read32(address)
    }

    /// Writes a register of a device.
    pub fn set_register(&mut self, address: u32, value: u32) {
        self.emulator.mmio_write32(address, value);
    }

    /// Reads a word of the RAM.
    #[must_use]
    pub fn memory(&mut self, address: u32) -> u32 {
        self.emulator.peek(address)
    }

    /// Writes a word of the RAM.
    pub fn set_memory(&mut self, address: u32, value: u32) {
        self.emulator.poke(address, value);
    }

    /// A register of the first core.
    #[must_use]
    pub fn core_register(&self, number: usize) -> u32 {
        self.emulator.core(0).regs.r[number]
    }

    /// Gives the line of UART0 bytes, which arrive at its rate.
    pub fn receive(&mut self, bytes: &[u8]) {
        self.emulator.bus.uart[0].rx_line.extend(bytes);
    }

    /// Takes the bytes that left on the line of UART0.
    pub fn take_sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.emulator.bus.uart[0].tx_log)
    }

    /// Cycles since the start.
    #[must_use]
    pub fn cycles(&self) -> u64 {
        self.emulator.cycles()
    }

    /// Address of the next instruction of the first core.
    #[must_use]
    pub fn address(&self) -> u32 {
        self.emulator.core(0).regs.pc()
    }
}
