//! `haptimill identify`: measures the joints of a machine.

use super::args::ConnectArgs;
use super::board::file_of;
use super::identify_args::{IdentifyArgs, finish, folder, options, save, say};
use super::run::results::ResultFolder;
use super::simple::open;
use super::{CliError, Exit, index_pulses, lost_motion, output};
use crate::commands::interrupt;
use haptimill_client::client::Options as ClientOptions;
use haptimill_client::port::PortSpec;
use haptimill_client::session::{self, Line, Session, SimLine};
use haptimill_identify::edit;
use haptimill_identify::identify::{Identification, Identified, lines, torque_joints};
use haptimill_identify::index_pulses::IndexJoint;
use haptimill_identify::line::{Geometry, Line as Travel};
use haptimill_identify::lost_steps::{Highest, StepLimits};
use haptimill_identify::switch_test::{
    BEYOND, Skipped, StepJoint, StepOptions, SwitchTest, step_joints,
};
use haptimill_identify::tune::rounded;
use haptimill_identify::{page, record};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::Command;
use serde_json::{Value, json};
use std::io::{BufRead as _, IsTerminal as _, Write as _};

/// What is measured.
#[derive(Default)]
struct Tasks {
    /// Lines of the torque joints.
    lines: Vec<Travel>,
    /// Step joints.
    steps: Vec<StepJoint>,
    /// Joints whose lost motion is measured, in place of the others.
    gauged: Vec<usize>,
    /// Joints whose index pulses are sought, in place of the others.
    indexed: Vec<IndexJoint>,
    /// The other joints.
    skipped: Vec<Skipped>,
}

/// What was measured.
#[derive(Default)]
struct Found {
    joints: Vec<Identified>,
    steps: Vec<StepLimits>,
}

/// Measures the joints.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: IdentifyArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    match &args.port.port {
        PortSpec::Emulated(_) | PortSpec::EmulatedPins => {
            let what = "--port: the emulated boards are for `haptimill run`; leave --port out for \
                the simulator";
            Err(CliError::new(Exit::Usage, what))
        }
        PortSpec::Simulator => {
            let machine = chosen.file;
            let tasks = plan(&args, &machine)?;
            let _folder = open_results(&args, &machine)?;
            confirm(&args, &machine, &tasks)?;
            let rig = session::rig(&machine, None, args.port.baud, Vec::new())?;
            let line = SimLine::new(rig).unrecorded();
            let options = ClientOptions::default();
            let mut session = Session::new(line, &machine, options, interrupt::flag());
            session.connect(1)?;
            session.configure(&machine)?;
            measure(&args, &machine, &mut session, &tasks)
        }
        PortSpec::Serial(_) | PortSpec::Tcp(_) => {
            let connect = ConnectArgs {
                port: args.port.port.clone(),
                baud: args.port.baud,
                timeout: 5.0,
            };
            let mut session = open(&connect, &chosen.file)?;
            let machine = file_of(&chosen, &mut session)?;
            let tasks = plan(&args, &machine)?;
            let _folder = open_results(&args, &machine)?;
            confirm(&args, &machine, &tasks)?;
            measure(&args, &machine, &mut session, &tasks)
        }
    }
}

fn plan(args: &IdentifyArgs, machine: &MachineFile) -> Result<Tasks, CliError> {
    session::check_has_tool(machine)?;
    let unknown = |name: &&String| !machine.joints.iter().any(|axis| axis.name == **name);
    if let Some(name) = args.joints.iter().find(unknown) {
        let names: Vec<&str> = machine.joints.iter().map(|it| it.name.as_str()).collect();
        let what = format!("--joint {name}: the joints are {}", names.join(", "));
        return Err(CliError::new(Exit::Usage, what));
    }
    let is_chosen = |name: &str| args.joints.is_empty() || args.joints.iter().any(|it| it == name);
    if args.lost_motion {
        let (gauged, skipped) = lost_motion::plan(args, machine, &is_chosen)?;
        return Ok(Tasks {
            gauged,
            skipped,
            ..Tasks::default()
        });
    }
    if args.index {
        let (indexed, skipped) = index_pulses::plan(args, machine, &is_chosen)?;
        return Ok(Tasks {
            indexed,
            skipped,
            ..Tasks::default()
        });
    }
    let options_of_steps = StepOptions {
        travel: args.travel,
        beyond: args.beyond.unwrap_or(BEYOND),
    };
    let (mut steps, mut skipped) = step_joints(machine, &options_of_steps);
    skipped.retain(|it| is_chosen(&it.name));
    steps.retain(|it| is_chosen(&machine.joints[it.joint].name));
    for axis in machine.joints.iter().filter(|it| !is_chosen(&it.name)) {
        skipped.push(Skipped {
            name: axis.name.clone(),
            reason: "--joint names others".to_string(),
        });
    }
    let mut torque = Vec::new();
    if !torque_joints(machine).is_empty() {
        torque = lines(machine, &options(args))?;
        torque.retain(|line: &Travel| {
            let mut joints = line.joints.iter();
            joints.any(|joint| is_chosen(&machine.joints[*joint].name))
        });
    }
    if torque.is_empty() && steps.is_empty() {
        let reasons: Vec<String> = skipped
            .iter()
            .map(|it| format!("joint {}: {}", it.name, it.reason))
            .collect();
        let what = format!(
            "{}: no joint has a torque drive and an encoder, or a step drive, a home switch and no \
             encoder; nothing can be identified\n{}",
            machine.file,
            reasons.join("\n")
        );
        return Err(CliError::new(Exit::BadInput, what));
    }
    Ok(Tasks {
        lines: torque,
        steps,
        skipped,
        ..Tasks::default()
    })
}

