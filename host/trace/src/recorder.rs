//! Recorder of a job: all records, every Nth control period, or the last ones.
//!
//! The recorder of the last control periods writes two files in turn, each of the time that is
//! kept. At the end they become one file. After a crash of the process both are readable.

use super::writer::{FileRecorder, FreeSpace, free_space};
use super::{Header, IoLog, Record, Recorded, Recording};
use haptimill_firmware::io::{Inputs, Outputs};
use std::io;
use std::path::{Path, PathBuf};

/// The records that are kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Keep {
    /// All, with the I/O log: the recording can be replayed.
    #[default]
    All,
    /// The first one of every N control periods, 2 at least.
    Every(u32),
    /// Those of the last control periods.
    Last(u64),
}

impl Keep {
    /// Says what a recording has; none where it has all.
    #[must_use]
    pub fn describe(&self, period_us: u16) -> Option<String> {
        match self {
            Self::All => None,
            Self::Every(periods) => Some(format!("one of {periods} control periods")),
            Self::Last(periods) => {
                let seconds = *periods as f64 * f64::from(period_us) * 1e-6;
                Some(format!("the last {seconds} s"))
            }
        }
    }
}

/// Sees every record, also one that is not kept.
type Observer = Box<dyn FnMut(&Record) + Send>;

/// Recorder of a job. Dropped without [`Recorder::finish`], it leaves a readable, truncated
/// recording.
pub struct Recorder {
    file: FileRecorder,
    keep: Keep,
    observer: Option<Observer>,
    /// Next control period to keep.
    next: Option<u64>,
    /// Records that were kept.
    records: u64,
    ring: Option<Ring>,
}

/// The files of the last control periods.
struct Ring {
    path: PathBuf,
    header: Header,
    free_space: FreeSpace,
    /// First control period of the present file.
    started: Option<u64>,
    newest: u64,
    has_earlier: bool,
    events: Vec<(u64, u8, String)>,
}

/// Events of a recording of the last control periods at most.
const MAX_EVENTS: usize = 10_000;

/// The file of the control periods before those of the present one.
#[must_use]
pub fn earlier_file(path: &Path) -> PathBuf {
    path.with_extension("earlier.hmr")
}

impl Recorder {
    /// Creates (or overwrites) a file and writes its header.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be created.
    pub fn create(path: &Path, header: &Header) -> io::Result<Self> {
        Self::create_with(path, header, free_space)
    }

    pub(super) fn create_with(
        path: &Path,
        header: &Header,
        free_space: FreeSpace,
    ) -> io::Result<Self> {
        Ok(Self {
            file: FileRecorder::create_with(path, header, free_space)?,
            keep: Keep::All,
            observer: None,
            next: None,
            records: 0,
            ring: None,
        })
    }

    /// As [`Recorder::create`], for a part of the records.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be created.
    pub fn create_thinned(path: &Path, header: &Header, keep: Keep) -> io::Result<Self> {
        let mut recorder = Self::create(path, header)?;
        recorder.keep = keep;
        if let Keep::Last(_) = keep {
            recorder.ring = Some(Ring {
                path: path.to_path_buf(),
                header: header.clone(),
                free_space,
                started: None,
                newest: 0,
                has_earlier: false,
                events: Vec::new(),
            });
        }
        Ok(recorder)
    }

    /// Passes every record to an observer, also one that is not kept.
    #[must_use]
    pub fn observed(mut self, observer: impl FnMut(&Record) + Send + 'static) -> Self {
        self.observer = Some(Box::new(observer));
        self
    }

    /// Writes an I/O log with all periods of the controller up to now, where all records are kept.
    /// Callers must pass each later period to [`Recorder::period`].
    pub fn start_io_log(&mut self, io_log: IoLog) {
        if self.keep == Keep::All {
            self.file.start_io_log(io_log);
        }
    }

    /// Records a period of the I/O log, if there is one.
    #[inline]
    pub fn period(&mut self, inputs: &Inputs, outputs: &Outputs) {
        self.file.period(inputs, outputs);
    }

