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

/// Reads an SVG with the font of the tests.
fn svg(content: &str) -> Drawing {
    let page = "xmlns=\"http://www.w3.org/2000/svg\" width=\"100mm\" height=\"100mm\" \
                viewBox=\"0 0 100 100\"";
    with_font(format!("<svg {page}>{content}</svg>").as_bytes())
}

/// Properties that the outlines do not follow are refused or noted by name, in an attribute, a
/// style, a style sheet, and on an element around the text. Their usual values are not.
#[test]
fn properties_of_svg_text_are_not_dropped() {
    let cases = [
        ("letter-spacing", "2px", "0px", true),
        ("word-spacing", "3", "normal", true),
        ("baseline-shift", "super", "baseline", true),
        ("writing-mode", "tb-rl", "lr-tb", true),
        ("dominant-baseline", "middle", "auto", true),
        ("alignment-baseline", "hanging", "baseline", true),
        ("text-transform", "uppercase", "none", true),
        ("font-variant", "small-caps", "normal", true),
        ("direction", "rtl", "ltr", true),
        ("inline-size", "50", "0", true),
        ("shape-inside", "url(#r)", "none", true),
        ("text-decoration", "underline", "none", false),
        ("font-stretch", "condensed", "normal", false),
    ];
    for (name, value, usual, is_refused) in cases {
        let ways = |value: &str| {
            [
                format!("<text id=\"t\" style=\"{name}:{value}\">LL</text>"),
                format!("<text id=\"t\">L<tspan style=\"{name}:{value}\">L</tspan></text>"),
                format!("<g {name}=\"{value}\"><text id=\"t\">LL</text></g>"),
                format!("<style>text {{ {name}: {value} }}</style><text id=\"t\">LL</text>"),
            ]
        };
        for content in ways(value) {
            let drawing = svg(&content);
            let problems: Vec<String> = drawing.problems.iter().map(ToString::to_string).collect();
            let said = if is_refused {
                &problems
            } else {
                &drawing.notices
            };
            let named = said.iter().any(|one| {
                one.contains(name) && one.contains("id t")
                    || one.contains(name) && one.contains("handle t")
            });
            assert!(named, "{content}: {said:?}");
            assert_eq!(drawing.paths.is_empty(), is_refused, "{content}");
        }
        for content in ways(usual) {
            let drawing = svg(&content);
            assert!(
                drawing.problems.is_empty(),
                "{content}: {:?}",
                drawing.problems
            );
            assert!(
                !drawing.notices.join(" ").contains(name),
                "{:?}",
                drawing.notices
            );
            assert_eq!(drawing.paths.len(), 2, "{content}");
        }
    }
    // The shorthand counts where no nearer element states a size.
    let short = svg("<text style=\"font:italic 20px serif\">L</text>");
    assert!(
        short.problems[0].message.contains("shorthand font"),
        "{:?}",
        short.problems
    );
    let sized = svg("<g style=\"font:20px serif\"><text font-size=\"10\">L</text></g>");
    assert!(sized.problems.is_empty(), "{:?}", sized.problems);
}

/// Text that is not visible is left out by name, with and without a font. A part without display
/// takes no space; a part that is only not visible is refused.
#[test]
fn hidden_text_is_left_out() {
    for content in [
        "<text id=\"t\" visibility=\"hidden\">L</text>",
        "<g style=\"visibility:hidden\"><text id=\"t\">L</text></g>",
        "<text id=\"t\" style=\"display:none\">L</text>",
        "<text id=\"t\"><tspan style=\"display:none\">L</tspan></text>",
    ] {
        let content = format!("<rect width=\"5\" height=\"5\"/>{content}");
        let plain = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"9mm\" height=\"9mm\">{content}</svg>"
        );
        let plain = read(plain.as_bytes(), &ReadOptions::default()).unwrap();
        for drawing in [svg(&content), plain] {
            assert!(
                drawing.problems.is_empty(),
                "{content}: {:?}",
                drawing.problems
            );
            assert_eq!(drawing.paths.len(), 1, "{content}");
            let notices = drawing.notices.join("\n");
            assert!(notices.contains("handle t"), "{content}: {notices}");
        }
    }
    let part = svg("<text id=\"t\"><tspan style=\"display:none\">L</tspan>L</text>");
    assert_eq!(part.paths.len(), 1);
    assert!(
        part.notices.join("\n").contains("display none"),
        "{:?}",
        part.notices
    );
    let mixed = svg("<text id=\"t\"><tspan visibility=\"hidden\">L</tspan>L</text>");
    assert!(
        mixed.problems[0].message.contains("not visible"),
        "{:?}",
        mixed.problems
    );
    let shown = svg("<g visibility=\"hidden\"><text visibility=\"visible\">L</text></g>");
    assert_eq!(shown.paths.len(), 1);
}

/// Filters, patterns and wide strokes are not cut, each with a notice.
#[test]
fn what_is_painted_and_not_cut_is_noted() {
    let defs = "<defs><filter id=\"f\"/><pattern id=\"p\"/></defs>";
    let rect = |more: &str| format!("{defs}<rect id=\"r\" width=\"5\" height=\"5\" {more}/>");
    for (more, expected) in [
        ("filter=\"url(#f)\"", "cut without their filter"),
        ("style=\"fill:url(#p)\"", "cut without their pattern"),
        ("style=\"fill:url('#p')\"", "cut without their pattern"),
        (
            "stroke=\"red\" stroke-width=\"3\"",
            "strokes wider than 1 mm",
        ),
        (
            "stroke=\"red\" style=\"stroke-width:2mm\" transform=\"scale(2)\"",
            "strokes wider",
        ),
    ] {
        let drawing = svg(&rect(more));
        assert_eq!(drawing.paths.len(), 1);
        let notice = drawing.notices.iter().find(|one| one.starts_with(expected));
        assert!(
            notice.is_some_and(|one| one.contains("rect handle r")),
            "{:?}",
            drawing.notices
        );
    }
    for more in [
        "filter=\"none\"",
        "stroke=\"red\"",
        "stroke-width=\"3\"",
        "fill=\"red\"",
    ] {
        let notices = svg(&rect(more)).notices.join("\n");
        for what in ["filter", "pattern", "wider"] {
            assert!(!notices.contains(what), "{notices}");
        }
    }
}
