//! Device controller of the RP2350 (datasheet, 12.7) as a bus of the crate `usb-device`.
//!
//! Every endpoint has one buffer of 64 bytes in the memory of the controller. The word of a buffer
//! has its length, the data toggle of its packet, and AVAILABLE: it belongs to the controller then.
//!
//! A SETUP packet ends the control transfer before it: it takes back what that one has left, and
//! gives the OUT buffer for the data or for the status of the new one.

use crate::registers::{read, write};
use core::cell::Cell;
use usb_device::bus::{PollResult, UsbBus};
use usb_device::endpoint::{EndpointAddress, EndpointType};
use usb_device::{Result, UsbDirection, UsbError};

/// Registers of the controller, and its memory. Both take aligned words.
const USB: usize = 0x5011_0000;
const MEMORY: usize = 0x5010_0000;

const ADDRESS: usize = 0x0;
const MAIN_CONTROL: usize = 0x40;
const CONTROL: usize = 0x4C;
const STATUS: usize = 0x50;
const BUFFERS: usize = 0x58;
const ABORT: usize = 0x60;
const ABORTED: usize = 0x64;
const STALL_ARM: usize = 0x68;
const MUXING: usize = 0x74;
const POWER: usize = 0x78;

/// Bits of STATUS.
const BUS_RESET: u32 = 1 << 19;
const SETUP: u32 = 1 << 17;
const RESUME: u32 = 1 << 11;
const SUSPENDED: u32 = 1 << 4;

/// Bits of the word of a buffer.
const FULL: u32 = 1 << 15;
const TOGGLE: u32 = 1 << 13;
const STALL: u32 = 1 << 11;
const AVAILABLE: u32 = 1 << 10;
const LENGTH: u32 = 0x3FF;

/// Largest packet, and size of a buffer.
pub const PACKET: usize = 64;
/// Buffer of both directions of endpoint 0, and of the first other endpoint.
const BUFFER_0: usize = 0x100;
const FIRST_BUFFER: usize = 0x180;

/// Endpoints, with endpoint 0: the serial port needs two others.
const ENDPOINTS: usize = 4;

/// Turns after which an abort is taken as done: the controller needs some ten cycles.
const ABORT_TURNS: u32 = 200;

const IN: usize = 0;
const OUT: usize = 1;

/// An endpoint in one direction.
#[derive(Default)]
struct Endpoint {
    /// Its place in the memory; 0 while it is not allocated.
    buffer: Cell<usize>,
    /// Word of its control register; 0 for endpoint 0, which has none.
    control: Cell<u32>,
    /// Data toggle of its next packet.
    toggle: Cell<bool>,
}

/// The device controller.
pub struct Bus {
    endpoints: [[Endpoint; 2]; ENDPOINTS],
    next_buffer: usize,
    /// A SETUP packet was reported, and is read next.
    has_setup: Cell<bool>,
}

// SAFETY: only the main loop uses it, which is one context.
unsafe impl Sync for Bus {}

/// Place of the word of a buffer.
const fn word(endpoint: usize, side: usize) -> usize {
    0x80 + 8 * endpoint + 4 * side
}

fn side(address: EndpointAddress) -> usize {
    match address.is_in() {
        true => IN,
        false => OUT,
    }
}

/// Gives a buffer to the controller. The other bits must have arrived in its clock domain before
/// AVAILABLE: three cycles of 48 MHz.
fn give(endpoint: usize, side: usize, bits: u32) {
    write(MEMORY, word(endpoint, side), bits);
    cortex_m::asm::delay(12);
    write(MEMORY, word(endpoint, side), bits | AVAILABLE);
}

impl Bus {
    /// A controller without endpoints.
    pub fn new() -> Self {
        Self {
            endpoints: Default::default(),
            next_buffer: FIRST_BUFFER,
            has_setup: Cell::new(false),
        }
    }

    /// An allocated endpoint: its number, side and state.
    fn endpoint(&self, address: EndpointAddress) -> Result<(usize, usize, &Endpoint)> {
        let (number, side) = (address.index(), side(address));
        let endpoint = self
            .endpoints
            .get(number)
            .map(|sides| &sides[side])
            .filter(|endpoint| endpoint.buffer.get() != 0);
        endpoint
            .map(|endpoint| (number, side, endpoint))
            .ok_or(UsbError::InvalidEndpoint)
    }

    /// Gives an OUT buffer for the next packet.
    fn expect(&self, number: usize) {
        let toggle = self.endpoints[number][OUT].toggle.get();
        let bits = if toggle { TOGGLE } else { 0 };
        give(number, OUT, bits | PACKET as u32);
    }

