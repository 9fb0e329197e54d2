//! Applies mutations to a copy of the sources, and reports whether the fuzz test finds each.

use crate::{cargo, root};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// The list of the mutations.
const LIST: &str = "tests/fuzz/mutations.txt";

/// Folders of the workspace that a build of the fuzz test needs.
const SOURCES: &[&str] = &[
    ".cargo", "protocol", "firmware", "hil-sim", "host", "tests", "xtask", "machines", "examples",
    "docs",
];

/// A mutation: what it breaks, and the texts to replace.
struct Mutation {
    name: String,
    breaks: String,
    /// File, exact old text, new text.
    changes: Vec<(String, String, String)>,
}

/// Applies all mutations to a copy of the sources, each behind a switch, and runs the fuzz test on
/// each.
pub fn mutations(arguments: &[&str]) -> Result<(), String> {
    let mut episodes = "1500".to_string();
    let mut seed = "1".to_string();
    let mut only = None;
    let mut words = arguments.iter();
    while let Some(word) = words.next() {
        let value = words
            .next()
            .ok_or_else(|| format!("{word} needs a value"))?;
        match *word {
            "--episodes" => episodes = (*value).to_string(),
            "--seed" => seed = (*value).to_string(),
            "--mutation" => only = Some((*value).to_string()),
            _ => {
                return Err(format!(
                    "--mutations takes --episodes N, --seed S and --mutation NAME, not '{word}'"
                ));
            }
        }
    }
    let mutations = parse(&read(&root().join(LIST))?)?;
    if let Some(name) = &only
        && !mutations.iter().any(|mutation| mutation.name == *name)
    {
        let names: Vec<&str> = mutations
            .iter()
            .map(|mutation| mutation.name.as_str())
            .collect();
        return Err(format!(
            "there is no mutation '{name}'; there are {}",
            names.join(", ")
        ));
    }
    let copy = root().join("target").join("mutations");
    let target = root().join("target").join("mutations-target");
    copy_sources(&copy)?;
    for (index, mutation) in mutations.iter().enumerate() {
        apply(&copy, mutation, index + 1)?;
    }
    add_switches(&copy)?;
    build(&copy, &target)?;
    let mut rows = Vec::new();
    let mut missed = Vec::new();
    for (index, mutation) in mutations.iter().enumerate() {
        if only.as_ref().is_some_and(|name| mutation.name != *name) {
            continue;
        }
        let start = Instant::now();
        // A failure with all switches off is not that of the mutation.
        let options = [
            // The episodes end the run, whatever the speed of the host.
            "--minutes",
            "1000",
            "--episodes",
            &episodes,
            "--seed",
            &seed,
            "--stop",
            "--against-healthy",
        ];
        let output = run_fuzz(&copy, &target, index + 1, &options)?;
        let found = first_failure(&output);
        let seconds = start.elapsed().as_secs_f64();
        let row = match found {
            Some(Found {
                check,
                seed,
                period,
            }) => {
                format!(
                    "| {} | {} | {check} | {seed} | {period} |",
                    mutation.name, mutation.breaks
                )
            }
            None => {
                missed.push(mutation.name.clone());
                format!(
                    "| {} | {} | NOT FOUND | | |",
                    mutation.name, mutation.breaks
                )
            }
        };
        println!("{row}  ({seconds:.0} s)");
        rows.push(row);
    }
    println!(
        "\n| mutation | what it breaks | found by | seed | after periods |\n| --- | --- | --- | --- | --- |"
    );
    for row in &rows {
        println!("{row}");
    }
    if missed.is_empty() {
        println!("all {} mutations were found", rows.len());
        Ok(())
    } else {
        Err(format!(
            "not found: {}; a check is missing, or the stimulus that shows the mutation",
            missed.join(", ")
        ))
    }
}

/// Adds the switches to the copy: a number in the protocol crate, from the environment variable.
fn add_switches(copy: &Path) -> Result<(), String> {
    let library = copy.join("protocol/src/lib.rs");
    let text = read(&library)?;
    write(
        &library,
        &format!(
            "{text}\n/// Which mutation is on.\npub mod mutations {{\n    use core::sync::atomic::{{AtomicU32, Ordering}};\n    static ON: AtomicU32 = AtomicU32::new(0);\n    \
             /// Whether it is this one.\n    pub fn on(mutation: u32) -> bool {{\n        ON.load(Ordering::Relaxed) == mutation\n    }}\n    \
             /// Switches one on.\n    pub fn set(mutation: u32) {{\n        ON.store(mutation, Ordering::Relaxed);\n    }}\n}}\n"
        ),
    )?;
    let program = copy.join("tests/src/bin/fuzz.rs");
    let text = read(&program)?;
    let mark = "    capture_panics();\n";
    if text.matches(mark).count() != 1 {
        return Err("tests/src/bin/fuzz.rs: the place of the switch must occur once".into());
    }
    let set = "    if let Some(mutation) = std::env::var(\"HAPTIMILL_MUTATION\").ok().and_then(|mutation| mutation.parse().ok()) {\n        haptimill_protocol::mutations::set(mutation);\n    }\n";
    write(&program, &text.replacen(mark, &format!("{mark}{set}"), 1))
}

/// A failure in the output of the fuzz test.
struct Found {
    check: String,
    seed: String,
    period: String,
}

/// Returns the first failure; its line is `FAILED  seed S  check "C"  period P`.
fn first_failure(output: &str) -> Option<Found> {
    let line = output.lines().find(|line| line.starts_with("FAILED"))?;
    let check = line.split('"').nth(1)?.to_string();
    let word_after = |name: &str| {
        let mut words = line.split_whitespace();
        words.find(|word| *word == name)?;
        words.next().map(str::to_string)
    };
    Some(Found {
        check,
        seed: word_after("seed")?,
        period: word_after("period")?,
    })
}

