//! Tests of the coding: it is exact for every setpoint, and compact for those of a planner.

use super::*;
use proptest::prelude::*;
use std::vec::Vec as StdVec;

/// Any setpoint of a number of axes, with many extreme values.
fn setpoint(axes: usize) -> impl Strategy<Value = Setpoint> {
    let value = || prop_oneof![any::<i32>(), -100..100i32, Just(i32::MIN), Just(i32::MAX)];
    let values = move || prop::collection::vec(value(), axes);
    (
        prop_oneof![1..=u16::MAX, 1..200u16, Just(u16::MAX)],
        values(),
        values(),
        0..3u8,
        any::<u16>(),
    )
        .prop_map(|(periods, pose, rates, kind, speed)| Setpoint {
            periods,
            pose: pose.into_iter().collect(),
            rates: rates.into_iter().collect(),
            action: [Action::None, Action::Pause, Action::Spindle(speed as i16)][usize::from(kind)],
        })
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn decoding_gives_back_every_bit(
        period_us in prop_oneof![1..=u16::MAX, Just(200)],
        (start, setpoints) in (0..=MAX_AXES).prop_flat_map(|axes| (
            prop::collection::vec(any::<i32>(), axes),
            prop::collection::vec(setpoint(axes), 1..20),
        )),
    ) {
        let mut encoder = SetpointCoder::new(period_us, &start.into_iter().collect());
        let mut decoder = encoder.clone();
        for setpoint in setpoints {
            let delta = encoder.encode(&setpoint).unwrap();
            let mut buffer = [0; 80];
            let bytes = postcard::to_slice(&delta, &mut buffer).unwrap();
            let delta: SetpointDelta = postcard::from_bytes(bytes).unwrap();
            prop_assert_eq!(decoder.decode(&delta).unwrap(), setpoint);
            prop_assert_eq!(&encoder, &decoder);
        }
    }

    /// Decoding of any delta returns a setpoint or an error and never panics. An error changes
    /// nothing.
    #[test]
    fn any_delta_is_decoded_or_refused(
        axes in 0..=MAX_AXES,
        deltas in prop::collection::vec((any::<u16>(), any::<u8>(), prop::collection::vec(any::<i32>(), 0..=2 * MAX_AXES)), 1..20),
    ) {
        let mut coder = SetpointCoder::new(200, &core::iter::repeat_n(i32::MAX, axes).collect());
        for (periods, moved, residuals) in deltas {
            let before = coder.clone();
            let delta = SetpointDelta { periods, moved, residuals: residuals.iter().copied().collect(), action: Action::None };
            let well = periods > 0 && u32::from(moved) >> axes == 0 && residuals.len() == 2 * moved.count_ones() as usize;
            prop_assert_eq!(coder.decode(&delta).is_ok(), well);
            if !well {
                prop_assert_eq!(&coder, &before);
            }
        }
    }
}

#[test]
fn wrong_setpoints_are_refused_and_change_nothing() {
    let mut coder = SetpointCoder::new(200, &[1, 2].into_iter().collect());
    let before = coder.clone();
    let good = Setpoint {
        periods: 1,
        pose: [1, 2].into_iter().collect(),
        rates: [0, 0].into_iter().collect(),
        action: Action::None,
    };
    let late = Setpoint {
        periods: 0,
        ..good.clone()
    };
    assert_eq!(coder.encode(&late), Err(SetpointError::NoTime));
    let short = Setpoint {
        rates: [0].into_iter().collect(),
        ..good
    };
    assert_eq!(coder.encode(&short), Err(SetpointError::CoordinateCount));
    assert_eq!(coder, before);
}

const PERIOD_US: u16 = 200;
const MM: f64 = 1048576.0;
const TURN: f64 = 4294967296.0;

