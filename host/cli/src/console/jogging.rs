//! Jogging with keys: which keys are held, for how long they count, and what the machine is asked for.
//!
//! A terminal tells that a key was pressed, and presses it again and again while it is held; most never tell that it was let go. So every press counts
//! for the *dead-man time* and no longer: when presses cease, for whatever reason, the motion ends. What is sent to the controller carries the rest of that
//! time as its deadline, so it ends there too if this process or the line dies.
//!
//! Some terminals tell of releases (the kitty keyboard protocol). A key whose release was seen once is stopped by its release, at once; its first press
//! may then count for [`FIRST_PRESS_US`], the time until repeats begin, because the release will be told. Repeats must come all the same:
//! a link that stalls takes releases with it.
//!
//! Times are microseconds of any clock that does not run backwards. Rates are mm/s and deg/s.
//!
//! Misuse: a stop must call [`Jogging::release_all`]; afterwards only a new press moves anything, never the repeat of an old one.

use haptimill_protocol::message::MAX_AXES;

/// The dead-man time when none is given, milliseconds.
pub const DEAD_MAN_MS: u16 = 200;

/// How long the first press of a key counts whose release will be told: keyboards begin to repeat within 660 ms.
pub const FIRST_PRESS_US: u64 = 700_000;

/// After a stop, presses count for nothing for so long: a key that is still held is not a new wish.
pub const PAUSE_US: u64 = 300_000;

/// Rates to choose from, mm/s and deg/s; an axis goes no faster than it may.
pub const RATES: [f64; 8] = [0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0];

/// Steps to choose from, mm and deg.
pub const STEPS: [f64; 5] = [0.001, 0.01, 0.1, 1.0, 10.0];

/// Time between two commands, as a part of the dead-man time: two may be lost before the machine stops.
const REPEAT: u64 = 3;

/// What a key does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Moves while the key is held.
    Continuous,
    /// One step for each press.
    Step,
}

/// What the terminal told of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Press {
    /// It was pressed. Terminals that do not tell of releases say the same of repeats.
    Down,
    /// It is still held.
    Again,
    /// It was let go.
    Up,
}

/// What the controller is to be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Nothing new.
    None,
    /// Move at these rates for at most so many milliseconds.
    Go {
        /// mm/s or deg/s of each pose coordinate.
        rates: [f64; MAX_AXES],
        /// Dead-man of the controller, ms.
        deadline_ms: u16,
    },
    /// Brake now.
    Cancel,
}

#[derive(Debug, Clone, Copy)]
struct Held {
    up: bool,
    until_us: u64,
}

/// The jog keys and what is chosen for them.
#[derive(Debug, Clone)]
pub struct Jogging {
    mode: Mode,
    rate: usize,
    step: usize,
    dead_man_us: u64,
    /// Largest rate of each pose coordinate.
    limits: [f64; MAX_AXES],
    held: [Option<Held>; MAX_AXES],
    /// Keys of which a release was told once, downwards and upwards.
    told: [[bool; 2]; MAX_AXES],
    ignore_until_us: u64,
    /// What was ordered last, and when the next order is due.
    ordered: Option<[f64; MAX_AXES]>,
    due_us: u64,
    /// The presses that are under way began with a key that ends by its release.
    cancel: bool,
}

impl Jogging {
    /// Nothing is held. `limits` are the largest rates of the pose coordinates.
    #[must_use]
    pub fn new(limits: &[f64], dead_man_ms: u16) -> Self {
        let mut all = [0.0; MAX_AXES];
        for (slot, limit) in all.iter_mut().zip(limits) {
            *slot = *limit;
        }
        Self {
            mode: Mode::Continuous,
            rate: 4,
            step: 2,
            dead_man_us: u64::from(dead_man_ms) * 1000,
            limits: all,
            held: [None; MAX_AXES],
            told: [[false; 2]; MAX_AXES],
            ignore_until_us: 0,
            ordered: None,
            due_us: 0,
            cancel: false,
        }
    }

    /// Continuous or steps.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// The chosen rate, mm/s and deg/s.
    #[must_use]
    pub fn rate(&self) -> f64 {
        RATES[self.rate]
    }

    /// The chosen rate of an axis: no more than it may.
    #[must_use]
    pub fn rate_of(&self, axis: usize) -> f64 {
        let limit = self.limits.get(axis).copied().unwrap_or(0.0);
        self.rate().min(limit)
    }

    /// The chosen step, mm and deg.
    #[must_use]
    pub fn step(&self) -> f64 {
        STEPS[self.step]
    }

    /// The dead-man time, ms.
    #[must_use]
    pub const fn dead_man_ms(&self) -> u64 {
        self.dead_man_us / 1000
    }

