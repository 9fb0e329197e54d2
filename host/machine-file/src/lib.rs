//! Machine files: everything that makes a controller, a planner and a simulated plant this machine and not another.
//!
//! A machine file is TOML in people's units; the unit stands in the name of the key (`rate_mm_s`, `low_deg`, `heartbeat_ms`). It is
//! turned into the controller's integers ([`Config`]) by one multiplication and one rounding a value (see `scale.rs`).
//! Every problem of a file is reported, not just the first, each with its line, its value, what is allowed and what to do.
//!
//! Misuse: a machine file that reads without a problem is consistent in itself. Whether it describes the machine in front of you it cannot know.

mod axes;
pub mod document;
mod force;
mod h4;
mod haptic;
pub mod input;
pub mod model;
mod plant;
mod problem;
pub mod scale;
mod stability;
#[cfg(test)]
mod tests;
mod together;
pub mod work;

pub use axes::AxisLimits;
pub use force::GATES;
pub use problem::{Problem, Problems};

use document::{Document, Section, real, whole};
use haptimill_firmware::config::{
    AxisKind, Config, Homing, JointAxis, PoseAxis, Stopping, Supervision,
};
use haptimill_kinematics::Model;
use haptimill_kinematics::h4::H4Geometry;
use haptimill_math::{Coordinate, Length, Rate};
use scale::{PER_DEG, PER_MM, to_i32, to_u16};
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::Spanned;
use toml::de::DeTable;

/// The machine file that the command has built in.
pub const BUILT_IN: &str = include_str!("../../../machines/h4.toml");

/// Name under which problems of [`BUILT_IN`] are reported.
pub const BUILT_IN_NAME: &str = "machines/h4.toml (built in)";

/// Sections that give an H-4 arm a haptic arm, with the hand of the simulator.
pub const HAND: &str = include_str!("../../../machines/hand.toml");

/// The reference haptic arm on a board of its own: a master.
pub const MASTER: &str = include_str!("../../../machines/hand-master.toml");

/// Name under which problems of [`MASTER`] are reported.
pub const MASTER_NAME: &str = "machines/hand-master.toml (built in)";

/// The section that lets a machine follow a hand afar.
pub const FOLLOW: &str = include_str!("../../../machines/follow.toml");

/// How the planner joins the blocks of a program; its rates, accelerations and jerks are those of the axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Planner {
    /// How far a path may pass a programmed corner by, mm; 0 stops at every corner.
    pub corner_tolerance_mm: f64,
    /// The same for the rotary coordinates, degrees.
    pub corner_tolerance_deg: f64,
    /// Jump of the acceleration where the curvature changes (line into arc), as a part of the limit of acceleration.
    pub curvature_step: f64,
    /// Longest span between setpoints while anything moves, ms.
    pub longest_span_ms: f64,
    /// Shortest span between setpoints, ms.
    pub shortest_span_ms: f64,
}

/// A machine file that was read without a problem.
#[derive(Debug, Clone, PartialEq)]
pub struct MachineFile {
    /// Name of the file, for messages.
    pub file: String,
    /// Its text.
    pub text: String,
    /// The controller's configuration.
    pub config: Config,
    /// Pose coordinates in people's units.
    pub pose: Vec<AxisLimits>,
    /// Joints in people's units.
    pub joints: Vec<AxisLimits>,
    /// Bounds of the planner.
    pub planner: Planner,
    /// Whether there is a `[plant]` section; see [`MachineFile::plant`].
    pub has_plant: bool,
}

impl MachineFile {
    /// The built-in H-4 arm.
    pub fn built_in() -> Result<Self, Problems> {
        Self::parse(BUILT_IN_NAME, BUILT_IN)
    }

    /// The same machine with the reference haptic arm and its hand ([`HAND`]); itself when it has one.
    ///
    /// # Errors
    /// What is written there does not fit this machine.
    pub fn with_hand(&self) -> Result<Self, Problems> {
        if self.config.haptic.is_some() {
            return Ok(self.clone());
        }
        let file = format!("{} with machines/hand.toml", self.file);
        Self::parse(&file, &format!("{}\n{HAND}", self.text))
    }

