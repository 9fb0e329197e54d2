//! Interpreter: from the lines of a program to its steps, one block at a time.

use super::block::{AXES, Block};
use super::canonical::Step;
use super::codes::Group;
use super::executor::{Executor, Here, Next};
use super::expression::{Read, text_of};
use super::flow::{Flow, OWord, OpenKind, Position, find_o_word};
use super::output::Output;
use super::problem::{Cause, Doubt, Mistake, Notice, Place, Problem, place_of};
use super::source::{Fetched, LONGEST_LINE, Mark, ProgramBytes, Source};
use super::state::{Motion, State};
use super::tool_table::{PerLetter, ToolTable, WorkOffset};
use super::{Comment, Coordinates, Options};

/// Most repeats of the main program by M99.
const MAX_REPEATS: u32 = 100;

/// Interpreter of a part program: an iterator over its steps.
///
/// Its memory does not depend on the length of the program. After a problem it goes on with the
/// next block, to find the others; steps after a problem must not be run.
pub struct Interpreter<'a> {
    pub(super) executor: Executor,
    pub(super) called: Vec<String>,
    pub(super) sources: Vec<Source<'a>>,
    pub(super) current: usize,
    pub(super) line: Vec<u8>,
    /// Position of the beginning of the line.
    pub(super) line_start: Mark,
    pub(super) block: Block,
    pub(super) flow: Flow,
    pub(super) tape_is_open: bool,
    pub(super) any_block: bool,
    /// Whether a block moved the machine.
    pub(super) any_step: bool,
    /// Repeats of the main program by M99.
    repeats: u32,
    pub(super) ended: Option<Place>,
    pub(super) finished: bool,
    /// Line of the newest call that the program itself made.
    pub(super) call_line: u32,
    pub(super) doubt: Doubt,
    pub(super) comments: Option<Vec<Comment>>,
}

impl<'a> Interpreter<'a> {
    /// Creates an interpreter of a program.
    pub fn new(bytes: impl ProgramBytes + 'a, options: &Options) -> Self {
        let mut at = PerLetter::default();
        let mut letters = Vec::new();
        let mut kinds = Vec::new();
        for (axis, start) in options.axes.iter().zip(&options.start) {
            let letter = AXES
                .iter()
                .position(|letter| char::from(*letter) == axis.letter);
            if let Some(letter) = letter {
                at[letter] = *start;
                letters.push(letter);
                kinds.push(axis.kind);
            }
        }
        let state = State::new(options, at);
        let out = Output::new(letters, kinds, at);
        Self {
            executor: Executor::new(state, out, options.clone()),
            called: Vec::new(),
            sources: vec![Source::new(Box::new(bytes))],
            current: 0,
            line: Vec::new(),
            line_start: Mark { offset: 0, line: 0 },
            block: Block::default(),
            flow: Flow::default(),
            tape_is_open: false,
            any_block: false,
            any_step: false,
            repeats: 0,
            ended: None,
            finished: false,
            call_line: 0,
            doubt: Doubt::default(),
            comments: None,
        }
    }

    /// Collects the comments of the program, for [`Interpreter::take_comments`].
    pub fn keep_comments(&mut self) {
        self.comments = Some(Vec::new());
    }

    /// Returns the comments so far, in order.
    pub fn take_comments(&mut self) -> Vec<Comment> {
        self.comments
            .as_mut()
            .map(std::mem::take)
            .unwrap_or_default()
    }

    /// Returns the words so far that change nothing on this machine.
    pub fn notices(&self) -> &[Notice] {
        &self.executor.notices
    }

    /// Returns the names of the called files, see [`Place::file`].
    pub fn called(&self) -> &[String] {
        &self.called
    }

    /// Adds the offsets in force to the problem of a planner with the step that was taken last,
    /// because they may be what is wrong. A problem at another place is returned as it is.
    pub fn with_offsets(&self, step: Place, mut problem: Problem) -> Problem {
        let in_machine_coordinates = self.block.codes.get(Group::Machine).is_some();
        if problem.place == step && !in_machine_coordinates {
            let Executor { state, out, .. } = &self.executor;
            if let Some(offsets) = state.offsets_in_force(&out.letters) {
                problem
                    .what
                    .push_str(&format!(" (offsets in force: {offsets})"));
            }
        }
        problem
    }

