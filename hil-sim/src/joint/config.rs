//! Configuration of one simulated joint: `[[plant.joint]]` of a machine file.
//!
//! A linear joint uses mm, N, kg and s; a rotary joint uses degrees, N m, kg m^2 and s. *Axis unit*
//! means mm or degrees; *effort* means N or N m.

use crate::check::Check;
use serde::{Deserialize, Serialize};

/// Linear or rotary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JointKind {
    /// mm, N, kg.
    Linear,
    /// Degrees, N m, kg m^2.
    Rotary,
}

impl JointKind {
    /// Acceleration in axis units/s^2 that one unit of effort gives to one unit of inertia: 1 N on
    /// 1 kg is 1000 mm/s^2, 1 N m on 1 kg m^2 is 180/pi degrees/s^2.
    pub const fn acceleration_unit(self) -> f64 {
        match self {
            Self::Linear => 1000.0,
            Self::Rotary => 180.0 / core::f64::consts::PI,
        }
    }
}

/// One joint: motor, screw or worm, and driven mass, as two masses with a spring and a gap between
/// them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointConfig {
    /// Name for messages and reports.
    pub name: String,
    /// Linear or rotary.
    pub kind: JointKind,
    /// Axis units per motor turn: the lead of the screw in mm, or the degrees of the table per turn
    /// of the worm.
    pub lead: f64,
    /// Total moving inertia, referred to the axis, kg or kg m^2.
    pub inertia: f64,
    /// Part of `inertia` on the motor side of the screw, 0.05 to 0.95.
    pub motor_share: f64,
    /// Natural frequency of motor side against slide side on the screw, Hz; sets the stiffness.
    pub mode_hz: f64,
    /// Damping ratio of that mode, 0 to 1.
    pub mode_damping: f64,
    /// Total width of the gap between screw and slide, axis units.
    pub backlash: f64,
    /// Coulomb friction, effort, both sides together.
    pub coulomb: f64,
    /// Viscous friction, effort per axis unit per second, both sides together.
    pub viscous: f64,
    /// Part of both frictions on the slide side, 0 to 1; the rest acts on motor and screw.
    pub friction_slide_share: f64,
    /// Lower hard stop of the slide, axis units; minus infinity, with `high` infinity, on a rotary
    /// joint that turns without end.
    pub low: f64,
    /// Upper hard stop of the slide, axis units.
    pub high: f64,
    /// Stiffness of the hard stops, effort per axis unit.
    pub stop_stiffness: f64,
    /// Start position of the slide, axis units.
    pub preset: f64,
    /// Largest offset of the start from the preset, to either side, axis units; drawn from the
    /// seed.
    #[serde(default)]
    pub start_spread: f64,
    /// The encoder; a joint without one has a step drive.
    #[serde(default)]
    pub encoder: Option<EncoderConfig>,
    /// Drive of the joint.
    pub drive: DriveConfig,
    /// Home switch.
    #[serde(default)]
    pub home: Option<SwitchConfig>,
    /// Switches whose line is low when they are active, as the contact opens.
    #[serde(default)]
    pub active_low: Vec<crate::fault::Switch>,
    /// Limit switch at the lower end: active at or below this coordinate.
    #[serde(default)]
    pub limit_low: Option<f64>,
    /// Limit switch at the upper end: active at or above this coordinate.
    #[serde(default)]
    pub limit_high: Option<f64>,
    /// Joint whose beam this joint moves at its other end: the joint is the second motor of a
    /// gantry, and no joint of the geometry.
    #[serde(default)]
    pub gantry_of: Option<String>,
    /// Stiffness of the beam against racking, effort per axis unit; 0: its ends are not
    /// coupled.
    #[serde(default)]
    pub racking_stiffness: f64,
    /// Racking at power-on: this joint minus that of the first motor, axis units.
    #[serde(default)]
    pub racked: f64,
}

/// Place of an encoder.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EncoderPlace {
    /// On the motor shaft: backlash and wind-up of the screw are outside the loop.
    #[default]
    Motor,
    /// On the slide: a linear scale, whose index states are reference marks.
    Slide,
}

/// An incremental encoder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderConfig {
    /// Where it is.
    #[serde(default)]
    pub on: EncoderPlace,
    /// Counts per motor turn, or per lead of travel of the slide, after x4 decoding (four times the
    /// lines); a multiple of 4.
    pub counts_per_turn: u32,
    /// Coordinate at which the index state begins on one motor turn, or a reference mark; the other
    /// ones are whole leads away.
    pub index: f64,
    /// The encoder counts backwards.
    #[serde(default)]
    pub reversed: bool,
}

