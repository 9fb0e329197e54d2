//! Lines of the operator, read in a thread: the session goes on meanwhile.

use crate::commands::{CliError, Exit};
use haptimill_client::session::{Line, Session};
use rustyline::error::ReadlineError;
use rustyline::{Config, DefaultEditor};
use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::sync::mpsc::{self, Receiver, Sender, TryRecvError};

/// Lines that the history keeps.
const HISTORY_LINES: usize = 1000;

/// What the thread read.
enum Answer {
    Line(String),
    /// Ctrl-C in the line editor: the line is cleared.
    Cleared,
    End,
    Failed(String),
}

/// Standard input: a line editor on a terminal, else lines.
pub(crate) struct Input {
    prompts: Sender<String>,
    answers: Receiver<Answer>,
    is_terminal: bool,
    #[cfg(unix)]
    settings: Option<rustix::termios::Termios>,
}

impl Input {
    /// A prompt with history.
    pub(crate) fn prompt() -> Self {
        Self::new(true)
    }

    /// Answers to questions; no line enters the history.
    pub(crate) fn terminal() -> Self {
        Self::new(false)
    }

    fn new(with_history: bool) -> Self {
        let is_terminal = std::io::stdin().is_terminal();
        let (prompts, asked) = mpsc::channel::<String>();
        let (sender, answers) = mpsc::channel();
        std::thread::spawn(move || {
            let mut editor = is_terminal.then(|| Editor::open(with_history)).flatten();
            while let Ok(prompt) = asked.recv() {
                let answer = match &mut editor {
                    Some(editor) => editor.read(&prompt),
                    None => read_plain(&prompt, is_terminal),
                };
                if sender.send(answer).is_err() {
                    return;
                }
            }
        });
        Self {
            prompts,
            answers,
            is_terminal,
            #[cfg(unix)]
            settings: rustix::termios::tcgetattr(std::io::stdin())
                .ok()
                .filter(|_| is_terminal),
        }
    }

    /// Whether an operator sits in front of it.
    pub(crate) const fn is_terminal(&self) -> bool {
        self.is_terminal
    }

    /// Asks a question; [`Input::is_answered`] reports its answer.
    pub(crate) fn ask(&self, question: &str) {
        // A thread that has ended closes the channel of the answers, too.
        let _ = self.prompts.send(question.to_string());
    }

    /// Whether the last question is answered.
    pub(crate) fn is_answered(&self) -> bool {
        !matches!(self.answers.try_recv(), Err(TryRecvError::Empty))
    }

    /// Reads a line, and steps the session meanwhile; `None` at the end.
    ///
    /// # Errors
    /// The session ended, or standard input cannot be read.
    pub(crate) fn line<L: Line>(
        &mut self,
        session: &mut Session<L>,
        prompt: &str,
    ) -> Result<Option<String>, CliError> {
        self.ask(prompt);
        loop {
            session.step()?;
            match self.answers.try_recv() {
                Ok(Answer::Line(line)) => return Ok(Some(line)),
                Ok(Answer::Cleared) => self.ask(prompt),
                Ok(Answer::End) | Err(TryRecvError::Disconnected) => return Ok(None),
                Ok(Answer::Failed(what)) => {
                    let what = format!("standard input: {what}");
                    return Err(CliError::new(Exit::BadInput, what));
                }
                Err(TryRecvError::Empty) => {}
            }
            if session.is_interrupted() {
                return Ok(None);
            }
        }
    }
}

impl Drop for Input {
    fn drop(&mut self) {
        // The session may end while the line editor has the terminal.
        #[cfg(unix)]
        if let Some(settings) = &self.settings {
            let now = rustix::termios::OptionalActions::Now;
            let _ = rustix::termios::tcsetattr(std::io::stdin(), now, settings);
        }
    }
}

/// Longest line of standard input, bytes: that of a part program.
const LONGEST_LINE: u64 = haptimill_gcode::LONGEST_LINE as u64;

fn read_plain(prompt: &str, is_terminal: bool) -> Answer {
    if is_terminal {
        eprint!("{prompt}");
        let _ = std::io::stderr().flush();
    }
    let mut line = Vec::new();
    let mut input = std::io::Read::take(std::io::stdin().lock(), LONGEST_LINE + 1);
    match input.read_until(b'\n', &mut line) {
        Ok(0) => Answer::End,
        Ok(_) if line.len() as u64 > LONGEST_LINE => {
            Answer::Failed(format!("a line of more than {LONGEST_LINE} bytes"))
        }
        Ok(_) => Answer::Line(String::from_utf8_lossy(&line).into_owned()),
        Err(error) => Answer::Failed(error.to_string()),
    }
}

/// A line editor with its history file.
struct Editor {
    editor: DefaultEditor,
    history: Option<PathBuf>,
}

impl Editor {
    fn open(with_history: bool) -> Option<Self> {
        let config = Config::builder()
            .max_history_size(HISTORY_LINES)
            .ok()?
            .auto_add_history(with_history)
            .build();
        let mut editor = DefaultEditor::with_config(config).ok()?;
        let history = history_path().filter(|_| with_history);
        if let Some(path) = &history {
            // The first session has no history yet.
            let _ = editor.load_history(path);
        }
        Some(Self { editor, history })
    }

    fn read(&mut self, prompt: &str) -> Answer {
        match self.editor.readline(prompt) {
            Ok(line) => {
                if let Some(path) = &self.history {
                    // A history that cannot be written is no reason to end a session.
                    let _ = self.editor.append_history(path);
                }
                Answer::Line(line)
            }
            Err(ReadlineError::Interrupted) => Answer::Cleared,
            Err(ReadlineError::Eof) => Answer::End,
            Err(error) => Answer::Failed(error.to_string()),
        }
    }
}

/// The file of the history; its folder exists afterwards.
fn history_path() -> Option<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    let state = variable("XDG_STATE_HOME").map(PathBuf::from).or_else(|| {
        let home = variable("HOME")?;
        Some(PathBuf::from(home).join(".local/state"))
    })?;
    let folder = state.join("haptimill");
    std::fs::create_dir_all(&folder).ok()?;
    Some(folder.join("mdi-history"))
}
