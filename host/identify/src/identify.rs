//! The measurement of all torque joints of a machine, over the protocol.

use crate::excitation::{Builder, Burst, PER_CYCLE, SHORTEST, Stimulus, burst_time, ramp_time};
use crate::line::{Geometry, Line};
use crate::measure::{Friction, Sample, count_of, friction, response, samples, steady};
use crate::two_mass::{Fit, Point, TwoMass};
use haptimill_client::session::{self, NoObserver, Session};
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::{AxisKind, Drive};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale;
use std::f64::consts::TAU;

/// What the measurement may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Longest line, mm or degrees.
    pub travel: f64,
    /// Lowest and highest frequency, Hz.
    pub frequencies: [f64; 2],
    /// Part of the maximum rate that a joint reaches, 0 to 1.
    pub rate_part: f64,
    /// Bytes per second of the line; `None` without a limit.
    pub line_rate: Option<u32>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            travel: 80.0,
            frequencies: [4.0, 200.0],
            rate_part: 0.8,
            line_rate: None,
        }
    }
}

/// Parts of the maximum rate at which the friction is measured.
const RATES: [f64; 6] = [0.06, 0.12, 0.25, 0.5, 0.75, 1.0];

/// Longest time at one rate, seconds.
const STEADY: f64 = 2.0;

/// Frequencies of the first sweep, and of the second one near the resonance.
const COARSE: usize = 22;
const FINE: usize = 12;

/// Duration of a sine in the first sweep, and in the second one, seconds.
const BURST: f64 = 1.0;
const FINE_BURST: f64 = 1.6;

/// Rate under the sines, part of the largest one, and the part of it that a sine may have.
const CARRIER: f64 = 0.12;
const CARRIER_PART: f64 = 0.5;

/// Effort of the sines as a part of the Coulomb friction: below the first frequency, where the
/// driven mass follows the motor; above it; and near the resonance, which amplifies it. What the
/// driven mass needs stays below its friction, and the flanks of the screw stay in contact.
const SLOW_EXCITATION: f64 = 0.35;
const EXCITATION: f64 = 0.2;
const FINE_EXCITATION: f64 = 0.1;
const SLOW_HZ: f64 = 25.0;

/// Least time at the top rate, seconds.
const TOP_CRUISE: f64 = 0.8;

/// The maximum rate up to `rate` that fits.
fn slowed(mut rate: f64, fits: impl Fn(f64) -> bool) -> f64 {
    while !fits(rate) && rate > 1e-3 {
        rate *= 0.9;
    }
    rate
}

/// Approximate bytes of a telemetry frame and of a setpoint on the line.
pub(crate) const FRAME_BYTES: f64 = 160.0;
const SETPOINT_BYTES: f64 = 20.0;

/// Number of the first job.
const FIRST_JOB: u32 = 100;

/// A joint as it was measured.
#[derive(Debug, Clone)]
pub struct Identified {
    /// Index of the joint.
    pub joint: usize,
    /// Its name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Friction.
    pub friction: Friction,
    /// The linear plant.
    pub plant: TwoMass,
    /// The response shows a resonance; if not, its highest frequency, Hz. The plant then has the
    /// worst mode that the response does not exclude.
    pub resonance: Result<(), f64>,
    /// Measured frequency response.
    pub points: Vec<Point>,
    /// Median of the relative difference between the response and the plant.
    pub error: f64,
}

impl Identified {
    /// The plant that the response shows: without a resonance, one mass.
    #[must_use]
    pub fn shown(&self) -> TwoMass {
        match self.resonance {
            Ok(()) => self.plant,
            Err(highest) => TwoMass {
                mode_hz: 1e3 * highest,
                ..self.plant
            },
        }
    }

    /// Mean of the Coulomb friction of both directions, N or N m.
    #[must_use]
    pub fn coulomb(&self) -> f64 {
        (self.friction.coulomb[0] + self.friction.coulomb[1]) / 2.0
    }
}

/// Acceleration of one unit of effort on one unit of inertia.
#[must_use]
pub const fn acceleration_unit(kind: AxisKind) -> f64 {
    if kind.is_rotary() {
        180.0 / std::f64::consts::PI
    } else {
        1000.0
    }
}

/// Inertia of the machine file, kg or kg m^2.
#[must_use]
pub fn inertia_of(machine: &MachineFile, joint: usize) -> f64 {
    // Within the range of the units of every kind of axis.
    let hundred = scale::inertia(100.0, machine.joints[joint].kind);
    f64::from(machine.config.joints[joint].law.inertia) * 100.0 / f64::from(hundred)
}

