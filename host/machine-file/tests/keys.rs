//! Properties of the table of keys, and its pages.

use haptimill_machine_file::keys::{axes_of, keys_of, sections};
use haptimill_machine_keys::page::{missing, rewrite};
use haptimill_machine_keys::{Default, Values};
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

/// `cargo xtask keys` rewrites the page.
/// A reader writes the `[[pose]]` and `[[joint]]` of a new file in the order of the sentence.
#[test]
fn the_axes_of_a_model_are_listed_in_its_order() {
    for machine in haptimill_kinematics::DESCRIPTORS {
        let sentence = axes_of(machine.code);
        let (pose, joints) = sentence.split_once("Joints: ").expect("two lists");
        let places = |text: &str, names: &[&str]| -> Vec<Option<usize>> {
            let marks = |it: char| !it.is_alphanumeric() && it != '_';
            let words: Vec<&str> = text.split(marks).collect();
            let place = |name: &&str| words.iter().position(|word| word == name);
            names.iter().map(place).collect()
        };
        let names: Vec<_> = machine.pose.iter().map(|it| it.name).collect();
        let found = places(pose, &names);
        assert!(
            found.iter().all(Option::is_some) && found.is_sorted(),
            "{sentence}"
        );
        let names: Vec<_> = machine.joints.iter().map(|it| it.name).collect();
        let found = places(joints, &names);
        assert!(
            found.iter().all(Option::is_some) && found.is_sorted(),
            "{sentence}"
        );
    }
}

/// The first table of the page names each file of the folder.
#[test]
fn the_page_of_machine_files_lists_the_folder() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let page = std::fs::read_to_string(format!("{root}/docs/machine-files.md")).expect("the page");
    let folder = std::fs::read_dir(format!("{root}/machines")).expect("the folder");
    for entry in folder {
        let name = entry.expect("an entry").file_name();
        let row = format!("| `{}` |", name.to_str().expect("a name"));
        assert!(
            page.contains(&row),
            "docs/machine-files.md has no row {row}"
        );
    }
}

#[test]
fn the_page_of_machine_files_has_the_tables() {
    let page = include_str!("../../../docs/machine-files.md");
    let sections = sections();
    assert_eq!(missing(page, &sections), Vec::<&str>::new());
    assert!(
        rewrite(page, &sections, axes_of).unwrap() == page,
        "docs/machine-files.md differs from the table of keys; run `cargo xtask keys`"
    );
}
