//! Designs that are refused.

use super::{SMALL, example, problem};
use haptimill_facet::{Gem, Rough, read};

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
            "32 48 G to",
            "32\n 65 G to",
            "small.asc:8: facet P@65: index 65 is off the wheel of 64 teeth",
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
    assert!(
        problem("a.csv", list).contains("a.csv:3: facet D@0: is the plane of facet 1@0 of line 2")
    );
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

/// A facet that another one cuts away is refused with the names of both, whatever the rough is: the
/// default rough is hardly larger than the finished stone, and may not reach to the facet.
#[test]
fn a_facet_that_is_cut_away_names_the_other_one() {
    let text = String::from_utf8(example("round-brilliant.asc")).unwrap();
    let with = |from: &str, to: &str, rough: Option<Rough>| {
        assert!(text.contains(from), "{from}");
        let design = read("b.asc", text.replace(from, to).as_bytes()).unwrap();
        Gem::new("b.asc", design, 6.0, rough).unwrap_err()
    };
    let roughs = [[6.5, 8.0], [8.0, 4.0], [20.0, 20.0]].map(|[diameter_mm, height_mm]| Rough {
        diameter_mm,
        height_mm,
    });
    let roughs = roughs.map(Some);
    for rough in [None].into_iter().chain(roughs) {
        let table = text.lines().find(|line| line.contains(" n T")).unwrap();
        let refused = with(table, "a 0.0 0.05 96 n T", rough);
        assert_eq!(
            refused.problems.len() + refused.more,
            8,
            "{rough:?}: {refused}"
        );
        for problem in &refused.problems {
            let name = problem.facet.as_deref().unwrap();
            assert!(
                name.starts_with("C3@")
                    && problem.what.contains("cut away by facet T@96 of line 13"),
                "{rough:?}: {refused}"
            );
        }
    }
    // The pavilion through the middle of the stone cuts the girdle away.
    let point = text.lines().find(|line| line.contains(" n P1 ")).unwrap();
    for rough in [None, roughs[2]] {
        let flat = point.replace(point.split(' ').nth(2).unwrap(), "0.0");
        let refused = with(point, &flat, rough);
        let first = &refused.problems[0];
        assert!(
            first.facet.as_deref() == Some("G1@3") && first.what.contains("by facet P1@"),
            "{refused}"
        );
    }
    // A rough that is too small is the only problem.
    let small = Rough {
        diameter_mm: 5.0,
        height_mm: 4.0,
    };
    let refused = with("Standard", "Standard", Some(small)).to_string();
    assert!(refused.contains("larger than the rough"), "{refused}");
    assert!(!refused.contains("misses"), "{refused}");
}

/// The oval of four angles has its table so low that it cuts the facets of the upper crown away.
/// Some of them would stay without a facet of the lower crown, too; the table is at fault.
#[test]
fn a_table_that_is_too_low_is_named_by_each_lost_facet() {
    let mut text = String::from("GemCad 5.0\ng 96 0.0\ny 2 y\nI 1.54\nH Oval\n");
    let tiers: [(&str, f64, [f64; 4]); 4] = [
        (
            "G",
            -90.0,
            [1.289_859_85, 1.215_329_50, 1.101_351_09, 1.013_045_69],
        ),
        (
            "P",
            -43.0,
            [1.036_682_19, 0.993_914_41, 0.930_080_49, 0.882_159_62],
        ),
        (
            "C",
            45.0,
            [1.055_044_65, 1.009_833_10, 0.942_198_02, 0.891_280_42],
        ),
        (
            "D",
            30.0,
            [0.915_319_40, 0.889_455_70, 0.851_538_93, 0.823_674_93],
        ),
    ];
    for (name, angle, distances) in tiers {
        for (at, distance) in distances.iter().enumerate() {
            let index = 3 + 6 * at;
            let (back, half) = (96 - index, 48 - index);
            let over = 48 + index;
            text += &format!("a {angle} {distance} {index} n {name}{at} {back} {half} {over}\n");
        }
    }
    text += "a 0 0.45 96 n T\nF end\n";
    let design = read("oval.asc", text.as_bytes()).unwrap_or_else(|it| panic!("{it}"));
    let refused = Gem::new("oval.asc", design, 6.0, None).unwrap_err();
    assert!(refused.problems.len() >= 4, "{refused}");
    for problem in &refused.problems {
        let is_upper = problem
            .facet
            .as_deref()
            .is_some_and(|name| name.starts_with('D'));
        let by_table = problem.what == "is wholly cut away by facet T@96 of line 22";
        assert!(is_upper && by_table, "{refused}");
    }
}

