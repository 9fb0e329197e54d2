//! What differs between the two ends: who greets, who answers, and what each says.

use super::{Link, LinkState, Payload};
use crate::frame::Header;
use crate::message::{Hello, HelloRefusal, PROTOCOL_VERSION, Report, Request, Welcome};
use crate::schema::schema_hash;
use heapless::{Deque, String};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// An end of a link: [`Host`] or [`Controller`].
pub trait End: greet::Greet {
    /// What it sends.
    type Sends: Serialize;
    /// What it hears.
    type Hears: DeserializeOwned;
}

/// Payload, which is no business of a caller.
pub(super) mod greet {
    use super::{Header, LinkState, Payload};

    /// How an end greets.
    pub trait Greet: Default {
        /// Takes a greeting; true when it may have opened a session.
        fn greeted(&mut self, header: Header, payload: &[u8]) -> bool;
        /// The session that was just opened.
        fn accepted(&mut self) -> Option<u32>;
        /// The greeting that is due, if one is; its payload is written.
        fn greeting(&mut self, now_us: u64, every_us: u32, payload: &mut Payload)
        -> Option<Header>;
        /// How it stands while no session is open.
        fn closed(&self) -> LinkState;
    }
}

/// The host's end.
#[derive(Debug, Default)]
pub struct Host {
    phase: Phase,
    /// The controller's last answer to this session.
    peer: Option<Welcome>,
}

/// How far a host's session is.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum Phase {
    #[default]
    Closed,
    /// Greets; next at this time.
    Opening {
        session: u32,
        next_us: u64,
    },
    /// Welcomed, not yet begun.
    Accepted(u32),
    Open,
    Refused(HelloRefusal),
}

impl End for Host {
    type Sends = Request;
    type Hears = Report;
}

impl greet::Greet for Host {
    fn greeted(&mut self, header: Header, payload: &[u8]) -> bool {
        let Phase::Opening { session, .. } = self.phase else {
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
        self.phase = refused.map_or(Phase::Accepted(session), Phase::Refused);
        self.peer = Some(welcome);
        refused.is_none()
    }

    fn accepted(&mut self) -> Option<u32> {
        let Phase::Accepted(session) = self.phase else {
            return None;
        };
        self.phase = Phase::Open;
        Some(session)
    }

    fn greeting(&mut self, now_us: u64, every_us: u32, payload: &mut Payload) -> Option<Header> {
        let Phase::Opening { session, next_us } = self.phase else {
            return None;
        };
        if now_us < next_us {
            return None;
        }
        let next_us = now_us.saturating_add(u64::from(every_us));
        self.phase = Phase::Opening { session, next_us };
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
            Phase::Closed => LinkState::Closed,
            Phase::Opening { .. } | Phase::Accepted(_) | Phase::Open => LinkState::Opening,
            Phase::Refused(why) => LinkState::Refused(why),
        }
    }
}

/// What does not fit between this build and another, if anything.
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
    /// Begins to greet; a session that is open is closed. `session` is random and was never used before; 0 is taken for 1.
    pub fn open(&mut self, session: u32, now_us: u64) {
        self.close();
        self.end.phase = Phase::Opening {
            session: session.max(1),
            next_us: now_us,
        };
    }

    /// What the controller says of itself: known once it answered, also when it refused.
    pub fn peer(&self) -> Option<&Welcome> {
        self.end.peer.as_ref()
    }
}

/// The controller's end.
#[derive(Debug, Default)]
pub struct Controller {
    /// The greeting that waits for an answer.
    hello: Option<Hello>,
    /// The answer that waits to be sent.
    welcome: Option<Welcome>,
    /// Sessions that ended, so that a late greeting does not bring one back.
    ended: Deque<u32, 4>,
}

impl End for Controller {
    type Sends = Report;
    type Hears = Request;
}

impl greet::Greet for Controller {
    fn greeted(&mut self, header: Header, payload: &[u8]) -> bool {
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

    fn greeting(&mut self, _: u64, _: u32, payload: &mut Payload) -> Option<Header> {
        let welcome = self.welcome.take()?;
        payload.encode(&welcome).ok()?;
        Some(Header::Welcome)
    }

    fn closed(&self) -> LinkState {
        LinkState::Closed
    }
}

/// What a controller says of itself in [`Welcome`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity<'a> {
    /// Name of the machine, at most 24 bytes (the rest is cut off); empty when there is no configuration.
    pub machine: &'a str,
    /// CRC-32 of the active configuration; 0 when there is none.
    pub config_crc: u32,
    /// Control period in microseconds.
    pub period_us: u16,
    /// Pose coordinates; 0 when not configured.
    pub axes: u8,
    /// Setpoints that the queue holds.
    pub queue: u16,
}

/// What became of a greeting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Greeted {
    /// There was none.
    Nothing,
    /// A new session has begun; what the one before had asked is forgotten.
    Begun,
    /// The host of the running session had not heard the answer; it is given again.
    Again,
    /// No session for this host; the running one, if any, goes on.
    Refused(HelloRefusal),
}

impl<const SEND: usize, const RECEIVE: usize> Link<Controller, SEND, RECEIVE> {
    /// A greeting that waits for [`Link::welcome`].
    pub fn hello(&self) -> Option<&Hello> {
        self.end.hello.as_ref()
    }

    /// Answers the greeting that waits, if one does. `busy` says that another session must not be broken into: it is alive and the machine
    /// moves or may move. Different versions and schemas are refused in any case.
    pub fn welcome(&mut self, now_us: u64, identity: &Identity<'_>, busy: bool) -> Greeted {
        let Some(hello) = self.end.hello.take() else {
            return Greeted::Nothing;
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
        let greeted = match refused {
            Some(why) => Greeted::Refused(why),
            None if running => {
                self.heard_us = now_us;
                Greeted::Again
            }
            None => {
                if self.open {
                    if self.end.ended.is_full() {
                        self.end.ended.pop_front();
                    }
                    // There is room: made above.
                    let _ = self.end.ended.push_back(self.session);
                }
                self.begin(now_us, hello.session);
                Greeted::Begun
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
        });
        greeted
    }
}
