//! The plant: drives, screws, slides, encoders, switches and the arm that the slides carry.
//!
//! [`Plant::advance`] applies the [`Outputs`] of one control period in steps of 20 us.
//! [`Plant::latch`] fills the [`Inputs`] that the controller sees at the start of the next period.
//! [`Plant::truth`] is the ground truth, which no controller can see: the exact positions of slides
//! and tool. A machine has a spindle, a cutter and a workpiece when its configuration names them or
//! when [`Plant::fit`] gives it a [`ProcessConfig`](crate::process::ProcessConfig). The force on
//! the tool loads the joints.
//!
//! Modelled: each joint as two masses on a screw with stiffness, damping and backlash; Coulomb
//! friction with sticking; drives with limits; hard stops; the encoder on the motor shaft or on the
//! slide, edge by edge; geometric errors of three slides.
//!
//! Not modelled: the inertia of the platform, which couples the slides; holding torque of a
//! disabled drive (friction alone holds the screw); the delay of the amplifier's current.
//!
//! A command of the wrong kind for a drive ([`DriveCommand::Steps`] on a torque drive) leaves the
//! drive off and is counted.

mod joint;
mod tool;

pub use joint::{JointCondition, SWITCHES};

use crate::check::PlantError;
use crate::config::PlantConfig;
use crate::contact::InputLines;
use crate::fault::Switch as Kind;
use crate::haptics::HapticArm;
use crate::joint::encoder::{Edge, Encoder, EncoderCondition, Track};
use crate::joint::gantry::Gantry;
use crate::joint::mechanics::{Bodies, JointArray, Mechanics};
use crate::joint::stepper::PulseReport;
use crate::joint::{DriveConfig, EncoderPlace};
use crate::machines::AnyGeometry;
use crate::process::Process;
use crate::random::Random;
use haptimill_firmware::io::{DriveCommand, ForceSample, Inputs, Outputs};
use haptimill_protocol::message::MAX_AXES;
use joint::{Drive, Joint, step_efforts};

/// Ground truth at the start of a period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GroundTruth {
    /// Positions of the joints' slide sides, mm or degrees; of a gantry the two ends of its beam.
    pub joints: [f64; MAX_AXES],
    /// Pose of the tool in the workpiece frame, mm and degrees;
    /// without an arm, the joint positions. The tip includes the deflection of the structure.
    pub pose: [f64; MAX_AXES],
    /// The rods close. If false, `pose` is the last valid one.
    pub pose_valid: bool,
    /// Force on the tool in the workpiece frame, N.
    pub force: [f64; 3],
}

/// The simulated machine.
#[derive(Debug, Clone)]
pub struct Plant {
    mechanics: Mechanics,
    bodies: Bodies,
    joints: Vec<Joint>,
    /// Beams with a motor at each end.
    gantries: Vec<Gantry>,
    /// `None` for a haptic arm alone.
    geometry: Option<AnyGeometry>,
    process: Option<Process>,
    haptic: Option<HapticArm>,
    /// Loads of the cutting process on the joints in this period.
    process_load: JointArray,
    load: JointArray,
    /// Positions at the encoders in the last period, one row per step, including the start.
    history: Vec<JointArray>,
    /// Joints whose encoder is a linear scale.
    scales: [bool; MAX_AXES],
    step_ns: u64,
    period_us: u16,
    seed: u64,
    /// Periods since the start.
    period: u64,
    emergency_stop: bool,
    inputs: InputLines,
    analog_inputs: [i16; 4],
    misdirected: u64,
    truth: GroundTruth,
}