fn build(copy: &Path, target: &Path) -> Result<(), String> {
    let output = cargo()
        .current_dir(copy)
        .env("CARGO_TARGET_DIR", target)
        .args([
            "build",
            "--quiet",
            "--offline",
            "--release",
            "--package",
            "haptimill-tests",
            "--bin",
            "fuzz",
        ])
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if output.status.success() {
        Ok(())
    } else {
        Err(format!(
            "the copy does not build:\n{}",
            String::from_utf8_lossy(&output.stderr)
        ))
    }
}

fn run_fuzz(
    copy: &Path,
    target: &Path,
    mutation: usize,
    options: &[&str],
) -> Result<String, String> {
    let output = Command::new(target.join("release").join("fuzz"))
        .current_dir(copy)
        .env("HAPTIMILL_MUTATION", mutation.to_string())
        .args(options)
        .output()
        .map_err(|error| format!("the fuzz test cannot be started: {error}"))?;
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Replaces the texts of a mutation; `MUTATED` in a new text is its switch.
fn apply(copy: &Path, mutation: &Mutation, number: usize) -> Result<(), String> {
    for (file, old, new) in &mutation.changes {
        let path = copy.join(file);
        let text = read(&path)?;
        let count = text.matches(old.as_str()).count();
        if count != 1 || !new.contains("MUTATED") {
            return Err(format!(
                "{LIST}: mutation '{}': the old text occurs {count} times in {file}, but must occur once, and the new text must contain the switch MUTATED; update the list",
                mutation.name
            ));
        }
        let krate = if file.starts_with("protocol") {
            "crate"
        } else {
            "haptimill_protocol"
        };
        let new = new.replace("MUTATED", &format!("{krate}::mutations::on({number})"));
        write(&path, &text.replacen(old.as_str(), &new, 1))?;
    }
    Ok(())
}

fn copy_sources(copy: &Path) -> Result<(), String> {
    if copy.exists() {
        fs::remove_dir_all(copy).map_err(|error| format!("{}: {error}", copy.display()))?;
    }
    fs::create_dir_all(copy).map_err(|error| format!("{}: {error}", copy.display()))?;
    for folder in SOURCES {
        copy_folder(&root().join(folder), &copy.join(folder))?;
    }
    for file in ["Cargo.toml", "Cargo.lock", "README.md", "memory.x"] {
        let from = root().join(file);
        if from.exists() {
            fs::copy(&from, copy.join(file))
                .map_err(|error| format!("{}: {error}", from.display()))?;
        }
    }
    Ok(())
}

fn copy_folder(from: &Path, to: &Path) -> Result<(), String> {
    let problem = |error| format!("{}: {error}", from.display());
    fs::create_dir_all(to).map_err(problem)?;
    for entry in fs::read_dir(from).map_err(problem)? {
        let entry = entry.map_err(problem)?;
        let path = entry.path();
        if entry.file_name() == "target" {
            continue;
        }
        if path.is_dir() {
            copy_folder(&path, &to.join(entry.file_name()))?;
        } else {
            fs::copy(&path, to.join(entry.file_name())).map_err(problem)?;
        }
    }
    Ok(())
}

/// Parses the list: `== name`, `breaks: ...`, and the changes of each mutation.
///
/// A change is `file: ...`, `--- old`, text, `--- new`, text, `---`.
fn parse(text: &str) -> Result<Vec<Mutation>, String> {
    let mut mutations: Vec<Mutation> = Vec::new();
    let mut file = String::new();
    let mut lines = text.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let bad = |what: &str| format!("{LIST}:{}: {what}", number + 1);
        if line.trim().is_empty() || line.starts_with('#') {
            continue;
        }
        if let Some(name) = line.strip_prefix("== ") {
            mutations.push(Mutation {
                name: name.trim().to_string(),
                breaks: String::new(),
                changes: vec![],
            });
            continue;
        }
        let mutation = mutations
            .last_mut()
            .ok_or_else(|| bad("a mutation begins with `== name`"))?;
        if let Some(breaks) = line.strip_prefix("breaks: ") {
            mutation.breaks = breaks.trim().to_string();
        } else if let Some(name) = line.strip_prefix("file: ") {
            file = name.trim().to_string();
        } else if line == "--- old" {
            let mut block = |end: &str| {
                let mut text = Vec::new();
                for (_, line) in lines.by_ref() {
                    if line == end {
                        return Ok(text.join("\n"));
                    }
                    text.push(line);
                }
                Err(format!("{LIST}:{}: `{end}` is missing", number + 1))
            };
            let old = block("--- new")?;
            let new = block("---")?;
            mutation.changes.push((file.clone(), old, new));
        } else {
            return Err(bad("must be `breaks: `, `file: ` or `--- old`"));
        }
    }
    Ok(mutations)
}

fn read(path: &Path) -> Result<String, String> {
    fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A change of the sources that breaks the list shows here, not in a run of an hour.
    #[test]
    fn each_old_text_occurs_once() {
        let mutations = parse(&read(&root().join(LIST)).expect("readable")).expect("a list");
        assert!(mutations.len() >= 20);
        for mutation in &mutations {
            for (file, old, _) in &mutation.changes {
                let text = read(&root().join(file)).expect("readable");
                assert_eq!(
                    text.matches(old.as_str()).count(),
                    1,
                    "{} {file}",
                    mutation.name
                );
            }
        }
    }
}
