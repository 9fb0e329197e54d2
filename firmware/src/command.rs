//! What each command does, and when it is refused. A refused command changes nothing.

use crate::config::Config;
use crate::controller::Controller;
use crate::decide::hardware;
use crate::force::conditioning::COMPONENTS;
use crate::force::{ForceControl, ForceLoop, LoopSettings};
use crate::io::Inputs;
use crate::machinery::Machinery;
use crate::machinery::hand::HAND;
use crate::reflection::Haptic;
use crate::reflection::config::scale_is_sound;
use crate::reflection::law;
use crate::reflection::lead::LED;
use crate::units::{Length, Rate};
use haptimill_protocol::frame::crc32;
use haptimill_protocol::haptic::{Hand, Reflection, Wall};
use haptimill_protocol::message::{
    AxisValues, Command, ConfigField, ConfigProblem, Event, Fault, InputProblem, MAX_AXES,
    RATE_SHIFT, Refusal, Source, State,
};

type Done = Result<(), Refusal>;

/// To try the pose of a setpoint takes as long as to try so many coordinates; to look at a new span of time and to take it as one, to read the next one as these.
const POSE: usize = 3;
const SPAN: usize = 1;
const TAKE: usize = 1;
/// To look at a piece of a long segment takes as long as so many; a period in which a frame came leaves it to the next one.
const PIECE: usize = 5;
const READ: usize = 5;

impl Controller {
    /// Carries out the request that was heard and answers it.
    pub(crate) fn command(&mut self, inputs: &Inputs) {
        let request = self.server.take_request();
        let result = match request.command {
            Command::Home | Command::JobStart { .. } | Command::Resume | Command::Jog { .. }
                if self.job.overtaken =>
            {
                Err(Refusal::State(self.safety.state()))
            }
            // Taken apart by the server, one setpoint a period.
            Command::Setpoints(_) | Command::Ping => Ok(()),
            Command::Configure(chunk) => self.server.stage(&chunk),
            Command::Activate {
                length,
                crc,
                at_preset,
            } => self.activate(inputs, length, crc, at_preset),
            Command::Enable => match self.enable(inputs) {
                Ok(()) if self.settled().is_err() => {
                    // Answered when the step motors have locked.
                    self.job.enabling = request.id;
                    return;
                }
                result => result,
            },
            Command::Disable => self.disable(),
            Command::Home => self.home(),
            Command::Reset => self.reset(inputs),
            Command::JobStart { job, pose } => self.start_job(job, &pose),
            Command::JobEnd { count } => self.end_job(count),
            Command::Hold => {
                self.hold();
                self.job.overtaken = false;
                Ok(())
            }
            Command::Resume => self.resume(),
            Command::Stop => {
                // It came in its place: all that the host said before has been heard.
                self.job.overtaken = false;
                if self.safety.active() {
                    self.give_up();
                }
                Ok(())
            }
            Command::EmergencyStop => {
                self.safety.emergency_stop();
                Ok(())
            }
            Command::Jog {
                epoch,
                deadline_ms,
                rates,
            } => self.jog(epoch, deadline_ms, &rates),
            Command::JogCancel { epoch } => self.cancel_jog(epoch),
            Command::Source { axis, source } => self.choose_source(axis, source),
            Command::Override { percent } => self.set_override(percent),
            Command::Telemetry { every } => {
                self.server.set_telemetry(every);
                Ok(())
            }
            Command::Status => {
                self.server.telemetry_now();
                Ok(())
            }
            Command::ForceMask { mask } => self.set_force_mask(mask),
            Command::ForceLoop { axis, settings } => self.set_force_loop(axis, &settings),
            Command::ForceSettings { axis } => self.tell_force_settings(axis),
            Command::Tare => self.tare(),
            Command::Hand {
                epoch,
                age_ms,
                hand,
            } => self.hear_hand(epoch, age_ms, &hand),
            Command::Feel { force } => self.haptic().map(|arm| arm.feel_afar(force)),
            Command::Reflect(settings) => self.set_reflection(&settings),
            Command::Wall { axis, upper, wall } => self.set_wall(axis, upper, wall),
            Command::HandScale { scale } => self.set_hand_scale(scale),
            Command::HandTelemetry { every } => {
                self.server.set_hand_telemetry(every);
                Ok(())
            }
        };
        self.server.answer(request.id, result);
    }

