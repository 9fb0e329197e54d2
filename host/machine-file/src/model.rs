//! Model of the machine for the planner: the firmware's kinematics in millimetres and degrees.
//!
//! A program is checked with the same code that moves the machine.

use crate::place::unit;
use crate::scale::per_unit;
use crate::work_data::tools_path;
use crate::{IoNames, MachineFile};
use haptimill_firmware::config::{self, ChipKind, DriveChip};
use haptimill_firmware::named_io::config::OutputFunction;
use haptimill_gcode::{Coordinates, Options, ProgramAxis, ToolAxis, WordKind};
use haptimill_kinematics::BoundedKinematics;
use haptimill_kinematics::descriptor::{Descriptor, Role};
use haptimill_kinematics::{Accelerations, Kinematics, Pose, Rates};
use haptimill_math::{Coordinate, Rate};
use haptimill_planner::{
    AnalogueOutput, JointLimits, MachineModel, Outputs, PoseLimits, PoseProblem, Settings,
};
use haptimill_protocol::message::{AxisValues, MAX_AXES, PoseError, Telemetry};
use haptimill_protocol::text::{AxesText, AxisText, ChipText};
use std::path::Path;

/// Kinematics of a machine file, with axis names.
#[derive(Debug, Clone)]
pub struct Model {
    machine: BoundedKinematics,
    /// Pose coordinates that wrap around, one bit each.
    wrapping: u8,
    pose: Vec<(String, config::AxisKind)>,
    joints: Vec<(String, config::AxisKind)>,
    /// Axis units per millimetre or degree of `pose` and `joints`.
    pose_scale: Vec<f64>,
    joint_scale: Vec<f64>,
    io: IoNames,
    /// Driver chips, by joint.
    chips: Vec<Option<ChipText>>,
}

/// Rounds to the nearest whole number, half away from 0, as `f64::round` does without a call.
fn round(value: f64) -> f64 {
    const WHOLE: f64 = 4_503_599_627_370_496.0;
    if !(-WHOLE..=WHOLE).contains(&value) {
        return value;
    }
    let part = value as i64 as f64;
    let rest = value - part;
    if rest >= 0.5 {
        part + 1.0
    } else if rest <= -0.5 {
        part - 1.0
    } else {
        part
    }
}

fn program_kind(kind: config::AxisKind) -> WordKind {
    if kind.is_rotary() {
        WordKind::Rotary
    } else {
        WordKind::Linear
    }
}

const fn chip_text(chip: &DriveChip) -> ChipText {
    match chip.kind {
        ChipKind::Tmc2209 => ChipText::Address(chip.place),
        ChipKind::Tmc5160 => ChipText::Position(chip.place),
    }
}

impl Model {
    /// Creates the model of a machine file.
    #[must_use]
    pub fn new(machine: &MachineFile) -> Self {
        let joints = machine.config.joints.iter();
        let chips = joints.map(|joint| joint.chip().map(chip_text));
        Self {
            machine: machine.config.kinematics(),
            wrapping: machine.config.wrapping(),
            pose: machine
                .pose
                .iter()
                .map(|axis| (axis.name.clone(), axis.kind))
                .collect(),
            joints: machine
                .joints
                .iter()
                .map(|axis| (axis.name.clone(), axis.kind))
                .collect(),
            pose_scale: machine.pose.iter().map(|it| per_unit(it.kind)).collect(),
            joint_scale: machine.joints.iter().map(|it| per_unit(it.kind)).collect(),
            io: machine.io.clone(),
            chips: chips.collect(),
        }
    }

    /// Names of inputs and outputs.
    #[must_use]
    pub const fn io(&self) -> &IoNames {
        &self.io
    }

    /// Removes names and units of all axes, inputs and outputs.
    pub fn clear_axes(&mut self) {
        self.pose.clear();
        self.joints.clear();
        self.pose_scale.clear();
        self.joint_scale.clear();
        self.io = IoNames::default();
        self.chips.clear();
    }

    /// Axis units of a coordinate in millimetres or degrees, rounded; within half a turn of 0 if it
    /// wraps around.
    fn whole_units(&self, axis: usize, scale: f64, value: f64) -> f64 {
        let value = round(value * scale);
        if self.wrapping >> axis & 1 != 0 {
            f64::from(value as i64 as i32)
        } else {
            value
        }
    }