    /// Returns the number of lines of the program that were read.
    pub fn lines(&self) -> u32 {
        self.sources[0].line
    }

    /// Returns the line of the program itself that made the step taken last: for a step of a
    /// subroutine that of its outermost call.
    pub fn main_line(&self, step: &Step) -> u32 {
        let Place { file, line, .. } = step.place();
        // A step of a subroutine may be taken after its end.
        let is_own = file == 0 && (self.call_line..=self.sources[0].line).contains(&line);
        if self.flow.frames.is_empty() && is_own {
            line
        } else {
            self.call_line
        }
    }

    /// Reports where a probe move ended: mm, degrees, in the machine's order, and whether the probe
    /// changed. Call it after the step was run and before the next one is taken; without it, the
    /// move ends at its programmed end and the probe changes there.
    pub fn report_probe(&mut self, at: &Coordinates, changed: bool) {
        self.place_at(at);
        self.executor.set_probed(self.executor.state.at, changed);
    }

    /// Sets the position of the machine: mm, degrees, in the machine's order.
    pub fn place_at(&mut self, at: &Coordinates) {
        let executor = &mut self.executor;
        let length = executor.state.length;
        let mut here = length.machine_pose(&executor.state.at);
        for (axis, slot) in here.iter_mut().enumerate() {
            let index = executor.out.coordinate(axis);
            if let Some(value) = index.and_then(|index| at.get(index)) {
                *slot = *value;
            }
        }
        let here = length.tip_pose(&here);
        executor.state.at = here;
        executor.out.place_at(here);
    }

    /// Reports the value of the input that an M66 read; -1 if its time ran out.
    pub fn report_input(&mut self, value: f64) {
        self.executor.state.numbered[super::state::WAITED] = value;
    }

    /// Returns the tool table, with the changes of G10.
    pub fn tools(&self) -> &ToolTable {
        &self.executor.state.tools
    }

    /// Returns a work coordinate system, from 0 (G54), with the changes of G10.
    pub fn work_offset(&self, index: usize) -> WorkOffset {
        self.executor
            .state
            .system(index.min(super::tool_table::SYSTEMS - 1))
    }

    fn problem(&self, place: Place, mistake: Mistake) -> Problem {
        Problem {
            place,
            what: mistake.what,
            remedy: mistake.remedy,
        }
    }

    pub(super) fn place(&self, at: usize) -> Place {
        let source = &self.sources[self.current];
        place_of(self.current as u16, source.line, &self.line, at)
    }

    /// Runs the next line.
    pub(super) fn advance(&mut self) -> Result<(), Problem> {
        self.line_start = self.sources[self.current].mark();
        let fetched = self.sources[self.current].next(&mut self.line);
        let fetched = match fetched {
            Ok(fetched) => fetched,
            Err(error) => {
                self.finished = true;
                let what = format!("the program cannot be read: {error}");
                let remedy = "check the disk, or the line over which it comes";
                let mistake = Mistake::new(0, what, remedy);
                return Err(self.problem(self.place(0), mistake));
            }
        };
        let done = match fetched {
            Fetched::End => self.end_of_file(),
            Fetched::Utf16 => {
                self.finished = true;
                Err(Box::new(Mistake::new(
                    0,
                    "the file is UTF-16 text",
                    "save it as plain text (ASCII or UTF-8)",
                )))
            }
            Fetched::TooLong => Err(Box::new(Mistake::new(
                0,
                format!("a line of more than {LONGEST_LINE} bytes"),
                "check that the file is a part program",
            ))),
            Fetched::Line => self.run_line(),
        };
        match done {
            Ok(()) => {
                let block = &self.block;
                self.doubt
                    .pass(!block.comments.is_empty(), block.first.is_some());
                Ok(())
            }
            Err(mistake) => {
                let place = self.place(mistake.at);
                // Behind a loop or recursion without end nothing is known.
                self.finished |= self.flow.is_endless;
                if !self.finished && self.doubt.continues_comment(&self.line) {
                    return Ok(());
                }
                let follows = self.doubt.explains(&mistake);
                self.doubt.note(&self.line, &mistake);
                if self.block.o_word.is_some() {
                    self.doubt.add(Cause::Order);
                }
                if follows {
                    return Ok(());
                }
                Err(self.problem(place, *mistake))
            }
        }
    }

