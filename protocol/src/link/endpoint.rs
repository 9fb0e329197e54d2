//! The two endpoints: the host sends Hello, the controller answers with Welcome, and each has its
//! message types.

use super::{Link, LinkState, Payload};
use crate::frame::Header;
use crate::message::{Hello, HelloRefusal, Kept, PROTOCOL_VERSION, Report, Request, Welcome};
use crate::schema::schema_hash;
use heapless::{Deque, String};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// An endpoint of a link: [`Host`] or [`Controller`].
pub trait Endpoint: handshake::Handshake {
    /// Messages that it sends.
    type Outgoing: Serialize;
    /// Messages that it receives.
    type Incoming: DeserializeOwned;
}

/// Sealed trait: callers cannot name its types.
pub(super) mod handshake {
    use super::{Header, LinkState, Payload};

    /// Start of a session at an endpoint.
    pub trait Handshake: Default {
        /// Takes a Hello or Welcome. Returns true when it may have opened a session.
        fn begins_session(&mut self, header: Header, payload: &[u8]) -> bool;
        /// Returns the session that was just opened.
        fn accepted(&mut self) -> Option<u32>;
        /// Returns the header of a Hello or Welcome that is due, and writes its payload.
        fn handshake_frame(
            &mut self,
            now_us: u64,
            every_us: u32,
            payload: &mut Payload,
        ) -> Option<Header>;
        /// Returns the state while no session is open.
        fn closed(&self) -> LinkState;
    }
}

/// The host's endpoint.
#[derive(Debug, Default)]
pub struct Host {
    phase: HandshakePhase,
    /// The controller's last answer in this session.
    peer: Option<Welcome>,
}

/// Progress of a host's session.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum HandshakePhase {
    #[default]
    Closed,
    /// Sends Hello; the next one at `next_us`.
    Opening {
        session: u32,
        next_us: u64,
    },
    /// A Welcome arrived; the session has not begun yet.
    Accepted(u32),
    Open,
    Refused(HelloRefusal),
}

impl Endpoint for Host {
    type Outgoing = Request;
    type Incoming = Report;
}

impl handshake::Handshake for Host {
    fn begins_session(&mut self, header: Header, payload: &[u8]) -> bool {
        let HandshakePhase::Opening { session, .. } = self.phase else {
            return false;
        };
        if header != Header::Welcome {
            return false;
        }
        let Ok(welcome) = postcard::from_bytes::<Welcome>(payload) else {
            return false;
        };
        if welcome.session != session {
            return false;
        }
        let refused = welcome.refused.or(differs(welcome.version, welcome.schema));
        self.phase = refused.map_or(HandshakePhase::Accepted(session), HandshakePhase::Refused);
        self.peer = Some(welcome);
        refused.is_none()
    }

    fn accepted(&mut self) -> Option<u32> {
        let HandshakePhase::Accepted(session) = self.phase else {
            return None;
        };
        self.phase = HandshakePhase::Open;
        Some(session)
    }

    fn handshake_frame(
        &mut self,
        now_us: u64,
        every_us: u32,
        payload: &mut Payload,
    ) -> Option<Header> {
        let HandshakePhase::Opening { session, next_us } = self.phase else {
            return None;
        };
        if now_us < next_us {
            return None;
        }
        let next_us = now_us.saturating_add(u64::from(every_us));
        self.phase = HandshakePhase::Opening { session, next_us };
        let hello = Hello {
            version: PROTOCOL_VERSION,
            schema: schema_hash(),
            session,
        };
        payload.encode(&hello).ok()?;
        Some(Header::Hello)
    }

    fn closed(&self) -> LinkState {
        match self.phase {
            HandshakePhase::Closed => LinkState::Closed,
            HandshakePhase::Opening { .. } | HandshakePhase::Accepted(_) | HandshakePhase::Open => {
                LinkState::Opening
            }
            HandshakePhase::Refused(why) => LinkState::Refused(why),
        }
    }
}

/// Returns the reason why another build does not fit this one, if any.
fn differs(version: u16, schema: u64) -> Option<HelloRefusal> {
    if version != PROTOCOL_VERSION {
        Some(HelloRefusal::Version)
    } else if schema != schema_hash() {
        Some(HelloRefusal::Schema)
    } else {
        None
    }
}

