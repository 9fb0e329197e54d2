//! Machine files: all data of a machine, for the controller, the planner and the simulated plant.
//!
//! A machine file is TOML in engineering units; the unit is part of the key (`rate_mm_s`,
//! `low_deg`, `heartbeat_ms`). One multiplication and one rounding per value give the controller's
//! integers ([`Config`], see `scale.rs`). Every problem of a file is reported with its line, its
//! value, the allowed range and the remedy.
//!
//! A machine file without a problem is consistent. The check cannot know whether the file describes
//! the real machine.

mod axes;
pub mod compensation;
mod cross_section;
pub mod document;
mod encoder;
mod force;
mod format;
mod gantry;
mod haptic;
mod homing;
pub mod input;
pub mod jog_limit;
pub mod keys;
mod likeness;
pub mod migrate;
pub mod model;
mod models;
mod named_io;
mod place;
mod plant;
pub mod pose_difference;
mod problem;
pub mod scale;
mod stability;
pub mod stock;
pub mod template;
#[cfg(test)]
mod tests;
pub mod work_data;

pub use axes::AxisLimits;
pub use force::ENABLE_CONDITIONS;
pub use format::FORMAT;
pub use named_io::{AnalogName, IoNames};
pub use problem::{Problem, Problems};

use document::{Document, Section};
use haptimill_firmware::config::{
    AxisKind, Config, Home, Homing, JointAxis, PoseAxis, Stopping, Supervision,
};
use haptimill_kinematics::Model;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_keys::controller::{self, root};
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;
use models::ModelReader;
use scale::{PER_DEG, PER_MM, to_i32, to_u16};
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::Spanned;
use toml::de::DeTable;

/// The built-in machine file.
pub const BUILT_IN: &str = include_str!("../../../machines/h4.toml");

/// Name under which problems of [`BUILT_IN`] are reported.
pub const BUILT_IN_NAME: &str = "machines/h4.toml (built in)";

/// Sections `[follow]` and `[haptic]`, with the simulated haptic arm and operator.
pub const HAPTIC_ARM: &str = include_str!("../../../machines/haptic-arm.toml");

/// Machine file of a haptic arm on a board of its own: a remote master.
pub const MASTER: &str = include_str!("../../../machines/haptic-master.toml");

/// Name under which problems of [`MASTER`] are reported.
pub const MASTER_NAME: &str = "machines/haptic-master.toml (built in)";

/// Section `[follow]`: the machine follows a remote master.
pub const FOLLOW: &str = include_str!("../../../machines/follow.toml");

/// Settings of the planner. Its limits of rate, acceleration and jerk are those of the axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Planner {
    /// Largest distance of the path from a programmed corner, mm; 0 stops at every corner.
    pub corner_tolerance_mm: f64,
    /// The same for the rotary coordinates, degrees.
    pub corner_tolerance_deg: f64,
    /// Jump of the acceleration where the curvature changes (line into arc), as a fraction of the
    /// acceleration limit.
    pub curvature_step: f64,
    /// Longest segment duration during motion, ms.
    pub longest_span_ms: f64,
    /// Shortest segment duration, ms.
    pub shortest_span_ms: f64,
}

/// Speeds of the spindle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spindle {
    /// Slowest and fastest speed in either direction, rev/min.
    pub rpm: [i16; 2],
    /// Time from standstill to the speed, seconds.
    pub run_up_s: f64,
}

impl Spindle {
    /// Checks the speeds of a program, slowest and fastest, at a spindle override in percent.
    ///
    /// # Errors
    ///
    /// The text states the speed that the spindle does not have.
    pub fn check_override(&self, speeds: Option<[u16; 2]>, percent: u8) -> Result<(), String> {
        let [low, high] = self.rpm.map(f64::from);
        for speed in speeds.into_iter().flatten() {
            let turns = f64::from(speed) * f64::from(percent) / 100.0;
            if !(low..=high).contains(&turns) {
                return Err(format!(
                    "spindle override {percent} %: S{speed} of the program would be {turns:.0} \
                     rev/min, and the spindle of the machine turns at {low} to {high} rev/min"
                ));
            }
        }
        Ok(())
    }
}

/// A machine file without a problem.
#[derive(Debug, Clone, PartialEq)]
pub struct MachineFile {
    /// Name of the file, for messages.
    pub file: String,
    /// Its text.
    pub text: String,
    /// The controller's configuration.
    pub config: Config,
    /// Pose coordinates in engineering units.
    pub pose: Vec<AxisLimits>,
    /// Joints in engineering units.
    pub joints: Vec<AxisLimits>,
    /// Names of inputs and outputs.
    pub io: IoNames,
    /// Settings of the planner.
    pub planner: Planner,
    /// Speeds of the spindle.
    pub spindle: Spindle,
    /// Whether the file has a `[plant]` section; see [`MachineFile::plant`].
    pub has_plant: bool,
}

