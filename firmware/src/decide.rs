//! Stage *decide*: faults first, then the one thing that was heard, then what each state does.

use crate::controller::Controller;
use crate::force::conditioning::is_force;
use crate::io::{AxisInputs, Inputs};
use crate::machinery::Machinery;
use crate::machinery::hand::Leading;
use crate::motion::Mode;
use crate::motion::program::Progress;
use crate::safety::homing::Outcome;
use crate::safety::{keeps_position, suspected};
use crate::server::Heard;
use haptimill_protocol::message::{Event, Fault, HomingProblem, Refusal, State};

/// How long after an urgent stop older messages may still come in, microseconds: longer than the link waits before it sends one again.
const OVERTAKEN_US: u64 = 450_000;

/// How far a machine goes back along its path from a force that is too large: microseconds of the program.
const BACK_OFF_US: u32 = 1_000_000;

/// Periods in time that make up for a missed one: with a quarter of it, a controller that misses every second period would never be told from one that misses none.
const PAID_BACK: u16 = 16;

/// Periods between two looks at a part of the configuration.
const INTEGRITY_PERIODS: u64 = 16;

/// When a look was due so often, a period is kept free for it.
pub(crate) const OVERDUE: u8 = 2;

/// The job that runs, and what belongs to it.
#[derive(Debug, Default)]
pub struct Job {
    /// The host's number of the job, while there is one.
    pub number: Option<u32>,
    /// The job, the jog or the search is to be given up once the machine is at rest.
    pub stopping: bool,
    /// Commanded spindle speed, rev/min; counter-clockwise below 0.
    pub spindle_rpm: i16,
    /// Joints whose saturation was told.
    pub saturated: u8,
    /// The newest epoch of jogs in this session.
    pub jog_epoch: Option<u16>,
    /// The newest epoch takes no more jogs.
    pub jog_cancelled: bool,
    /// The newest epoch of a hand afar, and whether it takes no more.
    pub hand_epoch: Option<u16>,
    /// That one takes no more words of the hand.
    pub hand_cancelled: bool,
    /// A new session has begun, and the machine has not been at rest since.
    pub new_session: bool,
    /// An urgent stop overtook what the host had said before; nothing of that may set the machine going again.
    pub overtaken: bool,
    /// How often a part of the configuration should have been looked at since one was.
    pub unchecked: u8,
    /// There is much to do on the path in this period.
    pub busy: bool,
    /// There was a configuration since power on.
    pub configured: bool,
    /// Periods since an urgent stop came.
    pub since_urgent: u32,
    /// Missed periods that are not yet made up for.
    pub missed: u16,
    /// The joints stand where their presets say, or moved from there with encoders that can be believed.
    pub preset_valid: bool,
    /// Number of the request to enable that is answered when the step motors have locked; 0 is none.
    pub enabling: u8,
}

impl Controller {
    #[inline]
    pub(crate) fn decide(&mut self, inputs: &Inputs, heard: Option<Heard>) {
        self.watch(inputs);
        if inputs.urgent {
            self.hold();
            self.job.overtaken = true;
            self.job.since_urgent = 0;
        } else if self.job.overtaken {
            // What was said before it may still be on its way, sent again after a loss; after that long it is not.
            self.job.since_urgent = self.job.since_urgent.saturating_add(1);
            let elapsed = u64::from(self.job.since_urgent) * u64::from(self.period_us);
            self.job.overtaken = elapsed < OVERTAKEN_US;
        }
        self.greet();
        if let Some(heard) = heard {
            self.heed(inputs, heard);
        }
        self.advance(inputs);
        self.close_what_faults_end();
        if self.job.enabling != 0 {
            self.answer_enable();
        }
    }

    /// The drives are enabled when the step motors have locked, unless something else happens before.
    #[cold]
    #[inline(never)]
    fn answer_enable(&mut self) {
        let locking = self.machinery.as_ref().is_some_and(Machinery::is_locking);
        let result = match self.safety.state() {
            State::Idle if locking => return,
            State::Idle => Ok(()),
            state => Err(Refusal::State(state)),
        };
        // The request of this period has taken its room.
        if self.server.can_answer() {
            self.server.answer(self.job.enabling, result);
            self.job.enabling = 0;
        }
    }