/// The setpoints of a motion, every `periods`, from its coordinates over time (mm or turns) and
/// their scale.
fn sample(
    motion: &dyn Fn(f64) -> [f64; 5],
    scales: [f64; 5],
    duration: f64,
    periods: u16,
) -> StdVec<Setpoint> {
    let step = f64::from(periods) * f64::from(PERIOD_US) * 1e-6;
    let count = (duration / step) as usize;
    let rates = |t: f64| {
        let (e, mut r) = (1e-4, [0.0; 5]);
        let (a, b, c, d) = (
            motion(t - 2.0 * e),
            motion(t - e),
            motion(t + e),
            motion(t + 2.0 * e),
        );
        for k in 0..5 {
            r[k] = (a[k] - 8.0 * b[k] + 8.0 * c[k] - d[k]) / (12.0 * e);
        }
        r
    };
    (0..=count)
        .map(|n| {
            let t = n as f64 * step;
            let (pose, rate) = (motion(t), rates(t));
            Setpoint {
                periods,
                pose: (0..5)
                    .map(|k| (pose[k] * scales[k]).round() as i64 as i32)
                    .collect(),
                rates: (0..5)
                    .map(|k| (rate[k] * scales[k] / 256.0).round() as i32)
                    .collect(),
                action: Action::None,
            }
        })
        .collect()
}

/// Bytes on the line per setpoint, including framing, request and batch but no acknowledgements.
fn line_bytes(setpoints: &[Setpoint]) -> f64 {
    use crate::frame::{self, Acknowledgement, FrameBytes, Header};
    use crate::message::{Command, Request, SetpointBatch};
    let mut coder = SetpointCoder::new(PERIOD_US, &setpoints[0].pose);
    let (mut bytes, mut frame) = (0, FrameBytes::new());
    for (index, batch) in setpoints[1..].chunks(SETPOINT_BATCH).enumerate() {
        let items = batch
            .iter()
            .map(|setpoint| coder.encode(setpoint).unwrap())
            .collect();
        let first = (index * SETPOINT_BATCH) as u32;
        let request = Request {
            id: 0,
            command: Command::Setpoints(SetpointBatch { first, items }),
        };
        let mut buffer = [0; frame::MAX_PAYLOAD];
        let payload = postcard::to_slice(&request, &mut buffer).unwrap();
        let acknowledgement = Acknowledgement { next: 7, beyond: 0 };
        frame::encode(
            Header::Reliable {
                sequence: 9,
                acknowledgement,
            },
            payload,
            77,
            &mut frame,
        )
        .unwrap();
        bytes += frame.len();
    }
    bytes as f64 / (setpoints.len() - 1) as f64
}

