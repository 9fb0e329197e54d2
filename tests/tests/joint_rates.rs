//! Setpoints that ask a joint for more than its maximum rate: refused with the joint and both rates, before the joint is commanded it.

mod scene;

use haptimill_protocol::message::{
    AxisValues, Command, Event, Refusal, SETPOINT_BATCH, SetpointBatch, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::Bench;
use scene::{DEGREE, MM, ready, rest, state};

/// Maximum rate of a slide in machines/h4.toml, mm/s.
const LIMIT: f64 = 100.0;
/// The slides of a pose (mm, degrees): spec h4-milling (3.23) to (3.26) with the lengths of machines/h4.toml.
fn slides(pose: &[f64; 5]) -> [f64; 4] {
    let (theta, alpha) = (pose[3].to_radians(), pose[4].to_radians());
    let x = pose[0] + 780.0 + 30.0;
    let y = pose[1] * alpha.cos() - pose[2] * alpha.sin();
    let z = pose[1] * alpha.sin() + pose[2] * alpha.cos() - 600.0;
    let slide = |s: f64, sigma: f64| {
        let m = 150.0 + 100.0 * (1.0 + sigma);
        let u = 250.0 - sigma * y;
        let v = -z - m * theta.cos() + sigma * 100.0 - 25.0;
        x + m * theta.sin() + s * (50.0 + (480.0_f64.powi(2) - u * u - v * v).sqrt())
    };
    [
        slide(1.0, 1.0),
        slide(-1.0, 1.0),
        slide(1.0, -1.0),
        slide(-1.0, -1.0),
    ]
}

/// The largest rate of a slide (mm/s) on the way to each setpoint: the cubic Hermite of the pose in 400 steps.
fn peaks(start: &AxisValues, setpoints: &[Setpoint]) -> Vec<f64> {
    let unit = |axis: usize| if axis < 3 { MM } else { DEGREE };
    let mut from: ([f64; 5], [f64; 5]) = (
        std::array::from_fn(|axis| f64::from(start[axis]) / unit(axis)),
        [0.0; 5],
    );
    setpoints
        .iter()
        .map(|setpoint| {
            let to: ([f64; 5], [f64; 5]) = (
                std::array::from_fn(|axis| f64::from(setpoint.pose[axis]) / unit(axis)),
                std::array::from_fn(|axis| f64::from(setpoint.rates[axis]) * 256.0 / unit(axis)),
            );
            let time = f64::from(setpoint.periods) * 2e-4;
            let at = |s: f64| {
                slides(&std::array::from_fn(|axis| {
                    let (p0, p1) = (from.0[axis], to.0[axis]);
                    let (m0, m1) = (from.1[axis] * time, to.1[axis] * time);
                    (2.0 * s * s * s - 3.0 * s * s + 1.0) * p0
                        + (s * s * s - 2.0 * s * s + s) * m0
                        + (3.0 * s * s - 2.0 * s * s * s) * p1
                        + (s * s * s - s * s) * m1
                }))
            };
            let mut most = 0.0_f64;
            for step in 0..=400 {
                let s = f64::from(step) / 400.0;
                let (back, ahead) = (at(s - 1e-5), at(s + 1e-5));
                for joint in 0..4 {
                    most = most.max(((ahead[joint] - back[joint]) / (2e-5 * time)).abs());
                }
            }
            from = to;
            most
        })
        .collect()
}

/// Says a job; the refusal of a batch, if there was one.
fn say(bench: &mut Bench, setpoints: &[Setpoint]) -> Option<Refusal> {
    let start = bench.status().wanted;
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

/// The largest rate of a slide, mm/s, by differences of commanded positions, until the machine rests for 1000 periods.
fn fastest(bench: &mut Bench) -> f64 {
    let slides = |bench: &Bench| {
        let machinery = bench.rig.control().machinery().expect("configured");
        let joints = machinery.target().joints.0;
        [0, 1, 2, 3].map(|joint: usize| f64::from(joints[joint].0) / MM)
    };
    let (mut most, mut still) = (0.0_f64, 0);
    let mut before = slides(bench);
    for _ in 0..60_000 {
        bench.step();
        let now = slides(bench);
        let step = (0..4).fold(0.0_f64, |most, joint| {
            most.max((now[joint] - before[joint]).abs())
        });
        still = if step == 0.0 { still + 1 } else { 0 };
        if still > 1000 {
            return most;
        }
        most = most.max(step / 2e-4);
        before = now;
    }
    panic!("the machine does not come to rest");
}

/// A turn of the tilt: each span (periods) goes on from the rate before to the next one (degrees/s), by the mean of both.
fn tilt(start: &AxisValues, spans: &[(u16, f64)]) -> Vec<Setpoint> {
    let (mut angle, mut before) = (f64::from(start[3]) / DEGREE, 0.0);
    spans
        .iter()
        .map(|&(periods, rate)| {
            angle += (before + rate) / 2.0 * f64::from(periods) * 2e-4;
            before = rate;
            let mut setpoint = rest(start, periods);
            setpoint.pose[3] = (angle * DEGREE) as i32;
            setpoint.rates[3] = (rate * DEGREE / 256.0) as i32;
            setpoint
        })
        .collect()
}

/// The machine brakes in front of the setpoint that was refused, keeps its position and takes the next job.
fn ends_well(bench: &mut Bench) {
    let most = fastest(bench);
    assert!(most <= 1.02 * LIMIT, "a slide was commanded {most} mm/s");
    assert_eq!(state(bench), State::Run);
    bench.ask(Command::Stop).expect("stops");
    assert!(bench.wait_for(State::Idle, 2000));
    assert!(bench.status().position_kept);
    let faults = |event: &Event| matches!(event, Event::Fault(_));
    assert!(!bench.events.iter().any(faults), "{:?}", bench.events);
    let start = bench.status().wanted;
    bench.start_job(2, &scene::line(&start, 0, 4.0, 5));
    assert!(bench.wait_for(State::Idle, 20_000));
}

/// Whatever a stream of setpoints asks for: what is refused would be too fast, and nothing too fast is taken.
fn is_refused_where_it_is_too_fast(bench: &mut Bench, setpoints: &[Setpoint]) -> bool {
    let start = bench.status().wanted;
    let peaks = peaks(&start, setpoints);
    let refused = say(bench, setpoints);
    let taken = match refused {
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
    for (setpoint, peak) in peaks[..taken].iter().enumerate() {
        assert!(
            *peak < 1.023 * LIMIT,
            "setpoint {setpoint} at {peak} mm/s: taken"
        );
    }
    refused.is_some()
}

#[test]
fn a_stream_too_fast_for_a_slide_is_refused_before_the_slide_is() {
    // A slide follows a tilt by some 6.5 mm/degree. The pose may turn by 30 degrees/s.
    for span in [5_u16, 25, 64, 100, 300, 1000] {
        let mut bench = ready();
        let start = bench.status().wanted;
        let mut spans = vec![(1000, 12.0)];
        for _ in 0..(2000 / span).min(120) {
            spans.push((span, 12.0));
        }
        spans.push((250, 20.0));
        spans.push((250, 0.0));
        assert!(is_refused_where_it_is_too_fast(
            &mut bench,
            &tilt(&start, &spans)
        ));
        ends_well(&mut bench);
    }
}

#[test]
fn a_joint_too_fast_between_two_setpoints_is_found() {
    // At rest at both ends, and in the middle at 1.5 times the mean.
    for (periods, degrees) in [(600_u16, 2.3), (1500, 5.5), (2500, 9.0), (5000, 17.5)] {
        let mut bench = ready();
        let mut setpoint = rest(&bench.status().wanted, periods);
        setpoint.pose[3] += (degrees * DEGREE) as i32;
        assert!(is_refused_where_it_is_too_fast(
            &mut bench,
            &[setpoint.clone()]
        ));
        ends_well(&mut bench);
        // Half as far in the same time is taken, and goes as fast as it says.
        let mut bench = ready();
        setpoint.pose[3] -= (degrees / 2.0 * DEGREE) as i32;
        let start = bench.status().wanted;
        let peak = peaks(&start, &[setpoint.clone()])[0];
        assert_eq!(say(&mut bench, &[setpoint]), None);
        bench.ask(Command::JobEnd { count: 1 }).expect("complete");
        let most = fastest(&mut bench);
        assert!((most / peak - 1.0).abs() < 0.01, "{most} of {peak}");
    }
}

/// Streams of any coordinates with any spans, from places of which some are near the bound of the workspace.
#[test]
fn no_stream_commands_a_joint_too_fast() {
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
        // A jog of y, z and the table towards somewhere, until it ends.
        let jog = [
            (1, uniform(-50.0, 50.0)),
            (2, uniform(-50.0, 50.0)),
            (4, uniform(-20.0, 20.0)),
        ];
        for _ in 0..case % 4 {
            bench.ask(scene::jog(1, 1000, &jog)).expect("jogs");
            bench.steps(4000);
        }
        assert!(bench.wait_for(State::Idle, 10_000));
        let start = bench.status().wanted;
        let axis = 1 + case % 4;
        let most = if axis < 3 { 49.0 } else { 29.0 };
        let span = uniform(2.0, 120.0) as u16;
        let sign = if uniform(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
        let (mut place, mut before, mut setpoints) = (0.0, 0.0_f64, Vec::new());
        let unit = if axis < 3 { MM } else { DEGREE };
        // Faster and faster, with an acceleration of at most 3 times that of a jog.
        while setpoints.len() < 400 && f64::abs(place) < 30.0 {
            let time = f64::from(span) * 2e-4;
            let rate = f64::min(before + uniform(0.0, 300.0) * time, most);
            place += sign * (before + rate) / 2.0 * time;
            before = rate;
            let mut setpoint = rest(&start, span);
            setpoint.pose[axis] += (place * unit) as i32;
            setpoint.rates[axis] = (sign * rate * unit / 256.0) as i32;
            setpoints.push(setpoint);
        }
        let reach = say_all(&mut bench, &setpoints);
        if reach {
            refused += 1;
        }
        let fast = fastest(&mut bench);
        assert!(
            fast <= 1.023 * LIMIT,
            "case {case}: a slide was commanded {fast} mm/s"
        );
    }
    assert!(refused >= 10, "{refused} refused");
}

/// As above; a stream that leaves the reach of the machine is refused for that. Says whether it was refused for a joint rate.
fn say_all(bench: &mut Bench, setpoints: &[Setpoint]) -> bool {
    let start = bench.status().wanted;
    let peaks = peaks(&start, setpoints);
    match say(bench, setpoints) {
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

/// A planner may go to the maximum rate itself.
#[test]
fn the_maximum_rate_is_allowed() {
    let mut bench = ready();
    let start = bench.status().wanted;
    let job = |rate| {
        tilt(
            &start,
            &[(2000, rate), (500, rate), (500, rate), (2000, 0.0)],
        )
    };
    let of = |rate| peaks(&start, &job(rate)).into_iter().fold(0.0, f64::max);
    // The rate of the tilt at which the fastest slide is at its maximum, by bisection.
    let (mut low, mut high) = (5.0, 25.0);
    while high - low > 1e-4 {
        let middle = (low + high) / 2.0;
        (low, high) = if of(middle) < LIMIT {
            (middle, high)
        } else {
            (low, middle)
        };
    }
    assert_eq!(say(&mut bench, &job(low)), None);
    bench.ask(Command::JobEnd { count: 4 }).expect("complete");
    let most = fastest(&mut bench);
    assert!((0.995 * LIMIT..=1.005 * LIMIT).contains(&most), "{most}");
    assert_eq!(state(&bench), State::Idle);
}
