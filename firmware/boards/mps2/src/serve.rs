//! A control period for every frame of the simulator, until it says that the run is over.

use crate::semihosting::{File, Gone};
use crate::{serial, stack, tick};
use haptimill_firmware::lockstep::{FromBoard, TO_BOARD_BYTES, ToBoard};

/// Looks at the receive ring before bytes that were announced are given up.
const PATIENCE: u32 = 200_000_000;

/// Serves the simulator until it says that the run is over.
///
/// # Errors
/// The simulator has gone.
///
/// # Panics
/// The simulator says what makes no sense, or bytes that it announced do not come.
#[cold]
#[inline(never)]
pub fn serve() -> Result<(), Gone> {
    let mut to_simulator = File::writer(c"from-board")?;
    let mut from_simulator = File::reader(c"to-board")?;
    to_simulator.write(&FromBoard::Hello.encode())?;
    let mut expected = 0_u32;
    loop {
        let mut frame = [0; TO_BOARD_BYTES];
        from_simulator.read(&mut frame)?;
        match ToBoard::decode(&frame) {
            Ok(ToBoard::Begin { period_us }) => tick::begin(period_us),
            Ok(ToBoard::Period { inputs, arrived }) => {
                expected = expected.wrapping_add(arrived);
                tick::with(|period| period.inputs = inputs);
                wait_for_bytes(expected);
                tick::run();
                #[cfg(feature = "faults")]
                crate::faults::reached(crate::faults::MAIN);
                let done = tick::with(|period| {
                    serial::say(&period.outputs.transmit);
                    tick::done(period)
                });
                to_simulator.write(&FromBoard::Done(done.unwrap_or_default()).encode())?;
            }
            Ok(ToBoard::End) => {
                let ring_peak =
                    tick::with(|period| period.waiting.as_ref().map(|ring| ring.peak()));
                let ended = FromBoard::Ended {
                    stack_bytes: stack::used_bytes(),
                    ring_peak: ring_peak.flatten().unwrap_or(0),
                };
                return to_simulator.write(&ended.encode());
            }
            Err(error) => panic!("{error}"),
        }
    }
}

/// Waits until the receive interrupt has seen all bytes that the simulator put on the line.
fn wait_for_bytes(expected: u32) {
    let seen = || {
        tick::with(|period| period.waiting.as_ref().map(|waiting| waiting.seen()))
            .flatten()
            .unwrap_or(expected)
    };
    for _ in 0..PATIENCE {
        if seen() == expected {
            return;
        }
    }
    panic!(
        "bytes of the host are missing: {} of {expected} came",
        seen()
    );
}