/// Joints that are measured: those with a torque drive and an encoder.
#[must_use]
pub fn torque_joints(machine: &MachineFile) -> Vec<usize> {
    let joints = machine.config.joints.iter().enumerate();
    joints
        .filter(|(_, joint)| matches!(joint.drive, Drive::Torque { .. }) && joint.encoder.is_some())
        .map(|(index, _)| index)
        .collect()
}

/// The lines of a machine: joints that move together share one.
///
/// # Errors
/// A joint has no line, or the machine has no torque joint.
pub fn lines(machine: &MachineFile, options: &Options) -> Result<Vec<Line>, Error> {
    let geometry = Geometry::new(machine);
    let mut lines: Vec<Line> = Vec::new();
    let joints = torque_joints(machine);
    if joints.is_empty() {
        let what = format!(
            "{}: no joint has a torque drive and an encoder; nothing can be identified",
            machine.file
        );
        return Err(Error::new(ErrorKind::BadInput, what));
    }
    for joint in joints {
        let shared = lines
            .iter_mut()
            .find(|line| line.direction[joint].abs() > 0.99 && line.direction[joint].abs() < 1.01);
        match shared {
            Some(line) => line.joints.push(joint),
            None => lines.push(geometry.line_of(joint, options.travel)?),
        }
    }
    Ok(lines)
}

/// A measurement in a session. The machine must be homed and at its home pose.
pub struct Identification<'a, L> {
    session: &'a mut Session<L>,
    machine: &'a MachineFile,
    model: Model,
    options: Options,
    /// Shortest segment, seconds.
    shortest: f64,
    period: f64,
    /// Time between two telemetry frames, seconds.
    interval: f64,
    job: u32,
}

impl<'a, L: session::Line> Identification<'a, L> {
    /// Prepares the measurement.
    ///
    /// # Errors
    /// The line is too slow.
    pub fn new(
        session: &'a mut Session<L>,
        machine: &'a MachineFile,
        options: Options,
    ) -> Result<Self, Error> {
        let period = f64::from(machine.config.period_us) * 1e-6;
        let mut options = options;
        // The setpoints in the queue must last longer than a controlled stop, or the controller
        // stops without setpoints.
        let queue = session.client().controller().map_or(64, |it| it.queue);
        let stop = f64::from(machine.config.stopping.time_ms) * 1e-3;
        let shortest = (1.6 * stop / f64::from(queue)).max(SHORTEST);
        options.frequencies[1] = options.frequencies[1].min(1.0 / (3.5 * shortest));
        let mut interval = 1e-3;
        if let Some(rate) = options.line_rate {
            let rate = f64::from(rate);
            // Half of the line for telemetry, a third for setpoints.
            interval = f64::max(interval, 2.0 * FRAME_BYTES / rate);
            let highest = rate / 3.0 / SETPOINT_BYTES / PER_CYCLE;
            if highest < 10.0 * options.frequencies[0] {
                let what = format!(
                    "a line of {rate:.0} bytes/s carries sines up to {highest:.0} Hz only; use a \
                     serial port of 1000000 baud or more"
                );
                return Err(Error::new(ErrorKind::Port, what));
            }
            options.frequencies[1] = options.frequencies[1].min(highest);
        }
        let every = (interval / period).round().clamp(1.0, 1000.0) as u16;
        session.keep_telemetry(every);
        Ok(Self {
            session,
            machine,
            model: Model::new(machine),
            options,
            shortest,
            period,
            interval: f64::from(every) * period,
            job: FIRST_JOB,
        })
    }

    /// Moves to the home pose, where every line begins.
    ///
    /// # Errors
    /// The machine does not complete the motion.
    pub fn home(&mut self) -> Result<(), Error> {
        let home = session::find_home_pose(self.machine, &self.model)?;
        self.session.go_home(self.machine, &home)
    }

    fn run(&mut self, motion: Stimulus) -> Result<(Stimulus, Vec<Sample>), Error> {
        let start = self.session.status()?.commanded;
        self.session.take_telemetry();
        self.job += 1;
        let end =
            self.session
                .run_job(self.job, start, motion.setpoints.clone(), &mut NoObserver)?;
        self.session.check_completed(&end)?;
        if let Some((setpoint, late)) = end.underruns.first() {
            let what = format!(
                "setpoint {setpoint} was {late} periods late: the line is too slow for the \
                 excitation; use a faster line, or lower --highest"
            );
            return Err(Error::new(ErrorKind::Port, what));
        }
        let frames = self.session.take_telemetry();
        Ok((motion, samples(self.machine, &self.model, &frames)))
    }

