//! Order of blocks: O words, subroutines, loops and conditions.

use super::expression::{Read, Scan, Values};
use super::problem::{Mistake, Place};
use super::source::Mark;
use std::collections::{HashMap, HashSet};

/// Deepest nesting of calls.
pub(crate) const DEEPEST_CALL: usize = 50;

/// Most arguments of a call.
pub(crate) const ARGUMENTS: usize = 30;

/// Most returns to an earlier line in one program: beyond, a loop has no end.
pub(crate) const MAX_JUMPS: u64 = 1_000_000;

/// What follows an O word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keyword {
    Sub,
    EndSub,
    Return,
    Call,
    If,
    ElseIf,
    Else,
    EndIf,
    While,
    EndWhile,
    Do,
    Repeat,
    EndRepeat,
    Break,
    Continue,
    /// A program number.
    None,
}

const KEYWORDS: [(&str, Keyword); 15] = [
    ("sub", Keyword::Sub),
    ("endsub", Keyword::EndSub),
    ("return", Keyword::Return),
    ("call", Keyword::Call),
    ("if", Keyword::If),
    ("elseif", Keyword::ElseIf),
    ("else", Keyword::Else),
    ("endif", Keyword::EndIf),
    ("while", Keyword::While),
    ("endwhile", Keyword::EndWhile),
    ("do", Keyword::Do),
    ("repeat", Keyword::Repeat),
    ("endrepeat", Keyword::EndRepeat),
    ("break", Keyword::Break),
    ("continue", Keyword::Continue),
];

/// An O word: its label and keyword, and the place of what follows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OWord {
    pub at: usize,
    pub label: String,
    pub keyword: Keyword,
    /// Place after the keyword.
    pub rest: usize,
}

impl OWord {
    /// Reads an O word at `at`.
    pub(crate) fn read(line: &[u8], at: usize, values: &dyn Values) -> Read<OWord> {
        let mut scan = Scan::new(line, at + 1, values);
        scan.skip_blanks();
        let label = match scan.peek() {
            Some(b'<') => {
                scan.at += 1;
                scan.name(at)?
            }
            Some(b'0'..=b'9' | b'#' | b'[') => {
                let number = scan.value()?;
                if number.fract() != 0.0 || !(0.0..=1e9).contains(&number) {
                    return Err(Box::new(Mistake::new(
                        at,
                        format!("O{number} is not a label"),
                        "write a whole number, or <name>",
                    )));
                }
                format!("{}", number as u64)
            }
            _ => {
                return Err(Box::new(Mistake::new(
                    at,
                    "the letter O has no number",
                    "write a number or <name> after the letter, or put a remark in ( )",
                )));
            }
        };
        scan.skip_blanks();
        let from = scan.at;
        // Blanks within a word have no meaning: `end sub` is `endsub`.
        let mut word = Vec::new();
        let mut end = from;
        while let Some(byte) = scan.peek().filter(u8::is_ascii_alphabetic) {
            word.push(byte.to_ascii_lowercase());
            scan.at += 1;
            end = scan.at;
            scan.skip_blanks();
        }
        scan.at = end;
        let keyword = if word.is_empty() {
            Keyword::None
        } else {
            match KEYWORDS
                .iter()
                .find(|(name, _)| name.as_bytes() == word.as_slice())
            {
                Some((_, keyword)) => *keyword,
                None => {
                    return Err(Box::new(Mistake::new(
                        from,
                        format!("{} is no keyword of an O word", scan.text(from)),
                        "write sub, endsub, call, return, if, elseif, else, endif, while, \
                         endwhile, do, repeat, endrepeat, break or continue",
                    )));
                }
            }
        };
        Ok(OWord {
            at,
            label,
            keyword,
            rest: scan.at,
        })
    }

    /// Reads the expressions after the keyword, and checks that only comments follow.
    pub(crate) fn arguments(&self, line: &[u8], values: &dyn Values) -> Read<Vec<f64>> {
        let mut scan = Scan::new(line, self.rest, values);
        let mut found = Vec::new();
        loop {
            scan.skip_blanks();
            match scan.peek() {
                Some(b'[') => {
                    if found.len() >= ARGUMENTS {
                        return Err(Box::new(Mistake::new(
                            scan.at,
                            format!("more than {ARGUMENTS} arguments"),
                            "use parameters",
                        )));
                    }
                    found.push(scan.bracket()?);
                }
                None | Some(b';') => return Ok(found),
                Some(b'(') => match line[scan.at..].iter().position(|byte| *byte == b')') {
                    Some(length) => scan.at += length + 1,
                    None => return Ok(found),
                },
                Some(b'%') => return Ok(found),
                Some(_) => {
                    return Err(Box::new(Mistake::new(
                        scan.at,
                        "a word after an O word",
                        "write it on a line of its own; conditions and arguments are in [ ]",
                    )));
                }
            }
        }
    }
}