    /// Converts a pose in millimetres and degrees to axis units, rounded.
    #[must_use]
    pub fn to_axis_units(&self, pose: &Coordinates) -> AxisValues {
        let axes = self.pose_scale.iter().zip(pose).enumerate();
        axes.map(|(axis, (scale, value))| self.whole_units(axis, *scale, *value) as i32)
            .collect()
    }

    /// Converts a pose in axis units to millimetres and degrees.
    #[must_use]
    pub fn to_engineering_units(&self, pose: &AxisValues) -> Coordinates {
        let mut values = Coordinates::default();
        for (slot, ((_, kind), value)) in values.iter_mut().zip(self.pose.iter().zip(pose)) {
            *slot = f64::from(*value) / per_unit(*kind);
        }
        values
    }

    /// Converts joint positions in axis units to millimetres and degrees.
    #[must_use]
    pub fn joints_to_engineering_units(&self, joints: &AxisValues) -> Vec<f64> {
        self.joints
            .iter()
            .zip(joints)
            .map(|((_, kind), value)| f64::from(*value) / per_unit(*kind))
            .collect()
    }

    /// Converts a pose of `telemetry` in axis units to millimetres and degrees. A coordinate that
    /// wraps around counts on over the turns of the joint of its name.
    #[must_use]
    pub fn unwound_pose(&self, pose: &AxisValues, telemetry: &Telemetry) -> Coordinates {
        let mut values = self.to_engineering_units(pose);
        let axes = self.pose.iter().zip(pose).zip(&mut values).enumerate();
        for (axis, (((name, kind), raw), value)) in axes {
            if self.wrapping >> axis & 1 != 0 {
                let joint = self.joints.iter().position(|(joint, _)| joint == name);
                *value = telemetry.unwound(joint, *raw) as f64 / per_unit(*kind);
            }
        }
        values
    }

    /// Converts the measured joints of `telemetry` to millimetres and degrees; joints that wrap
    /// around count on over their turns.
    #[must_use]
    pub fn unwound_joints(&self, telemetry: &Telemetry) -> Vec<f64> {
        let mut values = self.joints_to_engineering_units(&telemetry.joints);
        for (value, turns) in values.iter_mut().zip(&telemetry.turns) {
            *value += 360.0 * f64::from(*turns);
        }
        values
    }

    /// Returns the names of the pose coordinates.
    #[must_use]
    pub fn pose_names(&self) -> Vec<&str> {
        self.pose.iter().map(|(name, _)| name.as_str()).collect()
    }

    /// Returns the names of the joints.
    #[must_use]
    pub fn joint_names(&self) -> Vec<&str> {
        self.joints.iter().map(|(name, _)| name.as_str()).collect()
    }

    /// Returns the units of the pose coordinates in messages: `mm` or `deg`.
    #[must_use]
    pub fn pose_units(&self) -> Vec<&'static str> {
        self.pose.iter().map(|(_, kind)| unit(*kind)).collect()
    }

    /// Returns the units of the joints in messages: `mm` or `deg`.
    #[must_use]
    pub fn joint_units(&self) -> Vec<&'static str> {
        self.joints.iter().map(|(_, kind)| unit(*kind)).collect()
    }

    /// Calls `use_axes` with names and kinds of the axes, for messages.
    pub fn with_axes<T>(&self, use_axes: impl FnOnce(&AxesText<'_>) -> T) -> T {
        fn list(axes: &[(String, config::AxisKind)]) -> Vec<AxisText<'_>> {
            axes.iter()
                .map(|(name, kind)| AxisText { name, kind: *kind })
                .collect()
        }
        let (pose, joints) = (list(&self.pose), list(&self.joints));
        let inputs: Vec<&str> = self.io.inputs.iter().map(String::as_str).collect();
        let outputs: Vec<&str> = self.io.outputs.iter().map(String::as_str).collect();
        let analog = self.io.analog_outputs.iter();
        let analog_outputs: Vec<&str> = analog.map(|it| it.name.as_str()).collect();
        let errors = self.machine.descriptor().errors.iter();
        let pose_errors: Vec<&str> = errors.map(|error| error.sentence).collect();
        use_axes(&AxesText {
            pose_errors: &pose_errors,
            pose: &pose,
            joints: &joints,
            chips: &self.chips,
            inputs: &inputs,
            outputs: &outputs,
            analog_outputs: &analog_outputs,
        })
    }

    /// Returns the home pose, with the same bits as the controller's after an ideal homing.
    #[must_use]
    pub fn home(&self, machine: &MachineFile) -> Option<AxisValues> {
        let mut joints = haptimill_kinematics::Joints::default();
        for (slot, preset) in joints.0.iter_mut().zip(machine.preset()) {
            *slot = preset;
        }
        // A haptic arm alone has no tool pose.
        let pose = self
            .machine
            .forward(&joints)
            .ok()
            .filter(|_| !self.pose.is_empty())?;
        Some(
            pose.0
                .iter()
                .take(self.pose.len())
                .map(|coordinate| coordinate.0)
                .collect(),
        )
    }

    fn pose(&self, pose: &Coordinates) -> Option<Pose> {
        let mut units_of = Pose::default();
        let values = self.pose_scale.iter().zip(pose).enumerate();
        for (slot, (axis, (scale, value))) in units_of.0.iter_mut().zip(values) {
            let value = self.whole_units(axis, *scale, *value);
            if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value) {
                return None;
            }
            *slot = Coordinate(value as i32);
        }
        Some(units_of)
    }
}

