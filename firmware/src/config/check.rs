//! Checks of a configuration before it is activated. A refusal names the field and its axis.

use super::{
    AxisKind, Config, Drive, EncoderSettings, Home, JointSettings, PoseAxis, ServoConfig,
    SwitchHome,
};
use crate::config::volumetric::{CORRECTION, ERROR_AXES};
use crate::config::{BACKLASH_SLOPE_SHIFT, HAPTICS};
use crate::haptics::config::HapticConfig;
use crate::motion::tracker::TrackerLimits;
use crate::motion::{interpolator, jog};
use haptimill_kinematics::descriptor::CoordinateDescriptor;
use haptimill_kinematics::{Joints, Kinematics};
use haptimill_protocol::message::{ConfigField, ConfigProblem, MAX_AXES};

/// Largest magnitude of a coordinate for which the loops are designed, in axis units: 1900 mm, or
/// 0.46 turn.
const COORDINATE_MAX: i64 = 1900 << 20;

type Check = Result<(), ConfigProblem>;

fn require(condition: bool, field: ConfigField, index: Option<usize>) -> Check {
    if condition {
        Ok(())
    } else {
        Err(ConfigProblem {
            field,
            index: index.map(|index| index as u8),
        })
    }
}

impl Config {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// The first problem: its field, and the axis if the field belongs to one.
    #[cold]
    #[inline(never)]
    pub fn check(&self) -> Result<(), ConfigProblem> {
        require(
            (50..=1000).contains(&self.period_us) && 1_000_000 % u32::from(self.period_us) == 0,
            ConfigField::Period,
            None,
        )?;
        let axes = self.model.descriptor().axes();
        let counts = self.pose.len() == axes && self.joints.len() >= axes && axes <= MAX_AXES;
        require(counts, ConfigField::CoordinateCount, None)?;
        self.check_geometry()?;
        let has_axes = self.model.descriptor().has_force_axes();
        require(self.force.is_none() || has_axes, ConfigField::Force, None)?;
        self.check_haptics()?;
        self.check_volumetric()?;
        self.io.check()?;
        for (index, axis) in self.pose.iter().enumerate() {
            self.check_pose(index, axis)?;
        }
        for (index, joint) in self.joints.iter().enumerate() {
            self.check_joint(index, joint)?;
            self.check_gantry(index, joint)?;
        }
        require(
            (5..=2000).contains(&self.stopping.time_ms),
            ConfigField::StopTime,
            None,
        )?;
        require(
            interpolator::braking_limits(&self.stopping, self.period_us).is_some(),
            ConfigField::StopTime,
            None,
        )?;
        require(
            (10..=5000).contains(&self.supervision.heartbeat_ms),
            ConfigField::Heartbeat,
            None,
        )?;
        require(
            (1..=50).contains(&self.supervision.missed_periods),
            ConfigField::Period,
            None,
        )?;
        require(
            self.supervision.illegal_transitions <= 1000,
            ConfigField::Encoder,
            None,
        )?;
        // A stop from full rate sets its own acceleration. Above four times the jog acceleration it
        // would end in a following error.
        let stop_us = i64::from(self.stopping.time_ms - self.stopping.ramp_ms) * 1000;
        for (index, axis) in self.pose.iter().enumerate() {
            let braking = (i64::from(axis.rate.0) * 1_000_000 / stop_us) >> 8;
            let gentle = braking <= 4 * i64::from(axis.acceleration.0);
            require(gentle, ConfigField::StopTime, Some(index))?;
        }
        let mut presets = Joints::default();
        for (slot, joint) in presets.0.iter_mut().zip(&self.joints) {
            *slot = joint.preset;
        }
        require(
            self.kinematics().forward(&presets).is_ok(),
            ConfigField::Homing,
            None,
        )?;
        let searched =
            |joint: &JointSettings, kind| joint.kind == kind && joint.home == Home::Index;
        let needed = |kind| self.joints.iter().any(|joint| searched(joint, kind));
        require(
            (self.homing.rate.0 > 0 || !needed(AxisKind::Linear))
                && (self.homing.rotary_rate.0 > 0 || !needed(AxisKind::Rotary))
                && (self.homing.multi_turn_rate() > 0 || !needed(AxisKind::MultiTurn)),
            ConfigField::Homing,
            None,
        )
    }

