//! Loads a part program, checks it against the machine and plans it.

use super::changes::ChangeArgs;
use super::{CliError, Exit};
use haptimill_client::{Error, ErrorKind};
use haptimill_gcode::{
    Interpreter, Notice, Place, Problem, Program, ProgramBytes, Refused, Step, file_name,
};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::input;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_machine_file::work_data::WorkData;
use haptimill_planner::{CheckError, Figures, Plan, Planner, Settings};
use haptimill_protocol::message::{Action, AxisValues};
use haptimill_protocol::setpoint::Setpoint;
use std::collections::BTreeMap;
use std::fmt;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A program that was checked and planned from a start pose.
#[derive(Debug)]
pub(crate) struct Planned {
    pub(crate) plan: Plan,
    pub(crate) pauses: Pauses,
    /// The approach of a program that begins in the middle.
    pub(crate) approach: Option<String>,
    /// Words that change nothing on this machine, and feeds that it lowers, as lines of text.
    pub(crate) notices: Vec<String>,
}

/// A program that was checked from a start pose.
#[derive(Debug)]
pub(crate) struct Checked {
    pub(crate) figures: Figures,
    /// Names of the called files.
    pub(crate) called: Vec<String>,
    /// Duration at the overrides, seconds.
    pub(crate) duration_s: f64,
    /// Words that change nothing on this machine, and feeds that it lowers, as lines of text.
    pub(crate) notices: Vec<String>,
}

/// What lowers the feed of blocks, if there are any.
pub(crate) fn slowed(figures: &Figures) -> Option<String> {
    let blocks = haptimill_report::count(figures.slowed, "block");
    (figures.slowed > 0).then(|| format!("the limits of the machine keep {blocks} below the feed"))
}

impl Planned {
    /// The result of the check, with the duration at the overrides, and the approach.
    pub(crate) fn into_checked(self, duration_s: f64) -> (Checked, Option<String>) {
        let checked = Checked {
            duration_s,
            figures: self.plan.figures,
            called: Vec::new(),
            notices: self.notices,
        };
        (checked, self.approach)
    }
}

/// A pause of a program: M0, M1, or a tool change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pause {
    pub(crate) line: u32,
    column: u32,
    /// The called file of the line; `None` for the program itself.
    file: Option<String>,
    /// The tool to fit.
    tool: Option<u32>,
    /// The comment in this line, for the operator.
    comment: Option<String>,
}

impl Pause {
    /// The pause of a step, with the comment of its block; `None` for other steps.
    pub(crate) fn of(step: &Step, called: &[String], comment: Option<String>) -> Option<Self> {
        let (place, tool) = match step {
            Step::Pause { place } => (place, None),
            Step::ToolChange { place, tool, .. } => (place, Some(*tool)),
            _ => return None,
        };
        let number = usize::from(place.file);
        Some(Self {
            line: place.line,
            column: place.column,
            file: number
                .checked_sub(1)
                .and_then(|index| called.get(index).cloned()),
            tool,
            comment,
        })
    }
}

/// Pauses of a program, by their setpoints; those of a stream are added while it runs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pauses(Arc<Mutex<BTreeMap<u32, Pause>>>);

impl Pauses {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<u32, Pause>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn add(&self, setpoint: u32, pause: Pause) {
        self.lock().insert(setpoint, pause);
    }

    pub(crate) fn get(&self, setpoint: u32) -> Option<Pause> {
        self.lock().get(&setpoint).cloned()
    }

    #[cfg_attr(not(feature = "console"), allow(dead_code))]
    pub(crate) fn count(&self) -> usize {
        self.lock().len()
    }

    fn first(&self) -> Option<Pause> {
        self.lock().values().next().cloned()
    }
}

impl FromIterator<(u32, Pause)> for Pauses {
    fn from_iter<I: IntoIterator<Item = (u32, Pause)>>(pauses: I) -> Self {
        Self(Arc::new(Mutex::new(pauses.into_iter().collect())))
    }
}

impl fmt::Display for Pause {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "line {}", self.line)?;
        if let Some(file) = &self.file {
            write!(out, " of {file}")?;
        }
        match self.tool {
            Some(0) => out.write_str(", take out the tool")?,
            Some(tool) => write!(out, ", fit tool {tool}")?,
            None => {}
        }
        match &self.comment {
            Some(comment) => write!(out, " ({comment})"),
            None => Ok(()),
        }
    }
}

/// The lines of a part program, without control characters.
pub(crate) fn source_lines(text: &[u8]) -> Vec<String> {
    let lines = String::from_utf8_lossy(text);
    let plain = |letter: char| if letter.is_control() { ' ' } else { letter };
    lines
        .lines()
        .map(|line| {
            line.chars()
                .map(plain)
                .collect::<String>()
                .trim()
                .to_string()
        })
        .collect()
}

