//! A haptic arm on a controller of its own: a second controller, whose machine file has the role
//! `master`.
//!
//! The arm is a [`Session`] whose startup sends the machine file, enables the drives, and requests
//! the telemetry of the master. It never waits: while the machine is operated, a lost link or port
//! is opened again, and the arm is the master again once the operator has resumed the machine.
//!
//! Callers must call [`MasterDevice::advance`] regularly: without keep-alive frames the controller
//! of the arm exerts no more force.

use super::latency::ForceValue;
use super::script::ScriptedOperator;
use super::{ForceSample, MasterDevice, MasterForce, MasterSample, MasterStatus};
use haptimill_client::board::Chosen;
use haptimill_client::client::Options;
use haptimill_client::port::PortError;
use haptimill_client::session::{
    JobLine, JobRecording, Line, Numbers, Session, SessionPhase, SimLine, Startup,
};
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, MasterTelemetry};
use haptimill_protocol::message::{Command, Event};
use haptimill_trace::Recorder;
use std::collections::VecDeque;
use std::sync::Arc;

/// A line to a simulated arm that an operator of a script moves.
pub struct OperatorLine {
    line: SimLine,
    operator: ScriptedOperator,
}

impl OperatorLine {
    /// A line to a simulated arm.
    #[must_use]
    pub const fn new(line: SimLine, operator: ScriptedOperator) -> Self {
        Self { line, operator }
    }
}

impl Line for OperatorLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        self.operator.act(self.line.rig_mut());
        self.line.exchange(transmit, received)
    }

    fn name(&self) -> String {
        "the simulated arm".to_string()
    }

    fn snapshot(&self) -> Option<Snapshot> {
        self.line.snapshot()
    }

    fn is_recording_broken(&self) -> bool {
        self.line.is_recording_broken()
    }

    fn remote_force(&self) -> Option<[i16; COMPONENTS]> {
        let arm = self.line.rig().control().machine()?.masters.arm()?;
        Some(arm.remote_force())
    }

    fn record_event(&mut self, period: u64, level: u8, text: &str) {
        self.line.record_event(period, level, text);
    }
}

impl JobLine for OperatorLine {
    fn begin_recording(&mut self, recording: JobRecording) {
        self.line.begin_recording(recording);
    }

    fn end_recording(&mut self) -> Option<Recorder> {
        self.line.end_recording()
    }
}

/// Longest time in which the board of an arm must answer before anything moves, microseconds.
const PREPARE_US: u64 = 5_000_000;

/// Time in which the controller of an arm must answer, microseconds.
const CONNECT_US: u64 = 1_000_000;

/// Forces that are kept at most: more than arrive between two steps of the loop.
const MAX_FORCES: usize = 10_000;

/// Periods between two reports, and the bandwidth of the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkRates {
    /// Time between two reports of the master, microseconds.
    pub every_us: u32,
    /// Bytes per second; 0 for no limit.
    pub line_rate: u32,
}

/// A haptic arm.
pub struct Arm<L> {
    session: Session<L>,
    force_feedback: Option<ForceFeedback>,
    /// Times of the loop and of the line when the line was opened.
    origin_us: Option<(u64, u64)>,
    newest_period: Option<u64>,
    telemetry: Option<MasterTelemetry>,
    forces: VecDeque<ForceSample>,
    next_event: usize,
    messages: VecDeque<String>,
}

/// A force in newtons from units of 2^-8 N.
fn newtons(force: [i16; COMPONENTS]) -> [f64; COMPONENTS] {
    force.map(|part| f64::from(part) / 256.0)
}

impl<L: Line> Arm<L> {
    /// Checks that a machine file describes a haptic arm without a machine.
    ///
    /// # Errors
    /// It does not.
    pub fn check(machine: &MachineFile) -> Result<(), Error> {
        if !machine.is_master() {
            let what = format!(
                "{}: not a haptic arm alone; write role = \"master\", as in machines/haptic-master.toml",
                machine.file
            );
            return Err(Error::new(ErrorKind::BadInput, what));
        }
        Ok(())
    }

    /// The arm of a machine file at a line. For an arm on a board, `board` chooses the
    /// configuration: the board keeps its own unless the choice allows another one. `numbers` gives
    /// the numbers of its sessions.
    ///
    /// # Errors
    /// The machine file does not describe a haptic arm alone.
    pub fn new(
        line: L,
        machine: &MachineFile,
        board: Option<Chosen>,
        rates: LinkRates,
        numbers: Numbers,
    ) -> Result<Self, Error> {
        Self::check(machine)?;
        let mut options = Options::default();
        options.timing.line_rate = rates.line_rate;
        options.connect_us = CONNECT_US;
        let period_us = u32::from(machine.config.period_us.max(1));
        let every = (rates.every_us / period_us).clamp(1, u32::from(u16::MAX)) as u16;
        let commands = vec![Command::Enable, Command::MasterTelemetry { every }];
        let startup = Startup::new(machine, board, commands)?;
        let mut session = Session::new(line, machine, options, Arc::default())
            .with_startup(startup)
            .with_reconnection(numbers);
        // The machine has axes of the same numbers.
        session.clear_axes();
        Ok(Self {
            session,
            force_feedback: machine.config.haptic.as_ref().map(|arm| arm.feedback),
            origin_us: None,
            newest_period: None,
            telemetry: None,
            forces: VecDeque::new(),
            next_event: 0,
            messages: VecDeque::new(),
        })
    }

