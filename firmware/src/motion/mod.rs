//! What is wanted: the pose of this period, with its rate and acceleration.
//!
//! A pose coordinate takes its wanted value from the program, from a jog, or holds ([`Source`]). Sources change only while the
//! coordinate is at rest; the difference between where it stands and where the program would have it stays as an offset, so nothing jumps.
//!
//! Misuse: [`Motion::place`] sets the wanted pose without moving there. It is for enabling and homing, when wanted must become measured.

pub mod cubic;
pub mod jog;
pub mod program;
pub mod ramp;
pub mod sweep;

use crate::config::Config;
use crate::kinematics::{Accelerations, Kinematics, Pose, Rates};
use crate::safety::integrity::constants;
use crate::units::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::{MAX_AXES, Source};
use jog::Jog;
use program::{Program, Progress};
use sweep::Sweep;

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
    /// The wanted pose is another one than the program's, whose setpoints were checked when they were taken.
    led_otherwise: bool,
}

constants!(Motion { axes } of { program, jog } but { wanted, sources, offsets, led_otherwise });

impl Motion {
    /// Becomes that of the machine of `config`, in its place: its queue is large.
    pub fn set_up(&mut self, config: &Config) {
        self.program.set_up(config);
        self.jog = Jog::new(config);
        self.axes = config.pose.len();
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
    }

    /// Begins a job at the wanted pose.
    pub fn begin_program(&mut self) {
        self.program.begin(&self.wanted.pose);
        self.offsets = [0; MAX_AXES];
        self.note_leaders();
        self.jog.begin(&self.wanted.pose, true);
    }

    /// Begins jogging at the wanted pose; `limited` says whether soft limits count.
    pub fn begin_jog(&mut self, limited: bool) {
        self.jog.begin(&self.wanted.pose, limited);
    }

    /// Chooses the source of one coordinate; only while the machine is at rest.
    pub fn set_source(&mut self, axis: usize, source: Source) {
        if let Some(slot) = self.sources.get_mut(axis) {
            *slot = source;
            self.note_leaders();
            self.jog.begin(&self.wanted.pose, true);
        }
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
                Source::Jog | Source::Hold => self.wanted.pose.0[axis],
            };
        }
        destination
    }

    /// Whether any coordinate takes its value from a jog.
    #[must_use]
    pub fn has_jog_source(&self) -> bool {
        self.sources[..self.axes].contains(&Source::Jog)
    }

    /// One period of what is nearly always: nothing moves, or a program alone. `None` where it is something else, for [`Motion::advance`].
    #[inline]
    pub fn follow(&mut self, mode: Mode) -> Option<Progress> {
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
        if let Some(progress) = self.follow(mode) {
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
                let (jog, limited) = self.jog.advance(machine);
                for axis in 0..self.axes {
                    self.merge(axis, &program, &jog);
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
            || self.offsets.iter().any(|offset| *offset != 0);
    }

    /// Looks whether the machine can still come to rest within its bounds if all goes on for one period. Says whether the program must brake now,
    /// and the coordinate whose jog must.
    fn foresee(&self, machine: &impl Kinematics) -> (bool, Option<u8>) {
        let program = self.program.sweep();
        let fits = |goes_on| {
            let Some(jog) = self.jog.stopping(goes_on) else {
                return false;
            };
            let mut sweep = Sweep::at(&self.wanted.pose);
            let mut allowed = true;
            for axis in 0..self.axes {
                match self.sources[axis] {
                    Source::Program => {
                        sweep.take(axis, &program, self.offsets[axis]);
                        allowed &= self.offsets[axis] == 0 || self.jog.allows(axis, &sweep);
                    }
                    Source::Jog => sweep.take(axis, &jog, 0),
                    Source::Hold => {}
                }
            }
            allowed && sweep.is_reachable(self.axes, machine)
        };
        if fits(true) {
            return (false, None);
        }
        let jogged = self.sources[..self.axes]
            .iter()
            .position(|source| *source == Source::Jog)
            .filter(|_| !self.jog.is_still())
            .map(|axis| axis as u8);
        (jogged.is_none() || !fits(false), jogged)
    }

    fn merge(&mut self, axis: usize, program: &Wanted, jog: &Wanted) {
        let offset = self.offsets[axis];
        let (position, rate, acceleration) = match self.sources[axis] {
            Source::Program => (
                program.pose.0[axis].0.wrapping_add(offset),
                program.rates[axis],
                program.accelerations[axis],
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
