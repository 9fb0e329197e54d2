//! Highest and lowest force of the last spindle revolution (docs/control.md 7.1 item 17).
//!
//! A milling force has a peak for every tooth. The admittance law uses the largest magnitude of one
//! whole revolution, with its sign. For a force that repeats every revolution this value is
//! constant, whatever the run-out of the teeth.
//!
//! **Rounding.** A revolution is 60 / (rpm * period) samples: 60 at 5000 rev/min and 200 us, but
//! 58.82 at 5100. The window is rounded *up*: it holds one whole revolution and less than one
//! sample more. Rounded down, it would miss the peak for one sample in every revolution, and the
//! law would see a dip. A revolution of more than [`LEAVES`] samples uses groups of 2, 3, ...
//! samples, each with its highest and lowest force. The window then holds one revolution and less
//! than one group more (1/63 of a revolution).
//!
//! **Cost.** A tournament tree over a ring: a new sample changes one leaf and its log2(window)
//! parents, at most 7 pairs of comparisons. A monotonic queue has the same mean cost, but its worst
//! sample takes the whole window.
//!
//! Callers must set the window from the commanded speed, not from every measured revolution. Each
//! change keeps the present peaks for one revolution, so a window that changes continually never
//! drops an old peak.

use haptimill_math::force::Force;

/// Largest number of groups in a window.
pub const LEAVES: usize = 128;

/// Largest number of samples in a group: the longest window is 2048 samples, 0.41 s at 200 us.
const GROUP_MAX: u32 = 16;

/// Highest and lowest force of an interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extremes {
    /// Highest.
    pub high: Force,
    /// Lowest.
    pub low: Force,
}

impl Default for Extremes {
    fn default() -> Self {
        Self::of(Force(0))
    }
}

impl Extremes {
    /// Neutral element: below any high, above any low.
    const NONE: Self = Self {
        high: Force(i32::MIN),
        low: Force(i32::MAX),
    };

    const fn of(force: Force) -> Self {
        Self {
            high: force,
            low: force,
        }
    }

    #[inline]
    const fn with(self, other: Self) -> Self {
        Self {
            high: if other.high.0 > self.high.0 {
                other.high
            } else {
                self.high
            },
            low: if other.low.0 < self.low.0 {
                other.low
            } else {
                self.low
            },
        }
    }

    /// Force of the largest magnitude, with its sign: the *high* force of the thesis. If both are
    /// equal, the positive one.
    #[must_use]
    pub const fn peak(&self) -> Force {
        if self.high.magnitude() >= self.low.magnitude() {
            self.high
        } else {
            self.low
        }
    }

    /// The opposite extreme: the *low* force of the thesis.
    #[must_use]
    pub const fn other(&self) -> Force {
        if self.high.magnitude() >= self.low.magnitude() {
            self.low
        } else {
            self.high
        }
    }
}

/// Length of a window, in groups of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// Number of groups in the ring, 1 to [`LEAVES`].
    leaves: u16,
    /// Number of samples in a group, 1 to 16.
    group: u16,
}

impl Window {
    /// Creates a window of `samples`, rounded up to whole groups; `None` for none or more than
    /// 2048.
    #[must_use]
    pub const fn of(samples: u32) -> Option<Self> {
        if samples == 0 || samples > GROUP_MAX * LEAVES as u32 {
            return None;
        }
        let mut group = samples.div_ceil(LEAVES as u32);
        // A new group replaces the oldest one at its first sample: the complete groups plus one
        // sample must cover a revolution.
        if (samples - 1).div_ceil(group) >= LEAVES as u32 {
            group += 1;
        }
        Some(Self {
            leaves: ((samples - 1).div_ceil(group) + 1) as u16,
            group: group as u16,
        })
    }

    /// Creates a window of one revolution, rounded up; the sign of the speed is its direction.
    /// `None` at standstill, and for a speed at which a revolution exceeds 2048 samples.
    #[must_use]
    pub const fn revolution(rpm: i16, period_us: u16) -> Option<Self> {
        // At most 32768 * 65535: fits 32 bits.
        let turned = rpm.unsigned_abs() as u32 * period_us as u32;
        if turned == 0 {
            return None;
        }
        Self::of(60_000_000u32.div_ceil(turned))
    }

