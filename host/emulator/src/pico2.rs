//! A Pico 2 with its pins wired to a simulated machine.

use crate::chain::Chain;
use crate::chip::{CLOCK_HZ, Chip};
use crate::drive_chips::DriveChips;
use crate::encoders::Encoders;
use crate::rtt::Rtt;
use crate::signals::Signals;
use haptimill_client::port::PortError;
use haptimill_client::session::pins::record::{JOINTS, Period, WORDS};
use haptimill_client::session::{JobLine, JobRecording, Line};
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs, StepSegment};
use haptimill_hil_sim::plant::Plant;
use haptimill_hil_sim::{tmc2209, tmc5160};
use haptimill_machine_file::MachineFile;
use haptimill_pulses::Signal;
use haptimill_trace::Recorder;

/// Pins, as in `firmware/boards/pico2/src/pins.rs`.
const FIRST_STEP: u32 = 2;
const ENABLE: u32 = 12;
const CHARGE_PUMP: u32 = 13;
const EMERGENCY_STOP: u32 = 14;
const CYCLES_PER_US: u64 = CLOCK_HZ / 1_000_000;

/// Control periods within which an image must have started.
const BOOT_PERIODS: u32 = 500;

/// The stack lies at the start of the RAM; the start code of the image fills it with this word.
const STACK_END: u32 = 0x2000_0000;
const STACK_PAINT: u32 = 0xCCCC_CCCC;
/// End of the RAM.
const RAM_END: u32 = 0x2008_2000;
/// Start of the flash, whose first word is the other end of the stack.
const VECTORS: u32 = 0x1000_0000;

/// Femtoseconds of a number of cycles, rounded down by less than one.
fn femtoseconds(cycles: u64) -> i64 {
    (i128::from(cycles) * 20_000_000 / 3) as i64
}

/// Lines that the board drives, since the start.
#[derive(Debug, Clone, Default)]
pub struct Lines {
    /// Step lines of the joints.
    pub step: [Signal; JOINTS],
    /// Direction lines of the joints.
    pub direction: [Signal; JOINTS],
    /// Enable line of the drives.
    pub enable: Signal,
}

/// The stack of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stack {
    /// Bytes that were used at most until the first control period had ended.
    pub start: u32,
    /// Bytes that were used at most since then.
    pub used: u32,
    /// Bytes that there are.
    pub size: u32,
}

/// A Pico 2 with a machine.
pub struct Pico2 {
    chip: Chip,
    /// Address of the record of the last control period, where the stack begins.
    record: u32,
    /// Bytes of the stack that the start used at most.
    start_stack: u32,
    plant: Plant,
    period_us: u32,
    levels: u32,
    signals: Signals,
    /// Levels of the pins that are driven from outside.
    driven: u32,
    /// Level of the emergency stop, besides that of the machine.
    emergency_stop: bool,
    /// A drive reports an alarm, besides those of the machine.
    alarm: bool,
    /// Inputs that are high whatever the machine does.
    high: u32,
    /// Inputs with noise: their levels are wrong in every other control period.
    noise: u32,
    is_noisy: bool,
    /// Chips of the drives.
    pub chips: DriveChips,
    /// Lines that the board drove.
    pub lines: Lines,
    /// Changes of the line of the charge pump.
    pub pump: u64,
    /// Steps of each joint, by its lines.
    pub steps: [i64; JOINTS],
    /// Control periods of the board.
    pub periods: Vec<Period>,
    /// Their records, until they are taken.
    records: Vec<[u32; WORDS]>,
    last: u32,
    /// The log, if the image writes one.
    pub log: Option<Rtt>,
}

