//! Refusals of what is no word of a block: symbols, statements of other controllers, characters.

use super::expression::text_of;
use super::problem::{Cause, Mistake};

/// Returns the mistake of a symbol that begins nothing.
pub(crate) fn refuse_symbol(line: &[u8], at: usize) -> Mistake {
    let byte = line[at];
    if let (b'*' | b'/' | b'+' | b'-', Some(text)) = (byte, calculation_at(line, at)) {
        let remedy = format!("write [{}]", text_of(text));
        return Mistake::new(at, "a calculation outside [ ]", remedy);
    }
    let (what, remedy) = match byte {
        b'/' => (
            "a slash inside a block".into(),
            "write block delete (/) at the start of the line, divisions in [ ]",
        ),
        b'[' | b']' | b'=' => (
            format!("'{}' without a letter or parameter", char::from(byte)),
            "write X[1+2] or #1=[1+2]",
        ),
        b'*' => (
            "checksums are not supported".into(),
            "remove the * and the number after it; a product is X[#1*2]",
        ),
        b':' if line[..at]
            .iter()
            .all(|byte| matches!(byte, b' ' | b'\t' | b'%')) =>
        {
            let digits = line[at + 1..].iter().take_while(|it| it.is_ascii_digit());
            let number = text_of(&line[at + 1..at + 1 + digits.count()]);
            return Mistake::new(
                at,
                "':' in front of a program number",
                format!("write O{number}, or remove the line"),
            );
        }
        b')' => (
            "a comment is closed that was not opened".into(),
            "open it with ( on the same line",
        ),
        b'0'..=b'9' | b'.' | b'+' | b'-' => (
            "a number without a letter".into(),
            "write the letter of the word in front of the number",
        ),
        b',' if matches!(line.get(at + 1), Some(b'C' | b'R' | b'c' | b'r')) => (
            "a chamfer or rounding word after a comma is not supported".into(),
            "write the chamfer or the rounding as a move of its own",
        ),
        b',' => {
            let word = decimal_word(line, at).unwrap_or_else(|| "X10.5".into());
            return Mistake::new(
                at,
                "a comma is not supported",
                format!("write decimals with a point: {word}"),
            );
        }
        0x20..=0x7E => (
            format!("'{}' is not supported", char::from(byte)),
            "remove it, or put it in a comment ( )",
        ),
        _ => {
            return refuse_odd_character(line, at).unwrap_or_else(|| {
                let what = format!("byte 0x{byte:02X} is not part of a word");
                Mistake::new(at, what, ASCII_ONLY)
            });
        }
    };
    Mistake::new(at, what, remedy)
}

/// Returns the calculation with an operator at `at`: the value of an assignment, or of a word with
/// a parameter or an expression.
fn calculation_at(line: &[u8], at: usize) -> Option<&[u8]> {
    let before = &line[..at];
    let sign = before.iter().rposition(|byte| *byte == b'=');
    let letter = before.iter().rposition(u8::is_ascii_alphabetic);
    let calculation = |mark: usize, is_word: bool| {
        let text = line[mark + 1..].trim_ascii_start();
        // The number after `X5*` may be a checksum.
        if is_word && !matches!(text.first(), Some(b'#' | b'[')) {
            return None;
        }
        let text = &text[..calculation_length(text)];
        let reaches = line.len() - line[mark + 1..].trim_ascii_start().len() + text.len() > at;
        reaches.then_some(text)
    };
    sign.and_then(|sign| calculation(sign, false))
        .or_else(|| calculation(letter?, true))
}

