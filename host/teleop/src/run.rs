//! The loop itself.

mod hand;
mod orders;

use super::latency::What;
use super::outcome::{Ended, Outcome, Row, Stop};
use super::script::{Heard, Order, scale};
use super::{Feeling, Latency, Source, Standing, Word};
use hand::Late;
use haptimill_client::client::Ticket;
use haptimill_client::session::EMERGENCY_STOP;
use haptimill_client::session::{JobLine, Session};
use haptimill_client::{Error, ErrorKind};
use haptimill_protocol::haptic::COMPONENTS;
use haptimill_protocol::message::{
    Action, Command, Event, SetpointBatch, Source as Leader, State, Telemetry,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

/// The host's number of the job in which a hand leads.
const JOB: u32 = 2;

/// How long a source may take until it can lead, microseconds.
const PATIENCE_US: u64 = 10_000_000;

/// How long the machine may take to come to rest at the end, microseconds.
const REST_US: u64 = 10_000_000;

/// A hand that was not heard of for so long leads nothing, so nothing is resumed, microseconds.
const FRESH_US: u64 = 100_000;

/// How a session is to go.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TeleopOptions {
    /// Pose coordinates that the hand leads.
    pub axes: Vec<u8>,
    /// G_P; that of the machine file when it is not given.
    pub scale: Option<f64>,
    /// Time between two reports of the machine, microseconds.
    pub every_us: u32,
    /// When it ends by itself, s.
    pub duration_s: Option<f64>,
    /// Speed of the spindle, rev/min; clockwise above 0.
    pub spindle_rpm: i16,
    /// Orders at their times, s, in order.
    pub orders: Vec<(f64, Order)>,
    /// A word of the hand that is so old leads nothing, ms: as the controller of the machine was told.
    pub stale_ms: u16,
    /// The machine is simulated in this process, and a person, or a port, keeps real time with it.
    pub real_time: bool,
}

/// A session under way.
pub struct Teleop<'a, L: JobLine> {
    session: &'a mut Session<L>,
    source: &'a mut dyn Source,
    options: &'a TeleopOptions,
    outcome: Outcome,
    latency: Latency,
    /// What the machine's controller senses, and what the arm's was told, can be looked into.
    machine_is_open: bool,
    arm_is_open: bool,
    begun_us: u64,
    /// Events that were looked at.
    seen: usize,
    /// Telemetry that was looked at.
    newest: Option<u64>,
    state: State,
    word: Word,
    word_us: Option<u64>,
    ending: bool,
    over: bool,
    asked: Vec<(Ticket, String)>,
    /// The last word about a hand that is lost.
    lost: Option<String>,
    /// Why the machine holds, when that was not ordered and nobody has told it to go on.
    unresumed: Option<String>,
    /// The link to the hand is lost, as was told.
    away: bool,
    late: Late,
    /// Somebody ordered the end; otherwise its time was over.
    ended_by_order: bool,
    setpoints: u32,
    wall: Option<Instant>,
    lines: Option<Receiver<Heard>>,
}

/// Gives up real time that a simulated machine is behind by more than this, microseconds.
const MOST_BEHIND_US: u64 = 20_000;

impl<'a, L: JobLine> Teleop<'a, L> {
    /// A session over a machine that is homed and stands idle.
    pub fn new(
        session: &'a mut Session<L>,
        source: &'a mut dyn Source,
        options: &'a TeleopOptions,
    ) -> Self {
        let latency = Latency::new(source.reflection());
        let seen = session.events.len();
        Self {
            session,
            source,
            options,
            latency,
            machine_is_open: false,
            arm_is_open: false,
            outcome: Outcome {
                ended: Ended::Done,
                because: None,
                duration_s: 0.0,
                words: 0,
                holds: Vec::new(),
                refused: Vec::new(),
                faults: Vec::new(),
                notes: Vec::new(),
                largest_force_n: [0.0; COMPONENTS],
                largest_felt_n: [0.0; COMPONENTS],
                latency: None,
                latency_is_exact: false,
                machine_round_trip_ms: 0.0,
                hand_round_trip_ms: 0.0,
                final_state: String::new(),
                position_kept: false,
            },
            begun_us: 0,
            seen,
            newest: None,
            state: State::Idle,
            word: Word::default(),
            word_us: None,
            ending: false,
            over: false,
            asked: Vec::new(),
            lost: None,
            unresumed: None,
            away: false,
            late: Late::default(),
            ended_by_order: false,
            setpoints: 0,
            wall: None,
            lines: None,
        }
    }

