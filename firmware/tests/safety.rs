//! Joint monitors, latched faults, and the queue in its worst case.

use crate::reference;
use haptimill_firmware::config::{AxisKind, Drive, EncoderSettings, JointSettings, Stopping};
use haptimill_firmware::joint::monitor::{JointMonitor, JointSample};
use haptimill_firmware::motion::interpolator::{FULL_FACTOR, Interpolator, QUEUE};
use haptimill_firmware::safety::{EVENTS, Safety, decelerates_first, keeps_position};
use haptimill_kinematics::Pose;
use haptimill_math::{Coordinate, Effort, Rate};
use haptimill_protocol::message::{
    Action, Event, Fault, HomingProblem, MAX_AXES, PoseError, Refusal, State,
};
use haptimill_protocol::setpoint::Setpoint;
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
fn slide() -> (JointSettings, JointSample) {
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
    let (mut axis, seen) = slide();
    let limits = encoder(&mut axis).clone();
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
            let fault = look(&mut JointMonitor::default(), &axis, &seen, 1);
            let reported = matches!(fault, Some(Fault::FollowingError { joint: 2, error: reported, limit }) if reported == error && (limit - max).abs() <= 1);
            assert_eq!(reported, faulty, "{speed} {error} {fault:?}");
            assert_eq!(fault.is_some(), faulty);
        }
    }
}

/// Beyond its stroke a joint may exceed the limit of the following error at standstill at no rate.
#[test]
fn stroke_fault_reports_the_excess() {
    let (mut axis, seen) = slide();
    let following = encoder(&mut axis).following.0;
    for (end, sign) in [(axis.high.0, 1), (axis.low.0, -1)] {
        for (beyond, faulty) in [(0, false), (following, false), (following + 1, true)] {
            let seen = JointSample {
                commanded: Coordinate(end),
                commanded_rate: Rate(mm(100.0) * sign),
                rate: Rate(mm(100.0) * sign),
                measured: Coordinate(end + sign * beyond),
                ..seen
            };
            let fault = look(&mut JointMonitor::default(), &axis, &seen, 3);
            let by = sign * beyond;
            assert_eq!(fault, faulty.then_some(Fault::Stroke { joint: 2, by }));
        }
    }
}

#[test]
fn rotary_following_error_takes_the_short_way() {
    let (mut axis, seen) = slide();
    axis.kind = AxisKind::Rotary;
    (axis.low, axis.high) = (Coordinate(i32::MIN), Coordinate(i32::MAX));
    encoder(&mut axis).following = Coordinate(degrees(0.2));
    encoder(&mut axis).stuck_distance = Coordinate(degrees(0.1));
    let across = |off: f64| JointSample {
        commanded: Coordinate(i32::MAX),
        measured: Coordinate(i32::MAX.wrapping_add(degrees(off))),
        ..seen
    };
    assert_eq!(
        look(&mut JointMonitor::default(), &axis, &across(0.15), 10),
        None
    );
    assert!(look(&mut JointMonitor::default(), &axis, &across(0.25), 10).is_some());
    // Turning on through the end of the range is motion like any other.
    let mut monitor = JointMonitor::default();
    for step in 0..200 {
        let place = Coordinate((i32::MAX - 50 * 100_000).wrapping_add(step * 100_000));
        let seen = JointSample {
            commanded: place,
            measured: place,
            ..seen
        };
        assert_eq!(look(&mut monitor, &axis, &seen, 1), None, "{step}");
    }
}

