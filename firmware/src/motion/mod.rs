//! Generation of the commanded pose of a control period, with its rates and accelerations.
//!
//! Each pose coordinate has a [`Source`]: the program, a jog, a hold or a master. A coordinate
//! changes to or from a jog only at standstill. All other changes are allowed in motion: a
//! [`Tracker`] takes over position and rate, and then follows the master or decelerates. When a
//! coordinate returns to the program, the difference between its position and the program's remains
//! as an offset. The tracker decelerates the rate of this offset, so position and rate are
//! continuous.
//!
//! Units: axis units, axis units per second.
//!
//! [`Motion::set_position`] sets the commanded pose without motion. Callers must use it only when
//! the commanded pose becomes the measured one: at enable and in homing.

pub mod cubic;
pub mod envelope;
pub mod interpolator;
pub mod jog;
pub mod ramp;
pub mod segment;
pub mod tracker;

use crate::config::Config;
use crate::config::HAPTICS;
use crate::digest::impl_digest;
use envelope::{MAX_UTILISATION, ReachableBox, StoppingEnvelope};
use haptimill_kinematics::{Accelerations, Kinematics, Pose, Rates};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::{MAX_AXES, Source};
use interpolator::{Interpolator, Progress};
use jog::Jog;
use tracker::{Tracker, TrackerEnvelope, TrackerLimits};

/// Commanded pose, with its rates and accelerations.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PoseCommand {
    /// Pose.
    pub pose: Pose,
    /// Rates, axis units per second.
    pub rates: Rates,
    /// Accelerations.
    pub accelerations: Accelerations,
}

/// Origin of the machine's motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mode {
    /// None: the commanded pose is constant.
    #[default]
    Still,
    /// The program, for the coordinates whose source is the program; jogs, for those whose source
    /// is a jog.
    Program {
        /// Decelerate along the path and wait.
        halt: bool,
    },
    /// A jog of all coordinates.
    Jog,
}

/// Generator of the commanded pose.
#[derive(Debug, Default)]
pub struct Motion {
    /// Setpoint queue and interpolator of the job.
    pub program: Interpolator,
    /// Jog generator.
    pub jog: Jog,
    axes: usize,
    commanded: PoseCommand,
    sources: [Source; MAX_AXES],
    offsets: [i32; MAX_AXES],
    bounds: [TrackerLimits; MAX_AXES],
    /// Trackers of the coordinates that follow a master or decelerate. Where the program is the
    /// source, the tracker decelerates the offset.
    trackers: [Tracker; MAX_AXES],
    /// Rates of the program in the last control period.
    program_rates: Rates,
    /// Positions that the master commands for its coordinates.
    targets: [Option<Coordinate>; MAX_AXES],
    /// The master commands motion beyond the stopping distance: its trackers decelerate to
    /// standstill.
    tracking_blocked: bool,
    /// The present block was reported.
    limit_reported: bool,
    limited: Option<u8>,
    /// The job is finished: the trackers of the master decelerate to standstill.
    stopping: bool,
    /// The commanded pose differs from the program's, whose setpoints were checked on acceptance.
    blended: bool,
    /// Rate utilisation of the joints at the last check. Above [`envelope::SLOWED_UTILISATION`] a
    /// master is followed more slowly.
    utilisation: u32,
    /// Margin of the reachable box around a stopping envelope, and the reachable box.
    margins: [i32; MAX_AXES],
    reach: ReachableBox,
}

impl_digest!(Motion { fields { axes, bounds, margins }, nested { program, jog }, skip {
    commanded, sources, offsets, trackers, program_rates, targets, tracking_blocked, limit_reported, limited, stopping, blended, utilisation, reach
} });

/// Gain of the trackers of a machine without a master, 1/s: these trackers only decelerate.
const GAIN: u16 = 100;

/// The margin of a reachable box is the range of a coordinate divided by this power of two: 0.1 mm
/// of 200 mm, some 25 control periods at 20 mm/s.
const MARGIN_SHIFT: u32 = 11;

