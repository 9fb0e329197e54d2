//! Where the teeth went before: the way of the ball's centre, by spindle angle.
//!
//! A tooth that stands at some angle now was preceded there by the next tooth one pitch of spindle rotation ago. What that one left is told by
//! the place of the ball's centre then. So the way is kept at equal steps of spindle angle, however fast the spindle turns, and the
//! places one, two, ... pitches ago lie whole steps apart.
//!
//! What is older than [`PASSES`] pitches leaves the memory and is handed on, to be taken from the workpiece's map.

/// Steps of the memory in one pitch.
const STEPS: usize = 32;

/// How many earlier passes of a tooth are remembered. Vibration as slow as this many tooth periods is cut into the surface as it is.
pub const PASSES: usize = 4;

const ENTRIES: usize = STEPS * PASSES + 1;

/// A remembered place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passed {
    /// Centre of the ball, mm.
    pub centre: [f64; 3],
    /// The spindle stood still while the tool came here: there is no way from the place before.
    pub apart: bool,
}

/// The memory.
#[derive(Debug, Clone)]
pub struct ToothPath {
    ring: [Passed; ENTRIES],
    /// Place of the latest entry.
    latest: usize,
    /// Spindle angle since the latest entry, steps: 0 to 1.
    phase: f64,
    /// The tool moved while the spindle stood still.
    apart: bool,
}

impl ToothPath {
    /// The ball stands here and has always stood here.
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

    /// The spindle turns by `pitches` (tooth pitches, forward) while the centre goes straight from one place to another; what leaves the memory is
    /// handed to `leaves`, oldest first.
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

    /// Where the centre was so many pitches ago, 1 to [`PASSES`].
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

    /// All that is remembered, oldest first.
    pub fn remembered(&self) -> impl Iterator<Item = Passed> {
        (1..=ENTRIES).map(|step| self.ring[(self.latest + step) % ENTRIES])
    }
}
