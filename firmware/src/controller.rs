//! The controller: one function, one control period, one corridor.
//!
//! ```text
//! hear -> sense -> decide -> yield -> place -> drive -> feel -> tell -> gate
//! ```
//!
//! Data goes down it once; nothing reaches back up except what is measured in the next period. What each command does is in `command.rs`,
//! what each state does in `decide.rs`.

use crate::decide::{Job, OVERDUE};
use crate::drive::counted::SincePowerOn;
use crate::force::{ForceControl, ForceProblem};
use crate::io::{Inputs, Outputs};
use crate::machinery::Machinery;
use crate::motion::program::{FULL_RATE, QUEUE};
use crate::probe::{Probe, Stage};
use crate::safety::Safety;
use crate::server::{Heard, Server};
use haptimill_protocol::link::Identity;
use haptimill_protocol::message::{Event, Fault, State, Telemetry};

/// The controller. Give it [`Inputs`] every control period, carry out its [`Outputs`].
#[derive(Debug)]
pub struct Controller {
    pub(crate) period_us: u16,
    pub(crate) server: Server,
    pub(crate) safety: Safety,
    pub(crate) machinery: Option<Machinery>,
    pub(crate) job: Job,
    /// What was counted before there was a configuration.
    pub(crate) power_on: SincePowerOn,
}

impl Controller {
    /// A controller without a configuration, on a board whose control period has so many microseconds.
    #[must_use]
    #[inline(never)]
    pub fn new(period_us: u16) -> Self {
        Self {
            period_us,
            server: Server::new(period_us),
            safety: Safety::default(),
            machinery: None,
            job: Job::default(),
            power_on: SincePowerOn::default(),
        }
    }

