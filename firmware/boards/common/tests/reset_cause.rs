//! Causes of a reset.

use haptimill_board_common::reset_cause::{Cause, ENDED, RUNNING};

#[test]
fn a_boot_loader_that_restarts_the_chip_is_no_fault() {
    // After a new image: by the watchdog, with no mark, or what the memory had at power-on.
    for mark in [0, 0xFFFF_FFFF, 0xB007_C0D3] {
        assert_eq!(Cause::of(mark, 3, true), Cause::Power);
    }
    assert_eq!(Cause::of(RUNNING, 0, true), Cause::Watchdog);
    // The reset pin of a running board.
    assert_eq!(Cause::of(RUNNING, 0, false), Cause::Power);
    assert_eq!(Cause::of(ENDED, 3, true), Cause::Panic);
    assert_eq!(Cause::of(ENDED, 4, true), Cause::Fault);
    assert_eq!(Cause::of(ENDED, 7, true), Cause::Power);
}
