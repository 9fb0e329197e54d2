//! A machine file as a tree of sections. A section records the requested keys, to find unknown
//! ones.
//!
//! Reading does not stop at the first problem. A number that is missing or wrong is reported once
//! and read as NaN; later comparisons with NaN are false and report nothing. Callers must not use
//! any value unless [`Document::finish`] returns `Ok`.

use super::likeness::nearest;
use super::problem::{LISTED_PROBLEMS, Problem, Problems};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_keys::{Default as KeyDefault, Key, Section as KeySection, Values};
use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The text of a machine file, its lines, and the problems found so far.
pub struct Document<'i> {
    file: &'i str,
    text: &'i str,
    /// All sections of the kind of file, with their keys.
    sections: Vec<KeySection>,
    problems: RefCell<Vec<(usize, Problem)>>,
    /// Number of problems beyond [`KEPT_PROBLEMS`].
    more: Cell<usize>,
}

/// Largest number of problems that are kept. Each one costs a search for its line.
const KEPT_PROBLEMS: usize = 1000;

impl<'i> Document<'i> {
    /// Creates a document without problems. `sections` are those of the kind of file: they tell a
    /// key of another model or variant from an unknown one.
    pub fn new(file: &'i str, text: &'i str, sections: Vec<KeySection>) -> Self {
        Self {
            file,
            text,
            sections,
            problems: RefCell::default(),
            more: Cell::default(),
        }
    }

    /// Parses the text; `None` after a report.
    pub fn parse(&self) -> Option<Spanned<DeTable<'i>>> {
        let (root, errors) = DeTable::parse_recoverable(self.text);
        // One mistake, such as a misspelt [[joint]], can cause many equal errors.
        let mut counts: HashMap<&str, usize> = HashMap::new();
        for error in &errors {
            *counts.entry(error.message()).or_default() += 1;
        }
        for error in &errors {
            let message = error.message();
            // Only the first of equal errors is reported.
            let Some(count) = counts.remove(message) else {
                continue;
            };
            let offset = error.span().map_or(0, |span| span.start);
            let more = count - 1;
            let remedy = match more {
                0 => "correct the TOML".to_string(),
                _ => format!("correct the TOML ({more} more like this below)"),
            };
            self.report(offset, "", message.trim().replace('\n', ", "), remedy);
        }
        errors.is_empty().then_some(root)
    }

    /// Whether a problem of such a key was reported.
    pub fn has_problem(&self, is_it: impl Fn(&str) -> bool) -> bool {
        let problems = self.problems.borrow();
        problems.iter().any(|(_, problem)| is_it(&problem.key))
    }

    /// Reports a problem at a byte offset of the text.
    pub fn report(
        &self,
        offset: usize,
        key: impl Into<String>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        if self.problems.borrow().len() >= KEPT_PROBLEMS {
            self.more.set(self.more.get() + 1);
            return;
        }
        let (line, column) = position(self.text, offset);
        self.problems.borrow_mut().push((
            offset,
            Problem {
                file: self.file.to_string(),
                line,
                column,
                key: key.into(),
                what: what.into(),
                remedy: remedy.into(),
            },
        ));
    }

    /// Adds a problem that has its place.
    pub fn add(&self, problem: Problem) {
        let lines = self
            .text
            .split_inclusive('\n')
            .take(problem.line.saturating_sub(1));
        let offset = lines.map(str::len).sum::<usize>() + problem.column.saturating_sub(1);
        self.problems.borrow_mut().push((offset, problem));
    }

    /// Whether no problem was reported yet.
    pub fn is_valid(&self) -> bool {
        self.problems.borrow().is_empty()
    }

    /// Ends the document.
    ///
    /// # Errors
    ///
    /// Returns all reported problems.
    pub fn finish(self) -> Result<(), Problems> {
        if self.problems.borrow().is_empty() {
            return Ok(());
        }
        Err(self.into_problems())
    }

    /// Returns all reported problems in the order of the text.
    pub fn into_problems(self) -> Problems {
        let mut problems = self.problems.into_inner();
        problems.sort_by_key(|(offset, _)| *offset);
        let more = problems.len().saturating_sub(LISTED_PROBLEMS) + self.more.get();
        problems.truncate(LISTED_PROBLEMS);
        Problems(problems.into_iter().map(|(_, p)| p).collect(), more)
    }
}

