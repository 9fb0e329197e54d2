//! Reasons for which a drive is not ready.

use super::MAX_AXES;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Reason for which a board reports the drive of a joint as not ready.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DriveAlarm {
    /// The alarm input of the board is active, or the board knows no more.
    #[default]
    Input,
    /// The board cannot drive this joint.
    Unsupported,
    /// The board could not emit all steps of the joint.
    StepsCut,
    /// The board has no bus for the driver chip of the joint.
    NoBus,
    /// The board is setting the driver chip.
    Setting,
    /// The driver chip does not answer.
    Silent,
    /// The wire to the driver chip is disturbed: what arrives on it is not sound.
    Disturbed,
    /// A chip answers, and it is another one, or it did not take its settings.
    NotSet,
    /// The driver chip was reset since it was set: its currents are those of the factory.
    Reset,
    /// The driver chip switched the motor off because of its temperature.
    Overheated,
    /// The driver chip switched the motor off because a phase is shorted.
    Shorted,
    /// The driver chip switched the motor off, and temperature and phases are sound again.
    SwitchedOff,
    /// The supply of the driver chip is too low.
    Undervoltage,
    /// Another driver chip of the chain does not answer, so the board cannot reach this one.
    Unreachable,
}

impl DriveAlarm {
    /// All reasons, in the order of their codes from 1.
    pub const ALL: [Self; 14] = [
        Self::Input,
        Self::Unsupported,
        Self::StepsCut,
        Self::NoBus,
        Self::Setting,
        Self::Silent,
        Self::Disturbed,
        Self::NotSet,
        Self::Reset,
        Self::Overheated,
        Self::Shorted,
        Self::SwitchedOff,
        Self::Undervoltage,
        Self::Unreachable,
    ];

    /// Code of the reason, 1 to 15.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8 + 1
    }

    /// The reason with this code.
    #[must_use]
    pub fn of_code(code: u8) -> Option<Self> {
        let index = usize::from(code).checked_sub(1)?;
        Self::ALL.get(index).copied()
    }

    /// The driver chip of the joint causes it, and the board tries to set the chip again with the
    /// drives off.
    #[must_use]
    pub const fn is_of_chip(self) -> bool {
        self as u8 >= Self::Setting as u8
    }
}

/// Drives that report an alarm, and the reasons.
#[derive(Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Alarms(
    /// Four bits per joint: the code of its reason, 0 without an alarm.
    u32,
);

/// Bits of all joints.
const MASK: u32 = (1 << (4 * MAX_AXES)) - 1;

impl Alarms {
    /// The alarms with these bits, four per joint; the bits above are ignored.
    #[must_use]
    pub const fn of_bits(bits: u32) -> Self {
        Self(bits & MASK)
    }

    /// Four bits per joint: the code of its reason, 0 without an alarm.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0 & MASK
    }

    /// These alarms, with that of a joint replaced. A joint beyond the last one has none.
    #[must_use]
    pub const fn with(self, joint: usize, alarm: Option<DriveAlarm>) -> Self {
        if joint >= MAX_AXES {
            return self;
        }
        let code = match alarm {
            Some(alarm) => alarm.code() as u32,
            None => 0,
        };
        Self(self.0 & !(0xF << (4 * joint)) | code << (4 * joint))
    }

    /// Reason of a joint; `None` without an alarm.
    #[must_use]
    pub fn of(self, joint: usize) -> Option<DriveAlarm> {
        if joint >= MAX_AXES {
            return None;
        }
        match (self.0 >> (4 * joint) & 0xF) as u8 {
            0 => None,
            // A later version has a reason that this one does not know.
            code => Some(DriveAlarm::of_code(code).unwrap_or_default()),
        }
    }

    /// No drive reports an alarm.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.bits() == 0
    }

    /// Joints whose drives report an alarm, one bit each.
    #[must_use]
    pub fn joints(self) -> u8 {
        (0..MAX_AXES).fold(0, |all, joint| {
            all | u8::from(self.0 >> (4 * joint) & 0xF != 0) << joint
        })
    }
}

impl core::fmt::Debug for Alarms {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let joints = (0..MAX_AXES).filter_map(|joint| Some((joint, self.of(joint)?)));
        f.debug_map().entries(joints).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_reason_has_its_own_code_and_comes_back() {
        for (index, alarm) in DriveAlarm::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(alarm.code()), index + 1);
            assert_eq!(DriveAlarm::of_code(alarm.code()), Some(alarm));
            for joint in 0..MAX_AXES {
                let others = Alarms::of_bits(u32::MAX).with(joint, None);
                let alarms = others.with(joint, Some(alarm));
                assert_eq!((others.of(joint), alarms.of(joint)), (None, Some(alarm)));
                assert_eq!(alarms.joints(), 0b11_1111);
                assert_eq!(others.joints(), 0b11_1111 & !(1 << joint));
                assert_eq!(
                    Alarms::default().with(joint, Some(alarm)).joints(),
                    1 << joint
                );
            }
        }
        assert_eq!(DriveAlarm::of_code(0), None);
        assert_eq!(DriveAlarm::of_code(15), None);
        assert!(
            Alarms::default()
                .with(MAX_AXES, Some(DriveAlarm::Silent))
                .is_empty()
        );
        let of_chip = DriveAlarm::ALL
            .into_iter()
            .filter(|alarm| alarm.is_of_chip());
        assert_eq!(of_chip.count(), 10);
    }
}
