//! Work files: what is clamped on the table of the simulated machine, in TOML with the keys of a `[plant.workpiece]` section.

use super::Problems;
use super::document::Document;
use haptimill_hil_sim::process::{CuttingConfig, WorkpieceConfig};
use std::path::Path;
use toml::de::{DeTable, DeValue};

/// Reads a work file. A file that cannot be read is a problem of line 0.
///
/// # Errors
/// Every problem of the file; what cannot be read at all is found one at a time.
pub fn load(path: &Path) -> Result<WorkpieceConfig, Problems> {
    let file = path.display().to_string();
    let text = super::text_of(path)?;
    parse(&file, &text)
}

/// Reads the text of a work file; `file` is its name in messages.
///
/// # Errors
/// As [`load`].
pub fn parse(file: &str, text: &str) -> Result<WorkpieceConfig, Problems> {
    let document = Document::new(file, text);
    let workpiece: WorkpieceConfig = match toml::from_str(text) {
        Ok(workpiece) => workpiece,
        Err(error) => {
            let offset = error.span().map_or(0, |span| span.start);
            let message = error.message().trim().replace('\n', ", ");
            document.report(offset, "", message, "see examples/block.toml");
            return Err(document.into_problems());
        }
    };
    let config = CuttingConfig {
        workpiece,
        ..CuttingConfig::default()
    };
    let (root, _) = DeTable::parse_recoverable(text);
    for error in config.check().err().unwrap_or_default() {
        let mut offset = 0;
        let mut table = Some(root.get_ref());
        let parts: Vec<&str> = error.field.split(": ").skip(1).collect();
        for part in &parts {
            let value = table.and_then(|table| table.get(*part));
            offset = value.map_or(offset, |value| value.span().start);
            table = value.and_then(|value| match value.get_ref() {
                DeValue::Table(table) => Some(table),
                _ => None,
            });
        }
        document.report(offset, parts.join("."), error.problem, "correct it");
    }
    document.finish()?;
    Ok(config.workpiece)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_works_of_the_examples_are_well() {
        for text in [
            include_str!("../../../examples/block.toml"),
            include_str!("../../../examples/incline.toml"),
        ] {
            let work = parse("work.toml", text).unwrap_or_else(|problems| panic!("\n{problems}"));
            assert!((work.top_mm - 21.232).abs() < 1e-9);
        }
        let incline = parse(
            "incline.toml",
            include_str!("../../../examples/incline.toml"),
        );
        assert!((incline.unwrap().rise_x_deg + 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_mistake_is_told_at_its_line() {
        for (text, told) in [
            (
                "top_mm = 1.0\ncell_mm = 5.0\n",
                "work.toml:2:11: cell_mm: 5 is not within 0.01 to 1; correct it",
            ),
            (
                "top_mm = 1.0\nstock = { x_min = 0.0, x_max = -5.0, y_min = 0.0, y_max = 9.0 }\n",
                "work.toml:2:32: stock.x_max: -5 is not within 1 to 2000; correct it",
            ),
            (
                "top = 1.0\n",
                "work.toml:1:1: unknown field `top`, expected one of `stock`, `map`, `cell_mm`, `top_mm`, `rise_x_deg`, `rise_y_deg`, \
                 `bottom_mm`; see examples/block.toml",
            ),
        ] {
            let problems = parse("work.toml", text).unwrap_err();
            assert_eq!(problems.to_string(), told, "{text}");
        }
    }
}
