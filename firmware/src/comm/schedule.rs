//! Time slices of the link.
//!
//! A control period has time for one long task besides the control: its [`Slice`]. The first task
//! that asks takes it; all others wait. Three rules share the slices:
//!
//! - interpolation that needs the whole period takes it, but never twice in a row;
//! - reports or bytes that wait because another task has the slice get the next free one;
//! - after an executed message, waiting telemetry has the next slice.
//!
//! Receive and transmit therefore alternate, and neither can block the other.

use haptimill_protocol::link::ReceiveEffort;

/// The long task of a control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Slice {
    /// None yet. Short transmissions may go.
    #[default]
    Idle,
    /// Interpolation needs the period: nothing is executed or transmitted.
    Deferred,
    /// The link moved its stored messages to make room for another one.
    Receive,
    /// A message or a setpoint is read, checked or executed.
    Execute,
    /// A part of the configuration is checked, or a part of the next segment is prepared.
    Background,
    /// A telemetry message is sampled and encoded.
    Sample,
    /// A report is queued, a telemetry frame begins, or the period is kept free for them.
    Transmit,
}

/// Decides which task has the slice of a period.
#[derive(Debug, Default)]
pub struct Schedule {
    slice: Slice,
    /// Reports or bytes wait: the next free slice is theirs.
    transmit_waits: bool,
    /// The last slice that was free executed a message.
    executed: bool,
}

impl Schedule {
    /// Begins a period. `busy`: interpolation needs it. `received`: what the link did in it.
    #[inline]
    pub fn begin(&mut self, busy: bool, received: ReceiveEffort) {
        self.slice = if busy && self.slice != Slice::Deferred {
            Slice::Deferred
        } else if received == ReceiveEffort::Moved {
            Slice::Receive
        } else if core::mem::take(&mut self.transmit_waits) {
            Slice::Transmit
        } else {
            Slice::Idle
        };
    }

    /// The slice of this period.
    #[must_use]
    #[inline]
    pub const fn slice(&self) -> Slice {
        self.slice
    }

    /// Takes the slice if it is free; returns whether it was.
    #[inline]
    pub fn try_take(&mut self, slice: Slice) -> bool {
        let free = self.slice == Slice::Idle;
        if free {
            self.slice = slice;
        }
        free
    }

    /// Whether a message may be executed. Callers must ask once per period.
    #[inline]
    pub const fn may_execute(&mut self, telemetry_waits: bool) -> bool {
        if !matches!(self.slice, Slice::Idle) {
            return false;
        }
        let executed = core::mem::replace(&mut self.executed, false);
        !(executed && telemetry_waits)
    }

    /// Takes the slice for a message that [may be executed](Self::may_execute).
    pub const fn execute(&mut self) {
        self.slice = Slice::Execute;
        self.executed = true;
    }

    /// Returns the slice: there was nothing to execute.
    pub const fn release(&mut self) {
        self.slice = Slice::Idle;
        self.executed = false;
    }

    /// Whether a report or a frame may be transmitted. If another task has the slice, the next free
    /// one is kept for it. Interpolation keeps none: a host could not send any more setpoints.
    #[inline]
    pub const fn may_transmit(&mut self) -> bool {
        let may = matches!(self.slice, Slice::Idle | Slice::Transmit);
        self.transmit_waits |= !may && !matches!(self.slice, Slice::Deferred);
        may
    }

    /// A report was queued, or a telemetry frame has begun.
    pub const fn transmit(&mut self) {
        self.slice = Slice::Transmit;
    }
}
