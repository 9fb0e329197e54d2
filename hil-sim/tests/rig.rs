//! The rig: sequence within a period, bytes, faults, and repeatability.

use crate::machine;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};
use haptimill_hil_sim::fault::{Direction, Fault, FaultKind};
use haptimill_hil_sim::{Control, PlantConfig, Rig, RigOptions};
use proptest::prelude::*;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Independent position loops in f64: K_P = 40,000 1/s^2, K_D = 400 1/s with a filter of 1.5 ms.
struct Loops {
    joints: Vec<Joint>,
    expected: fn(f64) -> [f64; 5],
    echo: Vec<u8>,
}

struct Joint {
    per_count: f64,
    start: f64,
    /// Effort per mm/s^2 (or degree/s^2).
    inertia: f64,
    coulomb: f64,
    full_scale: f64,
    error: f64,
    rate: f64,
}

const PERIOD: f64 = 200e-6;

impl Loops {
    fn new(config: &PlantConfig, starts: &[f64], expected: fn(f64) -> [f64; 5]) -> Self {
        let joints = config
            .joint
            .iter()
            .zip(starts)
            .map(|(joint, &start)| Joint {
                per_count: joint.per_count(joint.encoder.as_ref().expect("an encoder")),
                start,
                inertia: joint.inertia / joint.kind.acceleration_unit(),
                // A fifth of the friction is not compensated.
                coulomb: 0.8 * joint.coulomb,
                full_scale: if joint.lead > 5.0 { 800.0 } else { 40.0 },
                error: 0.0,
                rate: 0.0,
            })
            .collect();
        Self {
            joints,
            expected,
            echo: Vec::new(),
        }
    }
}

impl Control for Loops {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.echo.extend_from_slice(&inputs.received);
        for byte in &inputs.received {
            let _ = outputs.transmit.push(byte.wrapping_add(1));
        }
        let time = inputs.period as f64 * PERIOD;
        let (now, soon) = ((self.expected)(time), (self.expected)(time + PERIOD));
        for (axis, joint) in self.joints.iter_mut().enumerate() {
            let measured = joint.start + f64::from(inputs.joints[axis].counts) * joint.per_count;
            let error = joint.start + now[axis] - measured;
            let filter = PERIOD / (1.5e-3 + PERIOD);
            joint.rate += filter * ((error - joint.error) / PERIOD - joint.rate);
            joint.error = error;
            let feed_forward = joint.coulomb * ((soon[axis] - now[axis]) / PERIOD / 0.3).tanh();
            let effort = joint.inertia * (40_000.0 * error + 400.0 * joint.rate) + feed_forward;
            let code = (effort / joint.full_scale * 8192.0)
                .round()
                .clamp(-8192.0, 8191.0);
            outputs.joints[axis] = DriveCommand::Torque(code as i16);
        }
    }
}

/// Slides and table oscillate slowly, by 5 mm and 2 degrees, at up to about 4 mm/s.
fn swing(time: f64) -> [f64; 5] {
    let soft = 1.0 - (-time * 4.0).exp() * (1.0 + time * 4.0);
    std::array::from_fn(|axis| {
        soft * (2.0 + axis as f64 * 0.6) * (0.8 * time + axis as f64).sin()
            - soft * (axis as f64).sin()
    })
}

fn still(_: f64) -> [f64; 5] {
    [0.0; 5]
}

fn rig(options: RigOptions, expected: fn(f64) -> [f64; 5]) -> Rig<Loops> {
    let config = machine::reference();
    let starts = Rig::new(&config, &options, Idle)
        .expect("a rig")
        .truth()
        .joints;
    let control = Loops::new(&config, &starts, expected);
    Rig::new(&config, &options, control).expect("a rig")
}

struct Idle;

impl Control for Idle {
    fn tick(&mut self, _: &Inputs, _: &mut Outputs) {}
}

fn faults(lines: &[&str]) -> RigOptions {
    let faults = lines
        .iter()
        .map(|line| line.parse().expect("a fault"))
        .collect();
    RigOptions {
        faults,
        ..RigOptions::default()
    }
}

