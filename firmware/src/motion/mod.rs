//! What is wanted: the pose of this period, with its rate and acceleration.
//!
//! A pose coordinate takes its wanted value from the program, from a jog, from a hand, or holds ([`Source`]). To a jog, and from one, it changes only
//! at rest. Otherwise it changes while it moves: a [`Mover`] takes over place and rate, and follows the hand, or brakes. Back at the program, the
//! difference between where it is and where the program would have it stays as an offset, whose rate the mover brakes; so nothing jumps.
//!
//! Misuse: [`Motion::place`] sets the wanted pose without moving there. It is for enabling and homing, when wanted must become measured.

pub mod cubic;
pub mod follow;
pub mod jog;
pub mod program;
pub mod ramp;
pub mod sweep;
pub mod way;

use crate::config::Config;
use crate::kinematics::{Accelerations, Kinematics, Pose, Rates};
use crate::machinery::hand::HAND;
use crate::safety::integrity::constants;
use crate::units::{Acceleration, Coordinate, Rate};
use follow::{Mover, MoverLimits};
use haptimill_protocol::message::{MAX_AXES, Source};
use jog::Jog;
use program::{Program, Progress};
use sweep::{MOST_LOAD, Reach, Sweep};

/// The wanted pose and its motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wanted {
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
    wanted: Wanted,
    sources: [Source; MAX_AXES],
    offsets: [i32; MAX_AXES],
    bounds: [MoverLimits; MAX_AXES],
    /// What follows the hand or brakes; where the program leads, its offset while that is under way.
    movers: [Mover; MAX_AXES],
    /// Rates of the program in the last period.
    program_rates: Rates,
    /// Where the hand wants the coordinates that it leads.
    targets: [Option<Coordinate>; MAX_AXES],
    /// The hand leads on where there is no room to stop: what follows it brakes to rest.
    confined: bool,
    /// That was told.
    told: bool,
    limited: Option<u8>,
    /// The job is over: what follows the hand comes to rest.
    ending: bool,
    /// The wanted pose is another one than the program's, whose setpoints were checked when they were taken.
    led_otherwise: bool,
    /// The load of the joints in the last period in which it was looked at: a hand is followed more slowly where it is large.
    load: u32,
    /// How much room a box around a sweep has, and what is known of the reach.
    room: [i32; MAX_AXES],
    reach: Reach,
}

