//! The hand, the contact and the line, around the controllers.
//!
//! With a line there are two controllers, one with the arm and one with the mill; a word each way
//! every 10 ms, so late as the line makes it. Without, one has both.
//!
//! The hand is a mass of 0.8 kg on spring and damper that follow an intended path: 4 mm into the
//! contact at 10 mm/s, and there it stays. There is no friction in hand, arm and mill, which is the
//! worst case.

use crate::bench::{Bench, HOME};
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_firmware::force::sensor::{Channel, ForceSensor};
use haptimill_firmware::force::{EnableCondition, ForceConfig, LoopSettings};
use haptimill_math::Rate;
use haptimill_math::force::Force;
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, MasterPose};
use haptimill_protocol::message::{Command, State};
use std::collections::VecDeque;

/// The period, s.
pub const T: f64 = 2e-4;
const NEWTON: f64 = 65_536.0;
/// Of the hand and what it holds of the arm, kg.
const MASS: f64 = 0.8;
/// Part of the critical damping that the hand has.
const RATIO: f64 = 0.35;
/// Of the amplifiers of the arm's motors, s.
const AMPLIFIER: f64 = 5e-4;
/// Two poles of the drives, 1/s: 8 ms.
const DRIVE: f64 = 250.0;
/// Newtons of a code: a sensor of +-200 N, so that what a hit on 200 N/mm does to the loop is seen,
/// too. (One of 100 N stops the mill there; see the largest force.)
const CODE: f64 = 200.0 / 8192.0;
/// Periods between two words on the line.
const WORD: usize = 50;

#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Stiffness of the hand, N/mm.
    pub grip: f64,
    /// Of the contact at the tool, N/mm.
    pub contact: f64,
    /// Of the line one way, s; 0: one board.
    pub delay: f64,
    /// The tool yields to forces above 5 N.
    pub yields: bool,
    /// How long, s.
    pub time: f64,
}

/// From when on the second part of it counts, s.
const LATE: f64 = 15.0;
/// How far into the contact the hand means to go, mm.
const DEPTH: f64 = 4.0;
/// How fast, mm/s.
const PACE: f64 = 10.0;

#[derive(Debug, Clone, Copy, Default)]
pub struct CaseResult {
    /// Largest oscillation of the hand from peak to peak within 1.5 s, from 3 s on, and from 15 s
    /// on; mm.
    pub early: f64,
    pub late: f64,
    /// That of the force at the hand from 15 s on, N.
    pub force_oscillation: f64,
    /// Largest force on the tool, N.
    pub peak: f64,
    /// Means from 15 s on: force at the hand, and what the law makes of the force on the tool; N.
    pub force: f64,
    pub law: f64,
    /// Largest force at the hand, and its largest change in a period, N.
    pub most: f64,
    pub step: f64,
    /// The mill is still running.
    pub runs: bool,
}

fn sensor(yields: bool) -> ForceConfig {
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
            // No spindle turns here, and a force at rest is not that of an empty sensor.
            drift: Force::millinewtons(20_000),
            limit: Force::millinewtons(185_000),
            ..force.sensor
        },
        axes: [settings.clone(), settings.clone(), settings],
        mask: u8::from(yields),
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
        force: Some(sensor(case.yields)),
        ..reference::h4_with_steps()
    };
    let mut mill = Bench::ready(config);
    let mut master = remote.then(|| {
        let mut master = Bench::ready(Config {
            haptic: Some(haptic()),
            ..reference::master()
        });
        master.inputs.haptic.engaged = true;
        master
    });
    mill.tare();
    mill.master(0);
    mill.start_job();
    mill.inputs.haptic.engaged = true;
    mill.steps(10);
    let surface = mill.at(0).0 - 10.0;

    let stiffness = case.grip * 1000.0; // N/m
    let damping = 2.0 * RATIO * (stiffness * MASS).sqrt();
    // From the surface, as the tool is; mm, mm/s.
    let (mut x, mut v) = (10.0_f64, 0.0_f64);
    let (mut tool, mut tool_rate) = (10.0_f64, 0.0_f64);
    let mut motor = 0.0_f64;
    let lag = (case.delay / T).round() as usize;
    let mut out: VecDeque<(usize, MasterPose)> = VecDeque::new();
    let mut back: VecDeque<(usize, [i16; 3])> = VecDeque::new();
    // The law's share comes in within 0.1 s.
    let begin = (0.3 / T) as usize;
    let (total, late) = ((case.time / T) as usize, (LATE / T) as usize);
    let (mut places, mut forces) = (Vec::with_capacity(total), Vec::with_capacity(total));
    let mut outcome = CaseResult::default();
    let way = 10.0 + DEPTH;
    for period in 0..total {
        let time = (period as f64 - begin as f64) * T;
        let going = time >= 0.0 && time < way / PACE;
        let intended = (10.0 - PACE * time.max(0.0)).max(-DEPTH);
        let hand_force = master.as_ref().unwrap_or(&mill).force()[0];
        for _ in 0..4 {
            motor += (hand_force - motor) * (T / 4.0 / AMPLIFIER);
            let pace = if going { -PACE / 1000.0 } else { 0.0 };
            let force = stiffness * (intended - x) / 1000.0 + damping * (pace - v / 1000.0) + motor;
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
        let held = master.as_mut().unwrap_or(&mut mill);
        held.centre = [HOME[0] + x - 10.0, HOME[1], HOME[2]];
        if let Some(master) = &mut master {
            if period % WORD == 0 {
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
        places.push(x);
        let before = forces.last().copied().unwrap_or_default();
        outcome.step = outcome.step.max(f64::abs(hand_force - before));
        outcome.most = outcome.most.max(hand_force.abs());
        outcome.peak = outcome.peak.max(force);
        forces.push(hand_force);
        if period >= late {
            outcome.force += hand_force / (total - late) as f64;
            outcome.law += (0.4 * peak).min(3.2) / (total - late) as f64;
        }
    }
    outcome.early = oscillation(&places[(3.0 / T) as usize..late]);
    outcome.late = oscillation(&places[late..]);
    outcome.force_oscillation = oscillation(&forces[late..]);
    outcome.runs = mill.state() == State::Run;
    outcome
}
