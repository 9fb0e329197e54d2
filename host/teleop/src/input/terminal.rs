//! The keyboard of a terminal, key by key.

use super::{Error, ErrorKind, Read, io};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};
use std::io::IsTerminal;

/// Standard input in single-key mode; dropping it restores the settings of the terminal.
pub struct Terminal {
    before: Termios,
}

impl Terminal {
    /// Switches the terminal to single keys; Ctrl-C keeps its meaning.
    ///
    /// # Errors
    /// Standard input is not a terminal.
    pub fn take() -> Result<Self, Error> {
        let stdin = io::stdin();
        if !stdin.is_terminal() {
            let what = "--master keyboard needs a terminal on standard input; \
                run it in one, or use --master sim, script:FILE or the port of an arm";
            return Err(Error::new(ErrorKind::Usage, what));
        }
        let failed = |error: rustix::io::Errno| {
            Error::new(ErrorKind::Usage, format!("the terminal: {error}"))
        };
        let before = tcgetattr(&stdin).map_err(failed)?;
        let mut raw = before.clone();
        raw.local_modes -= rustix::termios::LocalModes::ICANON | rustix::termios::LocalModes::ECHO;
        tcsetattr(&stdin, OptionalActions::Now, &raw).map_err(failed)?;
        Ok(Self { before })
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}

impl Read for Terminal {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let stdin = io::stdin();
        let mut ready = [PollFd::new(&stdin, PollFlags::IN)];
        let now = Timespec::default();
        if poll(&mut ready, Some(&now))? == 0 {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        // Not through the buffer of the standard library: `poll` does not see its content.
        Ok(rustix::io::read(&stdin, buffer)?)
    }
}
