//! Haptic arm: the master that an operator moves, with three motor-driven legs (docs/control.md 2.2
//! to 2.4).
//!
//! [`HapticArm::advance`] applies the [`HapticOutputs`] of one control period in the substeps of
//! the plant. [`HapticArm::inputs`] returns what the controller sees at the start of the next
//! period. [`HapticArm::truth`] is the ground truth, which no controller can see.
//!
//! * [`geometry`]: the loops of the legs, in vector form; [`dynamics`]: masses, weight, friction;
//! * [`motor`]: amplifiers and motors; [`sensors`]: the nine encoders and their faults;
//! * [`crate::operator`]: the operator model, the rail, the reference part.
//!
//! One substep is drift-kick-drift, as in [`crate::joint::mechanics`]: half a step of motion, the
//! forces in the middle, half a step of motion. The attitude is a quaternion that is turned by the
//! exact rotation of each half step.
//!
//! Units: mm, rad, s, N, N mm; base frame of the arm, z from the base to the handle. Positions of
//! tip and grip "from home" are relative to their positions at the home pose.
//!
//! The arm has end stops, but a sufficient force can push it through them to a pose that no leg can
//! hold. The handle then stands still until it is pulled back, and [`HapticGroundTruth::jammed`]
//! counts the substeps.

mod config;
pub mod dynamics;
pub mod geometry;
mod motion;
pub mod motor;
pub mod sensors;

pub use config::{HandleConfig, HapticConfig, StopsConfig};
pub use geometry::{Geometry, HandlePose, HapticGeometry};
pub use motor::ActuatorConfig;
pub use sensors::{HapticEncoders, Readings};

use crate::check::PlantError;
use crate::joint::encoder::EncoderCondition;
use crate::operator::{Handle, Live, Operator, OperatorConfig, Rail, ReferencePart, Trajectory};
use crate::vector::{Vector, minus, plus, times};
use dynamics::{Acting, Body, Dynamics, Friction, product};
use geometry::{Leg, Matrix, OutOfReach, Twist, turned};
use haptimill_firmware::io::{HapticInputs, HapticOutputs, LEGS};
use motion::HandleMotion;
use motor::Motors;
use sensors::Sensors;

/// Acceleration of free fall, mm/s^2.
const GRAVITY: f64 = 9806.65;

/// Rates that count as standstill, mm/s and rad/s.
const RESTS: f64 = 1e-7;

/// Periods at standstill without any commanded or intended motion after which the arm is no longer
/// stepped, because its friction holds it.
const ASLEEP: u32 = 2500;

/// Ground truth at the end of a period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HapticGroundTruth {
    /// Centre of the platform, mm.
    pub centre: Vector,
    /// Frame of the platform.
    pub frame: Matrix,
    /// Velocity of the centre, mm/s, then angular velocity, rad/s.
    pub twist: Twist,
    /// Tip, mm from its home position.
    pub tip: Vector,
    /// Velocity of the tip, mm/s.
    pub tip_velocity: Vector,
    /// d (mm), theta3 and theta4 (rad) of each leg.
    pub joints: Readings,
    /// Motor efforts: N along each slide, N mm about it.
    pub motors: [[f64; 2]; LEGS],
    /// Effect of the motors at the handle: force, N, and moment about the platform's centre, N mm.
    pub feedback: Twist,
    /// Force of the operator on the handle, N; 0 without an operator.
    pub operator: Vector,
    /// Fraction of its intended speed that the operator keeps; 1 without an operator.
    pub pace: f64,
    /// The operator has completed the trajectory.
    pub done: bool,
    /// Force of the reference part on the ball, N.
    pub contact: Vector,
    /// Penetration of the ball into the reference part, mm.
    pub depth: f64,
    /// Number of substeps in which no leg could hold the handle.
    pub jammed: u64,
}

/// Objects in contact with the arm.
#[derive(Debug, Clone, Default)]
struct Surroundings {
    operator: Option<Operator>,
    rail: Option<Rail>,
    part: Option<ReferencePart>,
    /// External force at the platform's centre, N.
    push: Vector,
}

