//! What the stages of the control cycle share: safety state, job, configured machine.

use crate::joint::power_on_counts::SincePowerOn;
use crate::machine::Machine;
use crate::safety::Safety;
use haptimill_protocol::message::{Event, Kept, Refusal, State};

/// The state of the controller without its link.
#[derive(Debug)]
pub(crate) struct Core {
    /// Control period, microseconds.
    pub period_us: u16,
    /// States, latched faults, position kept.
    pub safety: Safety,
    /// The configured machine.
    pub machine: Option<Machine>,
    /// The job that runs.
    pub job: Job,
    /// Encoder counts from power-on to the first configuration.
    pub power_on: SincePowerOn,
    /// What the board keeps without a supply.
    pub kept: Kept,
    /// The alarms of drives that were logged last.
    #[cfg(feature = "defmt")]
    pub alarms: haptimill_protocol::message::Alarms,
}

/// The job that runs, and the state that commands and faults set for later periods.
#[derive(Debug, Default)]
pub(crate) struct Job {
    /// Number of the job, given by the host; `None` without a job.
    pub number: Option<u32>,
    /// The job, jog or homing ends at standstill.
    pub stopping: bool,
    /// Commanded spindle speed, rev/min; counter-clockwise below 0.
    pub spindle_rpm: i16,
    /// Spindle override, percent.
    pub spindle_percent: u8,
    /// An open door stopped the spindle; the resumed job restarts it.
    pub spindle_stopped: bool,
    /// Periods until a resumed job moves, while the spindle starts; 0 is none.
    pub resume_wait: u16,
    /// Joints whose saturation was reported, one bit each.
    pub saturated: u8,
    /// Newest epoch of jogs in this session.
    pub jog_epoch: Option<u16>,
    /// The newest epoch of jogs has ended.
    pub jog_cancelled: bool,
    /// Newest epoch of the remote master.
    pub master_epoch: Option<u16>,
    /// The newest epoch of the remote master has ended.
    pub master_cancelled: bool,
    /// A session started, and the machine has been active since.
    pub new_session: bool,
    /// After an out-of-band stop: commands sent before it may still arrive and must not start
    /// motion.
    pub stale_commands: bool,
    /// Periods since the out-of-band stop.
    pub since_out_of_band_stop: u32,
    /// Integrity checks that are due and not done.
    pub digest_backlog: u8,
    /// The interpolator needs most of this period.
    pub busy: bool,
    /// A configuration was activated since power-on.
    pub configured: bool,
    /// Missed periods, in sixteenths; each on-time period subtracts one.
    pub missed: u16,
    /// The joints are at their presets, or moved from there with encoders that count.
    pub preset_valid: bool,
    /// Number of the `Enable` request that is answered when the step motors have locked; 0 is none.
    pub enabling: u8,
    /// A configuration that the board is keeping.
    pub storing: Option<Storing>,
}

/// A configuration that the board is keeping.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Storing {
    /// Number of the request; `None` if its session has ended.
    pub id: Option<u8>,
    /// CRC of the configuration.
    pub crc: u32,
    /// The host requested it in this period.
    pub is_new: bool,
}

impl Core {
    pub fn new(period_us: u16) -> Self {
        Self {
            period_us,
            safety: Safety::default(),
            machine: None,
            job: Job {
                spindle_percent: 100,
                ..Job::default()
            },
            power_on: SincePowerOn::default(),
            kept: Kept::Unsupported,
            #[cfg(feature = "defmt")]
            alarms: haptimill_protocol::message::Alarms::default(),
        }
    }

    /// The configured machine.
    ///
    /// # Errors
    /// [`Refusal::NotConfigured`].
    pub fn configured(&mut self) -> Result<&mut Machine, Refusal> {
        self.machine.as_mut().ok_or(Refusal::NotConfigured)
    }

    /// Whether the interpolator needs most of this period.
    pub fn is_busy(&self) -> bool {
        matches!(self.safety.state(), State::Run | State::Hold)
            && self
                .machine
                .as_ref()
                .is_some_and(|machine| machine.motion.program.is_busy())
    }

    /// The spindle speed in effect: 0 while an open door stops it. The override has no effect in a
    /// part of the path without overrides.
    #[inline]
    pub fn spindle_rpm(&self) -> i16 {
        let machine = self.machine.as_ref();
        if self.job.spindle_stopped {
            0
        } else if self.job.spindle_percent == 100
            || machine.is_some_and(|machine| machine.motion.program.is_fixed())
        {
            self.job.spindle_rpm
        } else {
            let rpm = self.job.spindle_rpm as i32 * self.job.spindle_percent as i32 / 100;
            if rpm > i16::MAX as i32 {
                i16::MAX
            } else if rpm < -(i16::MAX as i32) {
                -i16::MAX
            } else {
                rpm as i16
            }
        }
    }

