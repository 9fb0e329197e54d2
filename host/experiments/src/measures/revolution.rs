//! Shares of the radial, the tangential and the axial force in the force of a cut, by simulations
//! of each.
//!
//! The force is linear in the coefficients of the material. A cutter without all others that moves
//! as the recorded tool therefore has the share of one of them.

use crate::pass_data::{PassData, Shares};
use crate::sampled_trace::Period;
use haptimill_hil_sim::process::{Coefficients, Cutting, CuttingConfig, ToolPose};

/// Material without forces.
const NONE: Coefficients = Coefficients {
    tangential: 0.0,
    radial: 0.0,
    axial: 0.0,
    tangential_edge: 0.0,
    radial_edge: 0.0,
    axial_edge: 0.0,
};

/// Shares of all periods of a pass.
pub(super) fn shares(data: &PassData) -> &Shares {
    data.shares.get_or_init(|| {
        let material = data.cutting.cutter.coefficients;
        let periods = &data.trace.periods;
        let of = |coefficients| forces(&data.cutting, coefficients, periods);
        Shares {
            radial: of(Coefficients {
                radial: material.radial,
                radial_edge: material.radial_edge,
                ..NONE
            }),
            tangential: of(Coefficients {
                tangential: material.tangential,
                tangential_edge: material.tangential_edge,
                ..NONE
            }),
            axial: of(Coefficients {
                axial: material.axial,
                axial_edge: material.axial_edge,
                ..NONE
            }),
        }
    })
}

/// Forces on a cutter that moves as recorded, with other coefficients.
fn forces(
    cutting: &CuttingConfig,
    coefficients: Coefficients,
    periods: &[Period],
) -> Vec<[f64; 3]> {
    let mut config = cutting.clone();
    config.cutter.coefficients = coefficients;
    // The body of the cutter touches nothing in these cuts.
    config.cutter.body_stiffness = 0.0;
    let first = periods.first().map_or([0.0; 3], |period| period.tool);
    let Ok(mut cutting) = Cutting::new(&config, &ToolPose::upright(first)) else {
        return Vec::new();
    };
    let step = |period: &Period| {
        let pose = ToolPose::upright(period.tool);
        cutting.step(&pose, period.turns).force
    };
    periods.iter().map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_hil_sim::process::WorkpieceConfig;

    /// A slot 2 mm deep at 4 mm/s, 5000 rev/min, of 0.2 s.
    fn slot() -> (CuttingConfig, Vec<Period>) {
        let config = CuttingConfig {
            cutter: Default::default(),
            workpiece: WorkpieceConfig::default(),
        };
        let top = config.workpiece.top_mm;
        let period = |n: u32| Period {
            tool: [-4.0 * 2e-4 * f64::from(n), 0.0, top - 2.0],
            turns: 5000.0 / 60.0 * 2e-4,
        };
        (config, (0..1000).map(period).collect())
    }

    #[test]
    fn the_shares_of_all_coefficients_add_up_to_the_force() {
        let (config, periods) = slot();
        let all = config.cutter.coefficients;
        let of = |coefficients| forces(&config, coefficients, &periods);
        let total = of(all);
        let parts = [
            of(Coefficients {
                radial: all.radial,
                radial_edge: all.radial_edge,
                ..NONE
            }),
            of(Coefficients {
                tangential: all.tangential,
                tangential_edge: all.tangential_edge,
                ..NONE
            }),
            of(Coefficients {
                axial: all.axial,
                axial_edge: all.axial_edge,
                ..NONE
            }),
        ];
        assert!(
            total[999].iter().any(|force| force.abs() > 1.0),
            "{:?}",
            total[999]
        );
        for (index, total) in total.iter().enumerate() {
            for axis in 0..3 {
                let sum: f64 = parts.iter().map(|part| part[index][axis]).sum();
                assert!((sum - total[axis]).abs() < 1e-9, "{index}: {sum} {total:?}");
            }
        }
    }
}
