//! Part programs that ask the machine: probe moves (G38) and waits for inputs (M66).
//!
//! The program was checked as a whole, with probe moves to their programmed ends. It runs in parts:
//! the steps up to a probe move or a wait are one job, and the interpreter goes on with what the
//! machine reported.

use super::args::RunArgs;
use super::job::Job;
use super::lost_steps::StepJoints;
use super::operator::Operator;
use super::progress::ProgressDisplay;
use super::spool::Bytes;
use super::supply::Supply;
use crate::commands::probing::{Touch, find_input, probe_along, wait_for_input, wrong_start};
use crate::commands::program::{PartProgram, Pause, Planned};
use crate::commands::{CliError, Exit};
use haptimill_client::session::{JobLine, Session};
use haptimill_client::{Error, ErrorKind};
use haptimill_gcode::{
    Interpreter, Move, Place, ProbeKind, Problem, Program, Refused, Step, file_name,
};
use haptimill_machine_file::MachineFile;
use haptimill_planner::Plan;
use haptimill_protocol::message::{AxisValues, Telemetry};
use std::collections::BTreeMap;

/// What a program asks the machine.
#[derive(Debug, Default)]
pub(super) struct Questions {
    /// The first probe move: its place and word.
    probe: Option<(Place, &'static str)>,
    /// Places of the first waits for the inputs: their numbers, and whether they are analog.
    inputs: BTreeMap<(u16, bool), Place>,
    /// The first pause.
    pub(super) pause: Option<Step>,
}

impl Questions {
    /// Notes what a step asks.
    pub(super) fn note(&mut self, step: &Step) {
        let place = step.place();
        match step {
            Step::Probe {
                kind, must_change, ..
            } => {
                let word = match (kind, must_change) {
                    (ProbeKind::Towards, true) => "G38.2",
                    (ProbeKind::Towards, false) => "G38.3",
                    (ProbeKind::Away, true) => "G38.4",
                    (ProbeKind::Away, false) => "G38.5",
                };
                self.probe.get_or_insert((place, word));
            }
            Step::Wait {
                number, analogue, ..
            } => {
                self.inputs.entry((*number, *analogue)).or_insert(place);
            }
            Step::Pause { .. } | Step::ToolChange { .. } => {
                self.pause.get_or_insert_with(|| step.clone());
            }
            _ => {}
        }
    }

    /// Whether the program asks anything.
    pub(super) fn has_any(&self) -> bool {
        self.probe.is_some() || !self.inputs.is_empty()
    }
}

/// Checks that the machine has the probe and the inputs of a program.
///
/// # Errors
/// [`Exit::Refused`], with the place in the program.
pub(super) fn check_inputs(
    machine: &MachineFile,
    program: &PartProgram,
    questions: &Questions,
    called: &[String],
) -> Result<(), CliError> {
    let refused = |place: Place, what: &str| {
        let Place { file, line, column } = place;
        let main = program.file_name();
        let name = file_name(&main, called, file);
        CliError::new(Exit::Refused, format!("{name}:{line}:{column}: {what}"))
    };
    if let Some((place, word)) = questions.probe {
        find_input(machine, None, Touch::Probe)
            .map_err(|error| refused(place, &format!("{word}: {}", error.message)))?;
    }
    for ((number, analog), place) in &questions.inputs {
        let (count, kind) = if *analog {
            (machine.io.analog_inputs.len(), "analog_input")
        } else {
            (machine.io.inputs.len(), "input")
        };
        if usize::from(*number) >= count {
            let what = format!(
                "M66 waits for input {number}, and the machine has {count}, counted from 0; name \
                 it in a section [[{kind}]] of the machine file"
            );
            return Err(refused(*place, &what));
        }
    }
    Ok(())
}

/// Checks that the options suit a program that runs in parts.
///
/// # Errors
/// [`Exit::Usage`].
pub(super) fn check_options(
    args: &RunArgs,
    program: &PartProgram,
    questions: &Questions,
    called: &[String],
) -> Result<(), CliError> {
    let usage = |what: String| Err(CliError::new(Exit::Usage, what));
    if !args.changes.is_none() {
        return usage(format!(
            "{}: a program with probe moves or M66 runs as a whole; leave out --from-line, --dry \
             and --single",
            program.file_name()
        ));
    }
    questions.check_pauses(args, program, called)
}

impl Questions {
    /// Refuses a program with pauses where nobody can end them.
    ///
    /// # Errors
    /// [`Exit::Usage`].
    pub(super) fn check_pauses(
        &self,
        args: &RunArgs,
        program: &PartProgram,
        called: &[String],
    ) -> Result<(), CliError> {
        let pause = self.pause.as_ref();
        match pause.and_then(|step| Pause::of(step, called, None)) {
            Some(pause) if !args.skips_pauses() => program.check_pause(&pause),
            _ => Ok(()),
        }
    }
}

/// Steps of the next job, and what the jobs before left on.
#[derive(Default)]
struct Part {
    /// Time of the spindle from standstill to its speed, seconds.
    run_up_s: f64,
    steps: Vec<Step>,
    spindle: Option<Step>,
    coolant: Option<Step>,
}

impl Part {
    fn push(&mut self, step: Step) {
        self.steps.push(step);
    }