impl Pico2 {
    /// A board with these contents of its flash. The period is that of the machine.
    ///
    /// # Errors
    /// The emulator cannot be built.
    pub fn new(flash: &[u8], mut plant: Plant) -> Result<Self, String> {
        let signals = Signals::of(flash, &mut plant);
        let mut board = Self {
            // A tick of the step clock is two cycles, so no edge is lost or rounded differently
            // from the others.
            chip: Chip::with_quantum(flash, 2)?,
            record: 0,
            start_stack: 0,
            period_us: u32::from(plant.period_us()),
            plant,
            levels: 0,
            signals,
            driven: 0,
            emergency_stop: false,
            alarm: false,
            high: 0,
            noise: 0,
            is_noisy: false,
            chips: DriveChips::default(),
            pump: 0,
            lines: Lines::default(),
            steps: [0; JOINTS],
            periods: Vec::new(),
            records: Vec::new(),
            last: u32::MAX,
            log: None,
        };
        board.record = board.chip.memory(VECTORS);
        board.drive_inputs();
        board.boot()?;
        board.log = Rtt::find(&mut board.chip, board.record..RAM_END);
        board.start_stack = board.used_stack();
        // What is below the stack pointer is free: fill it again.
        for address in (STACK_END..board.chip.core_register(13)).step_by(4) {
            board.chip.set_memory(address, STACK_PAINT);
        }
        Ok(board)
    }

    /// Connects the chips that a machine file has for the drives of its joints, after power-on.
    pub fn connect_chips(&mut self, machine: &MachineFile) {
        let has_wire = self.chip.uses_usb();
        self.chips.connect(machine, has_wire, &mut self.signals);
    }

    /// The chip of a joint on the wire.
    ///
    /// # Panics
    /// The joint has none.
    pub fn drive_chip(&mut self, joint: usize) -> &mut tmc2209::Chip {
        let place = self.chips.place(joint);
        &mut self.chips.wire.chips[place]
    }

    /// The chain of the TMC5160.
    ///
    /// # Panics
    /// The image has none.
    pub fn chip_chain(&mut self) -> &mut tmc5160::Chain {
        match &mut self.signals {
            Signals::Spi(chain) => chain,
            _ => panic!("the image has no chain of chips"),
        }
    }

    /// The chip of a joint in the chain.
    ///
    /// # Panics
    /// The joint has none.
    pub fn chain_chip(&mut self, joint: usize) -> &mut tmc5160::Chip {
        let place = self.chips.place(joint);
        &mut self.chip_chain().chips[place]
    }

    /// Runs the image until its first control period has ended.
    fn boot(&mut self) -> Result<(), String> {
        for _ in 0..BOOT_PERIODS {
            let end = self.chip.cycles() + u64::from(self.period_us) * CYCLES_PER_US;
            while self.chip.cycles() < end {
                let levels = self.chip.cycle()?;
                self.serve_signals(levels);
            }
            if self.chip.memory(self.record + 4) != 0 {
                self.read_record();
                return Ok(());
            }
        }
        Err(format!(
            "the image has run no control period after {} ms; its processor is at {:#010x}",
            BOOT_PERIODS * self.period_us / 1000,
            self.chip.address()
        ))
    }

    /// Opens or closes the emergency stop.
    pub fn set_emergency_stop(&mut self, open: bool) {
        self.emergency_stop = open;
        self.plant.set_emergency_stop(open);
        self.drive_inputs();
    }

    /// Gives the wires of inputs noise, one bit a pin: a wrong level in every other control period.
    pub const fn set_noise(&mut self, pins: u32) {
        self.noise = pins;
    }

    /// Shift registers and encoders, if the image has them.
    ///
    /// # Panics
    /// It has none.
    pub fn chain(&mut self) -> (&mut Chain, &mut Encoders) {
        match &mut self.signals {
            Signals::Chain(chain) => (&mut chain.0, &mut chain.1),
            _ => panic!("the image has no shift registers"),
        }
    }

    /// Drives the pins that follow the board or the time.
    fn serve_signals(&mut self, pins: u32) {
        let levels = self.signals.follow(pins, self.chip.cycles());
        let live = self.signals.live();
        if levels != self.driven & live {
            self.drive(self.driven & !live | levels);
        }
    }

