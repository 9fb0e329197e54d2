//! Figures that several pages state: README and docs/figures.md must agree with
//! docs/instructions.md, which the tests of emulated runs write.

use std::fs;
use std::path::Path;

/// Heading of the job in docs/instructions.md whose whole period the pages state.
const JOB: &str = "## dome, 5 axes, a machine without a force sensor";

/// Pages, with the form in which they state mean and worst period.
const PAGES: &[(&str, &str)] = &[
    ("README.md", "| MEAN, at worst WORST |"),
    ("docs/figures.md", "; MEAN, WORST |"),
];

/// Checks the pages below `root`.
///
/// # Errors
///
/// Returns the page that states other figures, or that cannot be read.
pub fn lint(root: &Path) -> Result<(), String> {
    let read = |name: &str| {
        fs::read_to_string(root.join(name)).map_err(|error| format!("{name}: {error}"))
    };
    let [mean, worst] = whole_period(&read("docs/instructions.md")?)
        .ok_or("docs/instructions.md has no whole period of the dome")?;
    for (page, form) in PAGES {
        let stated = form.replace("MEAN", &mean).replace("WORST", &worst);
        if !read(page)?.contains(&stated) {
            return Err(format!(
                "{page} does not state `{stated}` for the instructions of a control period; \
                 docs/instructions.md does"
            ));
        }
    }
    Ok(())
}

/// Returns mean and worst period of the job, with a comma after the thousands.
fn whole_period(text: &str) -> Option<[String; 2]> {
    let (_, section) = text.split_once(JOB)?;
    let row = section
        .lines()
        .find_map(|line| line.strip_prefix("| whole period |"))?;
    let mut cells = row.split('|').map(|cell| cell.trim().parse().ok());
    Some([grouped(cells.next()??), grouped(cells.next()??)])
}

fn grouped(number: u32) -> String {
    match number / 1000 {
        0 => number.to_string(),
        thousands => format!("{thousands},{:03}", number % 1000),
    }
}

#[cfg(test)]
mod tests {
    use super::{JOB, whole_period};

    #[test]
    fn the_figures_are_those_of_the_job() {
        let text = format!(
            "## other\n| whole period | 1 | 2 |\n{JOB}\n\n| whole period | 8260 | 12041 |\n"
        );
        let expected = ["8,260", "12,041"].map(String::from);
        assert_eq!(whole_period(&text), Some(expected));
        assert_eq!(whole_period("## other\n| whole period | 1 | 2 |\n"), None);
    }
}
