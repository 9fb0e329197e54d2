//! Override mode of the path: overrides act on their parts, and no commanded rate exceeds its limit
//! at any override.

use crate::path;
use crate::reference;

use haptimill_firmware::motion::interpolator::{FULL_FACTOR, QUEUE};
use haptimill_protocol::message::{Action, OverrideMode, Refusal};
use haptimill_protocol::setpoint::Setpoint;
use path::{PERIOD_S, UNIT_MM, setpoint, start, straight, walk};
use proptest::prelude::*;
use reference::h4;

/// An override mode as the action of a setpoint.
fn with_mode(mut point: Setpoint, mode: OverrideMode) -> Setpoint {
    point.action = Action::OverrideMode(mode);
    point
}

/// The speed factor in the middle of each part of the path, percent, with overrides of feed and
/// rapid moves.
fn rates_of(modes: [OverrideMode; 4], feed: u8, rapid: u8) -> Vec<i64> {
    let mut program = start(&h4());
    program.set_override(feed);
    program.set_rapid_override(rapid);
    // Four parts of 60 spans of 20 ms.
    let mut points = straight(4.0, 240, 100);
    for (part, mode) in modes.into_iter().enumerate() {
        points[60 * part] = with_mode(points[60 * part].clone(), mode);
    }
    let mut rates = vec![0; 4];
    let mut pushed = points.iter();
    for _ in 0..200_000 {
        while let Some(point) = pushed.clone().next()
            && program.push(point).is_ok()
        {
            pushed.next();
        }
        if pushed.len() == 0 && !program.is_complete() {
            program.end(points.len() as u32).expect("at rest");
        }
        let (commanded, progress) = program.advance(false);
        let part = (program.reached() as usize).saturating_sub(1) / 60;
        if program.reached() % 60 == 50 && part < 4 {
            rates[part] = (program.speed_factor() * 100 + FULL_FACTOR / 2) / FULL_FACTOR;
            let rate = f64::from(commanded.rates[0].0) * UNIT_MM;
            let expected = 4.0 * program.speed_factor() as f64 / FULL_FACTOR as f64;
            assert!((rate - expected).abs() < 0.01, "{rate} {expected}");
        }
        if progress.finished {
            break;
        }
    }
    rates
}

#[test]
fn overrides_act_on_their_parts_of_the_path() {
    let [feed, rapid] = [OverrideMode::FEED, OverrideMode::RAPID];
    let modes = [
        feed,
        rapid,
        OverrideMode::FEED_AND_RAPID,
        OverrideMode::FIXED,
    ];
    assert_eq!(rates_of(modes, 100, 100), [100, 100, 100, 100]);
    assert_eq!(rates_of(modes, 50, 100), [50, 100, 50, 100]);
    assert_eq!(rates_of(modes, 100, 20), [100, 20, 20, 100]);
    let fast = OverrideMode::feed_up_to;
    let modes = [fast(150), feed, fast(200), rapid];
    assert_eq!(rates_of(modes, 200, 100), [150, 100, 200, 100]);
    assert_eq!(rates_of(modes, 120, 50), [120, 100, 120, 50]);
}

/// The motion stays on the path at any factor, and its rate is the derivative of its position.
#[test]
fn a_faster_pace_keeps_the_path_and_ends_sooner() {
    let mut program = start(&h4());
    program.set_override(200);
    let mut points = straight(4.0, 100, 100);
    points[0] = with_mode(points[0].clone(), OverrideMode::feed_up_to(200));
    points[60] = with_mode(points[60].clone(), OverrideMode::FEED);
    for point in &points {
        program.push(point).expect("accepted");
    }
    program.end(points.len() as u32).expect("at rest");
    let path = walk(&mut program, 20_000, |_| false);
    assert!(path.finished);
    path.assert_consistent();
    let end = f64::from(points.last().expect("some").pose[0]) * UNIT_MM;
    assert!((path.x.last().expect("moved") - end).abs() < 1e-6);
    // 60 spans of 100 periods at twice the speed; one ramp is slower, the other one faster.
    let periods = path.x.len() as i32;
    assert!((periods - 7200).abs() < 600, "{periods}");
    let fastest = path.rate.iter().fold(0.0_f64, |max, rate| max.max(*rate));
    assert!((fastest - 8.0).abs() < 0.01, "{fastest}");
    let (acceleration, jerk) = path.dynamics(700, 20_000);
    // 4 mm/s in 220 ms, which builds up in 80 ms; the end is that of the programmed motion.
    assert!(
        acceleration < 1100.0 && jerk < 110_000.0,
        "{acceleration} {jerk}"
    );
}