#[test]
fn simple_position_loops_hold_the_machine() {
    let mut rig = rig(RigOptions::default(), swing);
    let start = rig.truth().joints;
    let (mut worst, mut squares, mut count) = (0.0_f64, 0.0, 0);
    for _ in 0..30_000 {
        let time = rig.time_ns() as f64 * 1e-9;
        rig.step();
        assert!(rig.truth().pose_valid);
        let expected = swing(time);
        for (now, (start, moved)) in rig
            .truth()
            .joints
            .iter()
            .zip(start.iter().zip(&expected))
            .take(4)
        {
            let error = now - start - moved;
            worst = worst.max(error.abs());
            squares += error * error;
            count += 1;
        }
    }
    let rms = (squares / f64::from(count)).sqrt();
    println!("slide error: largest {worst:.4} mm, rms {rms:.4} mm");
    // The screw mode is not excited, and friction does not stop the motion: the slides stay within
    // the machine's figures.
    assert!(worst < 0.05, "largest slide error {worst} mm, rms {rms} mm");
    assert!(rms < 0.02, "rms {rms} mm");
}

fn fingerprint(options: RigOptions, seed: u64) -> u64 {
    let mut config = machine::reference();
    config.seed = seed;
    let starts = Rig::new(&config, &options, Idle)
        .expect("a rig")
        .truth()
        .joints;
    let mut rig = Rig::new(&config, &options, Loops::new(&config, &starts, swing)).expect("a rig");
    let mut hasher = DefaultHasher::new();
    let mut received = Vec::new();
    for period in 0..4000_u32 {
        if period % 7 == 0 {
            rig.host_write(&period.to_le_bytes());
        }
        rig.step().hash(&mut hasher);
        rig.host_read(&mut received);
        format!("{:?}{:?}", rig.inputs(), rig.outputs()).hash(&mut hasher);
        for value in rig.truth().joints.iter().chain(&rig.truth().pose) {
            value.to_bits().hash(&mut hasher);
        }
    }
    received.hash(&mut hasher);
    hasher.finish()
}

#[test]
fn the_same_seed_gives_the_same_outputs() {
    let faulty_line = || RigOptions {
        baud: Some(115_200),
        ..faults(&[
            "encoder-noise joint=l2 per-second=2000 at=100ms for=200ms",
            "link-errors rate=1e-3",
            "link-drop rate=0.01 at=0.3s",
            "missed-periods count=3 at=0.5s",
        ])
    };
    assert_eq!(fingerprint(faulty_line(), 5), fingerprint(faulty_line(), 5));
    assert_ne!(fingerprint(faulty_line(), 5), fingerprint(faulty_line(), 6));
}

#[test]
fn outputs_take_effect_one_period_later() {
    struct Push;
    impl Control for Push {
        fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
            outputs.joints[0] = if inputs.period == 3 {
                DriveCommand::Torque(8191)
            } else {
                DriveCommand::Off
            };
        }
    }
    let mut rig = Rig::new(&machine::slide(), &RigOptions::default(), Push).expect("a rig");
    let moved: Vec<bool> = (0..6)
        .map(|_| {
            rig.step();
            rig.plant().bodies().motor[0] != 0.0
        })
        .collect();
    assert_eq!(moved, [false, false, false, false, true, true]);
}

#[test]
fn bytes_beyond_the_receive_ring_are_lost() {
    let mut rig = rig(
        RigOptions {
            ring_bytes: 200,
            ..RigOptions::default()
        },
        still,
    );
    let sent: Vec<u8> = (0..=255).collect();
    rig.host_write(&sent);
    let mut waiting = Vec::new();
    for _ in 0..5 {
        rig.step();
        waiting.push((
            rig.inputs().received.len(),
            rig.inputs().waiting,
            rig.inputs().lost_bytes,
        ));
    }
    assert_eq!(
        waiting,
        [
            (64, 136, 56),
            (64, 72, 56),
            (64, 8, 56),
            (8, 0, 56),
            (0, 0, 56)
        ]
    );
    assert_eq!(rig.control().echo, sent[..200]);
    let mut received = Vec::new();
    rig.host_read(&mut received);
    assert!(
        received
            .iter()
            .copied()
            .eq(sent[..200].iter().map(|byte| byte + 1))
    );
}