    /// The one thing that was heard.
    #[inline(never)]
    fn heed(&mut self, inputs: &Inputs, heard: Heard) {
        match heard {
            Heard::Request => self.command(inputs),
            Heard::Setpoint { number, tried } => self.heed_setpoint(number, tried),
            Heard::BadSetpoint { number } => {
                self.server
                    .refuse_setpoints(Refusal::Setpoint { setpoint: number });
            }
        }
    }

    /// A new session counts its own epochs of jogs, and begins with all coordinates led by the program.
    #[inline]
    fn greet(&mut self) {
        if self.server.session_begun() {
            self.job.jog_epoch = None;
            self.job.jog_cancelled = false;
            self.job.hand_epoch = None;
            self.job.hand_cancelled = false;
            self.job.overtaken = false;
            self.job.new_session = true;
            self.job.enabling = 0;
            if let Some(machinery) = &mut self.machinery {
                machinery.hands.afar.forget();
            }
        }
        if self.job.new_session && !self.safety.active() {
            self.begin_session();
        }
    }

    #[inline(never)]
    fn begin_session(&mut self) {
        self.job.new_session = false;
        if let Some(machinery) = &mut self.machinery {
            machinery.motion.reset_sources();
            machinery.motion.program.set_override(100);
        }
    }

    /// Everything that can be wrong.
    #[inline]
    fn watch(&mut self, inputs: &Inputs) {
        if inputs.emergency_stop && self.safety.state() != State::EmergencyStop {
            self.safety.emergency_stop();
        }
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        if inputs.period.is_multiple_of(INTEGRITY_PERIODS) {
            // A period with something else to do leaves it to the next one; after so many, one is kept free of other things.
            self.job.unchecked = self.job.unchecked.saturating_add(1);
        }
        let held = self.server.is_held() && self.job.unchecked >= OVERDUE + u8::from(self.job.busy);
        if self.job.unchecked != 0 && (held || self.server.claim()) {
            self.job.unchecked = 0;
            if !machinery.configuration_intact() {
                self.safety.raise(Fault::Configuration);
                if self.safety.fault() != Some(Fault::Configuration) {
                    // What is latched stays; nothing may be switched on with this all the same.
                    self.safety.lose_position();
                    self.job.preset_valid = false;
                    self.machinery = None;
                    return;
                }
            }
        }
        if let Some(force) = &mut machinery.force
            && let Some(result) = force.take_tare_result()
        {
            self.safety.tell(match result {
                Ok(()) => Event::Tared,
                Err(refusal) => Event::TareRefused(refusal),
            });
        }
        if let Some(problem) = machinery.take_hand_problem() {
            let led = self.safety.drives_on() && machinery.depends_on_hand();
            if led {
                self.safety.raise(Fault::Hand(problem));
            } else {
                self.safety.tell(Event::Hand(problem));
            }
        }
        if let Some((axis, count)) = machinery.jump() {
            // While something else is latched the position is lost at once, and this is named after that.
            self.safety.lose_position();
            self.job.preset_valid = false;
            self.safety.raise(Fault::EncoderIllegal { axis, count });
            if matches!(self.safety.fault(), Some(Fault::EncoderIllegal { axis: of, .. }) if of == axis)
            {
                machinery.named_jump();
            }
        }
        if !self.safety.drives_on() {
            return;
        }
        if machinery.is_locking()
            && let Err(fault) = machinery.lock()
        {
            self.safety.raise(fault);
        }
        if self.safety.active()
            && let Some(force) = &machinery.force
            && let Some(problem) = force.stops(self.safety.state() == State::Jog)
        {
            if is_force(&problem) && self.safety.pending().is_none() {
                // What pushes so hard is not cut: away from it, by the way that was come.
                let periods = BACK_OFF_US / u32::from(self.period_us.max(1));
                machinery.motion.program.back_off(periods);
            }
            self.safety.raise(Fault::Force(problem));
        }
        // In a row, or again and again: what is missed counts in full and is made up for by periods in time, of which the one that comes late is none.
        let limit = machinery.config.supervision.missed_periods;
        self.job.missed = match inputs.missed {
            0 => self.job.missed.saturating_sub(1),
            missed => self
                .job
                .missed
                .saturating_add(missed.saturating_mul(PAID_BACK)),
        };
        let late = inputs.missed >= limit || self.job.missed >= limit.saturating_mul(4 * PAID_BACK);
        if late {
            self.job.missed = 0;
            self.safety.raise(Fault::LatePeriod {
                missed: inputs.missed,
            });
        }
        if let Some(fault) = hardware(&inputs.axes[..machinery.axes()])
            .or_else(|| machinery.supervise(inputs.missed != 0))
        {
            // In many periods a joint goes farther than it can in one: that is no jump of its counter.
            let jumped = matches!(fault, Fault::EncoderIllegal { .. });
            if !(late && jumped && machinery.encoders_counted()) {
                self.safety.raise(fault);
            }
        }
        let patience_us = (u64::from(machinery.config.supervision.heartbeat_ms) + 1) * 1000;
        let silent_us = self.server.silent_us();
        if self.safety.active() && silent_us >= patience_us {
            self.safety.raise(Fault::LostHost {
                silent_ms: (silent_us / 1000).min(u64::from(u32::MAX)) as u32,
            });
        }
    }