    /// Checks volumetric compensation: three linear coordinates that are joints, and joints that
    /// have room for the correction beyond the soft limits.
    fn check_volumetric(&self) -> Check {
        let Some(volumetric) = &self.volumetric else {
            return Ok(());
        };
        let field = ConfigField::Volumetric;
        let direct = self.model.descriptor().has_machine_axes();
        let counts = self.pose.len() >= ERROR_AXES && self.joints.len() >= ERROR_AXES;
        require(direct && counts, field, None)?;
        let axes = self.pose.iter().zip(&self.joints).take(ERROR_AXES);
        for (index, (pose, joint)) in axes.enumerate() {
            let room = i64::from(CORRECTION);
            let below = i64::from(pose.low.0) - i64::from(joint.low.0) >= room;
            let above = i64::from(joint.high.0) - i64::from(pose.high.0) >= room;
            require(below && above, field, Some(index))?;
        }
        let travel: [_; ERROR_AXES] =
            core::array::from_fn(|index| (self.pose[index].low, self.pose[index].high));
        match volumetric.unsound_axis(&travel) {
            None => Ok(()),
            axis => require(false, field, axis),
        }
    }

    /// Checks the haptic arm and the master-to-tool mapping. A machine without axes must have a
    /// haptic arm.
    fn check_haptics(&self) -> Check {
        require(HAPTICS || self.haptic.is_none(), ConfigField::Haptic, None)?;
        require(HAPTICS || self.follow.is_none(), ConfigField::Follow, None)?;
        let sound = !HAPTICS || self.haptic.as_ref().is_none_or(HapticConfig::is_sound);
        let something = self.haptic.is_some() || !self.pose.is_empty();
        require(sound && something, ConfigField::Haptic, None)?;
        let Some(follow) = self.follow.as_ref().filter(|_| HAPTICS) else {
            return Ok(());
        };
        require(
            follow.is_sound() && self.model.descriptor().has_guided_tool(),
            ConfigField::Follow,
            None,
        )?;
        for (index, axis) in self.pose.iter().enumerate() {
            let bounds = TrackerLimits::new(axis, follow.gain, self.period_us);
            require(bounds.is_some(), ConfigField::Follow, Some(index))?;
        }
        Ok(())
    }

    fn check_geometry(&self) -> Check {
        require(self.model.is_sound(), ConfigField::Geometry, None)?;
        let machine = self.model.descriptor();
        let pose = self.pose.iter().map(|coordinate| coordinate.kind);
        let joints = self.joints.iter().map(|joint| joint.kind);
        let joints = joints.take(machine.axes());
        let kinds = pose.eq(machine.pose.iter().map(|coordinate| coordinate.kind))
            && joints.eq(machine.joints.iter().map(|joint| joint.kind));
        require(kinds, ConfigField::CoordinateCount, None)
    }

    /// Whether a coordinate that wraps around, if it `wraps`, is a joint of the same name that does
    /// so too. Roles of tool and workpiece have bounds, which force control and masters need.
    fn is_turntable(&self, wraps: bool, coordinate: usize) -> bool {
        let machine = self.model.descriptor();
        let Some(described) = machine.pose.get(coordinate) else {
            return false;
        };
        let mut joints = machine.joints.iter().zip(&self.joints);
        let joint = joints.find(|(joint, _)| joint.name == described.name);
        wraps
            && described.role.may_wrap()
            && self.pose.get(coordinate).is_some_and(PoseAxis::wraps)
            && joint.is_some_and(|(_, joint)| joint.wraps())
    }

    fn check_pose(&self, index: usize, settings: &PoseAxis) -> Check {
        let here = Some(index);
        let limited =
            settings.low < settings.high && within(settings.low.0) && within(settings.high.0);
        require(
            limited || self.is_turntable(settings.wraps(), index),
            ConfigField::SoftLimit,
            here,
        )?;
        require(settings.rate.0 > 0, ConfigField::Rate, here)?;
        require(settings.acceleration.0 > 0, ConfigField::Acceleration, here)?;
        require(
            jog::rate_limits(settings.acceleration, settings.jerk, self.period_us).is_some(),
            ConfigField::Jerk,
            here,
        )
    }

