//! `haptimill mdi`: blocks of the part-program language, entered one after another.

use super::args::{BoardArg, ConnectArgs};
use super::board::file_of;
use super::operator_input::Input;
use super::probing::{Touch, find_input, probe_along, wait_for_input, wrong_start};
use super::program::{LanguageArgs, slowed};
use super::run::job::refuse_latched_fault;
use super::simple::{open, print_status};
use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::session::{JobObserver, PortLine, Session, check_has_tool};
use haptimill_client::{Error, ErrorKind};
use haptimill_gcode::{Dialog, Options, ProbeKind, Problem, Program, Refused, Step};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{program_options, settings};
use haptimill_machine_file::work_data::WorkData;
use haptimill_planner::Plan;
use haptimill_protocol::message::Telemetry;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

const LONG: &str = "\
Run blocks of the part-program language (MDI).

Each BLOCK is a line of a part program: `haptimill mdi \"G0 X10\" \"G1 Y5 F300\"`. Without BLOCK the \
command reads blocks from a prompt with history, or from standard input, until Ctrl-D. The modes \
(G91, G20, F, G54 ...), parameters and offsets stay in force from block to block; each command \
begins with those of a program. The machine must be homed.

Offsets that G10, G28.1 and G30.1 change are written beside the machine file given with --machine. \
Spindle and coolant stop at the end of each block: write M3 S... in the block that cuts. Ctrl-C \
stops the machine along its path; at the prompt it clears the line. A block with a mistake changes \
nothing, and nothing moves.";

/// Name of the blocks in messages.
const NAME: &str = "mdi";

/// The host's number of the jobs.
const MDI_JOB: u32 = 3;

/// Arguments of `haptimill mdi`.
#[derive(Debug, Clone, Args)]
#[command(about = "Run blocks of the part-program language", long_about = LONG)]
pub struct MdiArgs {
    /// Blocks, each a line of a part program [default: those of a prompt, or of standard input]
    #[arg(value_name = "BLOCK")]
    pub blocks: Vec<String>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub language: LanguageArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub connect: ConnectArgs,
    /// Print the status after the last block as JSON; only with BLOCK
    #[arg(long, requires = "blocks")]
    pub json: bool,
}

/// Runs blocks.
///
/// # Errors
/// See [`Exit`]. With BLOCK the first block that cannot be run ends the command.
pub fn run(args: MdiArgs) -> Result<(), CliError> {
    let chosen = args.machine.load()?;
    let mut session = open(&args.connect, &chosen.file)?;
    let machine = file_of(&chosen, &mut session)?;
    check_has_tool(&machine)?;
    require_homed(&refuse_latched_fault(&mut session)?)?;
    let data = WorkData::beside(&machine).map_err(|error| CliError::new(Exit::BadInput, error))?;
    // Rotors move when their drives are switched on, so the blocks are checked before.
    let mut checked = Mdi::new(session, machine, args.language, data)?;
    checked.check(&args.blocks)?;
    let Mdi {
        mut session,
        machine,
        data,
        ..
    } = checked;
    session.enable()?;
    require_homed(&session.status()?)?;
    let mut mdi = Mdi::new(session, machine, args.language, data)?;
    if args.blocks.is_empty() {
        return mdi.prompt();
    }
    let mut input = Input::terminal();
    for block in &args.blocks {
        mdi.run_block(block, &mut input)?;
    }
    print_status(&mut mdi.session, args.json)
}

/// Refuses a machine whose position is unknown.
fn require_homed(status: &Telemetry) -> Result<(), CliError> {
    if status.homed {
        return Ok(());
    }
    let what = "mdi: the machine is not homed; `haptimill home` homes it";
    Err(CliError::new(Exit::Command, what))
}

/// The state of the command.
struct Mdi {
    session: Session<PortLine>,
    machine: MachineFile,
    dialog: Dialog,
    /// Offsets and tools as they are on disk.
    data: WorkData,
    /// The machine file, if the offsets are kept beside it.
    file: Option<PathBuf>,
}

impl Mdi {
    fn new(
        mut session: Session<PortLine>,
        machine: MachineFile,
        language: LanguageArgs,
        data: WorkData,
    ) -> Result<Self, CliError> {
        let status = session.status()?;
        let here = session.model().to_engineering_units(&status.commanded);
        let options = Options {
            optional_stop: language.optional_stop,
            block_delete: language.block_delete,
            no_decimal: language.no_decimal,
            strict: language.strict,
            offsets: data.offsets,
            tools: data.tools.clone(),
            ..program_options(&machine, here)
        };
        let file = Some(PathBuf::from(&machine.file)).filter(|path| path.is_file());
        Ok(Self {
            dialog: Dialog::new(&options),
            session,
            machine,
            data,
            file,
        })
    }