/// A home switch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwitchConfig {
    /// Trip coordinate, axis units.
    pub at: f64,
    /// Side on which the switch is active.
    pub active: SwitchSide,
    /// Distance from the trip coordinate back to the release, axis units.
    #[serde(default)]
    pub hysteresis: f64,
    /// Time for which the contact bounces after a change, ms.
    #[serde(default)]
    pub bounce_ms: f64,
}

/// Side of a switch on which it is active.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SwitchSide {
    /// At and below the trip coordinate.
    Below,
    /// At and above the trip coordinate.
    Above,
}

/// Drive of a joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum DriveConfig {
    /// A current-mode amplifier behind a 14-bit DAC.
    Torque(TorqueDrive),
    /// A step/direction drive.
    Steps(StepDrive),
}

/// A current-mode amplifier.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TorqueDrive {
    /// Effort at the axis for code 8192; negative for a reversed amplifier.
    pub full_scale: f64,
    /// Largest effort of the amplifier.
    pub limit: f64,
}

/// A step motor with its drive, from the data sheet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepDrive {
    /// Full steps of the motor per turn (200 for 1.8 degrees).
    pub full_steps: u32,
    /// Phases of the motor; an electrical turn is two full steps for each.
    #[serde(default = "two_phases")]
    pub phases: u32,
    /// Steps (pulses) per full step.
    pub microsteps: u32,
    /// Largest static effort at the axis. The effort is this value times the sine of the electrical
    /// lag.
    pub pull_out: f64,
    /// Damping by the drive, effort per axis unit per second.
    #[serde(default)]
    pub damping: f64,
    /// A positive step moves downwards.
    #[serde(default)]
    pub reversed: bool,
    /// Ticks of the board's step clock per microsecond, 1 to 1000.
    pub ticks_per_us: u16,
    /// Width of the pulses of the board, ns.
    pub pulse_ns: f64,
    /// Shortest pulse that the drive detects reliably, ns.
    pub min_high_ns: f64,
    /// Shortest pause between two pulses, ns.
    pub min_low_ns: f64,
    /// Shortest time from a change of direction to the next pulse, ns.
    pub setup_ns: f64,
    /// Shortest time from the end of a pulse to a change of direction, ns.
    pub hold_ns: f64,
}

const fn two_phases() -> u32 {
    2
}

impl JointConfig {
    /// Stiffness of the screw, effort per axis unit, from `mode_hz`.
    pub fn stiffness(&self) -> f64 {
        let rate = core::f64::consts::TAU * self.mode_hz;
        rate * rate * self.reduced_inertia() / self.kind.acceleration_unit()
    }

    /// Damping of the screw, effort per axis unit per second.
    pub fn damping(&self) -> f64 {
        let rate = core::f64::consts::TAU * self.mode_hz;
        2.0 * self.mode_damping * rate * self.reduced_inertia() / self.kind.acceleration_unit()
    }

    fn reduced_inertia(&self) -> f64 {
        self.inertia * self.motor_share * (1.0 - self.motor_share)
    }

    /// Axis units per count of an encoder.
    pub fn per_count(&self, encoder: &EncoderConfig) -> f64 {
        self.lead / f64::from(encoder.counts_per_turn)
    }

