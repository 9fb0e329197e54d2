//! Whole joints: torque with backlash on a simulated slide, steps with a simulated motor, enabling,
//! references, bad configurations.

use haptimill_firmware::config::{
    AxisKind, Drive, EncoderSettings, Home, JointSettings, ServoConfig, ServoForm,
};
use haptimill_firmware::io::{DriveCommand, JointInputs};
use haptimill_firmware::joint::torque::TorqueOutput;
use haptimill_firmware::joint::{DriveError, JointCommand, JointDrive, ServoOutput};
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const MM: f64 = 1048576.0;
const NEWTON: f64 = 65536.0;

/// Advances a joint by one period and applies its command.
fn drive_to(joint: &mut JointDrive, commanded: &JointCommand) -> ServoOutput {
    let mut command = DriveCommand::Off;
    let saturated = joint.servo(
        commanded.coordinate,
        commanded.rate,
        commanded.acceleration,
        &mut command,
    );
    assert_eq!(
        (command, saturated),
        (joint.servo_output().command, joint.servo_output().saturated)
    );
    *joint.servo_output()
}

pub fn torque() -> Drive {
    Drive::Torque {
        full_scale: Effort((1000.0 * NEWTON) as i32),
        limit: Effort((800.0 * NEWTON) as i32),
    }
}

pub fn steps() -> Drive {
    Drive::Steps {
        per_step: (MM / 320.0 * 16777216.0) as i64,
        ticks_per_us: 72,
        pulse: 144,
        setup: 360,
        hold: 360,
        lost: Coordinate((0.02 * MM) as i32),
        chip: None,
    }
}

pub fn slide(drive: Drive, backlash_mm: f64) -> JointSettings {
    JointSettings {
        kind: AxisKind::Linear,
        low: Coordinate(0),
        high: Coordinate((1500.0 * MM) as i32),
        rate: Rate((60.0 * MM) as i32),
        backlash: Coordinate((backlash_mm * MM) as i32),
        backlash_table: Default::default(),
        drive,
        law: ServoConfig {
            form: ServoForm::ModelBased,
            kp: Gain(40_000 * 256),
            kd: Gain(400 * 256),
            rate_filter_us: 1500,
            inertia: (40.0 * 0.016 * 1048576.0) as u32,
            viscous: 0,
            coulomb: Effort((32.0 * NEWTON) as i32),
            coulomb_rate: Rate((0.02 * MM) as i32),
            ki: Gain(0),
            friction_adaptation_ms: 0,
        },
        preset: Coordinate(0),
        home: Home::Index,
        encoder: Some(EncoderSettings {
            per_count: 21_990_232_556,
            following: Coordinate((0.2 * MM) as i32),
            following_lag: 0,
            stuck_distance: Coordinate((0.1 * MM) as i32),
            index: Coordinate(0),
            index_pitch: Coordinate(10 << 20),
            index_slack: 4,
            search: Coordinate(0),
        }),
        active_low: 0,
        keeps_position: false,
        gantry: None,
    }
}

/// Motor and slide with backlash between them: the motor's mass is a quarter, friction (40 N) is
/// mostly on the slide; mm, s, N, kg.
struct Plant {
    motor: [f64; 2],
    slide: [f64; 2],
    backlash: f64,
    inputs: JointInputs,
}

impl Plant {
    fn new(backlash: f64) -> Self {
        Self {
            motor: [0.0; 2],
            slide: [0.0; 2],
            backlash,
            inputs: JointInputs::default(),
        }
    }

    /// One control period in steps of 2 us under a force; semi-implicit Euler.
    fn run(&mut self, newton: f64, end_ns: u64) {
        let dt = 2e-6;
        for k in 0..100u64 {
            let gap = self.motor[0] - self.slide[0];
            let over = gap - gap.clamp(-self.backlash / 2.0, self.backlash / 2.0);
            // A stiff contact of 80 Hz on 30 kg and its damping, only while it touches.
            let contact = if over == 0.0 {
                0.0
            } else {
                7600.0 * over + 8.0 * (self.motor[1] - self.slide[1])
            };
            let friction = |force: f64, rate: f64, max: f64| {
                if rate.abs() < 1e-3 {
                    -force.clamp(-max, max)
                } else {
                    -max * rate.signum()
                }
            };
            let on_motor = newton - contact;
            let on_motor = on_motor + friction(on_motor, self.motor[1], 10.0);
            let on_slide = contact + friction(contact, self.slide[1], 30.0);
            for (body, force, mass) in [
                (&mut self.motor, on_motor, 10.0),
                (&mut self.slide, on_slide, 30.0),
            ] {
                let before = body[1];
                body[1] += force / mass * 1e3 * dt;
                // Friction stops a body, it does not turn it round.
                if before * body[1] < 0.0 {
                    body[1] = 0.0;
                }
                body[0] += body[1] * dt;
            }
            let counts = (self.motor[0] / 0.00125).floor() as i32;
            if counts != self.inputs.counts {
                self.inputs.counts = counts;
                self.inputs.edge_time_ns = (end_ns - 200_000 + (k + 1) * 2_000) as u32;
            }
        }
    }
}