    fn in_state(&self, allowed: &[State]) -> Done {
        let state = self.safety.state();
        if allowed.contains(&state) {
            Ok(())
        } else {
            Err(Refusal::State(state))
        }
    }

    /// Nothing may be moved until the step motors have locked.
    fn settled(&self) -> Done {
        match &self.machinery {
            Some(machinery) if machinery.is_locking() => {
                Err(Refusal::Input(InputProblem::Settling))
            }
            _ => Ok(()),
        }
    }

    fn configured(&mut self) -> Result<&mut Machinery, Refusal> {
        self.machinery.as_mut().ok_or(Refusal::NotConfigured)
    }

    /// Checks the staged configuration and makes it the active one. Where the joints stand is known from the presets (said by the operator, or
    /// valid at power-on, with what was counted from then to the first configuration), or from the configuration before if both count alike; otherwise it is lost.
    #[cold]
    #[inline(never)]
    fn activate(&mut self, inputs: &Inputs, length: u16, crc: u32, at_preset: bool) -> Done {
        self.in_state(&[State::Disabled, State::Fault, State::EmergencyStop])?;
        if self.safety.drives_on() {
            return Err(Refusal::State(self.safety.state()));
        }
        let staged = self.server.staged();
        if staged.len() != usize::from(length) || crc32(staged) != crc {
            return Err(Refusal::ConfigCheck);
        }
        let problem = |field| Refusal::Config(ConfigProblem { field, axis: None });
        // The check and the schema fit: what cannot be read is a part that this controller was built without.
        let unreadable = if HAND {
            ConfigField::Encoding
        } else {
            ConfigField::Haptic
        };
        let (config, rest) =
            postcard::take_from_bytes::<Config>(staged).map_err(|_| problem(unreadable))?;
        if !rest.is_empty() {
            return Err(problem(ConfigField::Encoding));
        }
        if config.period_us != self.period_us {
            return Err(problem(ConfigField::Period));
        }
        let standing = self.machinery.as_ref().map(Machinery::standing);
        let hand = self.machinery.as_ref().and_then(Machinery::hand_standing);
        Machinery::install(&mut self.machinery, config, crc, inputs).map_err(Refusal::Config)?;
        let first = !core::mem::replace(&mut self.job.configured, true);
        let machinery = self.machinery.as_mut().ok_or(Refusal::NotConfigured)?;
        if at_preset || first {
            self.safety.set_homed(false);
            self.job.preset_valid = at_preset || machinery.count_from(&self.power_on);
        } else if !standing.is_some_and(|standing| machinery.take_over(&standing, inputs)) {
            self.safety.lose_position();
            self.job.preset_valid = false;
        }
        if let (Some(standing), false) = (&hand, at_preset) {
            machinery.take_over_hand(standing);
        }
        Ok(())
    }

    fn enable(&mut self, inputs: &Inputs) -> Done {
        self.in_state(&[State::Disabled])?;
        let machinery = self.machinery.as_mut().ok_or(Refusal::NotConfigured)?;
        if inputs.emergency_stop {
            return Err(Refusal::Input(InputProblem::EmergencyStop));
        }
        match hardware(&inputs.axes[..machinery.axes()]) {
            Some(Fault::LimitSwitch { axis }) => {
                return Err(Refusal::Input(InputProblem::LimitSwitch { axis }));
            }
            Some(Fault::Drive { axis }) => {
                return Err(Refusal::Input(InputProblem::Drive { axis }));
            }
            _ => {}
        }
        // It would be caught with all the force of its drives.
        if !machinery.is_still() {
            return Err(Refusal::Input(InputProblem::Coasting));
        }
        let counted = machinery.encoders_counted();
        machinery.enable().map_err(Refusal::Standing)?;
        if !counted {
            // While the drives were off nobody looked, and the machine may have been moved by hand.
            self.safety.lose_position();
            self.job.preset_valid = false;
        }
        self.job.saturated = 0;
        self.job.missed = 0;
        self.safety.enter(State::Idle);
        Ok(())
    }

    fn disable(&mut self) -> Done {
        self.in_state(&[State::Idle, State::Disabled])?;
        self.safety.enter(State::Disabled);
        Ok(())
    }

