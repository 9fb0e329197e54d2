//! Encoders and step drives against the true motion.

use crate::machine;
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs, StepSegment};
use haptimill_firmware::joint::step_gen::{PulseTiming, StepPlanner};
use haptimill_hil_sim::joint::encoder::{Encoder, EncoderCondition, Track};
use haptimill_hil_sim::joint::mechanics::JointArray;
use haptimill_hil_sim::joint::stepper::{PulseProblem, PulseReport};
use haptimill_hil_sim::random::Random;
use haptimill_hil_sim::{Plant, PlantConfig};
use haptimill_math::{Coordinate, Rate};
use proptest::prelude::*;

const STEP_NS: u64 = 20_000;

/// The shaft starts in the middle of a count.
const START: f64 = 0.300625;

/// Returns a random motion of the shaft: ten steps per period, with speeds drawn anew at times.
fn random_motion(seed: u64, periods: usize, speed: f64) -> Vec<[f64; 11]> {
    let mut random = Random::new(seed, 7);
    let (mut at, mut rate) = (START, 0.0);
    (0..periods)
        .map(|_| {
            let mut path = [at; 11];
            for place in &mut path[1..] {
                if random.happens(0.05) {
                    let slow = if random.happens(0.5) { 1e-3 } else { 1.0 };
                    rate = (2.0 * random.fraction() - 1.0) * speed * slow;
                }
                at += rate * 20e-6;
                *place = at;
            }
            path
        })
        .collect()
}

/// Moves the shaft through these samples.
fn follow(encoder: &mut Encoder, path: &[f64], time_ns: u64) {
    let rows: Vec<JointArray> = path
        .iter()
        .map(|&at| [at, 0.0, 0.0, 0.0, 0.0, 0.0])
        .collect();
    let low = path.iter().copied().fold(f64::INFINITY, f64::min);
    let high = path.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    encoder.follow(&Track::new(&rows, 0, low, high), time_ns, STEP_NS);
}

