//! Plain lists of facets.
//!
//! TOML, one `[[facet]]` for each tier, and one with `transfer = true` where the stone is turned
//! over:
//!
//! ```toml
//! gear = 64
//! refractive_index = 1.76
//!
//! [[facet]]
//! name = "P1"
//! angle = -42.0
//! index = [0, 16, 32, 48]
//! depth = 2.1
//!
//! [[facet]]
//! transfer = true
//! ```
//!
//! CSV, one row for each facet: `angle,index,depth` and optionally `name` and `note`. A row
//! `transfer` turns the stone over; `# gear = 64` and the other keys are in comments.
//!
//! Depths are distances of the planes from the origin in mm.

use crate::design::{Design, Position, RawTier, Transfer};
use crate::problem::{Problems, one_line};
use serde::Deserialize;
use toml::Spanned;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDesign {
    #[serde(default)]
    title: String,
    gear: Spanned<f64>,
    reference: Option<Spanned<f64>>,
    refractive_index: Option<Spanned<f64>>,
    symmetry: Option<Spanned<f64>>,
    #[serde(default)]
    mirror: bool,
    #[serde(default)]
    facet: Vec<Spanned<RawFacet>>,
}

/// Message on an index; `expecting` takes no constant.
const NO_INDEX: &str = "the index is no number and no list of numbers";

