//! Line lengths that no other tool checks: comments in Rust sources and prose in Markdown pages.
//!
//! `rustfmt` limits the length of code, but neither of comments nor of the text of a page. A line
//! counts in characters. Links do not count: their targets cannot be broken.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// Longest line in columns.
const COLUMNS: usize = 100;

/// Directories that hold no sources of the project.
const SKIPPED: &[&str] = &["data", "target"];

/// Checks all sources and pages below `root`.
///
/// # Errors
///
/// Returns the number of long lines of every package and folder, or the file that cannot be read.
pub fn lint(root: &Path) -> Result<(), String> {
    let mut files = Vec::new();
    list(root, &[".rs", ".md", ".toml"], &mut files)?;
    files.sort();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for path in files {
        let text =
            fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let name = path.strip_prefix(root).unwrap_or(&path);
        let lines = match name.extension().and_then(OsStr::to_str) {
            Some("rs") => long_comments(&text),
            Some("toml") => long_toml_comments(&text),
            _ => long_prose(&text),
        };
        for (line, columns) in lines {
            println!("{}:{line}: {columns} columns", name.display());
            *counts.entry(package(root, name)).or_default() += 1;
        }
    }
    if counts.is_empty() {
        return Ok(());
    }
    let total: usize = counts.values().sum();
    let counts: Vec<String> = counts
        .iter()
        .map(|(package, count)| format!("{package} {count}"))
        .collect();
    Err(format!(
        "{total} lines of comments or prose are longer than {COLUMNS} columns ({}); break them",
        counts.join(", ")
    ))
}

/// Collects the files below a directory whose names have one of the endings. Hidden directories,
/// build output and test data are skipped.
pub(crate) fn list(
    directory: &Path,
    endings: &[&str],
    files: &mut Vec<PathBuf>,
) -> Result<(), String> {
    let problem = |error| format!("{}: {error}", directory.display());
    for entry in fs::read_dir(directory).map_err(problem)? {
        let entry = entry.map_err(problem)?;
        let (path, name) = (entry.path(), entry.file_name());
        let name = name.to_string_lossy();
        if entry.file_type().map_err(problem)?.is_dir() {
            if !name.starts_with('.') && !SKIPPED.contains(&name.as_ref()) {
                list(&path, endings, files)?;
            }
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            files.push(path);
        }
    }
    Ok(())
}

/// Returns the directory of the package that a file belongs to, or the first directory of its path.
fn package(root: &Path, name: &Path) -> String {
    let package = name
        .ancestors()
        .skip(1)
        .filter(|directory| !directory.as_os_str().is_empty())
        .find(|directory| root.join(directory).join("Cargo.toml").is_file());
    let directory = package.or_else(|| name.iter().next().map(Path::new));
    directory.unwrap_or(name).display().to_string()
}

/// Returns the number, from 1, and the length of every long line that has a comment.
pub(crate) fn long_comments(text: &str) -> Vec<(usize, usize)> {
    let comments = lines_with_comments(text);
    text.lines()
        .enumerate()
        .filter(|(index, line)| {
            let content = line.trim_start_matches(['/', '!', '*', ' ']);
            comments.contains(index) && !content.starts_with('|')
        })
        .filter_map(|(index, line)| long(index, &without_links(line)))
        .collect()
}

/// Returns the number, from 1, and the length of every long line outside tables and code blocks.
fn long_prose(text: &str) -> Vec<(usize, usize)> {
    let mut fence: Option<&str> = None;
    let mut lines = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = line.trim_start();
        let mark = ["```", "~~~"]
            .into_iter()
            .find(|mark| content.starts_with(mark));
        match (fence, mark) {
            (None, Some(mark)) => fence = Some(mark),
            (Some(open), Some(mark)) if open == mark => fence = None,
            (None, None) if !content.starts_with('|') => {
                lines.extend(long(index, &without_links(line)));
            }
            _ => {}
        }
    }
    lines
}

/// Long lines of a TOML file that have a comment.
fn long_toml_comments(text: &str) -> Vec<(usize, usize)> {
    let commented = text.lines().enumerate();
    let commented = commented.filter(|(_, line)| line.contains('#'));
    commented
        .filter_map(|(index, line)| long(index, line))
        .collect()
}

/// Returns the number of a line, from 1, and its length if it is long.
fn long(index: usize, line: &str) -> Option<(usize, usize)> {
    let columns = line.trim_end().chars().count();
    (columns > COLUMNS).then_some((index + 1, columns))
}

/// Removes link targets and addresses from a line.
fn without_links(line: &str) -> String {
    let mut rest = line;
    let mut kept = String::new();
    while let Some(start) = rest.find("](") {
        let (text, target) = rest.split_at(start + 1);
        kept.push_str(text);
        rest = target.split_once(')').map_or("", |(_, rest)| rest);
    }
    kept.push_str(rest);
    kept.split_inclusive(' ')
        .filter(|word| !word.contains("://"))
        .collect()
}

/// Returns the indices of the lines that contain a part of a comment.
///
/// Strings and character literals are recognised, because they may contain `//`.
fn lines_with_comments(text: &str) -> Vec<usize> {
    let bytes = text.as_bytes();
    let (mut lines, mut line, mut at) = (Vec::new(), 0, 0);
    while let Some(byte) = bytes.get(at) {
        let rest = &bytes[at..];
        let length = match byte {
            b'/' if rest.starts_with(b"//") => {
                lines.push(line);
                rest.iter().take_while(|byte| **byte != b'\n').count()
            }
            b'/' if rest.starts_with(b"/*") => {
                let length = block_comment(rest);
                let breaks = newlines(&rest[..length]);
                lines.extend(line..=line + breaks);
                length
            }
            b'"' => string(rest),
            b'\'' => character(rest),
            byte if byte.is_ascii_alphanumeric() || *byte == b'_' => word(rest),
            _ => 1,
        };
        line += newlines(&rest[..length]);
        at += length;
    }
    lines
}

