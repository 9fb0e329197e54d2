//! The chip: rigless's STM32F427 with the request of TIM8's update at DMA2.
//!
//! rigless models the timers and the DMA controllers, but leaves out the rows of the timers in the
//! table of requests, and nothing acknowledges a timer's request (its documentation says so). Here
//! a transfer to the destination acknowledges it, as the chip does.

use rigless::device::{
    Device, DeviceContext, ErasedDevice, Level, RegisterFile, RequestChange, ResetCause,
};
use rigless::mcu::Mcu;
use rigless::soc::Bus;
use rigless::soc::stm32f427::Stm32f427;
use rigless::soc::stm32f427::generated::dma2::Register;
use rigless::soc::stm32f427::peripherals::dma::{Dma, Wire};
use rigless::time::VirtualNanos;

const TIM8: &str = "TIM8";
/// Number of the update among a timer's requests.
pub const UPDATE: usize = 0;

/// Update of TIM8: channel 7 of stream 1 (RM0090, table 44).
static REQUESTS: [Wire; 1] = [Wire {
    instance: TIM8,
    request: UPDATE,
    channel: 7,
    streams: &[1],
}];

/// Token of an access of stream 1 to its destination.
const TO_THE_PORT: u64 = 3;

/// DMA2, whose transfers acknowledge the request.
#[derive(Debug)]
pub struct Dma2 {
    dma: Dma,
    /// Transfers since the last look at them.
    pub served: u32,
}

impl Device for Dma2 {
    type Register = Register;

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::write(&mut self.dma, register, value, registers, context);
    }

    fn on_request(
        &mut self,
        change: RequestChange,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::on_request(&mut self.dma, change, registers, context);
    }

    fn on_access(
        &mut self,
        token: u64,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if token == TO_THE_PORT {
            self.served += 1;
            let low = RequestChange {
                instance: TIM8,
                request: UPDATE,
                level: Level::Low,
            };
            Device::on_request(&mut self.dma, low, registers, context);
        }
        Device::on_access(&mut self.dma, token, value, registers, context);
    }

    fn on_refused(
        &mut self,
        token: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::on_refused(&mut self.dma, token, registers, context);
    }

    fn reset(&mut self) {
        Device::reset(&mut self.dma);
    }
}

/// The chip.
#[derive(Debug)]
pub struct Chip {
    /// All of it but DMA2.
    pub mcu: Stm32f427,
    /// DMA2.
    pub dma2: Dma2,
    slot: usize,
}

impl Chip {
    /// The chip out of reset.
    pub fn new() -> Result<Self, String> {
        let mcu = Stm32f427::new().map_err(|error| error.to_string())?;
        let slot = mcu.bus().slot("DMA2").map_err(|error| error.to_string())?;
        Ok(Self {
            mcu,
            dma2: Dma2 {
                dma: Dma::new(&REQUESTS, &[], true),
                served: 0,
            },
            slot,
        })
    }
}

impl Mcu for Chip {
    fn bus(&self) -> &Bus {
        self.mcu.bus()
    }

    fn bus_mut(&mut self) -> &mut Bus {
        self.mcu.bus_mut()
    }

    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        self.mcu.reset(at, cause);
        Device::reset(&mut self.dma2);
    }

    fn poll(&mut self, now: VirtualNanos) {
        self.mcu.poll(now);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if slot == self.slot {
            (self.mcu.bus_mut(), Some(&mut self.dma2))
        } else {
            self.mcu.split(slot)
        }
    }
}
