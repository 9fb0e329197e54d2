//! The board: an STM32F427 with a crystal of 8 MHz, the line to the host, and wires to its pins.
//!
//! rigless has no wires from pins to timers. [`Board::drive`] has those of the encoders and of the
//! emergency stop.

use crate::chip::{Chip, UPDATE};
use rigless::chip::uart::{Peer, TcpPeer};
use rigless::device::Level;
use rigless::machine::{self, Crystal, HostWire, Target, armv7m};
use rigless::mcu::Operate as _;
use rigless::snapshot::Store;
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::{gpioa, tim2};
use rigless::soc::stm32f427::peripherals::gpio::Pin;
use rigless::soc::stm32f427::peripherals::tim::Channel;
use rigless::time::VirtualNanos;
use std::num::{NonZeroU32, NonZeroU64};

/// Ports by their letters, as rigless numbers them.
pub const A: usize = 0;
/// Port B.
pub const B: usize = 1;
/// Port C.
pub const C: usize = 2;
/// Port D.
pub const D: usize = 3;
/// Port E.
pub const E: usize = 4;

/// Number of USART3 in the emulator.
const USART3: usize = 2;
/// Number of TIM8 among the advanced timers.
const TIM8: usize = 1;

/// Pins of the encoders: A, B, index; and the number of the timer.
pub const ENCODERS: [([(usize, u8); 3], usize); 4] = [
    ([(A, 15), (B, 3), (B, 10)], 0),
    ([(A, 0), (A, 1), (A, 2)], 3),
    ([(B, 4), (B, 5), (B, 0)], 1),
    ([(B, 6), (B, 7), (B, 8)], 2),
];

/// Inputs that rest at ground: emergency stop, homes, limits, alarm, digital inputs.
const AT_GROUND: [(usize, u8); 19] = [
    (C, 6),
    (C, 1),
    (C, 2),
    (C, 4),
    (C, 5),
    (C, 8),
    (D, 0),
    (D, 1),
    (D, 2),
    (D, 3),
    (D, 6),
    (D, 7),
    (D, 10),
    (D, 11),
    (C, 9),
    (C, 11),
    (A, 3),
    (A, 8),
    (A, 10),
];

/// The emergency stop.
pub const EMERGENCY_STOP: (usize, u8) = (C, 6);

/// The board.
#[derive(Debug)]
pub struct Board {
    /// The chip.
    pub chip: Chip,
}

// Nothing here is kept in snapshots.
impl Store for Board {}

impl Board {
    /// The board, with the line to the host at a port of this computer.
    pub fn new(port: Option<u16>, crystal_hz: u64) -> Result<Self, String> {
        let mut chip = Chip::new()?;
        let mcu = &mut chip.mcu;
        mcu.rcc
            .attach_crystals(Crystal(crystal_hz).0, Crystal::NONE.0);
        mcu.set_supply(3300);
        if let Some(port) = port {
            let host = TcpPeer::listen(port).map_err(|error| format!("port {port}: {error}"))?;
            mcu.usart[USART3].attach(host);
        }
        Ok(Self { chip })
    }

    /// Attaches the line to the host.
    pub fn attach(&mut self, host: impl Peer) {
        self.chip.mcu.usart[USART3].attach(host);
    }

    /// Drives all inputs as closed contacts do, and the encoders low.
    pub fn rest(&mut self, at: VirtualNanos) {
        for pin in AT_GROUND {
            self.drive(at, pin, false);
        }
        for (pins, _) in ENCODERS {
            for pin in pins {
                self.drive(at, pin, false);
            }
        }
    }

    /// Drives a pin, and the timer behind it.
    pub fn drive(&mut self, at: VirtualNanos, (port, pin): (usize, u8), high: bool) {
        let level = if high { Level::High } else { Level::Low };
        let Some(place) = Pin::new(pin) else { return };
        self.chip
            .mcu
            .drive_port(at, port, |gpio, registers, context| {
                gpio.drive(place, Some(level), registers, context);
            });
        if (port, pin) == EMERGENCY_STOP {
            self.drive_gate(at, high);
        }
        for (pins, timer) in ENCODERS {
            if let Some(channel) = pins.iter().position(|it| *it == (port, pin)) {
                let channel = Channel::new(channel as u8 + 1).expect("a channel");
                self.chip
                    .mcu
                    .drive_timer(at, timer, |timer, registers, context| {
                        timer.drive_input(channel, level, registers, context);
                    });
            }
        }
    }

    /// Lets the gate of TIM8 see an edge of the emergency stop's level. The emulator takes the
    /// level of a gate at its edges only, the chip at all times.
    pub fn drive_gate(&mut self, at: VirtualNanos, high: bool) {
        let level = if high { Level::High } else { Level::Low };
        let channel = Channel::new(1).expect("a channel");
        self.chip
            .mcu
            .drive_advanced_timer(at, TIM8, |timer, registers, context| {
                timer.drive_input(channel, level, registers, context);
            });
    }

    /// Acknowledges the requests of TIM8 that the DMA has served; whether there were any.
    pub fn acknowledge(&mut self, at: VirtualNanos) -> bool {
        let served = core::mem::take(&mut self.chip.dma2.served) > 0;
        if served {
            self.chip
                .mcu
                .drive_advanced_timer(at, TIM8, |timer, registers, context| {
                    timer.acknowledge(UPDATE, registers, context);
                });
        }
        served
    }

    /// Stops the timer of the control period, as a broken program would.
    pub fn stop_periods(&mut self, at: VirtualNanos) {
        const TIM1_CONTROL: u64 = 0x4001_0000;
        let written = self.chip.write(at, TIM1_CONTROL, Width::W32, 0);
        written.expect("the timer has a clock");
    }

    /// Levels that a port drives.
    pub fn outputs(&mut self, port: usize) -> u16 {
        let (_, registers) = self.chip.mcu.port(port);
        registers.get(gpioa::Register::Odr) as u16
    }

    /// Captured index of an encoder.
    pub fn index(&mut self, encoder: usize) -> u32 {
        let (_, registers) = self.chip.mcu.timer(ENCODERS[encoder].1);
        registers.get(tim2::Register::Ccr3) as u32
    }
}

/// Name of the board.
pub const NAME: &str = "haptimill-stm32";
const MCU: &str = "stm32f427";

impl machine::Board for Board {
    fn name(&self) -> &'static str {
        NAME
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec![MCU]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn rigless::mcu::Mcu> {
        (target == 0).then_some(&mut self.chip)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let lines = u32::from(rigless::mcu::Operate::cpu(&self.chip).interrupt_lines);
        let core = armv7m::Core {
            variant: armv7m::Variant::M4,
            clock_hz: NonZeroU64::new(168_000_000).expect("not zero"),
            interrupt_lines: NonZeroU32::new(lines).expect("not zero"),
            priority_bits: 4,
            refclk_divider: NonZeroU32::new(8).expect("not zero"),
            instructions_per_second: armv7m::INSTRUCTIONS_PER_SECOND,
            boot: "flash",
        }
        .spec_with_parts(
            &rigless::cpu::armv7m::windows(rigless::mcu::Mcu::bus(&self.chip)),
            armv7m::Fpu::FpV4Sp,
            armv7m::MpuRegions::Eight,
        );
        vec![Target::new(MCU, &mut self.chip, core)]
    }

    fn hosts(&self) -> Vec<HostWire> {
        Vec::new()
    }
}