/// The haptic arm.
#[derive(Debug, Clone)]
pub struct HapticArm {
    config: HapticConfig,
    geometry: Geometry,
    dynamics: Dynamics,
    /// Platform, handle and links without an operator.
    bare: Body,
    motors: Motors,
    sensors: Sensors,
    around: Surroundings,
    motion: HandleMotion,
    legs: [Leg; LEGS],
    /// Sines of theta4 at the hinges' stops.
    hinge_sines: [f64; 2],
    step_s: f64,
    steps: usize,
    period_ns: u64,
    time_ns: u64,
    powered: bool,
    enabling_switch: bool,
    /// Number of periods without motion and without any commanded or intended motion.
    idle: u32,
    truth: HapticGroundTruth,
}

impl HapticArm {
    /// Creates the arm at standstill at its configured start, without an operator.
    ///
    /// # Errors
    /// All problems of the configuration.
    pub fn new(
        config: &HapticConfig,
        period_us: u16,
        substep_us: u16,
        seed: u64,
    ) -> Result<Self, Vec<PlantError>> {
        config.check()?;
        let refuse = |field: &str, problem: String| {
            vec![PlantError {
                field: field.into(),
                problem,
            }]
        };
        if substep_us == 0 || period_us == 0 || !period_us.is_multiple_of(substep_us) {
            let problem = "the control period is not a multiple of it; choose a divisor".to_owned();
            return Err(refuse("substep_us", problem));
        }
        let geometry = Geometry::new(&config.geometry);
        let home = geometry.home();
        let motion = HandleMotion::at(&HandlePose {
            centre: plus(home.centre, config.start_mm),
            ..home
        });
        geometry
            .legs(&home)
            .map_err(|error| refuse("haptic: geometry", format!("at home {error}")))?;
        let legs = geometry
            .legs(&motion.pose())
            .map_err(|error| refuse("haptic: start_mm", format!("there {error}")))?;
        let handle = &config.handle;
        let mut bare = Body::new(handle.mass_kg, handle.centre_mm, handle.inertia_kg_mm2);
        for leg in 0..LEGS {
            bare = bare.with(0.5 * config.link_kg, geometry.joint(leg));
        }
        let step_s = f64::from(substep_us) * 1e-6;
        let start = readings(&geometry, &legs);
        let period_ns = u64::from(period_us) * 1000;
        let degree = core::f64::consts::PI / 180.0;
        let mut arm = Self {
            dynamics: Dynamics {
                body: bare.clone(),
                joints: [
                    config.slide.inertia + 0.5 * config.link_kg,
                    config.turn.inertia,
                ],
                link: geometry.link(),
                gravity: [0.0, 0.0, -GRAVITY * (1.0 - config.balance)],
            },
            bare,
            motors: Motors::new(&config.slide, &config.turn, config.amplifier_lag_s, step_s),
            sensors: Sensors::new(&config.encoders, &start, period_ns, seed),
            around: Surroundings::default(),
            motion,
            legs,
            hinge_sines: config
                .stops
                .hinge_deg
                .map(|angle| libm::sin(angle * degree)),
            step_s,
            steps: usize::from(period_us / substep_us),
            period_ns,
            time_ns: 0,
            powered: true,
            enabling_switch: false,
            idle: 0,
            truth: HapticGroundTruth::default(),
            config: config.clone(),
            geometry,
        };
        arm.update_ground_truth();
        Ok(arm)
    }

    /// Lets an operator take the handle at its present position and hold it; `None` releases it.
    /// The mass of the hand joins the handle without adding speed.
    ///
    /// # Errors
    /// All problems of the configuration.
    pub fn take(&mut self, operator: Option<&OperatorConfig>) -> Result<(), Vec<PlantError>> {
        self.idle = 0;
        self.dynamics.body = self.bare.clone();
        self.around.operator = None;
        if let Some(config) = operator {
            config.check()?;
            self.dynamics.body = self.bare.clone().with(config.mass_kg, config.grip_mm);
            let operator = Operator::new(config, &self.handle(), self.period_s());
            self.around.operator = Some(operator);
        }
        Ok(())
    }