/// Returns line and column (in characters) of a byte offset, both from 1.
pub fn position(text: &str, offset: usize) -> (usize, usize) {
    let bytes = &text.as_bytes()[..offset.min(text.len())];
    let line_start = bytes.iter().rposition(|b| *b == b'\n').map_or(0, |p| p + 1);
    let line = bytes.iter().filter(|b| **b == b'\n').count() + 1;
    // Counts the bytes that begin a character; an offset inside a character is valid, too.
    let begins = |b: &&u8| **b & 0xC0 != 0x80;
    (line, bytes[line_start..].iter().filter(begins).count() + 1)
}

/// Allowed values of a number.
#[derive(Debug, Clone, Copy)]
pub struct Allowed {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Unit, for the message.
    pub unit: &'static str,
    /// Whether only whole numbers are allowed.
    pub whole: bool,
    /// What to do about a number out of range instead of changing it; empty for nothing.
    pub beyond: &'static str,
}

impl Allowed {
    /// Allowed values of a key of the table for one kind of axis; all numbers where it has no
    /// range.
    fn of(key: Key) -> Self {
        match key.values {
            Values::Number {
                low,
                high,
                unit,
                whole,
                ..
            } => Self {
                low,
                high,
                unit,
                whole,
                beyond: key.beyond[0],
            },
            _ => real(f64::NEG_INFINITY, f64::INFINITY, ""),
        }
    }
}

/// Allows real numbers from `low` to `high`.
pub fn real(low: f64, high: f64, unit: &'static str) -> Allowed {
    Allowed {
        low,
        high,
        unit,
        whole: false,
        beyond: "",
    }
}

