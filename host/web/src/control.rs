//! Control of the machine: at most one viewer has it.

use std::time::{Duration, Instant};

/// Time in which the viewer in control must answer when another one asks for control.
pub const ANSWER: Duration = Duration::from_secs(10);

/// The viewer in control, and the viewer that asks for control.
#[derive(Debug, Default)]
pub struct Control {
    commander: Option<u64>,
    asks: Option<(u64, Instant)>,
    viewers: usize,
    version: u64,
}

impl Control {
    /// Number of the changes so far.
    #[must_use]
    pub const fn version(&self) -> u64 {
        self.version
    }

    /// The viewer in control.
    #[must_use]
    pub const fn commander(&self) -> Option<u64> {
        self.commander
    }

    /// The viewer that asks for control.
    #[must_use]
    pub fn asks(&self) -> Option<u64> {
        self.asks.map(|(viewer, _)| viewer)
    }

    /// Viewers that are connected.
    #[must_use]
    pub const fn viewers(&self) -> usize {
        self.viewers
    }

    /// Adds a viewer.
    pub fn join(&mut self) {
        self.viewers += 1;
        self.version += 1;
    }

    /// Removes a viewer; returns true when it had control.
    pub fn leave(&mut self, viewer: u64, now: Instant) -> bool {
        self.viewers = self.viewers.saturating_sub(1);
        self.version += 1;
        if self.asks() == Some(viewer) {
            self.asks = None;
        }
        let commanded = self.commander == Some(viewer);
        if commanded {
            self.commander = None;
            if let Some((next, _)) = self.asks.take() {
                self.take(next, now);
            }
        }
        commanded
    }

    /// A viewer wants control. It gets free control at once; otherwise the viewer in control is
    /// asked.
    pub fn take(&mut self, viewer: u64, now: Instant) {
        match self.commander {
            None => {
                self.commander = Some(viewer);
                self.version += 1;
            }
            // Only the first question counts; others ask after it.
            Some(other) if other != viewer && self.asks.is_none() => {
                self.asks = Some((viewer, now));
                self.version += 1;
            }
            Some(_) => {}
        }
    }

    /// The viewer in control answers; returns true when it hands control over.
    pub fn answer(&mut self, viewer: u64, hands_over: bool) -> bool {
        if self.commander != Some(viewer) {
            return false;
        }
        let Some((next, _)) = self.asks.take() else {
            return false;
        };
        self.version += 1;
        if hands_over {
            self.commander = Some(next);
        }
        hands_over
    }

    /// Hands control over if the question was not answered in time; returns true then.
    pub fn advance(&mut self, now: Instant) -> bool {
        match (self.asks, self.commander) {
            (Some((_, since)), Some(commander)) if now.duration_since(since) >= ANSWER => {
                self.answer(commander, true)
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_passes_on_consent_on_silence_and_on_leaving() {
        let start = Instant::now();
        let mut control = Control::default();
        (1..=3).for_each(|_| control.join());
        control.take(1, start);
        control.take(2, start);
        control.take(3, start);
        assert_eq!((control.commander(), control.asks()), (Some(1), Some(2)));
        assert!(!control.answer(3, true), "a stranger cannot answer");
        assert!(!control.answer(1, false));
        assert_eq!((control.commander(), control.asks()), (Some(1), None));
        control.take(2, start);
        assert!(control.answer(1, true));
        assert_eq!(control.commander(), Some(2));
        control.take(3, start);
        assert!(!control.advance(start + ANSWER - Duration::from_millis(1)));
        assert!(control.advance(start + ANSWER));
        assert_eq!(control.commander(), Some(3));
        control.take(1, start);
        assert!(control.leave(3, start));
        assert_eq!(control.commander(), Some(1));
        assert!(!control.leave(2, start));
        assert_eq!(control.viewers(), 1);
    }
}