fn newlines(bytes: &[u8]) -> usize {
    bytes.iter().filter(|byte| **byte == b'\n').count()
}

/// Returns the length of a block comment; block comments nest.
fn block_comment(text: &[u8]) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while at < text.len() {
        if text[at..].starts_with(b"/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if text[at..].starts_with(b"*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                break;
            }
        } else {
            at += 1;
        }
    }
    at
}

/// Returns the length of a string with escapes.
fn string(text: &[u8]) -> usize {
    let mut at = 1;
    while let Some(byte) = text.get(at) {
        match byte {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    text.len()
}

/// Returns the length of a character literal, or 1 for the quote of a lifetime.
fn character(text: &[u8]) -> usize {
    if text.get(1) == Some(&b'\\') {
        let end = text.iter().skip(3).position(|byte| *byte == b'\'');
        return end.map_or(1, |end| end + 4);
    }
    // A character has at most four bytes.
    let end = text.iter().skip(2).take(4).position(|byte| *byte == b'\'');
    match end {
        Some(end)
            if std::str::from_utf8(&text[1..end + 2]).is_ok_and(|c| c.chars().count() == 1) =>
        {
            end + 3
        }
        _ => 1,
    }
}

/// Returns the length of an identifier or number, or of the raw string that it begins.
fn word(text: &[u8]) -> usize {
    let is_part = |byte: &&u8| byte.is_ascii_alphanumeric() || **byte == b'_';
    let length = text.iter().take_while(is_part).count();
    if !matches!(&text[..length], b"r" | b"br" | b"cr") {
        return length;
    }
    let hashes = text[length..]
        .iter()
        .take_while(|byte| **byte == b'#')
        .count();
    let start = length + hashes;
    if text.get(start) != Some(&b'"') {
        return length;
    }
    let end = [&b"\""[..], &vec![b'#'; hashes]].concat();
    let found = text[start + 1..]
        .windows(end.len())
        .position(|window| window == end);
    found.map_or(text.len(), |found| start + 1 + found + end.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(count: usize) -> String {
        "four ".repeat(count)
    }

    #[test]
    fn a_comment_of_more_than_100_columns_is_long() {
        let fits = format!("// {}{}\n", words(19), "xx");
        assert_eq!(long_comments(&fits), []);
        let text = format!("fn f() {{}}\n\n    /// {}\nfn g() {{}}\n", words(20));
        assert_eq!(long_comments(&text), [(3, 107)]);
        let text = format!("let x = 1; // {}\n", words(20));
        assert_eq!(long_comments(&text), [(1, 113)]);
        let text = format!("/* a\n{}\n/* b */ c\n*/ fn f() {{}}\n", words(21));
        assert_eq!(long_comments(&text), [(2, 104)]);
    }

    #[test]
    fn columns_are_characters() {
        assert_eq!(long_comments(&format!("// {}", "\u{e9}".repeat(97))), []);
        assert_eq!(
            long_comments(&format!("// {}", "\u{e9}".repeat(98))),
            [(1, 101)]
        );
    }

    #[test]
    fn strings_and_characters_are_no_comments() {
        let long = words(25);
        for code in [
            format!("let a = \"// {long}\";"),
            format!("let a = \"\\\"// {long}\";"),
            format!("let a = r\"// {long}\";"),
            format!("let a = br#\"\"// {long}\"#;"),
            format!("let a = b\"/* {long}\";"),
            format!("let a = ['\"', '/', '/']; let b = \"// {long}\";"),
            format!("let a = ['\\'', '\\\\', '\\u{{e9}}']; let b = \"// {long}\";"),
            format!("fn f<'a>(x: &'a str) {{ f(\"// {long}\") }}"),
            format!("let r#type = \"// {long}\";"),
        ] {
            assert_eq!(long_comments(&code), [], "{code}");
            let after = format!("{code}\n// {long}\n");
            assert_eq!(long_comments(&after), [(2, 127)], "{code}");
        }
    }

    #[test]
    fn links_and_tables_are_not_counted() {
        let target = "a".repeat(120);
        assert_eq!(long_comments(&format!("//! https://{target}.org/")), []);
        assert_eq!(
            long_comments(&format!("/// See [here]({target}) for it.")),
            []
        );
        assert_eq!(long_comments(&format!("/// | {} | x |", words(30))), []);
        assert_eq!(long_prose(&format!("[1]: https://{target}.org/")), []);
        assert_eq!(long_prose(&format!("| {} | x |", words(30))), []);
        let text = format!("{}[{}](x)", words(10), words(15));
        assert_eq!(long_prose(&text), [(1, 127)]);
    }

    #[test]
    fn code_blocks_of_a_page_are_not_counted() {
        let long = words(25);
        let text =
            format!("a\n```sh\n{long}\n~~~\n{long}\n```\n{long}\n~~~\n{long}\n~~~\n# {long}\n");
        assert_eq!(long_prose(&text), [(7, 124), (11, 126)]);
    }

    #[test]
    fn a_file_belongs_to_the_nearest_package() {
        let root = crate::root();
        assert_eq!(
            package(&root, Path::new("host/cli/tests/run.rs")),
            "host/cli"
        );
        assert_eq!(
            package(&root, Path::new("docs/decisions/0001-a.md")),
            "docs"
        );
        assert_eq!(package(&root, Path::new("README.md")), "README.md");
    }
}
