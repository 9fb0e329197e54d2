//! Gems of the examples: facets, symmetry, meet points.

use super::{example, gem, small};
use haptimill_facet::{Gem, Measured, Stage, read};
use haptimill_hil_sim::polyhedron::Plane;
use haptimill_hil_sim::vector::{length, minus};
use proptest::prelude::*;

#[test]
fn the_round_brilliant_has_57_facets_and_its_meets() {
    let gem = gem("round-brilliant.asc");
    assert_eq!(count(&gem, Stage::Girdle), 16);
    assert_eq!(count(&gem, Stage::Pavilion), 24);
    assert_eq!(count(&gem, Stage::Crown), 32);
    assert_eq!(count(&gem, Stage::Table), 1);
    assert_eq!(gem.body.faces().len(), 57 + 16);
    // The culet: eight mains in one point.
    let lowest = gem
        .meets
        .iter()
        .min_by(|a, b| a.at[2].total_cmp(&b.at[2]))
        .unwrap();
    assert_eq!(lowest.facets.len(), 8);
    // The table is an octagon; a kite, two stars and the table meet at its corners.
    let table = gem.design.facets.len() - 1;
    let corners = gem.meets.iter().filter(|meet| meet.facets.contains(&table));
    let corners: Vec<usize> = corners.map(|meet| meet.facets.len()).collect();
    assert_eq!(corners, [4; 8]);
    let four = gem
        .meets
        .iter()
        .filter(|meet| meet.facets.len() == 4)
        .count();
    assert!(four >= 24, "{four} points of four facets");
    let (left, right) = (
        gem.body.reach([-1.0, 0.0, 0.0]),
        gem.body.reach([1.0, 0.0, 0.0]),
    );
    // The corners of the girdle of 16 sides are farther out than its sides.
    assert!((left + right - 6.0).abs() < 1e-3, "{left} {right}");
}

#[test]
fn the_other_examples_are_of_other_symmetry() {
    let pentagon = gem("pentagon.asc");
    assert_eq!(pentagon.design.symmetry.order, 5);
    assert_eq!(pentagon.body.faces().len(), 36 + 10);
    let step = gem("step-cut.toml");
    assert_eq!(step.design.gear, 64);
    assert_eq!(step.body.faces().len(), step.design.facets.len());
    assert!(step.yield_part() > 0.2 && step.yield_part() < 0.6);
}

/// Rotations of the symmetry map the vertices onto each other.
#[test]
fn the_gems_have_the_symmetry_that_they_state() {
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        let gem = gem(name);
        let turn = core::f64::consts::TAU / f64::from(gem.design.symmetry.order);
        let (s, c) = turn.sin_cos();
        for at in gem.body.vertices() {
            let turned = [c * at[0] - s * at[1], s * at[0] + c * at[1], at[2]];
            let near = gem
                .body
                .vertices()
                .iter()
                .any(|other| length(minus(*other, turned)) < 1e-5);
            assert!(near, "{name}: {at:?}");
        }
    }
}

/// Distances with five decimals split the meet points of a design into vertices that are some
/// micrometres apart. They are the same points.
#[test]
fn rounded_distances_keep_the_meet_points() {
    for name in ["round-brilliant.asc", "pentagon.asc"] {
        let exact = gem(name);
        for decimals in [1e5, 1e6] {
            let mut design = exact.design.clone();
            for facet in &mut design.facets {
                facet.distance = (facet.distance * decimals).round() / decimals;
            }
            let rounded = Gem::new(name, design, 6.0, None).unwrap();
            let facets = |gem: &Gem| {
                let facets = gem.meets.iter().map(|meet| meet.facets.clone());
                facets.collect::<std::collections::BTreeSet<_>>()
            };
            assert_eq!(facets(&exact), facets(&rounded), "{name}");
        }
    }
}

/// The stone of a design whose facets are off by up to 2 um each has every meet point within the
/// displacement that the gain allows.
#[test]
fn a_stone_with_small_errors_has_its_meet_points() {
    let name = "round-brilliant.asc";
    let mut design = read(name, &example(name)).unwrap();
    for facet in &mut design.facets {
        facet.distance = (facet.distance * 1e5).round() / 1e5;
    }
    let gem = Gem::new(name, design, 6.0, None).unwrap();
    let mut stone = gem.rough_body();
    for (number, facet) in gem.design.facets.iter().enumerate() {
        let plane = gem.plane(number);
        let off = 2e-3 * (12.9898 * facet.index + 78.233 * facet.angle_deg).sin();
        let distance = plane.distance + off;
        stone.cut(Plane { distance, ..plane }, number);
    }
    let measured = Measured::new(&gem, &stone, &[]);
    assert_eq!(measured.lost_meets().count(), 0);
    assert!(measured.worst_meet_mm() > 1e-3);
    for result in &measured.meets {
        let bound = 0.02 + 2.1e-3 * gem.meets[result.meet].gain;
        assert!(result.error_mm < bound, "{result:?}");
    }
    // Without table and stars the stone lacks their points, and is off by a distance.
    let mut stone = gem.rough_body();
    for (number, facet) in gem.design.facets.iter().enumerate() {
        if facet.stage != Stage::Crown && facet.stage != Stage::Table || facet.angle_deg > 25.0 {
            stone.cut(gem.plane(number), number);
        }
    }
    let measured = Measured::new(&gem, &stone, &[]);
    assert!(measured.lost_meets().count() >= 8);
    assert!(measured.worst_meet_mm() > 0.02 && measured.worst_meet_mm() < 6.0);
}