impl Plant {
    /// Creates the plant at standstill, with the slides at their presets plus a seeded offset.
    ///
    /// # Errors
    /// All problems of the configuration.
    pub fn new(config: &PlantConfig, period_us: u16) -> Result<Self, Vec<PlantError>> {
        config.check(period_us)?;
        let mut random = Random::new(config.seed, 0);
        let mut bodies = Bodies::default();
        let mut joints = Vec::new();
        let gantries = Gantry::all(&config.joint);
        for (lane, joint) in config.joint.iter().enumerate() {
            let mut start = joint.preset + joint.start_spread * (2.0 * random.fraction() - 1.0);
            if let Some(gantry) = gantries.iter().find(|it| it.second() == lane) {
                start = bodies.slide[gantry.first()] + joint.racked;
            }
            bodies.slide[lane] = start;
            bodies.motor[lane] = start;
            joints.push(Joint::new(joint, lane, start, config.seed, period_us));
        }
        let geometry = config
            .geometry
            .as_ref()
            .map(|geometry| {
                AnyGeometry::new(geometry, &middles(&gantries, &bodies.slide)).map_err(|error| {
                    vec![PlantError {
                        field: "geometry".into(),
                        problem: format!("at the presets {error}"),
                    }]
                })
            })
            .transpose()?;
        let steps = usize::from(period_us / config.substep_us);
        let mut plant = Self {
            mechanics: Mechanics::new(&config.joint, f64::from(config.substep_us) * 1e-6),
            history: vec![bodies.motor; steps + 1],
            scales: core::array::from_fn(|lane| {
                let encoder = config
                    .joint
                    .get(lane)
                    .and_then(|joint| joint.encoder.as_ref());
                encoder.is_some_and(|encoder| encoder.on == EncoderPlace::Slide)
            }),
            bodies,
            joints,
            gantries,
            geometry,
            process: None,
            haptic: match &config.haptic {
                Some(haptic) => {
                    let mut arm =
                        HapticArm::new(haptic, period_us, config.substep_us, config.seed)?;
                    arm.take(config.operator.as_ref())?;
                    Some(arm)
                }
                None => None,
            },
            process_load: [0.0; MAX_AXES],
            load: [0.0; MAX_AXES],
            step_ns: u64::from(config.substep_us) * 1000,
            period_us,
            seed: config.seed,
            period: 0,
            emergency_stop: false,
            inputs: InputLines::new(
                &config.input,
                [config.probe.as_ref(), config.tool_setter.as_ref()],
            ),
            analog_inputs: config.analog_inputs,
            misdirected: 0,
            truth: GroundTruth::default(),
        };
        plant.update_ground_truth();
        if let Some(process) = config.process() {
            plant.fit(&process)?;
        }
        plant.follow_contacts();
        Ok(plant)
    }

    /// Number of joints.
    pub const fn axes(&self) -> usize {
        self.joints.len()
    }

    /// Control period, us.
    pub const fn period_us(&self) -> u16 {
        self.period_us
    }

    /// Periods since the start.
    pub const fn period(&self) -> u64 {
        self.period
    }

    /// Virtual time since the start, ns.
    pub const fn time_ns(&self) -> u64 {
        self.period * self.period_us as u64 * 1000
    }

    /// Present ground truth.
    pub const fn truth(&self) -> &GroundTruth {
        &self.truth
    }

    /// Present state of both sides of every joint.
    pub const fn bodies(&self) -> &Bodies {
        &self.bodies
    }

    /// Constants of masses, springs and friction.
    pub const fn mechanics(&self) -> &Mechanics {
        &self.mechanics
    }

    /// Report on the pulses of a step/direction drive; `None` for a torque drive.
    pub fn pulse_report(&self, joint: usize) -> Option<PulseReport> {
        match &self.joints.get(joint)?.drive {
            Drive::Torque { .. } => None,
            Drive::Steps(stepper) => Some(stepper.report()),
        }
    }

    /// Number of commands of the wrong kind for their drive.
    pub const fn misdirected(&self) -> u64 {
        self.misdirected
    }

    /// Sets an external effort on a slide or on the table; it acts until it is changed.
    pub fn set_load(&mut self, joint: usize, effort: f64) {
        self.load[joint] = effort;
    }

    /// Injected faults of a joint.
    pub fn condition(&self, joint: usize) -> JointCondition {
        self.joints[joint].condition
    }

    /// Sets the injected faults of a joint.
    pub fn set_condition(&mut self, joint: usize, condition: JointCondition) {
        self.mechanics.jam(joint, condition.jam);
        self.joints[joint].condition = condition;
    }

