//! Machines of the episodes: machine files of `machines/`, and their variants.

use haptimill_machine_file::MachineFile;
use std::sync::OnceLock;

/// The machine of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MachineKind {
    /// `machines/h4.toml`.
    Torque,
    /// `machines/h4-step.toml`.
    Step,
    /// The first one with a haptic arm.
    HapticArm,
    /// The first one; a remote master moves its tool.
    RemoteMaster,
    /// A haptic arm alone.
    MasterAlone,
    /// Another machine file of `machines/`, by its name in [`MACHINES`].
    File(&'static str),
}

/// Defines the list of the machine files, each by its name and the file in `machines/`.
macro_rules! machine_files {
    ($($name:literal, $file:literal;)*) => {
        /// The machine files whose episodes an option of the command selects; `vmc3-tables` is
        /// `vmc3.toml` with its true errors as tables in the controller.
        pub const MACHINES: [&str; [$($name),*].len()] = [$($name),*];

        const TEXTS: [&str; MACHINES.len()] =
            [$(include_str!(concat!("../../../machines/", $file))),*];
    };
}

machine_files! {
    "mill3", "mill3.toml";
    "mill3-servo", "mill3-servo.toml";
    "router3", "router3.toml";
    "mill4", "mill4.toml";
    "mill6", "mill6.toml";
    "trunnion5", "trunnion5.toml";
    "facet", "facet.toml";
    "scara", "scara.toml";
    "delta3", "delta3.toml";
    "vmc3", "vmc3.toml";
    "vmc3-tables", "vmc3.toml";
    "engraver", "engraver.toml";
    "fivebar", "fivebar.toml";
    "polar3", "polar3.toml";
    "corexy", "corexy.toml";
}

impl MachineKind {
    /// Returns the name of the machine file, if the episode is not one of the H-4 machines.
    #[must_use]
    pub const fn file(self) -> Option<&'static str> {
        match self {
            Self::File(name) => Some(name),
            _ => None,
        }
    }
}

/// Inputs and outputs of the machine with step motors. The safe level of each output is 0.
const STEP_IO: &str = r#"
[[input]]
name = "probe"
function = "probe"
channel = 0
active = "high"
filter_ms = 0
contact = "fault"

[[output]]
name = "coolant"
function = "coolant"
channel = 0
active = "high"
safe = "off"
without_host = "safe"

[[output]]
name = "clamp"
function = "tool_clamp"
channel = 1
active = "low"
safe = "on"
without_host = "keep"

[[analog_output]]
name = "laser"
channel = 0
unit = "V"
full_scale = 10.0
low = 0.0
high = 9.0
safe = 0.0
without_host = "safe"
"#;

/// Returns the machine file of a kind.
#[must_use]
pub fn machine(kind: MachineKind) -> &'static MachineFile {
    static FILES: OnceLock<[MachineFile; 5]> = OnceLock::new();
    let files = FILES.get_or_init(|| {
        let torque = MachineFile::built_in().expect("sound");
        let step = include_str!("../../../machines/h4-step.toml");
        let step = format!("{step}{STEP_IO}");
        [
            torque.clone(),
            MachineFile::parse("machines/h4-step.toml", &step).expect("sound"),
            torque.with_haptic_arm().expect("sound"),
            torque.with_follow().expect("sound"),
            MachineFile::built_in_master().expect("sound"),
        ]
    });
    &files[match kind {
        MachineKind::Torque => 0,
        MachineKind::Step => 1,
        MachineKind::HapticArm => 2,
        MachineKind::RemoteMaster => 3,
        MachineKind::MasterAlone => 4,
        MachineKind::File(name) => return machine_file(name),
    }]
}

/// Returns a machine file of [`MACHINES`].
fn machine_file(name: &str) -> &'static MachineFile {
    static FILES: [OnceLock<MachineFile>; MACHINES.len()] =
        [const { OnceLock::new() }; MACHINES.len()];
    let known = MACHINES.iter().position(|other| *other == name);
    let index = known.expect("a name of MACHINES");
    FILES[index].get_or_init(|| {
        let text = TEXTS[index];
        let file = MachineFile::parse(name, text).expect("sound");
        if name != "vmc3-tables" {
            return file;
        }
        // The true errors, which the file of the simulated machine has between quotes.
        let errors = text.split("\"\"\"").nth(1).expect("a table of errors");
        file.with_errors("its own errors", errors, "wYbXZt")
            .expect("sound")
    })
}
