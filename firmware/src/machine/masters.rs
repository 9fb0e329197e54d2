//! Masters of the machine: its own haptic arm, or a remote master, and the mapping from the master
//! to the coordinates of the tool.
//!
//! Callers must use [`Machine::release_master`] when the machine decelerates. Otherwise the mapping
//! keeps the old positions of master and tool.

use super::Machine;
use super::configure::HAPTICS_PART;
use crate::config::HAPTICS;
use crate::digest::Digest;
use crate::haptics::config::Encoder;
use crate::haptics::mapping::{HandleFrame, MasterMapping, RemoteMaster};
use crate::haptics::{Haptic, MasterProblem, Zero};
use crate::io::{HapticInputs, HapticOutputs, LEGS};
use haptimill_protocol::haptic::MasterPose;

/// The masters, and their mapping to the tool.
#[derive(Debug, Default)]
pub struct Masters {
    /// The haptic arm, if the machine has one.
    pub arm: Option<Haptic>,
    /// The remote master.
    pub remote: RemoteMaster,
    /// Master-to-tool mapping.
    pub mapping: MasterMapping,
    periods_per_second: u32,
    /// Age in periods above which a remote master pose is stale.
    stale: u32,
}

impl Masters {
    /// The haptic arm, for reading; `None` without the feature `haptics`.
    #[must_use]
    #[inline]
    pub const fn arm(&self) -> Option<&Haptic> {
        if HAPTICS { self.arm.as_ref() } else { None }
    }

    /// The haptic arm; `None` without the feature `haptics`.
    #[inline]
    pub const fn arm_mut(&mut self) -> Option<&mut Haptic> {
        if HAPTICS { self.arm.as_mut() } else { None }
    }
}

/// Encoder scalings of a haptic arm, and the counts at its home.
pub type HapticEncoderState = ([[Encoder; 3]; LEGS], Zero);

/// Whether a master moves the tool in a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MasterMotion {
    /// No master moves it.
    No,
    /// A master moves it.
    Yes,
    /// The remote master moved it, and its last pose is stale: its age in ms.
    Lost(u16),
}

impl Machine {
    #[cold]
    #[inline(never)]
    pub(super) fn configure_haptics(&mut self, inputs: &HapticInputs) {
        if !HAPTICS {
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

    /// Encoder scalings and zero of the haptic arm.
    #[must_use]
    pub fn haptic_encoder_state(&self) -> Option<HapticEncoderState> {
        let sensors = self.config.haptic.as_ref()?.sensors;
        Some((sensors, self.masters.arm()?.zero()))
    }

    /// Takes over the zero of the haptic arm from another configuration if the encoder scalings are
    /// equal.
    pub fn take_over_haptics(&mut self, (sensors, zero): &HapticEncoderState) {
        if let (Some(own), Some(haptic)) = (self.masters.arm_mut(), &self.config.haptic)
            && haptic.sensors == *sensors
        {
            own.take_over(zero);
        }
    }

    /// Stage *measure*, haptic part.
    #[inline]
    pub fn measure_haptics(&mut self, inputs: &HapticInputs) {
        if HAPTICS {
            self.masters.remote.grow();
        }
        if let Some(arm) = self.masters.arm_mut() {
            arm.measure(inputs);
        }
    }

    /// Stores a pose of the remote master, `age_ms` milliseconds old.
    pub fn set_remote_master(&mut self, master: &MasterPose, age_ms: u8) {
        let age = u32::from(age_ms) * self.masters.periods_per_second / 1000;
        self.masters.remote.set_sample(master, age);
    }

    /// Pose of the master that can move the tool: the haptic arm if there is one, otherwise the
    /// remote master.
    #[must_use]
    pub fn master(&self) -> Option<HandleFrame> {
        match self.masters.arm() {
            Some(arm) => arm.frame(),
            None if !HAPTICS => None,
            None => self.masters.remote.frame(self.masters.periods_per_second),
        }
    }

    /// Moves the coordinates whose source is the master, while its enabling switch is pressed.
    #[inline]
    pub fn advance_master(&mut self) -> MasterMotion {
        if HAPTICS {
            self.follow_master()
        } else {
            MasterMotion::No
        }
    }

    #[inline(never)]
    fn follow_master(&mut self) -> MasterMotion {
        let mask = self.motion.master_mask();
        let remote = self.masters.arm().is_none();
        let age = self.masters.remote.age().unwrap_or(u32::MAX);
        let late = remote && age > self.masters.stale;
        let frame = self
            .master()
            .filter(|frame| frame.enabling_switch && !late && mask != 0);
        let Some(frame) = frame else {
            let moved = self.masters.mapping.is_active();
            self.release_master();
            if late && moved && mask != 0 {
                let age_ms = u64::from(age) * u64::from(self.config.period_us) / 1000;
                return MasterMotion::Lost(age_ms.min(u64::from(u16::MAX)) as u16);
            }
            return MasterMotion::No;
        };
        let motion = &self.motion;
        self.masters
            .mapping
            .follow(&frame, mask, |axis| motion.standstill_position(axis));
        self.motion
            .set_master_targets(self.masters.mapping.targets());
        MasterMotion::Yes
    }

    /// Ends the motion of the tool by the master. The next one latches the positions of master and
    /// tool at its start.
    #[inline]
    pub fn release_master(&mut self) {
        if !HAPTICS {
            return;
        }
        self.masters.mapping.release();
        self.motion
            .set_master_targets(self.masters.mapping.targets());
    }

    /// Stage *render*: force feedback to the haptic arm.
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
        let moves_tool = if here {
            self.masters.mapping.is_active()
        } else {
            arm.frame().is_some_and(|frame| frame.enabling_switch)
        };
        // A sensor that is invalid or not tared gives no force feedback.
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
        arm.render(tool, moves_tool, powered, outputs);
    }

    /// A problem of the haptic arm that was not reported yet.
    pub fn take_haptic_problem(&mut self) -> Option<MasterProblem> {
        self.masters.arm_mut()?.take_problem()
    }

    /// Whether a problem of the haptic arm is a fault: the machine has no axes of its own, or a
    /// master is the source of a coordinate.
    #[must_use]
    pub fn is_led_by_haptics(&self) -> bool {
        self.joints.is_empty() || self.motion.master_mask() != 0
    }

    pub(super) fn digest_haptics(&self, digest: &mut Digest) {
        const { assert!(HAPTICS_PART < super::PARTS) };
        if !HAPTICS {
            return;
        }
        digest.add(&(&self.config.haptic, &self.config.follow));
        digest.add(&(self.masters.periods_per_second, self.masters.stale));
        if let Some(arm) = self.masters.arm() {
            arm.digest(digest);
        }
    }
}
