//! `haptimill run --stream`: the program is interpreted and planned while the machine runs it.
//!
//! One thread interprets, one plans, the session takes the setpoints; bounded queues connect them,
//! so that the memory does not grow with the program. In the simulator one thread does all of it. A
//! program that comes over standard input may come slower than the machine runs it: the planner
//! then ends the motion at standstill, and goes on with the next block.

use super::spool::Bytes;
use super::supply::{Shown, Supply};
use crate::commands::CliError;
use crate::commands::program::{PartProgram, Pause, Pauses};
use haptimill_client::client::{SetpointSource, Setpoints};
use haptimill_client::{Error, ErrorKind};
use haptimill_gcode::{Comment, Interpreter, Options, Refused, Step};
use haptimill_machine_file::model::Model;
use haptimill_planner::{Planner, Settings, SharedTrack};
use haptimill_protocol::message::Action;
use haptimill_protocol::setpoint::Setpoint;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TryRecvError};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::Poll;
use std::time::{Duration, Instant};

/// Steps between the interpreter and the planner.
const STEPS: usize = 256;

/// Comments that are kept for the pause in their block.
const COMMENTS: usize = 64;

/// Setpoints between the planner and the session.
const SETPOINTS: usize = 1024;

/// How long the machine may wait for setpoints before a part of the look-ahead is planned.
const HUNGER: Duration = Duration::from_millis(100);

/// Longest wait between two looks at the machine or at Ctrl-C.
const POLL: Duration = Duration::from_millis(20);

/// What the threads of a streamed program report.
#[derive(Debug, Default)]
struct Shared {
    /// The machine waits for setpoints since then.
    hungry_since: Option<Instant>,
    /// Why the program ended before its end.
    error: Option<CliError>,
    /// The program has ended, and whether nothing moved before.
    has_ended: bool,
    is_empty: bool,
    /// Names of the called files.
    called: Vec<String>,
}

/// A streamed program that runs.
#[derive(Debug, Clone)]
pub(super) struct StreamEnd(Arc<Mutex<Shared>>);

impl StreamEnd {
    fn lock(&self) -> std::sync::MutexGuard<'_, Shared> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether nothing moved before the end.
    pub(super) fn is_empty(&self) -> bool {
        self.lock().is_empty
    }

    /// Whether the program ended before its end.
    pub(super) fn has_error(&self) -> bool {
        self.lock().error.is_some()
    }

    /// Takes the reason why the program ended before its end.
    pub(super) fn take_error(&self) -> Option<CliError> {
        self.lock().error.take()
    }
}

/// How a program is streamed.
pub(super) struct StreamOptions {
    /// How it is read.
    pub(super) options: Options,
    /// Limits of the machine.
    pub(super) settings: Settings,
    /// The blocks may come slower than the machine runs them.
    pub(super) is_live: bool,
    /// The session waits for setpoints: the clock of a simulated machine then stands.
    pub(super) waits: bool,
    /// Nobody can end a pause.
    pub(super) refuses_pauses: bool,
    /// The program was checked from its start, and its notices were shown.
    pub(super) is_checked: bool,
    /// Prints a line for the operator.
    pub(super) print: Box<dyn Fn(&str) + Send>,
    /// Ctrl-C.
    pub(super) interrupted: Arc<AtomicBool>,
}

/// From the interpreter to the planner.
enum Item {
    Step(Box<Step>, Option<String>),
    Notice(String),
    /// The end, with the number of lines.
    End(u32),
    Error(CliError),
}

