//! Monitors of joints: following error, stroke, runaway, dead and stuck encoders, lost steps.

use crate::joint::{slide, steps, torque};
use crate::reference;
use haptimill_firmware::config::{AxisKind, Drive, EncoderSettings, JointSettings};
use haptimill_firmware::joint::monitor::{JointMonitor, JointSample};
use haptimill_math::{Coordinate, Effort, Rate};
use haptimill_protocol::message::Fault;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use reference::{degrees, h4, mm};

const LIMIT: u16 = 8;

fn newtons(force: f64) -> Effort {
    Effort((force * 65536.0) as i32)
}

/// The encoder of a joint.
fn encoder(joint: &mut JointSettings) -> &mut EncoderSettings {
    joint.encoder.as_mut().expect("an encoder")
}

/// A slide and a sample of it without a fault: standstill at 100 mm.
fn resting_slide() -> (JointSettings, JointSample) {
    let mut joint = h4().joints[0].clone();
    (joint.low, joint.high) = (Coordinate(mm(-1000.0)), Coordinate(mm(1000.0)));
    let seen = JointSample {
        commanded: Coordinate(mm(100.0)),
        measured: Coordinate(mm(100.0)),
        period_us: 200,
        placed: true,
        ..JointSample::default()
    };
    (joint, seen)
}

/// First fault of a monitor that gets the same sample for some periods.
fn look(
    monitor: &mut JointMonitor,
    joint: &JointSettings,
    seen: &JointSample,
    periods: usize,
) -> Option<Fault> {
    let encoder = joint.encoder.as_ref().expect("an encoder");
    (0..periods).find_map(|_| monitor.check(2, joint, encoder, LIMIT, seen))
}

#[test]
fn following_error_limit_grows_with_the_commanded_rate() {
    let (mut settings, seen) = resting_slide();
    let limits = encoder(&mut settings).clone();
    let limit = |speed: f64| {
        f64::from(limits.following.0)
            + f64::from(mm(speed)) * f64::from(limits.following_lag) / 65536.0
    };
    for speed in [0.0, 1.0, 20.0, -20.0, 100.0] {
        let max = limit(f64::abs(speed)) as i32;
        for (error, faulty) in [
            (max - 2, false),
            (max + 2, true),
            (2 - max, false),
            (-2 - max, true),
        ] {
            let seen = JointSample {
                commanded_rate: Rate(mm(speed)),
                rate: Rate(mm(speed)),
                measured: Coordinate(seen.commanded.0 - error),
                ..seen
            };
            let fault = look(&mut JointMonitor::default(), &settings, &seen, 1);
            let reported = matches!(fault, Some(Fault::FollowingError { joint: 2, error: reported, limit }) if reported == error && (limit - max).abs() <= 1);
            assert_eq!(reported, faulty, "{speed} {error} {fault:?}");
            assert_eq!(fault.is_some(), faulty);
        }
    }
}

/// Beyond its stroke a joint may exceed the limit of the following error at standstill at no rate.
#[test]
fn stroke_fault_reports_the_excess() {
    let (mut settings, seen) = resting_slide();
    let following = encoder(&mut settings).following.0;
    for (end, sign) in [(settings.high.0, 1), (settings.low.0, -1)] {
        for (beyond, faulty) in [(0, false), (following, false), (following + 1, true)] {
            let seen = JointSample {
                commanded: Coordinate(end),
                commanded_rate: Rate(mm(100.0) * sign),
                rate: Rate(mm(100.0) * sign),
                measured: Coordinate(end + sign * beyond),
                ..seen
            };
            let fault = look(&mut JointMonitor::default(), &settings, &seen, 3);
            let by = sign * beyond;
            assert_eq!(fault, faulty.then_some(Fault::Stroke { joint: 2, by }));
        }
    }
}

#[test]
fn rotary_following_error_takes_the_short_way() {
    let (mut settings, seen) = resting_slide();
    settings.kind = AxisKind::Rotary;
    (settings.low, settings.high) = (Coordinate(i32::MIN), Coordinate(i32::MAX));
    encoder(&mut settings).following = Coordinate(degrees(0.2));
    encoder(&mut settings).stuck_distance = Coordinate(degrees(0.1));
    let across = |off: f64| JointSample {
        commanded: Coordinate(i32::MAX),
        measured: Coordinate(i32::MAX.wrapping_add(degrees(off))),
        ..seen
    };
    assert_eq!(
        look(&mut JointMonitor::default(), &settings, &across(0.15), 10),
        None
    );
    assert!(look(&mut JointMonitor::default(), &settings, &across(0.25), 10).is_some());
    // Turning on through the end of the range is motion like any other.
    let mut monitor = JointMonitor::default();
    for step in 0..200 {
        let place = Coordinate((i32::MAX - 50 * 100_000).wrapping_add(step * 100_000));
        let seen = JointSample {
            commanded: place,
            measured: place,
            ..seen
        };
        assert_eq!(look(&mut monitor, &settings, &seen, 1), None, "{step}");
    }
}

