//! Elastic structure between the joints and the tool: rods, joints, platform, spindle.
//!
//! The model is a spring and a damper in each direction of the arm's base frame, without mass:
//!
//! ```text
//! T_s du/dt + u = F / K_s
//!
//! u deflection (mm), F force on the tool (N), K_s stiffness (N/mm), T_s = C_s / K_s (s)
//! ```
//!
//! The model has no mass on purpose. The modes slow enough for a force loop of some Hz and for the
//! tooth passing at 167 Hz are those of the joints on their screws, which
//! [`crate::joint::mechanics`] models with mass. The structure's own modes lie above; the loop sees
//! only their compliance. A force that is held for a control period would also feed energy into an
//! undamped mode. With a contact of stiffness k_e the model is stable when (1 - a)(1 + k_e / K_s) <
//! 2 with a = exp(-T / T_s), independent of the plant. At 200 us and 1 ms that holds up to k_e = 10
//! K_s.
//!
//! The force is constant during a period, so the solution is exact: u moves towards F / K_s by the
//! factor 1 - a.

use crate::check::{Check, PlantError};
use serde::{Deserialize, Serialize};

/// Configuration of the structure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructureConfig {
    /// Stiffness K_s at the tool in x, y and z of the arm's base frame, N/mm; infinity is rigid.
    pub stiffness: [f64; 3],
    /// Time constant T_s, seconds.
    pub time_constant_s: f64,
}

impl Default for StructureConfig {
    /// 500 N/mm across and 1000 N/mm along the tool: an estimate for an arm of this size with 480
    /// mm rods.
    fn default() -> Self {
        Self {
            stiffness: [500.0, 500.0, 1000.0],
            time_constant_s: 0.001,
        }
    }
}

impl StructureConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        for (axis, stiffness) in self.stiffness.into_iter().enumerate() {
            check.within(
                format!("structure: stiffness {axis}"),
                stiffness,
                1.0,
                f64::INFINITY,
            );
        }
        check.within(
            "structure: time_constant_s".into(),
            self.time_constant_s,
            0.0,
            1.0,
        );
        check.done()
    }
}

/// The structure, with its deflection.
#[derive(Debug, Clone)]
pub struct Structure {
    compliance: [f64; 3],
    keeps: f64,
    deflection: [f64; 3],
}

impl Structure {
    /// Creates an undeflected structure that is advanced once every `period_s` seconds. The
    /// configuration must have passed its check.
    pub fn new(config: &StructureConfig, period_s: f64) -> Self {
        Self {
            compliance: config.stiffness.map(|stiffness| 1.0 / stiffness),
            keeps: if config.time_constant_s > 0.0 {
                libm::exp(-period_s / config.time_constant_s)
            } else {
                0.0
            },
            deflection: [0.0; 3],
        }
    }

    /// Advances by one period under a force on the tool (base frame, N) and returns the deflection
    /// at its end, mm.
    pub fn advance(&mut self, force: [f64; 3]) -> [f64; 3] {
        for (i, deflection) in self.deflection.iter_mut().enumerate() {
            let goal = force[i] * self.compliance[i];
            *deflection = goal + (*deflection - goal) * self.keeps;
        }
        self.deflection
    }

    /// Present deflection, mm, base frame.
    pub const fn deflection(&self) -> [f64; 3] {
        self.deflection
    }
}
