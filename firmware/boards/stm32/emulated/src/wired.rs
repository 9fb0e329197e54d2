//! The board with a simulated machine at its pins: step edges move the motors, and the switches of
//! the machine drive the inputs. The host is in this process, at the other end of the serial line.
//!
//! The emulator runs in a thread of its own. At the end of each control period of the machine it
//! waits for the bytes of the host, so the speed of this computer does not matter.

use crate::board::{A, B, Board, C, D, E, EMERGENCY_STOP};
use crate::{ENABLE, Lines, MS, PORTS, PUMP, STEPS, TIM8_SLAVE};
use haptimill_client::port::PortError;
use haptimill_client::session::pins::record::{JOINTS, Period, WORDS};
use haptimill_client::session::{JobLine, JobRecording, Line};
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs, StepSegment};
use haptimill_hil_sim::plant::Plant;
use haptimill_machine_file::MachineFile;
use haptimill_trace::Recorder;
use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::emulator::{AccessKind, Driver, Host, Settled, Start, Stop, run};
use rigless::image::Image;
use rigless::session::Session;
use rigless::snapshot::Store;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// A pin: port and number.
pub type Pin = (usize, u8);

/// Inputs of the joints.
pub const HOME: [Pin; JOINTS] = [(C, 1), (C, 2), (C, 4), (C, 5), (C, 8)];
const LIMIT_LOW: [Pin; JOINTS] = [(D, 0), (D, 1), (D, 2), (D, 3), (D, 6)];
const LIMIT_HIGH: [Pin; JOINTS] = [(D, 7), (D, 10), (D, 11), (C, 9), (C, 11)];
/// Alarm of the drives.
pub const ALARM: Pin = (A, 3);
const DIGITAL: [Pin; 2] = [(A, 8), (A, 10)];

/// Start of the RAM, where the image keeps the record of its last control period.
const RECORD: u64 = 0x2000_0000;
/// Bytes on the serial line.
#[derive(Debug, Default)]
struct Wire {
    to_board: VecDeque<u8>,
    from_board: Vec<u8>,
}

/// The end of the serial line at the host.
#[derive(Debug)]
struct HostEnd(Arc<Mutex<Wire>>);

// Nothing here is kept in snapshots.
impl Store for HostEnd {}

fn locked(wire: &Mutex<Wire>) -> std::sync::MutexGuard<'_, Wire> {
    wire.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Peer for HostEnd {
    fn receive(&mut self, word: u16, _: &mut Timeline<'_, '_>) {
        locked(&self.0).from_board.push(word as u8);
    }

    fn transmit(&mut self, _: VirtualNanos) -> Option<u16> {
        locked(&self.0).to_board.pop_front().map(u16::from)
    }
}

/// What the host lets the emulator do in the next control period.
#[derive(Debug, Clone, Default)]
struct Order {
    bytes: Vec<u8>,
    /// Inputs that are active besides those of the machine, and those with noise: wrong levels in
    /// every other control period.
    active: Vec<Pin>,
    noisy: Vec<Pin>,
}

/// What happened in a control period.
#[derive(Debug)]
struct Turn {
    time_us: u64,
    sent: Vec<u8>,
    records: Vec<[u32; WORDS]>,
    steps: [i64; JOINTS],
    enabled: bool,
}

/// The side of the emulator.
pub struct Wired {
    started: bool,
    plant: Plant,
    period_ns: u64,
    wire: Arc<Mutex<Wire>>,
    /// `None` when the emulator has ended.
    host: Option<(SyncSender<Turn>, Receiver<Order>)>,
    /// Levels of the inputs.
    levels: BTreeMap<Pin, bool>,
    is_noisy: bool,
    records: Vec<[u32; WORDS]>,
    steps: [i64; JOINTS],
    /// Lines that the board drove.
    pub port_b: Lines,
    /// Step and direction lines.
    pub port_e: Lines,
    /// The LED.
    pub port_d: Lines,
    /// Time at which the gate of TIM8 gets its second edge.
    gate: Option<u64>,
    /// Start of the control period of the machine, ns.
    begun: u64,
}