impl Motion {
    /// Configures this generator in place for the machine of `config`, because its queue is large.
    pub fn configure(&mut self, config: &Config) {
        self.program.configure(config);
        self.jog = Jog::new(config);
        self.axes = config.pose.len();
        let gain = config.follow.map_or(GAIN, |follow| follow.gain);
        self.reach = ReachableBox::default();
        for (margins, axis) in self.margins.iter_mut().zip(&config.pose) {
            *margins =
                ((i64::from(axis.high.0) - i64::from(axis.low.0)).max(0) >> MARGIN_SHIFT) as i32;
        }
        for (bounds, axis) in self.bounds.iter_mut().zip(&config.pose) {
            if HAPTICS {
                *bounds = TrackerLimits::new(axis, gain, config.period_us).unwrap_or_default();
            }
        }
    }

    /// The commanded pose.
    #[must_use]
    #[inline]
    pub const fn commanded(&self) -> &PoseCommand {
        &self.commanded
    }

    /// Sets the commanded pose to `pose`, at standstill. The machine does not move. Callers must
    /// pass the measured pose.
    pub fn set_position(&mut self, pose: &Pose) {
        self.commanded = PoseCommand {
            pose: *pose,
            ..PoseCommand::default()
        };
        self.jog.begin(pose, true);
        self.reset_trackers();
    }

    /// Resets all trackers to the commanded pose, at standstill.
    fn reset_trackers(&mut self) {
        for axis in 0..self.axes {
            let place = self.commanded.pose.0[axis];
            self.trackers[axis] = Tracker::at(place, Rate::ZERO, &self.bounds[axis]);
        }
        self.targets = [None; MAX_AXES];
        self.tracking_blocked = false;
        self.limit_reported = false;
        self.stopping = false;
    }

    /// Begins a job at the commanded pose.
    pub fn begin_program(&mut self) {
        self.program.begin(&self.commanded.pose);
        self.offsets = [0; MAX_AXES];
        self.jog.begin(&self.commanded.pose, true);
        self.reset_trackers();
        self.update_blended();
    }

    /// Begins a jog at the commanded pose; `limited` enables the soft limits.
    pub fn begin_jog(&mut self, limited: bool) {
        self.jog.begin(&self.commanded.pose, limited);
    }

    /// Selects the source of one coordinate. Callers must change to or from a jog only at
    /// standstill.
    pub fn set_source(&mut self, axis: usize, source: Source) {
        let Some(before) = self.sources.get(axis).copied() else {
            return;
        };
        if !self.blended {
            self.program_rates = self.commanded.rates;
        }
        let bounds = &self.bounds[axis];
        let (place, rate) = (self.commanded.pose.0[axis], self.commanded.rates[axis]);
        if before == Source::Jog || source == Source::Jog {
            self.jog.begin(&self.commanded.pose, true);
        }
        if HAPTICS && source != before {
            self.trackers[axis] = if source == Source::Program {
                let rate = rate.saturating_sub(self.program_rates[axis]);
                Tracker::at(Coordinate(self.offsets[axis]), rate, bounds)
            } else {
                Tracker::at(place, rate, bounds)
            };
        }
        self.sources[axis] = source;
        self.targets[axis] = None;
        self.update_blended();
    }

    /// Coordinates whose source is a master, one bit each.
    #[must_use]
    pub fn master_mask(&self) -> u8 {
        if !HAPTICS {
            return 0;
        }
        let axes = self.sources[..self.axes].iter().enumerate();
        axes.fold(0, |mask, (axis, source)| {
            mask | u8::from(*source == Source::Master) << axis
        })
    }

    /// Sets the positions that the master commands in this control period.
    pub const fn set_master_targets(&mut self, targets: &[Option<Coordinate>; MAX_AXES]) {
        self.targets = *targets;
    }

