//! `haptimill identify --lost-motion`: lost motion of the joints, by a dial gauge.

use super::identify_args::{IdentifyArgs, finish, folder, save, say};
use super::{CliError, Exit};
use haptimill_client::port::PortSpec;
use haptimill_client::session::{self, Line, Session};
use haptimill_client::{Error, ErrorKind};
use haptimill_identify::lost_motion::{self, LostMotion, READINGS};
use haptimill_identify::switch_test::Skipped;
use haptimill_identify::{edit, record};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;
use serde_json::{Value, json};
use std::io::{BufRead as _, Write as _};
use std::sync::mpsc::{TryRecvError, channel};

/// The joints that are measured, and the others with their reasons.
///
/// # Errors
/// No joint can be measured, or the readings of the command line are too many or too few.
pub(super) fn plan(
    args: &IdentifyArgs,
    machine: &MachineFile,
    is_chosen: &dyn Fn(&str) -> bool,
) -> Result<(Vec<usize>, Vec<Skipped>), CliError> {
    let (mut joints, mut skipped) = (Vec::new(), Vec::new());
    for (index, axis) in machine.joints.iter().enumerate() {
        if !is_chosen(&axis.name) {
            continue;
        }
        match lost_motion::line_of(machine, index) {
            Ok(_) => joints.push(index),
            Err(error) => {
                let named = format!("joint {}: ", axis.name);
                let reason = error.message.strip_prefix(&named);
                skipped.push(Skipped {
                    name: axis.name.clone(),
                    reason: reason.unwrap_or(&error.message).to_string(),
                });
            }
        }
    }
    if joints.is_empty() {
        let reasons = skipped.iter();
        let reasons: Vec<String> = reasons
            .map(|it| format!("joint {}: {}", it.name, it.reason))
            .collect();
        return Err(CliError::new(Exit::BadInput, reasons.join("\n")));
    }
    let (given, needed) = (args.readings.len(), READINGS * joints.len());
    if given > 0 && given != needed {
        let names: Vec<&str> = joints
            .iter()
            .map(|joint| machine.joints[*joint].name.as_str())
            .collect();
        let what = format!(
            "--reading: {given} readings, and {needed} are needed: {READINGS} for each joint \
             ({}), in turn from below and from above",
            names.join(", ")
        );
        return Err(CliError::new(Exit::Usage, what));
    }
    Ok((joints, skipped))
}

/// Asks for a reading. The session goes on meanwhile.
fn ask<L: Line>(session: &mut Session<L>, what: &str) -> Result<f64, Error> {
    loop {
        // Standard output may be JSON.
        eprint!("{what}; reading of the gauge: ");
        let _ = std::io::stderr().flush();
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            let mut line = String::new();
            let read = std::io::stdin().lock().read_line(&mut line);
            let _ = sender.send(read.map(|length| (length, line)));
        });
        let read = loop {
            match receiver.try_recv() {
                Ok(read) => break read.ok(),
                Err(TryRecvError::Disconnected) => break None,
                Err(TryRecvError::Empty) if session.is_interrupted() => {
                    return Err(Error::new(ErrorKind::Stopped, "stopped by the user"));
                }
                Err(TryRecvError::Empty) => session.step()?,
            }
        };
        let Some((1.., line)) = read else {
            let what = "standard input ended before the last reading";
            return Err(Error::new(ErrorKind::Usage, what));
        };
        match line.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => return Ok(value),
            _ => eprintln!("{}: write a number, as 1.234", line.trim()),
        }
    }
}

fn measure_all<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    joints: &[usize],
) -> Result<Vec<LostMotion>, CliError> {
    let home = session::find_home_pose(machine, session.model())?;
    session.go_home(machine, &home)?;
    let mut given = args.readings.iter().copied();
    let is_simulated = args.port.port == PortSpec::Simulator;
    let mut found = Vec::new();
    for joint in joints {
        let mut gauge = |session: &mut Session<L>, what: &str| {
            if let Some(reading) = given.next() {
                return Ok(reading);
            }
            match session.line().truth() {
                Some(truth) if is_simulated => Ok(truth.joints[*joint]),
                _ => ask(session, what),
            }
        };
        found.push(lost_motion::measure(session, machine, *joint, &mut gauge)?);
    }
    Ok(found)
}

/// Measures the joints.
pub(super) fn measure<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    joints: &[usize],
    skipped: &[Skipped],
) -> Result<(), CliError> {
    session.enable()?;
    let found = measure_all(args, machine, session, joints);
    // Also after an error. A fault has switched the drives off.
    let disabled = session.ask(Command::Disable);
    let found = found?;
    disabled?;
    for joint in &found {
        say(args, &joint.summary());
    }
    let date = record::today();
    let name = machine.config.name.as_str();
    let data = folder(args.out.as_ref(), machine).join("lost-motion.toml");
    save(&data, &record::write_lost_motion(name, &date, &found))?;
    let (text, changes) = edit::with_lost_motion(machine, &found, &date)?;
    if !args.json {
        print_line!("data        {}", data.display());
    }
    let joint_json = |it: &LostMotion| -> Value {
        json!({
            "name": it.name,
            "lost_motion": it.value(),
            "before": it.before,
            "spread": it.spread(),
            "times": it.rests.len(),
        })
    };
    let skipped = skipped.iter();
    let skipped = skipped.map(|it| json!({ "name": it.name, "reason": it.reason }));
    let value = json!({
        "machine": name,
        "date": date,
        "lost_motions": found.iter().map(joint_json).collect::<Vec<_>>(),
        "not_measured": skipped.collect::<Vec<_>>(),
        "data": data,
    });
    finish(args, machine, value, (&text, &changes), &date)
}
