//! Talks to a controller: connects, configures, asks, streams jobs, jogs, stops.
//!
//! [`Client`] is a state machine without ports, threads or clocks: whoever owns the port calls [`Client::advance`] with the time, the bytes
//! that came and a buffer for the bytes to go, some hundred times a second or more, and takes what happened from
//! [`Client::poll`]. The same client therefore drives a serial port, a socket, and the simulator in virtual time.
//!
//! ```
//! use haptimill::client::{Client, Notice, Options};
//! use haptimill_protocol::message::Command;
//! let mut client = Client::new(Options::default());
//! client.connect(0x5eed_1234, 0); // a random number, new for each session
//! let (mut received, mut transmit) = (Vec::new(), Vec::new());
//! for now_us in (0..20_000).step_by(1000) {
//!     client.advance(now_us, &received, &mut transmit);
//!     // port.write_all(&transmit), received = what the port has
//!     transmit.clear();
//!     received.clear();
//!     while let Some(notice) = client.poll() {
//!         if let Notice::Connected(controller) = notice {
//!             println!("{} at {} us", controller.machine, controller.period_us);
//!             client.request(Command::Home);
//!         }
//!     }
//! }
//! ```
//!
//! Misuse: every [`Notice`] must be polled; of telemetry only the newest 4,096 frames are kept. The call rate bounds how fast a stop leaves:
//! [`Client::urgent_stop`] is on the line with the next call of `advance`, before everything else.

mod error;
mod notice;
mod requests;
mod stream;
#[cfg(test)]
mod tests;

pub use error::{ClientError, LineHealth, RequestError};
pub use notice::{ClientState, Notice, Options, Ticket};
pub use stream::{JobEnding, JobProgress};

use haptimill_protocol::frame::crc32;
use haptimill_protocol::haptic::{COMPONENTS, MasterPose, MasterTelemetry};
use haptimill_protocol::link::{HostLink, LinkState};
use haptimill_protocol::message::{
    AxisValues, CONFIG_CHUNK, Command, ConfigChunk, Event, Refusal, Report, Request, State,
    Telemetry, Welcome,
};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_protocol::urgent;
use requests::Requests;
use std::collections::VecDeque;
use stream::Stream;

/// Telemetry frames that wait to be polled, at most.
const MOST_TELEMETRY: usize = 4096;

/// While a job runs, telemetry is asked for when none came for this long, microseconds.
const ASK_AFTER_US: u64 = 100_000;

/// Drives one session with one controller.
#[derive(Debug)]
pub struct Client {
    options: Options,
    link: HostLink,
    state: ClientState,
    /// When the greeting has to be answered.
    connect_by_us: u64,
    now_us: u64,
    welcome: Option<Welcome>,
    /// CRC-32 of the configuration that is active in the controller.
    active_crc: u32,
    requests: Requests,
    stream: Option<Stream>,
    telemetry: Option<Telemetry>,
    hand: Option<MasterTelemetry>,
    /// When telemetry was last heard or asked for.
    telemetry_us: u64,
    waiting_telemetry: usize,
    notices: VecDeque<Notice>,
    jog_epoch: u16,
    hand_epoch: u16,
    urgent: Option<Urgent>,
    urgent_sent: u32,
}

/// An urgent stop that is repeated until the controller stands.
#[derive(Debug)]
struct Urgent {
    /// When the bytes go next.
    next_us: u64,
    /// The ordinary stop that follows the urgent one; once it is answered, what is reported is later than all that was asked before.
    settled: Option<Ticket>,
}