/// Allows whole numbers from `low` to `high`.
pub fn whole(low: u32, high: u32, unit: &'static str) -> Allowed {
    Allowed {
        low: f64::from(low),
        high: f64::from(high),
        unit,
        whole: true,
        beyond: "",
    }
}

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
            self.report(key, "is missing", remedy());
        }
        value
    }

    fn wrong_type(&self, key: &str, value: &DeValue<'_>, expected: &str) {
        let what = format!("is {}, not {expected}", named_type(value));
        self.report(key, what, format!("write {expected}"));
    }

    /// Reads a number by its row in the table of keys, or returns its default; NaN after a report
    /// and where the default is not a number.
    pub fn value(&self, key: Key) -> f64 {
        self.value_or(
            key,
            match key.default {
                KeyDefault::Number(default) => Some(default),
                KeyDefault::Required => None,
                KeyDefault::Text(_) | KeyDefault::Absent => Some(f64::NAN),
            },
        )
    }

    /// As [`Self::value`], with a default that depends on other values; `None` requires the key.
    pub fn value_or(&self, key: Key, default: Option<f64>) -> f64 {
        let key = self.key(key);
        if key.values == Values::Direction {
            return self.direction(key.name, default.unwrap_or(1.0));
        }
        let allowed = Allowed::of(key);
        match default {
            Some(default) => self.number_or(key.name, default, allowed),
            None => self.number(key.name, allowed),
        }
    }

    /// Reads a list of `N` numbers by its row in the table of keys; NaN after a report.
    pub fn values<const N: usize>(&self, key: Key) -> [f64; N] {
        let key = self.key(key);
        self.numbers(key.name, Allowed::of(key))
    }

    /// Reads a number; NaN after a report.
    pub fn number(&self, key: &'static str, allowed: Allowed) -> f64 {
        let remedy = || format!("add `{key} = ...`, {}", describe(allowed));
        self.required(key, remedy)
            .map_or(f64::NAN, |value| self.check(key, value, allowed))
    }

    /// Reads an optional number; NaN after a report.
    pub fn number_or(&self, key: &'static str, default: f64, allowed: Allowed) -> f64 {
        self.get(key)
            .map_or(default, |value| self.check(key, value, allowed))
    }

    fn check(&self, key: &'static str, value: &Spanned<DeValue<'i>>, allowed: Allowed) -> f64 {
        let number = match value.get_ref() {
            // A number beyond i128 is beyond every allowed range.
            DeValue::Integer(digits) => i128::from_str_radix(digits.as_str(), digits.radix())
                .map_or(f64::INFINITY, |n| n as f64),
            DeValue::Float(digits) => digits.as_str().parse().unwrap_or(f64::NAN),
            other => {
                self.wrong_type(key, other, "a number");
                return f64::NAN;
            }
        };
        let written = self.document.text.get(value.span()).unwrap_or("the value");
        if !number.is_finite() {
            let what = format!("`{written}` is not a finite number");
            self.report(key, what, format!("write a number, {}", describe(allowed)));
        } else if number < allowed.low || number > allowed.high {
            let what = format!("{written} is out of range, {}", describe(allowed));
            let remedy = if number < allowed.low {
                "raise"
            } else {
                "lower"
            };
            let remedy = match allowed.beyond {
                "" => format!("{remedy} it"),
                beyond => format!("{remedy} it, or {beyond}"),
            };
            self.report(key, what, remedy);
        } else if allowed.whole && number.fract() != 0.0 {
            let what = format!("{written} is not a whole number, {}", describe(allowed));
            self.report(key, what, "round it");
        } else {
            return number;
        }
        f64::NAN
    }

    /// Reads a list of `N` numbers; NaN after a report.
    pub fn numbers<const N: usize>(&self, key: &'static str, allowed: Allowed) -> [f64; N] {
        let remedy = || format!("add `{key} = [...]`, {N} numbers, {}", describe(allowed));
        match self.required(key, remedy).map(Spanned::get_ref) {
            Some(DeValue::Array(items)) if items.len() == N => {
                std::array::from_fn(|index| self.check(key, &items[index], allowed))
            }
            Some(DeValue::Array(items)) => {
                let what = format!("has {} numbers", items.len());
                self.report(key, what, format!("write {N}"));
                [f64::NAN; N]
            }
            Some(other) => {
                self.wrong_type(key, other, "a list of numbers");
                [f64::NAN; N]
            }
            None => [f64::NAN; N],
        }
    }

    /// Reads an optional list of `few` to `most` numbers, each in the range of the key `number`;
    /// empty where it is absent, or after a report.
    pub fn number_list(&self, key: Key, few: usize, most: usize, number: Key) -> Vec<f64> {
        let (key, allowed) = (self.key(key).name, Allowed::of(self.key(number)));
        let Some(value) = self.get(key) else {
            return Vec::new();
        };
        let DeValue::Array(items) = value.get_ref() else {
            self.wrong_type(key, value.get_ref(), "a list of numbers");
            return Vec::new();
        };
        if !(few..=most).contains(&items.len()) {
            let what = format!("has {} numbers", items.len());
            self.report(key, what, format!("write {few} to {most}"));
            return Vec::new();
        }
        let numbers: Vec<f64> = items
            .iter()
            .map(|item| self.check(key, item, allowed))
            .collect();
        if numbers.iter().any(|number| number.is_nan()) {
            return Vec::new();
        }
        numbers
    }

    /// Reads a boolean; `None` after a report.
    pub fn flag(&self, key: &'static str) -> Option<bool> {
        let remedy = || format!("add `{key} = true` or `{key} = false`");
        match self.required(key, remedy)?.get_ref() {
            DeValue::Boolean(flag) => Some(*flag),
            other => {
                self.wrong_type(key, other, "true or false");
                None
            }
        }
    }

    /// Reads 1 or -1.
    fn direction(&self, key: &'static str, default: f64) -> f64 {
        let sign = self.number_or(key, default, real(-1.0, 1.0, ""));
        if sign.is_nan() || sign.abs() == 1.0 {
            return sign;
        }
        self.report(key, format!("{sign} is not a direction"), "write 1 or -1");
        f64::NAN
    }

    /// Reads a string that must not be empty; `None` after a report.
    pub fn text(&self, key: &'static str, remedy: &str) -> Option<&'d str> {
        let value = self.required(key, || remedy.to_string())?;
        match value.get_ref() {
            DeValue::String(text) if text.is_empty() => {
                self.report(key, "is empty", remedy);
                None
            }
            DeValue::String(text) => Some(text),
            other => {
                self.wrong_type(key, other, "a string");
                None
            }
        }
    }

    /// Returns a string if it exists, without a report; the key is not marked as known.
    pub fn peek_text(&self, key: &str) -> Option<&'d str> {
        match self.table.get(key)?.get_ref() {
            DeValue::String(text) => Some(text),
            _ => None,
        }
    }

    /// As [`Self::peek_text`], of a key of a section below this one.
    pub fn peek_text_of(&self, section: &str, key: &str) -> Option<&'d str> {
        match self.table.get(section)?.get_ref() {
            DeValue::Table(table) => match table.get(key)?.get_ref() {
                DeValue::String(text) => Some(text),
                _ => None,
            },
            _ => None,
        }
    }

    /// Reads one of several words; `None` after a report.
    pub fn choice<T: Copy>(&self, key: Key, choices: &[(&str, T)]) -> Option<T> {
        check_words(key, choices);
        let key = key.name;
        let words: Vec<String> = choices.iter().map(|(w, _)| format!("\"{w}\"")).collect();
        let remedy = format!("write {}", words.join(" or "));
        let text = self.text(key, &remedy)?;
        let found = choices.iter().find(|(word, _)| *word == text);
        if found.is_none() {
            self.report(key, format!("\"{text}\" is not known"), remedy);
        }
        found.map(|(_, value)| *value)
    }

    /// Reads an optional list of words, each at most once; without the words that were reported.
    pub fn words<T: Copy + PartialEq>(&self, key: Key, choices: &[(&str, T)]) -> Vec<T> {
        check_words(key, choices);
        let key = key.name;
        let Some(value) = self.get(key) else {
            return Vec::new();
        };
        let words: Vec<String> = choices.iter().map(|(w, _)| format!("\"{w}\"")).collect();
        let remedy = format!("write a list of {}", words.join(", "));
        let DeValue::Array(items) = value.get_ref() else {
            self.wrong_type(key, value.get_ref(), "a list");
            return Vec::new();
        };
        let mut found = Vec::new();
        for item in items.iter() {
            let word = match item.get_ref() {
                DeValue::String(word) => word,
                other => {
                    self.report(key, format!("has {}", named_type(other)), remedy.as_str());
                    continue;
                }
            };
            match choices.iter().find(|(choice, _)| *choice == *word) {
                None => self.report(key, format!("\"{word}\" is not known"), remedy.as_str()),
                Some((_, value)) if found.contains(value) => {
                    self.report(key, format!("\"{word}\" is a duplicate"), "remove one");
                }
                Some((_, value)) => found.push(*value),
            }
        }
        found
    }

    /// Returns a section below this one; `None` after a report.
    pub fn section(&self, key: &'static str) -> Option<Section<'d, 'i>> {
        let value = self.required(key, || format!("add a section [{}]", self.path_of(key)))?;
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
        let Some(value) = self.required(key, || format!("add sections [[{key}]]")) else {
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
                    let remedy = format!("write [[{key}]]");
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
            let others: Vec<&str> = requested.iter().filter(could_be).copied().collect();
            let remedy = match (nearest(name, &others), known.map(Key::applies)) {
                (Some(near), _) => format!("did you mean `{near}`?"),
                (_, Some(applies)) if !applies.is_empty() => {
                    format!("remove it; it applies to {applies}")
                }
                _ if others.is_empty() => "remove it; the section has all its keys".to_string(),
                _ => format!("remove it; other keys here are {}", others.join(", ")),
            };
            self.document.report(
                key.span().start,
                self.path_of(name),
                "is not a known key",
                remedy,
            );
        }
    }
}

/// Returns a path without list indices, as in the table of keys: `joint[2].law` is `joint.law`.
fn table_path(path: &str) -> String {
    let parts = path.split('.').map(|part| part.split('[').next());
    parts.flatten().collect::<Vec<_>>().join(".")
}

/// Words of the reader and of the table are the same; a test that reads the key sees a difference.
fn check_words<T>(key: Key, choices: &[(&str, T)]) {
    if let Values::Word(words) | Values::Words(words) = key.values {
        let read = choices.iter().map(|(word, _)| *word);
        debug_assert!(read.eq(words.iter().copied()), "{}", key.name);
    }
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

fn describe(allowed: Allowed) -> String {
    let Allowed {
        low, high, unit, ..
    } = allowed;
    let space = if unit.is_empty() { "" } else { " " };
    format!("allowed is {low} to {high}{space}{unit}")
}
