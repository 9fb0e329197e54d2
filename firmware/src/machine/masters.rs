//! The hand in the machine: the haptic arm that it has, the hand afar that it hears of, and how they lead its coordinates.
//!
//! Misuse: leading without [`Machine::release_master`] when the machine brakes. The hand would be latched where it was before.

use super::{HAND_PART, Machine};
use crate::config::HAND;
use crate::config::digest::Digest;
use crate::haptics::config::Encoder;
use crate::haptics::mapping::{Frame, MasterMapping, RemoteMaster};
use crate::haptics::{HandProblem, Haptic, Zero};
use crate::io::{HapticInputs, HapticOutputs, LEGS};
use haptimill_protocol::haptic::Hand;

/// What leads, of the hands that can.
#[derive(Debug, Default)]
pub struct Masters {
    /// The arm.
    pub arm: Option<Haptic>,
    /// The hand afar.
    pub remote: RemoteMaster,
    /// From the hand to the tool.
    pub mapping: MasterMapping,
    periods_per_second: u32,
    /// Periods after which a word of the hand afar is too old.
    stale: u32,
}

impl Masters {
    /// The arm, for reading.
    #[must_use]
    #[inline]
    pub const fn arm(&self) -> Option<&Haptic> {
        if HAND { self.arm.as_ref() } else { None }
    }

    /// The arm.
    #[inline]
    pub const fn arm_mut(&mut self) -> Option<&mut Haptic> {
        if HAND { self.arm.as_mut() } else { None }
    }
}

/// The encoders of a haptic arm, and what they showed at its home.
pub type HapticEncoderState = ([[Encoder; 3]; LEGS], Zero);

/// How a hand stands to the tool in a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leading {
    /// Nothing is led.
    No,
    /// It leads.
    Yes,
    /// It led, and nothing new was heard of it for so many milliseconds.
    Lost(u16),
}

impl Machine {
    #[cold]
    #[inline(never)]
    pub(super) fn set_up_hand(&mut self, inputs: &HapticInputs) {
        if !HAND {
            return;
        }
        let config = &self.config;
        let period_us = config.period_us;
        let per_second = 1_000_000 / u32::from(period_us.max(1));
        let haptic = config.haptic.as_ref();
        self.masters.arm = haptic.map(|haptic| Haptic::new(haptic, period_us, inputs));
        self.masters.periods_per_second = per_second;
        if let Some(follow) = &config.follow {
            self.masters.mapping = MasterMapping::new(follow.scale);
            self.masters.stale = u32::from(follow.stale_ms) * per_second / 1000;
        }
    }

    /// What the counts of the haptic arm mean.
    #[must_use]
    pub fn haptic_encoder_state(&self) -> Option<HapticEncoderState> {
        let sensors = self.config.haptic.as_ref()?.sensors;
        Some((sensors, self.masters.arm()?.zero()))
    }

    /// Takes over what the counts of the haptic arm mean, if they mean the same under both configurations.
    pub fn take_over_haptics(&mut self, (sensors, zero): &HapticEncoderState) {
        if let (Some(own), Some(haptic)) = (self.masters.arm_mut(), &self.config.haptic)
            && haptic.sensors == *sensors
        {
            own.take_over(zero);
        }
    }

    /// The haptic part of stage *sense*.
    #[inline]
    pub fn measure_haptics(&mut self, inputs: &HapticInputs) {
        if HAND {
            self.masters.remote.grow();
        }
        if let Some(arm) = self.masters.arm_mut() {
            arm.measure(inputs);
        }
    }

    /// A new word of a hand afar, so many milliseconds old.
    pub fn set_remote_master(&mut self, hand: &Hand, age_ms: u8) {
        let age = u32::from(age_ms) * self.masters.periods_per_second / 1000;
        self.masters.remote.hear(hand, age);
    }

    /// The hand that can lead: that on the arm here, or the one afar.
    #[must_use]
    pub fn hand(&self) -> Option<Frame> {
        match self.masters.arm() {
            Some(arm) => arm.frame(),
            None if !HAND => None,
            None => self.masters.remote.frame(self.masters.periods_per_second),
        }
    }

    /// The hand leads the coordinates that are given to it, if its button is held.
    #[inline]
    pub fn advance_master(&mut self) -> Leading {
        if HAND {
            self.follow_master()
        } else {
            Leading::No
        }
    }

    #[inline(never)]
    fn follow_master(&mut self) -> Leading {
        let mask = self.motion.hand_mask();
        let remote = self.masters.arm().is_none();
        let age = self.masters.remote.age().unwrap_or(u32::MAX);
        let late = remote && age > self.masters.stale;
        let frame = self
            .hand()
            .filter(|frame| frame.engaged && !late && mask != 0);
        let Some(frame) = frame else {
            let led = self.masters.mapping.leads();
            self.release_master();
            if late && led && mask != 0 {
                let age_ms = u64::from(age) * u64::from(self.config.period_us) / 1000;
                return Leading::Lost(age_ms.min(u64::from(u16::MAX)) as u16);
            }
            return Leading::No;
        };
        let motion = &self.motion;
        self.masters
            .mapping
            .follow(&frame, mask, |axis| motion.rest(axis));
        self.motion
            .set_master_targets(self.masters.mapping.targets());
        Leading::Yes
    }

    /// Nothing is led; the next time that it is, hand and tool are latched where they are then.
    #[inline]
    pub fn release_master(&mut self) {
        if !HAND {
            return;
        }
        self.masters.mapping.release();
        self.motion
            .set_master_targets(self.masters.mapping.targets());
    }

    /// Stage *feel*.
    #[inline]
    pub fn render(&mut self, powered: bool, outputs: &mut HapticOutputs) {
        if self.masters.arm().is_some() {
            self.render_haptics(powered, outputs);
        }
    }

    #[inline(never)]
    fn render_haptics(&mut self, powered: bool, outputs: &mut HapticOutputs) {
        let Some(arm) = self.masters.arm.as_mut() else {
            return;
        };
        let here = !self.joints.is_empty();
        let leads = if here {
            self.masters.mapping.leads()
        } else {
            arm.frame().is_some_and(|frame| frame.engaged)
        };
        // A sensor without a zero, or one that cannot be believed, is not felt.
        let tool = self
            .force
            .as_ref()
            .filter(|force| force.conditioner().tared() && force.is_valid());
        let tool = tool.map(|force| force.extremes().map(|extremes| extremes.peak()));
        let tool = if here {
            Some(tool.unwrap_or_default())
        } else {
            None
        };
        arm.render(tool, leads, powered, outputs);
    }

    /// A problem of the haptic arm that was not told yet.
    pub fn take_haptic_problem(&mut self) -> Option<HandProblem> {
        self.masters.arm_mut()?.take_problem()
    }

    /// Whether the machine is there for the hand alone, or a hand leads it: what is wrong with the arm is then its own fault.
    #[must_use]
    pub fn is_led_by_haptics(&self) -> bool {
        self.joints.is_empty() || self.motion.hand_mask() != 0
    }

    pub(super) fn digest_hand(&self, digest: &mut Digest) {
        const { assert!(HAND_PART < super::PARTS) };
        if !HAND {
            return;
        }
        digest.add(&(&self.config.haptic, &self.config.follow));
        digest.add(&(self.masters.periods_per_second, self.masters.stale));
        if let Some(arm) = self.masters.arm() {
            arm.digest(digest);
        }
    }
}
