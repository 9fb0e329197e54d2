//! Receive and transmit share the slices: neither a blocked nor a saturated direction starves the
//! other.

use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_protocol::link::{HostLink, Timing};
use haptimill_protocol::message::{Command, Report, Request, State};

const PERIOD_US: u16 = 200;

/// A controller without a machine, and a host on a line of 20 bytes a period.
struct Line {
    controller: Controller,
    inputs: Inputs,
    outputs: Outputs,
    host: HostLink,
    telemetry: Vec<u64>,
}

impl Line {
    fn open() -> Self {
        let mut line = Self {
            controller: Controller::new(PERIOD_US),
            inputs: Inputs::default(),
            outputs: Outputs::default(),
            host: HostLink::new(Timing::default()),
            telemetry: vec![],
        };
        line.inputs.transmit_room = 20;
        line.host.open(5, 0);
        line.run(1000, |_| ());
        assert_ne!(line.host.session(), 0);
        line
    }

    fn run(&mut self, periods: usize, mut send: impl FnMut(&mut HostLink)) {
        for _ in 0..periods {
            send(&mut self.host);
            self.inputs.period += 1;
            let now_us = self.inputs.period * u64::from(PERIOD_US);
            let mut room = [0; 20];
            let count = self.host.transmit(now_us, &mut room);
            self.inputs.received.clear();
            self.inputs
                .received
                .extend_from_slice(&room[..count])
                .expect("room");
            self.controller
                .tick(&self.inputs, &mut self.outputs, &mut ());
            self.host.receive(now_us, &self.outputs.transmit);
            while let Some(report) = self.host.poll_message() {
                if let Report::Telemetry(telemetry) = report {
                    self.telemetry.push(telemetry.period);
                }
            }
        }
    }
}

fn request(id: u8, command: Command) -> Request {
    Request { id, command }
}

/// Requests are executed although nothing can be transmitted, as with one broken wire.
#[test]
fn requests_are_executed_while_the_transmit_line_is_blocked() {
    for after in 0..40 {
        let mut line = Line::open();
        for id in 1..5 {
            line.host.send(&request(id, Command::Status)).expect("room");
        }
        line.run(after, |_| ());
        line.inputs.transmit_room = 0;
        line.host
            .send(&request(9, Command::EmergencyStop))
            .expect("room");
        line.run(100, |_| ());
        assert_eq!(
            line.controller.safety().state(),
            State::EmergencyStop,
            "blocked after {after} periods"
        );
    }
}

/// Longest gap between telemetry messages, and their number in 5000 periods, for a host that sends
/// without a pause.
fn telemetry(every: u16, answered: bool) -> (u64, usize) {
    let mut line = Line::open();
    line.host
        .send(&request(1, Command::Telemetry { every }))
        .expect("room");
    let mut id = 1;
    line.run(5000, |host| {
        loop {
            let next = if answered { id % 250 + 1 } else { 0 };
            if host.send(&request(next, Command::Ping)).is_err() {
                break;
            }
            id = next;
        }
    });
    let gaps = line.telemetry.windows(2).map(|pair| pair[1] - pair[0]);
    (gaps.max().unwrap_or(u64::MAX), line.telemetry.len())
}

/// A host that sends without a pause gets telemetry at its interval, also where every request is
/// answered.
#[test]
fn telemetry_is_sent_under_continuous_requests() {
    for (every, answered) in [100, 20, 10]
        .into_iter()
        .flat_map(|every| [(every, false), (every, true)])
    {
        let (longest, count) = telemetry(every, answered);
        assert!(
            longest <= 2 * u64::from(every) + 10,
            "{longest} periods, {every} asked for, {answered}"
        );
        // Each answer supersedes telemetry that waits, so telemetry comes a little later.
        let min = if answered { 2000 } else { 4800 };
        assert!(count >= min / usize::from(every), "{count}, {answered}");
    }
}
