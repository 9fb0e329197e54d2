//! What the machine may do: states, latched faults, and whether the position is kept.
//!
//! | state | drives | left by |
//! | --- | --- | --- |
//! | Disabled | off | enable |
//! | Idle | holding | home, job, jog, disable |
//! | Homing | moving | found, failed, stop |
//! | Run | moving | last setpoint, hold, stop, fault |
//! | Hold | braking along the path, then holding | resume, stop |
//! | Jog | moving | deadline, cancel, stop |
//! | Fault (latched) | off, or holding | reset |
//! | EmergencyStop (latched) | off | reset |
//!
//! A fault in which the controller still has the machine in hand (lost host, late periods, a soft limit, a joint rate, the force sensor or what it feels, the haptic arm) first brakes along the path and
//! then latches, with the drives holding. Any other fault takes the drives off in the same period. Every stop says whether the position is
//! kept: it is lost when an encoder or the configuration cannot be believed, steps were lost, or a joint is not measured where it was commanded or can be.

pub mod homing;
pub mod integrity;
pub mod supervise;

use haptimill_protocol::message::{Event, Fault, State};
use heapless::Deque;

/// Events that wait to be told.
pub const EVENTS: usize = 16;

/// State, latched fault and position.
#[derive(Debug, Default)]
pub struct Safety {
    state: State,
    fault: Option<Fault>,
    /// A fault that latches when the machine has come to rest on its path.
    pending: Option<Fault>,
    /// The drives hold although a fault is latched.
    holding: bool,
    /// A fault that was latched and that [`Safety::take_latched`] has not told.
    latched: Option<Fault>,
    homed: bool,
    position_kept: bool,
    events: Deque<Event, EVENTS>,
    events_lost: u32,
}

/// Whether the controller still has the machine in hand: it brakes along the path, and the drives go on holding.
#[must_use]
pub const fn brakes_first(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::LostHost { .. }
            | Fault::LatePeriod { .. }
            | Fault::SoftLimit { .. }
            | Fault::JointRate { .. }
            | Fault::Force(_)
            | Fault::Hand(_)
    )
}

/// Whether it is a joint that does something else than it was told. While the machine brakes for missed periods, in which nobody told it anything, that
/// is what they have led to: the drives go off for it, but what is named is the cause, and the encoders have counted all along.
const fn is_of_joint(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::FollowingError { .. } | Fault::EncoderStill { .. } | Fault::EncoderReversed { .. }
    )
}

/// Whether the position is still known after a fault: nothing of its evidence can come from an encoder whose counts are wrong.
#[must_use]
pub const fn keeps_position(fault: &Fault) -> bool {
    suspected(fault).is_none()
        && !matches!(
            fault,
            Fault::EncoderIllegal { .. } | Fault::EncoderSlip { .. } | Fault::Configuration
        )
}

/// The joint whose encoder is under suspicion after a fault. It was not measured where it was
/// commanded, or not where it can be, or it disagrees with the steps of its motor. It may have been
/// pushed or held as well, and the encoder counted all of it: an index pulse in its place confirms
/// the encoder.
#[must_use]
pub const fn suspected(fault: &Fault) -> Option<u8> {
    match fault {
        Fault::EncoderStill { axis }
        | Fault::EncoderReversed { axis }
        | Fault::FollowingError { axis, .. }
        | Fault::Stroke { axis, .. }
        | Fault::LimitSwitch { axis }
        | Fault::StepsLost { axis, .. } => Some(*axis),
        _ => None,
    }
}

impl Safety {
    /// The state.
    #[must_use]
    #[inline]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The latched fault.
    #[must_use]
    #[inline]
    pub const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// The fault for which the machine is braking.
    #[must_use]
    #[inline]
    pub const fn pending(&self) -> Option<Fault> {
        self.pending
    }

    /// All joints have their reference.
    #[must_use]
    pub const fn homed(&self) -> bool {
        self.homed
    }

    /// The position is known to be right.
    #[must_use]
    pub const fn position_kept(&self) -> bool {
        self.position_kept
    }

    /// Whether a fault was latched that was not [taken](Safety::take_latched) yet.
    #[must_use]
    #[inline]
    pub const fn has_latched(&self) -> bool {
        self.latched.is_some()
    }

