//! A joint: encoder, backlash, position loop and output, whichever its drive is.
//!
//! ```text
//! sense   counts, edge times --encoder--> motor coordinate, rate --backlash--> coordinate of the slide
//! drive   wanted slide --backlash--> wanted motor --position loop--> effort --> code          (torque)
//!                                                 --step planner--> pulses                    (step/dir)
//! ```
//!
//! On a step/dir axis the position loop is in the drive: pulses follow what is wanted, and the encoder supervises; [`Sensed::slip`] is the
//! disagreement. Latency: outputs take effect one period after the inputs were latched. The pulses of a step axis *end* at the wanted position, at the end of that next
//! period: two periods after the latch. A torque axis closes its loop on the wanted position of the latch.
//!
//! Misuse: [`JointDrive::sense`] once every period whether enabled or not, before [`JointDrive::drive`]. What is wanted must begin at what
//! [`JointDrive::enable`] gives back.

pub mod backlash;
pub mod counted;
pub mod edges;
pub mod encoder;
pub mod index;
pub mod quadrature;
pub(crate) mod reciprocal;
pub mod steps;
pub mod torque;

use crate::config::{AxisKind, Drive, JointAxis, Supervision};
use crate::io::{AxisInputs, DriveCommand};
use crate::position::PositionLaw;
use crate::safety::integrity::{Constants, Digest, constants};
use crate::safety::supervise::{Seen, Watch};
use crate::units::{Acceleration, Coordinate, Effort, Rate};
use backlash::Backlash;
use counted::Counted;
use encoder::{Encoder, difference, sum};
use haptimill_protocol::message::Fault;
use index::IndexWatch;
use steps::{PulseTiming, StepPlanner};
use torque::TorqueOutput;

/// Why a joint's configuration cannot work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveError {
    /// The control period is not within 50 to 1000 us.
    Period,
    /// An encoder count of no size.
    Encoder,
    /// A torque drive of no full scale, or with a limit that is not above zero.
    Torque,
    /// A step smaller than one axis unit, or too many or too few ticks.
    Step,
    /// Pulse width and direction set-up do not fit into a control period.
    Timing,
    /// A backlash below zero.
    Backlash,
}

/// What a joint's sensors say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sensed {
    /// Coordinate of the slide: the motor's, less what backlash hides.
    pub coordinate: Coordinate,
    /// Coordinate of the motor side.
    pub motor: Coordinate,
    /// Encoder counts since the period before.
    pub moved: i32,
    /// Illegal transitions since enable; [`u32::MAX`] when index pulses say that counts were lost.
    pub illegal: u32,
    /// A new index pulse: its raw count, and the motor's coordinate there.
    pub index: Option<(i32, Coordinate)>,
    /// Counts by which index pulses are off, more than the configuration allows, since enable; else 0.
    pub off: i32,
    /// Step/dir only: coordinate according to the steps emitted, less the measured one.
    pub slip: Coordinate,
    /// The slip is beyond the limit of the configuration: steps were lost.
    pub lost_steps: bool,
    /// The counter changed by more than the joint can move in a period.
    pub leapt: bool,
}

/// Where a slide shall be.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Coordinate of the slide.
    pub coordinate: Coordinate,
    /// Its rate.
    pub rate: Rate,
    /// Its acceleration.
    pub acceleration: Acceleration,
}

/// What a period of driving came to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Driven {
    /// For the drive.
    pub command: DriveCommand,
    /// Wanted less measured, both of the motor side: what the loop works on.
    pub following_error: Coordinate,
    /// Effort asked for; zero on a step/dir axis.
    pub effort: Effort,
    /// The effort was cut at the drive's limit, or steps did not fit into the period.
    pub saturated: bool,
    /// Steps owed because they did not fit.
    pub lag: i32,
}

/// Where a joint stands, and what is known of its encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Kept {
    motor: Coordinate,
    slide: Coordinate,
    illegal: u32,
    off: i32,
    indexes: IndexWatch,
}