/// The target is 24 bytes for a pocket and 40 for full motion of five axes, framing included.
#[test]
fn wire_cost() {
    let linear = [MM, MM, MM, TURN, TURN];
    // A pocket: a 15 mm circle at 4 mm/s and the long side of a rectangle with a smooth start
    // (quintic), both with two axes at standstill.
    let circle = |t: f64| {
        let w = 4.0 / 15.0 * t;
        [15.0 * w.cos(), 15.0 * w.sin(), -2.0 - 0.05 * t, 0.1, -0.2]
    };
    // Minimum-jerk strokes of 8 mm back and forth, 2.5 s each: large acceleration all the time,
    // jerk up to 30 mm/s^3.
    let strokes = |t: f64| {
        let (n, s) = ((t / 2.5).floor(), (t / 2.5).fract());
        let part = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
        let x = 8.0
            * if n.rem_euclid(2.0) == 0.0 {
                part
            } else {
                1.0 - part
            };
        [x, 0.4 * x + 3.0, -2.0, 0.1, -0.2]
    };
    // Full motion of five axes: a sphere is milled at 25 mm/s while tool tilt and table move.
    let sphere = |t: f64| {
        let w = 25.0 / 40.0 * t;
        [
            40.0 * w.cos(),
            30.0 * (1.1 * w).sin(),
            10.0 * (2.3 * w).sin(),
            0.08 * (0.7 * w).sin(),
            0.3 * w + 0.02 * (3.0 * w).sin(),
        ]
    };
    let figures = [
        (
            "circle r 15 mm, 4 mm/s, 3 axes",
            line_bytes(&sample(&circle, linear, 20.0, 100)),
            24.0,
        ),
        (
            "strokes 8 mm in 2.5 s, 2 axes",
            line_bytes(&sample(&strokes, linear, 20.0, 100)),
            24.0,
        ),
        (
            "five axes, 25 mm/s",
            line_bytes(&sample(&sphere, linear, 20.0, 100)),
            40.0,
        ),
        (
            "five axes, 25 mm/s, every 5 ms",
            line_bytes(&sample(&sphere, linear, 20.0, 25)),
            40.0,
        ),
    ];
    for (name, bytes, limit) in figures {
        std::println!("{name:36} {bytes:5.1} bytes a setpoint on the line, at most {limit}");
        assert!(bytes <= limit, "{name}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(4), failure_persistence: None, ..ProptestConfig::default() })]

    /// A batch read one setpoint at a time equals the whole batch. A truncated batch ends at its
    /// last complete setpoint.
    #[test]
    fn a_batch_is_the_sum_of_its_setpoints(
        id: u8, first: u32,
        items in prop::collection::vec((1..=u16::MAX, 0u8..64, any::<[i32; 12]>(), any::<i16>()), 0..=SETPOINT_BATCH),
        cut: prop::sample::Index,
    ) {
        let items: StdVec<SetpointDelta> = items
            .into_iter()
            .map(|(periods, moved, residuals, speed)| SetpointDelta {
                periods,
                moved,
                residuals: residuals.into_iter().take(2 * moved.count_ones() as usize).collect(),
                action: if speed < 0 { Action::None } else { Action::Spindle(speed) },
            })
            .collect();
        let batch = crate::message::SetpointBatch { first, items: items.iter().cloned().collect() };
        let request = crate::message::Request { id, command: crate::message::Command::Setpoints(batch) };
        let mut buffer = [0; 400];
        let payload = postcard::to_slice(&request, &mut buffer).unwrap();
        prop_assert!(BatchReader::fits(payload));
        let mut reader = BatchReader::open(payload).unwrap();
        prop_assert_eq!((reader.id, usize::from(reader.left)), (id, items.len()));
        let start = SetpointCoder::new(200, &[1, 20, 300, 4_000, 50_000, 600_000].into_iter().collect());
        let (mut coder, mut whole) = (start.clone(), start.clone());
        let mut setpoint = Setpoint::default();
        for (index, item) in items.iter().enumerate() {
            prop_assert_eq!(reader.number, first.wrapping_add(index as u32));
            let before = coder.clone();
            prop_assert!(reader.next(payload, &coder, &mut setpoint));
            prop_assert_eq!(&coder, &before);
            prop_assert_eq!(&setpoint, &whole.decode(item).unwrap());
            coder.take(&setpoint);
            prop_assert_eq!(&coder, &whole);
        }
        prop_assert!(!reader.next(payload, &coder, &mut setpoint));
        let part = &payload[..cut.index(payload.len())];
        if let Some(mut reader) = BatchReader::open(part) {
            let read = core::iter::repeat_with(|| reader.next(part, &start, &mut setpoint)).take_while(|&read| read).count();
            prop_assert!(read < items.len());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(5), failure_persistence: None, ..ProptestConfig::default() })]

    /// For any bytes, a number is the one that postcard reads.
    #[test]
    fn numbers_are_those_of_postcard(bytes in prop::collection::vec(prop_oneof![any::<u8>(), 0x80u8..], 0..8)) {
        let mut rest = bytes.as_slice();
        let read = number(&mut rest);
        match postcard::take_from_bytes::<u32>(&bytes) {
            Ok((value, left)) => prop_assert_eq!((read, rest), (Some(value), left)),
            Err(_) => prop_assert_eq!(read, None),
        }
    }

    /// Divisions of one word give the same result as one division of two words.
    #[test]
    fn quotients_are_exact(micros in 0..=5_000_000_u64, last in 0..=5_000_000_u64) {
        let (span, last) = (Span::new(micros), Span::new(last));
        let time = (((micros as i64) << 18) / 15_625).clamp(SHORTEST, LONGEST);
        prop_assert_eq!(span, Span { time, reciprocal: (1 << 40) / time });
        if span.time < 16 * last.time {
            let ratio = quotient(span.time as u32, last.time as u32, 16);
            prop_assert_eq!(i64::from(ratio), (span.time << 16) / last.time);
        }
    }
}

/// No other request is mistaken for a batch.
#[test]
fn only_a_batch_is_taken_apart() {
    let mut buffer = [0; 400];
    for command in [
        crate::message::Command::Ping,
        crate::message::Command::Status,
        crate::message::Command::Hold,
    ] {
        let request = crate::message::Request { id: 0, command };
        let payload = postcard::to_slice(&request, &mut buffer).unwrap();
        assert!(!BatchReader::fits(payload) && BatchReader::open(payload).is_none());
    }
}
