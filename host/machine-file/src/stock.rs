//! Stock files: the stock on the table of the simulated machine, in TOML with the keys of a
//! `[plant.workpiece]` section.

use super::Problems;
use super::document::Document;
use super::keys::sections;
use haptimill_hil_sim::process::{CuttingConfig, WorkpieceConfig};
use std::path::Path;
use toml::de::{DeTable, DeValue};

/// Reads a stock file. A file that cannot be read is a problem of line 0.
///
/// # Errors
///
/// Returns every problem of the values, or the first problem of keys and types.
pub fn load(path: &Path) -> Result<WorkpieceConfig, Problems> {
    let file = path.display().to_string();
    let text = super::read_text(path)?;
    parse(&file, &text)
}

/// Reads the text of a stock file; `file` is its name in messages.
///
/// # Errors
///
/// As [`load`].
pub fn parse(file: &str, text: &str) -> Result<WorkpieceConfig, Problems> {
    let document = Document::new(file, text, sections());
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
        document.report(offset, parts.join("."), error.problem, "");
    }
    document.finish()?;
    Ok(config.workpiece)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn example_stock_files_are_valid() {
        for text in [
            include_str!("../../../examples/block.toml"),
            include_str!("../../../examples/incline.toml"),
        ] {
            let stock = parse("stock.toml", text).unwrap_or_else(|problems| panic!("\n{problems}"));
            assert!((stock.top_mm - 21.232).abs() < 1e-9);
        }
        let incline = parse(
            "incline.toml",
            include_str!("../../../examples/incline.toml"),
        );
        assert!((incline.unwrap().rise_x_deg + 10.0).abs() < 1e-9);
    }

    #[test]
    fn problems_name_their_line() {
        for (text, message) in [
            (
                "top_mm = 1.0\ncell_mm = 5.0\n",
                "stock.toml:2:11: cell_mm: 5 is out of range, allowed is 0.01 to 1; lower it",
            ),
            (
                "top_mm = 1.0\nstock = { x_min = 0.0, x_max = -5.0, y_min = 0.0, y_max = 9.0 }\n",
                "stock.toml:2:32: stock.x_max: -5 is out of range, allowed is 1 to 2000; raise it",
            ),
            (
                "top = 1.0\n",
                "stock.toml:1:1: unknown field `top`, expected one of `stock`, `map`, `cell_mm`, `top_mm`, `rise_x_deg`, `rise_y_deg`, \
                 `bottom_mm`; see examples/block.toml",
            ),
        ] {
            let problems = parse("stock.toml", text).unwrap_err();
            assert_eq!(problems.to_string(), message, "{text}");
        }
    }
}
