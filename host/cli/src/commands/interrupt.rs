//! Ctrl-C: the request to stop.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// The flag that Ctrl-C and SIGTERM set. The first call installs the handler.
///
/// A second Ctrl-C ends the process at once. The heartbeat timeout of the controller then stops the
/// machine along its path.
pub fn flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let shared = Arc::clone(&flag);
        let handler = move || {
            if shared.swap(true, Ordering::Relaxed) {
                restore_terminal();
                std::process::exit(i32::from(super::Exit::Stopped as u8));
            }
        };
        if let Err(error) = ctrlc::set_handler(handler) {
            eprintln!(
                "haptimill: Ctrl-C ends this process without a stop command, because its handler \
                 cannot be installed: {error}"
            );
        }
        flag
    })
    .clone()
}

/// Settings of the terminal before a command changed them.
#[cfg(unix)]
static TERMINAL: std::sync::Mutex<Option<rustix::termios::Termios>> = std::sync::Mutex::new(None);

/// Keeps the settings of the terminal for [`restore_terminal`].
#[cfg(unix)]
pub(super) fn keep_terminal(settings: rustix::termios::Termios) {
    if let Ok(mut kept) = TERMINAL.lock() {
        *kept = Some(settings);
    }
}

/// Gives the terminal the settings that were kept.
pub(super) fn restore_terminal() {
    #[cfg(unix)]
    if let Ok(mut kept) = TERMINAL.lock()
        && let Some(settings) = kept.take()
    {
        let now = rustix::termios::OptionalActions::Now;
        let _ = rustix::termios::tcsetattr(std::io::stdin(), now, &settings);
    }
}