#[derive(Deserialize)]
#[serde(untagged, expecting = "the index is no number and no list of numbers")]
enum Indices {
    One(f64),
    More(Vec<f64>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFacet {
    #[serde(default)]
    transfer: bool,
    name: Option<String>,
    angle: Option<f64>,
    index: Option<Indices>,
    depth: Option<f64>,
    #[serde(default)]
    note: String,
    #[serde(default)]
    preform: bool,
}

fn empty() -> Design {
    Design {
        is_in_mm: true,
        transfer: Some(Vec::new()),
        ..Design::empty()
    }
}

fn turn_over(design: &mut Design, line: usize) {
    let before = design.facets.len();
    let transfer = Transfer { before, line };
    design.transfer.get_or_insert_default().push(transfer);
}

/// Reads a TOML list.
pub fn read_toml(text: &str, problems: &mut Problems) -> Option<Design> {
    let line = |offset: usize| {
        1 + text
            .get(..offset)
            .map_or(0, |before| before.matches('\n').count())
    };
    let raw: RawDesign = match toml::from_str(text) {
        Ok(raw) => raw,
        Err(error) => {
            let at = error.span().map_or(0, |span| line(span.start));
            let remedy = match error.message() {
                NO_INDEX => "write index = 0 or index = [0, 16], without quotes",
                _ => "see docs/faceting.md for the keys of a list",
            };
            problems.report(at, None, error.message().to_string(), remedy);
            return None;
        }
    };
    let mut design = empty();
    design.title = raw.title;
    design.set_gear(*raw.gear.get_ref(), line(raw.gear.span().start), problems);
    if let Some(reference) = raw.reference {
        let at = line(reference.span().start);
        design.set_reference(*reference.get_ref(), at, problems);
    }
    if let Some(order) = raw.symmetry {
        let at = line(order.span().start);
        design.set_symmetry(*order.get_ref(), raw.mirror, at, problems);
    }
    if let Some(index) = raw.refractive_index {
        design.set_refractive_index(*index.get_ref(), line(index.span().start), problems);
    }
    let mut is_refused = false;
    for facet in raw.facet {
        let at = line(facet.span().start);
        let mut facet = facet.into_inner();
        facet.name = facet.name.map(|name| one_line(&name));
        if facet.transfer {
            if facet.angle.is_some() || facet.index.is_some() || facet.depth.is_some() {
                let what = "a transfer has no angle, index and depth";
                let remedy = "write them as a facet of its own";
                problems.report(at, facet.name.as_deref(), what, remedy);
            }
            turn_over(&mut design, at);
            continue;
        }
        let (Some(angle_deg), Some(index), Some(distance)) =
            (facet.angle, facet.index, facet.depth)
        else {
            let what = "angle, index or depth is missing";
            problems.report(
                at,
                facet.name.as_deref(),
                what,
                "write all three, or transfer = true",
            );
            is_refused = true;
            continue;
        };
        let indices = match index {
            Indices::One(index) => vec![index],
            Indices::More(indices) => indices,
        };
        if indices.is_empty() {
            let what = "the list of indices is empty";
            problems.report(at, facet.name.as_deref(), what, "write an index");
            is_refused = true;
        }
        let tier = RawTier {
            line: at,
            angle_deg,
            distance,
            indices: indices
                .into_iter()
                .map(|index| Position {
                    index,
                    name: facet.name.clone(),
                    line: at,
                })
                .collect(),
            note: facet.note,
            preform: facet.preform,
        };
        is_refused |= !design.add(tier, problems);
    }
    // Which side the facets that were refused are on is not known.
    if is_refused {
        design.transfer = None;
    }
    if design.facets.is_empty() && !is_refused {
        problems.report(
            0,
            None,
            "the design has no facet",
            "write sections [[facet]]",
        );
    }
    // A facet that was refused has no partners either.
    if problems.is_empty() {
        design.check_end(text, problems);
    }
    Some(design)
}

/// Columns of a CSV list.
const COLUMNS: [&str; 5] = ["angle", "index", "depth", "name", "note"];

/// Remedy for a row that is no facet.
const WRITE_ROW: &str = "write angle,index,depth,name,note or transfer; separate cells by commas, \
                         and write 12.5 with a point";

/// Settings of a CSV list.
const SETTINGS: [&str; 6] = [
    "title",
    "gear",
    "reference",
    "refractive_index",
    "symmetry",
    "mirror",
];

/// Reads a CSV list, whose lines end in LF, CRLF or CR.
pub fn read_csv(text: &str, problems: &mut Problems) -> Option<Design> {
    let text = text.replace("\r\n", "\n").replace('\r', "\n");
    let mut reader = CsvReader {
        design: empty(),
        settings: Vec::new(),
        columns: None,
        has_row: false,
        is_refused: false,
        problems,
    };
    for (number, line) in text.lines().enumerate() {
        reader.line(number + 1, line.trim());
    }
    let CsvReader {
        mut design,
        settings,
        is_refused,
        ..
    } = reader;
    // Which side the facets of a refused row are on is not known.
    if is_refused {
        design.transfer = None;
    }
    if !settings.iter().any(|(key, _)| key == "gear") {
        design.is_gear_refused = true;
        problems.report(
            0,
            None,
            "the index wheel is missing",
            "write a comment `# gear = 96` before the rows",
        );
    }
    if design.facets.is_empty() && !is_refused {
        problems.report(
            0,
            None,
            "the design has no facet",
            "write rows angle,index,depth",
        );
    }
    if problems.is_empty() {
        design.check_end(&text, problems);
    }
    Some(design)
}

struct CsvReader<'a> {
    design: Design,
    /// Settings and their lines.
    settings: Vec<(String, usize)>,
    /// Cells of the row of titles.
    columns: Option<usize>,
    /// A row of a facet or a transfer was read.
    has_row: bool,
    /// A row of a facet was refused.
    is_refused: bool,
    problems: &'a mut Problems,
}

impl CsvReader<'_> {
    fn line(&mut self, at: usize, line: &str) {
        if let Some(comment) = line.strip_prefix('#') {
            if let Some((key, value)) = comment.split_once('=') {
                self.setting(key.trim(), value.trim(), at);
            }
            return;
        }
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let is_letter = |first: char| first.is_alphabetic() || first == '"';
        let is_first = !self.has_row && self.columns.is_none();
        match cells[..] {
            [""] => return,
            ["transfer", ref rest @ ..] => {
                if let Some(word) = rest.iter().find(|cell| !cell.is_empty()) {
                    let what = format!("\"{word}\" is behind transfer");
                    let remedy = "write the transfer and the facet as two rows";
                    self.problems.report(at, None, what, remedy);
                }
                turn_over(&mut self.design, at);
            }
            // The row of titles.
            [first, ..] if is_first && first.starts_with(is_letter) => {
                return self.titles(&cells, at);
            }
            [_, _, _, ..] => self.is_refused |= self.facet(&cells, at).is_none(),
            _ => {
                self.is_refused = true;
                let count = match cells.len() {
                    1 => "1 cell".to_string(),
                    count => format!("{count} cells"),
                };
                let what = format!("the row has {count}");
                self.problems.report(at, None, what, WRITE_ROW);
            }
        }
        self.has_row = true;
    }

