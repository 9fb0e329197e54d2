//! Carries the script of an episode out, as a host and as the surroundings of the machine.

mod configuration;
mod contact;
mod job;
mod stimulus;

use super::bench::FuzzBench;
use super::checks::{Cause, Checks, Violation};
use super::command;
use super::episode::{Episode, stimulus_name};
use super::machines::MachineKind;
use super::rng::Rng;
use super::units::{MM, kind_unit};
use haptimill_protocol::haptic::MasterPose;
use haptimill_protocol::link::LinkState;
use haptimill_protocol::message::{AxisValues, Command, Refusal, State};
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};

/// Interval of the trace on standard output, in periods; 0 prints none.
pub static TRACE: AtomicU64 = AtomicU64::new(0);

/// Answer to a request; none if it did not come in time.
type Answer = Option<Result<(), Refusal>>;

/// Sends jogs at an interval.
struct JogSender {
    rates: AxisValues,
    timeout_ms: u16,
    every: u32,
    since: u32,
}

/// Sends the pose of a remote master.
struct MasterSender {
    rng: Rng,
    age_ms: u8,
    phase: f64,
    since: u32,
}

/// Carries a script out.
pub(super) struct Player {
    pub bench: FuzzBench,
    pub checks: Checks,
    /// Commands of the present job that are not sent yet.
    stream: VecDeque<Command>,
    /// Gap in the stream: the setpoint before which it comes, and the periods that are left.
    gap: Option<(u32, u32)>,
    jog_sender: Option<JogSender>,
    master_sender: Option<MasterSender>,
    epoch: u16,
    master_epoch: u16,
    job: u32,
    pub counts: BTreeMap<&'static str, u64>,
    pub faults: BTreeMap<String, u64>,
    had_fault: bool,
    kind: MachineKind,
    last_answer: Answer,
}

type PlayResult = Result<(), Violation>;

impl Player {
    pub(super) fn new(episode: &Episode) -> Self {
        let bench = FuzzBench::new(episode);
        Self {
            checks: Checks::new(episode, &bench),
            bench,
            stream: VecDeque::new(),
            gap: None,
            jog_sender: None,
            master_sender: None,
            epoch: 0,
            master_epoch: 0,
            job: 0,
            counts: BTreeMap::new(),
            faults: BTreeMap::new(),
            had_fault: false,
            kind: episode.kind,
            last_answer: None,
        }
    }

    pub(super) fn play(&mut self, episode: &Episode) -> PlayResult {
        if let Some(load) = episode.initial_load {
            *self
                .counts
                .entry("pushed before configuration")
                .or_default() += 1;
            for (joint, effort) in load.into_iter().enumerate() {
                self.bench.rig.plant_mut().set_load(joint, effort);
            }
            self.steps(400)?;
            for joint in 0..5 {
                self.bench.rig.plant_mut().set_load(joint, 0.0);
            }
        }
        self.steps(500)?;
        for step in &episode.script {
            *self
                .counts
                .entry(stimulus_name(&step.stimulus))
                .or_default() += 1;
            self.apply(&step.stimulus, step.periods)?;
        }
        if episode.with_replay
            && let Some(period) = self.bench.replay()
        {
            return Err(self.violation(
                "replay",
                format!("the same inputs give other outputs in period {period}"),
            ));
        }
        Ok(())
    }

    fn violation(&self, check: &'static str, text: String) -> Violation {
        Violation {
            check,
            text,
            period: self.bench.period,
        }
    }

    fn steps(&mut self, count: u32) -> PlayResult {
        for _ in 0..count {
            self.step()?;
        }
        Ok(())
    }

