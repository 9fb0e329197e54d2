//! `haptimill force`: the force sensor and the force loop of a running controller.

use super::one_shot::{OneShotArgs, open};
use super::{CliError, Exit};
use clap::{Args, Subcommand};
use haptimill_client::board::Need;
use haptimill_client::session::{ForceLoopChanges, PortLine, Session};
use haptimill_machine_file::GATES;
use haptimill_protocol::force::{COMPONENTS, ForceLoop, ForceTelemetry, Gate};

/// Names of the components.
const NAMES: [&str; COMPONENTS] = ["x", "y", "z"];

/// What can be done with the force.
#[derive(Debug, Subcommand)]
pub enum ForceCommand {
    /// Forces, how far the tool yields, which axes are under force control, and the settings of their loops on the controller
    Show(OneShotArgs),
    /// Take what the sensor shows now as its zero; only at rest, with nothing at the tool
    Tare(OneShotArgs),
    /// Set which axes are under force control, and their loops
    ///
    /// What is not given stays as the controller has it. It can be changed while a job runs: the tool does not jump. An axis that is taken out returns to the programmed position
    /// at f_d / K_V.
    Set(SetArgs),
}

impl ForceCommand {
    /// Whether a program reads the standard output.
    pub(super) fn json(&self) -> bool {
        match self {
            Self::Show(args) | Self::Tare(args) => args.json,
            Self::Set(args) => args.force.json,
        }
    }
}

/// Arguments of `haptimill force set`.
#[derive(Debug, Clone, Args)]
pub struct SetArgs {
    /// Axes under force control, as x,z; none for none
    #[arg(value_name = "AXES", value_parser = axes)]
    pub axes: Axes,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub gains: LoopArgs,
    /// The most that the tool yields, mm
    #[arg(long, value_name = "MM", value_parser = finite, allow_negative_numbers = true)]
    pub limit: Option<f64>,
    /// The fastest that the tool yields, mm/s
    #[arg(long, value_name = "MM/S", value_parser = finite, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// When a force moves the tool away: against_motion, any, positive or negative
    #[arg(long, value_name = "WHEN", value_parser = gate)]
    pub gate: Option<Gate>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub force: OneShotArgs,
}

/// Desired force and gains.
#[derive(Debug, Clone, Default, Args)]
pub struct LoopArgs {
    /// Desired force f_d, N
    #[arg(long, value_name = "N", value_parser = finite, allow_negative_numbers = true)]
    pub fd: Option<f64>,
    /// Virtual mass K_A, N s^2/mm
    #[arg(long, value_name = "GAIN", value_parser = finite, allow_negative_numbers = true)]
    pub ka: Option<f64>,
    /// Virtual damping K_V, N s/mm
    #[arg(long, value_name = "GAIN", value_parser = finite, allow_negative_numbers = true)]
    pub kv: Option<f64>,
}

impl LoopArgs {
    /// What was said, and nothing else.
    #[must_use]
    pub fn choice(&self) -> ForceLoopChanges {
        ForceLoopChanges {
            desired_n: self.fd,
            mass: self.ka,
            damping: self.kv,
            ..ForceLoopChanges::default()
        }
    }

    /// Whether nothing was said.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.fd.is_none() && self.ka.is_none() && self.kv.is_none()
    }
}

/// Axes of force, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axes(pub Vec<u8>);

/// Reads axes, as `x,z`.
pub(super) fn axes(text: &str) -> Result<Axes, String> {
    if text == "none" {
        return Ok(Axes(Vec::new()));
    }
    let mut found = Vec::new();
    for word in text.split(',') {
        let axis = NAMES.iter().position(|name| *name == word.trim());
        let axis = axis.ok_or_else(|| {
            format!("\"{word}\" has no force sensor; write x, y, z, or several as x,z, or none")
        })? as u8;
        if !found.contains(&axis) {
            found.push(axis);
        }
    }
    found.sort_unstable();
    Ok(Axes(found))
}

fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("write a finite number".to_string()),
    }
}

fn gate(text: &str) -> Result<Gate, String> {
    let found = GATES.iter().find(|(word, _)| *word == text);
    found
        .map(|(_, gate)| *gate)
        .ok_or_else(|| "write against_motion, any, positive or negative".to_string())
}

