//! Override mode of a move: the override that applies to it.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Which override applies to a part of a path, and up to which speed factor. A job begins with
/// [`OverrideMode::FEED`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OverrideMode(pub u8);

impl OverrideMode {
    /// A move at feed, up to the programmed speed.
    pub const FEED: Self = Self(0);
    /// A rapid move.
    pub const RAPID: Self = Self(101);
    /// The smaller of feed and rapid override: rapid moves and moves at feed meet.
    pub const FEED_AND_RAPID: Self = Self(102);
    /// The programmed speed: overrides have no effect.
    pub const FIXED: Self = Self(103);
    /// Largest factor of a move at feed, percent.
    pub const MAX_PERCENT: u8 = 200;

    /// A move at feed, up to a factor in percent, 100 to [`OverrideMode::MAX_PERCENT`].
    #[must_use]
    pub const fn feed_up_to(percent: u8) -> Self {
        let percent = if percent > Self::MAX_PERCENT {
            Self::MAX_PERCENT
        } else {
            percent
        };
        Self(percent.saturating_sub(100))
    }

    /// Whether the code is known.
    #[must_use]
    pub const fn is_valid(self) -> bool {
        self.0 <= Self::FIXED.0
    }

    /// Largest factor, percent.
    #[must_use]
    pub const fn max_percent(self) -> u8 {
        if self.0 <= 100 { 100 + self.0 } else { 100 }
    }

    /// The factor at a feed override and a rapid override, percent.
    #[must_use]
    pub fn factor(self, feed: u8, rapid: u8) -> u8 {
        match self {
            Self::RAPID => rapid,
            Self::FEED_AND_RAPID => feed.min(rapid).min(100),
            Self::FIXED => 100,
            _ => feed.min(self.max_percent()),
        }
    }
}
