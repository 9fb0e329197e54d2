//! List of a folder with part programs: its media, folders and files, and its reading in a thread.
//!
//! A medium that does not answer must not delay the heartbeat.

use haptimill_web::programs::ENDINGS;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};

/// Rows of a list at most.
const MAX_LISTED: usize = 2000;

/// Folders below which removable media are mounted.
const MEDIA: [&str; 3] = ["/media/", "/run/media/", "/mnt/"];

/// The mounted file systems.
const MOUNTS: &str = "/proc/self/mounts";

/// The open list.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Picker {
    /// The typed path.
    pub(super) text: String,
    /// The selected row; none while the typed path is meant.
    pub(super) selected: Option<usize>,
    /// The list; none while it is read.
    pub(super) listing: Option<Arc<Listing>>,
}

/// What a row of a list is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// A medium that is mounted where removable ones are.
    Medium,
    /// The folder above.
    Up,
    Folder,
    Program,
}

/// A row of a list.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub(super) kind: Kind,
    pub(super) name: String,
    pub(super) path: PathBuf,
}

/// A folder.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Listing {
    pub(super) folder: PathBuf,
    pub(super) entries: Vec<Entry>,
    /// Part programs and folders beyond the longest list.
    pub(super) more: usize,
    /// Why the folder cannot be read.
    pub(super) problem: Option<String>,
}

impl Listing {
    /// The row that is selected first.
    fn first_row(&self, row: &Row) -> Option<usize> {
        let row_of = |has: &dyn Fn(&Entry) -> bool| self.entries.iter().position(has);
        let found = match row {
            Row::None => return None,
            Row::First | Row::Typed => row_of(&|entry| entry.kind > Kind::Up),
            Row::Of(below) => row_of(&|entry| entry.kind > Kind::Up && entry.path == *below),
        };
        found.or_else(|| (!self.entries.is_empty()).then_some(0))
    }
}

/// What a path is.
#[derive(Debug)]
pub(super) enum Found {
    /// A folder, and the selected row.
    Folder(Listing, Option<usize>),
    File(PathBuf),
}

/// A folder that is read in a thread.
#[derive(Debug, Default)]
pub(super) struct Search(pub(super) Option<Receiver<Found>>);

impl Search {
    /// Forgets the folder that is read.
    pub(super) fn cancel(&mut self) {
        self.0 = None;
    }

    /// Looks at a path; `row` chooses the selected row of a folder.
    pub(super) fn begin(&mut self, path: PathBuf, row: Row) {
        let (sender, receiver) = mpsc::channel();
        std::thread::spawn(move || {
            let found = if path.is_dir() || row != Row::Typed {
                let listing = list(&path, &media());
                let row = listing.first_row(&row);
                Found::Folder(listing, row)
            } else {
                Found::File(path)
            };
            let _ = sender.send(found);
        });
        self.0 = Some(receiver);
    }
}

/// The row of a list that is selected first.
#[derive(Debug, PartialEq)]
pub(super) enum Row {
    None,
    First,
    /// The first one if the typed path is a folder.
    Typed,
    /// The one of this folder, which was left.
    Of(PathBuf),
}

/// Reads a folder. Removable media come first.
fn list(folder: &Path, media: &[PathBuf]) -> Listing {
    let here = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let here = fs::canonicalize(here).unwrap_or_else(|_| folder.to_path_buf());
    let others = media.iter().filter(|path| **path != here);
    let mut entries: Vec<Entry> = others
        .map(|path| Entry {
            kind: Kind::Medium,
            name: plain(&path.to_string_lossy()),
            path: path.clone(),
        })
        .collect();
    if let Some(above) = here.parent() {
        entries.push(Entry {
            kind: Kind::Up,
            name: "..".to_string(),
            path: above.to_path_buf(),
        });
    }
    let (mut found, problem) = match fs::read_dir(&here) {
        Ok(read) => (
            read.flatten().filter_map(entry_of).collect::<Vec<Entry>>(),
            None,
        ),
        Err(error) => {
            let problem = format!("{}: {error}", here.display());
            (Vec::new(), Some(plain(&problem)))
        }
    };
    found.sort_by(|a, b| (a.kind, &a.name).cmp(&(b.kind, &b.name)));
    let more = found.len().saturating_sub(MAX_LISTED);
    found.truncate(MAX_LISTED);
    entries.extend(found);
    Listing {
        folder: here,
        entries,
        more,
        problem,
    }
}

