//! Reads the sections of a machine file, and compares them with each other.

use super::axes::{self, AxisLimits};
use super::axis_places::read_axes;
use super::document::{Document, Section};
use super::models::ModelReader;
use super::scale::{PER_DEG, PER_MM, to_i32, to_u16};
use super::{IoNames, MachineFile, Planner, Spindle};
use super::{compensation, force, gantry, haptic, named_io, place};
use haptimill_firmware::config::{
    Config, Home, Homing, JointSettings, PoseAxis, Stopping, Supervision,
};
use haptimill_kinematics::Model;
use haptimill_machine_keys::controller::{self, root};
use haptimill_math::Rate;
use toml::Spanned;
use toml::de::DeTable;

pub(crate) fn read(document: &Document<'_>, root: &Spanned<DeTable<'_>>) -> MachineFile {
    let root = Section::root(document, root.get_ref());
    // Checked before.
    root.has(root::format.name);
    let name = read_name(&root);
    let period_us = root.value(root::period_us);
    if 1e6 % period_us > 0.0 {
        let what = "does not divide a second, 1,000,000 us";
        root.refuse(root::period_us, what, "write 100, 200, 250 or 500");
    }
    if root.has("role") {
        let role = root.choice(root::role, &[("machine", false), ("master", true)]);
        if role == Some(true) {
            return read_master(&root, name, period_us);
        }
    }

    let stopping = root.section("stopping").map(read_stopping);
    let kinematics = root.section("kinematics");
    let model = kinematics.as_ref().and_then(ModelReader::of);
    // Without a model the keys that depend on it are unknown: one report is enough.
    let singular = model.map(|model| model.has_singularity);
    let planner = root.section("planner").map(read_planner);
    let spindle = read_spindle(&root);
    let places = model.map_or_else(Vec::new, |model| model.pose());
    let pose = read_axes(&root, "pose", &places);
    let pose: Vec<_> = pose
        .iter()
        .map(|(section, place)| (section, axes::read_pose_axis(section, *place)))
        .collect();
    let places = model.map_or_else(Vec::new, |model| model.joints());
    let mut joints = gantry::read_joints(&root, &places, period_us / 1e6);
    check_pose_against_joints(&pose, &joints, model);
    // A joint without its drive may have an encoder or not.
    let encoders = joints.is_empty() || joints.iter().any(|(joint, _)| joint.encoder.is_some());
    let encoders = (encoders
        || !root.has_problem(|key| key.ends_with(".drive") || key.ends_with("drive.kind")))
    .then_some(encoders);
    let (supervision, margin) = root
        .section("supervision")
        .map(|section| read_supervision(section, singular, encoders))
        .unzip();
    let margin = margin.unwrap_or(f64::NAN);
    let geometry = kinematics
        .zip(model)
        .map(|(section, model)| model.read(section, margin));
    let homing = read_homing(&root, &joints);
    let force = if root.has("force") {
        root.section("force")
            .map(|section| force::read_force(&section, period_us))
    } else {
        None
    };
    let follow = if root.has("follow") {
        root.section("follow")
            .map(|section| haptic::read_follow(&section))
    } else {
        None
    };
    let arm = if root.has("haptic") {
        root.section("haptic")
            .map(|section| haptic::read_haptic(&section))
    } else {
        None
    };
    let (io, io_names) = named_io::read(&root, period_us);
    let volumetric = if root.has("compensation") {
        let axes: Vec<_> = pose.iter().map(|(_, (axis, _))| axis.clone()).collect();
        let section = root.section("compensation");
        let joints = joints.iter_mut().map(|(joint, _)| joint);
        section.and_then(|section| compensation::read(&section, &axes, joints))
    } else {
        None
    };
    let has_plant = root.has("plant");
    root.finish();

    let (pose, pose_limits): (Vec<_>, Vec<_>) = pose.into_iter().map(|(_, axis)| axis).unzip();
    let (joints, joint_limits): (Vec<_>, Vec<_>) = joints.into_iter().unzip();
    MachineFile {
        file: String::new(),
        text: String::new(),
        config: Config {
            name,
            period_us: to_u16(period_us),
            model: geometry.unwrap_or(Model::None),
            pose: pose.into_iter().take(6).collect(),
            joints: joints.into_iter().take(6).collect(),
            stopping: stopping.unwrap_or(Stopping {
                time_ms: 0,
                ramp_ms: 0,
            }),
            supervision: supervision.unwrap_or(Supervision {
                heartbeat_ms: 0,
                missed_periods: 0,
                illegal_transitions: 0,
            }),
            homing,
            force,
            follow,
            haptic: arm,
            io,
            volumetric,
        },
        pose: pose_limits,
        joints: joint_limits,
        io: io_names,
        planner: planner.unwrap_or(NO_PLANNER),
        spindle,
        has_plant,
    }
}

