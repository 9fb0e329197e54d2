//! Sessions that are opened again after their link or their port is lost.

use super::*;
use crate::flash::Board;
use crate::port::PortError;
use haptimill_protocol::message::{Command, State};
use std::cell::Cell;
use std::rc::Rc;

/// A line to a simulated haptic arm whose port fails, or which delivers nothing, on demand.
struct FaultyLine {
    line: SimLine,
    fault: Rc<Cell<Fault>>,
    is_closed: Cell<bool>,
    /// The first bytes after the last opening.
    first: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    Silent,
    PortLost,
}

impl Line for FaultyLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        assert!(!self.is_closed.get(), "bytes for a closed port");
        if self.first.len() < 8 {
            self.first.extend_from_slice(transmit);
        }
        match self.fault.get() {
            Fault::None => self.line.exchange(transmit, received),
            Fault::Silent => self.line.exchange(&[], &mut Vec::new()),
            Fault::PortLost => Err(PortError::Gone {
                name: self.name(),
                reason: "unplugged".to_string(),
            }),
        }
    }

    fn name(&self) -> String {
        "faulty line".to_string()
    }

    fn close(&mut self) -> bool {
        self.is_closed.set(true);
        true
    }

    fn open(&mut self) -> Result<Option<u64>, PortError> {
        match self.fault.get() {
            Fault::PortLost => Err(PortError::Gone {
                name: self.name(),
                reason: "still unplugged".to_string(),
            }),
            _ => {
                self.is_closed.set(false);
                Ok(Some(self.line.rig().time_ns() / 1000))
            }
        }
    }
}

fn line(fault: &Rc<Cell<Fault>>) -> FaultyLine {
    let machine = MachineFile::built_in_master().unwrap();
    FaultyLine {
        line: SimLine::new(rig(&machine, None, None, Vec::new()).unwrap()),
        fault: Rc::clone(fault),
        is_closed: Cell::new(false),
        first: Vec::new(),
    }
}

/// A session of a haptic arm, as teleoperation uses it.
fn session(fault: &Rc<Cell<Fault>>, reconnects: bool) -> Session<FaultyLine> {
    let machine = MachineFile::built_in_master().unwrap();
    let commands = vec![Command::Enable, Command::MasterTelemetry { every: 5 }];
    let startup = Startup::new(&machine, None, commands).unwrap();
    let session = Session::new(line(fault), &machine, Options::default(), Arc::default())
        .with_startup(startup);
    if !reconnects {
        return session;
    }
    let mut number = 0;
    session.with_reconnection(Box::new(move || {
        number += 1;
        number
    }))
}

/// Steps until the session is ready, and returns the time that took, microseconds.
fn wait_ready(session: &mut Session<FaultyLine>) -> u64 {
    let since = session.now_us();
    while *session.phase() != SessionPhase::Ready {
        session.step().unwrap();
        assert!(
            session.now_us() < since + 5_000_000,
            "{:?}",
            session.phase()
        );
    }
    session.now_us() - since
}

/// Whether the controller itself has executed the startup.
fn is_enabled(session: &mut Session<FaultyLine>) -> bool {
    session.line_mut().line.rig().outputs().haptic.enabled
}

#[test]
fn a_silent_controller_is_connected_again_and_gets_its_startup_again() {
    let fault = Rc::new(Cell::new(Fault::None));
    let mut session = session(&fault, true);
    session.begin_next();
    wait_ready(&mut session);
    assert!(is_enabled(&mut session));
    fault.set(Fault::Silent);
    while *session.phase() == SessionPhase::Ready {
        session.step().unwrap();
        assert!(session.now_us() < 10_000_000);
    }
    assert!(
        session.reason().contains("nothing was received"),
        "{}",
        session.reason()
    );
    fault.set(Fault::None);
    wait_ready(&mut session);
    // A new session has no telemetry of the master before the startup requests it.
    assert_eq!(session.client().master(), None);
    let until = session.now_us() + 100_000;
    while session.client().master().is_none() {
        session.step().unwrap();
        assert!(session.now_us() < until);
    }
}