/// Carries out a force command.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: ForceCommand) -> Result<(), CliError> {
    match command {
        ForceCommand::Show(args) => {
            let mut session = look(&args)?;
            show(&mut session, args.json)
        }
        ForceCommand::Tare(args) => {
            let mut session = look(&args)?;
            session.tare()?;
            show(&mut session, args.json)
        }
        ForceCommand::Set(args) => {
            let mut session = look(&args.force)?;
            let choice = ForceLoopChanges {
                limit_mm: args.limit,
                rate_mm_s: args.rate,
                gate: args.gate,
                ..args.gains.choice()
            };
            session.change_force_loops(&args.axes.0, &choice)?;
            session.set_force_mask(&args.axes.0)?;
            show(&mut session, args.force.json)
        }
    }
}

/// A session that changes no configuration: the force loop has the units of the wire.
fn look(args: &OneShotArgs) -> Result<Session<PortLine>, CliError> {
    let chosen = args.machine.load()?;
    let mut session = open(&args.connect, &chosen.file)?;
    chosen.agree(&mut session, Need::Nothing)?;
    Ok(session)
}

/// Says how the forces stand.
fn show(session: &mut Session<PortLine>, json: bool) -> Result<(), CliError> {
    let status = session.status()?;
    let Some(force) = status.force else {
        let what = if session.machine_name().is_empty() {
            "the board has no configuration; `haptimill home --machine FILE` sends it the machine file"
        } else {
            "the controller has no force sensor in its configuration; configure it with a machine file that has a section [force]"
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
        value["loops"] = NAMES
            .iter()
            .zip(&loops)
            .map(|(name, settings)| ((*name).to_string(), loop_to_json(settings)))
            .collect();
        tell!("{value:#}");
        return Ok(());
    }
    let row = |what: &str, unit: &str, values: [f64; COMPONENTS]| {
        let [x, y, z] = values;
        tell!("{what:<14}{x:>10.3}{y:>10.3}{z:>10.3}  {unit}");
    };
    tell!("{:<14}{:>10}{:>10}{:>10}", "", "x", "y", "z");
    row("force, high", "N", newtons(force.high));
    row("force, low", "N", newtons(force.low));
    row("tool yields", "mm", millimetres(force.yielded));
    row("f_d", "N", newtons(loops.map(|x| x.desired)));
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
    row("yields most", "mm", millimetres(loops.map(|x| x.limit)));
    row("fastest", "mm/s", millimetres(loops.map(|x| x.rate)));
    let [x, y, z] = loops.map(|settings| word(settings.gate));
    tell!("{:<14}x {x}, y {y}, z {z}", "yields when");
    let under: Vec<&str> = under_control(&force);
    let under = if under.is_empty() {
        "none".to_string()
    } else {
        under.join(", ")
    };
    let zero = if force.tared {
        "known"
    } else {
        "not known; tare it"
    };
    tell!("under force control: {under}; zero of the sensor: {zero}");
    if let Some(problem) = problem {
        tell!("{problem}");
    }
    Ok(())
}

fn newtons(values: [i32; COMPONENTS]) -> [f64; COMPONENTS] {
    values.map(|value| f64::from(value) / 65_536.0)
}

fn millimetres(values: [i32; COMPONENTS]) -> [f64; COMPONENTS] {
    values.map(|value| f64::from(value) / 1_048_576.0)
}

/// A gate as the machine file and the command line call it.
fn word(gate: Gate) -> &'static str {
    let found = GATES.iter().find(|(_, known)| *known == gate);
    found.map_or("", |(word, _)| word)
}

/// The settings of a loop, for a program: the names are those of the machine file.
fn loop_to_json(settings: &ForceLoop) -> serde_json::Value {
    serde_json::json!({
        "desired_n": f64::from(settings.desired) / 65_536.0,
        "mass_n_s2_per_mm": f64::from(settings.mass) / 65_536.0,
        "damping_n_s_per_mm": f64::from(settings.damping) / 65_536.0,
        "limit_mm": f64::from(settings.limit) / 1_048_576.0,
        "rate_mm_s": f64::from(settings.rate) / 1_048_576.0,
        "gate": word(settings.gate),
    })
}

fn under_control(force: &ForceTelemetry) -> Vec<&'static str> {
    let axes = NAMES.iter().enumerate();
    axes.filter(|(axis, _)| force.mask & (1 << axis) != 0)
        .map(|(_, name)| *name)
        .collect()
}

/// How the forces stand, for a program.
pub(super) fn to_json(force: &ForceTelemetry, problem: Option<&str>) -> serde_json::Value {
    let named = |values: [f64; COMPONENTS]| -> serde_json::Value {
        NAMES.iter().copied().zip(values).collect()
    };
    serde_json::json!({
        "high_n": named(newtons(force.high)),
        "low_n": named(newtons(force.low)),
        "yielded_mm": named(millimetres(force.yielded)),
        "under_control": under_control(force),
        "tared": force.tared,
        "problem": problem,
    })
}