fn encoder(reversed: bool) -> Encoder {
    let mut config = machine::slide();
    let joint = &mut config.joint[0];
    let mut encoder = joint.encoder.clone().expect("an encoder");
    encoder.reversed = reversed;
    encoder.index = 0.2;
    Encoder::new(joint, &encoder, START, Random::new(1, 1))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Counting by states and counting edge by edge through the decoder give the same counter.
    #[test]
    fn counting_by_states_and_by_edges_agrees(seed: u64, reversed: bool, speed in 1.0..2000.0_f64) {
        let mut direct = encoder(reversed);
        let mut edges = encoder(reversed);
        edges.set_condition(EncoderCondition { index_missing: true, ..EncoderCondition::default() });
        edges.set_condition(EncoderCondition::default());
        for (period, path) in random_motion(seed, 500, speed).iter().enumerate() {
            let now = period as u64 * 200_000;
            follow(&mut direct, path, now);
            follow(&mut edges, path, now);
            prop_assert_eq!(direct.reading(), edges.reading());
            prop_assert_eq!(edges.reading().illegal, 0);
        }
    }

    /// The counter is the true position to the count.
    #[test]
    fn the_counter_is_the_true_position(seed: u64, reversed: bool, speed in 1.0..2000.0_f64) {
        let mut encoder = encoder(reversed);
        let per_count = 10.0 / 8000.0;
        for (period, path) in random_motion(seed, 500, speed).iter().enumerate() {
            follow(&mut encoder, path, period as u64 * 200_000);
            let sign = if reversed { -1.0 } else { 1.0 };
            let measured = sign * f64::from(encoder.reading().counts) * per_count;
            prop_assert!((measured - (path[10] - START)).abs() <= per_count * 1.000_001);
        }
    }

    /// Edge times are those of the crossings: at constant speed they are equally spaced.
    #[test]
    fn edge_times_give_the_speed(speed in 0.5..60.0_f64) {
        let mut encoder = encoder(false);
        let (mut at, mut first, mut last) = (START, None, (0, 0));
        for period in 0..2000_u64 {
            let path: Vec<f64> = (0..=10).map(|step| at + speed * 20e-6 * f64::from(step)).collect();
            at = path[10];
            follow(&mut encoder, &path, period * 200_000);
            let reading = encoder.reading();
            if reading.counts > 0 {
                last = (reading.counts, reading.edge_time_ns);
                first.get_or_insert(last);
            }
        }
        let first = first.expect("moves");
        prop_assume!(last.0 > first.0);
        let measured = f64::from(last.0 - first.0) * (10.0 / 8000.0) / (f64::from(last.1 - first.1) * 1e-9);
        // A nanosecond at either end.
        let bound = 3.0 / f64::from(last.1 - first.1);
        prop_assert!((measured / speed - 1.0).abs() < bound + 1e-9, "{} {}", measured, speed);
    }

    /// The index latches the same count in either direction and at any speed.
    #[test]
    fn the_index_pulse_repeats_to_the_count(speeds in prop::collection::vec(0.1..300.0_f64, 1..12)) {
        let mut encoder = encoder(false);
        let (mut at, mut time, mut pulses) = (START, 0, 0);
        let mut latched = None;
        // Back and forth across the index at 0.2.
        for (turn, speed) in speeds.iter().enumerate() {
            let target = if turn % 2 == 0 { 0.1 } else { 0.3 };
            let direction = if turn % 2 == 0 { -1.0 } else { 1.0 };
            while (target - at) * direction > 0.0 {
                let path: Vec<f64> = (0..=10).map(|step| at + direction * speed * 20e-6 * f64::from(step)).collect();
                at = path[10];
                follow(&mut encoder, &path, time);
                time += 200_000;
            }
            pulses += 1;
            let reading = encoder.reading();
            prop_assert_eq!(reading.index_pulses, pulses);
            let counts = *latched.get_or_insert(reading.index_counts);
            prop_assert_eq!(reading.index_counts, counts);
        }
    }

    /// Any plan within the data sheet is emitted to the step and followed within the lag of the
    /// field.
    #[test]
    fn pulses_within_the_data_sheet_are_all_counted(segments in prop::collection::vec((-3_i16..=3, 100_u32..400), 1..60)) {
        let mut plant = Plant::new(&machine::stepped_slide(), 200).expect("a slide");
        let mut expected = 0_i32;
        let pulses = segments.iter().map(|&(count, delay)| StepSegment { count, delay, interval: 900, ramp: -3 });
        for segment in pulses.chain(std::iter::repeat_n(StepSegment::default(), 3000)) {
            expected += i32::from(segment.count);
            steps(&mut plant, segment);
        }
        prop_assert_eq!(report(&plant).violations, 0);
        let mut inputs = Inputs::default();
        plant.latch(&mut inputs);
        prop_assert_eq!(inputs.joints[0].steps, expected);
        // At standstill the field holds 20 N of friction: asin(20 / 1200) of an electrical turn of
        // 0.2 mm is 0.5 um.
        let lag = plant.bodies().motor[0] - f64::from(expected) * 10.0 / 3200.0;
        prop_assert!(lag.abs() < 0.0015, "{}", lag);
    }

    /// Pulses that were seen on the line of a board are all emitted in their period, those at its
    /// first and last moment too, and the motor follows them.
    #[test]
    fn seen_pulses_are_all_counted_in_their_period(
        times in prop::collection::vec(
            (prop_oneof![0_u64..=200_000, Just(0), Just(199_999), Just(200_000)], any::<bool>()),
            1..60,
        ),
    ) {
        let mut plant = Plant::new(&machine::stepped_slide(), 200).expect("a slide");
        let emitted = |plant: &Plant| {
            let mut inputs = Inputs::default();
            plant.latch(&mut inputs);
            inputs.joints[0].steps
        };
        let mut expected = 0_i32;
        for (time_ns, up) in times {
            plant.add_pulse(0, time_ns, up);
            expected += if up { 1 } else { -1 };
            steps(&mut plant, StepSegment::default());
            prop_assert_eq!(emitted(&plant), expected);
        }
        for _ in 0..3000 {
            steps(&mut plant, StepSegment::default());
        }
        let lag = plant.bodies().motor[0] - f64::from(expected) * 10.0 / 3200.0;
        prop_assert!(lag.abs() < 0.0015, "{}", lag);
    }
}

fn steps(plant: &mut Plant, segment: StepSegment) {
    let mut outputs = Outputs::default();
    outputs.joints[0] = DriveCommand::Steps(segment);
    plant.advance(&outputs);
}