    /// Sets the injected faults of an encoder; a joint without one has none.
    pub fn set_encoder_condition(&mut self, joint: usize, condition: EncoderCondition) {
        if let Some(encoder) = &mut self.joints[joint].encoder {
            encoder.set_condition(condition);
        }
    }

    /// Records the edges of the encoder of a joint from now on. Returns the present levels of its
    /// channels A and B; `None` for a joint without one.
    pub fn record_encoder_edges(&mut self, axis: usize) -> Option<(bool, bool)> {
        Some(self.joints.get_mut(axis)?.encoder.as_mut()?.record_edges())
    }

    /// Takes the recorded edges of an encoder since the last call, oldest first.
    pub fn take_encoder_edges(&mut self, axis: usize) -> Vec<Edge> {
        let encoder = self.joints.get_mut(axis).and_then(|it| it.encoder.as_mut());
        encoder.map(Encoder::take_edges).unwrap_or_default()
    }

    /// Adds a slip of `counts` to the counter of an encoder.
    pub fn slip_encoder(&mut self, joint: usize, counts: i32) {
        if let Some(encoder) = &mut self.joints[joint].encoder {
            encoder.slip(counts);
        }
    }

    /// Opens or closes the emergency stop circuit. Open, it removes the power of all drives.
    pub const fn set_emergency_stop(&mut self, open: bool) {
        self.emergency_stop = open;
    }

    /// Fills the machine's part of the inputs: period, time, joints, emergency stop. The rig fills
    /// received bytes and missed periods.
    pub fn latch(&self, inputs: &mut Inputs) {
        inputs.period = self.period;
        inputs.time_ns = self.time_ns() as u32;
        inputs.emergency_stop = self.emergency_stop;
        inputs.digital = self.inputs.word(self.time_ns());
        inputs.analog = self.analog_inputs;
        if let Some(sensor) = self.process.as_ref().and_then(Process::sensor) {
            inputs.force = ForceSample {
                codes: sensor.codes(),
                conversions: self.period as u8,
                overload: sensor.overloaded(),
            };
        }
        if let Some(arm) = &self.haptic {
            inputs.haptic = arm.inputs();
        }
        for (index, joint) in self.joints.iter().enumerate() {
            let reading = joint
                .encoder
                .as_ref()
                .map(Encoder::reading)
                .unwrap_or_default();
            let seen = &mut inputs.joints[index];
            seen.counts = reading.counts;
            seen.edge_time_ns = reading.edge_time_ns;
            seen.illegal = reading.illegal;
            seen.index_counts = reading.index_counts;
            seen.index_pulses = reading.index_pulses;
            seen.steps = match &joint.drive {
                Drive::Torque { .. } => 0,
                Drive::Steps(stepper) => stepper.emitted(),
            };
            seen.home = joint.level(Kind::Home as usize);
            seen.limit_low = joint.level(Kind::LimitLow as usize);
            seen.limit_high = joint.level(Kind::LimitHigh as usize);
            seen.drive_ready = !joint.condition.drive_tripped && !self.emergency_stop;
        }
    }

    /// Adds a pulse that was seen on the step line of a board, at this time of the coming period,
    /// in the order of the times; the end of the period is a part of it. The outputs of the period
    /// enable the drive with a segment without steps. A joint without a step drive has no such
    /// line.
    pub fn add_pulse(&mut self, joint: usize, time_ns: u64, up: bool) {
        let Some(joint) = self.joints.get_mut(joint) else {
            return;
        };
        if let (Drive::Steps(stepper), DriveConfig::Steps(drive)) =
            (&mut joint.drive, &joint.config.drive)
        {
            let tick = time_ns * u64::from(drive.ticks_per_us) / 1000;
            stepper.add_pulse(tick as i64, up);
        }
    }

