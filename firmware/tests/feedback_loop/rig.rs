//! Model of the hand, the contact and the line around the controllers.
//!
//! With a line there are two controllers, one with the arm and one with the mill. Each endpoint
//! sends one message every 10 ms, and the line delays it. Without a line, one controller has both.
//!
//! The hand is a mass of 0.8 kg. A spring and a damper connect it to an intended path: 4 mm into
//! the contact at 10 mm/s, then at rest. Hand, arm and mill have no friction, which is the worst
//! case.

use crate::haptics::bench::{Bench, HOME};
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_firmware::force::sensor::{Channel, ForceSensor};
use haptimill_firmware::force::{EnableCondition, ForceConfig, LoopSettings};
use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, MasterPose};
use haptimill_protocol::message::{Command, State};
use std::collections::VecDeque;

/// Control period, s.
pub const T: f64 = 2e-4;
/// Units of the firmware in a newton.
const NEWTON: f64 = 65_536.0;
/// Mass of the hand and of the handle, kg.
const MASS: f64 = 0.8;
/// Damping ratio of the hand.
const RATIO: f64 = 0.35;
/// Time constant of the amplifiers of the arm's motors, s.
const AMPLIFIER: f64 = 5e-4;
/// Both poles of the drives, 1/s: a lag of 8 ms.
const DRIVE: f64 = 250.0;
/// Force of a code of the sensor, N. The range is +-200 N: the contact of 200 N/mm exceeds 100 N,
/// and a sensor of 100 N would stop the mill there.
const CODE: f64 = 200.0 / 8192.0;
/// Periods between two messages on the line.
const MESSAGE_PERIODS: usize = 50;

#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Stiffness of the hand, N/mm.
    pub grip: f64,
    /// Stiffness of the contact at the tool, N/mm.
    pub contact: f64,
    /// Delay of the line in each direction, s; 0: one board.
    pub delay: f64,
    /// Forces above 5 N displace the tool.
    pub compliant: bool,
    /// Duration of the case, s.
    pub time: f64,
}

/// Start of the second part of the measurement, s.
const SECOND_PART: f64 = 15.0;
/// Intended depth in the contact, mm.
const DEPTH: f64 = 4.0;
/// Intended speed of the hand, mm/s.
const SPEED: f64 = 10.0;

#[derive(Debug, Clone, Copy, Default)]
pub struct CaseResult {
    /// Largest oscillation of the hand, peak to peak within 1.5 s, from 3 s to 15 s and after 15 s;
    /// mm.
    pub early: f64,
    pub late: f64,
    /// Largest oscillation of the force at the hand after 15 s, N.
    pub force_oscillation: f64,
    /// Largest force on the tool, N.
    pub peak: f64,
    /// Means after 15 s: force at the hand, and force that the feedback law demands for the force
    /// on the tool; N.
    pub force: f64,
    pub law: f64,
    /// Largest force at the hand, and its largest change in a period, N.
    pub max: f64,
    pub step: f64,
    /// The mill is still running.
    pub runs: bool,
}

fn sensor(compliant: bool) -> ForceConfig {
    let channel = || Channel {
        per_code: (CODE * NEWTON * NEWTON) as i32,
        saturation: 7782,
    };
    let force = reference::force();
    let settings = LoopSettings {
        rate: Rate(20 << 20),
        enable_condition: EnableCondition::Any,
        ..force.axes[0].clone()
    };
    ForceConfig {
        sensor: ForceSensor {
            channels: [channel(), channel(), channel()],
            // No spindle turns here, and the force at rest is not the drift of an unloaded sensor.
            drift: Force::millinewtons(20_000),
            limit: Force::millinewtons(185_000),
            ..force.sensor
        },
        axes: [settings.clone(), settings.clone(), settings],
        mask: u8::from(compliant),
        drive_lag_us: 8000,
        slowest_rpm: 5000,
        ..force
    }
}

fn feedback() -> ForceFeedback {
    let axis = ForceFeedbackAxis {
        percent: 40,
        limit: (3.2 * NEWTON) as i32,
    };
    ForceFeedback {
        axes: [axis; 3],
        damping: 0,
        damping_below: 2 << 16,
    }
}

/// The largest oscillation within any second and a half.
fn oscillation(values: &[f64]) -> f64 {
    values
        .chunks((1.5 / T) as usize)
        .map(|chunk| {
            let (low, high) = chunk.iter().fold((f64::MAX, f64::MIN), |(low, high), x| {
                (low.min(*x), high.max(*x))
            });
            high - low
        })
        .fold(0.0, f64::max)
}

