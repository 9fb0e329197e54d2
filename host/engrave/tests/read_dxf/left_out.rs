//! Entities that draw nothing or not what they ask for, each by name.

use super::draw;
use crate::common::{dxf, sections};
use haptimill_engrave::drawing::LayerChoice;

/// Only the section ENTITIES is drawn; look-alikes elsewhere are not.
#[test]
fn other_sections_draw_nothing() {
    let line = "0 LINE\n8 0\n10 1\n20 2\n11 3\n21 4";
    let alone = draw(&dxf(line));
    let others = draw(&sections(&[
        ("HEADER", "9 $INSUNITS\n70 4"),
        (
            "TABLES",
            "0 TABLE\n2 LAYER\n0 LAYER\n2 0\n70 0\n62 7\n0 ENDTAB",
        ),
        (
            "BLOCKS",
            &format!("0 BLOCK\n2 B\n10 0\n20 0\n{line}\n0 ENDBLK"),
        ),
        ("ENTITIES", line),
        ("OBJECTS", "0 DICTIONARY\n5 C"),
    ]));
    assert_eq!(alone.paths, others.paths);
}

/// Whatever is not cut is named with its line, handle and layer.
#[test]
fn what_is_left_out_is_reported() {
    let text = sections(&[
        (
            "TABLES",
            "0 TABLE\n2 LAYER\n0 LAYER\n2 Off\n70 0\n62 -7\n0 ENDTAB",
        ),
        (
            "ENTITIES",
            "0 LINE\n8 Off\n10 0\n20 0\n11 1\n21 1
            0 HATCH\n5 2A\n8 Fill\n10 0\n20 0
            0 DIMENSION\n5 2B\n8 Notes
            0 LINE\n8 0\n67 1\n10 0\n20 0\n11 1\n21 1
            0 LINE\n5 2C\n8 0\n10 3\n20 3\n11 3\n21 3
            0 LINE\n8 0\n10 0\n20 0\n30 5\n11 1\n21 1\n31 5",
        ),
    ]);
    let drawing = draw(&text);
    assert_eq!(drawing.paths.len(), 1);
    let notices = drawing.notices.join("\n");
    for part in [
        "HATCH handle 2A on layer Fill",
        "DIMENSION handle 2B on layer Notes",
        "off or frozen: line 25: LINE on layer Off",
        "in paper space: line 53: LINE on layer 0",
        "no length: line",
        "handle 2C",
        "Z other than 0",
    ] {
        assert!(notices.contains(part), "{part} in {notices}");
    }
}

/// Dashes, by the linetype of an entity or of its layer, and widths are not cut: the drawing is
/// read, and they are named.
#[test]
fn dashes_and_widths_are_named() {
    let text = sections(&[
        (
            "TABLES",
            "0 TABLE\n2 LTYPE\n0 LTYPE\n2 Plain\n73 0\n0 LTYPE\n2 Dashes\n73 2\n0 ENDTAB
            0 TABLE\n2 LAYER\n0 LAYER\n2 Axes\n70 0\n62 7\n6 Dashes\n0 ENDTAB",
        ),
        (
            "ENTITIES",
            "0 LINE\n5 10\n8 Axes\n10 0\n20 0\n11 1\n21 1
            0 LINE\n5 11\n8 0\n6 DASHES\n10 0\n20 0\n11 1\n21 2
            0 LINE\n5 12\n8 Axes\n6 Plain\n10 0\n20 0\n11 1\n21 3
            0 LINE\n5 13\n8 0\n10 0\n20 0\n11 1\n21 4
            0 LINE\n5 14\n8 Axes\n6 CONTINUOUS\n10 0\n20 0\n11 1\n21 5
            0 LWPOLYLINE\n5 15\n8 0\n90 2\n70 0\n43 2.5\n10 0\n20 0\n10 4\n20 0
            0 LWPOLYLINE\n5 16\n8 0\n90 2\n70 0\n43 0\n10 0\n20 0\n10 5\n20 0
            0 POLYLINE\n5 17\n8 0\n66 1\n40 1\n41 1
            0 VERTEX\n8 0\n10 0\n20 0
            0 VERTEX\n8 0\n10 6\n20 0
            0 SEQEND\n8 0",
        ),
    ]);
    let drawing = draw(&text);
    assert_eq!(drawing.paths.len(), 8);
    let handles = |what: &str| -> Vec<String> {
        let notice = drawing.notices.iter().find(|one| one.starts_with(what));
        let notice = notice.unwrap_or_else(|| panic!("{what}: {:?}", drawing.notices));
        let all = notice.split("handle ").skip(1);
        all.map(|rest| rest.chars().take(2).collect()).collect()
    };
    assert_eq!(handles("dashed lines are cut whole"), ["10", "11"]);
    assert_eq!(
        handles("wide polylines are cut along their middle"),
        ["15", "17"]
    );
}