constants!(Motion { axes, bounds, room } of { program, jog } but {
    wanted, sources, offsets, movers, program_rates, targets, confined, told, limited, ending, led_otherwise, load, reach
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
        self.reach = Reach::default();
        for (room, axis) in self.room.iter_mut().zip(&config.pose) {
            *room = ((i64::from(axis.high.0) - i64::from(axis.low.0)).max(0) >> ROOM_SHIFT) as i32;
        }
        for (bounds, axis) in self.bounds.iter_mut().zip(&config.pose) {
            if HAND {
                *bounds = MoverLimits::new(axis, gain, config.period_us).unwrap_or_default();
            }
        }
    }

    /// The wanted pose.
    #[must_use]
    #[inline]
    pub const fn wanted(&self) -> &Wanted {
        &self.wanted
    }

    /// Wanted becomes `pose`, at rest. No motion, and no jump: the caller has measured it.
    pub fn place(&mut self, pose: &Pose) {
        self.wanted = Wanted {
            pose: *pose,
            ..Wanted::default()
        };
        self.jog.begin(pose, true);
        self.stand();
    }

    /// All movers stand at the wanted pose.
    fn stand(&mut self) {
        for axis in 0..self.axes {
            let place = self.wanted.pose.0[axis];
            self.movers[axis] = Mover::at(place, Rate::ZERO, &self.bounds[axis]);
        }
        self.targets = [None; MAX_AXES];
        self.confined = false;
        self.told = false;
        self.ending = false;
    }

    /// Begins a job at the wanted pose.
    pub fn begin_program(&mut self) {
        self.program.begin(&self.wanted.pose);
        self.offsets = [0; MAX_AXES];
        self.jog.begin(&self.wanted.pose, true);
        self.stand();
        self.note_leaders();
    }

    /// Begins jogging at the wanted pose; `limited` says whether soft limits count.
    pub fn begin_jog(&mut self, limited: bool) {
        self.jog.begin(&self.wanted.pose, limited);
    }

    /// Chooses the source of one coordinate: to a jog, or from one, only while the machine is at rest.
    pub fn set_source(&mut self, axis: usize, source: Source) {
        let Some(before) = self.sources.get(axis).copied() else {
            return;
        };
        if !self.led_otherwise {
            self.program_rates = self.wanted.rates;
        }
        let bounds = &self.bounds[axis];
        let (place, rate) = (self.wanted.pose.0[axis], self.wanted.rates[axis]);
        if before == Source::Jog || source == Source::Jog {
            self.jog.begin(&self.wanted.pose, true);
        }
        if HAND && source != before {
            self.movers[axis] = if source == Source::Program {
                let rate = rate.saturating_sub(self.program_rates[axis]);
                Mover::at(Coordinate(self.offsets[axis]), rate, bounds)
            } else {
                Mover::at(place, rate, bounds)
            };
        }
        self.sources[axis] = source;
        self.targets[axis] = None;
        self.note_leaders();
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
    pub const fn lead(&mut self, targets: &[Option<Coordinate>; MAX_AXES]) {
        self.targets = *targets;
    }

    /// Where a coordinate that follows a hand comes to rest if nothing leads it any more.
    #[must_use]
    pub fn rest(&self, axis: usize) -> Coordinate {
        match self.sources.get(axis) {
            Some(Source::Master) => self.movers[axis].rest(&self.bounds[axis]),
            _ => self.wanted.pose.0.get(axis).copied().unwrap_or_default(),
        }
    }

    /// Whether nothing moves: neither the program, nor a jog, nor what follows a hand or brakes.
    #[must_use]
    #[inline]
    pub fn is_still(&self) -> bool {
        self.program.is_still() && self.jog.is_still() && self.movers_still()
    }

    /// Whether no mover is under way.
    #[must_use]
    pub fn movers_still(&self) -> bool {
        !HAND || self.movers[..self.axes].iter().all(Mover::is_still)
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
        self.note_leaders();
    }

    /// Where the machine would stand if the program were at `pose`: with offsets, and with coordinates that the program does not lead.
    #[must_use]
    pub fn destination(&self, pose: &Pose) -> Pose {
        let mut destination = *pose;
        for (axis, coordinate) in destination.0[..self.axes].iter_mut().enumerate() {
            *coordinate = match self.sources[axis] {
                Source::Program => Coordinate(coordinate.0.wrapping_add(self.offsets[axis])),
                Source::Jog | Source::Hold | Source::Master => self.wanted.pose.0[axis],
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
        !self.led_otherwise
    }

    /// Whether any coordinate takes its value from a jog.
    #[must_use]
    pub fn has_jog_source(&self) -> bool {
        self.sources[..self.axes].contains(&Source::Jog)
    }

    /// One period of what is nearly always: nothing moves, or a program alone. `None` where it is something else, for [`Motion::advance`].
    #[inline]
    pub fn advance_alone(&mut self, mode: Mode) -> Option<Progress> {
        match mode {
            Mode::Still => {
                self.wanted.rates = Rates::default();
                self.wanted.accelerations = Accelerations::default();
                Some(Progress::default())
            }
            Mode::Program { halt } if !self.led_otherwise => {
                Some(self.program.advance_to(halt, &mut self.wanted))
            }
            _ => None,
        }
    }

    /// One period. The number is a coordinate whose jog was kept from going on.
    pub fn advance(&mut self, mode: Mode, machine: &impl Kinematics) -> (Progress, Option<u8>) {
        if let Some(progress) = self.advance_alone(mode) {
            return (progress, None);
        }
        match mode {
            Mode::Still | Mode::Jog => {
                let (wanted, limited) = self.jog.advance(machine);
                self.wanted = wanted;
                (Progress::default(), limited)
            }
            Mode::Program { halt } => {
                for axis in 0..self.axes {
                    if self.sources[axis] != Source::Jog {
                        self.jog.carry(axis, self.wanted.pose.0[axis]);
                    }
                }
                let (blocked, clipped) = self.foresee(machine);
                if clipped.is_some() {
                    self.jog.release();
                }
                let (program, mut progress) = self.program.advance(halt || blocked);
                progress.blocked = blocked;
                self.program_rates = program.rates;
                let moving = self.follow(halt);
                self.ending = progress.finished;
                let (jog, limited) = self.jog.advance(machine);
                for axis in 0..self.axes {
                    self.merge(axis, &program, &jog, moving & (1 << axis) != 0);
                }
                self.note_leaders();
                (progress, clipped.or(limited))
            }
        }
    }

    /// After a change of a source or an offset.
    fn note_leaders(&mut self) {
        self.led_otherwise = self.sources[..self.axes]
            .iter()
            .any(|source| *source != Source::Program)
            || self.offsets.iter().any(|offset| *offset != 0)
            || !self.movers_still();
    }

    /// One period of the movers; a bit for each that was under way in it.
    fn follow(&mut self, halt: bool) -> u8 {
        if !HAND {
            return 0;
        }
        let free = !(halt || self.confined || self.ending || self.load > MOST_LOAD);
        let mut moving = 0;
        for axis in 0..self.axes {
            let mover = &mut self.movers[axis];
            match self.sources[axis] {
                Source::Master => {
                    let target = self.targets[axis].filter(|_| free);
                    mover.advance_under(target, self.load, &self.bounds[axis]);
                }
                Source::Hold | Source::Program if !mover.is_still() => {
                    mover.advance(None, &self.bounds[axis])
                }
                _ => continue,
            }
            moving |= 1 << axis;
        }
        moving
    }

    /// Whether the hand leads on; what follows it has come to rest and may try again, if it had to brake.
    fn hand_goes_on(&mut self) -> bool {
        self.confined = self.confined && !self.movers_still();
        !self.confined
    }

    /// Looks whether the machine can still come to rest within its bounds if all goes on for one period. Says whether the program must brake now,
    /// and the coordinate whose jog must. Where a joint would exceed its maximum rate, jogs and what follows the hand brake in this period, and try again
    /// in the next one.
    fn foresee(&mut self, machine: &impl Kinematics) -> (bool, Option<u8>) {
        let led = self.hand_goes_on();
        let load = self.fits(true, led, machine);
        self.load = load.unwrap_or_default();
        if self.load > MOST_LOAD {
            self.jog.brake();
        }
        if load.is_some() {
            self.told &= self.movers_still();
            return (false, None);
        }
        let first = |source| {
            let mut sources = self.sources[..self.axes].iter();
            sources
                .position(|other| *other == source)
                .map(|axis| axis as u8)
        };
        let jogged = first(Source::Jog).filter(|_| !self.jog.is_still());
        let followed = first(Source::Master);
        if followed.is_some() {
            self.confined = true;
            if !self.told {
                self.told = true;
                self.limited = followed;
            }
        }
        let braked = jogged.or(followed).is_some();
        (
            !braked || self.fits(false, false, machine).is_none(),
            jogged,
        )
    }

    /// The load of the joints ([`Sweep::load`]) until the machine rests if jogs and what follows the hand go on for one period, or brake already; `None` if it does not come to rest within its bounds.
    fn fits(
        &mut self,
        jog_goes_on: bool,
        hand_goes_on: bool,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        let program = self.program.sweep();
        let jog = self.jog.stopping(jog_goes_on)?;
        let mut sweep = Sweep::at(&self.wanted.pose);
        let mut allowed = true;
        for axis in 0..self.axes {
            let (mover, bounds) = (&self.movers[axis], &self.bounds[axis]);
            match self.sources[axis] {
                Source::Program => {
                    sweep.take(axis, &program, self.offsets[axis]);
                    if HAND && !mover.is_still() {
                        let (low, high) = mover.sweep(None, bounds);
                        let of = |end: Coordinate, by: i64| i64::from(end.0) + by;
                        sweep.reach(axis, of(program.low.0[axis], low));
                        sweep.reach(axis, of(program.high.0[axis], high));
                        let own = i64::from(program.rates[axis].0);
                        sweep.quicken(axis, own + mover.peak(None, self.load, bounds));
                    }
                    allowed &= self.offsets[axis] == 0 || self.jog.allows(axis, &sweep);
                }
                Source::Jog => sweep.take(axis, &jog, 0),
                Source::Master if HAND => {
                    let target = self.targets[axis].filter(|_| hand_goes_on);
                    let (low, high) = mover.sweep(target, bounds);
                    // A mover at rest stays in its place, to the last bit.
                    if target.is_some() || !mover.is_still() {
                        sweep.reach(axis, low);
                        sweep.reach(axis, high);
                        sweep.quicken(axis, mover.peak(target, self.load, bounds));
                    }
                }
                Source::Hold if HAND && !mover.is_still() => {
                    let (low, high) = mover.sweep(None, bounds);
                    sweep.reach(axis, low);
                    sweep.reach(axis, high);
                    sweep.quicken(axis, mover.peak(None, self.load, bounds));
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
            Some(sweep.load(&[sweep.rates], self.axes, machine)?[0])
        };
        load.filter(|_| allowed)
    }

    fn merge(&mut self, axis: usize, program: &Wanted, jog: &Wanted, moves: bool) {
        let mut moved = Wanted::default();
        if moves {
            self.movers[axis].tell(axis, &self.bounds[axis], &mut moved);
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
            Source::Hold => (self.wanted.pose.0[axis].0, Rate(0), Acceleration(0)),
        };
        if self.sources[axis] != Source::Program {
            // What the program does meanwhile becomes the offset at which it is taken up again.
            self.offsets[axis] = position.wrapping_sub(program.pose.0[axis].0);
        }
        self.wanted.pose.0[axis] = Coordinate(position);
        self.wanted.rates[axis] = rate;
        self.wanted.accelerations[axis] = acceleration;
    }
}
