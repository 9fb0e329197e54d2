//! Checks of the whole controller, from the first byte of a host to the last step of a job.
//!
//! The machine is as simple as possible: it makes and counts every step, and each motor turn has an
//! index pulse. The checks test the state machine, and that the drives are off when required.

use crate::Check;
use crate::reference::{h4_with_steps, mm};
use haptimill_firmware::comm::server::CONFIG_BYTES;
use haptimill_firmware::config::Config;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};
use haptimill_protocol::frame::crc32;
use haptimill_protocol::link::{HostLink, LinkState, Timing};
use haptimill_protocol::message::{
    Action, AxisValues, CONFIG_CHUNK, Command, ConfigChunk, DriveAlarm, Event, Fault, Refusal,
    Report, Request, SETPOINT_BATCH, SetpointBatch, State, Telemetry,
};
use haptimill_protocol::out_of_band::STOP;
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use heapless::Vec;

/// The checks of this module.
pub const CHECKS: &[Check] = &[
    Check {
        name: "states::a_job_from_power_on_to_its_last_setpoint",
        run: job,
    },
    Check {
        name: "states::a_stop_holds_the_job_and_it_goes_on_where_it_was",
        run: stop,
    },
    Check {
        name: "states::a_drive_that_trips_is_a_fault_and_all_drives_are_off_at_once",
        run: trip,
    },
    Check {
        name: "states::the_emergency_stop_is_latched_until_it_is_released_and_reset",
        run: emergency,
    },
    Check {
        name: "states::missed_periods_are_a_fault",
        run: late,
    },
    Check {
        name: "states::a_configuration_that_does_not_fit_is_refused",
        run: misfit,
    },
    Check {
        name: "states::lost_bytes_are_reported",
        run: lost,
    },
];

/// Joints of the machine.
const JOINTS: usize = 5;

/// A controller, its machine and a host.
struct Bed {
    controller: Controller,
    inputs: Inputs,
    outputs: Outputs,
    link: HostLink,
    config: Config,
    telemetry: Option<Telemetry>,
    answer: Option<(u8, Result<(), Refusal>)>,
    last_event: Option<Event>,
    id: u8,
}

impl Bed {
    fn new() -> Self {
        let mut link = HostLink::new(Timing::default());
        link.open(7, 0);
        let mut inputs = Inputs::default();
        for joint in &mut inputs.joints {
            joint.drive_ready = true;
        }
        Self {
            controller: Controller::new(200),
            inputs,
            outputs: Outputs::default(),
            link,
            config: h4_with_steps(),
            telemetry: None,
            answer: None,
            last_event: None,
            id: 0,
        }
    }

    /// Runs one control period: applies the last outputs, then calls the controller.
    fn step(&mut self) {
        let inputs = &mut self.inputs;
        inputs.period += 1 + u64::from(inputs.missed);
        inputs.time_ns = inputs.time_ns.wrapping_add(200_000);
        for (index, joint) in inputs.joints.iter_mut().enumerate().take(JOINTS) {
            let DriveCommand::Steps(segment) = self.outputs.joints[index] else {
                continue;
            };
            let way = i32::from(segment.count.signum());
            for _ in 0..segment.count.unsigned_abs() {
                joint.steps += way;
                joint.counts += way;
                joint.edge_time_ns = inputs.time_ns;
                if self.config.has_index(index, joint.counts) {
                    joint.index_counts = joint.counts;
                    joint.index_pulses = joint.index_pulses.wrapping_add(1);
                }
            }
        }
        let now_us = inputs.period * 200;
        let mut room = [0; 64];
        let count = self.link.transmit(now_us, &mut room);
        inputs.received.clear();
        // It fits: the buffers have the same length.
        let _ = inputs.received.extend_from_slice(&room[..count]);
        inputs.transmit_room = 64;
        self.controller.tick(inputs, &mut self.outputs, &mut ());
        inputs.missed = 0;
        inputs.out_of_band_stop = false;
        self.link.receive(now_us, &self.outputs.transmit);
        while let Some(report) = self.link.poll_message() {
            match report {
                Report::Answer { id, result } => self.answer = Some((id, result)),
                Report::Event { event, .. } => self.last_event = Some(event),
                Report::Telemetry(telemetry) => self.telemetry = Some(telemetry),
                Report::Master(_) => {}
            }
        }
    }

    fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.step());
    }

    /// Sends a command and waits for the answer.
    #[track_caller]
    fn ask(&mut self, command: Command) -> Result<(), Refusal> {
        self.id = self.id % 250 + 1;
        let request = Request {
            id: self.id,
            command,
        };
        self.link.send(&request).expect("room");
        for _ in 0..3000 {
            self.step();
            if let Some((id, result)) = self.answer.take()
                && id == self.id
            {
                return result;
            }
        }
        panic!("no answer");
    }

    fn state(&self) -> State {
        self.controller.safety().state()
    }

    #[track_caller]
    fn wait_for(&mut self, state: State) {
        for _ in 0..60_000 {
            self.step();
            if self.state() == state {
                return;
            }
        }
        panic!("{state:?} is not reached: {:?}", self.state());
    }

    fn drives_off(&self) -> bool {
        let off = |command: &DriveCommand| *command == DriveCommand::Off;
        self.outputs.joints.iter().all(off) && self.outputs.spindle_rpm == 0
    }

    /// Sends bytes as the configuration.
    fn configure(&mut self, bytes: &[u8], crc: u32) -> Result<(), Refusal> {
        for (index, chunk) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            self.ask(Command::Configure(ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            }))?;
        }
        self.ask(Command::Activate {
            length: bytes.len() as u16,
            crc,
            at_preset: false,
        })
    }

    /// Connects and configures.
    fn connect(&mut self) {
        while self.link.state(self.inputs.period * 200) != LinkState::Open {
            self.step();
            assert!(self.inputs.period < 5000, "no session");
        }
        let mut room = [0; 1024];
        let bytes = postcard::to_slice(&self.config, &mut room).expect("fits");
        let crc = crc32(bytes);
        assert_eq!(self.configure(bytes, crc), Ok(()));
        assert_eq!(self.state(), State::Disabled);
        assert!(self.drives_off());
    }

    /// Connects, configures, enables and homes.
    fn make_ready(&mut self) {
        self.connect();
        assert_eq!(self.ask(Command::Enable), Ok(()));
        assert_eq!(self.state(), State::Idle);
        assert_eq!(self.ask(Command::Home), Ok(()));
        assert_eq!(self.state(), State::Homing);
        self.wait_for(State::Idle);
        assert!(self.controller.safety().homed());
    }

    fn commanded(&self) -> AxisValues {
        let machine = self.controller.machine().expect("configured");
        machine.commanded_values()
    }

    /// Starts a job: 8 mm in x, there and back, `times` times. Returns the number of its setpoints.
    fn start_job(&mut self, times: usize) -> u32 {
        let start = self.commanded();
        let job = Command::JobStart {
            job: 3,
            pose: start.clone(),
        };
        assert_eq!(self.ask(job), Ok(()));
        let mut coder = SetpointCoder::new(200, &start);
        let mut batch = SetpointBatch {
            first: 0,
            items: Vec::new(),
        };
        let mut count = 0;
        for way in 0..2 * times {
            for part in 1..=4 {
                let setpoint = part_of_way(&start, way % 2 == 0, part);
                let item = coder.encode(&setpoint).expect("codes");
                count += 1;
                assert!(batch.items.push(item).is_ok(), "a batch is full");
                if batch.items.len() == SETPOINT_BATCH {
                    assert_eq!(self.ask(Command::Setpoints(batch.clone())), Ok(()));
                    batch.items.clear();
                    batch.first = count;
                }
            }
        }
        if !batch.items.is_empty() {
            assert_eq!(self.ask(Command::Setpoints(batch)), Ok(()));
        }
        assert_eq!(self.ask(Command::JobEnd { count }), Ok(()));
        count
    }

    /// Resets and enables; then the state is idle with the position kept.
    fn recover(&mut self) {
        // A machine that may still coast refuses to enable.
        self.steps(2500);
        assert_eq!(self.ask(Command::Reset), Ok(()));
        assert_eq!(self.state(), State::Disabled);
        assert_eq!(self.ask(Command::Enable), Ok(()));
        assert_eq!(self.state(), State::Idle);
        let before = self.inputs.joints.map(|joint| joint.counts);
        self.steps(500);
        let after = self.inputs.joints.map(|joint| joint.counts);
        for (before, after) in before.into_iter().zip(after) {
            assert!((after - before).abs() <= 1, "it jumped");
        }
    }
}

