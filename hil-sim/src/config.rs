//! What the simulated machine is made of: the `[plant]` section of a machine file.
//!
//! A linear joint is described in mm, N, kg and s, a rotary one in degrees, N m, kg m^2 and s. The two are told apart by
//! [`JointConfig::kind`]; where a field says *axis unit* it means mm or degrees, where it says *effort* N or N m.
//!
//! The plant is the truth of the simulation. Nothing here is read by the controller, and it may disagree with the controller's own
//! configuration on purpose: a longer rod, more friction, an index somewhere else.

use crate::cutting::{CutterConfig, CuttingConfig, SpindleConfig, WorkpieceConfig};
use crate::hand::HandConfig;
use crate::haptic::HapticConfig;
use crate::process::ProcessConfig;
use crate::sensor::SensorConfig;
use crate::structure::StructureConfig;
use core::fmt;
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// The simulated machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// Seed of everything random: start offsets, noise, link errors.
    pub seed: u64,
    /// Integration step in microseconds; the control period must be a whole multiple. 5 to 50.
    #[serde(default = "default_substep_us")]
    pub substep_us: u16,
    /// The arm that the joints carry; without it the pose is the joints.
    #[serde(default)]
    pub arm: Option<ArmGeometry>,
    /// The spindle.
    #[serde(default)]
    pub spindle: Option<SpindleConfig>,
    /// The cutter in the spindle; it cuts nothing while no work is clamped.
    #[serde(default)]
    pub cutter: Option<CutterConfig>,
    /// A work that is clamped from the start, homing included; see [`crate::plant::Plant::clamp`] for one that comes later.
    #[serde(default)]
    pub workpiece: Option<WorkpieceConfig>,
    /// What gives way between the slides and the tool; without it the arm is rigid.
    #[serde(default)]
    pub structure: Option<StructureConfig>,
    /// The force sensor under the work.
    #[serde(default)]
    pub sensor: Option<SensorConfig>,
    /// The haptic arm; without it there is none.
    #[serde(default)]
    pub haptic: Option<HapticConfig>,
    /// The hand at the haptic arm; it holds the handle from the start.
    #[serde(default)]
    pub hand: Option<HandConfig>,
    /// The joints, in the machine's order (H-4: four slides, then the table). 1 to 6; none where there is a haptic arm alone.
    #[serde(default)]
    pub joint: Vec<JointConfig>,
}

const fn default_substep_us() -> u16 {
    20
}

/// Lengths of the H-4 arm and its table in mm, under the names of the spec (h4-milling 2.5-2.6).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmGeometry {
    /// Lateral distance of a slide's joint from the middle, with `e` taken off.
    pub a: f64,
    /// Lateral distance of a platform joint from the tool axis.
    pub b: f64,
    /// Half the distance of the platform's joint pairs along the tool axis.
    pub c: f64,
    /// Half the height difference of the rail pairs.
    pub d: f64,
    /// Lateral offset of the slide's joint from its rail.
    pub e: f64,
    /// Offset of the slide's joint along the rail.
    pub w: f64,
    /// Length of a rod (R).
    pub r: f64,
    /// Offset of the rails in z (g_e).
    pub ge: f64,
    /// Tool length from the lower platform joints to the tip (T_L).
    pub tl: f64,
    /// Offset of the table in x.
    pub p: f64,
    /// Height of the table's axis below the origin of the arm.
    pub h: f64,
    /// Offset of the work's origin in x (x_Ow^O1).
    pub x_off: f64,
    /// Offset of the work's origin in y (y_Ow^O1).
    pub y_off: f64,
    /// Offset of the work's origin in z (z_O1^O2).
    pub z_off: f64,
    /// On which side of the rails the platform hangs when the machine is built.
    pub branch: Branch,
}