    fn check_joint(&self, index: usize, settings: &JointSettings) -> Check {
        let here = Some(index);
        let limited =
            settings.low < settings.high && within(settings.low.0) && within(settings.high.0);
        let turns = || {
            let machine = self.model.descriptor();
            let joint = machine.joints.get(index)?;
            if joint.may_wrap {
                return Some(settings.wraps());
            }
            let named = |described: &CoordinateDescriptor| described.name == joint.name;
            let coordinate = machine.pose.iter().position(named)?;
            Some(self.is_turntable(settings.wraps(), coordinate))
        };
        require(
            limited || turns().unwrap_or(false),
            ConfigField::Stroke,
            here,
        )?;
        require(settings.rate.0 > 0, ConfigField::Rate, here)?;
        require(
            settings.backlash.0 >= 0
                && settings.backlash.0 <= settings.high.0.saturating_sub(settings.low.0),
            ConfigField::Backlash,
            here,
        )?;
        require(has_sound_table(settings), ConfigField::Backlash, here)?;
        let preset = (settings.low..=settings.high).contains(&settings.preset);
        require(preset, ConfigField::Homing, here)?;
        match &settings.encoder {
            Some(encoder) => {
                require(!settings.keeps_position, ConfigField::Encoder, here)?;
                Self::check_encoder(here, settings, encoder)?;
            }
            None => {
                let steps = matches!(settings.drive, Drive::Steps { .. });
                require(steps, ConfigField::Encoder, here)?;
                let without = matches!(settings.home, Home::Preset | Home::Switch(_));
                require(without, ConfigField::Homing, here)?;
            }
        }
        require(settings.active_low < 8, ConfigField::Homing, here)?;
        if let Some(switch) = settings.home.switch() {
            // The search moves one joint at a time.
            let alone = self.model.joints_move_alone();
            require(
                alone && is_sound(settings, switch),
                ConfigField::Homing,
                here,
            )?;
        }
        self.check_drive(here, settings)
    }

    /// Checks that the joints of the model come first, and that the two motors of a gantry home
    /// together and reach the same places.
    fn check_gantry(&self, index: usize, settings: &JointSettings) -> Check {
        let axes = self.model.descriptor().axes();
        let Some(gantry) = &settings.gantry else {
            return require(index < axes, ConfigField::CoordinateCount, Some(index));
        };
        let first = usize::from(gantry.of);
        let seconds = self.joints.iter().filter_map(|joint| joint.gantry.as_ref());
        let alone = seconds.filter(|other| other.of == gantry.of).count() == 1;
        let fits = self.joints.get(first).is_some_and(|main| {
            let searches = match (main.home.switch(), settings.home.switch()) {
                (Some(main), Some(second)) => {
                    let main = SwitchHome {
                        input: second.input,
                        coordinate: second.coordinate,
                        release: second.release,
                        travel: second.travel,
                        ..main.clone()
                    };
                    main == *second
                }
                _ => false,
            };
            searches
                && main.kind == settings.kind
                && main.preset == settings.preset
                && settings.low <= main.low
                && settings.high >= main.high
                && settings.rate >= main.rate
        });
        let sound = index >= axes && first < axes && alone && fits && !settings.wraps();
        let racking = gantry.racking.0 > 0 && within(gantry.racking.0);
        require(sound && racking, ConfigField::Gantry, Some(index))
    }

    fn check_encoder(
        here: Option<usize>,
        joint: &JointSettings,
        encoder: &EncoderSettings,
    ) -> Check {
        let per_count = encoder.per_count.unsigned_abs();
        require(
            (1 << 20..1 << 44).contains(&per_count),
            ConfigField::Encoder,
            here,
        )?;
        require(
            i64::from(joint.backlash.0) < i64::from(encoder.index_pitch.0),
            ConfigField::Backlash,
            here,
        )?;
        require(
            encoder.following.0 > 0
                && encoder.following <= encoder.index_pitch
                && encoder.stuck_distance.0 > 0
                && encoder.following_lag < 1 << 16,
            ConfigField::Following,
            here,
        )?;
        let pitch = i64::from(encoder.index_pitch.0);
        let found = (joint.low..=joint.high).contains(&encoder.index)
            && encoder.search.0 > 0
            && i64::from(encoder.search.0) * 2 < pitch;
        require(found, ConfigField::Homing, here)?;
        let turn = (u64::from(encoder.index_pitch.0.unsigned_abs()) << 24) / per_count;
        let slack = u64::from(encoder.index_slack) * 4 < turn;
        require(slack, ConfigField::Homing, here)
    }

