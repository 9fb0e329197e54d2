//! Extension of counters.

use haptimill_board_common::counter::extended;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_counter_of_16_bits_follows_one_of_32(start: i32, moves in proptest::collection::vec(any::<i16>(), 1..200)) {
        let (mut whole, mut known) = (start, start);
        for moved in moves {
            whole = whole.wrapping_add(i32::from(moved));
            known = extended(known, whole as u16);
            prop_assert_eq!(known, whole);
        }
    }
}