/// Assembly branch of the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Branch {
    /// Platform below the rails.
    Below,
    /// Platform above the rails.
    Above,
}

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
    /// Axis units per second squared that one unit of effort gives to one unit of inertia: 1 N on 1 kg is 1000 mm/s^2, 1 N m on
    /// 1 kg m^2 is 180/pi degrees/s^2.
    pub const fn acceleration_unit(self) -> f64 {
        match self {
            Self::Linear => 1000.0,
            Self::Rotary => 180.0 / core::f64::consts::PI,
        }
    }
}

/// One joint: motor, screw or worm, and what it moves, as two masses with a spring and a gap between them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointConfig {
    /// Name, for people.
    pub name: String,
    /// Linear or rotary.
    pub kind: JointKind,
    /// Axis units per motor turn: the lead of the screw in mm, or the degrees of the table per turn of the worm.
    pub lead: f64,
    /// All that moves, as seen at the axis: kg or kg m^2.
    pub inertia: f64,
    /// Part of `inertia` on the motor's side of the screw, 0.05 to 0.95.
    pub motor_share: f64,
    /// Frequency at which motor side and slide side swing against each other on the screw, Hz; sets the stiffness.
    pub mode_hz: f64,
    /// Damping ratio of that mode, 0 to 1.
    pub mode_damping: f64,
    /// Whole width of the gap between screw and slide, axis units.
    pub backlash: f64,
    /// Coulomb friction, effort, both sides together.
    pub coulomb: f64,
    /// Viscous friction, effort per axis unit per second, both sides together.
    pub viscous: f64,
    /// Part of both frictions on the slide's side, 0 to 1; the rest acts on motor and screw.
    pub friction_slide_share: f64,
    /// Lower hard stop of the slide, axis units.
    pub low: f64,
    /// Upper hard stop of the slide, axis units.
    pub high: f64,
    /// Stiffness of the hard stops, effort per axis unit.
    pub stop_stiffness: f64,
    /// Where the slide stands at the start, axis units.
    pub preset: f64,
    /// The start is off the preset by up to this much to either side, drawn from the seed.
    #[serde(default)]
    pub start_spread: f64,
    /// The encoder on the motor shaft.
    pub encoder: EncoderConfig,
    /// What drives it.
    pub drive: DriveConfig,
    /// Home switch.
    #[serde(default)]
    pub home: Option<SwitchConfig>,
    /// Limit switch at the lower end: active at or below this coordinate.
    #[serde(default)]
    pub limit_low: Option<f64>,
    /// Limit switch at the upper end: active at or above this coordinate.
    #[serde(default)]
    pub limit_high: Option<f64>,
}

/// An incremental encoder on the motor shaft.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderConfig {
    /// Counts per motor turn after x4 decoding (four times the lines); a multiple of 4.
    pub counts_per_turn: u32,
    /// Coordinate at which the index state begins on one of the motor's turns; the others are whole leads away.
    pub index: f64,
    /// It counts backwards.
    #[serde(default)]
    pub reversed: bool,
}

/// A home switch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwitchConfig {
    /// Coordinate at which it trips, axis units.
    pub at: f64,
    /// On which side it is active.
    pub active: SwitchSide,
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

/// What drives a joint.
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
    /// Effort at the axis for code 8192; negative when the amplifier is wired the other way round.
    pub full_scale: f64,
    /// The amplifier gives no more than this effort.
    pub limit: f64,
}

/// A step motor with its drive; the data of its data sheet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepDrive {
    /// Full steps of the motor per turn (200 for 1.8 degrees).
    pub full_steps: u32,
    /// Steps (pulses) per full step.
    pub microsteps: u32,
    /// Largest static effort at the axis; the effort is this times the sine of the electrical lag.
    pub pull_out: f64,
    /// Damping by the drive, effort per axis unit per second.
    #[serde(default)]
    pub damping: f64,
    /// A positive step goes down.
    #[serde(default)]
    pub reversed: bool,
    /// Ticks of the board's step clock per microsecond, 1 to 1000.
    pub ticks_per_us: u16,
    /// Width of the pulses that the board makes, ns.
    pub pulse_ns: f64,
    /// Least width of a pulse that the drive is sure to see, ns.
    pub min_high_ns: f64,
    /// Least pause between two pulses, ns.
    pub min_low_ns: f64,
    /// Least time from a change of direction to the next pulse, ns.
    pub setup_ns: f64,
    /// Least time from the end of a pulse to a change of direction, ns.
    pub hold_ns: f64,
}

