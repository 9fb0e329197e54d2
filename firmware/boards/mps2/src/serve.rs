//! Main loop: one control period for every frame of the simulator, until the run ends.

use crate::semihosting::{File, Gone};
use crate::{serial, stack, tick};
use haptimill_firmware::pil::{FROM_BOARD_WORDS, FromBoardRef, Request, TO_BOARD_WORDS, read};
use haptimill_firmware::snapshot::Snapshot;

/// Polls of the receive ring before announced bytes are treated as lost.
const MAX_POLLS: u32 = 200_000_000;

/// Serves the simulator until the run ends.
///
/// # Errors
/// The simulator has ended.
///
/// # Panics
/// The simulator sends an invalid frame, or announced bytes do not arrive.
#[cold]
#[inline(never)]
pub fn serve() -> Result<(), Gone> {
    let mut to_simulator = File::writer(c"from-board")?;
    let mut from_simulator = File::reader(c"to-board")?;
    let mut frame = [0; TO_BOARD_WORDS];
    let mut answer = [0; FROM_BOARD_WORDS];
    let mut snapshot = Snapshot::default();
    FromBoardRef::Hello.write(&mut answer);
    to_simulator.write(&answer)?;
    let mut expected = 0_u32;
    loop {
        from_simulator.read(&mut frame)?;
        let request = tick::with(|period| read(&frame, &mut period.inputs));
        match request.unwrap_or(Ok(Request::End)) {
            Ok(Request::Begin { period_us }) => tick::begin(period_us),
            Ok(Request::Period { arrived }) => {
                expected = expected.wrapping_add(arrived);
                wait_for_bytes(expected);
                tick::run();
                #[cfg(feature = "faults")]
                crate::faults::reached(crate::faults::MAIN);
                tick::with(|period| {
                    serial::say(&period.outputs.transmit);
                    tick::report(period, &mut snapshot, &mut answer);
                });
                to_simulator.write(&answer)?;
            }
            Ok(Request::End) => {
                let ring_peak =
                    tick::with(|period| period.waiting.as_ref().map(|ring| ring.peak()));
                let mark = FromBoardRef::Ended {
                    stack_bytes: stack::used_bytes(),
                    ring_peak: ring_peak.flatten().unwrap_or(0),
                };
                mark.write(&mut answer);
                return to_simulator.write(&answer);
            }
            Err(error) => panic!("{error}"),
        }
    }
}

/// Waits until the receive interrupt has taken all bytes that the simulator put on the line.
fn wait_for_bytes(expected: u32) {
    let received_count = || {
        tick::with(|period| {
            period
                .waiting
                .as_ref()
                .map(|waiting| waiting.received_count())
        })
        .flatten()
        .unwrap_or(expected)
    };
    for _ in 0..MAX_POLLS {
        if received_count() == expected {
            return;
        }
    }
    panic!(
        "bytes of the host are missing: {} of {expected} came",
        received_count()
    );
}
