//! Files of gem designs: GemCad files, lists, and files that are cut off.

use super::{SMALL, example, problem, small};
use haptimill_facet::{Gem, Side, read};
use proptest::prelude::*;

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

/// The end of a text file of DOS is no line, and a comment may follow a word without a space. A
/// semicolon in a note is part of the note, also where a facet has the name G.
#[test]
fn ends_of_dos_and_glued_comments_are_read() {
    let plain = small();
    let dos = SMALL.replace('\n', "\r\n") + "\u{1a}";
    assert_eq!(read("dos.asc", dos.as_bytes()).unwrap(), plain);
    let cut = SMALL.replace("\nF end\n", "") + "\u{1a}";
    assert_eq!(read("dos.asc", cut.as_bytes()).unwrap().notices.len(), 1);
    for (from, to) in [
        ("n C 16 32 48", "n C 16 32 48;the crown"),
        ("n G 16 32 48", "n G 16 32 48;G is a name"),
        ("n C 16 32 48", "n C 16 32;first\n48;c"),
        ("0.3 0 n T", "0.3 0 n T;c"),
        ("0.3 0 n T", "0.3;c\n0;c\nn T"),
    ] {
        let text = SMALL.replace(from, to);
        let design = read("glued.asc", text.as_bytes()).unwrap_or_else(|it| panic!("{to}: {it}"));
        let facets = |design: &haptimill_facet::Design| {
            let facets = design.facets.iter();
            let facets = facets.map(|it| (it.name.clone(), it.index, it.note.clone()));
            facets.collect::<Vec<_>>()
        };
        let named = to != "0.3;c\n0;c\nn T";
        if named {
            assert_eq!(facets(&design), facets(&plain), "{to}");
        }
        assert_eq!(design.facets.len(), plain.facets.len());
    }
    let note = SMALL.replace("to a point", "to; a point");
    assert_eq!(
        read("note.asc", note.as_bytes()).unwrap().facets[4].note,
        "to; a point"
    );
}

/// Settings of a list are those of TOML, in any case.
#[test]
fn settings_of_a_csv_list_are_read_in_any_case() {
    let list = |settings: &str| {
        format!(
            "{settings}-90,0,1,G\n-90,16,1,G\n-90,32,1,G\n-90,48,1,G\n-0,0,0.4,P\ntransfer\n\
             0,0,0.4,T\n"
        )
    };
    let settings = "# Gear = 64\n# MIRROR = True\n# Symmetry = 4\n# Title = A\n";
    let design = read("a.csv", list(settings).as_bytes()).unwrap_or_else(|it| panic!("{it}"));
    assert_eq!((design.gear, design.symmetry.order), (64, 4));
    assert!(design.symmetry.mirror);
    assert_eq!(design.title, "A");
    let settings = "# gear = 64\n# symmetry = 4\n# mirror = false\n";
    assert!(
        !read("a.csv", list(settings).as_bytes())
            .unwrap()
            .symmetry
            .mirror
    );
    let found = problem("a.csv", &list("# gear = 64\n# mirror = yes\n"));
    assert!(
        found.starts_with("a.csv:2: \"yes\" is neither true nor false"),
        "{found}"
    );
    let found = problem("a.csv", &list("# gear = 64\n# Gear = 96\n"));
    assert!(
        found.starts_with("a.csv:2: the setting gear is already in line 1"),
        "{found}"
    );
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
}