#[test]
fn the_line_is_paced_to_its_baud_rate() {
    for baud in [9600, 115_200, 1_000_000] {
        let mut rig = rig(
            RigOptions {
                baud: Some(baud),
                ..RigOptions::default()
            },
            still,
        );
        rig.host_write(&[0x55; 500]);
        while rig.control().echo.len() < 500 {
            rig.step();
        }
        let expected = 500.0 * 10.0 / f64::from(baud);
        let took = rig.time_ns() as f64 * 1e-9;
        assert!(
            took >= expected && took < expected + 4.0 * PERIOD,
            "{baud} baud: {took} s, not {expected} s"
        );
    }
}

#[test]
fn the_out_of_band_stop_overtakes_waiting_bytes() {
    let mut rig = rig(
        RigOptions {
            ring_bytes: 300,
            ..RigOptions::default()
        },
        still,
    );
    rig.host_write(&[7; 400]);
    rig.host_write(&[0, 0x18, 0]);
    // The stop is behind 400 bytes, of which some are lost. It is recognised at once, and only
    // once.
    let stops: Vec<bool> = (0..4)
        .map(|_| {
            rig.step();
            rig.inputs().out_of_band_stop
        })
        .collect();
    assert_eq!(stops, [true, false, false, false]);
}

#[test]
fn missed_periods_are_reported_and_keep_the_torque() {
    let mut rig = rig(faults(&["missed-periods count=4 at=10ms"]), swing);
    let mut called = Vec::new();
    for period in 0..60_u64 {
        if rig.step() {
            assert_eq!(rig.inputs().period, period);
            assert_eq!(rig.inputs().missed, if period == 54 { 4 } else { 0 });
            called.push(period);
        }
    }
    assert!((50..54).all(|period| !called.contains(&period)));
    assert_eq!(called.len(), 56);
}

#[test]
fn faults_start_and_end_on_time() {
    let mut rig = rig(
        faults(&[
            "emergency-stop at=2ms for=1ms",
            "drive-tripped joint=l4 at=4ms for=2ms",
            "switch-stuck joint=l2 switch=limit-high active=yes at=1ms",
            "joint-jammed joint=l1 at=20ms",
            "encoder-slip joint=l3 counts=5000 at=5ms",
        ]),
        still,
    );
    for period in 0..50_u64 {
        rig.step();
        let inputs = rig.inputs();
        assert_eq!(
            inputs.emergency_stop,
            (10..15).contains(&period),
            "{period}"
        );
        assert_eq!(
            inputs.joints[3].drive_ready,
            !(10..15).contains(&period) && !(20..30).contains(&period)
        );
        assert_eq!(inputs.joints[1].limit_high, period >= 5);
        assert_eq!(inputs.joints[2].counts > 4000, period >= 25);
    }
}

#[test]
fn a_jammed_slide_stops_and_continues_after_the_fault() {
    let mut rig = rig(faults(&["joint-jammed joint=l1 at=0.5s for=200ms"]), swing);
    let mut stood = Vec::new();
    for period in 0..6000 {
        let before = rig.plant().truth().joints[0];
        rig.step();
        let moves = rig.plant().truth().joints[0] != before;
        // The step in which it is recognised ends after 20 us.
        if (2501..3500).contains(&period) {
            assert!(!moves, "moved at {period}");
        } else if period > 3600 && moves {
            stood.push(period);
        }
    }
    assert!(!stood.is_empty());
}

#[test]
fn an_interrupted_line_is_silent_in_one_direction() {
    let mut rig = rig(faults(&["link-cut direction=to-host at=0s for=1ms"]), still);
    rig.host_write(b"one");
    let mut received = Vec::new();
    for _ in 0..10 {
        rig.step();
        rig.host_read(&mut received);
    }
    assert_eq!(rig.control().echo, b"one");
    assert!(received.is_empty());
    rig.host_write(b"two");
    rig.step();
    rig.step();
    rig.host_read(&mut received);
    assert_eq!(received, b"uxp");
}

