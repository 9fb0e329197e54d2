//! The teleoperation loop.

mod commands;
mod events;
mod master;

use super::latency::ForceValue;
use super::outcome::{Ended, Row, TeleopOutcome};
use super::script::{CommandInput, OperatorCommand, scale};
use super::{Latency, MasterDevice, MasterSample, MasterStatus};
use haptimill_client::client::Ticket;
use haptimill_client::session::{JobLine, Session};
use haptimill_client::{Error, ErrorKind};
use haptimill_protocol::haptic::COMPONENTS;
use haptimill_protocol::message::{Action, Command, SetpointBatch, Source, State};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use master::StaleSamples;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

/// The host's number of the job in which the master moves the tool.
const JOB: u32 = 2;

/// Longest time until the master is ready, microseconds.
const MASTER_READY_US: u64 = 10_000_000;

/// Longest time until the machine is at standstill at the end, microseconds.
const STANDSTILL_US: u64 = 10_000_000;

/// A resume command is refused when the newest sample is older, microseconds.
const FRESH_US: u64 = 100_000;

/// Receives the rows of the table and the messages of a session as they come.
type Report<'r> = dyn FnMut(Option<&Row>, Option<&str>) + 'r;

/// Settings of a session.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TeleopOptions {
    /// Pose coordinates that the master moves.
    pub coordinates: Vec<u8>,
    /// G_P; that of the machine file when it is not given.
    pub scale: Option<f64>,
    /// Time between two reports of the machine, microseconds.
    pub every_us: u32,
    /// When the session ends by itself, s.
    pub duration_s: Option<f64>,
    /// Speed of the spindle, rev/min; positive is clockwise.
    pub spindle_rpm: i16,
    /// Commands with their times, s, sorted.
    pub commands: Vec<(f64, OperatorCommand)>,
    /// Age from which the controller of the machine rejects a sample, ms.
    pub stale_ms: u16,
    /// The machine is simulated in this process, and must keep real time for an operator or a port.
    pub real_time: bool,
}

/// A session that is running.
pub struct Teleop<'a, L: JobLine> {
    session: &'a mut Session<L>,
    master: &'a mut dyn MasterDevice,
    options: &'a TeleopOptions,
    outcome: TeleopOutcome,
    latency: Latency,
    /// The measured force of the machine's controller is read from the simulator.
    has_machine_snapshot: bool,
    /// The force that the arm's controller received is read from the simulator.
    has_arm_snapshot: bool,
    start_us: u64,
    next_event: usize,
    /// Period of the newest telemetry.
    newest_period: Option<u64>,
    state: State,
    sample: MasterSample,
    sampled_us: Option<u64>,
    is_ending: bool,
    is_over: bool,
    pending: Vec<(Ticket, String)>,
    /// The newest message about a lost master.
    master_lost: Option<String>,
    /// Why the machine holds, when no command caused it and none has resumed it.
    unresumed: Option<String>,
    /// The link to the master is lost, and that was reported.
    is_away: bool,
    stale: StaleSamples,
    /// A command ended the session; otherwise its duration was over.
    is_ended_by_command: bool,
    setpoints: u32,
    /// Real time at which the virtual time of a simulated machine began.
    wall: Option<Instant>,
    input: Option<Receiver<CommandInput>>,
}

/// A simulated machine that is behind real time by more skips the difference, microseconds.
const MAX_BEHIND_US: u64 = 20_000;

impl<'a, L: JobLine> Teleop<'a, L> {
    /// A session on a machine that is homed and idle.
    pub fn new(
        session: &'a mut Session<L>,
        master: &'a mut dyn MasterDevice,
        options: &'a TeleopOptions,
    ) -> Self {
        let latency = Latency::new(master.force_feedback());
        let next_event = session.events.len();
        Self {
            session,
            master,
            options,
            latency,
            has_machine_snapshot: false,
            has_arm_snapshot: false,
            outcome: TeleopOutcome::default(),
            start_us: 0,
            next_event,
            newest_period: None,
            state: State::Idle,
            sample: MasterSample::default(),
            sampled_us: None,
            is_ending: false,
            is_over: false,
            pending: Vec::new(),
            master_lost: None,
            unresumed: None,
            is_away: false,
            stale: StaleSamples::default(),
            is_ended_by_command: false,
            setpoints: 0,
            wall: None,
            input: None,
        }
    }

