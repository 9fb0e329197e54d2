//! Joint rates: setpoints that exceed a maximum are refused with the joint and both rates, before
//! they take effect.

use crate::setup;
use haptimill_protocol::message::{
    Action, Command, Event, OverrideMode, Refusal, SETPOINT_BATCH, SetpointBatch, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::Bench;
use setup::slides::{LIMIT, peak_rates, tilt};
use setup::{DEGREE, MM, ready, rest, state};

/// Sends a job. Returns the refusal of a batch, if there was one.
fn send_job(bench: &mut Bench, setpoints: &[Setpoint]) -> Option<Refusal> {
    let start = bench.status().commanded;
    bench
        .ask(Command::JobStart {
            job: 1,
            pose: start.clone(),
        })
        .expect("started");
    let mut coder = SetpointCoder::new(200, &start);
    for (index, batch) in setpoints.chunks(SETPOINT_BATCH).enumerate() {
        let items = batch
            .iter()
            .map(|setpoint| coder.encode(setpoint).expect("codes"))
            .collect();
        let first = (index * SETPOINT_BATCH) as u32;
        if let Err(refusal) = bench.ask(Command::Setpoints(SetpointBatch { first, items })) {
            return Some(refusal);
        }
    }
    None
}

/// Returns the largest rate of a slide, mm/s, by differences of commanded positions, until 1000
/// periods of standstill.
fn fastest_slide(bench: &mut Bench) -> f64 {
    let slides = |bench: &Bench| {
        let machine = bench.rig.control().machine().expect("configured");
        let joints = machine.target().joints.0;
        [0, 1, 2, 3].map(|joint: usize| f64::from(joints[joint].0) / MM)
    };
    let (mut max, mut still) = (0.0_f64, 0);
    let mut before = slides(bench);
    for _ in 0..60_000 {
        bench.step();
        let now = slides(bench);
        let step = (0..4).fold(0.0_f64, |max, joint| {
            max.max((now[joint] - before[joint]).abs())
        });
        still = if step == 0.0 { still + 1 } else { 0 };
        if still > 1000 {
            return max;
        }
        max = max.max(step / 2e-4);
        before = now;
    }
    panic!("the machine does not come to rest");
}

/// The machine brakes before the refused setpoint, keeps its position and accepts the next job.
fn assert_stopped_and_usable(bench: &mut Bench) {
    let max = fastest_slide(bench);
    assert!(max <= 1.02 * LIMIT, "a slide was commanded {max} mm/s");
    assert_eq!(state(bench), State::Run);
    bench.ask(Command::Stop).expect("stops");
    assert!(bench.wait_for(State::Idle, 2000));
    assert!(bench.status().homed);
    let faults = |event: &Event| matches!(event, Event::Fault(_));
    assert!(!bench.events.iter().any(faults), "{:?}", bench.events);
    let start = bench.status().commanded;
    bench.start_job(2, &setup::line(&start, 0, 4.0, 5));
    assert!(bench.wait_for(State::Idle, 20_000));
}

/// For any stream of setpoints: a refused one would be too fast, and no accepted one is too fast.
fn assert_refused_where_too_fast(bench: &mut Bench, setpoints: &[Setpoint]) -> bool {
    let start = bench.status().commanded;
    let peaks = peak_rates(&start, setpoints);
    let refused = send_job(bench, setpoints);
    let accepted = match refused {
        Some(Refusal::JointRate {
            setpoint,
            rate,
            limit,
            ..
        }) => {
            assert_eq!(f64::from(limit) / MM, LIMIT);
            let (peak, rate) = (peaks[setpoint as usize], f64::from(rate).abs() / MM);
            assert!(
                peak > 1.017 * LIMIT,
                "setpoint {setpoint} at {peak} mm/s: refused"
            );
            assert!(
                rate > 1.02 * LIMIT && rate < 1.02 * peak,
                "{rate} of {peak}"
            );
            setpoint as usize
        }
        None => setpoints.len(),
        _ => panic!("{refused:?}"),
    };
    for (setpoint, peak) in peaks[..accepted].iter().enumerate() {
        assert!(
            *peak < 1.023 * LIMIT,
            "setpoint {setpoint} at {peak} mm/s: accepted"
        );
    }
    refused.is_some()
}

#[test]
fn a_stream_too_fast_for_a_slide_is_refused_before_it_takes_effect() {
    // A slide follows a tilt by about 6.5 mm/degree. The pose may turn by 30 degrees/s.
    for span in [5_u16, 25, 64, 100, 300, 1000] {
        let mut bench = ready();
        let start = bench.status().commanded;
        let mut spans = vec![(1000, 12.0)];
        for _ in 0..(2000 / span).min(120) {
            spans.push((span, 12.0));
        }
        spans.push((250, 20.0));
        spans.push((250, 0.0));
        assert!(assert_refused_where_too_fast(
            &mut bench,
            &tilt(&start, &spans)
        ));
        assert_stopped_and_usable(&mut bench);
    }
}

#[test]
fn an_excessive_joint_rate_between_two_setpoints_is_refused() {
    // At standstill at both ends, and at 1.5 times the mean rate in the middle.
    for (periods, degrees) in [(600_u16, 2.3), (1500, 5.5), (2500, 9.0), (5000, 17.5)] {
        let mut bench = ready();
        let mut setpoint = rest(&bench.status().commanded, periods);
        setpoint.pose[3] += (degrees * DEGREE) as i32;
        assert!(assert_refused_where_too_fast(
            &mut bench,
            &[setpoint.clone()]
        ));
        assert_stopped_and_usable(&mut bench);
        // Half the distance in the same time is accepted, at the rate that it gives.
        let mut bench = ready();
        setpoint.pose[3] -= (degrees / 2.0 * DEGREE) as i32;
        let start = bench.status().commanded;
        let peak = peak_rates(&start, &[setpoint.clone()])[0];
        assert_eq!(send_job(&mut bench, &[setpoint]), None);
        bench.ask(Command::JobEnd { count: 1 }).expect("complete");
        let max = fastest_slide(&mut bench);
        assert!((max / peak - 1.0).abs() < 0.01, "{max} of {peak}");
    }
}

/// Streams of any coordinates and durations, from random poses, some of them near the bound of the
/// workspace.
#[test]
fn no_stream_exceeds_a_joint_rate() {
    let mut random = 7_u64;
    let mut uniform = |low: f64, high: f64| {
        random ^= random >> 12;
        random ^= random << 25;
        random ^= random >> 27;
        let bits = random.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11;
        low + (high - low) * bits as f64 / (1_u64 << 53) as f64
    };
    let mut refused = 0;
    for case in 0..40 {
        let mut bench = ready();
        // A jog of y, z and the table in a random direction, until it ends.
        let jog = [
            (1, uniform(-50.0, 50.0)),
            (2, uniform(-50.0, 50.0)),
            (4, uniform(-20.0, 20.0)),
        ];
        for _ in 0..case % 4 {
            bench.ask(setup::jog(1, 1000, &jog)).expect("jogs");
            bench.steps(4000);
        }
        assert!(bench.wait_for(State::Idle, 10_000));
        let start = bench.status().commanded;
        let axis = 1 + case % 4;
        let max = if axis < 3 { 49.0 } else { 29.0 };
        let span = uniform(2.0, 120.0) as u16;
        let sign = if uniform(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
        let (mut place, mut before, mut setpoints) = (0.0, 0.0_f64, Vec::new());
        let unit = if axis < 3 { MM } else { DEGREE };
        // Random rates with an acceleration of at most 3 times that of a jog.
        while setpoints.len() < 400 && f64::abs(place) < 30.0 {
            let time = f64::from(span) * 2e-4;
            let rate = f64::min(before + uniform(0.0, 300.0) * time, max);
            place += sign * (before + rate) / 2.0 * time;
            before = rate;
            let mut setpoint = rest(&start, span);
            setpoint.pose[axis] += (place * unit) as i32;
            setpoint.rates[axis] = (sign * rate * unit / 256.0) as i32;
            setpoints.push(setpoint);
        }
        let reach = send_any_stream(&mut bench, &setpoints);
        if reach {
            refused += 1;
        }
        let fast = fastest_slide(&mut bench);
        assert!(
            fast <= 1.023 * LIMIT,
            "case {case}: a slide was commanded {fast} mm/s"
        );
    }
    assert!(refused >= 10, "{refused} refused");
}

/// Sends a stream that may also leave the reach of the machine. Returns whether it was refused for
/// a joint rate.
fn send_any_stream(bench: &mut Bench, setpoints: &[Setpoint]) -> bool {
    let start = bench.status().commanded;
    let peaks = peak_rates(&start, setpoints);
    match send_job(bench, setpoints) {
        Some(Refusal::JointRate { setpoint, .. }) => {
            let peak = peaks[setpoint as usize];
            assert!(
                peak > 1.017 * LIMIT,
                "setpoint {setpoint} at {peak} mm/s: refused"
            );
            true
        }
        Some(Refusal::Pose { .. } | Refusal::SoftLimit { .. } | Refusal::QueueFull) | None => false,
        other => panic!("{other:?}"),
    }
}

/// A stream at the maximum rate itself is accepted.
#[test]
fn a_stream_at_the_maximum_rate_is_accepted() {
    let mut bench = ready();
    let start = bench.status().commanded;
    let job = |rate| {
        tilt(
            &start,
            &[(2000, rate), (500, rate), (500, rate), (2000, 0.0)],
        )
    };
    let of = |rate| {
        peak_rates(&start, &job(rate))
            .into_iter()
            .fold(0.0, f64::max)
    };
    // Finds the rate of the tilt at which the fastest slide is at its maximum, by bisection.
    let (mut low, mut high) = (5.0, 25.0);
    while high - low > 1e-4 {
        let middle = (low + high) / 2.0;
        (low, high) = if of(middle) < LIMIT {
            (middle, high)
        } else {
            (low, middle)
        };
    }
    assert_eq!(send_job(&mut bench, &job(low)), None);
    bench.ask(Command::JobEnd { count: 4 }).expect("complete");
    let max = fastest_slide(&mut bench);
    assert!((0.995 * LIMIT..=1.005 * LIMIT).contains(&max), "{max}");
    assert_eq!(state(&bench), State::Idle);
}

/// A faster override mode multiplies joint rates: the limit holds at the largest override.
#[test]
fn no_pace_exceeds_a_joint_rate_at_any_override() {
    for percent in [110_u8, 150, 200] {
        for part in [0.4, 0.6, 0.8, 0.95] {
            let mut bench = ready();
            bench
                .ask(Command::Override { percent: 200 })
                .expect("accepted");
            let start = bench.status().commanded;
            // Of the slide that is the fastest one; the pose has room for twice this rate.
            let rate = part * LIMIT / 8.4;
            let mut spans = vec![(250, 0.0), (1000, rate)];
            spans.extend([(200, rate); 8]);
            spans.push((1000, 0.0));
            let mut setpoints = tilt(&start, &spans);
            setpoints[0].action = Action::OverrideMode(OverrideMode::feed_up_to(percent));
            let peaks = peak_rates(&start, &setpoints);
            let peak = peaks.iter().fold(0.0_f64, |max, peak| max.max(*peak));
            let fastest = peak * f64::from(percent) / 100.0;
            let refused = send_job(&mut bench, &setpoints);
            println!("{percent} %: {peak:.1} mm/s, {refused:?}");
            if fastest < LIMIT {
                assert_eq!(refused, None);
            } else if fastest > 1.03 * LIMIT {
                let is_rate = matches!(refused, Some(Refusal::JointRate { .. }));
                assert!(is_rate, "{fastest} mm/s: {refused:?}");
            }
            if refused.is_none() {
                let count = setpoints.len() as u32;
                bench.ask(Command::JobEnd { count }).expect("complete");
                let max = fastest_slide(&mut bench);
                assert!(max <= 1.03 * LIMIT, "{max} mm/s");
                assert!(max > 0.97 * fastest, "{max} of {fastest} mm/s");
            } else {
                assert_stopped_and_usable(&mut bench);
            }
        }
    }
}
