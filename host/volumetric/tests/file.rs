//! Files that cannot be used, each with the line and a remedy.

use haptimill_volumetric::errors::{Axis, Function, Kind, Squareness};
use haptimill_volumetric::file::{FORM_HEADER, Limits, TABLE_HEADER, read};

/// A valid file: every function from -100 to 100 mm in steps of 100.
fn lines() -> Vec<String> {
    let mut lines = vec![TABLE_HEADER.to_string()];
    for function in Function::all() {
        for position in ["-100", "0", "100"] {
            lines.push(format!("{function},{position},,1.5,{}", function.unit()));
        }
    }
    lines.extend(Squareness::NAMES.map(|name| format!("{name},,,5,urad")));
    lines
}

fn limits() -> Limits {
    Limits {
        travel: Some([(-100.0, 100.0); 3]),
        ..Limits::default()
    }
}

fn refused(change: impl Fn(&mut Vec<String>)) -> String {
    let mut lines = lines();
    change(&mut lines);
    read(&lines.join("\n"), &limits()).unwrap_err().to_string()
}

#[test]
fn names_round_trip() {
    assert!(read(&lines().join("\n"), &limits()).is_ok());
    let all: Vec<Function> = Function::all().collect();
    assert_eq!(all.len(), 18);
    for (index, function) in all.iter().enumerate() {
        assert_eq!(function.index(), index);
        assert_eq!(Function::of_name(&function.to_string()), Some(*function));
    }
    // 3 positioning, 6 straightness, 9 rotations, 3 squareness.
    use haptimill_volumetric::errors::Kind::*;
    let count = |kind| {
        all.iter()
            .filter(|function| function.kind() == kind)
            .count()
    };
    assert_eq!(
        [Positioning, Straightness, Roll, Pitch, Yaw].map(count),
        [3, 6, 3, 3, 3]
    );
    let name = |name: &str| Function::of_name(name).unwrap().kind();
    assert_eq!([name("EAX"), name("EBX"), name("ECX")], [Roll, Pitch, Yaw]);
    assert_eq!([name("EAY"), name("EBY"), name("ECY")], [Pitch, Roll, Yaw]);
}

/// The symbols of the thesis and the names of ISO 230-1 of its 18 functions and three angles: the
/// index is the axis that moves, 1 for y, 2 for x, 3 for z.
#[test]
fn symbols_of_the_thesis_have_their_names() {
    let map = include_str!("data/error_parameter_map.csv");
    let rows = map.lines().filter(|line| !line.starts_with('#')).skip(1);
    let rows: Vec<Vec<&str>> = rows.map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 21);
    let mut functions = Vec::new();
    let mut angles = Vec::new();
    for row in &rows {
        let [symbol, _, kind, name, unit, ..] = row[..] else {
            panic!("{row:?}");
        };
        let Some(function) = Function::of_name(name) else {
            assert_eq!(kind, "squareness");
            angles.push(name.replace('_', ""));
            continue;
        };
        let (part, place) = symbol.split_once('_').unwrap();
        let axis = |of: &str, letter: &str| Axis::ALL[of.find(letter).unwrap()];
        assert_eq!(function.rotates, part == "eps", "{row:?}");
        assert_eq!(function.direction, axis("xyz", &place[..1]), "{row:?}");
        assert_eq!(
            function.moving,
            [Axis::Y, Axis::X, Axis::Z]["123".find(&place[1..]).unwrap()],
            "{row:?}"
        );
        assert_eq!(function.rotates, unit == "rad", "{row:?}");
        let word = match function.kind() {
            Kind::Positioning => "positioning",
            Kind::Straightness => "straightness",
            Kind::Roll => "roll",
            Kind::Pitch => "pitch",
            Kind::Yaw => "yaw",
            Kind::Squareness => "squareness",
        };
        assert!(kind.starts_with(word), "{row:?} {word}");
        assert_eq!(function.to_string(), name.replace('_', ""));
        functions.push(function.index());
    }
    functions.sort_unstable();
    assert_eq!(functions, (0..18).collect::<Vec<_>>());
    assert_eq!(angles, Squareness::NAMES);
}

