//! Safety state machine: states, latched faults, and whether the position is kept.
//!
//! | state | drives | left by |
//! | --- | --- | --- |
//! | Disabled | off | enable, move off a limit switch |
//! | Idle | holding | home, job, jog, disable |
//! | Homing, moving off a limit switch | moving | success, failure, stop |
//! | Run | moving | last setpoint, hold, stop, fault |
//! | Hold | decelerating along the path, then holding | resume, stop |
//! | Jog | moving | jog timeout, cancel, stop |
//! | Fault (latched) | off, or holding | reset |
//! | EmergencyStop (latched) | off | reset |
//!
//! After some faults the machine still follows its commands: lost host, missed periods, a soft
//! limit, a joint rate, the force sensor or its force, the haptic arm, a probe. The machine then
//! decelerates along the path first, the fault latches at standstill, and the drives hold. Any
//! other fault commands the drives off in the same period.
//!
//! Every stop reports whether the position is kept. It is lost when an encoder or the configuration
//! is invalid, when steps were lost, or when a joint is measured away from its command or outside
//! its stroke. A joint without an encoder loses it whenever its drive goes off, because no sensor
//! measures its motor then.

pub mod homing;
pub mod switch_search;

use haptimill_protocol::message::{Event, Fault, State};
use heapless::Deque;

/// Size of the event queue.
pub const EVENTS: usize = 16;

/// State, latched fault and position.
#[derive(Debug, Default)]
pub struct Safety {
    state: State,
    fault: Option<Fault>,
    /// A fault that latches when the machine is at standstill on its path.
    pending: Option<Fault>,
    /// The drives hold while a fault is latched.
    holding: bool,
    /// A latched fault that [`Safety::take_latched`] has not returned yet.
    latched: Option<Fault>,
    homed: bool,
    /// A joint has no encoder and nothing holds it without its drive: its position is lost then.
    loses_position_without_drives: bool,
    /// A joint has no encoder: an alarm of a drive loses the position.
    open_loop: bool,
    /// The position of an open-loop joint was lost, and [`Safety::take_position_loss`] has not
    /// returned that yet.
    position_lost: bool,
    events: Deque<Event, EVENTS>,
    events_lost: u32,
}

/// Whether the machine decelerates along the path on this fault, with drives that hold afterwards.
#[must_use]
pub const fn decelerates_first(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::LostHost { .. }
            | Fault::MissedPeriods { .. }
            | Fault::SoftLimit { .. }
            | Fault::JointRate { .. }
            | Fault::Force(_)
            | Fault::Master(_)
            | Fault::ProbeContact { .. }
    )
}

/// Whether a joint does not follow its command in this fault.
///
/// Missed periods can cause such a fault, because the joint got no command in them. If it occurs
/// while the machine decelerates for missed periods, the drives go off, but the missed periods are
/// reported as the cause. The position is lost, because an encoder can fail in the same moment.
const fn is_of_joint(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::FollowingError { .. } | Fault::EncoderStuck { .. } | Fault::EncoderReversed { .. }
    )
}

/// Whether the position is still known after a fault: no encoder is suspected or invalid, and the
/// configuration is intact.
#[must_use]
pub const fn keeps_position(fault: &Fault) -> bool {
    suspected(fault).is_none()
        && !matches!(
            fault,
            Fault::EncoderIllegal { .. }
                | Fault::CounterJump { .. }
                | Fault::EncoderSlip { .. }
                | Fault::Configuration
                | Fault::Racking { .. }
        )
}

