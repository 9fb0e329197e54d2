//! Lengths of the chain from three readings of the tip.

/// Reading of the tip in the base frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// p_x.
    pub x: f64,
    /// p_z less d1.
    pub z: Option<f64>,
}

/// Lengths of the chain, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmLengths {
    /// From the lift to the tilt axis.
    pub l2: f64,
    /// From the tilt axis to the spin axis.
    pub l3: f64,
    /// From the tilt axis to the tip.
    pub l4: f64,
    /// Largest difference of a reading from that of these lengths.
    pub residual: f64,
}

/// Computes the lengths from readings at theta2 = 0, 90 and 180 degrees: p_x = L2 + L3, L2 + L4, L2
/// - L3; p_z - d1 = L4, -L3, -L4. Heights that are given take part with the same weight.
#[must_use]
pub fn calibrate(at_0: Reading, at_90: Reading, at_180: Reading) -> ArmLengths {
    let l2 = 0.5 * (at_0.x + at_180.x);
    let mean = |values: &[Option<f64>]| {
        let known: Vec<f64> = values.iter().copied().flatten().collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    };
    let l3 = mean(&[Some(0.5 * (at_0.x - at_180.x)), at_90.z.map(|z| -z)]);
    let l4 = mean(&[Some(at_90.x - l2), at_0.z, at_180.z.map(|z| -z)]);
    let mut residual = 0.0_f64;
    for (reading, x, z) in [
        (at_0, l2 + l3, l4),
        (at_90, l2 + l4, -l3),
        (at_180, l2 - l3, -l4),
    ] {
        residual = residual.max((reading.x - x).abs());
        residual = residual.max(reading.z.map_or(0.0, |read| (read - z).abs()));
    }
    ArmLengths {
        l2,
        l3,
        l4,
        residual,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both readings of the printed lengths are recovered, with and without heights.
    #[test]
    fn the_lengths_are_recovered() {
        for (l2, l3, l4) in [(280.0, 0.24, 1.66), (280.0, 24.0, 166.0)] {
            for heights in [false, true] {
                let reading = |x, z| Reading {
                    x,
                    z: heights.then_some(z),
                };
                let found = calibrate(
                    reading(l2 + l3, l4),
                    reading(l2 + l4, -l3),
                    reading(l2 - l3, -l4),
                );
                for (is, was) in [(found.l2, l2), (found.l3, l3), (found.l4, l4)] {
                    assert!((is - was).abs() < 1e-9, "{found:?}");
                }
                assert!(found.residual < 1e-9);
            }
        }
    }

    /// A reading that is off shows in the residual.
    #[test]
    fn a_wrong_reading_has_a_residual() {
        let at = |x, z| Reading { x, z: Some(z) };
        let found = calibrate(at(280.24, 1.66), at(281.76, -0.24), at(279.76, -1.66));
        assert!(found.residual > 0.05);
    }
}
