//! Gem designs: from a file to facets, and from facets to a job that cuts them.
//!
//! A design is a list of facets in the order in which they are cut. [`read`] reads GemCad ASCII
//! files (`.asc`) and plain lists (`.toml`, `.csv`). [`Gem::new`] cuts the design out of its rough
//! and refuses what cannot be cut, by line and facet.
//!
//! The frame of a design has its origin in the stone and z through the table. A facet is a plane
//! with a distance from the origin; its angle is 0 for a facet parallel to the table and 90 degrees
//! for one of the girdle. Facets below the girdle have a negative angle in files, as in GemCad; the
//! culet is -0.

mod asc;
mod calibrate;
mod design;
mod forces;
mod gem;
mod job;
mod list;
mod measure;
mod page;
mod problem;
mod reach;
mod run;
pub mod thesis;

pub use calibrate::{ArmLengths, Reading, calibrate};
pub use design::{Design, Facet, Side, Stage, Symmetry, Tier, Transfer};
pub use gem::{Gem, MEET_MM, MeetPoint, ROUGH, Rough};
pub use job::{Coolant, Job, JobSettings, Lap, Mode, Mount, Operation, Pass, in_design};
pub use measure::{ANGLE_DEG, FacetResult, Measured, MeetResult};
pub use page::report;
pub use problem::{Problem, Refused};
pub use reach::{check_machine, coolant, index_wraps, max_force_n};
pub use run::{Cutting, OperationResult, RunOptions, cut};

/// Largest number of facets of a design.
pub const MAX_FACETS: usize = 2000;

/// Reads a design. The end of the name gives the format: `.asc`, `.toml` or `.csv`.
///
/// # Errors
/// All problems of the text, by line and facet.
pub fn read(file: &str, text: &[u8]) -> Result<Design, Refused> {
    let end = file.rsplit('.').next().unwrap_or_default();
    let mut problems = problem::Problems::new(file);
    let mut design = match end.to_ascii_lowercase().as_str() {
        "asc" | "toml" | "csv" if is_utf16(text) => {
            problems.report(0, None, "is UTF-16", "save the file as UTF-8");
            None
        }
        "asc" => asc::read(&latin(text), &mut problems),
        "toml" => list::read_toml(&utf8(text, &mut problems), &mut problems),
        "csv" => list::read_csv(&utf8(text, &mut problems), &mut problems),
        _ => {
            let what = "is no design: the name must end in .asc, .toml or .csv";
            problems.report(
                0,
                None,
                what,
                "rename the file, or write its facets as a list",
            );
            None
        }
    };
    if let Some(design) = &mut design {
        design.check(&mut problems);
    }
    problems.finish(design)
}

/// Whether a text begins with the mark of UTF-16, or with two of its Latin letters.
fn is_utf16(text: &[u8]) -> bool {
    matches!(
        text,
        [0xff, 0xfe, ..]
            | [0xfe, 0xff, ..]
            | [0, 1..=255, 0, 1..=255, ..]
            | [1..=255, 0, 1..=255, 0, ..]
    )
}

/// The text of a file of GemCad: UTF-8 with or without a mark, or Latin-1; lines end in LF, CRLF or
/// CR, and the file may end in the control character with which DOS ended its text files.
fn latin(text: &[u8]) -> String {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let mut text = text;
    while let Some(before) = text.strip_suffix(b"\x1a") {
        text = before;
    }
    let text = match core::str::from_utf8(text) {
        Ok(text) => text.to_string(),
        Err(_) => text.iter().map(|byte| char::from(*byte)).collect(),
    };
    text.replace("\r\n", "\n").replace('\r', "\n")
}

fn utf8(text: &[u8], problems: &mut problem::Problems) -> String {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    match core::str::from_utf8(text) {
        Ok(text) => text.to_string(),
        Err(error) => {
            let before = &text[..error.valid_up_to()];
            let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
            problems.report(line, None, "is not UTF-8", "save the file as UTF-8");
            String::new()
        }
    }
}