    /// Brakes whatever moves; a job keeps its place.
    #[inline(never)]
    pub(crate) fn hold(&mut self) {
        match self.safety.state() {
            State::Run => self.safety.enter(State::Hold),
            State::Jog | State::Homing => self.give_up(),
            _ => {}
        }
        self.end_jogs();
    }

    /// Brakes whatever moves, and ends it.
    #[inline(never)]
    pub(crate) fn give_up(&mut self) {
        if self.safety.state() == State::Run {
            self.safety.enter(State::Hold);
        }
        self.job.stopping = true;
        self.end_jogs();
    }

    /// Brakes jogs. What is under way of their epoch must not set the machine going again.
    #[inline(never)]
    fn end_jogs(&mut self) {
        self.job.jog_cancelled = true;
        self.job.hand_cancelled = true;
        if let Some(machinery) = &mut self.machinery {
            machinery.motion.jog.release();
            machinery.hands.afar.forget();
        }
    }

    /// One period of the state that the machine is in.
    #[inline]
    fn advance(&mut self, inputs: &Inputs) {
        if self.safety.pending().is_some() && !self.job.stopping {
            self.give_up();
        }
        self.lead();
        let state = self.safety.state();
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        let mode = match state {
            State::Run => Mode::Program { halt: false },
            State::Hold => Mode::Program { halt: true },
            State::Jog | State::Homing => Mode::Jog,
            _ => Mode::Still,
        };
        let (progress, limited) = machinery.advance(mode);
        if let Some(axis) = limited
            && state != State::Homing
        {
            machinery.motion.jog.release();
            self.safety.tell(Event::JogLimited { axis });
        }
        if let Some(axis) = machinery.motion.take_limited() {
            self.safety.tell(Event::HandLimited { axis });
        }
        match state {
            State::Run | State::Hold => self.follow_program(state, &progress),
            State::Jog if machinery.motion.jog.is_still() => self.come_to_rest(),
            State::Homing => self.follow_homing(inputs, limited.is_some()),
            _ => {}
        }
    }

    /// A hand leads in a job that runs. When nothing new is heard of it the job holds.
    fn lead(&mut self) {
        let running = self.safety.state() == State::Run && !self.job.stopping;
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        if !running {
            machinery.release_hand();
        } else if let Leading::Lost(age_ms) = machinery.lead() {
            self.safety.tell(Event::HandLost { age_ms });
            self.hold();
        }
    }

    #[inline]
    fn follow_program(&mut self, state: State, progress: &Progress) {
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        let held = self.server.is_held();
        let server = &mut self.server;
        let program = &mut machinery.motion.program;
        program.look_ahead(held, || server.claim_idle());
        if let Some(late) = machinery.motion.program.take_late() {
            self.safety.tell(Event::Underrun {
                setpoint: late.setpoint,
                late_periods: late.periods,
            });
        }
        if progress.ran_dry {
            self.safety.raise(Fault::Internal {
                line: line!() as u16,
            });
            return;
        }
        let wanted = machinery.motion.wanted().pose;
        if let Some(axis) = machinery.beyond_soft_limit(&wanted) {
            self.safety.raise(Fault::SoftLimit { axis });
        }
        if let Some(speed) = progress.spindle {
            self.job.spindle_rpm = speed;
        }
        if progress.blocked && state == State::Run {
            self.safety.tell(Event::Blocked {
                setpoint: machinery.motion.program.reached(),
            });
            self.safety.enter(State::Hold);
        }
        if let Some(setpoint) = progress.paused {
            self.safety.tell(Event::Paused { setpoint });
            self.safety.enter(State::Hold);
        }
        let still = machinery.motion.is_still();
        if progress.finished && still {
            let setpoints = machinery.motion.program.reached();
            if let Some(job) = self.job.number.take() {
                self.safety.tell(Event::JobDone { job, setpoints });
            }
            self.come_to_rest();
        } else if state == State::Hold && self.job.stopping && still {
            self.come_to_rest();
        }
    }