    /// The same machine, which can follow a hand afar ([`FOLLOW`]); itself when it can.
    ///
    /// # Errors
    /// What is written there does not fit this machine.
    pub fn with_follow(&self) -> Result<Self, Problems> {
        if self.config.follow.is_some() {
            return Ok(self.clone());
        }
        let file = format!("{} with machines/follow.toml", self.file);
        Self::parse(&file, &format!("{}\n{FOLLOW}", self.text))
    }

    /// The built-in haptic arm on a board of its own.
    ///
    /// # Errors
    /// None, unless this program is broken.
    pub fn built_in_master() -> Result<Self, Problems> {
        Self::parse(MASTER_NAME, MASTER)
    }

    /// Whether it is a haptic arm alone, which leads a machine afar.
    #[must_use]
    pub fn is_master(&self) -> bool {
        self.config.model == Model::None
    }

    /// Reads a machine file from disk. A file that cannot be read is a problem of line 0.
    pub fn load(path: &Path) -> Result<Self, Problems> {
        let file = path.display().to_string();
        let text = text_of(path)?;
        Self::parse(&file, &text)
    }

    /// Reads the text of a machine file; `file` is its name in messages.
    pub fn parse(file: &str, text: &str) -> Result<Self, Problems> {
        let document = Document::new(file, text);
        let Some(root) = document.parse() else {
            return Err(document.into_problems());
        };
        let read = read(&document, &root);
        if document.is_well() {
            together::home_pose(&document, root.get_ref(), &read.config);
        }
        if document.is_well() {
            together::acceptable(&document, root.get_ref(), &read.config);
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

    /// The configuration as it is sent to the controller (postcard), and its CRC-32 (ISO-HDLC).
    pub fn encoded(&self) -> Result<(Vec<u8>, u32), postcard::Error> {
        let bytes = postcard::to_stdvec(&self.config)?;
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes);
        Ok((bytes, crc))
    }

    /// The `[plant]` section as the type that the simulator wants, [`PlantConfig`](haptimill_hil_sim::config::PlantConfig). What cannot be read is found one at a time.
    ///
    /// # Errors
    /// There is no such section, or it is not of that type.
    pub fn plant<T: DeserializeOwned>(&self) -> Result<T, Problems> {
        #[derive(serde::Deserialize)]
        struct OnlyPlant<T> {
            plant: T,
        }
        match toml::from_str::<OnlyPlant<T>>(&self.text) {
            Ok(only) => Ok(only.plant),
            Err(error) => {
                let document = Document::new(&self.file, &self.text);
                let offset = error.span().map_or(0, |span| span.start);
                let message = error.message().trim().replace('\n', ", ");
                document.report(offset, "plant", message, "see machines/h4.toml");
                Err(document.into_problems())
            }
        }
    }
}

/// The text of a file with settings. A file that cannot be read is a problem of line 0.
pub fn text_of(path: &Path) -> Result<String, Problems> {
    let file = path.display().to_string();
    let bytes = input::read(path, input::SETTINGS_BYTES)
        .map_err(|error| Problems::unread(&file, error.what, error.remedy))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Problems::unread(
            &file,
            format!("is not UTF-8 at byte {at}"),
            "save it as UTF-8",
        )
    })
}

