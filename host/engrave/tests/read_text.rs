//! Text of DXF drawings: sizes and codes of MTEXT, code pages.

use crate::common;
use common::{font, sections};
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::read::text::Font;
use haptimill_engrave::read::{ReadOptions, read};

/// Reads a drawing with the font of the tests, which has a space and an L.
fn with_font(bytes: &[u8]) -> Drawing {
    let file = font();
    let font = Font::new(&file).unwrap();
    let options = ReadOptions {
        font: Some(&font),
        unit_mm: Some(1.0),
        ..ReadOptions::default()
    };
    read(bytes, &options).unwrap()
}

/// Low and high corner of each letter.
fn letters(string: &str) -> Vec<[[f64; 2]; 2]> {
    let text = format!("0 MTEXT\n8 0\n10 0\n20 0\n40 7\n71 1\n1 {string}");
    let drawing = with_font(sections(&[("ENTITIES", &text)]).as_bytes());
    assert!(drawing.problems.is_empty(), "{:?}", drawing.problems);
    let bounds = drawing.paths.iter().map(|path| path.bounds().unwrap());
    bounds.collect()
}

fn near(found: [[f64; 2]; 2], low: [f64; 2], high: [f64; 2]) {
    let all = found.into_iter().flatten().zip(low.into_iter().chain(high));
    for (found, stated) in all {
        assert!((found - stated).abs() < 1e-3, "{found} {stated}");
    }
}

/// The L is 0.4 em wide from 0.1 em and advances 0.6 em; capitals have 0.7 em: at a height of 7 an
/// em is 10.
#[test]
fn letters_have_the_sizes_of_the_codes() {
    let plain = letters("LL");
    near(plain[0], [1.0, -7.0], [5.0, 0.0]);
    near(plain[1], [7.0, -7.0], [11.0, 0.0]);
    // Twice as high: the line goes down by the height of its tallest letter.
    for code in [r"L{\H2x;L}L", r"L{\H14;L}L", r"L{\H14L}L"] {
        let sized = letters(code);
        near(sized[0], [1.0, -14.0], [5.0, -7.0]);
        near(sized[1], [8.0, -14.0], [16.0, 0.0]);
        near(sized[2], [19.0, -14.0], [23.0, -7.0]);
    }
    let narrow = letters(r"\W0.5;LL");
    near(narrow[1], [3.5, -7.0], [5.5, 0.0]);
    // Two lines: the second is 5/3 of its own height below the first.
    let lines = letters(r"L\P\H14;L");
    near(
        lines[1],
        [2.0, -7.0 - 14.0 * 5.0 / 3.0],
        [10.0, -7.0 - 14.0 * 2.0 / 3.0],
    );
}

/// What a text asks for and does not get is a notice with the entity.
#[test]
fn codes_that_are_not_drawn_are_noted() {
    let text = r"0 MTEXT
        5 A7
        8 NOTES
        10 0
        20 0
        40 7
        1 \LL\l \T2;L \pqc;L {\fArial|b1;L}
        0 TEXT
        5 A8
        8 0
        10 0
        20 0
        40 7
        1 %%uL";
    let drawing = with_font(sections(&[("ENTITIES", text)]).as_bytes());
    let notices = drawing.notices.join("\n");
    for (what, handles) in [
        ("lines under", &["A7", "A8"][..]),
        ("a spacing of its letters", &["A7"]),
        ("alignment of its paragraphs", &["A7"]),
        ("its own fonts", &["A7"]),
    ] {
        let notice = notices.lines().find(|line| line.contains(what));
        let notice = notice.unwrap_or_else(|| panic!("{what}: {notices}"));
        assert!(handles.iter().all(|one| notice.contains(one)), "{notice}");
    }
    assert_eq!(drawing.paths.len(), 5);
}