impl MachineFile {
    /// Reads the built-in machine file.
    pub fn built_in() -> Result<Self, Problems> {
        Self::parse(BUILT_IN_NAME, BUILT_IN)
    }

    /// Returns the machine with a haptic arm and the operator model ([`HAPTIC_ARM`]), or the
    /// machine itself if it has a haptic arm.
    ///
    /// # Errors
    ///
    /// Returns the problems of the extended file.
    pub fn with_haptic_arm(&self) -> Result<Self, Problems> {
        if self.config.haptic.is_some() {
            return Ok(self.clone());
        }
        let file = format!("{} with machines/haptic-arm.toml", self.file);
        Self::parse(&file, &format!("{}\n{HAPTIC_ARM}", self.text))
    }

    /// Returns the machine with the section that follows a remote master ([`FOLLOW`]), or the
    /// machine itself if it has that section.
    ///
    /// # Errors
    ///
    /// Returns the problems of the extended file.
    pub fn with_follow(&self) -> Result<Self, Problems> {
        if self.config.follow.is_some() {
            return Ok(self.clone());
        }
        let file = format!("{} with machines/follow.toml", self.file);
        Self::parse(&file, &format!("{}\n{FOLLOW}", self.text))
    }

    /// Reads the built-in machine file of a haptic arm on a board of its own.
    ///
    /// # Errors
    ///
    /// Returns problems only if the built-in file is wrong.
    pub fn built_in_master() -> Result<Self, Problems> {
        Self::parse(MASTER_NAME, MASTER)
    }

    /// Whether the machine is only a haptic arm, a remote master.
    #[must_use]
    pub fn is_master(&self) -> bool {
        self.config.model == Model::None
    }

    /// Reads a machine file from disk. A file that cannot be read is a problem of line 0.
    pub fn load(path: &Path) -> Result<Self, Problems> {
        let file = path.display().to_string();
        let text = read_text(path)?;
        Self::parse(&file, &text)
    }

    /// Reads the text of a machine file; `file` is its name in messages.
    pub fn parse(file: &str, text: &str) -> Result<Self, Problems> {
        let document = Document::new(file, text, keys::sections());
        let Some(root) = document.parse() else {
            return Err(document.into_problems());
        };
        if !format::check(&document, root.get_ref(), file) {
            return Err(document.into_problems());
        }
        let read = read(&document, &root);
        if document.is_valid() {
            cross_section::check_home_pose(&document, root.get_ref(), &read.config);
        }
        if document.is_valid() {
            cross_section::check_roles(&document, root.get_ref(), &read.config);
        }
        if document.is_valid() {
            cross_section::check_by_controller(&document, root.get_ref(), &read.config);
        }
        let machine = Self {
            file: file.to_string(),
            text: text.to_string(),
            ..read
        };
        if machine.has_plant && machine.config.period_us > 0 {
            plant::check(&document, root.get_ref(), &machine);
        }
        document.finish()?;
        Ok(machine)
    }

    /// Encodes the configuration for the controller (postcard); returns it and its CRC-32
    /// (ISO-HDLC).
    pub fn encoded(&self) -> Result<(Vec<u8>, u32), postcard::Error> {
        let bytes = postcard::to_stdvec(&self.config)?;
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes);
        Ok((bytes, crc))
    }

    /// Reads the `[plant]` section as a [`PlantConfig`](haptimill_hil_sim::config::PlantConfig).
    ///
    /// # Errors
    ///
    /// Returns the first problem: the section is missing or not of that type.
    pub fn plant<T: DeserializeOwned>(&self) -> Result<T, Problems> {
        #[derive(serde::Deserialize)]
        struct OnlyPlant<T> {
            plant: T,
        }
        match toml::from_str::<OnlyPlant<T>>(&self.text) {
            Ok(only) => Ok(only.plant),
            Err(error) => {
                let document = Document::new(&self.file, &self.text, keys::sections());
                let offset = error.span().map_or(0, |span| span.start);
                let message = error.message().trim().replace('\n', ", ");
                let remedy = "see [plant] in docs/machine-files.md";
                document.report(offset, "plant", message, remedy);
                Err(document.into_problems())
            }
        }
    }
}

/// Reads the text of a TOML file. A file that cannot be read is a problem of line 0.
pub fn read_text(path: &Path) -> Result<String, Problems> {
    let file = path.display().to_string();
    let bytes = input::read(path, input::SETTINGS_BYTES)
        .map_err(|error| Problems::unreadable(&file, error.what, error.remedy))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Problems::unreadable(
            &file,
            format!("is not UTF-8 at byte {at}"),
            "save it as UTF-8",
        )
    })
}