#[test]
fn runaway_is_detected_a_driven_joint_is_not() {
    let (axis, seen) = slide();
    // 50/s times the 0.5 mm of following error at standstill: 25 mm/s.
    let running = |rate: f64, force: f64| JointSample {
        rate: Rate(mm(rate)),
        effort: newtons(force),
        ..seen
    };
    for sign in [1.0, -1.0] {
        let fault = look(
            &mut JointMonitor::default(),
            &axis,
            &running(sign * 26.0, -sign * 200.0),
            4,
        );
        assert_eq!(fault, Some(Fault::EncoderReversed { joint: 2 }));
        // Three periods are not enough, nor is a push with the motion, a weak push, or a slow
        // motion.
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &axis,
                &running(sign * 26.0, -sign * 200.0),
                3
            ),
            None
        );
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &axis,
                &running(sign * 26.0, sign * 200.0),
                50
            ),
            None
        );
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &axis,
                &running(sign * 26.0, -sign * 60.0),
                50
            ),
            None
        );
        assert_eq!(
            look(
                &mut JointMonitor::default(),
                &axis,
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
    let (axis, seen) = slide();
    // 300 N against a load, at rest: for ever.
    let mut monitor = JointMonitor::default();
    let loaded = JointSample {
        effort: newtons(300.0),
        ..seen
    };
    assert_eq!(look(&mut monitor, &axis, &loaded, 20_000), None);
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
        assert_eq!(look(&mut monitor, &axis, &seen, 1), None, "{period}");
    }
    // From there on the encoder is dead.
    let at = Coordinate(seen.commanded.0 + 19_999 * mm(2e-4));
    let last = JointSample {
        commanded: at,
        measured: at,
        ..loaded
    };
    let off = dead_encoder_found_at(&mut monitor, &axis, &last, 1.0);
    // Long before the following error (0.5 mm) would say it.
    assert!(off < 0.06, "{off} mm");
}

/// The effort that accelerates a motor across the lost motion is no friction: a dead encoder is
/// found as soon as without a crossing before.
#[test]
fn the_effort_of_a_crossing_does_not_hide_a_dead_encoder() {
    let (axis, seen) = slide();
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
            assert_eq!(look(&mut monitor, &axis, &seen, 1), None);
        }
        let at = Coordinate(seen.commanded.0 + 199 * mm(2e-3));
        let last = JointSample {
            commanded: at,
            measured: at,
            effort: newtons(20.0),
            ..seen
        };
        dead_encoder_found_at(&mut monitor, &axis, &last, 0.2)
    };
    assert_eq!(found_at(120.0), found_at(0.0));
}

#[test]
fn illegal_transitions_and_lost_steps_have_limits() {
    let (mut axis, seen) = slide();
    let illegal = |count| JointSample {
        illegal: count,
        ..seen
    };
    assert_eq!(
        look(&mut JointMonitor::default(), &axis, &illegal(LIMIT), 1),
        None
    );
    assert_eq!(
        look(&mut JointMonitor::default(), &axis, &illegal(LIMIT + 1), 1),
        Some(Fault::EncoderIllegal {
            joint: 2,
            count: LIMIT + 1
        })
    );
    axis.drive = Drive::Steps {
        per_step: 1 << 30,
        ticks_per_us: 16,
        pulse: 16,
        setup: 16,
        hold: 16,
        lost: Coordinate(mm(0.05)),
        tmc2209: None,
    };
    for (by, lost) in [
        (0.049, false),
        (0.051, true),
        (-0.049, false),
        (-0.051, true),
    ] {
        let fault = look(
            &mut JointMonitor::default(),
            &axis,
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
        let (mut axis, _) = slide();
        axis.kind = if rotary { AxisKind::Rotary } else { AxisKind::Linear };
        encoder(&mut axis).following = Coordinate(numbers[0]);
        encoder(&mut axis).following_lag = numbers[1].unsigned_abs();
        encoder(&mut axis).stuck_distance = Coordinate(numbers[2]);
        axis.law.coulomb = Effort(numbers[3]);
        axis.law.inertia = inertia;
        encoder(&mut axis).per_count = per_count;
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
            let encoder = axis.encoder.clone().expect("an encoder");
            let _ = monitor.check(0, &axis, &encoder, LIMIT, &seen);
            let _ = JointMonitor::check_steps(0, &axis, &seen);
        }
    }
}