/// The output side, by kind of drive.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Output {
    Torque {
        law: PositionLaw,
        output: TorqueOutput,
    },
    Steps {
        planner: StepPlanner,
        supervision: StepSupervision,
    },
}

/// Compares steps with the encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
struct StepSupervision {
    per_step: i64,
    lost: i32,
    /// Free running counter of steps, and the motor, at the start of supervision.
    last_steps: i32,
    steps: i64,
    start: Coordinate,
    /// The rotor has not locked yet.
    lock: Option<Lock>,
}

constants!(StepSupervision { per_step, lost } of {} but { last_steps, steps, start, lock });

/// A rotor that moves to a detent after its drive was switched on.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Lock {
    /// The motor when the drive was switched on.
    origin: Coordinate,
    /// Middle of the band in which the rotor stays, and periods for which it has stayed there.
    middle: Coordinate,
    quiet: u32,
}

/// One joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JointDrive {
    kind: AxisKind,
    encoder: Encoder,
    indexes: IndexWatch,
    backlash: Backlash,
    output: Output,
    watch: Watch,
    wanted: Wanted,
    sensed: Sensed,
    driven: Driven,
    sensed_once: bool,
    enabled: bool,
    /// Counts that the joint can move by in a period ([`reach`]).
    reach: u32,
}

/// A joint is taken to move no faster than this many times its highest rate: by hand, coasting, or run away.
const REACH_FACTOR: u64 = 10;

/// Counts that a joint can move by in a period: its following error at standstill (a rotor that snaps, a screw that unwinds) and the way at [`REACH_FACTOR`] times its
/// highest rate. A counter that changes by more has jumped; where periods were missed, by more in the mean of them.
fn reach(axis: &JointAxis, period_us: u16) -> u32 {
    let rate = u64::from(axis.rate.0.unsigned_abs());
    let travel = rate * REACH_FACTOR * u64::from(period_us) / 1_000_000;
    let way = travel + u64::from(axis.following.magnitude());
    let counts = (way << 24) / axis.per_count.unsigned_abs().max(1);
    counts.min(u64::from(u32::MAX)) as u32
}