    /// With orders that come from elsewhere, or words that are none.
    #[must_use]
    pub fn hearing(mut self, lines: Option<Receiver<Heard>>) -> Self {
        self.lines = lines;
        self
    }

    /// Lets the hand lead until the end; `look` is shown every moment that was reported, and is told what happens, in words.
    ///
    /// # Errors
    /// The controller refuses, a port of the machine is gone, or what is there is no source. How the machine fared is no error, see [`Outcome`].
    pub fn run(
        mut self,
        look: &mut dyn FnMut(Option<&Row>, Option<&str>),
    ) -> Result<Outcome, Error> {
        self.wait_for_source(look)?;
        self.begin()?;
        let mut orders = self.options.orders.iter().peekable();
        let mut stopping_us = None;
        while !self.over {
            self.go_on()?;
            let now_s = self.time_s();
            self.hear_events(look);
            while let Some(what) = self.source.happened() {
                self.note(what, look);
            }
            self.hear_hand(look);
            if let Some(row) = self.hear_report() {
                look(Some(&row), None);
            }
            while let Some((_, order)) = orders.next_if(|(at_s, _)| *at_s <= now_s) {
                self.carry_out(*order, look);
            }
            while let Some(order) = self.source.order() {
                self.carry_out(order, look);
            }
            while let Some(line) = self.lines.as_ref().and_then(|lines| lines.try_recv().ok()) {
                self.obey(line, look);
            }
            self.hear_answers(look);
            let time_is_over = self.options.duration_s.is_some_and(|end| now_s >= end);
            if time_is_over && !self.ending {
                self.carry_out(Order::End, look);
                self.ended_by_order = false;
            }
            if self.session.interrupted() && stopping_us.is_none() {
                self.outcome.ended = Ended::Stopped;
                self.session.client_mut().urgent_stop();
                self.ending = true;
            }
            if self.ending {
                let since = *stopping_us.get_or_insert(self.session.now_us());
                if self.session.now_us() - since > REST_US {
                    let what = "the machine was told to come to rest and did not say that it has";
                    return Err(Error::new(ErrorKind::Port, what));
                }
            }
        }
        self.finish()
    }

    fn time_s(&self) -> f64 {
        self.session.now_us().saturating_sub(self.begun_us) as f64 * 1e-6
    }

    /// A step of everything; the newest word goes to the machine.
    fn go_on(&mut self) -> Result<(), Error> {
        self.keep_pace()?;
        let now_us = self.session.now_us();
        if let Some(word) = self.source.advance(now_us)? {
            self.word = word;
            self.word_us = Some(now_us.saturating_sub(word.age_us));
            self.tell();
        }
        while let Some(felt) = self.source.felt() {
            self.latency.felt(&felt);
            self.arm_is_open |= matches!(felt.what, What::Told(_));
        }
        Ok(())
    }

    /// One step of the machine, or as many as real time wants of a simulated one.
    fn keep_pace(&mut self) -> Result<(), Error> {
        if !self.options.real_time {
            self.session.step()?;
            return self.look_inside();
        }
        let wall = *self.wall.get_or_insert_with(Instant::now);
        let from = self.begun_us;
        loop {
            self.session.step()?;
            self.look_inside()?;
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
            if behind > MOST_BEHIND_US {
                // For the machine this process stood still, with the time in it.
                self.wall = Some(wall + Duration::from_micros(behind));
                return Ok(());
            }
        }
    }

    /// What a simulated controller senses, in the period in which it does.
    fn look_inside(&mut self) -> Result<(), Error> {
        let period_us = self
            .session
            .client_mut()
            .controller()
            .map_or(200, |welcome| u64::from(welcome.period_us));
        let at_us = self.session.now_us().saturating_sub(period_us);
        if let Some(snapshot) = self.session.line_mut().snapshot() {
            self.machine_is_open = true;
            self.latency.sensed(at_us, told(&snapshot.force.high));
        }
        Ok(())
    }