    /// Takes commands from a channel as well.
    #[must_use]
    pub fn with_command_input(mut self, input: Option<Receiver<CommandInput>>) -> Self {
        self.input = input;
        self
    }

    /// Runs the session to its end; `report` gets each row of telemetry and each message.
    ///
    /// # Errors
    /// The controller refuses a command, a port of the machine failed, or the master is of another
    /// kind. A fault of the machine is no error, see [`TeleopOutcome`].
    pub fn run(mut self, report: &mut Report<'_>) -> Result<TeleopOutcome, Error> {
        self.wait_for_master(report)?;
        self.start()?;
        let mut commands = self.options.commands.iter().peekable();
        let mut stopping_us = None;
        while !self.is_over {
            self.step()?;
            let now_s = self.time_s();
            self.process_events(report);
            while let Some(message) = self.master.next_message() {
                self.note(message, report);
            }
            self.report_master(report);
            if let Some(row) = self.process_telemetry() {
                report(Some(&row), None);
            }
            while let Some((_, command)) = commands.next_if(|(at_s, _)| *at_s <= now_s) {
                self.execute(*command, report);
            }
            while let Some(command) = self.master.next_command() {
                self.execute(command, report);
            }
            for _ in 0..commands::MAX_AT_ONCE {
                let Some(input) = self.input.as_ref().and_then(|input| input.try_recv().ok())
                else {
                    break;
                };
                self.process_input(input, report);
            }
            self.process_acknowledgements(report);
            let is_time_over = self.options.duration_s.is_some_and(|end| now_s >= end);
            if is_time_over && !self.is_ending {
                self.execute(OperatorCommand::End, report);
                self.is_ended_by_command = false;
            }
            if self.session.is_interrupted() && stopping_us.is_none() {
                self.outcome.ended = Ended::Stopped;
                self.session.stop();
                self.is_ending = true;
            }
            if self.is_ending {
                let since = *stopping_us.get_or_insert(self.session.now_us());
                if self.session.now_us() - since > STANDSTILL_US {
                    let what = "the machine was stopped and did not report standstill";
                    return Err(Error::new(ErrorKind::Port, what));
                }
            }
        }
        self.finish()
    }

    fn time_s(&self) -> f64 {
        self.session.now_us().saturating_sub(self.start_us) as f64 * 1e-6
    }

    fn period_us(&self) -> u16 {
        let welcome = self.session.client().controller();
        welcome.map_or(200, |welcome| welcome.period_us)
    }

    /// Steps machine and master, and sends the newest sample to the machine.
    fn step(&mut self) -> Result<(), Error> {
        self.step_machine()?;
        let now_us = self.session.now_us();
        if let Some(sample) = self.master.advance(now_us)? {
            self.sample = sample;
            self.sampled_us = Some(now_us.saturating_sub(sample.age_us));
            self.send_sample();
        }
        while let Some(sample) = self.master.next_force_sample() {
            self.latency.record_at_master(&sample);
            self.has_arm_snapshot |= matches!(sample.value, ForceValue::Received(_));
        }
        Ok(())
    }

    /// One step of the machine, or as many as a simulated one needs to keep real time.
    fn step_machine(&mut self) -> Result<(), Error> {
        if !self.options.real_time {
            self.session.step()?;
            self.read_snapshot();
            return Ok(());
        }
        let wall = *self.wall.get_or_insert_with(Instant::now);
        let from = self.start_us;
        loop {
            self.session.step()?;
            self.read_snapshot();
            let virtual_us = self.session.now_us().saturating_sub(from);
            let real_us = u64::try_from(wall.elapsed().as_micros()).unwrap_or(u64::MAX);
            if virtual_us >= real_us {
                let ahead = virtual_us - real_us;
                if ahead > 1000 {
                    std::thread::sleep(Duration::from_micros(ahead));
                }
                return Ok(());
            }
            let behind = real_us - virtual_us;
            if behind > MAX_BEHIND_US {
                // This process did not run; the simulated machine did not either.
                self.wall = Some(wall + Duration::from_micros(behind));
                return Ok(());
            }
        }
    }

    /// Reads the force that a simulated controller measured, in the period of the measurement.
    fn read_snapshot(&mut self) {
        let at_us = self
            .session
            .now_us()
            .saturating_sub(u64::from(self.period_us()));
        if let Some(snapshot) = self.session.line_mut().snapshot() {
            self.has_machine_snapshot = true;
            let force = to_message_units(&snapshot.force.high);
            self.latency.record_measured(at_us, force);
        }
    }