    /// Sets an output for an action of the job. An output that cannot be set ends the job.
    #[inline(never)]
    pub fn set_output_of_job(&mut self, output: u8, on: bool) {
        let rpm = self.job.spindle_rpm;
        let Some(machine) = &mut self.machine else {
            return;
        };
        match machine.io.may_set(&machine.config.io, output, rpm) {
            Ok(()) => machine.io.set(output, on),
            Err(refusal) => self.refuse_action(refusal),
        }
    }

    /// Sets the spindle speed for an action of the job. A start with an open tool clamp ends the
    /// job.
    #[inline(never)]
    pub fn set_spindle_of_job(&mut self, rpm: i16) {
        let Some(machine) = &mut self.machine else {
            return;
        };
        match machine.io.may_turn(&machine.config.io, rpm) {
            Ok(()) => self.job.spindle_rpm = rpm,
            Err(refusal) => self.refuse_action(refusal),
        }
    }

    /// Reports an action of the job that cannot be carried out, and ends the job.
    fn refuse_action(&mut self, refusal: Refusal) {
        if let Refusal::Output { output, problem } = refusal {
            let event = Event::OutputRefused { output, problem };
            self.safety.push_event(event);
        }
        self.abort();
    }

    /// Switches coolant and mist off, at the end of a job.
    #[inline(never)]
    pub fn end_coolant(&mut self) {
        if let Some(machine) = &mut self.machine {
            machine.io.end_coolant(&machine.config.io);
        }
    }

    /// Counts the periods until a resumed job moves, then resumes it.
    #[inline(never)]
    pub fn wait_for_spindle(&mut self) {
        if self.safety.state() != State::Hold || self.job.stopping {
            self.job.resume_wait = 0;
            return;
        }
        self.job.resume_wait -= 1;
        if self.job.resume_wait == 0
            && let Some(machine) = &mut self.machine
        {
            machine.motion.program.leave_pause();
            self.safety.enter(State::Run);
        }
    }

    /// Controlled stop; a job can be resumed from there.
    #[inline(never)]
    pub fn hold(&mut self) {
        self.job.resume_wait = 0;
        match self.safety.state() {
            State::Run => self.safety.enter(State::Hold),
            State::Jog | State::Homing => self.abort(),
            _ => {}
        }
        self.end_jogs();
    }

    /// Controlled stop that ends the job, jog or homing.
    #[inline(never)]
    pub fn abort(&mut self) {
        if self.safety.state() == State::Run {
            self.safety.enter(State::Hold);
        }
        self.job.stopping = true;
        self.job.resume_wait = 0;
        self.end_jogs();
    }

    /// Stops jogs and the remote master. Messages of their epochs are refused from now on.
    #[inline(never)]
    fn end_jogs(&mut self) {
        self.job.jog_cancelled = true;
        self.job.master_cancelled = true;
        if let Some(machine) = &mut self.machine {
            machine.motion.jog.release();
            machine.masters.remote.reset();
        }
    }

    /// The motion has ended at standstill; the drives hold.
    #[inline(never)]
    pub fn finish_at_standstill(&mut self) {
        self.drop_job();
        self.job.stopping = false;
        self.job.spindle_rpm = 0;
        let probing = self
            .machine
            .as_mut()
            .and_then(|machine| machine.io.take_probing());
        if let Some(probing) = probing {
            let input = probing.input;
            self.safety.push_event(Event::NoContact { input });
        }
        if self.safety.pending().is_some() {
            self.safety.settle();
        } else {
            self.safety.enter(State::Idle);
        }
    }

    /// Reports a job that ends before its last setpoint.
    #[inline(never)]
    pub fn drop_job(&mut self) {
        if let Some(job) = self.job.number.take() {
            let program = self.machine.as_ref().map(|machine| &machine.motion.program);
            // A missing setpoint is reported as a late one.
            if let Some(underrun) = program.and_then(|program| program.underrunning()) {
                self.safety.push_event(Event::Underrun {
                    setpoint: underrun.setpoint,
                    late_periods: underrun.periods,
                });
            }
            let setpoints = program.map_or(0, |program| program.reached());
            self.safety.push_event(Event::JobDropped { job, setpoints });
            self.end_coolant();
        }
    }
}
