//! Lines of a spindle, over any series of speeds.

use haptimill_board_common::spindle::{FULL_RPM, SpindleLines};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const COUNTS: u32 = 15_000;

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 500,
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]
    #[test]
    fn the_direction_changes_only_after_a_period_without_duty(
        speeds in proptest::collection::vec(
            prop_oneof![Just(0_i16), Just(i16::MIN), Just(i16::MAX), -30_000_i16..30_000],
            1..60,
        ),
    ) {
        let mut lines = SpindleLines::new();
        let mut before = SpindleLines::new().update(0, COUNTS);
        prop_assert_eq!((before.duty, before.is_clockwise), (0, false));
        for rpm in speeds {
            // The speed is held for two periods: the second one has it, whatever came before.
            for held in [false, true] {
                let now = lines.update(rpm, COUNTS);
                if now.is_clockwise != before.is_clockwise {
                    prop_assert_eq!(before.duty, 0);
                    prop_assert_ne!(rpm, 0);
                }
                if now.duty > 0 {
                    prop_assert_eq!(now.is_clockwise, rpm > 0);
                }
                if held {
                    let speed = u32::from(rpm.unsigned_abs()).min(FULL_RPM);
                    prop_assert_eq!(now.duty, speed * COUNTS / FULL_RPM);
                }
                before = now;
            }
        }
    }
}
