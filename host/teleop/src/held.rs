//! A handle that does not exist: keys, a game controller or a 3D mouse move it, and the tool follows as it follows a real one.
//!
//! Every device says at which rate the handle shall move, and whether the dead man's switch is held. The handle goes there from where it is, so nothing ever jumps; let go, it stays, and so does the
//! tool. There is nothing to feel but the numbers on the screen.
//!
//! | device | moves | dead man | orders |
//! | --- | --- | --- | --- |
//! | keyboard | a step for each key press | the last key, 0.7 s ago at most | space holds, g goes on, q ends, Backspace stops |
//! | game controller (`/dev/input/js*`) | left stick x and y, right stick z | first button | second button holds, fourth goes on |
//! | 3D mouse (`/dev/input/event*`) | its cap, x, y, z | first button | second button holds |
//!
//! Misuse: an event device that is no 3D mouse. Its events are read as those of one.

use super::script::Order;
use super::{Source, Standing, Word};
use haptimill_client::{Error, ErrorKind};
use haptimill_machine_file::scale::PER_MM;
use haptimill_protocol::haptic::{COMPONENTS, MasterPose};
use haptimill_protocol::message::RATE_SHIFT;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// What somebody wants at the moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DesiredMotion {
    /// Rate of the handle, mm/s.
    pub rate: [f64; COMPONENTS],
    /// How far it may go at that rate, mm; as far as it likes when there is none.
    pub within: Option<[f64; COMPONENTS]>,
    /// The dead man's switch is held.
    pub held: bool,
}

/// Something with which somebody says what is wanted.
pub trait Device {
    /// What is wanted now, for a handle that moves on by `dt` seconds; orders are added to the list. Never waits.
    ///
    /// # Errors
    /// The device has gone.
    fn wish(
        &mut self,
        now_us: u64,
        dt: f64,
        orders: &mut VecDeque<Order>,
    ) -> io::Result<DesiredMotion>;
}

/// Time between two words, microseconds.
const EVERY_US: u64 = 5000;

/// The handle stays within this of where it began, mm: a place on the wire is an `i32` of 2^-20 mm.
const REACH: f64 = 1500.0;

/// The handle.
pub struct Held<D> {
    device: D,
    name: String,
    tip: [f64; COMPONENTS],
    orders: VecDeque<Order>,
    last_us: Option<u64>,
    gone: Option<String>,
}

impl<D: Device> Held<D> {
    /// A handle that a device moves; `name` is what people call the device.
    #[must_use]
    pub fn new(device: D, name: &str) -> Self {
        Self {
            device,
            name: name.to_string(),
            tip: [0.0; COMPONENTS],
            orders: VecDeque::new(),
            last_us: None,
            gone: None,
        }
    }

    /// The handle goes on for a time; its rate in that time.
    fn move_on(&mut self, wish: &DesiredMotion, dt: f64) -> [f64; COMPONENTS] {
        std::array::from_fn(|axis| {
            let most = wish.within.map_or(f64::INFINITY, |within| within[axis]);
            let way = (wish.rate[axis] * dt).clamp(-most, most);
            let before = self.tip[axis];
            self.tip[axis] = (before + way).clamp(-REACH, REACH);
            (self.tip[axis] - before) / dt
        })
    }
}

impl<D: Device> Source for Held<D> {
    fn advance(&mut self, now_us: u64) -> Result<Option<Word>, Error> {
        let last_us = *self.last_us.get_or_insert(now_us);
        if self.gone.is_some() || now_us < last_us + EVERY_US {
            return Ok(None);
        }
        let dt = ((now_us - last_us) as f64 * 1e-6).min(0.05);
        let wish = match self.device.wish(now_us, dt, &mut self.orders) {
            Ok(wish) => wish,
            Err(error) => {
                // No more words: the machine holds by itself.
                self.gone = Some(format!("{}: {error}", self.name));
                return Ok(None);
            }
        };
        self.last_us = Some(now_us);
        let rate = if wish.held {
            self.move_on(&wish, dt)
        } else {
            [0.0; COMPONENTS]
        };
        let mm_s = PER_MM / f64::from(1 << RATE_SHIFT);
        let hand = MasterPose {
            tip: self.tip.map(|place| (place * PER_MM).round() as i32),
            rate: rate.map(|rate| (rate * mm_s).round() as i32),
            axes: [[i16::MAX, 0, 0], [0, 0, i16::MAX]],
            engaged: wish.held,
        };
        Ok(Some(Word { hand, age_us: 0 }))
    }

    fn standing(&self) -> Standing {
        match &self.gone {
            None => Standing::Ready,
            Some(why) => Standing::Waiting(why.clone()),
        }
    }

