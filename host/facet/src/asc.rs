//! GemCad ASCII files.
//!
//! ```text
//! GemCad 5.0
//! g 96 0.0                      teeth of the index wheel, position of azimuth 0
//! y 8 y                         order of the symmetry, mirror
//! I 1.54                        refractive index
//! H Title
//! a -41.0 0.95 3 n P1 9 15 G Cut to a point
//! a 0 0.4 96 n T
//! F Footnote
//! ```
//!
//! A line `a` is a tier: angle, distance, positions of the wheel. `n NAME` names the facet of the
//! position before it, and those after it up to the next name. `G` begins a note. A tier may go on
//! in the next line. A semicolon outside of a note begins a comment. A facet of angle 0 with a
//! negative distance is the culet, as is one of angle -0.

use crate::design::{Design, Position, RawTier};
use crate::problem::Problems;
use std::collections::BTreeMap;

/// Reads a file.
pub fn read(text: &str, problems: &mut Problems) -> Option<Design> {
    let mut reader = Reader {
        design: Design::empty(),
        tier: None,
        first: BTreeMap::new(),
        problems,
    };
    for (number, line) in text.lines().enumerate() {
        reader.line(number + 1, line.trim());
    }
    let ends_in_tier = reader.tier.is_some();
    reader.end_tier();
    let Reader {
        mut design, first, ..
    } = reader;
    if ends_in_tier {
        design.check_end(text, problems);
    }
    if !first.contains_key("g") {
        design.is_gear_refused = true;
        let what = "the index wheel is missing";
        problems.report(0, None, what, "write a line `g 96 0.0` before the facets");
    }
    if design.facets.is_empty() {
        problems.report(
            0,
            None,
            "the design has no facet",
            "write lines `a ANGLE DISTANCE INDEX`",
        );
    }
    Some(design)
}

struct Reader<'a> {
    design: Design,
    tier: Option<RawTier>,
    /// Lines of the settings, by keyword.
    first: BTreeMap<&'static str, usize>,
    problems: &'a mut Problems,
}

/// The keyword of a line and the rest; a number may follow the keyword without a space.
fn keyword(line: &str) -> (&str, &str) {
    let end = line.find(char::is_whitespace).unwrap_or(line.len());
    let (word, rest) = line.split_at(end);
    let mut letters = word.chars();
    let glued = letters.next().is_some_and(|first| "gyIa".contains(first))
        && letters
            .next()
            .is_some_and(|next| next.is_ascii_digit() || "+-.".contains(next));
    if glued {
        line.split_at(1)
    } else {
        (word, rest.trim_start())
    }
}

