//! `haptimill jog`: moves at a rate for a time, with a timeout for the next command.

use super::args::{BoardArg, ConnectArgs, seconds};
use super::board::file_of;
use super::simple::{open, print_status};
use super::{CliError, Exit};
use clap::Args;
use haptimill_client::board::Chosen;
use haptimill_client::session::{EMERGENCY_STOP, NoObserver, check_has_tool, plan_straight_move};
use haptimill_firmware::config::AxisKind;
use haptimill_gcode::Coordinates;
use haptimill_machine_file::jog_limit::jog_limit;
use haptimill_machine_file::scale::per_unit;
use haptimill_machine_file::{AxisLimits, MachineFile};
use haptimill_protocol::message::{AxisValues, Event, RATE_SHIFT, State};
use std::str::FromStr;

const LONG: &str = "\
Move pose coordinates at a rate for a time, or by a distance.

Rates are in mm/s and degrees/s: `haptimill jog x=5 b=-2 --for 1.5`. COORDINATE is the name of a \
pose coordinate in the machine file, or its letter in part programs; a wrong name lists those of \
the machine. The controller stops the motion at the soft limits. It stops the machine when it \
receives nothing from this command for --jog-timeout milliseconds. Ctrl-C stops.

`haptimill jog --by x=5` moves by a distance instead, in mm and degrees, along a straight line at \
--feed. The machine must be homed. A move beyond a soft limit is refused.";

/// Arguments of `haptimill jog`.
#[derive(Debug, Clone, Args)]
#[command(about = "Move pose coordinates at a rate for a time, or by a distance",
          long_about = LONG)]
pub struct JogArgs {
    /// Pose coordinates and rates, mm/s or deg/s
    #[arg(
        value_name = "COORDINATE=RATE",
        required_unless_present = "by",
        conflicts_with = "by",
        allow_negative_numbers = true
    )]
    pub coordinates: Vec<CoordinateValue>,
    /// Move by distances in mm or degrees instead, as x=5, or x=5 y=-2 without quotes
    #[arg(long, value_name = "COORDINATE=DISTANCE", num_args = 1.., allow_negative_numbers = true)]
    pub by: Vec<CoordinateValue>,
    /// With --by: feed in mm/min (deg/min where only rotary coordinates move)
    #[arg(long, value_name = "FEED", default_value_t = 300.0, requires = "by")]
    pub feed: f64,
    /// Duration of the jog
    #[arg(long = "for", value_name = "SECONDS", default_value_t = 1.0, conflicts_with = "by",
          value_parser = seconds)]
    pub duration: f64,
    /// Jog timeout: the controller stops the jog when it receives no jog command for this long
    #[arg(long, value_name = "MS", default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub jog_timeout: u16,
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

/// A pose coordinate and its rate, distance or position.
#[derive(Debug, Clone, PartialEq)]
pub struct CoordinateValue {
    /// Name of the coordinate, as in the machine file, or its letter in part programs; in lower
    /// case.
    pub coordinate: String,
    /// Value, mm or deg, or per second; finite.
    pub value: f64,
}

impl FromStr for CoordinateValue {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let remedy = "write a coordinate and a number, each pair as a word of its own: x=5 y=-2";
        let (coordinate, value) = text.split_once('=').ok_or(remedy)?;
        match value.trim().parse::<f64>() {
            Ok(value) if value.is_finite() && !coordinate.trim().is_empty() => Ok(Self {
                coordinate: coordinate.trim().to_lowercase(),
                value,
            }),
            _ => Err(remedy.to_string()),
        }
    }
}

/// Time between two jog commands as a fraction of the timeout: two may be lost before the machine
/// stops.
const REPEAT: f64 = 0.3;