/// A slide on x = 15 sin(4/15 t) mm, the fastest axis of a 30 mm circle at 4 mm/s, compensated for
/// a lost motion in mm; gives the largest error of the true slide and of its estimate after the
/// start, mm.
fn follow(lost_motion: f64) -> (f64, f64) {
    let mut joint = JointDrive::new(&slide(torque(), lost_motion), 200).unwrap();
    let mut plant = Plant::new(0.010);
    joint.measure(&plant.inputs, 0);
    let start = joint.enable();
    let (mut worst, mut blind, mut code) = (0.0f64, 0.0f64, 0i16);
    let w = 4.0 / 15.0;
    for period in 1..100_000u64 {
        let time = period as f64 * 200e-6;
        plant.run(f64::from(code) / 8192.0 * 1000.0, period * 200_000);
        let measurement = *joint.measure(&plant.inputs, (period * 200_000) as u32);
        // Runs up smoothly over the first second.
        let ease = (time / 1.0).min(1.0);
        let ease = ease * ease * (3.0 - 2.0 * ease);
        let phase = if time < 1.0 {
            time * time * time - time.powi(4) / 2.0
        } else {
            time - 0.5
        };
        let x = 15.0 * (w * phase).sin();
        let v = 15.0 * w * ease * (w * phase).cos();
        let commanded = JointCommand {
            coordinate: Coordinate(start.0 + (x * MM) as i32),
            rate: Rate((v * MM) as i32),
            acceleration: Acceleration((-w * w * x * 4096.0) as i32),
        };
        let servo_output = drive_to(&mut joint, &commanded);
        let DriveCommand::Torque(next) = servo_output.command else {
            panic!()
        };
        assert!(!servo_output.saturated);
        if time > 2.0 {
            worst = worst.max((plant.slide[0] - x).abs());
            // The estimate of the slide knows what the motor's encoder cannot see.
            let estimate = f64::from(measurement.coordinate.0) / MM;
            blind = blind.max((estimate - plant.slide[0]).abs());
        }
        code = next;
    }
    (worst, blind)
}

/// 10 um of backlash, and 30 N of friction on the slide that wind the screw up by 4 um: a lost
/// motion of 18 um.
#[test]
fn lost_motion_is_compensated() {
    let [none, backlash, all] = [0.0, 0.010, 0.018].map(follow);
    println!(
        "largest error of slide and estimate, mm: none {none:?}, backlash {backlash:?}, backlash and wind-up {all:?}"
    );
    // 8 N of friction that is not compensated are 5 um at 40 kg and 40,000 1/s^2; they are in all
    // three.
    assert!(none.0 - backlash.0 > 0.0045, "{none:?} {backlash:?}");
    assert!(backlash.0 - all.0 > 0.003, "{backlash:?} {all:?}");
    assert!(all.0 < 0.0065 && all.1 < 0.0065, "{all:?}");
}

/// With a table the commanded motor is ahead of the slide by half the lost motion at the place of
/// the slide, on the side of its motion; the reference is the same interpolation in `f64`.
#[test]
fn lost_motion_depends_on_the_place() {
    let nodes_mm = [0.010, 0.030, 0.0, 0.025];
    let mut config = slide(torque(), 0.030);
    let nodes = nodes_mm.iter().map(|mm| Coordinate((mm * MM) as i32));
    config.backlash_table = nodes.collect();
    let half_mm = |at: f64| {
        let place = (at / 500.0).clamp(0.0, 3.0);
        let node = (place as usize).min(2);
        let part = place - node as f64;
        0.5 * (nodes_mm[node] + part * (nodes_mm[node + 1] - nodes_mm[node]))
    };
    for (at, direction) in [
        (0.0, 1.0),
        (250.0, -1.0),
        (499.999, 1.0),
        (620.0, 1.0),
        (999.0, -1.0),
        (1300.0, 1.0),
        (1500.0, -1.0),
        (1510.0, 1.0),
        (-3.0, 1.0),
    ] {
        let mut joint = JointDrive::new(&config, 200).unwrap();
        joint.measure(&JointInputs::default(), 0);
        joint.enable();
        let command = JointCommand {
            coordinate: Coordinate((at * MM) as i32),
            rate: Rate((direction * MM) as i32),
            acceleration: Acceleration(0),
        };
        // 100 ms: the shift is complete after 12 ms.
        let last = (0..500).map(|_| drive_to(&mut joint, &command)).last();
        let shift = f64::from(last.unwrap().following_error.0) / MM - at;
        let expected = direction * half_mm(at);
        assert!((shift - expected).abs() < 5e-6, "{at}: {shift} {expected}");
    }
}

