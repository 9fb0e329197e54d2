//! A host on the USB of the emulated chip: it enumerates the device as an operating system does,
//! and carries the bytes of its serial port.
//!
//! Transactions take their time on a full-speed bus, one after the other; a packet that the device
//! does not take or have is tried again. Packets are never damaged.

use rp2350_emu::peripherals::usb::{UsbAnswer, UsbCtrl};
use std::collections::VecDeque;

/// Cycles of a bit on the bus, in halves: 150 MHz / 12 Mbit/s = 12.5.
const HALF_CYCLES_PER_BIT: u64 = 25;
const CYCLES_PER_US: u64 = 150;
/// Cycles of a frame.
const FRAME: u64 = 1000 * CYCLES_PER_US;
/// Bits of token, handshake, and the pauses between them; of what surrounds data.
const BITS: u64 = 70;
const DATA_BITS: u64 = 35;

/// Length of a reset, and pause after it (USB 2.0, 7.1.7.5). The pause of 100 ms before the reset,
/// in which plugs bounce, is left out.
const RESET_US: u64 = 10_000;
const RECOVERY_US: u64 = 10_000;
/// Pause after a new address (9.2.6.3).
const ADDRESS_US: u64 = 2000;
/// Longest wait for a stage of a control transfer (9.2.6.4).
const STAGE_US: u64 = 50_000;
/// Silence after which a device is suspended.
const SUSPEND_US: u64 = 3000;

/// Address that the device gets.
const DEVICE: u8 = 5;

/// What the device said of itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Description {
    /// Vendor and product.
    pub ids: (u16, u16),
    /// Manufacturer, product, serial number.
    pub names: [String; 3],
    /// Endpoints of the bytes: to the host, from the host.
    pub data: (u8, u8),
    /// Interface of the control requests of the serial port.
    pub control: u8,
}

/// Control transfers of the enumeration, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Request {
    FirstDevice,
    Address,
    Device,
    ConfigurationHead,
    Configuration,
    /// Number of the name.
    Name(usize),
    Configure,
    LineCoding,
    ControlLines,
}

/// Stage of a control transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Setup,
    Data,
    Status,
}

/// A control transfer.
#[derive(Debug, Clone)]
struct Transfer {
    request: Request,
    stage: Stage,
    packet: [u8; 8],
    /// Data to the device, or those that have come.
    data: Vec<u8>,
    done: usize,
    toggle: bool,
    /// Cycle at which the stage has lasted too long.
    end: u64,
}

#[derive(Debug, Clone)]
enum State {
    /// No device.
    Empty,
    /// The reset ends at the next turn.
    Reset,
    Control(Transfer),
    /// The serial port is open.
    Open,
    /// The cable is pulled, or the host sleeps.
    Away,
    /// The host has slept.
    Waking,
}

/// The host.
#[derive(Debug, Clone)]
pub struct UsbHost {
    state: State,
    /// Cycle of the next turn.
    due: u64,
    frame: u64,
    /// Endpoints' next data toggles: from the host, to the host.
    toggles: [bool; 2],
    is_in_next: bool,
    to_device: VecDeque<u8>,
    /// A packet that the device has not taken yet.
    packet: Vec<u8>,
    from_device: Vec<u8>,
    /// Whether a program reads the serial port.
    is_read: bool,
    lengths: [u8; 3],
    total: usize,
    /// What the device said of itself.
    pub description: Description,
}

impl Default for UsbHost {
    fn default() -> Self {
        Self {
            state: State::Empty,
            due: 0,
            frame: 0,
            toggles: [false; 2],
            is_in_next: false,
            to_device: VecDeque::new(),
            packet: Vec::new(),
            from_device: Vec::new(),
            is_read: true,
            lengths: [0; 3],
            total: 0,
            description: Description::default(),
        }
    }
}

/// Cycles of this number of bits.
const fn bits(count: u64) -> u64 {
    count * HALF_CYCLES_PER_BIT / 2
}

/// Cycles of a transaction with this number of data bytes; none without a data packet.
fn duration(data: Option<usize>) -> u64 {
    bits(BITS + data.map_or(0, |bytes| DATA_BITS + 8 * bytes as u64))
}

