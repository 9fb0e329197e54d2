//! Jog keys: which keys are held, how long each press counts, and the resulting jog command.
//!
//! A terminal reports that a key is pressed and repeats the report while it is held; most terminals
//! never report the release. Every press therefore counts for the *jog timeout* and no longer:
//! when presses cease, for whatever reason, the motion ends. The command to the controller carries
//! the remaining time as its timeout, so the motion also ends there if this process or the line
//! fails.
//!
//! Some terminals report releases (the kitty keyboard protocol). A key whose release was seen once
//! stops at its release; its first press then counts for [`FIRST_PRESS_US`], the time until repeats
//! begin, because the release will be reported. Repeats are still required: a stalled link delays
//! releases too.
//!
//! Times are microseconds of any monotonic clock. Rates are mm/s and deg/s.
//!
//! Callers must call [`Jogging::release_all`] on a stop; afterwards only a new press starts motion,
//! never the repeat of an old one.

use haptimill_protocol::message::MAX_AXES;

/// Default jog timeout, milliseconds.
pub const JOG_TIMEOUT_MS: u16 = 200;

/// Time for which the first press of a key with release reports counts: keyboards begin to repeat
/// within 660 ms.
pub const FIRST_PRESS_US: u64 = 700_000;

/// Time after a stop in which presses are ignored: a key that is still held is no new request.
pub const LOCKOUT_US: u64 = 300_000;

/// Selectable rates, mm/s and deg/s; the rate limit of each axis applies.
pub const RATES: [f64; 8] = [0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0];

/// Selectable steps, mm and deg.
pub const STEPS: [f64; 5] = [0.001, 0.01, 0.1, 1.0, 10.0];

/// Commands per jog timeout: two may be lost before the machine stops.
const COMMANDS_PER_TIMEOUT: u64 = 3;

/// Effect of a jog key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Moves while the key is held.
    Continuous,
    /// One step per key press.
    Step,
}

/// Report of the terminal about a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyPhase {
    /// Pressed. Terminals without release reports send repeats like this, too.
    Press,
    /// Still held.
    Repeat,
    /// Released.
    Release,
}

/// Command to send to the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JogCommand {
    /// No command.
    None,
    /// Jog at these rates.
    Move {
        /// Rate of each pose coordinate, mm/s or deg/s.
        rates: [f64; MAX_AXES],
        /// Timeout of the jog at the controller, ms.
        timeout_ms: u16,
    },
    /// End the jog now.
    Cancel,
}

#[derive(Debug, Clone, Copy)]
struct HeldKey {
    up: bool,
    until_us: u64,
}

/// State and settings of the jog keys.
#[derive(Debug, Clone)]
pub struct Jogging {
    mode: Mode,
    rate: usize,
    step: usize,
    jog_timeout_us: u64,
    /// Maximum rate of each pose coordinate, mm/s or deg/s.
    limits: [f64; MAX_AXES],
    held: [Option<HeldKey>; MAX_AXES],
    /// Keys with a reported release, negative and positive direction.
    reports_release: [[bool; 2]; MAX_AXES],
    ignore_until_us: u64,
    /// Rates of the last command, and when the next one is due.
    commanded: Option<[f64; MAX_AXES]>,
    due_us: u64,
    /// A held key was released: the jog must be cancelled.
    cancel: bool,
}

