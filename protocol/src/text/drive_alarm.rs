//! Sentences of the reasons for which a drive is not ready.

use super::AxesText;
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
        if self.alarm == DriveAlarm::NoBus || self.alarm.is_of_chip() {
            f.write_str("its driver chip")?;
            let chip = self.axes.chips.get(usize::from(self.joint));
            if let Some(address) = chip.copied().flatten() {
                write!(f, " (address {address})")?;
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
            DriveAlarm::Silent => {
                " does not answer; check the supply of the motors, the wire of its UART and the \
                 pins of its address"
            }
            DriveAlarm::Disturbed => {
                " answers with wrong bytes; check the wire of its UART for shorts and noise, and \
                 that no other chip has its address"
            }
            DriveAlarm::NotSet => {
                " did not take its settings; check that it is the kind of chip of the machine \
                 file, its supply and the wire of its UART"
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
        })
    }
}