    /// A fault that was latched since the last call.
    pub fn take_latched(&mut self) -> Option<Fault> {
        self.latched.take()
    }

    /// The position cannot be relied on any more.
    pub fn lose_position(&mut self) {
        self.position_kept = false;
        self.homed = false;
    }

    /// Whether the drives are to be on in this state.
    #[must_use]
    #[inline]
    pub const fn drives_on(&self) -> bool {
        match self.state {
            State::Idle | State::Homing | State::Run | State::Jog | State::Hold => true,
            State::Fault => self.holding,
            State::Disabled | State::EmergencyStop => false,
        }
    }

    /// Whether something moves, or may begin to move without being asked again.
    #[must_use]
    #[inline]
    pub const fn active(&self) -> bool {
        matches!(
            self.state,
            State::Homing | State::Run | State::Jog | State::Hold
        )
    }

    /// Goes to a state and tells it.
    #[inline(never)]
    pub fn enter(&mut self, state: State) {
        if state != self.state {
            let from = core::mem::replace(&mut self.state, state);
            #[cfg(feature = "defmt")]
            defmt::info!("{} -> {}", from, state);
            self.tell(Event::State {
                from,
                to: state,
                position_kept: self.position_kept,
            });
        }
    }

    /// The reference is found, or given up.
    pub fn set_homed(&mut self, homed: bool) {
        self.homed = homed;
        self.position_kept = homed;
        if homed {
            self.tell(Event::Homed);
        }
    }

    /// A fault: brakes first where that is right, else latches now. The first one stays.
    #[inline(never)]
    pub fn raise(&mut self, fault: Fault) {
        if brakes_first(&fault) && self.active() {
            self.pending.get_or_insert(fault);
        } else {
            self.latch(fault);
        }
    }

    /// Latches the fault for which the machine was braking; it is at rest.
    pub fn settle(&mut self) {
        if let Some(fault) = self.pending {
            self.latch(fault);
        }
    }

    fn latch(&mut self, fault: Fault) {
        // A latched fault gives way only to one for which the drives that it let hold must go off.
        if matches!(self.state, State::EmergencyStop)
            || (matches!(self.state, State::Fault) && (!self.holding || brakes_first(&fault)))
        {
            return;
        }
        let on = self.drives_on();
        self.holding = on && brakes_first(&fault);
        let fault = match self.pending.take() {
            Some(late @ Fault::LatePeriod { .. }) if is_of_joint(&fault) => late,
            _ => fault,
        };
        if !keeps_position(&fault) {
            self.lose_position();
        }
        self.fault = Some(fault);
        #[cfg(feature = "defmt")]
        defmt::error!("fault latched: {}", fault);
        self.latched = Some(fault);
        self.tell(Event::Fault(fault));
        self.enter(State::Fault);
    }

    /// The emergency stop: drives off, latched.
    pub fn emergency_stop(&mut self) {
        self.pending = None;
        self.holding = false;
        self.enter(State::EmergencyStop);
    }

    /// Clears what is latched; true if something was.
    pub fn reset(&mut self) -> bool {
        let latched = matches!(self.state, State::Fault | State::EmergencyStop);
        if latched {
            let next = if self.holding {
                State::Idle
            } else {
                State::Disabled
            };
            self.fault = None;
            self.pending = None;
            self.holding = false;
            self.enter(next);
        }
        latched
    }

    /// Puts an event into the queue. When nobody listened for so long that it is full, the oldest gives way and is counted: what happened
    /// last explains how things stand.
    #[inline(never)]
    pub fn tell(&mut self, event: Event) {
        if self.events.is_full() {
            self.events.pop_front();
            self.events_lost = self.events_lost.saturating_add(1);
        }
        // There is room: made above.
        let _ = self.events.push_back(event);
    }

    /// Events that gave way because nobody listened for too long.
    #[must_use]
    pub const fn events_lost(&self) -> u32 {
        self.events_lost
    }

    /// Whether there are events that were not told yet.
    #[must_use]
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    /// The oldest event that was not told yet.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Puts an event back that could not be told now.
    pub fn return_event(&mut self, event: Event) {
        if self.events.push_front(event).is_err() {
            self.events_lost = self.events_lost.saturating_add(1);
        }
    }
}
