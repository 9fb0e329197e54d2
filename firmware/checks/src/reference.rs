//! The reference H-4 machine as a configuration.

use haptimill_firmware::config::{
    AxisKind, Config, Drive, EncoderSettings, Home, Homing, JointSettings, PoseAxis, ServoConfig,
    ServoForm, Stopping, Supervision,
};
use haptimill_firmware::force::sensor::{Channel, ForceSensor};
use haptimill_firmware::force::{EnableCondition, ForceConfig, LoopSettings};
use haptimill_firmware::haptics::config::{Amplifier, Encoder, FollowConfig, HapticConfig};
use haptimill_firmware::haptics::fixture::FixtureConfig;
use haptimill_firmware::haptics::passivity::PassivityConfig;
use haptimill_kinematics::Model;
use haptimill_kinematics::h4::H4Geometry;
use haptimill_kinematics::haptic_arm::HapticGeometry;
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_math::{Acceleration, Angle, Coordinate, Effort, Gain, Length, Rate};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis};

/// Converts millimetres to axis units.
#[must_use]
pub fn mm(x: f64) -> i32 {
    libm::round(x * f64::from(1 << 20)) as i32
}

/// Converts degrees to axis units.
#[must_use]
pub fn degrees(x: f64) -> i32 {
    libm::round(x / 360.0 * 4_294_967_296.0) as i32
}

fn pose_axis(
    kind: AxisKind,
    unit: fn(f64) -> i32,
    low: f64,
    high: f64,
    rate: f64,
    acceleration: f64,
    jerk: f64,
) -> PoseAxis {
    PoseAxis {
        kind,
        low: Coordinate(unit(low)),
        high: Coordinate(unit(high)),
        rate: Rate(unit(rate)),
        acceleration: Acceleration(unit(acceleration / 256.0)),
        jerk: unit(jerk / 65536.0).unsigned_abs(),
    }
}

fn slide(preset: f64) -> JointSettings {
    JointSettings {
        kind: AxisKind::Linear,
        low: Coordinate(mm(preset - 250.0)),
        high: Coordinate(mm(preset + 250.0)),
        rate: Rate(mm(100.0)),
        backlash: Coordinate(mm(0.010)),
        backlash_table: Default::default(),
        drive: Drive::Torque {
            full_scale: Effort(800 << 16),
            limit: Effort(700 << 16),
        },
        law: ServoConfig {
            form: ServoForm::ModelBased,
            kp: Gain(40_000 << 8),
            kd: Gain(400 << 8),
            rate_filter_us: 1500,
            inertia: (40.0 * 0.016 * f64::from(1 << 20)) as u32,
            viscous: 0,
            coulomb: Effort(32 << 16),
            coulomb_rate: Rate(mm(0.2)),
            ki: Gain(0),
            friction_adaptation_ms: 0,
        },
        preset: Coordinate(mm(preset)),
        home: Home::Index,
        encoder: Some(EncoderSettings {
            per_count: i64::from(mm(10.0)) * (1 << 24) / 8000,
            following: Coordinate(mm(0.5)),
            following_lag: 1311,
            stuck_distance: Coordinate(mm(0.25)),
            index: Coordinate(mm(preset + 3.0)),
            index_pitch: Coordinate(mm(10.0)),
            index_slack: 4,
            search: Coordinate(mm(3.0)),
        }),
        active_low: 0,
        keeps_position: false,
        gantry: None,
    }
}

fn table() -> JointSettings {
    JointSettings {
        kind: AxisKind::Rotary,
        low: Coordinate(degrees(-45.0)),
        high: Coordinate(degrees(45.0)),
        rate: Rate(degrees(40.0)),
        backlash: Coordinate(0),
        backlash_table: Default::default(),
        preset: Coordinate(0),
        encoder: Some(EncoderSettings {
            per_count: (i64::from(degrees(4.0)) << 24) / 8000,
            following: Coordinate(degrees(0.5)),
            following_lag: 1311,
            stuck_distance: Coordinate(degrees(0.2)),
            index: Coordinate(degrees(1.0)),
            index_pitch: Coordinate(degrees(4.0)),
            index_slack: 4,
            search: Coordinate(degrees(1.5)),
        }),
        ..slide(0.0)
    }
}

/// Returns the reference geometry of the H-4 arm with its usual limits.
///
/// # Panics
/// Never: its name is short.
#[must_use]
pub fn h4() -> Config {
    let length = |x: f64| Length(mm(x));
    let linear = |low, high| pose_axis(AxisKind::Linear, mm, low, high, 50.0, 200.0, 5000.0);
    let rotary = |low, high| pose_axis(AxisKind::Rotary, degrees, low, high, 30.0, 100.0, 2500.0);
    Config {
        name: "reference".try_into().expect("short"),
        period_us: 200,
        model: Model::H4(H4Geometry {
            lateral: length(250.0),
            half_spacing: length(100.0),
            half_height: length(100.0),
            joint_offset: length(50.0),
            rod: length(480.0),
            rail_offset: length(25.0),
            tool: length(150.0),
            x_offset: length(810.0),
            y_offset: length(0.0),
            z_offset: length(0.0),
            table_height: length(600.0),
            below: true,
            singularity_margin: length(5.0),
        }),
        pose: [
            linear(-200.0, 200.0),
            linear(-120.0, 120.0),
            linear(-60.0, 140.0),
            rotary(-35.0, 35.0),
            rotary(-40.0, 40.0),
        ]
        .into_iter()
        .collect(),
        joints: [
            slide(1135.0),
            slide(485.0),
            slide(1135.0),
            slide(485.0),
            table(),
        ]
        .into_iter()
        .collect(),
        stopping: Stopping {
            time_ms: 120,
            ramp_ms: 30,
        },
        supervision: Supervision {
            heartbeat_ms: 500,
            missed_periods: 5,
            illegal_transitions: 10,
        },
        homing: Homing {
            rate: Rate(mm(10.0)),
            rotary_rate: Rate(degrees(4.0)),
        },
        force: None,
        follow: None,
        haptic: None,
        volumetric: None,
        io: Default::default(),
    }
}

