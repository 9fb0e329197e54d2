//! Timing, state and counters of a link.

use crate::message::HelloRefusal;

/// Timing and line rate of a link. The defaults suit a serial line of 115,200 baud or faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// Longest silence of an endpoint, microseconds; then it sends a keep-alive frame. The default
    /// gives seven keep-alive frames within a heartbeat of 500 ms. At a bit error rate of one in a
    /// thousand, one in thirty of them is lost, and never all of them in the life of a machine. A
    /// line that carries only garbage for 350 ms is tolerated.
    pub keep_alive_us: u32,
    /// Longest delay of an acknowledgement that waits for another frame to carry it, microseconds.
    pub acknowledge_us: u32,
    /// Time between two Hello messages, microseconds.
    pub hello_us: u32,
    /// Bounds of the resend time of an unacknowledged frame, microseconds. Between them it follows
    /// the round trip.
    pub resend_us: (u32, u32),
    /// Silence of the peer that ends the session, microseconds.
    pub silence_us: u32,
    /// Time without progress of a reliable message that ends the session, microseconds.
    pub stall_us: u32,
    /// Bytes per second that the line carries; 0 for no limit. [`super::Link::transmit`] returns no
    /// more, so that nothing waits in a driver, where later frames cannot overtake it.
    pub line_rate: u32,
    /// Time by which the line may be filled ahead, microseconds; at least the time between two
    /// calls of [`super::Link::transmit`].
    pub line_ahead_us: u32,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            keep_alive_us: 70_000,
            acknowledge_us: 5_000,
            hello_us: 100_000,
            resend_us: (15_000, 400_000),
            silence_us: 1_000_000,
            stall_us: 5_000_000,
            line_rate: 0,
            line_ahead_us: 5_000,
        }
    }
}

/// State of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkState {
    /// No session.
    Closed,
    /// The host sends Hello and waits for Welcome.
    Opening,
    /// The session is open.
    Open,
    /// The controller refused the session; [`super::Link::peer`] has its Welcome.
    Refused(HelloRefusal),
    /// The peer is silent.
    Silent,
    /// The peer is alive, but a reliable message is not acknowledged: the line is too bad.
    Stalled,
}

/// Reason why a message cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SendError {
    /// No session is open.
    NotOpen,
    /// The window or the buffer is full; try again later.
    Full,
    /// The message does not fit a frame.
    TooLong,
}

impl core::fmt::Display for SendError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotOpen => "no session is open",
            Self::Full => "too many messages are under way; wait for an acknowledgement",
            Self::TooLong => "the message fits no frame",
        })
    }
}

impl core::error::Error for SendError {}

/// Receive effort of [`super::Link::receive`], in increasing order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReceiveEffort {
    /// No byte arrived.
    Nothing,
    /// Bytes arrived.
    Bytes,
    /// A frame was completed.
    Frame,
    /// Stored messages were moved to make room for another one.
    Moved,
}

/// Counters of a link since its creation. Each saturates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Frames sent, of any kind.
    pub frames_sent: u32,
    /// Bytes given to the line, of any kind, resent ones included.
    pub bytes_sent: u32,
    /// Part of these bytes that belongs to frames with a reliable message, framing and
    /// acknowledgement included.
    pub message_bytes: u32,
    /// Frames with a valid check, of any kind.
    pub frames_heard: u32,
    /// Frames refused by their check, including frames of an old session.
    pub bad_frames: u32,
    /// Reliable frames that were resent.
    pub resent: u32,
    /// Duplicate reliable frames.
    pub duplicates: u32,
    /// Frames dropped because the buffer was full. Reliable ones are resent.
    pub no_room: u32,
    /// Messages with a valid check that could not be decoded. This occurs only if a build reports a
    /// wrong schema hash.
    pub unreadable: u32,
}