    fn wait_for_source(
        &mut self,
        look: &mut dyn FnMut(Option<&Row>, Option<&str>),
    ) -> Result<(), Error> {
        self.begun_us = self.session.now_us();
        let begun_us = self.begun_us;
        let mut told = String::new();
        loop {
            match self.source.standing() {
                Standing::Ready => return Ok(()),
                standing => {
                    let why = standing.why().unwrap_or_default();
                    if self.session.now_us() - begun_us > PATIENCE_US {
                        let exit = match standing {
                            Standing::Off(_) => ErrorKind::Fault,
                            _ => ErrorKind::Port,
                        };
                        let what = format!("the hand cannot lead: {why}; nothing moved");
                        return Err(Error::new(exit, what));
                    }
                    if why != told {
                        look(None, Some(&format!("the hand: {why}")));
                        told = why.to_string();
                    }
                }
            }
            if self.session.interrupted() {
                return Err(Error::new(
                    ErrorKind::Stopped,
                    "stopped before the hand could lead",
                ));
            }
            self.go_on()?;
        }
    }

    /// The job begins, with no setpoint but that of the spindle.
    fn begin(&mut self) -> Result<(), Error> {
        if let Some(commanded) = self.options.scale {
            let scale = scale(commanded).map_err(|what| Error::new(ErrorKind::Usage, what))?;
            self.session.ask(Command::PositionScale { scale })?;
        }
        for axis in &self.options.axes {
            self.session.ask(Command::Source {
                axis: *axis,
                source: Leader::Master,
            })?;
        }
        let period_us = self
            .session
            .client_mut()
            .controller()
            .map_or(200, |welcome| welcome.period_us);
        let every = (self.options.every_us / u32::from(period_us.max(1))).clamp(1, 60_000) as u16;
        self.session.ask(Command::Telemetry { every })?;
        let pose = self.session.status()?.commanded;
        self.session.ask(Command::JobStart {
            job: JOB,
            pose: pose.clone(),
        })?;
        self.state = State::Run;
        if self.options.spindle_rpm != 0 {
            let rest = Setpoint {
                periods: 1,
                pose: pose.clone(),
                rates: pose.iter().map(|_| 0).collect(),
                action: Action::Spindle(self.options.spindle_rpm),
            };
            let delta = SetpointCoder::new(period_us, &pose)
                .encode(&rest)
                .map_err(|error| Error::new(ErrorKind::Internal, error))?;
            let mut batch = SetpointBatch {
                first: 0,
                items: Default::default(),
            };
            // There is room for one.
            let _ = batch.items.push(delta);
            self.setpoints = 1;
            self.session.ask(Command::Setpoints(batch))?;
        }
        self.begun_us = self.session.now_us();
        self.wall = None;
        Ok(())
    }

    fn hear_events(&mut self, look: &mut dyn FnMut(Option<&Row>, Option<&str>)) {
        while let Some((_, event)) = self.session.events.get(self.seen) {
            let event = event.clone();
            self.seen += 1;
            let sentence = self
                .session
                .model()
                .with_axes(|axes| axes.describe(&event).to_string());
            match &event {
                Event::MasterLost { .. } => {
                    let standing = self.source.standing();
                    self.lost = Some(match standing.why() {
                        Some(why) => format!("{sentence} ({why})"),
                        None => sentence.clone(),
                    });
                }
                Event::State { to, .. } => self.enters(*to),
                Event::JobDone { job: JOB, .. } => self.over = true,
                Event::JobDropped { job: JOB, .. } => {
                    self.over = true;
                    if self.outcome.ended == Ended::Done && !self.ending {
                        self.outcome.ended = Ended::Stopped;
                    }
                }
                Event::Fault(fault) => {
                    self.outcome.ended = Ended::Fault;
                    let fault = self.session.sentence(fault);
                    self.outcome.faults.push(fault);
                }
                _ if !self.outcome.notes.contains(&sentence) => {
                    self.outcome.notes.push(sentence.clone());
                }
                _ => {}
            }
            look(None, Some(&sentence));
        }
    }

    fn enters(&mut self, to: State) {
        let at_s = self.time_s();
        if to == State::Hold && self.state == State::Run && !self.ending {
            self.unresumed = self.lost.take();
            let why = self.unresumed.clone();
            let why = why.unwrap_or_else(|| "it was ordered".to_string());
            self.outcome.holds.push(Stop {
                at_s,
                why,
                resumed_s: None,
            });
        }
        if to == State::Run {
            self.unresumed = None;
        }
        if to == State::Run
            && self.state == State::Hold
            && let Some(hold) = self.outcome.holds.last_mut()
        {
            hold.resumed_s = Some(at_s);
        }
        self.state = to;
    }