fn report(plant: &Plant) -> PulseReport {
    plant.pulse_report(0).expect("a step drive")
}

#[test]
fn a_stuck_channel_counts_nothing_and_swapped_channels_count_backwards() {
    let path: Vec<f64> = (0..=10)
        .map(|step| START + 0.01 * f64::from(step))
        .collect();
    let reading = |condition: EncoderCondition| {
        let mut encoder = encoder(false);
        encoder.set_condition(condition);
        follow(&mut encoder, &path, 0);
        encoder.reading()
    };
    let healthy = reading(EncoderCondition::default());
    assert_eq!(healthy.counts, 80);
    for level in [false, true] {
        let stuck = reading(EncoderCondition {
            stuck_a: Some(level),
            ..EncoderCondition::default()
        });
        assert!(stuck.counts.abs() <= 1, "{stuck:?}");
        let stuck = reading(EncoderCondition {
            stuck_b: Some(level),
            ..EncoderCondition::default()
        });
        assert!(stuck.counts.abs() <= 1, "{stuck:?}");
    }
    let swapped = reading(EncoderCondition {
        swapped: true,
        ..EncoderCondition::default()
    });
    assert!((swapped.counts + 80).abs() <= 2, "{swapped:?}");
    let noisy = reading(EncoderCondition {
        noise_hz: 49_000.0,
        ..EncoderCondition::default()
    });
    assert!(
        noisy.illegal > 0 && (noisy.counts - 80).abs() <= 2,
        "{noisy:?}"
    );
}

#[test]
fn a_slip_moves_the_counter_in_both_ways_of_counting() {
    for edges in [false, true] {
        let mut encoder = encoder(true);
        if edges {
            encoder.set_condition(EncoderCondition {
                index_missing: true,
                ..EncoderCondition::default()
            });
        }
        follow(&mut encoder, &[START, START + 0.01], 0);
        encoder.slip(100);
        follow(&mut encoder, &[START + 0.01, START + 0.02], STEP_NS);
        assert_eq!(encoder.reading().counts, 100 - 16);
    }
}

#[test]
fn violations_of_the_data_sheet_are_reported() {
    let fresh = || Plant::new(&machine::stepped_slide(), 200).expect("a slide");
    let first = |plant: &Plant| report(plant).first.map(|violation| violation.problem);
    // 16 ticks per us: 2 us pulse + 1 us pause = 48 ticks; 80 ticks set-up and hold; 3200 ticks a
    // period.
    let mut plant = fresh();
    steps(
        &mut plant,
        StepSegment {
            count: 20,
            delay: 0,
            interval: 48,
            ramp: 0,
        },
    );
    assert_eq!(report(&plant).violations, 0);
    assert_eq!(report(&plant).shortest_interval, Some(48));
    steps(
        &mut plant,
        StepSegment {
            count: 20,
            delay: 0,
            interval: 47,
            ramp: 0,
        },
    );
    assert_eq!(
        (report(&plant).violations, first(&plant)),
        (19, Some(PulseProblem::Interval))
    );

    // The last pulse of one period and the first of the next.
    let mut plant = fresh();
    steps(
        &mut plant,
        StepSegment {
            count: 1,
            delay: 3168,
            interval: 0,
            ramp: 0,
        },
    );
    steps(
        &mut plant,
        StepSegment {
            count: 1,
            delay: 15,
            interval: 0,
            ramp: 0,
        },
    );
    assert_eq!(first(&plant), Some(PulseProblem::Interval));

    let mut plant = fresh();
    steps(
        &mut plant,
        StepSegment {
            count: -1,
            delay: 79,
            interval: 0,
            ramp: 0,
        },
    );
    assert_eq!(first(&plant), Some(PulseProblem::Setup));
    let mut plant = fresh();
    steps(
        &mut plant,
        StepSegment {
            count: -1,
            delay: 80,
            interval: 0,
            ramp: 0,
        },
    );
    assert_eq!(first(&plant), None);

    let mut plant = fresh();
    steps(
        &mut plant,
        StepSegment {
            count: 1,
            delay: 3089,
            interval: 0,
            ramp: 0,
        },
    );
    steps(
        &mut plant,
        StepSegment {
            count: -1,
            delay: 200,
            interval: 0,
            ramp: 0,
        },
    );
    assert_eq!(first(&plant), Some(PulseProblem::Hold));

    let mut plant = fresh();
    steps(
        &mut plant,
        StepSegment {
            count: 3,
            delay: 100,
            interval: 1550,
            ramp: 0,
        },
    );
    assert_eq!(
        (report(&plant).violations, first(&plant)),
        (1, Some(PulseProblem::BeyondPeriod))
    );
    let mut inputs = Inputs::default();
    plant.latch(&mut inputs);
    assert_eq!(inputs.joints[0].steps, 2);
}

