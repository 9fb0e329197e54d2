//! What drawings of other programs hold: comments, embedded objects, dimensions, units, mirrored
//! and fitted text, clip paths, style sheets, symbols, and files that multiply.

use crate::common;
use common::{dxf, sections};
use haptimill_engrave::drawing::{Drawing, LayerChoice, Problem};
use haptimill_engrave::geometry::{Point, distance};
use haptimill_engrave::read::text::Font;
use haptimill_engrave::read::{ReadOptions, read};

fn drawn(text: &str) -> Drawing {
    let drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(drawing.problems, []);
    drawing
}

fn problems(text: &str) -> Vec<Problem> {
    match read(text.as_bytes(), &ReadOptions::default()) {
        Err(problem) => vec![problem],
        Ok(drawing) => drawing.problems,
    }
}

fn svg(content: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" \
         xmlns:inkscape=\"http://www.inkscape.org/namespaces/inkscape\" width=\"100mm\" \
         height=\"80mm\" viewBox=\"0 0 100 80\">\n{content}\n</svg>"
    )
}

#[track_caller]
fn bounds(drawing: &Drawing, low: Point, high: Point) {
    let [l, h] = drawing.bounds().unwrap();
    assert!(
        distance(l, low) < 0.006 && distance(h, high) < 0.006,
        "{l:?} {h:?}"
    );
}

/// Millimetres of every unit of `$INSUNITS`, from the definitions of the units.
#[test]
fn every_unit_of_a_dxf_has_its_length() {
    let foot = 304.8;
    let survey_foot = 1200.0e3 / 3937.0;
    let units = [
        (1, 25.4),
        (2, foot),
        (3, 5280.0 * foot),
        (4, 1.0),
        (5, 10.0),
        (6, 1e3),
        (7, 1e6),
        (8, 25.4e-6),
        (9, 25.4e-3),
        (10, 3.0 * foot),
        (11, 1e-7),
        (12, 1e-6),
        (13, 1e-3),
        (14, 100.0),
        (15, 1e4),
        (16, 1e5),
        (17, 1e12),
        (18, 149_597_870.7e6),
        (19, 9.460_730_472_580_8e18),
        (20, 3.085_677_581_491_367e19),
        (21, survey_foot),
        (22, survey_foot / 12.0),
        (23, survey_foot * 3.0),
        (24, survey_foot * 5280.0),
    ];
    let line = "0 LINE\n8 0\n10 0\n20 0\n11 1\n21 0";
    for (code, mm) in units {
        let header = format!("9 $INSUNITS\n70 {code}");
        let drawing = drawn(&sections(&[("HEADER", &header), ("ENTITIES", line)]));
        let length = drawing.paths[0].length();
        assert!((length / mm - 1.0).abs() < 1e-9, "{code}: {length} {mm}");
    }
}

/// Curves are within the tolerance in mm, whatever the unit and the size of the block: the arcs of
/// an ellipse in inches and in a block of 100 times its size, against the ellipse itself.
#[test]
fn the_tolerance_of_curves_is_that_of_the_plate() {
    let ellipse = |a: f64| {
        format!("0 ELLIPSE\n8 0\n10 0\n20 0\n11 {a}\n21 0\n40 0.5\n41 0\n42 6.283185307179586")
    };
    let inch = "9 $INSUNITS\n70 1";
    let mm = "9 $INSUNITS\n70 4";
    let block = format!("0 BLOCK\n2 B\n10 0\n20 0\n{}\n0 ENDBLK", ellipse(0.2));
    let insert = "0 INSERT\n8 0\n2 B\n10 0\n20 0\n41 100\n42 100";
    let cases = [
        (
            sections(&[("HEADER", inch), ("ENTITIES", &ellipse(4.0))]),
            101.6,
            None,
        ),
        (
            sections(&[("HEADER", mm), ("BLOCKS", &block), ("ENTITIES", insert)]),
            20.0,
            None,
        ),
        (
            sections(&[("HEADER", mm), ("ENTITIES", &ellipse(1.0))]),
            50.0,
            Some(50.0),
        ),
    ];
    for (text, a, scale) in cases {
        let options = ReadOptions {
            scale,
            ..ReadOptions::default()
        };
        let drawing = read(text.as_bytes(), &options).unwrap();
        let b = a / 2.0;
        let mut worst: f64 = 0.0;
        for segment in drawing.paths[0].segments() {
            for k in 0..=8 {
                let [x, y] = segment.point(f64::from(k) / 8.0);
                // First order distance from the ellipse.
                let (u, v) = (x / a, y / b);
                let slope = (u / a).hypot(v / b);
                worst = worst.max(((u * u + v * v - 1.0) / (2.0 * slope)).abs());
            }
        }
        assert!(worst < 0.003, "{a}: {worst} mm off the ellipse");
    }
}