    /// Some terminal told of the release of some key.
    #[must_use]
    pub fn releases_told(&self) -> bool {
        self.told.as_flattened().contains(&true)
    }

    /// The other mode. Nothing moves on.
    pub fn toggle_mode(&mut self) {
        self.mode = match self.mode {
            Mode::Continuous => Mode::Step,
            Mode::Step => Mode::Continuous,
        };
        self.held = [None; MAX_AXES];
    }

    /// The next larger rate or step, or the next smaller one.
    pub fn choose(&mut self, more: bool) {
        let (index, last) = match self.mode {
            Mode::Continuous => (&mut self.rate, RATES.len() - 1),
            Mode::Step => (&mut self.step, STEPS.len() - 1),
        };
        *index = if more {
            (*index + 1).min(last)
        } else {
            index.saturating_sub(1)
        };
    }

    /// Directions that are held, and for how many milliseconds they count still.
    #[must_use]
    pub fn held(&self, now_us: u64) -> [Option<(bool, u64)>; MAX_AXES] {
        self.held.map(|held| {
            let held = held.filter(|held| held.until_us > now_us)?;
            Some((held.up, (held.until_us - now_us).div_ceil(1000)))
        })
    }

    /// All keys count as let go, and for a moment presses count for nothing.
    pub fn release_all(&mut self, now_us: u64) {
        if self.held.iter().any(Option::is_some) {
            self.cancel = true;
        }
        self.held = [None; MAX_AXES];
        self.ignore_until_us = now_us + PAUSE_US;
    }

    /// A jog key in continuous mode. True when it moves something that stood.
    pub fn key(&mut self, axis: usize, up: bool, press: Press, now_us: u64) -> bool {
        let Some(slot) = self.held.get(axis).copied() else {
            return false;
        };
        let alive = slot.is_some_and(|held| held.up == up && held.until_us > now_us);
        match press {
            Press::Up => {
                self.told[axis][usize::from(up)] = true;
                if alive {
                    self.held[axis] = None;
                    self.cancel = true;
                }
                false
            }
            _ if now_us < self.ignore_until_us => false,
            Press::Again => {
                // Of a key that no longer counts a repeat is no new wish.
                if alive {
                    // Only the last key that was pressed repeats; the release of the others would be told.
                    for held in self.held.iter_mut().flatten() {
                        if held.until_us > now_us {
                            held.until_us = held.until_us.max(now_us + self.dead_man_us);
                        }
                    }
                }
                false
            }
            Press::Down => {
                let told = self.told[axis][usize::from(up)];
                if !told {
                    // Without releases, a press of another key is all that tells that the one before was let go.
                    for (index, held) in self.held.iter_mut().enumerate() {
                        if index != axis && held.take().is_some() {
                            self.cancel = true;
                        }
                    }
                }
                let counts = if told && !alive {
                    FIRST_PRESS_US.max(self.dead_man_us)
                } else {
                    self.dead_man_us
                };
                self.held[axis] = Some(Held {
                    up,
                    until_us: now_us + counts,
                });
                !alive
            }
        }
    }

