//! Sections of pose coordinates and joints, each with its place in the model.

use super::document::Section;
use haptimill_firmware::config::AxisKind;
use haptimill_protocol::message::MAX_AXES;

/// A section of a list of axes, with the name and kind that the model has at its place.
pub(crate) type PlacedSection<'d, 'i> = (Section<'d, 'i>, Option<(&'static str, AxisKind)>);

/// Reads the sections of a list of axes, each with the name and kind that the model has at its
/// place; reports a wrong count and duplicate names.
pub(crate) fn read_axes<'d, 'i>(
    root: &Section<'d, 'i>,
    key: &'static str,
    places: &[(&'static str, AxisKind)],
) -> Vec<PlacedSection<'d, 'i>> {
    place_axes(root, key, root.list(key), places)
}

/// As [`read_axes`], of sections of the list.
pub(crate) fn place_axes<'d, 'i>(
    root: &Section<'d, 'i>,
    key: &'static str,
    sections: Vec<Section<'d, 'i>>,
    places: &[(&'static str, AxisKind)],
) -> Vec<PlacedSection<'d, 'i>> {
    // Without a model the axes are unknown.
    if !sections.is_empty() && !places.is_empty() && sections.len() != places.len() {
        let names: Vec<&str> = places.iter().map(|(name, _)| *name).collect();
        let what = format!(
            "has {} sections, the model has {}",
            sections.len(),
            places.len()
        );
        let mut remedy = format!("write one for each of {}", names.join(", "));
        if key == "pose" {
            remedy.push_str(&other_models(sections.len()));
        }
        root.report(key, what, remedy);
    }
    let mut seen: Vec<&str> = Vec::new();
    let count_fits = sections.len() == places.len();
    let mut result = Vec::new();
    for (index, section) in sections.into_iter().enumerate() {
        let name = section.peek_text("name");
        let is_duplicate = name.is_some_and(|name| seen.contains(&name));
        if let Some(name) = name {
            if is_duplicate {
                section.report("name", format!("\"{name}\" is a duplicate"), "rename one");
            }
            seen.push(name);
        }
        // With a wrong count or a duplicate name the places are shifted: one report is enough.
        let place = places.get(index).filter(|_| count_fits && !is_duplicate);
        result.push((section, place.copied()));
    }
    result
}

/// The end of the remedy for a file with `count` pose coordinates and a model with another number:
/// the models that have as many.
fn other_models(count: usize) -> String {
    let fitting = haptimill_kinematics::DESCRIPTORS
        .iter()
        .filter(|model| model.pose.len() == count);
    let codes: Vec<String> = fitting.map(|model| format!("\"{}\"", model.code)).collect();
    match codes.is_empty() {
        false => format!(", or choose a model with {count}: {}", codes.join(", ")),
        true if count > MAX_AXES => format!("; a machine has at most {MAX_AXES} coordinates"),
        true => format!(
            "; no model has {count} coordinates, docs/adding-a-machine.md says how to add one"
        ),
    }
}
