//! The hand in the machine: the haptic arm that it has, the hand afar that it hears of, and how they lead its coordinates.
//!
//! Misuse: leading without [`Machinery::release_hand`] when the machine brakes. The hand would be latched where it was before.

use super::{HAND_PART, Machinery};
use crate::io::{HapticInputs, HapticOutputs, LEGS};
use crate::reflection::config::Encoder;
use crate::reflection::lead::{Afar, Frame, Lead};
use crate::reflection::{HandProblem, Haptic, Zero};
use crate::safety::integrity::Digest;
use haptimill_protocol::haptic::Hand;

/// Whether this controller was built for a hand (feature `hand`). Where it was not, a configuration with one is refused, and the compiler leaves out what nothing can reach.
pub const HAND: bool = cfg!(feature = "hand");

/// What leads, of the hands that can.
#[derive(Debug, Default)]
pub struct Hands {
    /// The arm.
    pub arm: Option<Haptic>,
    /// The hand afar.
    pub afar: Afar,
    /// From the hand to the tool.
    pub lead: Lead,
    periods_per_second: u32,
    /// Periods after which a word of the hand afar is too old.
    stale: u32,
}

impl Hands {
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
pub type HandStanding = ([[Encoder; 3]; LEGS], Zero);

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

impl Machinery {
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
        self.hands.arm = haptic.map(|haptic| Haptic::new(haptic, period_us, inputs));
        self.hands.periods_per_second = per_second;
        if let Some(follow) = &config.follow {
            self.hands.lead = Lead::new(follow.scale);
            self.hands.stale = u32::from(follow.stale_ms) * per_second / 1000;
        }
    }

    /// What the counts of the haptic arm mean.
    #[must_use]
    pub fn hand_standing(&self) -> Option<HandStanding> {
        let sensors = self.config.haptic.as_ref()?.sensors;
        Some((sensors, self.hands.arm()?.zero()))
    }

    /// Takes over what the counts of the haptic arm mean, if they mean the same under both configurations.
    pub fn take_over_hand(&mut self, (sensors, zero): &HandStanding) {
        if let (Some(own), Some(haptic)) = (self.hands.arm_mut(), &self.config.haptic)
            && haptic.sensors == *sensors
        {
            own.take_over(zero);
        }
    }

    /// The haptic part of stage *sense*.
    #[inline]
    pub fn sense_hand(&mut self, inputs: &HapticInputs) {
        if HAND {
            self.hands.afar.grow();
        }
        if let Some(arm) = self.hands.arm_mut() {
            arm.sense(inputs);
        }
    }

    /// A new word of a hand afar, so many milliseconds old.
    pub fn hear_hand(&mut self, hand: &Hand, age_ms: u8) {
        let age = u32::from(age_ms) * self.hands.periods_per_second / 1000;
        self.hands.afar.hear(hand, age);
    }

    /// The hand that can lead: that on the arm here, or the one afar.
    #[must_use]
    pub fn hand(&self) -> Option<Frame> {
        match self.hands.arm() {
            Some(arm) => arm.frame(),
            None if !HAND => None,
            None => self.hands.afar.frame(self.hands.periods_per_second),
        }
    }

    /// The hand leads the coordinates that are given to it, if its button is held.
    #[inline]
    pub fn lead(&mut self) -> Leading {
        if HAND {
            self.lead_by_hand()
        } else {
            Leading::No
        }
    }

    #[inline(never)]
    fn lead_by_hand(&mut self) -> Leading {
        let mask = self.motion.hand_mask();
        let afar = self.hands.arm().is_none();
        let age = self.hands.afar.age().unwrap_or(u32::MAX);
        let late = afar && age > self.hands.stale;
        let frame = self
            .hand()
            .filter(|frame| frame.engaged && !late && mask != 0);
        let Some(frame) = frame else {
            let led = self.hands.lead.leads();
            self.release_hand();
            if late && led && mask != 0 {
                let age_ms = u64::from(age) * u64::from(self.config.period_us) / 1000;
                return Leading::Lost(age_ms.min(u64::from(u16::MAX)) as u16);
            }
            return Leading::No;
        };
        let motion = &self.motion;
        self.hands
            .lead
            .follow(&frame, mask, |axis| motion.rest(axis));
        self.motion.lead(self.hands.lead.targets());
        Leading::Yes
    }

    /// Nothing is led; the next time that it is, hand and tool are latched where they are then.
    #[inline]
    pub fn release_hand(&mut self) {
        if !HAND {
            return;
        }
        self.hands.lead.release();
        self.motion.lead(self.hands.lead.targets());
    }

    /// Stage *feel*.
    #[inline]
    pub fn feel(&mut self, powered: bool, outputs: &mut HapticOutputs) {
        if self.hands.arm().is_some() {
            self.feel_by_hand(powered, outputs);
        }
    }

    #[inline(never)]
    fn feel_by_hand(&mut self, powered: bool, outputs: &mut HapticOutputs) {
        let Some(arm) = self.hands.arm.as_mut() else {
            return;
        };
        let here = !self.joints.is_empty();
        let leads = if here {
            self.hands.lead.leads()
        } else {
            arm.frame().is_some_and(|frame| frame.engaged)
        };
        // A sensor without a zero, or one that cannot be believed, is not felt.
        let tool = self
            .force
            .as_ref()
            .filter(|force| force.conditioner().tared() && force.believed());
        let tool = tool.map(|force| force.extremes().map(|extremes| extremes.peak()));
        let tool = if here {
            Some(tool.unwrap_or_default())
        } else {
            None
        };
        arm.feel(tool, leads, powered, outputs);
    }

    /// A problem of the haptic arm that was not told yet.
    pub fn take_hand_problem(&mut self) -> Option<HandProblem> {
        self.hands.arm_mut()?.take_problem()
    }

    /// Whether the machine is there for the hand alone, or a hand leads it: what is wrong with the arm is then its own fault.
    #[must_use]
    pub fn depends_on_hand(&self) -> bool {
        self.joints.is_empty() || self.motion.hand_mask() != 0
    }

    pub(super) fn digest_hand(&self, digest: &mut Digest) {
        const { assert!(HAND_PART < super::PARTS) };
        if !HAND {
            return;
        }
        digest.add(&(&self.config.haptic, &self.config.follow));
        digest.add(&(self.hands.periods_per_second, self.hands.stale));
        if let Some(arm) = self.hands.arm() {
            arm.digest(digest);
        }
    }
}