    /// Appends a record. [`Recorder::finish`] returns an error of the disk.
    #[inline]
    pub fn record(&mut self, record: &Record) {
        if let Some(observer) = &mut self.observer {
            observer(record);
        }
        match self.keep {
            Keep::All => self.file.record(record),
            Keep::Every(periods) => {
                if self.next.is_some_and(|next| record.period < next) {
                    return;
                }
                self.next = Some(record.period + u64::from(periods));
                self.records += 1;
                self.file.record(record);
            }
            Keep::Last(periods) => {
                self.turn_over(record.period, periods);
                self.records += 1;
                self.file.record(record);
            }
        }
    }

    /// Begins a new file when the present one has the time that is kept.
    fn turn_over(&mut self, period: u64, periods: u64) {
        let Some(ring) = &mut self.ring else { return };
        ring.newest = period;
        let started = *ring.started.get_or_insert(period);
        if period < started + periods {
            return;
        }
        ring.started = Some(period);
        // A disk that fails here fails in the new file as well, which `finish` reports.
        let earlier = earlier_file(&ring.path);
        let moved = std::fs::rename(&ring.path, earlier);
        let fresh = FileRecorder::create_with(&ring.path, &ring.header, ring.free_space);
        if let (Ok(()), Ok(fresh)) = (moved, fresh) {
            // The file keeps its contents under its new name.
            let full = std::mem::replace(&mut self.file, fresh);
            ring.has_earlier = full.finish().is_ok();
        }
    }

    /// Whether the recording has ended before the job, because the disk is nearly full or failed.
    #[inline]
    #[must_use]
    pub fn is_broken(&self) -> bool {
        self.file.is_broken()
    }

    /// Records an event; `level` is 0 for information, 1 for a warning, 2 for an error.
    pub fn event(&mut self, period: u64, level: u8, text: &str) {
        if let Some(ring) = &mut self.ring
            && ring.events.len() < MAX_EVENTS
        {
            ring.events.push((period, level, text.to_string()));
        }
        self.file.event(period, level, text);
    }

    /// Sends the records so far to the writing thread, without waiting if its queue is full. They
    /// are on disk even if the process is killed later.
    pub fn spill(&mut self) {
        self.file.spill();
    }

    /// Returns the number of records so far.
    pub fn records(&self) -> u64 {
        match self.keep {
            Keep::All => self.file.records(),
            Keep::Every(_) | Keep::Last(_) => self.records,
        }
    }

    /// Writes the remaining blocks and waits for the writing thread.
    ///
    /// # Errors
    ///
    /// Returns an error of the disk; the file is truncated there.
    pub fn finish(self) -> io::Result<Recorded> {
        let recorded = self.file.finish()?;
        match (self.ring, self.keep) {
            (Some(ring), Keep::Last(periods)) if ring.has_earlier => {
                ring.join(periods, recorded.disk_full)
            }
            _ => Ok(recorded),
        }
    }
}

impl Ring {
    /// Writes the last control periods of both files into one.
    fn join(self, periods: u64, disk_full: bool) -> io::Result<Recorded> {
        let earlier = earlier_file(&self.path);
        let joined = self.path.with_extension("joined.hmr");
        let mut file = FileRecorder::create_with(&joined, &self.header, self.free_space)?;
        for (period, level, text) in &self.events {
            file.event(*period, *level, text);
        }
        let first = (self.newest + 1).saturating_sub(periods);
        for path in [&earlier, &self.path] {
            let recording = Recording::open(path).map_err(io::Error::other)?;
            for record in recording.iter().map_err(io::Error::other)? {
                let record = record.map_err(io::Error::other)?;
                if record.period >= first {
                    file.record(&record);
                }
            }
        }
        let recorded = file.finish()?;
        std::fs::rename(&joined, &self.path)?;
        std::fs::remove_file(&earlier)?;
        Ok(Recorded {
            disk_full: recorded.disk_full || disk_full,
            ..recorded
        })
    }
}