    /// Takes the steps. A job ends with spindle and coolant off: they are switched on again. The
    /// controller does not report the speed of the spindle, so that the first motion waits for the
    /// run-up time of the machine file.
    fn take(&mut self) -> Vec<Step> {
        let own = std::mem::take(&mut self.steps);
        if own.is_empty() {
            return own;
        }
        // A part that sets the spindle before it moves needs no other start of it.
        let first = own.iter().find_map(|step| match step {
            Step::Spindle { .. } => Some(false),
            Step::Move(_) | Step::Dwell { .. } => Some(true),
            _ => None,
        });
        let mut steps: Vec<Step> = self.coolant.iter().cloned().collect();
        if first == Some(true)
            && let Some(spindle) = &self.spindle
        {
            steps.push(spindle.clone());
            steps.push(Step::Dwell {
                place: spindle.place(),
                seconds: self.run_up_s,
            });
        }
        for step in &own {
            match step {
                Step::Spindle { rpm, .. } => {
                    self.spindle = (*rpm != 0).then(|| step.clone());
                }
                Step::Coolant { mist, flood, .. } => {
                    self.coolant = (*mist || *flood).then(|| step.clone());
                }
                Step::ToolChange { .. } => self.spindle = None,
                _ => {}
            }
        }
        steps.extend(own);
        steps
    }
}

impl Job<'_> {
    /// Runs a program that asks the machine.
    pub(super) fn run_in_parts<L: JobLine>(
        &self,
        session: &mut Session<L>,
        bytes: Bytes,
        start: &AxisValues,
        operator: &mut Operator,
    ) -> Result<(), CliError> {
        self.args
            .print_message("running in parts: the program reads inputs; nothing is recorded");
        let step_joints = StepJoints::of(session, self.machine)?;
        let options = self.program.options(self.machine, session.model(), start)?;
        let mut interpreter = Interpreter::new(bytes, &options);
        interpreter.keep_comments();
        let mut part = Part {
            run_up_s: self.machine.spindle.run_up_s,
            ..Part::default()
        };
        while let Some(step) = interpreter.next() {
            let step = step.map_err(|problem| {
                let kind = ErrorKind::BadInput;
                self.program.refuse(kind, problem, interpreter.called())
            })?;
            match step {
                Step::Message { text, .. } => self.args.print_program_message(&text),
                Step::Probe {
                    step,
                    kind,
                    must_change,
                } => {
                    self.run_part(session, part.take(), &mut interpreter, operator)?;
                    self.probe(session, &mut interpreter, step, kind, must_change)?;
                }
                Step::Wait {
                    number,
                    analogue,
                    until,
                    seconds,
                    ..
                } => {
                    self.run_part(session, part.take(), &mut interpreter, operator)?;
                    let input = (usize::from(number), analogue);
                    let value = wait_for_input(session, self.machine, input, until, seconds)?;
                    interpreter.report_input(value);
                }
                step => part.push(step),
            }
        }
        self.run_part(session, part.take(), &mut interpreter, operator)?;
        if let Some(lost) = step_joints.lost(session, self.machine)? {
            return Err(CliError::new(Exit::Fault, lost));
        }
        if self.args.json && !self.args.silent {
            let result = serde_json::json!({ "program": self.program.name, "completed": true });
            print_line!("{result:#}");
        }
        self.args
            .print_message(&format!("{}: done", self.program.file_name()));
        Ok(())
    }