    /// Mounts a rail under the handle, or removes it.
    ///
    /// # Errors
    /// All problems of the rail.
    pub fn fit_rail(&mut self, rail: Option<Rail>) -> Result<(), Vec<PlantError>> {
        rail.as_ref().map_or(Ok(()), Rail::check)?;
        self.idle = 0;
        self.around.rail = rail;
        Ok(())
    }

    /// Clamps a reference part at the tip, or removes it.
    ///
    /// # Errors
    /// All problems of the part.
    pub fn clamp_part(&mut self, part: Option<ReferencePart>) -> Result<(), Vec<PlantError>> {
        part.as_ref().map_or(Ok(()), ReferencePart::check)?;
        self.idle = 0;
        self.around.part = part;
        Ok(())
    }

    /// Sets the operator trajectory; no effect without an operator.
    pub fn set_trajectory(&mut self, trajectory: Trajectory) {
        self.idle = 0;
        if let Some(operator) = &mut self.around.operator {
            operator.set_trajectory(trajectory);
        }
    }

    /// Sets the externally controlled tip position and the enabling switch. The operator trajectory
    /// becomes a live one.
    pub fn live(&mut self, live: Live) {
        self.idle = 0;
        self.enabling_switch = live.enabling_switch;
        if let Some(operator) = &mut self.around.operator {
            if matches!(operator.trajectory(), Trajectory::Live(_)) {
                operator.live(live);
            } else {
                operator.set_trajectory(Trajectory::Live(live));
            }
        }
    }

    /// Presses or releases the enabling switch on the handle.
    pub const fn set_enabling_switch(&mut self, enabling_switch: bool) {
        self.enabling_switch = enabling_switch;
    }

    /// The operator model.
    pub const fn operator(&self) -> Option<&Operator> {
        self.around.operator.as_ref()
    }

    /// Configuration of the arm.
    pub const fn config(&self) -> &HapticConfig {
        &self.config
    }

    /// Geometry of the legs.
    pub const fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Present ground truth.
    pub const fn truth(&self) -> &HapticGroundTruth {
        &self.truth
    }

    /// Kinetic energy and energy of the weight that is not balanced, N mm.
    pub fn energy(&self) -> f64 {
        let frame = self.motion.frame();
        let (centre, twist) = (&self.motion.centre, &self.motion.twist);
        self.dynamics
            .energy(&self.geometry, &self.legs, centre, &frame, twist)
    }

    /// Sets the velocity (mm/s) and the angular velocity (rad/s) of the platform, as an impact.
    pub fn strike(&mut self, twist: Twist) {
        self.idle = 0;
        self.motion.twist = twist;
        self.update_ground_truth();
    }

    /// Sets an external force at the platform's centre (N); it acts until it is changed.
    pub const fn set_push(&mut self, force: Vector) {
        self.idle = 0;
        self.around.push = force;
    }

    /// Puts the handle at a pose, at standstill. The encoders follow; the operator model continues.
    ///
    /// # Errors
    /// A leg does not reach the pose; the arm does not change then.
    pub fn put(&mut self, pose: &HandlePose) -> Result<(), OutOfReach> {
        self.legs = self.geometry.legs(pose)?;
        self.idle = 0;
        self.motion = HandleMotion::at(pose);
        let now = readings(&self.geometry, &self.legs);
        self.sensors.follow(&now, self.time_ns);
        self.update_ground_truth();
        Ok(())
    }

    /// Sets the injected faults of an encoder: leg and sensor (slide, turn, hinge) from 0.
    pub fn set_encoder_condition(
        &mut self,
        leg: usize,
        sensor: usize,
        condition: EncoderCondition,
    ) {
        self.sensors.set_condition(leg, sensor, condition);
    }