/// Reads the machine file of a haptic arm alone, which has no axes and no planner.
fn read_master(root: &Section<'_, '_>, name: heapless::String<24>, period_us: f64) -> MachineFile {
    let supervision = root.section("supervision").map(|section| {
        let heartbeat = section.value(controller::supervision::heartbeat_ms);
        let missed = section.value(controller::supervision::missed_periods);
        section.finish();
        (to_u16(heartbeat), to_u16(missed))
    });
    let (heartbeat_ms, missed_periods) = supervision.unwrap_or_default();
    let arm = root
        .section("haptic")
        .map(|section| haptic::read_haptic(&section));
    let has_plant = root.has("plant");
    root.finish();
    MachineFile {
        file: String::new(),
        text: String::new(),
        config: Config {
            name,
            period_us: to_u16(period_us),
            model: Model::None,
            pose: heapless::Vec::new(),
            joints: heapless::Vec::new(),
            // Valid values; without axes they have no effect.
            stopping: Stopping {
                time_ms: 100,
                ramp_ms: 20,
            },
            supervision: Supervision {
                heartbeat_ms,
                missed_periods,
                illegal_transitions: 0,
            },
            homing: Homing {
                rate: Rate(0),
                rotary_rate: Rate(0),
            },
            force: None,
            follow: None,
            haptic: arm,
            io: Default::default(),
            volumetric: None,
        },
        pose: Vec::new(),
        joints: Vec::new(),
        io: IoNames::default(),
        planner: NO_PLANNER,
        spindle: ANY_SPINDLE,
        has_plant,
    }
}

/// Placeholder for a planner section that is missing or has problems.
const NO_PLANNER: Planner = Planner {
    corner_tolerance_mm: f64::NAN,
    corner_tolerance_deg: f64::NAN,
    curvature_step: f64::NAN,
    longest_span_ms: f64::NAN,
    shortest_span_ms: f64::NAN,
};

/// The spindle of a machine file without the section: any speed of the protocol.
const ANY_SPINDLE: Spindle = Spindle {
    rpm: [0, i16::MAX],
    run_up_s: 5.0,
};

fn read_name(root: &Section<'_, '_>) -> heapless::String<24> {
    let name = root
        .text("name", "add a name of 1 to 24 bytes")
        .unwrap_or_default();
    heapless::String::try_from(name).unwrap_or_else(|_| {
        let what = format!("\"{name}\" has {} bytes, allowed are 1 to 24", name.len());
        root.report("name", what, "shorten it");
        heapless::String::new()
    })
}

/// Checks the limits of pose coordinates that are joints themselves.
fn check_pose_against_joints(
    pose: &[(&Section<'_, '_>, (PoseAxis, AxisLimits))],
    joints: &[(JointSettings, AxisLimits)],
    model: Option<ModelReader>,
) {
    for (index, (section, (_, limits))) in pose.iter().enumerate() {
        let named = format!("pose[{}].name", index + 1);
        if section.has_problem(|key| key == named) {
            // The joint of another coordinate is not compared.
            continue;
        }
        let ends = [
            (controller::pose::low, limits.low),
            (controller::pose::high, limits.high),
        ];
        // A pose coordinate may be a joint itself, as a table is.
        let joint = joints.iter().find(|(_, joint)| joint.name == limits.name);
        let role = model.and_then(|model| model.descriptor.pose.get(index));
        if limits.wraps() && role.is_some_and(|axis| !axis.role.may_wrap()) {
            let what = "is a direction of the tool or of the workpiece, which has limits";
            section.report("wrap", what, "write soft limits");
            continue;
        }
        if limits.wraps() != joint.is_some_and(|(_, joint)| joint.wraps()) {
            // The limits of the other one are not what is missing.
            let joint = joints
                .iter()
                .position(|(_, joint)| joint.name == limits.name);
            for (list, index) in [("pose", Some(index)), ("joint", joint)] {
                for key in [controller::pose::low, controller::pose::high] {
                    let number = index.map_or(0, |index| index + 1);
                    let key = section.key(key).name;
                    section.forget_missing(&format!("{list}[{number}].{key}"));
                }
            }
            let what =
                "a coordinate that wraps around is a joint of the same name that does so too";
            section.report(
                "wrap",
                what,
                "write `wrap = true` for both, or limits for both",
            );
            continue;
        }
        let Some((_, joint)) = joint else {
            continue;
        };
        let (low, high, unit) = (joint.low, joint.high, place::unit(limits.kind));
        for (key, value) in ends {
            if value < low || value > high {
                let what =
                    format!("{value} {unit} is outside the joint's stroke {low} to {high} {unit}");
                section.refuse(key, what, "narrow the soft limits");
            }
        }
        if limits.rate > joint.rate {
            let what = format!("{} is above the joint's rate {}", limits.rate, joint.rate);
            section.refuse(controller::pose::rate, what, "lower it");
        }
    }
}