/// Jogs the machine.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: JogArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    if !args.by.is_empty() {
        return move_by(&args, &chosen);
    }
    if chosen.named {
        rates(&args, &chosen.file)?;
    }
    let mut session = open(&args.connect, &chosen.file)?;
    let machine = file_of(&chosen, &mut session)?;
    let rates = rates(&args, &machine)?;
    let first = session.events.len();
    let begun = session.now_us();
    let end = begun + (args.duration * 1e6) as u64;
    let repeat = (f64::from(args.jog_timeout) * 1000.0 * REPEAT) as u64;
    let mut next = begun;
    if !args.json {
        print_line!("jogging for {} s; Ctrl-C stops", args.duration);
    }
    let refused = loop {
        if session.now_us() >= next {
            next += repeat;
            let lost = |error| CliError::new(Exit::Port, error);
            session
                .client_mut()
                .jog(rates.clone(), args.jog_timeout)
                .map_err(lost)?;
        }
        session.step()?;
        if session.now_us() >= end || session.is_interrupted() {
            break None;
        }
        if let Some(refusal) = session.refusal() {
            break Some(refusal);
        }
    };
    let ticket = session.client_mut().cancel_jog();
    session.wait_for_acknowledgement(ticket)?;
    let at = loop {
        let status = session.status()?;
        if status.state != State::Jog {
            break session.model().to_engineering_units(&status.commanded);
        }
    };
    let mut limited = Vec::new();
    for (_, event) in &session.events[first..] {
        match event {
            // Every jog command at the limit reports it; the user needs it once.
            Event::JogLimited { coordinate } if !limited.contains(coordinate) => {
                limited.push(*coordinate);
                let coordinate = usize::from(*coordinate);
                if coordinate < machine.pose.len() {
                    let rates = asked_rates(&args, &machine)?;
                    eprintln!(
                        "{}",
                        jog_limit(&machine, session.model(), coordinate, &at, &rates)
                    );
                }
            }
            Event::Fault(fault) => return Err(session.fault(fault).into()),
            Event::State {
                to: State::EmergencyStop,
                ..
            } => return Err(CliError::new(Exit::Fault, EMERGENCY_STOP)),
            _ => {}
        }
    }
    // A fault or emergency stop above is the cause of a refusal, so it comes first.
    if let Some(refusal) = refused {
        return Err(CliError::new(Exit::Command, format!("jog: {refusal}")));
    }
    print_status(&mut session, args.json)?;
    if session.is_interrupted() {
        return Err(CliError::new(Exit::Stopped, "stopped by the user").reported());
    }
    Ok(())
}

/// The host's number of the job of a move by a distance.
const MOVE_JOB: u32 = 2;

/// Moves by distances along a straight line.
fn move_by(args: &JogArgs, chosen: &Chosen) -> Result<(), CliError> {
    check_feed(args.feed)?;
    if chosen.named {
        distances(&args.by, &chosen.file)?;
    }
    let mut session = open(&args.connect, &chosen.file)?;
    let machine = file_of(chosen, &mut session)?;
    let distances = distances(&args.by, &machine)?;
    let from = session.status()?.commanded;
    let mut to = session.model().to_engineering_units(&from);
    for ((value, distance), axis) in to.iter_mut().zip(distances).zip(&machine.pose) {
        *value += distance;
        check_distance(axis, distance, *value)?;
    }
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(&machine, session.model(), &from, &to, Some(args.feed))?;
    let end = session.run_job(MOVE_JOB, from, plan.setpoints, &mut NoObserver)?;
    session.check_completed(&end)?;
    print_status(&mut session, args.json)
}

/// Refuses a distance that ends outside the soft limits of its coordinate.
///
/// # Errors
/// [`Exit::Refused`].
fn check_distance(axis: &AxisLimits, distance: f64, end: f64) -> Result<(), CliError> {
    let (low, high) = (axis.low, axis.high);
    if distance == 0.0 || axis.wraps() || (low..=high).contains(&end) {
        return Ok(());
    }
    let unit = match axis.kind {
        AxisKind::Linear => "mm",
        AxisKind::Rotary | AxisKind::MultiTurn => "deg",
    };
    let max = distance + end.clamp(low, high) - end;
    let name = &axis.name;
    let what = format!(
        "jog --by {name}={distance}: {name} would end at {end:.4} {unit}, outside its soft limits \
         ({low} to {high} {unit}); write at most {name}={max:.3}"
    );
    Err(CliError::new(Exit::Refused, what))
}

/// Refuses a feed that is not above 0.
///
/// # Errors
/// [`Exit::Usage`].
pub(super) fn check_feed(feed: f64) -> Result<(), CliError> {
    if feed.is_finite() && feed > 0.0 {
        return Ok(());
    }
    let what = format!("--feed {feed}: write a feed above 0");
    Err(CliError::new(Exit::Usage, what))
}