    /// Adds a slip of `counts` to the counter of an encoder.
    pub fn slip_encoder(&mut self, leg: usize, sensor: usize, counts: i32) {
        self.sensors.slip(leg, sensor, counts);
    }

    /// Trips or resets the amplifiers. Tripped, they give no current and report it.
    pub const fn set_tripped(&mut self, tripped: bool) {
        self.motors.set_tripped(tripped);
    }

    /// Inputs of the controller.
    pub fn inputs(&self) -> HapticInputs {
        HapticInputs {
            legs: core::array::from_fn(|leg| self.sensors.leg(leg)),
            enabling_switch: self.enabling_switch,
            drives_ready: self.motors.ready() && self.powered,
        }
    }

    /// Advances by one control period under these outputs; without power the motors give nothing.
    pub fn advance(&mut self, outputs: &HapticOutputs, powered: bool) {
        self.powered = powered;
        self.motors.command(outputs, powered);
        if !self.motors.still() {
            self.idle = 0;
        }
        if self.idle >= ASLEEP {
            // The encoders are followed even at standstill, because they may have faults.
            let joints = self.truth.joints;
            self.sensors.follow(&joints, self.time_ns);
            self.time_ns += self.period_ns;
            return;
        }
        let handle = self.handle();
        let period_s = self.period_s();
        if let Some(operator) = &mut self.around.operator {
            operator.update(&handle, period_s);
        }
        for step in 0..self.steps {
            self.step(step as f64 * self.step_s);
        }
        let now = readings(&self.geometry, &self.legs);
        self.sensors.follow(&now, self.time_ns);
        self.time_ns += self.period_ns;
        self.update_ground_truth();
        let holds = |operator: &Operator| matches!(operator.trajectory(), Trajectory::Hold);
        let is_holding = self.around.operator.as_ref().is_none_or(holds);
        let rests = is_holding && self.motion.twist.iter().all(|rate| rate.abs() < RESTS);
        self.idle = if rests {
            self.idle.saturating_add(1)
        } else {
            0
        };
        if self.idle == ASLEEP {
            self.motion.twist = [0.0; 6];
            self.update_ground_truth();
        }
    }

    fn period_s(&self) -> f64 {
        self.period_ns as f64 * 1e-9
    }

    fn step(&mut self, later: f64) {
        let half = 0.5 * self.step_s;
        let before = self.motion.clone();
        self.motion.drift(half);
        let pose = self.motion.pose();
        match self.geometry.legs(&pose) {
            Ok(legs) => self.legs = legs,
            Err(_) => return self.jam(before),
        }
        let acting = self.acting(&pose.frame, later + half);
        self.motion.twist = self.dynamics.kick(
            &self.legs,
            &pose.frame,
            &self.motion.twist,
            &acting,
            self.step_s,
        );
        self.motion.drift(half);
    }

    /// Keeps the handle at its last pose, because no leg holds it at the new one.
    fn jam(&mut self, before: HandleMotion) {
        self.motion = before;
        self.motion.twist = [0.0; 6];
        self.truth.jammed += 1;
    }

    fn acting(&mut self, frame: &Matrix, later: f64) -> Acting {
        let mut acting = Acting {
            joints: self.motors.step(),
            ..Acting::default()
        };
        self.joints(&mut acting);
        acting.push(self.around.push, [0.0; 3]);
        let motion = &self.motion;
        let home = self.geometry.home().centre;
        let centre = minus(motion.centre, home);
        if let Some(rail) = &self.around.rail {
            acting.push(rail.force(centre, motion.velocity()), [0.0; 3]);
            let (turned, spin) = (motion.turned(), motion.spin());
            acting.turn(core::array::from_fn(|i| {
                -rail.turn_stiffness * turned[i] - rail.turn_damping * spin[i]
            }));
            acting.rub(rail.unit_direction(), [0.0; 3], rail.coulomb);
        }
        if let Some(part) = &self.around.part {
            let tip = self.geometry.tip();
            let lever = turned(frame, tip);
            let place = minus(plus(centre, lever), tip);
            if let Some(touch) = part.touch(place, motion.of_point(lever)) {
                acting.push(times(touch.normal, touch.push), lever);
                let bound = part.friction * touch.push;
                acting.rub(touch.tangent, lever, bound);
                acting.rub([0.0, 0.0, 1.0], lever, bound);
            }
        }
        if let Some(operator) = &mut self.around.operator {
            let grip = operator.config().grip_mm;
            let lever = turned(frame, grip);
            let place = minus(plus(centre, lever), grip);
            let (force, moment) = operator.force_on(
                (place, motion.of_point(lever)),
                (motion.turned(), motion.spin()),
                later,
            );
            acting.push(force, lever);
            acting.turn(moment);
        }
        acting
    }