pub fn run(case: &Case) -> CaseResult {
    let haptic = || {
        let mut haptic = reference::haptic();
        haptic.feedback = feedback();
        haptic
    };
    let remote = case.delay > 0.0;
    let config = Config {
        follow: Some(reference::follow()),
        haptic: (!remote).then(haptic),
        force: Some(sensor(case.compliant)),
        ..reference::h4_with_steps()
    };
    let mut mill = Bench::ready(config);
    let mut master = remote.then(|| {
        let mut master = Bench::ready(Config {
            haptic: Some(haptic()),
            ..reference::master()
        });
        master.inputs.haptic.enabling_switch = true;
        master
    });
    mill.tare();
    mill.master(0);
    mill.start_job();
    mill.inputs.haptic.enabling_switch = true;
    mill.steps(10);
    let surface = mill.at(0).0 - 10.0;

    let stiffness = case.grip * 1000.0; // N/m
    let damping = 2.0 * RATIO * (stiffness * MASS).sqrt();
    // Distance of hand and tool from the surface, mm, and their rates, mm/s.
    let (mut x, mut v) = (10.0_f64, 0.0_f64);
    let (mut tool, mut tool_rate) = (10.0_f64, 0.0_f64);
    let mut motor = 0.0_f64;
    let lag = (case.delay / T).round() as usize;
    let mut out: VecDeque<(usize, MasterPose)> = VecDeque::new();
    let mut back: VecDeque<(usize, [i16; 3])> = VecDeque::new();
    // The feedback force rises to its full share within 0.1 s.
    let begin = (0.3 / T) as usize;
    let (total, late) = ((case.time / T) as usize, (SECOND_PART / T) as usize);
    let (mut positions, mut forces) = (Vec::with_capacity(total), Vec::with_capacity(total));
    let mut outcome = CaseResult::default();
    let travel = 10.0 + DEPTH;
    for period in 0..total {
        let time = (period as f64 - begin as f64) * T;
        let is_moving = time >= 0.0 && time < travel / SPEED;
        let intended = (10.0 - SPEED * time.max(0.0)).max(-DEPTH);
        let hand_force = master.as_ref().unwrap_or(&mill).force()[0];
        for _ in 0..4 {
            motor += (hand_force - motor) * (T / 4.0 / AMPLIFIER);
            let speed = if is_moving { -SPEED / 1000.0 } else { 0.0 };
            let force =
                stiffness * (intended - x) / 1000.0 + damping * (speed - v / 1000.0) + motor;
            v += force / MASS * 1000.0 * T / 4.0;
            x += v * T / 4.0;
        }
        let machine = mill.controller.machine().expect("configured");
        let reference = f64::from(machine.reference().pose.0[0].0) / 1_048_576.0 - surface;
        tool_rate += (DRIVE * DRIVE * (reference - tool) - 2.0 * DRIVE * tool_rate) * T;
        tool += tool_rate * T;
        let force = (-case.contact * tool).max(0.0);
        let peak = machine.force.as_ref().map_or(0.0, |force| {
            f64::from(force.extremes()[0].peak().0) / NEWTON
        });
        mill.codes = Some([(force / CODE).round().min(8000.0) as i16, 0, 0]);
        let with_arm = master.as_mut().unwrap_or(&mut mill);
        with_arm.centre = [HOME[0] + x - 10.0, HOME[1], HOME[2]];
        if let Some(master) = &mut master {
            if period % MESSAGE_PERIODS == 0 {
                let pose = master.arm().telemetry(0).pose;
                out.push_back((period + lag, pose));
                back.push_back((period + lag, [(peak * 64.0).round() as i16, 0, 0]));
            }
            while let Some((_, pose)) = out.front().copied().filter(|(at, _)| *at <= period) {
                out.pop_front();
                mill.say(Command::MasterPose {
                    epoch: 1,
                    age_ms: 0,
                    pose,
                });
            }
            while let Some((_, force)) = back.front().copied().filter(|(at, _)| *at <= period) {
                back.pop_front();
                master.say(Command::RemoteForce { force });
            }
            master.step();
        }
        mill.step();
        positions.push(x);
        let before = forces.last().copied().unwrap_or_default();
        outcome.step = outcome.step.max(f64::abs(hand_force - before));
        outcome.max = outcome.max.max(hand_force.abs());
        outcome.peak = outcome.peak.max(force);
        forces.push(hand_force);
        if period >= late {
            outcome.force += hand_force / (total - late) as f64;
            outcome.law += (0.4 * peak).min(3.2) / (total - late) as f64;
        }
    }
    outcome.early = oscillation(&positions[(3.0 / T) as usize..late]);
    outcome.late = oscillation(&positions[late..]);
    outcome.force_oscillation = oscillation(&forces[late..]);
    outcome.runs = mill.state() == State::Run;
    outcome
}
