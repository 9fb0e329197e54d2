//! The tables of docs/safety.md and docs/protocol.md have a row for each fault, problem and command
//! of the protocol, and no other row.

use haptimill_protocol::force::ForceProblem;
use haptimill_protocol::haptic::MasterProblem;
use haptimill_protocol::message::{Command, Fault, HomingProblem, Report};
use postcard_schema::Schema;
use postcard_schema::schema::DataModelType;
use std::collections::BTreeSet;

const SAFETY: &str = include_str!("../../docs/safety.md");
const PROTOCOL: &str = include_str!("../../docs/protocol.md");

/// The names of the variants of a type.
fn variants<T: Schema>() -> BTreeSet<String> {
    let DataModelType::Enum(variants) = T::SCHEMA.ty else {
        panic!("{} is no enumeration", T::SCHEMA.name);
    };
    variants.iter().map(|it| it.name.to_string()).collect()
}

/// The text below a heading, up to the next one.
fn section<'a>(page: &'a str, heading: &str) -> &'a str {
    let start = page
        .find(&format!("\n{heading}\n"))
        .unwrap_or_else(|| panic!("no {heading}"));
    let text = &page[start + heading.len() + 2..];
    let lines = text.match_indices("\n#").map(|(at, _)| at);
    &text[..{ lines }.next().unwrap_or(text.len())]
}

/// The words in backticks of a text.
fn words(text: &str) -> impl Iterator<Item = String> {
    text.split('`').skip(1).step_by(2).map(str::to_string)
}

/// The words in backticks of the first column of the tables below a heading; each must be there
/// once.
fn rows(page: &str, heading: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for line in section(page, heading).lines() {
        let first = line
            .strip_prefix("| ")
            .and_then(|row| row.split(" |").next());
        for word in words(first.unwrap_or_default()) {
            assert!(found.insert(word.clone()), "{heading}: {word} comes twice");
        }
    }
    found
}

#[test]
fn the_tables_of_faults_list_each_fault_and_problem() {
    assert_eq!(rows(SAFETY, "## Faults"), variants::<Fault>());
    assert_eq!(rows(SAFETY, "### Force sensor"), variants::<ForceProblem>());
    assert_eq!(rows(SAFETY, "### Haptic arm"), variants::<MasterProblem>());
}

/// The row of `Homing` names the problems of switches.
#[test]
fn the_fault_of_homing_names_the_problems_of_switches() {
    let faults = section(SAFETY, "## Faults");
    let mut lines = faults.lines();
    let row = lines.find(|line| line.starts_with("| `Homing` |"));
    let cause = row.and_then(|row| row.split('|').nth(2)).expect("a cause");
    let named: BTreeSet<String> = words(cause).collect();
    let problems = variants::<HomingProblem>();
    assert!(named.is_subset(&problems), "{named:?}");
    let of_switches = problems.iter().filter(|problem| {
        ["Switch", "Limit"]
            .iter()
            .any(|part| problem.contains(part))
    });
    assert_eq!(of_switches.cloned().collect::<BTreeSet<_>>(), named);
}

#[test]
fn the_tables_of_messages_list_each_command_and_report() {
    assert_eq!(rows(PROTOCOL, "### Requests"), variants::<Command>());
    assert_eq!(rows(PROTOCOL, "### Reports"), variants::<Report>());
}
