//! Format version of a machine file, and whether a text is a machine file at all.

use super::document::Document;
use super::keys::sections;
use toml::de::{DeTable, DeValue};

/// Format that this program reads. [`migrate`](super::migrate::migrate) writes it.
pub const FORMAT: u32 = 2;

/// Sections that every machine file but that of a master has.
const REQUIRED: [&str; 7] = [
    "kinematics",
    "pose",
    "joint",
    "planner",
    "stopping",
    "supervision",
    "homing",
];

/// Kind of a text, by its root keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Kind {
    /// A machine file of a format; a file without the key `format` has format 1.
    Machine(u32),
    /// Some optional sections of a machine file: their names.
    Fragment(Vec<String>),
    /// No machine file.
    Other,
}

/// Returns the kind of a text; `None` after a report of a format that is no number.
pub(super) fn kind(document: &Document<'_>, root: &DeTable<'_>) -> Option<Kind> {
    if let Some(value) = root.get("format") {
        let number = match value.get_ref() {
            DeValue::Integer(digits) => u32::from_str_radix(digits.as_str(), digits.radix()).ok(),
            _ => None,
        };
        return match number {
            Some(0) | None => {
                let what = "is not the number of a format";
                let remedy = format!("write `format = {FORMAT}`");
                document.report(value.span().start, "format", what, remedy);
                None
            }
            Some(number) => Some(Kind::Machine(number)),
        };
    }
    let has = |key: &str| root.contains_key(key);
    let required = REQUIRED.into_iter().filter(|section| has(section)).count();
    if has("name") || has("period_us") || required > REQUIRED.len() / 2 {
        return Some(Kind::Machine(1));
    }
    let known = root.keys().map(|key| key.get_ref().as_ref()).filter(|key| {
        sections()
            .iter()
            .any(|section| section.path.split('.').next() == Some(*key))
    });
    let names: Vec<String> = known.map(str::to_string).collect();
    Some(if names.is_empty() {
        Kind::Other
    } else {
        Kind::Fragment(names)
    })
}

/// Reports a text that is not a machine file of [`FORMAT`]; returns whether it is one.
pub(super) fn check(document: &Document<'_>, root: &DeTable<'_>, file: &str) -> bool {
    let offset = root.get("format").map_or(0, |value| value.span().start);
    match kind(document, root) {
        Some(Kind::Machine(FORMAT)) => return true,
        Some(Kind::Machine(format)) if format > FORMAT => document.report(
            offset,
            "format",
            format!("{format} is newer than this program, which reads format {FORMAT}"),
            "use a newer haptimill",
        ),
        Some(Kind::Machine(format)) => document.report(
            offset,
            "format",
            format!("the file has format {format}, this program reads format {FORMAT}"),
            format!("run `haptimill machine migrate {file}`"),
        ),
        Some(Kind::Fragment(names)) => {
            let names: Vec<_> = names.iter().map(|name| format!("[{name}]")).collect();
            let what = format!(
                "is a fragment of a machine file: it has {} only",
                names.join(", ")
            );
            document.report(offset, "", what, "append it to a machine file");
        }
        Some(Kind::Other) => document.report(
            offset,
            "",
            "is not a machine file: it has none of its keys and sections",
            "write one with `haptimill machine init NAME`",
        ),
        None => {}
    }
    false
}