/// Loses the port of a session that is ready, and keeps it lost for a time.
fn lose_port(session: &mut Session<FaultyLine>, fault: &Rc<Cell<Fault>>) {
    fault.set(Fault::PortLost);
    session.step().unwrap();
    assert_eq!(*session.phase(), SessionPhase::Disconnected);
    assert!(
        session.reason().contains("unplugged"),
        "{}",
        session.reason()
    );
    // An attempt that fails is no error.
    session.step().unwrap();
    assert_eq!(*session.phase(), SessionPhase::Disconnected);
    assert!(session.reason().contains("still unplugged"));
    session.line_mut().first.clear();
}

#[test]
fn a_lost_port_is_opened_again_and_its_controller_gets_the_startup() {
    let fault = Rc::new(Cell::new(Fault::None));
    let mut session = session(&fault, true);
    session.begin_next();
    wait_ready(&mut session);
    lose_port(&mut session, &fault);
    // Requests of the lost session have failed, and the time of the line goes on.
    let before_us = session.now_us();
    for _ in 0..50_000 {
        session.line_mut().line.rig_mut().step();
    }
    fault.set(Fault::None);
    session.step().unwrap();
    wait_ready(&mut session);
    assert!(session.now_us() > before_us + 10_000_000);
    assert!(is_enabled(&mut session) && session.is_configured());
}

#[test]
fn a_port_without_an_answer_is_closed_and_opened_again() {
    let fault = Rc::new(Cell::new(Fault::Silent));
    let mut session = session(&fault, true);
    session.begin_next();
    while *session.phase() != SessionPhase::Disconnected {
        session.step().unwrap();
        assert!(session.now_us() < 5_000_000);
    }
    assert!(
        session.reason().contains("no controller answered"),
        "{}",
        session.reason()
    );
    fault.set(Fault::None);
    wait_ready(&mut session);
}

#[test]
fn a_stop_without_a_session_is_sent_first_and_an_emergency_stop_is_latched() {
    let fault = Rc::new(Cell::new(Fault::None));
    let mut session = session(&fault, true);
    session.begin_next();
    wait_ready(&mut session);
    lose_port(&mut session, &fault);
    session.emergency_stop();
    assert!(session.is_emergency_pending());
    fault.set(Fault::None);
    session.step().unwrap();
    // The startup of an arm enables its drives: the controller refuses that after the stop.
    wait_ready(&mut session);
    let snapshot = session.line_mut().line.snapshot().unwrap();
    assert_eq!(snapshot.state, State::EmergencyStop);
    assert!(!is_enabled(&mut session) && !session.is_emergency_pending());
    assert_eq!(session.line_mut().first[..3], [0x00, 0x18, 0x00]);
}

#[test]
fn without_reconnection_a_lost_port_ends_the_session() {
    let fault = Rc::new(Cell::new(Fault::None));
    let mut session = session(&fault, false);
    session.connect(1).unwrap();
    assert!(is_enabled(&mut session));
    fault.set(Fault::PortLost);
    let error = session.step().unwrap_err();
    assert!(error.kind == ErrorKind::Port && error.message.contains("unplugged"));
}

