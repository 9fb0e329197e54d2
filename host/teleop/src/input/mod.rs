//! Input devices that move a virtual handle: keyboard, game controller, 3D mouse.
//!
//! A device commands a velocity of the handle and reports its enabling switch. The handle moves
//! from where it is, so its position never jumps; with the switch released, handle and tool stand
//! still. There is no force feedback.
//!
//! | device | moves | enabling switch | commands |
//! | --- | --- | --- | --- |
//! | keyboard | a step per key press | until 0.7 s after the last key | space: hold, g: resume, q: end, Backspace: stop |
//! | game controller (`/dev/input/js*`) | left stick x and y, right stick z | first button | second button: hold, fourth: resume |
//! | 3D mouse (`/dev/input/event*`) | its cap, x, y, z | first button | second button: hold |
//!
//! Callers must open the event device of a 3D mouse: the events of other devices are decoded as its
//! events.

mod joystick;
mod keyboard;
mod space_mouse;
#[cfg(unix)]
pub mod terminal;

pub use joystick::Joystick;
pub use keyboard::Keyboard;
pub use space_mouse::SpaceMouse;

use super::script::OperatorCommand;
use super::{MasterDevice, MasterSample, MasterStatus};
use haptimill_client::{Error, ErrorKind};
use haptimill_machine_file::scale::PER_MM;
use haptimill_protocol::haptic::{COMPONENTS, MasterPose};
use haptimill_protocol::message::RATE_SHIFT;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// The motion that a device commands.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct InputMotion {
    /// Velocity of the handle, mm/s.
    pub velocity: [f64; COMPONENTS],
    /// Distance limit at that velocity, mm; none when it is absent.
    pub limit: Option<[f64; COMPONENTS]>,
    /// The enabling switch is pressed.
    pub is_enabled: bool,
}

/// A device that commands the motion of the handle.
pub trait Device {
    /// The motion for the next `dt` seconds; commands are added to the list. Never waits.
    ///
    /// # Errors
    /// The device was disconnected.
    fn poll(
        &mut self,
        now_us: u64,
        dt: f64,
        commands: &mut VecDeque<OperatorCommand>,
    ) -> io::Result<InputMotion>;
}

/// Time between two samples, microseconds.
const EVERY_US: u64 = 5000;

/// Longest time that one sample integrates, s.
const MAX_DT: f64 = 0.05;

/// Distance of the handle from its start at most, mm: the protocol has an `i32` of 2^-20 mm.
const REACH: f64 = 1500.0;

/// A handle that exists in this process only.
pub struct VirtualHandle<D> {
    device: D,
    name: String,
    tip: [f64; COMPONENTS],
    commands: VecDeque<OperatorCommand>,
    last_us: Option<u64>,
    /// Why the device is lost.
    lost: Option<String>,
}

impl<D: Device> VirtualHandle<D> {
    /// A handle that a device moves; `name` is the name of the device in messages.
    #[must_use]
    pub fn new(device: D, name: &str) -> Self {
        Self {
            device,
            name: name.to_string(),
            tip: [0.0; COMPONENTS],
            commands: VecDeque::new(),
            last_us: None,
            lost: None,
        }
    }

    /// Moves the handle for a time, and returns its velocity in that time.
    fn integrate(&mut self, motion: &InputMotion, dt: f64) -> [f64; COMPONENTS] {
        std::array::from_fn(|axis| {
            let limit = motion.limit.map_or(f64::INFINITY, |limit| limit[axis]);
            let distance = (motion.velocity[axis] * dt).clamp(-limit, limit);
            let before = self.tip[axis];
            self.tip[axis] = (before + distance).clamp(-REACH, REACH);
            (self.tip[axis] - before) / dt
        })
    }
}

impl<D: Device> MasterDevice for VirtualHandle<D> {
    fn advance(&mut self, now_us: u64) -> Result<Option<MasterSample>, Error> {
        let last_us = *self.last_us.get_or_insert(now_us);
        if self.lost.is_some() || now_us < last_us + EVERY_US {
            return Ok(None);
        }
        let dt = ((now_us - last_us) as f64 * 1e-6).min(MAX_DT);
        let motion = match self.device.poll(now_us, dt, &mut self.commands) {
            Ok(motion) => motion,
            Err(error) => {
                // Without samples the machine holds by itself.
                self.lost = Some(format!("{}: {error}", self.name));
                return Ok(None);
            }
        };
        self.last_us = Some(now_us);
        let velocity = if motion.is_enabled {
            self.integrate(&motion, dt)
        } else {
            [0.0; COMPONENTS]
        };
        let mm_s = PER_MM / f64::from(1 << RATE_SHIFT);
        let pose = MasterPose {
            tip: self.tip.map(|position| (position * PER_MM).round() as i32),
            rate: velocity.map(|velocity| (velocity * mm_s).round() as i32),
            axes: [[i16::MAX, 0, 0], [0, 0, i16::MAX]],
            enabling_switch: motion.is_enabled,
        };
        Ok(Some(MasterSample { pose, age_us: 0 }))
    }

    fn status(&self) -> MasterStatus {
        match &self.lost {
            None => MasterStatus::Ready,
            Some(reason) => MasterStatus::Waiting(reason.clone()),
        }
    }

    fn next_command(&mut self) -> Option<OperatorCommand> {
        self.commands.pop_front()
    }
}

/// Reads what has arrived, without waiting; the end of the input is an error.
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

/// Part of the deflection of a stick that commands no motion.
const DEAD_ZONE: f64 = 0.08;

/// Fraction of the speed for a deflection, -1 to 1: zero in the dead zone, then quadratic, so that
/// it is fine around it.
fn shape(deflection: f64) -> f64 {
    let beyond = ((deflection.abs() - DEAD_ZONE) / (1.0 - DEAD_ZONE)).clamp(0.0, 1.0);
    (beyond * beyond).copysign(deflection)
}

/// Opens a device file for reading without waiting. `what` names the kind of device in messages;
/// `name` is the prefix that the system gives to devices of that kind.
///
/// # Errors
/// The file is missing, cannot be read, or is another kind of device.
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

/// Whether a file is an input device with this prefix in its system name, or a pipe that stands in
/// for one.
#[cfg(target_os = "linux")]
fn is_device(file: &File, name: &str) -> bool {
    use std::os::unix::fs::{FileTypeExt, MetadataExt};
    /// Major device number of input devices in the kernel.
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
    // Without sysfs the device number decides.
    let link = std::fs::read_link(format!("/sys/dev/char/{major}:{minor}"));
    link.map_or(true, |link| {
        link.file_name()
            .is_some_and(|own| own.to_string_lossy().starts_with(name))
    })
}

/// Other systems: any file that is neither a plain file nor a folder.
#[cfg(not(target_os = "linux"))]
fn is_device(file: &File, _: &str) -> bool {
    file.metadata()
        .is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

#[cfg(test)]
mod tests;