/// The text of a comment for the operator; `None` if it is empty.
pub(crate) fn comment_text(comment: &str) -> Option<String> {
    let comment = comment.trim();
    // The prefix of a message to the operator.
    let is_message = comment
        .get(..4)
        .is_some_and(|word| word.eq_ignore_ascii_case("MSG,"));
    let comment = if is_message {
        comment[4..].trim()
    } else {
        comment
    };
    (!comment.is_empty()).then(|| comment.to_string())
}

/// How a part program is read.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct LanguageArgs {
    /// Also pause at M1
    #[arg(long)]
    pub optional_stop: bool,
    /// Leave out blocks that begin with a slash
    #[arg(long)]
    pub block_delete: bool,
    /// Lengths without a decimal point count 0.001 mm or 0.0001 inch
    #[arg(long)]
    pub no_decimal: bool,
    /// Refuse words that change nothing on this machine
    #[arg(long)]
    pub strict: bool,
}

/// A part program on disk.
#[derive(Debug)]
pub(crate) struct PartProgram {
    /// File name without folders. The recording contains it and must not depend on the folder.
    pub(crate) name: String,
    file: String,
    pub(crate) text: Vec<u8>,
    language: LanguageArgs,
    /// Folder of the program, for called files.
    folder: PathBuf,
    /// What is changed before it is planned.
    changes: ChangeArgs,
    /// Spindle override from the start, percent.
    spindle_percent: u8,
}

impl PartProgram {
    /// Reads the file.
    pub(crate) fn load(path: &Path, language: LanguageArgs) -> Result<Self, CliError> {
        let file = path.display().to_string();
        if std::fs::metadata(path).is_ok_and(|data| data.len() > input::PROGRAM_BYTES) {
            let what = format!(
                "{file}: it is larger than {} MiB, and this command keeps it in memory; \
                 `haptimill run` without --from-line, --dry and --single does not",
                input::PROGRAM_BYTES >> 20
            );
            return Err(CliError::new(Exit::BadInput, what));
        }
        let text = input::read(path, input::PROGRAM_BYTES)
            .map_err(|error| CliError::new(Exit::BadInput, format!("{file}: {error}")))?;
        let name = path
            .file_name()
            .map_or_else(|| file.clone(), |name| name.to_string_lossy().into_owned());
        Ok(Self {
            name,
            file,
            text,
            language,
            folder: path.parent().map(Path::to_path_buf).unwrap_or_default(),
            changes: ChangeArgs::default(),
            spindle_percent: 100,
        })
    }

    /// A program that is streamed: its text is not kept.
    pub(crate) fn streamed(path: &Path, language: LanguageArgs) -> Self {
        let (file, name) = match path.file_name() {
            _ if path == Path::new("-") => ("standard input".into(), "standard input".into()),
            Some(name) => (
                path.display().to_string(),
                name.to_string_lossy().into_owned(),
            ),
            None => (path.display().to_string(), path.display().to_string()),
        };
        Self {
            name,
            file,
            text: Vec::new(),
            language,
            folder: path.parent().map(Path::to_path_buf).unwrap_or_default(),
            changes: ChangeArgs::default(),
            spindle_percent: 100,
        }
    }

    /// The same program without its text, for messages.
    pub(crate) fn without_text(&self) -> Self {
        Self {
            name: self.name.clone(),
            file: self.file.clone(),
            text: Vec::new(),
            folder: self.folder.clone(),
            ..*self
        }
    }

    /// The name of the file in messages.
    pub(crate) fn file_name(&self) -> String {
        self.file.clone()
    }

    /// Changes the program before it is planned.
    #[must_use]
    pub(crate) fn with_changes(self, changes: ChangeArgs) -> Self {
        Self { changes, ..self }
    }

    /// Runs the program at a spindle override, percent.
    #[must_use]
    pub(crate) fn at_spindle_override(self, spindle_percent: u8) -> Self {
        Self {
            spindle_percent,
            ..self
        }
    }

    /// Settings of the planner for the program.
    pub(crate) fn settings(&self, machine: &MachineFile) -> Settings {
        Settings {
            spindle_percent: self.spindle_percent,
            ..settings(machine)
        }
    }

    /// Checks and plans the program from a start pose, with the work offsets and the tool table
    /// beside the machine file.
    ///
    /// # Errors
    /// The mistakes of the program, or what the machine cannot do; nothing moves.
    pub(crate) fn plan(
        &self,
        machine: &MachineFile,
        model: &Model,
        start: &AxisValues,
    ) -> Result<Planned, CliError> {
        let options = self.options(machine, model, start)?;
        self.plan_steps(self.read(&options)?, machine, model, &options)
    }

