//! Force control as a whole, from codes to displacements: cutting, a sensor with the wrong sign,
//! leaving a stiff contact, changes at run time, spindle speeds.

use haptimill_checks::reference;
use haptimill_firmware::force::sensor::{Channel, ForceProblem, ForceSample, ForceSensor};
use haptimill_firmware::force::{
    EnableCondition, ForceConfig, ForceControl, ForceParameter, LoopSettings,
};
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_math::{Angle, Coordinate, Length, Rate};

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const MM: f64 = 1_048_576.0;
const NEWTON: f64 = 65_536.0;
const PER_CODE: f64 = 200.0 / 16_384.0;
const STEP: f64 = 200e-6;

fn settings(mass: f64, damping: f64, enable_condition: EnableCondition) -> LoopSettings {
    LoopSettings {
        setpoint: Force::millinewtons(5000),
        mass: VirtualMass((mass * NEWTON) as u32),
        damping: VirtualDamping((damping * NEWTON) as u32),
        limit: Length::millimetres(10),
        rate: Rate(50 << 20),
        enable_condition,
    }
}

fn config(sign: f64, loops: &LoopSettings) -> ForceConfig {
    let channel = || Channel {
        per_code: (-sign * PER_CODE * f64::exp2(32.0)) as i32,
        saturation: 7782,
    };
    let force = reference::force();
    ForceConfig {
        sensor: ForceSensor {
            channels: [channel(), channel(), channel()],
            ..force.sensor
        },
        axes: [loops.clone(), loops.clone(), loops.clone()],
        mask: 1,
        ..force
    }
}

/// A tool whose x follows its reference in the next period.
struct Rig {
    control: ForceControl,
    commanded: f64,
    tool: f64,
    speed: f64,
    displacement: f64,
    displacement_rate: f64,
    number: u8,
    random: u64,
    turned: f64,
    rpm: i16,
    /// Position of the tool in y, mm.
    across: f64,
}

impl Rig {
    fn new(config: &ForceConfig) -> Self {
        let mut rig = Self {
            control: ForceControl::new(config, 200).expect("sound"),
            commanded: 0.0,
            tool: 0.0,
            speed: 0.0,
            displacement: 0.0,
            displacement_rate: 0.0,
            number: 0,
            random: 3,
            turned: 0.0,
            rpm: 5000,
            across: 0.0,
        };
        rig.control.begin_tare();
        for _ in 0..300 {
            rig.period(0.0, 0.0);
        }
        assert_eq!(rig.control.conditioner().tare_result(), Some(Ok(())));
        rig
    }

    fn noise(&mut self) -> f64 {
        (0..4)
            .map(|_| {
                self.random = self
                    .random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (self.random >> 33) as f64 / f64::exp2(31.0) - 0.5
            })
            .sum::<f64>()
            * 2.0
    }

    /// One period: the force on the tool in x, and the commanded speed.
    fn period(&mut self, force: f64, speed: f64) -> Option<ForceProblem> {
        self.number = self.number.wrapping_add(1);
        // The sensor sees the tool's push on the work.
        let code = (-force / PER_CODE + self.noise())
            .round()
            .clamp(-8192.0, 8191.0) as i16;
        let codes = [
            code,
            self.noise().round() as i16,
            self.noise().round() as i16,
        ];
        let sample = ForceSample {
            codes,
            conversions: self.number,
            overload: false,
        };
        let position = [
            Coordinate((self.tool * MM) as i32),
            Coordinate((self.across * MM) as i32),
            Coordinate(0),
        ];
        self.control
            .measure(&sample, self.rpm, &position, [Angle(0); 2], false);
        let condition = self.control.condition();
        self.commanded += speed * STEP;
        let [x, ..] = self
            .control
            .advance(&[Rate((speed * MM) as i32), Rate(0), Rate(0)]);
        self.displacement = f64::from(x.displacement.length().0) / MM;
        self.displacement_rate = f64::from(x.rate.0) / MM;
        let tool = self.commanded + self.displacement;
        self.speed = (tool - self.tool) / STEP;
        self.tool = tool;
        self.turned += f64::from(self.rpm) / 60.0 * STEP;
        condition
    }