    fn home(&mut self) -> Done {
        self.in_state(&[State::Idle])?;
        self.settled()?;
        if !self.job.preset_valid {
            return Err(Refusal::PresetLost);
        }
        self.configured()?.begin_homing();
        self.safety.set_homed(false);
        self.job.stopping = false;
        self.safety.enter(State::Homing);
        Ok(())
    }

    fn reset(&mut self, inputs: &Inputs) -> Done {
        if inputs.emergency_stop {
            return Err(Refusal::Input(InputProblem::EmergencyStop));
        }
        if self.safety.drives_on()
            && self.safety.state() == State::Fault
            && let Some(machinery) = &mut self.machinery
        {
            // The tool stays where it yielded to; to go back from there is for whoever has looked at it.
            machinery.absorb();
        }
        if let Some(machinery) = &mut self.machinery
            && let Some(arm) = machinery.hands.arm_mut()
        {
            arm.reset();
        }
        self.safety.reset();
        Ok(())
    }

    fn start_job(&mut self, job: u32, pose: &AxisValues) -> Done {
        self.in_state(&[State::Idle])?;
        self.settled()?;
        if !self.safety.homed() || !self.safety.position_kept() {
            return Err(Refusal::NotHomed);
        }
        let machinery = self.machinery.as_mut().ok_or(Refusal::NotConfigured)?;
        let wanted = machinery.wanted_values();
        if pose.len() != wanted.len() {
            return Err(Refusal::AxisCount);
        }
        if let Some(axis) = pose.iter().zip(&wanted).position(|(said, is)| said != is) {
            return Err(Refusal::StartPose { axis: axis as u8 });
        }
        if let Some(force) = &machinery.force
            && force.mask() != 0
        {
            // Who believes that the tool yields must not be wrong.
            if !force.conditioner().tared() {
                return Err(Refusal::NotTared);
            }
            if let Some(problem) = force.condition() {
                return Err(Refusal::ForceSensor(problem));
            }
        }
        machinery.motion.begin_program();
        machinery.begin_joint_rates();
        self.server.begin_job(pose);
        self.job.number = Some(job);
        self.job.stopping = false;
        self.job.saturated = 0;
        self.safety.enter(State::Run);
        Ok(())
    }

    /// A period of a setpoint's trial: whether the machine can be at its pose, then whether each of its coordinates may go there as fast as it says. It is taken
    /// into the queue after that, and the next one read, as far as the period's share goes; the rest is for another period.
    #[inline(never)]
    pub(crate) fn heed_setpoint(&mut self, number: u32, tried: u8) {
        let mut share = self.server.share();
        match self.try_setpoint(number, usize::from(tried), &mut share) {
            Ok(None) => self.server.accept_setpoint(share >= READ),
            Ok(Some(tried)) => self.server.pass_setpoint(tried),
            Err(refusal) => self.server.refuse_setpoints(refusal),
        }
    }

    /// Goes on with a setpoint of which so much was tried: nothing, or the pose, or one more for each coordinate. Says how much is tried now; `None` if it was taken.
    fn try_setpoint(
        &mut self,
        number: u32,
        tried: usize,
        share: &mut usize,
    ) -> Result<Option<u8>, Refusal> {
        self.in_state(&[State::Run, State::Hold])?;
        let machinery = self.machinery.as_mut().ok_or(Refusal::NotConfigured)?;
        let setpoint = self.server.setpoint();
        let expected = machinery.motion.program.accepted();
        if number != expected {
            return Err(Refusal::OutOfOrder { expected });
        }
        if tried == 0 {
            machinery.can_reach(number, setpoint)?;
            *share = share.saturating_sub(POSE);
            if !machinery.motion.program.expects(setpoint.periods) {
                *share = share.saturating_sub(SPAN);
            }
        }
        let axes = machinery.axes();
        let first = tried.saturating_sub(1).min(axes);
        let last = axes.min(first + *share);
        *share -= last - first;
        machinery.motion.program.allows(setpoint, first..last)?;
        if last < axes {
            return Ok(Some(last as u8 + 1));
        }
        let pieces = machinery.pieces(setpoint);
        let mut piece = tried.saturating_sub(axes + 1) as u8;
        while piece < pieces {
            // The last piece ends at the pose that was tried.
            let cost = if piece + 1 == pieces { TAKE } else { PIECE };
            if *share < cost {
                break;
            }
            *share -= cost;
            machinery.check_piece(number, setpoint, piece, pieces)?;
            piece += 1;
        }
        if piece < pieces || *share < TAKE {
            return Ok(Some((axes + 1) as u8 + piece));
        }
        *share -= TAKE;
        machinery.motion.program.push_tried(setpoint, axes)?;
        machinery.take_end();
        Ok(None)
    }

