//! A hand in the controller: it leads, it feels, it lets go, its arm lies, and it is far away.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

#[path = "../arm/mod.rs"]
mod arm;
mod bed;
mod feeling;
mod leading;
mod refusing;

use bed::Bed;
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

/// Watches that nothing jumps: place against the rate, rate against the acceleration.
struct JointMonitor {
    before: [(f64, f64); 3],
}

impl JointMonitor {
    fn at(bed: &Bed) -> Self {
        Self {
            before: [bed.at(0), bed.at(1), bed.at(2)],
        }
    }

    /// The handle goes on evenly by a way.
    #[track_caller]
    fn lead(&mut self, bed: &mut Bed, way: [f64; 3], periods: usize) {
        for _ in 0..periods {
            bed.lead(way.map(|part| part / periods as f64), 1);
            self.look(bed);
        }
    }

    #[track_caller]
    fn look(&mut self, bed: &Bed) {
        for axis in 0..3 {
            let (now, before) = (bed.at(axis), self.before[axis]);
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
