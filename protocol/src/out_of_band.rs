//! Out-of-band stop.
//!
//! The bytes `00 18 00` on the line request a stop in any state of the framing and with any number
//! of queued messages. A receive interrupt runs [`StopDetector`] on every byte as it arrives and
//! sets a flag. No frame contains these bytes: between two zeros, 18 (hexadecimal) would be a COBS
//! code that announces 23 more bytes. Bytes lost on the line may produce the pattern. The machine
//! then stops unnecessarily, along its path, with its position kept.
//!
//! No check protects the bytes, and they may be lost themselves. Callers must repeat them until a
//! stop is reported.

/// The code between the two zeros (CAN, "cancel").
pub const STOP_CODE: u8 = 0x18;

/// The bytes that request a stop.
pub const STOP: [u8; 3] = [0, STOP_CODE, 0];

/// Recognises [`STOP`] byte by byte. It has one byte of state, no loop and no branch on memory, and
/// suits a receive interrupt.
///
/// ```
/// use haptimill_protocol::out_of_band::StopDetector;
/// let mut detector = StopDetector::new();
/// let found: Vec<bool> = [7, 0, 0x18, 0, 0x18, 0].iter().map(|&b| detector.push(b)).collect();
/// assert_eq!(found, [false, false, false, true, false, true]);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StopDetector {
    /// Bytes of the pattern matched so far: 0, 1 or 2.
    seen: u8,
}

impl StopDetector {
    /// Creates a detector in its initial state.
    pub const fn new() -> Self {
        Self { seen: 0 }
    }

    /// Takes the next byte and returns true when it completes the pattern. The closing zero can
    /// open the next pattern.
    pub const fn push(&mut self, byte: u8) -> bool {
        let complete = self.seen == 2 && byte == 0;
        self.seen = match byte {
            0 => 1,
            STOP_CODE if self.seen == 1 => 2,
            _ => 0,
        };
        complete
    }

    /// Takes several bytes and returns true when they complete the pattern at least once.
    pub const fn push_all(&mut self, bytes: &[u8]) -> bool {
        let mut found = false;
        let mut rest = bytes;
        while let [byte, after @ ..] = rest {
            found |= self.push(*byte);
            rest = after;
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{self, Acknowledgement, FrameBytes, Header, MAX_PAYLOAD};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        /// No series of frames contains the pattern, and an out-of-band stop between frames is
        /// found at once.
        #[test]
        fn no_frame_is_a_stop(
            payloads in prop::collection::vec(
                prop::collection::vec(prop_oneof![Just(0u8), Just(STOP_CODE), Just(0x17), any::<u8>()], 0..MAX_PAYLOAD), 1..6),
            sequence: u8, next: u8, beyond: u8, session: u32, kind in 0..5,
        ) {
            let mut detector = StopDetector::new();
            let mut frame = FrameBytes::new();
            for payload in payloads {
                let acknowledgement = Acknowledgement { next, beyond };
                let header = match kind {
                    0 => Header::Hello,
                    1 => Header::Welcome,
                    2 => Header::Reliable { sequence, acknowledgement },
                    3 => Header::Latest { sequence, acknowledgement },
                    _ => Header::Acknowledge(acknowledgement),
                };
                frame::encode(header, &payload, session, &mut frame).unwrap();
                prop_assert!(!frame.iter().any(|&byte| detector.push(byte)));
                prop_assert_eq!(STOP.map(|byte| detector.push(byte)), [false, false, true]);
            }
        }

        /// The detector agrees with a search over the whole stream.
        #[test]
        fn finds_every_stop(bytes in prop::collection::vec(prop_oneof![Just(0u8), Just(STOP_CODE), any::<u8>()], 0..200)) {
            let mut detector = StopDetector::new();
            let mut together = StopDetector::new();
            let stops = bytes.windows(STOP.len()).any(|window| window == STOP);
            prop_assert_eq!(together.push_all(&bytes), stops);
            for end in 1..=bytes.len() {
                prop_assert_eq!(detector.push(bytes[end - 1]), bytes[..end].ends_with(&STOP));
            }
        }
    }
}