/// A quarter (in time) of a move of 8 mm in x in 0.8 s, from standstill to standstill, with 13.3
/// mm/s between the ends.
fn part_of_way(start: &AxisValues, there: bool, part: i32) -> Setpoint {
    let speed = mm(40.0 / 3.0);
    // In 0.2 s: 1.33 mm while the speed increases or decreases, 2.67 mm in between.
    let way = [speed / 10, speed * 3 / 10, speed / 2, speed * 6 / 10];
    let total = way[3];
    let done = way[(part - 1) as usize];
    let mut pose = start.clone();
    pose[0] += if there { done } else { total - done };
    let mut rates: AxisValues = start.iter().map(|_| 0).collect();
    if part < 4 {
        rates[0] = if there { speed } else { -speed } / 256;
    }
    Setpoint {
        periods: 1000,
        pose,
        rates,
        action: Action::None,
    }
}

/// Position of the index pulse of a joint's encoder.
trait Indexes {
    fn has_index(&self, joint: usize, counts: i32) -> bool;
}

impl Indexes for Config {
    fn has_index(&self, joint: usize, counts: i32) -> bool {
        let preset = self.joints[joint].preset;
        let joint = self.joints[joint].encoder.as_ref().expect("an encoder");
        let in_counts = |way: i32| ((i64::from(way) << 24) / joint.per_count) as i32;
        let first = in_counts(joint.index.0.wrapping_sub(preset.0));
        (counts - first) % in_counts(joint.index_pitch.0) == 0
    }
}

fn job() {
    let mut bed = Bed::new();
    assert_eq!(bed.state(), State::Disabled);
    bed.make_ready();
    let start = bed.commanded();
    let counts = bed.inputs.joints.map(|joint| joint.counts);
    let setpoints = bed.start_job(2);
    assert_eq!(bed.state(), State::Run);
    let mut farthest = 0;
    while bed.state() == State::Run {
        bed.step();
        let x = bed.commanded()[0] - start[0];
        farthest = farthest.max(x);
        assert!((-1..=mm(8.01)).contains(&x), "{x}");
    }
    bed.steps(500);
    assert_eq!(bed.state(), State::Idle);
    assert!(farthest > mm(7.99), "{farthest}");
    assert_eq!(
        bed.last_event,
        Some(Event::State {
            from: State::Run,
            to: State::Idle,
            homed: true
        })
    );
    // There and back again: the command to the last bit, and the motion to a step.
    assert_eq!(bed.commanded(), start);
    for (before, joint) in counts.into_iter().zip(&bed.inputs.joints) {
        assert!((joint.counts - before).abs() <= 1);
        assert_eq!(joint.counts, joint.steps);
    }
    let telemetry = bed.telemetry();
    assert_eq!((telemetry.setpoint, telemetry.fault), (setpoints, None));
    assert_eq!(bed.ask(Command::Disable), Ok(()));
    assert_eq!(bed.state(), State::Disabled);
    assert!(bed.drives_off());
}

impl Bed {
    /// Requests telemetry and returns it.
    fn telemetry(&mut self) -> Telemetry {
        self.telemetry = None;
        assert_eq!(self.ask(Command::Status), Ok(()));
        for _ in 0..1000 {
            if let Some(telemetry) = self.telemetry.take() {
                return telemetry;
            }
            self.step();
        }
        panic!("no telemetry");
    }
}

fn stop() {
    let mut bed = Bed::new();
    bed.make_ready();
    let start = bed.commanded();
    bed.start_job(2);
    bed.steps(1500);
    assert_eq!(bed.state(), State::Run);
    // As in a receive interrupt.
    assert_eq!(STOP.len(), 3);
    bed.inputs.out_of_band_stop = true;
    bed.step();
    assert_eq!(bed.state(), State::Hold);
    bed.steps(2000);
    let held = bed.commanded();
    bed.steps(1000);
    assert_eq!((bed.commanded(), bed.state()), (held, State::Hold));
    bed.steps(2000);
    assert_eq!(bed.ask(Command::Resume), Ok(()));
    bed.wait_for(State::Idle);
    assert_eq!(bed.commanded(), start);
}

