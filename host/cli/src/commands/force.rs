//! `haptimill force`: the force sensor and the force control of a running controller.

use super::board::agree;
use super::simple::{SimpleArgs, open};
use super::{CliError, Exit};
use clap::{Args, Subcommand};
use haptimill_client::board::Need;
use haptimill_client::session::{ForceLoopChanges, PortLine, Session};
use haptimill_machine_file::ENABLE_CONDITIONS;
use haptimill_protocol::force::{
    COMPONENT_NAMES, COMPONENTS, EnableCondition, ForceLoop, ForceTelemetry,
};

/// A command on the force control.
#[derive(Debug, Subcommand)]
pub enum ForceCommand {
    /// Print the forces, the compliant displacement, the axes under force control and the settings
    /// of their loops
    Show(SimpleArgs),
    /// Zero the force sensor; only at standstill, without contact
    Tare(SimpleArgs),
    /// Set the axes under force control, and the settings of their loops
    ///
    /// Settings that are not given keep their values. They can be changed while a job runs; the
    /// commanded position does not step. An axis that leaves force control returns to the
    /// programmed position at f_d / K_V.
    Set(SetArgs),
}

impl ForceCommand {
    /// Whether standard output is JSON.
    pub(super) fn is_json(&self) -> bool {
        match self {
            Self::Show(args) | Self::Tare(args) => args.json,
            Self::Set(args) => args.simple.json,
        }
    }
}

/// Arguments of `haptimill force set`.
#[derive(Debug, Clone, Args)]
pub struct SetArgs {
    /// Axes under force control, as x,z, or none
    #[arg(value_name = "AXES", value_parser = parse_axes)]
    pub axes: ForceAxes,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub settings: ForceArgs,
    /// Largest compliant displacement, mm
    #[arg(long, value_name = "MM", value_parser = finite, allow_negative_numbers = true)]
    pub limit: Option<f64>,
    /// Maximum rate of the compliant displacement, mm/s
    #[arg(long, value_name = "MM/S", value_parser = finite, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Enable condition of the compliance: against_motion, any, positive or negative
    #[arg(long, value_name = "WHEN", value_parser = parse_enable_condition)]
    pub enable_condition: Option<EnableCondition>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simple: SimpleArgs,
}

/// Force setpoint and admittance gains.
#[derive(Debug, Clone, Default, Args)]
pub struct ForceArgs {
    /// Force setpoint f_d, N
    #[arg(long, value_name = "N", value_parser = finite, allow_negative_numbers = true)]
    pub force_setpoint: Option<f64>,
    /// Virtual mass K_A, N s^2/mm
    #[arg(long, value_name = "GAIN", value_parser = finite, allow_negative_numbers = true)]
    pub virtual_mass: Option<f64>,
    /// Virtual damping K_V, N s/mm
    #[arg(long, value_name = "GAIN", value_parser = finite, allow_negative_numbers = true)]
    pub virtual_damping: Option<f64>,
}

impl ForceArgs {
    /// The settings that were given.
    #[must_use]
    pub fn choice(&self) -> ForceLoopChanges {
        ForceLoopChanges {
            setpoint_n: self.force_setpoint,
            mass: self.virtual_mass,
            damping: self.virtual_damping,
            ..ForceLoopChanges::default()
        }
    }

    /// Whether no setting was given.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.force_setpoint.is_none()
            && self.virtual_mass.is_none()
            && self.virtual_damping.is_none()
    }
}

/// Force axes in ascending order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ForceAxes(pub Vec<u8>);

/// Parses axes, as `x,z`.
pub(super) fn parse_axes(text: &str) -> Result<ForceAxes, String> {
    if text == "none" {
        return Ok(ForceAxes(Vec::new()));
    }
    let mut found = Vec::new();
    for word in text.split(',') {
        let axis = COMPONENT_NAMES.iter().position(|name| *name == word.trim());
        let axis = axis.ok_or_else(|| {
            format!("\"{word}\" has no force sensor; write x, y, z, or several as x,z, or none")
        })? as u8;
        if !found.contains(&axis) {
            found.push(axis);
        }
    }
    found.sort_unstable();
    Ok(ForceAxes(found))
}

fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("write a finite number".to_string()),
    }
}

fn parse_enable_condition(text: &str) -> Result<EnableCondition, String> {
    let found = ENABLE_CONDITIONS.iter().find(|(word, _)| *word == text);
    found
        .map(|(_, enable_condition)| *enable_condition)
        .ok_or_else(|| "write against_motion, any, positive or negative".to_string())
}

/// Runs a force command.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: ForceCommand) -> Result<(), CliError> {
    match command {
        ForceCommand::Show(args) => {
            let mut session = connect(&args)?;
            show(&mut session, args.json)
        }
        ForceCommand::Tare(args) => {
            let mut session = connect(&args)?;
            session.tare()?;
            show(&mut session, args.json)
        }
        ForceCommand::Set(args) => {
            let mut session = connect(&args.simple)?;
            let choice = ForceLoopChanges {
                limit_mm: args.limit,
                rate_mm_s: args.rate,
                enable_condition: args.enable_condition,
                ..args.settings.choice()
            };
            session.change_force_loops(&args.axes.0, &choice)?;
            session.set_force_mask(&args.axes.0)?;
            show(&mut session, args.simple.json)
        }
    }
}