impl Jogging {
    /// No key is held. `limits` are the maximum rates of the pose coordinates.
    #[must_use]
    pub fn new(limits: &[f64], jog_timeout_ms: u16) -> Self {
        let mut all = [0.0; MAX_AXES];
        for (slot, limit) in all.iter_mut().zip(limits) {
            *slot = *limit;
        }
        Self {
            mode: Mode::Continuous,
            rate: 4,
            step: 2,
            jog_timeout_us: u64::from(jog_timeout_ms) * 1000,
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

    /// Selected rate, mm/s and deg/s.
    #[must_use]
    pub fn rate(&self) -> f64 {
        RATES[self.rate]
    }

    /// Selected rate of an axis, within its limit.
    #[must_use]
    pub fn rate_of(&self, axis: usize) -> f64 {
        let limit = self.limits.get(axis).copied().unwrap_or(0.0);
        self.rate().min(limit)
    }

    /// Selected step, mm and deg.
    #[must_use]
    pub fn step(&self) -> f64 {
        STEPS[self.step]
    }

    /// Jog timeout, ms.
    #[must_use]
    pub const fn jog_timeout_ms(&self) -> u64 {
        self.jog_timeout_us / 1000
    }

    /// A release of some key was reported.
    #[must_use]
    pub fn has_release_events(&self) -> bool {
        self.reports_release.as_flattened().contains(&true)
    }

    /// Switches the mode and releases all keys.
    pub fn toggle_mode(&mut self) {
        self.mode = match self.mode {
            Mode::Continuous => Mode::Step,
            Mode::Step => Mode::Continuous,
        };
        self.held = [None; MAX_AXES];
    }

    /// Selects the next larger or smaller rate or step.
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

    /// Held directions, with the remaining time of each, ms.
    #[must_use]
    pub fn held(&self, now_us: u64) -> [Option<(bool, u64)>; MAX_AXES] {
        self.held.map(|held| {
            let held = held.filter(|held| held.until_us > now_us)?;
            Some((held.up, (held.until_us - now_us).div_ceil(1000)))
        })
    }

    /// Releases all keys and ignores presses for [`LOCKOUT_US`].
    pub fn release_all(&mut self, now_us: u64) {
        if self.held.iter().any(Option::is_some) {
            self.cancel = true;
        }
        self.held = [None; MAX_AXES];
        self.ignore_until_us = now_us + LOCKOUT_US;
    }

    /// Releases all keys; the next press counts at once, for the jog timeout. For buttons whose
    /// holder reports every release.
    pub fn release(&mut self) {
        for held in &mut self.held {
            self.cancel |= held.take().is_some();
        }
    }

    /// Handles a jog key in continuous mode. Returns true when it starts motion of a stationary
    /// axis.
    pub fn handle_key(&mut self, axis: usize, up: bool, phase: KeyPhase, now_us: u64) -> bool {
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
                // A repeat of a key that no longer counts is no new request.
                if active {
                    // Only the key pressed last repeats; a release of the others would be reported.
                    for held in self.held.iter_mut().flatten() {
                        if held.until_us > now_us {
                            held.until_us = held.until_us.max(now_us + self.jog_timeout_us);
                        }
                    }
                }
                false
            }
            KeyPhase::Press => {
                let reports_release = self.reports_release[axis][usize::from(up)];
                if !reports_release {
                    // Without release reports, a press of another key is the only sign that the
                    // previous one was released.
                    for (index, held) in self.held.iter_mut().enumerate() {
                        if index != axis && held.take().is_some() {
                            self.cancel = true;
                        }
                    }
                }
                let counts = if reports_release && !active {
                    FIRST_PRESS_US.max(self.jog_timeout_us)
                } else {
                    self.jog_timeout_us
                };
                self.held[axis] = Some(HeldKey {
                    up,
                    until_us: now_us + counts,
                });
                !active
            }
        }
    }