/// Begins to interpret and plan a program.
pub(super) fn start(
    program: &PartProgram,
    bytes: Bytes,
    model: Model,
    stream: StreamOptions,
) -> Supply {
    let track = SharedTrack::new(u32::from(stream.settings.period_us));
    let pauses = Pauses::default();
    let end = StreamEnd(Arc::default());
    let options = stream.options.clone();
    let new_planner = match stream.is_checked {
        true => Planner::of_checked,
        false => Planner::new,
    };
    let mut planner = new_planner(stream.options.start, stream.settings.clone(), model);
    planner.follow(&track);
    // In the simulator the source interprets and plans itself, so that the recording does not
    // depend on the timing of threads. Only blocks that may come late are read by one.
    let is_pulled = stream.waits && !stream.is_live;
    let interrupted = Arc::clone(&stream.interrupted);
    let waits = stream.waits;
    let planning = Planning {
        program: program.without_text(),
        planner,
        stream,
        pauses: pauses.clone(),
        waiting: VecDeque::new(),
        sent: 0,
        end: end.clone(),
    };
    let setpoints = if is_pulled {
        Setpoints::of(Pulled {
            reader: Reader::new(program.without_text(), bytes, &options),
            planning,
            has_begun: false,
            ready: VecDeque::new(),
            interrupted,
        })
    } else {
        let (to_planner, steps) = mpsc::sync_channel(STEPS);
        let (to_session, setpoints) = mpsc::sync_channel(SETPOINTS);
        let reader = program.without_text();
        let shared = end.clone();
        std::thread::spawn(move || {
            let mut reader = Reader::new(reader, bytes, &options);
            loop {
                let item = reader.next(&shared);
                let is_last = item.is_last();
                if to_planner.send(item).is_err() || is_last {
                    return;
                }
            }
        });
        std::thread::spawn(move || {
            let mut thread = PlanningThread {
                planning,
                to_session,
            };
            // The session has dropped the setpoints: the job was stopped.
            let _ = thread.run(&steps);
        });
        Setpoints::of(StreamSource {
            setpoints,
            end: end.clone(),
            waits,
            interrupted,
        })
    };
    Supply {
        setpoints,
        shown: Shown {
            track,
            pauses,
            times: None,
        },
        end: Some(end),
    }
}

impl Item {
    const fn is_last(&self) -> bool {
        matches!(self, Item::End(_) | Item::Error(_))
    }
}

/// Interprets a program.
struct Reader {
    program: PartProgram,
    interpreter: Interpreter<'static>,
    /// Notices and called files that were passed on.
    notices: usize,
    called: usize,
    /// The last comments, for pauses.
    comments: VecDeque<Comment>,
    waiting: VecDeque<Item>,
}

impl Reader {
    fn new(program: PartProgram, bytes: Bytes, options: &Options) -> Self {
        let mut interpreter = Interpreter::new(bytes, options);
        interpreter.keep_comments();
        Self {
            program,
            interpreter,
            notices: 0,
            called: 0,
            comments: VecDeque::new(),
            waiting: VecDeque::new(),
        }
    }

    fn next(&mut self, shared: &StreamEnd) -> Item {
        if let Some(item) = self.waiting.pop_front() {
            return item;
        }
        let interpreter = &mut self.interpreter;
        let step = interpreter.next();
        if interpreter.called().len() > self.called {
            self.called = interpreter.called().len();
            shared.lock().called = interpreter.called().to_vec();
        }
        self.comments.extend(interpreter.take_comments());
        let surplus = self.comments.len().saturating_sub(COMMENTS);
        self.comments.drain(..surplus);
        let new = &interpreter.notices()[self.notices..];
        self.notices += new.len();
        let notices = self.program.describe_notices(new, interpreter.called());
        self.waiting.extend(notices.into_iter().map(Item::Notice));
        self.waiting.push_back(match step {
            Some(Ok(step)) => {
                let comment = comment_at(&step, &self.comments);
                Item::Step(Box::new(step), comment)
            }
            Some(Err(problem)) => {
                let kind = ErrorKind::BadInput;
                Item::Error(self.program.refuse(kind, problem, interpreter.called()))
            }
            None => Item::End(interpreter.lines()),
        });
        self.next(shared)
    }
}