/// Opens a session that changes no configuration. Force settings have the units of the protocol, so
/// they need no machine file.
fn connect(args: &SimpleArgs) -> Result<Session<PortLine>, CliError> {
    let chosen = args.machine.load()?;
    let mut session = open(&args.connect, &chosen.file)?;
    agree(&chosen, &mut session, Need::Nothing)?;
    Ok(session)
}

/// Prints the forces and the settings.
fn show(session: &mut Session<PortLine>, json: bool) -> Result<(), CliError> {
    let status = session.status()?;
    let Some(force) = status.force else {
        let what = if session.machine_name().is_empty() {
            "the board has no configuration; send it a machine file with \
             `haptimill home --machine FILE`"
        } else {
            "the configuration of the controller has no force sensor; configure it with a machine \
             file that has a section [force]"
        };
        return Err(CliError::new(Exit::Command, what));
    };
    let problem = force.problem.as_ref().map(|problem| {
        session
            .model()
            .with_axes(|axes| axes.describe(problem).to_string())
    });
    let loops = [
        session.force_loop(0)?,
        session.force_loop(1)?,
        session.force_loop(2)?,
    ];
    if json {
        let mut value = to_json(&force, problem.as_deref());
        value["loops"] = COMPONENT_NAMES
            .iter()
            .zip(&loops)
            .map(|(name, settings)| ((*name).to_string(), loop_to_json(settings)))
            .collect();
        print_line!("{value:#}");
        return Ok(());
    }
    let row = |what: &str, unit: &str, values: [f64; COMPONENTS]| {
        let [x, y, z] = values;
        print_line!("{what:<14}{x:>10.3}{y:>10.3}{z:>10.3}  {unit}");
    };
    print_line!("{:<14}{:>10}{:>10}{:>10}", "", "x", "y", "z");
    row("peak force", "N", newtons(force.high));
    row("opposite end", "N", newtons(force.low));
    row("displacement", "mm", millimetres(force.displacement));
    row("f_d", "N", newtons(loops.map(|x| x.setpoint)));
    row(
        "K_A",
        "N s^2/mm",
        loops.map(|x| f64::from(x.mass) / 65_536.0),
    );
    row(
        "K_V",
        "N s/mm",
        loops.map(|x| f64::from(x.damping) / 65_536.0),
    );
    row("limit", "mm", millimetres(loops.map(|x| x.limit)));
    row("rate limit", "mm/s", millimetres(loops.map(|x| x.rate)));
    let [x, y, z] = loops.map(|settings| enable_condition_name(settings.enable_condition));
    print_line!("{:<14}x {x}, y {y}, z {z}", "enable if");
    let axes: Vec<&str> = axes_under_control(&force);
    let axes = if axes.is_empty() {
        "none".to_string()
    } else {
        axes.join(", ")
    };
    let zero = if force.tared {
        "known"
    } else {
        "not known; zero it with `haptimill force tare`"
    };
    print_line!("under force control: {axes}; zero of the sensor: {zero}");
    if let Some(problem) = problem {
        print_line!("{problem}");
    }
    Ok(())
}

/// Forces of the protocol in N.
pub(crate) fn newtons(values: [i32; COMPONENTS]) -> [f64; COMPONENTS] {
    values.map(|value| f64::from(value) / 65_536.0)
}

fn millimetres(values: [i32; COMPONENTS]) -> [f64; COMPONENTS] {
    values.map(|value| f64::from(value) / 1_048_576.0)
}

/// Name of an enable condition in the machine file and on the command line.
fn enable_condition_name(enable_condition: EnableCondition) -> &'static str {
    let found = ENABLE_CONDITIONS
        .iter()
        .find(|(_, known)| *known == enable_condition);
    found.map_or("", |(word, _)| word)
}

/// The settings of a loop as JSON, with the key names of the machine file.
fn loop_to_json(settings: &ForceLoop) -> serde_json::Value {
    serde_json::json!({
        "setpoint_n": f64::from(settings.setpoint) / 65_536.0,
        "mass_n_s2_per_mm": f64::from(settings.mass) / 65_536.0,
        "damping_n_s_per_mm": f64::from(settings.damping) / 65_536.0,
        "limit_mm": f64::from(settings.limit) / 1_048_576.0,
        "rate_mm_s": f64::from(settings.rate) / 1_048_576.0,
        "enable_condition": enable_condition_name(settings.enable_condition),
    })
}

fn axes_under_control(force: &ForceTelemetry) -> Vec<&'static str> {
    let axes = COMPONENT_NAMES.iter().enumerate();
    axes.filter(|(axis, _)| force.mask & (1 << axis) != 0)
        .map(|(_, name)| *name)
        .collect()
}

/// The forces as JSON.
pub(super) fn to_json(force: &ForceTelemetry, problem: Option<&str>) -> serde_json::Value {
    let named = |values: [f64; COMPONENTS]| -> serde_json::Value {
        COMPONENT_NAMES.iter().copied().zip(values).collect()
    };
    serde_json::json!({
        "high_n": named(newtons(force.high)),
        "low_n": named(newtons(force.low)),
        "displacement_mm": named(millimetres(force.displacement)),
        "under_control": axes_under_control(force),
        "tared": force.tared,
        "problem": problem,
    })
}