    fn step(&mut self) -> PlayResult {
        self.send_periodic();
        let ticked = self.bench.step();
        if let Some(answer) = self.bench.answers.last() {
            self.last_answer = Some(answer.result);
        }
        if self.bench.answers.iter().any(|answer| {
            matches!(
                answer.command,
                Command::Setpoints(_) | Command::JobStart { .. }
            ) && answer.result.is_err()
        }) {
            self.stream.clear();
        }
        let trace = TRACE.load(Ordering::Relaxed);
        if trace != 0 && self.bench.period.is_multiple_of(trace) {
            self.trace();
        }
        let checked = self.checks.check_period(&mut self.bench, ticked);
        let fault = self.bench.controller().safety().fault();
        if let Some(fault) = fault
            && !self.had_fault
        {
            let name = format!("{fault:?}");
            let name = name.split([' ', '(']).next().unwrap_or_default().to_owned();
            *self.faults.entry(name).or_default() += 1;
        }
        self.had_fault = fault.is_some();
        if matches!(
            self.bench.link_state(),
            LinkState::Silent | LinkState::Stalled
        ) && self.bench.away_since.is_none()
        {
            // The host gives up a session that has failed.
            self.checks.causes.push(Cause::HostSilent);
            self.bench.open_session();
        }
        checked
    }

    /// Prints state, commanded pose and motor positions.
    fn trace(&self) {
        let pose = self.commanded();
        let limits = self.bench.machine.config.pose.iter();
        let pose: Vec<String> = limits
            .zip(pose)
            .map(|(limits, place)| format!("{:.3}", f64::from(place) / kind_unit(limits.kind)))
            .collect();
        let joints: Vec<String> = (0..self.bench.axes)
            .map(|joint| format!("{:.3}", self.bench.latched.motor[joint]))
            .collect();
        println!(
            "{:>8} {:?} pose {} motors {}",
            self.bench.period,
            self.state(),
            pose.join(" "),
            joints.join(" ")
        );
    }

    /// Sends what is due in this period: jogs, master poses, and the present job.
    fn send_periodic(&mut self) {
        if self.bench.away_since.is_some() {
            return;
        }
        self.send_jog();
        self.send_master();
        self.send_job();
    }

    fn send_jog(&mut self) {
        let Some(sender) = &mut self.jog_sender else {
            return;
        };
        sender.since += 1;
        if sender.since >= sender.every {
            sender.since = 0;
            let jog = Command::Jog {
                epoch: self.epoch,
                timeout_ms: sender.timeout_ms,
                rates: sender.rates.clone(),
            };
            self.bench.send(&jog);
        }
    }

    fn send_master(&mut self) {
        let Some(sender) = &mut self.master_sender else {
            return;
        };
        sender.since += 1;
        if sender.since < 25 {
            return;
        }
        sender.since = 0;
        sender.phase += 0.01;
        let wave = |phase: f64| 8.0 * (1.0 - phase.cos());
        let slope = |phase: f64, part: f64| 8.0 * phase.sin() * part * 2.0;
        let (fast, slow) = (sender.phase, sender.phase * 0.7);
        let any = self.kind != MachineKind::RemoteMaster || sender.age_ms > 40;
        let hand = if any && sender.rng.chance(0.1) {
            command::any_master(&mut sender.rng)
        } else {
            MasterPose {
                tip: [(wave(fast) * MM) as i32, (wave(slow) * MM) as i32, 0],
                rate: [
                    (slope(fast, 1.0) * 4096.0) as i32,
                    (slope(slow, 0.7) * 4096.0) as i32,
                    0,
                ],
                axes: [[32_767, 0, 0], [0, 0, 32_767]],
                enabling_switch: true,
            }
        };
        let pose = Command::MasterPose {
            epoch: self.master_epoch,
            age_ms: sender.age_ms,
            pose: hand,
        };
        self.bench.send(&pose);
    }

