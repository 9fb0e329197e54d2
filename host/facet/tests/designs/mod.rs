//! Designs: the examples, formats, and what is refused.

mod formats;
mod gems;
mod jobs;
mod notices;
mod refusals;
mod report;

use haptimill_facet::{Gem, Rough, read};

fn example(name: &str) -> Vec<u8> {
    let path = format!("{}/../../examples/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read(path).unwrap()
}

fn gem(name: &str) -> Gem {
    let design = read(name, &example(name)).unwrap_or_else(|refused| panic!("{refused}"));
    Gem::new(name, design, 6.0, None).unwrap_or_else(|refused| panic!("{refused}"))
}

const SMALL: &str = "GemCad 5.0\ng 64 0.0\ny 4 y\nI 1.54\nH Small\n\
a -90 1.0 0 n G 16 32 48\na -45 0.72 0 n P 16 32 48 G to a point\n\
a 40 0.70 0 n C 16 32 48\na 0 0.3 0 n T\nF end\n";

fn small() -> haptimill_facet::Design {
    read("small.asc", SMALL.as_bytes()).unwrap()
}

fn problem(name: &str, text: &str) -> String {
    let refused = match read(name, text.as_bytes()) {
        Err(refused) => refused,
        Ok(design) => {
            let rough = Rough {
                diameter_mm: 14.0,
                height_mm: 12.0,
            };
            Gem::new(name, design, 6.0, Some(rough)).expect_err("a problem")
        }
    };
    refused.to_string()
}
