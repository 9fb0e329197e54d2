//! Force feedback of a local and a remote tool, and virtual fixtures.

use super::bench::Bench;
use super::mill;
use haptimill_checks::reference;
use haptimill_firmware::config::Config;
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, VirtualFixture};
use haptimill_protocol::message::{Command, Refusal};

/// A master: a controller without axes. It renders the remote force with a limited slope, and its
/// telemetry moves another machine.
#[test]
fn master_arm_renders_the_remote_force() {
    let mut bench = Bench::ready(reference::master());
    assert_eq!(bench.ask(Command::MasterTelemetry { every: 20 }), Ok(()));
    bench.inputs.haptic.enabling_switch = true;
    bench.steps(600);
    let mut last = bench.force();
    let mut steps = 0;
    let mut run = |bench: &mut Bench, force: [f64; 3], periods: usize| {
        for k in 0..periods {
            if k % 50 == 0 {
                let force = force.map(|part| (part * 64.0) as i16);
                bench.say(Command::RemoteForce { force });
            }
            bench.step();
            let now = bench.force();
            for axis in 0..3 {
                assert!((now[axis] - last[axis]).abs() <= 0.0501, "{now:?} {last:?}");
                steps += usize::from((now[axis] - last[axis]).abs() > 0.0499);
            }
            last = now;
        }
        last
    };
    // 40 % of 5 N, 10 % and 20 % of 5 N; then the limits of 3.2 and 1.2 N.
    let force = run(&mut bench, [5.0, -5.0, 5.0], 1000);
    for (force, want) in force.into_iter().zip([2.0, -0.5, 1.0]) {
        assert!((force - want).abs() < 0.01, "{force} {want}");
    }
    let force = run(&mut bench, [40.0, -5.0, -40.0], 1000);
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
    assert_eq!(bench.ask(Command::ForceFeedback(settings)), Ok(()));
    let force = run(&mut bench, [10.0, 0.0, 0.0], 8000);
    assert!((force[0] - 2.0).abs() < 0.01, "{force:?}");
    let bad = ForceFeedback {
        axes: [ForceFeedbackAxis {
            percent: 101,
            limit: 0,
        }; 3],
        ..settings
    };
    assert_eq!(bench.ask(Command::ForceFeedback(bad)), Err(Refusal::Range));
    assert!(steps > 10, "the step was never used");
    // No further force of the tool arrives: the feedback decays by itself.
    bench.steps(1500);
    assert!(bench.force()[0].abs() < 0.01);
    let master = bench.master_report.expect("telemetry of the master");
    assert!(master.pose.enabling_switch && master.enabled && master.problem.is_none());
    assert!(
        (f64::from(master.pose.tip[2]) / 1_048_576.0 - 600.0).abs() < 0.05,
        "{master:?}"
    );
    assert!(master.pose.axes[0][0] > 32_700 && master.pose.axes[1][2] > 32_700);
}

#[test]
fn virtual_fixtures_push_back_and_move() {
    let mut bench = Bench::ready(reference::master());
    let at = |x: f64| Some((x * 1_048_576.0) as i32);
    let fixture = |x: f64, rate: f64| {
        Some(VirtualFixture {
            at: at(x),
            rate: (rate * 4096.0) as i32,
        })
    };
    assert_eq!(
        bench.ask(Command::VirtualFixture {
            axis: 0,
            upper: false,
            fixture: fixture(-10.0, 0.0)
        }),
        Ok(())
    );
    assert_eq!(
        bench.ask(Command::VirtualFixture {
            axis: 0,
            upper: true,
            fixture: fixture(-6.0, 0.0)
        }),
        Err(Refusal::FixturesTooNear)
    );
    assert_eq!(
        bench.ask(Command::VirtualFixture {
            axis: 3,
            upper: true,
            fixture: None
        }),
        Err(Refusal::Range)
    );
    bench.move_master([-9.0, 0.0, 0.0], 5000);
    assert_eq!(bench.force()[0], 0.0);
    bench.move_master([-6.0, 0.0, 0.0], 5000);
    // At rest: the oscillation damper takes some tenths of a second to find no oscillation.
    bench.steps(4000);
    assert!(
        (bench.force()[0] - 5.0 * 0.35).abs() < 0.02,
        "{}",
        bench.force()[0]
    );
    bench.move_master([-20.0, 0.0, 0.0], 9000);
    bench.steps(4000);
    assert!(
        (bench.force()[0] - 5.5).abs() < 0.01,
        "{}",
        bench.force()[0]
    );
    bench.move_master([35.0, 0.0, 0.0], 9000);
    // Thrown back by the fixture, the hand may be damped while it moves.
    assert!(bench.force()[0].abs() < 0.5);
    bench.steps(500);
    assert_eq!(bench.force()[0], 0.0);
    // E6: from the handle, 4 mm/s in -X.
    let moving = VirtualFixture {
        at: None,
        rate: -4 * 4096,
    };
    assert_eq!(
        bench.ask(Command::VirtualFixture {
            axis: 0,
            upper: false,
            fixture: Some(moving)
        }),
        Ok(())
    );
    bench.move_master([-20.0, 0.0, 0.0], 5000);
    // 20 mm in a second, the fixture 4 mm behind: 16 mm ahead of it, 5.5 N at the most.
    assert!(
        (bench.force()[0] - 5.5).abs() < 0.15,
        "{}",
        bench.force()[0]
    );
    bench.move_master([-1.0, 0.0, 0.0], 5000);
    // It comes after: 13 mm, and 0.4 mm less a tenth of a second later, when a hand at rest is not
    // damped any more.
    bench.steps(500);
    assert!(
        (bench.force()[0] - 12.6 * 0.35).abs() < 0.02,
        "{}",
        bench.force()[0]
    );
}

/// The currents follow the force sample of the same period, and the law holds in steady contact.
#[test]
fn force_is_rendered_in_its_sample_period() {
    let config = Config {
        force: Some(reference::force()),
        ..mill()
    };
    let mut bench = Bench::ready(config);
    bench.tare();
    bench.master(0);
    bench.start_job();
    bench.inputs.haptic.enabling_switch = true;
    bench.steps(1500);
    let before = bench.outputs.haptic.currents;
    // 5 N in x: 410 codes.
    bench.codes = Some([410, 0, 0]);
    bench.step();
    assert_ne!(bench.outputs.haptic.currents, before);
    assert!(
        (bench.force()[0] - 0.05).abs() < 0.02,
        "{}",
        bench.force()[0]
    );
    bench.steps(200);
    assert!(
        (bench.force()[0] - 2.0).abs() < 0.05,
        "{}",
        bench.force()[0]
    );
    // Lifted, the handle is free; nothing jumps.
    bench.inputs.haptic.enabling_switch = false;
    let mut last = bench.force()[0];
    for _ in 0..1000 {
        bench.step();
        assert!((bench.force()[0] - last).abs() <= 0.0501);
        last = bench.force()[0];
    }
    assert!(last.abs() < 0.01);
}
