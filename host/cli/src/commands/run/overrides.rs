//! Overrides that the operator changes while a program runs.

use super::args::RunArgs;
use crate::commands::requests::{check_overrides, describe_overrides};
use haptimill_machine_file::Spindle;
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
    /// Limits of the spindle, and the slowest and fastest speed of the program, rev/min.
    limits: Spindle,
    speeds: Option<[u16; 2]>,
    commands: VecDeque<Command>,
}

impl Overrides {
    pub(super) fn new(args: &RunArgs, limits: Spindle, speeds: Option<[u16; 2]>) -> Self {
        Self {
            feed: args.feed_override,
            rapid: args.rapid_override,
            spindle: args.spindle_override,
            limits,
            speeds,
            commands: VecDeque::new(),
        }
    }

    /// Overrides of feed and of rapid moves, percent.
    pub(super) const fn of_motion(&self) -> [u8; 2] {
        [self.feed, self.rapid]
    }

    /// Follows a key; other keys change nothing.
    ///
    /// # Errors
    /// Why the override does not change.
    pub(super) fn key(&mut self, key: u8) -> Result<(), String> {
        let up = matches!(key, b'+' | b'=' | b'o' | b'v');
        let [feed, rapid, spindle] = match key {
            b'+' | b'=' | b'-' => [next(&FEED, self.feed, up), None, None],
            b'o' | b'i' => [None, next(&RAPID, self.rapid, up), None],
            b'v' | b'c' => [None, None, next(&SPINDLE, self.spindle, up)],
            _ => return Ok(()),
        };
        self.set(feed, rapid, spindle)
    }

    /// Sets overrides, percent, or none of them.
    ///
    /// # Errors
    /// One is out of its range, or the spindle does not have the speed.
    pub(super) fn set(
        &mut self,
        feed: Option<u8>,
        rapid: Option<u8>,
        spindle: Option<u8>,
    ) -> Result<(), String> {
        check_overrides([feed, rapid, spindle])?;
        if let Some(percent) = spindle {
            self.limits.check_override(self.speeds, percent)?;
            self.spindle = percent;
            self.commands
                .push_back(Command::SpindleOverride { percent });
        }
        if let Some(percent) = feed {
            self.feed = percent;
            self.commands.push_back(Command::Override { percent });
        }
        if let Some(percent) = rapid {
            self.rapid = percent;
            self.commands.push_back(Command::RapidOverride { percent });
        }
        Ok(())
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
        out.write_str(&describe_overrides([*feed, *rapid, *spindle]))
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
            limits: Spindle {
                rpm: [300, 6000],
                run_up_s: 1.0,
            },
            speeds: Some([1000, 5800]),
            commands: VecDeque::new(),
        };
        for key in b"+-x++++++oicv" {
            overrides.key(*key).expect("within the limits");
        }
        let refused = overrides.key(b'v').expect_err("too fast");
        assert!(
            refused.contains("S5800 of the program would be 6380"),
            "{refused}"
        );
        let refused = overrides
            .set(Some(120), None, Some(20))
            .expect_err("too slow");
        assert!(refused.contains("would be 200"), "{refused}");
        let refused = overrides
            .set(Some(201), None, None)
            .expect_err("out of range");
        assert!(refused.contains("0 to 200 %"), "{refused}");
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
