//! Keys of the terminal while a program runs: single bytes, without Enter.

use crate::commands::interrupt;
use std::io::{IsTerminal as _, Read as _};
use std::sync::mpsc::{self, Receiver};

/// Whether a key holds the machine.
pub(super) const fn is_hold(key: u8) -> bool {
    matches!(key, b' ' | b'p')
}

/// Whether a key continues after a hold or a pause.
pub(super) const fn is_enter(key: u8) -> bool {
    matches!(key, b'\n' | b'\r')
}

/// The keys that were pressed. The terminal gets its settings back at the end.
pub(super) struct Keys {
    pressed: Receiver<u8>,
}

impl Keys {
    /// Reads single keys from the terminal; `None` without one.
    pub(super) fn open() -> Option<Self> {
        if !std::io::stdin().is_terminal() || !set_single_keys() {
            return None;
        }
        let (sender, pressed) = mpsc::channel();
        // Reading blocks, and the session must continue.
        std::thread::spawn(move || {
            let mut key = [0];
            while let Ok(1..) = std::io::stdin().lock().read(&mut key) {
                if sender.send(key[0]).is_err() {
                    return;
                }
            }
        });
        Some(Self { pressed })
    }

    /// Forgets the keys that were pressed.
    pub(super) fn clear(&mut self) {
        while self.pressed.try_recv().is_ok() {}
    }

    /// Takes the next key that was pressed.
    pub(super) fn next(&mut self) -> Option<u8> {
        self.pressed.try_recv().ok()
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        interrupt::restore_terminal();
    }
}

/// Switches line editing and echo off; Ctrl-C stays a signal.
#[cfg(unix)]
fn set_single_keys() -> bool {
    use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, tcgetattr, tcsetattr};
    let Ok(before) = tcgetattr(std::io::stdin()) else {
        return false;
    };
    let mut settings = before.clone();
    settings
        .local_modes
        .remove(LocalModes::ICANON | LocalModes::ECHO);
    settings.special_codes[SpecialCodeIndex::VMIN] = 1;
    settings.special_codes[SpecialCodeIndex::VTIME] = 0;
    interrupt::keep_terminal(before);
    tcsetattr(std::io::stdin(), OptionalActions::Now, &settings).is_ok()
}

#[cfg(not(unix))]
const fn set_single_keys() -> bool {
    false
}
