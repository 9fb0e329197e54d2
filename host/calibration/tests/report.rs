//! The text, the page and the JSON of the scenario mark what fails and what cannot be measured.

use haptimill_calibration::calibrate::Calibration;
use haptimill_calibration::comparison::{SideTable, side_table, table_5_1};
use haptimill_calibration::cut::Cmm;
use haptimill_calibration::laser::LaserOptions;
use haptimill_calibration::page::page;
use haptimill_calibration::scenario::{ScenarioResult, State, Volume, summary, table};
use haptimill_volumetric::Vector;
use haptimill_volumetric::errors::ErrorSet;
use haptimill_volumetric::file::{self, Limits};
use haptimill_volumetric::part::{Row, STRAIGHTNESS, probe_points};

/// An outcome with three sides: 2.42, 1.41 and 12 um of straightness.
fn outcome() -> ScenarioResult {
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
    ScenarioResult {
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

/// Row 40: of the published sides of a measuring machine, the one along y has a straightness below
/// its MPE_P. Text, page and JSON say so, and state the omission of errors.
#[test]
fn a_side_below_the_limit_of_the_measuring_machine_is_marked() {
    let sides = [
        (
            'x',
            include_str!("../../volumetric/tests/data/table_4_1_cmm_x_side.csv"),
        ),
        (
            'y',
            include_str!("../../volumetric/tests/data/table_4_2_cmm_y_side.csv"),
        ),
    ]
    .map(|(along, text)| SideTable::read(text, along, 3, 15).unwrap());
    let errors = include_str!("../../volumetric/data/vmc3_errors.csv");
    let errors = file::read(errors, &Limits::default()).unwrap();
    let mut outcome = outcome();
    outcome.comparison = table_5_1(&errors, &sides);
    outcome.sides = sides;
    outcome.calibration.errors = errors;
    let text = table(&outcome);
    let line = |start: &str| text.lines().find(|line| line.starts_with(start)).unwrap();
    let (x, y) = (line("X    polynomial"), line("Y    cubic spline"));
    assert!(x.ends_with("straightness 2.42 um"), "{x}");
    assert!(
        y.ends_with("straightness 1.41 um, below MPE_P 1.9 um"),
        "{y}"
    );
    assert!(text.contains("MPE_E is 2.38 um over the square"), "{text}");
    assert!(text.contains("\nwithout straightness  "), "{text}");
    let page = page(&outcome);
    assert!(page.contains("straightness 1.41 um, below MPE_P 1.9 um"));
    assert!(page.contains("without straightness"));
    let json: serde_json::Value = serde_json::from_str(&summary(&outcome)).unwrap();
    for (side, straightness, measurable) in [(0, 2.424, true), (1, 1.412, false)] {
        let line = &json["comparison"][side];
        let value = line["straightness_um"].as_f64().unwrap();
        assert!((value - straightness).abs() < 0.001, "{line}");
        assert_eq!(line["measurable"], measurable, "{line}");
    }
    let omission = &json["omission"][2];
    assert_eq!(omission["name"], "without straightness");
    assert!(
        omission["straightness_um"][0].as_f64().unwrap() < 0.12,
        "{omission}"
    );
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
