//! Interpolator and jog: limits, exact ends, no lost setpoint, no overshoot.

use crate::path;
use crate::reference;

use haptimill_firmware::motion::interpolator::{FULL_FACTOR, Interpolator, QUEUE};
use haptimill_firmware::motion::jog::Jog;
use haptimill_kinematics::{
    BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use haptimill_math::Acceleration;
use haptimill_protocol::message::{Action, MAX_AXES, Refusal};
use haptimill_protocol::setpoint::Setpoint;
use path::{PERIOD_S, Path, UNIT_MM, setpoint, start, straight, walk};
use proptest::prelude::*;
use reference::{h4, mm};

/// A ramp that arrives may pass its target by twice the jerk of a period: 2 * 5000 mm/s^3 * (200
/// us)^2, in axis units per second.
const OVERSHOOT: i32 = 420;
#[test]
fn program_ends_at_its_last_setpoint_on_time() {
    let mut program = start(&h4());
    let points = straight(4.0, 40, 100);
    for point in &points {
        program.push(point).expect("accepted");
    }
    program.end(points.len() as u32).expect("at rest");
    let path = walk(&mut program, 10_000, |_| false);
    assert!(path.finished);
    // It begins in the period after the first.
    assert_eq!(path.x.len(), 1 + 42 * 100);
    assert_eq!(
        mm(*path.x.last().expect("moved")),
        points.last().expect("some").pose[0]
    );
    assert_eq!(program.reached(), 42);
}

#[test]
fn invalid_setpoints_are_refused_without_effect() {
    let mut program = start(&h4());
    let refused =
        |program: &mut Interpolator, point: &Setpoint| program.push(point).expect_err("refused");
    assert_eq!(
        refused(&mut program, &setpoint(1.0, 0.0, 0)),
        Refusal::Setpoint { setpoint: 0 }
    );
    assert_eq!(
        refused(&mut program, &setpoint(100.0, 0.0, 10)),
        Refusal::Setpoint { setpoint: 0 }
    );
    assert_eq!(
        refused(&mut program, &setpoint(0.1, 80.0, 100)),
        Refusal::Setpoint { setpoint: 0 }
    );
    let mut short = setpoint(0.1, 0.0, 100);
    short.pose.pop();
    assert_eq!(refused(&mut program, &short), Refusal::CoordinateCount);
    let pause = Setpoint {
        action: Action::Pause,
        ..setpoint(0.1, 1.0, 500)
    };
    assert_eq!(
        refused(&mut program, &pause),
        Refusal::Setpoint { setpoint: 0 }
    );
    assert_eq!(program.end(1), Err(Refusal::OutOfOrder { expected: 0 }));
    program.push(&setpoint(0.1, 1.0, 1000)).expect("accepted");
    assert_eq!(
        program.end(1),
        Err(Refusal::Setpoint { setpoint: 0 }),
        "a job must end at rest"
    );
    assert_eq!(program.accepted(), 1);
}

#[test]
fn credit_is_the_free_queue_space() {
    let mut program = start(&h4());
    assert_eq!(program.credit(), QUEUE as u32);
    for index in 0..QUEUE {
        program
            .push(&setpoint(0.01 * (index + 1) as f64, 0.0, 100))
            .expect("room");
    }
    assert_eq!(program.credit(), QUEUE as u32);
    assert_eq!(
        program.push(&setpoint(3.0, 0.0, 100)),
        Err(Refusal::QueueFull)
    );
    let _ = walk(&mut program, 150, |_| false);
    assert!(program.credit() > QUEUE as u32);
}

#[test]
fn pause_waits_at_its_setpoint() {
    let mut program = start(&h4());
    program
        .push(&Setpoint {
            action: Action::Pause,
            ..setpoint(1.0, 0.0, 1000)
        })
        .expect("at rest");
    program.push(&setpoint(2.0, 0.0, 1000)).expect("accepted");
    program.end(2).expect("at rest");
    let path = walk(&mut program, 5000, |_| false);
    assert!(!path.finished);
    assert_eq!(mm(*path.x.last().expect("moved")), mm(1.0));
    program.leave_pause();
    let path = walk(&mut program, 5000, |_| false);
    assert!(path.finished);
    assert_eq!(path.x.len(), 1000);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Hold and resume at any time: same end, no step, deceleration within its limits, no reverse
    /// motion.
    #[test]
    fn hold_and_resume_keep_the_path(speed in 1.0_f64..40.0, hold_at in 0_usize..6000, hold_for in 1_usize..2000) {
        let config = h4();
        let mut program = start(&config);
        let points = straight(speed, 60, 100);
        for point in &points {
            program.push(point).expect("accepted");
        }
        program.end(points.len() as u32).expect("at rest");
        let path = walk(&mut program, 20_000, |period| (hold_at..hold_at + hold_for).contains(&period));
        prop_assert!(path.finished);
        prop_assert_eq!(mm(*path.x.last().expect("moved")), points.last().expect("some").pose[0]);
        prop_assert!(path.x.windows(2).all(|w| w[1] >= w[0]), "never backwards");
        // The program's own start takes 20 ms; braking takes 120 ms with 30 ms ramps.
        path.assert_consistent();
        let (acceleration, _) = path.dynamics(0, usize::MAX);
        let own = 1.05 * 2.0 * speed / 0.02;
        let braking = speed / 0.09;
        prop_assert!(acceleration <= own + braking + 2.0, "{acceleration} {own} {braking}");
        let first_hold = hold_at.max(200) + 40;
        if first_hold + 700 < 60 * 100 && hold_for > 800 && hold_at > 200 {
            let (acceleration, jerk) = path.dynamics(first_hold, first_hold + 700);
            prop_assert!(acceleration <= braking * 1.01 + 1.0, "{acceleration} {braking}");
            prop_assert!(jerk <= braking / 0.03 * 1.05 + 100.0, "{jerk}");
        }
    }

    /// Late setpoints: the machine stops before the last one and resumes when more arrive.
    /// A retraction follows the path as far as requested or stored, and ends at standstill.
    #[test]
    fn retraction_stays_on_the_path(speed in 1.0_f64..40.0, hold_at in 700_usize..9000, back in 1_u32..3000) {
        let config = h4();
        let mut program = start(&config);
        for point in straight(speed, 100, 100) {
            program.push(&point).expect("room");
        }
        program.end(102).expect("complete");
        let mut path = walk(&mut program, hold_at, |_| false);
        path.take(walk(&mut program, 1500, |_| true));
        prop_assert!(program.is_at_standstill());
        let rest = *path.x.last().expect("some");
        let reached = program.reached();
        program.retract(back);
        prop_assert!(!program.is_at_standstill());
        path.take(walk(&mut program, 4 * back as usize + 3000, |_| true));
        prop_assert!(program.is_at_standstill());
        path.assert_consistent();
        let end = *path.x.last().expect("some");
        for pair in path.x[hold_at + 1500..].windows(2) {
            prop_assert!(pair[1] <= pair[0] + UNIT_MM && pair[0] - pair[1] <= speed * PERIOD_S / 4.0 + 2.0 * UNIT_MM);
        }
        // 16 setpoints, 20 ms apart, and what was gone since the last of them.
        let remembered = 16.0 * 0.02;
        let asked = f64::from(back) * PERIOD_S;
        let gone = (rest - end) / speed;
        if rest - speed * (asked.min(remembered) + 0.04) > 0.0 && hold_at < 8000 {
            prop_assert!(gone <= asked + 1e-4 && gone <= remembered + 0.0201, "{gone} {asked}");
            prop_assert!(gone >= asked.min(remembered) - 1e-4, "{gone} of {asked}");
        }
        prop_assert!(end >= 0.0 && program.reached() <= reached);
        let (acceleration, _) = path.dynamics(hold_at + 1501, path.x.len());
        prop_assert!(acceleration <= speed / 0.09 * 1.02 + 1.0, "{acceleration}");
    }

    #[test]
    fn late_setpoints_decelerate_on_the_path(speed in 1.0_f64..40.0, delivered in 14_usize..50, gap in 1_usize..3000) {
        let config = h4();
        let mut program = start(&config);
        let points = straight(speed, 60, 100);
        for point in &points[..delivered] {
            program.push(point).expect("accepted");
        }
        let last = f64::from(points[delivered - 1].pose[0]) * UNIT_MM;
        let path = walk(&mut program, 100 * delivered + 400 + gap, |_| false);
        prop_assert!(path.x.iter().all(|&x| x <= last), "passed the last setpoint");
        prop_assert_eq!(program.speed_factor(), 0);
        let (acceleration, _) = path.dynamics(200, usize::MAX);
        prop_assert!(acceleration <= speed / 0.09 * 1.01 + 2.0, "{acceleration}");
        for point in &points[delivered..] {
            program.push(point).expect("accepted");
        }
        let underrun = program.take_underrun().expect("reported");
        prop_assert_eq!(underrun.setpoint, delivered as u32);
        prop_assert!(underrun.periods as usize >= gap, "{} {}", underrun.periods, gap);
        program.end(points.len() as u32).expect("at rest");
        let path = walk(&mut program, 20_000, |_| false);
        prop_assert!(path.finished);
        prop_assert_eq!(mm(*path.x.last().expect("moved")), points.last().expect("some").pose[0]);
    }

    /// Prefetched parts of a segment give the same motion to the bit: with segments of any
    /// duration, holds, late setpoints and retractions.
    #[test]
    fn prefetch_does_not_change_the_motion(
        spans in prop::collection::vec(1_u16..120, 30..60), free in prop::collection::vec(any::<bool>(), 1..9), every in 1_usize..60,
        hold_at in 20_usize..2000, hold_for in 1_usize..900, back in 0_u32..400,
    ) {
        let mut x = 2.0 * 100.0 * PERIOD_S / 2.0;
        let mut points = vec![setpoint(x, 2.0, 100)];
        for periods in spans {
            x += 2.0 * f64::from(periods) * PERIOD_S;
            points.push(setpoint(x, 2.0, periods));
        }
        points.push(setpoint(x + 2.0 * 100.0 * PERIOD_S / 2.0, 0.0, 100));
        let mut programs = [start(&h4()), start(&h4())];
        let mut mark = false;
        for period in 0..20_000 {
            let holds = (hold_at..hold_at + hold_for).contains(&period) || (back > 0 && period >= hold_at);
            let gone = programs.each_mut().map(|program| {
                if period % every == 0 && let Some(point) = points.get(period / every) {
                    program.push(point).expect("room");
                    if period / every + 1 == points.len() {
                        program.end(points.len() as u32).expect("at rest");
                    }
                }
                if back > 0 && period == hold_at {
                    program.retract(back);
                }
                let gone = program.advance(holds);
                (gone, program.program_time(), program.reached(), program.queued(), program.is_at_standstill())
            });
            prop_assert_eq!(gone[0], gone[1], "period {}", period);
            let [_, program] = &mut programs;
            program.prefetch(free[period / 2 % free.len()], || free[period % free.len()]);
            mark = gone[0].0.1.finished || (back > 0 && period > hold_at + 900 && gone[0].4);
            if mark {
                break;
            }
        }
        prop_assert!(mark);
    }

    /// A lower override takes longer by its factor and ends at the same position.
    #[test]
    fn override_stretches_time(percent in 5_u8..=100) {
        let mut program = start(&h4());
        program.set_override(percent);
        let points = straight(4.0, 60, 100);
        for point in &points {
            program.push(point).expect("accepted");
        }
        program.end(points.len() as u32).expect("at rest");
        let path = walk(&mut program, 200_000, |_| false);
        prop_assert!(path.finished);
        let expected = 1.0 + 6200.0 * 100.0 / f64::from(percent);
        prop_assert!((path.x.len() as f64 - expected).abs() < 2.0, "{} {expected}", path.x.len());
        prop_assert!(program.speed_factor() <= FULL_FACTOR);
    }
}

/// A machine that can reach a ball around the origin.
struct Ball {
    radius_mm: f64,
}

impl Kinematics for Ball {
    fn axes(&self) -> usize {
        5
    }
    fn box_bounds(&self, low: &Pose, high: &Pose, _: &[Rates]) -> Result<BoxBounds, PoseError> {
        // A ball is convex: it contains a box whose corners it contains.
        for corner in 0..1_u32 << 3 {
            let mut pose = *low;
            for (axis, value) in pose.0.iter_mut().enumerate().take(3) {
                if corner & (1 << axis) != 0 {
                    *value = high.0[axis];
                }
            }
            self.inverse(&pose)?;
        }
        Ok(BoxBounds::default())
    }
    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let radius: f64 = pose.0[..3]
            .iter()
            .map(|x| (f64::from(x.0) * UNIT_MM).powi(2))
            .sum::<f64>()
            .sqrt();
        if radius <= self.radius_mm {
            Ok(Joints(pose.0))
        } else {
            Err(PoseError::Unreachable)
        }
    }
    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &[Acceleration; MAX_AXES],
    ) -> Result<JointMotion, PoseError> {
        Ok(JointMotion {
            joints: self.inverse(pose)?,
            rates: *rates,
            accelerations: *accelerations,
        })
    }
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        Ok(Pose(joints.0))
    }
    fn jacobian(&self, _: &Pose) -> Result<Jacobian, PoseError> {
        Err(PoseError::Unreachable)
    }
}