    fn peak(&self) -> f64 {
        f64::from(self.control.extremes()[0].peak().0) / NEWTON
    }

    /// A cut towards -x: two teeth with 10 % of run-out, force with the speed into the work, the
    /// depth and the engagement.
    fn cut(&self, scale: f64) -> f64 {
        let angle = self.turned * 2.0 * std::f64::consts::PI;
        let teeth = libm::sin(angle).max(0.0) + 0.9 * libm::sin(-angle).max(0.0);
        let travel = -self.tool;
        let engaged = (travel / 2.0).clamp(0.0, 1.0);
        let depth = 1.0 + libm::tan(10f64.to_radians()) * travel;
        scale * 0.65 * (-self.speed).clamp(0.0, 20.0) * depth * engaged * teeth
    }
}

/// The 10-degree incline with force control on x: the guard never interferes, the loop is the
/// equation within 1 %, and the tool comes back.
#[test]
fn monitor_does_not_interfere_with_cutting() {
    for (mass, damping) in [(1.0, 5.0), (0.25, 5.0), (1.0, 20.0), (0.25, 0.5)] {
        for feed in [2.0, 4.0] {
            let mut loops = settings(mass, damping, EnableCondition::AgainstMotion);
            loops.limit = Length::millimetres(20);
            let mut rig = Rig::new(&config(1.0, &loops));
            let (mut impulse, mut levels, mut late, mut samples) = (0.0, 0, 0.0, 0);
            let periods = (20.0 / feed / STEP) as usize;
            for k in 0..periods {
                let force = rig.cut(3.0);
                assert_eq!(rig.period(force, -feed), None);
                if rig.displacement > 0.0 {
                    impulse += (rig.peak() - 5.0) * STEP;
                }
                if rig.control.levels()[0] > 0 && levels == 0 {
                    println!(
                        "at {} peak {} displacement {} rate {} tool {}",
                        f64::from(k as u32) * STEP,
                        rig.peak(),
                        rig.displacement,
                        rig.displacement_rate,
                        rig.tool
                    );
                }
                levels += usize::from(rig.control.levels()[0]);
                if k > periods / 2 {
                    late += rig.peak();
                    samples += 1;
                }
            }
            let (displacement, made) = (
                rig.displacement,
                damping * rig.displacement + mass * rig.displacement_rate,
            );
            println!(
                "K_A {mass}, K_V {damping}, {feed} mm/s: p_c {displacement:.2} mm, mean peak force of the last half {:.2} N",
                late / f64::from(samples)
            );
            assert_eq!(levels, 0, "the guard interfered");
            assert!((impulse / made - 1.0).abs() < 0.01, "{impulse} {made}");
            for _ in 0..100_000 {
                let force = rig.cut(3.0);
                rig.period(force, 0.0);
                assert_eq!(rig.control.levels()[0], 0);
            }
            assert!(rig.displacement < 0.05, "{}", rig.displacement);
        }
    }
}

/// An elastic body of this stiffness beyond x = -0.5: its force on the tool.
fn body_force(rig: &Rig, stiffness: f64) -> f64 {
    stiffness * (-0.5 - rig.tool).max(0.0)
}

