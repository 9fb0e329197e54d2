//! Tables of keys: for a page of the documentation, and as text.

use crate::{Key, Section};
use haptimill_protocol::text::AxisKind;

/// First and last part of the line before a table of a page; the path of the section is between.
const BEGIN: (&str, &str) = ("<!-- keys: ", " -->");
/// Longest line of a paragraph.
pub const COLUMNS: usize = 100;
/// Line after a table.
const END: &str = "<!-- end of keys -->";

/// Rewrites the tables of a page. A table is between a line `<!-- keys: PATH -->`, which names its
/// section (`root` for the keys outside of sections), and a line `<!-- end of keys -->`. Sections
/// that belong to a model follow the others of their path; `PATH.*` are the sections below a path
/// that belong to a model. `axes` names the coordinates and joints of a model.
///
/// # Errors
///
/// Returns the sentence that names a line without its end or without a section.
pub fn rewrite(
    page: &str,
    sections: &[Section],
    axes: impl Fn(&str) -> String,
) -> Result<String, String> {
    let mut text = String::new();
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        text.push_str(line);
        text.push('\n');
        let begin = line.strip_prefix(BEGIN.0);
        let Some(path) = begin.and_then(|rest| rest.strip_suffix(BEGIN.1)) else {
            continue;
        };
        let here: Vec<&Section> = sections.iter().filter(|it| is_at(it, path)).collect();
        if here.is_empty() {
            return Err(format!(
                "`{line}`: there is no such section; correct the path"
            ));
        }
        if !lines.by_ref().any(|line| line == END) {
            return Err(format!("`{line}`: there is no `{END}` after it; add it"));
        }
        text.push_str(&tables(&here, &axes));
        text.push_str(END);
        text.push('\n');
    }
    Ok(text)
}

/// Whether the tables of a section are at a path of a page.
fn is_at(section: &Section, path: &str) -> bool {
    match path.strip_suffix('*') {
        Some(below) => section.model.is_some() && section.path.starts_with(below),
        None => section.path == if path == "root" { "" } else { path },
    }
}

/// Sections of the table of keys that a page does not have.
#[must_use]
pub fn missing(page: &str, sections: &[Section]) -> Vec<&'static str> {
    let begin = page.lines().filter_map(|line| line.strip_prefix(BEGIN.0));
    let paths: Vec<&str> = begin
        .filter_map(|line| line.strip_suffix(BEGIN.1))
        .collect();
    let has = |section: &&Section| !paths.iter().any(|path| is_at(section, path));
    sections
        .iter()
        .filter(has)
        .map(|section| section.path)
        .collect()
}

/// The tables of sections in Markdown: one for those of all machines, one for each model.
fn tables(sections: &[&Section], axes: impl Fn(&str) -> String) -> String {
    let (own, models): (Vec<&Section>, Vec<&Section>) =
        sections.iter().partition(|section| section.model.is_none());
    let keys: Vec<Key> = own
        .iter()
        .flat_map(|section| section.keys)
        .copied()
        .collect();
    let mut text = String::new();
    if !keys.is_empty() {
        text.push_str(&table(&keys));
    }
    for section in models {
        if !text.is_empty() {
            text.push('\n');
        }
        let (path, title) = (section.path, section.title);
        let model = section.model.unwrap_or_default();
        let line = match path.contains('.') {
            true => format!("`[{path}]`: {title}"),
            false => format!("`model = \"{model}\"`: {title} {}", axes(model)),
        };
        push_paragraph(&mut text, &line);
        if !section.keys.is_empty() {
            // The line before the table names the model.
            let keys = section.keys.iter().map(|key| Key {
                condition: key.condition.filter(|(name, _)| *name != "model"),
                ..*key
            });
            text.push('\n');
            text.push_str(&table(&keys.collect::<Vec<_>>()));
        }
    }
    text
}

/// Adds a paragraph, with its lines broken at [`COLUMNS`].
fn push_paragraph(text: &mut String, paragraph: &str) {
    let mut columns = 0;
    for word in paragraph.split_whitespace() {
        if columns > 0 && columns + 1 + word.len() > COLUMNS {
            text.push('\n');
            columns = 0;
        } else if columns > 0 {
            text.push(' ');
            columns += 1;
        }
        text.push_str(word);
        columns += word.len();
    }
    text.push('\n');
}

/// A table of keys in Markdown.
fn table(keys: &[Key]) -> String {
    let mut text = String::from(
        "| key | unit | range | default | meaning |\n| --- | --- | --- | --- | --- |\n",
    );
    for key in keys {
        let cell = |text: String| text.replace('|', "\\|");
        text.push_str(&format!(
            "| {} | {} | {} | {} | {} |\n",
            names(key),
            pair(key, |key| key.values.unit().to_string()),
            cell(range(key)),
            cell(key.default_text().unwrap_or_else(|| "required".to_string())),
            cell(meaning(key)),
        ));
    }
    text
}

/// The names of a key: that of a linear axis, and that of a rotary one in brackets.
fn names(key: &Key) -> String {
    match key.rotary {
        Some((rotary, _)) if rotary != key.name => format!("`{}` (`{rotary}`)", key.name),
        _ => format!("`{}`", key.name),
    }
}

/// A property of a key, and of its rotary forms in brackets where they differ.
fn pair(key: &Key, of: impl Fn(&Key) -> String) -> String {
    use AxisKind::{Linear, MultiTurn, Rotary};
    let [linear, rotary, many] = [Linear, Rotary, MultiTurn].map(|kind| of(&key.of(kind)));
    if linear == rotary {
        linear
    } else if rotary == many {
        format!("{linear} ({rotary})")
    } else {
        format!("{linear} ({rotary}; multi-turn {many})")
    }
}