#[test]
fn problems_name_line_and_remedy() {
    type Change = fn(&mut Vec<String>);
    let cases: [(Change, &str); 17] = [
        (|l| l[0] = "a,b".into(), "line 1: the header"),
        (|l| l[2] = "EXX,0,,,um".into(), "line 3: EXX has a gap"),
        (
            |l| l[2] = "EXX,0,,1.5,urad".into(),
            "line 3: EXX is a translation",
        ),
        (|l| l[2] = "EXX,0,,1.5,inch".into(), "write um, mm or nm"),
        (|l| l.swap(2, 3), "line 4: EXX has 0 mm after 100 mm; sort"),
        (
            |l| l[2] = "EXX,0,,400,um".into(),
            "line 3: EXX changes by 3.985 um per mm",
        ),
        (
            |l| l[2] = "EXX,0,,1.5,mm".into(),
            "line 3: EXX is 1500.0000 um",
        ),
        (
            |l| l[3] = "EXX,120,,1.5,um".into(),
            "line 4: EXX has a position at 120 mm, the travel is -100 to 100 mm; use the coordinates",
        ),
        (|l| drop(l.drain(1..4)), "EXX has no line"),
        (
            |l| l[2] = "EQQ,0,,1,um".into(),
            "line 3: \"EQQ\" is no error",
        ),
        (|l| l[2] = "EXX,zero,,1,um".into(), "position_mm = \"zero\""),
        (
            |l| l[2] = "EXX,0,up,1,um".into(),
            "EXX has lines with and without",
        ),
        (|l| drop(l.pop()), "EA0Z has no line"),
        (
            |l| l[11] = "EAX,0,,1500,urad".into(),
            "line 12: EAX is 1500.0000 urad, the controller takes at most 1000.0000",
        ),
        (
            |l| l[11] = "EAX,0,,900,urad".into(),
            "line 12: EAX changes by 8.985 urad per mm, the controller takes at most 2.000",
        ),
        (
            |l| l[55] = "EC0Y,,,1001,urad".into(),
            "line 56: EC0Y is 1001.0000 urad",
        ),
        (
            |l| {
                l.splice(0..1, ["# a comment".into(), "name".into()])
                    .for_each(drop)
            },
            "line 2: the header is \"name\"",
        ),
    ];
    for (change, expected) in cases {
        let message = refused(change);
        assert!(message.contains(expected), "{message}\n  {expected}");
    }
    let gap = Limits {
        gap: 50.0,
        ..limits()
    };
    let message = read(&lines().join("\n"), &gap).unwrap_err().to_string();
    assert!(
        message.contains("line 3: EXX has a gap of 100 mm"),
        "{message}"
    );
    let wide = Limits {
        travel: Some([(-400.0, 400.0); 3]),
        ..limits()
    };
    let message = read(&lines().join("\n"), &wide).unwrap_err().to_string();
    assert!(
        message.contains("covers -100 to 100 mm of the travel -400"),
        "{message}"
    );
}

/// Closed forms have the limits of tables, over the whole travel.
#[test]
fn forms_beyond_the_limits() {
    let file = |exx: &str| {
        let mut lines = vec![FORM_HEADER.to_string()];
        for function in Function::all() {
            lines.push(format!("{function},{},1,0,0,0,0,0,0,0", function.unit()));
        }
        lines[1] = format!("EXX,um,{exx}");
        lines.extend(Squareness::NAMES.map(|name| format!("{name},urad,5,,,,,,,")));
        lines.join("\n")
    };
    assert!(read(&file("1,0,0,0,0,0,0,0"), &limits()).is_ok());
    for (exx, expected) in [
        // 1 um of a wave of 6 mm.
        (
            "0,0,1,6,0,0,0,0",
            "line 2: EXX changes by 1.047 um per mm, the controller takes at most 1.000",
        ),
        (
            "0,0.9,0.5,6,0,0,0,0",
            "line 2: EXX changes by 1.424 um per mm",
        ),
        ("300,0,150,2000,0,60,2000,0", "line 2: EXX is 510.0000 um"),
        ("450,-0.6,0,0,0,0,0,0", "line 2: EXX is 510.0000 um"),
    ] {
        let message = read(&file(exx), &limits()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}\n  {expected}");
    }
    let large = file("1,0,0,0,0,0,0,0").replace("EC0Y,urad,5", "EC0Y,urad,1200");
    let message = read(&large, &limits()).unwrap_err().to_string();
    assert!(
        message.contains("line 20: EC0Y is 1200.0000 urad"),
        "{message}"
    );
}
