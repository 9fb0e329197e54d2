//! SVG drawings: shapes, units, transforms, references, and bad files.

use haptimill_engrave::drawing::{Drawing, LayerChoice, Problem};
use haptimill_engrave::geometry::{Point, distance};
use haptimill_engrave::read::{ReadOptions, read};

fn svg(attributes: &str, content: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" \
         xmlns:inkscape=\"http://www.inkscape.org/namespaces/inkscape\" \
         xmlns:xlink=\"http://www.w3.org/1999/xlink\" {attributes}>\n{content}\n</svg>"
    )
}

/// 100 x 80 mm with 1 unit to the mm.
const PAGE: &str = "width=\"100mm\" height=\"80mm\" viewBox=\"0 0 100 80\"";

fn draw(content: &str) -> Drawing {
    let drawing = read(svg(PAGE, content).as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(drawing.problems, []);
    drawing
}

fn mistake(text: &str) -> Problem {
    match read(text.as_bytes(), &ReadOptions::default()) {
        Err(problem) => problem,
        Ok(drawing) => drawing.problems.into_iter().next().expect("a problem"),
    }
}

fn near(a: Point, b: Point) -> bool {
    distance(a, b) < 1e-9
}

/// UTF-16 with its byte order mark, and the encoding of the XML declaration.
#[test]
fn a_drawing_may_have_another_encoding_than_utf_8() {
    let line = "<g id=\"Größe\"><line x1=\"0\" y1=\"80\" x2=\"30\" y2=\"40\"/></g>";
    let text = |encoding: &str| {
        format!(
            "<?xml version=\"1.0\" encoding=\"{encoding}\"?>\n{}",
            svg(PAGE, line)
        )
    };
    let utf_16 = |bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
        let text = format!("\u{feff}{}", text("UTF-16"));
        text.encode_utf16().flat_map(bytes).collect()
    };
    let latin: Vec<u8> = text("ISO-8859-1").chars().map(|one| one as u8).collect();
    for bytes in [utf_16(u16::to_le_bytes), utf_16(u16::to_be_bytes), latin] {
        let drawing = read(&bytes, &ReadOptions::default()).unwrap();
        assert_eq!(drawing.paths.len(), 1);
        assert!((drawing.paths[0].length() - 50.0).abs() < 1e-9);
    }
    let wrong: Vec<u8> = text("UTF-8").chars().map(|one| one as u8).collect();
    let problem = read(&wrong, &ReadOptions::default()).unwrap_err();
    assert_eq!(problem.line, 3, "{problem}");
}

#[test]
fn y_points_up_from_the_lower_left_corner_of_the_page() {
    let drawing = draw("<line x1=\"10\" y1=\"80\" x2=\"20\" y2=\"70\"/>");
    let path = &drawing.paths[0];
    assert!(near(path.start().unwrap(), [10.0, 0.0]) && near(path.end().unwrap(), [20.0, 10.0]));
}

#[test]
fn units_are_those_of_the_page() {
    let line = "<line x1=\"0\" y1=\"0\" x2=\"10\" y2=\"0\"/>";
    let length = |attributes: &str| {
        let drawing = read(svg(attributes, line).as_bytes(), &ReadOptions::default()).unwrap();
        (drawing.paths[0].length(), drawing.notices.len())
    };
    let close = |a: (f64, usize), b: (f64, usize)| (a.0 - b.0).abs() < 1e-9 && a.1 == b.1;
    assert!(close(
        length("width=\"1in\" height=\"1in\" viewBox=\"0 0 10 10\""),
        (25.4, 0)
    ));
    assert!(close(
        length("width=\"10cm\" height=\"10cm\" viewBox=\"0 0 10 10\""),
        (100.0, 0)
    ));
    // Pixels are an assumption and noted.
    assert!(close(length("width=\"10\" height=\"10\""), (25.4 / 9.6, 1)));
    assert!(length("").1 >= 1);
    let stated = ReadOptions {
        unit_mm: Some(1.0),
        ..ReadOptions::default()
    };
    let drawing = read(svg("width=\"10\" height=\"10\"", line).as_bytes(), &stated).unwrap();
    assert!((drawing.paths[0].length() - 10.0).abs() < 1e-12);
}