#[test]
fn runaway_is_detected_a_driven_joint_is_not() {
    let (settings, seen) = resting_slide();
    // 50/s times the 0.5 mm of following error at standstill: 25 mm/s.
    let running = |rate: f64, force: f64| JointSample {
        rate: Rate(mm(rate)),
        effort: newtons(force),
        ..seen
    };
    for sign in [1.0, -1.0] {
        let fault = look(
            &mut JointMonitor::default(),
            &settings,
            &running(sign * 26.0, -sign * 200.0),
            4,
        );
        assert_eq!(fault, Some(Fault::EncoderReversed { joint: 2 }));
        // Three periods are not enough, nor is a push with the motion, a weak push, or a slow
        // motion.
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &settings,
                &running(sign * 26.0, -sign * 200.0),
                3
            ),
            None
        );
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &settings,
                &running(sign * 26.0, sign * 200.0),
                50
            ),
            None
        );
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &settings,
                &running(sign * 26.0, -sign * 60.0),
                50
            ),
            None
        );
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &settings,
                &running(sign * 24.0, -sign * 200.0),
                50
            ),
            None
        );
    }
}

/// Following error at which the encoder of a slide is found dead that stopped counting at `last`,
/// mm. Its command goes on at `speed` (mm/s), and the loop pushes as 40 kg and 40,000 1/s^2 say:
/// 1.6 N a micrometre.
fn dead_encoder_found_at(
    monitor: &mut JointMonitor,
    joint: &JointSettings,
    last: &JointSample,
    speed: f64,
) -> f64 {
    let found = (0..10_000).find_map(|period| {
        let off = f64::from(period) * speed * 2e-4;
        let seen = JointSample {
            commanded: Coordinate(last.commanded.0 + mm(off)),
            commanded_rate: Rate(mm(speed)),
            effort: Effort(last.effort.0 + newtons(off * 1600.0).0),
            ..*last
        };
        look(monitor, joint, &seen, 1).map(|fault| (fault, off))
    });
    let Some((Fault::EncoderStuck { joint: 2 }, off)) = found else {
        panic!("{found:?}")
    };
    off
}

#[test]
fn stuck_encoder_is_detected_a_static_load_is_not() {
    let (settings, seen) = resting_slide();
    // 300 N against a load, at rest: for ever.
    let mut monitor = JointMonitor::default();
    let loaded = JointSample {
        effort: newtons(300.0),
        ..seen
    };
    assert_eq!(look(&mut monitor, &settings, &loaded, 20_000), None);
    // The same while it creeps with a count now and then.
    for period in 0..20_000 {
        let place = seen.commanded.0 + period * mm(2e-4);
        let counted = Coordinate(place - place % mm(1.25e-3));
        let seen = JointSample {
            commanded: Coordinate(place),
            measured: counted,
            commanded_rate: Rate(mm(1.0)),
            ..loaded
        };
        assert_eq!(look(&mut monitor, &settings, &seen, 1), None, "{period}");
    }
    // From there on the encoder is dead.
    let at = Coordinate(seen.commanded.0 + 19_999 * mm(2e-4));
    let last = JointSample {
        commanded: at,
        measured: at,
        ..loaded
    };
    let off = dead_encoder_found_at(&mut monitor, &settings, &last, 1.0);
    // Long before the following error (0.5 mm) would say it.
    assert!(off < 0.06, "{off} mm");
}

/// The effort that accelerates a motor across the lost motion is no friction: a dead encoder is
/// found as soon as without a crossing before.
#[test]
fn the_effort_of_a_crossing_does_not_hide_a_dead_encoder() {
    let (settings, seen) = resting_slide();
    let found_at = |crossing: f64| {
        let mut monitor = JointMonitor::default();
        for period in 0..200 {
            let place = Coordinate(seen.commanded.0 + period * mm(2e-3));
            let seen = JointSample {
                commanded: place,
                measured: place,
                commanded_rate: Rate(mm(10.0)),
                effort: newtons(20.0 + crossing),
                crossing: newtons(crossing),
                ..seen
            };
            assert_eq!(look(&mut monitor, &settings, &seen, 1), None);
        }
        let at = Coordinate(seen.commanded.0 + 199 * mm(2e-3));
        let last = JointSample {
            commanded: at,
            measured: at,
            effort: newtons(20.0),
            ..seen
        };
        dead_encoder_found_at(&mut monitor, &settings, &last, 0.2)
    };
    assert_eq!(found_at(120.0), found_at(0.0));
}

