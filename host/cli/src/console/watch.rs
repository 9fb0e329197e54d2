//! `haptimill watch --screen`: a screen without commands.

use super::terminal;
use super::view::watched::{Watched, draw};
use crate::commands::exit::{CliError, Exit};
use crate::commands::interrupt;
use crate::commands::watch::Reports;
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{Event, KeyCode, KeyModifiers};
use std::io::stdout;
use std::sync::atomic::Ordering;
use std::sync::mpsc;

/// Shows reports until the run ends, or until q or Ctrl-C; returns whether the run has ended.
///
/// # Errors
/// There is no terminal, or the address serves no run.
pub(crate) fn run(reports: &mut Reports, address: &str) -> Result<bool, CliError> {
    terminal::require_terminal("watch --screen", "watch without --screen")?;
    let interrupted = interrupt::flag();
    terminal::take_over(&|| interrupted.load(Ordering::Relaxed))?;
    let ended = show(reports, address, &|| interrupted.load(Ordering::Relaxed));
    terminal::restore();
    ended
}

fn show(
    reports: &mut Reports,
    address: &str,
    is_interrupted: &dyn Fn() -> bool,
) -> Result<bool, CliError> {
    let (sender, keys) = mpsc::channel();
    terminal::spawn_reader(sender);
    let failed = |error| CliError::new(Exit::Usage, format!("watch: the terminal: {error}"));
    let mut screen = Terminal::new(CrosstermBackend::new(stdout())).map_err(failed)?;
    let mut watched = Watched::new(address.to_string());
    while !is_interrupted() {
        for key in keys.try_iter() {
            let quits = match key {
                Some(Event::Key(key)) => {
                    let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
                    key.code == KeyCode::Char('q') || (key.code == KeyCode::Char('c') && is_control)
                }
                Some(_) => false,
                // The terminal is closed.
                None => true,
            };
            if quits {
                return Ok(false);
            }
        }
        let Some(lines) = reports.next()? else {
            return Ok(true);
        };
        for line in lines {
            watched.take(&line);
        }
        screen.draw(|frame| draw(frame, &watched)).map_err(failed)?;
    }
    Ok(false)
}
