//! Path of the ball's centre over the last teeth, indexed by spindle angle.
//!
//! The next tooth was at the present angle of a tooth one pitch of spindle rotation ago. The
//! position of the ball's centre at that time determines the surface that it left. The path is
//! therefore sampled at equal steps of spindle angle, independent of the spindle speed, and the
//! positions one, two, ... pitches ago lie whole steps apart.
//!
//! Positions older than [`PASSES`] pitches leave the memory and are passed on for removal from the
//! workpiece's map.

/// Samples per pitch.
const STEPS: usize = 32;

/// Number of earlier passes of a tooth that are remembered. Vibration as slow as this many tooth
/// periods is cut into the surface directly.
pub const PASSES: usize = 4;

const ENTRIES: usize = STEPS * PASSES + 1;

/// A remembered position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed {
    /// Centre of the ball, mm.
    pub centre: [f64; 3],
    /// The spindle stood still while the tool moved here: no path connects it with the position
    /// before.
    pub apart: bool,
}

/// Memory of the tooth path.
#[derive(Debug, Clone)]
pub struct ToothPath {
    ring: [Passed; ENTRIES],
    /// Index of the latest entry.
    latest: usize,
    /// Spindle angle since the latest entry, steps: 0 to 1.
    phase: f64,
    /// The tool moved while the spindle stood still.
    apart: bool,
}

impl ToothPath {
    /// Starts with a ball that has always been at `centre`.
    pub const fn new(centre: [f64; 3]) -> Self {
        Self {
            ring: [Passed {
                centre,
                apart: false,
            }; ENTRIES],
            latest: 0,
            phase: 0.0,
            apart: false,
        }
    }

    /// Advances the spindle by `pitches` (tooth pitches, forward) while the centre moves on a
    /// straight line between two positions. Calls `leaves` with the positions that leave the
    /// memory, oldest first.
    pub fn advance(
        &mut self,
        pitches: f64,
        from: [f64; 3],
        to: [f64; 3],
        mut leaves: impl FnMut(Passed),
    ) {
        let steps = pitches * STEPS as f64;
        if steps < 1e-9 {
            self.apart |= from != to;
            return;
        }
        let end = self.phase + steps;
        let mut next = 1.0;
        while next <= end {
            let part = (next - self.phase) / steps;
            let mut centre = [0.0; 3];
            for i in 0..3 {
                centre[i] = from[i] + part * (to[i] - from[i]);
            }
            self.latest = (self.latest + 1) % ENTRIES;
            leaves(self.ring[self.latest]);
            self.ring[self.latest] = Passed {
                centre,
                apart: core::mem::take(&mut self.apart),
            };
            next += 1.0;
        }
        self.phase = end - (next - 1.0);
    }

    /// Position of the centre the given number of pitches ago, 1 to [`PASSES`].
    #[inline]
    pub fn ago(&self, pitches: usize) -> [f64; 3] {
        let back = pitches * STEPS;
        let at = |back: usize| &self.ring[(self.latest + ENTRIES - back) % ENTRIES];
        let (older, newer) = (at(back), at(back - 1));
        if newer.apart {
            return older.centre;
        }
        let mut centre = [0.0; 3];
        for (i, value) in centre.iter_mut().enumerate() {
            *value = older.centre[i] + self.phase * (newer.centre[i] - older.centre[i]);
        }
        centre
    }

    /// All remembered positions, oldest first.
    pub fn remembered(&self) -> impl Iterator<Item = Passed> {
        (1..=ENTRIES).map(|step| self.ring[(self.latest + step) % ENTRIES])
    }
}