    /// Adds viscous and Coulomb friction of the joints, and their stops.
    fn joints(&self, acting: &mut Acting) {
        let stops = &self.config.stops;
        let twist = &self.motion.twist;
        for (index, leg) in self.legs.iter().enumerate() {
            let rows = [leg.slide_row(), leg.turn_row()];
            for (kind, actuator) in [&self.config.slide, &self.config.turn]
                .into_iter()
                .enumerate()
            {
                acting.joints[2 * index + kind] -= actuator.viscous * product(&rows[kind], twist);
                acting.add(Friction {
                    row: rows[kind],
                    bound: actuator.coulomb,
                });
            }
            let beyond = leg.slide - leg.slide.clamp(stops.slide_mm[0], stops.slide_mm[1]);
            acting.joints[2 * index] -= stops.slide_stiffness * beyond;
            let sine = leg.sin.clamp(self.hinge_sines[0], self.hinge_sines[1]);
            if sine != leg.sin {
                let beyond = libm::asin(leg.sin) - libm::asin(sine);
                let row = leg.hinge_row(self.geometry.link());
                for (part, share) in acting.wrench.iter_mut().zip(row) {
                    *part -= stops.hinge_stiffness * beyond * share;
                }
            }
        }
    }

    fn handle(&self) -> Handle {
        Handle {
            tip: self.truth.tip,
            turned: self.motion.turned(),
        }
    }

    fn update_ground_truth(&mut self) {
        let motion = &self.motion;
        let frame = motion.frame();
        if let Ok(legs) = self.geometry.legs(&motion.pose()) {
            self.legs = legs;
        }
        let tip = self.geometry.tip();
        let lever = turned(&frame, tip);
        let from_home = minus(motion.centre, self.geometry.home().centre);
        let place = minus(plus(from_home, lever), tip);
        let velocity = motion.of_point(lever);
        let forces = self.motors.force();
        let mut feedback = [0.0; 6];
        for (force, row) in forces.iter().zip(Dynamics::rows(&self.legs)) {
            for (sum, part) in feedback.iter_mut().zip(row) {
                *sum += force * part;
            }
        }
        let touch = self
            .around
            .part
            .as_ref()
            .and_then(|part| part.touch(place, velocity));
        let operator = self.around.operator.as_ref();
        self.truth = HapticGroundTruth {
            centre: motion.centre,
            frame,
            twist: motion.twist,
            tip: place,
            tip_velocity: velocity,
            joints: readings(&self.geometry, &self.legs),
            motors: core::array::from_fn(|leg| [forces[2 * leg], forces[2 * leg + 1]]),
            feedback,
            operator: operator.map_or([0.0; 3], Operator::force),
            pace: operator.map_or(1.0, Operator::pace),
            done: operator.is_none_or(|operator| operator.desired().done),
            contact: touch.map_or([0.0; 3], |touch| times(touch.normal, touch.push)),
            depth: touch.map_or(0.0, |touch| touch.depth),
            jammed: self.truth.jammed,
        };
    }
}

fn readings(geometry: &Geometry, legs: &[Leg; LEGS]) -> Readings {
    core::array::from_fn(|index| {
        let [turn, hinge] = geometry.angles(index, &legs[index]);
        [legs[index].slide, turn, hinge]
    })
}
