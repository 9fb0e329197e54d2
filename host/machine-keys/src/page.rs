//! Tables of keys: for a page of the documentation, and as text.

use crate::{Key, keys_of, sections};

/// First and last part of the line before a table of a page; the path of the section is between.
const BEGIN: (&str, &str) = ("<!-- keys: ", " -->");
/// Line after a table.
const END: &str = "<!-- end of keys -->";

/// Rewrites the tables of a page. A table is between a line `<!-- keys: PATH -->`, which names its
/// section (`root` for the keys outside of sections), and a line `<!-- end of keys -->`.
///
/// # Errors
///
/// Returns the sentence that names a line without its end or without a section.
pub fn rewrite(page: &str) -> Result<String, String> {
    let mut text = String::new();
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        text.push_str(line);
        text.push('\n');
        let begin = line.strip_prefix(BEGIN.0);
        let Some(path) = begin.and_then(|rest| rest.strip_suffix(BEGIN.1)) else {
            continue;
        };
        let path = if path == "root" { "" } else { path };
        if keys_of(path).next().is_none() {
            return Err(format!(
                "`{line}`: there is no such section; correct the path"
            ));
        }
        if !lines.by_ref().any(|line| line == END) {
            return Err(format!("`{line}`: there is no `{END}` after it; add it"));
        }
        text.push_str(&table(path));
        text.push_str(END);
        text.push('\n');
    }
    Ok(text)
}

/// Sections of the table of keys that a page does not have.
#[must_use]
pub fn missing(page: &str) -> Vec<&'static str> {
    let paths = sections().map(|section| section.path);
    let has = |path: &str| {
        let path = if path.is_empty() { "root" } else { path };
        page.contains(&format!("{}{path}{}", BEGIN.0, BEGIN.1))
    };
    paths.filter(|path| !has(path)).collect()
}

/// The table of a section in Markdown.
fn table(path: &str) -> String {
    let mut text = String::from(
        "| key | unit | range | default | meaning |\n| --- | --- | --- | --- | --- |\n",
    );
    for key in keys_of(path) {
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

/// A property of a key, and of its rotary form in brackets where it differs.
fn pair(key: &Key, of: impl Fn(&Key) -> String) -> String {
    let (linear, rotary) = (of(&key.of(false)), of(&key.of(true)));
    if linear == rotary {
        linear
    } else {
        format!("{linear} ({rotary})")
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
pub fn listing(path: &str) -> String {
    let mut text = String::new();
    let below = format!("{path}.");
    let is_asked = |other: &str| path.is_empty() || other == path || other.starts_with(&below);
    for section in sections().filter(|section| is_asked(section.path)) {
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

    #[test]
    fn a_table_is_rewritten_between_its_lines() {
        let page = "a\n<!-- keys: stopping -->\nold\n<!-- end of keys -->\nb\n";
        let page = rewrite(page).unwrap();
        assert!(
            page.starts_with("a\n<!-- keys: stopping -->\n| key | unit |"),
            "{page}"
        );
        assert!(page.ends_with("|\n<!-- end of keys -->\nb\n"), "{page}");
        assert!(
            page.contains("| `time_ms` | ms | 5 to 2000, whole; "),
            "{page}"
        );
        assert_eq!(rewrite(&page).unwrap(), page);
    }

    #[test]
    fn a_line_without_its_end_or_section_is_named() {
        let error = rewrite("<!-- keys: stopping -->\n").unwrap_err();
        assert!(
            error.contains("there is no `<!-- end of keys -->`"),
            "{error}"
        );
        let error = rewrite("<!-- keys: stoping -->\n<!-- end of keys -->\n").unwrap_err();
        assert!(error.contains("there is no such section"), "{error}");
    }

    #[test]
    fn a_key_of_an_axis_shows_both_kinds() {
        let table = table("pose");
        let row = "| `rate_mm_s` (`rate_deg_s`) | mm/s (deg/s) | 0.001 to 2000 (0.001 to 179); ";
        assert!(table.contains(row), "{table}");
        let key = keys_of("joint.law").find(|key| key.name == "ki").unwrap();
        assert_eq!(
            summary(key),
            "1/s^3, 0 to 1.6e7; below K_P K_D / 4, default 0"
        );
    }

    /// `cargo xtask keys` rewrites the page.
    #[test]
    fn the_page_of_machine_files_has_the_tables() {
        let page = include_str!("../../../docs/machine-files.md");
        assert_eq!(missing(page), Vec::<&str>::new());
        assert!(
            rewrite(page).unwrap() == page,
            "docs/machine-files.md differs from the table of keys; run `cargo xtask keys`"
        );
    }
}
