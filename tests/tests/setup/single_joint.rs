//! One slide with its servo loop and supervision: the joint of the built-in machine on a screw with
//! known friction.
//!
//! The plant is independent of [`haptimill_hil_sim::joint::mechanics`]. Its friction has a
//! breakaway force above the Coulomb force (Stribeck). Units: mm, s, N, kg.

use super::MM;
use haptimill_firmware::config::{JointSettings, Supervision};
use haptimill_firmware::io::{DriveCommand, JointInputs};
use haptimill_firmware::joint::JointDrive;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::joint::encoder::{Encoder, EncoderCondition, Track};
use haptimill_hil_sim::random::Random;
use haptimill_machine_file::MachineFile;
use haptimill_math::{Acceleration, Coordinate, Gain, Rate};
use haptimill_protocol::message::{Fault, MAX_AXES};

/// Control period, s.
pub const PERIOD: f64 = 2e-4;
const SUBSTEPS: usize = 10;

/// Friction of the slide, over both sides of its screw.
#[derive(Debug, Clone, Copy)]
pub struct Friction {
    /// Coulomb force, N.
    pub coulomb: f64,
    /// Breakaway force, N.
    pub breakaway: f64,
    /// Rate over which the breakaway force falls to the Coulomb force, mm/s.
    pub stribeck: f64,
    /// Part of it on the slide's side.
    pub slide_share: f64,
}

impl Friction {
    fn bound(&self, rate: f64) -> f64 {
        let over = rate / self.stribeck;
        self.coulomb + (self.breakaway - self.coulomb) * (-over * over).exp()
    }
}

/// The slide, its encoder, and its joint in the controller.
pub struct Slide {
    axis: JointSettings,
    limits: Supervision,
    joint: JointDrive,
    encoder: Encoder,
    friction: Friction,
    /// Motor and slide: coordinate and rate.
    pub motor: [f64; 2],
    pub slide: [f64; 2],
    start: f64,
    reference: Coordinate,
    time_ns: u64,
    effort: f64,
}

impl Slide {
    /// Creates the slide at standstill, drive on. `gain` scales the stiffness of the loop,
    /// `integral` is its gain in 1/s^3.
    pub fn new(friction: Friction, gain: f64, integral: f64, phase: f64) -> Self {
        let machine = MachineFile::built_in().expect("sound");
        let plant: PlantConfig = machine.plant().expect("has a plant");
        let mut axis = machine.config.joints[0].clone();
        axis.law.kp = Gain((f64::from(axis.law.kp.0) * gain) as u32);
        axis.law.kd = Gain((f64::from(axis.law.kd.0) * gain.sqrt()) as u32);
        axis.law.ki = Gain((integral * 256.0) as u32);
        let start = 1135.0 + phase * 10.0 / 8000.0;
        let mut joint = JointDrive::new(&axis, 200).expect("sound");
        let inputs = JointInputs {
            drive_ready: true,
            ..JointInputs::default()
        };
        joint.measure(&inputs, 0);
        joint.set_reference(0, Coordinate((1135.0 * MM) as i32));
        joint.measure(&inputs, 0);
        let reference = joint.enable();
        joint.settle();
        Self {
            limits: machine.config.supervision.clone(),
            axis,
            joint,
            encoder: Encoder::new(
                &plant.joint[0],
                plant.joint[0].encoder.as_ref().expect("an encoder"),
                start,
                Random::new(1, 1),
            ),
            friction,
            motor: [start, 0.0],
            slide: [start, 0.0],
            start,
            reference,
            time_ns: 0,
            effort: 0.0,
        }
    }

    /// Sets the condition of the encoder.
    pub fn set_encoder_condition(&mut self, condition: EncoderCondition) {
        self.encoder.set_condition(condition);
    }

    /// Returns the travel since the start, mm.
    pub fn travel(&self) -> f64 {
        self.motor[0] - self.start
    }

    /// Runs one control period and returns the fault, if any.
    ///
    /// `commanded` is the distance from the start, its rate and acceleration; `load` is a force on
    /// the slide.
    pub fn step(&mut self, commanded: [f64; 3], load: f64) -> Option<Fault> {
        let snapshot = self.encoder.reading();
        let inputs = JointInputs {
            counts: snapshot.counts,
            edge_time_ns: snapshot.edge_time_ns,
            illegal: snapshot.illegal,
            index_counts: snapshot.index_counts,
            index_pulses: snapshot.index_pulses,
            drive_ready: true,
            ..JointInputs::default()
        };
        self.joint.measure(&inputs, self.time_ns as u32);
        // Supervision compares the measurement with the command of the period before. The first
        // period has none.
        let fault = if self.time_ns == 0 {
            None
        } else {
            self.joint
                .supervise(0, &self.axis, &self.limits, 200, false)
        };
        let mut command = DriveCommand::Off;
        let place = self
            .reference
            .0
            .wrapping_add((commanded[0] * MM).round() as i32);
        self.joint.servo(
            Coordinate(place),
            Rate((commanded[1] * MM).round() as i32),
            Acceleration((commanded[2] * MM / 256.0).round() as i32),
            &mut command,
        );
        // The effort takes effect in the next period.
        let effort = core::mem::replace(
            &mut self.effort,
            f64::from(self.joint.servo_output().effort.0) / 65536.0,
        );
        self.run(effort, load);
        fault
    }

    fn run(&mut self, effort: f64, load: f64) {
        const MASS: f64 = 20e-3; // N s^2/mm
        let step = PERIOD / SUBSTEPS as f64;
        let stiffness = (core::f64::consts::TAU * 80.0).powi(2) * MASS / 2.0;
        let damping = 2.0 * 0.05 * (stiffness * MASS / 2.0).sqrt();
        let mut rows = [[0.0; MAX_AXES]; SUBSTEPS + 1];
        rows[0][0] = self.motor[0];
        let (mut low, mut high) = (self.motor[0], self.motor[0]);
        for row in &mut rows[1..] {
            let wind = self.motor[0] - self.slide[0];
            let depth = wind - wind.clamp(-0.005, 0.005);
            let screw = if depth == 0.0 {
                0.0
            } else {
                let push = stiffness * depth + damping * (self.motor[1] - self.slide[1]);
                if depth > 0.0 {
                    push.max(0.0)
                } else {
                    push.min(0.0)
                }
            };
            let share = self.friction.slide_share;
            for (body, force, part) in [
                (&mut self.motor, effort - screw, 1.0 - share),
                (&mut self.slide, screw + load, share),
            ] {
                let max = self.friction.bound(body[1]) * part / MASS * step;
                let rate = body[1] + force / MASS * step;
                body[1] = rate - rate.clamp(-max, max);
                body[0] += body[1] * step;
            }
            row[0] = self.motor[0];
            low = low.min(self.motor[0]);
            high = high.max(self.motor[0]);
        }
        let track = Track::new(&rows, 0, low, high);
        self.encoder
            .follow(&track, self.time_ns, 200_000 / SUBSTEPS as u64);
        self.time_ns += 200_000;
    }
}