#[test]
fn shapes_are_their_outlines() {
    let drawing = draw(
        "<rect x=\"1\" y=\"2\" width=\"10\" height=\"6\"/>
         <rect x=\"1\" y=\"2\" width=\"10\" height=\"6\" rx=\"2\"/>
         <circle cx=\"5\" cy=\"5\" r=\"3\"/>
         <ellipse cx=\"5\" cy=\"5\" rx=\"20\" ry=\"10\"/>
         <polygon points=\"0,0 3,0 3,4\"/>
         <polyline points=\"0 0 3 0, 3 4\"/>
         <path d=\"M0 0 h3 v4 z M 10 10 a 5 5 0 0 1 10 0\"/>",
    );
    let lengths: Vec<f64> = drawing.paths.iter().map(|path| path.length()).collect();
    let pi = std::f64::consts::PI;
    let expected = [
        32.0,
        16.0 + 4.0 * pi,
        6.0 * pi,
        96.8845,
        12.0,
        7.0,
        12.0,
        5.0 * pi,
    ];
    for (found, expected) in lengths.iter().zip(expected) {
        assert!((found - expected).abs() < 0.01, "{found} {expected}");
    }
    assert_eq!(lengths.len(), expected.len());
    // A circle stays one, counter-clockwise from 0 degrees; round corners stay arcs.
    let circle = &drawing.paths[2];
    assert!(near(circle.start().unwrap(), [8.0, 75.0]) && circle.vertices[0].bulge > 0.0);
    assert_eq!(drawing.circle_centre(circle), Some([5.0, 75.0]));
    assert_eq!(
        drawing.paths[1]
            .vertices
            .iter()
            .filter(|v| v.bulge != 0.0)
            .count(),
        8
    );
}

#[test]
fn transforms_and_references_place_shapes() {
    let drawing = draw(
        "<defs><circle id=\"c\" r=\"1\"/><symbol id=\"s\"><line x2=\"2\"/></symbol></defs>
         <g transform=\"translate(10 20) rotate(90)\"><line x2=\"5\"/></g>
         <use href=\"#c\" x=\"30\" y=\"40\"/>
         <use xlink:href=\"#s\" transform=\"scale(3)\"/>
         <g transform=\"scale(2 1)\"><circle cx=\"5\" cy=\"5\" r=\"2\"/></g>",
    );
    assert_eq!(drawing.paths.len(), 4);
    let line = &drawing.paths[0];
    assert!(near(line.start().unwrap(), [10.0, 60.0]) && near(line.end().unwrap(), [10.0, 55.0]));
    assert!(
        distance(
            drawing.circle_centre(&drawing.paths[1]).unwrap(),
            [30.0, 40.0]
        ) < 1e-9
    );
    assert!((drawing.paths[2].length() - 6.0).abs() < 1e-9);
    // A stretched circle is an ellipse.
    assert!(drawing.paths[3].vertices.len() > 4);
    let [low, high] = drawing.paths[3].bounds().unwrap();
    assert!((high[0] - low[0] - 8.0).abs() < 0.01 && (high[1] - low[1] - 4.0).abs() < 0.01);
}

#[test]
fn layers_are_the_labels_of_groups() {
    let drawing = draw(
        "<g id=\"layer1\" inkscape:groupmode=\"layer\" inkscape:label=\"Cut\"><line id=\"a\" x2=\"5\"/></g>",
    );
    let entity = drawing.entity(&drawing.paths[0]);
    assert_eq!(
        (entity.layer.as_str(), entity.handle.as_deref()),
        ("Cut", Some("a"))
    );
}