    /// The line.
    pub const fn line_mut(&mut self) -> &mut L {
        self.session.line_mut()
    }

    fn is_ready(&self) -> bool {
        *self.session.phase() == SessionPhase::Ready
    }

    /// Steps the session; false when the port is lost.
    fn step(&mut self) -> Result<bool, Error> {
        self.session.step()?;
        while let Some(notice) = self.session.next_notice() {
            self.messages.push_back(notice);
        }
        while let Some((_, event)) = self.session.events.get(self.next_event) {
            self.next_event += 1;
            if matches!(event, Event::Fault(_) | Event::Master(_)) {
                let text = format!("the arm: {}", self.session.describe(event));
                self.messages.push_back(text);
            }
        }
        if !self.is_ready() {
            self.telemetry = None;
        }
        Ok(*self.session.phase() != SessionPhase::Disconnected)
    }

    /// A new report as a master sample.
    fn take_sample(&mut self) -> Option<MasterSample> {
        if !self.is_ready() {
            return None;
        }
        let telemetry = *self.session.client().master()?;
        if self.newest_period.replace(telemetry.period) == Some(telemetry.period) {
            return None;
        }
        self.telemetry = Some(telemetry);
        Some(MasterSample {
            pose: telemetry.pose,
            age_us: u64::from(self.round_trip_us()) / 2,
        })
    }

    /// Keeps the force that the arm received or renders.
    fn keep_force(&mut self, at_us: u64, sample: Option<&MasterSample>) {
        let force = match (
            self.session.line_mut().remote_force(),
            sample,
            &self.telemetry,
        ) {
            (Some(force), ..) => ForceSample {
                at_us,
                value: ForceValue::Received(force),
            },
            (None, Some(sample), Some(telemetry)) => ForceSample {
                at_us: at_us.saturating_sub(sample.age_us),
                value: ForceValue::Reported {
                    force: newtons(telemetry.feedback),
                    is_in_deficit: telemetry.energy < 0,
                },
            },
            _ => return,
        };
        if self.forces.len() < MAX_FORCES {
            self.forces.push_back(force);
        }
    }
}

impl<L: Line> MasterDevice for Arm<L> {
    fn prepare(&mut self) -> Result<(), Error> {
        let startup = self.session.startup_mut();
        if startup.is_some_and(|startup| startup.has_board()) {
            self.session.identify(PREPARE_US)?;
        }
        Ok(())
    }

    fn advance(&mut self, now_us: u64) -> Result<Option<MasterSample>, Error> {
        if *self.session.phase() == SessionPhase::Disconnected {
            self.step()?;
            return Ok(None);
        }
        let (loop_us, line_us) = match self.origin_us {
            Some(origin) => origin,
            None => {
                // The line may have been open for long: this step reads its clock.
                if !self.step()? {
                    return Ok(None);
                }
                self.session.begin_next();
                *self.origin_us.insert((now_us, self.session.now_us()))
            }
        };
        let mut newest = None;
        loop {
            if !self.step()? {
                return Ok(None);
            }
            let at_us = loop_us + self.session.now_us().saturating_sub(line_us);
            let sample = self.take_sample();
            self.keep_force(at_us, sample.as_ref());
            newest = sample.or(newest);
            if at_us >= now_us {
                return Ok(newest);
            }
        }
    }

    fn status(&self) -> MasterStatus {
        match (self.is_ready(), &self.telemetry) {
            (true, Some(telemetry)) => match telemetry.problem {
                None => MasterStatus::Ready,
                Some(problem) => {
                    let problem = self.session.describe(&Event::Master(problem));
                    MasterStatus::Disabled(format!("the arm is disabled: {problem}"))
                }
            },
            (true, None) => MasterStatus::Waiting("no telemetry was received yet".to_string()),
            _ => MasterStatus::Waiting(match self.session.reason() {
                "" => "is being connected".to_string(),
                reason => reason.to_string(),
            }),
        }
    }

    fn send_force(&mut self, force: [i16; COMPONENTS]) {
        if self.is_ready() {
            // Fails without a session only: the arm gets no force then.
            let _ = self.session.client_mut().send_remote_force(force);
        }
    }

    fn force(&self) -> Option<MasterForce> {
        self.telemetry.as_ref().map(|telemetry| MasterForce {
            force: newtons(telemetry.force),
            feedback: newtons(telemetry.feedback),
        })
    }

    fn next_force_sample(&mut self) -> Option<ForceSample> {
        self.forces.pop_front()
    }

    fn force_feedback(&self) -> Option<ForceFeedback> {
        self.force_feedback
    }

    fn reset(&mut self) {
        if self.is_ready() {
            let client = self.session.client_mut();
            client.request(Command::Reset);
            client.request(Command::Enable);
        }
    }

    fn next_message(&mut self) -> Option<String> {
        self.messages.pop_front()
    }

    fn round_trip_us(&self) -> u32 {
        self.session.client().link().round_trip_us()
    }
}
