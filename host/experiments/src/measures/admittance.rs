//! p_c by (3.30), for the force of a recording and for others.

use super::statistics::Point;
use crate::definition::ForceControl;

/// A time, the commanded rate and the force along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Push {
    pub time: f64,
    pub rate: f64,
    pub force: f64,
}

/// p_c by (3.30) from rest, with the enable condition of the machine file: a force pushes outward
/// only against the commanded motion.
pub(super) fn compliant_displacement(control: &ForceControl, pushes: &[Push]) -> Vec<Point> {
    let (mass, damping) = (control.virtual_mass, control.virtual_damping);
    let (mut displacement, mut rate) = (0.0_f64, 0.0);
    let mut before = pushes.first().map_or(0.0, |push| push.time);
    let step = |push: &Push| {
        let duration = push.time - before;
        before = push.time;
        let sign = if displacement == 0.0 {
            push.force.signum()
        } else {
            displacement.signum()
        };
        let drive = sign * push.force - control.setpoint_n;
        let is_open = sign * push.rate < 0.0;
        let drive = if is_open { drive } else { drive.min(0.0) };
        let (decay, end) = ((-damping * duration / mass).exp(), drive / damping);
        let (away, outward) = (sign * displacement, sign * rate);
        let moved = end * duration + (outward - end) * mass / damping * (1.0 - decay);
        displacement = sign * (away + moved).max(0.0);
        rate = if displacement == 0.0 {
            0.0
        } else {
            sign * (end + (outward - end) * decay)
        };
        (push.time, displacement)
    };
    pushes.iter().map(step).collect()
}

/// Value of a polyline; that of its ends beyond them.
pub(super) fn interpolated(points: &[[f64; 2]], time: f64) -> f64 {
    let after = points.partition_point(|[at, _]| *at < time);
    match (points.get(after.wrapping_sub(1)), points.get(after)) {
        (Some([t0, v0]), Some([t1, v1])) => v0 + (v1 - v0) * (time - t0) / (t1 - t0),
        (Some([_, value]), None) | (None, Some([_, value])) => *value,
        (None, None) => 0.0,
    }
}

/// Factor on the force with which p_c reaches a value.
pub(super) fn factor(reached: impl Fn(f64) -> f64, goal: f64) -> f64 {
    let (mut low, mut high) = (0.0, 16.0);
    for _ in 0..40 {
        let middle = (low + high) / 2.0;
        if reached(middle) < goal {
            low = middle;
        } else {
            high = middle;
        }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTROL: ForceControl = ForceControl {
        axes: Vec::new(),
        setpoint_n: 5.0,
        virtual_mass: 1.0,
        virtual_damping: 5.0,
    };

    fn constant(force: f64, rate: f64, seconds: u32) -> Vec<Push> {
        let times = (0..=1000 * seconds).map(|n| f64::from(n) * 1e-3);
        times.map(|time| Push { time, rate, force }).collect()
    }

    fn last(points: &[Point]) -> f64 {
        points.last().unwrap().1
    }

    #[test]
    fn a_constant_force_moves_by_its_integral_over_the_damping() {
        // p = v (t - K_A / K_V (1 - exp(-t K_V / K_A))), v = (F - f_d) / K_V.
        let expected = 1.0 * (3.0 - 0.2 * (1.0 - (-15.0_f64).exp()));
        let moved = compliant_displacement(&CONTROL, &constant(10.0, -4.0, 3));
        assert!((last(&moved) - expected).abs() < 1e-9, "{}", last(&moved));
        let moved = compliant_displacement(&CONTROL, &constant(-10.0, 4.0, 3));
        assert!((last(&moved) + expected).abs() < 1e-9, "{}", last(&moved));
    }

    #[test]
    fn a_force_below_the_setpoint_or_along_the_motion_does_not_move() {
        for (force, rate) in [(4.9, -4.0), (-4.9, 4.0), (10.0, 4.0), (10.0, 0.0)] {
            let moved = compliant_displacement(&CONTROL, &constant(force, rate, 1));
            assert_eq!(last(&moved), 0.0, "{force} {rate}");
        }
    }

    #[test]
    fn the_factor_reaches_its_goal() {
        let pushes = constant(4.0, -4.0, 3);
        let reached = |factor: f64| {
            let changed = pushes.iter().map(|push| Push {
                force: factor * push.force,
                ..*push
            });
            last(&compliant_displacement(
                &CONTROL,
                &changed.collect::<Vec<_>>(),
            ))
        };
        let goal = 2.0;
        let factor = factor(reached, goal);
        assert!((reached(factor) - goal).abs() < 1e-6, "{factor}");
    }

    #[test]
    fn a_polyline_holds_its_ends() {
        let points = [[1.0, 5.0], [3.0, 9.0]];
        for (time, value) in [(0.0, 5.0), (1.0, 5.0), (2.0, 7.0), (3.0, 9.0), (4.0, 9.0)] {
            assert_eq!(interpolated(&points, time), value);
        }
    }
}
