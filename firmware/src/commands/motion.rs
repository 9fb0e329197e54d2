//! Commands of jogs, sources and the feed override.

use super::conditions::{Done, in_state, settled};
use crate::config::HAPTICS;
use crate::core::Core;
use crate::haptics::mapping::MASTER_COORDINATES;
use haptimill_protocol::message::{
    AxisValues, MAX_AXES, OverrideMode, RATE_SHIFT, Refusal, Source, State,
};

pub(super) fn jog(core: &mut Core, epoch: u16, timeout_ms: u16, rates: &AxisValues) -> Done {
    if !core.safety.homed() {
        return Err(Refusal::NotHomed);
    }
    settled(core)?;
    if !(1..=1000).contains(&timeout_ms) {
        return Err(Refusal::Range);
    }
    // Epochs wrap around: one is older when it lies less than half the range behind.
    let age = epoch_age(core, epoch);
    if age > 0 || (age == 0 && core.job.jog_cancelled) {
        return Err(Refusal::OldEpoch);
    }
    let period_us = u32::from(core.period_us);
    let state = core.safety.state();
    let machine = core.machine.as_mut().ok_or(Refusal::NotConfigured)?;
    if rates.len() != machine.axes() {
        return Err(Refusal::CoordinateCount);
    }
    let beside_program =
        matches!(state, State::Run | State::Hold) && machine.motion.has_jog_source();
    if core.job.stopping || !(beside_program || matches!(state, State::Idle | State::Jog)) {
        return Err(Refusal::State(state));
    }
    machine.check_inputs(false)?;
    if state == State::Idle {
        machine.motion.begin_jog(true);
        core.safety.enter(State::Jog);
    }
    let mut commanded = [0_i64; MAX_AXES];
    for (index, (slot, rate)) in commanded.iter_mut().zip(rates).enumerate() {
        if !beside_program || machine.motion.source(index) == Source::Jog {
            *slot = i64::from(*rate) << RATE_SHIFT;
        }
    }
    machine
        .motion
        .jog
        .set_rates(&commanded, u32::from(timeout_ms) * 1000 / period_us);
    core.job.jog_epoch = Some(epoch);
    core.job.jog_cancelled = false;
    Ok(())
}

/// Number of epochs by which this one is older than the newest; negative when it is newer or when
/// there is none yet.
fn epoch_age(core: &Core, epoch: u16) -> i16 {
    core.job
        .jog_epoch
        .map_or(-1, |newest| newest.wrapping_sub(epoch) as i16)
}

pub(super) fn cancel_jog(core: &mut Core, epoch: u16) -> Done {
    if epoch_age(core, epoch) <= 0 {
        core.job.jog_epoch = Some(epoch);
        core.job.jog_cancelled = true;
        if let Some(machine) = &mut core.machine
            && core.safety.state() != State::Homing
        {
            machine.motion.jog.release();
        }
    }
    Ok(())
}

/// Selects the source of a coordinate.
///
/// A change to or from jog needs standstill; other changes are allowed while the coordinate moves.
/// The command is also accepted while a fault is latched: a broken master would otherwise latch
/// its fault again after each reset.
pub(super) fn choose_source(core: &mut Core, coordinate: u8, source: Source) -> Done {
    in_state(core, &[State::Idle, State::Hold, State::Run, State::Fault])?;
    let state = core.safety.state();
    let machine = core.configured()?;
    if usize::from(coordinate) >= machine.axes() {
        return Err(Refusal::Range);
    }
    let follows =
        HAPTICS && machine.config.follow.is_some() && usize::from(coordinate) < MASTER_COORDINATES;
    if source == Source::Master && !follows {
        return Err(Refusal::NoMaster);
    }
    // Without the feature `haptics` no source takes over a moving coordinate.
    let jogs = !HAPTICS
        || source == Source::Jog
        || machine.motion.source(usize::from(coordinate)) == Source::Jog;
    if jogs && state == State::Run {
        return Err(Refusal::State(state));
    }
    if jogs && state == State::Hold && !machine.motion.is_at_standstill() {
        return Err(Refusal::State(state));
    }
    machine.masters.mapping.release_one(usize::from(coordinate));
    machine.motion.set_source(usize::from(coordinate), source);
    Ok(())
}

pub(super) fn set_override(core: &mut Core, percent: u8) -> Done {
    if percent > OverrideMode::MAX_PERCENT {
        return Err(Refusal::Range);
    }
    core.configured()?.motion.program.set_override(percent);
    Ok(())
}

pub(super) fn set_rapid_override(core: &mut Core, percent: u8) -> Done {
    if percent > 100 {
        return Err(Refusal::Range);
    }
    core.configured()?
        .motion
        .program
        .set_rapid_override(percent);
    Ok(())
}

pub(super) fn set_spindle_override(core: &mut Core, percent: u8) -> Done {
    if !(10..=200).contains(&percent) {
        return Err(Refusal::Range);
    }
    core.job.spindle_percent = percent;
    Ok(())
}