    /// The command to send now. Callers must poll it every few milliseconds.
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
            // An expired timeout needs no command; a release does.
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
        self.due_us = now_us + self.jog_timeout_us / COMMANDS_PER_TIMEOUT;
        let timeout_ms = left_us.min(self.jog_timeout_us).div_ceil(1000).max(1);
        JogCommand::Move {
            rates,
            timeout_ms: timeout_ms as u16,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1000;

    fn jogging() -> Jogging {
        Jogging::new(&[50.0, 50.0, 50.0, 30.0, 30.0], JOG_TIMEOUT_MS)
    }

    fn is_commanding(jogging: &mut Jogging, now_us: u64) -> bool {
        jogging.command(now_us);
        jogging.commanded.is_some()
    }

    #[test]
    fn press_counts_for_the_jog_timeout() {
        let mut jogging = jogging();
        assert!(jogging.handle_key(0, true, KeyPhase::Press, 0));
        let JogCommand::Move { rates, timeout_ms } = jogging.command(0) else {
            panic!()
        };
        assert_eq!((rates[0], rates[1], timeout_ms), (5.0, 0.0, 200));
        // The command is repeated with the remaining time before it expires.
        assert_eq!(jogging.command(60 * MS), JogCommand::None);
        let JogCommand::Move { timeout_ms, .. } = jogging.command(70 * MS) else {
            panic!()
        };
        assert_eq!(timeout_ms, 130);
        assert!(is_commanding(&mut jogging, 199 * MS));
        assert!(!is_commanding(&mut jogging, 200 * MS));
        // Repeats keep the jog alive, however many there are.
        for now in (300..2000).step_by(33) {
            jogging.handle_key(0, true, KeyPhase::Press, now * MS);
            assert!(is_commanding(&mut jogging, now * MS));
        }
    }

    #[test]
    fn release_cancels_and_repeat_of_a_released_key_is_ignored() {
        let mut jogging = jogging();
        jogging.handle_key(2, false, KeyPhase::Press, 0);
        jogging.command(0);
        jogging.handle_key(2, false, KeyPhase::Release, 50 * MS);
        assert_eq!(jogging.command(50 * MS), JogCommand::Cancel);
        assert_eq!(jogging.command(51 * MS), JogCommand::None);
        jogging.handle_key(2, false, KeyPhase::Repeat, 60 * MS);
        assert_eq!(jogging.command(60 * MS), JogCommand::None);
        // From now on the first press of this key counts until repeats begin.
        jogging.handle_key(2, false, KeyPhase::Press, 100 * MS);
        assert!(is_commanding(&mut jogging, 799 * MS));
        assert!(!is_commanding(&mut jogging, 800 * MS));
    }

    #[test]
    fn after_a_button_is_released_the_next_press_counts_for_the_jog_timeout_only() {
        let mut jogging = jogging();
        jogging.handle_key(0, true, KeyPhase::Press, 0);
        jogging.command(0);
        jogging.release();
        assert_eq!(jogging.command(10 * MS), JogCommand::Cancel);
        jogging.handle_key(0, true, KeyPhase::Repeat, 20 * MS);
        assert_eq!(jogging.command(20 * MS), JogCommand::None);
        jogging.handle_key(0, true, KeyPhase::Press, 30 * MS);
        assert!(is_commanding(&mut jogging, 229 * MS));
        assert!(!is_commanding(&mut jogging, 230 * MS));
    }

    #[test]
    fn stop_requires_a_new_press() {
        let mut jogging = jogging();
        jogging.handle_key(1, true, KeyPhase::Press, 0);
        jogging.command(0);
        jogging.release_all(10 * MS);
        assert_eq!(jogging.command(10 * MS), JogCommand::Cancel);
        jogging.handle_key(1, true, KeyPhase::Press, 100 * MS);
        assert_eq!(jogging.command(100 * MS), JogCommand::None);
        jogging.handle_key(1, true, KeyPhase::Repeat, 400 * MS);
        assert_eq!(jogging.command(400 * MS), JogCommand::None);
        jogging.handle_key(1, true, KeyPhase::Press, 401 * MS);
        assert!(is_commanding(&mut jogging, 401 * MS));
    }

    #[test]
    fn axes_have_own_limits_and_two_keys_combine_with_release_reports() {
        let mut jogging = jogging();
        for _ in 0..9 {
            jogging.select(true);
        }
        jogging.handle_key(3, true, KeyPhase::Release, 0);
        jogging.handle_key(0, false, KeyPhase::Release, 0);
        jogging.handle_key(3, true, KeyPhase::Press, 0);
        jogging.handle_key(0, false, KeyPhase::Press, 0);
        let JogCommand::Move { rates, .. } = jogging.command(0) else {
            panic!()
        };
        assert_eq!((rates[0], rates[3]), (-50.0, 30.0));
        // A key without release reports replaces the other keys.
        jogging.handle_key(1, true, KeyPhase::Press, 10 * MS);
        let JogCommand::Move { rates, .. } = jogging.command(10 * MS) else {
            panic!()
        };
        assert_eq!(rates, [0.0, 50.0, 0.0, 0.0, 0.0, 0.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: proptest::test_runner::RngSeed::Fixed(7),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// For any key sequence, the commanded motion ends within the jog timeout of the last
        /// press, or within the first-press time where releases are reported; no motion is
        /// commanded while no key counts.
        #[test]
        fn motion_ends_when_key_presses_cease(
            events in prop::collection::vec(
                (0_u64..400, 0_usize..5, any::<bool>(), 0_u8..4),
                1..60,
            ),
        ) {
            let mut jogging = jogging();
            let (mut now, mut ends, mut last) = (0, 0, 0);
            for (wait, axis, up, kind) in events {
                for _ in 0..wait {
                    now += MS;
                    if let JogCommand::Move { timeout_ms, .. } = jogging.command(now) {
                        ends = now + u64::from(timeout_ms) * MS;
                        prop_assert!(u64::from(timeout_ms) <= jogging.jog_timeout_ms());
                        prop_assert!(ends <= last + FIRST_PRESS_US + MS);
                    }
                }
                match kind {
                    0 => { jogging.handle_key(axis, up, KeyPhase::Press, now); last = now }
                    1 => { jogging.handle_key(axis, up, KeyPhase::Repeat, now); last = now }
                    2 => { jogging.handle_key(axis, up, KeyPhase::Release, now); }
                    _ => {
                        jogging.release_all(now);
                        let is_commanding = matches!(jogging.command(now), JogCommand::Move { .. });
                        prop_assert!(!is_commanding);
                    }
                }
                if !jogging.has_release_events() {
                    prop_assert!(ends <= last + JOG_TIMEOUT_MS as u64 * MS + MS);
                }
            }
        }
    }
}