    /// One control period.
    pub fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs, probe: &mut impl Probe) {
        let heard = self.hear(inputs);
        probe.ended(Stage::Hear);
        if let Some(machinery) = &mut self.machinery {
            machinery.sense(inputs);
            machinery.sense_force(inputs, self.job.spindle_rpm, self.safety.active());
        } else {
            self.power_on.note(inputs);
        }
        probe.ended(Stage::Sense);
        self.decide(inputs, heard);
        probe.ended(Stage::Decide);
        self.give_way();
        probe.ended(Stage::Yield);
        self.place();
        probe.ended(Stage::Place);
        self.drive(outputs);
        probe.ended(Stage::Drive);
        self.feel(outputs);
        probe.ended(Stage::Feel);
        self.tell(inputs, outputs);
        probe.ended(Stage::Tell);
        if !self.safety.drives_on() {
            outputs.make_safe();
        }
        probe.ended(Stage::Gate);
    }

    #[inline]
    fn hear(&mut self, inputs: &Inputs) -> Option<Heard> {
        if self.server.listen(inputs) {
            self.welcome();
        }
        self.job.busy = matches!(self.safety.state(), State::Run | State::Hold)
            && self
                .machinery
                .as_ref()
                .is_some_and(|machinery| machinery.motion.program.is_busy());
        let overdue = self.job.unchecked >= OVERDUE;
        self.server.next(self.job.busy || overdue)
    }

    #[inline(never)]
    fn welcome(&mut self) {
        // A silent host loses its machine when the machine has begun to brake for want of it, and not before.
        let busy = self.safety.active() && self.safety.pending().is_none();
        let machinery = self.machinery.as_ref();
        let identity = Identity {
            machine: machinery.map_or("", |machinery| &machinery.config.name),
            config_crc: machinery.map_or(0, |machinery| machinery.crc),
            period_us: self.period_us,
            axes: machinery.map_or(0, |machinery| machinery.axes() as u8),
            queue: QUEUE as u16,
        };
        self.server.welcome(&identity, busy);
    }

    #[inline]
    fn give_way(&mut self) {
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        if !self.safety.drives_on() {
            machinery.release_force();
            return;
        }
        let stopped = match (self.safety.fault(), self.safety.pending()) {
            (Some(Fault::Force(_)), _) => true,
            // While the machine brakes, the tool goes on yielding to a force that is too large.
            (_, Some(Fault::Force(problem))) => !matches!(problem, ForceProblem::Limit { .. }),
            _ => machinery.is_locking(),
        };
        machinery.give_way(stopped, self.safety.state() == State::Homing);
    }

    #[inline]
    fn place(&mut self) {
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        if self.safety.drives_on()
            && let Err(error) = machinery.place()
        {
            self.safety.raise(Fault::Pose(error));
        }
        if self.safety.drives_on()
            && let Some(joint) = machinery.joint_too_fast()
        {
            self.safety.raise(Fault::JointRate {
                setpoint: machinery.motion.program.reached(),
                axis: joint as u8,
                rate: machinery.target().rates[joint].0,
                limit: machinery.machine.rates()[joint].0,
            });
        }
        while let Some(axis) = machinery.take_limited() {
            self.safety.tell(Event::YieldLimited { axis });
        }
    }

    #[inline]
    fn drive(&mut self, outputs: &mut Outputs) {
        let Some(machinery) = &mut self.machinery else {
            return;
        };
        if !self.safety.drives_on() {
            machinery.disable();
        }
        let saturated = machinery.drive(&mut outputs.axes);
        outputs.spindle_rpm = self.job.spindle_rpm;
        if let Some(axis) = saturated
            && self.job.saturated & (1 << axis) == 0
        {
            self.job.saturated |= 1 << axis;
            self.safety.tell(Event::Saturated { axis });
        }
    }

    #[inline]
    fn feel(&mut self, outputs: &mut Outputs) {
        let powered = self.safety.drives_on() && self.safety.state() != State::Fault;
        if let Some(machinery) = &mut self.machinery {
            machinery.feel(powered, &mut outputs.haptic);
        }
    }

    #[inline]
    fn tell(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.server.tell(
            inputs.period,
            &mut self.safety,
            inputs.transmit_room,
            &mut outputs.transmit,
        );
        if self.server.telemetry_due(self.safety.has_events()) {
            self.note_telemetry(inputs);
        }
        if self.server.hand_due() {
            let arm = self
                .machinery
                .as_ref()
                .and_then(|machinery| machinery.hands.arm());
            self.server
                .note_hand(arm.map(|arm| arm.telemetry(inputs.period)));
        }
    }

    /// Notes down how things stand in this period; it is encoded in another one.
    #[inline(never)]
    fn note_telemetry(&mut self, inputs: &Inputs) {
        let line = self.server.counters();
        let Some(note) = self.server.note() else {
            return;
        };
        if self.machinery.is_none() {
            // What was noted of a machine before is not true any more.
            *note = Telemetry::default();
        }
        note.period = inputs.period;
        note.state = self.safety.state();
        note.homed = self.safety.homed();
        note.position_kept = self.safety.position_kept();
        note.fault = self.safety.fault();
        note.deferred_bytes = line.deferred_bytes;
        note.bad_frames = line.bad_frames;
        note.lost_bytes = line.lost_bytes;
        let Some(machinery) = &self.machinery else {
            return;
        };
        let program = &machinery.motion.program;
        note.credit = program.credit();
        note.setpoint = program.reached();
        note.program_periods = (program.program_time() >> 32) as u32;
        note.path_rate = (program.path_rate().clamp(0, FULL_RATE - 1) >> 16) as u16;
        machinery.note(inputs, note);
        note.force = machinery.force.as_ref().map(ForceControl::telemetry);
    }

    /// The configured machine, for recorders and tests.
    #[must_use]
    pub const fn machinery(&self) -> Option<&Machinery> {
        self.machinery.as_ref()
    }

    /// State and faults, for recorders and tests.
    #[must_use]
    pub const fn safety(&self) -> &Safety {
        &self.safety
    }

    /// Spindle speed that is commanded, rev/min.
    #[must_use]
    pub const fn spindle_rpm(&self) -> i16 {
        self.job.spindle_rpm
    }
}
