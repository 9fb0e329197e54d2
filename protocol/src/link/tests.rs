//! Tests of sessions, keep-alive and memory. `tests/link.rs` tests messages on a bad line.

use super::*;
use crate::frame::{self, FrameBytes, FrameDecoder, Header};
use crate::message::{
    Command, ConfigChunk, Hello, HelloRefusal, PROTOCOL_VERSION, Report, Request, State, Telemetry,
    Welcome,
};
use crate::schema::schema_hash;
use std::vec::Vec as StdVec;

const IDENTITY: Identity<'static> = Identity {
    machine: "H4 arm",
    config_crc: 99,
    period_us: 200,
    axes: 5,
    queue: 64,
    kept: crate::message::Kept::Unsupported,
};

/// Both endpoints and the time, on a line without faults.
struct Pair {
    host: HostLink,
    controller: ControllerLink,
    now_us: u64,
    busy: bool,
    outcomes: StdVec<HelloOutcome>,
}

impl Pair {
    fn new() -> Self {
        Self {
            host: HostLink::new(Timing::default()),
            controller: ControllerLink::new(Timing::default()),
            now_us: 0,
            busy: false,
            outcomes: StdVec::new(),
        }
    }

    fn open(session: u32) -> Self {
        let mut pair = Self::new();
        pair.host.open(session, 0);
        pair.run(1000);
        assert_eq!(pair.host.state(pair.now_us), LinkState::Open);
        pair
    }

    fn run(&mut self, micros: u64) {
        let mut buffer = [0; 64];
        for _ in 0..micros / 200 {
            self.now_us += 200;
            let count = self.host.transmit(self.now_us, &mut buffer);
            self.controller.receive(self.now_us, &buffer[..count]);
            match self.controller.welcome(self.now_us, &IDENTITY, self.busy) {
                HelloOutcome::Nothing => {}
                outcomes => self.outcomes.push(outcomes),
            }
            let count = self.controller.transmit(self.now_us, &mut buffer);
            self.host.receive(self.now_us, &buffer[..count]);
        }
    }
}

fn ping(id: u8) -> Request {
    Request {
        id,
        command: Command::Ping,
    }
}

#[test]
fn the_welcome_tells_who_is_there() {
    let pair = Pair::open(77);
    let peer = pair.host.peer().unwrap();
    assert_eq!(
        (peer.machine.as_str(), peer.config_crc, peer.session),
        ("H4 arm", 99, 77)
    );
    assert_eq!((peer.period_us, peer.axes, peer.queue), (200, 5, 64));
    assert_eq!(pair.outcomes, [HelloOutcome::Begun]);
    assert_eq!((pair.host.session(), pair.controller.session()), (77, 77));
}

#[test]
fn a_host_greets_until_it_is_answered() {
    let mut host = HostLink::new(Timing::default());
    host.open(1, 0);
    let (mut decoder, mut buffer, mut hellos) = (FrameDecoder::new(), [0; 64], 0);
    for now_us in (0..1_000_000).step_by(1000) {
        let count = host.transmit(now_us, &mut buffer);
        for &byte in &buffer[..count] {
            hellos += usize::from(
                decoder
                    .push(byte)
                    .is_some_and(|frame| frame.header == Header::Hello),
            );
        }
        assert_eq!(host.state(now_us), LinkState::Opening);
        assert_eq!(host.send(&ping(1)), Err(SendError::NotOpen));
    }
    assert_eq!(hellos, 10);
}

#[test]
fn a_busy_controller_keeps_its_session() {
    let mut pair = Pair::open(1);
    pair.host.send(&ping(1)).unwrap();
    pair.run(1000);
    // A second host on the same line.
    let mut other = HostLink::new(Timing::default());
    other.open(2, pair.now_us);
    let mut buffer = [0; 64];
    let count = other.transmit(pair.now_us, &mut buffer);
    pair.controller.receive(pair.now_us, &buffer[..count]);
    assert_eq!(
        pair.controller.welcome(pair.now_us, &IDENTITY, true),
        HelloOutcome::Refused(HelloRefusal::Busy)
    );
    let count = pair.controller.transmit(pair.now_us, &mut buffer);
    other.receive(pair.now_us, &buffer[..count]);
    assert_eq!(
        other.state(pair.now_us),
        LinkState::Refused(HelloRefusal::Busy)
    );
    assert_eq!(pair.controller.poll_message(), Some(ping(1)));
    pair.busy = true;
    pair.host.send(&ping(2)).unwrap();
    pair.run(10_000);
    assert_eq!(pair.controller.poll_message(), Some(ping(2)));
    assert_eq!(pair.host.state(pair.now_us), LinkState::Open);
}