    fn run_line(&mut self) -> Read<()> {
        if let Some(skip) = &self.flow.skip {
            let Some(at) = find_o_word(&self.line) else {
                return Ok(());
            };
            let Ok(word) = OWord::read(&self.line, at, &self.executor.state) else {
                return Ok(());
            };
            if word.label != skip.label || !skip.until.ends_at(word.keyword) {
                return Ok(());
            }
            return self.end_skip(&word).inspect_err(|_| self.keep_order(&word));
        }
        self.executor.state.line = self.sources[self.current].line;
        let read = self.block.read(&self.line, &self.executor.state);
        if let Some(comments) = &mut self.comments {
            for comment in &self.block.comments {
                let line = self.sources[self.current].line;
                comments.push(Comment {
                    place: place_of(self.current as u16, line, &self.line, comment.at),
                    text: text_of(&self.line[comment.from..comment.to]),
                });
            }
        }
        if let (Err(mistake), Some(ended)) = (&read, self.ended) {
            // Text behind the end need not be a block.
            return self.after_the_end(mistake.at, ended);
        }
        read?;
        if let Some(at) = self.block.percent {
            self.tape_mark(at)?;
            if self.finished {
                return Ok(());
            }
        }
        let Some(first) = self.block.first else {
            return self.run_block();
        };
        if let Some(ended) = self.ended {
            return self.after_the_end(first, ended);
        }
        if self.block.optional && self.executor.options.block_delete {
            return Ok(());
        }
        let is_first = !self.any_block;
        self.any_block = true;
        if let Some(at) = self.block.o_word {
            let word = OWord::read(&self.line, at, &self.executor.state)?;
            return self
                .run_o_word(&word, is_first, false)
                .inspect_err(|_| self.keep_order(&word));
        }
        self.run_block()
    }

    fn run_block(&mut self) -> Read<()> {
        let here = Here {
            line: &self.line,
            file: self.current as u16,
            number: self.sources[self.current].line,
        };
        let motion = self.block.codes.tenths(Group::Motion).and_then(Motion::of);
        if motion.is_some_and(|motion| motion != self.executor.state.modes.motion) {
            // Another cycle has words of its own.
            self.doubt.remove(Cause::Series);
        }
        let next = self.executor.run(&mut self.block, &here)?;
        self.any_step |= !self.executor.out.steps.is_empty();
        match next {
            Next::Block => Ok(()),
            Next::End => {
                self.ended = Some(here.place(self.block.first.unwrap_or(0)));
                if self.current != 0 {
                    self.finished = true;
                }
                Ok(())
            }
            Next::Call {
                number,
                repeats,
                at,
            } => {
                if number.fract() != 0.0 || !(0.0..=1e9).contains(&number) {
                    return Err(Box::new(Mistake::new(
                        at,
                        format!("P{number} is not a subprogram"),
                        "write the number of its O word",
                    )));
                }
                if repeats == 0 {
                    return Ok(());
                }
                self.call(format!("{}", number as u64), at, None, repeats)
            }
            Next::Return { at } => {
                if self.flow.frames.is_empty() {
                    return self.repeat_program(at);
                }
                self.return_from_call(at)
            }
        }
    }

    /// M99 of the main program: back to its first block.
    fn repeat_program(&mut self, at: usize) -> Read<()> {
        self.repeats += 1;
        if self.repeats > MAX_REPEATS {
            return Err(Box::new(Mistake::new(
                at,
                format!("M99 in the main program repeats it more than {MAX_REPEATS} times"),
                "write M30, or a loop with a number of rounds",
            )));
        }
        self.tape_is_open = false;
        (self.any_block, self.any_step) = (false, false);
        self.flow.open.clear();
        let start = Position {
            file: 0,
            mark: Mark { offset: 0, line: 0 },
        };
        self.go_to(start, at)
    }