    /// Interprets the program.
    ///
    /// # Errors
    /// The mistakes of the program.
    pub(crate) fn read(&self, options: &haptimill_gcode::Options) -> Result<Program, CliError> {
        haptimill_gcode::read(&self.file, &self.text, options)
            .map_err(|refused| Error::refused(ErrorKind::BadInput, &refused).into())
    }

    /// Plans the program that was interpreted with these options.
    ///
    /// # Errors
    /// What the machine cannot do; nothing moves.
    pub(crate) fn plan_steps(
        &self,
        mut program: Program,
        machine: &MachineFile,
        model: &Model,
        options: &haptimill_gcode::Options,
    ) -> Result<Planned, CliError> {
        let run_up_s = machine.spindle.run_up_s;
        let approach = self.changes.apply(&mut program, options, run_up_s)?;
        let plan = Plan::new(&program, &self.settings(machine), model)
            .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))?;
        Ok(Planned {
            pauses: self.pauses_of(&plan, &program),
            approach,
            notices: self.all_notices(&program.notices, &program.called, &plan.figures),
            plan,
        })
    }

    /// The pauses of a planned program, with their comments.
    pub(crate) fn pauses_of(&self, plan: &Plan, program: &Program) -> Pauses {
        // Each pause of the program has one setpoint, in the same order.
        let setpoints = (0..)
            .zip(&plan.setpoints)
            .filter(|(_, setpoint)| setpoint.action == Action::Pause);
        let mut comments = BTreeMap::new();
        for comment in &program.comments {
            let Place { file, line, .. } = comment.place;
            comments.entry((file, line)).or_insert(&comment.text);
        }
        let steps = program.steps.iter();
        let pauses =
            steps.filter(|step| matches!(step, Step::Pause { .. } | Step::ToolChange { .. }));
        let pauses = pauses.filter_map(|step| {
            let place = step.place();
            let comment = comments.get(&(place.file, place.line));
            let comment = comment.and_then(|comment| comment_text(comment));
            Pause::of(step, &program.called, comment)
        });
        setpoints.map(|(index, _)| index).zip(pauses).collect()
    }

    /// Checks the program from a start pose, and keeps nothing of it.
    ///
    /// # Errors
    /// As [`PartProgram::plan`].
    pub(crate) fn check(
        &self,
        machine: &MachineFile,
        model: &Model,
        start: &AxisValues,
    ) -> Result<Checked, CliError> {
        self.check_bytes(
            std::io::Cursor::new(&self.text),
            machine,
            (model, start),
            |_| {},
        )
    }

    /// As [`PartProgram::check`], of bytes that are read once, and shows `seen` each step.
    ///
    /// # Errors
    /// As [`PartProgram::plan`].
    pub(crate) fn check_bytes(
        &self,
        bytes: impl ProgramBytes,
        machine: &MachineFile,
        (model, start): (&Model, &AxisValues),
        seen: impl FnMut(&Step),
    ) -> Result<Checked, CliError> {
        let options = self.options(machine, model, start)?;
        let mut interpreter = Interpreter::new(bytes, &options);
        let checked = haptimill_planner::check(
            &self.file,
            &mut interpreter,
            options.start,
            &self.settings(machine),
            model,
            seen,
        );
        let figures = checked.map_err(|error| match error {
            CheckError::Unreadable(refused) => Error::refused(ErrorKind::BadInput, &refused),
            CheckError::Impossible(refused) => Error::refused(ErrorKind::Refused, &refused),
        })?;
        Ok(Checked {
            duration_s: figures.duration_s,
            called: interpreter.called().to_vec(),
            notices: self.all_notices(interpreter.notices(), interpreter.called(), &figures),
            figures,
        })
    }

    /// Interprets the program from a start pose; each step goes to `take`, with the interpreter.
    ///
    /// # Errors
    /// A mistake of the program, or the first error of `take`.
    pub(crate) fn for_each_step(
        &self,
        options: &haptimill_gcode::Options,
        mut take: impl FnMut(&Step) -> Result<(), Problem>,
    ) -> Result<(), CliError> {
        let mut interpreter = Interpreter::new(std::io::Cursor::new(&self.text), options);
        while let Some(step) = interpreter.next() {
            let (kind, taken) = match step {
                Ok(step) => (ErrorKind::Refused, take(&step)),
                Err(problem) => (ErrorKind::BadInput, Err(problem)),
            };
            if let Err(problem) = taken {
                return Err(self.refuse(kind, problem, interpreter.called()));
            }
        }
        Ok(())
    }

    /// The error of one problem.
    pub(crate) fn refuse(&self, kind: ErrorKind, problem: Problem, called: &[String]) -> CliError {
        let refused = Refused {
            file: self.file.clone(),
            called: called.to_vec(),
            problems: vec![problem],
            more: 0,
        };
        Error::refused(kind, &refused).into()
    }

    /// How the program is read, with the work offsets and the tool table beside the machine file.
    pub(crate) fn options(
        &self,
        machine: &MachineFile,
        model: &Model,
        start: &AxisValues,
    ) -> Result<haptimill_gcode::Options, CliError> {
        let data =
            WorkData::beside(machine).map_err(|error| CliError::new(Exit::BadInput, error))?;
        Ok(haptimill_gcode::Options {
            optional_stop: self.language.optional_stop,
            block_delete: self.language.block_delete,
            no_decimal: self.language.no_decimal,
            strict: self.language.strict,
            offsets: data.offsets,
            tools: data.tools,
            folders: vec![self.folder.clone()],
            ..program_options(machine, model.to_engineering_units(start))
        })
    }

    pub(crate) fn describe_notices(&self, notices: &[Notice], called: &[String]) -> Vec<String> {
        let describe = |notice: &Notice| {
            let Place { file, line, column } = notice.place;
            let name = file_name(&self.file, called, file);
            format!("{name}:{line}:{column}: notice: {}", notice.what)
        };
        notices.iter().map(describe).collect()
    }

    fn all_notices(&self, notices: &[Notice], called: &[String], figures: &Figures) -> Vec<String> {
        let mut all = self.describe_notices(notices, called);
        all.extend(self.describe_slowed(figures));
        all
    }

    /// The notice of blocks whose feed the machine does not reach, if there are any.
    pub(crate) fn describe_slowed(&self, figures: &Figures) -> Option<String> {
        slowed(figures).map(|what| format!("{}: notice: {what}", self.file))
    }

    /// Refuses a program with pauses where standard input is no terminal, because a pause waits for
    /// Enter.
    pub(crate) fn check_pauses(&self, planned: &Planned) -> Result<(), CliError> {
        match planned.pauses.first() {
            Some(pause) => self.check_pause(&pause),
            None => Ok(()),
        }
    }

    /// Refuses the first pause of a program, see [`PartProgram::check_pauses`].
    pub(crate) fn check_pause(&self, pause: &Pause) -> Result<(), CliError> {
        if std::io::stdin().is_terminal() {
            return Ok(());
        }
        let file = pause.file.as_ref().unwrap_or(&self.file);
        let (line, column) = (pause.line, pause.column);
        let what = format!(
            "{file}:{line}:{column}: the program pauses here and standard input is no terminal to \
             press Enter on; run it in a terminal, or with --skip-pauses"
        );
        Err(CliError::new(Exit::Usage, what))
    }

    /// Plans a checked program again, in memory that does not depend on its length, and shows
    /// `take` each setpoint. Its text was checked from this start.
    ///
    /// # Errors
    /// As [`PartProgram::plan`].
    pub(crate) fn for_each_setpoint(
        &self,
        bytes: impl ProgramBytes,
        machine: &MachineFile,
        (model, start): (&Model, &AxisValues),
        mut take: impl FnMut(&Setpoint),
    ) -> Result<(), CliError> {
        let options = self.options(machine, model, start)?;
        let settings = self.settings(machine);
        let mut planner = Planner::of_checked(options.start, settings, model);
        let mut interpreter = Interpreter::new(bytes, &options);
        let refuse = |kind, problem, called: &[String]| self.refuse(kind, problem, called);
        while let Some(step) = interpreter.next() {
            let planned = match step {
                Ok(step) => planner.step(&step),
                Err(problem) => {
                    return Err(refuse(ErrorKind::BadInput, problem, interpreter.called()));
                }
            };
            planned.map_err(|problem| refuse(ErrorKind::Refused, problem, interpreter.called()))?;
            planner.made().for_each(|made| take(&made.setpoint));
        }
        planner
            .finish(interpreter.lines())
            .map_err(|problem| refuse(ErrorKind::Refused, problem, interpreter.called()))?;
        planner.made().for_each(|made| take(&made.setpoint));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_lines_are_texts_for_the_operator() {
        let comment = |text: &str| comment_text(text).unwrap_or_default();
        assert_eq!(comment("turn the part"), "turn the part");
        assert_eq!(comment("MSG, turn the part"), "turn the part");
        assert_eq!(comment(" turn (by 90)"), "turn (by 90)");
        assert_eq!(comment(" "), "");
        assert_eq!(comment("äöü"), "äöü");
        assert_eq!(source_lines(b"G1 X1\tY2\r\n\x1b[2J\n"), ["G1 X1 Y2", "[2J"]);
    }
}
