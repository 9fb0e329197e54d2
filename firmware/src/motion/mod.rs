//! What is wanted: the pose of this period, with its rate and acceleration.
//!
//! A pose coordinate takes its wanted value from the program, from a jog, from a hand, or holds ([`Source`]). To a jog, and from one, it changes only
//! at rest. Otherwise it changes while it moves: a [`Tracker`] takes over place and rate, and follows the hand, or brakes. Back at the program, the
//! difference between where it is and where the program would have it stays as an offset, whose rate the mover brakes; so nothing jumps.
//!
//! Misuse: [`Motion::place`] sets the wanted pose without moving there. It is for enabling and homing, when wanted must become measured.

pub mod cubic;
pub mod envelope;
pub mod interpolator;
pub mod jog;
pub mod ramp;
pub mod segment;
pub mod tracker;

use crate::config::Config;
use crate::config::HAND;
use crate::config::digest::constants;
use envelope::{MOST_LOAD, ReachableBox, StoppingEnvelope};
use haptimill_kinematics::{Accelerations, Kinematics, Pose, Rates};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::{MAX_AXES, Source};
use interpolator::{Program, Progress};
use jog::Jog;
use tracker::{Tracker, TrackerLimits};

/// The wanted pose and its motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PoseCommand {
    /// Pose.
    pub pose: Pose,
    /// Rates, axis units per second.
    pub rates: Rates,
    /// Accelerations.
    pub accelerations: Accelerations,
}

/// What moves the machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mode {
    /// Nothing: the wanted pose stays.
    #[default]
    Still,
    /// The program, for the coordinates whose source it is; jogs for those whose source is a jog.
    Program {
        /// Brake along the path, and wait.
        halt: bool,
    },
    /// A jog of all coordinates.
    Jog,
}

/// The generator of wanted poses.
#[derive(Debug, Default)]
pub struct Motion {
    /// The job.
    pub program: Program,
    /// The jog.
    pub jog: Jog,
    axes: usize,
    commanded: PoseCommand,
    sources: [Source; MAX_AXES],
    offsets: [i32; MAX_AXES],
    bounds: [TrackerLimits; MAX_AXES],
    /// What follows the hand or brakes; where the program leads, its offset while that is under way.
    trackers: [Tracker; MAX_AXES],
    /// Rates of the program in the last period.
    program_rates: Rates,
    /// Where the hand wants the coordinates that it leads.
    targets: [Option<Coordinate>; MAX_AXES],
    /// The hand leads on where there is no room to stop: what follows it brakes to rest.
    tracking_blocked: bool,
    /// That was told.
    limit_reported: bool,
    limited: Option<u8>,
    /// The job is over: what follows the hand comes to rest.
    stopping: bool,
    /// The wanted pose is another one than the program's, whose setpoints were checked when they were taken.
    blended: bool,
    /// The load of the joints in the last period in which it was looked at: a hand is followed more slowly where it is large.
    load: u32,
    /// How much room a box around a sweep has, and what is known of the reach.
    room: [i32; MAX_AXES],
    reach: ReachableBox,
}

constants!(Motion { axes, bounds, room } of { program, jog } but {
    commanded, sources, offsets, trackers, program_rates, targets, tracking_blocked, limit_reported, limited, stopping, blended, load, reach
});

/// Gain of the movers of a machine that no hand leads, 1/s: they only brake.
const GAIN: u16 = 100;

/// The room of a box around a sweep is this power of two of the range of a coordinate: 0.1 mm of 200, some 25 periods at 20 mm/s.
const ROOM_SHIFT: u32 = 11;

impl Motion {
    /// Becomes that of the machine of `config`, in its place: its queue is large.
    pub fn set_up(&mut self, config: &Config) {
        self.program.set_up(config);
        self.jog = Jog::new(config);
        self.axes = config.pose.len();
        let gain = config.follow.map_or(GAIN, |follow| follow.gain);
        self.reach = ReachableBox::default();
        for (room, axis) in self.room.iter_mut().zip(&config.pose) {
            *room = ((i64::from(axis.high.0) - i64::from(axis.low.0)).max(0) >> ROOM_SHIFT) as i32;
        }
        for (bounds, axis) in self.bounds.iter_mut().zip(&config.pose) {
            if HAND {
                *bounds = TrackerLimits::new(axis, gain, config.period_us).unwrap_or_default();
            }
        }
    }

