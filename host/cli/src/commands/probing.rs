//! Probing moves: an armed input ends a straight move, and the controller reports the contact.

use super::{CliError, Exit};
use haptimill_client::session::{Line, NoObserver, Session};
use haptimill_firmware::named_io::config::InputFunction;
use haptimill_gcode::WaitFor;
use haptimill_machine_file::MachineFile;
use haptimill_planner::Plan;
use haptimill_protocol::message::{AxisValues, Command, Event, Telemetry};

/// The host's number of a probing job.
const PROBE_JOB: u32 = 2;

/// A contact.
pub(super) struct Contact {
    /// Measured pose in the control period of the contact, axis units.
    pub(super) pose: AxisValues,
    /// The control period.
    pub(super) period: u64,
}

/// What is wrong with the start of a probe move, and the remedy: its input has its final level
/// already. The controller refuses such a move without its place in the program.
pub(super) fn wrong_start(
    machine: &MachineFile,
    status: &Telemetry,
    input: u8,
    away: bool,
) -> Option<(String, &'static str)> {
    let inputs = status.io.as_ref().map_or(0, |io| io.inputs);
    let is_in_contact = inputs >> input & 1 != 0;
    let name = &machine.io.inputs[usize::from(input)];
    match (is_in_contact, away) {
        (true, false) => Some((
            format!("the probe move begins with {name} in contact"),
            "move it off first, or write G38.4 or G38.5",
        )),
        (false, true) => Some((
            format!("the probe move away begins with {name} not in contact"),
            "move it into contact first, or write G38.2 or G38.3",
        )),
        _ => None,
    }
}

/// Waits for an input, as M66 does; returns its value, or -1 after the time limit.
///
/// # Errors
/// The line to the controller fails.
pub(super) fn wait_for_input<L: Line>(
    session: &mut Session<L>,
    machine: &MachineFile,
    (number, is_analog): (usize, bool),
    until: WaitFor,
    seconds: f64,
) -> Result<f64, CliError> {
    let end_us = session.now_us().saturating_add((seconds * 1e6) as u64);
    let mut before = None;
    loop {
        let io = session.status()?.io.unwrap_or_default();
        if is_analog {
            let code = io.analog_inputs.get(number).copied().unwrap_or_default();
            return Ok(machine.io.analog_inputs[number].value(code));
        }
        let level = io.inputs >> number & 1 != 0;
        let is_reached = match until {
            WaitFor::Nothing => true,
            WaitFor::High => level,
            WaitFor::Low => !level,
            WaitFor::Rise => level && before == Some(false),
            WaitFor::Fall => !level && before == Some(true),
        };
        if is_reached {
            return Ok(f64::from(u8::from(level)));
        }
        if session.now_us() >= end_us {
            return Ok(-1.0);
        }
        before = Some(level);
    }
}

/// Runs a planned move until an input has its contact, or loses it with `away`. `None`: the move
/// ended without one.
///
/// # Errors
/// The controller refuses to arm the probe or to move, or the move was stopped.
pub(super) fn probe_along<L: Line>(
    session: &mut Session<L>,
    plan: Plan,
    input: u8,
    away: bool,
) -> Result<Option<Contact>, CliError> {
    session.ask(Command::ArmProbe {
        input,
        active: !away,
    })?;
    let first = session.events.len();
    let axes = plan.start.len();
    let ended = session.run_job(PROBE_JOB, plan.start, plan.setpoints, &mut NoObserver)?;
    let found = contact(session, first, axes);
    if ended.stopped || !ended.faults.is_empty() || found.is_none() {
        session.check_completed(&ended)?;
    }
    Ok(found)
}

/// The contact that the events report.
fn contact<L: Line>(session: &Session<L>, first: usize, axes: usize) -> Option<Contact> {
    let mut pose: AxisValues = std::iter::repeat_n(0, axes).collect();
    let mut found = None;
    for (_, event) in &session.events[first..] {
        match event {
            Event::ProbedAt {
                coordinate,
                measured,
                ..
            } => {
                if let Some(slot) = pose.get_mut(usize::from(*coordinate)) {
                    *slot = *measured;
                }
            }
            Event::Probed { period, .. } => found = Some(*period),
            _ => {}
        }
    }
    found.map(|period| Contact { pose, period })
}

/// Function of the input of a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Touch {
    /// The probe in the spindle.
    Probe,
    /// The tool setter on the table.
    ToolSetter,
}

/// Index of the input that has the contact: the named one, or the one with the function.
///
/// # Errors
/// [`Exit::Usage`]: the machine has none, with those that it has.
pub(super) fn find_input(
    machine: &MachineFile,
    name: Option<&str>,
    touch: Touch,
) -> Result<u8, CliError> {
    let inputs = || machine.config.io.inputs.iter().zip(&machine.io.inputs);
    let index = match name {
        Some(name) => inputs().position(|(it, known)| it.function.is_probe() && known == name),
        None => inputs().position(|(it, _)| match touch {
            Touch::Probe => matches!(it.function, InputFunction::Probe(_)),
            Touch::ToolSetter => matches!(it.function, InputFunction::ToolSetter(_)),
        }),
    };
    let probes: Vec<&str> = inputs()
        .filter(|(it, _)| it.function.is_probe())
        .map(|(_, name)| name.as_str())
        .collect();
    index.map(|index| index as u8).ok_or_else(|| {
        let what = match name {
            Some(name) if !probes.is_empty() => format!(
                "'{name}' is no probe and no tool setter; this machine has {}",
                probes.join(", ")
            ),
            _ if !probes.is_empty() => {
                format!("name the input with --input: {}", probes.join(", "))
            }
            _ => {
                let (kind, function) = match touch {
                    Touch::Probe => ("probe", "probe"),
                    Touch::ToolSetter => ("tool setter", "tool_setter"),
                };
                format!(
                    "{}: the machine has no {kind}; add a section [[input]] with function = \
                     \"{function}\"",
                    machine.file
                )
            }
        };
        CliError::new(Exit::Usage, what)
    })
}
