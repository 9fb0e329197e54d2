//! `haptimill machine init`: writes a machine-file template.

use super::migrate::write_new;
use crate::commands::{CliError, Exit};
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use haptimill_machine_file::template::annotate;
use haptimill_machine_file::{BUILT_IN, MASTER, MachineFile};
use std::path::PathBuf;

const LONG: &str = "\
Write a machine-file template.

The template is the complete machine file of an existing machine, with NAME as its name. Each key has \
a comment with its meaning, unit, range and default; optional keys are there as comments. Replace the \
values by those of your machine, then run `haptimill machine check FILE`. An existing file is not \
overwritten.";

/// Arguments of `haptimill machine init`.
#[derive(Debug, Clone, Args)]
#[command(about = "Write a machine-file template", long_about = LONG)]
pub struct InitArgs {
    /// Name of the machine: letters, digits, - and _
    #[arg(value_name = "NAME", value_parser = machine_name)]
    pub name: String,
    /// Machine that the template describes
    #[arg(long, value_name = "TEMPLATE", value_enum, default_value_t = Template::Mill3)]
    pub template: Template,
    /// File to write [default: NAME.toml]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Machines with a template. `TEMPLATES` has their texts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Template {
    /// Three-axis mill: x, y, z on ball screws, open-loop step motors, home switches
    Mill3,
    /// Three-axis mill: x, y, z on ball screws, servo drives with encoders
    Mill3Servo,
    /// The mill with step motors, and a multi-turn rotary joint
    Mill4,
    /// Gantry router: step motors, two of them on the beam, home switches
    Router3,
    /// 5-axis mill: x, y, z, and a rotary table on a trunnion, servo drives
    Trunnion5,
    /// 5-axis H-4 parallel kinematics with a rotary table, servo drives and force sensor
    H4,
    /// The same with step and direction drives
    H4Step,
    /// Haptic arm on a board of its own, the master of a teleoperation
    HapticArm,
    /// Step motors on the bench, with free shafts and without switches, for a first motion
    Bench,
}

impl Template {
    /// Whether the example of a three-axis mill fits the machine.
    const fn cuts_the_first_pocket(self) -> bool {
        matches!(
            self,
            Self::Mill3 | Self::Mill3Servo | Self::Mill4 | Self::Router3
        )
    }
}

/// The text of every template.
const TEMPLATES: &[(Template, &str)] = &[
    (
        Template::Mill3,
        include_str!("../../../../../machines/mill3.toml"),
    ),
    (
        Template::Mill3Servo,
        include_str!("../../../../../machines/mill3-servo.toml"),
    ),
    (
        Template::Mill4,
        include_str!("../../../../../machines/mill4.toml"),
    ),
    (
        Template::Router3,
        include_str!("../../../../../machines/router3.toml"),
    ),
    (
        Template::Trunnion5,
        include_str!("../../../../../machines/trunnion5.toml"),
    ),
    (Template::H4, BUILT_IN),
    (
        Template::H4Step,
        include_str!("../../../../../machines/h4-step.toml"),
    ),
    (Template::HapticArm, MASTER),
    (
        Template::Bench,
        include_str!("../../../../../machines/bench.toml"),
    ),
];

/// Parses a machine name.
fn machine_name(text: &str) -> Result<String, String> {
    let allowed = |character: char| character.is_ascii_alphanumeric() || "-_".contains(character);
    if text.is_empty() || text.starts_with('-') || !text.chars().all(allowed) {
        return Err("write letters, digits, - and _".to_string());
    }
    Ok(text.to_string())
}

/// Writes a machine-file template.
///
/// # Errors
/// [`Exit::Usage`]: the name does not fit, or the file exists. [`Exit::Output`]: it cannot be
/// written.
pub(super) fn run(args: InitArgs) -> Result<(), CliError> {
    let path = match &args.out {
        Some(path) => path.clone(),
        None => PathBuf::from(format!("{}.toml", args.name)),
    };
    let text = fill(args.template, &args.name)?;
    if let Err(problems) = MachineFile::parse(&path.display().to_string(), &text) {
        return Err(CliError::new(
            Exit::Usage,
            format!("{problems}\nthe template with this name is not valid; write another NAME"),
        ));
    }
    write_new(&path, &text)?;
    let file = path.display();
    print_line!(
        "{file}: written; replace its values by those of your machine, in [plant] too, then run \
         `haptimill machine check {file}`"
    );
    if args.template.cuts_the_first_pocket() {
        print_line!(
            "it runs as it is, the first cut in the simulator:\n  haptimill examples --out .\n  \
             haptimill run examples/mill3-pocket.ngc --machine {file} --stock \
             examples/mill3-block.toml"
        );
    }
    Ok(())
}

/// The text of a template with the name of a machine.
fn fill(template: Template, name: &str) -> Result<String, CliError> {
    let broken = || CliError::new(Exit::Internal, "a template has no line with its name");
    let (_, text) = TEMPLATES
        .iter()
        .find(|(known, _)| *known == template)
        .ok_or_else(broken)?;
    // The name of the machine is the first key of the file.
    let (head, rest) = text.split_once("\nname = ").ok_or_else(broken)?;
    let (_, body) = rest.split_once('\n').ok_or_else(broken)?;
    let value = template.to_possible_value();
    let known = value.as_ref().map_or("", PossibleValue::get_name);
    Ok(format!(
        "# Machine file of \"{name}\", written by `haptimill machine init` from the template \
         \"{known}\".\n# All values are those of the template. Replace them by those of your machine \
         before it moves.\n#\n{}",
        annotate(&format!("{head}\nname = \"{name}\"\n{body}"))
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_template_is_a_valid_machine_file_with_the_given_name() {
        for template in Template::value_variants() {
            let text = fill(*template, "mill_2").unwrap();
            let machine = MachineFile::parse("mill_2.toml", &text)
                .unwrap_or_else(|problems| panic!("{template:?}:\n{problems}"));
            assert_eq!(machine.config.name.as_str(), "mill_2", "{template:?}");
        }
    }

    #[test]
    fn machine_names_have_letters_digits_dashes_and_underscores() {
        for good in ["a", "mill-2", "Mill_2"] {
            assert_eq!(machine_name(good).as_deref(), Ok(good));
        }
        for bad in ["", "-a", "a b", "a\"", "a\\", "a/b", "a\n", "\u{e4}"] {
            assert!(machine_name(bad).is_err(), "{bad:?}");
        }
    }
}
