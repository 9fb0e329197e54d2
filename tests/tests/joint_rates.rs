//! Joint rates: setpoints that exceed a maximum are refused with the joint and both rates, before
//! they take effect.

mod setup;

use haptimill_protocol::force::Gate;
use haptimill_protocol::message::{
    AxisValues, Command, Event, Fault, Refusal, SETPOINT_BATCH, SetpointBatch, Source, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::Bench;
use setup::{DEGREE, MM, ready, rest, state};

/// Maximum rate of a slide in machines/h4.toml, mm/s.
const LIMIT: f64 = 100.0;
/// Returns the slides of a pose (mm, degrees): docs/control.md (3.23) to (3.26), with the lengths
/// of machines/h4.toml.
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

/// Returns the largest rate of a slide (mm/s) before each setpoint: the cubic Hermite polynomial of
/// the pose in 400 steps.
fn peak_rates(start: &AxisValues, setpoints: &[Setpoint]) -> Vec<f64> {
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

/// Sends a job. Returns the refusal of a batch, if there was one.
fn say(bench: &mut Bench, setpoints: &[Setpoint]) -> Option<Refusal> {
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

/// Returns a tilt: each segment (periods) leads from the rate before to its own (degrees/s), by the
/// mean of both.
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

/// The machine brakes before the refused setpoint, keeps its position and accepts the next job.
fn assert_stopped_and_usable(bench: &mut Bench) {
    let most = fastest_slide(bench);
    assert!(most <= 1.02 * LIMIT, "a slide was commanded {most} mm/s");
    assert_eq!(state(bench), State::Run);
    bench.ask(Command::Stop).expect("stops");
    assert!(bench.wait_for(State::Idle, 2000));
    assert!(bench.status().position_kept);
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
    let refused = say(bench, setpoints);
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
        assert_eq!(say(&mut bench, &[setpoint]), None);
        bench.ask(Command::JobEnd { count: 1 }).expect("complete");
        let most = fastest_slide(&mut bench);
        assert!((most / peak - 1.0).abs() < 0.01, "{most} of {peak}");
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
        let most = if axis < 3 { 49.0 } else { 29.0 };
        let span = uniform(2.0, 120.0) as u16;
        let sign = if uniform(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
        let (mut place, mut before, mut setpoints) = (0.0, 0.0_f64, Vec::new());
        let unit = if axis < 3 { MM } else { DEGREE };
        // Random rates with an acceleration of at most 3 times that of a jog.
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
    assert_eq!(say(&mut bench, &job(low)), None);
    bench.ask(Command::JobEnd { count: 4 }).expect("complete");
    let most = fastest_slide(&mut bench);
    assert!((0.995 * LIMIT..=1.005 * LIMIT).contains(&most), "{most}");
    assert_eq!(state(&bench), State::Idle);
}

/// A random generator with a seed (xorshift64*).
struct Random(u64);

impl Random {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let bits = self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11;
        low + (high - low) * bits as f64 / (1_u64 << 53) as f64
    }

    fn sign(&mut self) -> f64 {
        self.uniform(-1.0, 1.0).signum()
    }
}

/// Commanded rates of the slides: differences over 8 periods of the inverse kinematics in f64,
/// applied to the reference.
#[derive(Default)]
struct Commanded {
    slides: Vec<[f64; 4]>,
    /// The largest rate of a slide, mm/s.
    fastest: f64,
    /// Largest compliant displacement, mm.
    displacement: f64,
}

impl Commanded {
    const SPAN: usize = 8;

    fn step(&mut self, bench: &mut Bench) {
        bench.step();
        let machine = bench.rig.control().machine().expect("configured");
        let unit = |axis: usize| if axis < 3 { MM } else { DEGREE };
        let pose = &machine.reference().pose.0;
        let pose = std::array::from_fn(|axis| f64::from(pose[axis].0) / unit(axis));
        self.slides.push(slides(&pose));
        self.displacement = self
            .displacement
            .max(setup::force::displacement(bench).abs());
        if let Some(before) = self.slides.len().checked_sub(Self::SPAN + 1) {
            for (now, then) in self.slides[self.slides.len() - 1]
                .iter()
                .zip(self.slides[before])
            {
                let rate = (now - then).abs() / (Self::SPAN as f64 * 2e-4);
                self.fastest = self.fastest.max(rate);
            }
        }
    }

    fn steps(&mut self, bench: &mut Bench, count: usize) {
        for _ in 0..count {
            self.step(bench);
        }
    }
}

/// The joint-rate fault: joint, rate in mm/s.
fn joint_rate_fault(bench: &Bench) -> Option<(u8, f64)> {
    bench.events.iter().find_map(|event| match event {
        Event::Fault(Fault::JointRate {
            axis, rate, limit, ..
        }) => {
            assert_eq!(f64::from(*limit) / MM, LIMIT);
            Some((*axis, f64::from(*rate) / MM))
        }
        _ => None,
    })
}

/// A wall displaces the tool while all coordinates are jogged, also into the bounds of the
/// workspace.
#[test]
fn a_jog_under_force_control_exceeds_no_joint_rate() {
    let mut random = Random(11);
    let (mut fastest, mut complied, mut faults) = (0.0_f64, 0, 0);
    for case in 0..12 {
        let mut bench = ready();
        let tool = setup::tool(&bench);
        let gap = random.uniform(0.2, 1.5);
        let stiffness = random.uniform(5.0, 40.0);
        let process = setup::force::wall(tool, gap, stiffness);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        setup::force::tare(&mut bench);
        bench.events.clear();
        for axis in [0, 2] {
            let settings = setup::force::force_settings(0.8, 2.0, Gate::Any);
            let command = Command::ForceLoop { axis, settings };
            bench.ask(command).expect("accepted");
        }
        bench.ask(Command::ForceMask { mask: 5 }).expect("accepted");
        let mut commanded = Commanded::default();
        let (across, up) = (random.sign(), random.sign());
        for epoch in 1..=6_u16 {
            // Into the wall and out of it; across and up or down at maximum rates, to the bound and
            // back.
            let back = if epoch > 4 { -1.0 } else { 1.0 };
            let x = if epoch % 2 == 1 { -1.0 } else { 1.0 } * random.uniform(2.0, 30.0);
            let rates = [
                (0, x),
                (1, back * across * random.uniform(20.0, 50.0)),
                (2, back * up * random.uniform(0.0, 50.0)),
                (3, random.uniform(-20.0, 20.0)),
                (4, random.uniform(-20.0, 20.0)),
            ];
            if bench.send(setup::jog(epoch, 600, &rates)).is_none() {
                panic!("no room");
            }
            commanded.steps(&mut bench, 3000);
        }
        commanded.steps(&mut bench, 2000);
        println!(
            "case {case}: {:.3} mm/s, displaced by {:.2} mm, {:?}",
            commanded.fastest, commanded.displacement, bench.events
        );
        fastest = fastest.max(commanded.fastest);
        complied += u32::from(commanded.displacement > 0.5);
        faults += u32::from(
            bench
                .events
                .iter()
                .any(|event| matches!(event, Event::Fault(_))),
        );
        assert_eq!(joint_rate_fault(&bench), None, "case {case}");
        assert!(
            commanded.fastest <= 1.0005 * LIMIT,
            "case {case}: a slide was commanded {} mm/s",
            commanded.fastest
        );
    }
    println!(
        "the fastest slide: {fastest:.3} mm/s; {complied} complied; {faults} ended by a fault"
    );
    assert!(
        fastest > 0.9 * LIMIT,
        "{fastest}: nothing was near its limit"
    );
    assert!(complied >= 8, "{complied} of 12 complied");
}

/// Sends a job whose setpoints are all allowed at the present pose, and jogs y and z before they
/// are reached.
fn jog_during_job(bench: &mut Bench, speeds: [f64; 2], setpoints: &[Setpoint]) {
    let start = bench.status().commanded;
    bench.start_part(1, &start, &[rest(&start, 2000)]);
    bench.ask(Command::Hold).expect("holds");
    bench.steps(2000);
    for axis in [1, 2] {
        let source = Source::Jog;
        bench.ask(Command::Source { axis, source }).expect("chosen");
    }
    bench.ask(Command::Resume).expect("goes on");
    let mut coder = SetpointCoder::new(200, &start);
    coder.encode(&rest(&start, 2000)).expect("codes");
    for (index, batch) in setpoints.chunks(SETPOINT_BATCH).enumerate() {
        let items = batch.iter().map(|of| coder.encode(of).expect("codes"));
        let items = items.collect();
        let first = (index * SETPOINT_BATCH) as u32 + 1;
        bench
            .ask(Command::Setpoints(SetpointBatch { first, items }))
            .expect("allowed where the machine stands");
    }
    let count = setpoints.len() as u32 + 1;
    bench.ask(Command::JobEnd { count }).expect("complete");
    bench
        .ask(setup::jog(1, 1000, &[(1, speeds[0]), (2, speeds[1])]))
        .expect("jogs");
}

/// A tilt to 20 degrees after a pause. At y = 0 the fastest slide is near its maximum rate; it is
/// faster where y and z are lower.
fn fast_tilt(start: &AxisValues) -> Vec<Setpoint> {
    let mut spans = vec![(10_000, 0.0), (1500, 12.42)];
    spans.extend([(100, 12.42); 60]);
    spans.push((1500, 0.0));
    tilt(start, &spans)
}

/// The motion of jogs is unknown when setpoints are accepted. The machine brakes along its path,
/// and reports the joint.
#[test]
fn an_excessive_joint_rate_by_a_jog_is_a_fault_that_keeps_the_position() {
    let mut bench = ready();
    let setpoints = fast_tilt(&bench.status().commanded);
    let planned = peak_rates(&bench.status().commanded, &setpoints);
    let planned = planned.into_iter().fold(0.0, f64::max);
    assert!((0.99 * LIMIT..1.01 * LIMIT).contains(&planned), "{planned}");
    jog_during_job(&mut bench, [-40.0, -25.0], &setpoints);
    let mut commanded = Commanded::default();
    for _ in 0..30_000 {
        commanded.step(&mut bench);
        if state(&bench) == State::Fault {
            break;
        }
    }
    bench.steps(500);
    let (joint, rate) = joint_rate_fault(&bench).expect("the fault");
    println!(
        "joint {joint} at {rate} mm/s; commanded {}",
        commanded.fastest
    );
    assert!(
        rate.abs() > 1.03 * LIMIT && rate.abs() < 1.04 * LIMIT,
        "{rate}"
    );
    // The rate may rise until the deceleration has built up.
    assert!(
        (1.03 * LIMIT..1.05 * LIMIT).contains(&commanded.fastest),
        "{}",
        commanded.fastest
    );
    assert_eq!(state(&bench), State::Fault);
    assert_eq!(
        setup::reported_faults(&bench).len(),
        1,
        "{:?}",
        bench.events
    );
    bench.steps(2000);
    assert!(!setup::drives_off(&bench));
    assert!(bench.status().position_kept);
    for joint in 0..5 {
        let off = setup::following_error(&bench, joint);
        assert!(off < 0.02, "joint {joint} is off by {off}");
    }
    setup::recover(&mut bench, State::Idle);
    // A jog moves the machine back.
    bench.ask(setup::jog(2, 500, &[(1, 10.0)])).expect("jogs");
    bench.steps(4000);
    assert_eq!(state(&bench), State::Idle);
}

/// Jogs beside programs with joint rates near their maximum or far from it, while the feed override
/// changes.
///
/// Every joint above the limit of the fault is reported, and no other.
#[test]
fn jogs_during_a_program_exceed_no_joint_rate_or_are_reported() {
    let mut random = Random(23);
    let (mut reported, mut fine, mut fast) = (0, 0, 0);
    for case in 0..16 {
        let mut bench = ready();
        let start = bench.status().commanded;
        let slow = case % 2 == 0;
        let speed = if slow {
            random.uniform(1.0, 4.0)
        } else {
            12.42
        };
        let mut spans = vec![(2000, 0.0), (1500, speed)];
        spans.extend([(200, speed); 30]);
        spans.push((1500, 0.0));
        spans.push((1500, -speed));
        spans.extend([(200, -speed); 30]);
        spans.push((1500, 0.0));
        let down = if slow { 10.0 } else { -15.0 };
        let speeds = [random.sign() * 35.0, random.uniform(-35.0, down)];
        jog_during_job(&mut bench, speeds, &tilt(&start, &spans));
        let mut commanded = Commanded::default();
        for epoch in 2..=10 {
            let least = if slow { 5.0 } else { 80.0 };
            let percent = random.uniform(least, 100.9) as u8;
            let _ = bench.send(Command::Override { percent });
            let rates = [
                (1, random.sign() * random.uniform(10.0, 50.0)),
                (2, random.uniform(-30.0, 20.0)),
            ];
            let _ = bench.send(setup::jog(epoch, 800, &rates));
            commanded.steps(&mut bench, 3000);
            if state(&bench) == State::Fault {
                break;
            }
        }
        bench.steps(500);
        let fault = joint_rate_fault(&bench);
        let most = commanded.fastest;
        println!("case {case}, {speed:.1} degrees/s: {most:.3} mm/s, {fault:?}");
        assert!(
            most <= 1.10 * LIMIT,
            "case {case}: a slide was commanded {most} mm/s"
        );
        // The joint accelerates until the deceleration has built up. A mean over 8 periods is a
        // little less than the rate of one.
        assert!(
            fault.is_some() || most <= 1.033 * LIMIT,
            "case {case}: {most} mm/s was not reported"
        );
        assert!(
            fault.is_none() || most > 1.029 * LIMIT,
            "case {case}: {fault:?} at {most} mm/s"
        );
        if fault.is_some() {
            assert!(bench.status().position_kept && !setup::drives_off(&bench));
            reported += 1;
        } else {
            fine += 1;
        }
        fast += u32::from(most > 0.9 * LIMIT);
        assert!(!slow || fault.is_none(), "case {case}: {fault:?}");
    }
    println!("{reported} reported, {fine} not, {fast} fast");
    assert!(
        fine >= 8 && reported >= 2 && fast >= 4,
        "{reported} reported, {fine} not, {fast} fast"
    );
}