    fn order(&mut self) -> Option<Order> {
        self.orders.pop_front()
    }
}

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Key {
    Step(usize, f64),
    Coarser,
    Finer,
    Order(Order),
}

/// Steps of the keyboard, mm.
const STEPS: [f64; 4] = [0.05, 0.2, 1.0, 5.0];

/// The dead man's switch of a keyboard: so long after the last key, microseconds.
const KEY_US: u64 = 700_000;

/// The handle stands still for so long after the switch was pressed, microseconds: where it is then is latched, and a step is to be a whole one.
const LATCH_US: u64 = 25_000;

/// Keys that came as bytes of a terminal.
#[derive(Debug, Clone)]
pub struct Keys<R> {
    input: R,
    /// Bytes of a sequence that is not whole.
    begun: Vec<u8>,
    speed: f64,
    step: usize,
    left: [f64; COMPONENTS],
    last_us: Option<u64>,
    /// Since when keys hold the dead man's switch.
    held_us: Option<u64>,
}

impl<R: Read> Keys<R> {
    /// Keys from an input that never waits; the handle moves at a speed, mm/s.
    pub const fn new(input: R, speed: f64) -> Self {
        Self {
            input,
            begun: Vec::new(),
            speed,
            step: 1,
            left: [0.0; COMPONENTS],
            last_us: None,
            held_us: None,
        }
    }

    /// The next key of the bytes that came.
    fn key(&mut self) -> Option<Key> {
        loop {
            let (used, key) = parse(&self.begun)?;
            self.begun.drain(..used);
            if key.is_some() {
                return key;
            }
        }
    }
}

/// The first key of some bytes: how many they are, and what it asks for. `None` while it is not whole.
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
        [b' ', ..] => key(Key::Order(Order::Hold)),
        [b'g', ..] => key(Key::Order(Order::Resume)),
        [b'q', ..] => key(Key::Order(Order::End)),
        // Backspace, and Ctrl-C where the terminal hands it over.
        [0x7f | 0x08 | 0x03, ..] => key(Key::Order(Order::Stop)),
        [_, ..] => Some((1, None)),
    }
}