    pub(crate) fn check(&self, at: &str, substep_us: f64, check: &mut Check) {
        let substep = substep_us * 1e-6;
        check.within(format!("{at}: lead"), self.lead, 0.01, 1000.0);
        check.within(format!("{at}: inertia"), self.inertia, 1e-6, 1e5);
        check.within(format!("{at}: motor_share"), self.motor_share, 0.05, 0.95);
        // The spring is integrated explicitly. The bound keeps it far from instability at omega *
        // substep = 2.
        check.within(
            format!("{at}: mode_hz"),
            self.mode_hz,
            1.0,
            (0.3 / (core::f64::consts::TAU * substep)).min(2000.0),
        );
        check.within(format!("{at}: mode_damping"), self.mode_damping, 0.0, 1.0);
        check.within(
            format!("{at}: backlash"),
            self.backlash,
            0.0,
            self.lead.abs(),
        );
        check.within(format!("{at}: coulomb"), self.coulomb, 0.0, 1e6);
        check.within(format!("{at}: viscous"), self.viscous, 0.0, 1e6);
        check.within(
            format!("{at}: friction_slide_share"),
            self.friction_slide_share,
            0.0,
            1.0,
        );
        // A rotary joint may turn many times between its stops.
        let reach = match self.kind {
            JointKind::Linear => 2000.0,
            JointKind::Rotary => 200_000.0,
        };
        let endless = self.kind == JointKind::Rotary
            && self.low == f64::NEG_INFINITY
            && self.high == f64::INFINITY;
        if !endless {
            check.within(format!("{at}: low"), self.low, -reach, reach);
            check.within(format!("{at}: high"), self.high, self.low, reach);
        }
        check.within(format!("{at}: preset"), self.preset, self.low, self.high);
        // A limit switch may lie outside the hard stops, where the slide cannot reach it. The lower
        // switch must be below the upper one.
        let (limit_low, limit_high) = (self.limit_low, self.limit_high);
        for (name, at_switch) in [("limit_low", limit_low), ("limit_high", limit_high)] {
            let place = at_switch.unwrap_or_default();
            check.within(format!("{at}: {name}"), place, -2.0 * reach, 2.0 * reach);
        }
        if let (Some(low), Some(high)) = (limit_low, limit_high)
            && low >= high
        {
            let problem = format!("{low} is not below limit_high = {high}; lower it");
            check.refuse(format!("{at}: limit_low"), problem);
        }
        if let Some(home) = &self.home {
            check.within(
                format!("{at}: home: at"),
                home.at,
                -2.0 * reach,
                2.0 * reach,
            );
            check.within(
                format!("{at}: home: hysteresis"),
                home.hysteresis,
                0.0,
                100.0,
            );
            check.within(
                format!("{at}: home: bounce_ms"),
                home.bounce_ms,
                0.0,
                1000.0,
            );
        }
        let distance = (self.preset - self.low).min(self.high - self.preset);
        // A preset beyond a stop is a problem of its own.
        if distance >= 0.0 {
            check.within(
                format!("{at}: start_spread"),
                self.start_spread,
                0.0,
                distance,
            );
        }
        let slide = self.inertia * (1.0 - self.motor_share);
        let stiffest = 0.09 / (substep * substep) * slide / self.kind.acceleration_unit();
        check.within(
            format!("{at}: stop_stiffness"),
            self.stop_stiffness,
            0.0,
            stiffest,
        );
        match (&self.encoder, &self.drive) {
            (Some(encoder), _) => {
                let counts = encoder.counts_per_turn;
                if counts < 4 || !counts.is_multiple_of(4) || counts > 4_000_000 {
                    check.refuse(
                        format!("{at}: encoder: counts_per_turn"),
                        format!("{counts} is not a multiple of 4 up to 4000000; correct it"),
                    );
                }
                check.within(
                    format!("{at}: encoder: index"),
                    encoder.index,
                    -2.0 * reach,
                    2.0 * reach,
                );
            }
            (None, DriveConfig::Torque(_)) => check.refuse(
                format!("{at}: encoder"),
                "is missing; a torque drive needs one".into(),
            ),
            (None, DriveConfig::Steps(_)) => {}
        }
        match &self.drive {
            DriveConfig::Torque(drive) => {
                check.within(
                    format!("{at}: drive: full_scale"),
                    drive.full_scale.abs(),
                    1e-6,
                    1e6,
                );
                check.within(format!("{at}: drive: limit"), drive.limit, 0.0, 1e6);
            }
            DriveConfig::Steps(drive) => {
                check.within(
                    format!("{at}: drive: full_steps"),
                    f64::from(drive.full_steps),
                    4.0,
                    10_000.0,
                );
                check.within(
                    format!("{at}: drive: phases"),
                    f64::from(drive.phases),
                    2.0,
                    5.0,
                );
                check.within(
                    format!("{at}: drive: microsteps"),
                    f64::from(drive.microsteps),
                    1.0,
                    1024.0,
                );
                check.within(
                    format!("{at}: drive: ticks_per_us"),
                    f64::from(drive.ticks_per_us),
                    1.0,
                    1000.0,
                );
                check.within(format!("{at}: drive: damping"), drive.damping, 0.0, 1e6);
                check.within(format!("{at}: drive: pull_out"), drive.pull_out, 0.0, 1e6);
                for (name, value) in [
                    ("pulse_ns", drive.pulse_ns),
                    ("min_high_ns", drive.min_high_ns),
                    ("min_low_ns", drive.min_low_ns),
                    ("setup_ns", drive.setup_ns),
                    ("hold_ns", drive.hold_ns),
                ] {
                    check.within(format!("{at}: drive: {name}"), value, 0.0, 1e6);
                }
            }
        }
    }
}
