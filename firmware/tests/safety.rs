//! Latched faults, and the queue in its worst case.

use crate::reference;
use haptimill_firmware::config::Stopping;
use haptimill_firmware::io::{JointInputs, first_alarm};
use haptimill_firmware::motion::interpolator::{FULL_FACTOR, Interpolator, QUEUE};
use haptimill_firmware::safety::{EVENTS, Safety, decelerates_first, keeps_position};
use haptimill_kinematics::Pose;
use haptimill_math::Coordinate;
use haptimill_protocol::message::{
    Action, DriveAlarm, Event, Fault, HomingProblem, MAX_AXES, PoseError, Refusal, State,
};
use haptimill_protocol::setpoint::Setpoint;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use reference::{h4, mm};

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
        Fault::Drive {
            joint: 0,
            alarm: DriveAlarm::Input,
        },
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
        safety.raise(Fault::Drive {
            joint: 1,
            alarm: DriveAlarm::Silent,
        });
        assert_eq!(safety.state(), State::EmergencyStop);
        assert!(safety.reset());
        assert_eq!((safety.state(), safety.fault()), (State::Disabled, None));
    }
}

/// A drive whose chip is only cut off by another one is named when there is no other alarm.
#[test]
fn a_drive_alarm_names_the_joint_that_causes_it() {
    let seen = |alarm: Option<DriveAlarm>| JointInputs {
        drive_ready: alarm.is_none(),
        alarm: alarm.unwrap_or_default(),
        ..JointInputs::default()
    };
    let (cut_off, silent, hot) = (
        Some(DriveAlarm::Unreachable),
        Some(DriveAlarm::Silent),
        Some(DriveAlarm::Overheated),
    );
    for (alarms, named) in [
        ([None, None, None], None),
        ([None, hot, silent], Some((1, DriveAlarm::Overheated))),
        ([cut_off, None, silent], Some((2, DriveAlarm::Silent))),
        ([cut_off, silent, cut_off], Some((1, DriveAlarm::Silent))),
        ([None, cut_off, cut_off], Some((1, DriveAlarm::Unreachable))),
    ] {
        assert_eq!(first_alarm(&alarms.map(seen)), named, "{alarms:?}");
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