/// Returns the length of the calculation at the beginning of a text: up to a comment, or the next
/// word.
fn calculation_length(text: &[u8]) -> usize {
    let (mut depth, mut end, mut needs_value) = (0, 0, true);
    for (at, byte) in text.iter().enumerate() {
        match byte {
            b'(' | b';' => break,
            b' ' | b'\t' => continue,
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth -= 1,
            _ if depth > 0 => {}
            b'+' | b'-' | b'*' | b'/' => {
                needs_value = true;
                continue;
            }
            // A word or an assignment after a blank.
            b'#' | b'0'..=b'9' | b'.' if !needs_value && end < at => break,
            b'#' | b'0'..=b'9' | b'.' => {}
            // The name of a function.
            _ if byte.is_ascii_alphabetic()
                && (needs_value || text[..at].last().is_some_and(u8::is_ascii_alphabetic)) => {}
            _ => break,
        }
        needs_value = false;
        end = at + 1;
    }
    end
}

/// Returns the mistake of a statement of other dialects that begins at a letter.
pub(crate) fn refuse_statement(line: &[u8], at: usize) -> Option<Mistake> {
    let is_letter = |byte: &&u8| byte.is_ascii_alphabetic();
    let length = line[at..].iter().take_while(is_letter).count();
    let word = &line[at..at + length];
    let remedy = match word.to_ascii_uppercase().as_slice() {
        b"IF" | b"GOTO" | b"THEN" => {
            "write O1 if [ ], the blocks, and O1 endif, on lines of their own"
        }
        b"WHILE" | b"DO" | b"END" => {
            "write O1 while [ ], the blocks, and O1 endwhile, on lines of their own"
        }
        _ => return None,
    };
    let what = format!("{} of another dialect", text_of(word));
    // A program has more of them: they are one mistake.
    Some(Mistake::new(at, what, remedy).because(Cause::Order))
}

const ASCII_ONLY: &str = "part programs are plain ASCII text outside comments";

/// The word around a comma, with a point instead: `X1,5` is X1.5.
fn decimal_word(line: &[u8], comma: usize) -> Option<String> {
    let is_digit = |byte: &&u8| byte.is_ascii_digit();
    let before = line[..comma].iter().rev().take_while(is_digit).count();
    let after = line[comma + 1..].iter().take_while(is_digit).count();
    let from = comma - before;
    let signed = from - usize::from(matches!(line[..from].last(), Some(b'-' | b'+')));
    let letter = line[..signed]
        .last()
        .filter(|byte| byte.is_ascii_alphabetic());
    let whole = text_of(&line[signed - usize::from(letter.is_some())..comma]);
    let part = text_of(&line[comma + 1..comma + 1 + after]);
    (before > 0 && after > 0).then(|| format!("{whole}.{part}"))
}

/// Returns the mistake of a character that no word has; none if the character is plain.
pub(crate) fn refuse_odd_character(line: &[u8], at: usize) -> Option<Mistake> {
    let byte = *line.get(at)?;
    if (0x20..=0x7E).contains(&byte) || byte == b'\t' {
        return None;
    }
    // A character has at most four bytes.
    let part = &line[at..line.len().min(at + 4)];
    let text = match std::str::from_utf8(part) {
        Ok(text) => text,
        Err(error) => std::str::from_utf8(&part[..error.valid_up_to()]).unwrap_or_default(),
    };
    let number = text.chars().next().map(u32::from);
    let what = match number {
        None => format!("byte 0x{byte:02X} is not part of a word"),
        Some(number) if number < 0x80 => format!("byte 0x{number:02X} is not part of a word"),
        Some(number) => format!("the character U+{number:04X} is not part of a word"),
    };
    let remedy = match number {
        // Hyphens, dashes and the sign for minus.
        Some(0x2010..=0x2015 | 0x2212 | 0xFE63 | 0xFF0D) => "write - in its place",
        // Spaces that are no blanks, and a mark of the byte order.
        Some(0xA0 | 0x2000..=0x200B | 0x202F | 0x3000 | 0xFEFF) => "write a blank in its place",
        Some(number) if number < 0x20 || number == 0x7F => "remove it",
        _ => ASCII_ONLY,
    };
    Some(Mistake::new(at, what, remedy))
}
