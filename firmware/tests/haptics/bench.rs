//! A controller, an ideal machine with step motors, a haptic arm with an f64 operator, and a host.

use crate::arm::{M, V, inverse, rotation};
use haptimill_firmware::config::Config;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::haptics::Haptic;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};
use haptimill_protocol::frame::crc32;
use haptimill_protocol::haptic::MasterTelemetry;
use haptimill_protocol::link::{HostLink, LinkState, Timing};
use haptimill_protocol::message::{
    AxisValues, CONFIG_CHUNK, Command, ConfigChunk, Event, Refusal, Report, Request, Source, State,
    Telemetry,
};

pub struct Bench {
    pub controller: Controller,
    pub inputs: Inputs,
    pub outputs: Outputs,
    pub link: HostLink,
    pub config: Config,
    pub events: Vec<Event>,
    pub telemetry: Option<Telemetry>,
    pub master_report: Option<MasterTelemetry>,
    answer: Option<(u8, Result<(), Refusal>)>,
    id: u8,
    /// Platform of the handle.
    pub centre: V,
    pub turn: M,
    /// Leg and sensor with an injected fault: reading from the true counts.
    #[allow(clippy::type_complexity, reason = "one fault, once")]
    pub lie: Option<(usize, usize, fn(i32) -> i32)>,
    /// Codes of the force sensor, give or take one; none is connected without.
    pub codes: Option<[i16; 3]>,
    home: [[f64; 3]; 3],
}

pub const HOME: V = [0.0, 0.0, 450.0];

impl Bench {
    pub fn new(config: Config) -> Self {
        let mut link = HostLink::new(Timing::default());
        link.open(7, 0);
        let mut inputs = Inputs::default();
        for joint in &mut inputs.joints {
            joint.drive_ready = true;
        }
        inputs.haptic.drives_ready = true;
        let turn = rotation([0.0, 0.0, 1.0], 0.0);
        Self {
            controller: Controller::new(200),
            inputs,
            outputs: Outputs::default(),
            link,
            config,
            events: vec![],
            telemetry: None,
            master_report: None,
            answer: None,
            id: 0,
            centre: HOME,
            turn,
            lie: None,
            codes: None,
            home: inverse(HOME, turn).expect("home"),
        }
    }

    fn move_axes(&mut self) {
        for (joint, axis) in self.inputs.joints.iter_mut().enumerate() {
            let DriveCommand::Steps(segment) = self.outputs.joints[joint] else {
                continue;
            };
            let preset = self.config.joints[joint].preset;
            let config = self.config.joints[joint]
                .encoder
                .as_ref()
                .expect("an encoder");
            let in_counts = |way: i32| ((i64::from(way) << 24) / config.per_count) as i32;
            let first = in_counts(config.index.0.wrapping_sub(preset.0));
            for _ in 0..segment.count.unsigned_abs() {
                let way = i32::from(segment.count.signum());
                axis.steps += way;
                axis.counts += way;
                axis.edge_time_ns = self.inputs.time_ns;
                if (axis.counts - first) % in_counts(config.index_pitch.0) == 0 {
                    axis.index_counts = axis.counts;
                    axis.index_pulses = axis.index_pulses.wrapping_add(1);
                }
            }
        }
    }

    /// Counters of the arm: 2.5 um and 65,536 to the turn from the home.
    fn move_arm(&mut self) {
        let legs = inverse(self.centre, self.turn).expect("in reach");
        for (leg, inputs) in self.inputs.haptic.legs.iter_mut().enumerate() {
            for sensor in 0..3 {
                let unit = if sensor == 0 {
                    0.0025
                } else {
                    std::f64::consts::TAU / 65_536.0
                };
                let counts =
                    libm::floor((legs[leg][sensor] - self.home[leg][sensor]) / unit + 0.5) as i32;
                inputs.counts[sensor] = match self.lie {
                    Some((other, of, lie)) if (other, of) == (leg, sensor) => lie(counts),
                    _ => counts,
                };
            }
        }
    }

    pub fn step(&mut self) {
        self.move_axes();
        self.move_arm();
        self.inputs.period += 1;
        // Sampled in every period, whether anyone looks or not.
        let noise = (self.inputs.period * 7 % 3) as i16 - 1;
        self.inputs.force.codes = self.codes.unwrap_or_default().map(|code| code + noise);
        self.inputs.force.conversions = self.inputs.force.conversions.wrapping_add(1);
        self.inputs.time_ns = self.inputs.time_ns.wrapping_add(200_000);
        let now_us = self.inputs.period * 200;
        let mut room = [0; 64];
        let count = self.link.transmit(now_us, &mut room);
        self.inputs.received.clear();
        let _ = self.inputs.received.extend_from_slice(&room[..count]);
        self.inputs.transmit_room = 64;
        self.controller
            .tick(&self.inputs, &mut self.outputs, &mut ());
        self.inputs.out_of_band_stop = false;
        self.link.receive(now_us, &self.outputs.transmit);
        while let Some(report) = self.link.poll_message() {
            match report {
                Report::Answer { id, result } => self.answer = Some((id, result)),
                Report::Event { event, .. } => self.events.push(event),
                Report::Telemetry(telemetry) => self.telemetry = Some(telemetry),
                Report::Master(master) => self.master_report = Some(master),
            }
        }
    }

