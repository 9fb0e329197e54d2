//! Sessions that are opened again after their link or their port is lost.

use super::*;
use crate::port::PortError;
use haptimill_protocol::message::Command;
use std::cell::Cell;
use std::rc::Rc;

/// A line to a simulated haptic arm whose port fails, or which delivers nothing, on demand.
struct FaultyLine {
    line: SimLine,
    fault: Rc<Cell<Fault>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    Silent,
    PortLost,
}

impl Line for FaultyLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
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
}

fn line(fault: &Rc<Cell<Fault>>) -> FaultyLine {
    let machine = MachineFile::built_in_master().unwrap();
    FaultyLine {
        line: SimLine::new(rig(&machine, None, None, Vec::new()).unwrap()),
        fault: Rc::clone(fault),
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
    let (fault, mut number) = (Rc::clone(fault), 0);
    session.with_reconnection(Reconnection {
        numbers: Box::new(move || {
            number += 1;
            number
        }),
        reopen: Some(Box::new(move || Ok(line(&fault)))),
    })
}

/// Steps until the session is ready, and returns the time that took, microseconds.
fn wait_ready(session: &mut Session<FaultyLine>) -> u64 {
    let since = session.now_us();
    while *session.phase() != Phase::Ready {
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
    while *session.phase() == Phase::Ready {
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

#[test]
fn a_lost_port_is_opened_again_with_a_new_clock() {
    let fault = Rc::new(Cell::new(Fault::None));
    let mut session = session(&fault, true);
    session.begin_next();
    wait_ready(&mut session);
    fault.set(Fault::PortLost);
    session.step().unwrap();
    assert_eq!(*session.phase(), Phase::Disconnected);
    assert!(
        session.reason().contains("unplugged"),
        "{}",
        session.reason()
    );
    // A disconnected session does nothing until its owner opens the port.
    session.step().unwrap();
    assert_eq!(*session.phase(), Phase::Disconnected);
    fault.set(Fault::None);
    assert!(session.reopen(7_000_000) && session.now_us() == 0);
    session.step().unwrap();
    session.begin_next();
    wait_ready(&mut session);
    assert!(is_enabled(&mut session));
    assert!(session.client().controller().is_some());
}

#[test]
fn without_a_reconnection_a_lost_port_ends_the_session() {
    let fault = Rc::new(Cell::new(Fault::None));
    let mut session = session(&fault, false);
    session.connect(1).unwrap();
    assert!(is_enabled(&mut session));
    fault.set(Fault::PortLost);
    let error = session.step().unwrap_err();
    assert!(error.kind == ErrorKind::Port && error.message.contains("unplugged"));
}
