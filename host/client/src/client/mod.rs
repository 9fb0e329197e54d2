//! The host side of the link: connects, configures, sends requests, streams jobs, jogs, stops.
//!
//! [`Client`] is a state machine without ports, threads or clocks. The owner of the port calls
//! [`Client::advance`] with the time, the received bytes and a buffer for the bytes to send, some
//! hundred times a second or more, and takes notifications from [`Client::poll`]. The same client
//! drives a serial port, a socket, and the simulator in virtual time.
//!
//! ```
//! use haptimill_client::client::{Client, Notification, Options};
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
//!         if let Notification::Connected(controller) = notice {
//!             println!("{} at {} us", controller.machine, controller.period_us);
//!             client.request(Command::Home);
//!         }
//!     }
//! }
//! ```
//!
//! Callers must poll every [`Notification`]; of telemetry only the newest 4,096 frames are kept.
//! The call rate bounds the latency of a stop: [`Client::stop_out_of_band`] is sent by the next
//! call of `advance`, before everything else.

mod ending;
mod error;
mod notification;
mod receive;
mod requests;
mod stream;
#[cfg(test)]
mod tests;

pub use ending::JobEnding;
pub use error::{ClientError, LineHealth, RequestError};
pub use notification::{ClientState, Notification, Options, Ticket};
pub use stream::{JobStatus, SetpointSource, Setpoints};

use haptimill_protocol::frame::crc32;
use haptimill_protocol::haptic::{COMPONENTS, MasterPose, MasterTelemetry};
use haptimill_protocol::link::HostLink;
use haptimill_protocol::message::{
    AxisValues, CONFIG_CHUNK, Command, ConfigChunk, Refusal, Request, Telemetry, Welcome,
};
use haptimill_protocol::out_of_band;
use requests::Requests;
use std::collections::VecDeque;
use std::num::TryFromIntError;
use stream::Stream;

/// Telemetry frames that wait to be polled, at most.
const MAX_TELEMETRY: usize = 4096;

/// While a job runs, the status is requested when no telemetry arrives for this time, microseconds.
const STATUS_AFTER_US: u64 = 100_000;

/// Drives one session with one controller.
#[derive(Debug)]
pub struct Client {
    options: Options,
    link: HostLink,
    state: ClientState,
    /// Deadline for the answer to the Hello.
    connect_by_us: u64,
    now_us: u64,
    welcome: Option<Welcome>,
    /// CRC-32 of the configuration that is active in the controller.
    active_crc: u32,
    requests: Requests,
    stream: Option<Stream>,
    telemetry: Option<Telemetry>,
    master: Option<MasterTelemetry>,
    /// When telemetry was last received or requested.
    telemetry_us: u64,
    waiting_telemetry: usize,
    notices: VecDeque<Notification>,
    jog_epoch: u16,
    master_epoch: u16,
    stop: Option<RepeatedStop>,
    stops_sent: u32,
}

