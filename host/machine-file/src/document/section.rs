//! A table of a machine file; it records the requested keys, to find unknown ones.

mod numbers;
mod words;

pub use numbers::{Allowed, real, whole};

use super::{Document, MISSING, UNKNOWN};
use crate::likeness::nearest;
use crate::renamed::{new_name, remedy};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_keys::Key;
use std::cell::{Cell, RefCell};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table of the file.
pub struct Section<'d, 'i> {
    document: &'d Document<'i>,
    path: String,
    table: &'d DeTable<'i>,
    offset: usize,
    requested: RefCell<Vec<&'static str>>,
    /// Kind of the axis to which the section and those below it belong.
    kind: Cell<AxisKind>,
}

impl<'d, 'i> Section<'d, 'i> {
    /// Returns the root section.
    pub fn root(document: &'d Document<'i>, table: &'d DeTable<'i>) -> Self {
        Self {
            document,
            path: String::new(),
            table,
            offset: 0,
            requested: RefCell::default(),
            kind: Cell::new(AxisKind::Linear),
        }
    }

    /// Returns a key with the path of its section.
    pub fn path_of(&self, key: &str) -> String {
        match (self.path.is_empty(), key.is_empty()) {
            (true, _) => key.to_string(),
            (_, true) => self.path.clone(),
            _ => format!("{}.{key}", self.path),
        }
    }

    /// Reports a problem of a key at its value, or at the section if the key is absent or empty.
    pub fn report(&self, key: &str, what: impl Into<String>, remedy: impl Into<String>) {
        let offset = self
            .table
            .get(key)
            .map_or(self.offset, |value| value.span().start);
        self.document
            .report(offset, self.path_of(key), what, remedy);
    }

    /// Makes this the section of an axis: keys have the names and ranges of its kind.
    pub fn set_kind(&self, kind: AxisKind) {
        self.kind.set(kind);
    }

    /// Returns the key for the kind of the axis to which the section belongs.
    pub fn key(&self, key: Key) -> Key {
        key.of(self.kind.get())
    }

    /// As [`Document::forget_missing`].
    pub fn forget_missing(&self, key: &str) {
        self.document.forget_missing(key);
    }

    /// Whether a problem of such a key was reported, in this section or in another one.
    pub fn has_problem(&self, is_it: impl Fn(&str) -> bool) -> bool {
        self.document.has_problem(is_it)
    }

    /// As [`Self::report`], for a key of the table.
    pub fn refuse(&self, key: Key, what: impl Into<String>, remedy: impl Into<String>) {
        self.report(self.key(key).name, what, remedy);
    }

    fn get(&self, key: &'static str) -> Option<&'d Spanned<DeValue<'i>>> {
        let mut requested = self.requested.borrow_mut();
        if !requested.contains(&key) {
            requested.push(key);
        }
        self.table.get(key)
    }

    fn required(
        &self,
        key: &'static str,
        remedy: impl FnOnce() -> String,
    ) -> Option<&'d Spanned<DeValue<'i>>> {
        let value = self.get(key);
        if value.is_none() {
            self.report(key, MISSING, remedy());
        }
        value
    }

    fn wrong_type(&self, key: &str, value: &DeValue<'_>, expected: &str) {
        let what = format!("is {}, not {expected}", named_type(value));
        self.report(key, what, format!("write {expected}"));
    }

    /// Returns a section below this one; `None` after a report.
    pub fn section(&self, key: &'static str) -> Option<Section<'d, 'i>> {
        let remedy = || {
            let section = table_path(&self.path_of(key));
            match self.path.rsplit_once('[') {
                None => format!("add a section [{section}]"),
                Some(_) => format!(
                    "add a section [{section}] below its [[{}]]",
                    table_path(&self.path)
                ),
            }
        };
        let value = self.required(key, remedy)?;
        match value.get_ref() {
            DeValue::Table(table) => Some(Section {
                document: self.document,
                path: self.path_of(key),
                table,
                offset: value.span().start,
                requested: RefCell::default(),
                kind: self.kind.clone(),
            }),
            other => {
                self.wrong_type(key, other, "a section");
                None
            }
        }
    }

    /// Returns the sections of a list (`[[key]]`); empty after a report.
    pub fn list(&self, key: &'static str) -> Vec<Section<'d, 'i>> {
        let remedy = || format!("add sections [[{}]]", table_path(&self.path_of(key)));
        let Some(value) = self.required(key, remedy) else {
            return Vec::new();
        };
        let DeValue::Array(items) = value.get_ref() else {
            self.wrong_type(key, value.get_ref(), "a list of sections");
            return Vec::new();
        };
        let mut sections = Vec::new();
        for (index, item) in items.iter().enumerate() {
            let path = format!("{}[{}]", self.path_of(key), index + 1);
            match item.get_ref() {
                DeValue::Table(table) => sections.push(Section {
                    document: self.document,
                    path,
                    table,
                    offset: item.span().start,
                    requested: RefCell::default(),
                    kind: self.kind.clone(),
                }),
                other => {
                    let what = format!("is {}, not a section", named_type(other));
                    let remedy = format!("write [[{}]]", table_path(&self.path_of(key)));
                    self.document.report(item.span().start, path, what, remedy);
                }
            }
        }
        sections
    }

    /// Whether a key exists; marks it as known.
    pub fn has(&self, key: &'static str) -> bool {
        self.get(key).is_some()
    }

    /// Reports every key that was not requested.
    pub fn finish(&self) {
        let requested = self.requested.borrow();
        let path = table_path(&self.path);
        for key in self.table.keys() {
            let name: &str = key.get_ref();
            if requested.contains(&name) {
                continue;
            }
            let sections = self.document.sections.iter();
            let of_path = sections.filter(|section| section.path == path);
            let known = of_path.flat_map(|section| section.keys).find(|known| {
                known.name == name || known.rotary.is_some_and(|(rotary, _)| rotary == name)
            });
            let could_be = |key: &&&str| match self.table.get(**key).map(Spanned::get_ref) {
                // A list may have more entries.
                Some(value) => matches!(value, DeValue::Array(_)),
                None => true,
            };
            if let Some(new_name) = new_name(&path, name) {
                self.document.forget_missing(&self.path_of(new_name));
                let remedy = remedy(self.document.file, new_name);
                let offset = key.span().start;
                self.document
                    .report(offset, self.path_of(name), UNKNOWN, remedy);
                continue;
            }
            let others: Vec<&str> = requested.iter().filter(could_be).copied().collect();
            let remedy = match (nearest(name, &others), known.map(Key::applies)) {
                (Some(near), _) => {
                    // A misspelt key is one mistake.
                    self.document.forget_missing(&self.path_of(near));
                    format!("did you mean `{near}`?")
                }
                (_, Some(applies)) if !applies.is_empty() => {
                    format!("remove it; it applies to {applies}")
                }
                _ if others.is_empty() => "remove it; the section has all its keys".to_string(),
                _ => format!("remove it; other keys here are {}", others.join(", ")),
            };
            self.document
                .report(key.span().start, self.path_of(name), UNKNOWN, remedy);
        }
    }
}

/// Returns a path without list indices, as in the table of keys: `joint[2].law` is `joint.law`.
pub(super) fn table_path(path: &str) -> String {
    let parts = path.split('.').map(|part| part.split('[').next());
    parts.flatten().collect::<Vec<_>>().join(".")
}

fn named_type(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a section",
    }
}
