//! Joint rates by jogs: under force control, and during a program.

use crate::setup;
use haptimill_protocol::force::EnableCondition;
use haptimill_protocol::message::{
    AxisValues, Command, Event, Fault, SETPOINT_BATCH, SetpointBatch, Source, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::Bench;
use setup::slides::{LIMIT, peak_rates, slides, tilt};
use setup::{DEGREE, MM, ready, rest, state};

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
            joint, rate, limit, ..
        }) => {
            assert_eq!(f64::from(*limit) / MM, LIMIT);
            Some((*joint, f64::from(*rate) / MM))
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
            let settings = setup::force::force_settings(0.8, 2.0, EnableCondition::Any);
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
    for coordinate in [1, 2] {
        let source = Source::Jog;
        bench
            .ask(Command::Source { coordinate, source })
            .expect("chosen");
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
    assert!(bench.status().homed);
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
            let min = if slow { 5.0 } else { 80.0 };
            let percent = random.uniform(min, 100.9) as u8;
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
        let max = commanded.fastest;
        println!("case {case}, {speed:.1} degrees/s: {max:.3} mm/s, {fault:?}");
        assert!(
            max <= 1.10 * LIMIT,
            "case {case}: a slide was commanded {max} mm/s"
        );
        // The joint accelerates until the deceleration has built up. A mean over 8 periods is a
        // little less than the rate of one.
        assert!(
            fault.is_some() || max <= 1.033 * LIMIT,
            "case {case}: {max} mm/s was not reported"
        );
        assert!(
            fault.is_none() || max > 1.029 * LIMIT,
            "case {case}: {fault:?} at {max} mm/s"
        );
        if fault.is_some() {
            assert!(bench.status().homed && !setup::drives_off(&bench));
            reported += 1;
        } else {
            fine += 1;
        }
        fast += u32::from(max > 0.9 * LIMIT);
        assert!(!slow || fault.is_none(), "case {case}: {fault:?}");
    }
    println!("{reported} reported, {fine} not, {fast} fast");
    assert!(
        fine >= 8 && reported >= 2 && fast >= 4,
        "{reported} reported, {fine} not, {fast} fast"
    );
}
