//! The reference H-4 machine as a configuration, which the checks on a chip use as well.
#![allow(unused_imports, reason = "each test binary uses a part")]

pub use haptimill_checks::reference::*;
