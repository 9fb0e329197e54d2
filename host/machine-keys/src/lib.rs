//! The table of the keys of machine files: unit, range, default and meaning of each key.
//!
//! The table is the only place that states them. The reader of machine files takes ranges and
//! messages from it, `haptimill machine init` the comments of its templates, `haptimill machine
//! keys` its output, and docs/machine-files.md its tables. A key is one line in [`controller`],
//! [`mod@named_io`], [`haptic`] or [`plant`]; its constant, such as
//! [`controller::planner::curvature_step`], is what the reader names.

pub mod controller;
pub mod haptic;
mod key;
pub mod named_io;
pub mod page;
pub mod plant;

pub use key::*;

/// All sections, in the order of a machine file. Sections of one path follow each other.
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

/// The keys of the section at a path without list indices, such as `joint.drive`; empty for a
/// section without keys in the table.
pub fn keys_of(path: &str) -> impl Iterator<Item = &'static Key> {
    sections()
        .filter(move |section| section.path == path)
        .flat_map(|section| section.keys)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn a_key_is_in_its_section_once_and_has_a_meaning() {
        for section in sections() {
            let mut seen = HashSet::new();
            for key in section.keys {
                let rotary = key
                    .rotary
                    .map(|(name, _)| name)
                    .filter(|name| *name != key.name);
                for name in [Some(key.name), rotary].into_iter().flatten() {
                    assert!(seen.insert(name), "[{}] {name}", section.path);
                }
                assert!(!key.meaning.is_empty(), "[{}] {}", section.path, key.name);
            }
        }
    }

    #[test]
    fn ranges_are_not_empty_and_defaults_are_within_them() {
        for section in sections() {
            for key in section.keys {
                let Values::Number { low, high, .. } = key.values else {
                    continue;
                };
                assert!(low < high, "[{}] {}", section.path, key.name);
                if let Default::Number(value) = key.default {
                    assert!(
                        (low..=high).contains(&value),
                        "[{}] {}",
                        section.path,
                        key.name
                    );
                }
            }
        }
    }

    #[test]
    fn a_condition_names_a_key_and_a_word_of_its_section() {
        for section in sections() {
            for key in section.keys {
                let Some((name, word)) = key.condition else {
                    continue;
                };
                let other = keys_of(section.path).find(|other| other.name == name);
                let values = other
                    .unwrap_or_else(|| panic!("[{}] {name}", section.path))
                    .values;
                if let Values::Word(words) = values {
                    assert!(words.contains(&word), "[{}] {name} = {word}", section.path);
                }
            }
        }
    }
}
