//! Keys of a terminal.

use super::{COMPONENTS, Device, InputMotion, OperatorCommand, Read, VecDeque, io, read_all};

/// The command of a key.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Key {
    Step(usize, f64),
    Coarser,
    Finer,
    Command(OperatorCommand),
}

/// Steps of the keyboard, mm.
const STEPS: [f64; 4] = [0.05, 0.2, 1.0, 5.0];

/// The enabling switch of a keyboard is pressed until this time after the last key, microseconds.
const KEY_US: u64 = 700_000;

/// The handle does not move for this time after the switch is pressed, microseconds: the controller
/// latches the start of the motion then, and the first step must be a whole one.
const LATCH_US: u64 = 25_000;

/// Keys that a terminal sends as bytes.
#[derive(Debug, Clone)]
pub struct Keyboard<R> {
    input: R,
    /// Bytes of an incomplete escape sequence.
    received: Vec<u8>,
    speed: f64,
    step: usize,
    remaining: [f64; COMPONENTS],
    last_us: Option<u64>,
    /// When the enabling switch was pressed.
    enabled_us: Option<u64>,
}

impl<R: Read> Keyboard<R> {
    /// Keys from an input that never waits; the handle moves at this speed, mm/s.
    pub const fn new(input: R, speed: f64) -> Self {
        Self {
            input,
            received: Vec::new(),
            speed,
            step: 1,
            remaining: [0.0; COMPONENTS],
            last_us: None,
            enabled_us: None,
        }
    }

    /// Decodes the next key.
    fn key(&mut self) -> Option<Key> {
        loop {
            let (used, key) = parse(&self.received)?;
            self.received.drain(..used);
            if key.is_some() {
                return key;
            }
        }
    }
}

/// Decodes the first key: its length and its command. `None` while its sequence is incomplete.
fn parse(bytes: &[u8]) -> Option<(usize, Option<Key>)> {
    let key = |key| Some((1, Some(key)));
    match bytes {
        [] | [0x1b] | [0x1b, b'['] | [0x1b, b'[', b'5' | b'6'] => None,
        [0x1b, b'[', b'A', ..] => Some((3, Some(Key::Step(1, 1.0)))),
        [0x1b, b'[', b'B', ..] => Some((3, Some(Key::Step(1, -1.0)))),
        [0x1b, b'[', b'C', ..] => Some((3, Some(Key::Step(0, 1.0)))),
        [0x1b, b'[', b'D', ..] => Some((3, Some(Key::Step(0, -1.0)))),
        [0x1b, b'[', b'5', _, ..] => Some((4, Some(Key::Step(2, 1.0)))),
        [0x1b, b'[', b'6', _, ..] => Some((4, Some(Key::Step(2, -1.0)))),
        [b'd', ..] => key(Key::Step(0, 1.0)),
        [b'a', ..] => key(Key::Step(0, -1.0)),
        [b'w', ..] => key(Key::Step(1, 1.0)),
        [b's', ..] => key(Key::Step(1, -1.0)),
        [b'r', ..] => key(Key::Step(2, 1.0)),
        [b'f', ..] => key(Key::Step(2, -1.0)),
        [b'+', ..] => key(Key::Coarser),
        [b'-', ..] => key(Key::Finer),
        [b' ', ..] => key(Key::Command(OperatorCommand::Hold)),
        [b'g', ..] => key(Key::Command(OperatorCommand::Resume)),
        [b'q', ..] => key(Key::Command(OperatorCommand::End)),
        // Backspace, and Ctrl-C where the terminal passes it on.
        [0x7f | 0x08 | 0x03, ..] => key(Key::Command(OperatorCommand::Stop)),
        [_, ..] => Some((1, None)),
    }
}

impl<R: Read> Device for Keyboard<R> {
    fn poll(
        &mut self,
        now_us: u64,
        dt: f64,
        commands: &mut VecDeque<OperatorCommand>,
    ) -> io::Result<InputMotion> {
        read_all(&mut self.input, &mut self.received)?;
        while let Some(key) = self.key() {
            match key {
                Key::Step(axis, sign) => {
                    // At most two steps ahead: the repeats of a pressed key must not accumulate.
                    let step = STEPS[self.step];
                    self.remaining[axis] =
                        (self.remaining[axis] + sign * step).clamp(-2.0 * step, 2.0 * step);
                    self.last_us = Some(now_us);
                }
                Key::Coarser => self.step = (self.step + 1).min(STEPS.len() - 1),
                Key::Finer => self.step = self.step.saturating_sub(1),
                Key::Command(command) => commands.push_back(command),
            }
        }
        let is_enabled = self
            .last_us
            .is_some_and(|last| now_us.saturating_sub(last) < KEY_US);
        if is_enabled {
            let since = *self.enabled_us.get_or_insert(now_us);
            if now_us.saturating_sub(since) < LATCH_US {
                return Ok(InputMotion {
                    is_enabled,
                    ..InputMotion::default()
                });
            }
        } else {
            self.enabled_us = None;
            self.remaining = [0.0; COMPONENTS];
        }
        let limit = self.remaining.map(f64::abs);
        let velocity = self.remaining.map(|left| {
            if left == 0.0 {
                0.0
            } else {
                self.speed.copysign(left)
            }
        });
        let distance = self.speed * dt;
        for left in &mut self.remaining {
            *left -= left.clamp(-distance, distance);
        }
        Ok(InputMotion {
            velocity,
            limit: Some(limit),
            is_enabled,
        })
    }
}