fn every_fault() -> [Fault; 17] {
    [
        Fault::Stroke { joint: 2, by: -9 },
        Fault::FollowingError {
            joint: 0,
            error: 1,
            limit: 0,
        },
        Fault::SoftLimit { coordinate: 0 },
        Fault::Pose(PoseError::Geometry { code: 2 }),
        Fault::LimitSwitch { joint: 0 },
        Fault::Drive { joint: 0 },
        Fault::EncoderIllegal { joint: 0, count: 9 },
        Fault::CounterJump {
            joint: 0,
            counts: 900,
        },
        Fault::EncoderSlip {
            joint: 0,
            counts: -9,
        },
        Fault::EncoderStuck { joint: 0 },
        Fault::EncoderReversed { joint: 0 },
        Fault::StepsLost { joint: 0, by: 1 },
        Fault::LostHost { silent_ms: 501 },
        Fault::Configuration,
        Fault::MissedPeriods { missed: 3 },
        Fault::Homing {
            joint: 0,
            problem: HomingProblem::NoIndex,
        },
        Fault::Internal { line: 1 },
    ]
}

fn in_state(state: State) -> Safety {
    let mut safety = Safety::default();
    safety.set_homed(true);
    safety.enter(state);
    safety
}

/// Missed periods cause following errors, which are reported as such while the machine decelerates.
/// An invalid counter is still a fault of its own.
#[test]
fn missed_periods_explain_their_following_errors() {
    let missed = Fault::MissedPeriods { missed: 50 };
    for other in every_fault() {
        let led_to = matches!(
            other,
            Fault::FollowingError { .. }
                | Fault::EncoderStuck { .. }
                | Fault::EncoderReversed { .. }
        );
        let mut safety = in_state(State::Run);
        safety.raise(missed);
        safety.raise(other);
        if decelerates_first(&other) {
            assert_eq!(safety.pending(), Some(missed));
            continue;
        }
        let named = if led_to { missed } else { other };
        assert_eq!(safety.fault(), Some(named));
        // A fault of a joint loses the position, whatever the name of the latched fault is.
        let kept = keeps_position(&named) && keeps_position(&other);
        assert_eq!(safety.homed(), kept, "{other:?}");
        assert!(!safety.drives_on());
    }
}

#[test]
fn each_fault_latches_once_in_each_state() {
    for fault in every_fault() {
        for state in [
            State::Disabled,
            State::Idle,
            State::Homing,
            State::Run,
            State::Jog,
            State::Hold,
        ] {
            let mut safety = in_state(state);
            let (on, moving) = (safety.drives_on(), safety.active());
            safety.raise(fault);
            if decelerates_first(&fault) && moving {
                // Still moving, in hand, braking.
                assert_eq!(
                    (safety.state(), safety.pending(), safety.drives_on()),
                    (state, Some(fault), true)
                );
                assert!(safety.take_latched().is_none());
                safety.settle();
            }
            assert_eq!(
                (safety.state(), safety.fault()),
                (State::Fault, Some(fault))
            );
            assert_eq!(
                safety.drives_on(),
                on && decelerates_first(&fault),
                "{fault:?} in {state:?}"
            );
            assert_eq!(safety.homed(), keeps_position(&fault));
            assert_eq!(safety.homed(), keeps_position(&fault));
            assert_eq!(safety.take_latched(), Some(fault));
            assert_eq!(safety.take_latched(), None);
            // The first one stays, but for one that takes the drives off that the first one let
            // hold.
            let holding = safety.drives_on();
            for other in every_fault() {
                let mut both = in_state(state);
                both.raise(fault);
                both.settle();
                both.raise(other);
                let expected = if holding && !decelerates_first(&other) {
                    other
                } else {
                    fault
                };
                assert_eq!(both.fault(), Some(expected), "{fault:?}, then {other:?}");
                assert_eq!(both.drives_on(), holding && decelerates_first(&other));
            }
            assert!(safety.reset());
            assert_eq!(
                safety.state(),
                if holding {
                    State::Idle
                } else {
                    State::Disabled
                }
            );
            assert_eq!((safety.fault(), safety.pending()), (None, None));
            assert!(!safety.reset());
        }
    }
}