/// The comment in the block of a pause.
fn comment_at(step: &Step, comments: &VecDeque<Comment>) -> Option<String> {
    let place = step.place();
    let is_here = |it: &&Comment| it.place.line == place.line && it.place.file == place.file;
    let comment = comments.iter().find(is_here)?;
    crate::commands::program::comment_text(&comment.text)
}

/// The session is gone.
struct Gone;

/// Plans the steps of a program.
struct Planning {
    program: PartProgram,
    planner: Planner<Model>,
    stream: StreamOptions,
    pauses: Pauses,
    /// Pauses whose setpoints are not made.
    waiting: VecDeque<Pause>,
    /// Setpoints that are made.
    sent: u32,
    end: StreamEnd,
}

/// Plans in a thread.
struct PlanningThread {
    planning: Planning,
    to_session: SyncSender<Setpoint>,
}

impl PlanningThread {
    fn run(&mut self, steps: &Receiver<Item>) -> Result<(), Gone> {
        if self.planning.begin() {
            return Ok(());
        }
        loop {
            let item = self.next(steps)?;
            if self.planning.end.lock().error.is_some() {
                self.planning.finish(1);
                return self.send();
            }
            let Some(item) = item else {
                continue;
            };
            let has_ended = self.planning.take(item);
            self.send()?;
            if has_ended {
                return Ok(());
            }
        }
    }

    /// Takes the next item. Where blocks may come late, the look-ahead is planned when the machine
    /// waits for it.
    fn next(&mut self, steps: &Receiver<Item>) -> Result<Option<Item>, Gone> {
        let stream = &self.planning.stream;
        if !stream.is_live || stream.waits {
            return steps.recv().map(Some).map_err(|_| Gone);
        }
        let item = match steps.recv_timeout(POLL) {
            Ok(item) => Some(item),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return Err(Gone),
        };
        let hungry_since = self.planning.end.lock().hungry_since;
        if hungry_since.is_some_and(|since| since.elapsed() > HUNGER) {
            if let Err(problem) = self.planning.planner.hurry(item.is_none()) {
                self.planning.fail(problem);
            }
            self.send()?;
        }
        Ok(item)
    }

    /// Sends the setpoints that are made.
    fn send(&mut self) -> Result<(), Gone> {
        let to_session = &self.to_session;
        self.planning
            .pass_on(|setpoint| to_session.send(setpoint).map_err(|_| Gone))
    }
}

/// Interprets and plans when the session asks for a setpoint.
struct Pulled {
    reader: Reader,
    planning: Planning,
    has_begun: bool,
    ready: VecDeque<Setpoint>,
    interrupted: Arc<AtomicBool>,
}

impl SetpointSource for Pulled {
    fn next_setpoint(&mut self) -> Poll<Option<Setpoint>> {
        loop {
            if let Some(setpoint) = self.ready.pop_front() {
                return Poll::Ready(Some(setpoint));
            }
            if self.planning.has_ended() {
                return Poll::Ready(None);
            }
            if self.interrupted.load(Ordering::Relaxed) {
                return Poll::Pending;
            }
            if std::mem::replace(&mut self.has_begun, true) || !self.planning.begin() {
                let item = self.reader.next(&self.planning.end);
                self.planning.take(item);
            }
            let ready = &mut self.ready;
            let passed: Result<(), Gone> = self.planning.pass_on(|setpoint| {
                ready.push_back(setpoint);
                Ok(())
            });
            if passed.is_err() {
                return Poll::Ready(None);
            }
        }
    }
}

impl Planning {
    /// Checks the start; returns whether the program has ended there.
    fn begin(&mut self) -> bool {
        match self.planner.check_start() {
            Ok(()) => false,
            Err(problem) => {
                self.fail(problem);
                self.end.lock().has_ended = true;
                true
            }
        }
    }

    fn has_ended(&self) -> bool {
        self.end.lock().has_ended
    }