    /// The row of titles, which has the columns in their order.
    fn titles(&mut self, cells: &[&str], at: usize) {
        let named = cells.iter().rposition(|cell| !cell.is_empty());
        let named = &cells[..named.map_or(0, |last| last + 1)];
        let is_title = |(cell, title): (&&str, &str)| cell.eq_ignore_ascii_case(title);
        let fits =
            (3..=COLUMNS.len()).contains(&named.len()) && named.iter().zip(COLUMNS).all(is_title);
        self.columns = Some(cells.len());
        if !fits {
            let what = format!("\"{}\" is no row of titles", named.join(","));
            let remedy = "write angle,index,depth,name,note; the last two may be absent";
            self.problems.report(at, None, what, remedy);
        }
    }

    /// Reads a facet; `None` if its row is refused.
    fn facet(&mut self, cells: &[&str], at: usize) -> Option<()> {
        let name = cells.get(3).filter(|name| !name.is_empty()).copied();
        let columns = self.columns.unwrap_or(COLUMNS.len());
        let max = match self.columns {
            Some(columns) => format!("the row of titles {columns}"),
            None => format!("a list at most {columns}"),
        };
        // A decimal comma makes a cell more, or a name that is a number.
        if cells.len() > columns {
            let what = format!("the row has {} cells, and {max}", cells.len());
            let remedy = "write 12.5 with a point, and names and notes without a comma";
            self.problems.report(at, None, what, remedy);
            return None;
        }
        let is_number = |name: &str| name.parse::<f64>().is_ok();
        if let Some(number) = name.filter(|name| is_number(name)) {
            let what = format!("the name {number} is a number");
            let remedy = format!("write 12.5 with a point, and a name with a letter, as P{number}");
            self.problems.report(at, None, what, remedy);
            return None;
        }
        let angle_deg = self.number("angle", cells[0], name, at);
        let index = self.number("index", cells[1], name, at);
        let distance = self.number("depth", cells[2], name, at);
        let (angle_deg, index, distance) = (angle_deg?, index?, distance?);
        let note = cells.get(4).copied().unwrap_or_default().to_string();
        let tier = RawTier {
            line: at,
            angle_deg,
            distance,
            indices: vec![Position {
                index,
                name: name.map(one_line),
                line: at,
            }],
            preform: note.to_ascii_lowercase().starts_with("preform"),
            note,
        };
        self.design.add(tier, self.problems).then_some(())
    }

    fn number(&mut self, of: &str, cell: &str, name: Option<&str>, at: usize) -> Option<f64> {
        let value = cell.parse::<f64>().ok().filter(|value| value.is_finite());
        if value.is_none() {
            let what = format!("\"{cell}\" is no number for the {of}");
            let remedy = "write a decimal number, as 12.5";
            self.problems.report(at, name, what, remedy);
        }
        value
    }

    /// A setting in a comment, in any case; other comments have no meaning. It is written once,
    /// before the rows: it holds for all of them.
    fn setting(&mut self, key: &str, value: &str, line: usize) {
        let key = &*key.to_ascii_lowercase();
        if !SETTINGS.contains(&key) {
            return;
        }
        let before = self.settings.iter().find(|(other, _)| other == key);
        let what = match before {
            Some((_, first)) => Some(format!("the setting {key} is already in line {first}")),
            None if self.has_row => Some(format!("the setting {key} is behind a row")),
            None => None,
        };
        self.settings.push((key.to_string(), line));
        if let Some(what) = what {
            let remedy = "write it once, before the rows: it holds for all of them";
            self.problems.report(line, None, what, remedy);
            return;
        }
        let (design, problems) = (&mut self.design, &mut *self.problems);
        if key == "title" {
            design.title = value.to_string();
            return;
        }
        if key == "mirror" {
            match &*value.to_ascii_lowercase() {
                "true" => design.symmetry.mirror = true,
                "false" => design.symmetry.mirror = false,
                _ => {
                    let what = format!("\"{value}\" is neither true nor false for the mirror");
                    problems.report(line, None, what, "write `# mirror = true`");
                }
            }
            return;
        }
        let Ok(number) = value.parse::<f64>() else {
            let what = format!("\"{value}\" is no number for {key}");
            problems.report(line, None, what, "write a decimal number");
            return;
        };
        match key {
            "gear" => design.set_gear(number, line, problems),
            "reference" => design.set_reference(number, line, problems),
            "refractive_index" => design.set_refractive_index(number, line, problems),
            _ => design.set_symmetry(number, design.symmetry.mirror, line, problems),
        }
    }
}
