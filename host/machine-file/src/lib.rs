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
mod axis_places;
pub mod compensation;
mod cross_section;
pub mod document;
mod drive_chip;
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
mod reading;
mod renamed;
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

use document::Document;
use haptimill_firmware::config::Config;
use haptimill_kinematics::Model;
use haptimill_math::Coordinate;
use serde::de::DeserializeOwned;
use std::path::Path;

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
        let read = reading::read(&document, &root);
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

    /// Returns the presets: the joint positions that the operator sets before power-on.
    pub fn preset(&self) -> Vec<Coordinate> {
        self.config
            .joints
            .iter()
            .map(|joint| joint.preset)
            .collect()
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
                let field = unknown_field(&message);
                let renamed = field.and_then(|(name, _)| renamed::new_name_in_plant(name));
                let remedy = match (renamed, field.and_then(|(_, near)| near)) {
                    (Some(new_name), _) => renamed::remedy(&self.file, new_name),
                    (_, Some(near)) => format!("did you mean `{near}`?"),
                    _ => "see [plant] in docs/machine-files.md".to_string(),
                };
                document.report(offset, "plant", message, remedy);
                Err(document.into_problems())
            }
        }
    }
}

/// The unknown field of an error message, and the known one that it is most like.
fn unknown_field(message: &str) -> Option<(&str, Option<&str>)> {
    let (unknown, known) = message
        .strip_prefix("unknown field `")?
        .split_once("`, expected ")?;
    let known: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
    Some((unknown, likeness::nearest(unknown, &known)))
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