#[test]
fn emergency_stop_overrides_all_faults() {
    for fault in every_fault() {
        let mut safety = in_state(State::Run);
        safety.raise(fault);
        safety.emergency_stop();
        assert_eq!(
            (safety.state(), safety.drives_on()),
            (State::EmergencyStop, false)
        );
        safety.settle();
        safety.raise(Fault::Drive { joint: 1 });
        assert_eq!(safety.state(), State::EmergencyStop);
        assert!(safety.reset());
        assert_eq!((safety.state(), safety.fault()), (State::Disabled, None));
    }
}

#[test]
fn event_queue_keeps_the_newest() {
    let mut safety = Safety::default();
    for coordinate in 0..40 {
        safety.push_event(Event::JogLimited { coordinate });
    }
    let reported: Vec<_> = core::iter::from_fn(|| safety.next_event()).collect();
    let newest: Vec<_> = (40 - EVENTS as u8..40)
        .map(|coordinate| Event::JogLimited { coordinate })
        .collect();
    assert_eq!(reported, newest);
}

/// A run in x at constant speed with segments of these durations, from standstill to standstill.
fn spans(speed: f64, lengths: &[u16]) -> Vec<Setpoint> {
    let mut x = 0.0;
    let mut points = vec![];
    let mut point = |x: f64, rate: f64, periods: u16| {
        points.push(Setpoint {
            periods,
            pose: [mm(x), 0, mm(20.0), 0, 0].into_iter().collect(),
            rates: [(rate * 4096.0) as i32, 0, 0, 0, 0].into_iter().collect(),
            action: Action::None,
        });
    };
    x += speed * 0.02 / 2.0;
    point(x, speed, 100);
    for &periods in lengths {
        x += speed * f64::from(periods) * 2e-4;
        point(x, speed, periods);
    }
    x += speed * 0.02 / 2.0;
    point(x, 0.0, 100);
    points
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: RngSeed::Fixed(22), failure_persistence: None, ..ProptestConfig::default() })]

    /// Segments so short that a full queue does not cover the stopping distance, and a host that
    /// pauses: slow, but never past the last setpoint.
    #[test]
    fn queue_never_empties_in_motion(
        speed in 1.0_f64..20.0,
        short in 1_u16..6,
        count in 300_usize..1500,
        deliveries in prop::collection::vec((1_usize..400, 0_usize..900), 1..30),
        percent in 5_u8..=100,
    ) {
        let lengths: Vec<u16> = (0..count).map(|index| short + (index % 2) as u16).collect();
        let points = spans(speed, &lengths);
        let mut config = h4();
        config.stopping = Stopping { time_ms: 400, ramp_ms: 100 };
        let mut program = Interpolator::new(&config);
        let mut pose = Pose([Coordinate(0); MAX_AXES]);
        pose.0[2] = Coordinate(mm(20.0));
        program.begin(&pose);
        program.set_override(percent);
        let (mut next, mut last_x, mut periods) = (0, 0, 0_u32);
        let mut deliveries = deliveries.iter().cycle();
        let (mut bring, mut wait) = (400, 0);
        loop {
            if wait == 0 {
                (bring, wait) = *deliveries.next().expect("endless");
            }
            wait = wait.saturating_sub(1);
            while bring > 0 && next < points.len() {
                match program.push(&points[next]) {
                    Ok(()) => next += 1,
                    Err(Refusal::QueueFull) => break,
                    Err(other) => prop_assert!(false, "{other:?}"),
                }
                bring -= 1;
            }
            if next == points.len() {
                prop_assert!(program.end(next as u32).is_ok());
            }
            let (commanded, progress) = program.advance(false);
            prop_assert!(!progress.queue_empty, "period {periods}, {next} taken, {} reached", program.reached());
            // A ramp may pass its target by twice its jerk.
            prop_assert!(program.speed_factor() <= FULL_FACTOR + FULL_FACTOR / 10_000);
            let x = commanded.pose.0[0].0;
            prop_assert!(x >= last_x - 1 && x <= points[next.max(1) - 1].pose[0]);
            last_x = x;
            periods += 1;
            if progress.finished {
                break;
            }
            prop_assert!(periods < 400_000, "stuck: {next} taken, {} reached of {}", program.reached(), points.len());
        }
        prop_assert_eq!(program.reached() as usize, points.len());
        prop_assert!(next > QUEUE);
    }
}
