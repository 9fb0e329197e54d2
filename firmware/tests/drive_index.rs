//! Index pulses against counts: what is lost is found, what is not lost is never said to be.

use haptimill_firmware::drive::index::{IndexWatch, TOLERANCE};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Axis units a count, Q24, of a 10 mm screw with 8000 counts a turn: 1310.72.
const PER_COUNT: i64 = 21_990_232_556;

/// 10 mm.
const PITCH: i32 = 10 << 20;

/// Pulses of a shaft on its way: each after so many turns more, and a count apart where it is come to from the other side.
fn pulses(first: i32, turn: i32, turns: &[i32]) -> impl Iterator<Item = i32> {
    let mut raw = first;
    turns.iter().map(move |turns| {
        // The counter is free running and wraps around.
        raw = raw.wrapping_add(turn.wrapping_mul(*turns));
        raw.wrapping_add(i32::from(*turns < 0))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Of a counter that loses nothing nothing is said, however far it goes, and whatever it began at.
    #[test]
    fn a_counter_that_loses_nothing_is_believed(
        first in any::<i32>(),
        turns in prop::collection::vec(-20..=20_i32, 1..200),
        backwards in any::<bool>(),
    ) {
        let per_count = if backwards { -PER_COUNT } else { PER_COUNT };
        let mut watch = IndexWatch::new(PITCH, per_count);
        for raw in pulses(first, 8000, &turns) {
            prop_assert!(watch.pulse(raw).unsigned_abs() <= 1);
        }
    }

    /// All that is lost or gained between two pulses is said at the second one, as long as it is less than half a turn.
    #[test]
    fn what_is_lost_is_said(
        first in any::<i32>(),
        turns in prop::collection::vec(1..=20_i32, 2..20),
        lost in 5..3990_i32,
        gained in any::<bool>(),
        at in any::<prop::sample::Index>(),
    ) {
        let lost = if gained { lost } else { -lost };
        let at = 1 + at.index(turns.len() - 1);
        let mut watch = IndexWatch::new(PITCH, PER_COUNT);
        let offs: Vec<i32> = pulses(first, 8000, &turns)
            .enumerate()
            .map(|(number, raw)| watch.pulse(if number < at { raw } else { raw.wrapping_add(lost) }))
            .collect();
        prop_assert_eq!(offs.iter().position(|off| off.unsigned_abs() > TOLERANCE), Some(at));
        prop_assert_eq!(offs[at], lost);
    }

    /// Counts that are lost one by one add up to what is said.
    #[test]
    fn what_is_lost_little_by_little_adds_up(each in 1..=4_i32) {
        let mut watch = IndexWatch::new(PITCH, PER_COUNT);
        let said = (0..10).position(|turn| watch.pulse(turn * (8000 - each)).unsigned_abs() > TOLERANCE);
        prop_assert_eq!(said, Some((TOLERANCE as i32 / each + 1) as usize));
    }

    /// A pitch that is no whole number of counts, or that no encoder has, says nothing; nor does anything panic.
    #[test]
    fn what_cannot_be_compared_is_not(pitch in any::<i32>(), per_count in any::<i64>(), raws in prop::collection::vec(any::<i32>(), 0..20)) {
        let mut watch = IndexWatch::new(pitch, per_count);
        for raw in &raws {
            let _ = watch.pulse(*raw);
        }
        // 8000.25 counts a turn.
        let mut watch = IndexWatch::new(PITCH, (i64::from(PITCH) << 26) / 32_001);
        for raw in raws {
            prop_assert_eq!(watch.pulse(raw), 0);
        }
    }
}

#[test]
fn after_its_reference_is_found_anew_the_next_pulse_is_the_first() {
    let mut watch = IndexWatch::new(PITCH, PER_COUNT);
    assert_eq!([0, 8000, 16_100].map(|raw| watch.pulse(raw)), [0, 0, 100]);
    assert_eq!(watch.pulse(24_100), 100);
    watch.forget();
    assert_eq!([32_100, 24_100].map(|raw| watch.pulse(raw)), [0, 0]);
}
