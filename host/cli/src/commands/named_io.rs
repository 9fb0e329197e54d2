//! `haptimill output set` and `haptimill probe`: named outputs, and a probing move.

use super::args::{BoardArg, ConnectArgs, seconds};
use super::jog::CoordinateValue;
use super::probe_cycle::{self, ProbeCycle};
use super::probing::{Touch, find_input, probe_along};
use super::simple::{open, print_status};
use super::{CliError, Exit};
use clap::{Args, Subcommand};
use haptimill_client::board::Need;
use haptimill_client::session::{check_has_tool, plan_straight_move};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::per_unit;
use haptimill_protocol::message::{AxisValues, Command};

/// Commands of outputs.
#[derive(Debug, Clone, Subcommand)]
pub enum OutputCommand {
    /// Switch an output on or off, or set an analog output to a value
    Set(SetArgs),
}

impl OutputCommand {
    /// Whether standard output is JSON.
    pub(super) const fn is_json(&self) -> bool {
        let Self::Set(args) = self;
        args.json
    }
}

/// Arguments of `haptimill output set`.
#[derive(Debug, Clone, Args)]
#[command(
    long_about = "Switch an output on or off, or set an analog output to a value.\n\nNAME is the \
                  name in the machine file (sections [[output]] and [[analog_output]]). An output \
                  with without_host = \"safe\" returns to its safe value when the controller \
                  receives nothing for heartbeat_ms: give --for to keep it longer."
)]
pub struct SetArgs {
    /// Name of the output in the machine file
    #[arg(value_name = "NAME")]
    pub name: String,
    /// on, off, or the value of an analog output in the unit of the machine file
    #[arg(value_name = "on|off|VALUE", allow_negative_numbers = true)]
    pub value: String,
    /// Stay connected for this time
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs a command of outputs.
///
/// # Errors
/// See [`Exit`].
pub fn run(command: OutputCommand) -> Result<(), CliError> {
    let OutputCommand::Set(args) = command;
    let chosen = args.machine.load()?;
    if chosen.named {
        command_of(&chosen.file, &args.name, &args.value)?;
    }
    let mut session = open(&args.connect, &chosen.file)?;
    let machine = chosen.file_of(&mut session)?;
    let (command, returns) = command_of(&machine, &args.name, &args.value)?;
    session.ask(command)?;
    if let Some(duration) = args.duration {
        let end = session.now_us() + (duration * 1e6) as u64;
        while session.now_us() < end && !session.is_interrupted() {
            session.step()?;
        }
    } else if returns && !args.json {
        print_line!(
            "{} returns to its safe value {} ms after this command (without_host = \"safe\"); \
             --for keeps it",
            args.name,
            machine.config.supervision.heartbeat_ms
        );
    }
    print_status(&mut session, args.json)
}

/// The command that sets an output, and whether a silent host ends its effect.
fn command_of(machine: &MachineFile, name: &str, value: &str) -> Result<(Command, bool), CliError> {
    let usage = |what: String| CliError::new(Exit::Usage, what);
    let (names, config) = (&machine.io, &machine.config.io);
    if let Some(index) = names.outputs.iter().position(|known| known == name) {
        let on = match value {
            "on" => true,
            "off" => false,
            _ => return Err(usage(format!("{name}: \"{value}\" is not on or off"))),
        };
        let returns = config.outputs[index].safe_without_host;
        let output = index as u8;
        return Ok((Command::SetOutput { output, on }, returns));
    }
    let analog = &names.analog_outputs;
    if let Some(index) = analog.iter().position(|known| known.name == name) {
        let (known, limits) = (&analog[index], &config.analog_outputs[index]);
        let ends = [known.value(limits.low), known.value(limits.high)];
        let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        let unit = &known.unit;
        let number = value.parse::<f64>().ok();
        let code = number
            .map(|number| known.code(number))
            .filter(|code| (limits.low..=limits.high).contains(code));
        let Some(code) = code else {
            let what = format!("{name}: \"{value}\" is not a number from {low} to {high} {unit}");
            return Err(usage(what.trim_end().to_string()));
        };
        let output = index as u8;
        let command = Command::SetAnalogOutput { output, code };
        return Ok((command, limits.safe_without_host));
    }
    let all = names.outputs.iter().cloned();
    let all: Vec<String> = all
        .chain(analog.iter().map(|known| known.name.clone()))
        .collect();
    Err(usage(if all.is_empty() {
        format!(
            "{}: the machine has no outputs; add sections [[output]]",
            machine.file
        )
    } else {
        format!(
            "there is no output '{name}'; this machine has {}",
            all.join(", ")
        )
    }))
}

/// Arguments of `haptimill probe`.
#[derive(Debug, Clone, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    about = "Move to a position until the probe makes contact, and print the position of the \
             contact; probing cycles",
    long_about = "Move along a straight line to a position until the probe makes contact, and \
                  print the position of the contact.\n\nThe machine must be homed and idle. It \
                  decelerates along its path at the contact, so the position must leave room beyond \
                  it. The printed position is the measured one in the control period of the \
                  contact. A move that ends without a contact is an error (exit code 8)."
)]
pub struct ProbeArgs {
    /// A probing cycle instead of a single move
    #[command(subcommand)]
    pub cycle: Option<ProbeCycle>,
    /// Pose coordinates and their positions, mm or deg, as z=-20
    #[arg(
        value_name = "COORDINATE=POSITION",
        required = true,
        allow_negative_numbers = true
    )]
    pub coordinates: Vec<CoordinateValue>,
    /// Feed, mm/min (deg/min where only rotary coordinates move)
    #[arg(long, value_name = "FEED", default_value_t = 60.0)]
    pub feed: f64,
    /// Input of the contact [default: the one with the function "probe"]
    #[arg(long, value_name = "NAME")]
    pub input: Option<String>,
    /// Move until the contact is lost
    #[arg(long)]
    pub away: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: Option<ConnectArgs>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