#[test]
fn comments_and_embedded_objects_change_nothing() {
    let text = dxf("999 written by a program
        0 LINE\n999 the first\n8 0\n10 0\n20 0\n11 5\n21 0
        0 LINE\n8 0\n10 5\n20 0\n11 5\n21 5\n101 Embedded Object\n10 99\n20 99\n11 99\n21 99");
    let drawing = drawn(&text);
    assert_eq!(drawing.paths.len(), 2);
    bounds(&drawing, [0.0, 0.0], [5.0, 5.0]);
}

/// dxflib 2.0 ends the header after its second variable and writes the others behind it.
#[test]
fn header_variables_behind_their_section_count() {
    let line = "0\nSECTION\n2\nENTITIES\n0\nLINE\n8\n0\n10\n0\n20\n0\n11\n1\n21\n0\n0\nENDSEC\n";
    let header = "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n0\nENDSEC\n9\n$DIMASZ\n40\n2.5\n\
                  9\n$INSUNITS\n70\n1\n0\nENDSEC\n";
    let drawing = drawn(&format!("{header}{line}0\nEOF\n"));
    assert_eq!(drawing.paths[0].length(), 25.4);
    assert!(drawing.notices[0].contains("outside of a section"));
}

/// The text of a dimension is in a block of its own, which no INSERT places.
#[test]
fn only_what_is_placed_can_be_refused() {
    let block =
        "0 BLOCK\n2 *D1\n10 0\n20 0\n0 MTEXT\n5 A1\n8 0\n10 0\n20 0\n40 3\n1 25.0\n0 ENDBLK";
    let line = "0 LINE\n8 CUT\n10 0\n20 0\n11 5\n21 0";
    let drawing = drawn(&sections(&[("BLOCKS", block), ("ENTITIES", line)]));
    assert_eq!(drawing.paths.len(), 1);
    // Placed twice on a layer, it is one problem of that layer, with its handle.
    let insert = "0 INSERT\n5 B1\n8 NOTES\n2 *D1\n10 0\n20 0\n70 2\n44 9";
    let text = sections(&[
        ("BLOCKS", block),
        ("ENTITIES", &format!("{insert}\n{line}")),
    ]);
    let found = problems(&text);
    assert_eq!(found.len(), 1);
    assert!(found[0].message.contains("A1"), "{}", found[0]);
    assert_eq!(found[0].layer.as_deref(), Some("NOTES"));
    // A choice of another layer gives no notice of it.
    let mut drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    let only = |name: &str| LayerChoice {
        only: vec![name.into()],
        without: Vec::new(),
    };
    drawing.select_layers(&only("NOTES")).unwrap();
    assert_eq!((drawing.problems.len(), drawing.paths.len()), (1, 0));
    let mut drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    drawing.select_layers(&only("CUT")).unwrap();
    assert_eq!((drawing.problems.len(), drawing.paths.len()), (0, 1));
}

#[test]
fn invisible_attributes_and_definitions_are_noted() {
    let drawing = drawn(&dxf("0 LINE\n8 0\n10 0\n20 0\n11 5\n21 0
        0 ATTRIB\n8 0\n10 0\n20 0\n40 2\n1 secret\n70 1
        0 ATTDEF\n5 C1\n8 0\n10 0\n20 0\n40 2\n1 default\n70 0"));
    let notices = drawing.notices.join("\n");
    assert!(
        notices.contains("off or frozen: line 17: ATTRIB on layer 0"),
        "{notices}"
    );
    assert!(notices.contains("ATTDEF handle C1"), "{notices}");
}

/// Blocks and clones that multiply end with a sentence, also where they draw nothing.
#[test]
fn files_that_multiply_end() {
    let mut blocks = String::from("0 BLOCK\n2 B0\n10 0\n20 0\n0 ENDBLK\n");
    for level in 1..14 {
        blocks += &format!("0 BLOCK\n2 B{level}\n10 0\n20 0\n");
        for _ in 0..10 {
            blocks += &format!("0 INSERT\n8 0\n2 B{}\n10 0\n20 0\n", level - 1);
        }
        blocks += "0 ENDBLK\n";
    }
    let insert = "0 INSERT\n8 0\n2 B13\n10 0\n20 0";
    let found = problems(&sections(&[("BLOCKS", &blocks), ("ENTITIES", insert)]));
    assert!(found[0].message.contains("entities"), "{}", found[0]);

    let mut content = String::from("<defs><g id=\"g0\"/>");
    for level in 1..14 {
        content += &format!("<g id=\"g{level}\">");
        content += &format!("<use xlink:href=\"#g{}\"/>", level - 1).repeat(10);
        content += "</g>";
    }
    let found = problems(&svg(&(content + "</defs><use xlink:href=\"#g13\"/>")));
    assert!(found[0].message.contains("elements"), "{}", found[0]);
}

#[test]
fn mirrored_and_fitted_text_is_where_the_drawing_has_it() {
    let bytes = common::font();
    let font = Font::new(&bytes).unwrap();
    let options = ReadOptions {
        font: Some(&font),
        ..ReadOptions::default()
    };
    let bounds = |entity: &str| {
        let drawing = read(dxf(entity).as_bytes(), &options).unwrap();
        assert_eq!(drawing.problems, [], "{entity}");
        drawing.bounds().unwrap()
    };
    let plain = bounds("0 TEXT\n8 0\n10 50\n20 50\n40 10\n1 L");
    assert!(plain[0][0] > 50.0 && (plain[0][1] - 50.0).abs() < 0.01);
    assert!((plain[1][1] - 60.0).abs() < 0.01, "{plain:?}");
    let width = plain[1][0] - plain[0][0];
    // Backwards (2): left of its point. Upside down (4): below it.
    let back = bounds("0 TEXT\n8 0\n10 50\n20 50\n40 10\n71 2\n1 L");
    assert!(
        (back[1][0] - (100.0 - plain[0][0])).abs() < 0.01 && back[1][1] > 59.9,
        "{back:?}"
    );
    let down = bounds("0 TEXT\n8 0\n10 50\n20 50\n40 10\n71 4\n1 L");
    assert!((down[0][1] - 40.0).abs() < 0.01 && (down[1][0] - plain[1][0]).abs() < 0.01);
    // Seen from below, x is mirrored at the origin.
    let below = bounds("0 TEXT\n8 0\n10 50\n20 50\n40 10\n230 -1\n1 L");
    assert!((below[1][0] + plain[0][0]).abs() < 0.01, "{below:?}");
    // Fitted between two points: the height stays, the advance is the distance.
    let fit = bounds("0 TEXT\n8 0\n10 0\n20 0\n11 80\n21 0\n40 10\n72 5\n1 L");
    let factor = (fit[1][0] - fit[0][0]) / width;
    assert!(
        (fit[1][1] - 10.0).abs() < 0.01 && factor > 5.0 && fit[1][0] <= 80.0,
        "{fit:?}"
    );
    // Aligned: in proportion, along the line between the points.
    let aligned = bounds("0 TEXT\n8 0\n10 0\n20 0\n11 0\n21 80\n40 10\n72 3\n1 L");
    assert!(
        (aligned[0][0] + 10.0 * factor).abs() < 0.05 && aligned[1][1] <= 80.0,
        "{aligned:?}"
    );
    // An attribute in the middle of its height: group 74.
    let attribute = "0 ATTRIB\n8 0\n10 0\n20 0\n11 50\n21 50\n40 10\n72 0\n74 2\n1 L";
    assert!((bounds(attribute)[0][1] - 45.0).abs() < 0.01);
    // A multi-line text wraps between words at its width; its direction is in the drawing plane.
    let wide = "0 MTEXT\n8 0\n10 0\n20 0\n40 10\n71 1\n1 L L";
    let narrow = "0 MTEXT\n8 0\n10 0\n20 0\n40 10\n41 12\n71 1\n1 L L";
    assert!((bounds(wide)[0][1] + 10.0).abs() < 0.01);
    assert!((bounds(narrow)[0][1] + 10.0 + 10.0 * 5.0 / 3.0).abs() < 0.01);
    let seen = bounds("0 MTEXT\n8 0\n10 50\n20 50\n40 10\n71 7\n11 -1\n21 0\n230 -1\n1 L");
    assert!(
        seen[1][0] < 50.0 && (seen[1][1] - 60.0).abs() < 0.01,
        "{seen:?}"
    );
}

#[test]
fn a_clip_path_that_hides_something_is_refused_by_name() {
    let clip = "<defs><clipPath id=\"k\"><rect width=\"50\" height=\"50\"/></clipPath>
        <clipPath id=\"page\"><path d=\"M0 0H100V80H0Z\"/></clipPath></defs>";
    let shape = "<g clip-path=\"url(#k)\" id=\"p\"><rect x=\"40\" width=\"30\" height=\"20\"/></g>";
    let found = problems(&svg(&format!("{clip}{shape}")));
    assert_eq!(found.len(), 1);
    assert!(found[0].message.contains("handle p") && found[0].message.contains("'k'"));
    assert!(found[0].remedy.contains("--ignore-clips"));
    // A clip path around everything changes nothing; a reference to nothing clips nothing.
    drawn(&svg(&format!("{clip}{}", shape.replace("#k", "#page"))));
    drawn(&svg(&format!("{clip}{}", shape.replace("#k", "#gone"))));
    let options = ReadOptions {
        ignore_clips: true,
        ..ReadOptions::default()
    };
    let whole = read(svg(&format!("{clip}{shape}")).as_bytes(), &options).unwrap();
    assert!(whole.problems.is_empty() && whole.notices.join("").contains("clip-path"));
    assert_eq!(whole.paths.len(), 1);
    let mask = "<mask id=\"m\"/><rect id=\"p\" mask=\"url(#m)\" width=\"5\" height=\"5\"/>";
    assert!(problems(&svg(mask))[0].message.contains("mask 'm'"));
}

#[test]
fn style_sheets_hide_and_dashes_are_noted() {
    let drawing = drawn(&svg(
        "<style>.guide { display: none } #thin { stroke-dasharray: 2,1 }</style>
         <line class=\"guide\" id=\"g\" x2=\"5\"/>
         <line id=\"thin\" stroke=\"black\" x2=\"7\"/>
         <rect id=\"bare\" fill=\"none\" width=\"3\" height=\"3\"/>",
    ));
    assert_eq!(drawing.paths.len(), 2);
    let notices = drawing.notices.join("\n");
    for part in [
        "handle g",
        "dashed lines are cut whole",
        "neither fill nor stroke",
        "handle bare",
    ] {
        assert!(notices.contains(part), "{part}: {notices}");
    }
}

/// The size of a symbol is that of its reference, in the middle of its place.
#[test]
fn symbols_take_the_size_of_their_reference() {
    let symbol = "<symbol id=\"s\" viewBox=\"0 0 10 10\"><path d=\"M0 0H10V10H0Z\"/></symbol>";
    let placed = |text: &str| drawn(&svg(&format!("{symbol}{text}")));
    let inside = placed("<use xlink:href=\"#s\" x=\"10\" y=\"10\" width=\"40\" height=\"20\"/>");
    bounds(&inside, [20.0, 50.0], [40.0, 70.0]);
    let whole = placed("<use xlink:href=\"#s\"/>");
    bounds(&whole, [10.0, 0.0], [90.0, 80.0]);
    let nested = drawn(&svg(
        "<svg x=\"10\" y=\"0\" width=\"20\" height=\"40\" viewBox=\"0 0 10 10\" \
         preserveAspectRatio=\"none\"><path d=\"M0 0H10V10H0Z\"/></svg>",
    ));
    bounds(&nested, [10.0, 40.0], [30.0, 80.0]);
    let low = drawn(&svg(
        "<svg width=\"20\" height=\"40\" viewBox=\"0 0 10 10\" \
         preserveAspectRatio=\"xMidYMax meet\"><path d=\"M0 0H10V10H0Z\"/></svg>",
    ));
    bounds(&low, [0.0, 40.0], [20.0, 60.0]);
}

/// A group inside of an Inkscape layer is on that layer; without layers the outermost groups count.
#[test]
fn groups_stay_on_their_layer() {
    let layer = "<g inkscape:groupmode=\"layer\" inkscape:label=\"Cut\" id=\"layer1\">\
        <g id=\"g12\"><line x2=\"5\"/></g></g><g id=\"loose\"><line x2=\"5\"/></g>";
    let drawing = drawn(&svg(layer));
    let layers: Vec<&str> = drawing
        .entities
        .iter()
        .map(|one| one.layer.as_str())
        .collect();
    assert_eq!(layers, ["Cut", ""]);
    let drawing = drawn(&svg("<g id=\"a\"><g id=\"b\"><line x2=\"5\"/></g></g>"));
    assert_eq!(drawing.entities[0].layer, "a");
}

#[test]
fn letters_that_are_placed_one_by_one_are_refused() {
    let bytes = common::font();
    let font = Font::new(&bytes).unwrap();
    let options = ReadOptions {
        font: Some(&font),
        ..ReadOptions::default()
    };
    for text in [
        "<text id=\"t\" dx=\"0 2 2\">LLL</text>",
        "<text id=\"t\">L<tspan dy=\"-3\">L</tspan></text>",
        "<text id=\"t\"><textPath>L</textPath></text>",
        "<flowRoot id=\"t\"><flowRegion><rect width=\"9\" height=\"9\"/></flowRegion><flowPara>L</flowPara></flowRoot>",
        "<text id=\"t\"><tspan x=\"0\">L<tspan x=\"5\">L</tspan></tspan></text>",
    ] {
        let drawing = read(svg(text).as_bytes(), &options).unwrap();
        let message = &drawing.problems[0].message;
        assert!(
            message.contains("handle t") && message.contains('L'),
            "{message}"
        );
    }
    // Text before the first placed span is a line of its own.
    let text = "<text x=\"10\" y=\"20\">L<tspan x=\"10\" y=\"60\">L</tspan></text>";
    let drawing = read(svg(text).as_bytes(), &options).unwrap();
    assert_eq!(drawing.paths.len(), 2);
}

/// One drawing as other programs write it: DXF of ezdxf 1.4 in four versions (blocks nested,
/// mirrored, scaled unevenly and in arrays; arcs seen from below; hidden layers), an SVG as
/// Inkscape writes it. Lengths of the DXF are those of the curves, integrated in 400,000 steps;
/// that of the SVG, and the boxes, are those of svgelements and ezdxf. For the star, svgelements
/// does not apply the size of its reference: 0.2 of the circumference of 32.3607 is subtracted
/// here.
#[test]
fn drawings_of_other_programs_have_their_length() {
    let cases = [
        ("r12.dxf", 36, 440.3647, [142.0, 82.710]),
        ("r2000.dxf", 39, 625.7261, [142.0, 101.948]),
        ("r2007.dxf", 39, 625.7261, [142.0, 101.948]),
        ("r2018.dxf", 39, 625.7261, [142.0, 101.948]),
        ("inkscape.svg", 6, 277.8231, [70.0, 55.0]),
    ];
    for (name, entities, length, high) in cases {
        let path = format!("{}/tests/drawings/{name}", env!("CARGO_MANIFEST_DIR"));
        let drawing = read(&std::fs::read(path).unwrap(), &ReadOptions::default()).unwrap();
        assert_eq!(drawing.problems, [], "{name}");
        let found: f64 = drawing.paths.iter().map(|one| one.length()).sum();
        let with_paths: std::collections::BTreeSet<usize> =
            drawing.paths.iter().map(|one| one.entity).collect();
        assert_eq!(with_paths.len(), entities, "{name}");
        // Arcs within 0.0025 mm of a curve differ from its length by much less than that each.
        assert!((found - length).abs() < 0.02, "{name}: {found} {length}");
        let [_, h] = drawing.bounds().unwrap();
        assert!(distance(h, high) < 0.01, "{name}: {h:?}");
        let notices = drawing.notices.join("\n");
        let left_out = if name.ends_with("svg") {
            "image"
        } else {
            "off or frozen"
        };
        assert!(notices.contains(left_out), "{name}: {notices}");
        assert_eq!(
            notices.contains("HATCH"),
            name.starts_with("r2"),
            "{notices}"
        );
    }
}

/// Programs that shorten files leave out what separates numbers.
#[test]
fn numbers_without_blanks_are_numbers() {
    let drawing = drawn(&svg("<polyline stroke=\"red\" points=\"1-2.5.5 3-4-5\"/>"));
    let points: Vec<Point> = drawing.paths[0].vertices.iter().map(|one| one.at).collect();
    let expected = [[1.0, 82.5], [0.5, 77.0], [-4.0, 85.0]];
    assert_eq!(points.len(), expected.len());
    for (a, b) in points.into_iter().zip(expected) {
        assert!(distance(a, b) < 1e-9, "{a:?} {b:?}");
    }
}

/// A transform is about its origin: the middle stays where it is. What is not read is refused.
#[test]
fn transforms_are_about_their_origin() {
    let rect = |more: &str| {
        svg(&format!(
            "<rect id='R' x='40' y='30' width='20' height='10' stroke='b' {more}/>"
        ))
    };
    for origin in [
        "transform='scale(0.5)' transform-origin='50 35'",
        "transform='scale(0.5)' transform-origin='50px 35px'",
        "transform='scale(0.5)' style='transform-origin: 50% 43.75%'",
        "transform='scale(0.5)' transform-origin='center 35'",
        "style='transform:scale(0.5);transform-origin:35px center' transform-origin='9 9'",
    ] {
        // The page is 80 high, y points up in the drawing; `35px center` is the point 35, 40.
        let (low, high) = if origin.contains("35px center") {
            ([37.5, 40.0], [47.5, 45.0])
        } else {
            ([45.0, 42.5], [55.0, 47.5])
        };
        bounds(&drawn(&rect(origin)), low, high);
    }
    for (words, refused) in [
        (
            "transform='scale(2)' transform-origin='2em 0'",
            "transform-origin",
        ),
        (
            "transform='scale(2)' style='transform-box:fill-box;transform-origin:center'",
            "transform-box",
        ),
        ("style='translate:10px 20px'", "translate"),
        ("style='rotate:10deg'", "rotate"),
        ("style='scale:2'", "scale"),
    ] {
        let found = problems(&rect(words));
        assert_eq!(found.len(), 1, "{words}");
        let text = found[0].to_string();
        assert!(
            text.contains(refused) && text.contains("handle R"),
            "{text}"
        );
        assert_eq!(found[0].line, 2);
    }
    let sheet = "<style>.a { rotate: 5deg }</style><g class='a'><path d='M1 1H9' stroke='b'/></g>";
    assert_eq!(problems(&svg(sheet)).len(), 1);
    // Without a transform an origin moves nothing.
    bounds(
        &drawn(&rect(
            "style='transform-origin:9em;transform-box:fill-box;rotate:none'",
        )),
        [40.0, 40.0],
        [60.0, 50.0],
    );
}

/// A layer of Inkscape is chosen and left out with the layers in it.
#[test]
fn a_layer_holds_its_sublayers() {
    let layer = |name: &str, content: &str| {
        format!("<g inkscape:groupmode='layer' inkscape:label='{name}'>{content}</g>")
    };
    let line = |y: u32| format!("<path d='M10 {y}H20' stroke='b'/>");
    let deep = layer("Deep", &line(30));
    let cut = layer(
        "Cut",
        &[layer("Inner", &[line(20), deep].concat()), line(10)].concat(),
    );
    let guides = layer("Guides", &[layer("Frame", &line(50)), line(40)].concat());
    let text = svg(&[cut, guides].concat());
    let heights = |only: &[&str], without: &[&str]| {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect();
        let mut drawing = drawn(&text);
        let choice = LayerChoice {
            only: names(only),
            without: names(without),
        };
        drawing.select_layers(&choice).unwrap();
        let paths = drawing.paths.iter();
        paths
            .map(|path| (80.0 - path.start().unwrap()[1]).round() as u32)
            .collect::<Vec<_>>()
    };
    assert_eq!(heights(&["Cut"], &[]), [20, 30, 10]);
    assert_eq!(heights(&["Inner"], &[]), [20, 30]);
    assert_eq!(heights(&["Deep"], &[]), [30]);
    assert_eq!(heights(&[], &["Guides"]), [20, 30, 10]);
    assert_eq!(heights(&[], &["Inner"]), [10, 50, 40]);
    assert_eq!(heights(&["Cut"], &["Deep"]), [20, 10]);
}