#[test]
fn illegal_transitions_and_lost_steps_have_limits() {
    let (mut settings, seen) = resting_slide();
    let illegal = |count| JointSample {
        illegal: count,
        ..seen
    };
    assert_eq!(
        look(&mut JointMonitor::default(), &settings, &illegal(LIMIT), 1),
        None
    );
    assert_eq!(
        look(
            &mut JointMonitor::default(),
            &settings,
            &illegal(LIMIT + 1),
            1
        ),
        Some(Fault::EncoderIllegal {
            joint: 2,
            count: LIMIT + 1
        })
    );
    settings.drive = Drive::Steps {
        per_step: 1 << 30,
        ticks_per_us: 16,
        pulse: 16,
        setup: 16,
        hold: 16,
        lost: Coordinate(mm(0.05)),
        chip: None,
    };
    for (by, lost) in [
        (0.049, false),
        (0.051, true),
        (-0.049, false),
        (-0.051, true),
    ] {
        let fault = look(
            &mut JointMonitor::default(),
            &settings,
            &JointSample {
                step_error: Coordinate(mm(by)),
                ..seen
            },
            1,
        );
        assert_eq!(
            fault,
            lost.then_some(Fault::StepsLost {
                joint: 2,
                by: mm(by)
            })
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(21), failure_persistence: None, ..ProptestConfig::default() })]

    /// No sample and no configuration overflows the monitor.
    #[test]
    fn joint_monitor_accepts_any_sample(sights in prop::collection::vec(any::<[i32; 7]>(), 1..20), numbers: [i32; 4], inertia: u32, per_count: i64, rotary: bool, period_us: u16) {
        let (mut settings, _) = resting_slide();
        settings.kind = if rotary { AxisKind::Rotary } else { AxisKind::Linear };
        encoder(&mut settings).following = Coordinate(numbers[0]);
        encoder(&mut settings).following_lag = numbers[1].unsigned_abs();
        encoder(&mut settings).stuck_distance = Coordinate(numbers[2]);
        settings.law.coulomb = Effort(numbers[3]);
        settings.law.inertia = inertia;
        encoder(&mut settings).per_count = per_count;
        let mut monitor = JointMonitor::default();
        for sight in sights {
            let seen = JointSample {
                commanded: Coordinate(sight[0]),
                commanded_rate: Rate(sight[1]),
                measured: Coordinate(sight[2]),
                rate: Rate(sight[3]),
                moved: sight[6],
                effort: Effort(sight[4]),
                crossing: Effort(sight[3]),
                illegal: 0,
                step_error: Coordinate(sight[5]),
                period_us,
                missed: false,
                placed: true,
            };
            let encoder = settings.encoder.clone().expect("an encoder");
            let _ = monitor.check(0, &settings, &encoder, LIMIT, &seen);
            let _ = JointMonitor::check_steps(0, &settings, &seen);
        }
    }
}

/// The rotor of a step motor resonates about the position of its steps, by a count at 2.5 kHz: no
/// stuck channel while the steps rest or creep. A count that reverses about one position while the
/// steps move on is one.
#[test]
fn a_resonating_rotor_is_no_stuck_channel() {
    let settings = slide(steps(), 0.0);
    let encoder = settings.encoder.clone().expect("an encoder");
    let count = (encoder.per_count >> 24) as i32;
    let fault = |steps_per_period: f64| {
        let mut monitor = JointMonitor::default();
        (0..400).find_map(|period| {
            let up = period % 2;
            let measured = Coordinate((100 << 20) + up * count);
            let travel = (steps_per_period * f64::from(period * count)) as i32;
            let steps = Coordinate((100 << 20) + travel);
            let sample = JointSample {
                commanded: steps,
                measured,
                moved: 2 * up - 1,
                step_error: steps.wrapping_sub(measured),
                period_us: 200,
                placed: true,
                ..JointSample::default()
            };
            monitor.check_stuck_channel(1, &settings, &encoder, &sample)
        })
    };
    assert_eq!(fault(0.0), None);
    assert_eq!(fault(0.01), None);
    assert_eq!(fault(0.2), Some(Fault::EncoderStuck { joint: 1 }));
}

/// A slide with an effort of -60 N against its new direction moves on by two counts while its loop
/// reverses the effort, and then sticks at 80 N for 40 ms: friction, no dead encoder. If the same
/// efforts give no count at all, the encoder is dead.
#[test]
fn a_slide_that_moves_on_after_a_reversal_has_a_live_encoder() {
    let settings = slide(torque(), 0.0);
    let encoder = settings.encoder.clone().expect("an encoder");
    let count = (encoder.per_count >> 24) as i32;
    let fault = |against: &[usize]| {
        let mut monitor = JointMonitor::default();
        let mut measured = 100 << 20;
        (0..200).find_map(|period| {
            let moved = -i32::from(against.contains(&period));
            measured += moved * count;
            let force = (-60.0 + 20.0 * period as f64).min(80.0);
            let sample = JointSample {
                commanded: Coordinate((100 << 20) + period as i32 * 10),
                commanded_rate: Rate(100_000),
                measured: Coordinate(measured),
                moved,
                effort: newtons(force),
                period_us: 200,
                placed: true,
                ..JointSample::default()
            };
            monitor.check(1, &settings, &encoder, 0, &sample)
        })
    };
    assert_eq!(fault(&[2, 6]), None);
    assert_eq!(fault(&[]), Some(Fault::EncoderStuck { joint: 1 }));
}
