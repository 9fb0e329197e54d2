//! `haptimill calibrate`: a measurement of the simulated machine, the readings of a laser as a
//! file, and the circle test.

mod arm;
mod ball_bar;
mod laser;
mod rewrite;
mod scenario;

use haptimill_volumetric::chain;
use haptimill_volumetric::file::{self, Limits};

fn machine() -> String {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = root.join("../../machines/vmc3.toml");
    path.canonicalize().unwrap().to_str().unwrap().to_string()
}

/// The lines of an error file that are no comments.
fn errors(path: &str) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(str::to_string).collect()
}

/// The number of a line that begins with a name.
fn value(out: &str, name: &str) -> f64 {
    let line = out.lines().find(|line| line.starts_with(name));
    let rest = line.unwrap_or_else(|| panic!("no {name} in {out}"));
    let words = rest[name.len()..].split_whitespace();
    words.filter_map(|word| word.parse().ok()).next().unwrap()
}

/// The error of the tool by the model of the chain, mm.
fn error_of(errors: &str, point: [f64; 3]) -> [f64; 3] {
    let errors = file::read(errors, &Limits::default()).unwrap();
    chain::Model::default().error(&errors, point.into()).into()
}

/// Squareness, urad, that a circle test about the origin shows on a machine with these errors:
/// -4 / r times the mean of the radial error times sin 2a.
fn ellipse(errors: &str, radius: f64) -> f64 {
    let parts = (0..360).map(|step| {
        let angle = f64::from(step).to_radians();
        let (sine, cosine) = angle.sin_cos();
        let [x, y, _] = error_of(errors, [radius * cosine, radius * sine, 0.0]);
        (x * cosine + y * sine) * (2.0 * angle).sin() / 360.0
    });
    -4e6 / radius * parts.sum::<f64>()
}