constants!(JointDrive { kind, reach } of { encoder, indexes, backlash, output } but { watch, wanted, sensed, driven, sensed_once, enabled });

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
    /// A joint of a configuration; disabled, its coordinate 0 where it stands when first sensed.
    pub fn new(axis: &JointAxis, period_us: u16) -> Result<Self, DriveError> {
        if !(50..=1000).contains(&period_us) {
            return Err(DriveError::Period);
        }
        if axis.per_count == 0 {
            return Err(DriveError::Encoder);
        }
        if axis.backlash.0 < 0 {
            return Err(DriveError::Backlash);
        }
        let output = match axis.drive {
            Drive::Torque { full_scale, limit } => {
                if full_scale.0 == 0 || limit.0 <= 0 {
                    return Err(DriveError::Torque);
                }
                Output::Torque {
                    law: PositionLaw::new(&axis.law, limit, period_us),
                    output: TorqueOutput::new(full_scale),
                }
            }
            Drive::Steps {
                per_step,
                ticks_per_us,
                pulse,
                setup,
                hold,
                lost,
            } => {
                if per_step.unsigned_abs() < 1 << 24 || !(1..=1000).contains(&ticks_per_us) {
                    return Err(DriveError::Step);
                }
                let period = u32::from(ticks_per_us) * u32::from(period_us);
                let timing = PulseTiming {
                    period,
                    pulse,
                    setup,
                    hold,
                };
                if !timing.fits() {
                    return Err(DriveError::Timing);
                }
                Output::Steps {
                    planner: StepPlanner::new(axis.kind, per_step, timing, period_us),
                    supervision: StepSupervision {
                        per_step,
                        lost: lost.0,
                        last_steps: 0,
                        steps: 0,
                        start: Coordinate(0),
                        lock: None,
                    },
                }
            }
        };
        Ok(Self {
            kind: axis.kind,
            encoder: Encoder::new(axis.kind, axis.per_count),
            indexes: IndexWatch::new(axis.index_pitch.0, axis.per_count, axis.index_slack),
            backlash: Backlash::new(axis.kind, axis.backlash, period_us),
            output,
            watch: Watch::default(),
            wanted: Wanted::default(),
            sensed: Sensed::default(),
            driven: Driven::default(),
            sensed_once: false,
            enabled: false,
            reach: reach(axis, period_us),
        })
    }

    /// Reads the joint's inputs, latched at `time_ns` of the board's clock. Once every period.
    #[inline(never)]
    pub fn sense(&mut self, inputs: &AxisInputs, time_ns: u32) -> &Sensed {
        let measured = self.encoder.read(inputs, time_ns);
        if !self.sensed_once {
            self.sensed_once = true;
            self.backlash.place(measured.coordinate);
            if let Output::Steps { supervision, .. } = &mut self.output {
                supervision.last_steps = inputs.steps;
                supervision.start = measured.coordinate;
            }
        }
        if let Output::Steps { supervision, .. } = &mut self.output {
            let motor = measured.coordinate;
            (self.sensed.slip, self.sensed.lost_steps) =
                supervision.compare(self.kind, self.enabled, inputs.steps, motor);
        }
        let sensed = &mut self.sensed;
        sensed.coordinate = self.backlash.carry(measured.coordinate);
        sensed.motor = measured.coordinate;
        sensed.moved = measured.moved;
        sensed.leapt = measured.moved.unsigned_abs() > self.reach;
        sensed.illegal = self.encoder.illegal();
        sensed.index = measured.index;
        if sensed.index.is_some() {
            self.note_pulse();
        }
        &self.sensed
    }

    /// Counts that were lost make the encoder unbelievable until the joint is enabled anew.
    #[cold]
    #[inline(never)]
    fn note_pulse(&mut self) {
        let sensed = &mut self.sensed;
        if let Some((raw, _)) = sensed.index
            && let Some(off) = self.indexes.pulse(raw)
        {
            self.encoder.disbelieve();
            sensed.illegal = self.encoder.illegal();
            sensed.off = off;
        }
    }

    /// Whether the counter jumped, so many periods after it was read before: it is not believed any more then.
    pub(crate) const fn jumped(&mut self, periods: u32) -> bool {
        let jumped = self.sensed.moved.unsigned_abs() / periods > self.reach;
        if jumped {
            self.encoder.disbelieve();
            self.sensed.illegal = self.encoder.illegal();
        }
        jumped
    }

    /// The joint, which was taken to stand at its preset now, stood there at power-on, and has moved from there as was counted since. False if the counter jumped.
    pub(crate) fn count_from(&mut self, counted: &Counted) -> bool {
        let Ok(travelled) = i32::try_from(counted.travelled) else {
            return false;
        };
        let preset = self.sensed.motor;
        self.set_reference(counted.counts.wrapping_sub(travelled), preset);
        counted.widest <= self.reach
    }

    /// The references are looked for, or not any more.
    pub fn search(&mut self, searching: bool) {
        self.indexes.search(searching);
    }

    /// Where index pulses must come.
    pub const fn indexes(&self) -> &IndexWatch {
        &self.indexes
    }

    /// What was sensed last.
    #[inline]
    pub const fn sensed(&self) -> &Sensed {
        &self.sensed
    }

    /// The drive goes on at the slide's present coordinate, which is given back: what is wanted must begin there, at rest. Nothing jumps.
    pub fn enable(&mut self) -> Coordinate {
        let motor = self.sensed.motor;
        self.backlash.hold(motor);
        if self.sensed.off != 0 {
            self.indexes.forget();
        }
        self.encoder.clear_illegal();
        self.sensed.illegal = 0;
        self.sensed.off = 0;
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
        self.sensed.slip = Coordinate(0);
        self.sensed.lost_steps = false;
        self.enabled = true;
        self.sensed.coordinate
    }

    /// The drive was just switched on, and the rotor of a step motor moves to a detent: lost steps are not supervised until it [has locked](Self::end_lock). False for a
    /// torque drive.
    pub fn begin_lock(&mut self) -> bool {
        let Output::Steps { supervision, .. } = &mut self.output else {
            return false;
        };
        let motor = self.sensed.motor;
        supervision.lock = Some(Lock {
            origin: motor,
            middle: motor,
            quiet: 0,
        });
        true
    }

    /// One period until the rotor has locked: how far it is from where its drive was switched on, and for how many periods it has stayed within an eighth of the limit
    /// of lost steps (two counts at least). `None` for a torque drive.
    pub fn locking(&mut self, axis: &JointAxis) -> Option<(Coordinate, u32)> {
        let Output::Steps { supervision, .. } = &mut self.output else {
            return None;
        };
        let motor = self.sensed.motor;
        let band = u64::from(supervision.lost.unsigned_abs() / 8);
        let lock = supervision.lock.as_mut()?;
        let moved = difference(self.kind, motor, lock.middle).magnitude();
        if u64::from(moved) > band.max(axis.per_count.unsigned_abs() >> 23) {
            lock.middle = motor;
            lock.quiet = 0;
        } else {
            lock.quiet = lock.quiet.saturating_add(1);
        }
        Some((difference(self.kind, motor, lock.origin), lock.quiet))
    }

    /// The rotor has locked: steps count from where it is, and lost ones are supervised. Gives the slide's coordinate, which becomes the commanded one; `None` for a
    /// torque drive.
    pub fn end_lock(&mut self) -> Option<Coordinate> {
        let locks =
            matches!(&self.output, Output::Steps { supervision, .. } if supervision.lock.is_some());
        locks.then(|| self.enable())
    }

    /// The drive goes off.
    pub fn disable(&mut self) {
        self.enabled = false;
        self.driven = Driven::default();
    }

    /// What the last period of driving came to.
    #[inline]
    pub const fn driven(&self) -> &Driven {
        &self.driven
    }

    /// The drive is on.
    pub const fn is_enabled(&self) -> bool {
        self.enabled
    }

    /// The motor's coordinate at the raw count `raw` is `coordinate`: a preset (with [`AxisInputs::counts`]) or a found index.
    ///
    /// Gives what every coordinate of this joint grew by. The caller adds it to what it wants, in the same period; then nothing moves, enabled or not.
    pub fn set_reference(&mut self, raw: i32, coordinate: Coordinate) -> Coordinate {
        let shift = self.encoder.set_reference(raw, coordinate);
        self.backlash.rebase(shift);
        if let Output::Steps {
            planner,
            supervision,
        } = &mut self.output
        {
            planner.rebase(shift);
            supervision.start = sum(self.kind, supervision.start, shift);
        }
        self.sensed.coordinate = sum(self.kind, self.sensed.coordinate, shift);
        self.sensed.motor = sum(self.kind, self.sensed.motor, shift);
        shift
    }

    /// What a joint of another configuration, whose counts mean the same, takes over.
    pub fn standing(&self) -> Kept {
        Kept {
            motor: self.sensed.motor,
            slide: self.sensed.coordinate,
            illegal: self.sensed.illegal,
            off: self.sensed.off,
            indexes: self.indexes.clone(),
        }
    }

    /// Takes over where a joint stood, whose counter is at `raw`, and what was wrong with its encoder.
    pub fn take_over(&mut self, raw: i32, kept: &Kept) {
        self.set_reference(raw, kept.motor);
        self.backlash.place(kept.slide);
        self.sensed.coordinate = self.backlash.carry(kept.motor);
        self.encoder.take_over_illegal(kept.illegal);
        self.sensed.illegal = kept.illegal;
        self.sensed.off = kept.off;
        self.indexes.take_over(&kept.indexes);
    }

    /// Supervision: does the joint do what it was told in the period before? `joint` is its number, `axis` its configuration; periods were
    /// `missed` before this one.
    #[inline(never)]
    pub fn supervise(
        &mut self,
        joint: u8,
        axis: &JointAxis,
        limits: &Supervision,
        period_us: u16,
        missed: bool,
    ) -> Option<Fault> {
        let sensed = &self.sensed;
        let seen = Seen {
            wanted: self.wanted.coordinate,
            wanted_rate: self.wanted.rate,
            measured: sensed.coordinate,
            moved: sensed.moved,
            effort: self.driven.effort,
            rate: if Watch::pushes(axis, self.driven.effort) {
                self.encoder.rate()
            } else {
                Rate::ZERO
            },
            illegal: sensed.illegal.min(u32::from(u16::MAX)) as u16,
            steps_off: sensed.slip,
            period_us,
            missed,
        };
        if sensed.off != 0 {
            return Some(Fault::EncoderSlip {
                axis: joint,
                counts: sensed.off,
            });
        }
        self.watch
            .look(joint, axis, limits.illegal_transitions, &seen)
    }

    /// Rate of the motor side, from the times between edges.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.encoder.rate()
    }

    /// Supervision forgets what it saw: the drives go on, or the coordinate was set.
    pub fn settle(&mut self) {
        self.watch.reset();
    }

    /// The command of a period, for where the slide shall be, put into its place; off while disabled. Says whether the drive was asked for too much.
    // Called, not inlined: with registers of its own it is a third shorter than as a part of the whole period.
    #[inline(never)]
    pub fn drive(
        &mut self,
        coordinate: Coordinate,
        rate: Rate,
        acceleration: Acceleration,
        command: &mut DriveCommand,
    ) -> bool {
        self.wanted = Wanted {
            coordinate,
            rate,
            acceleration,
        };
        if !self.enabled {
            *command = DriveCommand::Off;
            return false;
        }
        let (shift, shift_rate) = self.backlash.shift(rate);
        // The motor's rate, crossing the play included: its friction turns over as it sets off, not when the slide does.
        let rate = Rate(rate.0.saturating_add(shift_rate.0));
        let target = sum(self.kind, coordinate, shift);
        let following_error = difference(self.kind, target, self.sensed.motor);
        let driven = &mut self.driven;
        driven.following_error = following_error;
        match &mut self.output {
            Output::Torque { law, output } => {
                let (effort, cut) = law.effort(following_error, rate, acceleration);
                let (code, clamped) = output.code(effort);
                driven.command = DriveCommand::Torque(code);
                driven.effort = effort;
                driven.saturated = cut | clamped;
                *command = DriveCommand::Torque(code);
            }
            Output::Steps { planner, .. } => {
                let planned = planner.plan(target, rate);
                driven.command = DriveCommand::Steps(planned.segment);
                driven.saturated = planned.ceiling;
                driven.lag = planned.lag;
                *command = driven.command;
            }
        }
        driven.saturated
    }
}

