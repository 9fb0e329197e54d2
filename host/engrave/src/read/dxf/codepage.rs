//! Characters of a DXF file: UTF-8 from AutoCAD 2007 on (AC1021), a code page before.

use super::pairs::Pairs;
use encoding_rs::{Encoding, WINDOWS_1252};
use std::borrow::Cow;

/// First version whose files are UTF-8.
const UTF_8_VERSION: &str = "AC1021";

/// A file as UTF-8. Bytes that are no characters become U+FFFD.
pub struct Decoded<'a> {
    pub bytes: Cow<'a, [u8]>,
    /// What is unusual about the file's characters.
    pub notice: Option<String>,
}

/// The encoding of a value of `$DWGCODEPAGE`.
fn encoding(page: &str) -> Option<&'static Encoding> {
    let page = page.trim().to_ascii_lowercase();
    let label = match page.as_str() {
        "gb2312" | "ansi_936" | "dos936" => "gbk",
        "big5" | "ansi_950" | "dos950" => "big5",
        "ksc5601" | "ansi_949" | "dos949" => "euc-kr",
        "ansi_932" | "dos932" => "shift_jis",
        "mac-roman" => "macintosh",
        "utf8" | "utf-8" => "utf-8",
        other => match other
            .strip_prefix("ansi_")
            .or(other.strip_prefix("iso8859-"))
        {
            Some(number) if other.starts_with("ansi") => {
                return Encoding::for_label(format!("windows-{number}").as_bytes());
            }
            Some(number) => return Encoding::for_label(format!("iso-8859-{number}").as_bytes()),
            None => return None,
        },
    };
    Encoding::for_label(label.as_bytes())
}

/// Version and code page that the header states.
fn header(bytes: &[u8]) -> (String, String) {
    let (mut version, mut page) = (String::new(), String::new());
    let mut pairs = Pairs::new(bytes);
    let mut variable = "";
    while let Ok(Some(pair)) = pairs.next() {
        match (pair.code, variable) {
            (0, _) if matches!(pair.word(), "ENDSEC" | "EOF") => break,
            (9, _) => variable = pair.word(),
            (1, "$ACADVER") => version = pair.word().to_uppercase(),
            (3, "$DWGCODEPAGE") => page = pair.word().into(),
            _ => {}
        }
    }
    (version, page)
}

/// Decodes the text of a file.
pub fn decode(bytes: &[u8]) -> Decoded<'_> {
    let as_is = |notice| Decoded {
        bytes: Cow::Borrowed(bytes),
        notice,
    };
    if bytes.is_ascii() {
        return as_is(None);
    }
    let is_utf_8 = std::str::from_utf8(bytes).is_ok();
    let lossy = |what: String| Decoded {
        bytes: match String::from_utf8_lossy(bytes) {
            Cow::Borrowed(text) => Cow::Borrowed(text.as_bytes()),
            Cow::Owned(text) => Cow::Owned(text.into_bytes()),
        },
        notice: Some(what),
    };
    let (version, page) = header(bytes);
    if version.as_str() >= UTF_8_VERSION && version.starts_with("AC") {
        return match is_utf_8 {
            true => as_is(None),
            false => lossy(format!(
                "the file has bytes that are not UTF-8, which a drawing of {version} must be"
            )),
        };
    }
    let (encoding, unstated) = match encoding(&page) {
        Some(encoding) => (encoding, false),
        None if is_utf_8 => return as_is(None),
        None if page.is_empty() => (WINDOWS_1252, true),
        None => {
            return lossy(format!(
                "the file's code page '{page}' ($DWGCODEPAGE) is not known; text with letters \
                 beyond ASCII cannot be read"
            ));
        }
    };
    // Text of a code page of one byte a character is hardly ever UTF-8 by chance.
    if is_utf_8 && encoding.is_single_byte() {
        return as_is((!page.is_empty()).then(|| {
            format!("the file states the code page {page}, but its text is UTF-8: it is read so")
        }));
    }
    let (text, _) = encoding.decode_without_bom_handling(bytes);
    Decoded {
        bytes: Cow::Owned(text.into_owned().into_bytes()),
        notice: unstated.then(|| {
            "the file states no code page ($DWGCODEPAGE): its text is read as ANSI_1252".into()
        }),
    }
}

/// The character of an escape `\M+nXXXX`: a code page and two bytes of it.
pub fn multi_byte(page: char, code: u16) -> Option<char> {
    let page = match page {
        '1' => "ansi_932",
        '2' => "ansi_950",
        '3' => "ansi_949",
        '5' => "ansi_936",
        _ => return None,
    };
    let [high, low] = code.to_be_bytes();
    let bytes: &[u8] = if high == 0 { &[low] } else { &[high, low] };
    let (text, failed) = encoding(page)?.decode_without_bom_handling(bytes);
    let mut chars = text.chars();
    let one = chars.next()?;
    (!failed && chars.next().is_none()).then_some(one)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_pages_have_their_encoding() {
        let name = |page| encoding(page).map(Encoding::name);
        assert_eq!(name("ANSI_1252"), Some("windows-1252"));
        assert_eq!(name("ansi_1251"), Some("windows-1251"));
        assert_eq!(name("ANSI_874"), Some("windows-874"));
        assert_eq!(name("ANSI_932"), Some("Shift_JIS"));
        assert_eq!(name("GB2312"), Some("GBK"));
        assert_eq!(name("ISO8859-2"), Some("ISO-8859-2"));
        assert_eq!(name("dos850"), None);
        // Shift JIS 0x93FA is the sun, in an escape as in a file.
        assert_eq!(multi_byte('1', 0x93fa), Some('\u{65e5}'));
        assert_eq!(multi_byte('9', 0x93fa), None);
    }
}
