//! Lost motion of a joint, by a dial gauge at the part that it moves.
//!
//! The encoder of a motor, and the count of its steps, do not see the backlash of the screw and its
//! wind-up by friction. The joint comes to the same place from below and from above. The controller
//! takes up the backlash of the machine file; what the gauge still sees is the rest.

use crate::excitation::Builder;
use crate::line::{Geometry, Line};
use haptimill_client::session::{self, NoObserver, Session};
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;

/// Times at the place, from each side.
const TIMES: usize = 5;

/// Readings of the gauge for a joint: in turn from below and from above.
pub const READINGS: usize = 2 * TIMES;

/// Travel to the place from each side, mm or degrees; the lost motion is less.
const TRAVEL: f64 = 1.5;

/// Part of the maximum rate.
const RATE: f64 = 0.1;

/// Time at the place before the gauge is read, seconds.
const REST: f64 = 1.0;

/// Number of the first job.
const FIRST_JOB: u32 = 20_000;

/// Reads a gauge, mm or degrees; the text is what the joint has done.
pub type Gauge<'a, L> = dyn FnMut(&mut Session<L>, &str) -> Result<f64, Error> + 'a;

/// Lost motion of a joint; mm or degrees.
#[derive(Debug, Clone)]
pub struct LostMotion {
    /// Index of the joint.
    pub joint: usize,
    /// Its name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Backlash of the machine file, which the controller took up.
    pub before: f64,
    /// What the gauge saw beyond it, each time.
    pub rests: Vec<f64>,
}

impl LostMotion {
    /// The lost motion: what the machine file should have as backlash.
    #[must_use]
    pub fn value(&self) -> f64 {
        let mean = self.rests.iter().sum::<f64>() / self.rests.len().max(1) as f64;
        (self.before + mean).max(0.0)
    }

    /// Largest minus smallest of the measurements.
    #[must_use]
    pub fn spread(&self) -> f64 {
        let high = self.rests.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let low = self.rests.iter().copied().fold(f64::INFINITY, f64::min);
        (high - low).max(0.0)
    }

    /// One line for the joint.
    #[must_use]
    pub fn summary(&self) -> String {
        let unit = if self.kind.is_rotary() { "deg" } else { "mm" };
        format!(
            "{}: lost motion {:.4} {unit} (machine file {:.4} {unit}), {} times within {:.4} {unit}",
            self.name,
            self.value(),
            self.before,
            self.rests.len(),
            self.spread()
        )
    }
}

/// The line on which the lost motion of a joint is measured, with the ends of the motion: the joint
/// alone where it can move alone.
///
/// # Errors
/// The joint has a backlash table, is a second motor of a gantry, or cannot move.
pub fn line_of(machine: &MachineFile, joint: usize) -> Result<Line, Error> {
    let (axis, name) = (&machine.config.joints[joint], &machine.joints[joint].name);
    let refuse = |what: &str| {
        Err(Error::new(
            ErrorKind::Refused,
            format!("joint {name}: {what}"),
        ))
    };
    if !axis.backlash_table.is_empty() {
        return refuse("it has a table of its backlash, which one value does not replace");
    }
    if axis.gantry.is_some() {
        return refuse("it is the second motor of a gantry; measure the first one");
    }
    let geometry = Geometry::new(machine);
    let longest = 8.0 * TRAVEL;
    let mut line = match geometry.alone(joint, longest) {
        Some(line) => line,
        None => geometry.line_of(joint, longest)?,
    };
    let travel = TRAVEL.min(line.high).min(-line.low);
    if travel < TRAVEL / 2.0 {
        return refuse("there is no room around its home pose; move the preset");
    }
    (line.low, line.high) = (-travel, travel);
    Ok(line)
}

/// Measures the lost motion of a joint of a homed machine at its home pose. `gauge` reads the gauge
/// at the joint, mm or degrees, positive in the positive direction of the joint; its argument is
/// what the joint has done.
///
/// # Errors
/// The machine does not complete a motion, a reading fails, or the gauge shows no motion that the
/// joint can have made.
pub fn measure<L: session::Line>(
    session: &mut Session<L>,
    machine: &MachineFile,
    joint: usize,
    gauge: &mut Gauge<'_, L>,
) -> Result<LostMotion, Error> {
    let line = line_of(machine, joint)?;
    let axis = &machine.joints[joint];
    let geometry = Geometry::new(machine);
    let model = Model::new(machine);
    let period = f64::from(machine.config.period_us) * 1e-6;
    let travel = line.high;
    let mut job = FIRST_JOB;
    let mut rests = Vec::new();
    for time in 1..=TIMES {
        let mut seen = [0.0; 2];
        for (side, seen) in [-1.0, 1.0].into_iter().zip(&mut seen) {
            let mut builder = Builder::new(&geometry, &line, period, 0.0);
            builder.move_to(side * travel, RATE * line.rate)?;
            builder.rest(0.2)?;
            builder.move_to(0.0, RATE * line.rate)?;
            builder.rest(REST)?;
            let (motion, _) = builder.finish();
            let start = session.status()?.commanded;
            job += 1;
            let end = session.run_job(job, start, motion.setpoints, &mut NoObserver)?;
            session.check_completed(&end)?;
            let from = if side < 0.0 { "below" } else { "above" };
            let what = format!("joint {} from {from}, {time} of {TIMES}", axis.name);
            let shown = gauge(session, &what)?;
            // The rest of the following error is no lost motion.
            let status = session.status()?;
            let at = model.unwound_joints(&status);
            *seen = shown - at.get(joint).copied().unwrap_or_default();
        }
        let rest = seen[1] - seen[0];
        if !rest.is_finite() || rest.abs() > travel {
            let what = format!(
                "joint {}: the readings from both sides differ by {rest:.3}, more than the motion \
                 of {travel:.1}; read in mm or degrees, positive in the direction of the joint",
                axis.name
            );
            return Err(Error::new(ErrorKind::Refused, what));
        }
        rests.push(rest);
    }
    Ok(LostMotion {
        joint,
        name: axis.name.clone(),
        kind: axis.kind,
        before: f64::from(machine.config.joints[joint].backlash.0) / per_unit(axis.kind),
        rests,
    })
}
