//! Rewrites the tables of keys in a page: `cargo xtask keys`.

use haptimill_machine_file::keys::{axes_of, sections};
use haptimill_machine_keys::page::rewrite;
use std::process::ExitCode;

fn main() -> ExitCode {
    let Some(page) = std::env::args().nth(1) else {
        eprintln!("usage: key_tables PAGE");
        return ExitCode::FAILURE;
    };
    let result = std::fs::read_to_string(&page)
        .map_err(|error| error.to_string())
        .and_then(|text| rewrite(&text, &sections(), axes_of))
        .and_then(|text| std::fs::write(&page, text).map_err(|error| error.to_string()));
    if let Err(error) = result {
        eprintln!("{page}: {error}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
