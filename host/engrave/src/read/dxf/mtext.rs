//! Text strings of a DXF drawing: special characters and the formatting codes of MTEXT.

use super::codepage::multi_byte;
use std::collections::BTreeSet;

/// What is drawn in another way than the drawing asks.
pub type Notes = BTreeSet<&'static str>;

const FONTS: &str = "its own fonts; the font of --font is used";
const FRACTIONS: &str = "stacked fractions, which are drawn in a line";
const INDENTS: &str = "indents or an alignment of its paragraphs, which are not kept";
const ALIGNED: &str = "heights that are aligned in its lines; they stand on the baseline";
const SPACED: &str = "a spacing of its letters, which is not kept";
const COLUMNS: &str = "columns, which follow each other as lines";
const UNDERLINED: &str = "lines under, over or through its letters, which are not drawn";

/// How a letter is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Style {
    /// Height of a capital letter, in units of the drawing.
    pub height: f64,
    /// Factor of its width.
    pub width: f64,
    /// Angle to the right of upright, rad.
    pub oblique: f64,
}

/// Letters of a line.
pub type Line = Vec<(char, Style)>;

/// Reads a special character at the start of `text`: `%%d`, `%%nnn`, `\U+XXXX`, `\M+nXXXX`. Returns
/// it and its length; `None` for the code of an underline.
fn special(text: &str) -> Option<(Option<char>, usize)> {
    let hex = |from: usize| {
        let digits = text.get(from..from + 4)?;
        u16::from_str_radix(digits, 16).ok()
    };
    if text.starts_with("\\U+") {
        let one = char::from_u32(u32::from(hex(3)?))?;
        return Some((Some(one), 7));
    }
    if let Some(page) = text.strip_prefix("\\M+") {
        let page = page.chars().next()?;
        return Some((Some(multi_byte(page, hex(4)?)?), 8));
    }
    let code = text.strip_prefix("%%")?;
    if let Some(digits) = code.get(..3)
        && let Ok(number) = digits.parse::<u8>()
    {
        return Some((Some(char::from(number)), 5));
    }
    let one = match code.chars().next()?.to_ascii_lowercase() {
        'd' => Some('\u{b0}'),
        'p' => Some('\u{b1}'),
        'c' => Some('\u{2300}'),
        '%' => Some('%'),
        'u' | 'o' | 'k' => None,
        _ => return None,
    };
    Some((one, 3))
}

/// The letters of a TEXT or an ATTRIB.
pub fn single_line(text: &str, style: Style, notes: &mut Notes) -> Line {
    let mut line = Line::new();
    let mut rest = text;
    while let Some(one) = rest.chars().next() {
        let (one, length) = special(rest).unwrap_or((Some(one), one.len_utf8()));
        match one {
            Some(one) => line.push((one, style)),
            None => {
                notes.insert(UNDERLINED);
            }
        }
        rest = &rest[length..];
    }
    line
}

/// Reader of the string of an MTEXT.
struct Formatted<'t, 'n> {
    rest: &'t str,
    style: Style,
    outer: Vec<Style>,
    lines: Vec<Line>,
    notes: &'n mut Notes,
}

/// The lines of an MTEXT; its letters begin with `style`.
pub fn lines(text: &str, style: Style, notes: &mut Notes) -> Vec<Line> {
    let mut reader = Formatted {
        rest: text,
        style,
        outer: Vec::new(),
        lines: vec![Line::new()],
        notes,
    };
    while let Some(one) = reader.rest.chars().next() {
        reader.next(one);
    }
    let aligned = reader.notes.remove(ALIGNED);
    let sizes_differ = |line: &Line| {
        line.windows(2)
            .any(|two| two[0].1.height != two[1].1.height)
    };
    if aligned && reader.lines.iter().any(sizes_differ) {
        reader.notes.insert(ALIGNED);
    }
    reader.lines
}

impl Formatted<'_, '_> {
    fn push(&mut self, one: char) {
        if let Some(line) = self.lines.last_mut() {
            line.push((one, self.style));
        }
    }

    fn new_line(&mut self) {
        self.lines.push(Line::new());
    }

    fn skip(&mut self, length: usize) {
        self.rest = &self.rest[length..];
    }

    fn next(&mut self, one: char) {
        if let Some((found, length)) = special(self.rest)
            && let Some(found) = found
        {
            self.skip(length);
            self.push(found);
            return;
        }
        self.skip(one.len_utf8());
        match one {
            '{' => self.outer.push(self.style),
            '}' => self.style = self.outer.pop().unwrap_or(self.style),
            '^' => {
                let next = self.rest.chars().next();
                self.skip(next.map_or(0, char::len_utf8));
                match next {
                    Some('J') => self.new_line(),
                    Some('I') => self.push(' '),
                    Some('M') => {}
                    Some(' ') | None => self.push('^'),
                    Some(other) => {
                        self.push('^');
                        self.push(other);
                    }
                }
            }
            '\\' => self.escape(),
            other => self.push(other),
        }
    }