    fn drive(&mut self, levels: u32) {
        self.driven = levels;
        let mask = self.signals.mask() | 1 << EMERGENCY_STOP;
        self.chip.drive(mask, levels);
    }

    /// Holds inputs high, whatever the machine does: an open contact, a broken wire. One bit a pin;
    /// of shift registers one bit an input as in [`Chain::inputs`].
    pub fn hold_high(&mut self, pins: u32) {
        self.high = pins;
        self.drive_inputs();
    }

    /// Lets a drive report an alarm, besides those of the machine; or not.
    pub fn set_alarm(&mut self, alarm: bool) {
        self.alarm = alarm;
        self.drive_inputs();
    }

    /// Level of a pin.
    #[must_use]
    pub const fn level(&self, pin: u32) -> bool {
        self.levels >> pin & 1 != 0
    }

    /// The enable line is high.
    #[must_use]
    pub const fn is_enabled(&self) -> bool {
        self.level(ENABLE)
    }

    /// The machine, for faults.
    pub const fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// The machine.
    #[must_use]
    pub const fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The machine, for a board that starts anew.
    #[must_use]
    pub fn into_plant(self) -> Plant {
        self.plant
    }

    /// The chip.
    pub const fn chip(&mut self) -> &mut Chip {
        &mut self.chip
    }

    /// The stack of the image. A function that leaves part of its frame unwritten uses more than is
    /// seen here, by this part.
    pub fn stack(&mut self) -> Stack {
        Stack {
            start: self.start_stack,
            used: self.used_stack(),
            size: self.record - STACK_END,
        }
    }

    /// Bytes of the stack above the lowest word that was written.
    fn used_stack(&mut self) -> u32 {
        let untouched = (STACK_END..self.record)
            .step_by(4)
            .take_while(|address| self.chip.memory(*address) == STACK_PAINT)
            .count() as u32;
        self.record - STACK_END - 4 * untouched
    }

    /// Cycles since the start.
    #[must_use]
    pub fn cycles(&self) -> u64 {
        self.chip.cycles()
    }

    /// Runs a number of cycles with the machine at rest; returns the cycle of the last rising edge
    /// of a step line.
    ///
    /// # Errors
    /// The emulator cannot go on.
    pub fn run_cycles(&mut self, cycles: u64) -> Result<Option<u64>, String> {
        let mut last = None;
        let end = self.chip.cycles() + cycles;
        while self.chip.cycles() < end {
            let before = self.steps;
            let levels = self.chip.cycle()?;
            self.chips.serve_wire(&mut self.chip);
            self.serve_signals(levels);
            if levels != self.levels {
                self.note(levels, u64::MAX);
                if self.steps != before {
                    last = Some(self.chip.cycles());
                }
            }
        }
        Ok(last)
    }

    /// Runs a control period of chip and machine.
    ///
    /// # Errors
    /// The emulator cannot go on.
    pub fn run_period(&mut self) -> Result<(), String> {
        let start = self.chip.cycles();
        let end = start + u64::from(self.period_us) * CYCLES_PER_US;
        let mut read_at = start;
        while self.chip.cycles() < end {
            let levels = self.chip.cycle()?;
            self.chips.serve_wire(&mut self.chip);
            self.serve_signals(levels);
            if levels != self.levels {
                self.note(levels, start);
            }
            // More often than the shortest period handler: no record is overwritten unseen. An
            // instruction may take many cycles, so the count may pass any given one.
            if self.chip.cycles() >= read_at {
                self.read_record();
                read_at += 512;
            }
        }
        let mut outputs = Outputs::default();
        if self.is_enabled() {
            let on = DriveCommand::Steps(StepSegment::default());
            outputs.joints[..self.plant.axes()].fill(on);
        }
        let start_ns = self.plant.time_ns();
        self.plant.advance(&outputs);
        if let Signals::Chain(chain) = &mut self.signals {
            // What happened in this control period is only known now: the edges come a period late.
            chain
                .1
                .follow(&mut self.plant, start_ns, self.chip.cycles());
        }
        self.drive_inputs();
        self.read_log();
        Ok(())
    }