/// What is wrong in a [`PlantConfig`].
#[derive(Debug, Clone, PartialEq)]
pub struct PlantError {
    /// The field, as a path: `joint 2: motor_share`.
    pub field: String,
    /// What it must be.
    pub problem: String,
}

impl fmt::Display for PlantError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "plant: {}: {}", self.field, self.problem)
    }
}

impl core::error::Error for PlantError {}

/// Gathers every problem, so that a machine file is mended in one go.
#[derive(Default)]
pub(crate) struct Check(Vec<PlantError>);

impl Check {
    pub(crate) fn refuse(&mut self, field: String, problem: String) {
        self.0.push(PlantError { field, problem });
    }

    pub(crate) fn within(&mut self, field: String, value: f64, low: f64, high: f64) {
        if !(low..=high).contains(&value) {
            self.refuse(field, format!("{value} is not within {low} to {high}"));
        }
    }

    pub(crate) fn done(self) -> Result<(), Vec<PlantError>> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(self.0)
        }
    }
}

impl PlantConfig {
    /// Checks everything and gives every problem, not the first alone.
    ///
    /// # Errors
    /// The list is not empty.
    pub fn check(&self, period_us: u16) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        check.within("substep_us".into(), f64::from(self.substep_us), 5.0, 50.0);
        if self.substep_us == 0 || period_us == 0 || !period_us.is_multiple_of(self.substep_us) {
            check.refuse(
                "substep_us".into(),
                format!("the control period of {period_us} us is not a whole multiple"),
            );
        }
        let alone = self.joint.is_empty() && self.haptic.is_some() && self.arm.is_none();
        if (self.joint.is_empty() && !alone) || self.joint.len() > MAX_AXES {
            check.refuse(
                "joint".into(),
                format!("1 to {MAX_AXES} joints, not {}", self.joint.len()),
            );
        }
        if let Some(arm) = &self.arm {
            self.check_arm(arm, &mut check);
        }
        let cutter = self.cutter.clone().unwrap_or_default();
        for problem in self
            .process()
            .and_then(|process| process.check().err())
            .into_iter()
            .flatten()
            .chain(
                self.workpiece
                    .is_none()
                    .then(|| cutter.problems())
                    .into_iter()
                    .flatten(),
            )
        {
            check.refuse(problem.field, problem.problem);
        }
        let haptic = self.haptic.as_ref().and_then(|haptic| haptic.check().err());
        let hand = self.hand.as_ref().and_then(|hand| hand.check().err());
        for problem in haptic.into_iter().chain(hand).flatten() {
            check.refuse(problem.field, problem.problem);
        }
        if self.hand.is_some() && self.haptic.is_none() {
            check.refuse("hand".into(), "needs [plant.haptic] to hold on to".into());
        }
        for (index, joint) in self.joint.iter().enumerate() {
            joint.check(
                &format!("joint {index} ({})", joint.name),
                f64::from(self.substep_us),
                &mut check,
            );
        }
        check.done()
    }

    /// What there is at the tool, if anything is named.
    #[must_use]
    pub fn process(&self) -> Option<ProcessConfig> {
        let named = self.spindle.is_some()
            || self.cutter.is_some()
            || self.workpiece.is_some()
            || self.structure.is_some()
            || self.sensor.is_some();
        named.then(|| ProcessConfig {
            spindle: self.spindle.clone().unwrap_or_default(),
            cutting: self.workpiece.clone().map(|work| self.cutting(work)),
            wall: None,
            structure: self.structure.clone(),
            sensor: self.sensor.clone(),
        })
    }

    /// The machine's cutter in a work.
    #[must_use]
    pub fn cutting(&self, workpiece: WorkpieceConfig) -> CuttingConfig {
        CuttingConfig {
            cutter: self.cutter.clone().unwrap_or_default(),
            workpiece,
        }
    }

    fn check_arm(&self, arm: &ArmGeometry, check: &mut Check) {
        let kinds: Vec<_> = self.joint.iter().map(|joint| joint.kind).collect();
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Linear, Linear, Linear, Rotary] {
            check.refuse(
                "arm".into(),
                "needs four linear joints and then a rotary one, the table".into(),
            );
        }
        for (name, value) in [
            ("c", arm.c),
            ("r", arm.r),
            ("E = a - b - e", arm.a - arm.b - arm.e),
        ] {
            check.within(format!("arm: {name}"), value, 1.0, 2000.0);
        }
        for (name, value) in [
            ("d", arm.d),
            ("w", arm.w),
            ("ge", arm.ge),
            ("tl", arm.tl),
            ("p", arm.p),
            ("h", arm.h),
            ("x_off", arm.x_off),
            ("y_off", arm.y_off),
            ("z_off", arm.z_off),
        ] {
            check.within(format!("arm: {name}"), value, -2000.0, 2000.0);
        }
    }
}