/// Returns a force sensor of +-100 N with 14 bits, and force control towards 5 N with no axis
/// active.
#[must_use]
pub fn force() -> ForceConfig {
    let channel = || Channel {
        per_code: (100.0 / 8192.0 * 65_536.0 * 65_536.0) as i32,
        saturation: 7782,
    };
    let settings = LoopSettings {
        setpoint: Force::millinewtons(5000),
        mass: VirtualMass(1 << 16),
        damping: VirtualDamping(5 << 16),
        limit: Length::millimetres(10),
        rate: Rate(10 << 20),
        enable_condition: EnableCondition::AgainstMotion,
    };
    ForceConfig {
        sensor: ForceSensor {
            channels: [channel(), channel(), channel()],
            silent_samples: 3,
            stuck_samples: 500,
            drift: Force::millinewtons(500),
            limit: Force::millinewtons(80_000),
            tare_samples: 256,
            tare_spread: 30,
            weight: Force::ZERO,
        },
        axes: [settings.clone(), settings.clone(), settings],
        mask: 0,
        drive_lag_us: 5000,
        creep: Rate::ZERO,
        slowest_rpm: 4000,
    }
}

/// Returns REF-M of docs/control.md 7.2 with the force feedback of its section 4.2. The arm counts
/// 2.5 um and 65,536 per turn.
#[must_use]
pub fn haptic() -> HapticConfig {
    let length = |x: f64| Length(mm(x));
    let newton = |x: f64| (x * 65_536.0) as i32;
    let slide = Encoder {
        per_count: (0.0025 * 1_048_576.0 * 16_777_216.0) as i64,
        preset: Coordinate(mm(295.329_466)),
    };
    let angle = |preset: f64| Encoder {
        per_count: 1 << 40,
        preset: Coordinate(degrees(preset)),
    };
    let motor = |full: f64, limit: f64| Amplifier {
        full_scale: Effort(newton(full)),
        limit: Effort(newton(limit)),
    };
    let feedback = |percent, max| ForceFeedbackAxis {
        percent,
        limit: newton(max),
    };
    HapticConfig {
        geometry: HapticGeometry {
            base_radius: length(150.0),
            platform_radius: length(50.0),
            link: length(200.0),
            tilt: Angle::degrees(30),
            tip: [Length::ZERO, Length::ZERO, length(150.0)],
            side_tolerance: length(0.4),
        },
        sensors: [[slide, angle(0.0), angle(43.787_6)]; 3],
        ranges: [
            (Coordinate(mm(100.0)), Coordinate(mm(500.0))),
            (Coordinate(degrees(-60.0)), Coordinate(degrees(60.0))),
            (Coordinate(degrees(5.0)), Coordinate(degrees(88.0))),
        ],
        drives: [[motor(20.0, 15.0), motor(2.0, 1.5)]; 3],
        illegal_transitions: 10,
        condition: 20,
        rate_filter_us: 5000,
        ball: length(5.0),
        step: Force(newton(0.05)),
        feedback: ForceFeedback {
            axes: [feedback(40, 3.2), feedback(10, 3.2), feedback(20, 1.2)],
            damping: 0,
            damping_below: newton(2.0),
        },
        fixture: FixtureConfig {
            stiffness: newton(0.35) as u32,
            max: Force(newton(5.5)),
        },
        passivity: PassivityConfig {
            surplus: newton(0.5) as u32,
            deficit: newton(1.0) as u32,
            damping: newton(0.3) as u32,
        },
    }
}

/// Returns a tool that follows its master at a position scale of 1.
#[must_use]
pub const fn follow() -> FollowConfig {
    FollowConfig {
        scale: 1 << 12,
        gain: 100,
        stale_ms: 50,
    }
}

/// Returns a haptic arm alone, which is the remote master of a tool.
#[must_use]
pub fn master() -> Config {
    Config {
        model: Model::None,
        pose: Default::default(),
        joints: Default::default(),
        haptic: Some(haptic()),
        ..h4()
    }
}

/// Returns the same machine with step/direction drives, one step per encoder count.
#[must_use]
pub fn h4_with_steps() -> Config {
    let mut config = h4();
    for joint in &mut config.joints {
        let Some(encoder) = &joint.encoder else {
            continue;
        };
        joint.drive = Drive::Steps {
            per_step: encoder.per_count,
            ticks_per_us: 84,
            pulse: 210,
            setup: 420,
            hold: 420,
            lost: encoder.stuck_distance,
            chip: None,
        };
        joint.backlash = Coordinate(0);
        joint.rate = Rate(joint.rate.0 / 2);
    }
    config
}
