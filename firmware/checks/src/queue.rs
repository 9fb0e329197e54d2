//! Checks of the setpoint queue and the receive ring, full and empty.

use crate::Check;
use crate::reference::{h4, mm};
use haptimill_firmware::comm::rx_ring::ReceiveRing;
use haptimill_firmware::io::{Inputs, RECEIVE_BYTES};
use haptimill_firmware::motion::interpolator::{Interpolator, QUEUE};
use haptimill_kinematics::Pose;
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Action, Refusal};
use haptimill_protocol::out_of_band;
use haptimill_protocol::setpoint::Setpoint;

/// The checks of this module.
pub const CHECKS: &[Check] = &[
    Check {
        name: "queue::setpoints_are_taken_until_it_is_full_and_passed_in_order",
        run: setpoints,
    },
    Check {
        name: "queue::setpoints_that_come_too_late_are_waited_for_at_rest",
        run: underrunning,
    },
    Check {
        name: "queue::a_ring_that_overruns_loses_the_newest_and_no_stop",
        run: overrun,
    },
];

/// Segment duration, control periods.
const SPAN: u16 = 25;

/// The setpoint `number` of a line in x at 20 mm/s; `rest` ends it at standstill.
fn along(number: usize, rest: bool) -> Setpoint {
    let mut pose = [0; 5];
    // 25 periods of 200 us at 20 mm/s. To standstill it takes twice the time, because the mean of
    // 20 and 0 is half.
    pose[0] = mm(0.1) * number as i32;
    let mut rates = [0; 5];
    if !rest {
        rates[0] = mm(20.0) / 256;
    }
    Setpoint {
        periods: if rest || number == 1 { 2 * SPAN } else { SPAN },
        pose: pose.into_iter().collect(),
        rates: rates.into_iter().collect(),
        action: Action::None,
    }
}

fn setpoints() {
    let mut program = Interpolator::new(&h4());
    program.begin(&Pose::default());
    assert_eq!((program.credit(), program.queued()), (QUEUE as u32, 0));
    for number in 1..=QUEUE {
        assert_eq!(program.push(&along(number, false)), Ok(()), "{number}");
        assert_eq!(program.queued(), number);
        assert_eq!(program.credit(), QUEUE as u32);
    }
    // A refused setpoint changes nothing.
    let next = along(QUEUE + 1, false);
    assert_eq!(program.push(&next), Err(Refusal::QueueFull));
    assert_eq!(
        (program.queued(), program.accepted()),
        (QUEUE, QUEUE as u32)
    );
    let last = QUEUE + 41;
    let (mut number, mut x, mut reached) = (QUEUE + 1, 0, 0);
    for _ in 0..20_000 {
        let (commanded, progress) = program.advance(false);
        assert!(!progress.queue_empty);
        // Setpoints are reached in order and the motion continues.
        assert!(commanded.pose.0[0].0 >= x);
        x = commanded.pose.0[0].0;
        assert!(program.reached() - reached <= 1);
        reached = program.reached();
        assert_eq!(
            program.credit() - program.accepted(),
            (QUEUE - program.queued()) as u32
        );
        if number <= last && program.queued() < QUEUE {
            assert_eq!(program.push(&along(number, number == last)), Ok(()));
            number += 1;
            if number > last {
                assert_eq!(program.end(last as u32), Ok(()));
            }
        }
        if progress.finished {
            assert_eq!(x, along(last, true).pose[0]);
            assert_eq!((reached as usize, program.queued()), (last, 0));
            assert!(program.take_underrun().is_none());
            return;
        }
    }
    panic!("{reached} of {last}");
}

fn underrunning() {
    let mut program = Interpolator::new(&h4());
    program.begin(&Pose::default());
    let first = 60;
    for number in 1..=first {
        assert_eq!(program.push(&along(number, false)), Ok(()));
    }
    let mut x = 0;
    for _ in 0..6000 {
        let (commanded, progress) = program.advance(false);
        assert!(!progress.queue_empty);
        x = commanded.pose.0[0].0;
        assert!(
            x <= along(first, false).pose[0],
            "the last setpoint was passed"
        );
    }
    // Standstill before the end of the known path, and it reports the missing setpoint.
    assert!(program.is_at_standstill());
    assert_eq!(
        program.underrunning().map(|underrun| underrun.setpoint),
        Some(first as u32)
    );
    assert_eq!(program.push(&along(first + 1, true)), Ok(()));
    assert_eq!(program.end(first as u32 + 1), Ok(()));
    let underrun = program.take_underrun().map(|underrun| underrun.setpoint);
    assert_eq!(underrun, Some(first as u32));
    for _ in 0..6000 {
        let (commanded, progress) = program.advance(false);
        assert!(commanded.pose.0[0].0 >= x);
        x = commanded.pose.0[0].0;
        if progress.finished {
            assert_eq!(Coordinate(x), Coordinate(along(first + 1, true).pose[0]));
            return;
        }
    }
    panic!("it does not go on");
}

fn overrun() {
    let mut ring = ReceiveRing::<256>::new();
    let (mut receiver, mut waiting) = ring.split();
    let flood = |index: usize| (index % 23) as u8 + 40;
    (0..400).for_each(|index| receiver.push(flood(index)));
    out_of_band::STOP
        .iter()
        .for_each(|&byte| receiver.push(byte));
    assert_eq!((waiting.received_count(), waiting.peak()), (403, 255));
    let mut inputs = Inputs::default();
    let mut received = 0;
    for period in 0..4 {
        waiting.take(&mut inputs);
        for &byte in &inputs.received {
            assert_eq!(byte, flood(received));
            received += 1;
        }
        assert!(inputs.received.len() <= RECEIVE_BYTES);
        assert_eq!(inputs.out_of_band_stop, period == 0);
        assert_eq!(
            (usize::from(inputs.waiting), inputs.lost_bytes),
            (255 - received, 148)
        );
    }
    assert_eq!(received, 255);
    receiver.push(9);
    waiting.take(&mut inputs);
    assert_eq!(inputs.received.as_slice(), [9]);
}
