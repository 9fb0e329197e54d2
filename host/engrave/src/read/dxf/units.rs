//! Unit of a DXF: `$INSUNITS`, the measurement, and the tolerance of curves in that unit.

use super::Reader;
use crate::curves::TOLERANCE;
use crate::drawing::Problem;
use kurbo::Affine;

impl Reader<'_, '_> {
    /// Tolerance of curves in the units of an entity that is placed by a map.
    pub(super) fn tolerance(&self, map: Affine) -> f64 {
        let [a, b, c, d, ..] = map.as_coeffs();
        let size = a.hypot(b).max(c.hypot(d)) * self.millimetres().unwrap_or(1.0);
        TOLERANCE / size
    }

    /// Whether the unit is inches by the measurement only.
    fn english(&self) -> bool {
        matches!((self.unit, self.metric), (None | Some(0), Some(0)))
    }

    /// Millimetres per unit, with the factor of the caller.
    pub(super) fn millimetres(&self) -> Result<f64, Problem> {
        let unit = match (self.options.unit_mm, self.unit) {
            (Some(unit), _) => unit,
            (None, None | Some(0)) if self.english() => 25.4,
            (None, None | Some(0)) => 1.0,
            (None, Some(unit)) => millimetres_of(unit).ok_or_else(|| {
                Problem::general(
                    format!("the drawing's unit ($INSUNITS) is {unit}, which is not known"),
                    "state the unit with --unit mm or --unit inch",
                )
            })?,
        };
        Ok(unit * self.options.scale.unwrap_or(1.0))
    }

    /// Tells which unit is taken where the file states none.
    pub(super) fn note_unit(&mut self) {
        if self.options.unit_mm.is_some() || !matches!(self.unit, None | Some(0)) {
            return;
        }
        let notice = if self.english() {
            "the drawing states no unit, but English measurement: 1 unit is taken as 1 inch; \
             --unit mm sets millimetres"
        } else {
            "the drawing states no unit ($INSUNITS): 1 unit is taken as 1 mm; --unit inch sets \
             inches"
        };
        self.drawing.notices.push(notice.into());
    }
}

/// Millimetres per unit of a value of `$INSUNITS`.
fn millimetres_of(unit: i64) -> Option<f64> {
    Some(match unit {
        1 => 25.4,
        2 => 304.8,
        3 => 1_609_344.0,
        4 => 1.0,
        5 => 10.0,
        6 => 1000.0,
        7 => 1e6,
        8 => 25.4e-6,
        9 => 25.4e-3,
        10 => 914.4,
        11 => 1e-7,
        12 => 1e-6,
        13 => 1e-3,
        14 => 100.0,
        15 => 1e4,
        16 => 1e5,
        17 => 1e12,
        18 => 1.495_978_707e14,
        19 => 9.460_730_472_580_8e18,
        20 => 3.085_677_581_491_367e19,
        // The foot of the survey of the United States is 1200/3937 m.
        21 => 1_200_000.0 / 3937.0,
        22 => 100_000.0 / 3937.0,
        23 => 3_600_000.0 / 3937.0,
        24 => 6_336_000_000.0 / 3937.0,
        _ => return None,
    })
}