impl Reader<'_> {
    fn line(&mut self, number: usize, line: &str) {
        if line.is_empty() || line.starts_with(';') {
            return;
        }
        if line
            .get(..6)
            .is_some_and(|word| word.eq_ignore_ascii_case("gemcad"))
        {
            return;
        }
        let (word, rest) = keyword(line);
        match word {
            "g" => self.gear(number, rest),
            "y" => self.symmetry(number, rest),
            "I" => {
                if self.is_again(number, "I", "the refractive index") {
                    return;
                }
                let mut words = words(rest);
                if let Some(value) = self.number(number, words.next(), "I") {
                    let design = &mut self.design;
                    design.set_refractive_index(value, number, self.problems);
                }
                self.end(number, words.next(), "I");
            }
            "H" if self.design.title.is_empty() => self.design.title = rest.to_string(),
            "H" | "F" => {
                self.end_tier();
                self.design.remarks.push(rest.to_string());
            }
            "a" => {
                self.end_tier();
                let rest = without_comment(rest);
                let mut tokens = rest.split_whitespace();
                let angle = self.number(number, tokens.next(), "the angle of a facet");
                let distance = self.number(number, tokens.next(), "the distance of a facet");
                if let (Some(angle), Some(distance)) = (angle, distance) {
                    let is_culet = angle == 0.0 && distance < 0.0;
                    let (angle_deg, distance) = if is_culet {
                        (-0.0, -distance)
                    } else {
                        (angle, distance)
                    };
                    self.tier = Some(RawTier {
                        line: number,
                        angle_deg,
                        distance,
                        ..RawTier::default()
                    });
                    self.positions(number, after_words(rest, 2));
                }
            }
            "G" | "n" if self.tier.is_some() => self.positions(number, line),
            _ if self.tier.is_some()
                && word.starts_with(|first: char| first.is_ascii_digit() || first == '-') =>
            {
                self.positions(number, line);
            }
            _ => {
                let what = format!("\"{word}\" begins no line of a GemCad file");
                self.problems.report(
                    number,
                    None,
                    what,
                    "lines begin with g, y, I, H, a, F; a comment with a semicolon",
                );
            }
        }
    }

    /// Whether a setting is written again, which is reported. The second one would replace the
    /// first.
    fn is_again(&mut self, line: usize, key: &'static str, what: &str) -> bool {
        let Some(first) = self.first.get(key) else {
            self.first.insert(key, line);
            return false;
        };
        let what = format!("{what} is already in line {first}");
        let remedy = "write it once, before the facets: it holds for all of them";
        self.problems.report(line, None, what, remedy);
        true
    }

    fn gear(&mut self, line: usize, rest: &str) {
        if self.is_again(line, "g", "the index wheel") {
            return;
        }
        let mut words = words(rest);
        if !self.design.facets.is_empty() || self.tier.is_some() {
            let what = "the index wheel changes after a facet";
            self.problems
                .report(line, None, what, "write it once, before the facets");
            return;
        }
        if let Some(teeth) = self.number(line, words.next(), "g") {
            self.design.set_gear(teeth, line, self.problems);
        }
        if let Some(word) = words.next()
            && let Some(at) = self.number(line, Some(word), "g")
        {
            self.design.set_reference(at, line, self.problems);
        }
        self.end(line, words.next(), "g");
    }

    fn symmetry(&mut self, line: usize, rest: &str) {
        if self.is_again(line, "y", "the symmetry") {
            return;
        }
        let mut words = words(rest);
        let order = self.number(line, words.next(), "y");
        let mirror = match words.next() {
            None => false,
            Some("y" | "Y") => true,
            Some("n" | "N") => false,
            Some(word) => {
                let what = format!("\"{word}\" is neither y nor n for the mirror");
                self.problems
                    .report(line, None, what, "write a line as `y 8 y`");
                false
            }
        };
        if let Some(order) = order {
            self.design.set_symmetry(order, mirror, line, self.problems);
        }
        self.end(line, words.next(), "y");
    }

    /// Reports a further word of a line.
    fn end(&mut self, line: usize, word: Option<&str>, of: &str) {
        if let Some(word) = word {
            let what = format!("\"{word}\" is behind the end of line {of}");
            self.problems.report(
                line,
                None,
                what,
                "remove it, or begin a comment with a semicolon",
            );
        }
    }

    /// Reads positions, names and the note of the present tier.
    fn positions(&mut self, line: usize, text: &str) {
        let Some(mut tier) = self.tier.take() else {
            return;
        };
        let mut rest = without_comment(text).trim_start();
        while !rest.is_empty() {
            let word = rest.split_whitespace().next().unwrap_or_default();
            let after = rest[word.len()..].trim_start();
            match word {
                "G" => {
                    if !tier.note.is_empty() {
                        tier.note.push(' ');
                    }
                    tier.note.push_str(after.trim_end());
                    break;
                }
                "n" => {
                    let name = after.split_whitespace().next().unwrap_or_default();
                    match tier.indices.last_mut() {
                        Some(last) if !name.is_empty() => last.name = Some(name.to_string()),
                        _ => {
                            let what = "`n` names no facet";
                            self.problems.report(line, None, what, "write INDEX n NAME");
                        }
                    }
                    rest = after[name.len()..].trim_start();
                    continue;
                }
                _ => {
                    if let Some(index) = self.number(line, Some(word), "a position of the wheel") {
                        tier.indices.push(Position {
                            index,
                            name: None,
                            line,
                        });
                    }
                }
            }
            rest = after;
        }
        self.tier = Some(tier);
    }

    fn end_tier(&mut self) {
        let Some(mut tier) = self.tier.take() else {
            return;
        };
        if tier.indices.is_empty() {
            if tier.angle_deg != 0.0 {
                let what = "a facet has no position of the wheel";
                self.problems.report(
                    tier.line,
                    None,
                    what,
                    "write its indices after the distance",
                );
                return;
            }
            tier.indices.push(Position {
                index: 0.0,
                name: None,
                line: tier.line,
            });
        }
        let begins = |text: &str, with: &str| {
            text.get(..with.len())
                .is_some_and(|start| start.eq_ignore_ascii_case(with))
        };
        let named = tier.indices.iter().find_map(|at| at.name.as_deref());
        tier.preform =
            begins(&tier.note, "preform") || named.is_some_and(|name| begins(name, "pf"));
        self.design.add(tier, self.problems);
    }

    fn number(&mut self, line: usize, word: Option<&str>, of: &str) -> Option<f64> {
        let word = word.unwrap_or_default();
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Some(value),
            _ => {
                let what = format!("\"{word}\" is no number for {of}");
                self.problems
                    .report(line, None, what, "write a decimal number");
                None
            }
        }
    }
}

/// The words of a line before its comment.
fn words(text: &str) -> impl Iterator<Item = &str> {
    let comment = text.find(';').unwrap_or(text.len());
    text[..comment].split_whitespace()
}

/// A line of a tier without its comment. A semicolon in the note is part of the note, which `G`
/// begins if it is no name.
fn without_comment(text: &str) -> &str {
    let is_in_note = |at: usize| {
        let mut before = "";
        text[..at].split_whitespace().any(|word| {
            let begins = word == "G" && before != "n";
            before = word;
            begins
        })
    };
    match text.find(';') {
        Some(at) if !is_in_note(at) => &text[..at],
        _ => text,
    }
}

/// The text behind this many words.
fn after_words(text: &str, count: usize) -> &str {
    let mut rest = text;
    for _ in 0..count {
        rest = rest.trim_start();
        let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
        rest = &rest[end..];
    }
    rest
}
