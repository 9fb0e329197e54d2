//! Force control in the configuration of a machine.

use super::sensor::{COMPONENTS, ForceSensor};
use super::window_peak::Window;
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_math::{Length, Rate};
use haptimill_protocol::force::{EnableCondition, ForceLoop};
use serde::{Deserialize, Serialize};

/// Force control settings of one axis.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LoopSettings {
    /// f_d, a magnitude: it acts on the side of the contact.
    pub setpoint: Force,
    /// K_A.
    pub mass: VirtualMass,
    /// K_V.
    pub damping: VirtualDamping,
    /// Compliance limit.
    pub limit: Length,
    /// Maximum rate of the compliant displacement, away and back.
    pub rate: Rate,
    /// Enable condition.
    pub enable_condition: EnableCondition,
}

impl LoopSettings {
    /// Smallest force setpoint: 0.5 N, 40 codes of a sensor of +-100 N.
    ///
    /// A force setpoint of 0 makes the tool follow noise and never return (its return rate is f_d /
    /// K_V): callers must disable the axis instead. A negative one has no meaning, since the sign
    /// is that of the contact. Below 40 codes, drift and noise move the tool.
    pub const MIN_SETPOINT: Force = Force::millinewtons(500);
}

impl From<&ForceLoop> for LoopSettings {
    fn from(settings: &ForceLoop) -> Self {
        Self {
            setpoint: Force(settings.setpoint),
            mass: VirtualMass(settings.mass),
            damping: VirtualDamping(settings.damping),
            limit: Length(settings.limit),
            rate: Rate(settings.rate),
            enable_condition: settings.enable_condition,
        }
    }
}

impl From<&LoopSettings> for ForceLoop {
    fn from(settings: &LoopSettings) -> Self {
        Self {
            setpoint: settings.setpoint.0,
            mass: settings.mass.0,
            damping: settings.damping.0,
            limit: settings.limit.0,
            rate: settings.rate.0,
            enable_condition: settings.enable_condition,
        }
    }
}

/// Force control section of the configuration.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ForceConfig {
    /// The sensor.
    pub sensor: ForceSensor,
    /// Force control settings of x, y, z.
    pub axes: [LoopSettings; COMPONENTS],
    /// Axes under force control after a start: bit 0 for x.
    pub mask: u8,
    /// Lag of the tool behind its reference, microseconds.
    pub drive_lag_us: u16,
    /// Creep rate: the slowest rate that the drives follow in spite of friction and lost motion. On
    /// a stiff contact the tool moves at this rate or faster, or is at standstill. 0 for drives
    /// that follow any rate.
    pub creep: Rate,
    /// Slowest spindle speed at which force control works, rev/min. It sets the longest window of
    /// the peak force. 0 is a tool without teeth, such as a lap: the window is 2 ms at every speed.
    pub slowest_rpm: u16,
}

/// Window of the peak force of a tool without teeth, microseconds. The force of such a tool has no
/// peaks, so the window only has to be long against the noise of a sample.
const TOOTHLESS_US: u32 = 2000;

/// Time between two updates of the contact-stability monitor for a tool without teeth,
/// microseconds. Its memory of 32 updates must be longer than a revolution: the run-out of a lap
/// moves the tool, and within a part of a revolution its force looks like one of the wrong sign.
const TOOTHLESS_UPDATE_US: u32 = 10_000;

impl ForceConfig {
    /// Delay that the contact-stability monitor assumes from a motion of the tool to a change of
    /// the peak force: the longest window, the drive lag, and one and a half control periods.
    /// Microseconds.
    #[must_use]
    pub fn delay_us(&self, period_us: u16) -> u32 {
        let window = match self.slowest_rpm {
            0 => TOOTHLESS_US,
            rpm => 60_000_000 / u32::from(rpm),
        };
        window
            .saturating_add(u32::from(self.drive_lag_us))
            .saturating_add(u32::from(period_us) * 3 / 2)
    }

    /// Control periods between two updates of the contact-stability monitor for a tool without
    /// teeth; 0 with teeth, where the window of the peak sets them.
    pub(super) fn toothless_update(&self, period_us: u16) -> u16 {
        match self.slowest_rpm {
            0 => TOOTHLESS_UPDATE_US.div_ceil(u32::from(period_us.max(1))) as u16,
            _ => 0,
        }
    }

    pub(super) fn window(&self, period_us: u16) -> Option<Window> {
        if self.slowest_rpm == 0 {
            return Window::of(TOOTHLESS_US.div_ceil(u32::from(period_us.max(1))));
        }
        let rpm = i16::try_from(self.slowest_rpm).ok()?;
        Window::revolution(rpm, period_us)
    }
}
