//! The table of the keys of machine files: unit, range, default and meaning of each key.
//!
//! The table is the only place that states them. The reader of machine files takes ranges and
//! messages from it, `haptimill machine init` the comments of its templates, `haptimill machine
//! keys` its output, and docs/machine-files.md its tables. A key is one line in [`controller`],
//! [`mod@named_io`], [`haptic`] or [`plant`]; its constant, such as
//! [`controller::planner::curvature_step`], is what the reader names. The keys of a model are
//! beside its reader ([`model_keys!`], `host/machine-file/src/models/`).

pub mod controller;
pub mod haptic;
mod key;
pub mod named_io;
pub mod page;
pub mod plant;

pub use key::*;

/// The sections that do not belong to a model, in the order of a machine file. Sections of one path
/// follow each other.
pub fn sections() -> impl Iterator<Item = &'static Section> {
    [
        controller::SECTIONS,
        named_io::SECTIONS,
        haptic::SECTIONS,
        plant::SECTIONS,
    ]
    .into_iter()
    .flatten()
}
