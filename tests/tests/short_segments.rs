//! Setpoints at intervals of a few milliseconds, closer than the planner of this project places
//! them.

use haptimill_client::client::Options;
use haptimill_client::session::{NoObserver, Session, SimLine, rig};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{Action, AxisValues, State};
use haptimill_protocol::setpoint::Setpoint;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

const MM: f64 = (1 << 20) as f64;

/// Returns a line in x and y: 0.1 s to `speed` mm/s, `count` segments, 0.1 s to standstill.
fn line(start: &AxisValues, speed: f64, periods: u16, count: usize) -> Vec<Setpoint> {
    let mut place = [f64::from(start[0]), f64::from(start[1])];
    (0..count + 2)
        .map(|span| {
            let ends = span == 0 || span == count + 1;
            let (periods, mean) = if ends {
                (500, speed / 2.0)
            } else {
                (periods, speed)
            };
            let rate = if span == count + 1 { 0.0 } else { speed };
            let mut pose = start.clone();
            for (axis, place) in place.iter_mut().enumerate() {
                *place += mean * f64::from(periods) * 2e-4 * MM;
                pose[axis] = *place as i32;
            }
            Setpoint {
                periods,
                pose,
                rates: [(rate * 4096.0) as i32, (rate * 4096.0) as i32, 0, 0, 0]
                    .into_iter()
                    .collect(),
                action: Action::None,
            }
        })
        .collect()
}

/// The host sends as many setpoints as the credit allows. The queue must never run low.
#[test]
fn setpoints_at_one_millisecond_cause_no_underrun() {
    let machine = MachineFile::built_in().expect("sound");
    let home = Model::new(&machine).home(&machine).expect("a pose");
    let stop = Arc::new(AtomicBool::new(false));
    let line_of = SimLine::new(rig(&machine, None, None, vec![]).expect("sound"));
    let mut session = Session::new(line_of, &machine, Options::default(), stop);
    session.connect(1).expect("answers");
    session.configure(&machine).expect("accepted");
    session.enable().expect("enabled");
    session.go_home(&machine, &home).expect("homed");
    let mut speed = 4.0;
    for (job, periods) in [25, 16, 10, 7, 5].into_iter().enumerate() {
        let start = session.status().expect("status").commanded;
        let count = 20_000 / usize::from(periods);
        let job = session.run_job(
            2 + job as u32,
            start.clone(),
            line(&start, speed, periods, count),
            &mut NoObserver,
        );
        let end = job.expect("ended");
        assert_eq!(end.underruns, [], "{periods} periods a setpoint");
        assert_eq!(end.status.state, State::Idle);
        speed = -speed;
    }
}