/// The joint whose encoder is suspected after a fault.
///
/// The joint was measured away from its command or outside its stroke, or it disagrees with the
/// steps of its motor. It may also have been pushed or blocked while the encoder counted correctly.
/// An index pulse in its place confirms the encoder.
#[must_use]
pub const fn suspected(fault: &Fault) -> Option<u8> {
    match fault {
        Fault::EncoderStuck { joint }
        | Fault::EncoderReversed { joint }
        | Fault::FollowingError { joint, .. }
        | Fault::Stroke { joint, .. }
        | Fault::LimitSwitch { joint }
        | Fault::StepsLost { joint, .. } => Some(*joint),
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

    /// The fault for which the machine is decelerating.
    #[must_use]
    #[inline]
    pub const fn pending(&self) -> Option<Fault> {
        self.pending
    }

    /// Whether all joints are homed, and nothing since has made their positions doubtful.
    #[must_use]
    pub const fn homed(&self) -> bool {
        self.homed
    }

    /// Whether a latched fault was not [taken](Safety::take_latched) yet.
    #[must_use]
    #[inline]
    pub const fn has_latched(&self) -> bool {
        self.latched.is_some()
    }

    /// Returns a fault that was latched since the last call.
    pub fn take_latched(&mut self) -> Option<Fault> {
        self.latched.take()
    }

    /// Sets whether a joint has no encoder, and whether the position is therefore lost whenever the
    /// drives go off.
    pub const fn set_open_loop(&mut self, open_loop: bool, loses_position_without_drives: bool) {
        self.open_loop = open_loop;
        self.loses_position_without_drives = loses_position_without_drives;
    }

    /// Whether the position of an open-loop joint was lost since the last call.
    pub const fn take_position_loss(&mut self) -> bool {
        core::mem::replace(&mut self.position_lost, false)
    }

    /// Marks the joints as not homed: their positions are not known to be right.
    pub fn lose_position(&mut self) {
        self.homed = false;
    }

    /// Whether the drives must be on in this state.
    #[must_use]
    #[inline]
    pub const fn drives_on(&self) -> bool {
        match self.state {
            State::Idle | State::Homing | State::Run | State::Jog | State::Hold => true,
            State::Fault => self.holding,
            State::Disabled | State::EmergencyStop => false,
        }
    }

    /// Whether something moves, or may start to move without another command.
    #[must_use]
    #[inline]
    pub const fn active(&self) -> bool {
        matches!(
            self.state,
            State::Homing | State::Run | State::Jog | State::Hold
        )
    }

    /// Enters a state and reports the change.
    #[inline(never)]
    pub fn enter(&mut self, state: State) {
        if state != self.state {
            let from = core::mem::replace(&mut self.state, state);
            if self.loses_position_without_drives && !self.drives_on() {
                self.position_lost = true;
                self.lose_position();
            }
            self.push_event(Event::State {
                from,
                to: state,
                homed: self.homed,
            });
        }
    }

    /// Marks the joints as homed or as not homed.
    pub fn set_homed(&mut self, homed: bool) {
        self.homed = homed;
        if homed {
            self.push_event(Event::Homed);
        }
    }

    /// Raises a fault: the machine decelerates first if it is active and [`decelerates_first`]
    /// holds for the fault; otherwise the fault latches now. The first fault for which the machine
    /// decelerates stays.
    #[inline(never)]
    pub fn raise(&mut self, fault: Fault) {
        if decelerates_first(&fault) && self.active() {
            self.pending.get_or_insert(fault);
        } else {
            self.latch(fault);
        }
    }

    /// Latches the fault for which the machine was decelerating. Callers must be at standstill.
    pub fn settle(&mut self) {
        if let Some(fault) = self.pending {
            self.latch(fault);
        }
    }

    fn latch(&mut self, fault: Fault) {
        // Only a fault that must switch holding drives off replaces a latched fault.
        if matches!(self.state, State::EmergencyStop)
            || (matches!(self.state, State::Fault) && (!self.holding || decelerates_first(&fault)))
        {
            return;
        }
        let on = self.drives_on();
        self.holding = on && decelerates_first(&fault);
        // The fault of the joint decides about the position, also where missed periods are reported
        // as the cause below: its encoder is suspected.
        self.latched = Some(fault);
        // A drive with an alarm has not followed, and no encoder measured its motor.
        let unmeasured = self.open_loop && matches!(fault, Fault::Drive { .. });
        if unmeasured || !keeps_position(&fault) {
            self.position_lost |= unmeasured;
            self.lose_position();
        }
        let fault = match self.pending.take() {
            Some(missed @ Fault::MissedPeriods { .. }) if is_of_joint(&fault) => missed,
            _ => fault,
        };
        self.fault = Some(fault);
        self.push_event(Event::Fault(fault));
        self.enter(State::Fault);
    }

    /// Enters the emergency stop: drives off, latched.
    pub fn emergency_stop(&mut self) {
        self.pending = None;
        self.holding = false;
        self.enter(State::EmergencyStop);
    }

    /// Ends a fault in which the drives hold the machine: they go off.
    pub const fn end_holding(&mut self) {
        self.holding = false;
    }

    /// Clears the latched fault or emergency stop; returns whether there was one.
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

    /// Queues an event. A full queue drops its oldest event and counts it, because the newest
    /// events explain the present state.
    #[inline(never)]
    pub fn push_event(&mut self, event: Event) {
        #[cfg(feature = "defmt")]
        match &event {
            Event::Fault(fault) => defmt::error!("fault: {}", fault),
            event => defmt::info!("{}", event),
        }
        if self.events.is_full() {
            self.events.pop_front();
            self.events_lost = self.events_lost.saturating_add(1);
        }
        // The code above made room.
        let _ = self.events.push_back(event);
    }

    /// Events that were dropped because they were not read for too long.
    #[must_use]
    pub const fn events_lost(&self) -> u32 {
        self.events_lost
    }

    /// Whether there are unread events.
    #[must_use]
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    /// Takes the oldest unread event.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Puts an event back that could not be sent now.
    pub fn unread_event(&mut self, event: Event) {
        if self.events.push_front(event).is_err() {
            self.events_lost = self.events_lost.saturating_add(1);
        }
    }
}
