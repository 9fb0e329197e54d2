//! Drawings for tests.

/// A DXF with these entities: pairs of group code and value, one a line, `code value`.
pub fn dxf(entities: &str) -> String {
    sections(&[("ENTITIES", entities)])
}

/// A DXF of sections.
pub fn sections(sections: &[(&str, &str)]) -> String {
    let mut text = String::new();
    for (name, content) in sections {
        text.push_str(&format!("0\nSECTION\n2\n{name}\n"));
        for line in content.lines().filter(|line| !line.trim().is_empty()) {
            let line = line.trim();
            let (code, value) = line.split_once(' ').unwrap_or((line, ""));
            text.push_str(&format!("{code}\n{value}\n"));
        }
        text.push_str("0\nENDSEC\n");
    }
    text.push_str("0\nEOF\n");
    text
}

/// A TrueType font of a space and an L, both 600 wide in an em of 1000. The L is 400 wide from 100,
/// and 700 high, which is the height of capitals.
pub fn font() -> Vec<u8> {
    font_of('L', 700, 700)
}

/// The same font with another letter in place of the L, of this height, and with the height of
/// capitals that it states; 0 states none. It reaches 200 below the baseline.
pub fn font_of(letter: char, height: i16, stated: i16) -> Vec<u8> {
    let letter = letter as i16;
    let words = |all: &[i16]| -> Vec<u8> { all.iter().flat_map(|one| one.to_be_bytes()).collect() };
    let mut head = words(&[1, 0, 1, 0, 0, 0, 0x5f0f, 0x3cf5, 0, 1000]);
    head.extend([0; 16]);
    head.extend(words(&[0, 0, 1000, height, 0, 8, 2, 0, 0]));
    let hhea = words(&[
        1, 0, 800, -200, 0, 600, 0, 0, 500, 1, 0, 0, 0, 0, 0, 0, 0, 1,
    ]);
    let maxp = words(&[1, 0, 3, 6, 1, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0]);
    let hmtx = words(&[600, 0, 0, 100]);
    // Glyph 0 is for missing characters, 1 the space, 2 the L.
    let mut glyf = words(&[1, 100, 0, 500, height, 5, 0]);
    glyf.extend([1; 6]);
    glyf.extend(words(&[
        100,
        400,
        0,
        -300,
        0,
        -100,
        0,
        0,
        100,
        0,
        height - 100,
        0,
    ]));
    let loca = words(&[0, 0, 0, (glyf.len() / 2) as i16]);
    let mut cmap = words(&[0, 1, 3, 1, 0, 12, 4, 40, 0, 6, 4, 1, 2]);
    // Segments: the space, the L, the end.
    cmap.extend(words(&[
        0x20,
        letter,
        -1,
        0,
        0x20,
        letter,
        -1,
        1 - 0x20,
        2 - letter,
        1,
        0,
        0,
        0,
    ]));
    let length = (cmap.len() - 12) as u16;
    cmap[14..16].copy_from_slice(&length.to_be_bytes());
    let mut os2 = words(&[2]);
    os2.extend([0; 86]);
    os2.extend(words(&[stated, 0, 0, 0]));
    let tables: [(&[u8; 4], Vec<u8>); 8] = [
        (b"OS/2", os2),
        (b"cmap", cmap),
        (b"glyf", glyf),
        (b"head", head),
        (b"hhea", hhea),
        (b"hmtx", hmtx),
        (b"loca", loca),
        (b"maxp", maxp),
    ];
    let mut font = words(&[1, 0, 8, 128, 3, 0]);
    let mut content = Vec::new();
    for (name, table) in tables {
        let at = 12 + 16 * 8 + content.len() as u32;
        font.extend(name);
        font.extend([0; 4]);
        font.extend(at.to_be_bytes());
        font.extend((table.len() as u32).to_be_bytes());
        content.extend(&table);
        content.resize(content.len().next_multiple_of(4), 0);
    }
    font.extend(content);
    font
}
