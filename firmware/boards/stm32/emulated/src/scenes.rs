//! Runs of the board with a simulated mill at its pins, and their checks.

use crate::wired::{ALARM, Finished, HOME, Stm32};
use crate::{ENABLE, STEPS, require};
use haptimill_client::client::Options;
use haptimill_client::session::pins::record::{JOINTS, Period};
use haptimill_client::session::{Homing, NoObserver, Session, find_home_pose};
use haptimill_firmware::config::Drive;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveCommand, Outputs, StepSegment};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::{Command, State};
use haptimill_pulses::{AxisSignals, Capture, Clock, Planned, Rules, Signal, check, pulses};
use std::sync::Arc;

/// Ticks of the step clock in a microsecond, and in a slot of the step lines.
const TICKS_PER_US: u32 = 84;
const SLOT_TICKS: i64 = 42;
/// Femtoseconds in a nanosecond.
const FS: i64 = 1_000_000;

const MILL: &str = include_str!("../../../../../host/emulator/tests/mill3-short.toml");
const PROGRAM: &str = include_str!("../../../../../host/emulator/tests/short.ngc");

/// The mill with the step clock of this board.
fn mill() -> Result<MachineFile, String> {
    let text = MILL.replace("ticks_per_us = 75", "ticks_per_us = 84");
    MachineFile::parse("mill3-short.toml", &text).map_err(|error| error.to_string())
}

type Host = Session<Stm32>;

fn text<E: ToString>(error: E) -> String {
    error.to_string()
}

/// A session with a board whose drives are enabled.
fn enabled(image: &str, machine: &MachineFile) -> Result<Host, String> {
    let board = Stm32::start(image, machine)?;
    let mut session = Session::new(board, machine, Options::default(), Arc::default());
    session.connect(1).map_err(text)?;
    session.configure(machine).map_err(text)?;
    session.enable().map_err(text)?;
    Ok(session)
}

fn steps(session: &mut Host, periods: usize) -> Result<(), String> {
    for _ in 0..periods {
        session.step().map_err(text)?;
    }
    Ok(())
}

/// All scenes.
pub const ALL: [&str; 2] = ["program", "inputs"];

/// Runs scenes.
pub fn run(image: &str, names: &[&str]) -> Result<(), String> {
    let machine = mill()?;
    for name in names {
        match *name {
            "program" => part_program(image, &machine)?,
            "inputs" => inputs(image, &machine)?,
            _ => {
                return Err(format!(
                    "there is no scene '{name}', only {}",
                    ALL.join(", ")
                ));
            }
        }
    }
    Ok(())
}

/// Homing, then a part program; every edge is compared.
fn part_program(image: &str, machine: &MachineFile) -> Result<(), String> {
    let mut session = enabled(image, machine)?;
    let model = session.model().clone();
    let home = find_home_pose(machine, &model).map_err(text)?;
    session.go_home(machine, &home).map_err(text)?;
    let options = program_options(machine, model.to_engineering_units(&home));
    let program = haptimill_gcode::read("short.ngc", PROGRAM.as_bytes(), &options).map_err(text)?;
    let plan = Plan::new(&program, &settings(machine), &model)
        .map_err(|refused| format!("{:?}", refused.problems))?;
    let end = session
        .run_job(2, home, plan.setpoints, &mut NoObserver)
        .map_err(text)?;
    session.check_completed(&end).map_err(text)?;
    // The pulses of the last control periods leave.
    steps(&mut session, 20)?;
    let pins = session.line_mut().steps;
    let (periods, finished) = session.into_line().finish()?;
    for gap in &finished.gaps {
        println!("{gap}");
    }
    println!("homing and a part program:");
    require(finished.resets == 0, "no reset")?;
    commands_are_native(&periods, machine)?;
    let counted: Vec<i64> = match periods.last() {
        Some(last) => {
            let joints = last.inputs.joints[..JOINTS].iter();
            joints.map(|joint| joint.steps.into()).collect()
        }
        None => Vec::new(),
    };
    require(
        counted == pins,
        &format!("the board counts the steps of its pins, {pins:?}"),
    )?;
    compare(&periods, &finished, machine)
}

/// The commands have the bits of a controller in this process that is given the same inputs.
fn commands_are_native(periods: &[Period], machine: &MachineFile) -> Result<(), String> {
    let mut controller = Controller::new(machine.config.period_us);
    let mut outputs = Outputs::default();
    let (mut next, mut missed, mut missed_enabled) = (None, 0, 0);
    let mut on = false;
    for period in periods {
        let number = period.inputs.period;
        let skipped = u64::from(period.inputs.missed);
        if next.is_some_and(|next| next + skipped != number) {
            return Err(format!("control period {number} is not the next one"));
        }
        next = Some(number + 1);
        if on {
            missed_enabled += skipped;
        } else {
            missed += skipped;
        }
        outputs.transmit.clear();
        controller.tick(&period.inputs, &mut outputs, &mut ());
        if outputs.joints[..JOINTS] != period.commands {
            return Err(format!(
                "control period {number}: the board commands {:?}, the controller in this process {:?}",
                period.commands,
                &outputs.joints[..JOINTS]
            ));
        }
        on = period.commands.iter().any(|it| *it != DriveCommand::Off);
    }
    let what = format!(
        "{} control periods with the commands of the controller in this process; {missed_enabled} \
         missed with the drives on, {missed} with the drives off",
        periods.len()
    );
    require(missed_enabled == 0, &what)
}