#[test]
fn enable_does_not_move_the_joint() {
    for servo in [torque(), steps()] {
        let mut joint = JointDrive::new(&slide(servo, 0.01), 200).unwrap();
        let mut inputs = JointInputs {
            counts: 12_345,
            steps: 777,
            ..JointInputs::default()
        };
        joint.measure(&inputs, 0);
        assert_eq!(
            drive_to(&mut joint, &JointCommand::default()).command,
            DriveCommand::Off
        );
        // Turned by hand while off, by more than the backlash.
        inputs.counts += 4000;
        joint.measure(&inputs, 200_000);
        let commanded = JointCommand {
            coordinate: joint.enable(),
            ..JointCommand::default()
        };
        for period in 2..500u32 {
            joint.measure(&inputs, period * 200_000);
            let servo_output = drive_to(&mut joint, &commanded);
            assert_eq!(servo_output.following_error, Coordinate(0));
            match servo_output.command {
                DriveCommand::Torque(code) => assert_eq!(code, 0),
                DriveCommand::Steps(segment) => assert_eq!(segment.count, 0),
                DriveCommand::Off => panic!("off"),
            }
        }
        joint.disable();
        assert_eq!(drive_to(&mut joint, &commanded).command, DriveCommand::Off);
    }
}

/// A slide that creeps during missed periods is braked for its mean rate. A derivative of the whole
/// motion over one period would be 16,000 N/(m/s) * 0.42 m/s = 6,700 N, far above the limit.
#[test]
fn missed_periods_do_not_kick() {
    let mut joint = JointDrive::new(&slide(torque(), 0.0), 200).expect("valid");
    let mut inputs = JointInputs::default();
    joint.measure(&inputs, 0);
    let still = JointCommand {
        coordinate: joint.enable(),
        ..JointCommand::default()
    };
    let period = |joint: &mut JointDrive, inputs: &JointInputs, number: u32, missed: u16| {
        joint.measure(inputs, number * 200_000);
        if missed != 0 {
            joint.skip(missed, inputs.counts);
        }
        f64::from(drive_to(joint, &still).effort.0) / NEWTON
    };
    for number in 1..5 {
        assert!(period(&mut joint, &inputs, number, 0).abs() < 0.01);
    }
    // 67 counts of 1.25 um in 356 periods: 84 um, 1.18 mm/s.
    inputs.counts += 67;
    let kp = 40.0 * 40_000.0 * 67.0 * 1.25e-6;
    let kd = 40.0 * 400.0 * 67.0 * 1.25e-6 / (356.0 * 200e-6);
    let effort = period(&mut joint, &inputs, 360, 355);
    assert!(
        effort < -kp + 0.5 && effort > -kp - kd,
        "{effort} {kp} {kd}"
    );
}

#[test]
fn reference_set_in_motion_does_not_jump() {
    for servo in [torque(), steps()] {
        let mut joint = JointDrive::new(&slide(servo, 0.01), 200).unwrap();
        let inputs = JointInputs {
            counts: -500,
            ..JointInputs::default()
        };
        joint.measure(&inputs, 0);
        let mut commanded = JointCommand {
            coordinate: joint.enable(),
            ..JointCommand::default()
        };
        let shift = joint.set_reference(-100, Coordinate((1135.0 * MM) as i32));
        commanded.coordinate.0 += shift.0;
        let at = (1135.0 - 400.0 * 0.00125) * MM;
        assert!((f64::from(joint.measurement().motor.0) - at).abs() < 2.0);
        for period in 1..100u32 {
            let measurement = joint.measure(&inputs, period * 200_000);
            assert!((f64::from(measurement.coordinate.0) - at).abs() < 2.0);
            assert!(measurement.slip.0.abs() < 2 && !measurement.lost_steps);
            let servo_output = drive_to(&mut joint, &commanded);
            assert!(servo_output.following_error.0.abs() <= 1);
            assert!(
                !matches!(servo_output.command, DriveCommand::Steps(segment) if segment.count != 0)
            );
        }
    }
}

