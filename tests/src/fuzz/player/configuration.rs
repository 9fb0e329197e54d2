//! Sends configurations, as they are or with mutated fields.

use super::{Answer, PlayResult, Player};
use crate::fuzz::checks::Violation;
use crate::fuzz::command;
use crate::fuzz::rng::Rng;
use haptimill_firmware::config::{
    Config, Drive, GantryAxis, Home, JointSettings, PoseAxis, SwitchHome,
};
use haptimill_kinematics::Model;
use haptimill_protocol::message::{CONFIG_CHUNK, Command, ConfigChunk};

impl Player {
    /// Sends a configuration and activates it.
    pub(super) fn configure(
        &mut self,
        bytes: &[u8],
        crc: u32,
        at_preset: bool,
    ) -> Result<Answer, Violation> {
        for (index, chunk) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            let chunk = ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            };
            if self.ask(&Command::Configure(chunk), 4000)? != Some(Ok(())) {
                return Ok(None);
            }
        }
        let activate = Command::Activate {
            length: bytes.len() as u16,
            crc,
            at_preset,
        };
        self.ask(&activate, 4000)
    }

    /// Sends a configuration with this many mutations.
    pub(super) fn reconfigure(&mut self, seed: u64, mutations: u8, preset: bool) -> PlayResult {
        let mut rng = Rng::new(seed, 904);
        let mut config = self.bench.machine.config.clone();
        let other = self.kind.file().is_some();
        let bits = mutations > 0 && rng.chance(if other { 0.5 } else { 0.3 });
        if !bits {
            for _ in 0..mutations {
                if other && rng.chance(0.4) {
                    mutate_parts(&mut config, &mut rng);
                } else {
                    mutate(&mut config, &mut rng);
                }
            }
        }
        let file = haptimill_machine_file::MachineFile {
            config,
            ..self.bench.machine.clone()
        };
        let Ok((mut bytes, mut crc)) = file.encoded() else {
            return Ok(());
        };
        if bits {
            for _ in 0..mutations {
                let at = rng.index(bytes.len());
                if other && rng.chance(0.3) {
                    bytes[at] = rng.bits() as u8;
                } else {
                    bytes[at] ^= 1 << rng.below(8);
                }
            }
            if rng.chance(0.1) {
                bytes.truncate(rng.index(bytes.len()));
            }
            crc = haptimill_protocol::frame::crc32(&bytes);
        }
        if mutations > 0 || preset {
            // The configuration is not that of the plant from here on.
            self.checks.foreign_configuration = true;
        }
        self.checks.job.invalidate();
        self.configure(&bytes, crc, preset)?;
        Ok(())
    }
}

/// Sets one field of a configuration to an edge value or to any other.
fn mutate(config: &mut Config, rng: &mut Rng) {
    let word = command::word(rng);
    let half = rng.bits() as u16 >> rng.below(16);
    let wide = i64::from(command::word(rng)) << rng.below(24);
    let (pose, joint) = (rng.index(5), rng.index(5));
    if rng.chance(0.25) && !config.pose.is_empty() {
        let pose = pose % config.pose.len();
        mutate_coordinate(&mut config.pose[pose], word, rng);
        return;
    }
    if rng.chance(0.5) && !config.joints.is_empty() {
        let joint = joint % config.joints.len();
        let values = (word, half, wide);
        mutate_joint(&mut config.joints[joint], values, rng);
        return;
    }
    match rng.below(12) {
        0 => config.period_us = half,
        1 => config.stopping.time_ms = half,
        2 => config.stopping.ramp_ms = half,
        3 => config.supervision.heartbeat_ms = half,
        4 => config.supervision.missed_periods = half,
        5 => config.supervision.illegal_transitions = half,
        6 => config.homing.rate.0 = word,
        7 => config.homing.rotary_rate.0 = word,
        8 | 9 => {
            if let Model::H4(geometry) = &mut config.model {
                match rng.below(6) {
                    0 => geometry.rod.0 = word,
                    1 => geometry.half_spacing.0 = word,
                    2 => geometry.tool.0 = word,
                    3 => geometry.below = !geometry.below,
                    4 => geometry.lateral.0 = word,
                    _ => geometry.table_height.0 = word,
                }
            }
        }
        _ => {
            if let Some(force) = &mut config.force {
                let axis = &mut force.axes[rng.index(3)];
                match rng.below(8) {
                    0 => axis.setpoint.0 = word,
                    1 => axis.limit.0 = word,
                    2 => axis.rate.0 = word,
                    3 => force.mask = word as u8,
                    4 => force.drive_lag_us = half,
                    5 => force.creep.0 = word,
                    6 => force.slowest_rpm = half,
                    _ => config.force = None,
                }
            }
        }
    }
}