fn jog_rates(x: f64, y: f64, z: f64) -> [i64; MAX_AXES] {
    [x, y, z, 0.0, 0.0, 0.0].map(|speed| i64::from(mm(speed)))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Any jog stays within soft limits, reach, rate, acceleration and jerk, and is at standstill
    /// after its timeout.
    #[test]
    fn jog_keeps_all_limits(commands in prop::collection::vec((-60.0_f64..60.0, -60.0_f64..60.0, -60.0_f64..60.0, 1_u32..4000), 1..8)) {
        let config = h4();
        let ball = Ball { radius_mm: 90.0 };
        let mut jog = Jog::new(&config);
        jog.begin(&Pose::default(), true);
        let mut paths = [Path::default(), Path::default(), Path::default()];
        for (x, y, z, periods) in commands {
            jog.set_rates(&jog_rates(x, y, z), periods);
            for _ in 0..periods + 300 {
                let (commanded, _) = jog.advance(&ball);
                prop_assert!(ball.inverse(&commanded.pose).is_ok());
                for (axis, path) in paths.iter_mut().enumerate() {
                    path.push(commanded.pose.0[axis], commanded.rates[axis]);
                    prop_assert!((config.pose[axis].low..=config.pose[axis].high).contains(&commanded.pose.0[axis]));
                    prop_assert!(commanded.rates[axis].0.abs() <= config.pose[axis].rate.0 + OVERSHOOT);
                }
            }
        }
        for _ in 0..2500 {
            let _ = jog.advance(&ball);
        }
        prop_assert!(jog.is_at_standstill(), "at rest after the timeout");
        for path in &paths {
            path.assert_consistent();
            let (acceleration, jerk) = path.dynamics(0, usize::MAX);
            prop_assert!(acceleration <= 200.1, "{acceleration}");
            // A ramp that arrives may change its slope by twice the jerk in one of the 16 periods
            // over which this is measured.
            prop_assert!(jerk <= 5001.0 + 5000.0 / 16.0, "{jerk}");
        }
    }
}
