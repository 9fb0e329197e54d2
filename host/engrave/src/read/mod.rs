//! Readers of drawing files.

mod dxf;
mod nurbs;
mod svg;
pub mod text;

use crate::drawing::{Drawing, Problem};
use encoding_rs::{Encoding, UTF_8};
use text::Font;

/// Largest number of entities after blocks are expanded.
pub const ENTITY_LIMIT: usize = 4_000_000;

/// Largest coordinate of a drawing that stays where it is: units of a DXF, mm of an SVG.
pub const COORDINATE_LIMIT: f64 = 1e6;

/// Largest coordinate of one that is moved to the origin. Coordinates of surveys reach 1e10 mm,
/// where the resolution of numbers is 2e-6 mm.
pub const FAR_LIMIT: f64 = 1e10;

/// What is to be done about points that are too far away.
const FAR_REMEDY: &str =
    "move the whole drawing with --origin lower-left, or move or delete the entity";

/// What the caller states about a drawing.
#[derive(Default)]
pub struct ReadOptions<'a> {
    /// Millimetres per unit of the drawing; `None` for the unit that the file states.
    pub unit_mm: Option<f64>,
    /// Factor of the drawing's size about its origin; `None` for 1. Curves become arcs at the
    /// final size, so that their deviation does not grow with it.
    pub scale: Option<f64>,
    /// Font of text; without one a text is a problem.
    pub font: Option<&'a Font<'a>>,
    /// Whether text without a font is left out with a notice instead of being a problem.
    pub skip_text: bool,
    /// Whether the drawing is moved to the origin afterwards, so that it may be far from it.
    pub moved: bool,
    /// Whether elements with a clip path or a mask are cut whole, with a notice, instead of being
    /// problems.
    pub ignore_clips: bool,
}

/// Reads a drawing. The content decides between DXF and SVG, not the name.
///
/// # Errors
/// The first mistake after which the rest of the file cannot be read. Mistakes of single entities
/// are in [`Drawing::problems`].
pub fn read(bytes: &[u8], options: &ReadOptions) -> Result<Drawing, Problem> {
    let text;
    let start = match Encoding::for_bom(bytes) {
        Some((encoding, mark)) if encoding != UTF_8 => {
            text = encoding.decode_without_bom_handling(&bytes[mark..]).0;
            text.as_bytes()
        }
        Some((_, mark)) => &bytes[mark..],
        None => bytes,
    };
    if start.starts_with(b"AutoCAD Binary DXF") {
        return Err(Problem::general(
            "the file is a binary DXF",
            "save the drawing as ASCII DXF",
        ));
    }
    if start.starts_with(b"AC10") {
        return Err(Problem::general(
            "the file is a DWG",
            "save the drawing as ASCII DXF",
        ));
    }
    if start.starts_with(&[0x1f, 0x8b]) {
        return Err(Problem::general(
            "the file is compressed",
            "unpack it (an .svgz with gunzip) and pass the result",
        ));
    }
    let first = start.iter().find(|byte| !byte.is_ascii_whitespace());
    match first {
        None => Err(Problem::general(
            "the file is empty",
            "pass a DXF or SVG drawing",
        )),
        Some(b'<') => svg::read(start, options),
        Some(_) => dxf::read(start, options),
    }
}

/// The problem of text that cannot become outlines.
fn text_remedy() -> &'static str {
    "add --font FILE.ttf, convert the text to paths in the drawing program, or leave it out with \
     --skip-text"
}
