//! Tests of frames: decoding returns what was encoded, and nothing else.

use super::*;
use proptest::prelude::*;
use std::vec::Vec as StdVec;

/// Any header.
fn header() -> impl Strategy<Value = Header> {
    (0..5, any::<u8>(), any::<u8>(), any::<u8>()).prop_map(|(kind, sequence, next, beyond)| {
        let acknowledgement = Acknowledgement { next, beyond };
        match kind {
            0 => Header::Hello,
            1 => Header::Welcome,
            2 => Header::Reliable {
                sequence,
                acknowledgement,
            },
            3 => Header::Latest {
                sequence,
                acknowledgement,
            },
            _ => Header::Acknowledge(acknowledgement),
        }
    })
}

/// Any payload, with many zeros and with lengths at which the COBS code changes.
fn payload() -> impl Strategy<Value = StdVec<u8>> {
    let length = prop_oneof![0..=MAX_PAYLOAD, 240..260usize];
    length
        .prop_flat_map(|n| prop::collection::vec(prop_oneof![3 => any::<u8>(), 1 => Just(0u8)], n))
}

/// All frames in a stream.
fn frames(decoder: &mut FrameDecoder, bytes: &[u8]) -> StdVec<(Header, StdVec<u8>)> {
    let mut found = StdVec::new();
    for &byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            found.push((frame.header, frame.payload.to_vec()));
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Comparison with the COBS encoding of another implementation.
    #[test]
    fn stuffed_as_others_do(header in header(), payload in payload(), session: u32) {
        let mut frame = FrameBytes::new();
        encode(header, &payload, session, &mut frame).unwrap();
        let mut content = [0; MAX_FRAME];
        let length = cobs::decode(&frame, &mut content).unwrap().frame_size();
        let mut again = [0; MAX_FRAME];
        let count = cobs::encode(&content[..length], &mut again);
        prop_assert_eq!(&frame[..frame.len() - 1], &again[..count]);
    }

    /// A frame read in pieces is the same for any sizes of the pieces, and every piece makes
    /// progress. A run without a zero cannot be sent before its end is known, at most 255 bytes of
    /// content later.
    #[test]
    fn made_in_pieces_it_is_the_same(
        header in header(), payload in payload(), session: u32, zero_first: bool,
        pieces in prop::collection::vec((1_usize..40, 1_usize..80), 1..20),
    ) {
        let mut whole = FrameBytes::new();
        encode(header, &payload, session, &mut whole).unwrap();
        let mut outgoing = OutgoingFrame::default();
        outgoing.begin(header, &payload, session, zero_first).unwrap();
        let (mut made, mut looked_at) = (StdVec::new(), 0);
        for (room, max) in pieces.iter().cycle() {
            if outgoing.is_gone() {
                break;
            }
            let mut buffer = [0xEE; 40];
            let count = outgoing.read(&mut buffer[..*room], *max);
            prop_assert!(count <= *room && buffer[count..].iter().all(|byte| *byte == 0xEE));
            made.extend_from_slice(&buffer[..count]);
            looked_at = if count == 0 { looked_at + max } else { 0 };
            prop_assert!(looked_at <= 255 + 80, "{looked_at} bytes looked at, and none went");
        }
        let front = usize::from(zero_first);
        prop_assert!(made[..front].iter().all(|byte| *byte == 0));
        prop_assert_eq!(&made[front..], &whole[..]);
    }

    #[test]
    fn round_trip_after_any_garbage(garbage in prop::collection::vec(any::<u8>(), 0..700), header in header(), payload in payload(), session: u32) {
        let mut frame = FrameBytes::new();
        encode(header, &payload, session, &mut frame).unwrap();
        prop_assert_eq!(frame.iter().filter(|&&b| b == 0).count(), 1);
        prop_assert_eq!(frame.last(), Some(&0));
        let mut decoder = FrameDecoder::new();
        decoder.set_session(session);
        frames(&mut decoder, &garbage);
        decoder.push(0);
        let bad = decoder.bad_frames();
        prop_assert_eq!(frames(&mut decoder, &frame), [(header, payload)]);
        prop_assert_eq!(decoder.bad_frames(), bad);
    }

    /// Up to three flipped bits never make a different frame (the CRC's distance is 4 up to 11 kB).
    /// COBS may spread a flip, so the test flips bits on the line and not in the content.
    #[test]
    fn flipped_bits_are_refused(header in header(), payload in payload(), flips in prop::collection::btree_set(0..8 * MAX_FRAME, 1..4)) {
        let mut frame = FrameBytes::new();
        encode(header, &payload, 5, &mut frame).unwrap();
        let bits = 8 * frame.len();
        for flip in flips {
            frame[(flip % bits) / 8] ^= 1 << (flip % 8);
        }
        let mut good = FrameBytes::new();
        encode(header, &payload, 5, &mut good).unwrap();
        prop_assume!(frame != good);
        let mut decoder = FrameDecoder::new();
        decoder.set_session(5);
        for found in frames(&mut decoder, &frame) {
            prop_assert_eq!(found, (header, payload.clone()));
        }
    }

    /// A frame of another session is ignored. A Hello is accepted in any session.
    #[test]
    fn sessions_do_not_hear_each_other(header in header(), payload in payload(), ours: u32, theirs: u32) {
        prop_assume!(ours != theirs);
        let mut frame = FrameBytes::new();
        encode(header, &payload, theirs, &mut frame).unwrap();
        let mut decoder = FrameDecoder::new();
        decoder.set_session(ours);
        let handshake = matches!(header, Header::Hello | Header::Welcome);
        prop_assert_eq!(frames(&mut decoder, &frame).len(), usize::from(handshake));
        prop_assert_eq!(decoder.bad_frames(), u32::from(!handshake));
    }
}