/// Opens the folder of the results, and checks that the machine file can be replaced. The
/// measurement takes minutes, so its results must not be lost at its end.
fn open_results(args: &IdentifyArgs, machine: &MachineFile) -> Result<ResultFolder, CliError> {
    let folder = ResultFolder::open(&folder(args.out.as_ref(), machine))?;
    if let Some(path) = args.machine.machine.as_deref().filter(|_| !args.no_write) {
        output::check_writable(path)?;
    }
    Ok(folder)
}

/// Ranges of the pose coordinates on a line.
fn moved(machine: &MachineFile, line: &Travel) -> String {
    let units = Model::new(machine).pose_units();
    let ranges = Geometry::new(machine).ranges(line);
    let moved = ranges.into_iter().zip(&machine.pose).zip(units);
    let moved: Vec<String> = moved
        .filter(|(((low, high), _), _)| high - low > 0.01)
        .map(|(((low, high), axis), unit)| format!("{} {low:.1} to {high:.1} {unit}", axis.name))
        .collect();
    moved.join(", ")
}

/// Prints what will move, and asks.
fn confirm(args: &IdentifyArgs, machine: &MachineFile, tasks: &Tasks) -> Result<(), CliError> {
    let say = |what: String| say(args, &what);
    say("the machine homes, and then moves, one line after the other, in these ranges:".into());
    for line in &tasks.lines {
        let names: Vec<&str> = line
            .joints
            .iter()
            .map(|joint| machine.joints[*joint].name.as_str())
            .collect();
        let is_rotary = |joint: &usize| machine.joints[*joint].kind.is_rotary();
        let unit = if line.joints.iter().any(is_rotary) {
            "deg/s"
        } else {
            "mm/s"
        };
        say(format!(
            "  joint {}: {}, at up to {:.1} {unit}",
            names.join(", "),
            moved(machine, line),
            line.rate * args.rate
        ));
    }
    for step in &tasks.steps {
        let axis = &machine.joints[step.joint];
        let unit = if axis.kind.is_rotary() { "deg" } else { "mm" };
        let [[low, high], [gentle, max]] = [step.bounds.rate, step.bounds.acceleration];
        let lower = step.lower.map(|why| format!(" ({why})"));
        say(format!(
            "  joint {}: {}, at {low:.1} to {high:.1} {unit}/s and {gentle:.0} to {max:.0} \
             {unit}/s^2 until it loses steps{}",
            axis.name,
            moved(machine, &step.reach()),
            lower.unwrap_or_default()
        ));
    }
    for joint in &tasks.gauged {
        let line = haptimill_identify::lost_motion::line_of(machine, *joint)?;
        say(format!(
            "  joint {}: {}, by a dial gauge",
            machine.joints[*joint].name,
            moved(machine, &line)
        ));
    }
    for it in &tasks.indexed {
        say(index_pulses::range(machine, it)?);
    }
    if !tasks.steps.is_empty() {
        say(
            "the test for lost steps homes up to 60 times; a motor that stalls leaves the joint \
             anywhere in its range"
                .to_string(),
        );
    }
    for joint in &tasks.skipped {
        say(format!(
            "not measured: joint {}: {}",
            joint.name, joint.reason
        ));
    }
    if args.yes {
        return Ok(());
    }
    if !std::io::stdin().is_terminal() {
        let what = "standard input is no terminal to confirm the motion on; clear the ranges and \
            give --yes";
        return Err(CliError::new(Exit::Usage, what));
    }
    print!("Are they clear, and is the spindle off? Type yes: ");
    let _ = std::io::stdout().flush();
    let mut answer = String::new();
    let _ = std::io::stdin().lock().read_line(&mut answer);
    if answer.trim() == "yes" {
        return Ok(());
    }
    Err(CliError::new(Exit::Stopped, "not confirmed; nothing moved"))
}

