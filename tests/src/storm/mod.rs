//! The storm: randomised robustness episodes of the whole controller, each from one seed. docs/storm.md says what it does.

pub mod bench;
pub mod command;
pub mod files;
pub mod reference;
pub mod script;
pub mod watch;

use bench::World;
use haptimill_firmware::config::Config;
use haptimill_hil_sim::fault::FaultKind;
use haptimill_hil_sim::operator::trajectory::{Live, Trajectory};
use haptimill_hil_sim::process::{
    Area, Coefficients, CutterConfig, CuttingConfig, ElasticWall, WorkpieceConfig,
};
use haptimill_protocol::haptic::MasterPose;
use haptimill_protocol::link::LinkState;
use haptimill_protocol::message::{
    Action, AxisValues, CONFIG_CHUNK, Command, ConfigChunk, Refusal, SETPOINT_BATCH, SetpointBatch,
    State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_protocol::urgent::STOP;
use script::{Dice, Episode, JobPlan, Kind, Step, What};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use watch::{Cause, DEGREE, MM, Violation, Watch};

/// What came of an episode.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// The check that failed.
    pub violation: Option<Violation>,
    /// Control periods.
    pub periods: u64,
    /// Stimuli by kind.
    pub counts: BTreeMap<&'static str, u64>,
    /// Largest values of what is compared with a bound.
    pub largest: Vec<(&'static str, f64)>,
    /// Faults that were latched, by kind.
    pub faults: BTreeMap<String, u64>,
}

/// With a value other than 0, how things stand is printed every so many periods.
pub static TRACE: AtomicU64 = AtomicU64::new(0);

thread_local! {
    static PANICKED: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Panics of this thread are kept for the report, not printed.
pub fn keep_panics() {
    std::panic::set_hook(Box::new(|info| {
        let place = info
            .location()
            .map_or_else(String::new, |at| format!("{}:{}", at.file(), at.line()));
        let what = info
            .payload()
            .downcast_ref::<String>()
            .cloned()
            .or_else(|| {
                info.payload()
                    .downcast_ref::<&str>()
                    .map(ToString::to_string)
            })
            .unwrap_or_default();
        PANICKED.with(|slot| *slot.borrow_mut() = Some(format!("{place}: {what}")));
    }));
}

/// Runs an episode to its end, or to the first check that fails.
#[must_use]
pub fn run(episode: &Episode) -> Outcome {
    let mut player = Player::new(episode);
    let played = catch_unwind(AssertUnwindSafe(|| player.play(episode)));
    let violation = match played {
        Ok(Ok(())) => None,
        Ok(Err(violation)) => Some(violation),
        Err(_) => Some(Violation {
            check: "panic",
            text: PANICKED
                .with(|slot| slot.borrow_mut().take())
                .unwrap_or_default(),
            period: player.world.period,
        }),
    };
    // A position that is wrong from the start has a name of its own.
    let violation = violation.map(|found| Violation {
        check: match (episode.pushed, found.check) {
            (Some(_), "position wrong" | "following" | "runaway" | "rest") => {
                "pushed before configuration"
            }
            (_, check) => check,
        },
        ..found
    });
    let mut counts = player.counts;
    for (name, count) in &player.world.counts {
        *counts.entry(name).or_default() += count;
    }
    Outcome {
        violation,
        periods: player.world.period,
        counts,
        largest: player.watch.largest,
        faults: player.faults,
    }
}

/// Shortens the script of a failing episode as far as the same check still fails.
#[must_use]
pub fn shrink(episode: &Episode, check: &str, tries: usize) -> Episode {
    let mut best = episode.clone();
    let mut left = tries;
    let fails = |script: &[Step], left: &mut usize| {
        *left = left.saturating_sub(1);
        let candidate = Episode {
            script: script.to_vec(),
            ..episode.clone()
        };
        run(&candidate)
            .violation
            .is_some_and(|violation| violation.check == check)
    };
    let mut size = best.script.len().div_ceil(2);
    while size > 0 && left > 0 {
        let mut at = 0;
        let mut shorter = false;
        while at < best.script.len() && left > 0 {
            let mut script = best.script.clone();
            script.drain(at..(at + size).min(script.len()));
            if fails(&script, &mut left) {
                best.script = script;
                shorter = true;
            } else {
                at += size;
            }
        }
        if !shorter || size > 1 {
            size /= 2;
        }
    }
    best
}

/// Sends jogs again and again.
struct Jogger {
    rates: AxisValues,
    deadline_ms: u16,
    every: u32,
    since: u32,
}

/// Sends a hand afar.
struct Afar {
    dice: Dice,
    age_ms: u8,
    phase: f64,
    since: u32,
}

/// Carries a script out.
struct Player {
    world: World,
    watch: Watch,
    stream: VecDeque<Command>,
    /// Setpoints of the job that is streamed; the host waits so many periods before the batch of this number.
    gap: Option<(u32, u32)>,
    jogger: Option<Jogger>,
    afar: Option<Afar>,
    epoch: u16,
    hand_epoch: u16,
    job: u32,
    counts: BTreeMap<&'static str, u64>,
    faults: BTreeMap<String, u64>,
    fault: bool,
    kind: Kind,
    last: Option<Result<(), Refusal>>,
}

type Played = Result<(), Violation>;

impl Player {
    fn new(episode: &Episode) -> Self {
        let world = World::new(episode);
        Self {
            watch: Watch::new(episode, &world),
            world,
            stream: VecDeque::new(),
            gap: None,
            jogger: None,
            afar: None,
            epoch: 0,
            hand_epoch: 0,
            job: 0,
            counts: BTreeMap::new(),
            faults: BTreeMap::new(),
            fault: false,
            kind: episode.kind,
            last: None,
        }
    }

    fn play(&mut self, episode: &Episode) -> Played {
        if let Some(pushed) = episode.pushed {
            *self
                .counts
                .entry("pushed before configuration")
                .or_default() += 1;
            for (joint, effort) in pushed.into_iter().enumerate() {
                self.world.rig.plant_mut().set_load(joint, effort);
            }
            self.steps(400)?;
            for joint in 0..5 {
                self.world.rig.plant_mut().set_load(joint, 0.0);
            }
        }
        self.steps(500)?;
        for step in &episode.script {
            *self.counts.entry(kind_of(&step.what)).or_default() += 1;
            self.happen(&step.what, step.periods)?;
        }
        if episode.replayed
            && let Some(period) = self.world.replay()
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
            period: self.world.period,
        }
    }

    fn steps(&mut self, count: u32) -> Played {
        for _ in 0..count {
            self.step()?;
        }
        Ok(())
    }

    fn step(&mut self) -> Played {
        self.pump();
        let ticked = self.world.step();
        if let Some(answer) = self.world.answers.last() {
            self.last = Some(answer.result);
        }
        if self.world.answers.iter().any(|answer| {
            matches!(
                answer.command,
                Command::Setpoints(_) | Command::JobStart { .. }
            ) && answer.result.is_err()
        }) {
            self.stream.clear();
        }
        let trace = TRACE.load(Ordering::Relaxed);
        if trace != 0 && self.world.period.is_multiple_of(trace) {
            self.trace();
        }
        let looked = self.watch.look(&mut self.world, ticked);
        let fault = self.world.controller().safety().fault();
        if let Some(fault) = fault
            && !self.fault
        {
            let name = format!("{fault:?}");
            let name = name.split([' ', '(']).next().unwrap_or_default().to_owned();
            *self.faults.entry(name).or_default() += 1;
        }
        self.fault = fault.is_some();
        if matches!(
            self.world.link_state(),
            LinkState::Silent | LinkState::Stalled
        ) && self.world.away.is_none()
        {
            // A session that died is given up, as every host does.
            self.watch.causes.push(Cause::Silence);
            self.world.greet();
        }
        looked
    }

    /// How things stand, in a line.
    fn trace(&self) {
        let pose = self.commanded();
        let pose: Vec<String> = (0..5)
            .map(|axis| format!("{:.3}", f64::from(pose[axis]) / unit(axis)))
            .collect();
        let joints: Vec<String> = (0..self.world.axes)
            .map(|joint| format!("{:.3}", self.world.latched.motor[joint]))
            .collect();
        println!(
            "{:>8} {:?} pose {} motors {}",
            self.world.period,
            self.state(),
            pose.join(" "),
            joints.join(" ")
        );
    }

    /// What the host says by itself.
    fn pump(&mut self) {
        if self.world.away.is_some() {
            return;
        }
        if let Some(jogger) = &mut self.jogger {
            jogger.since += 1;
            if jogger.since >= jogger.every {
                jogger.since = 0;
                let jog = Command::Jog {
                    epoch: self.epoch,
                    deadline_ms: jogger.deadline_ms,
                    rates: jogger.rates.clone(),
                };
                self.world.say(&jog);
            }
        }
        if let Some(afar) = &mut self.afar {
            afar.since += 1;
            if afar.since >= 25 {
                afar.since = 0;
                afar.phase += 0.01;
                let wave = |phase: f64| 8.0 * (1.0 - phase.cos());
                let [x, y] = [wave(afar.phase), wave(afar.phase * 0.7)];
                let slope = |phase: f64, part: f64| 8.0 * phase.sin() * part * 2.0;
                let wild = self.kind != Kind::Follow || afar.age_ms > 40;
                let hand = if wild && afar.dice.happens(0.1) {
                    command::any_hand(&mut afar.dice)
                } else {
                    MasterPose {
                        tip: [(x * MM) as i32, (y * MM) as i32, 0],
                        rate: [
                            (slope(afar.phase, 1.0) * 4096.0) as i32,
                            (slope(afar.phase * 0.7, 0.7) * 4096.0) as i32,
                            0,
                        ],
                        axes: [[32_767, 0, 0], [0, 0, 32_767]],
                        engaged: true,
                    }
                };
                let word = Command::MasterPose {
                    epoch: self.hand_epoch,
                    age_ms: afar.age_ms,
                    pose: hand,
                };
                self.world.say(&word);
            }
        }
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
                let credit = self.world.controller().machine().map_or(0, |machine| {
                    // What is under way and was not taken yet has its credit already.
                    machine.motion.program.credit()
                });
                let last = batch.first + batch.items.len() as u32;
                let started = self
                    .world
                    .pending
                    .iter()
                    .all(|pending| !matches!(pending.command, Command::JobStart { .. }));
                if last > credit || !started {
                    break;
                }
            }
            if !self.world.say(&command.clone()) {
                break;
            }
            self.stream.pop_front();
        }
    }

    fn state(&self) -> State {
        self.world.controller().safety().state()
    }

    fn commanded(&self) -> [i32; 6] {
        self.world.controller().machine().map_or([0; 6], |machine| {
            machine.motion.commanded().pose.0.map(|place| place.0)
        })
    }

    /// Asks and waits for the answer, for no longer than the patience; `None` if it did not come.
    fn ask(
        &mut self,
        command: &Command,
        patience: u32,
    ) -> Result<Option<Result<(), Refusal>>, Violation> {
        let mut said = false;
        // A hand is not answered: an older answer is none to it.
        self.last = None;
        for _ in 0..patience {
            if !said {
                said = self.world.say(command);
            }
            self.step()?;
            if said && self.world.pending.is_empty() {
                return Ok(self.last.take());
            }
        }
        Ok(None)
    }

    fn idle(&mut self, most: u32) -> Played {
        for _ in 0..most {
            let calm = !matches!(
                self.state(),
                State::Run | State::Jog | State::Homing | State::Hold
            );
            if calm && self.stream.is_empty() && self.world.pending.is_empty() {
                return Ok(());
            }
            self.step()?;
        }
        Ok(())
    }

    /// Sends a configuration and activates it.
    fn configure(
        &mut self,
        bytes: &[u8],
        crc: u32,
        at_preset: bool,
    ) -> Result<Option<Result<(), Refusal>>, Violation> {
        for (index, chunk) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            let chunk = ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            };
            if self.ask(&Command::Configure(chunk), 4000)? != Some(Ok(())) {
                return Ok(None);
            }
        }
        let activate = Command::Activate {
            length: bytes.len() as u16,
            crc,
            at_preset,
        };
        self.ask(&activate, 4000)
    }

    /// All that gets the machine homed and idle, as a careful operator does.
    fn ready(&mut self) -> Played {
        self.stream.clear();
        self.jogger = None;
        self.afar = None;
        if self.world.away.take().is_some() {
            self.world.greet();
        }
        self.steps(10)?;
        if matches!(
            self.state(),
            State::Run | State::Hold | State::Jog | State::Homing
        ) {
            self.ask(&Command::Stop, 4000)?;
            self.idle(12_000)?;
        }
        if matches!(self.state(), State::Fault | State::EmergencyStop) {
            // A slide that was let go coasts for a while.
            self.steps(2500)?;
            self.ask(&Command::Reset, 4000)?;
        }
        let own = self.world.machine.encoded().ok();
        if let Some((bytes, crc)) = own {
            let is = self.world.controller().machine().map(|machine| machine.crc);
            if is != Some(crc) && matches!(self.state(), State::Disabled | State::Fault) {
                let first = is.is_none();
                if self.configure(&bytes, crc, false)? == Some(Ok(())) && first {
                    self.watch.foreign = false;
                }
            }
        }
        if self.state() == State::Disabled {
            self.ask(&Command::Enable, 4000)?;
        }
        if self.kind == Kind::Master {
            return Ok(());
        }
        let safety = self.world.controller().safety();
        if self.state() == State::Idle && !(safety.homed() && safety.position_kept()) {
            self.ask(&Command::Home, 4000)?;
            for _ in 0..30_000 {
                if self.state() != State::Homing {
                    break;
                }
                self.step()?;
            }
        }
        self.watch.recovered(&self.world);
        Ok(())
    }

    #[allow(clippy::too_many_lines, reason = "one arm for each stimulus")]
    fn happen(&mut self, what: &What, periods: u32) -> Played {
        match what {
            What::Wait => {}
            What::Say(command) => {
                self.mind(command);
                self.world.say(command);
            }
            What::Probe(command) => self.probe(command)?,
            What::Job(plan) => self.begin_job(plan),
            What::Jog {
                rates,
                deadline_ms,
                every,
                epoch,
                cancel,
            } => {
                self.epoch = self.epoch.wrapping_add(*epoch as u16);
                let limits = self.world.machine.config.pose.iter();
                self.jogger = Some(Jogger {
                    rates: limits
                        .zip(rates)
                        .map(|(limit, part)| (f64::from(limit.rate.0) * part / 256.0) as i32)
                        .collect(),
                    deadline_ms: *deadline_ms,
                    every: u32::from(*every),
                    since: u32::from(*every),
                });
                self.steps(periods)?;
                self.jogger = None;
                if *cancel {
                    let cancel = Command::JogCancel { epoch: self.epoch };
                    self.world.say(&cancel);
                }
                return self.steps(1500);
            }
            What::StaleJog => {
                let rates: AxisValues = (0..5).map(|_| 8192).collect();
                self.epoch = self.epoch.wrapping_add(2);
                let cancel = Command::JogCancel { epoch: self.epoch };
                self.world.say(&cancel);
                for back in [0_u16, 1, 100] {
                    let jog = Command::Jog {
                        epoch: self.epoch.wrapping_sub(back),
                        deadline_ms: 100,
                        rates: rates.clone(),
                    };
                    self.world.say(&jog);
                }
            }
            What::Ready => self.ready()?,
            What::Idle => {
                self.idle(periods)?;
                return self.steps(20);
            }
            What::Greet => {
                self.stream.clear();
                self.jogger = None;
                self.watch.causes.push(Cause::Silence);
                self.world.greet();
                self.epoch = 0;
            }
            What::Away(away) => {
                self.watch.causes.push(Cause::Silence);
                if *away {
                    self.world.away.get_or_insert(self.world.period);
                } else if self.world.away.take().is_some() {
                    self.stream.clear();
                }
            }
            What::Urgent => self.world.inject(&STOP),
            What::Garbage(bytes) => {
                self.watch.causes.push(Cause::Silence);
                self.world.inject(bytes);
            }
            What::Line(noise) => {
                self.watch.causes.push(Cause::Silence);
                self.world.set_noise(*noise);
            }
            What::Circuit(open) => {
                self.watch.causes.push(Cause::Circuit);
                self.world.rig.plant_mut().set_emergency_stop(*open);
            }
            What::Break(kind) => self.break_device(kind),
            What::Lean(joint, effort) => {
                if *joint >= self.world.axes {
                    return self.steps(periods);
                }
                self.watch.broke(&FaultKind::Push {
                    axis: script::JOINTS[*joint].to_string(),
                    effort: *effort,
                });
                for period in 0..periods {
                    let part = f64::from(period + 1) / f64::from(periods);
                    self.world.rig.plant_mut().set_load(*joint, effort * part);
                    self.step()?;
                }
                return Ok(());
            }
            What::Heal => {
                self.world.set_broken(vec![]);
                self.world.rig.plant_mut().set_emergency_stop(false);
                if self.world.away.take().is_some() {
                    self.stream.clear();
                }
            }
            What::Miss(count) => {
                self.watch.causes.push(Cause::Late);
                self.world.rig.control_mut().late = *count;
            }
            What::Contact(contact) => self.touch(*contact),
            What::Block => self.clamp(),
            What::Configure {
                seed,
                mutations,
                preset,
            } => self.reconfigure(*seed, *mutations, *preset)?,
            What::Lead(to, engaged) => {
                self.watch.causes.push(Cause::Lead);
                if let Some(arm) = self.world.rig.plant_mut().haptic_mut() {
                    arm.set_trajectory(Trajectory::Live(Live {
                        place_mm: *to,
                        velocity_mm_s: [0.0; 3],
                        engaged: *engaged,
                    }));
                    arm.set_engaged(*engaged);
                }
            }
            What::Afar(seed, age_ms) => {
                self.watch.causes.push(Cause::Lead);
                self.hand_epoch = self.hand_epoch.wrapping_add(1);
                self.afar = Some(Afar {
                    dice: Dice::new(*seed, 903),
                    age_ms: *age_ms,
                    phase: 0.0,
                    since: 25,
                });
                self.steps(periods)?;
                self.afar = None;
                return Ok(());
            }
            What::File(seed) => {
                if let Err(text) = files::corrupt(*seed) {
                    return Err(self.violation("parser", text));
                }
            }
        }
        self.steps(periods)
    }

    /// Commands beside a job's own may spoil what is known of it.
    fn mind(&mut self, command: &Command) {
        if matches!(
            command,
            Command::Setpoints(_) | Command::JobStart { .. } | Command::JobEnd { .. }
        ) {
            self.watch.course.taint();
        }
        if matches!(command, Command::Stop | Command::EmergencyStop) {
            self.stream.clear();
        }
        if let Command::Jog { epoch, .. } | Command::JogCancel { epoch } = command {
            self.epoch = *epoch;
        }
    }

    fn break_device(&mut self, kind: &FaultKind) {
        self.watch.broke(kind);
        match kind {
            FaultKind::EncoderSlip { axis, counts } => {
                if let Some(joint) = script::JOINTS.iter().position(|joint| joint == axis)
                    && joint < self.world.axes
                {
                    self.world.rig.plant_mut().slip_encoder(joint, *counts);
                }
            }
            kind => {
                let mut broken = self.world.broken.clone();
                broken.push(kind.clone());
                self.world.set_broken(broken);
            }
        }
    }

    fn probe(&mut self, command: &Command) -> Played {
        for _ in 0..3000 {
            let calm = self.stream.is_empty()
                && self.world.pending.is_empty()
                && self.jogger.is_none()
                && self.afar.is_none();
            if calm && Watch::stands(&self.world) && self.world.away.is_none() {
                break;
            }
            self.step()?;
        }
        if !Watch::stands(&self.world) || !self.world.pending.is_empty() {
            return Ok(());
        }
        self.steps(30)?;
        self.mind(command);
        let state = self.state();
        let session = self.world.greeted;
        let before = Watch::fingerprint(&self.world);
        let result = self.ask(command, 3000)?;
        let moved = self.state() != state || self.world.greeted != session;
        if let (Some(Err(refusal)), false) = (&result, moved) {
            let after = Watch::fingerprint(&self.world);
            if let Some(difference) = Watch::difference(&before, &after) {
                return Err(self.violation(
                    "refused with side effects",
                    format!("{command:?} was refused ({refusal:?}), and {difference}"),
                ));
            }
        }
        Ok(())
    }

    fn begin_job(&mut self, plan: &JobPlan) {
        if self.kind == Kind::Master {
            return;
        }
        let mut dice = Dice::new(plan.seed, 902);
        let setpoints = self.plan(plan, &mut dice);
        let start: AxisValues = self.commanded()[..5].iter().copied().collect();
        self.job = self.job.wrapping_add(1);
        let mut coder = SetpointCoder::new(200, &start);
        self.stream.clear();
        self.stream.push_back(Command::JobStart {
            job: self.job,
            pose: start,
        });
        for (index, batch) in setpoints.chunks(SETPOINT_BATCH).enumerate() {
            let items = batch
                .iter()
                .filter_map(|setpoint| coder.encode(setpoint).ok())
                .collect();
            self.stream.push_back(Command::Setpoints(SetpointBatch {
                first: (index * SETPOINT_BATCH) as u32,
                items,
            }));
        }
        if !plan.open {
            self.stream.push_back(Command::JobEnd {
                count: setpoints.len() as u32,
            });
        }
        self.gap = (plan.gap > 0).then(|| (u32::from(plan.count) / 3, u32::from(plan.gap)));
        if plan.absurd == 0.0 && self.state() == State::Idle {
            self.watch.course.offer(&setpoints);
        } else {
            self.watch.course.taint();
        }
    }

    /// Setpoints of a job from where the machine stands.
    fn plan(&self, plan: &JobPlan, dice: &mut Dice) -> Vec<Setpoint> {
        let start = self.commanded();
        let pose = &self.world.machine.config.pose;
        let at_rest = |place: &[f64; 5], periods: u16, action| Setpoint {
            periods,
            pose: place.iter().map(|value| *value as i64 as i32).collect(),
            rates: (0..5).map(|_| 0).collect(),
            action,
        };
        let mut here = [0.0; 5];
        for axis in 0..5 {
            here[axis] = f64::from(start[axis]);
        }
        let mut setpoints = vec![];
        if plan.actions {
            setpoints.push(at_rest(&here, 50, Action::Spindle(5000)));
            setpoints.push(at_rest(&here, 5000, Action::None));
        }
        if plan.count == 0 {
            // A line towards what is at the tool.
            let packed = plan.seed & 7;
            let (axis, way) = if packed == 0 {
                (0, 25.0)
            } else {
                ((packed - 1) as usize, (plan.seed >> 3) as f64 / 1000.0)
            };
            let speed = plan.speed * 50.0;
            let spans = (way / speed / 0.1).ceil().max(2.0);
            let pace = way / (spans * 0.1);
            let mut place = here;
            for span in 0..=spans as usize {
                let ends = span == 0 || span == spans as usize;
                place[axis] -= if ends { pace / 2.0 } else { pace } * 0.1 * MM;
                let mut setpoint = at_rest(&place, 500, Action::None);
                if span != spans as usize {
                    setpoint.rates[axis] = (-pace * 4096.0) as i32;
                }
                setpoints.push(setpoint);
            }
            setpoints.push(at_rest(&place, 3000, Action::None));
            return setpoints;
        }
        if plan.speed == 0.0 {
            setpoints.push(at_rest(&here, plan.span, Action::None));
            return setpoints;
        }
        let count = usize::from(plan.count);
        let span = f64::from(plan.span.max(1)) * watch::PERIOD;
        let total = span * count as f64;
        // A rest-to-rest profile of fifth order, and swings on top of it that begin and end at rest as well.
        let mut ways = [(0.0, 0.0, 0.0); 5];
        for (axis, way) in ways.iter_mut().enumerate() {
            if dice.happens(0.35) {
                continue;
            }
            let rate = f64::from(pose[axis].rate.0) * plan.speed;
            let acceleration = f64::from(pose[axis].acceleration.0) * 256.0 * 6.0;
            let (low, high) = (f64::from(pose[axis].low.0), f64::from(pose[axis].high.0));
            let middle = (low + high) / 2.0;
            let range = (high - low) * 0.12;
            // Back to where there is room.
            let towards = if (here[axis] - middle).abs() < range {
                dice.pick(&[-1.0, 1.0])
            } else {
                (middle - here[axis]).signum()
            };
            let reach = (rate * total * 0.35)
                .min(acceleration * total * total / 8.0)
                .min(range);
            let cycles = (1.0 + dice.between(0.0, 4.0)).floor();
            let swing = (rate * total * 0.15 / (cycles * core::f64::consts::TAU))
                .min(acceleration * total * total / (core::f64::consts::TAU * cycles).powi(2) / 8.0)
                .min(range / 4.0)
                // Near a limit a swing would leave it between two setpoints that are within.
                .min(((high - low) / 2.0 - (here[axis] - middle).abs()).max(0.0) / 8.0);
            *way = (
                towards * dice.between(0.1, 1.0) * reach,
                dice.between(-1.0, 1.0) * swing,
                cycles,
            );
        }
        let mut elapsed = 0.0;
        for index in 1..=count {
            let absurd = dice.happens(plan.absurd);
            let periods = if index == count {
                ((total - elapsed) / watch::PERIOD).round().max(1.0)
            } else {
                (f64::from(plan.span) * dice.between(0.7, 1.3))
                    .round()
                    .clamp(1.0, 60_000.0)
                    .min(((total - elapsed) / watch::PERIOD - (count - index) as f64).max(1.0))
            };
            elapsed += periods * watch::PERIOD;
            let t = (elapsed / total).clamp(0.0, 1.0);
            let profile = t * t * t * (10.0 + t * (6.0 * t - 15.0));
            let slope = 30.0 * t * t * (1.0 - t) * (1.0 - t) / total;
            let mut setpoint = at_rest(&here, periods as u16, Action::None);
            for axis in 0..5 {
                let (reach, swing, cycles) = ways[axis];
                let angle = core::f64::consts::TAU * cycles * t;
                let place = here[axis]
                    + reach * profile
                    + swing
                        * (angle.sin()
                            - cycles * core::f64::consts::TAU * t * (1.0 - t) * (1.0 - 2.0 * t))
                        * 0.5;
                let bend = cycles * core::f64::consts::TAU * (1.0 - 6.0 * t + 6.0 * t * t);
                let rate = reach * slope
                    + swing * (core::f64::consts::TAU * cycles * angle.cos() - bend) * 0.5 / total;
                setpoint.pose[axis] = place.round() as i64 as i32;
                setpoint.rates[axis] = (rate / 256.0).round() as i32;
                if index == count {
                    setpoint.rates[axis] = 0;
                }
                if absurd {
                    setpoint.pose[axis] = command::word(dice);
                }
            }
            if plan.actions && dice.happens(0.05) {
                // Slower ones are none for force control.
                let rpm = dice.between(4000.0, 6000.0) as i16;
                setpoint.action = Action::Spindle(if dice.happens(0.3) { -rpm } else { rpm });
            }
            setpoints.push(setpoint);
        }
        if plan.actions {
            let end = setpoints.last().expect("there is one").clone();
            let mut pause = end;
            pause.periods = 100;
            pause.action = if dice.happens(0.3) {
                Action::Pause
            } else {
                Action::Spindle(0)
            };
            setpoints.push(pause);
        }
        setpoints
    }

    fn touch(&mut self, contact: Option<(u8, f64, f64)>) {
        let truth = self.world.rig.plant().truth().pose;
        let Some(process) = self.world.rig.plant_mut().process_mut() else {
            return;
        };
        let wall = contact.map(|(axis, gap, stiffness)| {
            let axis = usize::from(axis);
            let mut point = [truth[0], truth[1], truth[2]];
            let mut normal = [0.0; 3];
            point[axis] -= gap;
            normal[axis] = 1.0;
            ElasticWall {
                point,
                normal,
                stiffness,
                damping: stiffness * 1e-4,
                radius: 0.0,
            }
        });
        if contact.is_some() {
            self.watch.causes.push(Cause::Contact);
        }
        process.set_wall(wall);
        if contact.is_none() && process.cutting().is_some() {
            self.unclamp();
        }
    }

    /// The block is taken away: the machine has spindle and sensor as before.
    fn unclamp(&mut self) {
        if let Some(process) = self.world.plant.process() {
            // A process that was there is fitted anew; its zero is another one.
            let _ = self.world.rig.plant_mut().fit(&process);
            self.watch.causes.push(Cause::Refitted);
        }
    }

    fn clamp(&mut self) {
        self.watch.causes.push(Cause::Contact);
        let [x, y, z, ..] = self.world.rig.plant().truth().pose;
        let config = CuttingConfig {
            cutter: CutterConfig {
                coefficients: Coefficients::P2,
                force_scale: 1.0,
                ..CutterConfig::default()
            },
            workpiece: WorkpieceConfig {
                stock: Area {
                    x_min: x - 80.0,
                    x_max: x - 5.0,
                    y_min: y - 30.0,
                    y_max: y + 30.0,
                },
                map: Area {
                    x_min: x - 45.0,
                    x_max: x - 4.0,
                    y_min: y - 8.0,
                    y_max: y + 8.0,
                },
                cell_mm: 0.2,
                top_mm: z + 1.0,
                bottom_mm: z - 20.0,
                ..WorkpieceConfig::default()
            },
        };
        let _ = self.world.rig.plant_mut().clamp(&config);
    }

    /// Sends a configuration, mutated or not.
    fn reconfigure(&mut self, seed: u64, mutations: u8, preset: bool) -> Played {
        let mut dice = Dice::new(seed, 904);
        let mut config = self.world.machine.config.clone();
        let bits = mutations > 0 && dice.happens(0.3);
        if !bits {
            for _ in 0..mutations {
                mutate(&mut config, &mut dice);
            }
        }
        let file = haptimill_machine_file::MachineFile {
            config,
            ..self.world.machine.clone()
        };
        let Ok((mut bytes, mut crc)) = file.encoded() else {
            return Ok(());
        };
        if bits {
            for _ in 0..mutations {
                let at = dice.place(bytes.len());
                bytes[at] ^= 1 << dice.below(8);
            }
            if dice.happens(0.1) {
                bytes.truncate(dice.place(bytes.len()));
            }
            crc = haptimill_protocol::frame::crc32(&bytes);
        }
        if mutations > 0 || preset {
            // From here on the controller believes what is not so.
            self.watch.foreign = true;
        }
        self.watch.course.taint();
        self.configure(&bytes, crc, preset)?;
        Ok(())
    }
}

