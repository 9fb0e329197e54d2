//! Subjects of commits: one change, at most 65 characters.

use std::path::Path;
use std::process::Command;

/// Longest subject in characters.
const LONGEST: usize = 65;

/// The last commit whose subjects were written before this check.
const BEFORE: &str = "bdb60946";

/// Checks the subjects of all commits since [`BEFORE`] in the repository at `root`. A copy without
/// this commit (a shallow clone, an archive) is not checked.
///
/// # Errors
///
/// Returns the number of subjects that are too long or name several changes.
pub fn lint(root: &Path) -> Result<(), String> {
    let range = format!("{BEFORE}..HEAD");
    let output = Command::new("git")
        .arg("-C")
        .arg(root)
        .args(["log", "--no-merges", "--format=%h %s", &range])
        .output();
    let Some(output) = output.ok().filter(|output| output.status.success()) else {
        println!("commit subjects: not checked, the commit {BEFORE} is not here");
        return Ok(());
    };
    let mut count = 0;
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let (commit, subject) = line.split_once(' ').unwrap_or((line, ""));
        if let Some(problem) = problem(subject) {
            println!("commit {commit}: {problem}: {subject}");
            count += 1;
        }
    }
    match count {
        0 => Ok(()),
        count => Err(format!(
            "{count} commit subjects are not one change in at most {LONGEST} characters; reword \
             them (git commit --amend, git rebase --interactive)"
        )),
    }
}

/// Returns the mistake of a subject.
fn problem(subject: &str) -> Option<String> {
    let length = subject.chars().count();
    if length > LONGEST {
        return Some(format!("{length} characters"));
    }
    if subject.contains(';') {
        return Some("several changes".to_string());
    }
    subject
        .ends_with('.')
        .then(|| "ends with a full stop".to_string())
}

#[cfg(test)]
mod tests {
    use super::problem;

    #[test]
    fn subjects_have_one_change_and_a_bounded_length() {
        let longest = "\u{e4}".repeat(65);
        for subject in ["planner: bound the jerk at the start of an arc", &longest] {
            assert_eq!(problem(subject), None, "{subject}");
        }
        let long = format!("{longest}a");
        assert_eq!(problem(&long).as_deref(), Some("66 characters"));
        let several = "docs: figures of the probe; teleop with a board";
        assert_eq!(problem(several).as_deref(), Some("several changes"));
        assert!(problem("docs: add the figures.").is_some());
    }
}
