//! Bars drawn with characters.

/// Bar around zero for a range in parts of full scale (-1 to 1). A cell is filled when its middle
/// is within the range extended to zero.
pub(super) fn around_zero(low: f64, high: f64, width: usize) -> String {
    let half = width / 2;
    let cell = |index: usize, side: f64| (index as f64 / half.max(1) as f64) * side;
    let mut bar = String::new();
    for index in (0..half).rev() {
        // Cell from -(index + 1) to -index.
        let (far, near) = (cell(index + 1, -1.0), cell(index, -1.0));
        bar.push(fill(low.min(0.0), high, far, near));
    }
    bar.push('│');
    for index in 0..half {
        let (near, far) = (cell(index, 1.0), cell(index + 1, 1.0));
        bar.push(fill(low, high.max(0.0), near, far));
    }
    bar
}

/// A part in percent, without the sign of a negative value that rounds to zero.
pub(super) fn percent(part: f64) -> String {
    format!("{:.0}", (part * 100.0).round() + 0.0)
}

fn fill(low: f64, high: f64, from: f64, to: f64) -> char {
    let middle = (from + to) / 2.0;
    // The bar always starts at zero.
    let (low, high) = (low.min(0.0), high.max(0.0));
    if middle >= low && middle <= high {
        '█'
    } else {
        '·'
    }
}

/// Bar from the left for a part of full scale, 0 to 1.
pub(super) fn from_left(part: f64, width: usize) -> String {
    let filled = (part.clamp(0.0, 1.0) * width as f64).round() as usize;
    "█".repeat(filled) + &"·".repeat(width - filled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_percent_has_no_sign() {
        for (part, text) in [(-0.004, "0"), (0.0, "0"), (-0.006, "-1"), (0.5, "50")] {
            assert_eq!(percent(part), text);
        }
    }

    #[test]
    fn bars_start_at_zero() {
        assert_eq!(around_zero(0.0, 0.0, 8), "····│····");
        assert_eq!(around_zero(0.0, 0.5, 8), "····│██··");
        assert_eq!(around_zero(-1.0, 0.0, 8), "████│····");
        assert_eq!(around_zero(-0.25, 1.0, 8), "···█│████");
        assert_eq!(around_zero(-9.0, 9.0, 8), "████│████");
        assert_eq!(around_zero(0.6, 0.7, 8), "····│███·");
        assert_eq!(from_left(0.5, 10), "█████·····");
        assert_eq!(from_left(f64::NAN, 2), "··");
        assert_eq!(from_left(7.0, 2), "██");
    }
}
