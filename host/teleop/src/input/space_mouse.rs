//! 3D mice, by the event interface of Linux.

use super::{
    COMPONENTS, Device, InputMotion, OperatorCommand, Read, VecDeque, io, read_all, shape,
};

/// Decodes the records of the event interface, as a 3D mouse sends them.
#[derive(Debug)]
pub struct SpaceMouse<R> {
    input: R,
    received: Vec<u8>,
    /// Deflections; for a relative one also the time of its newest event.
    caps: [(i32, Option<u64>); COMPONENTS],
    /// The enabling switch is pressed.
    is_enabled: bool,
    speed: f64,
}

/// Length of a record, bytes: two machine words of time, u16 kind, u16 code, i32 value.
pub(super) const EVENT: usize = 2 * size_of::<usize>() + 8;

/// A relative deflection is over when no event repeats it for this time, microseconds: zero has no
/// event.
const RELATIVE_US: u64 = 100_000;

/// Deflection that commands the full speed.
const FULL: f64 = 350.0;

impl<R: Read> SpaceMouse<R> {
    /// A 3D mouse; full deflection moves the handle at this speed, mm/s.
    pub const fn new(input: R, speed: f64) -> Self {
        Self {
            input,
            received: Vec::new(),
            caps: [(0, None); COMPONENTS],
            is_enabled: false,
            speed,
        }
    }

    fn decode(
        &mut self,
        event: &[u8; EVENT],
        now_us: u64,
        commands: &mut VecDeque<OperatorCommand>,
    ) {
        let [.., k0, k1, c0, c1, v0, v1, v2, v3] = *event;
        let (kind, code) = (u16::from_ne_bytes([k0, k1]), u16::from_ne_bytes([c0, c1]));
        let value = i32::from_ne_bytes([v0, v1, v2, v3]);
        match (kind, code) {
            (1, 0x100) => self.is_enabled = value != 0,
            (1, 0x101) if value == 1 => commands.push_back(OperatorCommand::Hold),
            (2, axis @ 0..3) => self.caps[usize::from(axis)] = (value, Some(now_us)),
            (3, axis @ 0..3) => self.caps[usize::from(axis)] = (value, None),
            _ => {}
        }
    }
}

impl<R: Read> Device for SpaceMouse<R> {
    fn poll(
        &mut self,
        now_us: u64,
        _: f64,
        commands: &mut VecDeque<OperatorCommand>,
    ) -> io::Result<InputMotion> {
        read_all(&mut self.input, &mut self.received)?;
        let received = std::mem::take(&mut self.received);
        let (events, rest) = received.as_chunks::<EVENT>();
        for event in events {
            self.decode(event, now_us, commands);
        }
        self.received = rest.to_vec();
        let is_over =
            |at: Option<u64>| at.is_some_and(|at| now_us.saturating_sub(at) > RELATIVE_US);
        // Towards the operator and down are positive on the device.
        let signs = [1.0, -1.0, -1.0];
        let velocity = std::array::from_fn(|axis| {
            let (value, at) = self.caps[axis];
            let value = if is_over(at) { 0 } else { value };
            shape((signs[axis] * f64::from(value) / FULL).clamp(-1.0, 1.0)) * self.speed
        });
        Ok(InputMotion {
            velocity,
            limit: None,
            is_enabled: self.is_enabled,
        })
    }
}
