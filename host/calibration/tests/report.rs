//! The text, the page and the JSON of the scenario mark what fails and what cannot be measured.

use haptimill_calibration::calibrate::Calibration;
use haptimill_calibration::comparison::side_table;
use haptimill_calibration::cut::Cmm;
use haptimill_calibration::laser::LaserOptions;
use haptimill_calibration::page::page;
use haptimill_calibration::scenario::{Outcome, State, Volume, summary, table};
use haptimill_volumetric::Vector;
use haptimill_volumetric::errors::ErrorSet;
use haptimill_volumetric::part::{Row, STRAIGHTNESS, probe_points};

/// An outcome with three sides: 2.42, 1.41 and 12 um of straightness.
fn outcome() -> Outcome {
    let surface = probe_points().map(|point| point.surface);
    let rows = [("X", 2.42e-3), ("Y", 1.41e-3), ("Z", 12e-3)].map(|(name, value)| {
        let row = Row {
            name: format!("side {name}"),
            value,
            zone: None,
            tolerance: Some(STRAIGHTNESS),
        };
        [row.clone(), row]
    });
    let state = State {
        name: "no compensation",
        volume: Volume::of(vec![Vector::zeros()], |_| Vector::x()),
        surface: surface.clone(),
        rows: rows.to_vec(),
        still: 0.0,
        circles: Vec::new(),
    };
    let runs = Cmm::default().probe(&surface);
    Outcome {
        states: vec![state],
        worn: Vec::new(),
        sides: [0, 3].map(|side| side_table(&runs, side)),
        comparison: Vec::new(),
        calibration: Calibration {
            axes: Vec::new(),
            errors: ErrorSet::default(),
            options: LaserOptions::ideal(),
            compensation: None,
        },
    }
}

/// Rows 27 and 40: a straightness of 12 um fails, and one of 1.41 um is below MPE_P of 1.9 um.
#[test]
fn rows_are_marked() {
    let outcome = outcome();
    let text = table(&outcome);
    for (name, expected) in [("X", "2.420 "), ("Y", "1.410*"), ("Z", "12.000!")] {
        let line = text
            .lines()
            .find(|line| line.starts_with(&format!("side {name}")));
        assert!(line.unwrap().ends_with(expected), "{line:?}");
    }
    let json: serde_json::Value = serde_json::from_str(&summary(&outcome)).unwrap();
    let rows = &json["states"][0]["test_piece"];
    for (row, passes, measurable) in [(0, true, true), (1, true, false), (2, false, true)] {
        assert_eq!(rows[row]["passes"], passes, "{row}");
        assert_eq!(rows[row]["measurable"], measurable, "{row}");
    }
    let page = page(&outcome);
    assert!(page.contains("<td class=\"n\">2.420 (2.42)</td>"));
    assert!(page.contains("<td class=\"n\">1.410 (1.41) *</td>"));
    assert!(page.contains("<td class=\"n bad\">12.000 (12.00)</td>"));
}