/// An out-of-band stop that is repeated until the controller reports standstill.
#[derive(Debug)]
struct RepeatedStop {
    /// Time of the next transmission.
    next_us: u64,
    /// The ordinary stop that follows the out-of-band one. Reports after its acknowledgement are
    /// later than all requests before it.
    acknowledged: Option<Ticket>,
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
            master: None,
            telemetry_us: 0,
            waiting_telemetry: 0,
            notices: VecDeque::new(),
            jog_epoch: 1,
            master_epoch: 1,
            stop: None,
            stops_sent: 0,
        }
    }

    /// Begins a session; an open one is dropped, and its requests fail. `session` must be random:
    /// with a number that was used before, late frames of that session may be accepted.
    pub fn connect(&mut self, session: u32, now_us: u64) {
        self.end(ClientError::Closed);
        self.now_us = now_us;
        self.link.open(session, now_us);
        self.state = ClientState::Connecting;
        self.connect_by_us = now_us.saturating_add(self.options.connect_us);
        // The controller forgets its epochs when a session begins.
        self.jog_epoch = 1;
        self.master_epoch = 1;
        self.welcome = None;
        self.telemetry = None;
        self.master = None;
    }

    /// Ends the session on this side. The controller detects it by its heartbeat timeout.
    pub fn close(&mut self) {
        self.end(ClientError::Closed);
        self.link.close();
        self.state = ClientState::Closed;
    }

    /// The state of the session.
    pub fn state(&self) -> &ClientState {
        &self.state
    }

    /// The answer of the controller to the Hello.
    pub fn controller(&self) -> Option<&Welcome> {
        self.welcome.as_ref()
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    /// The newest telemetry of the master.
    pub fn master(&self) -> Option<&MasterTelemetry> {
        self.master.as_ref()
    }

    /// The link, for its counters and round trip.
    pub fn link(&self) -> &HostLink {
        &self.link
    }

    /// The next notification.
    pub fn poll(&mut self) -> Option<Notification> {
        let notification = self.notices.pop_front();
        if matches!(notification, Some(Notification::Telemetry(_))) {
            self.waiting_telemetry -= 1;
        }
        notification
    }

    /// Sends a request. Its acknowledgement is a [`Notification::Answered`] with the same ticket.
    /// Jobs, jogs, configurations and out-of-band stops have methods of their own.
    pub fn request(&mut self, command: Command) -> Ticket {
        if matches!(command, Command::Hold | Command::Stop) {
            self.next_jog_epoch();
        }
        self.requests.ask(command)
    }

    /// Jogs after a stop belong to a new epoch: the controller rejects those of the epoch it ended.
    fn next_jog_epoch(&mut self) {
        self.jog_epoch = self.jog_epoch.wrapping_add(1).max(1);
    }

    /// Makes a configuration (as encoded by the firmware's types) the active one, unless it is
    /// already. Acknowledged as `activate`. With `at_preset` it is sent in any case, and the joints
    /// are taken to be at their presets.
    pub fn configure(&mut self, config: &[u8], at_preset: bool) -> Ticket {
        let crc = crc32(config);
        if !config.is_empty() && crc == self.active_crc && !at_preset {
            return self.requests.acknowledged("activate", Ok(()));
        }
        let Ok(length) = self.send_chunks(config) else {
            let refused = Err(RequestError::Refused(Refusal::Range));
            return self.requests.acknowledged("activate", refused);
        };
        self.requests.ask(Command::Activate {
            length,
            crc,
            at_preset,
        })
    }

    /// Orders that the board keeps a configuration, which must be the active one. Acknowledged as
    /// `store` when it is kept.
    pub fn store(&mut self, config: &[u8]) -> Ticket {
        let Ok(length) = self.send_chunks(config) else {
            let refused = Err(RequestError::Refused(Refusal::Range));
            return self.requests.acknowledged("store", refused);
        };
        let crc = crc32(config);
        self.requests.ask(Command::Store { length, crc })
    }

    /// Stages a configuration; returns its length.
    fn send_chunks(&mut self, config: &[u8]) -> Result<u16, TryFromIntError> {
        let length = u16::try_from(config.len())?;
        for (index, chunk) in config.chunks(CONFIG_CHUNK).enumerate() {
            let chunk = ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            };
            self.requests.send_unacknowledged(Command::Configure(chunk));
        }
        Ok(length)
    }

    /// Begins a job at `pose`, which must equal the commanded pose of the controller
    /// ([`Telemetry::commanded`]). Setpoints are taken as the queue of the controller has free
    /// slots. The end is reported by [`Notification::Job`].
    ///
    /// # Errors
    ///
    /// No session is open, or a job is running.
    pub fn start_job(
        &mut self,
        job: u32,
        pose: AxisValues,
        setpoints: impl Into<Setpoints>,
    ) -> Result<(), ClientError> {
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
        self.stream = Some(Stream::new(job, start, &pose, welcome, setpoints.into()));
        Ok(())
    }

    /// Progress of the job, if one is running.
    pub fn job(&self) -> Option<JobStatus> {
        self.stream.as_ref().map(Stream::progress)
    }

    /// Moves at these rates (axis units per second divided by 2^8, one per pose coordinate) for at
    /// most `timeout_ms`. To keep moving, callers must repeat it in time. Only the newest jog
    /// counts; nothing is queued.
    ///
    /// # Errors
    ///
    /// [`ClientError::Closed`] when no session is open.
    pub fn jog(&mut self, rates: AxisValues, timeout_ms: u16) -> Result<(), ClientError> {
        let command = Command::Jog {
            epoch: self.jog_epoch,
            timeout_ms,
            rates,
        };
        self.link
            .send_latest(&Request { id: 0, command })
            .map_err(|_| ClientError::Closed)
    }

    /// Stops jogging: jogs that were sent before have no effect, whenever they arrive.
    pub fn cancel_jog(&mut self) -> Ticket {
        let ticket = self.requests.ask(Command::JogCancel {
            epoch: self.jog_epoch,
        });
        self.next_jog_epoch();
        ticket
    }

    /// Sends a pose of the remote master and its age. Only the newest sample counts; a lost one is
    /// not sent again.
    ///
    /// # Errors
    ///
    /// [`ClientError::Closed`] when no session is open.
    pub fn send_master_pose(&mut self, pose: MasterPose, age_ms: u8) -> Result<(), ClientError> {
        let command = Command::MasterPose {
            epoch: self.master_epoch,
            age_ms,
            pose,
        };
        self.link
            .send_latest(&Request { id: 0, command })
            .map_err(|_| ClientError::Closed)
    }

    /// Begins a new epoch of master samples, after a hold: earlier samples have no effect, whenever
    /// they arrive.
    pub fn begin_master_epoch(&mut self) {
        self.master_epoch = self.master_epoch.wrapping_add(1).max(1);
    }

    /// Sends the force on the tool to the controller of the master: x, y, z, in 2^-6 N. Only the
    /// newest force counts.
    ///
    /// # Errors
    ///
    /// [`ClientError::Closed`] when no session is open.
    pub fn send_remote_force(&mut self, force: [i16; COMPONENTS]) -> Result<(), ClientError> {
        let command = Command::RemoteForce { force };
        self.link
            .send_latest(&Request { id: 0, command })
            .map_err(|_| ClientError::Closed)
    }

    /// Stops the machine as fast as possible: the next [`Client::advance`] sends the bytes of the
    /// out-of-band stop before everything else, and repeats them until standstill is reported. A
    /// job is dropped. Acknowledged as `stop`, unless an out-of-band stop was being sent already.
    pub fn stop_out_of_band(&mut self) {
        if self.stop.is_some() {
            return;
        }
        // Requests that are not sent yet must not arrive after the stop.
        self.requests.withdraw();
        self.next_jog_epoch();
        if let Some(stream) = self.stream.as_mut() {
            stream.abandon();
            let ending = stream.withdrawn(&self.requests);
            self.finish_job(ending);
        }
        let acknowledged =
            (self.state == ClientState::Ready).then(|| self.requests.ask(Command::Stop));
        self.stop = Some(RepeatedStop {
            next_us: 0,
            acknowledged,
        });
    }

    /// Whether an out-of-band stop is still being repeated, and how many were sent in total.
    pub fn repeated_stop(&self) -> (bool, u32) {
        (self.stop.is_some(), self.stops_sent)
    }

    /// Takes the received bytes and appends the bytes to send. Must be called regularly, also when
    /// nothing was received.
    pub fn advance(&mut self, now_us: u64, received: &[u8], transmit: &mut Vec<u8>) {
        self.now_us = self.now_us.max(now_us);
        let now_us = self.now_us;
        if let Some(stop) = self.stop.as_mut().filter(|stop| now_us >= stop.next_us) {
            // This breaks a frame that is being sent; the link sends it again.
            transmit.extend_from_slice(&out_of_band::STOP);
            self.stops_sent += 1;
            stop.next_us = now_us.saturating_add(self.options.stop_repeat_us);
        }
        // In chunks, so that no burst overruns the inbox.
        let mut chunks = received.chunks(256);
        loop {
            let chunk = chunks.next();
            self.link.receive(now_us, chunk.unwrap_or_default());
            self.follow_link();
            while let Some(report) = self.link.poll_message() {
                self.receive_report(report);
            }
            if chunk.is_none() {
                break;
            }
        }
        self.send_pending();
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

    /// Queues notifications of finished requests.
    fn collect(&mut self) {
        for (ticket, command, result) in self.requests.take_finished() {
            self.notices.push_back(Notification::Answered {
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

    /// Passes requests, then setpoints, to the link, as far as its window allows.
    fn send_pending(&mut self) {
        if self.state != ClientState::Ready {
            return;
        }
        let late = self.requests.expire(self.now_us, self.line_health());
        if let Some(stream) = self.stream.as_mut() {
            let ending = late.and_then(|(ticket, error)| stream.failed(ticket, error));
            self.finish_job(ending);
        }
        if self.stream.is_some() && self.now_us.saturating_sub(self.telemetry_us) >= STATUS_AFTER_US
        {
            // Telemetry carries the credit of the job, and may be switched off or too slow.
            self.requests.send_unacknowledged(Command::Status);
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
                self.notices.push_back(Notification::Job(ending));
            }
        }
    }
}
