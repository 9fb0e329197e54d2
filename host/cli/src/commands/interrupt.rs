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