impl Wired {
    /// Drives the inputs whose levels changed.
    fn drive_inputs(&mut self, board: &mut Board, at: VirtualNanos, order: &Order) {
        let mut inputs = Inputs::default();
        self.plant.latch(&mut inputs);
        let mut levels = BTreeMap::new();
        levels.insert(EMERGENCY_STOP, inputs.emergency_stop);
        for (joint, input) in inputs.joints.iter().enumerate().take(JOINTS) {
            levels.insert(HOME[joint], input.home);
            levels.insert(LIMIT_LOW[joint], input.limit_low);
            levels.insert(LIMIT_HIGH[joint], input.limit_high);
        }
        let joints = &inputs.joints[..self.plant.axes()];
        let alarm = joints.iter().any(|input| !input.drive_ready);
        levels.insert(ALARM, alarm && !inputs.emergency_stop);
        for (channel, pin) in DIGITAL.into_iter().enumerate() {
            levels.insert(pin, inputs.digital >> channel & 1 != 0);
        }
        for pin in &order.active {
            levels.insert(*pin, true);
        }
        self.is_noisy = !self.is_noisy;
        for pin in order.noisy.iter().filter(|_| self.is_noisy) {
            levels.entry(*pin).and_modify(|level| *level = !*level);
        }
        for (pin, level) in &levels {
            if self.levels.get(pin) != Some(level) {
                board.drive(at, *pin, *level);
            }
        }
        self.levels = levels;
    }

    /// Notes the levels of the step and direction lines, and moves the motors.
    fn note_steps(&mut self, at: u64, levels: u16) {
        let rising = levels & !self.port_e.levels;
        for (joint, (step, direction)) in STEPS.iter().enumerate() {
            if rising >> step & 1 != 0 {
                let up = levels >> direction & 1 != 0;
                self.steps[joint] += if up { 1 } else { -1 };
                self.plant
                    .add_pulse(joint, at.saturating_sub(self.begun), up);
            }
        }
        self.port_e.note(at, levels);
    }
}

impl Driver<Board> for Wired {
    fn on_settled(&mut self, session: &mut Session<Board>, host: &mut dyn Host, settled: Settled) {
        let mut written = false;
        let at = match settled {
            Settled::Access { access, .. } => {
                let at = access.virtual_time;
                if access.address == TIM8_SLAVE && access.kind == AccessKind::Write {
                    session.board_mut().drive_gate(at, true);
                    self.gate = Some(at.0 + 5_000);
                }
                written = access.kind == AccessKind::Write && PORTS.contains(&access.address);
                at
            }
            Settled::Stop(stop) => stop.at,
            _ => return,
        };
        let board = session.board_mut();
        if !self.started {
            self.started = true;
            board.rest(at);
        }
        let moved = board.acknowledge(at);
        if self.gate.is_some_and(|gate| at.0 >= gate) {
            self.gate = None;
            board.drive_gate(at, false);
        }
        // Only the DMA and writes of the core change an output.
        if moved || written {
            self.note_steps(at.0, board.outputs(E));
        }
        if !written {
            return;
        }
        self.port_d.note(at.0, board.outputs(D));
        let before = self.port_b.levels;
        self.port_b.note(at.0, board.outputs(B));
        if (before ^ self.port_b.levels) >> PUMP & 1 != 0 {
            // The charge pump changes after the record.
            let mut words = [0; WORDS];
            for (word, address) in words.iter_mut().zip((RECORD..).step_by(4)) {
                *word = host.read(address, Width::W32).unwrap_or(0) as u32;
            }
            self.records.push(words);
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Board>,
        stop: Stop,
        _: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        let enabled = self.port_b.levels >> ENABLE & 1 != 0;
        let mut outputs = Outputs::default();
        if enabled {
            let on = DriveCommand::Steps(StepSegment::default());
            outputs.joints[..self.plant.axes()].fill(on);
        }
        self.plant.advance(&outputs);
        self.begun = stop.at.0;
        let turn = Turn {
            time_us: stop.at.0 / 1000,
            sent: std::mem::take(&mut locked(&self.wire).from_board),
            records: std::mem::take(&mut self.records),
            steps: self.steps,
            enabled,
        };
        let (turns, orders) = self.host.as_ref()?;
        turns.send(turn).ok()?;
        let order = orders.recv().ok()?;
        locked(&self.wire).to_board.extend(&order.bytes);
        self.drive_inputs(session.board_mut(), stop.at, &order);
        Some(VirtualNanos(stop.at.0 + self.period_ns))
    }
}

/// The side of the host.
pub struct Stm32 {
    orders: Option<SyncSender<Order>>,
    turns: Receiver<Turn>,
    emulator: Option<JoinHandle<Result<Finished, String>>>,
    next: Order,
    period_us: u32,
    /// Control periods of the board.
    pub periods: Vec<Period>,
    /// Steps of each joint, by its lines.
    pub steps: [i64; JOINTS],
    /// The enable line is high.
    pub enabled: bool,
}

/// What is left of a run.
pub struct Finished {
    /// The lines.
    pub wired: Wired,
    /// Resets of the chip.
    pub resets: usize,
    /// What the emulator could not model.
    pub gaps: Vec<String>,
    /// End of the run, ns.
    pub end: u64,
}

impl Stm32 {
    /// Starts an image with a machine at its pins.
    pub fn start(image: &str, machine: &MachineFile) -> Result<Self, String> {
        let config = machine.plant().map_err(|error| error.to_string())?;
        let period_us = machine.config.period_us;
        let plant = Plant::new(&config, period_us).map_err(|problems| {
            let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
            problems.join("\n")
        })?;
        let (orders, from_host) = sync_channel(1);
        let (to_host, turns) = sync_channel(1);
        let wire = Arc::new(Mutex::new(Wire::default()));
        let wired = Wired {
            started: false,
            plant,
            period_ns: u64::from(period_us) * 1000,
            wire: wire.clone(),
            host: Some((to_host, from_host)),
            levels: BTreeMap::new(),
            is_noisy: false,
            records: Vec::new(),
            steps: [0; JOINTS],
            port_b: Lines::default(),
            port_e: Lines::default(),
            port_d: Lines::default(),
            gate: None,
            begun: 0,
        };
        let image = image.to_string();
        let emulator = std::thread::spawn(move || {
            let mut board = Board::new(None, 8_000_000)?;
            board.attach(HostEnd(wire));
            emulate(&image, board, wired)
        });
        let mut line = Self {
            orders: Some(orders),
            turns,
            emulator: Some(emulator),
            next: Order::default(),
            period_us: u32::from(period_us),
            periods: Vec::new(),
            steps: [0; JOINTS],
            enabled: false,
        };
        match line.turns.recv() {
            Ok(_) => Ok(line),
            Err(_) => Err(line.failure()),
        }
    }