    /// Takes what the image has written to its log. Callers of [`Pico2::run_cycles`] must call it
    /// before the buffer of the log is full.
    pub fn read_log(&mut self) {
        if let Some(log) = &mut self.log {
            log.read(&mut self.chip);
        }
    }

    /// Keeps the record of the last control period, if it is a new one. Callers of
    /// [`Pico2::run_cycles`] must call it before the next control period ends.
    pub fn read_record(&mut self) {
        if self.chip.memory(self.record) == self.last {
            return;
        }
        let mut words = [0; WORDS];
        for (word, at) in words.iter_mut().zip((self.record..).step_by(4)) {
            *word = self.chip.memory(at);
        }
        self.last = words[0];
        self.periods.push(Period::decode(&words, self.period_us));
        self.records.push(words);
    }

    /// Takes the records of the control periods since the last call.
    pub fn take_records(&mut self) -> Vec<[u32; WORDS]> {
        std::mem::take(&mut self.records)
    }

    /// Time since the start, fs.
    #[must_use]
    pub fn time(&self) -> i64 {
        femtoseconds(self.chip.cycles())
    }

    /// Notes the changes of the lines; `start` is the first cycle of the machine's period.
    fn note(&mut self, levels: u32, start: u64) {
        let changed = levels ^ self.levels;
        self.levels = levels;
        let now = self.chip.cycles();
        let time = femtoseconds(now);
        self.pump += u64::from(changed >> CHARGE_PUMP & 1);
        if changed >> ENABLE & 1 != 0 {
            self.lines.enable.changes.push(time);
            let enabled = levels >> ENABLE & 1 != 0;
            self.chips.set_enabled(enabled, &mut self.signals);
        }
        for joint in 0..JOINTS {
            let pin = FIRST_STEP + 2 * joint as u32;
            if changed >> (pin + 1) & 1 != 0 {
                self.lines.direction[joint].changes.push(time);
            }
            if changed >> pin & 1 == 0 {
                continue;
            }
            self.lines.step[joint].changes.push(time);
            if levels >> pin & 1 != 0 {
                let up = levels >> (pin + 1) & 1 != 0;
                self.steps[joint] += if up { 1 } else { -1 };
                if start <= now && self.chips.drives(joint, &self.signals) {
                    let time_ns = (now - start) * 1000 / CYCLES_PER_US;
                    self.plant.add_pulse(joint, time_ns, up);
                }
            }
        }
    }

    /// Drives the input pins of the board with the switches of the machine.
    fn drive_inputs(&mut self) {
        let mut inputs = Inputs::default();
        self.plant.latch(&mut inputs);
        let joints = inputs.joints[..self.plant.axes()].iter().enumerate();
        let alarm = joints
            .filter(|(_, axis)| self.alarm || !axis.drive_ready && !inputs.emergency_stop)
            .fold(0, |alarm, (joint, _)| alarm | 1 << joint);
        let stop = inputs.emergency_stop || self.emergency_stop;
        let mut levels = u32::from(stop) << EMERGENCY_STOP;
        levels |= self.high & (1 << EMERGENCY_STOP);
        levels |= self.signals.set(&inputs, alarm, self.high);
        levels |= self.signals.follow(self.levels, self.chip.cycles());
        self.is_noisy = !self.is_noisy;
        if self.is_noisy {
            levels ^= self.noise;
        }
        self.drive(levels);
    }
}

impl Line for Pico2 {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        self.chip.receive(transmit);
        self.run_period().map_err(|reason| PortError::Failed {
            name: self.name(),
            reason,
        })?;
        received.extend(self.chip.take_sent());
        Ok(self.chip.cycles() / CYCLES_PER_US)
    }

    fn name(&self) -> String {
        "emu:pico2".to_string()
    }
}

impl JobLine for Pico2 {
    fn begin_recording(&mut self, _: JobRecording) {}

    fn end_recording(&mut self) -> Option<Recorder> {
        None
    }
}