    fn plan_part<L: JobLine>(
        &self,
        session: &mut Session<L>,
        steps: Vec<Step>,
        interpreter: &mut Interpreter<'_>,
    ) -> Result<(Planned, Telemetry), CliError> {
        let status = session.status()?;
        let from = steps.iter().find_map(|step| match step {
            Step::Move(step) => Some(step.tool.machine_pose(&step.path.from)),
            _ => None,
        });
        let model = session.model();
        let program = Program {
            file: self.program.file_name(),
            called: interpreter.called().to_vec(),
            start: from.unwrap_or_else(|| model.to_engineering_units(&status.commanded)),
            steps,
            main_lines: Vec::new(),
            comments: interpreter.take_comments(),
            notices: Vec::new(),
            lines: interpreter.lines(),
        };
        let plan = Plan::new(&program, &self.program.settings(self.machine), model)
            .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))?;
        let planned = Planned {
            pauses: self.program.pauses_of(&plan, &program),
            plan,
            approach: None,
            notices: Vec::new(),
        };
        Ok((planned, status))
    }

    fn run_part<L: JobLine>(
        &self,
        session: &mut Session<L>,
        steps: Vec<Step>,
        interpreter: &mut Interpreter<'_>,
        operator: &mut Operator,
    ) -> Result<(), CliError> {
        if steps.is_empty() {
            return Ok(());
        }
        let (planned, status) = self.plan_part(session, steps, interpreter)?;
        let supply = Supply::of(planned, self.args, self.machine);
        let mut progress = ProgressDisplay::new(self.args, self.machine, &supply.shown, operator);
        let end = session.run_job(2, status.commanded, supply.setpoints, &mut progress);
        progress.finish(false);
        Ok(session.check_completed(&end?)?)
    }

    /// Runs a probe move and reports its end to the interpreter.
    fn probe<L: JobLine>(
        &self,
        session: &mut Session<L>,
        interpreter: &mut Interpreter<'_>,
        step: Move,
        kind: ProbeKind,
        must_change: bool,
    ) -> Result<(), CliError> {
        let input = find_input(self.machine, None, Touch::Probe)?;
        let place = step.place;
        let (planned, status) = self.plan_part(session, vec![Step::Move(step)], interpreter)?;
        let away = kind == ProbeKind::Away;
        if let Some((what, remedy)) = wrong_start(self.machine, &status, input, away) {
            return Err(self.stopped(place, what, remedy, interpreter.called()));
        }
        let contact = probe_along(session, planned.plan, input, away)?;
        let status = session.status()?;
        let model = session.model();
        // The machine stops behind the contact; the probed position is the contact.
        let stopped = model.to_engineering_units(&status.commanded);
        let at = contact.as_ref().map_or(&status.commanded, |it| &it.pose);
        interpreter.report_probe(&model.to_engineering_units(at), contact.is_some());
        interpreter.place_at(&stopped);
        if contact.is_some() || !must_change {
            return Ok(());
        }
        let name = &self.machine.io.inputs[usize::from(input)];
        Err(self.stopped(
            place,
            format!("the probe move ended without a change of {name}"),
            "check the probe and the end of the move, or write G38.3 or G38.5",
            interpreter.called(),
        ))
    }

    fn stopped(&self, place: Place, what: String, remedy: &str, called: &[String]) -> CliError {
        let refused = Refused {
            file: self.program.file_name(),
            called: called.to_vec(),
            problems: vec![Problem {
                place,
                what,
                remedy: remedy.into(),
            }],
            more: 0,
        };
        CliError::new(Exit::Command, refused.to_string())
    }
}
