//! Receiving: the state of the link, and the reports of the controller.

use super::{
    Client, ClientError, ClientState, JobEnding, MAX_TELEMETRY, Notification, RequestError,
};
use haptimill_protocol::link::LinkState;
use haptimill_protocol::message::{Command, Event, Report, State};

impl Client {
    /// Follows the state of the link.
    pub(super) fn follow_link(&mut self) {
        let failed = match (self.link.state(self.now_us), &self.state) {
            (LinkState::Open, ClientState::Connecting) => {
                if let Some(welcome) = self.link.peer() {
                    self.active_crc = welcome.config_crc;
                    self.welcome = Some(welcome.clone());
                    self.notices
                        .push_back(Notification::Connected(welcome.clone()));
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

    /// Ends the session: pending requests and the job fail.
    pub(super) fn end(&mut self, error: ClientError) {
        if !matches!(self.state, ClientState::Connecting | ClientState::Ready) {
            return;
        }
        self.requests.fail_all(&RequestError::Lost(error.clone()));
        self.collect();
        if let Some(stream) = self.stream.take() {
            self.notices
                .push_back(Notification::Job(stream.lost(error.clone())));
        }
        self.notices.push_back(Notification::Lost(error));
        if let Some(stop) = self.stop.as_mut() {
            // The bytes are still repeated: they may arrive where messages do not.
            stop.acknowledged = None;
        }
    }

    /// Takes a report of the controller.
    pub(super) fn receive_report(&mut self, report: Report) {
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
                    // Setpoints in the queue of the controller must not be executed.
                    self.requests.ask(Command::Stop);
                    self.notices.push_back(Notification::Job(ending));
                } else {
                    self.notices.push_back(Notification::Refused(refusal));
                }
            }
            Report::Answer { id, result } => {
                let Some((ticket, command)) = self.requests.answered(id, result, self.now_us)
                else {
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
                if let Some(stop) = self
                    .stop
                    .as_mut()
                    .filter(|stop| stop.acknowledged == Some(ticket))
                {
                    stop.acknowledged = None;
                }
            }
            Report::Event { period, event } => {
                let ending = self.stream.as_mut().and_then(|stream| stream.event(&event));
                if let Event::State { to, .. } = event {
                    self.check_standstill(to);
                }
                self.notices
                    .push_back(Notification::Event { period, event });
                self.finish_job(ending);
            }
            Report::Master(master) => self.master = Some(master),
            Report::Telemetry(telemetry) => {
                self.telemetry_us = self.now_us;
                if let Some(stream) = self.stream.as_mut() {
                    stream.telemetry(&telemetry);
                }
                self.check_standstill(telemetry.state);
                if self.waiting_telemetry >= MAX_TELEMETRY {
                    let oldest = self
                        .notices
                        .iter()
                        .position(|n| matches!(n, Notification::Telemetry(_)));
                    if let Some(oldest) = oldest {
                        self.notices.remove(oldest);
                        self.waiting_telemetry -= 1;
                    }
                }
                self.waiting_telemetry += 1;
                self.notices
                    .push_back(Notification::Telemetry(Box::new(telemetry.clone())));
                self.telemetry = Some(telemetry);
            }
        }
    }

    pub(super) fn finish_job(&mut self, ending: Option<JobEnding>) {
        if let Some(ending) = ending {
            self.stream = None;
            self.notices.push_back(Notification::Job(ending));
        }
    }

    /// Ends an out-of-band stop at standstill. Before the ordinary stop is acknowledged, a report
    /// may be older than the motion to be stopped.
    fn check_standstill(&mut self, state: State) {
        let at_rest = matches!(
            state,
            State::Disabled | State::Idle | State::Hold | State::Fault | State::EmergencyStop
        );
        if at_rest
            && self.state == ClientState::Ready
            && self
                .stop
                .take_if(|stop| stop.acknowledged.is_none())
                .is_some()
        {
            // A repeated out-of-band stop may arrive after the ordinary one. Another stop keeps the
            // order: later requests arrive after both.
            self.requests.send_unacknowledged(Command::Stop);
        }
    }
}