    /// Reads the SETUP packet, and begins its control transfer.
    fn read_setup(&self, buffer: &mut [u8]) -> Result<usize> {
        // Cleared before the packet is read: a later one is seen again.
        write(USB, STATUS, SETUP);
        let bytes = buffer.get_mut(..8).ok_or(UsbError::BufferOverflow)?;
        read_memory(0, bytes);
        // Data of either direction: the host sends data, or the status after those of the device.
        let has_data = bytes[6..8] != [0, 0];
        let is_out = bytes[0] & 0x80 == 0;
        // Both stages after it begin with toggle 1.
        let [into_host, from_host] = &self.endpoints[0];
        into_host.toggle.set(true);
        if read(MEMORY, word(0, IN)) & AVAILABLE != 0 {
            take_back(0, IN);
        }
        write(MEMORY, word(0, IN), 0);
        let out = read(MEMORY, word(0, OUT));
        from_host.toggle.set(true);
        // Data that arrived before the SETUP packet was seen are its own. What else has arrived is
        // the status of the transfer before it.
        if is_out && has_data && out & FULL != 0 && out & LENGTH != 0 {
            return Ok(8);
        }
        if out & AVAILABLE != 0 {
            take_back(0, OUT);
        }
        write(MEMORY, word(0, OUT), 0);
        if has_data {
            self.expect(0);
        }
        Ok(8)
    }
}

/// Takes a buffer back from the controller.
fn take_back(endpoint: usize, side: usize) {
    let bit = 1 << (2 * endpoint + side);
    write(USB, ABORT, bit);
    for _ in 0..ABORT_TURNS {
        if read(USB, ABORTED) & bit != 0 {
            break;
        }
    }
    write(MEMORY, word(endpoint, side), 0);
    write(USB, ABORTED, bit);
    write(USB, ABORT, 0);
}

/// Copies bytes from the memory of the controller.
fn read_memory(from: usize, bytes: &mut [u8]) {
    for (four, at) in bytes.chunks_mut(4).zip((from..).step_by(4)) {
        let word = read(MEMORY, at).to_le_bytes();
        four.copy_from_slice(&word[..four.len()]);
    }
}

/// Copies bytes into the memory of the controller.
fn write_memory(to: usize, bytes: &[u8]) {
    for (four, at) in bytes.chunks(4).zip((to..).step_by(4)) {
        let mut word = [0; 4];
        word[..four.len()].copy_from_slice(four);
        write(MEMORY, at, u32::from_le_bytes(word));
    }
}

impl UsbBus for Bus {
    fn alloc_ep(
        &mut self,
        direction: UsbDirection,
        address: Option<EndpointAddress>,
        kind: EndpointType,
        max_packet_size: u16,
        _interval: u8,
    ) -> Result<EndpointAddress> {
        if usize::from(max_packet_size) > PACKET {
            return Err(UsbError::EndpointOverflow);
        }
        let side = if direction == UsbDirection::In {
            IN
        } else {
            OUT
        };
        let number = match address {
            Some(address) => address.index(),
            None => (1..ENDPOINTS)
                .find(|number| self.endpoints[*number][side].buffer.get() == 0)
                .ok_or(UsbError::EndpointOverflow)?,
        };
        let sides = self
            .endpoints
            .get(number)
            .ok_or(UsbError::InvalidEndpoint)?;
        let endpoint = &sides[side];
        if endpoint.buffer.get() != 0 {
            return Err(UsbError::InvalidEndpoint);
        }
        let kind = match kind {
            EndpointType::Control => 0,
            EndpointType::Isochronous { .. } => return Err(UsbError::Unsupported),
            EndpointType::Bulk => 2,
            EndpointType::Interrupt => 3,
        };
        if number == 0 {
            endpoint.buffer.set(BUFFER_0);
        } else {
            endpoint.buffer.set(self.next_buffer);
            // Enabled; a packet is reported when its buffer is done.
            let control = 1 << 31 | 1 << 29 | kind << 26 | self.next_buffer as u32;
            endpoint.control.set(control);
            self.next_buffer += PACKET;
        }
        Ok(EndpointAddress::from_parts(number, direction))
    }

    fn enable(&mut self) {
        for at in (0..0x1000).step_by(4) {
            write(MEMORY, at, 0);
        }
        // Pads by the controller; the bus supply counts as there, since no pin senses it.
        write(USB, MUXING, 1 << 3 | 1);
        write(USB, POWER, 1 << 3 | 1 << 2);
        // Device, enabled, its pads not isolated.
        write(USB, MAIN_CONTROL, 1);
        self.reset();
        // Each packet of endpoint 0 is reported. The pull-up tells the host that a device is there.
        write(USB, CONTROL, 1 << 29 | 1 << 16);
    }