/// The row of a folder or of a part program; none for hidden and other files.
fn entry_of(entry: fs::DirEntry) -> Option<Entry> {
    let name = entry.file_name();
    let name = name.to_string_lossy();
    if name.starts_with('.') {
        return None;
    }
    let path = entry.path();
    // Of a link it is the type of its target.
    let data = fs::metadata(&path).ok()?;
    let ending = path.extension().map(|ending| ending.to_string_lossy());
    let is_program = ending.is_some_and(|ending| ENDINGS.contains(&&*ending.to_lowercase()));
    let kind = match (data.is_dir(), data.is_file() && is_program) {
        (true, _) => Kind::Folder,
        (_, true) => Kind::Program,
        _ => return None,
    };
    let name = plain(&name);
    Some(Entry { kind, name, path })
}

/// A name without control characters.
fn plain(name: &str) -> String {
    let shown = |letter: char| match letter.is_control() {
        true => '\u{fffd}',
        false => letter,
    };
    name.chars().map(shown).collect()
}

/// The removable media that are mounted.
fn media() -> Vec<PathBuf> {
    let mut media = mounted(&fs::read_to_string(MOUNTS).unwrap_or_default());
    // In a container a file may be mounted.
    media.retain(|path| path.is_dir());
    media
}

/// The removable media in a table of mounted file systems, sorted.
fn mounted(table: &str) -> Vec<PathBuf> {
    let places = table.lines().filter_map(|row| row.split(' ').nth(1));
    let places = places.map(unescaped).filter(|place| {
        MEDIA.iter().any(|folder| {
            let is_below = place.starts_with(folder) && place.len() > folder.len();
            is_below || place.as_str() == folder.trim_end_matches('/')
        })
    });
    let mut media: Vec<PathBuf> = places.map(PathBuf::from).collect();
    media.sort();
    media.dedup();
    media
}

/// The text of a field in the table of mounted file systems: blanks are written in octal.
fn unescaped(field: &str) -> String {
    let pairs = [
        ("\\040", " "),
        ("\\011", "\t"),
        ("\\012", "\n"),
        ("\\134", "\\"),
    ];
    pairs.iter().fold(field.to_string(), |field, (from, to)| {
        field.replace(from, to)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines as a Debian desktop with a stick, a share and a container root has them.
    #[test]
    fn mounted_sticks_are_found() {
        let table = "/dev/sda2 / ext4 rw 0 0\nproc /proc proc rw 0 0\n\
                     /dev/sdb1 /media/user/CAM\\040STICK vfat rw 0 0\n\
                     /dev/sdc1 /run/media/user/B exfat rw 0 0\nhost:/parts /mnt nfs4 rw 0 0\n\
                     /dev/sdd1 /mediaserver ext4 rw 0 0\n";
        let expected = ["/media/user/CAM STICK", "/mnt", "/run/media/user/B"];
        assert_eq!(mounted(table), expected.map(PathBuf::from));
    }

    #[test]
    fn a_list_has_media_folders_and_part_programs_in_this_order() {
        let root = tempfile::tempdir().expect("a folder");
        let root = fs::canonicalize(root.path()).expect("the folder");
        fs::create_dir_all(root.join("parts/b")).expect("a folder");
        for name in [
            "z.ngc",
            "A.NC",
            "notes.pdf",
            ".hidden.ngc",
            "a\u{1b}[2J.tap",
        ] {
            fs::write(root.join("parts").join(name), "").expect("written");
        }
        let stick = PathBuf::from("/media/stick");
        let listing = list(&root.join("parts"), std::slice::from_ref(&stick));
        let rows: Vec<(Kind, &str)> = listing
            .entries
            .iter()
            .map(|entry| (entry.kind, entry.name.as_str()))
            .collect();
        let expected = [
            (Kind::Medium, "/media/stick"),
            (Kind::Up, ".."),
            (Kind::Folder, "b"),
            (Kind::Program, "A.NC"),
            (Kind::Program, "a\u{fffd}[2J.tap"),
            (Kind::Program, "z.ngc"),
        ];
        assert_eq!(rows, expected);
        assert_eq!((listing.problem, listing.more), (None, 0));
        let gone = list(&root.join("gone"), &[stick]);
        let problem = gone.problem.expect("a problem");
        assert!(problem.contains("gone: No such file"), "{problem}");
        assert_eq!(gone.entries[0].kind, Kind::Medium);
    }
}
