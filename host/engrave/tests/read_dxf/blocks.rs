//! Blocks: where references place them, blocks in themselves, clips.

use super::{draw, ends, mistake, near};
use crate::common::{dxf, sections};
use haptimill_engrave::read::{ReadOptions, read};

#[test]
fn blocks_are_placed_scaled_and_turned() {
    let blocks = "0 BLOCK
        2 Part
        10 1
        20 0
        0 LINE
        5 A1
        8 0
        10 1
        20 0
        11 3
        21 0
        0 CIRCLE
        8 Holes
        10 1
        20 0
        40 1
        0 ENDBLK
        0 BLOCK
        2 OUTER
        10 0
        20 0
        0 INSERT
        2 PART
        10 0
        20 0
        0 ENDBLK";
    let insert = "0 INSERT
        5 B7
        8 Top
        2 OUTER
        10 10
        20 20
        41 2
        42 2
        50 90
        70 2
        44 5";
    let drawing = draw(&sections(&[("BLOCKS", blocks), ("ENTITIES", insert)]));
    assert_eq!(drawing.paths.len(), 4);
    let (start, end) = ends(&drawing.paths[0]);
    assert!(
        near(start, [10.0, 20.0]) && near(end, [10.0, 24.0]),
        "{start:?} {end:?}"
    );
    let (start, _) = ends(&drawing.paths[2]);
    assert!(near(start, [10.0, 25.0]), "{start:?}");
    // Layer 0 of a block is the layer of its reference; the circle stays an arc.
    assert_eq!(drawing.entity(&drawing.paths[0]).layer, "Top");
    assert_eq!(drawing.entity(&drawing.paths[1]).layer, "Holes");
    assert_eq!(drawing.paths[1].vertices.len(), 2);
    assert!(
        drawing
            .entity(&drawing.paths[0])
            .kind
            .contains("INSERT OUTER handle B7")
    );
    // A block with different scales makes ellipses of arcs.
    let wide = insert.replace("42 2", "42 1");
    let drawing = draw(&sections(&[("BLOCKS", blocks), ("ENTITIES", &wide)]));
    assert!(drawing.paths[1].vertices.len() > 4);
}

#[test]
fn blocks_that_contain_themselves_end() {
    let blocks = "0 BLOCK\n2 A\n10 0\n20 0\n0 INSERT\n5 9\n2 A\n10 0\n20 0\n0 ENDBLK";
    let text = sections(&[
        ("BLOCKS", blocks),
        ("ENTITIES", "0 INSERT\n5 1F\n8 L\n2 A\n10 0\n20 0"),
    ]);
    let problem = mistake(text);
    assert!(
        problem.message.contains("itself") || problem.message.contains("no block"),
        "{problem}"
    );
    let problem = mistake(dxf("0 INSERT\n5 1F\n8 L\n2 MISSING\n10 0\n20 0"));
    assert!(
        problem.message.contains("handle 1F on layer L") && problem.message.contains("MISSING")
    );
}

/// Blocks that insert the next one twice, deeper than they may be: one problem, not one for each of
/// the ways to the innermost block.
#[test]
fn deep_blocks_are_reported_once() {
    let blocks: String = (1..20)
        .map(|k| {
            let next = format!("0 INSERT\n8 0\n2 L{}\n10 0\n20 0\n", k - 1);
            format!("0 BLOCK\n2 L{k}\n10 0\n20 0\n{next}{next}0 ENDBLK\n")
        })
        .collect();
    let text = sections(&[
        ("BLOCKS", &blocks),
        ("ENTITIES", "0 INSERT\n5 1F\n8 Cut\n2 L19\n10 0\n20 0"),
    ]);
    let drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(drawing.problems.len(), 1, "{:?}", drawing.problems);
    let message = &drawing.problems[0].message;
    assert!(
        message.contains("block L3 contains itself or is nested deeper than 16 blocks")
            && message.contains("in INSERT L4, in 14 more, in INSERT L19 handle 1F)"),
        "{message}"
    );
}

/// A block reference with a clip (XCLIP) is refused with its handle, as it would be cut whole.
#[test]
fn clipped_blocks_are_refused() {
    let file = |state: &str| {
        let objects = format!(
            "0 DICTIONARY\n5 A1\n102 {{ACAD_REACTORS\n330 20\n102 }}\n330 20\n100 AcDbDictionary\n3 ACAD_FILTER\n360 A2
            0 DICTIONARY\n5 A2\n330 A1\n100 AcDbDictionary\n3 SPATIAL\n360 A3
            0 SPATIAL_FILTER\n5 A3\n330 A2\n100 AcDbFilter\n100 AcDbSpatialFilter\n70 2\n10 0\n20 0\n10 1\n20 1\n71 {state}"
        );
        sections(&[
            (
                "BLOCKS",
                "0 BLOCK\n2 B\n10 0\n20 0\n0 LINE\n8 0\n10 0\n20 0\n11 9\n21 0\n0 ENDBLK",
            ),
            ("ENTITIES", "0 INSERT\n5 20\n8 0\n2 B\n10 0\n20 0"),
            ("OBJECTS", &objects),
        ])
    };
    let problem = mistake(file("1"));
    assert!(
        problem
            .message
            .contains("INSERT handle 20: its clip (XCLIP)"),
        "{problem}"
    );
    assert!(problem.remedy.contains("--ignore-clips"), "{problem}");
    let ignored = ReadOptions {
        ignore_clips: true,
        ..ReadOptions::default()
    };
    let drawing = read(file("1").as_bytes(), &ignored).unwrap();
    assert!(
        drawing
            .notices
            .iter()
            .any(|one| one.contains("INSERT handle 20"))
    );
    assert_eq!(draw(&file("0")).paths.len(), 1);
}