impl StepSupervision {
    /// From now on steps and encoder agree.
    const fn restart(&mut self, motor: Coordinate) {
        self.steps = 0;
        self.start = motor;
        self.lock = None;
    }

    /// Steps less encoder, and whether that is too much.
    #[inline(never)]
    fn compare(
        &mut self,
        kind: AxisKind,
        enabled: bool,
        steps: i32,
        motor: Coordinate,
    ) -> (Coordinate, bool) {
        self.steps = self
            .steps
            .wrapping_add(i64::from(steps.wrapping_sub(self.last_steps)));
        self.last_steps = steps;
        if !enabled || self.lock.is_some() {
            return (Coordinate(0), false);
        }
        let by_steps = match kind {
            AxisKind::Linear => {
                let travel = self
                    .steps
                    .saturating_mul(self.per_step)
                    .saturating_add(1 << 23)
                    >> 24;
                sum(kind, self.start, Coordinate(reciprocal::saturate(travel)))
            }
            AxisKind::Rotary => {
                let travel = self.steps.wrapping_mul(self.per_step).wrapping_add(1 << 23) >> 24;
                sum(kind, self.start, Coordinate(travel as i32))
            }
        };
        let slip = difference(kind, by_steps, motor);
        (slip, slip.0.unsigned_abs() > self.lost.unsigned_abs())
    }
}
