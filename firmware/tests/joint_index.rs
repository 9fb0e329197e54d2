//! Index monitor: lost counts are found, and none are reported that were not lost.

use haptimill_firmware::joint::index_monitor::IndexMonitor;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Axis units a count, Q24, of a 10 mm screw with 8000 counts a turn: 1310.72.
const PER_COUNT: i64 = 21_990_232_556;

/// 10 mm.
const PITCH: i32 = 10 << 20;

/// Counts that a pulse may be off.
const SLACK: u16 = 4;

fn monitor() -> IndexMonitor {
    IndexMonitor::new(PITCH, PER_COUNT, SLACK)
}

/// Index pulses of a shaft, with a width in counts: each after some turns more, and at its other
/// end when approached from the other side.
fn pulses(first: i32, width: i32, turns: &[i32]) -> impl Iterator<Item = i32> {
    let mut raw = first;
    turns.iter().map(move |turns| {
        // The counter is free running and wraps around.
        raw = raw.wrapping_add(turns.wrapping_mul(8000));
        raw.wrapping_add(if *turns < 0 { width - 1 } else { 0 })
    })
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// A correct counter raises no fault, for any motion, any start, and pulses as wide as the
    /// tolerance.
    #[test]
    fn correct_counter_raises_no_fault(
        first in any::<i32>(),
        width in 1..=12_i32,
        turns in prop::collection::vec(-20..=20_i32, 1..200),
        backwards in any::<bool>(),
    ) {
        let per_count = if backwards { -PER_COUNT } else { PER_COUNT };
        let mut monitor = IndexMonitor::new(PITCH, per_count, SLACK.max(width as u16 - 1));
        for raw in pulses(first, width, &turns) {
            prop_assert_eq!(monitor.pulse(raw), None);
        }
    }

    /// A loss or gain of less than half a turn is reported when a second pulse confirms it.
    #[test]
    fn lost_counts_are_reported_exactly(
        first in any::<i32>(),
        turns in prop::collection::vec(1..=20_i32, 4..20),
        lost in 5..3990_i32,
        gained in any::<bool>(),
        at in any::<prop::sample::Index>(),
    ) {
        let lost = if gained { lost } else { -lost };
        let at = 2 + at.index(turns.len() - 3);
        let mut monitor = monitor();
        let said: Vec<Option<i32>> = pulses(first, 1, &turns)
            .enumerate()
            .map(|(number, raw)| monitor.pulse(if number < at { raw } else { raw.wrapping_add(lost) }))
            .collect();
        prop_assert_eq!(said.iter().position(Option::is_some), Some(at + 1));
        prop_assert_eq!(said[at + 1], Some(lost));
    }

    /// A stray pulse is no fault, wherever it comes.
    #[test]
    fn stray_index_pulse_is_no_fault(first in any::<i32>(), stray in any::<i32>(), at in 0..20_usize) {
        let mut monitor = monitor();
        for (number, raw) in pulses(first, 1, &[1; 20]).enumerate() {
            if number == at {
                prop_assert_eq!(monitor.pulse(stray), None);
            }
            prop_assert_eq!(monitor.pulse(raw), None, "after {} at {}", stray, at);
        }
    }

    /// Counts lost one by one add up.
    #[test]
    fn small_losses_accumulate(each in 1..=4_i32) {
        let mut monitor = monitor();
        let said = (0..20).position(|turn| monitor.pulse(turn * (8000 - each)).is_some());
        let soon = usize::from(SLACK) / each as usize + 3;
        prop_assert!(said.is_some_and(|turn| turn <= soon), "{:?} {}", said, soon);
    }

    /// During homing a single pulse reports a loss, and a correct pulse becomes the reference.
    #[test]
    fn homing_accepts_each_index_pulse(first in any::<i32>(), off in -3990..=3990_i32) {
        let mut monitor = monitor();
        for raw in pulses(first, 1, &[1, 1]) {
            prop_assert_eq!(monitor.pulse(raw), None);
        }
        prop_assert!(monitor.is_armed());
        monitor.search(true);
        let raw = first.wrapping_add(24_000 + off);
        let lost = off.unsigned_abs() > u32::from(SLACK);
        prop_assert_eq!(monitor.pulse(raw), lost.then_some(off));
        monitor.search(false);
        if !lost {
            // What was off then does not count any more.
            let more = raw.wrapping_add(8000 + off.signum() * i32::from(SLACK));
            prop_assert_eq!([monitor.pulse(more), monitor.pulse(more)], [None, None]);
        }
    }

    /// An invalid index pitch disables the monitor without a panic.
    #[test]
    fn invalid_index_pitch_disables_the_monitor(
        pitch in any::<i32>(),
        per_count in any::<i64>(),
        slack in any::<u16>(),
        raws in prop::collection::vec(any::<i32>(), 0..20),
    ) {
        let mut monitor = IndexMonitor::new(pitch, per_count, slack);
        for raw in &raws {
            let _ = monitor.pulse(*raw);
        }
        // A pitch of 8000.25 counts a turn, and a pitch with the comparison off.
        let quarter = IndexMonitor::new(PITCH, (i64::from(PITCH) << 26) / 32_001, SLACK);
        for mut monitor in [quarter, IndexMonitor::new(PITCH, PER_COUNT, 0)] {
            for raw in &raws {
                prop_assert_eq!(monitor.pulse(*raw), None);
            }
            prop_assert!(!monitor.is_armed());
        }
    }
}

#[test]
fn index_monitor_restarts_after_a_report() {
    let mut monitor = monitor();
    let said = [0, 8000, 16_100, 24_100].map(|raw| monitor.pulse(raw));
    assert_eq!(said, [None, None, None, Some(100)]);
    monitor.clear();
    assert!(!monitor.is_armed());
    assert_eq!(
        [32_100, 40_100, 48_100].map(|raw| monitor.pulse(raw)),
        [None; 3]
    );
}
