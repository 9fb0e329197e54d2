//! Checks of frames and link: messages arrive once and in order, or not at all, and a wrong bit
//! never becomes a message.

use crate::Check;
use crate::kinematics::subject::Sequence;
use haptimill_protocol::frame::{
    self, Acknowledgement, FrameBytes, FrameDecoder, Header, MAX_PAYLOAD,
};
use haptimill_protocol::link::{ControllerLink, HostLink, Identity, LinkState, Timing};
use haptimill_protocol::message::{Command, Event, Report, Request};
use haptimill_protocol::out_of_band::{STOP, StopDetector};
use heapless::Deque;

/// The checks of this module.
pub const CHECKS: &[Check] = &[
    Check {
        name: "link::frames_of_every_length_arrive_and_damaged_ones_do_not",
        run: frames,
    },
    Check {
        name: "link::a_stop_is_seen_wherever_it_comes_and_in_no_frame",
        run: stops,
    },
    Check {
        name: "link::messages_arrive_once_and_in_order_over_a_good_line",
        run: || exchange(0, 400),
    },
    Check {
        name: "link::messages_arrive_once_and_in_order_over_a_bad_line",
        run: || exchange(300, 400),
    },
];

fn filled(sequence: &mut Sequence, payload: &mut [u8]) {
    for byte in payload {
        // Many zeros, because COBS encodes zeros.
        *byte = match sequence.below(3) {
            0 => 0,
            _ => sequence.next() as u8,
        };
    }
}

fn frames() {
    let mut sequence = Sequence(21);
    let mut decoder = FrameDecoder::new();
    decoder.set_session(77);
    let mut room = [0; MAX_PAYLOAD];
    for length in 0..=MAX_PAYLOAD {
        let payload = &mut room[..length];
        filled(&mut sequence, payload);
        let header = Header::Reliable {
            sequence: length as u8,
            acknowledgement: Acknowledgement {
                next: sequence.next() as u8,
                beyond: sequence.next() as u8,
            },
        };
        let mut bytes = FrameBytes::new();
        frame::encode(header, payload, 77, &mut bytes).expect("fits");
        let bad = decoder.bad_frames();
        let mut received = 0;
        for &byte in &bytes {
            if let Some(frame) = decoder.push(byte) {
                assert_eq!(
                    (frame.header, frame.payload),
                    (header, &*payload),
                    "{length}"
                );
                received += 1;
            }
        }
        assert_eq!((received, decoder.bad_frames()), (1, bad), "{length}");
        // A frame with one wrong bit is never accepted.
        for _ in 0..8 {
            let place = sequence.below(bytes.len() as u64) as usize;
            let bit = sequence.below(8);
            for (index, &byte) in bytes.iter().enumerate() {
                let byte = byte ^ (u8::from(index == place) << bit);
                assert!(decoder.push(byte).is_none(), "{length}: {place} {bit}");
            }
            assert!(decoder.push(0).is_none());
        }
    }
}

fn stops() {
    let mut sequence = Sequence(22);
    let mut detector = StopDetector::new();
    let mut room = [0; 60];
    for round in 0..500 {
        let length = sequence.below(61) as usize;
        filled(&mut sequence, &mut room[..length]);
        let header = Header::Latest {
            sequence: round as u8,
            acknowledgement: Acknowledgement { next: 0, beyond: 0 },
        };
        let mut bytes = FrameBytes::new();
        frame::encode(header, &room[..length], 5, &mut bytes).expect("fits");
        assert!(!detector.push_all(&bytes), "{round}");
        // Within a frame as well as between two.
        let cut = sequence.below(bytes.len() as u64) as usize;
        detector.push_all(&bytes[..cut]);
        assert!(detector.push_all(&STOP), "{round} {cut}");
    }
}

/// One direction of a line that flips bits. It drops bytes when it is full.
struct Line {
    bytes: Deque<u8, 2048>,
    /// Wrong bits per million bits.
    errors: u64,
}

impl Line {
    const fn new(errors: u64) -> Self {
        Self {
            bytes: Deque::new(),
            errors,
        }
    }

    fn put(&mut self, sequence: &mut Sequence, bytes: &[u8]) {
        for &byte in bytes {
            let broken = sequence.below(1_000_000) < self.errors * 8;
            let byte = byte ^ (u8::from(broken) << sequence.below(8));
            // A byte that does not fit is lost, as on a line.
            let _ = self.bytes.push_back(byte);
        }
    }

    /// Slightly more than 115,200 baud carry in 200 us.
    fn take(&mut self, room: &mut [u8; 16]) -> usize {
        let mut count = 0;
        while let Some((slot, byte)) = room.get_mut(count).zip(self.bytes.front().copied()) {
            *slot = byte;
            self.bytes.pop_front();
            count += 1;
        }
        count
    }
}

/// Exchanges `count` numbered requests and events over lines with `errors` wrong bits per million.
fn exchange(errors: u64, count: u32) {
    let mut sequence = Sequence(23 + errors);
    let mut host = HostLink::new(Timing::default());
    let mut controller = ControllerLink::new(Timing::default());
    let (mut there, mut back) = (Line::new(errors), Line::new(errors));
    let identity = Identity {
        machine: "check",
        config_crc: 1,
        period_us: 200,
        axes: 5,
        queue: 256,
        kept: haptimill_protocol::message::Kept::Unsupported,
    };
    host.open(99, 0);
    let (mut sent, mut received, mut reports_sent, mut reports_received) = (0, 0, 0, 0);
    let mut now_us = 0;
    while received < count || reports_received < count {
        now_us += 200;
        assert!(
            now_us < 60_000_000,
            "{received} and {reports_received} of {count}"
        );
        let mut room = [0; 16];
        let mut out = [0; 128];
        let given = host.transmit(now_us, &mut out);
        there.put(&mut sequence, &out[..given]);
        let arrived = there.take(&mut room);
        controller.receive(now_us, &room[..arrived]);
        controller.welcome(now_us, &identity, false);
        let given = controller.transmit(now_us, &mut out);
        back.put(&mut sequence, &out[..given]);
        let arrived = back.take(&mut room);
        host.receive(now_us, &room[..arrived]);
        while let Some(request) = controller.poll_message() {
            let expected = Command::JobEnd { count: received };
            assert_eq!((request.id, request.command), (received as u8, expected));
            received += 1;
        }
        while let Some(report) = host.poll_message() {
            let event = Event::JobDone {
                job: reports_received,
                setpoints: !reports_received,
            };
            let period = u64::from(reports_received);
            assert_eq!(report, Report::Event { period, event });
            reports_received += 1;
        }
        if host.state(now_us) != LinkState::Open {
            continue;
        }
        let request = Request {
            id: sent as u8,
            command: Command::JobEnd { count: sent },
        };
        if sent < count && host.send(&request).is_ok() {
            sent += 1;
        }
        let event = Event::JobDone {
            job: reports_sent,
            setpoints: !reports_sent,
        };
        let period = u64::from(reports_sent);
        if reports_sent < count && controller.send(&Report::Event { period, event }).is_ok() {
            reports_sent += 1;
        }
    }
    let bad = host.counters().bad_frames + controller.counters().bad_frames;
    assert_eq!(bad > 0, errors > 0, "{bad} broken frames");
    // Nothing arrives twice.
    for _ in 0..2000 {
        now_us += 200;
        let mut out = [0; 128];
        let given = host.transmit(now_us, &mut out);
        controller.receive(now_us, &out[..given]);
        let given = controller.transmit(now_us, &mut out);
        host.receive(now_us, &out[..given]);
        assert!(controller.poll_message().is_none() && host.poll_message().is_none());
    }
}
