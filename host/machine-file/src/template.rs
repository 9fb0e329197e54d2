//! Comments of a machine-file template: unit, range, default and meaning of each key, from the
//! table of keys.

use crate::keys::keys_of;
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_machine_keys::page::{COLUMNS, summary};
use haptimill_machine_keys::{Default, Key};
use std::collections::{HashMap, HashSet};

/// Writes a comment above each key of a machine file where the key first occurs, and the optional
/// keys that the file does not have as comments at the end of their section. The values stay.
#[must_use]
pub fn annotate(text: &str) -> String {
    let mut writer = Writer::default();
    for line in text.lines() {
        writer.line(line);
    }
    writer.end_section();
    let mut text = writer.text;
    text.push_str(&writer.gap);
    text
}

/// The template so far.
#[derive(Default)]
struct Writer {
    text: String,
    /// Blank lines and comments that belong to what comes next.
    gap: String,
    /// Path of the section.
    path: String,
    /// Keys of the section with their values.
    values: HashMap<String, String>,
    /// The section belongs to a rotary axis.
    kind: AxisKind,
    /// Keys with a comment, by path and name.
    explained: HashSet<(String, String)>,
}

impl Writer {
    fn line(&mut self, line: &str) {
        let content = line.trim();
        if content.is_empty() || content.starts_with('#') {
            self.push_gap(line);
        } else if content.starts_with('[') {
            self.end_section();
            let path: String = content.chars().take_while(|c| *c != '#').collect();
            self.path = path.trim().trim_matches(['[', ']']).to_string();
            self.values.clear();
            self.write_gap();
            self.push(line);
        } else {
            self.write_gap();
            if let Some((name, value)) = content.split_once('=') {
                self.key(name.trim(), value);
            }
            self.push(line);
        }
    }

    /// Explains a key that follows.
    fn key(&mut self, name: &str, value: &str) {
        let value = value.split('#').next().unwrap_or_default().trim();
        if name == "kind" && ["\"linear\"", "\"rotary\""].contains(&value) {
            self.kind = if value == "\"rotary\"" {
                AxisKind::Rotary
            } else {
                AxisKind::Linear
            };
        }
        self.values.insert(name.to_string(), value.to_string());
        let rows: Vec<&Key> = keys_of(&self.path).collect();
        let row = rows
            .iter()
            .map(|key| key.of(self.kind))
            .find(|key| key.name == name);
        if let Some(row) = row
            && self.explained.insert((self.path.clone(), name.to_string()))
        {
            self.comment(&explanation(&row));
        }
    }

    /// Lists the optional keys that the section does not have.
    fn end_section(&mut self) {
        let rows: Vec<&Key> = keys_of(&self.path).collect();
        let rows = rows.iter().map(|key| key.of(self.kind));
        let absent: Vec<Key> = rows
            .filter(|key| key.default != Default::Required && key.machines.is_empty())
            .filter(|key| !self.values.contains_key(key.name))
            .filter(|key| {
                let quoted = |word| format!("\"{word}\"");
                key.condition
                    .is_none_or(|(key, word)| self.values.get(key) == Some(&quoted(word)))
            })
            .collect();
        for key in absent {
            if self
                .explained
                .insert((self.path.clone(), key.name.to_string()))
            {
                self.comment(&explanation(&key));
                let default = match key.default {
                    Default::Number(_) => key.default_text().unwrap_or_default(),
                    // A description is a value where it is one of TOML.
                    Default::Text(text) if text.starts_with(['"', '[', '{', 't', 'f']) => {
                        text.to_string()
                    }
                    _ => "...".to_string(),
                };
                self.push(&format!("# {} = {default}", key.name));
            }
        }
    }

    fn push(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    fn push_gap(&mut self, line: &str) {
        self.gap.push_str(line);
        self.gap.push('\n');
    }

    fn write_gap(&mut self) {
        let gap = std::mem::take(&mut self.gap);
        self.text.push_str(&gap);
    }

    /// Writes a comment, broken at [`COLUMNS`].
    fn comment(&mut self, text: &str) {
        let mut line = String::from("#");
        for word in text.split_whitespace() {
            if line.len() + 1 + word.len() > COLUMNS {
                self.push(&line);
                line = String::from("#  ");
            }
            line.push(' ');
            line.push_str(word);
        }
        self.push(&line);
    }
}

/// Meaning, unit, range and default of a key.
fn explanation(key: &Key) -> String {
    format!("{}: {}", key.meaning, summary(key))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MachineFile;

    const MILL: &str = include_str!("../../../machines/mill3-servo.toml");

    #[test]
    fn each_key_is_explained_where_it_first_occurs() {
        let text = annotate(MILL);
        let rate = "# maximum rate: mm/s, 0.001 to 2000; at most the joint's where the coordinate is \
                    a joint, required\nrate_mm_s = 80.0\n";
        assert!(text.contains(rate), "{text}");
        assert_eq!(
            text.matches("# maximum rate: mm/s, 0.001 to 2000; at most")
                .count(),
            1
        );
        // An optional key that the file does not have.
        let role = "\"machine\", \"master\", default \"machine\"\n# role = \"machine\"\n";
        assert_eq!(text.matches(role).count(), 1, "{text}");
        let generated = text.lines().filter(|line| !MILL.contains(line));
        assert!(generated.clone().count() > 60);
        for line in generated {
            assert!(line.len() <= COLUMNS, "{line}");
        }
    }

    #[test]
    fn every_key_of_a_machine_has_a_comment() {
        for text in [MILL, crate::BUILT_IN, crate::MASTER] {
            let annotated = annotate(text);
            let mut before = "";
            let mut seen = HashSet::new();
            let mut section = "";
            for line in annotated.lines() {
                if line.starts_with('[') {
                    section = line.trim_matches(['[', ']']);
                }
                // An optional key that the first section of a list lacks is there as a comment.
                if let Some((key, _)) = line.split_once(" = ")
                    && seen.insert((section, key.trim_start_matches(['#', ' '])))
                    && !key.starts_with('#')
                {
                    // Inline tables have no rows of their own.
                    let is_known = before.starts_with('#') || ["encoder", "home"].contains(&key);
                    assert!(is_known, "[{section}] {key}");
                }
                before = line;
            }
        }
    }

    #[test]
    fn the_values_stay() {
        for text in [MILL, crate::BUILT_IN, crate::MASTER] {
            let machine = MachineFile::parse("machine.toml", text).unwrap();
            let annotated = MachineFile::parse("machine.toml", &annotate(text)).unwrap();
            assert_eq!(annotated.config, machine.config);
            let plant = |machine: &MachineFile| -> haptimill_hil_sim::config::PlantConfig {
                machine.plant().unwrap()
            };
            assert_eq!(plant(&annotated), plant(&machine));
        }
    }
}