#[test]
fn layers_are_chosen_in_either_case() {
    let mut drawing = draw(
        "<g inkscape:groupmode=\"layer\" inkscape:label=\"Öffnung\"><line x2=\"5\"/></g>
         <g inkscape:groupmode=\"layer\" inkscape:label=\"Rand\"><line x2=\"7\"/></g>",
    );
    let choice = LayerChoice {
        only: vec!["ÖFFNUNG".into()],
        without: Vec::new(),
    };
    drawing.select_layers(&choice).unwrap();
    assert_eq!(drawing.paths.len(), 1);
    assert!((drawing.paths[0].length() - 5.0).abs() < 1e-9);
}

#[test]
fn what_is_left_out_is_reported() {
    let drawing = draw(
        "<image id=\"photo\" href=\"x.png\"/>
         <rect id=\"gone\" style=\"display:none\" width=\"5\" height=\"5\"/>
         <line id=\"dot\" x1=\"3\" x2=\"3\"/>
         <rect id=\"clipped\" width=\"5\" height=\"5\"/>
         <path id=\"hid\" visibility=\"hidden\" d=\"M0 0L5 5\"/>",
    );
    let notices = drawing.notices.join("\n");
    for part in ["photo", "gone", "dot", "hid"] {
        assert!(notices.contains(part), "{part}: {notices}");
    }
    assert_eq!(drawing.paths.len(), 1);
}

/// A chosen layer that is hidden, or all of whose elements are, is no mistake in its name: those of
/// Inkscape, with the layers in it, and groups where there are none.
#[test]
fn a_chosen_layer_that_is_hidden_is_named_as_such() {
    let layer = |name: &str, more: &str, content: &str| {
        format!("<g inkscape:groupmode=\"layer\" inkscape:label=\"{name}\" {more}>{content}</g>")
    };
    let hidden = "style=\"display:none\"";
    let line = "<line x2=\"5\"/>";
    let inner = layer("Inner", "", line);
    let layered = layer("Off", hidden, &inner)
        + &layer("Ghost", "", "<line visibility=\"hidden\" x2=\"5\"/>")
        + &layer("On", "", line);
    let group =
        |id: &str, more: &str, content: &str| format!("<g id=\"{id}\" {more}>{content}</g>");
    let grouped = group("Off", hidden, &group("Inner", "", line))
        + &group("Ghost", "", "<line visibility=\"hidden\" x2=\"5\"/>")
        + &group("On", "", &(group("Deep", hidden, line) + line));
    let choose = |content: &str, name: &str| {
        let choice = LayerChoice {
            only: vec![name.into()],
            without: Vec::new(),
        };
        let mut drawing = draw(content);
        let problem = drawing.select_layers(&choice).err();
        problem.map_or_else(String::new, |one| one.to_string())
    };
    for (content, layer, part) in [
        (&layered, "off", "not plotted"),
        (&layered, "Inner", "not plotted"),
        (&layered, "Ghost", "not plotted"),
        (&layered, "None", "the drawing has no layer None"),
        (&grouped, "Off", "not plotted"),
        (&grouped, "Ghost", "not plotted"),
        // Groups within groups are no layers.
        (&grouped, "Inner", "the drawing has no layer Inner"),
        (&grouped, "Deep", "the drawing has no layer Deep"),
    ] {
        let problem = choose(content, layer);
        assert!(problem.contains(part), "{layer}: {problem}");
    }
    assert_eq!(choose(&layered, "On"), "");
    assert_eq!(choose(&grouped, "On"), "");
}