#[test]
fn a_new_session_forgets_the_old_one_and_an_ended_one_does_not_come_back() {
    let mut pair = Pair::open(1);
    for id in 1..=5 {
        pair.host.send(&ping(id)).unwrap();
    }
    pair.run(2000);
    pair.host.open(2, pair.now_us);
    pair.run(2000);
    assert_eq!(pair.outcomes, [HelloOutcome::Begun, HelloOutcome::Begun]);
    assert_eq!(pair.controller.poll_message(), None);
    pair.host.send(&ping(9)).unwrap();
    pair.run(2000);
    assert_eq!(pair.controller.poll_message(), Some(ping(9)));
    // A delayed Hello of session 1.
    let mut frame = FrameBytes::new();
    let hello = Hello {
        version: PROTOCOL_VERSION,
        schema: schema_hash(),
        session: 1,
    };
    let mut buffer = [0; 64];
    let payload = postcard::to_slice(&hello, &mut buffer).unwrap();
    frame::encode(Header::Hello, payload, 0, &mut frame).unwrap();
    pair.controller.receive(pair.now_us, &frame);
    assert!(pair.controller.hello().is_none());
}

#[test]
fn other_versions_and_schemas_are_refused_by_both_ends() {
    for (version, schema, why) in [
        (PROTOCOL_VERSION + 1, schema_hash(), HelloRefusal::Version),
        (PROTOCOL_VERSION, schema_hash() ^ 1, HelloRefusal::Schema),
    ] {
        let (mut buffer, mut frame) = ([0; 128], FrameBytes::new());
        let hello = Hello {
            version,
            schema,
            session: 5,
        };
        let payload = postcard::to_slice(&hello, &mut buffer).unwrap();
        frame::encode(Header::Hello, payload, 0, &mut frame).unwrap();
        let mut controller = ControllerLink::new(Timing::default());
        controller.receive(0, &frame);
        assert_eq!(
            controller.welcome(0, &IDENTITY, false),
            HelloOutcome::Refused(why)
        );
        assert_eq!(controller.state(0), LinkState::Closed);

        let mut host = HostLink::new(Timing::default());
        host.open(5, 0);
        let welcome = Welcome {
            version,
            schema,
            session: 5,
            refused: None,
            machine: heapless::String::new(),
            config_crc: 0,
            period_us: 200,
            axes: 0,
            queue: 0,
            kept: crate::message::Kept::Unsupported,
        };
        let payload = postcard::to_slice(&welcome, &mut buffer).unwrap();
        frame::encode(Header::Welcome, payload, 0, &mut frame).unwrap();
        host.receive(0, &frame);
        assert_eq!(host.state(0), LinkState::Refused(why));
    }
}

#[test]
fn an_end_with_nothing_to_say_costs_sixty_bytes_a_second() {
    let mut pair = Pair::open(3);
    pair.run(100_000);
    let before = pair.host.counters();
    pair.run(1_500_000);
    let after = pair.host.counters();
    let frames = after.frames_sent - before.frames_sent;
    assert!((20..=22).contains(&frames), "{frames}");
    assert_eq!(after.bytes_sent - before.bytes_sent, 4 * frames);
    assert_eq!(pair.controller.counters().bad_frames, 0);
    // An acknowledgement is sent at once and does not wait for the next keep-alive frame.
    pair.controller
        .send(&Report::Answer {
            id: 1,
            result: Ok(()),
        })
        .unwrap();
    pair.run(10_000);
    assert_eq!(pair.controller.under_way(), 0);
}

#[test]
fn a_living_end_is_never_silent_for_long() {
    let mut pair = Pair::open(3);
    let limit = u64::from(Timing::default().keep_alive_us) + 2_000;
    for _ in 0..1000 {
        pair.run(400);
        assert!(pair.host.peer_silent_us(pair.now_us) <= limit);
        assert!(pair.controller.peer_silent_us(pair.now_us) <= limit);
    }
    let silent_from = pair.now_us;
    assert_eq!(pair.host.state(silent_from + 2_000_000), LinkState::Silent);
}

