//! Reversals of a counter about one place, which a stuck channel of its encoder causes.

/// This many reversals about one place within [`REVERSAL_US`] microseconds come from a stuck
/// channel. A stuck channel gives one reversal per two counts of motion and is found from 1.2 mm/s
/// on. A loop with a limit cycle about an edge, or a slide with stick-slip, reverses 160 times per
/// second, which is a third of the limit.
const REVERSALS: u8 = 24;
const REVERSAL_US: u32 = 50_000;

/// Reversals of the motion about one place.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Reversals {
    place: i32,
    /// Sign of the last motion.
    sign: i32,
    count: u8,
    /// Time since the first of the reversals, microseconds.
    since_us: u32,
}

impl Reversals {
    /// The place about which reversals are counted.
    #[inline]
    pub const fn place(&self) -> i32 {
        self.place
    }

    /// Records the counts of one period. `is_away` says that the joint, now at `now`, is farther
    /// from the place than a stuck channel counts. Returns whether a channel is stuck.
    #[inline]
    pub fn update(&mut self, moved: i32, is_away: bool, now: i32, period_us: u16) -> bool {
        if moved != 0 {
            let sign = moved.signum();
            if is_away {
                *self = Self {
                    place: now,
                    sign,
                    ..Self::default()
                };
            } else if sign != self.sign {
                self.sign = sign;
                self.count += 1;
                if self.count >= REVERSALS {
                    self.count = 0;
                    return true;
                }
            }
        }
        if self.count != 0 {
            self.since_us = self.since_us.saturating_add(u32::from(period_us));
            if self.since_us > REVERSAL_US {
                self.count /= 2;
                self.since_us /= 2;
            }
        } else {
            self.since_us = 0;
        }
        false
    }
}