    /// Why the emulator ended.
    fn failure(&mut self) -> String {
        let ended = self.emulator.take().map(JoinHandle::join);
        match ended {
            Some(Ok(Ok(_))) => "the emulator ended early".to_string(),
            Some(Ok(Err(reason))) => reason,
            _ => "the emulator panicked".to_string(),
        }
    }

    /// Makes inputs active besides those of the machine.
    pub fn activate(&mut self, pins: &[Pin]) {
        self.next.active = pins.to_vec();
    }

    /// Gives inputs noise.
    pub fn set_noise(&mut self, pins: &[Pin]) {
        self.next.noisy = pins.to_vec();
    }

    /// Runs a control period; returns the bytes of the board and the time.
    pub fn run_period(&mut self, transmit: &[u8]) -> Result<(Vec<u8>, u64), String> {
        let order = Order {
            bytes: transmit.to_vec(),
            ..self.next.clone()
        };
        let sent = match &self.orders {
            Some(orders) => orders.send(order).is_ok(),
            None => false,
        };
        let turn = match sent.then(|| self.turns.recv()) {
            Some(Ok(turn)) => turn,
            _ => return Err(self.failure()),
        };
        self.steps = turn.steps;
        self.enabled = turn.enabled;
        let periods = turn.records.iter();
        self.periods
            .extend(periods.map(|words| Period::decode(words, self.period_us)));
        Ok((turn.sent, turn.time_us))
    }

    /// Ends the run.
    pub fn finish(mut self) -> Result<(Vec<Period>, Finished), String> {
        self.orders = None;
        match self.emulator.take().map(JoinHandle::join) {
            Some(Ok(Ok(finished))) => Ok((self.periods, finished)),
            Some(Ok(Err(reason))) => Err(reason),
            _ => Err("the emulator panicked".to_string()),
        }
    }
}

impl Line for Stm32 {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        let (sent, time_us) = self
            .run_period(transmit)
            .map_err(|reason| PortError::Failed {
                name: self.name(),
                reason,
            })?;
        received.extend(sent);
        Ok(time_us)
    }

    fn name(&self) -> String {
        "the emulated STM32".to_string()
    }
}

impl JobLine for Stm32 {
    fn begin_recording(&mut self, _: JobRecording) {}

    fn end_recording(&mut self) -> Option<Recorder> {
        None
    }
}

/// Runs the emulator until the host has ended.
fn emulate(image: &str, board: Board, wired: Wired) -> Result<Finished, String> {
    let images = [Image::read(&PathBuf::from(image), None).map_err(|error| error.to_string())?];
    let first = VirtualNanos(wired.period_ns);
    let session = Session::new(Box::new(board), 0, first).map_err(|error| error.to_string())?;
    let finished = run(session, &Start::new(&images), wired).map_err(|error| error.to_string())?;
    let mut gaps: Vec<String> = Vec::new();
    for (at, it) in finished.session.unimplemented() {
        gaps.push(format!("not modelled: {at:#010x} {it:?}"));
    }
    for it in finished.session.unmapped() {
        gaps.push(format!("no such address: {it:?}"));
    }
    let mut wired = finished.driver;
    // The host must not wait for a board that has ended.
    wired.host = None;
    let end = wired.begun.max(MS);
    Ok(Finished {
        resets: finished.session.resets().len(),
        wired,
        gaps,
        end,
    })
}
