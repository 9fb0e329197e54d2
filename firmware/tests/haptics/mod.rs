//! Haptic arm and remote master in the controller: following, rendering, refusals.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

pub mod bench;
mod following;
mod refusals;
mod rendering;

use bench::Bench;
use haptimill_checks::reference;
use haptimill_firmware::config::Config;

fn mill() -> Config {
    Config {
        follow: Some(reference::follow()),
        haptic: Some(reference::haptic()),
        ..reference::h4_with_steps()
    }
}

/// Of 200 mm/s^2 in a period, mm/s, and a little for rounding.
const STEP: f64 = 200.0 * 2e-4 + 1e-3;

/// Checks that no coordinate jumps: position against rate, rate against acceleration.
struct JumpCheck {
    before: [(f64, f64); 3],
}

impl JumpCheck {
    fn at(bench: &Bench) -> Self {
        Self {
            before: [bench.at(0), bench.at(1), bench.at(2)],
        }
    }

    /// Moves the handle evenly by a displacement.
    #[track_caller]
    fn move_master(&mut self, bench: &mut Bench, way: [f64; 3], periods: usize) {
        for _ in 0..periods {
            bench.move_master(way.map(|part| part / periods as f64), 1);
            self.check(bench);
        }
    }

    #[track_caller]
    fn check(&mut self, bench: &Bench) {
        for axis in 0..3 {
            let (now, before) = (bench.at(axis), self.before[axis]);
            let step = now.0 - before.0 - (now.1 + before.1) / 2.0 * 2e-4;
            assert!(step.abs() < 1e-3, "axis {axis} steps by {step} mm");
            let change = now.1 - before.1;
            assert!(
                change.abs() < STEP,
                "axis {axis} changes its rate by {change} mm/s"
            );
            self.before[axis] = now;
        }
    }
}