/// A step motor that follows exactly, then loses 10 steps: reported at once, and only then.
#[test]
fn lost_steps_are_detected() {
    let mut joint = JointDrive::new(&slide(steps(), 0.0), 200).unwrap();
    let mut inputs = JointInputs::default();
    joint.measure(&inputs, 0);
    let start = joint.enable();
    let (mut motor_steps, mut segment) = (0i64, 0i16);
    for period in 1..4000u32 {
        // The segment of the period before is carried out now.
        inputs.steps = inputs.steps.wrapping_add(i32::from(segment));
        motor_steps += i64::from(segment);
        if period == 3000 {
            motor_steps -= 10;
        }
        // 2.5 counts a step.
        let counts = (motor_steps * 5).div_euclid(2) as i32;
        if counts != inputs.counts {
            inputs.counts = counts;
            inputs.edge_time_ns = period * 200_000 - 1;
        }
        let measurement = joint.measure(&inputs, period * 200_000);
        assert_eq!(
            measurement.lost_steps,
            period >= 3000,
            "period {period}: slip {:?}",
            measurement.slip
        );
        let time = f64::from(period) * 200e-6;
        let x = 5.0 * (1.0 - (3.0 * time).cos());
        let servo_output = drive_to(
            &mut joint,
            &JointCommand {
                coordinate: Coordinate(start.0 + (x * MM) as i32),
                rate: Rate((15.0 * (3.0 * time).sin() * MM) as i32),
                acceleration: Acceleration(0),
            },
        );
        let DriveCommand::Steps(next) = servo_output.command else {
            panic!()
        };
        segment = next.count;
        if period < 3000 {
            // Two periods of travel and a step.
            assert!(f64::from(servo_output.following_error.0).abs() / MM < 15.0 * 400e-6 + 0.0045);
        }
    }
}