fn read(document: &Document<'_>, root: &Spanned<DeTable<'_>>) -> MachineFile {
    let root = Section::root(document, root.get_ref());
    let name = name(&root);
    let period_us = root.number("period_us", whole(50, 1000, "us"));
    if root.skip("role") {
        let role = root.choice("role", &[("slave", false), ("master", true)]);
        if role == Some(true) {
            return master(&root, name, period_us);
        }
    }

    let stopping = root.section("stopping").map(stopping);
    let (supervision, margin) = match root.section("supervision").map(supervision) {
        Some((supervision, margin)) => (Some(supervision), margin),
        None => (None, f64::NAN),
    };
    let homing = root.section("homing").map(homing);
    let planner = root.section("planner").map(planner);
    let geometry = root.section("kinematics").map(|section| {
        let model = section.choice("model", &[("h4", ())]);
        // The keys of an unknown model are not known either.
        model.map(|()| h4::geometry(section, margin))
    });

    let pose = axes(&root, "pose", &h4::POSE);
    let pose: Vec<_> = pose
        .iter()
        .map(|(section, place)| (section, axes::pose_axis(section, *place)))
        .collect();
    let joints = axes(&root, "joint", &h4::JOINTS);
    let joints: Vec<_> = joints
        .iter()
        .map(|(section, place)| axes::joint_axis(section, *place, period_us / 1e6))
        .collect();
    across(&pose, &joints);
    let force = if root.skip("force") {
        root.section("force")
            .map(|section| force::force_control(&section, period_us))
    } else {
        None
    };
    let follow = if root.skip("follow") {
        root.section("follow")
            .map(|section| haptic::follow(&section))
    } else {
        None
    };
    let arm = if root.skip("haptic") {
        root.section("haptic")
            .map(|section| haptic::haptic(&section))
    } else {
        None
    };
    let has_plant = root.skip("plant");
    root.finish();

    let (pose, pose_limits): (Vec<_>, Vec<_>) = pose.into_iter().map(|(_, axis)| axis).unzip();
    let (joints, joint_limits): (Vec<_>, Vec<_>) = joints.into_iter().unzip();
    MachineFile {
        file: String::new(),
        text: String::new(),
        config: Config {
            name,
            period_us: to_u16(period_us),
            model: Model::H4(geometry.flatten().unwrap_or_else(no_geometry)),
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
            homing: homing.unwrap_or(Homing {
                rate: Rate(0),
                table_rate: Rate(0),
            }),
            force,
            follow,
            haptic: arm,
        },
        pose: pose_limits,
        joints: joint_limits,
        planner: planner.unwrap_or(NO_PLANNER),
        has_plant,
    }
}

/// A haptic arm alone: no axes, nothing to plan, nothing to brake.
fn master(root: &Section<'_, '_>, name: heapless::String<24>, period_us: f64) -> MachineFile {
    let supervision = root.section("supervision").map(|section| {
        let heartbeat = section.number("heartbeat_ms", whole(20, 5000, "ms"));
        let missed = section.number("missed_periods", whole(1, 50, "periods"));
        section.finish();
        (to_u16(heartbeat), to_u16(missed))
    });
    let (heartbeat_ms, missed_periods) = supervision.unwrap_or_default();
    let arm = root
        .section("haptic")
        .map(|section| haptic::haptic(&section));
    let has_plant = root.skip("plant");
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
            // Of no consequence without axes, and sound.
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
                table_rate: Rate(0),
            },
            force: None,
            follow: None,
            haptic: arm,
        },
        pose: Vec::new(),
        joints: Vec::new(),
        planner: NO_PLANNER,
        has_plant,
    }
}

/// Stands where the file has no planner.
const NO_PLANNER: Planner = Planner {
    corner_tolerance_mm: f64::NAN,
    corner_tolerance_deg: f64::NAN,
    curvature_step: f64::NAN,
    longest_span_ms: f64::NAN,
    shortest_span_ms: f64::NAN,
};

fn name(root: &Section<'_, '_>) -> heapless::String<24> {
    let name = root
        .text("name", "add a name of 1 to 24 bytes")
        .unwrap_or_default();
    heapless::String::try_from(name).unwrap_or_else(|_| {
        let what = format!("\"{name}\" has {} bytes, allowed are 1 to 24", name.len());
        root.report("name", what, "shorten it");
        heapless::String::new()
    })
}