impl Client {
    /// A client without a session.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            link: HostLink::new(options.timing),
            state: ClientState::Closed,
            connect_by_us: 0,
            now_us: 0,
            welcome: None,
            active_crc: 0,
            requests: Requests::default(),
            stream: None,
            telemetry: None,
            hand: None,
            telemetry_us: 0,
            waiting_telemetry: 0,
            notices: VecDeque::new(),
            jog_epoch: 1,
            hand_epoch: 1,
            urgent: None,
            urgent_sent: 0,
        }
    }

    /// Begins a session; one that is open is dropped, and its requests fail. `session` must be random: a number that was used before may let
    /// late frames of that session in.
    pub fn connect(&mut self, session: u32, now_us: u64) {
        self.end(ClientError::Closed);
        self.now_us = now_us;
        self.link.open(session, now_us);
        self.state = ClientState::Connecting;
        self.connect_by_us = now_us.saturating_add(self.options.connect_us);
        // The controller forgets its epochs when a session begins.
        self.jog_epoch = 1;
        self.hand_epoch = 1;
        self.welcome = None;
        self.telemetry = None;
        self.hand = None;
    }

    /// Ends the session from this side. The controller notices by the silence.
    pub fn close(&mut self) {
        self.end(ClientError::Closed);
        self.link.close();
        self.state = ClientState::Closed;
    }

    /// How the client stands.
    pub fn state(&self) -> &ClientState {
        &self.state
    }

    /// What the controller said of itself when the session began.
    pub fn controller(&self) -> Option<&Welcome> {
        self.welcome.as_ref()
    }

    /// The newest report of how things stand.
    pub fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    /// The newest report of how the hand on its haptic arm stands.
    pub fn hand(&self) -> Option<&MasterTelemetry> {
        self.hand.as_ref()
    }

    /// The link, for its counters and round trip.
    pub fn link(&self) -> &HostLink {
        &self.link
    }

    /// What happened next, if anything did.
    pub fn poll(&mut self) -> Option<Notice> {
        let notice = self.notices.pop_front();
        if matches!(notice, Some(Notice::Telemetry(_))) {
            self.waiting_telemetry -= 1;
        }
        notice
    }

    /// Asks for something. The answer is a [`Notice::Answered`] with the same ticket. For jobs, jogs, configurations and urgent stops there
    /// are methods that know more.
    pub fn request(&mut self, command: Command) -> Ticket {
        if matches!(command, Command::Hold | Command::Stop) {
            self.next_jog_epoch();
        }
        self.requests.ask(command)
    }

    /// Jogs after a stop belong to a new epoch: the controller hears no more of the one that it ended.
    fn next_jog_epoch(&mut self) {
        self.jog_epoch = self.jog_epoch.wrapping_add(1).max(1);
    }

    /// Makes a configuration (as encoded by the firmware's types) the active one, unless it is already. Answered as `activate`. With
    /// `at_preset` it is sent in any case, and the joints are taken to stand at their presets.
    pub fn configure(&mut self, config: &[u8], at_preset: bool) -> Ticket {
        let crc = crc32(config);
        let Ok(length) = u16::try_from(config.len()) else {
            return self
                .requests
                .settled("activate", Err(RequestError::Refused(Refusal::Range)));
        };
        if length > 0 && crc == self.active_crc && !at_preset {
            return self.requests.settled("activate", Ok(()));
        }
        for (index, chunk) in config.chunks(CONFIG_CHUNK).enumerate() {
            let chunk = ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            };
            self.requests.tell(Command::Configure(chunk));
        }
        self.requests.ask(Command::Activate {
            length,
            crc,
            at_preset,
        })
    }

    /// Begins a job at `pose`, which must be the wanted pose of the controller to the last bit (see [`Telemetry::commanded`]). The setpoints are
    /// taken from the iterator as the controller has room for them; how it ends is told by [`Notice::Job`].
    ///
    /// # Errors
    ///
    /// [`ClientError`] when no session is open or a job runs already.
    pub fn start_job<I>(
        &mut self,
        job: u32,
        pose: AxisValues,
        setpoints: I,
    ) -> Result<(), ClientError>
    where
        I: IntoIterator<Item = Setpoint>,
        I::IntoIter: Send + 'static,
    {
        let welcome = self
            .welcome
            .as_ref()
            .filter(|_| self.state == ClientState::Ready);
        let welcome = welcome.ok_or(ClientError::Closed)?;
        if self.stream.is_some() {
            return Err(ClientError::JobRuns);
        }
        let start = self.requests.ask(Command::JobStart {
            job,
            pose: pose.clone(),
        });
        self.stream = Some(Stream::new(
            job,
            start,
            &pose,
            welcome,
            Box::new(setpoints.into_iter()),
        ));
        Ok(())
    }

    /// How far the job is, if one runs.
    pub fn job(&self) -> Option<JobProgress> {
        self.stream.as_ref().map(Stream::progress)
    }

    /// Moves at these rates (axis units per second divided by 2^8, one for each pose coordinate) for at most `deadline_ms`. To keep moving,
    /// call it again in time, as long as the hand is on the key; only the newest one counts, so nothing queues up.
    ///
    /// # Errors
    ///
    /// [`ClientError::Closed`] when no session is open.
    pub fn jog(&mut self, rates: AxisValues, deadline_ms: u16) -> Result<(), ClientError> {
        let command = Command::Jog {
            epoch: self.jog_epoch,
            deadline_ms,
            rates,
        };
        self.link
            .send_latest(&Request { id: 0, command })
            .map_err(|_| ClientError::Closed)
    }

    /// Stops jogging: no jog sent before this moves the machine, whenever it arrives.
    pub fn cancel_jog(&mut self) -> Ticket {
        let ticket = self.requests.ask(Command::JogCancel {
            epoch: self.jog_epoch,
        });
        self.next_jog_epoch();
        ticket
    }

    /// Says where a hand is that leads the tool from afar, and how old that is. Only the newest word counts, and a lost one is not sent again.
    ///
    /// # Errors
    ///
    /// [`ClientError::Closed`] when no session is open.
    pub fn lead(&mut self, hand: MasterPose, age_ms: u8) -> Result<(), ClientError> {
        let command = Command::MasterPose {
            epoch: self.hand_epoch,
            age_ms,
            pose: hand,
        };
        self.link
            .send_latest(&Request { id: 0, command })
            .map_err(|_| ClientError::Closed)
    }

    /// The hand leads anew, after a hold: what was said of it before is not heard any more, whenever it arrives.
    pub fn lead_anew(&mut self) {
        self.hand_epoch = self.hand_epoch.wrapping_add(1).max(1);
    }

    /// Says what the tool feels to the controller of the arm whose hand leads it: forces along x, y, z, 2^-6 N. Only the newest word counts.
    ///
    /// # Errors
    ///
    /// [`ClientError::Closed`] when no session is open.
    pub fn feel(&mut self, force: [i16; COMPONENTS]) -> Result<(), ClientError> {
        let command = Command::RemoteForce { force };
        self.link
            .send_latest(&Request { id: 0, command })
            .map_err(|_| ClientError::Closed)
    }

    /// Stops the machine by the shortest way: the urgent bytes go out with the next [`Client::advance`] before everything else, and again until
    /// a standstill is reported. A job is dropped. Answered as `stop`, unless it was under way already.
    pub fn urgent_stop(&mut self) {
        if self.urgent.is_some() {
            return;
        }
        // What was not sent yet is not to come after the stop.
        self.requests.withdraw();
        self.next_jog_epoch();
        if let Some(stream) = self.stream.as_mut() {
            stream.abandon();
            let ending = stream.withdrawn(&self.requests);
            self.finish_job(ending);
        }
        let settled = (self.state == ClientState::Ready).then(|| self.requests.ask(Command::Stop));
        self.urgent = Some(Urgent {
            next_us: 0,
            settled,
        });
    }

    /// Whether an urgent stop is still being repeated, and how many were sent in all.
    pub fn urgent(&self) -> (bool, u32) {
        (self.urgent.is_some(), self.urgent_sent)
    }

    /// Takes the bytes that came and appends the bytes to go. To be called regularly, also when nothing came.
    pub fn advance(&mut self, now_us: u64, received: &[u8], transmit: &mut Vec<u8>) {
        self.now_us = self.now_us.max(now_us);
        let now_us = self.now_us;
        if let Some(urgent) = self
            .urgent
            .as_mut()
            .filter(|urgent| now_us >= urgent.next_us)
        {
            // A frame that had begun is broken by this, and sent again by the link.
            transmit.extend_from_slice(&urgent::STOP);
            self.urgent_sent += 1;
            urgent.next_us = now_us.saturating_add(self.options.urgent_repeat_us);
        }
        // In pieces, so that no burst overruns the inbox.
        let mut pieces = received.chunks(256);
        loop {
            let piece = pieces.next();
            self.link.receive(now_us, piece.unwrap_or_default());
            self.follow_link();
            while let Some(report) = self.link.poll_message() {
                self.hear(report);
            }
            if piece.is_none() {
                break;
            }
        }
        self.say();
        let mut buffer = [0; 512];
        loop {
            let count = self.link.transmit(now_us, &mut buffer);
            transmit.extend(buffer.iter().take(count));
            if count < buffer.len() {
                break;
            }
        }
        self.collect();
    }

    /// Reports the requests that came to their end.
    fn collect(&mut self) {
        for (ticket, command, result) in self.requests.finished() {
            self.notices.push_back(Notice::Answered {
                ticket,
                command,
                result,
            });
        }
    }

    fn line_health(&self) -> LineHealth {
        let counters = self.link.counters();
        LineHealth {
            bad_frames: counters.bad_frames,
            resent: counters.resent,
        }
    }

    /// Takes over what became of the session.
    fn follow_link(&mut self) {
        let failed = match (self.link.state(self.now_us), &self.state) {
            (LinkState::Open, ClientState::Connecting) => {
                if let Some(welcome) = self.link.peer() {
                    self.active_crc = welcome.config_crc;
                    self.welcome = Some(welcome.clone());
                    self.notices.push_back(Notice::Connected(welcome.clone()));
                }
                self.state = ClientState::Ready;
                return;
            }
            (LinkState::Opening, ClientState::Connecting) if self.now_us >= self.connect_by_us => {
                ClientError::NoAnswer {
                    waited_us: self.options.connect_us,
                }
            }
            (LinkState::Refused(why), ClientState::Connecting) => ClientError::Refused {
                why,
                version: self.link.peer().map_or(0, |peer| peer.version),
            },
            (LinkState::Silent, ClientState::Ready) => ClientError::Silent {
                silent_us: self.link.peer_silent_us(self.now_us),
                line: self.line_health(),
            },
            (LinkState::Stalled, ClientState::Ready) => ClientError::Stalled {
                line: self.line_health(),
            },
            _ => return,
        };
        self.end(failed.clone());
        self.link.close();
        self.state = ClientState::Failed(failed);
    }

    /// The session is over: everything that waits for it fails.
    fn end(&mut self, error: ClientError) {
        if !matches!(self.state, ClientState::Connecting | ClientState::Ready) {
            return;
        }
        self.requests.fail_all(&RequestError::Lost(error.clone()));
        self.collect();
        if let Some(stream) = self.stream.take() {
            self.notices
                .push_back(Notice::Job(stream.lost(error.clone())));
        }
        self.notices.push_back(Notice::Lost(error));
        if let Some(urgent) = self.urgent.as_mut() {
            // The bytes go on: they may get through where messages do not.
            urgent.settled = None;
        }
    }

    /// Takes a report.
    fn hear(&mut self, report: Report) {
        match report {
            Report::Answer { id: 0, result } => {
                let Err(refusal) = result else {
                    return;
                };
                let ending = self
                    .stream
                    .as_mut()
                    .and_then(|stream| stream.refused(refusal));
                if let Some(ending) = ending {
                    self.stream = None;
                    // What the controller still holds of the job must not run on.
                    self.requests.ask(Command::Stop);
                    self.notices.push_back(Notice::Job(ending));
                } else {
                    self.notices.push_back(Notice::Refused(refusal));
                }
            }
            Report::Answer { id, result } => {
                let Some((ticket, command)) = self.requests.answered(id, result) else {
                    return;
                };
                if let (Command::Activate { crc, .. }, Ok(())) = (&command, result) {
                    self.active_crc = *crc;
                }
                let ending = self
                    .stream
                    .as_mut()
                    .and_then(|stream| stream.answered(ticket, result));
                self.finish_job(ending);
                if let Some(urgent) = self
                    .urgent
                    .as_mut()
                    .filter(|urgent| urgent.settled == Some(ticket))
                {
                    urgent.settled = None;
                }
            }
            Report::Event { period, event } => {
                let ending = self.stream.as_mut().and_then(|stream| stream.event(&event));
                if let Event::State { to, .. } = event {
                    self.stands(to);
                }
                self.notices.push_back(Notice::Event { period, event });
                self.finish_job(ending);
            }
            Report::Master(hand) => self.hand = Some(hand),
            Report::Telemetry(telemetry) => {
                self.telemetry_us = self.now_us;
                if let Some(stream) = self.stream.as_mut() {
                    stream.telemetry(&telemetry);
                }
                self.stands(telemetry.state);
                if self.waiting_telemetry >= MOST_TELEMETRY {
                    let oldest = self
                        .notices
                        .iter()
                        .position(|n| matches!(n, Notice::Telemetry(_)));
                    if let Some(oldest) = oldest {
                        self.notices.remove(oldest);
                        self.waiting_telemetry -= 1;
                    }
                }
                self.waiting_telemetry += 1;
                self.notices
                    .push_back(Notice::Telemetry(Box::new(telemetry.clone())));
                self.telemetry = Some(telemetry);
            }
        }
    }

    fn finish_job(&mut self, ending: Option<JobEnding>) {
        if let Some(ending) = ending {
            self.stream = None;
            self.notices.push_back(Notice::Job(ending));
        }
    }

    /// Ends an urgent stop once the machine is known to stand. Before the ordinary stop is answered, a report may be older than what it
    /// is to stop.
    fn stands(&mut self, state: State) {
        let at_rest = matches!(
            state,
            State::Disabled | State::Idle | State::Hold | State::Fault | State::EmergencyStop
        );
        if at_rest
            && self.state == ClientState::Ready
            && self
                .urgent
                .take_if(|urgent| urgent.settled.is_none())
                .is_some()
        {
            // An urgent stop that was repeated meanwhile may come behind the ordinary one; what is asked from now on comes after both.
            self.requests.tell(Command::Stop);
        }
    }

    /// Hands the link what it has room for: requests first, then setpoints.
    fn say(&mut self) {
        if self.state != ClientState::Ready {
            return;
        }
        let late = self.requests.expire(self.now_us, self.line_health());
        if let Some(stream) = self.stream.as_mut() {
            let ending = late.and_then(|(ticket, error)| stream.failed(ticket, error));
            self.finish_job(ending);
        }
        if self.stream.is_some() && self.now_us.saturating_sub(self.telemetry_us) >= ASK_AFTER_US {
            // The credit comes with telemetry, which may be switched off or too slow.
            self.requests.tell(Command::Status);
            self.telemetry_us = self.now_us;
        }
        self.requests
            .send(&mut self.link, self.now_us, self.options.answer_us);
        let Some(stream) = self.stream.as_mut() else {
            return;
        };
        match stream.send(&mut self.link, &mut self.requests) {
            Ok(()) => {}
            Err(ending) => {
                self.stream = None;
                self.requests.ask(Command::Stop);
                self.notices.push_back(Notice::Job(ending));
            }
        }
    }
}