    /// The wanted pose.
    #[must_use]
    #[inline]
    pub const fn commanded(&self) -> &PoseCommand {
        &self.commanded
    }

    /// Wanted becomes `pose`, at rest. No motion, and no jump: the caller has measured it.
    pub fn set_position(&mut self, pose: &Pose) {
        self.commanded = PoseCommand {
            pose: *pose,
            ..PoseCommand::default()
        };
        self.jog.begin(pose, true);
        self.reset_trackers();
    }

    /// All movers stand at the wanted pose.
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

    /// Begins a job at the wanted pose.
    pub fn begin_program(&mut self) {
        self.program.begin(&self.commanded.pose);
        self.offsets = [0; MAX_AXES];
        self.jog.begin(&self.commanded.pose, true);
        self.reset_trackers();
        self.update_blended();
    }

    /// Begins jogging at the wanted pose; `limited` says whether soft limits count.
    pub fn begin_jog(&mut self, limited: bool) {
        self.jog.begin(&self.commanded.pose, limited);
    }

    /// Chooses the source of one coordinate: to a jog, or from one, only while the machine is at rest.
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
        if HAND && source != before {
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

    /// Coordinates that a hand leads: a bit each.
    #[must_use]
    pub fn hand_mask(&self) -> u8 {
        if !HAND {
            return 0;
        }
        let axes = self.sources[..self.axes].iter().enumerate();
        axes.fold(0, |mask, (axis, source)| {
            mask | u8::from(*source == Source::Master) << axis
        })
    }

    /// Where the hand wants the coordinates that it leads, in this period.
    pub const fn set_master_targets(&mut self, targets: &[Option<Coordinate>; MAX_AXES]) {
        self.targets = *targets;
    }

    /// Where a coordinate that follows a hand comes to rest if nothing leads it any more.
    #[must_use]
    pub fn rest(&self, axis: usize) -> Coordinate {
        match self.sources.get(axis) {
            Some(Source::Master) => self.trackers[axis].rest(&self.bounds[axis]),
            _ => self.commanded.pose.0.get(axis).copied().unwrap_or_default(),
        }
    }

    /// Whether nothing moves: neither the program, nor a jog, nor what follows a hand or brakes.
    #[must_use]
    #[inline]
    pub fn is_at_standstill(&self) -> bool {
        self.program.is_at_standstill()
            && self.jog.is_at_standstill()
            && self.are_trackers_at_standstill()
    }

    /// Whether no mover is under way.
    #[must_use]
    pub fn are_trackers_at_standstill(&self) -> bool {
        !HAND
            || self.trackers[..self.axes]
                .iter()
                .all(Tracker::is_at_standstill)
    }

    /// A coordinate that the hand leads where the machine cannot go; once until it goes on.
    pub const fn take_limited(&mut self) -> Option<u8> {
        self.limited.take()
    }

    /// Where a coordinate takes its wanted value from.
    #[must_use]
    pub fn source(&self, axis: usize) -> Source {
        self.sources.get(axis).copied().unwrap_or_default()
    }

    /// All coordinates are led by the program again; only while the machine is at rest.
    pub fn reset_sources(&mut self) {
        self.sources = [Source::Program; MAX_AXES];
        self.update_blended();
    }

    /// Where the machine would stand if the program were at `pose`: with offsets, and with coordinates that the program does not lead.
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

    /// Whether the program leads a coordinate.
    #[must_use]
    pub fn is_led_by_program(&self, axis: usize) -> bool {
        self.source(axis) == Source::Program
    }

    /// Whether the program leads all coordinates, without offsets.
    #[must_use]
    pub const fn program_alone(&self) -> bool {
        !self.blended
    }

    /// Whether any coordinate takes its value from a jog.
    #[must_use]
    pub fn has_jog_source(&self) -> bool {
        self.sources[..self.axes].contains(&Source::Jog)
    }

    /// One period of what is nearly always: nothing moves, or a program alone. `None` where it is something else, for [`Motion::advance`].
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

    /// One period. The number is a coordinate whose jog was kept from going on.
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
                        self.jog.carry(axis, self.commanded.pose.0[axis]);
                    }
                }
                let (blocked, clipped) = self.check_stopping(machine);
                if clipped.is_some() {
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
                (progress, clipped.or(limited))
            }
        }
    }

    /// After a change of a source or an offset.
    fn update_blended(&mut self) {
        self.blended = self.sources[..self.axes]
            .iter()
            .any(|source| *source != Source::Program)
            || self.offsets.iter().any(|offset| *offset != 0)
            || !self.are_trackers_at_standstill();
    }

    /// One period of the movers; a bit for each that was under way in it.
    fn follow(&mut self, halt: bool) -> u8 {
        if !HAND {
            return 0;
        }
        let free = !(halt || self.tracking_blocked || self.stopping || self.load > MOST_LOAD);
        let mut moving = 0;
        for axis in 0..self.axes {
            let tracker = &mut self.trackers[axis];
            match self.sources[axis] {
                Source::Master => {
                    let target = self.targets[axis].filter(|_| free);
                    tracker.advance_under(target, self.load, &self.bounds[axis]);
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

    /// Whether the hand leads on; what follows it has come to rest and may try again, if it had to brake.
    fn hand_goes_on(&mut self) -> bool {
        self.tracking_blocked = self.tracking_blocked && !self.are_trackers_at_standstill();
        !self.tracking_blocked
    }

    /// Looks whether the machine can still come to rest within its bounds if all goes on for one period. Says whether the program must brake now,
    /// and the coordinate whose jog must. Where a joint would exceed its maximum rate, jogs and what follows the hand brake in this period, and try again
    /// in the next one.
    fn check_stopping(&mut self, machine: &impl Kinematics) -> (bool, Option<u8>) {
        let led = self.hand_goes_on();
        let load = self.fits(true, led, machine);
        self.load = load.unwrap_or_default();
        if self.load > MOST_LOAD {
            self.jog.brake();
        }
        if load.is_some() {
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
            !braked || self.fits(false, false, machine).is_none(),
            jogged,
        )
    }

    /// The load of the joints ([`StoppingEnvelope::load`]) until the machine rests if jogs and what follows the hand go on for one period, or brake already; `None` if it does not come to rest within its bounds.
    fn fits(
        &mut self,
        jog_goes_on: bool,
        hand_goes_on: bool,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        let program = self.program.sweep();
        let jog = self.jog.stopping(jog_goes_on)?;
        let mut sweep = StoppingEnvelope::at(&self.commanded.pose);
        let mut allowed = true;
        for axis in 0..self.axes {
            let (tracker, bounds) = (&self.trackers[axis], &self.bounds[axis]);
            match self.sources[axis] {
                Source::Program => {
                    sweep.take(axis, &program, self.offsets[axis]);
                    if HAND && !tracker.is_at_standstill() {
                        let (low, high) = tracker.sweep(None, bounds);
                        let of = |end: Coordinate, by: i64| i64::from(end.0) + by;
                        sweep.reach(axis, of(program.low.0[axis], low));
                        sweep.reach(axis, of(program.high.0[axis], high));
                        let own = i64::from(program.rates[axis].0);
                        sweep.quicken(axis, own + tracker.peak(None, self.load, bounds));
                    }
                    allowed &= self.offsets[axis] == 0 || self.jog.allows(axis, &sweep);
                }
                Source::Jog => sweep.take(axis, &jog, 0),
                Source::Master if HAND => {
                    let target = self.targets[axis].filter(|_| hand_goes_on);
                    let (low, high) = tracker.sweep(target, bounds);
                    // A mover at rest stays in its place, to the last bit.
                    if target.is_some() || !tracker.is_at_standstill() {
                        sweep.reach(axis, low);
                        sweep.reach(axis, high);
                        sweep.quicken(axis, tracker.peak(target, self.load, bounds));
                    }
                }
                Source::Hold if HAND && !tracker.is_at_standstill() => {
                    let (low, high) = tracker.sweep(None, bounds);
                    sweep.reach(axis, low);
                    sweep.reach(axis, high);
                    sweep.quicken(axis, tracker.peak(None, self.load, bounds));
                }
                Source::Hold | Source::Master => {}
            }
        }
        sweep.displace(self.jog.excursion());
        // A machine that no hand leads has its boxes for jogs alone, and little flash.
        let load = if HAND {
            let room = (&self.room, self.hand_mask());
            self.reach.holds(&sweep, room, self.axes, machine)
        } else {
            Some(sweep.load(&[sweep.rates], machine)?[0])
        };
        load.filter(|_| allowed)
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
            // What the program does meanwhile becomes the offset at which it is taken up again.
            self.offsets[axis] = position.wrapping_sub(program.pose.0[axis].0);
        }
        self.commanded.pose.0[axis] = Coordinate(position);
        self.commanded.rates[axis] = rate;
        self.commanded.accelerations[axis] = acceleration;
    }
}
