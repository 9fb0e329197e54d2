//! Image of the cut surface from above: light from the upper left, blue where the cut is deep.

use haptimill_hil_sim::process::Workpiece;
use haptimill_hil_sim::process::metrology::Picture;
use haptimill_report::Cut;
use haptimill_report::chart::Backdrop;

/// Largest number of pixels along the longer side of the map.
const LARGEST_SIDE: usize = 1400;

/// Uncut margin around the cut, mm.
const MARGIN: f64 = 3.0;

/// Depth from which a point counts as cut, mm.
const CUT: f64 = 0.02;

/// What was cut from a stock, for the report of a job.
#[must_use]
pub fn cut_of(stock: &Workpiece) -> Cut {
    Cut {
        removed_mm3: stock.removed_mm3(),
        depth_mm: greatest_depth(stock),
        surface: render(stock),
    }
}

/// Renders the cut part of the stock; none when nothing is cut.
pub(super) fn render(stock: &Workpiece) -> Option<Backdrop> {
    let cut = stock.extents(CUT)?;
    let picture = stock.picture(LARGEST_SIDE);
    let cell = (picture.area.x_max - picture.area.x_min) / (picture.columns.max(2) - 1) as f64;
    let span = |low: f64, high: f64, origin: f64, count: usize| {
        let first = ((low - MARGIN - origin) / cell).floor().max(0.0) as usize;
        let last = ((high + MARGIN - origin) / cell).ceil().max(0.0) as usize;
        (first.min(count - 1), last.clamp(1, count - 1))
    };
    let columns = span(cut.x_min, cut.x_max, picture.area.x_min, picture.columns);
    let rows = span(cut.y_min, cut.y_max, picture.area.y_min, picture.rows);
    let deepest = picture.depths.iter().copied().fold(0.0, f32::max);
    let mut pixels = Vec::new();
    // Rows of an image go down, y goes up.
    for row in (rows.0..=rows.1).rev() {
        for column in columns.0..=columns.1 {
            pixels.extend_from_slice(&pixel(&picture, column, row, cell, deepest));
        }
    }
    let (wide, high) = (columns.1 - columns.0 + 1, rows.1 - rows.0 + 1);
    let png = png(wide as u32, high as u32, &pixels)?;
    let x = |column: usize| picture.area.x_min + column as f64 * cell;
    let y = |row: usize| picture.area.y_min + row as f64 * cell;
    Some(Backdrop {
        data: format!("data:image/png;base64,{}", base64(&png)),
        x: (x(columns.0), x(columns.1)),
        y: (y(rows.0), y(rows.1)),
    })
}

/// Greatest depth below the uncut top, mm.
pub(super) fn greatest_depth(stock: &Workpiece) -> f64 {
    let picture = stock.picture(LARGEST_SIDE);
    f64::from(picture.depths.iter().copied().fold(0.0, f32::max))
}

/// Colours of the uncut top and of the greatest depth.
pub(super) const TOP: [f64; 3] = [240.0, 236.0, 226.0];
/// See [`TOP`].
pub(super) const DEEP: [f64; 3] = [38.0, 92.0, 148.0];

fn pixel(picture: &Picture, column: usize, row: usize, cell: f64, deepest: f32) -> [u8; 3] {
    let height =
        |column: usize, row: usize| f64::from(picture.heights[row * picture.columns + column]);
    let (left, right) = (
        column.saturating_sub(1),
        (column + 1).min(picture.columns - 1),
    );
    let (below, above) = (row.saturating_sub(1), (row + 1).min(picture.rows - 1));
    let slope_x = (height(right, row) - height(left, row)) / ((right - left).max(1) as f64 * cell);
    let slope_y =
        (height(column, above) - height(column, below)) / ((above - below).max(1) as f64 * cell);
    // Light from the upper left at 45 degrees. Slopes are reduced: walls would be black or white.
    let (slope_x, slope_y) = (0.6 * slope_x, 0.6 * slope_y);
    let length = (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
    let light = (0.5 * slope_x - 0.5 * slope_y + 0.707) / length;
    let shade = 0.45 + 0.55 * (light / 0.707).clamp(0.0, 1.35);
    let depth = f64::from(picture.depths[row * picture.columns + column]);
    let part = (depth / f64::from(deepest.max(1e-6))).clamp(0.0, 1.0);
    std::array::from_fn(|i| {
        let colour = TOP[i] + part * (DEEP[i] - TOP[i]);
        (colour * shade).clamp(0.0, 255.0).round() as u8
    })
}

/// Encodes a PNG of three bytes per pixel; none when the sizes do not fit.
fn png(wide: u32, high: u32, pixels: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, wide, high);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(pixels).ok()?;
    writer.finish().ok()?;
    Some(bytes)
}

/// Encodes base64 (RFC 4648, with padding).
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |index: usize| u32::from(chunk.get(index).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for digit in 0..4 {
            if digit <= chunk.len() {
                text.push(char::from(DIGITS[(word >> (18 - 6 * digit) & 63) as usize]));
            } else {
                text.push('=');
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_test_vectors_of_rfc_4648() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }
}