    /// Position at which a coordinate that follows a master comes to standstill if the master stops
    /// moving it.
    #[must_use]
    pub fn standstill_position(&self, axis: usize) -> Coordinate {
        match self.sources.get(axis) {
            Some(Source::Master) => self.trackers[axis].standstill_position(&self.bounds[axis]),
            _ => self.commanded.pose.0.get(axis).copied().unwrap_or_default(),
        }
    }

    /// Whether all motion is at standstill: program, jog and trackers.
    #[must_use]
    #[inline]
    pub fn is_at_standstill(&self) -> bool {
        self.program.is_at_standstill()
            && self.jog.is_at_standstill()
            && self.are_trackers_at_standstill()
    }

    /// Whether all trackers are at standstill.
    #[must_use]
    pub fn are_trackers_at_standstill(&self) -> bool {
        !HAPTICS
            || self.trackers[..self.axes]
                .iter()
                .all(Tracker::is_at_standstill)
    }

    /// Takes the coordinate that the master moves beyond the machine's reach. Each block is
    /// reported once, until motion resumes.
    pub const fn take_limited(&mut self) -> Option<u8> {
        self.limited.take()
    }

    /// The source of a coordinate.
    #[must_use]
    pub fn source(&self, axis: usize) -> Source {
        self.sources.get(axis).copied().unwrap_or_default()
    }

    /// Makes the program the source of all coordinates. Callers must do this only at standstill.
    pub fn reset_sources(&mut self) {
        self.sources = [Source::Program; MAX_AXES];
        self.update_blended();
    }

    /// The commanded pose if the program were at `pose`: offsets are added, and coordinates of
    /// other sources keep their commanded positions.
    #[must_use]
    pub fn destination(&self, pose: &Pose) -> Pose {
        let mut destination = *pose;
        for (axis, coordinate) in destination.0[..self.axes].iter_mut().enumerate() {
            *coordinate = match self.sources[axis] {
                Source::Program => Coordinate(coordinate.0.wrapping_add(self.offsets[axis])),
                Source::Jog | Source::Hold | Source::Master => self.commanded.pose.0[axis],
            };
        }
        destination
    }

    /// Whether the program is the source of a coordinate.
    #[must_use]
    pub fn is_led_by_program(&self, axis: usize) -> bool {
        self.source(axis) == Source::Program
    }

    /// Whether the program is the source of all coordinates, without offsets.
    #[must_use]
    pub const fn program_alone(&self) -> bool {
        !self.blended
    }

    /// Whether the source of any coordinate is a jog.
    #[must_use]
    pub fn has_jog_source(&self) -> bool {
        self.sources[..self.axes].contains(&Source::Jog)
    }

    /// Advances one control period in the common cases: standstill, or the program alone. Returns
    /// `None` in all other cases; they need [`Motion::advance`].
    #[inline]
    pub fn advance_program(&mut self, mode: Mode) -> Option<Progress> {
        match mode {
            Mode::Still => {
                self.commanded.rates = Rates::default();
                self.commanded.accelerations = Accelerations::default();
                Some(Progress::default())
            }
            Mode::Program { halt } if !self.blended => {
                Some(self.program.advance_to(halt, &mut self.commanded))
            }
            _ => None,
        }
    }

    /// Advances one control period. The number names a coordinate whose jog was limited.
    pub fn advance(&mut self, mode: Mode, machine: &impl Kinematics) -> (Progress, Option<u8>) {
        if let Some(progress) = self.advance_program(mode) {
            return (progress, None);
        }
        match mode {
            Mode::Still | Mode::Jog => {
                let (commanded, limited) = self.jog.advance(machine);
                self.commanded = commanded;
                (Progress::default(), limited)
            }
            Mode::Program { halt } => {
                for axis in 0..self.axes {
                    if self.sources[axis] != Source::Jog {
                        self.jog.set_coordinate(axis, self.commanded.pose.0[axis]);
                    }
                }
                let (blocked, limited_jog) = self.check_stopping(machine);
                if limited_jog.is_some() {
                    self.jog.release();
                }
                let (program, mut progress) = self.program.advance(halt || blocked);
                progress.blocked = blocked;
                self.program_rates = program.rates;
                let moving = self.follow(halt);
                self.stopping = progress.finished;
                let (jog, limited) = self.jog.advance(machine);
                for axis in 0..self.axes {
                    self.merge(axis, &program, &jog, moving & (1 << axis) != 0);
                }
                self.update_blended();
                (progress, limited_jog.or(limited))
            }
        }
    }