#[test]
fn zero_length_polylines_are_left_out_by_name() {
    let drawing = draw(&dxf(
        "0 LWPOLYLINE\n5 3F\n8 Cut\n90 3\n70 1\n10 4\n20 4\n10 4\n20 4\n10 4\n20 4",
    ));
    assert!(drawing.paths.is_empty());
    assert!(
        drawing
            .notices
            .iter()
            .any(|notice| notice.contains("handle 3F on layer Cut"))
    );
}

/// Arcs, circles and ellipses without an extent are left out, and the rest of the drawing is read;
/// so is a segment of a polyline whose ends are one point.
#[test]
fn entities_without_extent_are_left_out() {
    let text = dxf("0 CIRCLE\n5 20\n8 Cut\n10 1\n20 1\n40 0
        0 ARC\n5 21\n8 Cut\n10 1\n20 1\n40 0\n50 0\n51 90
        0 ELLIPSE\n5 22\n8 Cut\n10 0\n20 0\n11 0\n21 0\n40 0.5
        0 ELLIPSE\n5 23\n8 Cut\n10 0\n20 0\n11 4\n21 0\n40 0
        0 LWPOLYLINE\n5 24\n8 Cut\n90 3\n70 1\n10 10\n20 10\n42 1\n10 10\n20 10\n10 20\n20 20
        0 LINE\n5 25\n8 Cut\n10 0\n20 0\n11 3\n21 0");
    let drawing = draw(&text);
    assert_eq!(drawing.paths.len(), 2);
    let notices = drawing.notices.join("\n");
    for part in [
        "it has no length: line",
        "CIRCLE handle 20",
        "an axis of it has no length: line",
        "ELLIPSE handle 22",
        "segments with a bulge and without length are left out",
        "LWPOLYLINE handle 24",
    ] {
        assert!(notices.contains(part), "{part} in {notices}");
    }
}

/// The unit of a drawing that states none is that of its measurement.
#[test]
fn the_measurement_is_the_unit_where_none_is_stated() {
    for (header, mm, said) in [
        ("9 $MEASUREMENT\n70 0", 25.4, "English measurement"),
        (
            "9 $MEASUREMENT\n70 0\n9 $INSUNITS\n70 0",
            25.4,
            "English measurement",
        ),
        ("9 $MEASUREMENT\n70 1", 1.0, "1 unit is taken as 1 mm"),
        ("9 $ACADVER\n1 AC1009", 1.0, "1 unit is taken as 1 mm"),
        ("9 $MEASUREMENT\n70 0\n9 $INSUNITS\n70 5", 10.0, ""),
    ] {
        let text = sections(&[
            ("HEADER", header),
            ("ENTITIES", "0 LINE\n8 0\n10 0\n20 0\n11 2\n21 0"),
        ]);
        let drawing = draw(&text);
        let length = drawing.paths[0].length();
        assert!((length - 2.0 * mm).abs() < 1e-9, "{header}: {length}");
        let notices = drawing.notices.join("\n");
        assert!(notices.contains(said), "{said} in {notices}");
        assert_eq!(notices.contains("unit"), !said.is_empty(), "{notices}");
    }
}

/// The Z of the vertices of a POLYLINE is noted as that of a LINE is, and a vertex outside of one
/// is named.
#[test]
fn heights_and_stray_vertices_are_noted() {
    let polyline = |z: f64| {
        format!(
            "0 POLYLINE\n8 0\n66 1\n0 VERTEX\n8 0\n10 0\n20 0\n30 {z}
            0 VERTEX\n8 0\n10 5\n20 0\n30 {z}\n0 SEQEND"
        )
    };
    let notices = draw(&dxf(&polyline(2.0))).notices.join("\n");
    assert!(
        notices.contains("Z other than 0, their projection on the plane is cut: line 5: POLYLINE"),
        "{notices}"
    );
    let notices = draw(&dxf(&polyline(0.0))).notices.join("\n");
    assert!(!notices.contains("Z other than 0"), "{notices}");
    let line = "0 LINE\n8 0\n10 1\n20 2\n11 3\n21 4\n0 VERTEX\n5 2F\n8 Top\n10 9\n20 9";
    let drawing = draw(&dxf(line));
    assert_eq!(drawing.paths.len(), 1);
    let notices = drawing.notices.join("\n");
    let stray = "VERTEX is outside of a POLYLINE: line 17: VERTEX handle 2F on layer Top";
    assert!(notices.contains(stray), "{notices}");
}

/// A chosen layer that is off is no mistake in its name.
#[test]
fn a_chosen_layer_that_is_off_is_named_as_such() {
    let text = sections(&[
        (
            "TABLES",
            "0 TABLE\n2 LAYER\n0 LAYER\n2 Off\n70 0\n62 -7\n0 ENDTAB",
        ),
        (
            "ENTITIES",
            "0 LINE\n8 Off\n10 0\n20 0\n11 1\n21 1
            0 LINE\n8 Ghost\n60 1\n10 0\n20 0\n11 1\n21 1
            0 LINE\n8 On\n10 0\n20 0\n11 1\n21 1",
        ),
    ]);
    let choose = |only: &[&str], without: &[&str]| {
        let names = |all: &[&str]| all.iter().map(|one| (*one).to_string()).collect();
        let choice = LayerChoice {
            only: names(only),
            without: names(without),
        };
        draw(&text).select_layers(&choice)
    };
    for layer in ["OFF", "ghost"] {
        let problem = choose(&[layer], &[]).unwrap_err().to_string();
        let expected = format!("layer {layer} is off, frozen, hidden or not plotted");
        assert!(problem.contains(&expected), "{problem}");
        assert!(problem.contains("switch it on"), "{problem}");
        assert!(choose(&[], &[layer]).is_ok());
    }
    let problem = choose(&["None"], &[]).unwrap_err().to_string();
    assert!(
        problem.contains("the drawing has no layer None"),
        "{problem}"
    );
    assert!(choose(&["on"], &[]).is_ok());
}

/// What CAD programs show and do not plot is not cut, and is named: layers with a plot flag of 0,
/// and Defpoints, also in blocks. A choice of such a layer is no mistake in its name.
#[test]
fn layers_that_are_not_plotted_are_left_out_by_name() {
    let text = sections(&[
        (
            "TABLES",
            "0 TABLE\n2 LAYER
            0 LAYER\n2 Guides\n70 0\n62 7\n290 0
            0 LAYER\n2 Cut\n70 0\n62 7\n290 1
            0 ENDTAB",
        ),
        (
            "BLOCKS",
            "0 BLOCK\n2 B\n10 0\n20 0
            0 LINE\n8 0\n10 0\n20 0\n11 1\n21 0
            0 LINE\n8 Cut\n10 0\n20 1\n11 1\n21 1
            0 ENDBLK",
        ),
        (
            "ENTITIES",
            "0 LINE\n5 A1\n8 GUIDES\n10 0\n20 0\n11 5\n21 5
            0 POINT\n5 A2\n8 DefPoints\n10 0\n20 0
            0 LINE\n5 A3\n8 Cut\n10 3\n20 0\n11 5\n21 0
            0 INSERT\n5 A4\n8 Guides\n2 B\n10 10\n20 10",
        ),
    ]);
    let drawing = draw(&text);
    assert!(drawing.points.is_empty());
    let layers: Vec<&str> = drawing
        .paths
        .iter()
        .map(|path| drawing.entity(path).layer.as_str())
        .collect();
    assert_eq!(layers, ["Cut", "Cut"]);
    let notice = |what: &str| {
        let found = drawing.notices.iter().find(|one| one.contains(what));
        found.unwrap_or_else(|| panic!("{what}: {:?}", drawing.notices))
    };
    let flag = notice("its layer is not plotted");
    // The line of the block on layer 0 is on the layer of its reference.
    for part in [
        "left out",
        "handle A1 on layer GUIDES",
        "INSERT B handle A4",
    ] {
        assert!(flag.contains(part), "{part}: {flag}");
    }
    let points = notice("layer Defpoints is not plotted");
    assert!(points.contains("POINT handle A2"), "{points}");
    for layer in ["Guides", "defpoints"] {
        let choice = LayerChoice {
            only: vec![layer.into()],
            without: Vec::new(),
        };
        let problem = draw(&text).select_layers(&choice).unwrap_err().to_string();
        assert!(problem.contains("not plotted"), "{problem}");
    }
}
