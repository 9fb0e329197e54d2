//! One joint: encoder, backlash compensation, servo loop and drive output.
//!
//! ```text
//! measure  counts, edge times --encoder--> motor coordinate, rate --backlash--> slide coordinate
//! servo    commanded slide --backlash--> commanded motor --servo law--> effort --> code   (torque)
//!                                                        --step planner--> pulses       (step/dir)
//! ```
//!
//! The servo loop of a step/dir joint is in its drive. The pulses follow the commanded position,
//! and the encoder supervises them; [`JointMeasurement::slip`] is their difference. A step/dir
//! joint without an encoder is open loop: it counts the steps that were emitted, in place of the
//! edges of an encoder, and nothing supervises whether its motor made them.
//!
//! Outputs take effect one period after the inputs were latched. The pulses of a step/dir joint end
//! at the commanded position at the end of that next period, two periods after the latch. A torque
//! joint closes its loop on the commanded position of the latch.
//!
//! Callers must call [`JointDrive::measure`] once every period, enabled or not, before
//! [`JointDrive::servo`]. The commanded position must begin at the coordinate that
//! [`JointDrive::enable`] returns.

pub mod backlash;
mod construction;
pub mod disturbance;
pub mod edge_timer;
pub mod encoder;
pub mod friction;
pub mod index_monitor;
pub mod monitor;
pub mod power_on_counts;
pub mod quadrature;
mod reversals;
pub mod servo;
pub mod step_gen;
mod step_supervision;
pub mod torque;

pub use construction::DriveError;

use crate::config::{AxisKind, JointSettings, Supervision};
use crate::digest::{Constants, Digest, impl_digest};
use crate::io::{DriveCommand, JointInputs};
use crate::joint::monitor::{JointMonitor, JointSample};
use crate::joint::servo::ServoLaw;
use backlash::Backlash;
use encoder::{Encoder, Measured, difference, sum};
use haptimill_math::{Acceleration, Coordinate, Effort, Rate};
use haptimill_protocol::message::Fault;
use index_monitor::IndexMonitor;
use power_on_counts::Counted;
use step_gen::StepPlanner;
use step_supervision::StepSupervision;
use torque::TorqueOutput;

/// Measured values of a joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointMeasurement {
    /// Coordinate of the slide: the motor's coordinate after the backlash model.
    pub coordinate: Coordinate,
    /// Coordinate of the motor.
    pub motor: Coordinate,
    /// Encoder counts since the previous period.
    pub moved: i32,
    /// Illegal transitions since enable; [`u32::MAX`] after lost counts.
    pub illegal: u32,
    /// A new index pulse: its raw count and the motor coordinate there.
    pub index: Option<(i32, Coordinate)>,
    /// Offset of the index pulses since enable, in counts; 0 while it is within the configured
    /// slack.
    pub off: i32,
    /// Step/dir only: coordinate by the emitted steps minus the measured coordinate.
    pub slip: Coordinate,
    /// The slip is above the configured limit: steps were lost.
    pub lost_steps: bool,
    /// The counter changed by more than the joint can move in a period.
    pub large_step: bool,
}

/// Commanded motion of a slide.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointCommand {
    /// Coordinate of the slide.
    pub coordinate: Coordinate,
    /// Its rate.
    pub rate: Rate,
    /// Its acceleration.
    pub acceleration: Acceleration,
}

/// Result of the servo loop in a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ServoOutput {
    /// Command for the drive.
    pub command: DriveCommand,
    /// Commanded minus measured coordinate of the motor: the input of the servo law.
    pub following_error: Coordinate,
    /// Commanded effort; zero on a step/dir joint.
    pub effort: Effort,
    /// Part of the effort that accelerates the motor across the lost motion.
    pub crossing: Effort,
    /// The effort was clamped at the drive's limit, or steps did not fit into the period.
    pub saturated: bool,
    /// Steps that did not fit and are still due.
    pub lag: i32,
}

/// Position of a joint and state of its encoder, for the transfer to another configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncoderState {
    motor: Coordinate,
    slide: Coordinate,
    illegal: u32,
    off: i32,
    indexes: IndexMonitor,
}

/// Output stage, by kind of drive.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Output {
    Torque {
        law: ServoLaw,
        output: TorqueOutput,
    },
    Steps {
        planner: StepPlanner,
        supervision: StepSupervision,
    },
}

/// One joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JointDrive {
    kind: AxisKind,
    encoder: Encoder,
    indexes: IndexMonitor,
    backlash: Backlash,
    output: Output,
    monitor: JointMonitor,
    commanded: JointCommand,
    measurement: JointMeasurement,
    servo_output: ServoOutput,
    measured_once: bool,
    enabled: bool,
    /// Largest plausible change of the counter in a period ([`construction::reach`]), in counts.
    reach: u32,
    /// The joint has no encoder: its counter counts the emitted steps.
    open_loop: bool,
    /// The position is known well enough to compare it with the stroke.
    placed: bool,
}