/// The pulses of a segment, each in the slot of its time.
fn slots(segment: StepSegment, period: u64) -> Vec<Planned> {
    // In period 0, so that the ticks are those from the start of the period.
    let clock = Clock {
        ticks_per_us: TICKS_PER_US,
        period_us: 1,
    };
    let planned = Planned { period: 0, segment };
    let pulses = pulses(&[planned], clock);
    pulses
        .iter()
        .map(|pulse| Planned {
            period,
            segment: StepSegment {
                count: segment.count.signum(),
                delay: (pulse.tick / SLOT_TICKS * SLOT_TICKS) as u32,
                ..StepSegment::default()
            },
        })
        .collect()
}

/// Lines of a port as a signal.
fn signal(edges: &[(u64, bool)]) -> Signal {
    Signal {
        changes: edges.iter().map(|edge| edge.0 as i64 * FS).collect(),
        ..Signal::default()
    }
}

/// Every edge of the step and direction lines against the commands: the start of the slot in which
/// its commanded time lies, with one constant offset and no other difference.
fn compare(periods: &[Period], finished: &Finished, machine: &MachineFile) -> Result<(), String> {
    let model = Model::new(machine);
    let names = model.joint_names();
    let port = &finished.wired.port_e;
    let lines: Vec<(Signal, Signal)> = STEPS
        .iter()
        .map(|(step, direction)| (signal(&port.edges(*step)), signal(&port.edges(*direction))))
        .collect();
    let planned: Vec<Vec<Planned>> = (0..names.len())
        .map(|joint| {
            let pairs = periods.iter().zip(periods.iter().skip(1));
            pairs
                .flat_map(|(period, next)| match period.commands[joint] {
                    DriveCommand::Steps(segment) => slots(segment, next.inputs.period),
                    _ => Vec::new(),
                })
                .collect()
        })
        .collect();
    let axes: Vec<AxisSignals<'_>> = names
        .iter()
        .enumerate()
        .map(|(joint, name)| AxisSignals {
            name,
            step: &lines[joint].0,
            direction: &lines[joint].1,
            planned: Some(&planned[joint]),
        })
        .collect();
    let capture = Capture {
        resolution: FS,
        start: 0,
        end: finished.end as i64 * FS,
        signals: Vec::new(),
    };
    let enable = signal(&finished.wired.port_b.edges(ENABLE));
    let report = check(&capture, &axes, Some(&enable), &rules(machine)?);
    let mut compared = 0;
    for axis in &report.axes {
        println!("{axis}");
        compared += axis.compared;
        require(axis.compared == 2 * axis.pulses, "all edges were compared")?;
        require(axis.commanded == Some(axis.count), "the count is exact")?;
    }
    let what = format!("{compared} edges in the slots of their commanded times");
    require(report.fault_count() == 0 && compared > 10_000, &what)
}

/// Rules of the drives.
fn rules(machine: &MachineFile) -> Result<Rules, String> {
    let clock = Clock {
        ticks_per_us: TICKS_PER_US,
        period_us: u32::from(machine.config.period_us),
    };
    let Some(Drive::Steps {
        pulse, setup, hold, ..
    }) = machine.config.joints.first().map(|joint| &joint.drive)
    else {
        return Err("the first joint has no step drive".to_string());
    };
    let time = |ticks: u16| clock.femtoseconds(i64::from(ticks));
    Ok(Rules {
        clock,
        tolerance: 0,
        width: time(*pulse),
        pause: time(*pulse),
        setup: time(*setup),
        hold: time(*hold),
        exact_width: Some(u32::from(*pulse)),
    })
}

/// Switches and the alarm chatter, then the alarm stays; the emergency stop opens.
fn inputs(image: &str, machine: &MachineFile) -> Result<(), String> {
    println!("inputs in a homing:");
    let mut session = enabled(image, machine)?;
    let before = session
        .line_mut()
        .periods
        .last()
        .map_or(0, |it| it.glitches);
    let first = session.line_mut().periods.len();
    let mut noisy = HOME[..3].to_vec();
    noisy.push(ALARM);
    session.line_mut().set_noise(&noisy);
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300)?;
    session.line_mut().set_noise(&[]);
    steps(&mut session, 5)?;
    let board = session.line_mut();
    let unseen = board.periods[first..].iter().all(|period| {
        let joints = &period.inputs.joints[..3];
        joints.iter().all(|joint| !joint.home && joint.drive_ready)
    });
    require(unseen, "switches and an alarm that chatter are not seen")?;
    let counted = board.periods.last().map_or(0, |it| it.glitches) - before;
    let what = format!("{counted} changes of four inputs in 300 periods were suppressed");
    require((500..=620).contains(&counted), &what)?;
    require(board.steps != [0; JOINTS], "the joint moves meanwhile")?;
    board.activate(&[ALARM]);
    steps(&mut session, 10)?;
    require(
        !session.line_mut().enabled,
        "an alarm that stays switches the drives off",
    )?;
    let status = session.status().map_err(text)?;
    require(status.state == State::Fault, "the state is a fault")?;
    session.line_mut().activate(&[]);
    steps(&mut session, 10)?;
    session.ask(Command::Reset).map_err(text)?;
    session.enable().map_err(text)?;
    require(
        session.line_mut().enabled,
        "after a reset the drives can be enabled",
    )?;
    let (periods, finished) = session.into_line().finish()?;
    require(finished.resets == 0, "no reset of the chip")?;
    commands_are_native(&periods, machine)
}