/// Tests the step joints. The controller has higher limits meanwhile.
fn test_steps<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    joints: &[StepJoint],
) -> Result<Vec<StepLimits>, CliError> {
    let raised = SwitchTest::<L>::raised(machine, joints);
    if raised == *machine {
        let mut test = SwitchTest::new(session, machine, joints);
        return Ok(test.measure(&mut |what| say(args, what))?);
    }
    // Drives off: a controller takes no configuration otherwise.
    session.ask(Command::Disable)?;
    session.configure(&raised)?;
    let found = session.enable().and_then(|()| {
        SwitchTest::new(session, machine, joints).measure(&mut |what| say(args, what))
    });
    // Also after an error. A fault has switched the drives off, and then this is refused.
    let disabled = session.ask(Command::Disable);
    let restored = session.configure(machine);
    let found = found?;
    disabled?;
    restored.map_err(|error| {
        let what = format!(
            "{error}; the controller still has the limits of the test: any command with --machine \
             and --replace-machine gives it those of the machine file"
        );
        CliError::new(error.kind.into(), what)
    })?;
    session.enable()?;
    Ok(found)
}

fn move_and_measure<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    tasks: &Tasks,
) -> Result<Found, CliError> {
    let mut found = Found::default();
    if !tasks.steps.is_empty() {
        found.steps = test_steps(args, machine, session, &tasks.steps)?;
    }
    if !tasks.lines.is_empty() {
        let mut identification = Identification::new(session, machine, options(args))?;
        identification.home()?;
        for line in &tasks.lines {
            let joints = identification.measure(line, &mut |what| say(args, what))?;
            found.joints.extend(joints);
        }
    }
    found.joints.sort_by_key(|it| it.joint);
    Ok(found)
}

fn measure<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    tasks: &Tasks,
) -> Result<(), CliError> {
    if !tasks.gauged.is_empty() {
        return lost_motion::measure(args, machine, session, &tasks.gauged, &tasks.skipped);
    }
    if !tasks.indexed.is_empty() {
        return index_pulses::measure(args, machine, session, (&tasks.indexed, &tasks.skipped));
    }
    session.enable()?;
    let found = move_and_measure(args, machine, session, tasks);
    // Also after an error: nobody works at the machine now. A fault has switched the drives off.
    let disabled = session.ask(Command::Disable);
    let Found { joints, steps } = found?;
    disabled?;
    for joint in &joints {
        say(args, &page::summary(joint));
    }
    for joint in &steps {
        say(args, &joint.summary());
    }
    let date = record::today();
    let folder = folder(args.out.as_ref(), machine);
    let name = machine.config.name.as_str();
    // The measurement first: the machine file may refuse the new values.
    let data = folder.join("identified.toml");
    let record = record::write(name, &date, &joints, &steps, &tasks.skipped);
    save(&data, &record)?;
    let (text, changes) = edit::with_identified(machine, &joints, &steps, &date)?;
    let html = folder.join("identify.html");
    let shown = page::identification(name, &date, &joints, &steps, &tasks.skipped, &changes);
    save(&html, &shown)?;
    if !args.json {
        print_line!("data        {}", data.display());
        print_line!("page        {}", html.display());
    }
    let skipped = tasks.skipped.iter();
    let skipped = skipped.map(|it| json!({ "name": it.name, "reason": it.reason }));
    let value = json!({
        "machine": name,
        "date": date,
        "joints": joints.iter().map(joint_json).collect::<Vec<_>>(),
        "step_joints": steps.iter().map(step_json).collect::<Vec<_>>(),
        "not_measured": skipped.collect::<Vec<_>>(),
        "data": data,
        "page": html,
    });
    finish(args, machine, value, (&text, &changes), &date)
}

/// A torque joint as JSON; units are those of `identified.toml`.
fn joint_json(joint: &Identified) -> Value {
    let [forward, backward] = joint.friction.coulomb;
    json!({
        "name": joint.name,
        "inertia": joint.plant.inertia,
        "coulomb_forward": forward,
        "coulomb_backward": backward,
        "viscous": joint.friction.viscous,
        "mode_hz": joint.resonance.is_ok().then_some(joint.plant.mode_hz),
        "no_resonance_below_hz": joint.resonance.err(),
        "fit_error": joint.error,
    })
}

/// A step joint as JSON; mm or degrees, seconds.
fn step_json(joint: &StepLimits) -> Value {
    let limit = |highest: Option<Highest>| match highest {
        Some(Highest::NoLossUpTo(kept)) => json!({ "no_loss_up_to": kept }),
        Some(Highest::Between(kept, lost)) => json!({ "without_loss": kept, "with_loss": lost }),
        Some(Highest::AllLost(lost)) => json!({ "with_loss": lost }),
        None => Value::Null,
    };
    let [rate, acceleration] = joint.proposed().map(|it| it.map(rounded));
    json!({
        "name": joint.name,
        "rate": limit(joint.rate()),
        "acceleration": limit(joint.acceleration()),
        "acceleration_at_rate": joint.working_rate(),
        "resonances": joint.resonances(),
        "proposed_rate": rate,
        "proposed_acceleration": acceleration,
    })
}