fn read(document: &Document<'_>, root: &Spanned<DeTable<'_>>) -> MachineFile {
    let root = Section::root(document, root.get_ref());
    // Checked before.
    root.has(root::format.name);
    let name = read_name(&root);
    let period_us = root.value(root::period_us);
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
    let encoders =
        (encoders || !root.has_problem(|key| key.ends_with(".drive"))).then_some(encoders);
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

/// Reads the sections of a list of axes, each with the name and kind that the model has at its
/// place; reports a wrong count and duplicate names.
fn read_axes<'d, 'i>(
    root: &Section<'d, 'i>,
    key: &'static str,
    places: &[(&'static str, AxisKind)],
) -> Vec<PlacedSection<'d, 'i>> {
    place_axes(root, key, root.list(key), places)
}

/// A section of a list of axes, with the name and kind that the model has at its place.
type PlacedSection<'d, 'i> = (Section<'d, 'i>, Option<(&'static str, AxisKind)>);

/// As [`read_axes`], of sections of the list.
fn place_axes<'d, 'i>(
    root: &Section<'d, 'i>,
    key: &'static str,
    sections: Vec<Section<'d, 'i>>,
    places: &[(&'static str, AxisKind)],
) -> Vec<PlacedSection<'d, 'i>> {
    // Without a model the axes are unknown.
    if !sections.is_empty() && !places.is_empty() && sections.len() != places.len() {
        let names: Vec<&str> = places.iter().map(|(name, _)| *name).collect();
        let what = format!(
            "has {} sections, the model has {}",
            sections.len(),
            places.len()
        );
        let mut remedy = format!("write one for each of {}", names.join(", "));
        if key == "pose" {
            remedy.push_str(&other_models(sections.len()));
        }
        root.report(key, what, remedy);
    }
    let mut seen: Vec<&str> = Vec::new();
    let count_fits = sections.len() == places.len();
    let mut result = Vec::new();
    for (index, section) in sections.into_iter().enumerate() {
        let name = section.peek_text("name");
        let is_duplicate = name.is_some_and(|name| seen.contains(&name));
        if let Some(name) = name {
            if is_duplicate {
                section.report("name", format!("\"{name}\" is a duplicate"), "rename one");
            }
            seen.push(name);
        }
        // With a wrong count or a duplicate name the places are shifted: one report is enough.
        let place = places.get(index).filter(|_| count_fits && !is_duplicate);
        result.push((section, place.copied()));
    }
    result
}

/// The end of the remedy for a file with `count` pose coordinates and a model with another number:
/// the models that have as many.
fn other_models(count: usize) -> String {
    let fitting = haptimill_kinematics::DESCRIPTORS
        .iter()
        .filter(|model| model.pose.len() == count);
    let codes: Vec<String> = fitting.map(|model| format!("\"{}\"", model.code)).collect();
    match codes.is_empty() {
        false => format!(", or choose a model with {count}: {}", codes.join(", ")),
        true if count > MAX_AXES => format!("; a machine has at most {MAX_AXES} coordinates"),
        true => format!(
            "; no model has {count} coordinates, docs/adding-a-machine.md says how to add one"
        ),
    }
}

/// Checks the limits of pose coordinates that are joints themselves, and of the tilt.
fn check_pose_against_joints(
    pose: &[(&Section<'_, '_>, (PoseAxis, AxisLimits))],
    joints: &[(JointAxis, AxisLimits)],
    model: Option<ModelReader>,
) {
    let tilt = model.and_then(|model| model.descriptor.coordinate(Role::ToolTilt));
    for (index, (section, (_, limits))) in pose.iter().enumerate() {
        let ends = [
            (controller::pose::low, limits.low),
            (controller::pose::high, limits.high),
        ];
        if tilt == Some(index) {
            for (key, value) in ends {
                if value.abs() >= 90.0 {
                    let what = format!("{value} deg: the tilt must stay within +-90 deg");
                    section.refuse(key, what, "narrow the soft limits");
                }
            }
        }
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
fn read_homing(root: &Section<'_, '_>, joints: &[(JointAxis, AxisLimits)]) -> Homing {
    let searched = |rotary| {
        let mut joints = joints.iter();
        joints.any(|(joint, _)| joint.kind.is_rotary() == rotary && joint.home == Home::Index)
    };
    let (linear, rotary) = (searched(false), searched(true));
    let mut homing = Homing {
        rate: Rate(0),
        rotary_rate: Rate(0),
    };
    // A joint whose way to find its reference is not known may need the section or not.
    let is_unknown = root.has_problem(|key| {
        [".home", ".switch", ".drive"]
            .iter()
            .any(|end| key.ends_with(end))
    });
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

impl MachineFile {
    /// Returns the presets: the joint positions that the operator sets before power-on.
    pub fn preset(&self) -> Vec<Coordinate> {
        self.config
            .joints
            .iter()
            .map(|joint| joint.preset)
            .collect()
    }
}