    /// Advances by one control period under these outputs.
    pub fn advance(&mut self, outputs: &Outputs) {
        let powered = !self.emergency_stop;
        let mut drive = [0.0; MAX_AXES];
        let mut stepping = false;
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let command = &outputs.joints[index];
            let powered = powered && !joint.condition.drive_tripped;
            drive[index] = joint.torque(command, powered);
            match (&mut joint.drive, command) {
                (_, DriveCommand::Off) | (Drive::Torque { .. }, DriveCommand::Torque(_)) => {}
                (Drive::Steps(stepper), DriveCommand::Steps(segment)) => {
                    // The board emits its pulses even when the drive is dead.
                    stepper.begin(*segment);
                    stepping = true;
                }
                _ => self.misdirected += 1,
            }
        }
        let load = core::array::from_fn(|lane| self.load[lane] + self.process_load[lane]);
        let mut bodies = self.bodies.clone();
        let steps = self.history.len() - 1;
        let scales = self.scales;
        let at_encoders = |bodies: &Bodies| -> JointArray {
            core::array::from_fn(|lane| {
                if scales[lane] {
                    bodies.slide[lane]
                } else {
                    bodies.motor[lane]
                }
            })
        };
        let start = at_encoders(&bodies);
        self.history[0] = start;
        let (mut low, mut high) = (start, start);
        for step in 0..steps {
            if stepping {
                let part = (step as f64 + 0.5) / steps as f64;
                step_efforts(
                    &mut self.joints,
                    outputs,
                    powered,
                    part,
                    &bodies,
                    &mut drive,
                );
            }
            if self.gantries.is_empty() {
                self.mechanics.step(&mut bodies, &drive, &load);
            } else {
                let mut load = load;
                for gantry in &self.gantries {
                    gantry.load(&bodies, &mut load);
                }
                self.mechanics.step(&mut bodies, &drive, &load);
            }
            let now = at_encoders(&bodies);
            self.history[step + 1] = now;
            for lane in 0..MAX_AXES {
                let at = now[lane];
                low[lane] = if at < low[lane] { at } else { low[lane] };
                high[lane] = if at > high[lane] { at } else { high[lane] };
            }
        }
        self.bodies = bodies;
        let start_ns = self.time_ns();
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let track = Track::new(&self.history, index, low[index], high[index]);
            if let Some(encoder) = &mut joint.encoder {
                encoder.follow(&track, start_ns, self.step_ns);
            }
            if let Drive::Steps(stepper) = &mut joint.drive {
                stepper.end();
            }
        }
        if let Some(arm) = &mut self.haptic {
            arm.advance(&outputs.haptic, powered);
        }
        self.period += 1;
        let now_ns = self.time_ns();
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let conditions = joint.condition.switches;
            for (switch, condition) in joint.switches.iter_mut().zip(&conditions) {
                switch.follow(self.bodies.slide[index], now_ns, condition);
            }
        }
        self.update_ground_truth();
        if self.process.is_some() {
            let rpm = if powered {
                f64::from(outputs.spindle_rpm)
            } else {
                0.0
            };
            self.apply_process(rpm);
        }
        self.follow_contacts();
    }

    /// Digital inputs, with the contacts of probe and tool setter.
    pub const fn inputs(&self) -> &InputLines {
        &self.inputs
    }

    /// Digital inputs, with mutable access for fault injection.
    pub const fn inputs_mut(&mut self) -> &mut InputLines {
        &mut self.inputs
    }

    /// The haptic arm; `None` on a machine without one.
    pub const fn haptic(&self) -> Option<&HapticArm> {
        self.haptic.as_ref()
    }

    /// The haptic arm, with mutable access for the operator model and for fault injection.
    pub const fn haptic_mut(&mut self) -> Option<&mut HapticArm> {
        self.haptic.as_mut()
    }

    fn update_ground_truth(&mut self) {
        self.truth.joints = self.bodies.slide;
        self.truth.pose_valid = match &mut self.geometry {
            Some(geometry) => {
                let joints = middles(&self.gantries, &self.bodies.slide);
                geometry.follow(&joints, &mut self.truth.pose)
            }
            None => true,
        };
    }
}

/// The joints of the geometry: a beam with two motors is where its middle is.
fn middles(gantries: &[Gantry], slides: &JointArray) -> JointArray {
    let mut joints = *slides;
    for gantry in gantries {
        gantry.put_middle(&mut joints);
    }
    joints
}