impl_digest!(JointDrive { fields { kind, reach, open_loop }, nested { encoder, indexes, backlash, output }, skip { monitor, commanded, measurement, servo_output, measured_once, enabled, placed } });

impl Constants for Output {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Torque { law, output } => {
                law.digest(digest);
                output.digest(digest);
            }
            Self::Steps {
                planner,
                supervision,
            } => {
                planner.digest(digest);
                supervision.digest(digest);
            }
        }
    }
}

impl JointDrive {
    /// Reads the joint's inputs, latched at `time_ns` of the board's clock. Callers must call it
    /// once every period.
    #[inline(never)]
    pub fn measure(&mut self, inputs: &JointInputs, time_ns: u32) -> &JointMeasurement {
        let measured = if self.open_loop {
            self.count_steps(inputs, time_ns)
        } else {
            self.encoder.read(inputs, time_ns)
        };
        if !self.measured_once {
            self.measured_once = true;
            self.backlash.set_slide(measured.coordinate);
            if let Output::Steps { supervision, .. } = &mut self.output {
                supervision.start(inputs.steps, measured.coordinate);
            }
        }
        if let Output::Steps { supervision, .. } = &mut self.output {
            let motor = measured.coordinate;
            (self.measurement.slip, self.measurement.lost_steps) =
                supervision.compare(self.kind, self.enabled, inputs.steps, motor);
        }
        let measurement = &mut self.measurement;
        measurement.coordinate = self.backlash.carry(measured.coordinate);
        measurement.motor = measured.coordinate;
        measurement.moved = measured.moved;
        measurement.large_step = measured.moved.unsigned_abs() > self.reach;
        measurement.illegal = self.encoder.illegal();
        measurement.index = measured.index;
        if measurement.index.is_some() {
            self.note_pulse();
        }
        &self.measurement
    }

    /// Reads the count of emitted steps in place of an encoder.
    #[cold]
    #[inline(never)]
    fn count_steps(&mut self, inputs: &JointInputs, time_ns: u32) -> Measured {
        let steps = JointInputs {
            counts: inputs.steps,
            edge_time_ns: time_ns,
            ..JointInputs::default()
        };
        self.encoder.read(&steps, time_ns)
    }

    /// The counter that [`Self::set_reference`] refers to: the encoder's, or the emitted steps.
    #[must_use]
    pub const fn counter(&self, inputs: &JointInputs) -> i32 {
        if self.open_loop {
            inputs.steps
        } else {
            inputs.counts
        }
    }

    /// Whether the joint has no encoder.
    #[must_use]
    pub const fn is_open_loop(&self) -> bool {
        self.open_loop
    }

    /// Checks the index pulse. Lost counts invalidate the encoder until the joint is enabled again.
    #[cold]
    #[inline(never)]
    fn note_pulse(&mut self) {
        let measurement = &mut self.measurement;
        if let Some((raw, _)) = measurement.index
            && let Some(off) = self.indexes.pulse(raw)
        {
            self.encoder.invalidate();
            measurement.illegal = self.encoder.illegal();
            measurement.off = off;
        }
    }

    /// Checks whether the counter jumped since it was read `periods` ago, and invalidates the
    /// encoder if it did.
    pub(crate) const fn jumped(&mut self, periods: u32) -> bool {
        let jumped = self.measurement.moved.unsigned_abs() / periods > self.reach;
        if jumped {
            self.encoder.invalidate();
            self.measurement.illegal = self.encoder.illegal();
        }
        jumped
    }

    /// Accounts for `missed` periods before the present one, after [`JointDrive::measure`]. The
    /// motor moved during all of them. The rate of the following error takes the mean motion of
    /// one period, not the whole: the derivative term would act on a rate that never was.
    #[cold]
    #[inline(never)]
    pub fn skip(&mut self, missed: u16, counter: i32) {
        let Output::Torque { law, .. } = &mut self.output else {
            return;
        };
        let before = counter.wrapping_sub(self.measurement.moved);
        let before = self.encoder.coordinate_at(before);
        let moved = difference(self.kind, self.measurement.motor, before);
        let mean = i64::from(moved.0) / (i64::from(missed) + 1);
        law.shift(Coordinate(haptimill_math::reciprocal::saturate(
            mean - i64::from(moved.0),
        )));
    }