    /// Measures the joints of a line.
    ///
    /// # Errors
    /// The machine does not complete a motion, or a measurement is not plausible.
    pub fn measure(
        &mut self,
        line: &Line,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Vec<Identified>, Error> {
        let geometry = Geometry::new(self.machine);
        // At the top rate a part of the line is left for the measurement.
        let cruise = |rate: f64| line.high - line.low - rate * ramp_time(line, rate);
        let top = slowed(line.rate * self.options.rate_part, |rate| {
            cruise(rate) > TOP_CRUISE * rate
        });
        let fast = self.dithered(line, top);
        let mut builder = Builder::new(&geometry, line, self.period, 0.0);
        for part in RATES {
            let rate = self.dithered(line, top * part);
            let middle = (line.low + line.high) / 2.0;
            let half = ((line.high - line.low) / 2.0).min(rate * (STEADY + 0.5) / 2.0 + 1.0);
            builder.move_to(middle - half, fast)?;
            builder.rest(0.1)?;
            builder.move_to(middle + half, rate)?;
            builder.rest(0.1)?;
            builder.move_to(middle - half, rate)?;
            builder.rest(0.1)?;
        }
        builder.move_to(0.0, fast)?;
        let (motion, _) = builder.finish();
        progress("friction: constant rates in both directions");
        let (motion, friction_samples) = self.run(motion)?;
        let frictions: Result<Vec<Friction>, Error> = line
            .joints
            .iter()
            .map(|joint| self.friction(&motion, &friction_samples, *joint, line))
            .collect();
        let frictions = frictions?;

        progress("frequency response: sines from the lowest to the highest frequency");
        let [low, high] = self.options.frequencies;
        let frequencies = (0..COARSE)
            .map(|index| low * (high / low).powf(index as f64 / (COARSE - 1) as f64))
            .collect::<Vec<_>>();
        let coarse_run = self.sweep(line, &frictions, &frequencies, BURST)?;
        let mut runs = vec![coarse_run];
        let coarse = self.plants(line, &frictions, &runs)?;
        // The second sweep covers notch and peak of all joints of the line.
        let lowest = coarse
            .iter()
            .map(|it| it.plant.antiresonance())
            .fold(high, f64::min);
        let highest = coarse.iter().map(|it| it.plant.mode_hz).fold(low, f64::max);
        let (from, to) = ((0.8 * lowest).max(low), (1.2 * highest).min(high));
        let near = (0..FINE)
            .map(|index| from * (to / from).powf(index as f64 / (FINE - 1) as f64))
            .collect::<Vec<_>>();
        progress(&format!(
            "frequency response: sines from {from:.0} to {to:.0} Hz"
        ));
        let fine_run = self.sweep(line, &frictions, &near, FINE_BURST)?;
        // Near the resonance only the smaller sines count.
        for (motion, _) in &mut runs {
            motion
                .windows
                .retain(|it| it.frequency < from || it.frequency > to);
        }
        runs.push(fine_run);
        self.plants(line, &frictions, &runs)
    }

    /// The rate next to `rate` at which the place within an encoder count is another one at each
    /// telemetry frame. At a whole number of counts between two frames all frames would show the
    /// same phase of the effort that each count causes, and their mean would be wrong.
    fn dithered(&self, line: &Line, rate: f64) -> f64 {
        let count = line
            .joints
            .first()
            .map_or(0.0, |it| count_of(self.machine, *it));
        if count <= 0.0 {
            return rate;
        }
        let counts = rate * self.interval / count;
        (counts.floor() + 0.381_966) * count / self.interval
    }

    fn friction(
        &self,
        motion: &Stimulus,
        samples: &[Sample],
        joint: usize,
        line: &Line,
    ) -> Result<Friction, Error> {
        let unit = acceleration_unit(self.machine.joints[joint].kind);
        let inertia = inertia_of(self.machine, joint) / unit;
        let points = motion.windows.iter().filter(|window| {
            // The ways back to a start are at the top rate and as good as the others.
            window.to - window.from > 0.1 && line.direction[joint] != 0.0
        });
        let points = points
            .filter_map(|window| steady(samples, window, joint, inertia))
            .collect::<Vec<_>>();
        let found = friction(points).filter(|found| found.points.len() >= 6);
        let name = &self.machine.joints[joint].name;
        let found = found.ok_or_else(|| {
            let what = format!(
                "joint {name}: too few telemetry frames at constant rates; lengthen --travel"
            );
            Error::new(ErrorKind::Internal, what)
        })?;
        if found.coulomb[0] + found.coulomb[1] <= 0.0 {
            let what = format!(
                "joint {name}: the effort does not oppose the motion ({:.2} forward, {:.2} \
                 backward); check `direction` and `full_scale` of its drive",
                found.coulomb[0], found.coulomb[1]
            );
            return Err(Error::new(ErrorKind::Refused, what));
        }
        Ok(found)
    }

    /// Runs sines and returns what was measured.
    fn sweep(
        &mut self,
        line: &Line,
        frictions: &[Friction],
        frequencies: &[f64],
        seconds: f64,
    ) -> Result<(Stimulus, Vec<Sample>), Error> {
        let geometry = Geometry::new(self.machine);
        // A line has room for one sine at least.
        let carrier = slowed(line.rate * CARRIER, |rate| {
            0.95 * line.room() > rate * burst_time(line, rate, seconds)
        });
        let carrier = self.dithered(line, carrier);
        let bursts: Vec<Burst> = frequencies
            .iter()
            .map(|frequency| {
                let part = if seconds > BURST {
                    FINE_EXCITATION
                } else if *frequency < SLOW_HZ {
                    SLOW_EXCITATION
                } else {
                    EXCITATION
                };
                let accelerations = line.joints.iter().zip(frictions).map(|(joint, friction)| {
                    let effort = part * (friction.coulomb[0] + friction.coulomb[1]) / 2.0;
                    let unit = acceleration_unit(self.machine.joints[*joint].kind);
                    effort / inertia_of(self.machine, *joint) * unit
                });
                let acceleration = accelerations
                    .fold(line.acceleration / 2.0, f64::min)
                    .min(CARRIER_PART * carrier * TAU * frequency);
                Burst {
                    frequency: *frequency,
                    acceleration,
                }
            })
            .collect();
        let mut builder = Builder::new(&geometry, line, self.period, 0.0);
        let fast = line.rate * self.options.rate_part / 2.0;
        builder.move_to(line.low + 1.0, fast)?;
        builder.rest(0.1)?;
        builder.sweep(&bursts, carrier, seconds, self.shortest)?;
        builder.move_to(0.0, fast)?;
        let (motion, _) = builder.finish();
        self.run(motion)
    }

    fn plants(
        &self,
        line: &Line,
        frictions: &[Friction],
        runs: &[(Stimulus, Vec<Sample>)],
    ) -> Result<Vec<Identified>, Error> {
        let joints = line.joints.iter().zip(frictions);
        joints
            .map(|(&joint, friction)| {
                let axis = &self.machine.joints[joint];
                let count = count_of(self.machine, joint);
                let mut points: Vec<Point> = runs
                    .iter()
                    .flat_map(|(motion, samples)| {
                        let sines = motion.windows.iter().filter(|it| it.frequency > 0.0);
                        sines.filter_map(|window| {
                            response(samples, window, joint, self.period, count)
                        })
                    })
                    // A response below its noise says nothing.
                    .filter(|point| point.deviation < 0.5 * point.response.abs())
                    .collect();
                points.sort_by(|a, b| a.frequency.total_cmp(&b.frequency));
                let unit = acceleration_unit(axis.kind);
                let inertia = inertia_of(self.machine, joint);
                let fitted = TwoMass::fit(&points, inertia, friction.viscous, unit);
                let fitted = fitted.filter(|_| points.len() >= 8).ok_or_else(|| {
                    let what = format!(
                        "joint {}: only {} of the sines are above the noise of the encoder; \
                         lower --highest",
                        axis.name,
                        points.len()
                    );
                    Error::new(ErrorKind::Refused, what)
                })?;
                let Fit {
                    plant,
                    error,
                    resonance,
                } = fitted;
                Ok(Identified {
                    joint,
                    name: axis.name.clone(),
                    kind: axis.kind,
                    friction: friction.clone(),
                    plant,
                    resonance,
                    points,
                    error,
                })
            })
            .collect()
    }
}
