//! Chips of the drives: TMC2209 on the wire at GP0 and GP1, or TMC5160 in the chain of the image
//! with SPI.

use crate::chip::Chip;
use crate::signals::Signals;
use haptimill_client::session::pins::record::JOINTS;
use haptimill_firmware::config::ChipKind;
use haptimill_hil_sim::tmc2209::{self, Wire};
use haptimill_hil_sim::tmc5160;
use haptimill_machine_file::MachineFile;

/// The chips. Those of a chain are in [`Signals`].
#[derive(Debug, Default)]
pub struct DriveChips {
    /// The wire with its chips.
    pub wire: Wire,
    /// Place of the chip of each joint on the wire or in the chain; a joint without one has a drive
    /// that is set by its switches.
    places: [Option<usize>; JOINTS],
    /// Cycles of a bit on the wire.
    bit: u64,
}

impl DriveChips {
    /// Connects the chips that a machine file has for the drives of its joints, after power-on. An
    /// image whose line is the UART has no wire for them, and only the image with SPI has a chain.
    pub fn connect(&mut self, machine: &MachineFile, has_wire: bool, signals: &mut Signals) {
        self.wire.chips.clear();
        self.places = [None; JOINTS];
        for (place, joint) in self.places.iter_mut().zip(&machine.config.joints) {
            let Some(chip) = joint.chip().filter(|_| has_wire) else {
                continue;
            };
            match (chip.kind, &mut *signals) {
                (ChipKind::Tmc2209, Signals::Pins | Signals::Chain(_)) => {
                    *place = Some(self.wire.chips.len());
                    self.wire.chips.push(tmc2209::Chip::new(chip.place));
                }
                (ChipKind::Tmc5160, Signals::Spi(chain)) => {
                    *place = Some(usize::from(chip.place));
                    chain.chips.push(tmc5160::Chip::default());
                }
                _ => {}
            }
        }
    }

    /// Place of the chip of a joint.
    ///
    /// # Panics
    /// The joint has none.
    #[must_use]
    pub const fn place(&self, joint: usize) -> usize {
        self.places[joint].expect("a joint with a chip")
    }

    /// Carries the bytes of the wire. The board receives what it sends, a byte later than on a real
    /// wire: the emulated UART reports a byte at its end.
    pub fn serve_wire(&mut self, board: &mut Chip) {
        if self.wire.chips.is_empty() {
            return;
        }
        let now = board.cycles();
        if board.has_uart_bytes() {
            self.bit = board.uart_bit().unwrap_or(1);
            for byte in board.take_uart_bytes() {
                self.wire.send(byte, now, self.bit);
                board.give_uart_bytes(&[byte]);
            }
        }
        let reply = self.wire.replies(now, self.bit);
        if !reply.is_empty() {
            board.give_uart_bytes(&reply);
        }
    }

    /// The drive of a joint moves its motor.
    #[must_use]
    pub fn drives(&self, joint: usize, signals: &Signals) -> bool {
        self.places[joint].is_none_or(|place| match signals {
            Signals::Spi(chain) => chain.chips[place].drives(),
            _ => self.wire.chips[place].drives(),
        })
    }

    /// Sets the enable inputs.
    pub fn set_enabled(&mut self, enabled: bool, signals: &mut Signals) {
        for chip in &mut self.wire.chips {
            chip.set_enabled(enabled);
        }
        if let Signals::Spi(chain) = signals {
            for chip in &mut chain.chips {
                chip.set_enabled(enabled);
            }
        }
    }
}
