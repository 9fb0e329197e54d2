//! Sentences that need no data of the machine.

use crate::message::{
    Action, Command, ConfigField, HelloRefusal, HomingProblem, OutputProblem, OverrideMode, Source,
    State,
};
use core::fmt::{Display, Formatter, Result};

impl Display for HelloRefusal {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.write_str(match self {
            Self::Busy => {
                "another host is connected and the machine is active; stop the other host first"
            }
            Self::Version => {
                "the controller has another version of the protocol; \
                 use host and firmware of one release"
            }
            Self::Schema => {
                "host and controller have different message types; \
                 use host and firmware of one release"
            }
        })
    }
}

impl Display for State {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.pad(match self {
            Self::Disabled => "disabled",
            Self::Idle => "idle",
            Self::Homing => "homing",
            Self::Run => "running",
            Self::Jog => "jogging",
            Self::Hold => "on hold",
            Self::Fault => "in fault",
            Self::EmergencyStop => "in emergency stop",
        })
    }
}

impl Display for Source {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.pad(match self {
            Self::Program => "program",
            Self::Jog => "jog",
            Self::Hold => "hold",
            Self::Master => "master",
        })
    }
}

impl Display for Action {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self {
            Self::None => f.write_str("nothing"),
            Self::Spindle(0) => f.write_str("spindle off"),
            Self::Spindle(speed) => write!(f, "spindle to {speed} rev/min"),
            Self::OverrideMode(OverrideMode::RAPID) => f.write_str("rapid"),
            Self::OverrideMode(OverrideMode::FEED_AND_RAPID) => f.write_str("feed or rapid"),
            Self::OverrideMode(OverrideMode::FIXED) => f.write_str("fixed speed"),
            Self::OverrideMode(mode) => write!(f, "feed up to {} %", mode.max_percent()),
            Self::Pause => f.write_str("pause"),
            Self::Output { output, on } => {
                let on = if *on { "on" } else { "off" };
                write!(f, "output {} {on}", u32::from(*output) + 1)
            }
            Self::AnalogOutput { output, code } => {
                write!(f, "analog output {} to code {code}", u32::from(*output) + 1)
            }
        }
    }
}

impl Display for HomingProblem {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.write_str(match self {
            Self::NoIndex => "no index pulse within the search distance; check the encoder and the preset",
            Self::NoSwitch => "the home switch did not become active within its largest travel; check that it is connected, its active level in the machine file, that the joint moves towards it (`direction` of its drive), and that nothing blocks it",
            Self::Stalled => "the joint did not follow; remove what blocks it",
            Self::Implausible => "the reference is too far from the preset; set the joints up at their presets by hand",
            Self::Workspace => "the search would leave the workspace; set the joints up at their presets by hand",
            Self::Stopped => "homing was stopped",
            Self::SwitchStuck => "the home switch stays active where it must be released; check its wiring, its active level in the machine file, that it is not stuck, and that the joint was not farther behind it than `release_mm`; then try again",
            Self::SwitchUnsteady => "the home switch became active at two different positions; check that it is tight and its cable, that back_off_mm is longer than its play, and that the motor has not lost steps",
            Self::LimitStuck => "the limit switch did not open while the joint moved off it by a sixteenth of its stroke; check that the joint moves, that the switch is not stuck, its active level, and that the switches of the two ends are not exchanged; then try again or move it off by hand",
        })
    }
}

impl Display for ConfigField {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.write_str(match self {
            Self::Encoding => "encoding",
            Self::Period => "control period",
            Self::CoordinateCount => "number of coordinates or joints",
            Self::Geometry => "geometry",
            Self::Stroke => "stroke",
            Self::SoftLimit => "soft limits",
            Self::Rate => "maximum rate",
            Self::Acceleration => "maximum acceleration",
            Self::Jerk => "maximum jerk",
            Self::Encoder => "encoder scaling",
            Self::Drive => "drive",
            Self::Gain => "gains of the position loop",
            Self::Filter => "filter of the position loop",
            Self::Following => "following error limit",
            Self::Backlash => "backlash",
            Self::Homing => "homing",
            Self::Heartbeat => "heartbeat",
            Self::StopTime => "stop time",
            Self::Force => "force sensor or force loop",
            Self::Haptic => "haptic arm",
            Self::Follow => "teleoperation ([follow])",
            Self::Input => "inputs (a channel or function that is used twice, or a range)",
            Self::Output => "outputs (a channel or function that is used twice, or a range)",
            Self::Gantry => {
                "gantry (both motors need equal searches of their switches, equal presets, and a \
                 largest racking)"
            }
            Self::Volumetric => "volumetric compensation (needs joints x, y, z with 4 mm of stroke beyond the soft limits; \
                 or size, slope or range of a table)",
        })
    }
}

impl Display for OutputProblem {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        f.write_str(match self {
            Self::Unknown => {
                "the machine has no such output; add it to the machine file and configure the \
                 controller with it"
            }
            Self::Range => "the value is out of the range of this output",
            Self::FollowsSpindle => "it follows the spindle; command the spindle instead",
            Self::SpindleTurns => "it is the tool clamp and the spindle turns; stop the spindle",
            Self::ClampOpen => {
                "it is the tool clamp and it is off; clamp the tool before the spindle starts"
            }
        })
    }
}

impl Command {
    /// Name of the command.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Setpoints(_) => "setpoints",
            Self::Ping => "ping",
            Self::Configure(_) => "configure",
            Self::Activate { .. } => "activate",
            Self::Store { .. } => "store",
            Self::Enable => "enable",
            Self::Disable => "disable",
            Self::Home => "home",
            Self::Reset => "reset",
            Self::JobStart { .. } => "job start",
            Self::JobEnd { .. } => "job end",
            Self::Hold => "hold",
            Self::Resume => "resume",
            Self::Stop => "stop",
            Self::EmergencyStop => "emergency stop",
            Self::Jog { .. } => "jog",
            Self::JogCancel { .. } => "jog cancel",
            Self::Source { .. } => "source",
            Self::Override { .. } => "override",
            Self::Telemetry { .. } => "telemetry",
            Self::Status => "status",
            Self::ForceMask { .. } => "force axes",
            Self::ForceLoop { .. } => "force set",
            Self::Tare => "tare",
            Self::MasterPose { .. } => "master pose",
            Self::RemoteForce { .. } => "remote force",
            Self::ForceFeedback(_) => "force feedback",
            Self::VirtualFixture { .. } => "virtual fixture",
            Self::PositionScale { .. } => "position scale",
            Self::MasterTelemetry { .. } => "master telemetry",
            Self::ForceSettings { .. } => "force settings",
            Self::SetOutput { .. } => "set output",
            Self::SetAnalogOutput { .. } => "set analog output",
            Self::Compensation { .. } => "compensation",
            Self::ArmProbe { .. } => "arm probe",
            Self::RapidOverride { .. } => "rapid override",
            Self::SpindleOverride { .. } => "spindle override",
            Self::MoveOff { .. } => "move off",
        }
    }
}
