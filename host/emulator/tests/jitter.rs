//! When a control period begins, while the USB carries as much as it can: the record of the board,
//! and what the emulator sees of the processor.

mod common;

use common::{enabled, mill};
use haptimill_client::session::Homing;
use haptimill_protocol::message::Command;

/// Entry of SysTick in the vector table.
const SYSTICK: u32 = 0x1000_003C;
/// Bytes of its first instructions.
const FIRST: u32 = 16;
const PERIOD: u64 = 30_000;
/// Control periods without and with load.
const PERIODS: usize = 300;
/// Largest difference between the moments in their control periods at which two of them begin,
/// cycles: 0.2 us.
const JITTER: u32 = 30;
/// Cycles that the emulator runs between two looks at the processor, twice.
const LOOK: u32 = 4;

/// Difference of the largest and the smallest number.
fn spread(values: impl Iterator<Item = u32> + Clone) -> u32 {
    let min = values.clone().min().unwrap_or(0);
    values.max().unwrap_or(0) - min
}

/// A control period begins at its time also while the host floods the port with bytes and the board
/// sends a report in every period. The board measures it by the timer of the period; the emulator
/// looks at the address of the processor in every second cycle.
#[test]
fn control_periods_begin_in_time_under_usb_load() {
    let machine = mill();
    let mut session = enabled(&machine);
    let _homing = Homing::start(&mut session);
    session
        .ask(Command::Telemetry { every: 1 })
        .expect("the board reports");
    let mut junk = [0x55; 48];
    junk[47] = 0;
    let board = session.line_mut();
    let handler = board.chip().memory(SYSTICK) & !1;
    for is_loaded in [false, true] {
        let first = board.periods.len();
        let (mut entries, mut was_inside, mut sent) = (Vec::new(), false, 0);
        let start = board.cycles();
        for period in 0..PERIODS as u64 {
            if is_loaded {
                board.chip().receive(&junk);
            }
            while board.cycles() < start + (period + 1) * PERIOD {
                board.run_cycles(2).expect("the emulator runs");
                board.read_record();
                let is_inside = (handler..handler + FIRST).contains(&board.chip().address());
                if is_inside && !was_inside {
                    entries.push((board.cycles() % PERIOD) as u32);
                }
                was_inside = is_inside;
            }
            // Without a reader the board keeps its bytes.
            sent += board.chip().take_sent().len();
        }
        let periods = &board.periods[first..];
        let received: usize = periods.iter().map(|it| it.inputs.received.len()).sum();
        let late = periods.iter().map(|period| period.late);
        let (recorded, seen) = (spread(late), spread(entries.iter().copied()));
        println!(
            "{received} bytes received and {sent} sent in {PERIODS} control periods: a jitter of \
             {recorded} cycles, {:.3} us, by the board, and of {seen} by the emulator",
            f64::from(recorded) / 150.0,
        );
        assert!(entries.len().abs_diff(PERIODS) <= 1, "{}", entries.len());
        assert!(recorded <= JITTER, "{recorded} cycles");
        assert!(recorded.abs_diff(seen) <= LOOK, "{recorded}, {seen}");
        assert!(periods.iter().all(|period| period.inputs.missed == 0));
        assert!(sent >= 20 * PERIODS, "{sent}");
        if is_loaded {
            assert!(received >= 47 * PERIODS, "{received}");
        }
    }
}
