//! Ctrl-C: the wish that everything stops.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// The flag that Ctrl-C (or a request of the system to end) sets; the handler is put in place at the first call. A second Ctrl-C ends
/// the process at once: the controller then notices the silence and stops the machine along its path.
pub fn flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&flag);
        let handler = move || {
            if seen.swap(true, Ordering::Relaxed) {
                std::process::exit(i32::from(super::Exit::Stopped as u8));
            }
        };
        if let Err(error) = ctrlc::set_handler(handler) {
            eprintln!("haptimill: Ctrl-C will end this process without stopping first: {error}");
        }
        flag
    })
    .clone()
}