impl ProbeArgs {
    /// Whether standard output is JSON.
    pub(super) fn is_json(&self) -> bool {
        self.cycle.as_ref().map_or(self.json, ProbeCycle::is_json)
    }
}

/// Probes.
///
/// # Errors
/// See [`Exit`].
pub fn probe(args: ProbeArgs) -> Result<(), CliError> {
    if let Some(cycle) = &args.cycle {
        return probe_cycle::run(cycle);
    }
    let Some(connect) = &args.connect else {
        let what = "probe: write --port PORT";
        return Err(CliError::new(Exit::Usage, what));
    };
    super::jog::check_feed(args.feed)?;
    let chosen = args.machine.load()?;
    if chosen.named {
        find_input(&chosen.file, args.input.as_deref(), Touch::Probe)?;
    }
    let mut session = open(connect, &chosen.file)?;
    let machine = chosen
        .agree(&mut session, Need::File)?
        .unwrap_or(chosen.file);
    check_has_tool(&machine)?;
    let input = find_input(&machine, args.input.as_deref(), Touch::Probe)?;
    let start = session.status()?.commanded;
    let end = target(&args, &machine, &start)?;
    let plan = plan_straight_move(&machine, session.model(), &start, &end, Some(args.feed))?;
    let Some(contact) = probe_along(&mut session, plan, input, args.away)? else {
        let name = &machine.io.inputs[usize::from(input)];
        let what = format!("the move ended without a contact of {name}");
        return Err(CliError::new(Exit::Command, what));
    };
    let values = session.model().to_engineering_units(&contact.pose);
    let names = session.model().pose_names();
    let place = names.iter().zip(values).map(|(name, value)| (*name, value));
    if args.json {
        let measured: serde_json::Map<String, serde_json::Value> = place
            .map(|(name, value)| (name.to_string(), value.into()))
            .collect();
        let value = serde_json::json!({ "contact": measured, "period": contact.period });
        print_line!("{value:#}");
    } else {
        let text: String = place
            .map(|(name, value)| format!("  {name} {value:.4}"))
            .collect();
        print_line!("contact at{text}");
    }
    Ok(())
}

/// The end of the move, axis units.
fn target(
    args: &ProbeArgs,
    machine: &MachineFile,
    start: &AxisValues,
) -> Result<AxisValues, CliError> {
    let mut end = start.clone();
    for command in &args.coordinates {
        let index = super::jog::coordinate_index(machine, &command.coordinate)?;
        let value = command.value * per_unit(machine.pose[index].kind);
        if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value) {
            let what = format!("{}={} is out of range", command.coordinate, command.value);
            return Err(CliError::new(Exit::Usage, what));
        }
        end[index] = value.round() as i32;
    }
    Ok(end)
}