    /// References the joint to the power-on counts. The coordinate is at the preset now. The joint
    /// was at its preset at power-on and has moved by `counted` since. Returns false if the counter
    /// jumped, or if a channel was stuck.
    ///
    /// A motor without an encoder emitted no steps before its configuration.
    pub(crate) fn count_from(&mut self, counted: &Counted) -> bool {
        if self.open_loop {
            return true;
        }
        let Ok(travelled) = i32::try_from(counted.travelled) else {
            return false;
        };
        let preset = self.measurement.motor;
        self.set_reference(counted.counts.wrapping_sub(travelled), preset);
        counted.widest <= self.reach && !counted.stuck
    }

    /// Starts or ends the reference search.
    pub fn search(&mut self, searching: bool) {
        self.indexes.search(searching);
    }

    /// Index monitor of the joint.
    pub const fn indexes(&self) -> &IndexMonitor {
        &self.indexes
    }

    /// Measurement of the last period.
    #[inline]
    pub const fn measurement(&self) -> &JointMeasurement {
        &self.measurement
    }

    /// Switches the drive on and returns the slide's coordinate. The commanded position must begin
    /// there, at standstill, so that nothing jumps.
    pub fn enable(&mut self) -> Coordinate {
        let motor = self.measurement.motor;
        self.backlash.hold(motor);
        if self.measurement.off != 0 {
            self.indexes.clear();
        }
        self.encoder.clear_illegal();
        self.measurement.illegal = 0;
        self.measurement.off = 0;
        self.indexes.search(false);
        match &mut self.output {
            Output::Torque { law, output } => {
                law.reset(Coordinate(0));
                output.reset();
            }
            Output::Steps {
                planner,
                supervision,
            } => {
                planner.start(motor);
                supervision.restart(motor);
            }
        }
        self.measurement.slip = Coordinate(0);
        self.measurement.lost_steps = false;
        self.enabled = true;
        self.measurement.coordinate
    }

    /// Starts the rotor lock of a step/dir drive. The drive was just switched on, and the rotor
    /// moves to a detent. Lost steps are not supervised until [`Self::end_lock`]. Returns false for
    /// a torque drive.
    pub fn begin_lock(&mut self) -> bool {
        let Output::Steps { supervision, .. } = &mut self.output else {
            return false;
        };
        supervision.begin_lock(self.measurement.motor);
        true
    }

    /// Updates the rotor lock by one period. Returns the distance of the rotor from where its drive
    /// was switched on, and the number of periods for which it has stayed within an eighth of the
    /// limit of lost steps (at least two counts). `None` for a torque drive.
    pub fn locking(&mut self, joint: &JointSettings) -> Option<(Coordinate, u32)> {
        let Output::Steps { supervision, .. } = &mut self.output else {
            return None;
        };
        let per_count = joint
            .encoder
            .as_ref()
            .map_or(0, |encoder| encoder.per_count);
        supervision.locking(self.kind, self.measurement.motor, per_count)
    }

    /// Ends the rotor lock: steps count from the present position, and lost steps are supervised.
    /// Returns the slide's coordinate, which becomes the commanded one. `None` for a torque drive.
    pub fn end_lock(&mut self) -> Option<Coordinate> {
        let locks =
            matches!(&self.output, Output::Steps { supervision, .. } if supervision.is_locking());
        locks.then(|| self.enable())
    }

    /// Switches the drive off.
    pub fn disable(&mut self) {
        self.enabled = false;
        self.servo_output = ServoOutput::default();
    }

    /// Servo output of the last period.
    #[inline]
    pub const fn servo_output(&self) -> &ServoOutput {
        &self.servo_output
    }

    /// Whether the drive is on.
    pub const fn is_enabled(&self) -> bool {
        self.enabled
    }

    /// Sets the motor coordinate at the raw count `raw` to `coordinate`: a preset (with
    /// [`JointDrive::counter`]) or a found index.
    ///
    /// Returns the shift of every coordinate of this joint. Callers must add it to their commanded
    /// position in the same period; then nothing moves, enabled or not.
    pub fn set_reference(&mut self, raw: i32, coordinate: Coordinate) -> Coordinate {
        let shift = self.encoder.set_reference(raw, coordinate);
        self.backlash.rebase(shift);
        if let Output::Steps {
            planner,
            supervision,
        } = &mut self.output
        {
            planner.rebase(shift);
            supervision.rebase(self.kind, shift);
        }
        self.measurement.coordinate = sum(self.kind, self.measurement.coordinate, shift);
        self.measurement.motor = sum(self.kind, self.measurement.motor, shift);
        shift
    }

    /// State for a joint of another configuration whose counts have the same scaling.
    pub fn encoder_state(&self) -> EncoderState {
        EncoderState {
            motor: self.measurement.motor,
            slide: self.measurement.coordinate,
            illegal: self.measurement.illegal,
            off: self.measurement.off,
            indexes: self.indexes.clone(),
        }
    }