    fn end_job(&mut self, count: u32) -> Done {
        self.in_state(&[State::Run, State::Hold])?;
        self.configured()?.motion.program.end(count)
    }

    fn resume(&mut self) -> Done {
        self.in_state(&[State::Hold, State::Run])?;
        if self.job.stopping {
            return Err(Refusal::State(State::Hold));
        }
        self.configured()?.motion.program.leave_pause();
        self.safety.enter(State::Run);
        Ok(())
    }

    fn jog(&mut self, epoch: u16, deadline_ms: u16, rates: &AxisValues) -> Done {
        if !self.safety.homed() {
            return Err(Refusal::NotHomed);
        }
        self.settled()?;
        if !(1..=1000).contains(&deadline_ms) {
            return Err(Refusal::Range);
        }
        // Epochs wrap around: one is older when it lies less than half the circle behind.
        let age = self.epoch_age(epoch);
        if age > 0 || (age == 0 && self.job.jog_cancelled) {
            return Err(Refusal::OldEpoch);
        }
        let period_us = u32::from(self.period_us);
        let state = self.safety.state();
        let machinery = self.machinery.as_mut().ok_or(Refusal::NotConfigured)?;
        if rates.len() != machinery.axes() {
            return Err(Refusal::AxisCount);
        }
        let beside_program =
            matches!(state, State::Run | State::Hold) && machinery.motion.has_jog_source();
        if self.job.stopping || !(beside_program || matches!(state, State::Idle | State::Jog)) {
            return Err(Refusal::State(state));
        }
        if state == State::Idle {
            machinery.motion.begin_jog(true);
            self.safety.enter(State::Jog);
        }
        let mut wanted = [0_i64; MAX_AXES];
        for (index, (slot, rate)) in wanted.iter_mut().zip(rates).enumerate() {
            if !beside_program || machinery.motion.source(index) == Source::Jog {
                *slot = i64::from(*rate) << RATE_SHIFT;
            }
        }
        machinery
            .motion
            .jog
            .aim(&wanted, u32::from(deadline_ms) * 1000 / period_us);
        self.job.jog_epoch = Some(epoch);
        self.job.jog_cancelled = false;
        Ok(())
    }

    /// How many epochs this one is older than the newest; negative when it is newer. Any is newer than none.
    fn epoch_age(&self, epoch: u16) -> i16 {
        self.job
            .jog_epoch
            .map_or(-1, |newest| newest.wrapping_sub(epoch) as i16)
    }

    fn cancel_jog(&mut self, epoch: u16) -> Done {
        if self.epoch_age(epoch) <= 0 {
            self.job.jog_epoch = Some(epoch);
            self.job.jog_cancelled = true;
            if let Some(machinery) = &mut self.machinery
                && self.safety.state() != State::Homing
            {
                machinery.motion.jog.release();
            }
        }
        Ok(())
    }

    /// To a jog, and from one, only at rest; otherwise also while the coordinate moves. Also while a fault is latched: a hand that stays broken would latch it again after each reset.
    fn choose_source(&mut self, axis: u8, source: Source) -> Done {
        self.in_state(&[State::Idle, State::Hold, State::Run, State::Fault])?;
        let state = self.safety.state();
        let machinery = self.configured()?;
        if usize::from(axis) >= machinery.axes() {
            return Err(Refusal::Range);
        }
        let follows = HAND && machinery.config.follow.is_some() && usize::from(axis) < LED;
        if source == Source::Master && !follows {
            return Err(Refusal::NoHand);
        }
        machinery.hands.lead.release_one(usize::from(axis));
        // Without a hand there is nothing that takes a coordinate over while it moves.
        let jogs = !HAND
            || source == Source::Jog
            || machinery.motion.source(usize::from(axis)) == Source::Jog;
        if jogs && state == State::Run {
            return Err(Refusal::State(state));
        }
        if jogs && state == State::Hold && !machinery.motion.is_still() {
            return Err(Refusal::State(state));
        }
        machinery.motion.set_source(usize::from(axis), source);
        Ok(())
    }

