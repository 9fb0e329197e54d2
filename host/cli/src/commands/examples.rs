//! `haptimill examples`: the files of examples/, built in.

use super::{CliError, Exit};
use clap::Args;
use std::path::PathBuf;

/// Arguments of `haptimill examples`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "List the examples that are built in, or write them out",
    long_about = "List the examples that are built in, or write them out: `haptimill examples \
                  --out DIR` writes all into DIR/examples, so that the commands of the \
                  documentation run in DIR. An existing file is kept."
)]
pub struct ExamplesArgs {
    /// Only these [default: all]
    #[arg(value_name = "NAME")]
    pub names: Vec<String>,
    /// Write them into the folder `examples` in this folder
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

macro_rules! files {
    ($($name:literal: $what:literal,)*) => {
        &[$(($name, $what, include_str!(concat!("../../../../examples/", $name)))),*]
    };
}

/// Name, description and content.
const FILES: &[(&str, &str, &str)] = files! {
    "e11-circle.ngc": "circle of 30 mm",
    "e1-feed-sweep.ngc": "experiment 1: grooves at several feeds",
    "e2-depth-sweep.ngc": "experiment 2: grooves of several depths",
    "e3-incline-2.ngc": "experiment 3: incline, 2 mm/s",
    "e3-incline-4.ngc": "experiment 3: incline, 4 mm/s",
    "e5-incline-2.ngc": "experiment 5: force control on an incline, 2 mm/s",
    "e5-incline-4.ngc": "experiment 5: force control on an incline, 4 mm/s",
    "e7-slot.ngc": "experiment 7: slot in a block",
    "e9-pocket.ngc": "experiment 9: pocket",
    "e6-teleop.ngc": "experiment 6: program beside an operator at the haptic arm",
    "e8-teleop.ngc": "experiment 8: program beside an operator",
    "e10-teleop.ngc": "experiment 10: program beside an operator",
    "e12-teleop.ngc": "experiment 12: program beside an operator",
    "dome.ngc": "dome with lines of a ball cutter",
    "mill3-pocket.ngc": "pocket on the Cartesian mill",
    "mill4-thread.ngc": "thread along the rotary axis of machines/mill4.toml",
    "freecad-plate.ngc": "plate by the FreeCAD post-processor, for a Cartesian mill",
    "fusion-cover.ngc": "cover by the Fusion post-processor, for a Cartesian mill",
    "a160.ngc": "test piece A160 of ISO 10791-7, for machines/vmc3.toml",
    "plate.dxf": "drawing of a plate to engrave",
    "pentagon.asc": "gem design of GemCad: a pentagon",
    "round-brilliant.asc": "gem design of GemCad: a round brilliant",
    "step-cut.toml": "gem design: a rectangular step cut",
    "block.toml": "stock: a block",
    "incline.toml": "stock: an inclined block",
    "mill3-block.toml": "stock: a block for the Cartesian mill",
    "teleop.toml": "script of an operator at the haptic arm",
};

/// Lists or writes the examples.
///
/// # Errors
/// An example does not exist, or a file cannot be written.
pub fn run(args: &ExamplesArgs) -> Result<(), CliError> {
    for name in &args.names {
        if !FILES.iter().any(|(known, _, _)| known == name) {
            let what = format!("there is no example '{name}'; `haptimill examples` lists them");
            return Err(CliError::new(Exit::Usage, what));
        }
    }
    let chosen = FILES
        .iter()
        .filter(|(name, _, _)| args.names.is_empty() || args.names.iter().any(|it| it == name));
    let Some(out) = &args.out else {
        for (name, what, _) in chosen {
            print_line!("{name:20} {what}");
        }
        return Ok(());
    };
    let folder = out.join("examples");
    let failed = |path: &std::path::Path, error: std::io::Error| {
        let what = format!("{}: {error}", path.display());
        CliError::new(Exit::Output, what)
    };
    std::fs::create_dir_all(&folder).map_err(|error| failed(&folder, error))?;
    for (name, _, content) in chosen {
        let path = folder.join(name);
        match std::fs::File::create_new(&path) {
            Ok(mut file) => {
                std::io::Write::write_all(&mut file, content.as_bytes())
                    .map_err(|error| failed(&path, error))?;
                print_line!("{} written", path.display());
            }
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                print_line!("{} exists and is kept", path.display());
            }
            Err(error) => return Err(failed(&path, error)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_example_is_built_in() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
        for entry in std::fs::read_dir(folder).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            assert!(
                FILES.iter().any(|(known, _, _)| *known == name),
                "examples/{name} is not in the list"
            );
        }
    }
}
