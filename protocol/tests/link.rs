//! Reliable messages arrive once and in order over any line, or the session ends; and the time that
//! they take.

mod line;

use haptimill_protocol::link::{
    ControllerLink, HelloOutcome, HostLink, Identity, LinkState, Timing,
};
use haptimill_protocol::message::{Command, ConfigChunk, Event, Report, Request};
use line::{Faults, Line, Random};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::fmt::Write;

const IDENTITY: Identity<'static> = Identity {
    machine: "test",
    config_crc: 0,
    period_us: 200,
    axes: 5,
    queue: 64,
    kept: haptimill_protocol::message::Kept::Unsupported,
};

/// Returns a request with its number; length and content depend on the number.
fn request(number: u32) -> Request {
    let mut random = Random::new(u64::from(number));
    let length = 40 + random.below(25);
    let bytes = (0..length).map(|_| random.bits() as u8).collect();
    Request {
        id: number as u8,
        command: Command::Configure(ConfigChunk {
            offset: number as u16,
            bytes,
        }),
    }
}

/// Returns a report with its number.
fn report(number: u32) -> Report {
    Report::Event {
        period: u64::from(number) * 0x1234_5678,
        event: Event::Underrun {
            setpoint: number,
            late_periods: !number,
        },
    }
}

/// Result of a transfer.
struct LinkResult {
    state: LinkState,
    /// One of the endpoints ended the session.
    ended: bool,
    /// Requests and reports that arrived.
    arrived: (u32, u32),
    micros: u64,
    resent: u32,
    bad_frames: u32,
    carried: usize,
}

/// Sends requests one way and reports the other, as fast as the links accept them, and checks every
/// message that arrives.
fn transfer(
    seed: u64,
    rate: u64,
    faults: Faults,
    requests: u32,
    reports: u32,
    limit_us: u64,
) -> LinkResult {
    let timing = Timing {
        line_rate: rate as u32,
        ..Timing::default()
    };
    let mut host = HostLink::new(timing);
    let mut controller = ControllerLink::new(timing);
    let mut out = Line::new(seed, rate, faults);
    let mut back = Line::new(!seed, rate, faults);
    let (mut sent, mut arrived) = ((0, 0), (0, 0));
    let mut buffer = [0; 64];
    host.open(seed as u32 | 1, 0);
    let (mut now_us, mut ended) = (0, false);
    while now_us < limit_us && arrived != (requests, reports) {
        now_us += 200;
        while sent.0 < requests && host.send(&request(sent.0)).is_ok() {
            sent.0 += 1;
        }
        let count = host.transmit(now_us, &mut buffer);
        out.send(now_us, &buffer[..count]);
        controller.receive(now_us, &out.take(now_us, 64));
        if let HelloOutcome::Refused(why) = controller.welcome(now_us, &IDENTITY, false) {
            panic!("refused: {why:?}");
        }
        // The controller takes one message per control period.
        if let Some(received) = controller.poll_message() {
            assert_eq!(
                received,
                request(arrived.0),
                "request {} at {now_us} us",
                arrived.0
            );
            arrived.0 += 1;
        }
        if sent.1 < reports && controller.send(&report(sent.1)).is_ok() {
            sent.1 += 1;
        }
        let count = controller.transmit(now_us, &mut buffer);
        back.send(now_us, &buffer[..count]);
        host.receive(now_us, &back.take(now_us, 64));
        while let Some(received) = host.poll_message() {
            assert_eq!(
                received,
                report(arrived.1),
                "report {} at {now_us} us",
                arrived.1
            );
            arrived.1 += 1;
        }
        // While the host still sends `Hello`, it cannot have noticed that the controller fell
        // silent.
        ended = host.session() != 0
            && [host.state(now_us), controller.state(now_us)]
                .iter()
                .any(|state| matches!(state, LinkState::Silent | LinkState::Stalled));
        if ended {
            break;
        }
    }
    LinkResult {
        state: host.state(now_us),
        ended,
        arrived,
        micros: now_us,
        resent: host.counters().resent,
        bad_frames: controller.counters().bad_frames,
        carried: out.carried,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, rng_seed: RngSeed::Fixed(4), ..ProptestConfig::default() })]

    /// No message is lost, doubled, out of order or changed: `transfer` checks each. On this line
    /// all of them arrive.
    #[test]
    fn reliable_messages_arrive_once_and_in_order(
        seed: u64,
        bit_error in prop_oneof![Just(0.0), Just(1e-5), Just(1e-4), Just(5e-4)],
        byte_loss in prop_oneof![Just(0.0), Just(1e-4), Just(1e-3)],
        frame in prop_oneof![Just(0.0), Just(0.02), Just(0.1)],
        rate in prop_oneof![Just(11_520u64), Just(200_000)],
    ) {
        let outcome = transfer(seed, rate, Faults { bit_error, byte_loss, frame }, 150, 100, 60_000_000);
        prop_assert_eq!(outcome.arrived, (150, 100), "{:?} after {} us", outcome.state, outcome.micros);
    }

    /// On the worst line, what arrives is right, and a session that cannot continue ends.
    #[test]
    fn messages_are_right_or_the_session_ends(seed: u64, bit_error in 1e-3..2e-2f64, byte_loss in 0.0..0.02f64, frame in 0.0..0.5f64) {
        let outcome = transfer(seed, 11_520, Faults { bit_error, byte_loss, frame }, 100, 60, 300_000_000);
        let ended = outcome.ended || outcome.state == LinkState::Opening;
        prop_assert!(outcome.arrived == (100, 60) || ended, "{:?} {:?} after {} us", outcome.state, outcome.arrived, outcome.micros);
    }
}

/// The line at 115,200 baud (11,520 bytes per second), 600 requests of 40 to 64 bytes one way and
/// 60 events the other.
#[test]
fn delivery_over_bad_lines() {
    let mut table = String::from(
        "bit errors   frame faults   delivered   goodput B/s   resent   bad frames   line use   end\n",
    );
    for (bit_error, frame) in [
        (0.0, 0.0),
        (1e-6, 0.0),
        (1e-5, 0.0),
        (1e-4, 0.0),
        (3e-4, 0.0),
        (1e-3, 0.0),
        (3e-3, 0.0),
        (1e-2, 0.0),
        (0.0, 0.01),
        (0.0, 0.05),
        (0.0, 0.2),
        (1e-4, 0.05),
    ] {
        let faults = Faults {
            bit_error,
            byte_loss: 0.0,
            frame,
        };
        let outcome = transfer(42, 11_520, faults, 600, 60, 120_000_000);
        let payload: usize = (0..outcome.arrived.0)
            .map(|number| match request(number).command {
                Command::Configure(chunk) => chunk.bytes.len(),
                _ => 0,
            })
            .sum();
        let seconds = outcome.micros as f64 * 1e-6;
        writeln!(
            table,
            "{:10.0e}   {:12.2}   {:5}/600   {:11.0}   {:6}   {:10}   {:7.0}%   {:?}",
            bit_error,
            frame,
            outcome.arrived.0,
            payload as f64 / seconds,
            outcome.resent,
            outcome.bad_frames,
            outcome.carried as f64 / seconds / 115.20,
            outcome.state,
        )
        .unwrap();
    }
    println!("{table}");
    insta::assert_snapshot!(table);
}