/// What is there to be read, without waiting; an input at its end is gone.
fn read_all(input: &mut impl Read, bytes: &mut Vec<u8>) -> io::Result<()> {
    let mut buffer = [0; 512];
    loop {
        match input.read(&mut buffer) {
            Ok(0) => return Err(io::Error::from(io::ErrorKind::UnexpectedEof)),
            Ok(count) => bytes.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

impl<R: Read> Device for Keys<R> {
    fn wish(
        &mut self,
        now_us: u64,
        dt: f64,
        orders: &mut VecDeque<Order>,
    ) -> io::Result<DesiredMotion> {
        read_all(&mut self.input, &mut self.begun)?;
        while let Some(key) = self.key() {
            match key {
                Key::Step(axis, sign) => {
                    // No more than two steps ahead: a held key must not run away with it.
                    let step = STEPS[self.step];
                    self.left[axis] =
                        (self.left[axis] + sign * step).clamp(-2.0 * step, 2.0 * step);
                    self.last_us = Some(now_us);
                }
                Key::Coarser => self.step = (self.step + 1).min(STEPS.len() - 1),
                Key::Finer => self.step = self.step.saturating_sub(1),
                Key::Order(order) => orders.push_back(order),
            }
        }
        let held = self
            .last_us
            .is_some_and(|last| now_us.saturating_sub(last) < KEY_US);
        if held {
            let since = *self.held_us.get_or_insert(now_us);
            if now_us.saturating_sub(since) < LATCH_US {
                return Ok(DesiredMotion {
                    held,
                    ..DesiredMotion::default()
                });
            }
        } else {
            self.held_us = None;
            self.left = [0.0; COMPONENTS];
        }
        let within = self.left.map(f64::abs);
        let rate = self.left.map(|left| {
            if left == 0.0 {
                0.0
            } else {
                self.speed.copysign(left)
            }
        });
        // What goes now is not left.
        let way = self.speed * dt;
        for left in &mut self.left {
            *left -= left.clamp(-way, way);
        }
        Ok(DesiredMotion {
            rate,
            within: Some(within),
            held,
        })
    }
}

/// Records of Linux's joystick interface.
#[derive(Debug)]
pub struct Joystick<R> {
    input: R,
    begun: Vec<u8>,
    axes: [i16; 8],
    dead_man: bool,
    speed: f64,
}

/// Bytes of a record: u32 time, i16 value, u8 kind, u8 number.
const RECORD: usize = 8;

/// Part of the deflection in which nothing happens.
const DEAD_ZONE: f64 = 0.08;

impl<R: Read> Joystick<R> {
    /// A game controller; the handle moves at a speed at most, mm/s.
    pub const fn new(input: R, speed: f64) -> Self {
        Self {
            input,
            begun: Vec::new(),
            axes: [0; 8],
            dead_man: false,
            speed,
        }
    }

    fn take(&mut self, record: [u8; RECORD], orders: &mut VecDeque<Order>) {
        let [_, _, _, _, low, high, kind, number] = record;
        let value = i16::from_le_bytes([low, high]);
        // The highest bit says that it was so from the start.
        match (kind & 0x7f, number) {
            (1, 0) => self.dead_man = value != 0,
            (1, 1) if value != 0 && kind & 0x80 == 0 => orders.push_back(Order::Hold),
            (1, 3) if value != 0 && kind & 0x80 == 0 => orders.push_back(Order::Resume),
            (2, axis @ 0..8) => self.axes[usize::from(axis)] = value,
            _ => {}
        }
    }
}

/// From the deflection of a stick, -1 to 1, to a part of the speed: nothing in the middle, fine around it.
fn shaped(deflection: f64) -> f64 {
    let beyond = ((deflection.abs() - DEAD_ZONE) / (1.0 - DEAD_ZONE)).clamp(0.0, 1.0);
    (beyond * beyond).copysign(deflection)
}

impl<R: Read> Device for Joystick<R> {
    fn wish(&mut self, _: u64, _: f64, orders: &mut VecDeque<Order>) -> io::Result<DesiredMotion> {
        read_all(&mut self.input, &mut self.begun)?;
        let begun = std::mem::take(&mut self.begun);
        let (records, rest) = begun.as_chunks::<RECORD>();
        for record in records {
            self.take(*record, orders);
        }
        self.begun = rest.to_vec();
        // Sticks are forward and up at negative values.
        let part = |axis: usize, sign: f64| {
            shaped(sign * f64::from(self.axes[axis]) / 32_767.0) * self.speed
        };
        Ok(DesiredMotion {
            rate: [part(0, 1.0), part(1, -1.0), part(4, -1.0)],
            within: None,
            held: self.dead_man,
        })
    }
}

/// Records of Linux's event interface, as a 3D mouse gives them.
#[derive(Debug)]
pub struct SpaceMouse<R> {
    input: R,
    begun: Vec<u8>,
    /// Deflections, and when a relative one was told last.
    caps: [(i32, Option<u64>); COMPONENTS],
    dead_man: bool,
    speed: f64,
}

/// Bytes of a record: two machine words of time, u16 kind, u16 code, i32 value.
const EVENT: usize = 2 * size_of::<usize>() + 8;

/// A relative deflection that is not told again for so long is over, microseconds: a zero is never told.
const RELATIVE_US: u64 = 100_000;

/// Deflection at which the speed is whole.
const FULL: f64 = 350.0;

impl<R: Read> SpaceMouse<R> {
    /// A 3D mouse; the handle moves at a speed at most, mm/s.
    pub const fn new(input: R, speed: f64) -> Self {
        Self {
            input,
            begun: Vec::new(),
            caps: [(0, None); COMPONENTS],
            dead_man: false,
            speed,
        }
    }

    fn take(&mut self, event: &[u8; EVENT], now_us: u64, orders: &mut VecDeque<Order>) {
        let [.., k0, k1, c0, c1, v0, v1, v2, v3] = *event;
        let (kind, code) = (u16::from_ne_bytes([k0, k1]), u16::from_ne_bytes([c0, c1]));
        let value = i32::from_ne_bytes([v0, v1, v2, v3]);
        match (kind, code) {
            (1, 0x100) => self.dead_man = value != 0,
            (1, 0x101) if value == 1 => orders.push_back(Order::Hold),
            (2, axis @ 0..3) => self.caps[usize::from(axis)] = (value, Some(now_us)),
            (3, axis @ 0..3) => self.caps[usize::from(axis)] = (value, None),
            _ => {}
        }
    }
}

impl<R: Read> Device for SpaceMouse<R> {
    fn wish(
        &mut self,
        now_us: u64,
        _: f64,
        orders: &mut VecDeque<Order>,
    ) -> io::Result<DesiredMotion> {
        read_all(&mut self.input, &mut self.begun)?;
        let begun = std::mem::take(&mut self.begun);
        let (events, rest) = begun.as_chunks::<EVENT>();
        for event in events {
            self.take(event, now_us, orders);
        }
        self.begun = rest.to_vec();
        let over = |at: Option<u64>| at.is_some_and(|at| now_us.saturating_sub(at) > RELATIVE_US);
        // Towards the person and down are positive on the device.
        let signs = [1.0, -1.0, -1.0];
        let rate = std::array::from_fn(|axis| {
            let (value, at) = self.caps[axis];
            let value = if over(at) { 0 } else { value };
            shaped((signs[axis] * f64::from(value) / FULL).clamp(-1.0, 1.0)) * self.speed
        });
        Ok(DesiredMotion {
            rate,
            within: None,
            held: self.dead_man,
        })
    }
}

/// Opens a device file, to be read without waiting. `what` it is to be, for people, and how the system begins the names of such devices.
///
/// # Errors
/// There is none, it must not be read, or it is no such device.
pub fn open(path: &Path, what: &str, name: &str) -> Result<File, Error> {
    let mut options = File::options();
    options.read(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits() as i32);
    }
    let none = |why: &dyn std::fmt::Display, remedy: &str| {
        let what = format!("{}: no {what} there: {why}; {remedy}", path.display());
        Error::new(ErrorKind::Port, what)
    };
    let file = options.open(path).map_err(|error| {
        let remedy = match error.kind() {
            io::ErrorKind::NotFound => "is it plugged in?",
            io::ErrorKind::PermissionDenied => {
                "add yourself to the group that may read it (input, on most systems)"
            }
            _ => "is it the device?",
        };
        none(&error, remedy)
    })?;
    if !is_device(&file, name) {
        let remedy = format!("give /dev/input/{name}*, or a link to it");
        return Err(none(&"it is another kind of file", &remedy));
    }
    Ok(file)
}

/// Whether a file is an input device whose name in the system begins like this, or a pipe, whose other end says what such a device would.
#[cfg(target_os = "linux")]
fn is_device(file: &File, name: &str) -> bool {
    use std::os::unix::fs::{FileTypeExt, MetadataExt};
    /// The kernel's number of input devices.
    const INPUT: u32 = 13;
    let Ok(metadata) = file.metadata() else {
        return false;
    };
    if metadata.file_type().is_fifo() {
        return true;
    }
    let number = metadata.rdev();
    let (major, minor) = (rustix::fs::major(number), rustix::fs::minor(number));
    if !metadata.file_type().is_char_device() || major != INPUT {
        return false;
    }
    // Without that folder the number has to do.
    let link = std::fs::read_link(format!("/sys/dev/char/{major}:{minor}"));
    link.map_or(true, |link| {
        link.file_name()
            .is_some_and(|own| own.to_string_lossy().starts_with(name))
    })
}

/// Elsewhere nothing is known of such devices, but that they are no plain files.
#[cfg(not(target_os = "linux"))]
fn is_device(file: &File, _: &str) -> bool {
    file.metadata()
        .is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

/// The keyboard of a terminal, key by key.
#[cfg(unix)]
pub mod terminal {
    use super::{Error, ErrorKind, Read, io};
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};
    use std::io::IsTerminal;

    /// Standard input while it gives single keys; the terminal is as before when this is gone.
    pub struct Terminal {
        before: Termios,
    }

    impl Terminal {
        /// Takes the terminal; Ctrl-C stays what it is.
        ///
        /// # Errors
        /// Standard input is no terminal.
        pub fn take() -> Result<Self, Error> {
            let stdin = io::stdin();
            if !stdin.is_terminal() {
                let what = "--master keyboard needs a terminal on standard input; run it in one, or use --master sim, script:FILE or the port of an arm";
                return Err(Error::new(ErrorKind::Usage, what));
            }
            let failed = |error: rustix::io::Errno| {
                Error::new(ErrorKind::Usage, format!("the terminal: {error}"))
            };
            let before = tcgetattr(&stdin).map_err(failed)?;
            let mut raw = before.clone();
            raw.local_modes -=
                rustix::termios::LocalModes::ICANON | rustix::termios::LocalModes::ECHO;
            tcsetattr(&stdin, OptionalActions::Now, &raw).map_err(failed)?;
            Ok(Self { before })
        }
    }

    impl Drop for Terminal {
        fn drop(&mut self) {
            let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
        }
    }

    impl Read for Terminal {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let stdin = io::stdin();
            let mut ready = [PollFd::new(&stdin, PollFlags::IN)];
            let now = Timespec::default();
            if poll(&mut ready, Some(&now))? == 0 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            // Past the buffer of the standard library, which poll cannot see.
            Ok(rustix::io::read(&stdin, buffer)?)
        }
    }
}

#[cfg(test)]
mod tests;
