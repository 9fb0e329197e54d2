//! Texts, words and booleans of a section.

use super::{Section, named_type};
use haptimill_machine_keys::{Key, Values};
use toml::de::DeValue;

impl<'d> Section<'d, '_> {
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
}

/// Words of the reader and of the table are the same; a test that reads the key sees a difference.
fn check_words<T>(key: Key, choices: &[(&str, T)]) {
    if let Values::Word(words) | Values::Words(words) = key.values {
        let read = choices.iter().map(|(word, _)| *word);
        debug_assert!(read.eq(words.iter().copied()), "{}", key.name);
    }
}
