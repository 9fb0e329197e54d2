//! Designs that are cut with a notice: positions, order of the sides, symmetry.

use super::{SMALL, gem};
use haptimill_facet::{Gem, Side, read};

/// Planes and notices of a design that can be cut.
fn cut(name: &str, text: &str) -> (Gem, Vec<String>) {
    let design = read(name, text.as_bytes()).unwrap_or_else(|refused| panic!("{refused}"));
    let notices = design.notices.iter().map(|it| it.text(name)).collect();
    let gem = Gem::new(name, design, 6.0, None).unwrap_or_else(|refused| panic!("{refused}"));
    (gem, notices)
}

/// GemCad writes the position 0 of a wheel as the number of its teeth with the sign of the gear.
/// Positions repeat after a turn. A negative gear counts the other way.
#[test]
fn positions_are_counted_modulo_the_gear() {
    let (plain, _) = cut("small.asc", SMALL);
    // The same stone, with positions of a wheel whose numbers run clockwise.
    let (other, notices) = cut(
        "clockwise.asc",
        "GemCad 5.0\r\ng -96 48.0\r\ny 4 y\r\nI 1.54\r\nH Small\r\n\
         a -90.000000 1.00000000 -96 24 n G 72 48\r\na -45.000000 0.72000000 24 n P -96 48\r\n 72\r\n\
         a 40.000000 0.70000000 -96 n C 24 -48 -24\r\na 0.000000 0.30000000 -96 n T\r\nF end\r\n",
    );
    assert_eq!(notices, [] as [&str; 0]);
    assert!((plain.body.volume() - other.body.volume()).abs() < 1e-9);
    let names: Vec<&str> = other
        .design
        .facets
        .iter()
        .map(|it| it.name.as_str())
        .collect();
    assert_eq!(names[..4], ["G@96", "G@24", "G@72", "G@48"]);
    assert_eq!(names[8..], ["C@96", "C@24", "C@48", "C@72", "T@96"]);
    // Position 48 is azimuth 0, and an eighth of a turn on is -45 degrees.
    assert!(other.design.azimuth_deg(48.0).abs() < 1e-9);
    assert!((other.design.azimuth_deg(60.0) + 45.0).abs() < 1e-9);
    // A chiral stone: the one facet beside the axis of the mirror is on the side of its azimuth.
    let text = |gear: &str| {
        let one = SMALL.replace("g 64 0.0", &format!("g {gear} 0.0"));
        one.replace("y 4 y", "y 1 n")
            .replace("n T\n", "n T\na 20 0.5 10 n X\n")
    };
    for (gear, sign) in [("64", 1.0), ("-64", -1.0)] {
        let (gem, _) = cut("chiral.asc", &text(gear));
        let normal = gem.plane(13).normal;
        let azimuth = normal[1].atan2(normal[0]).to_degrees();
        assert!((azimuth - sign * 56.25).abs() < 1e-9, "{gear}: {azimuth}");
    }
}

/// GemCad lists planes; the order may go between the sides, and a plane may come twice.
#[test]
fn tiers_in_any_order_are_cut_by_side() {
    let (plain, none) = cut("small.asc", SMALL);
    assert_eq!(none, [] as [&str; 0]);
    let (mixed, notices) = cut(
        "mixed.asc",
        "GemCad 4.51\ng 64 64.0\ny 4 y\nI 1.54\nH Mixed\na -90.00 1.00000 0 32\n\
         a 40.00 0.70000 0 16 32 48\na -45.00 0.72000 0 16\na -90.00 1.00000 16 48\n\
         a 0.00 0.30000 0\na -90.00 1.00000 64\na -45.00 0.72000 32 48\n",
    );
    assert!((plain.body.volume() - mixed.body.volume()).abs() < 1e-9);
    assert_eq!(mixed.body.faces().len(), 13);
    let sides: Vec<Side> = mixed.design.facets.iter().map(|facet| facet.side).collect();
    let pavilion = sides.iter().filter(|side| **side == Side::Pavilion).count();
    assert_eq!(pavilion, 8);
    assert!(sides[..8].iter().all(|side| *side == Side::Pavilion));
    let expected = [
        "mixed.asc:8: facet 3@0: is behind facets of the other side; the stone is turned over once, \
         and the side of the pavilion is cut first",
        "mixed.asc:11: facet 6@64: is the plane of facet 1@0 of line 6 and is not cut again",
    ];
    assert_eq!(notices.len(), 2, "{notices:?}");
    for (notice, expected) in notices.iter().zip(expected) {
        assert!(notice.contains(expected), "{notice}");
    }
}

/// A facet that breaks the symmetry of its file is named with the position that is missing.
#[test]
fn broken_symmetry_and_a_missing_table_are_notices() {
    for (from, to, expected) in [
        (
            "P 16 32 48",
            "P 16 32 47",
            "small.asc:7: facet P@0: has no partner at index 48, which the symmetry `y 4 y` asks for",
        ),
        (
            "P 16 32 48",
            "P 16 32 47",
            "small.asc:7: facet P@47: has no partner at index 1, 15, 17",
        ),
        (
            "y 4 y",
            "y 5 n",
            "small.asc:6: facet G@0: has no partner at index 12.8, 25.6, 38.4, 51.2, which",
        ),
        ("y 4 y", "y 8 y", "small.asc:7: 7 more facets"),
        ("a 0 0.3 0 n T\n", "", "small.asc: the design has no table"),
        (
            "n T\nF end\n",
            "n T",
            "small.asc:9: the last line has no line end",
        ),
    ] {
        assert!(SMALL.contains(from));
        let design = read("small.asc", SMALL.replace(from, to).as_bytes());
        let design = design.unwrap_or_else(|refused| panic!("{refused}"));
        let texts = design.notices.iter().map(|notice| notice.text("small.asc"));
        let texts: Vec<String> = texts.collect();
        assert!(
            texts.iter().any(|text| text.contains(expected)),
            "{from:?} -> {to:?}: {texts:#?}"
        );
    }
    for (from, to) in [("y 4 y", "y 1 n"), ("y 4 y", "y 2 y"), ("y 4 y\n", "")] {
        let design = read("small.asc", SMALL.replace(from, to).as_bytes()).unwrap();
        assert_eq!(design.notices, [], "{to}");
    }
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        assert_eq!(gem(name).design.notices, [], "{name}");
    }
}
