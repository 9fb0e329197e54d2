//! Line to the host: a serial port on the USB (class CDC ACM).
//!
//! The main loop serves it, which every handler interrupts: it takes no time of a control period,
//! and a byte that arrives between two periods is there for the next one. While no host takes the
//! bytes of the controller they are dropped, as a serial line without a listener drops them: a host
//! that opens the port later does not get old frames.

use crate::chips::{self, Keeper};
use crate::clocks::{CYCLES_PER_US, cycles};
use crate::ending::Lamp;
use crate::link::Wire;
use crate::registers::read;
use crate::storage;
use crate::usb_bus::{Bus, PACKET};
use core::pin::pin;
use core::task::{Context, Waker};
use usb_device::LangID;
use usb_device::bus::UsbBusAllocator;
use usb_device::device::{StringDescriptors, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usbd_serial::{CdcAcmClass, USB_CLASS_CDC};

/// Vendor and product: those that Raspberry Pi keeps for serial ports of its chips. The names below
/// tell this device from others.
const IDS: UsbVidPid = UsbVidPid(0x2E8A, 0x0009);
/// Names that the host shows.
const MANUFACTURER: &str = "Haptimill";
const PRODUCT: &str = if cfg!(feature = "encoders") {
    "Haptimill encoder Pico 2"
} else if cfg!(feature = "spi") {
    "Haptimill SPI Pico 2"
} else {
    "Haptimill Pico 2"
};
/// Most current from the bus, mA. The drives have a supply of their own.
const CURRENT_MA: usize = 100;

/// Memory that is programmed once; its first eight bytes are the number of the chip.
const OTP_DATA: usize = 0x4013_0000;

/// Bytes of a packet to the host. A packet of the largest size would not end a transfer.
const MAX: usize = PACKET - 1;

/// Time for which a packet waits for the host. Then the bytes behind it are dropped.
const PATIENCE: u32 = 100_000 * CYCLES_PER_US;

/// The part of the line that SysTick serves: none.
pub struct InPeriod;

/// The part of the line that is served between the control periods.
pub struct Between(Wire);

/// Splits the line. [`Between::serve`] starts it.
pub const fn start(wire: Wire) -> (InPeriod, Between) {
    (InPeriod, Between(wire))
}

impl InPeriod {
    /// SysTick has nothing to do.
    pub const fn exchange(&mut self) {}
}

/// Number of the chip, 16 hexadecimal digits.
fn chip_number() -> [u8; 16] {
    let mut digits = [0; 16];
    for (half, at) in digits.chunks_exact_mut(8).zip([4, 0]) {
        let word = read(OTP_DATA, at);
        for (place, digit) in half.iter_mut().enumerate() {
            let four = (word >> (28 - 4 * place) & 0xF) as u8;
            *digit = if four < 10 {
                b'0' + four
            } else {
                b'A' - 10 + four
            };
        }
    }
    digits
}

impl Between {
    /// Serves the USB, the LED and the chips of the drives for ever.
    pub fn serve(self, mut lamp: Lamp, keeper: Keeper) -> ! {
        let mut wire = self.0;
        let number = chip_number();
        let names = StringDescriptors::new(LangID::EN_US)
            .manufacturer(MANUFACTURER)
            .product(PRODUCT)
            .serial_number(core::str::from_utf8(&number).unwrap_or_default());
        let bus = UsbBusAllocator::new(Bus::new());
        let mut port = CdcAcmClass::new(&bus, PACKET as u16);
        let device = UsbDeviceBuilder::new(&bus, IDS)
            .device_class(USB_CLASS_CDC)
            .max_packet_size_0(PACKET as u8)
            .and_then(|builder| builder.max_power(CURRENT_MA))
            .and_then(|builder| builder.strings(&[names]));
        // The values above are constants within the limits of the builder.
        let Ok(builder) = device else {
            panic!("the USB device cannot be described")
        };
        let mut device = builder.build();
        let mut packet = Packet {
            bytes: [0; MAX],
            count: 0,
            since: cycles(),
        };
        let mut chips = pin!(chips::serve(keeper));
        // The loop polls it again at once: nothing has to wake it.
        let mut context = Context::from_waker(Waker::noop());
        #[cfg(feature = "log")]
        let mut was_configured = false;
        let mut turn = || {
            lamp.update();
            let _ = chips.as_mut().poll(&mut context);
            device.poll(&mut [&mut port]);
            let is_configured = device.state() == UsbDeviceState::Configured;
            #[cfg(feature = "log")]
            if core::mem::replace(&mut was_configured, is_configured) != is_configured {
                defmt::info!(
                    "USB: {}",
                    if is_configured {
                        "connected"
                    } else {
                        "disconnected"
                    }
                );
            }
            if is_configured {
                receive(&mut port, &mut wire);
                packet.send(&mut port, &mut wire);
            } else {
                packet.drop_all(&mut wire);
            }
        };
        loop {
            turn();
            storage::serve(&mut turn);
        }
    }
}

/// Takes a packet that has arrived.
fn receive(port: &mut CdcAcmClass<'_, Bus>, wire: &mut Wire) {
    let mut bytes = [0; PACKET];
    if let Ok(count) = port.read_packet(&mut bytes) {
        for &byte in &bytes[..count] {
            wire.receiver.push(byte);
        }
    }
}

/// The next packet to the host.
struct Packet {
    bytes: [u8; MAX],
    count: usize,
    /// Cycle at which it was filled.
    since: u32,
}

impl Packet {
    /// Sends the bytes that wait, as soon as the host has taken those before.
    fn send(&mut self, port: &mut CdcAcmClass<'_, Bus>, wire: &mut Wire) {
        if self.count == 0 {
            self.since = cycles();
            while self.count < MAX
                && let Some(byte) = wire.outgoing.dequeue()
            {
                self.bytes[self.count] = byte;
                self.count += 1;
            }
        }
        if self.count == 0 {
            return;
        }
        if port.write_packet(&self.bytes[..self.count]).is_ok() {
            self.count = 0;
        } else if cycles().wrapping_sub(self.since) >= PATIENCE {
            self.drop_all(wire);
        }
    }

    /// No host takes the bytes.
    fn drop_all(&mut self, wire: &mut Wire) {
        self.count = 0;
        while wire.outgoing.dequeue().is_some() {}
    }
}