    /// Takes over the position and the encoder state of a joint whose counter is at `raw`.
    pub fn take_over(&mut self, raw: i32, before: &EncoderState) {
        self.set_reference(raw, before.motor);
        self.backlash.set_slide(before.slide);
        self.measurement.coordinate = self.backlash.carry(before.motor);
        self.encoder.take_over_illegal(before.illegal);
        self.measurement.illegal = before.illegal;
        self.measurement.off = before.off;
        self.indexes.take_over(&before.indexes);
    }

    /// Checks whether the joint followed its command of the previous period. `joint` is its number,
    /// `settings` its configuration. `missed` is true if periods were missed before this one.
    #[inline(never)]
    pub fn supervise(
        &mut self,
        joint: u8,
        settings: &JointSettings,
        limits: &Supervision,
        period_us: u16,
        missed: bool,
    ) -> Option<Fault> {
        let measurement = &self.measurement;
        let sample = JointSample {
            commanded: self.commanded.coordinate,
            commanded_rate: self.commanded.rate,
            measured: measurement.coordinate,
            moved: measurement.moved,
            effort: self.servo_output.effort,
            crossing: self.servo_output.crossing,
            rate: if JointMonitor::pushes(settings, self.servo_output.effort) {
                self.encoder.rate()
            } else {
                Rate::ZERO
            },
            illegal: measurement.illegal.min(u32::from(u16::MAX)) as u16,
            step_error: measurement.slip,
            period_us,
            missed,
            placed: self.placed,
        };
        let Some(encoder) = &settings.encoder else {
            return JointMonitor::check_steps(joint, settings, &sample);
        };
        if measurement.off != 0 {
            return Some(Fault::EncoderSlip {
                joint,
                counts: measurement.off,
            });
        }
        self.monitor.check(
            joint,
            settings,
            encoder,
            limits.illegal_transitions,
            &sample,
        )
    }

    /// Checks the encoder of a joint whose drive is off: a stuck channel, while the joint is moved
    /// by hand or coasts. The distance is lost and may be any number of turns, so no index pulse
    /// can confirm the position.
    #[inline(never)]
    pub fn supervise_unpowered(
        &mut self,
        joint: u8,
        settings: &JointSettings,
        period_us: u16,
    ) -> Option<Fault> {
        let seen = JointSample {
            measured: self.measurement.coordinate,
            moved: self.measurement.moved,
            period_us,
            ..JointSample::default()
        };
        let encoder = settings.encoder.as_ref()?;
        self.monitor
            .check_stuck_channel(joint, settings, encoder, &seen)
    }

    /// Rate of the motor side, from the times between edges.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.encoder.rate()
    }

    /// Sets whether the position is known well enough to compare it with the stroke.
    pub const fn set_placed(&mut self, placed: bool) {
        self.placed = placed;
    }

    /// Resets supervision, after the drives were switched on or the coordinate was set.
    pub fn settle(&mut self) {
        self.monitor.reset();
    }

    /// Computes the drive command of a period from the commanded motion of the slide and writes it
    /// to `command`; [`DriveCommand::Off`] while disabled. Returns whether the output is saturated.
    // Not inlined: with its own registers it is a third shorter than as a part of the whole period.
    #[inline(never)]
    pub fn servo(
        &mut self,
        coordinate: Coordinate,
        rate: Rate,
        acceleration: Acceleration,
        command: &mut DriveCommand,
    ) -> bool {
        self.commanded = JointCommand {
            coordinate,
            rate,
            acceleration,
        };
        if !self.enabled {
            *command = DriveCommand::Off;
            return false;
        }
        let shift = self.backlash.shift(coordinate, rate);
        // The motor's rate includes the crossing of the backlash: friction reverses when the motor
        // sets off, before the slide does.
        let rate = Rate(rate.0.saturating_add(shift.rate.0));
        let acceleration = Acceleration(acceleration.0.saturating_add(shift.acceleration.0));
        let target = sum(self.kind, coordinate, shift.coordinate);
        let following_error = difference(self.kind, target, self.measurement.motor);
        let servo_output = &mut self.servo_output;
        servo_output.following_error = following_error;
        match &mut self.output {
            Output::Torque { law, output } => {
                let (effort, cut) = law.effort(following_error, rate, acceleration);
                let (code, clamped) = output.code(effort);
                servo_output.command = DriveCommand::Torque(code);
                servo_output.effort = effort;
                servo_output.crossing = law.feedforward(shift.acceleration);
                servo_output.saturated = cut | clamped;
                *command = DriveCommand::Torque(code);
            }
            Output::Steps { planner, .. } => {
                let planned = planner.plan(target, rate);
                servo_output.command = DriveCommand::Steps(planned.segment);
                servo_output.saturated = planned.ceiling;
                servo_output.lag = planned.lag;
                *command = servo_output.command;
            }
        }
        servo_output.saturated
    }
}
