//! The reference H-4 machine as a configuration, which the checks on a chip use as well.
pub use haptimill_checks::reference::*;