impl JointConfig {
    /// Stiffness of the screw, effort per axis unit: the two sides swing against each other at `mode_hz`.
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

    /// Axis units per encoder count.
    pub fn per_count(&self) -> f64 {
        self.lead / f64::from(self.encoder.counts_per_turn)
    }

    fn check(&self, at: &str, substep_us: f64, check: &mut Check) {
        let substep = substep_us * 1e-6;
        check.within(format!("{at}: lead"), self.lead, 0.01, 1000.0);
        check.within(format!("{at}: inertia"), self.inertia, 1e-6, 1e5);
        check.within(format!("{at}: motor_share"), self.motor_share, 0.05, 0.95);
        // The spring is integrated explicitly: stay far from the stability bound at omega * substep = 2.
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
        check.within(format!("{at}: low"), self.low, -2000.0, 2000.0);
        check.within(format!("{at}: high"), self.high, self.low, 2000.0);
        check.within(format!("{at}: preset"), self.preset, self.low, self.high);
        // A switch may stand behind the end of the slide's way, where nothing reaches it, but the lower one is below the upper one.
        let (limit_low, limit_high) = (self.limit_low, self.limit_high);
        for (name, at_switch) in [("limit_low", limit_low), ("limit_high", limit_high)] {
            let place = at_switch.unwrap_or_default();
            check.within(format!("{at}: {name}"), place, -4000.0, 4000.0);
        }
        if let (Some(low), Some(high)) = (limit_low, limit_high)
            && low >= high
        {
            let problem = format!("{low} is not below limit_high, {high}");
            check.refuse(format!("{at}: limit_low"), problem);
        }
        let room = (self.preset - self.low).min(self.high - self.preset);
        check.within(format!("{at}: start_spread"), self.start_spread, 0.0, room);
        let slide = self.inertia * (1.0 - self.motor_share);
        let stiffest = 0.09 / (substep * substep) * slide / self.kind.acceleration_unit();
        check.within(
            format!("{at}: stop_stiffness"),
            self.stop_stiffness,
            0.0,
            stiffest,
        );
        let counts = self.encoder.counts_per_turn;
        if counts < 4 || !counts.is_multiple_of(4) || counts > 4_000_000 {
            check.refuse(
                format!("{at}: encoder: counts_per_turn"),
                format!("{counts} is not a multiple of 4 up to 4000000"),
            );
        }
        check.within(
            format!("{at}: encoder: index"),
            self.encoder.index,
            -4000.0,
            4000.0,
        );
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
