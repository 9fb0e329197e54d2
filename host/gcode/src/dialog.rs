//! Lines that an operator enters one after another (MDI), with what they leave in force.

use super::canonical::Step;
use super::problem::{Notice, Problem};
use super::state::{FeedMode, G28, G30, G92, G92_ACTIVE, State, Turn};
use super::tool_table::{Offsets, PerLetter, SYSTEM_NAMES, SYSTEMS, ToolTable};
use super::{Coordinates, Interpreter, Options};
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Locks the text.
fn text_of(text: &Mutex<Vec<u8>>) -> MutexGuard<'_, Vec<u8>> {
    text.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The lines so far: loops and subroutines go back to them.
#[derive(Clone, Default)]
struct Lines {
    text: Arc<Mutex<Vec<u8>>>,
    at: u64,
}

impl Read for Lines {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let text = text_of(&self.text);
        let from = usize::try_from(self.at).map_or(text.len(), |at| at.min(text.len()));
        let count = buffer.len().min(text.len() - from);
        buffer[..count].copy_from_slice(&text[from..from + count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Lines {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let SeekFrom::Start(at) = to else {
            return Err(io::ErrorKind::Unsupported.into());
        };
        self.at = at;
        Ok(at)
    }
}

/// Interpreter of lines that are entered one after another. Modes, offsets and parameters stay in
/// force from line to line.
///
/// Callers must take the steps of a line with [`Dialog::next_step`] up to `None` before the next
/// line. A line with a problem changes nothing.
pub struct Dialog {
    interpreter: Interpreter<'static>,
    text: Arc<Mutex<Vec<u8>>>,
    /// State and position before the line, and the number of notices.
    before: (State, PerLetter, usize),
    /// Notices before the last line.
    noticed: usize,
}

impl Dialog {
    /// Begins with the modes of a program.
    pub fn new(options: &Options) -> Self {
        let lines = Lines::default();
        let text = Arc::clone(&lines.text);
        let interpreter = Interpreter::new(lines, options);
        let executor = &interpreter.executor;
        let before = (executor.state.clone(), *executor.out.at(), 0);
        Self {
            interpreter,
            text,
            before,
            noticed: 0,
        }
    }

    /// Sets the position of the machine: mm, degrees, in the machine's order.
    pub fn place_at(&mut self, at: &Coordinates) {
        self.interpreter.place_at(at);
    }

    /// Enters a line. Line ends in it become blanks.
    pub fn enter(&mut self, line: &str) {
        let executor = &self.interpreter.executor;
        self.noticed = executor.notices.len();
        self.before = (
            executor.state.clone(),
            *executor.out.at(),
            executor.notices.len(),
        );
        let plain = line.bytes().map(|byte| {
            if matches!(byte, b'\n' | b'\r') {
                b' '
            } else {
                byte
            }
        });
        let mut text = text_of(&self.text);
        text.extend(plain);
        text.push(b'\n');
        // A program that ended may be followed by further lines.
        self.interpreter.ended = None;
        self.interpreter.finished = false;
    }

    /// Whether a line, or the rest of a subroutine, was not run yet.
    fn is_behind(&self) -> bool {
        let read = self.interpreter.sources[0].mark().offset;
        self.interpreter.current != 0 || read < text_of(&self.text).len() as u64
    }

    /// Returns the next step of the line, or `None` at its end.
    ///
    /// # Errors
    ///
    /// The line has a problem; [`Dialog::undo`] was called.
    pub fn next_step(&mut self) -> Result<Option<Step>, Problem> {
        loop {
            if let Some(step) = self.interpreter.executor.out.steps.pop_front() {
                return Ok(Some(step));
            }
            if self.interpreter.finished || !self.is_behind() {
                return Ok(None);
            }
            if let Err(problem) = self.interpreter.advance() {
                self.undo();
                return Err(problem);
            }
        }
    }

    /// Takes back what the last line set, because the machine does not run it. Called files,
    /// conditions and loops that are open end, too.
    pub fn undo(&mut self) {
        let end = text_of(&self.text).len() as u64;
        let interpreter = &mut self.interpreter;
        interpreter.current = 0;
        interpreter.flow.frames.clear();
        interpreter.flow.open.clear();
        interpreter.flow.skip = None;
        // What the line left in doubt is taken back, too.
        interpreter.doubt = Default::default();
        let lines = interpreter.sources[0].line;
        let mark = super::source::Mark {
            offset: end,
            line: lines,
        };
        // The text is in memory: going to its end cannot fail.
        let _ = interpreter.sources[0].seek(mark);
        let executor = &mut interpreter.executor;
        executor.leave_all_calls();
        executor.out.steps.clear();
        executor.out.compensation = Default::default();
        let (state, at, notices) = &self.before;
        executor.state = state.clone();
        executor.state.compensation = 400;
        executor.out.place_at(*at);
        executor.notices.truncate(*notices);
    }

    /// Reports the value of the input that M66 read, as [`Interpreter::report_input`].
    pub fn report_input(&mut self, value: f64) {
        self.interpreter.report_input(value);
    }

    /// Reports where a probe move ended, as [`Interpreter::report_probe`].
    pub fn report_probe(&mut self, at: &Coordinates, changed: bool) {
        self.interpreter.report_probe(at, changed);
    }

    /// Adds the offsets in force, see [`Interpreter::with_offsets`].
    pub fn with_offsets(&self, problem: Problem) -> Problem {
        self.interpreter.with_offsets(problem.place, problem)
    }

    /// Returns the words of the last line that change nothing on this machine.
    pub fn notices(&self) -> &[Notice] {
        let notices = &self.interpreter.executor.notices;
        &notices[self.noticed.min(notices.len())..]
    }

    /// Returns the number of the last line, from 1.
    pub fn line(&self) -> u32 {
        self.interpreter.lines()
    }

    /// Returns the tool table, with the changes of G10.
    pub fn tools(&self) -> &ToolTable {
        self.interpreter.tools()
    }

    /// Returns the offsets, with the changes of G10, G28.1, G30.1 and G92.
    pub fn offsets(&self) -> Offsets {
        let state = &self.interpreter.executor.state;
        let values = |first: usize| {
            let mut values = PerLetter::default();
            values.copy_from_slice(&state.numbered[first..first + 9]);
            values
        };
        Offsets {
            systems: std::array::from_fn(|index| state.system(index.min(SYSTEMS - 1))),
            active: state.modes.system,
            g92: values(G92),
            g92_active: state.numbered[G92_ACTIVE] != 0.0,
            g28: values(G28),
            g30: values(G30),
        }
    }

    /// Returns a position of the machine (mm, degrees, in the machine's order) in the coordinates
    /// of the program, in mm and degrees.
    pub fn in_program(&self, at: &Coordinates) -> Coordinates {
        let executor = &self.interpreter.executor;
        let coordinate = |axis| executor.out.coordinate(axis);
        let length = executor.state.length;
        let mut machine = length.machine_pose(&executor.state.at);
        for (axis, slot) in machine.iter_mut().enumerate() {
            if let Some(value) = coordinate(axis).and_then(|index| at.get(index)) {
                *slot = *value;
            }
        }
        let program = executor.state.in_program(&length.tip_pose(&machine));
        let mut values = Coordinates::default();
        for (axis, value) in program.iter().enumerate() {
            if let Some(slot) = coordinate(axis).and_then(|index| values.get_mut(index)) {
                *slot = *value;
            }
        }
        values
    }

    /// Returns the words in force, as `G1 G17 G21 G90 G94 G54 G49 G40 F600 S0 M5 T0`.
    pub fn modes(&self) -> String {
        let state = &self.interpreter.executor.state;
        let modes = &state.modes;
        let code = |tenths: u16| match tenths % 10 {
            0 => format!("G{}", tenths / 10),
            part => format!("G{}.{part}", tenths / 10),
        };
        let length = if state.tool_offset == PerLetter::default() {
            "G49"
        } else {
            "G43"
        };
        let mut words = vec![
            code(modes.motion.tenths()),
            modes.plane.word().to_owned(),
            if modes.inch { "G20" } else { "G21" }.to_owned(),
            if modes.incremental { "G91" } else { "G90" }.to_owned(),
            match modes.feed_mode {
                FeedMode::InverseTime => "G93",
                FeedMode::PerMinute => "G94",
                FeedMode::PerTurn => "G95",
            }
            .to_owned(),
            SYSTEM_NAMES[modes.system.min(SYSTEMS - 1)].to_owned(),
            length.to_owned(),
            code(state.compensation),
        ];
        words.extend(modes.feed.map(|feed| format!("F{feed}")));
        words.extend(modes.speed.map(|speed| format!("S{speed}")));
        words.push(
            match modes.turn {
                Turn::Off => "M5",
                Turn::Clockwise => "M3",
                Turn::CounterClockwise => "M4",
            }
            .to_owned(),
        );
        words.push(format!("T{}", state.tool));
        words.join(" ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Path;

    fn dialog() -> Dialog {
        Dialog::new(&Options::of_letters("XYZBA", Coordinates::default()))
    }

    fn run(dialog: &mut Dialog, line: &str) -> Result<Vec<Path>, Problem> {
        dialog.enter(line);
        let mut paths = Vec::new();
        while let Some(step) = dialog.next_step()? {
            if let Step::Move(step) = step {
                paths.push(step.path);
            }
        }
        Ok(paths)
    }

    #[test]
    fn modes_stay_in_force_from_line_to_line() {
        let mut dialog = dialog();
        assert!(run(&mut dialog, "G91 G20").expect("no move").is_empty());
        let first = run(&mut dialog, "G1 X1 F10").expect("a move");
        let second = run(&mut dialog, "X1").expect("a move");
        assert_eq!((first[0].to[0], second[0].to[0]), (25.4, 50.8));
        assert_eq!(dialog.modes(), "G1 G17 G20 G91 G94 G54 G49 G40 F10 M5 T0");
        run(&mut dialog, "#1=3 #<_depth>=4").expect("parameters");
        let third = run(&mut dialog, "G21 G90 X#1 Y#<_depth>").expect("a move");
        assert_eq!(third[0].to[..2], [3.0, 4.0]);
    }

    #[test]
    fn a_line_with_a_problem_changes_nothing() {
        let mut dialog = dialog();
        let before = dialog.modes();
        let problem = run(&mut dialog, "G91 G20 G1 X5").expect_err("no feed");
        assert_eq!(
            (problem.place.line, problem.what.contains("feed")),
            (1, true)
        );
        assert_eq!(dialog.modes(), before);
        let paths = run(&mut dialog, "G0 X5").expect("a move");
        assert_eq!(paths[0].to[0], 5.0);
        assert_eq!(dialog.line(), 2);
    }

    #[test]
    fn a_line_that_is_undone_changes_nothing() {
        let mut dialog = dialog();
        run(&mut dialog, "G0 X5").expect("a move");
        let before = (dialog.modes(), dialog.offsets());
        run(&mut dialog, "G10 L20 P1 X0").expect("an offset");
        assert_ne!(dialog.offsets(), before.1);
        dialog.undo();
        assert_eq!((dialog.modes(), dialog.offsets()), before);
        let paths = run(&mut dialog, "G0 X6").expect("a move");
        assert_eq!((paths[0].from[0], paths[0].to[0]), (5.0, 6.0));
    }

    #[test]
    fn lines_go_on_after_the_end_of_a_program_and_from_another_place() {
        let mut dialog = dialog();
        run(&mut dialog, "G0 X5 M2").expect("the end");
        dialog.place_at(&[1.0, 2.0, 3.0, 0.0, 0.0, 0.0]);
        let paths = run(&mut dialog, "G0 X6").expect("a move");
        assert_eq!(paths[0].from[..3], [1.0, 2.0, 3.0]);
        assert_eq!(paths[0].to[..3], [6.0, 2.0, 3.0]);
        assert!(run(&mut dialog, "%").expect("a tape mark").is_empty());
        assert!(run(&mut dialog, "%").expect("a tape mark").is_empty());
        assert_eq!(run(&mut dialog, "G0 X7").expect("a move").len(), 1);
    }

    #[test]
    fn loops_over_several_lines_are_run_at_their_end() {
        let mut dialog = dialog();
        assert!(run(&mut dialog, "O1 repeat [2]").expect("open").is_empty());
        assert_eq!(run(&mut dialog, "G91 G0 X1").expect("a move").len(), 1);
        let paths = run(&mut dialog, "O1 endrepeat").expect("the second round");
        assert_eq!(paths.last().expect("a move").to[0], 2.0);
    }
}