    /// Updates `blended` after a change of a source or an offset.
    fn update_blended(&mut self) {
        self.blended = self.sources[..self.axes]
            .iter()
            .any(|source| *source != Source::Program)
            || self.offsets.iter().any(|offset| *offset != 0)
            || !self.are_trackers_at_standstill();
    }

    /// Advances the trackers by one control period. Returns a bit for each tracker that moved.
    fn follow(&mut self, halt: bool) -> u8 {
        if !HAPTICS {
            return 0;
        }
        let free =
            !(halt || self.tracking_blocked || self.stopping || self.utilisation > MAX_UTILISATION);
        let mut moving = 0;
        for axis in 0..self.axes {
            let tracker = &mut self.trackers[axis];
            match self.sources[axis] {
                Source::Master => {
                    let target = self.targets[axis].filter(|_| free);
                    tracker.advance_under(target, self.utilisation, &self.bounds[axis]);
                }
                Source::Hold | Source::Program if !tracker.is_at_standstill() => {
                    tracker.advance(None, &self.bounds[axis])
                }
                _ => continue,
            }
            moving |= 1 << axis;
        }
        moving
    }

    /// Whether the master may continue to move the tool. A blocked master may move it again once
    /// all trackers are at standstill.
    fn master_may_move(&mut self) -> bool {
        self.tracking_blocked = self.tracking_blocked && !self.are_trackers_at_standstill();
        !self.tracking_blocked
    }

    /// Checks whether the machine can still stop within its bounds after one more period of motion.
    /// Returns whether the program must decelerate now, and the coordinate whose jog must. Where a
    /// joint would exceed its maximum rate, jogs and trackers decelerate in this period and try
    /// again in the next one.
    fn check_stopping(&mut self, machine: &impl Kinematics) -> (bool, Option<u8>) {
        let master_moves = self.master_may_move();
        let utilisation = self.stopping_utilisation(true, master_moves, machine);
        self.utilisation = utilisation.unwrap_or_default();
        if self.utilisation > MAX_UTILISATION {
            self.jog.brake();
        }
        if utilisation.is_some() {
            self.limit_reported &= self.are_trackers_at_standstill();
            return (false, None);
        }
        let first = |source| {
            let mut sources = self.sources[..self.axes].iter();
            sources
                .position(|other| *other == source)
                .map(|axis| axis as u8)
        };
        let jogged = first(Source::Jog).filter(|_| !self.jog.is_at_standstill());
        let followed = first(Source::Master);
        if followed.is_some() {
            self.tracking_blocked = true;
            if !self.limit_reported {
                self.limit_reported = true;
                self.limited = followed;
            }
        }
        let braked = jogged.or(followed).is_some();
        (
            !braked || self.stopping_utilisation(false, false, machine).is_none(),
            jogged,
        )
    }

