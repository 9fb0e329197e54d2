//! An emulated chip with its pins.

use crate::flash::Flash;
use crate::usb_host::UsbHost;
use rp2350_emu::peripherals::usb::UsbCtrl;
use rp2350_emu::{Config, Emulator, EmulatorBuilder};
use std::sync::atomic::Ordering::Relaxed;

/// Address of the flash.
const FLASH: u32 = 0x1000_0000;

/// DIRECT_CSR of the QMI, and its value after a reset.
const DIRECT_CSR: u32 = 0x400D_0000;
const CSR_AFTER_RESET: u32 = 6 << 22;

/// Clock of the chip once its image has set it, Hz.
pub const CLOCK_HZ: u64 = 150_000_000;

/// The first UART.
const UART0: u32 = 0x4007_0000;

/// Register of the devices that are in reset, and the bit of the USB controller.
const RESETS: u32 = 0x4002_0000;
const USB_RESET: u32 = 1 << 28;

/// A chip that runs an image.
pub struct Chip {
    emulator: Emulator,
    /// Cycles before the last reset of the chip.
    before: u64,
    /// Resets by the watchdog.
    resets: u32,
    /// Pins that are driven from outside, and their levels.
    driven: (u32, u32),
    /// The flash at the QMI.
    flash: Flash,
    /// The host on the USB.
    pub usb_host: UsbHost,
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
        let mut chip = Self {
            emulator,
            before: 0,
            resets: 0,
            driven: (0, 0),
            flash: Flash::new(flash),
            usb_host: UsbHost::default(),
        };
        chip.reset();
        Ok(chip)
    }

    /// Starts the image as the boot ROM does: at the vector table in the flash.
    fn reset(&mut self) {
        self.before = self.cycles();
        self.emulator.reset();
        let [stack, entry] = [0, 4].map(|at| self.emulator.peek(FLASH + at));
        for core in 0..2 {
            let core = self.emulator.core_mut(core);
            core.regs.msp = stack;
            core.regs.r[13] = stack;
            core.regs.set_pc(entry & !1);
            core.ppb.vtor = FLASH;
        }
        self.set_register(DIRECT_CSR, CSR_AFTER_RESET);
        self.emulator.bus.qmi_writes.clear();
        self.emulator.bus.qmi_received.clear();
        self.flash.reset_of_processor();
        // The second core waits.
        self.emulator.bus.atomics.set_halted(1);
        let (pins, levels) = self.driven;
        self.drive(pins, levels);
    }

    /// Drives pins from outside: one bit each.
    pub fn drive(&mut self, pins: u32, levels: u32) {
        self.driven = (pins, levels);
        self.emulator.bus.gpio_external_mask = pins;
        self.emulator.bus.gpio_external_in.store(levels, Relaxed);
    }

    /// Runs a quantum, one cycle in [`Chip::new`]; returns the levels of all pins.
    ///
    /// # Errors
    /// The emulator cannot go on.
    pub fn cycle(&mut self) -> Result<u32, String> {
        self.emulator.step().map_err(|error| error.to_string())?;
        if self.emulator.bus.watchdog_reset_requested() {
            self.reset();
            self.resets += 1;
        }
        let now = self.cycles();
        if !self.emulator.bus.qmi_writes.is_empty() {
            self.serve_flash(now);
        }
        if self.flash.is_direct() && self.address() >> 24 == FLASH >> 24 {
            let at = self.address();
            return Err(format!(
                "code of the flash at {at:#010x} in the direct mode"
            ));
        }
        if now >= self.usb_host.due() {
            let host = &mut self.usb_host;
            self.emulator
                .bus
                .with_usb(|device| host.serve(device, now))?;
        }
        Ok(self.emulator.bus.gpio_in.load(Relaxed))
    }

    /// Carries out what the image wrote to the QMI.
    fn serve_flash(&mut self, now: u64) {
        let bus = &mut self.emulator.bus;
        while self.flash.is_free(now)
            && let Some((register, value)) = bus.qmi_writes.pop_front()
        {
            if register == 0 {
                self.flash.control(value, now);
            } else {
                bus.qmi_received.extend(self.flash.exchange(value, now));
            }
        }
    }

    /// The flash.
    pub fn flash(&mut self) -> &mut Flash {
        let now = self.cycles();
        self.flash.finish(now);
        &mut self.flash
    }

    /// Resets by the watchdog.
    #[must_use]
    pub const fn resets(&self) -> u32 {
        self.resets
    }

    /// Words of buffers that the image gave to the USB controller wrongly: it may see the bits of
    /// before.
    pub fn wrong_usb_writes(&mut self) -> u32 {
        self.emulator
            .bus
            .with_usb(|device| device.concurrent_writes)
    }

    /// The device at the USB, for a test that is the host.
    pub fn usb<R>(&mut self, act: impl FnOnce(&mut UsbCtrl) -> R) -> R {
        self.emulator.bus.with_usb(act)
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

    /// Replaces an instruction in the RAM.
    pub fn set_code(&mut self, address: u32, value: u32) {
        self.emulator.poke(address, value);
        self.emulator.bus.invalidate_all();
    }

    /// A register of the first core.
    #[must_use]
    pub fn core_register(&self, number: usize) -> u32 {
        self.emulator.core(0).regs.r[number]
    }

    /// The image uses the USB, and not the UART.
    pub fn uses_usb(&mut self) -> bool {
        self.register(RESETS) & USB_RESET == 0
    }

    /// Gives the line of the image bytes, which arrive at its rate.
    pub fn receive(&mut self, bytes: &[u8]) {
        match self.uses_usb() {
            true => self.usb_host.send(bytes),
            false => self.emulator.bus.uart[0].rx_line.extend(bytes),
        }
    }

    /// The device of the line has all bytes that it was given.
    pub fn has_received(&mut self) -> bool {
        match self.uses_usb() {
            true => self.usb_host.is_sent(),
            false => self.emulator.bus.uart[0].rx_line.is_empty(),
        }
    }

    /// Cycles of a bit of UART0, by the divider that the image has set; `None` while it has none.
    pub fn uart_bit(&mut self) -> Option<u64> {
        let whole = self.register(UART0 + 0x24);
        let fraction = self.register(UART0 + 0x28);
        let sixteenth = u64::from(whole) * 64 + u64::from(fraction);
        (sixteenth != 0).then_some(sixteenth / 4)
    }

    /// Takes the bytes that UART0 has sent.
    pub fn take_uart_bytes(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.emulator.bus.uart[0].tx_log)
    }

    /// UART0 has sent bytes that were not taken.
    #[must_use]
    pub fn has_uart_bytes(&self) -> bool {
        !self.emulator.bus.uart[0].tx_log.is_empty()
    }

    /// Gives UART0 bytes, which arrive at its rate.
    pub fn give_uart_bytes(&mut self, bytes: &[u8]) {
        self.emulator.bus.uart[0].rx_line.extend(bytes);
    }

    /// Takes the bytes that left on the line of the image.
    pub fn take_sent(&mut self) -> Vec<u8> {
        match self.uses_usb() {
            true => self.usb_host.take(),
            false => std::mem::take(&mut self.emulator.bus.uart[0].tx_log),
        }
    }

    /// Cycles since the start.
    #[must_use]
    pub fn cycles(&self) -> u64 {
        self.before + self.emulator.cycles()
    }

    /// Address of the next instruction of the first core.
    #[must_use]
    pub fn address(&self) -> u32 {
        self.emulator.core(0).regs.pc()
    }
}