/// The frame of a nested `svg` hides what is beyond it, at any place and in any direction.
#[test]
fn a_frame_that_hides_a_part_is_refused() {
    let nested = |more: &str, shape: &str| {
        let frame = "x=\"10\" y=\"5\" width=\"20\" height=\"10\" viewBox=\"0 0 40 20\"";
        svg(
            PAGE,
            &format!("<g transform=\"rotate(30)\"><svg id=\"p\" {frame} {more}>{shape}</svg></g>"),
        )
    };
    let inside = "<line x1=\"1\" y1=\"1\" x2=\"39.9\" y2=\"1\"/>";
    let beyond = "<line x1=\"1\" y1=\"1\" x2=\"41\" y2=\"1\"/>";
    let problem = mistake(&nested("", beyond));
    assert!(
        problem
            .message
            .contains("its frame (overflow hidden) hides a part"),
        "{problem}"
    );
    for (more, shape) in [("", inside), ("overflow=\"visible\"", beyond)] {
        let drawing = read(nested(more, shape).as_bytes(), &ReadOptions::default()).unwrap();
        assert_eq!(drawing.paths.len(), 1);
    }
}

#[test]
fn bad_files_name_line_and_remedy() {
    for (content, part) in [
        ("<path id=\"p\" d=\"M0 0 L5\"/>", "path data"),
        ("<path id=\"p\" d=\"M0 0 L1e9 0\"/>", "farther than"),
        ("<circle id=\"p\" r=\"-2\"/>", "negative"),
        ("<polygon id=\"p\" points=\"0 0 5\"/>", "pairs"),
        ("<polygon id=\"p\" points=\"0 0 NaN 5 3 3\"/>", "pairs"),
        (
            "<g id=\"p\" transform=\"turn(5)\"><line x2=\"5\"/></g>",
            "transform",
        ),
        ("<use id=\"p\" href=\"#none\"/>", "no element #none"),
        (
            "<g id=\"p\"><use id=\"p\" href=\"#p\"/></g>",
            "contains itself",
        ),
        ("<text id=\"p\" x=\"3\">KMITL</text>", "'KMITL' is text"),
    ] {
        let problem = mistake(&svg(PAGE, content));
        assert!(problem.message.contains(part), "{part}: {problem}");
        assert!(
            problem.message.contains("handle p") && problem.line == 2,
            "{problem}"
        );
        assert!(!problem.remedy.is_empty());
    }
    let truncated = mistake("<svg width=\"5\">\n<rect");
    assert!(
        truncated.message.contains("well-formed") && truncated.line > 0,
        "{truncated}"
    );
    assert!(mistake("<html/>").message.contains("html"));
}

/// What is not cut as it is drawn is named: arrow heads, dots, alternatives, transparent elements.
#[test]
fn markers_dots_and_alternatives_are_named() {
    let line = "d=\"M0 0h10\"";
    for (content, notice) in [
        (
            format!("<path {line} marker-end=\"url(#a)\"/>"),
            "markers (arrow heads): line 2: path",
        ),
        (
            format!("<g style=\"marker:url(#a)\"><path {line}/></g>"),
            "markers (arrow heads): line 2: path",
        ),
        (
            "<path d=\"M10 10L20 20M30 30h0\"/>".to_string(),
            "parts of them have no length: line 2: path",
        ),
        (
            format!("<switch id=\"s\"><g><path {line}/></g><g><path {line}/></g></switch>"),
            "all alternatives of a switch are cut: line 2: switch",
        ),
        (
            format!("<g opacity=\"0\"><path {line}/></g>"),
            "cut although they are transparent: line 2: g",
        ),
    ] {
        let drawing = draw(&content);
        let notices = drawing.notices.join("\n");
        assert!(notices.contains(notice), "{content}: {notices}");
    }
    let whole = format!(
        "<path {line} marker-end=\"none\"/><rect width=\"3\" height=\"3\" style=\"opacity:1\"/>\
         <switch><foreignObject/><path {line}/></switch>"
    );
    let notices = draw(&whole).notices.join("\n");
    for part in ["markers", "transparent", "alternatives"] {
        assert!(!notices.contains(part), "{notices}");
    }
}
