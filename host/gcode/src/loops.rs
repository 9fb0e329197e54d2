//! O words: loops, conditions and the ends of subroutines.

use super::Interpreter;
use super::expression::Read;
use super::flow::{Keyword, OWord, Open, OpenKind, Position, Skip, Subroutine, Until};
use super::problem::{Cause, Mistake};
use super::source::Mark;

/// A mistake in the order of blocks.
fn out_of_order(at: usize, what: String, remedy: &str) -> Box<Mistake> {
    Box::new(Mistake::new(at, what, remedy).because(Cause::Order))
}

impl Interpreter<'_> {
    pub(super) fn run_o_word(&mut self, word: &OWord, is_first: bool, from_skip: bool) -> Read<()> {
        match word.keyword {
            Keyword::None => self.program_number(word, is_first),
            Keyword::Sub => {
                let body = Subroutine { body: self.mark() };
                self.flow.subroutines.insert(word.label.clone(), body);
                self.skip(word, Until::EndSub);
                Ok(())
            }
            Keyword::EndSub | Keyword::Return => {
                let values = word.arguments(&self.line, &self.executor.state)?;
                let in_call = match self.flow.frames.last() {
                    Some(frame) if word.keyword == Keyword::EndSub => frame.label == word.label,
                    Some(_) => true,
                    None => false,
                };
                if !in_call {
                    return Err(out_of_order(
                        word.at,
                        format!("O{} is not called here", word.label),
                        "give endsub and return the label of their sub",
                    ));
                }
                let globals = &mut self.executor.state.globals;
                globals.insert("_value".into(), values.first().copied().unwrap_or(0.0));
                globals.insert(
                    "_value_returned".into(),
                    f64::from(u8::from(!values.is_empty())),
                );
                self.return_from_call(word.at)
            }
            Keyword::Call => {
                let arguments = word.arguments(&self.line, &self.executor.state)?;
                self.call(word.label.clone(), word.at, Some(&arguments), 1)
            }
            Keyword::If => {
                if self.condition(word)? != 0.0 {
                    let start = self.mark().mark;
                    self.open(word, OpenKind::If, start);
                } else {
                    self.skip(word, Until::Branch);
                }
                Ok(())
            }
            Keyword::ElseIf | Keyword::Else | Keyword::EndIf => self.run_branch(word, from_skip),
            Keyword::While => self.run_while(word),
            Keyword::Do => {
                word.arguments(&self.line, &self.executor.state)?;
                let start = self.mark().mark;
                self.open(word, OpenKind::Do, start);
                Ok(())
            }
            Keyword::Repeat => {
                // Halves go to the even number, as with LinuxCNC.
                let rounds = self.condition(word)?.round_ties_even();
                if rounds >= 1.0 {
                    let start = self.mark().mark;
                    let rounds = rounds.min(1e15) as u64;
                    self.open(word, OpenKind::Repeat(rounds), start);
                } else {
                    self.skip(word, Until::EndRepeat);
                }
                Ok(())
            }
            Keyword::EndWhile | Keyword::EndRepeat => {
                let open = self.matching(word, |kind| match kind {
                    OpenKind::While => word.keyword == Keyword::EndWhile,
                    OpenKind::Repeat(_) => word.keyword == Keyword::EndRepeat,
                    _ => false,
                })?;
                self.flow.open.pop();
                self.next_round(open, word.at)
            }
            Keyword::Break | Keyword::Continue => self.leave_round(word),
        }
    }

    /// Runs elseif, else or endif; `from_skip` if no branch before was run.
    pub(super) fn run_branch(&mut self, word: &OWord, from_skip: bool) -> Read<()> {
        if !from_skip {
            self.matching(word, |kind| kind == OpenKind::If)?;
            self.flow.open.pop();
            if word.keyword != Keyword::EndIf {
                self.skip(word, Until::EndIf);
            }
            return Ok(());
        }
        let is_true = match word.keyword {
            Keyword::EndIf => return Ok(()),
            Keyword::ElseIf => self.condition(word)? != 0.0,
            _ => true,
        };
        if is_true {
            let start = self.mark().mark;
            self.open(word, OpenKind::If, start);
        } else {
            self.skip(word, Until::Branch);
        }
        Ok(())
    }

    pub(super) fn run_while(&mut self, word: &OWord) -> Read<()> {
        let is_true = self.condition(word)? != 0.0;
        if let Some(open) = self.flow.innermost()
            && open.kind == OpenKind::Do
            && open.label == word.label
        {
            let start = open.start;
            if is_true {
                self.flow.jump(word.at)?;
                let file = self.current as u16;
                return self.go_to(Position { file, mark: start }, word.at);
            }
            self.flow.open.pop();
            return Ok(());
        }
        if is_true {
            self.open(word, OpenKind::While, self.line_start);
        } else {
            self.skip(word, Until::EndWhile);
        }
        Ok(())
    }

    /// Goes on with the next round of a loop that is no longer open, or behind it.
    pub(super) fn next_round(&mut self, mut open: Open, at: usize) -> Read<()> {
        match &mut open.kind {
            OpenKind::Repeat(left) if *left > 1 => *left -= 1,
            OpenKind::Repeat(_) => return Ok(()),
            _ => {}
        }
        self.flow.jump(at)?;
        let start = Position {
            file: self.current as u16,
            mark: open.start,
        };
        // The line of a while is read again; it opens the loop.
        if open.kind != OpenKind::While {
            self.flow.open.push(open);
        }
        self.go_to(start, at)
    }

    pub(super) fn leave_round(&mut self, word: &OWord) -> Read<()> {
        let first = self.flow.frames.last().map_or(0, |frame| frame.blocks);
        let found = self.flow.open[first.min(self.flow.open.len())..]
            .iter()
            .rposition(|open| open.label == word.label && open.kind != OpenKind::If);
        let Some(index) = found.map(|index| index + first) else {
            return Err(out_of_order(
                word.at,
                format!(
                    "O{} is not the label of a loop around this line",
                    word.label
                ),
                "write the label of the loop",
            ));
        };
        self.flow.open.truncate(index + 1);
        let Some(open) = self.flow.open.pop() else {
            return Ok(());
        };
        let is_break = word.keyword == Keyword::Break;
        match open.kind {
            OpenKind::Do if is_break => self.skip(word, Until::EndDo),
            OpenKind::Do => {
                self.flow.open.push(open);
                self.skip(word, Until::DoWhile);
            }
            OpenKind::Repeat(left) if is_break || left <= 1 => self.skip(word, Until::EndRepeat),
            OpenKind::While if is_break => self.skip(word, Until::EndWhile),
            _ => return self.next_round(open, word.at),
        }
        Ok(())
    }

    /// Goes on behind an O word with a mistake: what it begins or ends has begun or ended, so that
    /// its other end is no mistake.
    pub(super) fn keep_order(&mut self, word: &OWord) {
        let start = self.mark().mark;
        match word.keyword {
            Keyword::If | Keyword::ElseIf => self.open(word, OpenKind::If, start),
            Keyword::Repeat => self.open(word, OpenKind::Repeat(1), start),
            Keyword::While => {
                let innermost = self.flow.innermost();
                let is_end = |open: &Open| open.kind == OpenKind::Do && open.label == word.label;
                if innermost.is_some_and(is_end) {
                    self.flow.open.pop();
                }
            }
            _ => {}
        }
    }

    /// Goes on at the O word that ends a skip.
    pub(super) fn end_skip(&mut self, word: &OWord) -> Read<()> {
        let Some(skip) = self.flow.skip.take() else {
            return Ok(());
        };
        if matches!(skip.until, Until::Branch | Until::DoWhile) {
            return self.run_o_word(word, false, true);
        }
        Ok(())
    }

    pub(super) fn condition(&self, word: &OWord) -> Read<f64> {
        let found = word.arguments(&self.line, &self.executor.state)?;
        match found[..] {
            [value] => Ok(value),
            _ => Err(Box::new(Mistake::new(
                word.at,
                format!("O{} needs one expression in [ ]", word.label),
                "write [condition] or [number]",
            ))),
        }
    }

    pub(super) fn skip(&mut self, word: &OWord, until: Until) {
        self.flow.skip = Some(Skip {
            label: word.label.clone(),
            until,
            place: self.place(word.at),
        });
    }

    pub(super) fn open(&mut self, word: &OWord, kind: OpenKind, start: Mark) {
        let place = self.place(word.at);
        self.flow.open.push(Open {
            label: word.label.clone(),
            kind,
            start,
            place,
        });
    }

    /// Returns the innermost loop or condition, if it has the label and kind of an O word.
    pub(super) fn matching(&self, word: &OWord, is_kind: impl Fn(OpenKind) -> bool) -> Read<Open> {
        match self.flow.innermost() {
            Some(open) if open.label == word.label && is_kind(open.kind) => Ok(open.clone()),
            _ => Err(out_of_order(
                word.at,
                format!("O{} ends nothing that is open", word.label),
                "give it the label of its beginning, and close inner loops first",
            )),
        }
    }

    pub(super) fn program_number(&mut self, word: &OWord, is_first: bool) -> Read<()> {
        let rest = word.arguments(&self.line, &self.executor.state);
        if self.flow.frames.is_empty() && matches!(&rest, Ok(found) if found.is_empty()) {
            if !is_first && self.flow.called.contains(&word.label) {
                return self.end_at_subprogram(word);
            }
            if is_first || !self.any_step {
                return Ok(());
            }
        }
        Err(Box::new(Mistake::new(
            word.at,
            format!(
                "program number O{} is not alone in its block, before the first move",
                word.label
            ),
            "remove it; a subroutine begins with O100 sub, or is after the end (M30)",
        )))
    }
}
