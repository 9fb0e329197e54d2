//! Start order and end of a run, the same for every image of this board.

use crate::semihosting::Gone;
use crate::{counter, ending, semihosting, serial, serve, tick};
use cortex_m::singleton;
use haptimill_firmware::comm::rx_ring::ReceiveRing;

/// Baud rate of the host's line. The emulator ignores it; the simulator paces the bytes.
const BAUD: u32 = 1_000_000;

/// Runs the board; the image's entry calls it once.
pub fn run() -> ! {
    let (Some(mut core), Some(ring)) = (
        cortex_m::Peripherals::take(),
        singleton!(: ReceiveRing<{ serial::RING }> = ReceiveRing::new()),
    ) else {
        semihosting::exit(ending::PANIC);
    };
    ending::watch(&mut core.SCB, &mut core.MPU);
    counter::start();
    #[cfg(feature = "defmt")]
    crate::log::start();
    #[cfg(feature = "faults")]
    crate::faults::read();
    tick::start(&mut core.SCB, serial::start(ring, &mut core.NVIC, BAUD));
    match serve::serve() {
        Ok(()) => semihosting::exit(0),
        Err(Gone) => ending::end(ending::GONE, format_args!("the simulator has gone")),
    }
}