    /// Sends the commands of the present job for which there is credit and room.
    fn send_job(&mut self) {
        if let Some((at, left)) = &mut self.gap {
            let here = matches!(
                self.stream.front(),
                Some(Command::Setpoints(batch)) if batch.first >= *at
            );
            if here && *left > 0 {
                *left -= 1;
                return;
            }
        }
        while let Some(command) = self.stream.front() {
            if let Command::Setpoints(batch) = command {
                let machine = self.bench.controller().machine();
                let credit = machine.map_or(0, |machine| machine.motion.program.credit());
                let last = batch.first + batch.items.len() as u32;
                let mut pending = self.bench.pending.iter();
                let starting =
                    pending.any(|pending| matches!(pending.command, Command::JobStart { .. }));
                if last > credit || starting {
                    break;
                }
            }
            if !self.bench.send(&command.clone()) {
                break;
            }
            self.stream.pop_front();
        }
    }

    /// Returns the number of coordinates; of a master alone that of the H-4 machines.
    fn axes(&self) -> usize {
        match self.kind {
            MachineKind::MasterAlone => 5,
            _ => self.bench.machine.config.pose.len(),
        }
    }

    fn state(&self) -> State {
        self.bench.controller().safety().state()
    }

    fn commanded(&self) -> [i32; 6] {
        self.bench.controller().machine().map_or([0; 6], |machine| {
            machine.motion.commanded().pose.0.map(|place| place.0)
        })
    }

    /// Sends a request and waits for its answer, for at most `periods` periods.
    fn ask(&mut self, command: &Command, periods: u32) -> Result<Answer, Violation> {
        let mut sent = false;
        // A last-value message has no answer; an older answer must not be taken for it.
        self.last_answer = None;
        for _ in 0..periods {
            if !sent {
                sent = self.bench.send(command);
            }
            self.step()?;
            if sent && self.bench.pending.is_empty() {
                return Ok(self.last_answer.take());
            }
        }
        Ok(None)
    }

    /// Waits until the machine is idle and every request is answered.
    fn wait_idle(&mut self, max: u32) -> PlayResult {
        for _ in 0..max {
            let idle = !matches!(
                self.state(),
                State::Run | State::Jog | State::Homing | State::Hold
            );
            if idle && self.stream.is_empty() && self.bench.pending.is_empty() {
                return Ok(());
            }
            self.step()?;
        }
        Ok(())
    }

    /// Recovers from faults, configures, enables and homes.
    fn recover(&mut self) -> PlayResult {
        self.stream.clear();
        self.jog_sender = None;
        self.master_sender = None;
        if self.bench.away_since.take().is_some() {
            self.bench.open_session();
        }
        // A fault by missed periods is latched after the last of them.
        while self.bench.rig.is_late() {
            self.step()?;
        }
        self.steps(10)?;
        if matches!(
            self.state(),
            State::Run | State::Hold | State::Jog | State::Homing
        ) {
            self.ask(&Command::Stop, 4000)?;
            self.wait_idle(12_000)?;
        }
        if matches!(self.state(), State::Fault | State::EmergencyStop) {
            // A slide without drive coasts for a while.
            self.steps(2500)?;
            self.ask(&Command::Reset, 4000)?;
        }
        let own = self.bench.machine.encoded().ok();
        if let Some((bytes, crc)) = own {
            let active = self.bench.controller().machine().map(|machine| machine.crc);
            if active != Some(crc) && matches!(self.state(), State::Disabled | State::Fault) {
                let first = active.is_none();
                if self.configure(&bytes, crc, false)? == Some(Ok(())) && first {
                    self.checks.foreign_configuration = false;
                }
            }
        }
        if self.state() == State::Disabled {
            self.ask(&Command::Enable, 4000)?;
        }
        if self.kind == MachineKind::MasterAlone {
            return Ok(());
        }
        let safety = self.bench.controller().safety();
        if self.state() == State::Idle && !safety.homed() {
            self.ask(&Command::Home, 4000)?;
            for _ in 0..30_000 {
                if self.state() != State::Homing {
                    break;
                }
                self.step()?;
            }
        }
        self.checks.recovered(&self.bench);
        Ok(())
    }
}
