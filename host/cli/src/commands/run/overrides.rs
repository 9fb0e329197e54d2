//! Overrides that the operator changes while a program runs.

use super::args::RunArgs;
use haptimill_protocol::message::Command;
use std::collections::VecDeque;
use std::fmt;

/// Selectable feed overrides, percent.
pub(crate) const FEED: [u8; 19] = [
    0, 1, 2, 5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130, 150, 200,
];
/// Selectable rapid overrides, percent.
pub(crate) const RAPID: [u8; 7] = [0, 5, 10, 25, 50, 75, 100];
/// Selectable spindle overrides, percent.
pub(crate) const SPINDLE: [u8; 11] = [50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 150];

/// The next selectable value above or below the present one.
pub(crate) fn next(values: &[u8], now: u8, up: bool) -> Option<u8> {
    if up {
        values.iter().find(|percent| **percent > now).copied()
    } else {
        values.iter().rev().find(|percent| **percent < now).copied()
    }
}

/// The overrides in force, and commands that were not sent yet.
#[derive(Debug)]
pub(super) struct Overrides {
    feed: u8,
    rapid: u8,
    spindle: u8,
    commands: VecDeque<Command>,
}

impl Overrides {
    pub(super) fn new(args: &RunArgs) -> Self {
        Self {
            feed: args.feed_override,
            rapid: args.rapid_override,
            spindle: args.spindle_override,
            commands: VecDeque::new(),
        }
    }

    /// Follows a key; other keys change nothing.
    pub(super) fn key(&mut self, key: u8) {
        let (values, now, up): (&[u8], &mut u8, bool) = match key {
            b'+' | b'=' => (&FEED, &mut self.feed, true),
            b'-' => (&FEED, &mut self.feed, false),
            b'o' => (&RAPID, &mut self.rapid, true),
            b'i' => (&RAPID, &mut self.rapid, false),
            b'v' => (&SPINDLE, &mut self.spindle, true),
            b'c' => (&SPINDLE, &mut self.spindle, false),
            _ => return,
        };
        let Some(percent) = next(values, *now, up) else {
            return;
        };
        *now = percent;
        self.commands.push_back(match key {
            b'o' | b'i' => Command::RapidOverride { percent },
            b'v' | b'c' => Command::SpindleOverride { percent },
            _ => Command::Override { percent },
        });
    }

    /// Takes the next command.
    pub(super) fn take(&mut self) -> Option<Command> {
        self.commands.pop_front()
    }
}

impl fmt::Display for Overrides {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            feed,
            rapid,
            spindle,
            ..
        } = self;
        write!(
            out,
            "overrides: feed {feed} %, rapid {rapid} %, spindle {spindle} %"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_step_through_the_values_and_stop_at_the_ends() {
        let mut overrides = Overrides {
            feed: 100,
            rapid: 100,
            spindle: 100,
            commands: VecDeque::new(),
        };
        for key in b"+-x++++++oicv" {
            overrides.key(*key);
        }
        let commands: Vec<Command> = std::iter::from_fn(|| overrides.take()).collect();
        let feed = |percent| Command::Override { percent };
        let expected = [
            feed(110),
            feed(100),
            feed(110),
            feed(120),
            feed(130),
            feed(150),
            feed(200),
            Command::RapidOverride { percent: 75 },
            Command::SpindleOverride { percent: 90 },
            Command::SpindleOverride { percent: 100 },
        ];
        assert_eq!(commands, expected);
        assert_eq!(
            overrides.to_string(),
            "overrides: feed 200 %, rapid 75 %, spindle 100 %"
        );
    }
}