    /// `%` before the first block opens the tape, the next one ends the program.
    fn tape_mark(&mut self, at: usize) -> Read<()> {
        if self.block.first.is_some() {
            return Err(Box::new(Mistake::new(
                at,
                "% in a block",
                "write % on a line of its own",
            )));
        }
        if self.current != 0 {
            return Ok(());
        }
        if !self.any_block && !self.tape_is_open {
            self.tape_is_open = true;
            return Ok(());
        }
        self.executor.out.release();
        self.finished = true;
        self.check_open()
    }

    fn after_the_end(&mut self, first: usize, ended: Place) -> Read<()> {
        self.finished = true;
        // Subroutines may stand behind the main program.
        if self.block.o_word.is_some() {
            return Ok(());
        }
        let what = format!(
            "this block and those after it are not run: the program ends in line {}",
            ended.line
        );
        self.notice_end(first, what)
    }

    fn notice_end(&mut self, at: usize, what: String) -> Read<()> {
        let here = Here {
            line: &self.line,
            file: self.current as u16,
            number: self.sources[self.current].line,
        };
        self.executor.notice(&here, at, "end", what)
    }

    /// Ends the main program at a subprogram that it called: there is no M30 before it.
    pub(super) fn end_at_subprogram(&mut self, word: &OWord) -> Read<()> {
        self.executor.out.release();
        self.finished = true;
        let what = format!(
            "the main program has no end: it ends before its subprogram O{}",
            word.label
        );
        self.notice_end(word.at, what)?;
        self.check_open()
    }

    fn check_open(&mut self) -> Read<()> {
        let open = match (&self.flow.skip, self.flow.open.last()) {
            (Some(skip), _) => Some((skip.label.clone(), skip.until.name(), skip.place)),
            (None, Some(open)) => {
                let end = match open.kind {
                    OpenKind::If => "endif",
                    OpenKind::While => "endwhile",
                    OpenKind::Do => "while",
                    OpenKind::Repeat(_) => "endrepeat",
                };
                Some((open.label.clone(), end, open.place))
            }
            (None, None) => None,
        };
        self.flow.skip = None;
        self.flow.open.clear();
        match open {
            None => Ok(()),
            Some((label, end, place)) => {
                let what = format!(
                    "the file ends without the {end} of O{label} in line {}",
                    place.line
                );
                let mistake = Mistake::new(0, what, "write it");
                Err(Box::new(mistake.because(Cause::Order)))
            }
        }
    }

    fn end_of_file(&mut self) -> Read<()> {
        self.line.clear();
        if self.current != 0 || !self.flow.frames.is_empty() {
            let label = self.flow.frames.last().map(|frame| frame.label.clone());
            self.finished = true;
            return Err(Box::new(Mistake::new(
                0,
                format!(
                    "the file ends within the subroutine O{}",
                    label.unwrap_or_default()
                ),
                "end it with endsub, or with M99 after an O number",
            )));
        }
        self.executor.out.release();
        self.finished = true;
        self.check_open()
    }

    pub(super) fn mark(&self) -> Position {
        Position {
            file: self.current as u16,
            mark: self.sources[self.current].mark(),
        }
    }

    pub(super) fn go_to(&mut self, position: Position, at: usize) -> Read<()> {
        self.current = usize::from(position.file);
        self.sources[self.current]
            .seek(position.mark)
            .map_err(|error| {
                self.finished = true;
                Box::new(Mistake::new(
                    at,
                    format!("the program cannot go back to an earlier line: {error}"),
                    "run it from a file",
                ))
            })
    }
}

impl Iterator for Interpreter<'_> {
    type Item = Result<Step, Problem>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(step) = self.executor.out.steps.pop_front() {
                return Some(Ok(step));
            }
            if self.finished {
                return None;
            }
            if let Err(problem) = self.advance() {
                return Some(Err(problem));
            }
        }
    }
}