/// A stone is out of tolerance when a facet is off by more than 0.02 degrees, or a meet point by
/// more than 0.02 mm. The worst one is named.
#[test]
fn a_stone_out_of_tolerance_names_its_worst_facet_and_point() {
    let gem = Gem::new("small.asc", small(), 2.5, None).unwrap();
    // The table is tilted about y, and higher.
    let stone = |tilt_deg: f64, higher_mm: f64| {
        let mut stone = gem.rough_body();
        for number in 0..gem.design.facets.len() {
            let mut plane = gem.plane(number);
            if number == 12 {
                let (sin, cos) = tilt_deg.to_radians().sin_cos();
                plane.normal = [sin, 0.0, cos];
                plane.distance += higher_mm;
            }
            stone.cut(plane, number);
        }
        Measured::new(&gem, &stone, &[])
    };
    assert_eq!(stone(0.0, 0.0).beyond(&gem), None);
    assert_eq!(stone(0.0199, 0.0).beyond(&gem), None);
    let expected = "the angle of facet T@0 is off by 0.0201 deg, and 0.02 deg is the most";
    assert_eq!(stone(0.0201, 0.0).beyond(&gem).as_deref(), Some(expected));
    // Its corners move by a depth along the crown.
    let gain = stone(0.0, 0.01).worst_meet_mm() / 0.01;
    assert!(gain > 1.0, "{gain}");
    assert_eq!(stone(0.0, 0.0199 / gain).beyond(&gem), None);
    let found = stone(0.0, 0.0201 / gain).beyond(&gem).unwrap();
    assert!(found.starts_with("the meet point of C@"), "{found}");
    assert!(
        found.ends_with("T@0 is off by 0.0201 mm, and 0.02 mm is the most"),
        "{found}"
    );
    let both = stone(0.03, 0.05).beyond(&gem).unwrap();
    assert!(
        both.contains("0.0300 deg") && both.contains("mm is the most"),
        "{both}"
    );
}

/// A culet of very many facets is a design in some seconds: the gain of a point is found from a
/// part of them.
#[test]
fn a_culet_of_very_many_facets_is_cut_in_seconds() {
    let count = 900;
    let positions = |count: u32| {
        let index = |at: u32| format!(" {:.5}", 120.0 * f64::from(at) / f64::from(count));
        (0..count).map(index).collect::<String>()
    };
    let text = format!(
        "g 120 0\na -90 1{}\na -45 0.72{}\na 0 0.3 0 n T\nF\n",
        positions(60),
        positions(count)
    );
    let started = std::time::Instant::now();
    let design = read("cone.asc", text.as_bytes()).unwrap();
    let gem = Gem::new("cone.asc", design, 6.0, None).unwrap();
    let max = gem
        .meets
        .iter()
        .map(|meet| meet.facets.len())
        .max()
        .unwrap();
    assert!(max > 800, "{max} facets in a point");
    let gain = gem.meets.iter().map(|meet| meet.gain).fold(0.0, f64::max);
    assert!(gain > 10.0, "{gain}");
    println!("gain {gain} in {:.1?}", started.elapsed());
    assert!(started.elapsed().as_secs() < 60);
}

fn count(gem: &Gem, stage: Stage) -> usize {
    gem.design
        .facets
        .iter()
        .filter(|facet| facet.stage == stage)
        .count()
}

proptest! {
    /// Distances and angles that are off by a little change the volume by a little.
    #[test]
    fn a_small_change_is_a_small_change(by in -1e-6..1e-6_f64) {
        let mut design = small();
        for facet in &mut design.facets {
            facet.distance += by;
        }
        let one = Gem::new("a", small(), 2.0, None).unwrap();
        let other = Gem::new("a", design, 2.0, None).unwrap();
        prop_assert!((one.body.volume() - other.body.volume()).abs() < 1e-4);
    }
}