/// A wrong sensor sign is reported in the first contact before the force reaches 10 times its
/// setpoint; a right one never is.
#[test]
fn wrong_sensor_sign_is_detected_in_the_first_contact() {
    for enable_condition in [EnableCondition::Any, EnableCondition::AgainstMotion] {
        for (stiffness, speed) in [
            (5.0, 1.0),
            (20.0, 1.0),
            (100.0, 1.0),
            (100.0, 4.0),
            (500.0, 0.5),
            (1000.0, 0.2),
        ] {
            for sign in [1.0, -1.0] {
                let mut rig = Rig::new(&config(sign, &settings(1.0, 5.0, enable_condition)));
                let mut reported = None;
                for _ in 0..(6.0 / speed / STEP) as usize {
                    let force = body_force(&rig, stiffness);
                    if let Some(condition) = rig.period(force, -speed) {
                        reported = Some((condition, force));
                        break;
                    }
                }
                if sign > 0.0 {
                    assert!(
                        !matches!(reported, Some((ForceProblem::WrongSign { .. }, _))),
                        "{enable_condition:?} {stiffness} {reported:?}"
                    );
                } else {
                    let Some((ForceProblem::WrongSign { component: 0 }, force)) = reported else {
                        panic!("{enable_condition:?} {stiffness} {speed} {reported:?}")
                    };
                    println!(
                        "{enable_condition:?}, {stiffness} N/mm at {speed} mm/s: reported at {force:.1} N"
                    );
                    assert!(
                        force < 50.0,
                        "{enable_condition:?} {stiffness} {speed} {force}"
                    );
                }
            }
        }
    }
}

/// A cut along y at a rising feed pushes along x, and the tool complies there: that force grows as
/// the tool moves along it, with a right sensor. Without the motion along y it would be a wrong
/// sign.
#[test]
fn lateral_force_of_a_cut_is_no_wrong_sign() {
    for (feed, is_wrong) in [(8.0, false), (0.0, true)] {
        let mut rig = Rig::new(&config(1.0, &settings(1.0, 5.0, EnableCondition::Any)));
        let mut reported = false;
        for k in 0..(1.0 / STEP) as usize {
            let part = (k as f64 * STEP / 0.5).min(1.0);
            rig.across -= part * feed * STEP;
            let problem = rig.period(16.0 * part, 0.0);
            reported |= matches!(problem, Some(ForceProblem::WrongSign { component: 0 }));
        }
        assert_eq!(reported, is_wrong, "{feed} mm/s");
    }
}

/// The stiffness estimate of a wall decays in a second of free motion, and does not slow a
/// retraction.
#[test]
fn stiffness_estimate_decays_in_free_motion() {
    let mut rig = Rig::new(&config(1.0, &settings(1.0, 5.0, EnableCondition::Any)));
    for k in 0..20_000 {
        let force = body_force(&rig, 1000.0);
        rig.period(force, if k < 4000 { -1.0 } else { 0.0 });
    }
    assert!(rig.control.levels()[0] >= 4);
    let before = rig.tool;
    for _ in 0..1000 {
        let force = body_force(&rig, 1000.0);
        rig.period(force, 4.0);
    }
    // In 0.2 s the commanded position retreats by 0.8 mm.
    assert!(rig.tool - before > 0.7, "{}", rig.tool - before);
    for _ in 0..5000 {
        rig.period(0.0, 4.0);
    }
    assert_eq!(rig.control.levels()[0], 0);
}

