//! A coordinate that wraps around: the table C of `machines/trunnion5.toml` over several turns.
//!
//! The controller holds angles of one turn. The unwound motion is the sum of their differences,
//! each of less than half a turn.

use haptimill_firmware::motion::interpolator::Interpolator;
use haptimill_firmware::motion::jog::Jog;
use haptimill_kinematics::{Joints, Kinematics, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Action, AxisValues, MAX_AXES};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::job;
use haptimill_trace::{Quantity, Recording, flag, replay};
use proptest::prelude::*;
use std::path::Path;
use std::sync::LazyLock;

static MACHINE: LazyLock<MachineFile> = LazyLock::new(|| {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines/trunnion5.toml");
    MachineFile::load(&file).unwrap_or_else(|problems| panic!("{problems}"))
});

/// The table in a pose and in the joints.
const C: usize = 4;
/// Axis units per turn.
const TURN: i64 = 1 << 32;
/// Seconds of a control period.
const PERIOD: f64 = 2e-4;

/// The home pose with the table at an angle.
fn pose(angle: i32) -> Pose {
    let mut joints = Joints::default();
    for (joint, preset) in joints.0.iter_mut().zip(MACHINE.preset()) {
        *joint = preset;
    }
    let mut pose = MACHINE.config.kinematics().forward(&joints).expect("home");
    pose.0[C] = Coordinate(angle);
    pose
}

/// Sum of the differences of angles.
struct Unwound {
    angle: i32,
    total: i64,
}

impl Unwound {
    fn follow(&mut self, angle: Coordinate) -> i64 {
        let by = i64::from(angle.0.wrapping_sub(self.angle));
        self.angle = angle.0;
        self.total += by;
        by
    }
}

