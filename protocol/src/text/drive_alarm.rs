//! Sentences of the reasons for which a drive is not ready.

use super::{AxesText, ChipText};
use crate::message::DriveAlarm;
use core::fmt::{Display, Formatter, Result};

/// What is wrong with the drive of a joint, and what to check.
pub(super) struct Explained<'a> {
    /// The joint.
    pub joint: u8,
    /// The reason.
    pub alarm: DriveAlarm,
    /// Names and chips of the joints.
    pub axes: &'a AxesText<'a>,
}

impl Display for Explained<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let chip = self.axes.chips.get(usize::from(self.joint));
        let chip = chip.copied().flatten();
        if self.alarm == DriveAlarm::NoBus || self.alarm.is_of_chip() {
            f.write_str("its driver chip")?;
            match chip {
                Some(ChipText::Address(address)) => write!(f, " (address {address})")?,
                Some(ChipText::Position(position)) => write!(f, " (position {position})")?,
                None => {}
            }
        }
        f.write_str(match self.alarm {
            DriveAlarm::Input => "its alarm input is active; check the drive and its alarm line",
            DriveAlarm::Unsupported => {
                "the board cannot drive this joint; check kind of drive, step clock, pulse width, \
                 encoder, switches and driver chip of the joint in the machine file"
            }
            DriveAlarm::StepsCut => {
                "the board could not emit all of its steps; lower its rate, or use an image with a \
                 longer control period"
            }
            DriveAlarm::NoBus => {
                " has no bus at this board; use an image that has one, or remove the chip from \
                 the machine file and set the drive by its switches"
            }
            DriveAlarm::Setting => " is being set; wait a second, then enable again",
            DriveAlarm::Silent | DriveAlarm::Disturbed | DriveAlarm::NotSet => {
                return of_bus(self.alarm, chip, f);
            }
            DriveAlarm::Reset => {
                " was reset; check the supply of the motors, which was interrupted or too low for \
                 a moment"
            }
            DriveAlarm::Overheated => {
                " is too hot and switched the motor off; let it cool down, then lower the current \
                 or cool it better"
            }
            DriveAlarm::Shorted => {
                " found a short and switched the motor off; remove the supply, then check the \
                 phases of the motor and its cable"
            }
            DriveAlarm::SwitchedOff => {
                " switched the motor off for a heat or a short that is over; check the phases of \
                 the motor, its cable and its current"
            }
            DriveAlarm::Undervoltage => {
                " has too low a supply; check the supply of the motors and its wires"
            }
            DriveAlarm::Unreachable => {
                " cannot be reached; `haptimill status` names the chip of the chain that does not \
                 answer"
            }
        })
    }
}

/// Reasons whose remedy depends on the bus of the chip.
fn of_bus(alarm: DriveAlarm, chip: Option<ChipText>, f: &mut Formatter<'_>) -> Result {
    f.write_str(match alarm {
        DriveAlarm::Silent => " does not answer; check the supply of the motors, ",
        DriveAlarm::Disturbed => " answers with wrong bytes; check ",
        _ => {
            " did not take its settings; check that it is the kind of chip of the machine file, its \
             supply"
        }
    })?;
    f.write_str(match (alarm, chip) {
        (DriveAlarm::Silent, Some(ChipText::Address(_))) => {
            "the wire of its UART and the pins of its address"
        }
        (DriveAlarm::Silent, Some(ChipText::Position(_))) => {
            "and the wire from its SDO to the next chip of the chain, or from the last one to the \
             board"
        }
        (DriveAlarm::Silent, None) => "and the wires of its bus",
        (DriveAlarm::Disturbed, Some(ChipText::Address(_))) => {
            "the wire of its UART for shorts and noise, and that no other chip has its address"
        }
        (DriveAlarm::Disturbed, Some(ChipText::Position(_))) => {
            "the wires of the chain for shorts and noise, and that the chain has as many chips as \
             the machine file"
        }
        (DriveAlarm::Disturbed, None) => "the wires of its bus for shorts and noise",
        (_, Some(ChipText::Address(_))) => " and the wire of its UART",
        (_, Some(ChipText::Position(_))) => {
            ", its pin SD_MODE, which must be high, and the wires of the chain"
        }
        (_, None) => " and the wires of its bus",
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::{String, ToString};

    fn sentence(alarm: DriveAlarm, chip: Option<ChipText>) -> String {
        let axes = AxesText {
            chips: &[None, chip],
            ..AxesText::default()
        };
        Explained {
            joint: 1,
            alarm,
            axes: &axes,
        }
        .to_string()
    }

    /// Each reason of a chip has its place, and a remedy that fits its bus.
    #[test]
    fn the_remedy_is_that_of_the_bus() {
        let of_chip = DriveAlarm::ALL
            .into_iter()
            .filter(|alarm| alarm.is_of_chip());
        for alarm in of_chip {
            let [uart, chain, none] = [
                Some(ChipText::Address(3)),
                Some(ChipText::Position(4)),
                None,
            ]
            .map(|chip| sentence(alarm, chip));
            assert!(uart.starts_with("its driver chip (address 3) "), "{uart}");
            assert!(
                chain.starts_with("its driver chip (position 4) "),
                "{chain}"
            );
            assert!(none.starts_with("its driver chip "), "{none}");
            assert!(!chain.contains("UART") && !none.contains("UART"), "{chain}");
            assert!(!uart.contains("SDO"), "{uart}");
            for text in [uart, chain, none] {
                assert!(!text.contains("  ") && text.contains("; "), "{text}");
            }
        }
        assert!(sentence(DriveAlarm::Silent, Some(ChipText::Position(0))).contains("its SDO"));
        assert!(sentence(DriveAlarm::Silent, Some(ChipText::Address(0))).contains("its UART"));
    }
}