impl<const SEND: usize, const RECEIVE: usize> Link<Host, SEND, RECEIVE> {
    /// Starts to send Hello and closes an open session. `session` must be random and never used
    /// before; 0 is replaced by 1.
    pub fn open(&mut self, session: u32, now_us: u64) {
        self.close();
        self.end.phase = HandshakePhase::Opening {
            session: session.max(1),
            next_us: now_us,
        };
    }

    /// The controller's Welcome: known after its answer, also after a refusal.
    pub fn peer(&self) -> Option<&Welcome> {
        self.end.peer.as_ref()
    }
}

/// The controller's endpoint.
#[derive(Debug, Default)]
pub struct Controller {
    /// The Hello that waits for an answer.
    hello: Option<Hello>,
    /// The Welcome that waits to be sent.
    welcome: Option<Welcome>,
    /// Sessions that ended. A late Hello cannot start them again.
    ended: Deque<u32, 4>,
}

impl Endpoint for Controller {
    type Outgoing = Report;
    type Incoming = Request;
}

impl handshake::Handshake for Controller {
    fn begins_session(&mut self, header: Header, payload: &[u8]) -> bool {
        if header == Header::Hello
            && let Ok(hello) = postcard::from_bytes::<Hello>(payload)
            && hello.session != 0
            && !self.ended.iter().any(|&ended| ended == hello.session)
        {
            self.hello = Some(hello);
        }
        false
    }

    fn accepted(&mut self) -> Option<u32> {
        None
    }

    fn handshake_frame(&mut self, _: u64, _: u32, payload: &mut Payload) -> Option<Header> {
        let welcome = self.welcome.take()?;
        payload.encode(&welcome).ok()?;
        Some(Header::Welcome)
    }

    fn closed(&self) -> LinkState {
        LinkState::Closed
    }
}

/// Description of the controller for [`Welcome`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity<'a> {
    /// Name of the machine, at most 24 bytes (the rest is cut off); empty without a configuration.
    pub machine: &'a str,
    /// CRC-32 of the active configuration; 0 without one.
    pub config_crc: u32,
    /// Control period in microseconds.
    pub period_us: u16,
    /// Pose coordinates; 0 without a configuration.
    pub axes: u8,
    /// Setpoints that the queue holds.
    pub queue: u16,
    /// What the board keeps without a supply.
    pub kept: Kept,
}

/// Result of [`Link::welcome`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HelloOutcome {
    /// No Hello was waiting.
    Nothing,
    /// A new session has begun. Requests of the session before are dropped.
    Begun,
    /// The host of the running session had not received the answer; it is sent again.
    Again,
    /// The session is refused; a running one continues.
    Refused(HelloRefusal),
}

impl<const SEND: usize, const RECEIVE: usize> Link<Controller, SEND, RECEIVE> {
    /// The Hello that waits for [`Link::welcome`].
    pub fn hello(&self) -> Option<&Hello> {
        self.end.hello.as_ref()
    }

    /// Answers a waiting Hello. `busy` refuses a session takeover: another session is alive and the
    /// machine moves or may move. Different versions and schemas are always refused.
    pub fn welcome(&mut self, now_us: u64, identity: &Identity<'_>, busy: bool) -> HelloOutcome {
        let Some(hello) = self.end.hello.take() else {
            return HelloOutcome::Nothing;
        };
        let running = self.open && hello.session == self.session;
        let refused = differs(hello.version, hello.schema)
            .or((busy && !running).then_some(HelloRefusal::Busy));
        let mut machine = String::new();
        for letter in identity.machine.chars() {
            if machine.push(letter).is_err() {
                break;
            }
        }
        let outcome = match refused {
            Some(why) => HelloOutcome::Refused(why),
            None if running => {
                self.received_us = now_us;
                HelloOutcome::Again
            }
            None => {
                if self.open {
                    if self.end.ended.is_full() {
                        self.end.ended.pop_front();
                    }
                    // Room was made above.
                    let _ = self.end.ended.push_back(self.session);
                }
                self.begin(now_us, hello.session);
                HelloOutcome::Begun
            }
        };
        self.quiet_until_us = 0;
        self.end.welcome = Some(Welcome {
            version: PROTOCOL_VERSION,
            schema: schema_hash(),
            session: hello.session,
            refused,
            machine,
            config_crc: identity.config_crc,
            period_us: identity.period_us,
            axes: identity.axes,
            queue: identity.queue,
            kept: identity.kept,
        });
        outcome
    }
}