#[test]
fn line_errors_have_the_configured_rates() {
    let mut rig = rig(
        faults(&[
            "link-errors rate=1e-3 direction=to-machine",
            "link-duplicate rate=0.02 direction=to-machine",
            "link-drop rate=0.01 direction=to-machine",
        ]),
        still,
    );
    for _ in 0..2000 {
        rig.host_write(&[0; 50]);
        rig.step();
    }
    let count = rig.to_machine().count();
    assert_eq!(count.written, 100_000);
    let near = |value: u64, expected: f64| (value as f64 - expected).abs() < 5.0 * expected.sqrt();
    assert!(near(count.flipped, 0.99 * 800.0), "{count:?}");
    assert!(near(count.dropped, 1000.0), "{count:?}");
    assert!(near(count.duplicated, 0.99 * 2000.0), "{count:?}");
    assert_eq!(rig.to_host().count().flipped, 0);
}

#[test]
fn invalid_faults_are_refused_with_a_message() {
    for (line, part) in [
        ("", "empty"),
        ("slide-jamed joint=l2", "unknown fault `slide-jamed`"),
        ("joint-jammed", "`joint=` is missing"),
        ("joint-jammed joint=", "`joint=` is empty"),
        ("joint-jammed joint=l2 effort=much", "not a number"),
        ("joint-jammed joint=l2 at=3", "must be a time"),
        ("joint-jammed joint=l2 joint=l3", "is a duplicate"),
        ("joint-jammed joint=l2 gain=2", "is not a key"),
        (
            "encoder-stuck joint=l2 channel=c level=low",
            "must be a or b",
        ),
        ("link-cut direction=up", "both or to-machine or to-host"),
        ("link-cut cut", "must be key=value"),
    ] {
        let error = line.parse::<Fault>().expect_err(line).to_string();
        assert!(error.contains(part), "{line}: {error}");
    }
    for line in [
        "drive-dead joint=5",
        "drive-dead joint=0",
        "drive-dead joint=L1",
        "link-errors rate=1.5",
        "joint-jammed joint=l1 effort=-1",
        "drive-weak joint=l1 gain=inf",
        "drive-dead joint=l1 at=-1s",
    ] {
        let options = faults(&[line]);
        assert!(
            Rig::new(&machine::reference(), &options, Idle).is_err(),
            "{line}"
        );
    }
}

#[test]
fn every_field_of_a_plant_is_checked() {
    let mut config = machine::reference();
    config.joint[1].motor_share = 1.0;
    config.joint[2].mode_hz = 20_000.0;
    config.joint[3].preset = 1e4;
    let problems = config.check(200).expect_err("three mistakes");
    assert!(problems.len() >= 3);
    assert!(
        problems[0]
            .to_string()
            .contains("joint 1 (l2): motor_share"),
        "{}",
        problems[0]
    );
    assert!(machine::reference().check(210).is_err());
    let mut config = machine::reference();
    config.joint.pop();
    assert!(
        config.check(200).expect_err("no table")[0]
            .to_string()
            .contains("four linear joints")
    );
}

fn any_direction() -> impl Strategy<Value = Direction> {
    prop_oneof![
        Just(Direction::Both),
        Just(Direction::ToMachine),
        Just(Direction::ToHost)
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    /// A fault and its line of text are equivalent.
    #[test]
    fn faults_and_their_text_are_equivalent(
        joint in "[a-z][a-z0-9]{0,5}",
        number in 0.0..1.0_f64,
        counts: i32,
        direction in any_direction(),
        at_s in 0.0..1000.0_f64,
        for_s in prop::option::of(0.0..1000.0_f64),
        which in 0..9,
    ) {
        let what = match which {
            0 => FaultKind::EncoderSlip { joint, counts },
            1 => FaultKind::LinkErrors { rate: number, direction },
            2 => FaultKind::LinkDelay { ms: number, direction },
            3 => FaultKind::JointJammed { joint, effort: (counts > 0).then_some(number) },
            4 => FaultKind::DriveWeak { joint, gain: -number },
            5 => FaultKind::EmergencyStop,
            6 => FaultKind::LinkCut { direction },
            7 => FaultKind::EncoderNoise { joint, per_second: number },
            _ => FaultKind::MissedPeriods { count: counts.unsigned_abs() },
        };
        let fault = Fault { at_s, for_s, what };
        let read: Fault = fault.to_string().parse().expect("reads back");
        prop_assert_eq!(&read, &fault);
        // The same through a scenario file.
        let file = toml::Value::try_from(&fault).expect("writes");
        prop_assert_eq!(file.try_into::<Fault>().expect("reads"), fault);
    }
}