#[test]
fn a_program_turns_the_table_many_times_forwards_and_back() {
    let machine = &*MACHINE;
    let model = Model::new(machine);
    let home = job::home(machine);
    let start = model.to_engineering_units(&home);
    // 5 turns up, 7.5 down while the tool moves, then absolute angles in both directions.
    let text = "G21 G91 F10200\nG1 C1800\nG0 C-2700 X3\nG90\nG1 C90\nG1 C-45\nG0 C45\nM30\n";
    let plan = job::plan(machine, text).unwrap_or_else(|refused| panic!("{refused}"));
    // The planned setpoints, unwound.
    let mut planned = Unwound {
        angle: home[C],
        total: 0,
    };
    let (mut low, mut high) = (0, 0);
    for setpoint in &plan.setpoints {
        planned.follow(Coordinate(setpoint.pose[C]));
        low = low.min(planned.total);
        high = high.max(planned.total);
    }
    assert_eq!((high, low), (5 * TURN, -5 * TURN / 2));
    assert_eq!(planned.total, -15 * TURN / 8);

    let mut session = job::homed(machine, vec![]);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("recording.hmr");
    job::begin_recording(&mut session, &path, &plan, machine, |_| ());
    for round in 0..2 {
        let end = job::run(&mut session, 2 + round, machine, &plan);
        if round == 0 {
            job::end_recording(&mut session);
        }
        assert!(end.status.homed);
        // Telemetry counts the turns.
        let status = session.status().expect("a status");
        let unwound = model.unwound_pose(&status.measured, &status)[C];
        let want = start[C] - 675.0 - 720.0 * f64::from(round);
        assert!((unwound - want).abs() < 0.05, "{unwound}, not {want}");
        let joint = model.unwound_joints(&status)[C];
        assert!((joint - want).abs() < 0.05, "{joint}, not {want}");
        // Back to the home pose, the shorter way: from 45 degrees.
        session.go_home(machine, &home).expect("homed again");
    }
    let line = session.into_line();
    let truth = line.rig().plant().truth();
    // Each round ends at -675 degrees, and the shorter way home is 45 degrees down.
    let off = truth.joints[C] - 2.0 * (-675.0 - 45.0);
    assert!(off.abs() < 0.05, "the table is off by {off} degrees");
    for (axis, (truth, start)) in truth.pose.iter().zip(&start).take(3).enumerate() {
        let off = truth - start;
        assert!(off.abs() < 0.05, "axis {axis} is off by {off} mm");
    }

    // The recording has the unwound angles, and the true pose is that of the command throughout.
    let recording = Recording::open(&path).expect("readable");
    let degrees = |units: i64| units as f64 * 360.0 / TURN as f64;
    let (mut low, mut high, mut worst) = (0.0_f64, 0.0_f64, 0.0_f64);
    for record in recording.iter().expect("records") {
        let record = record.expect("a record");
        let commanded = degrees(record.unwound(Quantity::Commanded, C));
        (low, high) = (low.min(commanded), high.max(commanded));
        let others = [
            (record.has(flag::TOOL_TRUE), Quantity::Tool),
            (record.has(flag::PROGRAMMED), Quantity::Programmed),
            (true, Quantity::Joints),
        ];
        for (_, quantity) in others.into_iter().filter(|(known, _)| *known) {
            let off = degrees(record.unwound(quantity, C)) - commanded;
            worst = worst.max(off.abs());
        }
    }
    println!("largest difference from the command: {worst:.4} deg");
    assert!(
        (high - 1800.0).abs() < 0.01 && (low + 900.0).abs() < 0.01,
        "{low} {high}"
    );
    // The lag of the servo loop at 170 deg/s, and half a degree where the program pauses.
    assert!(worst < 1.0, "{worst}");
    assert!(replay::replay(&recording).expect("replayable").is_ok());
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// A jog turns without end: no period moves farther than its rate, and every position up to
    /// standstill is in the arc that the envelope stated before.
    #[test]
    fn a_jog_turns_without_a_step_and_stops_within_its_envelope(
        start: i32,
        targets in prop::collection::vec((-1.0..1.0_f64, 1_u32..15_000), 1..6),
    ) {
        let config = &MACHINE.config;
        let kinematics = config.kinematics();
        let mut jog = Jog::new(config);
        jog.begin(&pose(start), true);
        let max = f64::from(config.pose[C].rate.0);
        let mut unwound = Unwound { angle: start, total: 0 };
        let (mut integral, mut before, mut periods) = (0.0, 0.0, 0);
        for (part, length) in targets {
            let mut rates = [0; MAX_AXES];
            rates[C] = (part * max) as i64;
            jog.set_rates(&rates, length);
            for _ in 0..length {
                let envelope = jog.stopping(true).expect("an envelope");
                let (commanded, limited) = jog.advance(&kinematics);
                prop_assert_eq!(limited, None);
                let by = unwound.follow(commanded.pose.0[C]) as f64;
                prop_assert!(by.abs() <= max * PERIOD * 1.001 + 2.0, "{} units in a period", by);
                let arc = envelope.high.0[C].wrapping_sub(envelope.low.0[C]).0 as u32;
                let at = commanded.pose.0[C].wrapping_sub(envelope.low.0[C]).0 as u32;
                prop_assert!(at <= arc, "{} of {}", at, arc);
                let rate = f64::from(commanded.rates[C].0);
                integral += 0.5 * (before + rate) * PERIOD;
                before = rate;
                periods += 1;
            }
        }
        // The ramp adds the rate at the end of a period, so its sum may be half a period off.
        let off = unwound.total as f64 - integral;
        prop_assert!(off.abs() < max * PERIOD + 2.0 * f64::from(periods), "{} units", off);
        let envelope = jog.stopping(false).expect("an envelope");
        let arc = envelope.high.0[C].wrapping_sub(envelope.low.0[C]).0 as u32;
        jog.release();
        while !jog.is_at_standstill() {
            let (commanded, _) = jog.advance(&kinematics);
            let at = commanded.pose.0[C].wrapping_sub(envelope.low.0[C]).0 as u32;
            prop_assert!(at <= arc, "{} of {}", at, arc);
        }
    }

    /// Setpoints over turns: the coder returns every bit, and the interpolator follows the unwound
    /// path.
    #[test]
    fn setpoints_over_turns_are_coded_and_interpolated_exactly(
        start: i32,
        steps in prop::collection::vec((-1.0..1.0_f64, 100_u16..1250), 1..60),
    ) {
        let config = &MACHINE.config;
        let max = f64::from(config.pose[C].rate.0);
        let home = pose(start);
        let base: AxisValues = home.0[..5].iter().map(|coordinate| coordinate.0).collect();
        let mut sender = SetpointCoder::new(config.period_us, &base);
        let mut receiver = sender.clone();
        let mut program = Interpolator::new(config);
        program.begin(&home);
        // Unwound knots: period, position, rate in axis units.
        let mut knots = vec![(0_u64, i64::from(start), 0_i64)];
        let last = steps.len() - 1;
        for (index, (part, periods)) in steps.into_iter().enumerate() {
            let (at, place, rate) = knots[knots.len() - 1];
            let wire = if index == last { 0 } else { (part * max / 256.0) as i64 };
            // At most the acceleration that setpoints may have: a change of rate takes its time.
            let change = (wire * 256 - rate).unsigned_abs() as f64;
            let min = change / (4.0 * 256.0 * f64::from(config.pose[C].acceleration.0)) / PERIOD;
            let periods = periods.max(min.ceil() as u16);
            let end = wire * 256;
            let by = ((rate + end) as f64 * 0.5 * f64::from(periods) * PERIOD).round() as i64;
            let setpoint = Setpoint {
                periods,
                pose: {
                    let mut pose = base.clone();
                    pose[C] = (place + by) as i32;
                    pose
                },
                rates: [0, 0, 0, 0, wire as i32].into_iter().collect(),
                action: Action::None,
            };
            let delta = sender.encode(&setpoint).expect("coded");
            prop_assert_eq!(receiver.decode(&delta).expect("decoded"), setpoint.clone());
            prop_assert_eq!(program.push(&setpoint), Ok(()));
            knots.push((at + u64::from(periods), place + by, end));
        }
        program.end(knots.len() as u32 - 1).expect("ended");
        let mut unwound = Unwound { angle: start, total: i64::from(start) };
        let mut segment = 0;
        loop {
            let (commanded, progress) = program.advance(false);
            unwound.follow(commanded.pose.0[C]);
            if progress.finished {
                break;
            }
            let now = program.program_time() as f64 / f64::from(2_u32.pow(16)).powi(2);
            while knots[segment + 1].0 as f64 <= now && segment + 2 < knots.len() {
                segment += 1;
            }
            let [(t0, p0, v0), (t1, p1, v1)] = [knots[segment], knots[segment + 1]];
            let span = (t1 - t0) as f64;
            let s = ((now - t0 as f64) / span).min(1.0);
            let (v0, v1) = (v0 as f64 * span * PERIOD, v1 as f64 * span * PERIOD);
            let d = (p1 - p0) as f64;
            let by = ((v0 + v1 - 2.0 * d) * s + 3.0 * d - 2.0 * v0 - v1) * s * s + v0 * s;
            let off = (unwound.total - p0) as f64 - by;
            // 2^-28 of half a turn and the rounding of the time: see `segment`.
            prop_assert!(off.abs() <= 64.0, "{off} units off at {now}");
        }
        prop_assert_eq!(unwound.total, knots[knots.len() - 1].1);
    }
}