/// Changes one field of a configuration to an edge value or any other.
fn mutate(config: &mut Config, dice: &mut Dice) {
    use haptimill_firmware::config::Drive;
    use haptimill_kinematics::Model;
    let word = command::word(dice);
    let half = dice.bits() as u16 >> dice.below(16);
    let wide = i64::from(command::word(dice)) << dice.below(24);
    let (pose, joint) = (dice.place(5), dice.place(5));
    if dice.happens(0.25) && !config.pose.is_empty() {
        let axis = &mut config.pose[pose];
        match dice.below(5) {
            0 => axis.low.0 = word,
            1 => axis.high.0 = word,
            2 => axis.rate.0 = word,
            3 => axis.acceleration.0 = word,
            _ => axis.jerk = word as u32,
        }
        return;
    }
    if dice.happens(0.5) && !config.joints.is_empty() {
        let axis = &mut config.joints[joint];
        match dice.below(24) {
            0 => axis.low.0 = word,
            1 => axis.high.0 = word,
            2 => axis.rate.0 = word,
            3 => axis.per_count = wide,
            4 => axis.per_count = -axis.per_count,
            5 => axis.backlash.0 = word,
            6 => axis.following.0 = word,
            7 => axis.following_lag = word as u32,
            8 => axis.still.0 = word,
            9 => axis.preset.0 = word,
            10 => axis.index.0 = word,
            11 => axis.index_pitch.0 = word,
            12 => axis.index_slack = half,
            13 => axis.search.0 = word,
            14 => axis.law.kp.0 = word as u32,
            15 => axis.law.kd.0 = word as u32,
            16 => axis.law.rate_filter_us = half,
            17 => axis.law.inertia = word as u32,
            18 => axis.law.viscous = word as u32,
            19 => axis.law.coulomb.0 = word,
            20 => axis.law.coulomb_rate.0 = word,
            21 => axis.law.ki.0 = word as u32,
            _ => match &mut axis.drive {
                Drive::Torque { full_scale, limit } => {
                    if dice.happens(0.5) {
                        full_scale.0 = word;
                    } else {
                        limit.0 = word;
                    }
                }
                Drive::Steps {
                    per_step,
                    ticks_per_us,
                    pulse,
                    lost,
                    ..
                } => match dice.below(4) {
                    0 => *per_step = wide,
                    1 => *ticks_per_us = half,
                    2 => *pulse = half,
                    _ => lost.0 = word,
                },
            },
        }
        return;
    }
    match dice.below(12) {
        0 => config.period_us = half,
        1 => config.stopping.time_ms = half,
        2 => config.stopping.ramp_ms = half,
        3 => config.supervision.heartbeat_ms = half,
        4 => config.supervision.missed_periods = half,
        5 => config.supervision.illegal_transitions = half,
        6 => config.homing.rate.0 = word,
        7 => config.homing.table_rate.0 = word,
        8 | 9 => {
            if let Model::H4(geometry) = &mut config.model {
                match dice.below(6) {
                    0 => geometry.rod.0 = word,
                    1 => geometry.half_spacing.0 = word,
                    2 => geometry.tool.0 = word,
                    3 => geometry.below = !geometry.below,
                    4 => geometry.lateral.0 = word,
                    _ => geometry.table_height.0 = word,
                }
            }
        }
        _ => {
            if let Some(force) = &mut config.force {
                let axis = &mut force.axes[dice.place(3)];
                match dice.below(8) {
                    0 => axis.desired.0 = word,
                    1 => axis.limit.0 = word,
                    2 => axis.rate.0 = word,
                    3 => force.mask = word as u8,
                    4 => force.drive_lag_us = half,
                    5 => force.creep.0 = word,
                    6 => force.slowest_rpm = half,
                    _ => config.force = None,
                }
            }
        }
    }
}