    /// Largest number of samples covered, when the newest group is complete.
    #[must_use]
    pub const fn samples(self) -> u32 {
        self.leaves as u32 * self.group as u32
    }

    /// Smallest number of samples covered, when the newest group has one sample.
    #[must_use]
    pub const fn min_samples(self) -> u32 {
        (self.leaves as u32 - 1) * self.group as u32 + 1
    }
}

/// Sliding min/max filter of one axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SlidingMinMax {
    window: Window,
    /// Number of leaves of the tree: the smallest power of two that holds the window.
    size: usize,
    /// Node 1 is the root, node i has the children 2i and 2i+1, leaves begin at `size`. Nodes
    /// beyond the tree are not read.
    tree: [Extremes; 2 * LEAVES],
    /// Index of the leaf that is being filled.
    leaf: usize,
    /// Number of samples in that leaf.
    filled: u16,
}

impl SlidingMinMax {
    /// Creates a window with zero force.
    #[must_use]
    pub fn new(window: Window) -> Self {
        let mut new = Self {
            window,
            size: 1,
            tree: [Extremes::NONE; 2 * LEAVES],
            leaf: 0,
            filled: 0,
        };
        new.fill(Extremes::default());
        new
    }

    /// The present window.
    #[must_use]
    pub const fn window(&self) -> Window {
        self.window
    }

    /// Changes the window. The present extremes remain for the length of the new window. The same
    /// window changes nothing.
    pub fn set_window(&mut self, window: Window) {
        if window != self.window {
            let now = self.extremes();
            self.window = window;
            self.fill(now);
        }
    }

    /// Resets the window to zero force.
    pub fn clear(&mut self) {
        self.fill(Extremes::default());
    }

    #[cold]
    #[inline(never)]
    fn fill(&mut self, with: Extremes) {
        let leaves = usize::from(self.window.leaves);
        self.size = leaves.next_power_of_two();
        // Level by level from the root: nodes up to the one above the last leaf get the value, the
        // others are neutral.
        let (mut level, mut below) = (1, self.size);
        while level <= self.size {
            let used = leaves.div_ceil(below);
            let nodes = self.tree.get_mut(level..2 * level).unwrap_or_default();
            let (used, unused) = nodes.split_at_mut(used.min(level));
            used.fill(with);
            unused.fill(Extremes::NONE);
            level *= 2;
            below /= 2;
        }
        self.leaf = 0;
        self.filled = 0;
    }

    /// Adds the force of a sample; returns the extremes of the window that ends with it.
    #[inline]
    pub fn push(&mut self, force: Force) -> Extremes {
        let mut now = Extremes::of(force);
        let mut node = self.size + self.leaf;
        if self.filled > 0 {
            now = now.with(self.at(node));
        }
        self.filled += 1;
        if self.filled >= self.window.group {
            self.filled = 0;
            self.leaf += 1;
            if self.leaf >= usize::from(self.window.leaves) {
                self.leaf = 0;
            }
        }
        self.put(node, now);
        while node > 1 {
            now = now.with(self.at(node ^ 1));
            node >>= 1;
            if self.at(node) == now {
                // Nodes above depend on this node only through this value.
                return self.at(1);
            }
            self.put(node, now);
        }
        now
    }

    #[inline]
    fn at(&self, node: usize) -> Extremes {
        self.tree[node % (2 * LEAVES)]
    }

    /// Nodes are below 2 * LEAVES; the remainder is a mask that avoids the bounds check.
    #[inline]
    fn put(&mut self, node: usize, extremes: Extremes) {
        self.tree[node % (2 * LEAVES)] = extremes;
    }

    /// Extremes of the window.
    #[must_use]
    pub fn extremes(&self) -> Extremes {
        self.at(1)
    }
}
