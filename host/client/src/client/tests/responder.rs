//! The controller side for the tests of the client: link, setpoint decoder and stop are real, the
//! motion is simplified.

use super::*;

/// Setpoints that the queue holds.
pub(super) const QUEUE: u32 = 64;
const PERIOD_US: u16 = 200;

/// The controller side.
pub(super) struct Responder {
    pub(super) link: ControllerLink,
    pub(super) stop_detector: StopDetector,
    pub(super) state: State,
    pub(super) period: u64,
    pub(super) staged: Vec<u8>,
    pub(super) config: Vec<u8>,
    pub(super) coder: Option<SetpointCoder>,
    pub(super) job: u32,
    pub(super) queue: VecDeque<Setpoint>,
    pub(super) expected: u32,
    pub(super) count: Option<u32>,
    pub(super) done: u32,
    pub(super) wait: u16,
    pub(super) every: u16,
    pub(super) epoch: u16,
    pub(super) cancelled: u16,
    pub(super) jog_left: u64,
    /// Functions that are disabled.
    pub(super) busy: bool,
    pub(super) mute: Option<&'static str>,
    pub(super) dead: bool,
    /// Record of its actions.
    pub(super) reached: Vec<Setpoint>,
    pub(super) jogs: Vec<(u64, u16)>,
    pub(super) stops_received: u32,
    pub(super) activated: u32,
    /// Times at which `Enable` came, and how many of them are refused because of a driver chip.
    pub(super) enables: Vec<u64>,
    pub(super) refused_enables: usize,
}

impl Responder {
    pub(super) fn new() -> Self {
        Self {
            link: ControllerLink::new(Timing {
                line_rate: 11_520,
                ..Timing::default()
            }),
            stop_detector: StopDetector::new(),
            state: State::Idle,
            period: 0,
            staged: Vec::new(),
            config: Vec::new(),
            coder: None,
            job: 0,
            queue: VecDeque::new(),
            expected: 0,
            count: None,
            done: 0,
            wait: 0,
            every: 100,
            epoch: 0,
            cancelled: 0,
            jog_left: 0,
            busy: false,
            mute: None,
            dead: false,
            reached: Vec::new(),
            jogs: Vec::new(),
            stops_received: 0,
            activated: 0,
            enables: Vec::new(),
            refused_enables: 0,
        }
    }

    /// One control period.
    pub(super) fn period(&mut self, now_us: u64, bytes: &[u8], buffer: &mut [u8; 64]) -> usize {
        self.period += 1;
        if self.dead {
            return 0;
        }
        if self.stop_detector.push_all(bytes) {
            self.stops_received += 1;
            self.jog_left = 0;
            if self.state == State::Run {
                self.go(State::Hold);
            }
        }
        self.link.receive(now_us, bytes);
        let crc = if self.config.is_empty() {
            0
        } else {
            crc32(&self.config)
        };
        let identity = Identity {
            machine: "responder",
            config_crc: crc,
            period_us: PERIOD_US,
            axes: 2,
            queue: QUEUE as u16,
            kept: haptimill_protocol::message::Kept::Unsupported,
        };
        if self.link.welcome(now_us, &identity, self.busy) == HelloOutcome::Begun {
            (self.epoch, self.cancelled) = (0, 0);
        }
        // Space for an acknowledgement and for the events of a command or of this period.
        if self.link.room(SHORT_REPORT) >= 4
            && let Some(Request { id, command }) = self.link.poll_message()
            && self.mute != Some(command.name())
        {
            let result = self.obey(command);
            if id != 0 || result.is_err() {
                self.link
                    .send(&Report::Answer { id, result })
                    .expect("room for an answer");
            }
        }
        self.jog_left = self.jog_left.saturating_sub(1);
        if self.state == State::Run {
            self.advance();
        }
        if self.every != 0 && self.period.is_multiple_of(u64::from(self.every)) {
            let telemetry = self.telemetry();
            let _ = self.link.send_latest(&Report::Telemetry(telemetry));
        }
        self.link.transmit(now_us, buffer)
    }

    fn advance(&mut self) {
        if self.count == Some(self.done) {
            self.push_event(Event::JobDone {
                job: self.job,
                setpoints: self.done,
            });
            self.go(State::Idle);
            return;
        }
        let Some(next) = self.queue.front() else {
            return;
        };
        self.wait += 1;
        if self.wait >= next.periods {
            self.wait = 0;
            self.done += 1;
            self.reached.extend(self.queue.pop_front());
        }
    }