/// A setpoint that would be too fast at the factor of its override mode is refused, and so is an
/// unknown override mode.
#[test]
fn a_pace_bounds_the_rates_of_the_setpoints_behind_it() {
    let mut program = start(&h4());
    let wrong = with_mode(setpoint(0.05, 5.0, 100), OverrideMode(200));
    assert_eq!(program.push(&wrong), Err(Refusal::Setpoint { setpoint: 0 }));
    let fast = h4().pose[0].rate.0 as f64 * UNIT_MM * 0.6;
    for (mode, accepted) in [
        (OverrideMode::feed_up_to(150), true),
        (OverrideMode::feed_up_to(200), false),
    ] {
        let mut program = start(&h4());
        program
            .push(&with_mode(setpoint(0.0, 0.0, 100), mode))
            .expect("at rest");
        let next = setpoint(fast * 0.1, fast, 1000);
        assert_eq!(program.push(&next).is_ok(), accepted);
    }
}

/// A random part of a path: periods, speed as a part of the limit, and the override mode behind it.
fn part() -> impl Strategy<Value = (u16, f64, Option<u8>)> {
    let speed = prop_oneof![1 => Just(0.0), 6 => 0.0_f64..1.02];
    let mode = prop_oneof![3 => Just(None), 2 => (0_u8..=103).prop_map(Some)];
    (5_u16..400, speed, mode)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever setpoints and modes are accepted, and whenever the operator changes the overrides
    /// or holds: no commanded rate exceeds the limit of its coordinate.
    #[test]
    fn no_accepted_path_exceeds_a_rate_limit(
        parts in prop::collection::vec(part(), 4..60),
        overrides in prop::collection::vec((100_usize..3000, 20_u8..=200, any::<bool>()), 1..6),
    ) {
        let config = h4();
        let limit = f64::from(config.pose[0].rate.0) * UNIT_MM;
        let mut program = start(&config);
        program.set_override(200);
        let (mut x, mut before, mut pushed) = (0.0, 0.0, 0);
        for (periods, part, mode) in parts {
            let mut speed = part * limit;
            // A refused setpoint is sent again at half the speed.
            for _ in 0..8 {
                let to = x + (before + speed) / 2.0 * f64::from(periods) * PERIOD_S;
                let mut point = setpoint(to, speed, periods);
                if let Some(mode) = mode {
                    point.action = Action::OverrideMode(OverrideMode(mode));
                }
                if program.push(&point).is_ok() {
                    (x, before, pushed) = (to, speed, pushed + 1);
                    break;
                }
                speed /= 2.0;
            }
        }
        prop_assume!(pushed < QUEUE as u32 - 1);
        while before != 0.0 {
            let to = x + before / 2.0 * 200.0 * PERIOD_S;
            if program.push(&setpoint(to, 0.0, 200)).is_err() {
                // The queue ends in motion: the program holds at its end.
                break;
            }
            (before, pushed) = (0.0, pushed + 1);
        }
        let _ = program.end(pushed);
        let mut changes = overrides.into_iter().cycle();
        let mut change = changes.next();
        let mut halt = false;
        for period in 0..60_000_usize {
            if let Some((every, percent, holds)) = change
                && period.is_multiple_of(every)
            {
                program.set_override(percent);
                halt = holds && !halt;
                change = changes.next();
            }
            let (commanded, progress) = program.advance(halt);
            let rate = f64::from(commanded.rates[0].0).abs() * UNIT_MM;
            // 2 % for the rounding of setpoints, and the rounding of a rate.
            prop_assert!(rate <= limit * 1.021, "{rate} of {limit} in period {period}");
            if progress.finished {
                break;
            }
        }
    }
}