    /// A report of the machine: what the tool feels goes to the hand.
    fn hear_report(&mut self) -> Option<Row> {
        let telemetry: Telemetry = self.session.client_mut().telemetry()?.clone();
        if self.newest.replace(telemetry.period) == Some(telemetry.period) {
            return None;
        }
        let now_us = self.session.now_us();
        let force = telemetry
            .force
            .as_ref()
            .filter(|force| force.tared && force.problem.is_none());
        let high = force.map_or([0; COMPONENTS], |force| force.high);
        let tells = told(&high);
        if !self.machine_is_open {
            let trip = u64::from(self.session.client_mut().link().round_trip_us());
            self.latency.sensed(now_us.saturating_sub(trip / 2), tells);
        }
        if self.state == State::Run {
            self.latency.told(tells);
        }
        // In free air, in a hold and without a sensor it feels nothing.
        self.source.feel(if self.state == State::Run {
            tells
        } else {
            [0; COMPONENTS]
        });
        let Feeling { force, reflected } = self.source.feeling().unwrap_or_default();
        let newtons = high.map(|part| f64::from(part) / 65_536.0);
        let largest = |most: &mut [f64; COMPONENTS], now: &[f64; COMPONENTS]| {
            for (most, now) in most.iter_mut().zip(now) {
                *most = most.max(now.abs());
            }
        };
        largest(&mut self.outcome.largest_force_n, &newtons);
        largest(&mut self.outcome.largest_felt_n, &force);
        let three = |values: &[f64]| {
            std::array::from_fn(|axis| values.get(axis).copied().unwrap_or_default())
        };
        let model = self.session.model();
        let mm = |raw: i32| f64::from(raw) / haptimill_machine_file::scale::PER_MM;
        Some(Row {
            time_s: self.time_s(),
            state: telemetry.state,
            hand: self.word.hand.tip.map(mm),
            engaged: self.word.hand.engaged,
            age_ms: self
                .word_us
                .map_or(0.0, |at| now_us.saturating_sub(at) as f64 / 1000.0),
            commanded: three(&model.to_engineering_units(&telemetry.commanded)),
            tool: three(&model.to_engineering_units(&telemetry.measured)),
            force: newtons,
            felt: force,
            reflected,
        })
    }

    /// What is latched at the end counts, whatever was heard of it on the way there.
    fn judge_machine(&mut self, status: &Telemetry) {
        match (status.state, &status.fault) {
            (State::EmergencyStop, _) => {
                self.outcome.faults.push(EMERGENCY_STOP.to_string());
                self.outcome.because = Some(EMERGENCY_STOP.to_string());
            }
            (State::Fault, Some(fault)) if self.outcome.faults.is_empty() => {
                let fault = self.session.sentence(fault);
                self.outcome.faults.push(fault);
            }
            (State::Fault, _) => {}
            _ => return,
        }
        self.outcome.ended = Ended::Fault;
    }

    fn finish(mut self) -> Result<Outcome, Error> {
        self.outcome.duration_s = self.time_s();
        let begun_us = self.session.now_us();
        let status = loop {
            let status = self.session.status()?;
            let moves = matches!(status.state, State::Run | State::Hold);
            if !moves || self.session.now_us() - begun_us > REST_US {
                break status;
            }
        };
        self.session.ask(Command::Telemetry { every: 0 })?;
        if status.state == State::Idle {
            for axis in &self.options.axes {
                self.session.ask(Command::Source {
                    axis: *axis,
                    source: Leader::Program,
                })?;
            }
        }
        self.judge_machine(&status);
        self.judge_hand();
        let ms = |us: u32| f64::from(us) / 1000.0;
        self.outcome.latency = self.latency.figures();
        self.outcome.latency_is_exact = self.machine_is_open && self.arm_is_open;
        self.outcome.machine_round_trip_ms = ms(self.session.client_mut().link().round_trip_us());
        self.outcome.hand_round_trip_ms = ms(self.source.round_trip_us());
        self.outcome.final_state = format!("{:?}", status.state);
        self.outcome.position_kept = status.position_kept;
        Ok(self.outcome)
    }
}

/// A force as it is told to the arm: 2^-16 N to 2^-6 N.
fn told(force: &[i32; COMPONENTS]) -> [i16; COMPONENTS] {
    force.map(|part| (part >> 10).clamp(-32768, 32767) as i16)
}
