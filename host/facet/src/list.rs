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

use crate::design::{Design, Tier};
use crate::problem::Problems;
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

#[derive(Deserialize)]
#[serde(untagged)]
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

fn turn_over(design: &mut Design) {
    let at = design.facets.len();
    design.transfer.get_or_insert_default().push(at);
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
            let remedy = "see docs/faceting.md for the keys of a list";
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
    for facet in raw.facet {
        let at = line(facet.span().start);
        let facet = facet.into_inner();
        if facet.transfer {
            if facet.angle.is_some() || facet.index.is_some() || facet.depth.is_some() {
                let what = "a transfer has no angle, index and depth";
                let remedy = "write them as a facet of its own";
                problems.report(at, facet.name.as_deref(), what, remedy);
            }
            turn_over(&mut design);
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
            continue;
        };
        let indices = match index {
            Indices::One(index) => vec![index],
            Indices::More(indices) => indices,
        };
        if indices.is_empty() {
            let what = "the list of indices is empty";
            problems.report(at, facet.name.as_deref(), what, "write an index");
        }
        let tier = Tier {
            line: at,
            angle_deg,
            distance,
            indices: indices
                .into_iter()
                .map(|index| (index, facet.name.clone()))
                .collect(),
            note: facet.note,
            preform: facet.preform,
        };
        design.add(tier, problems);
    }
    if design.facets.is_empty() {
        problems.report(
            0,
            None,
            "the design has no facet",
            "write sections [[facet]]",
        );
    }
    Some(design)
}

/// Reads a CSV list.
pub fn read_csv(text: &str, problems: &mut Problems) -> Option<Design> {
    let mut design = empty();
    let mut has_gear = false;
    for (number, line) in text.lines().enumerate() {
        let (at, line) = (number + 1, line.trim());
        if let Some(comment) = line.strip_prefix('#') {
            if let Some((key, value)) = comment.split_once('=') {
                has_gear |= key.trim() == "gear";
                setting(&mut design, key.trim(), value.trim(), at, problems);
            }
            continue;
        }
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        match cells[..] {
            [""] => {}
            ["transfer", ..] => turn_over(&mut design),
            // The row of titles.
            ["angle", ..] if design.facets.is_empty() => {}
            [angle, index, depth, ref rest @ ..] => {
                let name = rest.first().filter(|name| !name.is_empty());
                let number = |of: &str, cell: &str, problems: &mut Problems| {
                    let value = cell.parse::<f64>().ok().filter(|value| value.is_finite());
                    if value.is_none() {
                        let what = format!("\"{cell}\" is no number for the {of}");
                        let name = name.copied();
                        problems.report(at, name, what, "write a decimal number");
                    }
                    value
                };
                let angle_deg = number("angle", angle, problems);
                let index = number("index", index, problems);
                let distance = number("depth", depth, problems);
                if let (Some(angle_deg), Some(index), Some(distance)) = (angle_deg, index, distance)
                {
                    let note = rest
                        .get(1)
                        .map_or(String::new(), |note| (*note).to_string());
                    let tier = Tier {
                        line: at,
                        angle_deg,
                        distance,
                        indices: vec![(index, name.map(|name| (*name).to_string()))],
                        preform: note.to_ascii_lowercase().starts_with("preform"),
                        note,
                    };
                    design.add(tier, problems);
                }
            }
            _ => {
                let what = format!("the row has {} cells", cells.len());
                problems.report(at, None, what, "write angle,index,depth or transfer");
            }
        }
    }
    if !has_gear {
        problems.report(
            0,
            None,
            "the index wheel is missing",
            "write a comment `# gear = 96`",
        );
    }
    if design.facets.is_empty() {
        problems.report(
            0,
            None,
            "the design has no facet",
            "write rows angle,index,depth",
        );
    }
    Some(design)
}

/// A setting in a comment of a CSV list; other comments have no meaning.
fn setting(design: &mut Design, key: &str, value: &str, line: usize, problems: &mut Problems) {
    if key == "title" {
        design.title = value.to_string();
        return;
    }
    if !["gear", "reference", "refractive_index", "symmetry"].contains(&key) {
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
        _ => design.set_symmetry(number, false, line, problems),
    }
}