    fn escape(&mut self) {
        let Some(code) = self.rest.chars().next() else {
            self.push('\\');
            return;
        };
        let before = self.rest;
        self.skip(code.len_utf8());
        match code {
            'P' | 'X' => self.new_line(),
            'N' => {
                self.notes.insert(COLUMNS);
                self.new_line();
            }
            '~' => self.push(' '),
            '\\' | '{' | '}' => self.push(code),
            'L' | 'O' | 'K' => {
                self.notes.insert(UNDERLINED);
            }
            'l' | 'o' | 'k' => {}
            'S' => self.fraction(),
            'H' | 'W' | 'Q' | 'T' | 'A' | 'C' | 'c' => {
                if !self.value(code) {
                    self.rest = before;
                    self.push('\\');
                }
            }
            'f' | 'F' | 'p' => match self.rest.find(';') {
                Some(end) => {
                    let value = &self.rest[..end];
                    if code != 'p' {
                        self.notes.insert(FONTS);
                    } else if value.contains(['i', 'l', 'r', 'q', 't']) {
                        self.notes.insert(INDENTS);
                    }
                    self.skip(end + 1);
                }
                None => {
                    self.rest = before;
                    self.push('\\');
                }
            },
            // No code: the backslash is a letter, as in the name of a file.
            _ => {
                self.rest = before;
                self.push('\\');
            }
        }
    }

    /// Reads the number of a code, an `x` where it is a factor, and the semicolon behind it.
    fn value(&mut self, code: char) -> bool {
        let is_digit = |one: char| one.is_ascii_digit() || matches!(one, '.' | '-' | '+' | 'e');
        let end = self
            .rest
            .find(|one| !is_digit(one))
            .unwrap_or(self.rest.len());
        let Ok(number) = self.rest[..end].parse::<f64>() else {
            return false;
        };
        self.skip(end);
        let is_factor = self.rest.starts_with('x') && matches!(code, 'H' | 'W');
        self.skip(usize::from(is_factor));
        self.skip(usize::from(self.rest.starts_with(';')));
        let style = &mut self.style;
        match code {
            'H' if number > 0.0 => {
                style.height = if is_factor {
                    style.height * number
                } else {
                    number
                };
            }
            'W' if number > 0.0 => {
                style.width = if is_factor {
                    style.width * number
                } else {
                    number
                };
            }
            'Q' if number.abs() <= 85.0 => style.oblique = number.to_radians(),
            'T' if number != 1.0 => {
                self.notes.insert(SPACED);
            }
            'A' if number != 0.0 => {
                self.notes.insert(ALIGNED);
            }
            _ => {}
        }
        true
    }

    /// A stacked fraction `\S1/2;`, `\S1#2;` or `\S1^ 2;`.
    fn fraction(&mut self) {
        self.notes.insert(FRACTIONS);
        while let Some(one) = self.rest.chars().next() {
            self.skip(one.len_utf8());
            match one {
                ';' => return,
                '\\' => {
                    let next = self.rest.chars().next();
                    self.skip(next.map_or(0, char::len_utf8));
                    self.push(next.unwrap_or('\\'));
                }
                '^' | '#' => {
                    self.skip(usize::from(self.rest.starts_with(' ')));
                    self.push('/');
                }
                other => self.push(other),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Style = Style {
        height: 2.0,
        width: 1.0,
        oblique: 0.0,
    };

    fn plain(text: &str) -> (Vec<String>, Notes) {
        let mut notes = Notes::new();
        let lines = lines(text, PLAIN, &mut notes);
        let text = |line: &Line| line.iter().map(|one| one.0).collect();
        (lines.iter().map(text).collect(), notes)
    }

    #[test]
    fn formatting_codes_of_a_multi_line_text_go() {
        let text = r"\fTechnic|b0|i0|c2|p2;KMITL\P{\H2.5x;5%%d} \{a\} \S1/2;";
        let (lines, notes) = plain(text);
        assert_eq!(lines, ["KMITL", "5\u{b0} {a} 1/2"]);
        assert_eq!(notes.into_iter().collect::<Vec<_>>(), [FONTS, FRACTIONS]);
        assert_eq!(plain(r"\U+00D8 5\M+193FA%%065").0, ["\u{d8} 5\u{65e5}A"]);
        assert!(plain(r"\A1;\C1;\T1;\pl0;x").1.contains(INDENTS));
        assert!(plain(r"\A1;\C1;\T1;x").1.is_empty());
    }

    /// Every letter that is no code is in the text.
    #[test]
    fn what_is_no_code_stays() {
        assert_eq!(plain(r"C:\temp\part").0, [r"C:\temp\part"]);
        assert_eq!(plain(r"C:\Hall\Q").0, [r"C:\Hall\Q"]);
        assert_eq!(plain(r"\fArial").0, [r"\fArial"]);
        assert_eq!(plain(r"2^ 3 ^A \").0, [r"2^3 ^A \"]);
        assert_eq!(plain(r"\S1^ 2").0, ["1/2"]);
        let mut notes = Notes::new();
        let line = single_line("%%u100%%%%%z", PLAIN, &mut notes);
        assert_eq!(line.iter().map(|one| one.0).collect::<String>(), "100%%%z");
        assert!(notes.contains(UNDERLINED));
    }

    #[test]
    fn sizes_hold_to_the_end_of_their_braces() {
        let mut notes = Notes::new();
        let lines = lines(r"a{\H3;b\H2x;c\W0.5;\Q15;d}e", PLAIN, &mut notes);
        let of = |k: usize| lines[0][k].1;
        assert_eq!((of(0), of(4)), (PLAIN, PLAIN));
        assert_eq!((of(1).height, of(2).height), (3.0, 6.0));
        assert_eq!((of(3).height, of(3).width), (6.0, 0.5));
        assert!((of(3).oblique - 15_f64.to_radians()).abs() < 1e-12);
        assert!(notes.is_empty());
    }
}