fn range(key: &Key) -> String {
    let range = pair(key, |key| key.values.range());
    match key.bounds {
        "" => range,
        bounds => format!("{range}; {bounds}"),
    }
}

fn meaning(key: &Key) -> String {
    match key.applies() {
        applies if applies.is_empty() => key.meaning.to_string(),
        applies => format!("{} (only {applies})", key.meaning),
    }
}

/// Unit, range and default of a key on one line: `mm/s, 0.001 to 2000, required`.
#[must_use]
pub fn summary(key: &Key) -> String {
    let default = match key.default_text() {
        Some(default) => format!("default {default}"),
        None => "required".to_string(),
    };
    let unit = pair(key, |key| key.values.unit().to_string());
    let parts = [unit, range(key), default];
    let parts: Vec<_> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    parts.join(", ")
}

/// The sections whose path begins with `path` as text for a terminal; empty if there is none.
#[must_use]
pub fn listing(path: &str, sections: &[Section]) -> String {
    let mut text = String::new();
    let below = format!("{path}.");
    let is_asked = |other: &str| path.is_empty() || other == path || other.starts_with(&below);
    for section in sections.iter().filter(|section| is_asked(section.path)) {
        let name = match section.path {
            "" => "before the sections".to_string(),
            path => format!("[{path}]"),
        };
        text.push_str(&format!("{name}  {}\n", section.title));
        for key in section.keys {
            let names = names(key).replace('`', "");
            text.push_str(&format!("  {names}\n      {}\n", meaning(key)));
            text.push_str(&format!("      {}\n", summary(key)));
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sections() -> Vec<Section> {
        crate::sections().copied().collect()
    }

    fn none(_: &str) -> String {
        String::new()
    }

    fn keys_of(path: &str) -> Vec<Key> {
        let all = sections();
        let of_path = all.iter().filter(|section| section.path == path);
        of_path.flat_map(|section| section.keys).copied().collect()
    }

    #[test]
    fn a_table_is_rewritten_between_its_lines() {
        let page = "a\n<!-- keys: stopping -->\nold\n<!-- end of keys -->\nb\n";
        let page = rewrite(page, &sections(), none).unwrap();
        assert!(
            page.starts_with("a\n<!-- keys: stopping -->\n| key | unit |"),
            "{page}"
        );
        assert!(page.ends_with("|\n<!-- end of keys -->\nb\n"), "{page}");
        assert!(
            page.contains("| `time_ms` | ms | 5 to 2000, whole; "),
            "{page}"
        );
        assert_eq!(rewrite(&page, &sections(), none).unwrap(), page);
    }

    mod crane {
        crate::model_keys! {
            "crane"
            kinematics "The lengths of the crane." {
                boom = real(1.0, 500.0, "mm").is("length of the boom");
            }
            plant "The crane hangs." {}
        }
    }

    #[test]
    fn the_tables_of_a_model_have_a_title() {
        let mut all = sections();
        all.extend([crane::kinematics::SECTION, crane::plant::SECTION]);
        let page = "<!-- keys: kinematics -->\n<!-- end of keys -->\n\
                    <!-- keys: plant.geometry.* -->\n<!-- end of keys -->\n";
        let page = rewrite(page, &all, |model| format!("A {model} has axes.")).unwrap();
        let table = "| key | unit | range | default | meaning |\n\
                     | --- | --- | --- | --- | --- |\n\
                     | `boom` | mm | 1 to 500 | required | length of the boom |\n";
        let text = format!(
            "\n\n`model = \"crane\"`: The lengths of the crane. \
                           A crane has axes.\n\n{table}"
        );
        assert!(
            page.replace("coordinates and joints |\n\n", "\n\n")
                .contains(&text),
            "{page}"
        );
        let text = "<!-- keys: plant.geometry.* -->\n\
                    `[plant.geometry.crane]`: The crane hangs.\n<!-- end of keys -->\n";
        assert!(page.ends_with(text), "{page}");
        let is_of_crane = |path: &&&str| path.contains("crane");
        let absent = missing("<!-- keys: kinematics -->", &all);
        assert_eq!(absent.iter().filter(is_of_crane).count(), 1, "{absent:?}");
        let absent = missing(&page, &all);
        assert_eq!(absent.iter().filter(is_of_crane).count(), 0, "{absent:?}");
    }

    #[test]
    fn a_line_without_its_end_or_section_is_named() {
        let error = rewrite("<!-- keys: stopping -->\n", &sections(), none).unwrap_err();
        assert!(
            error.contains("there is no `<!-- end of keys -->`"),
            "{error}"
        );
        let page = "<!-- keys: stoping -->\n<!-- end of keys -->\n";
        let error = rewrite(page, &sections(), none).unwrap_err();
        assert!(error.contains("there is no such section"), "{error}");
    }

    #[test]
    fn a_key_of_an_axis_shows_all_kinds() {
        let table = table(&keys_of("pose"));
        let row = "| `rate_mm_s` (`rate_deg_s`) | mm/s (deg/s) | 0.001 to 2000 \
                   (0.001 to 179; multi-turn 0.001 to 180000); ";
        assert!(table.contains(row), "{table}");
        let law = keys_of("joint.law");
        let key = law.iter().find(|key| key.name == "ki").unwrap();
        assert_eq!(
            summary(key),
            "1/s^3, 0 to 1.6e7; below K_P K_D / 4, default 0"
        );
    }
}