#[test]
fn invalid_joint_configurations_are_refused() {
    let refused = |joint: &JointSettings, period| JointDrive::new(joint, period).err();
    assert_eq!(refused(&slide(torque(), 0.0), 200), None);
    assert_eq!(refused(&slide(steps(), 0.0), 200), None);
    assert_eq!(refused(&slide(torque(), 0.0), 49), Some(DriveError::Period));
    assert_eq!(
        refused(&slide(torque(), 0.0), 1001),
        Some(DriveError::Period)
    );
    assert_eq!(
        refused(&slide(torque(), -0.1), 200),
        Some(DriveError::Backlash)
    );
    let mut senseless = slide(torque(), 0.0);
    senseless.encoder.as_mut().expect("an encoder").per_count = 0;
    assert_eq!(refused(&senseless, 200), Some(DriveError::Encoder));
    // Without an encoder only steps can be counted.
    senseless.encoder = None;
    assert_eq!(refused(&senseless, 200), Some(DriveError::Encoder));
    senseless.drive = steps();
    assert_eq!(refused(&senseless, 200), None);
    for (full_scale, limit) in [(0, 1), (1, 0), (1, -1)] {
        let servo = Drive::Torque {
            full_scale: Effort(full_scale),
            limit: Effort(limit),
        };
        assert_eq!(refused(&slide(servo, 0.0), 200), Some(DriveError::Torque));
    }
    let step = |per_step, ticks_per_us, pulse, setup| Drive::Steps {
        per_step,
        ticks_per_us,
        pulse,
        setup,
        hold: 0,
        lost: Coordinate(1),
        chip: None,
    };
    assert_eq!(
        refused(&slide(step(1 << 23, 72, 100, 100), 0.0), 200),
        Some(DriveError::Step)
    );
    assert_eq!(
        refused(&slide(step(1 << 30, 0, 100, 100), 0.0), 200),
        Some(DriveError::Step)
    );
    assert_eq!(
        refused(&slide(step(1 << 30, 1, 0, 10), 0.0), 200),
        Some(DriveError::Timing)
    );
    assert_eq!(
        refused(&slide(step(1 << 30, 1, 101, 10), 0.0), 200),
        Some(DriveError::Timing)
    );
    assert_eq!(
        refused(&slide(step(1 << 30, 1, 50, 151), 0.0), 200),
        Some(DriveError::Timing)
    );
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(5), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn torque_codes_have_the_right_mean(full_scale in prop_oneof![1_000_000i32..=i32::MAX, i32::MIN..=-1_000_000], part in -0.999f64..0.999) {
        let mut output = TorqueOutput::new(Effort(full_scale));
        let effort = (f64::from(full_scale) * part) as i32;
        let exact = f64::from(effort) * 8192.0 / f64::from(full_scale);
        let mut total = 0.0;
        for k in 1..=2000 {
            let (code, clamped) = output.code(Effort(effort));
            total += f64::from(code);
            prop_assert!(!clamped);
            prop_assert!((f64::from(code) - exact).abs() <= 1.001);
            // The sum never strays by more than half a code (and the 2^-28 of the scale).
            prop_assert!((total - exact * f64::from(k)).abs() <= 0.51 + f64::from(k) * (exact.abs() * 4e-9 + 2e-5));
        }
    }

    #[test]
    fn torque_is_symmetric_and_within_the_codes(full_scale: i32, effort: i32) {
        let fresh = || TorqueOutput::new(Effort(full_scale));
        let (code, clamped) = fresh().code(Effort(effort));
        let (opposite, _) = fresh().code(Effort(effort.saturating_neg()));
        prop_assert!((code + opposite).abs() <= 1);
        prop_assert!((-8191..=8191).contains(&code));
        let exact = f64::from(effort) * 8192.0 / f64::from(if full_scale == 0 { 1 } else { full_scale });
        prop_assert_eq!(clamped, code.abs() == 8191 && exact.abs() > 8191.0 + 0.5 - 1e-3, "{} {}", code, exact);
        prop_assert!((f64::from(code) - exact.clamp(-8191.0, 8191.0)).abs() <= 0.51);
    }

    /// The drive command stays within its limit for any command and measurement.
    #[test]
    fn drive_command_stays_within_its_limit(
        full_scale in prop_oneof![1_000_000i32..=i32::MAX, i32::MIN..=-1_000_000], limit in 1i32.., place: i32, commanded: (i32, i32, i32),
    ) {
        let limit = Effort(limit);
        let mut joint = JointDrive::new(&slide(Drive::Torque { full_scale: Effort(full_scale), limit }, 0.0), 200).unwrap();
        joint.measure(&JointInputs::default(), 0);
        joint.enable();
        joint.measure(&JointInputs { counts: place >> 12, ..JointInputs::default() }, 200_000);
        let (coordinate, rate, acceleration) = commanded;
        let servo_output = drive_to(&mut joint, &JointCommand { coordinate: Coordinate(coordinate), rate: Rate(rate), acceleration: Acceleration(acceleration) });
        let DriveCommand::Torque(code) = servo_output.command else {
            panic!("a torque drive: {servo_output:?}");
        };
        let max = f64::from(limit.0) * 8192.0 / f64::from(full_scale).abs();
        prop_assert!(f64::from(code).abs() <= max + 0.51);
        prop_assert!(servo_output.effort.0.unsigned_abs() <= limit.0.unsigned_abs());
    }

    #[test]
    fn joint_accepts_any_input(
        kind in prop::sample::select(&[AxisKind::Linear, AxisKind::Rotary, AxisKind::MultiTurn][..]), backlash in 0i32.., per_count in prop_oneof![1i64.., ..0i64],
        frames in prop::collection::vec((any::<(i32, u32, u16, i32, u8, i32, u32)>(), any::<(i32, i32, i32)>(), 0u8..8), 1..60),
    ) {
        for servo in [torque(), steps()] {
            let mut config = slide(servo, 0.0);
            config.kind = kind;
            config.backlash = Coordinate(backlash);
            config.encoder.as_mut().expect("an encoder").per_count = per_count;
            let mut joint = JointDrive::new(&config, 200).unwrap();
            for &((counts, edge_time_ns, illegal, index_counts, index_pulses, steps, time), (coordinate, rate, acceleration), what) in &frames {
                joint.measure(&JointInputs { counts, edge_time_ns, illegal, index_counts, index_pulses, steps, ..JointInputs::default() }, time);
                match what {
                    0 => { joint.enable(); }
                    1 => joint.disable(),
                    2 => { joint.set_reference(index_counts, Coordinate(coordinate)); }
                    _ => {}
                }
                drive_to(&mut joint, &JointCommand { coordinate: Coordinate(coordinate), rate: Rate(rate), acceleration: Acceleration(acceleration) });
            }
        }
    }
}
