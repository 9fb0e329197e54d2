//! Set-up, drawing and restoration of the terminal.
//!
//! One thread draws and may block on the terminal; only the newest view model counts. Another
//! thread reads keys. [`restore`] may be called from any thread at any time, repeatedly.

use super::view;
use super::view_model::ViewModel;
use crate::commands::exit::{CliError, Exit};
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

/// The terminal is in raw mode with the alternate screen.
static ACTIVE: AtomicBool = AtomicBool::new(false);

/// The terminal reports key releases.
static ENHANCED: AtomicBool = AtomicBool::new(false);

/// Shortest frame period: 30 frames per second.
const FRAME: Duration = Duration::from_millis(33);

/// Frame period without a new view model.
const IDLE_FRAME: Duration = Duration::from_millis(250);

/// Poll period during the query of the terminal.
const QUERY_POLL: Duration = Duration::from_millis(20);

/// Longest wait for the last frame on exit.
const LAST_FRAME: Duration = Duration::from_millis(300);

/// Restores the terminal. Errors are ignored: there is no terminal left to report them on.
pub(super) fn restore() {
    if !ACTIVE.swap(false, Ordering::SeqCst) {
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

/// Checks that standard input and output are a terminal. The error names the command, and what is
/// there for scripts.
///
/// # Errors
/// One of them is none.
pub(super) fn require_terminal(command: &str, for_scripts: &str) -> Result<(), CliError> {
    for (is_terminal, stream) in [
        (stdin().is_terminal(), "standard input"),
        (stdout().is_terminal(), "standard output"),
    ] {
        if !is_terminal {
            let message = format!(
                "{command}: {stream} is not a terminal; run it in one (over ssh with `ssh -t`). \
                 For scripts use {for_scripts}"
            );
            return Err(CliError::new(Exit::Usage, message));
        }
    }
    Ok(())
}

/// Takes over the terminal. A hang-up or `is_cancelled` ends the set-up early, without an error.
///
/// # Errors
/// The system refuses.
pub(super) fn take_over(is_cancelled: &dyn Fn() -> bool) -> Result<(), CliError> {
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        restore();
        before(panic);
    }));
    set_up(is_cancelled).map_err(|error| {
        restore();
        if is_hung_up() {
            return CliError::new(
                Exit::Stopped,
                "the terminal is closed; the machine did not move",
            );
        }
        CliError::new(Exit::Usage, format!("console: the terminal: {error}"))
    })
}

fn set_up(is_cancelled: &dyn Fn() -> bool) -> std::io::Result<()> {
    enable_raw_mode()?;
    ACTIVE.store(true, Ordering::SeqCst);
    execute!(
        stdout(),
        EnterAlternateScreen,
        // ratatui would query the cursor position, and block.
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

/// Queries whether the terminal reports releases. A terminal without an answer costs two seconds.
fn reports_releases(is_cancelled: &dyn Fn() -> bool) -> bool {
    let (sender, answer) = mpsc::channel();
    // In a thread, since crossterm reads a terminal that has hung up in an endless loop.
    std::thread::spawn(move || sender.send(supports_keyboard_enhancement().unwrap_or(false)));
    loop {
        match answer.recv_timeout(QUERY_POLL) {
            Ok(reports) => return reports,
            Err(RecvTimeoutError::Timeout) if !is_cancelled() && !is_hung_up() => {}
            Err(_) => return false,
        }
    }
}

/// Reads keys in a thread until the terminal is closed.
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

/// Returns true when the terminal has hung up.
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

/// Draws in a thread.
pub(super) struct Renderer {
    shared: Arc<Shared>,
    thread: JoinHandle<std::io::Result<()>>,
}

impl Renderer {
    /// Starts the thread. Callers must have taken over the terminal.
    pub(super) fn spawn() -> Self {
        let shared = Arc::new(Shared::default());
        let source = Arc::clone(&shared);
        let thread = std::thread::spawn(move || render(&source));
        Self { shared, thread }
    }

    /// Replaces the view model to draw. Never blocks.
    pub(super) fn show(&self, view: ViewModel) {
        if let Ok(mut newest) = self.shared.newest.lock() {
            newest.0 = Some(Box::new(view));
        }
        self.shared.changed.notify_one();
    }

    /// The thread has ended by itself: the terminal accepts no output, or a defect.
    pub(super) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Ends the thread after the last frame. Returns false when the terminal is stuck: further
    /// output would block.
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
            // The mode of the terminal can be restored even if its output is stuck.
            ACTIVE.store(false, Ordering::SeqCst);
            let _ = disable_raw_mode();
        }
        has_ended
    }
}

fn render(shared: &Shared) -> std::io::Result<()> {
    let mut terminal = Terminal::new(CrosstermBackend::new(stdout()))?;
    let mut last: Option<Box<ViewModel>> = None;
    loop {
        let started = Instant::now();
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
        // A panic in another thread has restored the terminal.
        if !ACTIVE.load(Ordering::SeqCst) {
            return Ok(());
        }
        if let Some(view) = &last {
            terminal.draw(|frame| view::draw(frame, view))?;
        }
        if end {
            return Ok(());
        }
        std::thread::sleep(FRAME.saturating_sub(started.elapsed()));
    }
}