/// The kind of a stimulus, for the counts.
const fn kind_of(what: &What) -> &'static str {
    match what {
        What::Wait => "wait",
        What::Say(_) => "command in any state",
        What::Probe(_) => "probed command",
        What::Job(_) => "job",
        What::Jog { .. } => "jog",
        What::StaleJog => "stale jog",
        What::Ready => "recovery and homing",
        What::Idle => "wait for idle",
        What::Greet => "new session",
        What::Away(_) => "host away or back",
        What::Urgent => "urgent stop",
        What::Garbage(_) => "garbage on the line",
        What::Line(_) => "noise on the line",
        What::Circuit(_) => "emergency stop circuit",
        What::Break(kind) => broken(kind),
        What::Lean(..) => "fault lean",
        What::Heal => "devices healed",
        What::Miss(_) => "missed periods",
        What::Contact(_) => "elastic wall",
        What::Block => "block that is cut",
        What::Configure { .. } => "configuration",
        What::Lead(..) => "hand at the arm",
        What::Afar(..) => "hand afar",
        What::File(_) => "corrupted file",
    }
}

const fn broken(kind: &FaultKind) -> &'static str {
    match kind {
        FaultKind::EncoderStuck { .. } => "fault encoder-stuck",
        FaultKind::EncoderSwapped { .. } => "fault encoder-swapped",
        FaultKind::EncoderSlip { .. } => "fault encoder-slip",
        FaultKind::EncoderNoise { .. } => "fault encoder-noise",
        FaultKind::IndexMissing { .. } => "fault index-missing",
        FaultKind::DriveDead { .. } => "fault drive-dead",
        FaultKind::DriveTripped { .. } => "fault drive-tripped",
        FaultKind::DriveWeak { .. } => "fault drive-weak",
        FaultKind::DriveReversed { .. } => "fault drive-reversed",
        FaultKind::SlideJammed { .. } => "fault slide-jammed",
        FaultKind::Push { .. } => "fault push",
        FaultKind::SwitchStuck { .. } => "fault switch-stuck",
        FaultKind::HapticArm(_) => "fault of the haptic arm",
        FaultKind::SpindleStalled => "fault spindle-stalled",
        _ => "fault of the force sensor",
    }
}

/// Degrees and millimetres of an axis unit, for messages of other modules.
#[must_use]
pub const fn unit(axis: usize) -> f64 {
    if axis < 3 { MM } else { DEGREE }
}