fn read_stopping(section: Section<'_, '_>) -> Stopping {
    let time = section.value(controller::stopping::time_ms);
    let ramp = section.value(controller::stopping::ramp_ms);
    if ramp > time / 2.0 {
        let what = format!("{ramp} ms is more than half of time_ms = {time}");
        section.report("ramp_ms", what, "lower it");
    }
    section.finish();
    Stopping {
        time_ms: to_u16(time),
        ramp_ms: to_u16(ramp),
    }
}

fn read_supervision(
    section: Section<'_, '_>,
    singular: Option<bool>,
    encoders: Option<bool>,
) -> (Supervision, f64) {
    let transitions = controller::supervision::illegal_transitions;
    let result = Supervision {
        heartbeat_ms: to_u16(section.value(controller::supervision::heartbeat_ms)),
        missed_periods: to_u16(section.value(controller::supervision::missed_periods)),
        illegal_transitions: if encoders.unwrap_or_else(|| section.has(transitions.name)) {
            to_u16(section.value(transitions))
        } else {
            0
        },
    };
    let key = controller::supervision::singularity_margin_mm;
    // Of an unknown model it is not known whether it needs the key.
    let margin = if singular.unwrap_or_else(|| section.has(key.name)) {
        section.value(key)
    } else {
        0.0
    };
    section.finish();
    (result, margin)
}

/// Reads the rates of the search for the index pulses; a machine without a joint that homes by its
/// index has no such section.
fn read_homing(root: &Section<'_, '_>, joints: &[(JointSettings, AxisLimits)]) -> Homing {
    let searched = |rotary| {
        let mut joints = joints.iter();
        joints.any(|(joint, _)| joint.kind.is_rotary() == rotary && joint.home == Home::Index)
    };
    let (linear, rotary) = (searched(false), searched(true));
    let mut homing = Homing {
        rate: Rate(0),
        rotary_rate: Rate(0),
    };
    // A joint with a problem may need the section or not.
    let is_unknown = root.has_problem(|key| key.starts_with("joint["));
    if is_unknown && !root.has("homing") {
        return homing;
    }
    if !joints.is_empty() && !linear && !rotary {
        if root.has("homing") {
            let what = "has no meaning: no joint homes by its index pulse";
            root.report("homing", what, "remove it");
        }
        return homing;
    }
    if let Some(section) = root.section("homing") {
        if linear {
            homing.rate = Rate(to_i32(
                section.value(controller::homing::rate_mm_s) * PER_MM,
            ));
        }
        if rotary {
            let rate = section.value(controller::homing::rate_deg_s);
            homing.rotary_rate = Rate(to_i32(rate * PER_DEG));
        }
        section.finish();
    }
    homing
}

fn read_planner(section: Section<'_, '_>) -> Planner {
    let result = Planner {
        corner_tolerance_mm: section.value(controller::planner::corner_tolerance_mm),
        corner_tolerance_deg: section.value(controller::planner::corner_tolerance_deg),
        curvature_step: section.value(controller::planner::curvature_step),
        longest_span_ms: section.value(controller::planner::longest_span_ms),
        shortest_span_ms: section.value(controller::planner::shortest_span_ms),
    };
    if result.shortest_span_ms > result.longest_span_ms {
        let what = format!(
            "{} is above longest_span_ms = {}",
            result.shortest_span_ms, result.longest_span_ms
        );
        section.report("shortest_span_ms", what, "exchange them");
    }
    section.finish();
    result
}

fn read_spindle(root: &Section<'_, '_>) -> Spindle {
    let Some(section) = root
        .has("spindle")
        .then(|| root.section("spindle"))
        .flatten()
    else {
        return ANY_SPINDLE;
    };
    let rpm = [controller::spindle::min_rpm, controller::spindle::max_rpm];
    let spindle = Spindle {
        // The range of the keys is that of the type.
        rpm: rpm.map(|key| section.value(key) as i16),
        run_up_s: section.value(controller::spindle::run_up_s),
    };
    let [slowest, fastest] = spindle.rpm;
    if slowest > fastest {
        let what = format!("{slowest} is above max_rpm = {fastest}");
        section.report("min_rpm", what, "exchange them");
    }
    section.finish();
    spindle
}
