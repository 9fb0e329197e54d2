//! Calls: subroutines of the program and of called files.

use super::Interpreter;
use super::expression::{Read, Values};
use super::flow::{
    ARGUMENTS, DEEPEST_CALL, Frame, Keyword, OWord, Position, Subroutine, find_o_word,
};
use super::problem::Mistake;
use super::source::{Fetched, Mark, Source};
use std::collections::HashMap;

/// Most files that a program may call.
const MAX_FILES: usize = 100;

impl Interpreter<'_> {
    /// Calls a subroutine: with arguments for an O word, without for M98.
    pub(super) fn call(
        &mut self,
        label: String,
        at: usize,
        arguments: Option<&[f64]>,
        repeats: u32,
    ) -> Read<()> {
        if self.flow.frames.len() >= DEEPEST_CALL {
            self.flow.is_endless = true;
            return Err(Box::new(Mistake::new(
                at,
                format!("calls are nested deeper than {DEEPEST_CALL}"),
                "check that the subroutine does not call itself without end",
            )));
        }
        self.flow.jump(at)?;
        if self.flow.frames.is_empty() {
            self.call_line = self.place(at).line;
        }
        let body = self.find_subroutine(&label, at)?;
        self.flow.called.insert(label.clone());
        let state = &mut self.executor.state;
        let saved = arguments.map(|arguments| {
            let mut saved = [0.0; ARGUMENTS];
            saved.copy_from_slice(&state.numbered[1..=ARGUMENTS]);
            for (index, slot) in state.numbered[1..=ARGUMENTS].iter_mut().enumerate() {
                *slot = arguments.get(index).copied().unwrap_or(0.0);
            }
            state.locals.push(HashMap::new());
            saved
        });
        self.flow.frames.push(Frame {
            label,
            back: self.mark(),
            saved,
            blocks: self.flow.open.len(),
            repeats,
            body,
        });
        self.executor.enter_call();
        self.go_to(body.body, at)
    }

    pub(super) fn return_from_call(&mut self, at: usize) -> Read<()> {
        let Some(frame) = self.flow.frames.last_mut() else {
            return Ok(());
        };
        let blocks = frame.blocks;
        self.flow.open.truncate(blocks);
        if frame.repeats > 1 {
            frame.repeats -= 1;
            let body = frame.body.body;
            self.flow.jump(at)?;
            return self.go_to(body, at);
        }
        let Some(frame) = self.flow.frames.pop() else {
            return Ok(());
        };
        if let Some(saved) = frame.saved {
            let state = &mut self.executor.state;
            state.numbered[1..=ARGUMENTS].copy_from_slice(&saved);
            state.locals.pop();
        }
        self.executor.leave_call(self.place(at));
        self.go_to(frame.back, at)
    }

    pub(super) fn find_subroutine(&mut self, label: &str, at: usize) -> Read<Subroutine> {
        if let Some(found) = self.flow.subroutines.get(label) {
            return Ok(*found);
        }
        for file in [self.current, 0] {
            self.index_file(file, at)?;
            if let Some(found) = self.flow.subroutines.get(label) {
                return Ok(*found);
            }
        }
        let file = self.open_file(label, at)?;
        self.index_file(file, at)?;
        self.flow.subroutines.get(label).copied().ok_or_else(|| {
            Box::new(Mistake::new(
                at,
                format!("the file {} has no O<{label}> sub", self.called[file - 1]),
                "give the subroutine the name of its file",
            ))
        })
    }

    /// Finds the subroutines of a file.
    pub(super) fn index_file(&mut self, file: usize, at: usize) -> Read<()> {
        let unreadable = |error: std::io::Error| {
            Box::new(Mistake::new(
                at,
                format!("the file cannot be searched for subroutines: {error}"),
                "run it from a file",
            ))
        };
        let mut line = Vec::new();
        let (mut tape_is_open, mut any_block) = (false, false);
        let source = &mut self.sources[file];
        let back = source.mark();
        source
            .seek(Mark { offset: 0, line: 0 })
            .map_err(unreadable)?;
        while source.next(&mut line).map_err(unreadable)? != Fetched::End {
            match line.trim_ascii_start().first() {
                // Behind the mark that ends the program is other text.
                Some(b'%') if file == 0 && (tape_is_open || any_block) => break,
                Some(b'%') => tape_is_open = true,
                None | Some(b'(' | b';') => {}
                Some(_) => any_block = true,
            }
            let Some(at) = find_o_word(&line) else {
                continue;
            };
            let Ok(word) = OWord::read(&line, at, &NoValues) else {
                continue;
            };
            if matches!(word.keyword, Keyword::None | Keyword::Sub) {
                let body = Position {
                    file: file as u16,
                    mark: source.mark(),
                };
                self.flow
                    .subroutines
                    .entry(word.label)
                    .or_insert(Subroutine { body });
            }
        }
        source.seek(back).map_err(unreadable)
    }

    pub(super) fn open_file(&mut self, label: &str, at: usize) -> Read<usize> {
        let mistake = |what: String, remedy: &str| Err(Box::new(Mistake::new(at, what, remedy)));
        let is_name = label
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-'));
        let folders = &self.executor.options.folders;
        if !is_name || folders.is_empty() {
            return mistake(
                format!("the subroutine O{label} does not exist"),
                "write it in this file: O100 sub ... O100 endsub",
            );
        }
        if self.called.len() >= MAX_FILES {
            return mistake(
                format!("more than {MAX_FILES} files are called"),
                "put the subroutines into fewer files",
            );
        }
        for folder in folders {
            let path = folder.join(format!("{label}.ngc"));
            // Opening a pipe would wait for its writer, in the middle of a job.
            if path.exists() && !path.is_file() {
                return mistake(
                    format!("{} is no regular file", path.display()),
                    "put a part program with the subroutine there",
                );
            }
            if let Ok(file) = std::fs::File::open(&path) {
                self.called.push(path.display().to_string());
                self.sources.push(Source::new(Box::new(file)));
                return Ok(self.sources.len() - 1);
            }
        }
        mistake(
            format!("the subroutine O{label} does not exist, and no file {label}.ngc"),
            "write it in this file, or put the file beside the program",
        )
    }
}

/// Labels of subroutines are numbers and names, not parameters.
struct NoValues;

impl Values for NoValues {
    fn numbered(&self, _: u32) -> Option<f64> {
        None
    }

    fn named(&self, _: &str) -> Option<f64> {
        None
    }
}
