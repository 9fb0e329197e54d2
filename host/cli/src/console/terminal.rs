//! The terminal: taken over, drawn on, and given back on every way out.
//!
//! A thread draws, and waits for the terminal as long as it likes: only the newest picture counts. Another thread reads keys. [`restore`] may be
//! called by anybody at any time, more than once.

use super::view;
use super::view_model::ViewModel;
use crate::commands::{CliError, Exit};
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{
    self, DisableBracketedPaste, DisableFocusChange, EnableBracketedPaste, EnableFocusChange,
    Event, KeyboardEnhancementFlags, PopKeyboardEnhancementFlags, PushKeyboardEnhancementFlags,
};
use ratatui::crossterm::terminal::{
    Clear, ClearType, EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode,
    enable_raw_mode, supports_keyboard_enhancement,
};
use ratatui::crossterm::{cursor, execute};
use std::io::{IsTerminal, stdin, stdout};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The terminal is ours.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The terminal was asked to tell of releases.
static ENHANCED: AtomicBool = AtomicBool::new(false);

/// Least time between two pictures: 30 a second.
const FRAME: Duration = Duration::from_millis(33);

/// A picture is drawn so often even when nothing new came.
const IDLE_FRAME: Duration = Duration::from_millis(250);

/// While the terminal is asked it is looked at so often.
const QUERY_POLL: Duration = Duration::from_millis(20);

/// How long the last picture may take when the console is left.
const LAST_FRAME: Duration = Duration::from_millis(300);

/// Gives the terminal back as it was. Errors are not told: there is nobody left to tell.
pub(super) fn restore() {
    if !TAKEN.swap(false, Ordering::SeqCst) {
        return;
    }
    let _ = disable_raw_mode();
    if ENHANCED.swap(false, Ordering::SeqCst) {
        let _ = execute!(stdout(), PopKeyboardEnhancementFlags);
    }
    let _ = execute!(
        stdout(),
        DisableFocusChange,
        DisableBracketedPaste,
        LeaveAlternateScreen,
        cursor::Show
    );
}

/// Checks that there is a terminal, for keys and for the picture.
///
/// # Errors
/// There is none.
pub(super) fn check() -> Result<(), CliError> {
    for (is, which) in [
        (stdin().is_terminal(), "standard input"),
        (stdout().is_terminal(), "standard output"),
    ] {
        if !is {
            let what = format!(
                "console: {which} is not a terminal; run it in one (over ssh with `ssh -t`). For scripts there are `haptimill status`, `jog`, `run` with --json"
            );
            return Err(CliError::new(Exit::Usage, what));
        }
    }
    Ok(())
}

/// Takes the terminal over. When it hangs up meanwhile, or `is_cancelled` says that nobody wants it any more, it is taken as far as it was.
///
/// # Errors
/// The system does not let it.
pub(super) fn take(is_cancelled: &dyn Fn() -> bool) -> Result<(), CliError> {
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        restore();
        before(panic);
    }));
    prepare(is_cancelled).map_err(|error| {
        restore();
        if is_hung_up() {
            return CliError::new(Exit::Stopped, "the terminal is gone; nothing moved");
        }
        CliError::new(Exit::Usage, format!("console: the terminal: {error}"))
    })
}

fn prepare(is_cancelled: &dyn Fn() -> bool) -> std::io::Result<()> {
    enable_raw_mode()?;
    TAKEN.store(true, Ordering::SeqCst);
    execute!(
        stdout(),
        EnterAlternateScreen,
        // Not by ratatui: it would ask the terminal where its cursor is, and wait.
        Clear(ClearType::All),
        EnableBracketedPaste,
        EnableFocusChange
    )?;
    if reports_releases(is_cancelled) {
        let flags = KeyboardEnhancementFlags::DISAMBIGUATE_ESCAPE_CODES
            | KeyboardEnhancementFlags::REPORT_EVENT_TYPES;
        execute!(stdout(), PushKeyboardEnhancementFlags(flags))?;
        ENHANCED.store(true, Ordering::SeqCst);
    }
    Ok(())
}