/// Setpoints so short that a full queue lasts no longer than braking: the controller stops for want
/// of setpoints, and resumes when the queue is full. The host must fill its last places, which are
/// fewer than a batch.
#[test]
fn a_starved_job_with_short_segments_resumes() {
    use haptimill_protocol::setpoint::Setpoint;
    let machine = MachineFile::built_in().unwrap();
    let line = SimLine::new(rig(&machine, None, None, Vec::new()).unwrap()).unrecorded();
    let mut session = Session::new(line, &machine, Options::default(), Arc::default());
    session.connect(1).unwrap();
    session.configure(&machine).unwrap();
    session.enable().unwrap();
    let home = find_home_pose(&machine, session.model()).unwrap();
    session.go_home(&machine, &home).unwrap();
    session.keep_telemetry(5);
    // 0.1 s up to 10 mm/s, 5 s at it, 0.1 s down, in segments of 5 periods of 0.2 ms.
    const MM: f64 = 1_048_576.0;
    let mut x = f64::from(home[0]);
    let mut setpoints = Vec::new();
    let mut add = |periods: u16, mean: f64, rate: f64| {
        x += mean * f64::from(periods) * 2e-4 * MM;
        let mut pose = home.clone();
        pose[0] = x as i32;
        setpoints.push(Setpoint {
            periods,
            pose,
            rates: [(rate * MM / 256.0) as i32, 0, 0, 0, 0]
                .into_iter()
                .collect(),
            ..Setpoint::default()
        });
    };
    add(500, 5.0, 10.0);
    for _ in 0..5000 {
        add(5, 10.0, 10.0);
    }
    add(500, 5.0, 0.0);
    let mut run = JobRun::start(&mut session, 7, home, setpoints);
    for _ in 0..400_000 {
        if let JobStatus::Ended(end) = run.advance(&mut session, &mut NoObserver).unwrap() {
            session.check_completed(&end).unwrap();
            return;
        }
        session.step().unwrap();
    }
    panic!("the job does not resume: {:?}", session.client().job());
}

/// A line whose port names its board.
struct BoardLine(SimLine);

impl Line for BoardLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        self.0.exchange(transmit, received)
    }

    fn name(&self) -> String {
        "/dev/ttyACM0".to_string()
    }

    fn board(&self) -> Option<&'static Board> {
        Board::named("pico2")
    }
}

/// A machine file for another board is refused before it is sent, by commands and by the console.
#[test]
fn a_machine_that_the_board_cannot_drive_is_not_configured() {
    let machine = MachineFile::built_in().unwrap();
    let line = || BoardLine(SimLine::new(rig(&machine, None, None, Vec::new()).unwrap()));
    let mut session = Session::new(line(), &machine, Options::default(), Arc::default());
    session.connect(1).unwrap();
    let refused = session.configure(&machine).unwrap_err();
    assert_eq!(refused.kind, ErrorKind::BadInput);
    assert!(refused.message.contains("no torque drives"), "{refused}");
    assert_eq!(session.machine_name(), "");
    let startup = Startup::new(&machine, None, Vec::new()).unwrap();
    let mut session =
        Session::new(line(), &machine, Options::default(), Arc::default()).with_startup(startup);
    let refused = session.connect(1).unwrap_err();
    assert!(refused.message.contains("no torque drives"), "{refused}");
    assert_eq!(session.machine_name(), "");
    // A mill that the board can drive.
    let mill = include_str!("../../../../machines/mill3.toml");
    let mill = mill.replace("ticks_per_us = 84", "ticks_per_us = 75");
    let mill = MachineFile::parse("mill3.toml", &mill).unwrap();
    let line = BoardLine(SimLine::new(rig(&mill, None, None, Vec::new()).unwrap()));
    let mut session = Session::new(line, &mill, Options::default(), Arc::default());
    session.connect(1).unwrap();
    session.configure(&mill).unwrap();
    assert_eq!(session.machine_name(), "mill3");
}

/// A machine file for an image with another control period is refused before it is sent.
#[test]
fn a_machine_with_another_control_period_is_not_configured() {
    let board = MachineFile::built_in().unwrap();
    let slower = board.text.replace("period_us = 200", "period_us = 400");
    let slower = MachineFile::parse("slower.toml", &slower).unwrap();
    let line = || SimLine::new(rig(&board, None, None, Vec::new()).unwrap());
    let mut session = Session::new(line(), &slower, Options::default(), Arc::default());
    session.connect(1).unwrap();
    let refused = session.configure(&slower).unwrap_err();
    assert_eq!(refused.kind, ErrorKind::BadInput);
    let text = "simulator: the control period of the board is 200 us, and slower.toml has \
                period_us = 400; set it to 200, or write an image with a period of 400 us into the \
                board";
    assert_eq!(refused.message, text);
    let startup = Startup::new(&slower, None, Vec::new()).unwrap();
    let mut session =
        Session::new(line(), &slower, Options::default(), Arc::default()).with_startup(startup);
    assert_eq!(session.connect(1).unwrap_err().message, text);
    assert_eq!(session.machine_name(), "");
}