/// A text with these bytes in a file of this version and code page. Its problem names the letters
/// that the font of the tests does not have.
fn problem(version: &str, page: Option<&str>, bytes: &[u8]) -> (String, Drawing) {
    let mut header = format!("9 $ACADVER\n1 {version}\n");
    if let Some(page) = page {
        header += &format!("9 $DWGCODEPAGE\n3 {page}\n");
    }
    let text = "0 TEXT\n5 2F\n8 0\n10 0\n20 0\n40 7\n1 @";
    let file = sections(&[("HEADER", &header), ("ENTITIES", text)]);
    let (before, after) = file.split_once('@').unwrap();
    let file = [before.as_bytes(), bytes, after.as_bytes()].concat();
    let drawing = with_font(&file);
    assert_eq!(drawing.problems.len(), 1);
    (drawing.problems[0].to_string(), drawing)
}

#[test]
fn letters_of_a_code_page_are_the_right_ones() {
    for (version, page, bytes, letters) in [
        ("AC1009", "ansi_1252", &b"Gr\xfc\xdfe"[..], "Grüße"),
        ("AC1015", "ANSI_1251", b"\xcf\xeb\xe0\xed", "План"),
        ("AC1015", "ANSI_932", b"\x93\xfa\x96\x7b", "日本"),
        // 0x5C, the backslash, is the second byte of a letter here.
        ("AC1015", "ANSI_932", b"\x95\x5c", "表"),
        ("AC1014", "GB2312", b"\xc4\xa3", "模"),
        ("AC1024", "ANSI_1252", "Grüße".as_bytes(), "Grüße"),
        ("AC1015", "ANSI_1252", "Grüße".as_bytes(), "Grüße"),
        ("AC1015", "ANSI_1252", br"Gr\U+00FC\M+193FA", "Grü日"),
    ] {
        let (problem, _) = problem(version, Some(page), bytes);
        assert!(problem.contains(&format!("'{letters}'")), "{problem}");
        assert!(problem.contains("2F"), "{problem}");
    }
}

#[test]
fn letters_that_cannot_be_known_are_refused_or_noted() {
    let (found, drawing) = problem("AC1009", Some("dos850"), b"Gr\x81n");
    assert!(
        found.contains("no characters") && found.contains("2F"),
        "{found}"
    );
    assert!(drawing.notices.join("").contains("dos850"));
    let (found, drawing) = problem("AC1027", Some("ANSI_1252"), b"Gr\xfcn");
    assert!(found.contains("no characters"), "{found}");
    assert!(drawing.notices.join("").contains("not UTF-8"));
    let (found, drawing) = problem("AC1009", None, b"Gr\xfcn");
    assert!(found.contains("'Grün'"), "{found}");
    assert!(drawing.notices.join("").contains("ANSI_1252"));
}

/// Capitals are as high as the drawing says, also with a font that does not state their height. A
/// text that is aligned at its bottom has its descenders on the point, 0.2 em below its baseline.
#[test]
fn capitals_have_their_height_and_bottoms_their_descenders() {
    // The H is 0.8 em high.
    for stated in [0, 800] {
        let file = common::font_of('H', 800, stated);
        let font = Font::new(&file).unwrap();
        let options = ReadOptions {
            font: Some(&font),
            unit_mm: Some(1.0),
            ..ReadOptions::default()
        };
        for (kind, vertical, codes, low) in [
            ("TEXT", 73, "0", 0.0),
            ("TEXT", 73, "1", 2.0),
            ("TEXT", 73, "2", -4.0),
            ("TEXT", 73, "3", -8.0),
            ("ATTRIB", 74, "1", 2.0),
        ] {
            let text = format!(
                "0 {kind}\n8 0\n10 0\n20 0\n40 8\n1 H\n72 0\n{vertical} {codes}\n11 0\n21 0"
            );
            let drawing = read(sections(&[("ENTITIES", &text)]).as_bytes(), &options).unwrap();
            assert_eq!(drawing.problems, []);
            near(drawing.bounds().unwrap(), [1.0, low], [5.0, low + 8.0]);
        }
    }
}