impl UsbHost {
    /// Cycle at which [`UsbHost::serve`] must be called.
    #[must_use]
    pub const fn due(&self) -> u64 {
        self.due
    }

    /// The serial port is open.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        matches!(self.state, State::Open)
    }

    /// Bytes for the serial port.
    pub fn send(&mut self, bytes: &[u8]) {
        self.to_device.extend(bytes);
    }

    /// The device has taken all bytes for the serial port.
    #[must_use]
    pub fn is_sent(&self) -> bool {
        self.to_device.is_empty() && self.packet.is_empty()
    }

    /// Takes the bytes that the serial port received.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.from_device)
    }

    /// Lets the serial port take no bytes from the device, as if no program read it; or lets it.
    pub const fn set_read(&mut self, is_read: bool) {
        self.is_read = is_read;
    }

    /// Pulls the cable, or lets the host sleep: the device receives nothing.
    pub fn leave(&mut self, now: u64) {
        self.state = State::Away;
        self.to_device.clear();
        self.packet.clear();
        self.from_device.clear();
        self.due = now + SUSPEND_US * CYCLES_PER_US;
    }

    /// The host has slept, and goes on with the open serial port.
    pub fn wake(&mut self, now: u64) {
        self.state = State::Waking;
        self.due = now;
    }

    /// Takes no turns any more: a test is the host.
    pub const fn pause(&mut self) {
        self.due = u64::MAX;
    }

    /// Plugs the cable in again: the host resets and enumerates the device.
    pub fn come_back(&mut self, now: u64) {
        self.state = State::Empty;
        self.due = now;
    }

    /// The next turn of the host, at the cycle [`UsbHost::due`] or later.
    ///
    /// # Errors
    /// The device does not answer as it must.
    pub fn serve(&mut self, device: &mut UsbCtrl, now: u64) -> Result<(), String> {
        let is_away = matches!(self.state, State::Away);
        if !is_away && now / FRAME != self.frame && !matches!(self.state, State::Reset) {
            self.frame = now / FRAME;
            device.start_of_frame(self.frame as u32);
        }
        if !is_away && !matches!(self.state, State::Empty) && !device.is_attached() {
            self.state = State::Empty;
        }
        let wait = match self.state.clone() {
            State::Empty if device.is_attached() => {
                device.bus_reset();
                self.state = State::Reset;
                RESET_US * CYCLES_PER_US
            }
            State::Empty => FRAME,
            State::Reset => {
                self.toggles = [false; 2];
                self.description = Description::default();
                self.begin(Request::FirstDevice, now);
                RECOVERY_US * CYCLES_PER_US
            }
            State::Control(transfer) => self.control(transfer, device, now)?,
            State::Open => self.carry(device)?,
            State::Away => {
                device.bus_suspend();
                u64::MAX - now
            }
            State::Waking => {
                device.bus_resume();
                self.state = State::Open;
                RECOVERY_US * CYCLES_PER_US
            }
        };
        self.due = now + wait;
        Ok(())
    }

    fn begin(&mut self, request: Request, now: u64) {
        let descriptor = |kind: u8, index: u8, length: u16| {
            let [low, high] = length.to_le_bytes();
            [0x80, 6, index, kind, 0, 0, low, high]
        };
        let control = self.description.control;
        let (packet, data) = match request {
            Request::FirstDevice => (descriptor(1, 0, 64), vec![]),
            Request::Address => ([0, 5, DEVICE, 0, 0, 0, 0, 0], vec![]),
            Request::Device => (descriptor(1, 0, 18), vec![]),
            Request::ConfigurationHead => (descriptor(2, 0, 9), vec![]),
            Request::Configuration => (descriptor(2, 0, self.total as u16), vec![]),
            Request::Name(name) => {
                let mut packet = descriptor(3, self.lengths[name], 255);
                // US English.
                packet[4..6].copy_from_slice(&[0x09, 0x04]);
                (packet, vec![])
            }
            Request::Configure => ([0, 9, 1, 0, 0, 0, 0, 0], vec![]),
            Request::LineCoding => {
                let coding = [0x40, 0x42, 0x0F, 0, 0, 0, 8];
                ([0x21, 0x20, 0, 0, control, 0, 7, 0], coding.to_vec())
            }
            Request::ControlLines => ([0x21, 0x22, 3, 0, control, 0, 0, 0], vec![]),
        };
        self.state = State::Control(Transfer {
            request,
            stage: Stage::Setup,
            packet,
            data,
            done: 0,
            toggle: true,
            end: now + (RECOVERY_US + STAGE_US) * CYCLES_PER_US,
        });
    }

    /// A transaction of a control transfer; returns the cycles until the next.
    fn control(
        &mut self,
        mut transfer: Transfer,
        device: &mut UsbCtrl,
        now: u64,
    ) -> Result<u64, String> {
        let named = matches!(transfer.request, Request::FirstDevice | Request::Address);
        let address = if named { 0 } else { DEVICE };
        let is_in = transfer.packet[0] & 0x80 != 0;
        let requested = u16::from_le_bytes([transfer.packet[6], transfer.packet[7]]) as usize;
        let (request, stage) = (transfer.request, transfer.stage);
        let failed = |what: &str| Err(format!("USB: {request:?}, {stage:?}: {what}"));
        let (answer, length, is_done) = match transfer.stage {
            Stage::Setup => {
                let answer = device.setup(address, transfer.packet);
                (answer, Some(8), true)
            }
            Stage::Data if is_in => {
                let answer = device.transmit(address, 0);
                let mut is_done = false;
                let mut length = None;
                if let UsbAnswer::Data { toggle, bytes } = &answer {
                    if *toggle != transfer.toggle {
                        return failed("the data toggle is wrong");
                    }
                    length = Some(bytes.len());
                    transfer.data.extend(bytes);
                    // A short packet, or all that was requested.
                    is_done = bytes.len() < 64 || transfer.data.len() >= requested;
                }
                (answer, length, is_done)
            }
            Stage::Data => {
                let end = transfer.data.len().min(transfer.done + 64);
                let bytes = &transfer.data[transfer.done..end];
                let answer = device.receive(address, 0, transfer.toggle, bytes);
                let length = bytes.len();
                if answer == UsbAnswer::Ack {
                    transfer.done = end;
                }
                (answer, Some(length), transfer.done == transfer.data.len())
            }
            Stage::Status if is_in && requested > 0 => {
                (device.receive(address, 0, true, &[]), Some(0), true)
            }
            Stage::Status => {
                let answer = device.transmit(address, 0);
                if let UsbAnswer::Data { toggle, bytes } = &answer
                    && !(*toggle && bytes.is_empty())
                {
                    return failed("the status has data");
                }
                (answer, None, true)
            }
        };
        let time = duration(length);
        match answer {
            UsbAnswer::Ack | UsbAnswer::Data { .. } => {}
            UsbAnswer::Nak if now < transfer.end => {
                self.state = State::Control(transfer);
                return Ok(time);
            }
            UsbAnswer::Nak => return failed("the device is never ready"),
            UsbAnswer::Stall => return failed("the device refuses it"),
            UsbAnswer::Silence => return failed("the device does not answer"),
        }
        transfer.toggle = match transfer.stage {
            Stage::Setup => true,
            _ => !transfer.toggle,
        };
        if is_done {
            transfer.end = now + STAGE_US * CYCLES_PER_US;
            transfer.stage = match transfer.stage {
                Stage::Setup if requested > 0 => Stage::Data,
                Stage::Setup | Stage::Data => Stage::Status,
                Stage::Status => return self.end(&transfer, now).map(|pause| time + pause),
            };
        }
        self.state = State::Control(transfer);
        Ok(time)
    }

    /// A control transfer has ended; begins the next one after the returned cycles.
    fn end(&mut self, transfer: &Transfer, now: u64) -> Result<u64, String> {
        let data = &transfer.data[..];
        let short = || format!("USB: {:?}: the descriptor is short", transfer.request);
        let mut pause = 0;
        let next = match transfer.request {
            Request::FirstDevice => Request::Address,
            Request::Address => {
                pause = ADDRESS_US * CYCLES_PER_US;
                Request::Device
            }
            Request::Device => {
                let device: [u8; 18] = data.try_into().map_err(|_| short())?;
                let half = |at: usize| u16::from_le_bytes([device[at], device[at + 1]]);
                self.description.ids = (half(8), half(10));
                self.lengths = [device[14], device[15], device[16]];
                Request::ConfigurationHead
            }
            Request::ConfigurationHead => {
                let head: [u8; 9] = data.try_into().map_err(|_| short())?;
                self.total = usize::from(u16::from_le_bytes([head[2], head[3]]));
                Request::Configuration
            }
            Request::Configuration => {
                if data.len() != self.total {
                    return Err(short());
                }
                self.interfaces(data)?;
                Request::Name(0)
            }
            Request::Name(name) => {
                let text = data.get(2..).ok_or_else(short)?;
                let (units, _) = text.as_chunks::<2>();
                let units: Vec<u16> = units.iter().map(|unit| u16::from_le_bytes(*unit)).collect();
                self.description.names[name] = String::from_utf16_lossy(&units);
                match name {
                    2 => Request::Configure,
                    name => Request::Name(name + 1),
                }
            }
            Request::Configure => Request::LineCoding,
            Request::LineCoding => Request::ControlLines,
            Request::ControlLines => {
                self.state = State::Open;
                return Ok(0);
            }
        };
        self.begin(next, now + pause);
        Ok(pause)
    }

    /// Finds the serial port in a configuration descriptor.
    fn interfaces(&mut self, mut rest: &[u8]) -> Result<(), String> {
        let (mut class, mut control, mut data) = (0, None, (None, None));
        while let [length, kind, ..] = *rest {
            let (own, after) = rest
                .split_at_checked(usize::from(length))
                .filter(|_| length >= 2)
                .ok_or("USB: a descriptor exceeds the configuration")?;
            rest = after;
            match (kind, own) {
                (4, [_, _, number, _, _, interface, subclass, ..]) => {
                    class = *interface;
                    // Communication, abstract control model.
                    if (class, *subclass) == (2, 2) {
                        control = Some(*number);
                    }
                }
                // Bulk endpoints of the interface for data.
                (5, [_, _, address, 2, ..]) if class == 10 => match address & 0x80 {
                    0 => data.1 = Some(*address),
                    _ => data.0 = Some(address & 0xF),
                },
                _ => {}
            }
        }
        match (control, data) {
            (Some(control), (Some(into), Some(from))) => {
                self.description.control = control;
                self.description.data = (into, from);
                Ok(())
            }
            _ => Err("USB: the device is no serial port".to_string()),
        }
    }

    /// A transaction of the serial port; returns its cycles.
    fn carry(&mut self, device: &mut UsbCtrl) -> Result<u64, String> {
        self.is_in_next = !self.is_in_next;
        let (into, from) = self.description.data;
        if self.packet.is_empty() {
            let count = self.to_device.len().min(64);
            self.packet.extend(self.to_device.drain(..count));
        }
        if self.packet.is_empty() || self.is_in_next && self.is_read {
            if !self.is_read {
                return Ok(duration(None));
            }
            return match device.transmit(DEVICE, into) {
                UsbAnswer::Data { toggle, bytes } if toggle == self.toggles[1] => {
                    self.toggles[1] = !toggle;
                    self.from_device.extend(&bytes);
                    Ok(duration(Some(bytes.len())))
                }
                UsbAnswer::Data { .. } => Err("USB: the data toggle is wrong".to_string()),
                UsbAnswer::Nak => Ok(duration(None)),
                answer => Err(format!("USB: endpoint {into}: {answer:?}")),
            };
        }
        let toggle = self.toggles[0];
        let time = duration(Some(self.packet.len()));
        match device.receive(DEVICE, from, toggle, &self.packet) {
            UsbAnswer::Ack => {
                self.toggles[0] = !toggle;
                self.packet.clear();
                Ok(time)
            }
            UsbAnswer::Nak => Ok(time),
            answer => Err(format!("USB: endpoint {from}: {answer:?}")),
        }
    }
}