/// Asks the terminal whether it tells of releases; one that answers nothing at all costs two seconds.
fn reports_releases(is_cancelled: &dyn Fn() -> bool) -> bool {
    let (sender, answer) = mpsc::channel();
    // In a thread of its own: crossterm reads a terminal that has hung up again and again, for ever.
    std::thread::spawn(move || sender.send(supports_keyboard_enhancement().unwrap_or(false)));
    loop {
        match answer.recv_timeout(QUERY_POLL) {
            Ok(reports) => return reports,
            Err(RecvTimeoutError::Timeout) if !is_cancelled() && !is_hung_up() => {}
            Err(_) => return false,
        }
    }
}

/// Reads keys until the terminal is gone.
pub(super) fn spawn_reader(events: Sender<Option<Event>>) {
    std::thread::spawn(move || {
        while let Ok(event) = event::read() {
            if events.send(Some(event)).is_err() {
                return;
            }
        }
        let _ = events.send(None);
    });
}

/// Whether the terminal has hung up.
pub(super) fn is_hung_up() -> bool {
    #[cfg(unix)]
    {
        use rustix::event::{PollFd, PollFlags, Timespec, poll};
        let input = stdin();
        let mut fds = [PollFd::new(&input, PollFlags::empty())];
        let now = Timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        matches!(poll(&mut fds, Some(&now)), Ok(1..))
            && fds[0]
                .revents()
                .intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL)
    }
    #[cfg(not(unix))]
    false
}

#[derive(Default)]
struct Shared {
    newest: Mutex<(Option<Box<ViewModel>>, bool)>,
    changed: Condvar,
}

/// Draws, in a thread of its own.
pub(super) struct Renderer {
    shared: Arc<Shared>,
    thread: JoinHandle<std::io::Result<()>>,
}

impl Renderer {
    /// Begins. The terminal must be taken.
    pub(super) fn begin() -> Self {
        let shared = Arc::new(Shared::default());
        let source = Arc::clone(&shared);
        let thread = std::thread::spawn(move || render(&source));
        Self { shared, thread }
    }

    /// Shows this next. Never waits for the terminal.
    pub(super) fn show(&self, view: ViewModel) {
        if let Ok(mut newest) = self.shared.newest.lock() {
            newest.0 = Some(Box::new(view));
        }
        self.shared.changed.notify_one();
    }

    /// The painter ended by itself: the terminal takes no more, or a defect.
    pub(super) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Ends, after the last picture. False when the terminal is stuck: whoever writes to it would wait for ever.
    pub(super) fn end(self) -> bool {
        if let Ok(mut newest) = self.shared.newest.lock() {
            newest.1 = true;
        }
        self.shared.changed.notify_one();
        let until = Instant::now() + LAST_FRAME;
        while !self.thread.is_finished() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
        let has_ended = self.thread.is_finished();
        if !has_ended {
            // The mode of the terminal can be set all the same.
            TAKEN.store(false, Ordering::SeqCst);
            let _ = disable_raw_mode();
        }
        has_ended
    }
}

fn render(shared: &Shared) -> std::io::Result<()> {
    let mut terminal = Terminal::new(CrosstermBackend::new(stdout()))?;
    let mut last: Option<Box<ViewModel>> = None;
    loop {
        let begun = Instant::now();
        let end = {
            let Ok(newest) = shared.newest.lock() else {
                return Ok(());
            };
            let waited = shared
                .changed
                .wait_timeout_while(newest, IDLE_FRAME, |(view, end)| view.is_none() && !*end);
            let Ok((mut newest, _)) = waited else {
                return Ok(());
            };
            if let Some(view) = newest.0.take() {
                last = Some(view);
            }
            newest.1
        };
        // After a restore, by a defect elsewhere, the screen is not ours any more.
        if !TAKEN.load(Ordering::SeqCst) {
            return Ok(());
        }
        if let Some(view) = &last {
            terminal.draw(|frame| view::draw(frame, view))?;
        }
        if end {
            return Ok(());
        }
        std::thread::sleep(FRAME.saturating_sub(begun.elapsed()));
    }
}