/// A refused facet of a list is the only problem: which side it is on is not known, so the transfer
/// beside it is not at fault. A transfer that is at fault is named by its own line.
#[test]
fn a_refused_facet_of_a_list_is_the_only_problem() {
    let one = |name: &str, text: &str, expected: &str| {
        let refused = problem(name, text);
        assert!(refused.starts_with(expected), "{refused}");
        assert_eq!(refused.lines().count(), 1, "{refused}");
    };
    let head = "# gear = 64\n-90,0,1,G\n-90,16,1,G\n-90,32,1,G\n-90,48,1,G\n";
    let list = format!("{head}-0,0,0.4,P\ntransfer\n95,0,0.4,T\n");
    one(
        "a.csv",
        &list,
        "a.csv:8: facet T: an angle of 95 deg is impossible",
    );
    let list = format!("{head}-0,0,0.4,P\ntransfer\n0,65,0.4,T\n");
    one(
        "a.csv",
        &list,
        "a.csv:8: facet T@65: index 65 is off the wheel",
    );
    let facet = |angle: &str, index: &str, depth: &str| {
        format!("[[facet]]\nangle = {angle}\nindex = {index}\ndepth = {depth}\n")
    };
    let toml = |table: &str| {
        let girdle = facet("-90", "[0, 16, 32, 48]", "1");
        let culet = facet("-0.0", "0", "0.4");
        format!("gear = 64\n{girdle}{culet}[[facet]]\ntransfer = true\n{table}")
    };
    let angle = "a.toml:12: facet 3: an angle of 95 deg";
    one("a.toml", &toml(&facet("95", "0", "0.4")), angle);
    one(
        "a.toml",
        &toml(&facet("0", "[]", "0.4")),
        "a.toml:12: the list of indices is empty",
    );
    one(
        "a.toml",
        &toml("[[facet]]\nangle = 0\nindex = 0\n"),
        "a.toml:12: angle, index or depth",
    );
    let list = format!("{head}\ntransfer\n-0,0,0.4,P\ntransfer\n0,0,0.4,T\n");
    one(
        "a.csv",
        &list,
        "a.csv:7: the transfer is not between two sides",
    );
}

/// Without a gear the wheel is not known: neither the symmetry nor the positions are a problem.
#[test]
fn a_missing_gear_is_the_only_problem() {
    for (name, text, expected) in [
        (
            "a.csv",
            LIST.replace("# gear = 64\n", ""),
            "a.csv: the index wheel is missing",
        ),
        (
            "small.asc",
            SMALL.replace("g 64 0.0\n", ""),
            "small.asc: the index wheel is missing",
        ),
        (
            "small.asc",
            SMALL.replace("g 64 0.0\n", "").replace(" 48", " 100"),
            "small.asc: the index wheel is missing",
        ),
    ] {
        let refused = problem(name, &text);
        assert!(refused.starts_with(expected), "{refused}");
        assert_eq!(refused.lines().count(), 1, "{refused}");
    }
}

/// A second line of a setting would replace the first one.
#[test]
fn a_setting_of_a_gemcad_file_is_written_once() {
    for (line, what) in [
        ("g 96 0.0", "the index wheel is already in line 2"),
        ("y 2 n", "the symmetry is already in line 3"),
        ("I 1.76", "the refractive index is already in line 4"),
    ] {
        let refused = problem("small.asc", &SMALL.replace("H Small", line));
        let expected = format!("small.asc:5: {what}; write it once, before the facets");
        assert!(refused.starts_with(&expected), "{refused}");
        assert_eq!(refused.lines().count(), 1, "{refused}");
    }
}