    /// Plans an item; returns whether the program has ended.
    fn take(&mut self, item: Item) -> bool {
        let result = match item {
            Item::Notice(text) => {
                self.show(&text);
                return false;
            }
            Item::Step(step, comment) => self.step(&step, comment),
            Item::End(lines) => {
                self.finish(lines);
                return true;
            }
            Item::Error(error) => {
                self.stop(error);
                self.finish(1);
                return true;
            }
        };
        if let Err(problem) = result {
            self.fail(problem);
            self.finish(1);
            return true;
        }
        false
    }

    fn step(
        &mut self,
        step: &Step,
        comment: Option<String>,
    ) -> Result<(), haptimill_gcode::Problem> {
        let pause = Pause::of(step, &self.end.lock().called, comment);
        if let Some(pause) = pause {
            if self.stream.refuses_pauses {
                return Err(haptimill_gcode::Problem {
                    place: step.place(),
                    what: "the program pauses here and standard input is no terminal to press \
                           Enter on"
                        .into(),
                    remedy: "run it from a file in a terminal, or with --skip-pauses".into(),
                });
            }
            self.waiting.push_back(pause);
        }
        self.planner.step(step)
    }

    /// Shows a notice of a program that was not checked.
    fn show(&self, text: &str) {
        if !self.stream.is_checked {
            (self.stream.print)(text);
        }
    }

    /// Notes an error of the planner.
    fn fail(&mut self, problem: haptimill_gcode::Problem) {
        let refused = Refused {
            file: self.program.file_name(),
            called: self.end.lock().called.clone(),
            problems: vec![problem],
            more: 0,
        };
        self.stop(Error::refused(ErrorKind::Refused, &refused).into());
    }

    /// Notes the first error.
    fn stop(&mut self, error: CliError) {
        self.end.lock().error.get_or_insert(error);
    }

    /// Ends the motion at standstill.
    fn finish(&mut self, line: u32) {
        if let Err(problem) = self.planner.finish(line) {
            self.fail(problem);
        }
        let figures = self.planner.figures();
        let mut end = self.end.lock();
        (end.is_empty, end.has_ended) = (figures.blocks == 0, true);
        drop(end);
        if let Some(text) = self.program.describe_slowed(&figures) {
            self.show(&text);
        }
    }

    /// Passes the setpoints on that are made.
    fn pass_on(&mut self, mut take: impl FnMut(Setpoint) -> Result<(), Gone>) -> Result<(), Gone> {
        for planned in self.planner.made() {
            if planned.setpoint.action == Action::Pause
                && let Some(pause) = self.waiting.pop_front()
            {
                self.pauses.add(self.sent, pause);
            }
            self.sent += 1;
            take(planned.setpoint)?;
        }
        Ok(())
    }
}

/// The setpoints of a streamed program.
struct StreamSource {
    setpoints: Receiver<Setpoint>,
    end: StreamEnd,
    waits: bool,
    interrupted: Arc<AtomicBool>,
}

impl SetpointSource for StreamSource {
    fn next_setpoint(&mut self) -> Poll<Option<Setpoint>> {
        if self.waits {
            loop {
                match self.setpoints.recv_timeout(POLL) {
                    Ok(setpoint) => return Poll::Ready(Some(setpoint)),
                    Err(RecvTimeoutError::Disconnected) => return Poll::Ready(None),
                    Err(RecvTimeoutError::Timeout) => {
                        if self.interrupted.load(Ordering::Relaxed) {
                            return Poll::Pending;
                        }
                    }
                }
            }
        }
        match self.setpoints.try_recv() {
            Ok(setpoint) => {
                self.end.lock().hungry_since = None;
                Poll::Ready(Some(setpoint))
            }
            Err(TryRecvError::Disconnected) => Poll::Ready(None),
            Err(TryRecvError::Empty) => {
                self.end
                    .lock()
                    .hungry_since
                    .get_or_insert_with(Instant::now);
                Poll::Pending
            }
        }
    }
}
