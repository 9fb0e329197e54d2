//! Keys of the simulated machine, `[plant]`.

/// The sections of this file.
pub const SECTIONS: &[crate::Section] = &[];
