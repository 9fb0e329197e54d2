//! It feels: a tool here and one afar, and virtual walls.

use crate::bed::Bed;
use crate::mill;
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, VirtualFixture};
use haptimill_protocol::message::{Command, Refusal};

/// A role master: the same controller without axes. It feels what it is told, within what may change in a period, and its telemetry leads another.
#[test]
fn an_arm_alone_feels_what_a_tool_afar_feels() {
    let mut bed = Bed::ready(reference::master());
    assert_eq!(bed.ask(Command::MasterTelemetry { every: 20 }), Ok(()));
    bed.inputs.haptic.engaged = true;
    bed.steps(600);
    let mut last = bed.felt();
    let mut steps = 0;
    let mut run = |bed: &mut Bed, force: [f64; 3], periods: usize| {
        for k in 0..periods {
            if k % 50 == 0 {
                let force = force.map(|part| (part * 64.0) as i16);
                bed.say(Command::RemoteForce { force });
            }
            bed.step();
            let now = bed.felt();
            for axis in 0..3 {
                assert!((now[axis] - last[axis]).abs() <= 0.0501, "{now:?} {last:?}");
                steps += usize::from((now[axis] - last[axis]).abs() > 0.0499);
            }
            last = now;
        }
        last
    };
    // 40 % of 5 N, 10 % and 20 % of 5 N; then the limits of 3.2 and 1.2 N.
    let force = run(&mut bed, [5.0, -5.0, 5.0], 1000);
    for (force, want) in force.into_iter().zip([2.0, -0.5, 1.0]) {
        assert!((force - want).abs() < 0.01, "{force} {want}");
    }
    let force = run(&mut bed, [40.0, -5.0, -40.0], 1000);
    for (force, want) in force.into_iter().zip([3.2, -0.5, -1.2]) {
        assert!((force - want).abs() < 0.01, "{force} {want}");
    }
    // Another percentage comes in gently.
    let axis = ForceFeedbackAxis {
        percent: 20,
        limit: 3 << 16,
    };
    let settings = ForceFeedback {
        axes: [axis; 3],
        damping: 6554,
        damping_below: 2 << 16,
    };
    assert_eq!(bed.ask(Command::ForceFeedback(settings)), Ok(()));
    let force = run(&mut bed, [10.0, 0.0, 0.0], 8000);
    assert!((force[0] - 2.0).abs() < 0.01, "{force:?}");
    let bad = ForceFeedback {
        axes: [ForceFeedbackAxis {
            percent: 101,
            limit: 0,
        }; 3],
        ..settings
    };
    assert_eq!(bed.ask(Command::ForceFeedback(bad)), Err(Refusal::Range));
    assert!(steps > 10, "the step was never used");
    // Nothing more is heard of the tool: the force goes away by itself.
    bed.steps(1500);
    assert!(bed.felt()[0].abs() < 0.01);
    let hand = bed.hand_report.expect("telemetry of the hand");
    assert!(hand.pose.engaged && hand.enabled && hand.problem.is_none());
    assert!(
        (f64::from(hand.pose.tip[2]) / 1_048_576.0 - 600.0).abs() < 0.05,
        "{hand:?}"
    );
    assert!(hand.pose.axes[0][0] > 32_700 && hand.pose.axes[1][2] > 32_700);
}

#[test]
fn virtual_walls_push_back_and_a_moving_one_goes_along() {
    let mut bed = Bed::ready(reference::master());
    let at = |x: f64| Some((x * 1_048_576.0) as i32);
    let wall = |x: f64, rate: f64| {
        Some(VirtualFixture {
            at: at(x),
            rate: (rate * 4096.0) as i32,
        })
    };
    assert_eq!(
        bed.ask(Command::VirtualFixture {
            axis: 0,
            upper: false,
            fixture: wall(-10.0, 0.0)
        }),
        Ok(())
    );
    assert_eq!(
        bed.ask(Command::VirtualFixture {
            axis: 0,
            upper: true,
            fixture: wall(-6.0, 0.0)
        }),
        Err(Refusal::FixturesTooNear)
    );
    assert_eq!(
        bed.ask(Command::VirtualFixture {
            axis: 3,
            upper: true,
            fixture: None
        }),
        Err(Refusal::Range)
    );
    bed.lead([-9.0, 0.0, 0.0], 5000);
    assert_eq!(bed.felt()[0], 0.0);
    bed.lead([-6.0, 0.0, 0.0], 5000);
    // At rest: what watches the swings takes some tenths of a second to see that there is none.
    bed.steps(4000);
    assert!(
        (bed.felt()[0] - 5.0 * 0.35).abs() < 0.02,
        "{}",
        bed.felt()[0]
    );
    bed.lead([-20.0, 0.0, 0.0], 9000);
    bed.steps(4000);
    assert!((bed.felt()[0] - 5.5).abs() < 0.01, "{}", bed.felt()[0]);
    bed.lead([35.0, 0.0, 0.0], 9000);
    // Thrown back by the wall, the hand may be damped while it moves.
    assert!(bed.felt()[0].abs() < 0.5);
    bed.steps(500);
    assert_eq!(bed.felt()[0], 0.0);
    // E6: from the handle, 4 mm/s in -X.
    let moving = VirtualFixture {
        at: None,
        rate: -4 * 4096,
    };
    assert_eq!(
        bed.ask(Command::VirtualFixture {
            axis: 0,
            upper: false,
            fixture: Some(moving)
        }),
        Ok(())
    );
    bed.lead([-20.0, 0.0, 0.0], 5000);
    // 20 mm in a second, the wall 4 mm behind: 16 mm ahead of it, 5.5 N at the most.
    assert!((bed.felt()[0] - 5.5).abs() < 0.15, "{}", bed.felt()[0]);
    bed.lead([-1.0, 0.0, 0.0], 5000);
    // It comes after: 13 mm, and 0.4 mm less a tenth of a second later, when a hand at rest is not damped any more.
    bed.steps(500);
    assert!(
        (bed.felt()[0] - 12.6 * 0.35).abs() < 0.02,
        "{}",
        bed.felt()[0]
    );
}

/// From the sensor here to the hand here: the currents of the period in which the force was sampled, and its law in steady contact.
#[test]
fn a_force_is_felt_in_the_period_in_which_it_was_sampled() {
    let config = Config {
        force: Some(reference::force()),
        ..mill()
    };
    let mut bed = Bed::ready(config);
    bed.tare();
    bed.master(0);
    bed.start_job();
    bed.inputs.haptic.engaged = true;
    bed.steps(1500);
    let before = bed.outputs.haptic.currents;
    // 5 N in x: 410 codes.
    bed.codes = Some([410, 0, 0]);
    bed.step();
    assert_ne!(bed.outputs.haptic.currents, before);
    assert!((bed.felt()[0] - 0.05).abs() < 0.02, "{}", bed.felt()[0]);
    bed.steps(200);
    assert!((bed.felt()[0] - 2.0).abs() < 0.05, "{}", bed.felt()[0]);
    // Lifted, the handle is free; nothing jumps.
    bed.inputs.haptic.engaged = false;
    let mut last = bed.felt()[0];
    for _ in 0..1000 {
        bed.step();
        assert!((bed.felt()[0] - last).abs() <= 0.0501);
        last = bed.felt()[0];
    }
    assert!(last.abs() < 0.01);
}