/// Settings change while the tool is displaced. The law takes over some periods later, and the tool
/// does not jump.
#[test]
fn runtime_settings_change_without_a_jump() {
    let mut rig = Rig::new(&config(1.0, &settings(1.0, 5.0, EnableCondition::Any)));
    let (mut largest, mut last, mut speed) = (0.0f64, 0.0, 0.0);
    for k in 0..10_000 {
        rig.period(10.0, 0.0);
        if k == 5000 {
            let mut gentle = settings(0.25, 0.5, EnableCondition::Any);
            gentle.setpoint = Force::millinewtons(9000);
            assert_eq!(rig.control.set(0, &gentle), Ok(()));
            assert_eq!(
                rig.control
                    .set(0, &gentle)
                    .map_err(|refused| refused.parameter),
                Err(ForceParameter::Busy)
            );
        }
        if k > 100 {
            largest = largest.max((rig.displacement - last - speed * STEP).abs());
        }
        (last, speed) = (rig.displacement, rig.displacement_rate);
    }
    assert_eq!(
        rig.control.settings(0).map(|settings| settings.setpoint),
        Some(Force::millinewtons(9000))
    );
    println!("largest jump of the tool {:.1} nm", largest * 1e6);
    // Two roundings to 2^-20 mm, and half of 20 mm/s^2 (200 us)^2.
    assert!(largest < 2.5e-6, "{largest}");
    assert!(
        rig.control
            .set(3, &settings(1.0, 5.0, EnableCondition::Any))
            .is_err()
    );
    let mut bad = settings(1.0, 5.0, EnableCondition::Any);
    bad.setpoint = Force(0);
    assert_eq!(
        rig.control
            .set(0, &bad)
            .map_err(|refused| (refused.parameter, refused.bound)),
        Err((ForceParameter::SetpointTooSmall, 32_768))
    );
}

/// Without a tare, or out of the mask, a force moves nothing; taken out of the mask the tool
/// returns.
#[test]
fn only_tared_axes_in_the_mask_comply() {
    let config = config(1.0, &settings(1.0, 5.0, EnableCondition::Any));
    let mut bare = ForceControl::new(&config, 200).expect("sound");
    for k in 0..1000u32 {
        let sample = ForceSample {
            codes: [-2000 + (k % 3) as i16; 3],
            conversions: k as u8,
            overload: false,
        };
        bare.measure(&sample, 5000, &[Coordinate(0); 3], [Angle(0); 2], false);
        assert!(
            bare.advance(&[Rate(0); 3])
                .iter()
                .all(|axis| axis.displacement.0 == 0)
        );
    }
    let mut rig = Rig::new(&config);
    for _ in 0..5000 {
        rig.period(10.0, 0.0);
    }
    assert!(rig.displacement > 0.5 && rig.control.displacements()[1].0 == 0);
    rig.control.set_mask(0);
    for _ in 0..20_000 {
        rig.period(10.0, 0.0);
    }
    assert_eq!(rig.control.displacements()[0].0, 0);
    rig.control.set_mask(0xff);
    assert_eq!(rig.control.mask(), 7);
}

/// The window follows the spindle; too slow a spindle is reported while force control is on.
#[test]
fn spindle_speed_sets_the_peak_window() {
    let mut rig = Rig::new(&config(1.0, &settings(1.0, 5.0, EnableCondition::Any)));
    rig.rpm = 3000;
    assert_eq!(
        rig.period(0.0, 0.0),
        Some(ForceProblem::SlowSpindle { rpm: 3000 })
    );
    rig.control.set_mask(0);
    assert_eq!(rig.period(0.0, 0.0), None);
    rig.control.set_mask(1);
    for rpm in [0, 8000, -6000, 4000] {
        rig.rpm = rpm;
        assert_eq!(rig.period(0.0, 0.0), None);
    }
    let mut slow = config(1.0, &settings(1.0, 5.0, EnableCondition::Any));
    slow.slowest_rpm = 100;
    let refused = ForceControl::new(&slow, 200).map(|_| ());
    let Err((None, refused)) = refused else {
        panic!("{refused:?}")
    };
    assert_eq!(
        (refused.parameter, refused.bound),
        (ForceParameter::SlowestSpindle, 147)
    );
    slow.sensor.limit = Force(0);
    assert!(
        matches!(ForceControl::new(&slow, 200), Err((None, refused)) if refused.parameter == ForceParameter::Sensor)
    );
}

fn toothless(sign: f64) -> ForceConfig {
    ForceConfig {
        slowest_rpm: 0,
        ..config(sign, &settings(0.05, 20.0, EnableCondition::Any))
    }
}