    /// Interprets and plans blocks from the present pose; nothing moves. Blocks behind the first
    /// one that asks the machine depend on its answer, and are checked when they run.
    fn check(&mut self, blocks: &[String]) -> Result<(), CliError> {
        let mut status = self.session.status()?;
        if status.state.has_drives_off() {
            // The drives start where the machine is.
            status.commanded = status.measured.clone();
        }
        let here = self.session.model().to_engineering_units(&status.commanded);
        self.dialog.place_at(&here);
        let mut steps = Vec::new();
        'blocks: for block in blocks {
            self.dialog.enter(block);
            loop {
                let step = self.dialog.next_step();
                match step.map_err(|problem| self.refused(problem, ErrorKind::BadInput))? {
                    Some(Step::Probe { .. } | Step::Wait { .. }) => break 'blocks,
                    Some(Step::Message { .. }) => {}
                    Some(step) => steps.push(step),
                    None => break,
                }
            }
        }
        if !steps.is_empty() {
            self.plan(steps, &status)?;
        }
        Ok(())
    }

    /// Reads and runs blocks until the end of the input.
    fn prompt(&mut self) -> Result<(), CliError> {
        let mut input = Input::prompt();
        let interrupted = interrupt::flag();
        let mut failed = None;
        self.print_place()?;
        while let Some(line) = input.line(&mut self.session, "mdi> ")? {
            if line.trim().is_empty() {
                continue;
            }
            match self.run_block(&line, &mut input) {
                Ok(()) => self.print_place()?,
                // The operator continues; a script must not go on behind a block that failed.
                Err(error) if input.is_terminal() && error.exit != Exit::Port => {
                    eprintln!("{}", error.message);
                    interrupted.store(false, Ordering::Relaxed);
                }
                Err(error) => {
                    failed = Some(error);
                    break;
                }
            }
        }
        failed.map_or(Ok(()), Err)
    }

    /// Prints the position in the coordinates of the blocks, and the modes.
    fn print_place(&mut self) -> Result<(), CliError> {
        let status = self.session.status()?;
        let model = self.session.model();
        let at = model.to_engineering_units(&status.commanded);
        let values = self.dialog.in_program(&at);
        let described = self.machine.config.model.descriptor().pose;
        let text: String = described
            .iter()
            .zip(values)
            .map(|(axis, value)| format!("{}{value:.4} ", axis.letter))
            .collect();
        print_line!("{text} {}", self.dialog.modes());
        Ok(())
    }

    /// Interprets, plans and runs a block.
    fn run_block(&mut self, block: &str, input: &mut Input) -> Result<(), CliError> {
        let status = self.session.status()?;
        self.dialog
            .place_at(&self.session.model().to_engineering_units(&status.commanded));
        self.dialog.enter(block);
        let mut steps = Vec::new();
        loop {
            let step = self.dialog.next_step();
            let step = step.map_err(|problem| self.refused(problem, ErrorKind::BadInput))?;
            if steps.is_empty() && step.is_none() {
                break;
            }
            match step {
                Some(Step::Message { text, .. }) => print_line!("{text}"),
                Some(Step::Probe {
                    step,
                    kind,
                    must_change,
                }) => {
                    self.run_steps(std::mem::take(&mut steps), input)?;
                    self.probe(Step::Move(step), kind, must_change)?;
                }
                Some(Step::Wait {
                    number,
                    analogue,
                    until,
                    seconds,
                    ..
                }) => {
                    self.run_steps(std::mem::take(&mut steps), input)?;
                    let number = (usize::from(number), analogue);
                    let value =
                        wait_for_input(&mut self.session, &self.machine, number, until, seconds)?;
                    self.dialog.report_input(value);
                }
                Some(step) => steps.push(step),
                None => {
                    self.run_steps(std::mem::take(&mut steps), input)?;
                    break;
                }
            }
        }
        for notice in self.dialog.notices() {
            print_line!("notice: {}", notice.what);
        }
        self.keep_changes()
    }

    fn refused(&self, problem: Problem, kind: ErrorKind) -> CliError {
        let refused = Refused {
            file: NAME.to_string(),
            called: Vec::new(),
            problems: vec![problem],
            more: 0,
        };
        Error::refused(kind, &refused).into()
    }

    /// The error of a block that the machine began and cannot end.
    fn stopped(&self, problem: Problem) -> CliError {
        let refused = self.refused(problem, ErrorKind::Refused);
        CliError::new(Exit::Command, refused.message)
    }

    /// Plans steps from the present pose; takes the block back if the machine cannot run them.
    fn plan(&mut self, steps: Vec<Step>, status: &Telemetry) -> Result<Plan, CliError> {
        let start = self.session.model().to_engineering_units(&status.commanded);
        let program = Program {
            file: NAME.to_string(),
            called: Vec::new(),
            start,
            steps,
            main_lines: Vec::new(),
            comments: Vec::new(),
            notices: Vec::new(),
            lines: self.dialog.line(),
        };
        let plan = Plan::new(&program, &settings(&self.machine), self.session.model());
        plan.map_err(|mut refused| {
            let problems = std::mem::take(&mut refused.problems).into_iter();
            refused.problems = problems
                .map(|problem| self.dialog.with_offsets(problem))
                .collect();
            self.dialog.undo();
            Error::refused(ErrorKind::Refused, &refused).into()
        })
    }

    fn run_steps(&mut self, steps: Vec<Step>, input: &mut Input) -> Result<(), CliError> {
        if steps.is_empty() {
            return Ok(());
        }
        let status = self.session.status()?;
        let what: Vec<String> = steps
            .iter()
            .filter_map(|step| match step {
                Step::Pause { .. } => Some("the block pauses".to_string()),
                Step::ToolChange { tool, .. } => Some(format!("fit tool {tool}")),
                _ => None,
            })
            .collect();
        if !what.is_empty() && !input.is_terminal() {
            self.dialog.undo();
            let changes = steps
                .iter()
                .any(|step| matches!(step, Step::ToolChange { .. }));
            let or = if changes {
                "name the tool in the spindle with M61 Q"
            } else {
                "remove the pause"
            };
            let what = format!(
                "mdi: the block pauses and standard input is no terminal to press Enter on; run \
                 the command in a terminal, or {or}"
            );
            return Err(CliError::new(Exit::Usage, what));
        }
        let plan = self.plan(steps, &status)?;
        if let Some(what) = slowed(&plan.figures) {
            print_line!("notice: {what}");
        }
        let mut pauses = Pauses {
            input,
            what: what.into_iter(),
            asked: false,
        };
        let end = self
            .session
            .run_job(MDI_JOB, plan.start, plan.setpoints, &mut pauses)?;
        Ok(self.session.check_completed(&end)?)
    }

    /// Runs a probe move and reports its end to the interpreter.
    fn probe(&mut self, step: Step, kind: ProbeKind, must_change: bool) -> Result<(), CliError> {
        let input = match find_input(&self.machine, None, Touch::Probe) {
            Ok(input) => input,
            Err(error) => {
                self.dialog.undo();
                return Err(error);
            }
        };
        let away = kind == ProbeKind::Away;
        let place = step.place();
        let status = self.session.status()?;
        if let Some((what, remedy)) = wrong_start(&self.machine, &status, input, away) {
            self.dialog.undo();
            let problem = Problem {
                place,
                what,
                remedy: remedy.into(),
            };
            return Err(self.stopped(problem));
        }
        let plan = self.plan(vec![step], &status)?;
        let contact = probe_along(&mut self.session, plan, input, away)?;
        let status = self.session.status()?;
        let model = self.session.model();
        // The machine stops behind the contact; the probed position is the contact.
        let at = contact.as_ref().map_or(&status.commanded, |it| &it.pose);
        let at = model.to_engineering_units(at);
        let stopped = model.to_engineering_units(&status.commanded);
        self.dialog.report_probe(&at, contact.is_some());
        self.dialog.place_at(&stopped);
        match contact {
            Some(_) => {
                let program = self.dialog.in_program(&at);
                let names = model.pose_names();
                let text: String = names
                    .iter()
                    .zip(program)
                    .map(|(name, value)| format!("  {name} {value:.4}"))
                    .collect();
                print_line!("contact at{text}");
                Ok(())
            }
            None if must_change => {
                let name = &self.machine.io.inputs[usize::from(input)];
                let problem = Problem {
                    place,
                    what: format!("the probe move ended without a change of {name}"),
                    remedy: "check the probe and the end of the move, or write G38.3 or G38.5"
                        .into(),
                };
                Err(self.stopped(problem))
            }
            None => Ok(()),
        }
    }

    /// Writes offsets and tools that the block changed.
    fn keep_changes(&mut self) -> Result<(), CliError> {
        let kept = self.data.keep(
            self.dialog.offsets(),
            self.dialog.tools(),
            self.file.as_deref(),
        );
        let [_, new_tools] = match kept.map_err(|error| CliError::new(Exit::Output, error))? {
            [false, false] => return Ok(()),
            changed => changed,
        };
        if self.file.is_none() {
            let what = if new_tools { "tools" } else { "offsets" };
            eprintln!(
                "the {what} end with this command: a built-in machine has no file for them; \
                 --machine FILE keeps them"
            );
        }
        Ok(())
    }
}

/// Asks for Enter at the pauses of a block.
struct Pauses<'a> {
    input: &'a mut Input,
    what: std::vec::IntoIter<String>,
    asked: bool,
}

impl JobObserver for Pauses<'_> {
    fn progress(&mut self, _: &Telemetry) {}

    fn paused(&mut self, _: u32) {
        let what = self.what.next().unwrap_or_else(|| "paused".to_string());
        self.held_by_input(&what);
    }

    fn may_resume(&mut self) -> bool {
        if self.asked && self.input.is_answered() {
            self.asked = false;
        }
        !self.asked
    }

    fn held_by_input(&mut self, what: &str) {
        self.input.ask(&format!(
            "{what}; press Enter to continue, Ctrl-C to stop: "
        ));
        self.asked = true;
    }
}