#[test]
fn a_full_inbox_holds_messages_back_and_loses_none() {
    let mut pair = Pair::open(4);
    let chunk = crate::message::ConfigChunk {
        offset: 0,
        bytes: [7; crate::message::CONFIG_CHUNK].into_iter().collect(),
    };
    let (mut sent, mut received) = (0u8, 0u8);
    for step in 0..20_000 {
        let request = Request {
            id: sent,
            command: Command::Configure(chunk.clone()),
        };
        if sent < 200 && pair.host.send(&request).is_ok() {
            sent += 1;
        }
        pair.run(200);
        // A controller that receives every 10 ms only.
        if step % 50 == 0
            && let Some(request) = pair.controller.poll_message()
        {
            assert_eq!(request.id, received);
            received += 1;
        }
    }
    assert_eq!((sent, received), (200, 200));
    assert!(pair.controller.counters().no_room > 0);
}

fn telemetry(period: u64) -> Report {
    Report::Telemetry(Telemetry {
        period,
        state: State::Idle,
        ..Telemetry::default()
    })
}

#[test]
fn only_newer_latest_values_are_heard() {
    let mut pair = Pair::open(5);
    let (mut frames, mut buffer) = (StdVec::new(), [0; 400]);
    for period in 0..3 {
        pair.controller.send_latest(&telemetry(period)).unwrap();
        let count = pair.controller.transmit(pair.now_us, &mut buffer);
        frames.push(buffer[..count].to_vec());
    }
    for index in [0, 2, 1, 2] {
        pair.host.receive(pair.now_us, &frames[index]);
    }
    let received: StdVec<_> = core::iter::from_fn(|| pair.host.poll_message()).collect();
    assert_eq!(received, [telemetry(0), telemetry(2)]);
}

/// Any number of last-value messages may be lost: their sequence numbers wrap around.
#[test]
fn latest_values_are_heard_again_after_an_outage() {
    for lost in 0..600 {
        let mut pair = Pair::open(5);
        let mut buffer = [0; 400];
        for period in 0..lost + 20 {
            pair.controller.send_latest(&telemetry(period)).unwrap();
            let count = pair.controller.transmit(pair.now_us, &mut buffer);
            if !(1..=lost).contains(&period) {
                pair.host.receive(pair.now_us, &buffer[..count]);
            }
        }
        let received: StdVec<_> = core::iter::from_fn(|| pair.host.poll_message()).collect();
        let again = received
            .iter()
            .filter(|report| **report != telemetry(0))
            .count();
        assert!(again >= 19 - 16, "{again} of 19 after {lost} were lost");
    }
}

#[test]
fn memory_is_what_the_documentation_says() {
    let (controller, host) = (size_of::<ControllerLink>(), size_of::<HostLink>());
    std::println!("controller {controller} bytes, host {host} bytes");
    assert!(controller <= 3 * 1024, "{controller}");
    assert!(host <= 8300, "{host}");
}

#[test]
fn the_line_is_not_filled_faster_than_it_carries() {
    let timing = Timing {
        line_rate: 11_520,
        ..Timing::default()
    };
    let mut pair = Pair::new();
    pair.host = HostLink::new(timing);
    pair.host.open(1, 0);
    pair.run(10_000);
    let (mut bytes, mut buffer) = (0, [0; 64]);
    for step in 0..5000u64 {
        let now_us = pair.now_us + step * 200;
        let _ = pair.host.send(&ping(1));
        bytes += pair.host.transmit(now_us, &mut buffer);
    }
    // One second of resent and new frames: never above the line rate, except for what may be filled
    // ahead.
    assert!(bytes <= 11_520 + 60, "{bytes}");
}

/// Flow control: a host that sends faster than the controller takes is blocked by delayed
/// acknowledgements. Nothing is resent because the receiver is full, and the controller always has
/// a message to take.
#[test]
fn who_says_more_than_is_taken_waits() {
    for bytes in [20, 40, 50, 64] {
        let mut pair = Pair::open(1);
        let chunk = ConfigChunk {
            offset: 0,
            bytes: core::iter::repeat_n(7, bytes).collect(),
        };
        let request = Request {
            id: 0,
            command: Command::Configure(chunk),
        };
        let (mut taken, mut missed) = (0, 0);
        // The time that four setpoints take.
        for period in 0..10_000 {
            while pair.host.under_way() < 4 {
                pair.host.send(&request).unwrap();
            }
            pair.run(200);
            if period % 14 == 13 {
                match pair.controller.peek() {
                    Some(_) => taken += 1,
                    None => missed += 1,
                }
                pair.controller.drop_first();
            }
        }
        let (host, controller) = (pair.host.counters(), pair.controller.counters());
        assert_eq!((host.resent, controller.no_room), (0, 0), "{bytes} bytes");
        assert!(taken > 700 && missed <= 1, "{taken}, {missed}");
    }
}