    /// What the controller is to be told now; to be asked often.
    pub fn order(&mut self, now_us: u64) -> Order {
        let mut rates = [0.0; MAX_AXES];
        let mut left_us = 0;
        for (axis, slot) in self.held.iter_mut().enumerate() {
            match slot {
                Some(held) if held.until_us > now_us => {
                    let rate = RATES[self.rate].min(self.limits[axis]);
                    rates[axis] = if held.up { rate } else { -rate };
                    left_us = held.until_us.max(left_us + now_us) - now_us;
                }
                _ => *slot = None,
            }
        }
        if left_us == 0 {
            let moved = self.ordered.take().is_some();
            // A deadline that has come needs no word; a release does.
            let cancel = std::mem::take(&mut self.cancel) && moved;
            return if cancel { Order::Cancel } else { Order::None };
        }
        if self.ordered == Some(rates) && now_us < self.due_us {
            return Order::None;
        }
        self.cancel = false;
        self.ordered = Some(rates);
        self.due_us = now_us + self.dead_man_us / REPEAT;
        let deadline_ms = left_us.min(self.dead_man_us).div_ceil(1000).max(1);
        Order::Go {
            rates,
            deadline_ms: deadline_ms as u16,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1000;

    fn jogging() -> Jogging {
        Jogging::new(&[50.0, 50.0, 50.0, 30.0, 30.0], DEAD_MAN_MS)
    }

    fn goes(jogging: &mut Jogging, now_us: u64) -> bool {
        jogging.order(now_us);
        jogging.ordered.is_some()
    }

    #[test]
    fn a_press_counts_for_the_dead_man_time() {
        let mut jogging = jogging();
        assert!(jogging.key(0, true, Press::Down, 0));
        let Order::Go { rates, deadline_ms } = jogging.order(0) else {
            panic!()
        };
        assert_eq!((rates[0], rates[1], deadline_ms), (5.0, 0.0, 200));
        // The same again, with what is left, before anything can run out.
        assert_eq!(jogging.order(60 * MS), Order::None);
        let Order::Go { deadline_ms, .. } = jogging.order(70 * MS) else {
            panic!()
        };
        assert_eq!(deadline_ms, 130);
        assert!(goes(&mut jogging, 199 * MS));
        assert!(!goes(&mut jogging, 200 * MS));
        // Repeats keep it alive, however often they come.
        for now in (300..2000).step_by(33) {
            jogging.key(0, true, Press::Down, now * MS);
            assert!(goes(&mut jogging, now * MS));
        }
    }

    #[test]
    fn a_release_cancels_and_the_repeat_of_a_dead_key_does_nothing() {
        let mut jogging = jogging();
        jogging.key(2, false, Press::Down, 0);
        jogging.order(0);
        jogging.key(2, false, Press::Up, 50 * MS);
        assert_eq!(jogging.order(50 * MS), Order::Cancel);
        assert_eq!(jogging.order(51 * MS), Order::None);
        jogging.key(2, false, Press::Again, 60 * MS);
        assert_eq!(jogging.order(60 * MS), Order::None);
        // From now on its first press counts until repeats begin.
        jogging.key(2, false, Press::Down, 100 * MS);
        assert!(goes(&mut jogging, 799 * MS));
        assert!(!goes(&mut jogging, 800 * MS));
    }

    #[test]
    fn a_stop_needs_a_new_press() {
        let mut jogging = jogging();
        jogging.key(1, true, Press::Down, 0);
        jogging.order(0);
        jogging.release_all(10 * MS);
        assert_eq!(jogging.order(10 * MS), Order::Cancel);
        jogging.key(1, true, Press::Down, 100 * MS);
        assert_eq!(jogging.order(100 * MS), Order::None);
        jogging.key(1, true, Press::Again, 400 * MS);
        assert_eq!(jogging.order(400 * MS), Order::None);
        jogging.key(1, true, Press::Down, 401 * MS);
        assert!(goes(&mut jogging, 401 * MS));
    }

    #[test]
    fn axes_have_their_own_limits_and_two_keys_go_together_where_releases_are_told() {
        let mut jogging = jogging();
        for _ in 0..9 {
            jogging.choose(true);
        }
        jogging.key(3, true, Press::Up, 0);
        jogging.key(0, false, Press::Up, 0);
        jogging.key(3, true, Press::Down, 0);
        jogging.key(0, false, Press::Down, 0);
        let Order::Go { rates, .. } = jogging.order(0) else {
            panic!()
        };
        assert_eq!((rates[0], rates[3]), (-50.0, 30.0));
        // Where they are not, the second key takes over.
        jogging.key(1, true, Press::Down, 10 * MS);
        let Order::Go { rates, .. } = jogging.order(10 * MS) else {
            panic!()
        };
        assert_eq!(rates, [0.0, 50.0, 0.0, 0.0, 0.0, 0.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(7), failure_persistence: None, ..ProptestConfig::default() })]

        /// Whatever the keys do: what the controller was told ends within the dead-man time of the last press, or of the first one where releases
        /// are told; and nothing is told to move while no key counts.
        #[test]
        fn motion_ends_when_keys_cease(events in prop::collection::vec((0_u64..400, 0_usize..5, any::<bool>(), 0_u8..4), 1..60)) {
            let mut jogging = jogging();
            let (mut now, mut ends, mut last) = (0, 0, 0);
            for (wait, axis, up, kind) in events {
                for _ in 0..wait {
                    now += MS;
                    if let Order::Go { deadline_ms, .. } = jogging.order(now) {
                        ends = now + u64::from(deadline_ms) * MS;
                        prop_assert!(u64::from(deadline_ms) <= jogging.dead_man_ms());
                        prop_assert!(ends <= last + FIRST_PRESS_US + MS);
                    }
                }
                match kind {
                    0 => { jogging.key(axis, up, Press::Down, now); last = now }
                    1 => { jogging.key(axis, up, Press::Again, now); last = now }
                    2 => { jogging.key(axis, up, Press::Up, now); }
                    _ => {
                        jogging.release_all(now);
                        let goes = matches!(jogging.order(now), Order::Go { .. });
                        prop_assert!(!goes);
                    }
                }
                if !jogging.releases_told() {
                    prop_assert!(ends <= last + DEAD_MAN_MS as u64 * MS + MS);
                }
            }
        }
    }
}
