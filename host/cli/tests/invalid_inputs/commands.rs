//! Every command with every input that it reads: the rows of the tests.
//!
//! A row is a command line; `{}` is the input. GOOD is a valid part program, OUT a folder with
//! earlier results, PORT a port that must stay unused, NONE a path without a file.

use clap::{Command, CommandFactory as _};

/// A command line that is valid up to its inputs, for each command that reads a file or opens a
/// device. Rows for its options are made from it.
const COMMANDS: &[&str] = &[
    "run GOOD --out OUT",
    "engrave examples/plate.dxf --out OUT/trace.csv",
    "dnc OUT/trace.csv --line NONE --out OUT",
    "jog x=1 --port PORT",
    "mdi G0X1 --port PORT",
    "home --port PORT",
    "console",
    "teleop --master sim --out OUT",
    "facet check examples/pentagon.asc",
    "facet plan examples/pentagon.asc --out OUT/trace.csv",
    "facet run examples/pentagon.asc --out OUT",
    "status --port PORT",
    "enable --port PORT",
    "disable --port PORT",
    "store --port PORT",
    "stop --port PORT",
    "move-off --port PORT",
    "reset --port PORT",
    "compensation off --port PORT",
    "scenario run e7 --out OUT",
    "calibrate laser --out OUT/trace.csv",
    "calibrate ball-bar --out OUT/trace.csv",
    "calibrate arm --out OUT/trace.csv",
    "calibrate rewrite GOOD --errors host/volumetric/data/vmc3_errors.csv --out OUT/trace.csv",
    "identify --yes --out OUT",
    "tune --out OUT",
    "force show --port PORT",
    "force tare --port PORT",
    "force set x --port PORT",
    "output set coolant on --port PORT",
    "probe z=-1 --port PORT",
    "probe edge z=-1 --radius 0 --port PORT",
    "probe bore --reach 1 --port PORT",
    "probe boss --size 9 --depth 1 --port PORT",
    "probe tool --tool 1 --height 0 --port PORT",
    "sim serve --listen tcp:127.0.0.1:0 --for 1",
    "machine check {}",
    "machine migrate {}",
    "offset show",
    "offset set g54 x=1",
    "offset touch g54 x=1 --port PORT",
    "serve --listen 127.0.0.1:0",
    "bridge grbl",
    "flash",
    "preview GOOD --out OUT/trace.csv",
    "pulses {}",
    "trace info {}",
    "trace csv {} --out OUT/trace.csv",
    "trace plot {} x_tool_mm --out OUT/report.html",
    "trace mcap {} --out OUT/trace.csv",
    "trace diff {} {}",
    "replay {}",
    "kin ik --in {} --out OUT/trace.csv",
    "kin fk --in examples/dome.ngc --out OUT/trace.csv",
];

/// Commands without a row, and the reason.
const WITHOUT_ROW: &[(&str, &str)] = &[
    ("override", "a request to the process that runs the job"),
    ("hold", "a request to the process that runs the job"),
    ("resume", "a request to the process that runs the job"),
    ("watch", "reads a TCP port, and nothing moves"),
    ("scenario list", "no input"),
    ("machine init", "no input; it overwrites no file"),
    ("machine keys", "no input"),
    ("examples", "no input; it overwrites no file"),
    ("ports", "no input"),
    ("facet calibrate", "its input is in its options"),
];

/// Inputs that are no option with a file, and options with others before them.
const MORE: &[&str] = &[
    "run {} --out OUT",
    "run {} --port PORT --out OUT",
    "run GOOD --machine {} --port PORT --out OUT",
    "run GOOD --out OUT --port PORT --serve tcp:127.0.0.1:0 --token-file {}",
    "engrave {} --out OUT/trace.csv",
    "dnc OUT/trace.csv --line NONE --machine {} --port PORT --out OUT",
    "console {}",
    "teleop --master script:{} --port PORT --out OUT",
    "teleop --master PORT --master-machine {} --port PORT --out OUT",
    "facet check {}",
    "facet plan {} --out OUT/trace.csv",
    "facet run {} --out OUT",
    "identify --yes --machine {} --port PORT --out OUT",
    "serve --listen 127.0.0.1:0 --machine {} --port PORT",
    "bridge grbl --machine {} --port PORT",
    "preview {} --out OUT/trace.csv",
    "scenario run vmc --coarse --errors {} --out OUT",
    "scenario run vmc --coarse --cmm-x {} --out OUT \
     --cmm-y host/volumetric/tests/data/table_4_2_cmm_y_side.csv",
    "scenario run vmc --coarse --cmm-y {} --out OUT \
     --cmm-x host/volumetric/tests/data/table_4_1_cmm_x_side.csv",
    "calibrate rewrite {} --machine machines/vmc3.toml --out OUT/trace.csv \
     --errors host/volumetric/data/vmc3_errors.csv",
    "calibrate rewrite GOOD --machine machines/vmc3.toml --errors {} --out OUT/trace.csv",
];