fn trip() {
    let mut bed = Bed::new();
    bed.make_ready();
    bed.start_job(2);
    bed.steps(1500);
    bed.inputs.joints[2].drive_ready = false;
    bed.inputs.joints[2].alarm = DriveAlarm::Silent;
    bed.step();
    assert_eq!(bed.state(), State::Fault);
    assert!(bed.drives_off());
    assert_eq!(
        bed.controller.safety().fault(),
        Some(Fault::Drive {
            joint: 2,
            alarm: DriveAlarm::Silent
        })
    );
    assert!(bed.ask(Command::Enable).is_err());
    bed.inputs.joints[2].drive_ready = true;
    bed.recover();
}

fn emergency() {
    let mut bed = Bed::new();
    bed.make_ready();
    bed.start_job(2);
    bed.steps(1500);
    bed.inputs.emergency_stop = true;
    bed.step();
    assert_eq!(bed.state(), State::EmergencyStop);
    assert!(bed.drives_off());
    // Refused while the button is pressed.
    assert!(bed.ask(Command::Reset).is_err() || bed.state() == State::EmergencyStop);
    assert!(bed.drives_off());
    bed.inputs.emergency_stop = false;
    bed.recover();
}

fn late() {
    let mut bed = Bed::new();
    bed.make_ready();
    bed.start_job(2);
    bed.steps(1500);
    // One less than the number that is a fault.
    let limit = bed.config.supervision.missed_periods;
    bed.inputs.missed = limit - 1;
    bed.steps(100);
    assert_eq!(bed.state(), State::Run);
    bed.inputs.missed = limit;
    bed.step();
    bed.wait_for(State::Fault);
    let fault = Fault::MissedPeriods { missed: limit };
    assert_eq!(bed.controller.safety().fault(), Some(fault));
    // The machine decelerated along its path, and the drives hold it.
    let held = bed.commanded();
    bed.steps(500);
    assert_eq!(bed.commanded(), held);
    assert!(!bed.drives_off());
    assert_eq!(bed.ask(Command::Reset), Ok(()));
    assert_eq!(bed.state(), State::Idle);
}

fn misfit() {
    let mut bed = Bed::new();
    bed.connect();
    let mut room = [0; 1024];
    let length = postcard::to_slice(&bed.config, &mut room)
        .expect("fits")
        .len();
    let crc = crc32(&room[..length]);
    // Configurations with a wrong CRC, incomplete, too long, and with invalid values.
    let refused = |result: Result<(), Refusal>| assert!(result.is_err(), "taken");
    refused(bed.configure(&room[..length], crc ^ 1));
    refused(bed.configure(&room[..length - 7], crc));
    for offset in (0..2 * CONFIG_BYTES).step_by(CONFIG_CHUNK) {
        let chunk = ConfigChunk {
            offset: offset as u16,
            bytes: [7; CONFIG_CHUNK].into_iter().collect(),
        };
        let result = bed.ask(Command::Configure(chunk));
        assert_eq!(
            result.is_ok(),
            offset + CONFIG_CHUNK <= CONFIG_BYTES,
            "{offset}"
        );
    }
    let mut senseless = bed.config.clone();
    senseless.joints[1].low.0 = i32::MAX;
    let mut other = [0; 1024];
    let bytes = postcard::to_slice(&senseless, &mut other).expect("fits");
    let crc_of_it = crc32(bytes);
    refused(bed.configure(bytes, crc_of_it));
    // The state is unchanged.
    assert_eq!(bed.state(), State::Disabled);
    assert_eq!(bed.ask(Command::Enable), Ok(()));
}

fn lost() {
    let mut bed = Bed::new();
    bed.connect();
    assert_eq!(bed.telemetry().lost_bytes, 0);
    // The board's own count wraps around at 65,536.
    for count in [60_000_u16, 5_000, 5_001] {
        bed.inputs.lost_bytes = count;
        bed.step();
    }
    assert_eq!(bed.telemetry().lost_bytes, 60_000 + 10_536 + 1);
}