impl Model {
    /// Joint rates for rates of a pose; `None` if the firmware refuses the pose.
    fn solved_rates(&self, pose: &Coordinates, rates: &Coordinates) -> Option<[f64; MAX_AXES]> {
        // The firmware's rates are below 2^31 axis units per second. The map is linear, so larger
        // rates are scaled down.
        let scaled = self.pose_scale.iter().zip(rates);
        let largest = scaled
            .map(|(scale, rate)| (rate * scale).abs())
            .fold(0.0, f64::max);
        let shrink = if largest > 1e8 { 1e8 / largest } else { 1.0 };
        let mut scaled_rates = Rates::default();
        for (slot, (scale, rate)) in scaled_rates
            .iter_mut()
            .zip(self.pose_scale.iter().zip(rates))
        {
            *slot = Rate(round(rate * scale * shrink) as i32);
        }
        let units_of = self.pose(pose)?;
        let motion = self
            .machine
            .inverse_motion(&units_of, &scaled_rates, &Accelerations::default())
            .ok()?;
        let mut values = [0.0; MAX_AXES];
        for (slot, (scale, rate)) in values
            .iter_mut()
            .zip(self.joint_scale.iter().zip(motion.rates))
        {
            *slot = f64::from(rate.0) / scale;
            if shrink < 1.0 {
                *slot /= shrink;
            }
        }
        Some(values)
    }
}

impl MachineModel for Model {
    fn joints(&self, pose: &Coordinates) -> Result<[f64; 6], PoseProblem> {
        let units_of = self.pose(pose).ok_or_else(|| {
            PoseProblem("is beyond the number range of the controller".to_string())
        })?;
        match self.machine.inverse(&units_of) {
            Ok(joints) => {
                let mut values = [0.0; MAX_AXES];
                for (slot, (scale, value)) in
                    values.iter_mut().zip(self.joint_scale.iter().zip(joints.0))
                {
                    *slot = f64::from(value.0) / scale;
                }
                Ok(values)
            }
            Err(error) => Err(PoseProblem(
                self.with_axes(|axes| axes.describe(&error).to_string()),
            )),
        }
    }

    fn joint_rates(&self, pose: &Coordinates, rates: &Coordinates) -> [f64; 6] {
        self.solved_rates(pose, rates).unwrap_or_default()
    }

    fn checked_joint_rates(
        &self,
        pose: &Coordinates,
        rates: &Coordinates,
    ) -> Result<[f64; 6], PoseProblem> {
        // The firmware refuses a moving pose for the reasons for which it refuses one at rest.
        match self.solved_rates(pose, rates) {
            Some(joints) => Ok(joints),
            None => self.joints(pose).map(|_| [0.0; MAX_AXES]),
        }
    }
}