/// Options with a file that is written, not read.
const OUTPUTS: &[&str] = &["out", "vcd", "log", "save-readings", "svg"];

/// Options with a file that other options must come with.
const COMPANIONS: &[(&str, &str)] = &[
    ("errors", "--machine machines/vmc3.toml"),
    ("operator", "--machine machines/haptic-master.toml"),
];

/// Options of a command without a row, and the reason.
const OPTIONS_WITHOUT_ROW: &[(&str, &str)] = &[
    ("run --image", "for an emulated board only"),
    ("dnc --image", "for an emulated board only"),
    ("engrave --preview", "written"),
    ("engrave --font", "read for a drawing with text only"),
    (
        "pulses --recording",
        "read behind the capture; nothing is written",
    ),
    ("dnc --token-file", "as run --token-file"),
];

/// The subcommands without subcommands of their own, with their names from the first one on.
/// `probe` has subcommands and is a command, too.
pub fn leaves() -> Vec<(String, Command)> {
    fn collect(prefix: &str, command: &Command, found: &mut Vec<(String, Command)>) {
        for sub in command
            .get_subcommands()
            .filter(|it| it.get_name() != "help")
        {
            let name = format!("{prefix}{}", sub.get_name());
            if !sub.has_subcommands() || name == "probe" {
                found.push((name.clone(), sub.clone()));
            }
            collect(&format!("{name} "), sub, found);
        }
    }
    let mut found = Vec::new();
    collect("", &haptimill::commands::Cli::command(), &mut found);
    found
}

/// Whether a row is of a command.
fn is_row_of(row: &str, command: &str) -> bool {
    row.strip_prefix(command)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
}

/// The rows of every command with every option that names a file, and the commands and options
/// that have neither a row nor a reason.
pub fn rows() -> (Vec<String>, Vec<String>) {
    let rows_by_hand = COMMANDS.iter().chain(MORE);
    let by_hand = rows_by_hand.filter(|row| row.contains("{}"));
    let mut rows: Vec<String> = by_hand.map(ToString::to_string).collect();
    let mut missing = Vec::new();
    for (name, command) in leaves() {
        // The longest name comes last: `probe edge` is no row of `probe`.
        let base = COMMANDS.iter().find(|row| {
            is_row_of(row, &name)
                && !leaves().iter().any(|(longer, _)| {
                    longer.len() > name.len() && is_row_of(longer, &name) && is_row_of(row, longer)
                })
        });
        let Some(base) = base else {
            if !WITHOUT_ROW.iter().any(|(without, _)| *without == name) {
                missing.push(name);
            }
            continue;
        };
        for option in command.get_arguments() {
            let names = option.get_value_names().unwrap_or_default();
            let is_file = names
                .iter()
                .any(|it| matches!(it.as_str(), "FILE" | "RECORDING"));
            let Some(long) = option.get_long().filter(|_| is_file) else {
                continue;
            };
            let full = format!("{name} --{long}");
            if OUTPUTS.contains(&long)
                || OPTIONS_WITHOUT_ROW
                    .iter()
                    .any(|(without, _)| *without == full)
                || rows
                    .iter()
                    .any(|row| is_row_of(row, &name) && row.contains(&format!("--{long} {{}}")))
                    && long != "machine"
            {
                continue;
            }
            let companion = COMPANIONS.iter().find(|(with, _)| *with == long);
            let companion = companion.map_or("", |(_, companion)| companion);
            let base = base.replace("{}", "examples/dome.ngc");
            rows.push(format!("{base} {companion} --{long} {{}}"));
        }
    }
    (rows, missing)
}

/// The rows of every command that opens a port, and the commands that open none at once.
pub fn port_rows() -> Vec<String> {
    let with_port = |row: &&&str| row.contains("--port PORT");
    let rows = COMMANDS.iter().filter(with_port);
    let mut rows: Vec<String> = rows.map(|row| row.replace("PORT", "{}")).collect();
    for row in [
        "run GOOD --port {} --out OUT",
        "dnc OUT/trace.csv --line NONE --port {} --out OUT",
        "dnc OUT/trace.csv --line {} --out OUT",
        "teleop --master sim --port {} --out OUT",
        "teleop --master {} --port PORT --out OUT",
        "teleop --master {} --out OUT",
        "teleop --master joystick:{} --port PORT --out OUT",
        "teleop --master joystick:{} --out OUT",
        "teleop --master mouse3d:{} --port PORT --out OUT",
        "teleop --master mouse3d:{} --out OUT",
        "identify --yes --port {} --out OUT",
        "bridge grbl --port {}",
    ] {
        rows.push(row.to_string());
    }
    rows
}
