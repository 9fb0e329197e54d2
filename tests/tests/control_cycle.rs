//! The whole control cycle: commands over the link move the simulated machine.

use haptimill_protocol::message::{Event, State};
use haptimill_tests::{Bench, line_in_x};

#[test]
fn a_homed_machine_follows_a_line() {
    const MM: f64 = (1 << 20) as f64;
    let mut bench = Bench::new();
    bench.make_ready();
    let status = bench.status();
    assert!(status.homed);
    // After homing the measured pose is the true one except for backlash, screw friction and a
    // count.
    for axis in 0..3 {
        let off = f64::from(status.measured[axis]) / MM - bench.rig.truth().pose[axis];
        assert!(off.abs() < 0.012, "axis {axis} off by {off} mm");
    }
    bench.start_job(1, &line_in_x(&status.commanded, -4.0, 20));
    let (mut worst, mut sum) = (0.0_f64, 0.0_f64);
    for _ in 0..11_500 {
        bench.step();
        let commanded = bench
            .rig
            .control()
            .machine()
            .expect("configured")
            .motion
            .commanded()
            .pose;
        let error: f64 = (0..3)
            .map(|i| (f64::from(commanded.0[i].0) / MM - bench.rig.truth().pose[i]).powi(2))
            .sum::<f64>()
            .sqrt();
        worst = worst.max(error);
        sum += error * error;
    }
    println!(
        "tool error: rms {:.4} mm, largest {worst:.4} mm",
        (sum / 11_500.0).sqrt()
    );
    let status = bench.status();
    assert_eq!((status.state, status.fault), (State::Idle, None));
    assert!(
        bench.events.contains(&Event::JobDone {
            job: 1,
            setpoints: 22
        }),
        "{:?}",
        bench.events
    );
    assert!(worst < 0.05, "{worst}");
}
