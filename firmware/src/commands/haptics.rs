//! Commands of the haptic arm and of the remote master.

use super::conditions::Done;
use crate::config::HAPTICS;
use crate::core::Core;
use crate::force::sensor::COMPONENTS;
use crate::haptics::Haptic;
use crate::haptics::config::scale_is_sound;
use crate::haptics::feedback_law;
use haptimill_math::{Length, Rate};
use haptimill_protocol::haptic::{ForceFeedback, MasterPose, VirtualFixture};
use haptimill_protocol::message::{RATE_SHIFT, Refusal};

pub(super) fn haptic_arm(core: &mut Core) -> Result<&mut Haptic, Refusal> {
    let machine = core.configured()?;
    machine.masters.arm_mut().ok_or(Refusal::NoMaster)
}

/// Stores a pose of the remote master. Its epochs work as those of jogs.
pub(super) fn set_remote_master(
    core: &mut Core,
    epoch: u16,
    age_ms: u8,
    master: &MasterPose,
) -> Done {
    if !HAPTICS || core.configured()?.config.follow.is_none() {
        return Err(Refusal::NoMaster);
    }
    let newest = core.job.master_epoch;
    let age = newest.map_or(-1, |newest| newest.wrapping_sub(epoch) as i16);
    if age > 0 || (age == 0 && core.job.master_cancelled) {
        return Err(Refusal::OldEpoch);
    }
    core.job.master_epoch = Some(epoch);
    core.job.master_cancelled = false;
    core.configured()?.set_remote_master(master, age_ms);
    Ok(())
}

pub(super) fn set_feedback(core: &mut Core, settings: &ForceFeedback) -> Done {
    let arm = haptic_arm(core)?;
    if !feedback_law::is_sound(settings) {
        return Err(Refusal::Range);
    }
    arm.set_feedback(settings);
    Ok(())
}

pub(super) fn set_fixture(
    core: &mut Core,
    axis: u8,
    upper: bool,
    fixture: Option<VirtualFixture>,
) -> Done {
    let arm = haptic_arm(core)?;
    let fixture = match fixture {
        None => None,
        Some(VirtualFixture { at, rate }) => {
            let rate = rate.checked_mul(1 << RATE_SHIFT).ok_or(Refusal::Range)?;
            Some((at.map(Length), Rate(rate)))
        }
    };
    if usize::from(axis) >= COMPONENTS {
        return Err(Refusal::Range);
    }
    arm.set_fixture(usize::from(axis), upper, fixture)
        .map_err(|_| Refusal::FixturesTooNear)
}

/// Latches master and tool positions anew, so the tool does not jump.
pub(super) fn set_position_scale(core: &mut Core, scale: u16) -> Done {
    let machine = core.configured()?;
    if !HAPTICS || machine.config.follow.is_none() {
        return Err(Refusal::NoMaster);
    }
    if !scale_is_sound(scale) {
        return Err(Refusal::Range);
    }
    let frame = machine.master();
    machine.masters.mapping.set_scale(scale, frame.as_ref());
    Ok(())
}