    #[inline(never)]
    fn follow_homing(&mut self, inputs: &Inputs, limited: bool) {
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        if self.job.stopping {
            if machinery.motion.jog.is_still() {
                self.come_to_rest();
            }
            return;
        }
        if let Err(fault) = machinery.note_indexes() {
            self.safety.raise(fault);
            return;
        }
        if machinery.measured_pose().is_none() {
            self.safety.raise(Fault::Homing {
                axis: 0,
                problem: HomingProblem::Workspace,
            });
            return;
        }
        let pose = machinery.motion.wanted().pose;
        match machinery
            .homing
            .advance(&machinery.config, &pose, &mut machinery.motion.jog, limited)
        {
            Outcome::Searching => {}
            Outcome::Failed(fault) => self.safety.raise(fault),
            Outcome::Found(corrections) => match machinery.correct(&corrections, inputs) {
                Ok(()) => {
                    self.safety.set_homed(true);
                    self.come_to_rest();
                }
                Err(error) => self.safety.raise(Fault::Pose(error)),
            },
        }
    }

    /// Whatever moved has ended, at rest, drives holding.
    #[inline(never)]
    fn come_to_rest(&mut self) {
        self.drop_job();
        self.job.stopping = false;
        self.job.spindle_rpm = 0;
        if self.safety.pending().is_some() {
            self.safety.settle();
        } else {
            self.safety.enter(State::Idle);
        }
    }

    /// A latched fault, or an emergency stop, ends the job.
    #[inline]
    fn close_what_faults_end(&mut self) {
        if matches!(
            self.safety.state(),
            State::Fault | State::EmergencyStop | State::Disabled
        ) {
            self.drop_job();
            self.job.stopping = false;
            self.job.spindle_rpm = 0;
        }
        if self.safety.has_latched() {
            self.heed_fault();
        }
    }

    /// What a fault means for the position.
    #[cold]
    #[inline(never)]
    fn heed_fault(&mut self) {
        if let Some(fault) = self.safety.take_latched() {
            // An encoder that is only suspected is asked while the references are looked for: a pulse out of its place ends that.
            let asked = suspected(&fault)
                .zip(self.machinery.as_ref())
                .is_some_and(|(axis, machinery)| machinery.index_will_tell(axis));
            self.job.preset_valid &= asked || keeps_position(&fault);
            if fault == Fault::Configuration {
                // Nothing that it says can be relied on any more; the host sends a new one.
                self.machinery = None;
            }
        }
    }

    #[inline(never)]
    fn drop_job(&mut self) {
        if let Some(job) = self.job.number.take() {
            let program = self
                .machinery
                .as_ref()
                .map(|machinery| &machinery.motion.program);
            // A setpoint that was waited for and never came is named as one that came late.
            if let Some(late) = program.and_then(|program| program.starving()) {
                self.safety.tell(Event::Underrun {
                    setpoint: late.setpoint,
                    late_periods: late.periods,
                });
            }
            let setpoints = program.map_or(0, |program| program.reached());
            self.safety.tell(Event::JobDropped { job, setpoints });
        }
    }
}

/// A limit switch or a drive that reports a fault.
#[inline]
pub(crate) fn hardware(axes: &[AxisInputs]) -> Option<Fault> {
    let well = |axis: &AxisInputs| axis.drive_ready & !(axis.limit_low | axis.limit_high);
    if axes.iter().fold(true, |all, axis| all & well(axis)) {
        return None;
    }
    name_hardware(axes)
}

#[cold]
#[inline(never)]
fn name_hardware(axes: &[AxisInputs]) -> Option<Fault> {
    for (index, axis) in axes.iter().enumerate() {
        if axis.limit_low || axis.limit_high {
            return Some(Fault::LimitSwitch { axis: index as u8 });
        }
        if !axis.drive_ready {
            return Some(Fault::Drive { axis: index as u8 });
        }
    }
    None
}
