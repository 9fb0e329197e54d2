//! Track: the programmed poses and lines of a job around its present motion.

use super::trajectory::{Cursor, Trajectory};
use haptimill_gcode::{Coordinates, Place};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Pieces that have ended and are kept, so that their removal costs little.
const ENDED_PIECES: usize = 1024;

/// Programmed poses and places of a job, as far as its setpoints are made.
///
/// A planner appends to it; [`Track::discard`] removes what the machine has passed, so that its
/// memory does not depend on the length of the program.
#[derive(Debug, Clone, Default)]
pub struct Track {
    trajectory: Trajectory,
    cursor: Cursor,
    /// The first setpoint of each series of setpoints with one place.
    places: VecDeque<(u32, Place)>,
    /// Messages of the program, by the setpoint towards which the machine moves when it shows them.
    pub(crate) messages: VecDeque<(u32, String)>,
    /// Number of setpoints.
    setpoints: u32,
    period_s: f64,
}

impl Track {
    /// Returns the programmed pose at a time, on the exact lines and arcs, mm and degrees. For
    /// calls in sequence.
    pub fn programmed(&mut self, time_s: f64) -> Coordinates {
        self.trajectory.programmed(&mut self.cursor, time_s)
    }

    /// Returns the place in the program of the motion towards a setpoint; the last one for a number
    /// beyond the end.
    pub fn place_of(&self, setpoint: u32) -> Place {
        let behind = self
            .places
            .partition_point(|(first, _)| *first <= setpoint)
            .saturating_sub(1);
        self.places
            .get(behind)
            .map_or_else(Place::default, |(_, place)| *place)
    }

    /// Returns the control period, seconds.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Removes what the motion towards a setpoint, at a time, has passed.
    pub fn discard(&mut self, setpoint: u32, time_s: f64) {
        while self
            .places
            .get(1)
            .is_some_and(|(first, _)| *first <= setpoint)
        {
            self.places.pop_front();
        }
        let pieces = &self.trajectory.pieces;
        if pieces
            .get(ENDED_PIECES)
            .is_some_and(|piece| piece.time <= time_s)
        {
            self.trajectory.discard(time_s);
            self.cursor = Cursor::default();
        }
    }

    /// Appends setpoints of a place.
    pub(crate) fn add_place(&mut self, place: Place) {
        if self.places.back().is_none_or(|(_, last)| *last != place) {
            self.places.push_back((self.setpoints, place));
        }
        self.setpoints = self.setpoints.saturating_add(1);
    }

    /// Appends a message of the program before the motion towards the last setpoint.
    pub(crate) fn add_message(&mut self, text: String) {
        let setpoint = self.setpoints.saturating_sub(1);
        self.messages.push_back((setpoint, text));
    }

    /// Removes the first message of the program that is due in the motion towards a setpoint:
    /// (MSG,), (PRINT,), (DEBUG,). A pause shows its comment itself.
    pub fn take_message(&mut self, setpoint: u32) -> Option<String> {
        let due = self.messages.pop_front_if(|(first, _)| *first <= setpoint);
        due.map(|(_, text)| text)
    }

    /// Creates the track of a whole trajectory, without places.
    pub(crate) fn of_whole(trajectory: Trajectory, period_s: f64) -> Self {
        Self {
            trajectory,
            period_s,
            ..Self::default()
        }
    }

    /// Appends the pieces of a trajectory from a number on.
    pub(crate) fn add_pieces(&mut self, from: &Trajectory, first: usize) {
        self.trajectory.append(from, first);
    }
}

/// A track that a planner, a recording and a display share.
#[derive(Debug, Clone, Default)]
pub struct SharedTrack(Arc<Mutex<Track>>);

impl SharedTrack {
    /// Creates an empty one, for [`Planner::follow`](super::Planner::follow); `period_us` is the
    /// control period.
    pub fn new(period_us: u32) -> Self {
        let track = Track::of_whole(Trajectory::default(), f64::from(period_us) * 1e-6);
        Self::of(track)
    }

    /// Shares a track.
    pub(crate) fn of(track: Track) -> Self {
        Self(Arc::new(Mutex::new(track)))
    }

    /// Locks it.
    pub fn lock(&self) -> MutexGuard<'_, Track> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
