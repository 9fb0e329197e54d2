//! Figures of the structure of the sources, by crate.
//!
//! `cargo xtask structure [FOLDER]` counts them in the sources below FOLDER, by default those of
//! this repository, so that states of the repository can be compared.

use crate::{cycles, lint};
use std::fs;
use std::path::{Path, PathBuf};

/// Figures of a crate.
struct Row {
    name: String,
    /// Lines of the sources, and of tests, benchmarks and examples.
    lines: [usize; 2],
    /// Files of the largest dependency cycle; 1 for none.
    cycle: usize,
    /// Longest file of the sources.
    longest: usize,
}

/// Prints the figures as a table.
///
/// # Errors
///
/// Returns the file that cannot be read.
pub fn structure(root: &Path) -> Result<(), String> {
    let mut manifests = Vec::new();
    lint::list(root, &["Cargo.toml"], &mut manifests)?;
    manifests.sort();
    let mut rows = Vec::new();
    for manifest in manifests {
        let folder = manifest.parent().unwrap_or(root);
        rows.extend(row(root, folder)?);
    }
    println!("| crate | lines | of tests | longest file | largest dependency cycle |");
    println!("| --- | ---: | ---: | ---: | ---: |");
    for row in &rows {
        println!(
            "| `{}` | {} | {} | {} | {} |",
            row.name, row.lines[0], row.lines[1], row.longest, row.cycle
        );
    }
    let total = |part: usize| rows.iter().map(|row| row.lines[part]).sum::<usize>();
    let max = |of: fn(&Row) -> usize| rows.iter().map(of).max().unwrap_or_default();
    println!(
        "| {} crates | {} | {} | {} | {} |",
        rows.len(),
        total(0),
        total(1),
        max(|row| row.longest),
        max(|row| row.cycle)
    );
    println!();
    println!("Comment lines over 100 columns: {}", long_comments(root)?);
    println!("Terms of docs/glossary.md: {}", terms(root));
    Ok(())
}

/// Returns the figures of the crate in a folder; none for a folder without sources.
fn row(root: &Path, folder: &Path) -> Result<Option<Row>, String> {
    let sources = folder.join("src");
    let starts = ["lib.rs", "main.rs"].map(|start| sources.join(start));
    if !starts.iter().any(|start| start.is_file()) {
        return Ok(None);
    }
    let mut row = Row {
        name: folder
            .strip_prefix(root)
            .unwrap_or(folder)
            .display()
            .to_string(),
        lines: [0; 2],
        cycle: 1,
        longest: 0,
    };
    for path in files(&sources)? {
        let lines = text(&path)?.lines().count();
        let is_test =
            path.ends_with("tests.rs") || path.components().any(|part| part.as_os_str() == "tests");
        row.lines[usize::from(is_test && folder != root.join("tests"))] += lines;
        row.longest = row.longest.max(lines);
    }
    for part in ["tests", "benches", "examples"] {
        let part = folder.join(part);
        if part.is_dir() {
            for path in files(&part)? {
                row.lines[1] += text(&path)?.lines().count();
            }
        }
    }
    for start in starts.iter().filter(|start| start.is_file()) {
        row.cycle = row.cycle.max(cycles::largest(start)?);
    }
    Ok(Some(row))
}

/// Returns the number of lines with a comment that are longer than 100 columns.
fn long_comments(root: &Path) -> Result<usize, String> {
    let mut count = 0;
    for path in files(root)? {
        count += lint::long_comments(&text(&path)?).len();
    }
    Ok(count)
}

/// Returns the number of terms of the glossary: rows of its tables below their heads.
fn terms(root: &Path) -> usize {
    let text = fs::read_to_string(root.join("docs/glossary.md")).unwrap_or_default();
    let lines: Vec<&str> = text.lines().collect();
    let is_row = |line: &&str| line.starts_with('|');
    let heads = lines
        .iter()
        .filter(|line| line.starts_with("| ---"))
        .count();
    lines.iter().filter(|line| is_row(line)).count() - 2 * heads
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    lint::list(folder, &[".rs"], &mut files)?;
    Ok(files)
}

fn text(path: &Path) -> Result<String, String> {
    fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}