/// Drives a slide at `rate` steps per period for `periods`. Returns the distance to its target.
fn sent_and_missed(config: &PlantConfig, rate: i16, periods: usize, load: f64) -> f64 {
    let mut plant = Plant::new(config, 200).expect("a slide");
    plant.set_load(0, load);
    let interval = if rate == 0 {
        0
    } else {
        3200 / u32::from(rate.unsigned_abs())
    };
    for _ in 0..periods {
        steps(
            &mut plant,
            StepSegment {
                count: rate,
                delay: 0,
                interval,
                ramp: 0,
            },
        );
    }
    plant.set_load(0, 0.0);
    for _ in 0..5000 {
        steps(&mut plant, StepSegment::default());
    }
    plant.bodies().motor[0] - f64::from(rate) * periods as f64 * 10.0 / 3200.0
}

#[test]
fn steps_are_lost_only_above_the_pull_out_torque() {
    let config = machine::stepped_slide();
    // One step per period is 15.6 mm/s: the slide starts at once. It keeps up against 600 N, and
    // not against 1400 N.
    assert!(sent_and_missed(&config, 1, 500, -600.0).abs() < 0.002);
    let missed = sent_and_missed(&config, 1, 500, -1400.0);
    let tooth = 4.0 * 10.0 / 200.0;
    assert!(missed < -tooth / 2.0, "{missed}");
    assert!(
        (missed / tooth - (missed / tooth).round()).abs() < 0.02,
        "whole electrical turns: {missed}"
    );
    // 40 kg cannot start at 312 mm/s.
    let missed = sent_and_missed(&config, 20, 100, 0.0);
    assert!(missed < -10.0 * tooth, "{missed}");
    assert!((missed / tooth - (missed / tooth).round()).abs() < 0.02);
}

/// The pulses that the firmware plans, checked against the drive's data sheet and on the motor.
#[test]
fn planned_pulses_obey_the_data_sheet_and_move_the_slide() {
    let mut plant = Plant::new(&machine::stepped_slide(), 200).expect("a slide");
    // 16 ticks per us. The pause of the planner is as long as its pulse: 2 us.
    let timing = PulseTiming {
        period: 3200,
        pulse: 32,
        setup: 80,
        hold: 80,
    };
    let unit = f64::from(1 << 20);
    let per_step = (10.0 / 3200.0 * unit * f64::from(1 << 24)).round() as i64;
    let mut planner = StepPlanner::new(AxisKind::Linear, per_step, timing, 200);
    let (mut worst, mut steps_sent) = (0.0_f64, 0_i64);
    for period in 1..25_000 {
        let phase = f64::from(period) * 200e-6 * 2.0;
        // Back and forth by 3 mm at up to 6 mm/s, starting without jerk.
        let soft = 1.0 - (-phase).exp() * (1.0 + phase);
        let (expected, rate) = (3.0 * soft * phase.sin(), 6.0 * soft * phase.cos());
        let planned = planner.plan(
            Coordinate((expected * unit) as i32),
            Rate((rate * unit) as i32),
        );
        steps_sent += i64::from(planned.segment.count);
        steps(&mut plant, planned.segment);
        worst = worst.max((plant.bodies().motor[0] - expected).abs());
    }
    assert_eq!(report(&plant).violations, 0, "{:?}", report(&plant));
    let mut inputs = Inputs::default();
    plant.latch(&mut inputs);
    assert_eq!(i64::from(inputs.joints[0].steps), steps_sent);
    assert!(steps_sent != 0);
    // Half a step of 3.1 um, friction and acceleration on the field's stiffness of 38 N/um: well
    // below 10 um.
    assert!(worst < 0.010, "{worst}");
}
