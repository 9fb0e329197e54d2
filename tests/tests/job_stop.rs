//! A stopped job ends at standstill, whatever was under way before.

use haptimill_client::client::Options;
use haptimill_client::port::PortError;
use haptimill_client::session::{Line, NoObserver, Session, SimLine, rig};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::State;
use haptimill_tests::line_in_x;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The simulated machine, and a user who requests a stop after a number of exchanges.
struct Impatient {
    line: SimLine,
    left: Option<u32>,
    stop: Arc<AtomicBool>,
}

impl Line for Impatient {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        if let Some(left) = &mut self.left {
            *left = left.saturating_sub(1);
            self.stop.store(*left == 0, Ordering::Relaxed);
        }
        self.line.exchange(transmit, received)
    }

    fn name(&self) -> String {
        self.line.name()
    }
}

/// Telemetry of earlier periods may arrive after the end of the job. It shows the state hold, and
/// the machine is idle.
#[test]
fn the_summary_of_a_stopped_job_has_the_final_state() {
    let machine = MachineFile::built_in().expect("sound");
    let home = Model::new(&machine).home(&machine).expect("a pose");
    let stop = Arc::new(AtomicBool::new(false));
    let line = Impatient {
        line: SimLine::new(rig(&machine, None, None, vec![]).expect("sound")),
        left: None,
        stop: stop.clone(),
    };
    let mut session = Session::new(line, &machine, Options::default(), stop.clone());
    session.connect(1).expect("answers");
    session.configure(&machine).expect("accepted");
    session.enable().expect("enabled");
    session.go_home(&machine, &home).expect("homed");
    let mut speed = 2.0;
    let mut others = vec![];
    for periods in 0..120 {
        let start = session.status().expect("status").commanded;
        session.line_mut().left = Some(300 + periods);
        let job = session.run_job(
            2 + periods,
            start.clone(),
            line_in_x(&start, speed, 10),
            &mut NoObserver,
        );
        let end = job.expect("ended");
        let last = session.events.len().saturating_sub(12);
        assert!(
            end.stopped,
            "{:?} {:?}",
            end.ending,
            &session.events[last..]
        );
        if end.status.state != State::Idle {
            others.push((periods, end.status.state));
        }
        session.line_mut().left = None;
        stop.store(false, Ordering::Relaxed);
        speed = -speed;
    }
    assert_eq!(others, []);
}
