//! Bytes of a part program: of a file, or of a stream that can go back.

use crate::commands::{CliError, Exit};
use haptimill_gcode::ProgramBytes;
use haptimill_machine_file::input;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Longest text of a program that is kept in memory, for its recording.
const KEPT_BYTES: u64 = 1 << 20;

/// The bytes of a streamed program.
pub(super) type Bytes = Box<dyn ProgramBytes + Send>;

/// The bytes of a file, or of standard input for `-`.
///
/// # Errors
/// The file cannot be read.
pub(super) fn open(path: &Path) -> Result<(Bytes, bool), CliError> {
    if path == Path::new("-") {
        return Ok((spool(Box::new(io::stdin()))?, true));
    }
    let unreadable = |error: io::Error| {
        let remedy = input::remedy_of(path, &error);
        let what = format!("{}: {error}; {remedy}", path.display());
        CliError::new(Exit::BadInput, what)
    };
    let file = File::open(path).map_err(unreadable)?;
    if file.metadata().map_err(unreadable)?.is_dir() {
        let what = format!("{}: it is a folder; name a part program", path.display());
        return Err(CliError::new(Exit::BadInput, what));
    }
    Ok((Box::new(file), false))
}

/// The bytes of a program that is checked and then runs: what is checked is what runs, whatever
/// happens to the file in the meantime. A short text is in memory, and is returned, too; a longer
/// one is copied to a file without a name.
///
/// # Errors
/// The file cannot be read, or no temporary file can be made.
pub(super) fn keep(path: &Path) -> Result<(Bytes, Vec<u8>), CliError> {
    let (mut file, _) = open(path)?;
    let mut text = Vec::new();
    let unreadable = |error: io::Error| {
        let what = format!("{}: {error}", path.display());
        CliError::new(Exit::BadInput, what)
    };
    file.by_ref()
        .take(KEPT_BYTES + 1)
        .read_to_end(&mut text)
        .map_err(unreadable)?;
    if text.len() as u64 <= KEPT_BYTES {
        return Ok((Box::new(io::Cursor::new(text.clone())), text));
    }
    file.rewind().map_err(unreadable)?;
    Ok((spool(Box::new(file))?, Vec::new()))
}

/// The bytes of a program that comes while it runs.
///
/// # Errors
/// No temporary file can be made.
pub(super) fn spool(input: Box<dyn Read + Send>) -> Result<Bytes, CliError> {
    let spool = Spool::new(input).map_err(|error| {
        let what = format!(
            "a file for the lines that were read cannot be made in {}: {error}; set TMPDIR to a \
             folder on a disk with space",
            std::env::temp_dir().display()
        );
        CliError::new(Exit::Output, what)
    })?;
    Ok(Box::new(spool))
}

/// A stream that can go back: what was read is kept in a file without a name, because loops and
/// subroutines go back to earlier lines.
struct Spool<R> {
    input: R,
    file: File,
    /// Bytes in the file, and the next one.
    length: u64,
    at: u64,
}

impl<R: Read> Spool<R> {
    fn new(input: R) -> io::Result<Self> {
        Ok(Self {
            input,
            file: tempfile::tempfile()?,
            length: 0,
            at: 0,
        })
    }
}

impl<R: Read> Read for Spool<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.file.seek(SeekFrom::Start(self.at))?;
        let count = if self.at < self.length {
            self.file.read(buffer)?
        } else {
            let count = self.input.read(buffer)?;
            self.file.write_all(&buffer[..count])?;
            self.length += count as u64;
            count
        };
        self.at += count as u64;
        Ok(count)
    }
}

impl<R> Seek for Spool<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
        };
        let within = at.filter(|at| *at <= self.length);
        self.at = within.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A text that is replaced in place after its check runs as it was checked.
    #[test]
    fn what_is_kept_does_not_follow_the_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("part.ngc");
        for length in [1000, KEPT_BYTES as usize, KEPT_BYTES as usize + 1] {
            let text: Vec<u8> = (0..length).map(|k| (k % 251) as u8).collect();
            std::fs::write(&path, &text).expect("written");
            let (mut bytes, kept) = keep(&path).expect("read");
            // The check reads it to its end.
            let mut read = Vec::new();
            bytes.read_to_end(&mut read).expect("read");
            assert_eq!(read, text);
            std::fs::write(&path, "M30").expect("written");
            bytes.rewind().expect("a start");
            read.clear();
            bytes.read_to_end(&mut read).expect("read");
            assert_eq!(read, text);
            assert_eq!(kept.is_empty(), length as u64 > KEPT_BYTES);
        }
    }

    /// What goes back reads the same bytes, over the ends of what was read at once.
    #[test]
    fn a_spool_goes_back() {
        let text: Vec<u8> = (0..10_000u32).map(|k| (k % 251) as u8).collect();
        let mut spool = Spool::new(text.as_slice()).expect("a file");
        let mut buffer = [0; 700];
        let mut read = |spool: &mut Spool<&[u8]>, at: u64| {
            spool.seek(SeekFrom::Start(at)).expect("within");
            let count = spool.read(&mut buffer).expect("readable");
            buffer[..count].to_vec()
        };
        for at in [0, 700, 100, 1400, 2100, 650, 0, 2800] {
            let bytes = read(&mut spool, at);
            assert!(!bytes.is_empty());
            assert_eq!(bytes, text[at as usize..at as usize + bytes.len()]);
        }
        assert!(spool.seek(SeekFrom::Start(9999)).is_err());
    }
}
