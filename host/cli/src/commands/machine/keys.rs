//! `haptimill machine keys`: the keys of machine files.

use crate::commands::{CliError, Exit};
use clap::Args;
use haptimill_machine_file::keys::sections;
use haptimill_machine_keys::page::listing;

const LONG: &str = "\
List the keys of machine files.

Each key with its meaning, unit, range and default. With SECTION only that section and those below \
it: joint, joint.drive, planner, plant.cutter.";

/// Arguments of `haptimill machine keys`.
#[derive(Debug, Clone, Args)]
#[command(about = "List the keys of machine files", long_about = LONG)]
pub struct KeysArgs {
    /// A section, without brackets
    #[arg(value_name = "SECTION", default_value = "")]
    pub section: String,
}

/// Lists the keys.
///
/// # Errors
/// [`Exit::Usage`]: there is no such section.
pub(super) fn run(args: &KeysArgs) -> Result<(), CliError> {
    let text = listing(&args.section, &sections());
    if text.is_empty() {
        let section = &args.section;
        return Err(CliError::new(
            Exit::Usage,
            format!("there is no section `{section}`; `haptimill machine keys` lists all"),
        ));
    }
    print_line!("{}", text.trim_end());
    Ok(())
}
