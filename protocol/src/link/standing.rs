//! How a link is set, how it stands, and what it has counted.

use crate::message::HelloRefusal;

/// Times and rate of a link. The defaults suit a serial line of 115,200 baud and anything faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// The longest silence of a living end, microseconds. The default leaves seven signs of life in the 500 ms after which a machine gives its host
    /// up: with a bit in a thousand wrong one of them is lost in thirty, and never all of them in the life of a machine. A line that carries nothing but
    /// garbage for 350 ms is borne.
    pub keep_alive_us: u32,
    /// How long an acknowledgement waits for a frame to ride on, microseconds.
    pub acknowledge_us: u32,
    /// Time between two greetings, microseconds.
    pub hello_us: u32,
    /// Bounds of the time after which an unanswered frame is sent again, microseconds; it follows the round trip in between.
    pub resend_us: (u32, u32),
    /// Silence of the peer after which the session is lost, microseconds.
    pub silence_us: u32,
    /// Time without progress of a reliable message after which the session is lost, microseconds.
    pub stall_us: u32,
    /// Bytes per second that the line carries; 0 for no bound. [`super::Link::transmit`] gives no more, so that nothing waits in a
    /// driver where it cannot be overtaken.
    pub line_rate: u32,
    /// How far the line may be filled ahead, microseconds; at least the time between two calls of [`super::Link::transmit`].
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

/// How a link stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LinkState {
    /// No session.
    Closed,
    /// The host greets and waits for an answer.
    Opening,
    /// Messages go.
    Open,
    /// The controller answered with a refusal; [`super::Link::peer`] says more.
    Refused(HelloRefusal),
    /// The peer fell silent.
    Silent,
    /// The peer lives, and yet a message cannot be brought over: the line is too bad.
    Stalled,
}

/// Why a message cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SendError {
    /// No session is open.
    NotOpen,
    /// As many messages, or bytes, are under way as can be; later there is room again.
    Full,
    /// It fits no frame.
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

/// What [`super::Link::receive`] had to do: the later, the more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Work {
    /// No byte came.
    Nothing,
    /// Bytes came.
    Bytes,
    /// A frame ended.
    Frame,
    /// Messages that wait had to be moved to make room for another.
    Moved,
}

/// What a link has counted since it was made. Each stays at its largest value.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Frames sent, of any kind.
    pub frames_sent: u32,
    /// Bytes given to the line, of any kind; what is sent again counts again.
    pub bytes_sent: u32,
    /// Of those, the bytes of frames with a reliable message, framing and acknowledgement included.
    pub message_bytes: u32,
    /// Frames with the right check, of any kind.
    pub frames_heard: u32,
    /// Frames refused by their check; those of an old session are among them.
    pub bad_frames: u32,
    /// Reliable frames sent again.
    pub resent: u32,
    /// Reliable frames that had arrived before.
    pub duplicates: u32,
    /// Frames that found no room and were dropped; reliable ones come again.
    pub no_room: u32,
    /// Messages with the right check that could not be read: never seen unless two builds lie about their schema.
    pub unreadable: u32,
}
