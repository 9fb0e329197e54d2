//! Quadrature decoder and encoder against a true motion.

use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::JointInputs;
use haptimill_firmware::joint::encoder::Encoder;
use haptimill_firmware::joint::quadrature::Quadrature;
use haptimill_math::Coordinate;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Levels of A and B at a place, in counts: A leads B going up.
fn levels(place: i64) -> (bool, bool) {
    match place.rem_euclid(4) {
        0 => (false, false),
        1 => (true, false),
        2 => (true, true),
        _ => (false, true),
    }
}

/// Axis units a count, Q24, of a 10 mm screw with 8000 counts a turn: 1310.72.
const PER_COUNT: i64 = 21_990_232_556;

/// An encoder on a true motion, in counts, sampled finely enough that no edge is missed.
struct Rig {
    decoder: Quadrature,
    place: i64,
    inputs: JointInputs,
}

impl Rig {
    fn at(place: f64) -> Self {
        let place = place.floor() as i64;
        let mut decoder = Quadrature::new(0);
        let (a, b) = levels(place);
        decoder.feed(a, b, false, 0);
        Self {
            decoder,
            place,
            inputs: JointInputs::default(),
        }
    }

    /// Edges on the way to `position`, each at its own time, on a clock of 100 ns.
    fn run(&mut self, motion: impl Fn(f64) -> f64, from_ns: u64, to_ns: u64) -> &JointInputs {
        let fine = 100;
        for time in (from_ns..=to_ns).step_by(fine) {
            let place = motion(time as f64 * 1e-9).floor() as i64;
            while self.place != place {
                self.place += (place - self.place).signum();
                let (a, b) = levels(self.place);
                self.decoder.feed(a, b, false, time as u32);
            }
        }
        self.decoder.latch(&mut self.inputs);
        &self.inputs
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(2), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn legal_transitions_are_counted_exactly(start: i32, path in prop::collection::vec(-1i64..=1, 0..400)) {
        let mut decoder = Quadrature::new(start);
        let mut place = 0;
        let (a, b) = levels(place);
        decoder.feed(a, b, false, 0);
        for (time, step) in path.into_iter().enumerate() {
            place += step;
            let (a, b) = levels(place);
            decoder.feed(a, b, false, time as u32);
            prop_assert_eq!(decoder.counts(), start.wrapping_add(place as i32));
        }
        prop_assert_eq!(decoder.illegal(), 0);
    }

    #[test]
    fn illegal_transitions_are_counted_and_do_not_move(path in prop::collection::vec(0u8..4, 1..300)) {
        let mut decoder = Quadrature::new(7);
        let (mut before, mut illegal) = (None, 0u16);
        for (time, state) in path.into_iter().enumerate() {
            let counts = decoder.counts();
            decoder.feed(state & 2 != 0, state & 1 != 0, false, time as u32);
            let changed = before.map_or(0, |before: u8| (before ^ state).count_ones());
            if changed == 2 {
                illegal += 1;
            }
            prop_assert_eq!(decoder.illegal(), illegal);
            prop_assert_eq!((decoder.counts() - counts).unsigned_abs(), u32::from(changed == 1));
            before = Some(state);
        }
    }

    #[test]
    fn coordinate_is_the_exact_product_across_wrap_around(
        start: i32,
        per_count in -(1i64 << 40)..(1i64 << 40),
        moves in prop::collection::vec(any::<i32>(), 1..60),
        reference: i32,
    ) {
        for kind in [AxisKind::Linear, AxisKind::Rotary, AxisKind::MultiTurn] {
            let mut encoder = Encoder::new(kind, per_count);
            let mut inputs = JointInputs { counts: start, ..JointInputs::default() };
            encoder.read(&inputs, 0);
            encoder.set_reference(start, Coordinate(reference));
            let mut total = 0i128;
            for (period, &step) in moves.iter().enumerate() {
                inputs.counts = inputs.counts.wrapping_add(step);
                inputs.edge_time_ns = inputs.edge_time_ns.wrapping_add(7);
                total += i128::from(step);
                let measured = encoder.read(&inputs, period as u32 * 200_000);
                let exact = ((total * i128::from(per_count) + (1 << 23)) >> 24) + i128::from(reference);
                let exact = match kind {
                    AxisKind::Linear | AxisKind::MultiTurn => exact.clamp(i32::MIN.into(), i32::MAX.into()) as i32,
                    AxisKind::Rotary => exact as i32,
                };
                prop_assert_eq!(measured.coordinate.0, exact);
                prop_assert_eq!(measured.moved, step);
            }
        }
    }

    #[test]
    fn nothing_overflows(
        per_count: i64,
        frames in prop::collection::vec(any::<(i32, u32, u16, i32, u8, u32)>(), 1..50),
        reference: (i32, i32),
    ) {
        for kind in [AxisKind::Linear, AxisKind::Rotary, AxisKind::MultiTurn] {
            let mut encoder = Encoder::new(kind, per_count);
            for &(counts, edge_time_ns, illegal, index_counts, index_pulses, time) in &frames {
                let inputs = JointInputs { counts, edge_time_ns, illegal, index_counts, index_pulses, ..JointInputs::default() };
                encoder.read(&inputs, time);
                encoder.set_reference(reference.0, Coordinate(reference.1));
            }
        }
    }

    #[test]
    fn constant_rate_is_measured_at_any_phase(rate_mm_s in prop_oneof![0.02f64..1.0, 1.0..60.0], phase in 0.0f64..1.0, backwards: bool) {
        let rate_mm_s = if backwards { -rate_mm_s } else { rate_mm_s };
        let counts_per_s = rate_mm_s / 0.00125;
        let motion = |time: f64| phase + counts_per_s * time;
        let mut rig = Rig::at(phase);
        let mut encoder = Encoder::new(AxisKind::Linear, PER_COUNT);
        // The clock of the rig ticks every 100 ns; the first edges start the estimate.
        let settle = 3.0 / counts_per_s.abs() + 0.0004;
        for period in 0..(settle / 200e-6) as u64 + 20 {
            let (from, to) = (period * 200_000, (period + 1) * 200_000);
            let inputs = rig.run(motion, from, to);
            encoder.read(inputs, to as u32);
            if to as f64 * 1e-9 > settle {
                let between = (1.0 / counts_per_s.abs()).max(1e-4);
                let bound = rate_mm_s.abs() * (2.0 * 100e-9 / between) + 2e-6;
                let error = f64::from(encoder.rate().0) / f64::from(1 << 20) - rate_mm_s;
                prop_assert!(error.abs() <= bound, "{rate_mm_s}: off by {error}, bound {bound}");
            }
        }
    }
}

#[test]
fn rate_decays_as_one_count_over_elapsed_time() {
    let stop = 0.02;
    let motion = |time: f64| 0.3 + 3200.0 * f64::min(time, stop);
    let mut rig = Rig::at(0.3);
    let mut encoder = Encoder::new(AxisKind::Linear, PER_COUNT);
    for period in 0..5000u64 {
        let (from, to) = (period * 200_000, (period + 1) * 200_000);
        let inputs = *rig.run(motion, from, to);
        encoder.read(&inputs, to as u32);
        let rate = f64::from(encoder.rate().0) / 1310.72;
        let age = f64::from((to as u32).wrapping_sub(inputs.edge_time_ns)) * 1e-9;
        assert!(
            rate >= 0.0 && rate <= 1.0 / age.max(1.0 / 3200.1) + 1.0,
            "{period}: {rate} counts/s {age} s after the edge"
        );
    }
    // No edge for more than half the clock's range: at rest, and the clock's wrap-around does not
    // bring the rate back.
    for time in (0..90u32).map(|k| 1_000_000_000u32.wrapping_add(k.wrapping_mul(100_000_000))) {
        encoder.read(&rig.inputs, time);
        let rate = encoder.rate().0;
        assert!(rate.abs() <= 1311 * 2);
    }
    encoder.read(&rig.inputs, 0xc000_0000);
    assert_eq!(encoder.rate().0, 0);
}

#[test]
fn dither_about_one_edge_gives_zero_rate() {
    let mut decoder = Quadrature::new(0);
    let mut encoder = Encoder::new(AxisKind::Linear, PER_COUNT);
    let mut inputs = JointInputs::default();
    decoder.feed(false, false, false, 0);
    encoder.read(&inputs, 0);
    for period in 1..200u32 {
        let (a, b) = levels(i64::from(period % 2));
        decoder.feed(a, b, false, period * 200_000 - 50_000);
        decoder.latch(&mut inputs);
        encoder.read(&inputs, period * 200_000);
        let rate = encoder.rate().0;
        assert_eq!(rate, 0, "period {period}");
    }
}

#[test]
fn index_pulse_latches_its_coordinate() {
    let mut decoder = Quadrature::new(i32::MAX - 3);
    let mut encoder = Encoder::new(AxisKind::Linear, PER_COUNT);
    let mut inputs = JointInputs {
        counts: i32::MAX - 3,
        ..JointInputs::default()
    };
    decoder.feed(false, false, false, 0);
    encoder.read(&inputs, 0);
    let mut seen = None;
    for place in 1..=12 {
        let (a, b) = levels(place);
        decoder.feed(a, b, place == 7, 100 * place as u32);
        if place % 4 == 0 {
            decoder.latch(&mut inputs);
            let measured = encoder.read(&inputs, 100 * place as u32);
            assert_eq!(measured.index.is_some(), place == 8);
            seen = measured.index.or(seen);
        }
    }
    let (raw, coordinate) = seen.unwrap();
    assert_eq!(raw, (i32::MAX - 3).wrapping_add(7));
    assert_eq!(coordinate.0, (7.0f64 * 1310.72).round() as i32);
    let before = encoder.coordinate_at(inputs.counts);
    let shift = encoder.set_reference(raw, Coordinate(5_000_000));
    assert_eq!(encoder.coordinate_at(raw), Coordinate(5_000_000));
    assert_eq!(encoder.coordinate_at(inputs.counts).0, before.0 + shift.0);
}

#[test]
fn illegal_transition_count_restarts_after_clear() {
    let mut encoder = Encoder::new(AxisKind::Linear, PER_COUNT);
    let mut inputs = JointInputs {
        illegal: u16::MAX - 1,
        ..JointInputs::default()
    };
    encoder.read(&inputs, 0);
    assert_eq!(encoder.illegal(), 0);
    inputs.illegal = 3;
    encoder.read(&inputs, 1);
    assert_eq!(encoder.illegal(), 5);
    encoder.clear_illegal();
    encoder.read(&inputs, 2);
    assert_eq!(encoder.illegal(), 0);
}

/// A board reads its clock, then its capture registers, and an edge may come in between: it is one
/// of now.
#[test]
fn edge_captured_after_clock_read_counts_as_now() {
    for late in [false, true] {
        let mut encoder = Encoder::new(AxisKind::Linear, PER_COUNT);
        for period in 0..12_u32 {
            // 50 mm/s: an edge each 25 us, 8 in a period.
            let time_ns = 1_000_000 + period * 200_000;
            let late = late && (6..9).contains(&period);
            let edge_time_ns = if late { time_ns + 300 } else { time_ns - 5_000 };
            let counts = period as i32 * 8;
            encoder.read(
                &JointInputs {
                    counts,
                    edge_time_ns,
                    ..JointInputs::default()
                },
                time_ns,
            );
            let rate = f64::from(encoder.rate().0) / f64::from(1 << 20);
            assert!(period < 3 || (rate - 50.0).abs() < 2.0, "{period}: {rate}");
        }
    }
}