    fn check_drive(&self, here: Option<usize>, joint: &JointSettings) -> Check {
        match &joint.drive {
            Drive::Torque { full_scale, limit } => {
                let sound =
                    full_scale.0 != i32::MIN && limit.0 > 0 && limit.0 <= full_scale.0.abs();
                require(sound, ConfigField::Drive, here)?;
                let law = &joint.law;
                require(
                    law.kp.0 > 0 && law.kp.0 < 1 << 28 && law.kd.0 > 0 && law.kd.0 < 1 << 22,
                    ConfigField::Gain,
                    here,
                )?;
                require(
                    law.inertia > 0 && law.coulomb.0 >= 0 && law.coulomb_rate.0 > 0,
                    ConfigField::Gain,
                    here,
                )?;
                // A sampled rate loop with K_D T above 1 cannot be damped.
                let damping = u64::from(law.kd.0) * u64::from(self.period_us) < 256 * 1_000_000;
                require(damping, ConfigField::Gain, here)?;
                require(law.rate_filter_us <= 50_000, ConfigField::Filter, here)?;
                require(stable(law, self.period_us), ConfigField::Gain, here)
            }
            Drive::Steps {
                per_step,
                ticks_per_us,
                pulse,
                setup,
                hold,
                lost,
                chip,
            } => {
                let steps = (1 << 24..1 << 44).contains(&per_step.unsigned_abs());
                let clock = (1..=1000).contains(ticks_per_us);
                let ticks = u32::from(*ticks_per_us) * u32::from(self.period_us);
                let is_consistent = *pulse > 0
                    && u32::from(*pulse) * 2 + u32::from(*setup) + u32::from(*hold) < ticks;
                // Lost steps show as a difference from the encoder.
                let lost = (lost.0 > 0) == joint.encoder.is_some() && lost.0 >= 0;
                // Without its supply the chip loses its electrical angle.
                let chip =
                    chip.is_none_or(|chip| !joint.keeps_position && self.is_sound_chip(&chip));
                require(
                    steps && clock && is_consistent && lost && chip,
                    ConfigField::Drive,
                    here,
                )
            }
        }
    }
}

/// Whether the search for a switch stays within the numbers of the joint, and stops within the
/// distance in which the switch is released.
fn is_sound(joint: &JointSettings, switch: &SwitchHome) -> bool {
    let stroke = i64::from(joint.low.0)..=i64::from(joint.high.0);
    let at = i64::from(switch.coordinate.0);
    let off = i64::from(switch.back_off.0);
    let end = if switch.downwards { at + off } else { at - off };
    let places = stroke.contains(&at) && stroke.contains(&end);
    let rates = 0 < switch.touch_rate.0
        && switch.touch_rate <= switch.rate
        && switch.rate <= joint.rate
        && switch.acceleration.0 > 0;
    let distances =
        off > 0 && switch.release.0 > 0 && switch.travel.0 > 0 && within(switch.travel.0);
    // v^2 / 2a; an acceleration has 2^8 axis units per second squared.
    let (rate, release) = (i128::from(switch.rate.0), i128::from(switch.release.0));
    let stops = rate * rate <= 512 * i128::from(switch.acceleration.0) * release;
    places && rates && distances && stops
}

/// Whether the servo loop on a mass is damped with a margin of two, with a filter tau and a lag of
/// 1.5 periods T. The filter leaves the damping K_D / (1 + K_P tau^2). It must be at least twice
/// what the lag takes, 1.5 T K_P. K_I must stay below a quarter of K_P K_D. Friction adaptation
/// needs an integrator.
fn stable(law: &ServoConfig, period_us: u16) -> bool {
    let (kp, kd, ki) = (
        u128::from(law.kp.0),
        u128::from(law.kd.0),
        u128::from(law.ki.0),
    );
    let (filter, period) = (u128::from(law.rate_filter_us), u128::from(period_us));
    // Gains have 8 fraction bits; times are in microseconds.
    let damping = kd * 256 * 1_000_000_000_000 * 1_000_000;
    let lag = 3 * kp * period * (256 * 1_000_000_000_000 + kp * filter * filter);
    let adapts = law.friction_adaptation_ms == 0 || ki > 0;
    damping >= lag && ki * 1024 < kp * kd && adapts
}

fn within(value: i32) -> bool {
    i64::from(value).abs() <= COORDINATE_MAX
}

/// Whether the backlash table of a joint is within its bounds: values, slopes, distance of nodes.
fn has_sound_table(joint: &JointSettings) -> bool {
    let table = &joint.backlash_table;
    let Some(spans) = table.len().checked_sub(1) else {
        return true;
    };
    if spans == 0 || joint.wraps() {
        return false;
    }
    let pitch = (i64::from(joint.high.0) - i64::from(joint.low.0)) / spans as i64;
    let bounded = table
        .iter()
        .all(|node| (0..=joint.backlash.0).contains(&node.0));
    let flat = table.windows(2).all(|pair| {
        let change = (i64::from(pair[1].0) - i64::from(pair[0].0)).abs();
        change << BACKLASH_SLOPE_SHIFT <= pitch
    });
    pitch >= 1 << 16 && bounded && flat
}