/// The sections of a list of axes, each with the place that the model has for it; reports a wrong count and doubled names.
fn axes<'d, 'i>(
    root: &Section<'d, 'i>,
    key: &'static str,
    places: &'static [(&'static str, AxisKind)],
) -> Vec<(Section<'d, 'i>, Option<(&'static str, AxisKind)>)> {
    let sections = root.list(key);
    if !sections.is_empty() && sections.len() != places.len() {
        let names: Vec<&str> = places.iter().map(|(name, _)| *name).collect();
        let what = format!(
            "has {} sections, the model has {}",
            sections.len(),
            places.len()
        );
        root.report(
            key,
            what,
            format!("write one for each of {}", names.join(", ")),
        );
    }
    let mut seen: Vec<&str> = Vec::new();
    let count_fits = sections.len() == places.len();
    let mut result = Vec::new();
    for (index, section) in sections.into_iter().enumerate() {
        let name = section.peek_text("name");
        let doubled = name.is_some_and(|name| seen.contains(&name));
        if let Some(name) = name {
            if doubled {
                section.report("name", format!("\"{name}\" is there twice"), "rename one");
            }
            seen.push(name);
        }
        // With a wrong count or a doubled name the places are shifted: one report is enough.
        let place = places.get(index).filter(|_| count_fits && !doubled);
        result.push((section, place.copied()));
    }
    result
}

/// What must fit between pose coordinates and joints.
fn across(pose: &[(&Section<'_, '_>, (PoseAxis, AxisLimits))], joints: &[(JointAxis, AxisLimits)]) {
    for (section, (_, limits)) in pose {
        if limits.name == "theta" {
            for (key, value) in [("low_deg", limits.low), ("high_deg", limits.high)] {
                if value.abs() >= 90.0 {
                    let what = format!("{value} deg: the tilt must stay within +-90 deg");
                    section.report(key, what, "narrow the soft limits");
                }
            }
        }
        // A pose coordinate that is a joint itself, as the table is.
        let Some((_, joint)) = joints.iter().find(|(_, joint)| joint.name == limits.name) else {
            continue;
        };
        let (low, high) = (joint.low, joint.high);
        for (key, value) in [("low_deg", limits.low), ("high_deg", limits.high)] {
            if value < low || value > high {
                let what = format!("{value} deg is outside the joint's stroke {low} to {high} deg");
                section.report(key, what, "narrow the soft limits");
            }
        }
        if limits.rate > joint.rate {
            let what = format!("{} is above the joint's rate {}", limits.rate, joint.rate);
            section.report("rate_deg_s", what, "lower it");
        }
    }
}

fn stopping(section: Section<'_, '_>) -> Stopping {
    let time = section.number("time_ms", whole(5, 2000, "ms"));
    let ramp = section.number("ramp_ms", whole(1, 1000, "ms"));
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

fn supervision(section: Section<'_, '_>) -> (Supervision, f64) {
    let result = Supervision {
        heartbeat_ms: to_u16(section.number("heartbeat_ms", whole(20, 5000, "ms"))),
        missed_periods: to_u16(section.number("missed_periods", whole(1, 50, "periods"))),
        illegal_transitions: to_u16(section.number("illegal_transitions", whole(1, 1000, ""))),
    };
    let margin = section.number("singularity_margin_mm", real(1.0, 200.0, "mm"));
    section.finish();
    (result, margin)
}

fn homing(section: Section<'_, '_>) -> Homing {
    let rate = section.number("rate_mm_s", real(0.01, 200.0, "mm/s"));
    let table_rate = section.number("table_rate_deg_s", real(0.01, 90.0, "deg/s"));
    section.finish();
    Homing {
        rate: Rate(to_i32(rate * PER_MM)),
        table_rate: Rate(to_i32(table_rate * PER_DEG)),
    }
}

fn planner(section: Section<'_, '_>) -> Planner {
    let result = Planner {
        corner_tolerance_mm: section.number("corner_tolerance_mm", real(0.0, 1.0, "mm")),
        corner_tolerance_deg: section.number("corner_tolerance_deg", real(0.0, 1.0, "deg")),
        curvature_step: section.number("curvature_step", real(0.0, 1.0, "")),
        longest_span_ms: section.number("longest_span_ms", real(1.0, 1000.0, "ms")),
        shortest_span_ms: section.number("shortest_span_ms", real(0.2, 1000.0, "ms")),
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

/// Stands where the file has no geometry; never leaves this module without a report.
fn no_geometry() -> H4Geometry {
    let zero = Length(0);
    H4Geometry {
        lateral: zero,
        half_spacing: zero,
        half_height: zero,
        joint_offset: zero,
        rod: zero,
        rail_offset: zero,
        tool: zero,
        x_offset: zero,
        y_offset: zero,
        z_offset: zero,
        table_height: zero,
        below: true,
        singularity_margin: zero,
    }
}

impl MachineFile {
    /// The joints at the home preset, as the operator sets them up before power on.
    pub fn preset(&self) -> Vec<Coordinate> {
        self.config
            .joints
            .iter()
            .map(|joint| joint.preset)
            .collect()
    }
}