/// A tool without teeth: no speed is too slow, and the force of 2 ms counts, not its peak over a
/// revolution.
#[test]
fn a_tool_without_teeth_has_a_window_of_2_ms() {
    let mut rig = Rig::new(&toothless(1.0));
    for rpm in [0, 60, 600, -600, 6000] {
        rig.rpm = rpm;
        for force in [8.0, 0.0] {
            for period in 0..200 {
                assert_eq!(rig.period(force, 0.0), None);
                if period > 12 {
                    assert!(
                        (rig.peak() - force).abs() < 0.2,
                        "{rpm} {period} {}",
                        rig.peak()
                    );
                }
            }
        }
    }
}

/// A lap with a run-out of 20 um lifts the tool once per revolution, so force and tool move in one
/// direction for half of it: that is no wrong sign of the sensor. A wrong one stops the machine.
#[test]
fn a_run_out_is_no_wrong_sign() {
    for (rpm, stiffness) in [
        (120, 500.0),
        (300, 200.0),
        (600, 200.0),
        (600, 1000.0),
        (1500, 500.0),
    ] {
        for sign in [1.0, -1.0] {
            let mut rig = Rig::new(&toothless(sign));
            rig.rpm = rpm;
            let mut reported = None;
            for _ in 0..(20.0 / STEP) as usize {
                let lap = 0.01 * libm::sin(rig.turned * 2.0 * std::f64::consts::PI);
                let force = stiffness * (lap - rig.tool).max(0.0);
                if let Some(condition) = rig.period(force, -0.02) {
                    reported = Some((condition, force));
                    break;
                }
            }
            if sign > 0.0 {
                assert_eq!(reported, None, "{rpm} rev/min, {stiffness} N/mm");
                continue;
            }
            // The force grows with k / K_V, so the limit of the sensor may be first.
            let stops = matches!(
                reported,
                Some((
                    ForceProblem::WrongSign { component: 0 }
                        | ForceProblem::Limit { component: 0, .. },
                    _
                ))
            );
            assert!(stops, "{rpm} rev/min, {stiffness} N/mm: {reported:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: RngSeed::Fixed(21), failure_persistence: None, ..ProptestConfig::default() })]

    /// Any inputs in any order: nothing overflows, and displacements stay within their limits.
    #[test]
    fn any_input_stays_within_limits(
        inputs in prop::collection::vec(
            (any::<[i16; 3]>(), any::<u8>(), any::<[bool; 3]>(), any::<i16>(), any::<[i32; 3]>(), any::<[i32; 3]>(), any::<i32>(), 1u16..80), 1..80,
        ),
        gentle: bool,
    ) {
        let loops = if gentle { settings(0.25, 0.5, EnableCondition::Any) } else { settings(1.0, 5.0, EnableCondition::AgainstMotion) };
        let mut config = config(1.0, &loops);
        config.sensor.weight = Force::millinewtons(60_000);
        config.sensor.tare_samples = 16;
        let mut control = ForceControl::new(&config, 200).expect("sound");
        for (codes, conversions, [overload, unloaded, hold], rpm, position, rates, table, periods) in inputs {
            match conversions % 16 {
                0 => control.begin_tare(),
                1 => control.reset(),
                2 => control.set_mask(codes[0] as u8),
                3 => { let _ = control.set(usize::from(conversions >> 6), &settings(1.0, 20.0, EnableCondition::Any)); }
                _ => {}
            }
            control.hold(hold);
            for k in 0..periods {
                let sample = ForceSample { codes: codes.map(|code| code.wrapping_add(k as i16)), conversions: conversions.wrapping_add(k as u8), overload };
                control.measure(&sample, rpm, &position.map(Coordinate), [Angle(table); 2], unloaded);
                control.advance(&rates.map(Rate));
                if k % 7 == 3 {
                    control.roll_back();
                }
                for compliance in control.compliance() {
                    prop_assert!(compliance.displacement.0.abs() <= 10 << 40);
                }
            }
        }
    }
}
