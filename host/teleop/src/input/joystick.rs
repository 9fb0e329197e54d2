//! Game controllers, by the joystick interface of Linux.

use super::{Device, InputMotion, OperatorCommand, Read, VecDeque, io, read_all, shape};

/// Decodes the records of the joystick interface.
#[derive(Debug)]
pub struct Joystick<R> {
    pub(super) input: R,
    received: Vec<u8>,
    axes: [i16; 8],
    /// The enabling switch is pressed.
    is_enabled: bool,
    speed: f64,
}

/// Length of a record, bytes: u32 time, i16 value, u8 kind, u8 number.
const RECORD: usize = 8;

impl<R: Read> Joystick<R> {
    /// A game controller; full deflection moves the handle at this speed, mm/s.
    pub const fn new(input: R, speed: f64) -> Self {
        Self {
            input,
            received: Vec::new(),
            axes: [0; 8],
            is_enabled: false,
            speed,
        }
    }

    fn decode(&mut self, record: [u8; RECORD], commands: &mut VecDeque<OperatorCommand>) {
        let [_, _, _, _, low, high, kind, number] = record;
        let value = i16::from_le_bytes([low, high]);
        // The highest bit marks the initial state.
        match (kind & 0x7f, number) {
            (1, 0) => self.is_enabled = value != 0,
            (1, 1) if value != 0 && kind & 0x80 == 0 => commands.push_back(OperatorCommand::Hold),
            (1, 3) if value != 0 && kind & 0x80 == 0 => commands.push_back(OperatorCommand::Resume),
            (2, axis @ 0..8) => self.axes[usize::from(axis)] = value,
            _ => {}
        }
    }
}

impl<R: Read> Device for Joystick<R> {
    fn poll(
        &mut self,
        _: u64,
        _: f64,
        commands: &mut VecDeque<OperatorCommand>,
    ) -> io::Result<InputMotion> {
        read_all(&mut self.input, &mut self.received)?;
        let received = std::mem::take(&mut self.received);
        let (records, rest) = received.as_chunks::<RECORD>();
        for record in records {
            self.decode(*record, commands);
        }
        self.received = rest.to_vec();
        // Forward and up are negative values.
        let part = |axis: usize, sign: f64| {
            shape(sign * f64::from(self.axes[axis]) / 32_767.0) * self.speed
        };
        Ok(InputMotion {
            velocity: [part(0, 1.0), part(1, -1.0), part(4, -1.0)],
            limit: None,
            is_enabled: self.is_enabled,
        })
    }
}