/// Returns the place of the O of a line that begins with an O word, after blanks, a slash and N.
pub(crate) fn find_o_word(line: &[u8]) -> Option<usize> {
    let mut at = 0;
    let blanks = |at: &mut usize| {
        while let Some(b' ' | b'\t') = line.get(*at) {
            *at += 1;
        }
    };
    blanks(&mut at);
    if line.get(at) == Some(&b'/') {
        at += 1;
        blanks(&mut at);
    }
    if let Some(b'N' | b'n') = line.get(at) {
        at += 1;
        blanks(&mut at);
        while line
            .get(at)
            .is_some_and(|byte| byte.is_ascii_digit() || *byte == b'.')
        {
            at += 1;
        }
        blanks(&mut at);
    }
    matches!(line.get(at), Some(b'O' | b'o')).then_some(at)
}

/// Position in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Position {
    pub file: u16,
    pub mark: Mark,
}

/// A subroutine: its first line after the O word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Subroutine {
    pub body: Position,
}

/// A call in progress.
#[derive(Debug)]
pub(crate) struct Frame {
    pub label: String,
    pub back: Position,
    /// Parameters 1 to 30 of the caller; none for M98, which shares them.
    pub saved: Option<[f64; ARGUMENTS]>,
    pub blocks: usize,
    /// Remaining repeats of M98, and the body.
    pub repeats: u32,
    pub body: Subroutine,
}

/// A loop or condition in progress.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Open {
    pub label: String,
    pub kind: OpenKind,
    pub start: Mark,
    pub place: Place,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OpenKind {
    If,
    While,
    Do,
    /// Remaining rounds, this one included.
    Repeat(u64),
}

/// Lines are passed over until an O word.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Skip {
    pub label: String,
    pub until: Until,
    pub place: Place,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Until {
    EndSub,
    /// elseif, else or endif.
    Branch,
    EndIf,
    EndWhile,
    EndRepeat,
    /// The while of a do, which is run.
    DoWhile,
    /// The while of a do, which is passed over.
    EndDo,
}

impl Until {
    /// Whether a keyword ends the skip.
    pub(crate) fn ends_at(self, keyword: Keyword) -> bool {
        match self {
            Until::EndSub => keyword == Keyword::EndSub,
            Until::Branch => matches!(keyword, Keyword::ElseIf | Keyword::Else | Keyword::EndIf),
            Until::EndIf => keyword == Keyword::EndIf,
            Until::EndWhile => keyword == Keyword::EndWhile,
            Until::EndRepeat => keyword == Keyword::EndRepeat,
            Until::DoWhile | Until::EndDo => keyword == Keyword::While,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Until::EndSub => "endsub",
            Until::Branch | Until::EndIf => "endif",
            Until::EndWhile => "endwhile",
            Until::EndRepeat => "endrepeat",
            Until::DoWhile | Until::EndDo => "while",
        }
    }
}

/// State of the order of blocks.
#[derive(Debug, Default)]
pub(crate) struct Flow {
    pub frames: Vec<Frame>,
    pub open: Vec<Open>,
    pub skip: Option<Skip>,
    pub subroutines: HashMap<String, Subroutine>,
    /// Labels that were called.
    pub called: HashSet<String>,
    pub jumps: u64,
    /// A loop or recursion has no end.
    pub is_endless: bool,
}

impl Flow {
    /// Returns the innermost loop or condition of this call.
    pub(crate) fn innermost(&self) -> Option<&Open> {
        let first = self.frames.last().map_or(0, |frame| frame.blocks);
        self.open[first.min(self.open.len())..].last()
    }

    /// Counts a return to an earlier line.
    pub(crate) fn jump(&mut self, at: usize) -> Read<()> {
        self.jumps += 1;
        if self.jumps > MAX_JUMPS {
            self.is_endless = true;
            return Err(Box::new(Mistake::new(
                at,
                format!("the program goes back to earlier lines more than {MAX_JUMPS} times"),
                "check the condition of the loop: it may have no end",
            )));
        }
        Ok(())
    }
}
