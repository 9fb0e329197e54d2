//! A line to a simulated machine that samples the ground truth, as instruments on it would.

use haptimill_client::port::PortError;
use haptimill_client::session::{Line, SimLine};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::per_unit;
use haptimill_protocol::message::MAX_AXES;

/// The machine at one moment. Unused axes are 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time since power-on, seconds.
    pub time: f64,
    /// The pose that the program commands, mm and degrees.
    pub commanded: [f64; MAX_AXES],
    /// The joints as the controller reports them, mm and degrees.
    pub reported: [f64; MAX_AXES],
    /// The true pose of the tool in work coordinates, mm and degrees.
    pub tool: [f64; MAX_AXES],
    /// The true positions of the carriages, mm and degrees.
    pub carriages: [f64; MAX_AXES],
}

/// A simulated machine whose ground truth is sampled.
pub struct ObservedLine {
    line: SimLine,
    /// Axis units per mm or degree of the coordinates and of the joints.
    units: [[f64; MAX_AXES]; 2],
    every: u64,
    periods: u64,
    samples: Vec<Sample>,
    sampling: bool,
}

impl ObservedLine {
    /// Samples the machine every `every` control periods once it is asked to.
    #[must_use]
    pub fn new(line: SimLine, machine: &MachineFile, every: u64) -> Self {
        let mut units = [[1.0; MAX_AXES]; 2];
        let [pose, joints] = &mut units;
        let config = &machine.config;
        for (unit, axis) in pose.iter_mut().zip(&config.pose) {
            *unit = per_unit(axis.kind);
        }
        for (unit, joint) in joints.iter_mut().zip(&config.joints) {
            *unit = per_unit(joint.kind);
        }
        Self {
            line,
            units,
            every,
            periods: 0,
            samples: Vec::new(),
            sampling: false,
        }
    }

    /// Begins to sample; earlier samples are dropped.
    pub fn begin(&mut self) {
        self.samples.clear();
        self.sampling = true;
    }

    /// Ends sampling and returns the samples.
    pub fn end(&mut self) -> Vec<Sample> {
        self.sampling = false;
        std::mem::take(&mut self.samples)
    }

    /// The simulated machine.
    #[must_use]
    pub const fn line(&self) -> &SimLine {
        &self.line
    }

    fn sample(&mut self) {
        self.periods += 1;
        if !self.sampling || !self.periods.is_multiple_of(self.every) {
            return;
        }
        let rig = self.line.rig();
        let Some(snapshot) = self.line.snapshot() else {
            return;
        };
        let truth = rig.plant().truth();
        self.samples.push(Sample {
            time: rig.time_ns() as f64 * 1e-9,
            commanded: scaled(&snapshot.commanded, &self.units[0]),
            reported: scaled(&snapshot.joints, &self.units[1]),
            tool: truth.pose,
            carriages: truth.joints,
        });
    }
}

fn scaled(places: &[i32; MAX_AXES], units: &[f64; MAX_AXES]) -> [f64; MAX_AXES] {
    std::array::from_fn(|axis| f64::from(places[axis]) / units[axis])
}

impl Line for ObservedLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        let time = self.line.exchange(transmit, received)?;
        self.sample();
        Ok(time)
    }

    fn name(&self) -> String {
        self.line.name()
    }

    fn snapshot(&self) -> Option<Snapshot> {
        self.line.snapshot()
    }
}
