//! Offset between the clock of a capture and the first control period.

use crate::expected::{Clock, Pulse};

/// Intervals that a place of the capture in the commanded pulses must match.
const PATTERN: usize = 8;
/// Number of places that are compared over all axes.
const PLACES: usize = 64;
/// Number of pulses of each axis that such a comparison uses.
const COMPARED: usize = 1000;

/// Rising edges of a line and the pulses commanded on it.
pub(crate) struct Track<'a> {
    pub(crate) rises: &'a [i64],
    pub(crate) pulses: &'a [Pulse],
}

/// The offset, in fs, at which most edges are where they were commanded; `None` without an edge or
/// without a commanded pulse. The capture may begin anywhere in the motion. Of several offsets with
/// as many matches the one with the earliest pulse is taken.
pub(crate) fn offset(tracks: &[Track<'_>], clock: Clock, tolerance: i64) -> Option<i64> {
    let mut places = Vec::new();
    for track in tracks {
        let Some(first) = track.rises.first() else {
            continue;
        };
        for (place, pulse) in track.pulses.iter().enumerate() {
            let origin = clock.femtoseconds(pulse.tick);
            let matching = track
                .rises
                .iter()
                .zip(&track.pulses[place..])
                .take(PATTERN)
                .take_while(|(rise, pulse)| {
                    let error = (*rise - first) - (clock.femtoseconds(pulse.tick) - origin);
                    error.abs() <= tolerance
                })
                .count();
            places.push((matching, pulse.tick, first - origin));
        }
    }
    places.sort_by_key(|(matching, tick, _)| (std::cmp::Reverse(*matching), *tick));
    places.truncate(PLACES);
    let matches = |offset: i64| -> usize {
        let of_track = |track: &Track<'_>| count(track, offset, clock, tolerance);
        tracks.iter().map(of_track).sum()
    };
    let mut best = None;
    for (_, _, offset) in places {
        let score = matches(offset);
        if best.is_none_or(|(max, _)| score > max) {
            best = Some((score, offset));
        }
    }
    best.map(|(_, offset)| offset)
}

/// Number of the first edges of a line that are at a commanded time.
fn count(track: &Track<'_>, offset: i64, clock: Clock, tolerance: i64) -> usize {
    let mut pulses = track
        .pulses
        .iter()
        .map(|pulse| clock.femtoseconds(pulse.tick) + offset)
        .peekable();
    let mut count = 0;
    for rise in track.rises.iter().take(COMPARED) {
        while pulses.next_if(|at| *at < rise - tolerance).is_some() {}
        if pulses.next_if(|at| *at <= rise + tolerance).is_some() {
            count += 1;
        }
    }
    count
}