fn mutate_coordinate(axis: &mut PoseAxis, word: i32, rng: &mut Rng) {
    match rng.below(5) {
        0 => axis.low.0 = word,
        1 => axis.high.0 = word,
        2 => axis.rate.0 = word,
        3 => axis.acceleration.0 = word,
        _ => axis.jerk = word as u32,
    }
}

fn mutate_joint(joint: &mut JointSettings, (word, half, wide): (i32, u16, i64), rng: &mut Rng) {
    let number = rng.below(24);
    if let (3..=4 | 6..=8 | 10..=13, Some(encoder)) = (number, &mut joint.encoder) {
        match number {
            3 => encoder.per_count = wide,
            4 => encoder.per_count = -encoder.per_count,
            6 => encoder.following.0 = word,
            7 => encoder.following_lag = word as u32,
            8 => encoder.stuck_distance.0 = word,
            10 => encoder.index.0 = word,
            11 => encoder.index_pitch.0 = word,
            12 => encoder.index_slack = half,
            _ => encoder.search.0 = word,
        }
        return;
    }
    match number {
        0 => joint.low.0 = word,
        1 => joint.high.0 = word,
        2 => joint.rate.0 = word,
        5 => joint.backlash.0 = word,
        9 => joint.preset.0 = word,
        14 => joint.law.kp.0 = word as u32,
        15 => joint.law.kd.0 = word as u32,
        16 => joint.law.rate_filter_us = half,
        17 => joint.law.inertia = word as u32,
        18 => joint.law.viscous = word as u32,
        19 => joint.law.coulomb.0 = word,
        20 => joint.law.coulomb_rate.0 = word,
        21 => joint.law.ki.0 = word as u32,
        _ => match &mut joint.drive {
            Drive::Torque { full_scale, limit } => {
                if rng.chance(0.5) {
                    full_scale.0 = word;
                } else {
                    limit.0 = word;
                }
            }
            Drive::Steps {
                per_step,
                ticks_per_us,
                pulse,
                lost,
                ..
            } => match rng.below(4) {
                0 => *per_step = wide,
                1 => *ticks_per_us = half,
                2 => *pulse = half,
                _ => lost.0 = word,
            },
        },
    }
}

/// Sets one field that the H-4 machines do not have, or exchanges parts of a configuration.
fn mutate_parts(config: &mut Config, rng: &mut Rng) {
    let word = command::word(rng);
    let half = rng.bits() as u16 >> rng.below(16);
    let (first, second) = (
        rng.index(config.joints.len()),
        rng.index(config.joints.len()),
    );
    let joint = &mut config.joints[first];
    match rng.below(12) {
        0..=3 => {
            if let Home::Switch(switch) | Home::SwitchAndIndex(switch) = &mut joint.home {
                mutate_search(switch, word, rng);
            }
        }
        4 => {
            joint.gantry = Some(GantryAxis {
                of: second as u8,
                racking: haptimill_math::Coordinate(word),
            });
        }
        5 => joint.gantry = None,
        6 => joint.encoder = None,
        7 => joint.home = rng.choose(&[Home::Index, Home::Preset]),
        8 => joint.keeps_position = !joint.keeps_position,
        9 => joint.active_low = word as u8,
        10 => {
            if let Some(volumetric) = &mut config.volumetric {
                let axis = &mut volumetric.axes[rng.index(3)];
                match rng.below(3) {
                    0 => axis.nodes = word as u8,
                    1 => axis.first.0 = word,
                    _ => axis.pitch.0 = word,
                }
            }
        }
        _ => {
            if let Some(input) = config.io.inputs.first_mut() {
                input.filter = half;
                input.channel = word as u8;
            }
            if let Some(output) = config.io.outputs.first_mut() {
                output.channel = word as u8;
                output.safe = !output.safe;
            }
        }
    }
}

fn mutate_search(search: &mut SwitchHome, word: i32, rng: &mut Rng) {
    match rng.below(9) {
        0 => search.order = word as u8,
        1 => search.downwards = !search.downwards,
        2 => search.coordinate.0 = word,
        3 => search.rate.0 = word,
        4 => search.touch_rate.0 = word,
        5 => search.acceleration.0 = word,
        6 => search.back_off.0 = word,
        7 => search.release.0 = word,
        _ => search.travel.0 = word,
    }
}
