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
pub const LOCKOUT_US: u64 = 300_000;

/// Rates to choose from, mm/s and deg/s; an axis goes no faster than it may.
pub const RATES: [f64; 8] = [0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0];

/// Steps to choose from, mm and deg.
pub const STEPS: [f64; 5] = [0.001, 0.01, 0.1, 1.0, 10.0];

/// Time between two commands, as a part of the dead-man time: two may be lost before the machine stops.
const COMMANDS_PER_DEAD_MAN: u64 = 3;

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
pub enum KeyPhase {
    /// It was pressed. Terminals that do not tell of releases say the same of repeats.
    Press,
    /// It is still held.
    Repeat,
    /// It was let go.
    Release,
}

/// What the controller is to be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JogCommand {
    /// Nothing new.
    None,
    /// Move at these rates for at most so many milliseconds.
    Move {
        /// mm/s or deg/s of each pose coordinate.
        rates: [f64; MAX_AXES],
        /// Dead-man of the controller, ms.
        deadline_ms: u16,
    },
    /// Brake now.
    Cancel,
}

#[derive(Debug, Clone, Copy)]
struct HeldKey {
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
    held: [Option<HeldKey>; MAX_AXES],
    /// Keys of which a release was told once, downwards and upwards.
    reports_release: [[bool; 2]; MAX_AXES],
    ignore_until_us: u64,
    /// What was ordered last, and when the next order is due.
    commanded: Option<[f64; MAX_AXES]>,
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
            reports_release: [[false; 2]; MAX_AXES],
            ignore_until_us: 0,
            commanded: None,
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
    pub fn has_release_events(&self) -> bool {
        self.reports_release.as_flattened().contains(&true)
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
    pub fn select(&mut self, more: bool) {
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
        self.ignore_until_us = now_us + LOCKOUT_US;
    }

    /// A jog key in continuous mode. True when it moves something that stood.
    pub fn key(&mut self, axis: usize, up: bool, phase: KeyPhase, now_us: u64) -> bool {
        let Some(slot) = self.held.get(axis).copied() else {
            return false;
        };
        let active = slot.is_some_and(|held| held.up == up && held.until_us > now_us);
        match phase {
            KeyPhase::Release => {
                self.reports_release[axis][usize::from(up)] = true;
                if active {
                    self.held[axis] = None;
                    self.cancel = true;
                }
                false
            }
            _ if now_us < self.ignore_until_us => false,
            KeyPhase::Repeat => {
                // Of a key that no longer counts a repeat is no new wish.
                if active {
                    // Only the last key that was pressed repeats; the release of the others would be told.
                    for held in self.held.iter_mut().flatten() {
                        if held.until_us > now_us {
                            held.until_us = held.until_us.max(now_us + self.dead_man_us);
                        }
                    }
                }
                false
            }
            KeyPhase::Press => {
                let reports_release = self.reports_release[axis][usize::from(up)];
                if !reports_release {
                    // Without releases, a press of another key is all that tells that the one before was let go.
                    for (index, held) in self.held.iter_mut().enumerate() {
                        if index != axis && held.take().is_some() {
                            self.cancel = true;
                        }
                    }
                }
                let counts = if reports_release && !active {
                    FIRST_PRESS_US.max(self.dead_man_us)
                } else {
                    self.dead_man_us
                };
                self.held[axis] = Some(HeldKey {
                    up,
                    until_us: now_us + counts,
                });
                !active
            }
        }
    }

    /// What the controller is to be told now; to be asked often.
    pub fn command(&mut self, now_us: u64) -> JogCommand {
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
            let moved = self.commanded.take().is_some();
            // A deadline that has come needs no word; a release does.
            let cancel = std::mem::take(&mut self.cancel) && moved;
            return if cancel {
                JogCommand::Cancel
            } else {
                JogCommand::None
            };
        }
        if self.commanded == Some(rates) && now_us < self.due_us {
            return JogCommand::None;
        }
        self.cancel = false;
        self.commanded = Some(rates);
        self.due_us = now_us + self.dead_man_us / COMMANDS_PER_DEAD_MAN;
        let deadline_ms = left_us.min(self.dead_man_us).div_ceil(1000).max(1);
        JogCommand::Move {
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

    fn is_commanding(jogging: &mut Jogging, now_us: u64) -> bool {
        jogging.command(now_us);
        jogging.commanded.is_some()
    }

    #[test]
    fn a_press_counts_for_the_dead_man_time() {
        let mut jogging = jogging();
        assert!(jogging.key(0, true, KeyPhase::Press, 0));
        let JogCommand::Move { rates, deadline_ms } = jogging.command(0) else {
            panic!()
        };
        assert_eq!((rates[0], rates[1], deadline_ms), (5.0, 0.0, 200));
        // The same again, with what is left, before anything can run out.
        assert_eq!(jogging.command(60 * MS), JogCommand::None);
        let JogCommand::Move { deadline_ms, .. } = jogging.command(70 * MS) else {
            panic!()
        };
        assert_eq!(deadline_ms, 130);
        assert!(is_commanding(&mut jogging, 199 * MS));
        assert!(!is_commanding(&mut jogging, 200 * MS));
        // Repeats keep it alive, however often they come.
        for now in (300..2000).step_by(33) {
            jogging.key(0, true, KeyPhase::Press, now * MS);
            assert!(is_commanding(&mut jogging, now * MS));
        }
    }

    #[test]
    fn a_release_cancels_and_the_repeat_of_a_dead_key_does_nothing() {
        let mut jogging = jogging();
        jogging.key(2, false, KeyPhase::Press, 0);
        jogging.command(0);
        jogging.key(2, false, KeyPhase::Release, 50 * MS);
        assert_eq!(jogging.command(50 * MS), JogCommand::Cancel);
        assert_eq!(jogging.command(51 * MS), JogCommand::None);
        jogging.key(2, false, KeyPhase::Repeat, 60 * MS);
        assert_eq!(jogging.command(60 * MS), JogCommand::None);
        // From now on its first press counts until repeats begin.
        jogging.key(2, false, KeyPhase::Press, 100 * MS);
        assert!(is_commanding(&mut jogging, 799 * MS));
        assert!(!is_commanding(&mut jogging, 800 * MS));
    }

    #[test]
    fn a_stop_needs_a_new_press() {
        let mut jogging = jogging();
        jogging.key(1, true, KeyPhase::Press, 0);
        jogging.command(0);
        jogging.release_all(10 * MS);
        assert_eq!(jogging.command(10 * MS), JogCommand::Cancel);
        jogging.key(1, true, KeyPhase::Press, 100 * MS);
        assert_eq!(jogging.command(100 * MS), JogCommand::None);
        jogging.key(1, true, KeyPhase::Repeat, 400 * MS);
        assert_eq!(jogging.command(400 * MS), JogCommand::None);
        jogging.key(1, true, KeyPhase::Press, 401 * MS);
        assert!(is_commanding(&mut jogging, 401 * MS));
    }

    #[test]
    fn axes_have_their_own_limits_and_two_keys_go_together_where_releases_are_told() {
        let mut jogging = jogging();
        for _ in 0..9 {
            jogging.select(true);
        }
        jogging.key(3, true, KeyPhase::Release, 0);
        jogging.key(0, false, KeyPhase::Release, 0);
        jogging.key(3, true, KeyPhase::Press, 0);
        jogging.key(0, false, KeyPhase::Press, 0);
        let JogCommand::Move { rates, .. } = jogging.command(0) else {
            panic!()
        };
        assert_eq!((rates[0], rates[3]), (-50.0, 30.0));
        // Where they are not, the second key takes over.
        jogging.key(1, true, KeyPhase::Press, 10 * MS);
        let JogCommand::Move { rates, .. } = jogging.command(10 * MS) else {
            panic!()
        };
        assert_eq!(rates, [0.0, 50.0, 0.0, 0.0, 0.0, 0.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::StaticInfo(7), failure_persistence: None, ..ProptestConfig::default() })]

        /// Whatever the keys do: what the controller was told ends within the dead-man time of the last press, or of the first one where releases
        /// are told; and nothing is told to move while no key counts.
        #[test]
        fn motion_ends_when_keys_cease(events in prop::collection::vec((0_u64..400, 0_usize..5, any::<bool>(), 0_u8..4), 1..60)) {
            let mut jogging = jogging();
            let (mut now, mut ends, mut last) = (0, 0, 0);
            for (wait, axis, up, kind) in events {
                for _ in 0..wait {
                    now += MS;
                    if let JogCommand::Move { deadline_ms, .. } = jogging.command(now) {
                        ends = now + u64::from(deadline_ms) * MS;
                        prop_assert!(u64::from(deadline_ms) <= jogging.dead_man_ms());
                        prop_assert!(ends <= last + FIRST_PRESS_US + MS);
                    }
                }
                match kind {
                    0 => { jogging.key(axis, up, KeyPhase::Press, now); last = now }
                    1 => { jogging.key(axis, up, KeyPhase::Repeat, now); last = now }
                    2 => { jogging.key(axis, up, KeyPhase::Release, now); }
                    _ => {
                        jogging.release_all(now);
                        let is_commanding = matches!(jogging.command(now), JogCommand::Move { .. });
                        prop_assert!(!is_commanding);
                    }
                }
                if !jogging.has_release_events() {
                    prop_assert!(ends <= last + DEAD_MAN_MS as u64 * MS + MS);
                }
            }
        }
    }
}
