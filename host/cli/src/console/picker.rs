//! Choice of a part program: folders, removable media, a typed path.

use super::app::App;
use super::input::{is_cancel, typed};
use super::keys::Key;
use super::listing::{Found, Kind, Picker, Row};
use super::view_model::{Overlay, Severity};
use ratatui::crossterm::event::KeyCode;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::TryRecvError;

impl App {
    /// Opens the list of the folder of the last program.
    pub(super) fn open_picker(&mut self) {
        let text = self.jobs.typed();
        let folder = Path::new(&text).parent().unwrap_or(Path::new(""));
        let row = match text.is_empty() {
            true => Row::First,
            false => Row::None,
        };
        self.jobs.search.begin(folder.to_path_buf(), row);
        self.open(Overlay::Programs(Picker {
            text,
            ..Picker::default()
        }));
    }

    /// Handles a key of the list.
    pub(super) fn picker_key(&mut self, mut picker: Picker, key: Key) {
        if is_cancel(key) {
            self.jobs.search.cancel();
            return;
        }
        let count = picker.listing.as_ref().map_or(0, |list| list.entries.len());
        let selected = picker.selected.filter(|row| *row < count);
        match (key.code, selected) {
            (KeyCode::Up, Some(row)) => picker.selected = row.checked_sub(1),
            (KeyCode::PageUp, Some(row)) => picker.selected = Some(row.saturating_sub(10)),
            (KeyCode::Down | KeyCode::PageDown, None) if count > 0 => picker.selected = Some(0),
            (KeyCode::Down, Some(row)) => picker.selected = Some((row + 1).min(count - 1)),
            (KeyCode::PageDown, Some(row)) => picker.selected = Some((row + 10).min(count - 1)),
            (KeyCode::Enter, row) => return self.choose(picker, row),
            (KeyCode::Backspace, Some(_)) => picker = self.go_up(picker),
            (KeyCode::Backspace, None) if picker.text.is_empty() => picker = self.go_up(picker),
            (KeyCode::Up | KeyCode::PageUp | KeyCode::Down | KeyCode::PageDown, None) => {}
            _ => {
                if let Some(text) = typed(&picker.text, key) {
                    (picker.text, picker.selected) = (text, None);
                }
            }
        }
        self.overlay = Overlay::Programs(picker);
    }

    /// Takes pasted text as part of the path.
    pub(super) fn paste_path(&mut self, mut picker: Picker, text: &str) {
        picker.selected = None;
        let letters = text.chars().take_while(|letter| !letter.is_control());
        picker.text.extend(letters);
        self.overlay = Overlay::Programs(picker);
    }

    /// Opens the selected folder, or checks the selected or typed program.
    fn choose(&mut self, picker: Picker, row: Option<usize>) {
        let entry = row.and_then(|row| picker.listing.as_ref()?.entries.get(row));
        match entry {
            Some(entry) if entry.kind == Kind::Program => {
                let path = entry.path.clone();
                self.jobs.search.cancel();
                self.check_program(path);
            }
            Some(entry) => {
                let left = picker.listing.as_ref().map(|list| list.folder.clone());
                let row = match (entry.kind, left) {
                    (Kind::Up, Some(left)) => Row::Of(left),
                    _ => Row::First,
                };
                self.jobs.search.begin(entry.path.clone(), row);
                self.overlay = Overlay::Programs(Picker {
                    listing: None,
                    ..picker
                });
            }
            None if picker.text.is_empty() => self.overlay = Overlay::Programs(picker),
            None => {
                let path = PathBuf::from(&picker.text);
                self.jobs.search.begin(path, Row::Typed);
                self.overlay = Overlay::Programs(Picker {
                    listing: None,
                    ..picker
                });
            }
        }
    }

    /// Reads the folder above.
    fn go_up(&mut self, picker: Picker) -> Picker {
        let folder = picker.listing.as_ref().map(|list| list.folder.clone());
        let Some((folder, above)) = folder.and_then(|folder| {
            let above = folder.parent()?.to_path_buf();
            Some((folder, above))
        }) else {
            return picker;
        };
        self.jobs.search.begin(above, Row::Of(folder));
        Picker {
            listing: None,
            ..picker
        }
    }

    /// Shows a folder that was read, or checks the program that was typed.
    pub(super) fn advance_search(&mut self) {
        let Some(search) = &self.jobs.search.0 else {
            return;
        };
        let found = match search.try_recv() {
            Err(TryRecvError::Empty) => return,
            found => found,
        };
        self.jobs.search.cancel();
        let Overlay::Programs(picker) = &mut self.overlay else {
            return;
        };
        match found {
            Ok(Found::Folder(listing, selected)) => {
                // What was typed in the meantime is kept.
                picker.selected = selected;
                picker.listing = Some(Arc::new(listing));
            }
            Ok(Found::File(path)) => {
                self.overlay = Overlay::None;
                self.check_program(path);
            }
            Err(_) => self.notify(Severity::Warning, "the folder cannot be read"),
        }
    }
}