/// The keep-alive frame has three bytes and is accepted in its own session and not in session 0.
/// About one other session in 256 shares its byte.
#[test]
fn a_sign_of_life_takes_three_bytes_and_is_heard_in_its_session() {
    let mut heard_elsewhere = 0;
    for session in 1..5000 {
        let mut frame = FrameBytes::new();
        encode(Header::KeepAlive, b"not sent", session, &mut frame).unwrap();
        assert_eq!((frame.len(), frame.last()), (3, Some(&0)));
        let mut decoder = FrameDecoder::new();
        assert!(frames(&mut decoder, &frame).is_empty());
        assert_eq!(decoder.bad_frames(), 1);
        decoder.set_session(session);
        assert_eq!(
            frames(&mut decoder, &frame),
            [(Header::KeepAlive, StdVec::new())]
        );
        assert_eq!(decoder.bad_frames(), 1);
        decoder.set_session(session ^ 0x0400_0001);
        heard_elsewhere += frames(&mut decoder, &frame).len();
    }
    assert!(heard_elsewhere < 5000 / 64, "{heard_elsewhere}");
}

#[test]
fn check_value_is_the_standard_one() {
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
}

#[test]
fn out_of_band_stops_and_idle_zeros_are_no_bad_frames() {
    let mut decoder = FrameDecoder::new();
    assert!(frames(&mut decoder, &[0, 0, 0x18, 0, 0x18, 0, 0, 0]).is_empty());
    assert_eq!(decoder.bad_frames(), 0);
}

#[test]
fn too_long_is_refused_and_skipped_as_one() {
    let mut frame = FrameBytes::new();
    let long = [7; MAX_PAYLOAD + 1];
    assert_eq!(encode(Header::Hello, &long, 0, &mut frame), Err(TooLong));
    let mut decoder = FrameDecoder::new();
    let line: StdVec<u8> = core::iter::repeat_n(9, 5000).chain([0]).collect();
    assert!(frames(&mut decoder, &line).is_empty());
    assert_eq!(decoder.bad_frames(), 1);
    encode(Header::Hello, &long[1..], 0, &mut frame).unwrap();
    assert_eq!(frames(&mut decoder, &frame).len(), 1);
}