    pub fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.step());
    }

    #[track_caller]
    pub fn ask(&mut self, command: Command) -> Result<(), Refusal> {
        self.id = self.id % 250 + 1;
        let id = self.id;
        self.link.send(&Request { id, command }).expect("room");
        for _ in 0..3000 {
            self.step();
            if let Some((answered, result)) = self.answer.take()
                && answered == id
            {
                return result;
            }
        }
        panic!("no answer");
    }

    /// Sent without waiting for the answer.
    pub fn say(&mut self, command: Command) {
        let request = Request { id: 0, command };
        self.link.send_latest(&request).expect("open");
    }

    /// Makes the master the source of a coordinate.
    #[track_caller]
    pub fn master(&mut self, coordinate: u8) {
        let source = Source::Master;
        assert_eq!(self.ask(Command::Source { coordinate, source }), Ok(()));
    }

    /// Connects the force sensor without load, and tares it.
    #[track_caller]
    pub fn tare(&mut self) {
        self.codes = Some([0; 3]);
        assert_eq!(self.ask(Command::Tare), Ok(()));
        self.steps(600);
        assert!(self.events.contains(&Event::Tared), "{:?}", self.events);
    }

    #[track_caller]
    pub fn arm(&self) -> &Haptic {
        let machine = self.controller.machine().expect("configured");
        machine.masters.arm.as_ref().expect("an arm")
    }

    /// The force at the hand, N.
    #[track_caller]
    pub fn force(&self) -> [f64; 3] {
        self.arm()
            .force()
            .map(|force| f64::from(force.0) / 65_536.0)
    }

    pub fn state(&self) -> State {
        self.controller.safety().state()
    }

    #[track_caller]
    pub fn wait_for(&mut self, state: State) {
        for _ in 0..60_000 {
            self.step();
            if self.state() == state {
                return;
            }
        }
        panic!(
            "{state:?} is not reached: {:?} {:?}",
            self.state(),
            self.controller.safety().fault()
        );
    }

    #[track_caller]
    pub fn configure(&mut self) -> Result<(), Refusal> {
        while self.link.state(self.inputs.period * 200) != LinkState::Open {
            self.step();
            assert!(self.inputs.period < 5000, "no session");
        }
        let mut room = [0; 2048];
        let bytes = postcard::to_slice(&self.config, &mut room)
            .expect("fits")
            .to_vec();
        for (index, chunk) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            self.ask(Command::Configure(ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            }))?;
        }
        self.ask(Command::Activate {
            length: bytes.len() as u16,
            crc: crc32(&bytes),
            at_preset: false,
        })
    }

    /// Configured, enabled and, if it has axes, homed.
    #[track_caller]
    pub fn ready(config: Config) -> Self {
        let mut bench = Self::new(config);
        assert_eq!(bench.configure(), Ok(()));
        assert_eq!(bench.ask(Command::Enable), Ok(()));
        if !bench.config.joints.is_empty() {
            assert_eq!(bench.ask(Command::Home), Ok(()));
            bench.wait_for(State::Idle);
        }
        bench
    }

    pub fn commanded(&self) -> AxisValues {
        self.controller
            .machine()
            .expect("configured")
            .commanded_values()
    }

    /// A commanded coordinate in mm, and its rate in mm/s.
    pub fn at(&self, axis: usize) -> (f64, f64) {
        let machine = self.controller.machine().expect("configured");
        let commanded = machine.motion.commanded();
        (
            f64::from(commanded.pose.0[axis].0) / 1_048_576.0,
            f64::from(commanded.rates[axis].0) / 1_048_576.0,
        )
    }

    #[track_caller]
    pub fn start_job(&mut self) {
        let pose = self.commanded();
        assert_eq!(self.ask(Command::JobStart { job: 3, pose }), Ok(()));
    }

    /// Runs some periods in which the handle moves evenly by a displacement.
    pub fn move_master(&mut self, way: V, periods: usize) {
        for _ in 0..periods {
            for axis in 0..3 {
                self.centre[axis] += way[axis] / periods as f64;
            }
            self.step();
        }
    }

    pub fn arm_off(&self) -> bool {
        self.outputs.haptic == Default::default()
    }
}