    fn set_override(&mut self, percent: u8) -> Done {
        if !(1..=100).contains(&percent) {
            return Err(Refusal::Range);
        }
        self.configured()?.motion.program.set_override(percent);
        Ok(())
    }

    fn haptic(&mut self) -> Result<&mut Haptic, Refusal> {
        let machinery = self.configured()?;
        machinery.hands.arm_mut().ok_or(Refusal::NoHand)
    }

    /// Epochs as those of jogs.
    fn hear_hand(&mut self, epoch: u16, age_ms: u8, hand: &Hand) -> Done {
        if !HAND || self.configured()?.config.follow.is_none() {
            return Err(Refusal::NoHand);
        }
        let newest = self.job.hand_epoch;
        let age = newest.map_or(-1, |newest| newest.wrapping_sub(epoch) as i16);
        if age > 0 || (age == 0 && self.job.hand_cancelled) {
            return Err(Refusal::OldEpoch);
        }
        self.job.hand_epoch = Some(epoch);
        self.job.hand_cancelled = false;
        self.configured()?.hear_hand(hand, age_ms);
        Ok(())
    }

    fn set_reflection(&mut self, settings: &Reflection) -> Done {
        let arm = self.haptic()?;
        if !law::is_sound(settings) {
            return Err(Refusal::Range);
        }
        arm.set_reflection(settings);
        Ok(())
    }

    fn set_wall(&mut self, axis: u8, upper: bool, wall: Option<Wall>) -> Done {
        let arm = self.haptic()?;
        let wall = match wall {
            None => None,
            Some(Wall { at, rate }) => {
                let rate = rate.checked_mul(1 << RATE_SHIFT).ok_or(Refusal::Range)?;
                Some((at.map(Length), Rate(rate)))
            }
        };
        if usize::from(axis) >= COMPONENTS {
            return Err(Refusal::Range);
        }
        arm.set_wall(usize::from(axis), upper, wall)
            .map_err(|_| Refusal::WallTooNear)
    }

    /// The tool does not jump: hand and tool are latched anew.
    fn set_hand_scale(&mut self, scale: u16) -> Done {
        let machinery = self.configured()?;
        if !HAND || machinery.config.follow.is_none() {
            return Err(Refusal::NoHand);
        }
        if !scale_is_sound(scale) {
            return Err(Refusal::Range);
        }
        let frame = machinery.hand();
        machinery.hands.lead.set_scale(scale, frame.as_ref());
        Ok(())
    }

    fn force(&mut self) -> Result<&mut ForceControl, Refusal> {
        let machinery = self.configured()?;
        machinery.force.as_mut().ok_or(Refusal::NoForceSensor)
    }

    /// In any state: an axis that is taken out returns by its law, one that is put in begins where it is.
    fn set_force_mask(&mut self, mask: u8) -> Done {
        let force = self.force()?;
        if mask >> COMPONENTS != 0 {
            return Err(Refusal::Range);
        }
        let tared = force.conditioner().tared();
        let moving = self.safety.active();
        if mask != 0 && moving && !tared {
            return Err(Refusal::NotTared);
        }
        self.force()?.set_mask(mask);
        Ok(())
    }

    fn set_force_loop(&mut self, axis: u8, settings: &ForceLoop) -> Done {
        self.force()?
            .set(usize::from(axis), &LoopSettings::from(settings))
            .map_err(|refusal| Refusal::Force { axis, refusal })
    }

    fn tell_force_settings(&mut self, axis: u8) -> Done {
        let settings = self.force()?.settings(usize::from(axis));
        let settings = settings.map(ForceLoop::from).ok_or(Refusal::Range)?;
        self.safety.tell(Event::ForceSettings { axis, settings });
        Ok(())
    }

    /// Only at rest, with the spindle off (it is, in these states), and where the tool does not lean on anything.
    fn tare(&mut self) -> Done {
        let state = self.safety.state();
        let force = self.force()?;
        if !matches!(state, State::Disabled | State::Idle) {
            return Err(Refusal::State(state));
        }
        if force.displaced() {
            return Err(Refusal::Yielding);
        }
        force.begin_tare();
        Ok(())
    }
}