    fn reset(&self) {
        self.has_setup.set(false);
        write(USB, ADDRESS, 0);
        write(USB, STALL_ARM, 0);
        write(USB, STATUS, SETUP);
        for (number, sides) in self.endpoints.iter().enumerate() {
            for (side, endpoint) in sides.iter().enumerate() {
                if number > 0 {
                    write(MEMORY, 8 * number + 4 * side, endpoint.control.get());
                }
                write(MEMORY, word(number, side), 0);
                endpoint.toggle.set(false);
            }
        }
        write(USB, BUFFERS, u32::MAX);
        for number in 1..ENDPOINTS {
            if self.endpoints[number][OUT].buffer.get() != 0 {
                self.expect(number);
            }
        }
    }

    fn set_device_address(&self, address: u8) {
        write(USB, ADDRESS, u32::from(address));
    }

    fn write(&self, address: EndpointAddress, bytes: &[u8]) -> Result<usize> {
        let (number, side, endpoint) = self.endpoint(address)?;
        if bytes.len() > PACKET {
            return Err(UsbError::BufferOverflow);
        }
        if read(MEMORY, word(number, side)) & (AVAILABLE | STALL) != 0 {
            return Err(UsbError::WouldBlock);
        }
        write_memory(endpoint.buffer.get(), bytes);
        let toggle = endpoint.toggle.replace(!endpoint.toggle.get());
        let bits = if toggle { TOGGLE } else { 0 };
        give(number, side, FULL | bits | bytes.len() as u32);
        Ok(bytes.len())
    }

    fn read(&self, address: EndpointAddress, buffer: &mut [u8]) -> Result<usize> {
        let (number, side, endpoint) = self.endpoint(address)?;
        if number == 0 && self.has_setup.replace(false) {
            return self.read_setup(buffer);
        }
        let bits = read(MEMORY, word(number, side));
        if bits & AVAILABLE != 0 || bits & FULL == 0 {
            return Err(UsbError::WouldBlock);
        }
        let count = (bits & LENGTH) as usize;
        let bytes = buffer.get_mut(..count);
        let fits = bytes.is_some();
        if let Some(bytes) = bytes {
            read_memory(endpoint.buffer.get(), bytes);
        }
        endpoint.toggle.set(!endpoint.toggle.get());
        if number == 0 && count < PACKET {
            // The last packet of its stage: the next one follows a SETUP packet.
            write(MEMORY, word(0, OUT), 0);
        } else {
            self.expect(number);
        }
        match fits {
            true => Ok(count),
            false => Err(UsbError::BufferOverflow),
        }
    }

    fn set_stalled(&self, address: EndpointAddress, stalled: bool) {
        let Ok((number, side, endpoint)) = self.endpoint(address) else {
            return;
        };
        let bits = read(MEMORY, word(number, side));
        if stalled {
            write(MEMORY, word(number, side), STALL);
            if number == 0 {
                // The controller clears it with the next SETUP packet.
                write(USB, STALL_ARM, read(USB, STALL_ARM) | 1 << side);
            }
        } else if number > 0 {
            // The host begins with toggle 0 again, also at an endpoint that was not stalled.
            endpoint.toggle.set(false);
            if bits & AVAILABLE != 0 {
                take_back(number, side);
            }
            match side {
                OUT if bits & FULL == 0 || bits & AVAILABLE != 0 => self.expect(number),
                OUT => {
                    // A packet waits to be read; then the toggle is changed.
                    endpoint.toggle.set(true);
                }
                _ => write(MEMORY, word(number, side), 0),
            }
        } else if bits & STALL != 0 {
            write(MEMORY, word(0, side), 0);
        }
    }

    fn is_stalled(&self, address: EndpointAddress) -> bool {
        let found = self.endpoint(address);
        found.is_ok_and(|(number, side, _)| read(MEMORY, word(number, side)) & STALL != 0)
    }

    fn suspend(&self) {}

    fn resume(&self) {}

    fn poll(&self) -> PollResult {
        let status = read(USB, STATUS);
        for (bit, event) in [
            (BUS_RESET, PollResult::Reset),
            (SUSPENDED, PollResult::Suspend),
            (RESUME, PollResult::Resume),
        ] {
            if status & bit != 0 {
                write(USB, STATUS, bit);
                return event;
            }
        }
        let done = read(USB, BUFFERS);
        if done != 0 {
            write(USB, BUFFERS, done);
        }
        let (mut out, mut sent) = (0, 0);
        for (number, sides) in self.endpoints.iter().enumerate() {
            sent |= ((done >> (2 * number) & 1) as u16) << number;
            // A packet is reported until it is read.
            let bits = read(MEMORY, word(number, OUT));
            let arrived = sides[OUT].buffer.get() != 0 && bits & (AVAILABLE | FULL) == FULL;
            out |= u16::from(arrived) << number;
        }
        let setup = u16::from(status & SETUP != 0);
        self.has_setup.set(setup != 0);
        if out | sent | setup == 0 {
            return PollResult::None;
        }
        PollResult::Data {
            ep_out: out,
            ep_in_complete: sent,
            ep_setup: setup,
        }
    }
}
