//! Drawings for tests.

/// A DXF with these entities: pairs of group code and value, one a line, `code value`.
pub fn dxf(entities: &str) -> String {
    sections(&[("ENTITIES", entities)])
}

/// A DXF of sections.
#[allow(dead_code)]
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