/// Returns the outputs of a machine file that a program can set.
fn outputs(machine: &MachineFile) -> Outputs {
    let io = &machine.config.io;
    let with = |function: OutputFunction| {
        let mut outputs = (0..).zip(&io.outputs);
        outputs.find_map(|(index, output)| (output.function == function).then_some(index))
    };
    let analogue = io.analog_outputs.iter().zip(&machine.io.analog_outputs);
    Outputs {
        flood: with(OutputFunction::Coolant),
        mist: with(OutputFunction::Mist),
        digital: io
            .outputs
            .iter()
            .map(|output| !output.function.follows_spindle())
            .collect(),
        analogue: analogue
            .map(|(output, named)| AnalogueOutput {
                codes: [output.low, output.high],
                per_unit: f64::from(1_u32 << 15) / named.full_scale,
                unit: named.unit.clone(),
            })
            .collect(),
    }
}

/// Returns the planner settings of a machine file.
#[must_use]
pub fn settings(machine: &MachineFile) -> Settings {
    let pose: Vec<PoseLimits> = machine
        .pose
        .iter()
        .zip(machine.config.model.descriptor().pose)
        .map(|(axis, described)| PoseLimits {
            letter: described.letter,
            kind: program_kind(axis.kind),
            units: per_unit(axis.kind),
            low: axis.low,
            high: axis.high,
            rate: axis.rate,
            acceleration: axis.acceleration,
            jerk: axis.jerk,
        })
        .collect();
    let joints = machine
        .joints
        .iter()
        .map(|axis| JointLimits {
            name: axis.name.clone(),
            unit: unit(axis.kind),
            rate: axis.rate,
            acceleration: axis.acceleration,
            jerk: Settings::joint_jerk(&pose, axis.acceleration),
        })
        .collect();
    Settings {
        outputs: outputs(machine),
        spindle_rpm: machine.spindle.rpm,
        tolerance_mm: machine.planner.corner_tolerance_mm,
        tolerance_deg: machine.planner.corner_tolerance_deg,
        curvature_step: machine.planner.curvature_step,
        longest_span_s: machine.planner.longest_span_ms / 1000.0,
        shortest_span_s: machine.planner.shortest_span_ms / 1000.0,
        braking_s: {
            let stopping = &machine.config.stopping;
            let [time, ramp] = [stopping.time_ms, stopping.ramp_ms].map(f64::from);
            [(time - ramp) / 1000.0, ramp / 1000.0]
        },
        ..Settings::new(pose, joints, machine.config.period_us)
    }
}

/// Returns the options for part programs that start at `start`.
#[must_use]
pub fn program_options(machine: &MachineFile, start: Coordinates) -> Options {
    let axes = machine
        .pose
        .iter()
        .zip(machine.config.model.descriptor().pose)
        .map(|(axis, described)| ProgramAxis {
            letter: described.letter,
            kind: program_kind(axis.kind),
            wraps: axis.wraps(),
        })
        .collect();
    let outputs = outputs(machine);
    Options {
        axes,
        start,
        coolant: outputs.flood.is_some() || outputs.mist.is_some(),
        outputs: !outputs.digital.is_empty()
            || !outputs.analogue.is_empty()
            || !machine.io.inputs.is_empty()
            || !machine.io.analog_inputs.is_empty(),
        tool_axis: tool_axis(machine.config.model.descriptor()),
        tools_file: tools_path(Path::new(&machine.file)).display().to_string(),
        ..Options::default()
    }
}

/// Returns the coordinates that turn the tool of a machine in its workpiece.
#[must_use]
pub fn tool_axis(machine: &Descriptor) -> ToolAxis {
    let Some(tip) = machine.tool_tip() else {
        return ToolAxis::default();
    };
    ToolAxis {
        tip,
        tilt: machine.coordinate(Role::ToolTilt),
        rotation: machine.coordinate(Role::WorkpieceRotation),
        table: machine.coordinate(Role::TableRotation),
    }
}

/// Returns the code of a pose error in tables and JSON output, of a machine with this descriptor.
#[must_use]
pub fn pose_error_code(error: PoseError, machine: &Descriptor) -> &'static str {
    match error {
        PoseError::Unreachable => "unreachable",
        PoseError::OutOfStroke { .. } => "out_of_stroke",
        PoseError::NearSingularity { .. } => "near_singularity",
        PoseError::Geometry { code } => machine
            .errors
            .get(usize::from(code))
            .map_or("refused", |error| error.name),
    }
}