    fn drop_job(&mut self) {
        if self.coder.take().is_some() && self.state != State::Idle {
            self.queue.clear();
            self.push_event(Event::JobDropped {
                job: self.job,
                setpoints: self.done,
            });
            self.go(State::Idle);
        }
    }

    fn go(&mut self, to: State) {
        let from = std::mem::replace(&mut self.state, to);
        self.push_event(Event::State {
            from,
            to,
            homed: true,
        });
    }

    fn push_event(&mut self, event: Event) {
        self.link
            .send(&Report::Event {
                period: self.period,
                event,
            })
            .expect("room for an event");
    }

    fn telemetry(&self) -> Telemetry {
        Telemetry {
            period: self.period,
            state: self.state,
            homed: true,
            credit: self.done + QUEUE,
            setpoint: self.done,
            program_periods: self
                .reached
                .iter()
                .map(|setpoint| u32::from(setpoint.periods))
                .sum::<u32>()
                + u32::from(self.wait),
            speed_factor: haptimill_protocol::message::FULL_SPEED_FACTOR,
            commanded: AxisValues::new(),
            measured: AxisValues::new(),
            joints: AxisValues::new(),
            turns: AxisValues::new(),
            following_error: AxisValues::new(),
            open_loop: 0,
            drive: AxisValues::new(),
            fault: None,
            deferred_bytes: 0,
            bad_frames: self.link.counters().bad_frames,
            force: None,
            io: None,
            more: Default::default(),
            lost_bytes: 0,
        }
    }

    fn obey(&mut self, command: Command) -> Result<(), Refusal> {
        match command {
            Command::Enable => {
                self.enables.push(self.period * u64::from(PERIOD_US));
                if self.enables.len() <= self.refused_enables {
                    let alarm = DriveAlarm::Setting;
                    let problem = InputProblem::Drive { joint: 1, alarm };
                    return Err(Refusal::Input(problem));
                }
            }
            Command::Configure(chunk) => {
                self.staged.truncate(usize::from(chunk.offset));
                self.staged.extend(&chunk.bytes);
            }
            Command::Activate { length, crc, .. } => {
                if usize::from(length) != self.staged.len() || crc != crc32(&self.staged) {
                    return Err(Refusal::ConfigCheck);
                }
                self.config = self.staged.clone();
                self.activated += 1;
            }
            Command::JobStart { job, pose } => {
                if self.state != State::Idle {
                    return Err(Refusal::State(self.state));
                }
                self.coder = Some(SetpointCoder::new(PERIOD_US, &pose));
                (self.job, self.expected, self.count, self.done, self.wait) = (job, 0, None, 0, 0);
                self.queue.clear();
                self.go(State::Run);
            }
            Command::Setpoints(batch) => {
                let coder = self.coder.as_mut().ok_or(Refusal::State(self.state))?;
                if batch.first != self.expected {
                    return Err(Refusal::OutOfOrder {
                        expected: self.expected,
                    });
                }
                for delta in &batch.items {
                    if self.queue.len() as u32 >= QUEUE {
                        return Err(Refusal::QueueFull);
                    }
                    let setpoint = coder.decode(delta).map_err(|_| Refusal::Setpoint {
                        setpoint: self.expected,
                    })?;
                    self.queue.push_back(setpoint);
                    self.expected += 1;
                }
            }
            Command::JobEnd { count } => self.count = Some(count),
            Command::Stop => self.drop_job(),
            Command::Jog {
                epoch, timeout_ms, ..
            } => {
                if epoch <= self.cancelled || epoch < self.epoch {
                    return Err(Refusal::OldEpoch);
                }
                self.epoch = epoch;
                self.jog_left = u64::from(timeout_ms) * 5;
                self.jogs.push((self.period, epoch));
            }
            Command::JogCancel { epoch } => {
                self.cancelled = self.cancelled.max(epoch);
                self.jog_left = 0;
            }
            Command::Status => {
                let telemetry = self.telemetry();
                let _ = self.link.send_latest(&Report::Telemetry(telemetry));
            }
            Command::Home => return Err(Refusal::NotHomed),
            _ => {}
        }
        Ok(())
    }
}
