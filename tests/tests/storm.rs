//! The storm, a handful of seeds of it: each theme once, the same to the last bit each time; and its references, which must tell right from wrong.

use haptimill_protocol::message::Action;
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::storm::bench::World;
use haptimill_tests::storm::reference::{Arithmetic, Course, Tracked};
use haptimill_tests::storm::run;
use haptimill_tests::storm::script::{Episode, Kind, Theme};
use haptimill_tests::storm::watch::{MM, bounds};

/// The first seed of a theme from `from` on.
fn seed_of(theme: Theme, from: u64) -> u64 {
    (from..from + 10_000)
        .find(|seed| {
            let episode = Episode::of(*seed);
            episode.theme == theme && episode.pushed.is_none()
        })
        .expect("every theme comes")
}

#[test]
fn one_episode_of_each_theme_holds_all_checks() {
    for (theme, _) in Theme::ALL {
        let seed = seed_of(theme, 5000);
        let outcome = run(&Episode::of(seed));
        assert_eq!(outcome.violation, None, "{theme:?}, seed {seed}");
        assert!(theme == Theme::Files || outcome.periods > 5000);
    }
}

#[test]
fn a_seed_is_the_same_episode_each_time() {
    let episode = Episode::of(seed_of(Theme::Wild, 7000));
    assert_eq!(episode, Episode::of(episode.seed));
    let (first, second) = (run(&episode), run(&episode));
    assert_eq!(first.violation, second.violation);
    assert_eq!(first.periods, second.periods);
    assert_eq!(first.counts, second.counts);
    assert_eq!(first.largest, second.largest);
}

fn setpoint(periods: u16, x_mm: f64, rate_mm_s: f64) -> Setpoint {
    Setpoint {
        periods,
        pose: [(x_mm * MM) as i32, 0, 0, 0, 0].into_iter().collect(),
        rates: [(rate_mm_s * 4096.0) as i32, 0, 0, 0, 0]
            .into_iter()
            .collect(),
        action: Action::None,
    }
}

fn tracked(periods: f64, reached: u32, x_mm: f64) -> Tracked {
    Tracked {
        time: (periods * 4_294_967_296.0) as u64,
        reached,
        accepted: 2,
        pose: [x_mm * MM, 0.0, 0.0, 0.0, 0.0, 0.0],
        halted: false,
        spindle: 0,
        held: false,
    }
}

fn course() -> Course {
    let mut course = Course::default();
    // 0.1 s from rest to 1 mm at 20 mm/s (a parabola), 0.1 s on to 2 mm at rest.
    course.offer(&[setpoint(500, 1.0, 20.0), setpoint(500, 2.0, 0.0)]);
    course.begin([0.0; 6]);
    course
}

#[test]
fn a_skipped_setpoint_and_a_wrong_pose_are_told_from_the_plan() {
    // A quarter of the way up a parabola after half the time.
    let off = course().check(&tracked(250.0, 0, 0.25)).expect("right");
    assert!(off < 2.0, "{off}");
    let off = course()
        .check(&tracked(250.0, 0, 0.25005))
        .expect("right in order");
    assert!(off > bounds::CUBIC, "{off}");
    assert!(course().check(&tracked(250.0, 1, 0.25)).is_err());
    assert!(course().check(&tracked(500.0, 0, 1.0)).is_err());
    let mut late = tracked(1000.0, 2, 2.0);
    late.accepted = 1;
    assert!(course().check(&late).is_err());
    let mut twice = course();
    twice.check(&tracked(250.0, 0, 0.25)).expect("right");
    assert!(twice.check(&tracked(252.0, 0, 0.254)).is_err());
}

#[test]
fn a_micrometre_of_a_joint_opens_the_rods() {
    let episode = Episode {
        kind: Kind::Torque,
        baud: None,
        ..Episode::of(1)
    };
    let world = World::new(&episode);
    let arithmetic = Arithmetic::new(&world.plant);
    let truth = world.rig.plant().truth();
    let turn = 4_294_967_296.0 / 360.0;
    let mut pose = truth.pose.map(|place| place * MM);
    pose[3] = truth.pose[3] * turn;
    pose[4] = truth.pose[4] * turn;
    let mut joints = truth.joints.map(|place| place * MM);
    joints[4] = truth.joints[4] * turn;
    let right = arithmetic.residual(&pose, &joints);
    assert!(right < bounds::RESIDUAL, "{right}");
    for joint in 0..4 {
        let mut moved = joints;
        moved[joint] += 0.001 * MM;
        let wrong = arithmetic.residual(&pose, &moved);
        assert!(wrong > bounds::RESIDUAL, "joint {joint}: {wrong}");
    }
}