    fn wait_for_master(&mut self, report: &mut Report<'_>) -> Result<(), Error> {
        self.start_us = self.session.now_us();
        let start_us = self.start_us;
        let mut reported = String::new();
        loop {
            let status = self.master.status();
            let Some(reason) = status.reason() else {
                return Ok(());
            };
            if self.session.now_us() - start_us > MASTER_READY_US {
                let kind = match status {
                    MasterStatus::Disabled(_) => ErrorKind::Fault,
                    _ => ErrorKind::Port,
                };
                let what = format!("the master is not ready: {reason}; nothing moved");
                return Err(Error::new(kind, what));
            }
            if reason != reported {
                report(None, Some(&format!("master: {reason}")));
                reported = reason.to_string();
            }
            if self.session.is_interrupted() {
                return Err(Error::new(
                    ErrorKind::Stopped,
                    "stopped before the master was ready",
                ));
            }
            self.step()?;
        }
    }

    /// Starts the job. Its only setpoint is that of the spindle.
    fn start(&mut self) -> Result<(), Error> {
        if let Some(commanded) = self.options.scale {
            let scale = scale(commanded).map_err(|what| Error::new(ErrorKind::Usage, what))?;
            self.session.ask(Command::PositionScale { scale })?;
        }
        for coordinate in &self.options.coordinates {
            self.session.ask(Command::Source {
                coordinate: *coordinate,
                source: Source::Master,
            })?;
        }
        let period_us = self.period_us();
        let every = (self.options.every_us / u32::from(period_us.max(1))).clamp(1, 60_000) as u16;
        self.session.ask(Command::Telemetry { every })?;
        let pose = self.session.status()?.commanded;
        self.session.ask(Command::JobStart {
            job: JOB,
            pose: pose.clone(),
        })?;
        self.state = State::Run;
        if self.options.spindle_rpm != 0 {
            let standstill = Setpoint {
                periods: 1,
                pose: pose.clone(),
                rates: pose.iter().map(|_| 0).collect(),
                action: Action::Spindle(self.options.spindle_rpm),
            };
            let delta = SetpointCoder::new(period_us, &pose)
                .encode(&standstill)
                .map_err(|error| Error::new(ErrorKind::Internal, error))?;
            let mut batch = SetpointBatch {
                first: 0,
                items: Default::default(),
            };
            // A batch holds more than one.
            let _ = batch.items.push(delta);
            self.setpoints = 1;
            self.session.ask(Command::Setpoints(batch))?;
        }
        self.start_us = self.session.now_us();
        self.wall = None;
        Ok(())
    }

    fn finish(mut self) -> Result<TeleopOutcome, Error> {
        self.outcome.duration_s = self.time_s();
        let since = self.session.now_us();
        let status = loop {
            let status = self.session.status()?;
            let moves = matches!(status.state, State::Run | State::Hold);
            if !moves || self.session.now_us() - since > STANDSTILL_US {
                break status;
            }
        };
        self.session.ask(Command::Telemetry { every: 0 })?;
        if status.state == State::Idle {
            for coordinate in &self.options.coordinates {
                self.session.ask(Command::Source {
                    coordinate: *coordinate,
                    source: Source::Program,
                })?;
            }
        }
        self.evaluate_machine(&status);
        self.evaluate_master();
        let ms = |us: u32| f64::from(us) / 1000.0;
        self.outcome.latency = self.latency.figures();
        self.outcome.latency_is_exact = self.has_machine_snapshot && self.has_arm_snapshot;
        self.outcome.machine_round_trip_ms = ms(self.session.client().link().round_trip_us());
        self.outcome.master_round_trip_ms = ms(self.master.round_trip_us());
        self.outcome.final_state = format!("{:?}", status.state);
        self.outcome.final_state_text = status.state.to_string();
        self.outcome.position_kept = status.homed;
        Ok(self.outcome)
    }
}

/// A force in the units of the message to the arm: 2^-16 N to 2^-6 N.
fn to_message_units(force: &[i32; COMPONENTS]) -> [i16; COMPONENTS] {
    force.map(|part| (part >> 10).clamp(-32768, 32767) as i16)
}
