//! Designs: the examples, formats, and what is refused.

use haptimill_facet::{
    Coolant, Gem, Job, JobSettings, Measured, Mode, Rough, Side, Stage, check_machine, coolant,
    most_force_n, read,
};
use haptimill_hil_sim::polyhedron::Plane;
use haptimill_hil_sim::vector::{length, minus};
use haptimill_machine_file::MachineFile;
use proptest::prelude::*;

fn example(name: &str) -> Vec<u8> {
    let path = format!("{}/../../examples/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read(path).unwrap()
}

fn gem(name: &str) -> Gem {
    let design = read(name, &example(name)).unwrap_or_else(|refused| panic!("{refused}"));
    Gem::new(name, design, 6.0, None).unwrap_or_else(|refused| panic!("{refused}"))
}

fn count(gem: &Gem, stage: Stage) -> usize {
    gem.design
        .facets
        .iter()
        .filter(|facet| facet.stage == stage)
        .count()
}

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

const SMALL: &str = "GemCad 5.0\ng 64 0.0\ny 4 y\nI 1.54\nH Small\n\
a -90 1.0 0 n G 16 32 48\na -45 0.72 0 n P 16 32 48 G to a point\n\
a 40 0.70 0 n C 16 32 48\na 0 0.3 0 n T\nF end\n";

fn small() -> haptimill_facet::Design {
    read("small.asc", SMALL.as_bytes()).unwrap()
}

/// CRLF, tabs, comments, a mark, keywords without spaces, a tier over several lines, Latin-1.
#[test]
fn odd_files_of_gemcad_are_read() {
    let odd = "\u{feff}; a comment\r\ngemcad 4.51\r\ng64\t0.0\r\n y  4   y \r\nI 1.54\r\nH Small\r\n\r\n\
        a  -90\t 1.0   0   n  G  16\r\n  32 48\r\na-45 0.72 0 n P 16 32\r\n48\r\nG to a\r\nG point\r\n\
        a 40 0.70 0 16 32 48 n C ; the crown\r\na 0 0.3 n T\r\n";
    let refused = read("odd.asc", odd.as_bytes()).unwrap_err();
    // `n` behind no index names no facet.
    assert_eq!(refused.problems.len(), 1, "{refused}");
    let design = read("odd.asc", odd.replace("0.3 n T", "0.3").as_bytes()).unwrap();
    let plain = small();
    assert_eq!(design.facets.len(), plain.facets.len());
    for (odd, plain) in design.facets.iter().zip(&plain.facets) {
        assert_eq!((odd.angle_deg, odd.index), (plain.angle_deg, plain.index));
        assert_eq!((odd.side, odd.stage), (plain.side, plain.stage));
    }
    assert_eq!(design.facets[4].note, "to a point");
    assert_eq!(design.facets[8].name, "C@0");
    let latin = SMALL.replace("Small", "Gr\u{fc}n");
    let bytes: Vec<u8> = latin.chars().map(|letter| letter as u32 as u8).collect();
    assert_eq!(read("latin.asc", &bytes).unwrap().title, "Gr\u{fc}n");
}

/// What files of cutters have beside that: a culet of negative distance, the facets of the crown
/// first, several names in a tier, names that are numbers, half teeth, a wheel whose numbers run
/// clockwise, old line ends, footnotes in between.
#[test]
fn habits_of_cutters_are_read() {
    let text = "GemCad 5.0\rg -64 0.0\ry 2 n\rI 1.72\rH PC 45.149 Odd\rH by Nobody, 1990\r\
        a 0.000000 0.3 64 n T\ra 40 0.70 0 n 1 16 32 48.5 n 2 G ends in a name\r\
        F \"For small stones\"\r\
        a -90.00 1.0 0 16 n g1 32 48\ra -45 0.72 64 n 3 16 n 4 32 n 5 48 n 6\r\
        a 0.00 -0.6 0 n C\rF end\r";
    let design = read("habits.asc", text.as_bytes()).unwrap_or_else(|refused| panic!("{refused}"));
    assert!(design.reversed);
    assert_eq!((design.gear, design.facets.len()), (64, 14));
    assert_eq!(design.title, "PC 45.149 Odd");
    let names: Vec<&str> = design
        .facets
        .iter()
        .map(|facet| facet.name.as_str())
        .collect();
    assert_eq!(names[..5], ["T@64", "1@0", "1@16", "1@32", "2@48.5"]);
    assert_eq!(names[9..], ["3@64", "4@16", "5@32", "6@48", "C@0"]);
    // Clockwise: a quarter of the wheel is -90 degrees.
    assert!((design.azimuth_deg(16.0) + 90.0).abs() < 1e-9);
    let culet = design.facets.last().unwrap();
    assert_eq!((culet.side, culet.distance), (Side::Pavilion, 0.6));
    assert!((design.normal(culet)[2] + 1.0).abs() < 1e-12);
    // The crown and the girdle are cut first, and the stone is turned over once.
    assert_eq!(design.first_after_transfer(), Some(9));
    let gem =
        Gem::new("habits.asc", design, 3.0, None).unwrap_or_else(|refused| panic!("{refused}"));
    assert_eq!(gem.body.faces().len(), 14);
}

/// A list of the same facets makes the same stone.
#[test]
fn lists_and_gemcad_files_make_the_same_stone() {
    let mut csv = String::from("# gear = 64\n# symmetry = 4\nangle,index,depth,name,note\n");
    let mut toml = String::from("gear = 64\nsymmetry = 4\n");
    let mut over = false;
    let plain = small();
    for facet in &plain.facets {
        let below = facet.side == haptimill_facet::Side::Pavilion;
        if !below && !over {
            over = true;
            csv.push_str("transfer\n");
            toml.push_str("[[facet]]\ntransfer = true\n");
        }
        let angle = if below {
            -facet.angle_deg
        } else {
            facet.angle_deg
        };
        let (name, index, depth) = (&facet.name, facet.index, facet.distance);
        csv.push_str(&format!("{angle:?},{index},{depth},{name},\n"));
        toml.push_str(&format!(
            "[[facet]]\nname = \"{name}\"\nangle = {angle:?}\nindex = {index:?}\ndepth = {depth:?}\n"
        ));
    }
    let width = 2.0;
    let one = Gem::new("a", plain, width, None).unwrap();
    for (name, text) in [("a.csv", csv), ("a.toml", toml)] {
        let design = read(name, text.as_bytes()).unwrap_or_else(|refused| panic!("{refused}"));
        let other = Gem::new(name, design, width, None).unwrap();
        assert!((one.body.volume() - other.body.volume()).abs() < 1e-9);
    }
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

#[test]
fn what_cannot_be_cut_is_refused_by_line_and_facet() {
    let with = |from: &str, to: &str| {
        assert!(SMALL.contains(from));
        problem("small.asc", &SMALL.replace(from, to))
    };
    for (from, to, expected) in [
        (
            "a -45 ",
            "a -145 ",
            "small.asc:7: facet P: an angle of -145 deg is impossible",
        ),
        (
            "a -45 ",
            "a x ",
            "small.asc:7: \"x\" is no number for the angle of a facet",
        ),
        (
            "48 G to",
            "65 G to",
            "small.asc:7: facet P@65: index 65 is off the wheel of 64 teeth",
        ),
        (
            "g 64 0.0",
            "g 31 0.0",
            "small.asc:2: an index wheel of 31 teeth",
        ),
        ("g 64 0.0\n", "", "small.asc: the index wheel is missing"),
        (
            "0.70 0 n C",
            "5.0 0 n C",
            "small.asc:8: facet C@0: the plane misses the stone",
        ),
        (
            "0.72 ",
            "-3.0 ",
            "small.asc: the facets leave nothing of the stone",
        ),
        (
            "a 0 0.3 0 n T\n",
            "a 0 0.3 0 n T\na 0 0.2 0 n U\n",
            "small.asc:9: facet T@0: is wholly cut away by facet U@0",
        ),
        (
            "y 4 y",
            "y -4 y",
            "small.asc:3: a symmetry of order -4; write a whole number of 1 to 120",
        ),
        ("y 4 y", "y 1e30 y", "small.asc:3: a symmetry of order 1"),
        ("y 4 y", "y 2.5 y", "small.asc:3: a symmetry of order 2.5"),
        (
            "y 4 y",
            "y 4 maybe",
            "small.asc:3: \"maybe\" is neither y nor n for the mirror",
        ),
        ("y 4 y", "y", "small.asc:3: \"\" is no number for y"),
        (
            "y 4 y",
            "y 4 y y",
            "small.asc:3: \"y\" is behind the end of line y",
        ),
        (
            "g 64 0.0",
            "g 64 0.0 junk",
            "small.asc:2: \"junk\" is behind the end of line g",
        ),
        ("g 64 0.0", "g 64 1e300", "small.asc:2: azimuth 0 is at"),
        (
            "48 G to",
            "-65 G to",
            "small.asc:7: facet P@-65: index -65 is off the wheel of 64 teeth",
        ),
        // The indices are those of another wheel.
        (
            "g 64 0.0",
            "g 72 0.0",
            "small.asc:2: the indices have the symmetry `y 4 y` on a wheel of 64 teeth, and not on \
             one of 72",
        ),
        (
            "a -45 0.72 0 n P 16 32 48 G to a point\n",
            "",
            "small.asc: the facets do not close the stone",
        ),
        ("I 1.54", "I 15", "small.asc:4: a refractive index of 15"),
        ("y 4 y", "q 4 y", "small.asc:3: \"q\" begins no line"),
        (
            "a 40 0.70 0 n C 16 32 48",
            "a 40 0.70",
            "small.asc:8: a facet has no position of the wheel",
        ),
    ] {
        let problem = with(from, to);
        assert!(problem.contains(expected), "{from:?} -> {to:?}:\n{problem}");
    }
    let list = "# gear = 64\n-45,0,1\ntransfer\n0,0,1\ntransfer\n-44,16,1\n";
    assert!(problem("a.csv", list).contains("a.csv:6: facet 3@16: is cut from a side"));
    let list = "# gear = 64\n-45,0,1\n-45,0,1,D\n-45,32,1\ntransfer\n45,16,1\n45,48,1\n";
    assert!(problem("a.csv", list).contains("a.csv:3: facet D@0: is the plane of facet 1@0"));
    let list = "gear = 64\n[[facet]]\nname = \"P\"\nangle = -4\nindex = []\ndepth = 1\n";
    assert!(problem("a.toml", list).contains("a.toml:2: facet P: the list of indices is empty"));
    let list = "gear = 64\nreference = nan\n[[facet]]\ntransfer = true\nangle = 3\n";
    assert!(problem("a.toml", list).contains("a.toml:2: azimuth 0 is at NaN"));
    assert!(problem("a.toml", list).contains("a.toml:3: a transfer has no angle"));
    assert!(problem("a.gem", "").contains("is no design"));
    assert!(problem("a.csv", "# gear = 64\n-45,0\n").contains("a.csv:2: the row has 2 cells"));
    assert!(problem("a.toml", "gear = 64\nangel = 1\n").contains("a.toml:2:"));
}

#[test]
fn a_list_needs_its_transfer() {
    let text = String::from_utf8(example("step-cut.toml")).unwrap();
    let without = text.replace("[[facet]]\ntransfer = true\n", "");
    let line = 1 + without[..without.find("name = \"C1a\"").unwrap()]
        .matches('\n')
        .count()
        - 1;
    let found = problem("step.toml", &without);
    let expected = format!("step.toml:{line}: facet C1a@0: is on the other side of the girdle");
    assert!(found.contains(&expected), "{found}");
    let twice = text.replacen(
        "transfer = true\n",
        "transfer = true\n\n[[facet]]\ntransfer = true\n",
        1,
    );
    assert!(read("step.toml", twice.as_bytes()).is_ok());
    let early = text.replacen(
        "[[facet]]\nname = \"P1a\"",
        "[[facet]]\ntransfer = true\n\n[[facet]]\nname = \"P1a\"",
        1,
    );
    assert!(problem("step.toml", &early).contains("is not between two sides"));
}

#[test]
fn a_design_larger_than_its_rough_is_refused() {
    let rough = Rough {
        diameter_mm: 5.9,
        height_mm: 9.0,
    };
    let name = "round-brilliant.asc";
    let design = read(name, &example(name)).unwrap();
    let refused = Gem::new(name, design.clone(), 6.0, Some(rough)).unwrap_err();
    assert!(
        refused.to_string().contains("larger than the rough"),
        "{refused}"
    );
    let rough = Rough {
        diameter_mm: 6.5,
        height_mm: 9.0,
    };
    assert!(Gem::new(name, design, 6.0, Some(rough)).is_ok());
}

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
        "mixed.asc:11: facet 6@64: is the plane of facet 1@0 and is not cut again",
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

/// A file that is cut off anywhere is refused, or a notice says that something is missing.
#[test]
fn a_file_that_is_cut_off_is_found() {
    for name in ["round-brilliant.asc", "pentagon.asc"] {
        let text = String::from_utf8(example(name)).unwrap();
        let text = text.trim_end();
        let mut refusals = 0;
        // An end behind a whole number, with which the design is whole.
        let whole = text.rfind(" n T").unwrap();
        for end in 0..text.len() {
            if end >= whole {
                break;
            }
            let Ok(design) = read(name, &text.as_bytes()[..end]) else {
                refusals += 1;
                continue;
            };
            let notices = design.notices.clone();
            let gem = Gem::new(name, design, 6.0, None);
            refusals += usize::from(gem.is_err());
            assert!(gem.is_err() || !notices.is_empty(), "{name}: {end} bytes");
        }
        // Only at the end of a tier can the rest be a design.
        assert!(refusals + 30 > whole, "{refusals} of {whole}");
    }
    let (head, _) = SMALL.split_once("16 32 48\na 0 0.3").unwrap();
    let found = problem("small.asc", head);
    let expected = "small.asc:8: the file is cut off: its last line has no line end, and facet C@0 \
                    has no partner in its last tier, and it has no table; take the whole file";
    assert!(found.contains(expected), "{found}");
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

proptest! {
    /// Any bytes: a design or problems, no panic.
    #[test]
    fn any_text_is_read_or_refused(text in "(g 96 0\n)?([agyIHFn;] ?[-0-9. nG\r\n,#=]{0,40}\n){0,12}") {
        for name in ["a.asc", "a.csv", "a.toml"] {
            if let Ok(design) = read(name, text.as_bytes()) {
                let _ = Gem::new(name, design, 6.0, None);
            }
        }
    }

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

/// No part of the stone is on the lap before its facet is: at the retracted height whatever the
/// angle, and at the start of the feed with the angle of the facet.
#[test]
fn no_facet_is_touched_by_the_approach_of_another() {
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        let gem = gem(name);
        let job = Job::new(&gem, JobSettings::default()).unwrap();
        let mut stone = gem.rough_body();
        let mut count = 0;
        for operation in job.passes.iter().flat_map(|pass| &pass.operations) {
            for vertex in stone.vertices() {
                assert!(length(*vertex) < job.retracted_mm - 1.9);
            }
            let heights: Vec<f64> = operation
                .grind
                .split_whitespace()
                .filter_map(|word| word.strip_prefix('Z')?.parse().ok())
                .collect();
            let plane = Plane {
                distance: operation.depth_mm,
                ..gem.plane(operation.facet)
            };
            // Retracted, then straight down to the start of the feed, then never up again.
            assert!((heights[0] - job.retracted_mm).abs() < 1e-3);
            assert!(heights[1] > stone.reach(plane.normal) + 0.04);
            assert!(heights.windows(2).all(|pair| pair[1] <= pair[0]));
            let last = heights.last().unwrap();
            assert!((last - operation.depth_mm).abs() < 1e-4);
            stone.cut(plane, operation.facet);
            count += 1;
        }
        // Every facet on every lap.
        assert_eq!(count, 3 * gem.design.facets.len());
        // Eight decimals of a design leave slivers, which depend on the order.
        assert!((stone.volume() - gem.body.volume()).abs() < 1e-5);
    }
}

fn machine(from: &str, to: &str) -> MachineFile {
    let text = include_str!("../../../machines/facet.toml");
    assert!(text.contains(from));
    let text = text.replacen(from, to, 1);
    MachineFile::parse("facet.toml", &text).unwrap_or_else(|problems| panic!("{problems}"))
}

/// A job that the machine cannot make is refused by line and facet, each facet once, before
/// anything turns.
#[test]
fn facets_that_the_machine_cannot_reach_are_refused() {
    let sized = |width: f64| Gem::new("small.asc", small(), width, None).unwrap();
    let refused = |gem: &Gem, machine: &MachineFile, mode: Mode| {
        let mut settings = JobSettings {
            mode,
            ..JobSettings::default()
        };
        for lap in &mut settings.laps {
            lap.preston_mm2_n *= 10.0;
        }
        let job = Job::new(gem, settings).unwrap();
        let refused = check_machine(gem, &job, machine);
        refused.map_or_else(|refused| refused.to_string(), |()| String::new())
    };
    let plain = machine("", "");
    for width in [2.5, 6.0, 15.0] {
        assert_eq!(refused(&sized(width), &plain, Mode::Feed), "");
        assert_eq!(refused(&sized(width), &plain, Mode::Force), "");
    }
    // Facets of the girdle need an angle of 90 degrees; they are in line 6.
    let flat = machine(
        "low_deg = -92.0\nhigh_deg = 92.0",
        "low_deg = -60.0\nhigh_deg = 60.0",
    );
    let found = refused(&sized(2.5), &flat, Mode::Feed);
    assert_eq!(found.lines().count(), 4, "{found}");
    for (line, name) in found.lines().zip(["G@0", "G@16", "G@32", "G@48"]) {
        let expected = format!("small.asc:6: facet {name}: on lap 260: A");
        assert!(line.starts_with(&expected), "{line}");
        assert!(line.contains("outside the soft limits"), "{line}");
    }
    // Facets nearer to the axis than the least height.
    let found = refused(&sized(0.38), &plain, Mode::Feed);
    assert!(
        found.starts_with("small.asc:6: facet G@0: on lap"),
        "{found}"
    );
    assert_eq!(found.lines().count(), 13, "{found}");
    // Too large for the lap.
    let found = refused(&sized(60.0), &plain, Mode::Feed);
    assert!(found.contains("small.asc:6: facet G@0: reaches"), "{found}");
    // Too large for the laps.
    let problem = Job::new(&sized(60.0), JobSettings::default()).unwrap_err();
    let expected = "small.asc:6: facet G@0 of 2956.8 mm^2 takes more than 20000 strokes on lap 260";
    assert!(problem.starts_with(expected), "{problem}");
    // No faceting machine; no sensor, or one that stops at less than the job asks for.
    let mill = include_str!("../../../machines/mill3.toml");
    let mill = MachineFile::parse("mill3.toml", mill).unwrap();
    let found = refused(&sized(2.5), &mill, Mode::Feed);
    let expected = "mill3.toml: the machine is of the model \"cartesian\", no faceting machine";
    assert!(found.starts_with(expected), "{found}");
    let weak = machine("limit_n = 40.0 ", "limit_n = 7.0 ");
    assert_eq!(refused(&sized(2.5), &weak, Mode::Feed), "");
    let found = refused(&sized(2.5), &weak, Mode::Force);
    let expected = "facet.toml: the force of lap 260 is 4 N, and the machine stops at 7 N; lower";
    assert!(found.starts_with(expected), "{found}");
    assert!((most_force_n(&weak) - 2.625).abs() < 1e-9);
    assert!((most_force_n(&plain) - 15.0).abs() < 1e-9);
}

/// Before each pause the lap and the coolant stop, and a facet is ground with both. The stone is
/// turned over once. By force the program says that it needs force control.
#[test]
fn the_program_pauses_with_the_lap_at_a_standstill() {
    let gem = Gem::new("small.asc", small(), 2.5, None).unwrap();
    let counter_clockwise = |mut settings: JobSettings| {
        settings.laps[1].rpm = -600.0;
        settings
    };
    for (mode, coolant, on) in [
        (Mode::Feed, Coolant::None, ""),
        (Mode::Feed, Coolant::Mist, "M7"),
        (Mode::Force, Coolant::Flood, "M8"),
    ] {
        let settings = counter_clockwise(JobSettings {
            mode,
            ..JobSettings::default()
        });
        let job = Job::new(&gem, settings).unwrap();
        let text = job.program("Title (small)", coolant);
        let (mut lap, mut wet, mut pauses, mut cuts) = (false, false, Vec::new(), 0);
        for line in text.lines() {
            match line.split_whitespace().last().unwrap() {
                "M3" | "M4" => lap = true,
                "M5" => lap = false,
                "M7" | "M8" => {
                    assert!(line == on && lap, "{line}");
                    wet = true;
                }
                "M9" => wet = false,
                _ if line.starts_with("M0") => {
                    assert!(!lap && !wet, "{line}");
                    pauses.push(line);
                }
                _ if line.starts_with("G1") => {
                    assert!(lap && wet == (coolant != Coolant::None), "{line}");
                    cuts += 1;
                }
                _ => {}
            }
        }
        assert!(cuts > 100);
        assert!(!lap && !wet && text.ends_with("M30\n"));
        assert_eq!(pauses.len(), job.passes.len());
        let over = pauses.iter().filter(|pause| pause.contains("transfer"));
        assert_eq!(over.count(), 1);
        let says_force = |text: &str| text.contains("force");
        assert_eq!(says_force(pauses[0]), mode == Mode::Force);
        assert_eq!(
            says_force(text.lines().nth(1).unwrap()),
            mode == Mode::Force
        );
        assert!(!says_force(pauses[1]));
    }
    assert_eq!(coolant(&machine("", "")), Coolant::None);
    let output = "[[output]]\nname = \"pump\"\nfunction = \"coolant\"\nchannel = 5\nsafe = \"off\"\n\n[planner]";
    assert_eq!(coolant(&machine("[planner]", output)), Coolant::Flood);
}

/// Angle and index of the machine put the normal of a facet on the lap, and stay off the ends of
/// the spin.
#[test]
fn the_mounts_put_each_facet_on_the_lap() {
    for name in ["round-brilliant.asc", "pentagon.asc", "step-cut.toml"] {
        let gem = gem(name);
        let job = Job::new(&gem, JobSettings::default()).unwrap();
        for pass in &job.passes {
            for operation in &pass.operations {
                let normal = gem.plane(operation.facet).normal;
                let [angle, index] = pass.mount.pose(normal);
                assert!((-90.0..=90.0).contains(&angle), "{angle}");
                assert!(index.abs() <= 160.0, "{name}: {index}");
                // The tip in the lap frame: turned by the spin, then tilted; z of the lap is
                // against z of the tip where the dop points down.
                let axes = pass.mount.axes();
                let v: [f64; 3] =
                    std::array::from_fn(|i| (0..3).map(|k| axes[k][i] * normal[k]).sum());
                let (s3, c3) = index.to_radians().sin_cos();
                let (s2, c2) = angle.to_radians().sin_cos();
                let spun = [c3 * v[0] - s3 * v[1], s3 * v[0] + c3 * v[1], v[2]];
                let tilted = [
                    c2 * spun[0] + s2 * spun[2],
                    spun[1],
                    c2 * spun[2] - s2 * spun[0],
                ];
                assert!(length(minus(tilted, [0.0, 0.0, 1.0])) < 1e-9, "{tilted:?}");
            }
        }
    }
}

#[test]
fn laps_that_leave_stock_are_refused() {
    let gem = gem("pentagon.asc");
    let mut settings = JobSettings::default();
    settings.laps.swap(0, 1);
    assert!(
        Job::new(&gem, settings.clone())
            .unwrap_err()
            .contains("as much stock")
    );
    settings.laps.truncate(1);
    assert!(
        Job::new(&gem, settings.clone())
            .unwrap_err()
            .contains("write stock_mm = 0")
    );
    settings.laps.clear();
    assert!(Job::new(&gem, settings).unwrap_err().contains("no lap"));
}