    /// The utilisation of the joints ([`StoppingEnvelope::rate_utilisation`]) up to standstill, if
    /// jogs and trackers continue for one period or decelerate now. `None` if the machine does not
    /// stop within its bounds.
    fn stopping_utilisation(
        &mut self,
        jog_continues: bool,
        master_may_move: bool,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        let program = self.program.envelope();
        let jog = self.jog.stopping(jog_continues)?;
        let mut envelope =
            StoppingEnvelope::at(&self.commanded.pose).with_wrapping(self.jog.wrapping());
        let extend = |envelope: &mut StoppingEnvelope, axis, by: &TrackerEnvelope| {
            envelope.reach(axis, by.low);
            envelope.reach(axis, by.high);
            envelope.extend_rate(axis, by.rate);
        };
        let mut allowed = true;
        for axis in 0..self.axes {
            let (tracker, bounds) = (&self.trackers[axis], &self.bounds[axis]);
            match self.sources[axis] {
                Source::Program => {
                    envelope.take(axis, &program, self.offsets[axis]);
                    if HAPTICS && !tracker.is_at_standstill() {
                        let offset = tracker.envelope(None, self.utilisation, bounds);
                        let of = |end: Coordinate, by: i64| i64::from(end.0) + by;
                        envelope.reach(axis, of(program.low.0[axis], offset.low));
                        envelope.reach(axis, of(program.high.0[axis], offset.high));
                        let own = i64::from(program.rates[axis].0);
                        envelope.extend_rate(axis, own + offset.rate);
                    }
                    allowed &= self.offsets[axis] == 0 || self.jog.allows(axis, &envelope);
                }
                Source::Jog => envelope.take(axis, &jog, 0),
                Source::Master if HAPTICS => {
                    let target = self.targets[axis].filter(|_| master_may_move);
                    // A tracker at standstill keeps its position exactly.
                    if target.is_some() || !tracker.is_at_standstill() {
                        extend(
                            &mut envelope,
                            axis,
                            &tracker.envelope(target, self.utilisation, bounds),
                        );
                    }
                }
                Source::Hold if HAPTICS && !tracker.is_at_standstill() => {
                    extend(
                        &mut envelope,
                        axis,
                        &tracker.envelope(None, self.utilisation, bounds),
                    );
                }
                Source::Hold | Source::Master => {}
            }
        }
        envelope.displace(self.jog.displacement());
        // A machine without a master checks the corners directly: it needs boxes only for jogs, and
        // has little flash.
        let utilisation = if HAPTICS {
            let margins = (&self.margins, self.master_mask());
            self.reach
                .utilisation_bound(&envelope, margins, self.axes, machine)
        } else {
            Some(envelope.rate_utilisation(&[envelope.rates], machine)?[0])
        };
        utilisation.filter(|_| allowed)
    }

    fn merge(&mut self, axis: usize, program: &PoseCommand, jog: &PoseCommand, moves: bool) {
        let mut moved = PoseCommand::default();
        if moves {
            self.trackers[axis].write_to(axis, &self.bounds[axis], &mut moved);
            if self.sources[axis] == Source::Program {
                self.offsets[axis] = moved.pose.0[axis].0;
            }
        }
        let offset = self.offsets[axis];
        let (position, rate, acceleration) = match self.sources[axis] {
            Source::Program => (
                program.pose.0[axis].0.wrapping_add(offset),
                program.rates[axis].saturating_add(moved.rates[axis]),
                program.accelerations[axis].saturating_add(moved.accelerations[axis]),
            ),
            Source::Master => (
                moved.pose.0[axis].0,
                moved.rates[axis],
                moved.accelerations[axis],
            ),
            Source::Hold if moves => (
                moved.pose.0[axis].0,
                moved.rates[axis],
                moved.accelerations[axis],
            ),
            Source::Jog => (jog.pose.0[axis].0, jog.rates[axis], jog.accelerations[axis]),
            Source::Hold => (self.commanded.pose.0[axis].0, Rate(0), Acceleration(0)),
        };
        if self.sources[axis] != Source::Program {
            // The offset absorbs the program's own motion until the coordinate returns to the
            // program.
            self.offsets[axis] = position.wrapping_sub(program.pose.0[axis].0);
        }
        self.commanded.pose.0[axis] = Coordinate(position);
        self.commanded.rates[axis] = rate;
        self.commanded.accelerations[axis] = acceleration;
    }
}