/// An impossible gear is the only problem: the wheel is not compared with the symmetry.
#[test]
fn an_impossible_gear_is_refused_once() {
    for name in ["small.asc", "step-cut.toml"] {
        let text = if name == "small.asc" {
            SMALL.replace("g 64 ", "g 30 ")
        } else {
            let text = String::from_utf8(example(name)).unwrap();
            text.replace("gear = 64", "gear = 30")
        };
        let refused = problem(name, &text);
        assert!(refused.contains("an index wheel of 30 teeth"), "{refused}");
        assert!(
            !refused.contains("of 64 teeth") && !refused.contains("96"),
            "{refused}"
        );
    }
}

/// A list of 13 facets; its lines are 1 to 16.
const LIST: &str = "# gear = 64\n# symmetry = 4\nangle,index,depth,name,note\n\
-90,0,1.25,G,\n-90,16,1.25,G,\n-90,32,1.25,G,\n-90,48,1.25,G,\n\
-45,0,0.9,P,\n-45,16,0.9,P,\n-45,32,0.9,P,\n-45,48,0.9,P,\ntransfer\n\
40,0,0.875,C,\n40,16,0.875,C,\n40,32,0.875,C,\n40,48,0.875,C,\n0,0,0.375,T,\n";

/// Rows of a list that would be read as other facets than those that are meant.
#[test]
fn rows_that_are_read_otherwise_are_refused() {
    assert!(read("a.csv", LIST.as_bytes()).is_ok());
    let bare = LIST
        .replace("angle,index,depth,name,note\n", "")
        .replace(",\n", "\n");
    assert!(read("a.csv", bare.as_bytes()).is_ok());
    let comma = "-90,0,12,5,G";
    for (text, from, to, expected) in [
        // Settings that hold for earlier rows.
        (
            LIST,
            "transfer\n",
            "transfer\n# gear = 80\n",
            "a.csv:13: the setting gear is already in line 1; write it once, before the rows",
        ),
        (
            LIST,
            "transfer\n",
            "transfer\n# reference = 8\n",
            "a.csv:13: the setting reference is behind a row; write it once, before the rows",
        ),
        (
            LIST,
            "transfer\n",
            "# symmetry=8\ntransfer\n",
            "a.csv:12: the setting symmetry is",
        ),
        (
            LIST,
            "# symmetry = 4\n",
            "# gear = 80\n",
            "a.csv:2: the setting gear is already in line 1; write it once",
        ),
        // Decimal commas.
        (
            &bare,
            "-90,0,1.25,G",
            comma,
            "a.csv:3: the name 5 is a number; write 12.5 with a point",
        ),
        (
            &bare,
            "-90,0,1.25,G",
            "-90,0,12,5",
            "a.csv:3: the name 5 is a number",
        ),
        (
            &bare,
            "-90,0,1.25,G",
            "-90,0,12,5,G,",
            "a.csv:3: the row has 6 cells, and a list at most 5",
        ),
        (
            LIST,
            "-90,0,1.25,G,",
            "-90,0,12,5,G,",
            "a.csv:4: the row has 6 cells, and the row of titles 5",
        ),
        (
            LIST,
            "-90,0,1.25,G,",
            "-90,0,12,5",
            "a.csv:4: the name 5 is a number",
        ),
        (
            LIST,
            "-90,0,1.25,G,",
            "-90,0,1,25,G",
            "a.csv:4: the name 25 is a number; write 12.5 with a point, and a name with a letter",
        ),
        (
            LIST,
            "-90,0,1.25,G,",
            "-90;0;12,5;G",
            "a.csv:4: the row has 2 cells; write angle,index",
        ),
        (
            LIST,
            "-90,0,1.25,G,",
            "-90,0,1.25,G,to, that",
            "a.csv:4: the row has 6 cells",
        ),
        (
            LIST,
            "transfer",
            "transfer,20,8,0.72",
            "a.csv:12: \"20\" is behind transfer; write the transfer and the facet as two rows",
        ),
        // Titles.
        (
            LIST,
            "angle,index,depth,",
            "angle,depth,index,",
            "a.csv:3: \"angle,depth,index,name,note\" is no row of titles; write angle,index,depth",
        ),
        (
            LIST,
            "angle,index",
            "angel,index",
            "a.csv:3: \"angel,index,depth,name,note\" is no row",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let refused = problem("a.csv", &text.replacen(from, to, 1));
        assert!(
            refused.starts_with(expected),
            "{from:?} -> {to:?}:\n{refused}"
        );
    }
    // A refused row is the only problem.
    let all = bare.replace("1.25,", "1,25,").replace("0.9,", "0,9,");
    let refused = problem(
        "a.csv",
        &all.replace("0.875", "0,875").replace("0.375", "0,375"),
    );
    assert!(
        refused.starts_with("a.csv:3: the name 25 is a number"),
        "{refused}"
    );
    assert!(!refused.contains("transfer"), "{refused}");
    // An empty transfer, titles in capitals, and other line ends.
    for (from, to) in [
        ("transfer", "transfer,,,,"),
        ("angle,index,depth", "Angle,Index,Depth"),
        ("\n", "\r"),
        ("\n", "\r\n"),
    ] {
        let design = read("a.csv", LIST.replace(from, to).as_bytes());
        let design = design.unwrap_or_else(|refused| panic!("{from:?} -> {to:?}: {refused}"));
        assert_eq!(design.facets.len(), 13);
    }
}

/// A list that is cut off is refused as a GemCad file is.
#[test]
fn lists_that_are_cut_off_are_refused() {
    for name in ["a.csv", "a.toml"] {
        let text = match name {
            "a.csv" => LIST.replace("# symmetry = 4\n", "\n"),
            _ => String::from_utf8(example("step-cut.toml")).unwrap(),
        };
        let text = text.trim_end();
        let table = text
            .rfind(if name == "a.csv" {
                "0,0,0.375"
            } else {
                "[[facet]]"
            })
            .unwrap();
        let head = text[..table].trim_end();
        let refused = problem(name, head);
        let line = head.lines().count();
        let expected = format!(
            "{name}:{line}: the file is cut off: its last line has no line end, and it has no table"
        );
        assert!(refused.contains(&expected), "{refused}");
        // With its table and without a line end it is a notice.
        let design = read(name, text.as_bytes()).unwrap_or_else(|refused| panic!("{refused}"));
        assert_eq!(design.notices.len(), 1);
        assert_eq!(design.notices[0].what, "the last line has no line end");
    }
    // A row of a tier is missing, and the table.
    let (head, _) = LIST.split_once("40,48,").unwrap();
    let refused = problem("a.csv", head);
    let expected = "a.csv:15: the file is cut off: facet C@0 has no partner in its last tier, and \
                    it has no table";
    assert!(refused.contains(expected), "{refused}");
}

#[test]
fn unreadable_files_are_named() {
    let utf16: Vec<u8> = SMALL.encode_utf16().flat_map(u16::to_le_bytes).collect();
    for (name, text) in [
        ("a.asc", utf16.clone()),
        ("a.asc", [&[0xff, 0xfe], &utf16[..]].concat()),
        ("a.csv", [&[0xff, 0xfe], &utf16[..]].concat()),
        (
            "a.toml",
            SMALL.encode_utf16().flat_map(u16::to_be_bytes).collect(),
        ),
    ] {
        let refused = read(name, &text).unwrap_err().to_string();
        assert_eq!(
            refused,
            format!("{name}: is UTF-16; save the file as UTF-8")
        );
    }
    let list = "gear = 64\n[[facet]]\nangle = 4\nindex = \"0\"\ndepth = 1\n";
    let expected = "a.toml:4: the index is no number and no list of numbers; write index = 0 or \
                    index = [0, 16], without quotes";
    assert!(
        problem("a.toml", list).contains(expected),
        "{}",
        problem("a.toml", list)
    );
}