/// Distances of all pose coordinates, mm and degrees.
fn distances(given: &[CoordinateValue], machine: &MachineFile) -> Result<Vec<f64>, CliError> {
    check_has_tool(machine)?;
    let mut distances = vec![0.0; machine.pose.len()];
    for command in given {
        let index = coordinate_index(machine, &command.coordinate)?;
        let axis = &machine.pose[index];
        let usage = |what: String| CliError::new(Exit::Usage, what);
        if distances[index] != 0.0 {
            let what = format!("{} is given twice; leave one out", axis.name);
            return Err(usage(what));
        }
        // Half a turn at most: beyond it, a coordinate that wraps around would turn the other way.
        let max = match axis.kind {
            AxisKind::Rotary => 180.0,
            AxisKind::Linear | AxisKind::MultiTurn => 1e6,
        };
        if command.value.abs() >= max {
            let what = format!(
                "{}={}: write less than {max}",
                command.coordinate, command.value
            );
            return Err(usage(what));
        }
        distances[index] = command.value;
    }
    Ok(distances)
}

/// Rates of all pose coordinates, mm/s and deg/s.
fn asked_rates(args: &JogArgs, machine: &MachineFile) -> Result<Coordinates, CliError> {
    let mut rates = Coordinates::default();
    for command in &args.coordinates {
        if let Some(rate) = rates.get_mut(coordinate_index(machine, &command.coordinate)?) {
            *rate = command.value;
        }
    }
    Ok(rates)
}

/// Rates of all pose coordinates in the units of the protocol.
fn rates(args: &JogArgs, machine: &MachineFile) -> Result<AxisValues, CliError> {
    let mut rates: Vec<i32> = vec![0; machine.pose.len()];
    let usage = |what: String| CliError::new(Exit::Usage, what);
    check_has_tool(machine)?;
    let mut given = vec![false; machine.pose.len()];
    for command in &args.coordinates {
        let index = coordinate_index(machine, &command.coordinate)?;
        let axis = &machine.pose[index];
        if std::mem::replace(&mut given[index], true) {
            return Err(usage(format!(
                "{} is given twice; leave one out",
                axis.name
            )));
        }
        if command.value.abs() > axis.rate {
            return Err(usage(format!(
                "{}={} exceeds the maximum rate of the coordinate; write at most {}",
                command.coordinate, command.value, axis.rate
            )));
        }
        rates[index] =
            (command.value * per_unit(axis.kind) / f64::from(1 << RATE_SHIFT)).round() as i32;
    }
    Ok(rates.into_iter().collect())
}

/// Index of a pose coordinate by its name in the machine file or its letter in part programs, both
/// in lower case.
///
/// # Errors
/// [`Exit::Usage`].
pub(crate) fn coordinate_index(machine: &MachineFile, name: &str) -> Result<usize, CliError> {
    let described = machine.config.model.descriptor().pose;
    let letters = described
        .iter()
        .map(|axis| axis.letter.to_lowercase().to_string());
    let index = machine
        .pose
        .iter()
        .position(|axis| axis.name.to_lowercase() == name)
        .or_else(|| letters.clone().position(|letter| letter == name))
        .filter(|index| *index < machine.pose.len());
    index.ok_or_else(|| {
        let names: Vec<String> = machine
            .pose
            .iter()
            .zip(described.iter().map(|axis| axis.letter))
            .map(|(axis, letter)| match axis.name.to_uppercase() {
                name if name == letter.to_string() => axis.name.clone(),
                _ => format!("{} (or {letter})", axis.name),
            })
            .collect();
        let what = format!(
            "there is no coordinate '{name}'; this machine has {}",
            names.join(", ")
        );
        CliError::new(Exit::Usage, what)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pairs in one word are refused with the way to write them.
    #[test]
    fn a_pair_is_a_word_of_its_own() {
        let pair: CoordinateValue = "X=-2.5".parse().expect("a pair");
        assert_eq!((pair.coordinate.as_str(), pair.value), ("x", -2.5));
        for text in ["x=5,y=-3", "x=5 y=-3", "x", "=5", "x=inf"] {
            let error = text.parse::<CoordinateValue>().expect_err(text);
            assert!(error.contains("x=5 y=-2"), "{error}");
        }
    }
}
