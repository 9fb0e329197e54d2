//! Pulses of the drives: words for the port of the step and direction lines
//! ([`step_samples`](haptimill_board_common::step_samples)), one each 0.5 us.
//!
//! TIM8 counts slots of 0.5 us. At the end of each one it requests a transfer of the DMA, which
//! writes the next word to the set and reset register of the port. The DMA has two buffers in turn;
//! it goes from one to the other by itself, so no pulse depends on the processor at the boundary of
//! two periods.
//!
//! The DMA changes its buffers [`LEAD`] slots after TIM1 has begun a control period. In between
//! [`Engine::begin`] names the buffer that is next: the words that [`Filler::fill`] made, or, after
//! a missed period, words without steps. Words are therefore never sent twice.
//!
//! The emergency stop is the gate of TIM8: while its circuit is open the timer stands, no word is
//! sent, and no line changes. [`Engine::begin`] then finds the DMA at another word than expected.
//! It counts the steps of the words that were sent, and starts the timer again when the circuit has
//! been closed for a while. The same happens when the processor was late.

use crate::clocks::{CYCLES_PER_US, PERIOD_CYCLES, PERIOD_US};
use crate::encoders::ENCODERS;
use crate::pins::{JOINTS, STEP_LINES, STEP_PORT};
use crate::registers::port::SET_RESET;
use crate::registers::timer::{
    CHANNEL_ENABLES, CHANNELS_1_2, CONTROL, COUNT, ENABLES, EVENTS, OVERFLOW_ONLY, PRESCALER,
    RELOAD, RUN, SLAVE, STATUS, UPDATE, UPDATE_DMA,
};
use crate::registers::{DMA2, TIM1, TIM8, read, wait, write};
use core::cell::UnsafeCell;
use haptimill_board_common::step_samples::{SLOTS, Samples, StepSamples, fall, missed, rises};
use haptimill_firmware::config::Drive;
use haptimill_firmware::io::{DriveCommand, Outputs, StepSegment};
use haptimill_firmware::machine::Machine;

/// Ticks of the step clock in a microsecond; a machine file must have the same.
pub const TICKS_PER_US: u32 = 84;
/// Ticks and cycles of a slot.
const SLOT_TICKS: u32 = TICKS_PER_US * PERIOD_US as u32 / SLOTS as u32;
const SLOT_CYCLES: u32 = PERIOD_CYCLES / SLOTS as u32;

/// Slots from the start of a control period to its first word.
const LEAD: u32 = 20;
/// Slots before the change of the buffers at which it is too late to name the next one.
const TOO_LATE: u32 = 4;
/// Periods with a closed emergency stop after which the pulses start again.
const CLOSED: u16 = 50;

/// Stream 1 of the DMA controller; channel 7 of it is the update of TIM8 (RM0090, table 43).
const STREAM: usize = 0x10 + 0x18;
const LEFT: usize = STREAM + 0x4;
const DESTINATION: usize = STREAM + 0x8;
const SOURCES: [usize; 2] = [STREAM + 0xC, STREAM + 0x10];
const FIFO: usize = STREAM + 0x14;
/// Clears the flags of stream 1.
const CLEAR_FLAGS: (usize, u32) = (0x8, 0b11_1101 << 6);
/// Channel 7, two buffers, highest priority, words, memory address counts up, memory to device.
const STREAM_SETUP: u32 =
    7 << 25 | 1 << 18 | 0b11 << 16 | 0b10 << 13 | 0b10 << 11 | 1 << 10 | 1 << 6;
const STREAM_ON: u32 = 1;
/// The stream reads the second source now.
const SECOND: u32 = 1 << 19;

/// TIM8 runs while its input 1 is low: the emergency stop is closed.
const GATED_BY_INPUT_1: u32 = 0b101 << 4 | 0b101;
/// Input 1 with a filter: a level lasts for 8 samples at 168 MHz / 16, 0.76 us.
const STOP_INPUT: u32 = 1 | 0b1100 << 4;
const ACTIVE_LOW: u32 = 1 << 1;

/// Buffers: the words that are sent, those that are next, and those that are made.
const BUFFERS: usize = 3;

/// Words that the DMA reads; the core-coupled memory is out of its reach.
struct Words(UnsafeCell<[Samples; BUFFERS]>);

// SAFETY: `Filler` writes the buffer that it was given, which neither `Engine` nor the DMA uses
// until it comes back in a `Batch`.
unsafe impl Sync for Words {}

static WORDS: Words = Words(UnsafeCell::new([[0; SLOTS]; BUFFERS]));

/// Words of a missed period, in the flash.
static MISSED: Samples = missed(&STEP_LINES);

/// Words of a control period.
#[derive(Clone, Copy)]
pub struct Batch {
    buffer: usize,
    steps: [i16; JOINTS],
    /// Joints whose steps did not fit, one bit each.
    unfit: u8,
}

impl Batch {
    fn samples(&self) -> &'static Samples {
        // SAFETY: see `Words`; the buffer was filled, and is not free before the next one was sent.
        unsafe { &*(&raw const (*WORDS.0.get())[self.buffer]) }
    }
}

/// Makes words; the side of the controller.
pub struct Filler {
    encoders: [StepSamples; JOINTS],
}

impl Filler {
    /// Nothing is emitted yet.
    pub const fn new() -> Self {
        let mut encoders = [const { StepSamples::new(STEP_LINES[0], SLOT_TICKS, 1) }; JOINTS];
        let mut joint = 0;
        while joint < JOINTS {
            encoders[joint] = StepSamples::new(STEP_LINES[joint], SLOT_TICKS, 1);
            joint += 1;
        }
        Self { encoders }
    }

    /// Words of these outputs, in a buffer that [`Engine::free`] gave. Widths are in slots.
    pub fn fill(&mut self, buffer: usize, outputs: &Outputs, widths: &[u32; JOINTS]) -> Batch {
        let mut batch = Batch {
            buffer,
            steps: [0; JOINTS],
            unfit: 0,
        };
        // SAFETY: see `Words`.
        let samples = unsafe { &mut (*WORDS.0.get())[buffer] };
        *samples = [0; SLOTS];
        for joint in 0..JOINTS {
            let encoder = &mut self.encoders[joint];
            if encoder.width() != widths[joint] {
                *encoder = encoder.clone().with_width(widths[joint]);
            }
            let segment = match outputs.joints[joint] {
                DriveCommand::Steps(segment) => segment,
                DriveCommand::Off | DriveCommand::Torque(_) => StepSegment::default(),
            };
            match encoder.add(&segment, samples) {
                Ok(()) => batch.steps[joint] = segment.count,
                Err(_) => batch.unfit |= 1 << joint,
            }
        }
        batch
    }
}

/// Widths of the pulses of a machine, in slots; and the joints that this board cannot drive, one
/// bit each.
pub fn requirements(machine: Option<&Machine>) -> ([u32; JOINTS], u8) {
    let mut widths = [1; JOINTS];
    let mut wrong = 0;
    let joints = machine.map_or(&[][..], |machine| &machine.config.joints[..]);
    for (joint, settings) in joints.iter().enumerate() {
        let whole_slots = |ticks: u16| u32::from(ticks) % SLOT_TICKS == 0;
        match &settings.drive {
            Drive::Steps {
                ticks_per_us,
                pulse,
                setup,
                chip: None,
                ..
            } if joint < JOINTS
                && u32::from(*ticks_per_us) == TICKS_PER_US
                && whole_slots(*pulse)
                && whole_slots(*setup)
                && (settings.encoder.is_none() || joint < ENCODERS) =>
            {
                widths[joint] = u32::from(*pulse) / SLOT_TICKS;
            }
            _ => wrong |= 1 << joint,
        }
    }
    (widths, wrong)
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Running,
    /// No word is sent; periods since the circuit of the emergency stop was closed.
    Stopped(u16),
}

/// Hands words over to the DMA; the side of the control period's interrupt.
pub struct Engine {
    state: State,
    /// Words that the DMA was given last, and those before; `None` are those without steps.
    handed_over: [Option<Batch>; 2],
    /// The DMA read the second source at the last hand-over.
    second: bool,
    emitted: [i32; JOINTS],
    /// Joints that lost steps since the last enable, one bit each.
    lost: u8,
}

impl Engine {
    /// Prepares TIM8. The first period with a closed emergency stop sends words.
    pub fn start() -> Self {
        write(TIM8, CONTROL, 0);
        write(TIM8, PRESCALER, 0);
        write(TIM8, RELOAD, SLOT_CYCLES - 1);
        write(TIM8, CONTROL, OVERFLOW_ONLY);
        write(TIM8, EVENTS, UPDATE);
        write(TIM8, CHANNELS_1_2, STOP_INPUT);
        write(TIM8, CHANNEL_ENABLES, ACTIVE_LOW);
        write(TIM8, SLAVE, GATED_BY_INPUT_1);
        Self {
            state: State::Stopped(CLOSED),
            handed_over: [None; 2],
            second: false,
            emitted: [0; JOINTS],
            lost: 0,
        }
    }

    /// A buffer that is free until its batch is handed over.
    pub fn free(&self) -> usize {
        let taken = |buffer| {
            let mut batches = self.handed_over.iter().flatten();
            batches.any(|batch| batch.buffer == buffer)
        };
        (0..BUFFERS).find(|buffer| !taken(*buffer)).unwrap_or(0)
    }

    /// Steps of each joint so far, with those of the period that begins now excluded.
    pub const fn emitted(&self, joint: usize) -> i32 {
        self.emitted[joint]
    }

    /// No pulses are sent.
    pub fn is_stopped(&self) -> bool {
        self.state != State::Running
    }

    /// Joints that lost steps, one bit each.
    pub const fn lost(&self) -> u8 {
        self.lost
    }

    /// The drives are off: lost steps do not matter, because the joints will be homed again.
    pub const fn clear_lost_steps(&mut self) {
        self.lost = 0;
    }

    /// Begins a period with these words; without them it has no steps. `open`: the emergency stop.
    pub fn begin(&mut self, batch: Option<Batch>, open: bool) {
        match self.state {
            State::Running if open || !self.is_in_step() => {
                self.stop();
                self.lose(batch);
                if !open {
                    // The processor was late, or the stop was open for a short time.
                    self.lost = (1 << JOINTS) - 1;
                }
            }
            State::Running => {
                // The words that were handed over before leave within `LEAD` slots from now.
                if let Some(before) = &self.handed_over[0] {
                    for (emitted, steps) in self.emitted.iter_mut().zip(before.steps) {
                        *emitted = emitted.wrapping_add(steps.into());
                    }
                }
                if let Some(batch) = &batch {
                    self.lost |= batch.unfit;
                }
                self.hand_over(batch);
            }
            State::Stopped(_) if open => {
                self.state = State::Stopped(0);
                self.lose(batch);
            }
            State::Stopped(closed) => {
                self.lose(batch);
                if closed < CLOSED {
                    self.state = State::Stopped(closed + 1);
                } else {
                    self.restart();
                }
            }
        }
    }

    /// The DMA is where it is expected at the start of a period: it has changed its buffers once
    /// since the last hand-over, and has some words left.
    fn is_in_step(&self) -> bool {
        let control = read(DMA2, STREAM);
        let left = read(DMA2, LEFT);
        control & STREAM_ON != 0
            && (control & SECOND != 0) != self.second
            && left > TOO_LATE
            && left <= LEAD + 1
    }

    /// Names the words that are next.
    fn hand_over(&mut self, batch: Option<Batch>) {
        self.second = read(DMA2, STREAM) & SECOND != 0;
        let samples = batch.as_ref().map_or(&MISSED, Batch::samples);
        // The source that the DMA does not read now.
        write(DMA2, SOURCES[usize::from(!self.second)], address(samples));
        self.handed_over = [batch, self.handed_over[0]];
    }

    /// The steps of a batch are not emitted.
    fn lose(&mut self, batch: Option<Batch>) {
        if let Some(batch) = &batch {
            for (joint, steps) in batch.steps.iter().enumerate() {
                if *steps != 0 {
                    self.lost |= 1 << joint;
                }
            }
        }
    }

    /// Stops the pulses, and counts the steps that have left.
    fn stop(&mut self) {
        write(TIM8, CONTROL, OVERFLOW_ONLY);
        let control = read(DMA2, STREAM);
        let sent = SLOTS.saturating_sub(read(DMA2, LEFT) as usize);
        let [last, before] = self.handed_over;
        // The batch before was counted as a whole when the last one was handed over.
        let changed = (control & SECOND != 0) != self.second;
        for joint in 0..JOINTS {
            let left = |batch: &Batch| {
                let rises = rises(batch.samples(), STEP_LINES[joint], sent);
                i32::from(rises) * i32::from(batch.steps[joint].signum())
            };
            let correction = match (changed, &last, &before) {
                (true, Some(last), _) => left(last),
                (false, _, Some(before)) => left(before) - i32::from(before.steps[joint]),
                _ => 0,
            };
            self.emitted[joint] = self.emitted[joint].wrapping_add(correction);
        }
        halt();
        self.handed_over = [None; 2];
        self.state = State::Stopped(0);
    }

    /// Starts the pulses, [`LEAD`] slots after the start of the present period, with words without
    /// steps.
    fn restart(&mut self) {
        write(TIM8, CONTROL, OVERFLOW_ONLY);
        // Off and on: a request that waits is forgotten.
        write(TIM8, ENABLES, 0);
        write(DMA2, STREAM, STREAM_SETUP);
        if !wait(DMA2, STREAM, STREAM_ON, 0, 1000) {
            return;
        }
        write(DMA2, CLEAR_FLAGS.0, CLEAR_FLAGS.1);
        write(DMA2, LEFT, SLOTS as u32);
        write(DMA2, DESTINATION, (STEP_PORT + SET_RESET) as u32);
        for source in SOURCES {
            write(DMA2, source, address(&MISSED));
        }
        // No FIFO: a word is read one slot before it is written.
        write(DMA2, FIFO, 0);
        write(DMA2, STREAM, STREAM_SETUP | STREAM_ON);
        write(TIM8, COUNT, 0);
        write(TIM8, STATUS, 0);
        write(TIM8, ENABLES, UPDATE_DMA);
        while read(TIM1, COUNT) < LEAD * SLOT_CYCLES {}
        write(TIM8, CONTROL, OVERFLOW_ONLY | RUN);
        // The DMA changes to the second source in the next period.
        self.second = true;
        self.handed_over = [None; 2];
        self.state = State::Running;
    }
}

/// Ends the pulses: stops the timer and the DMA, and lets the step lines fall.
pub fn halt() {
    write(TIM8, CONTROL, 0);
    write(TIM8, ENABLES, 0);
    write(DMA2, STREAM, 0);
    write(STEP_PORT, SET_RESET, fall(&STEP_LINES));
}

/// Address of words for the DMA.
fn address(samples: &'static Samples) -> u32 {
    samples.as_ptr() as u32
}

const _: () = assert!(SLOT_TICKS * SLOTS as u32 == TICKS_PER_US * PERIOD_US as u32);
const _: () = assert!(SLOT_CYCLES * SLOTS as u32 == PERIOD_CYCLES);
const _: () = assert!(CYCLES_PER_US == 2 * TICKS_PER_US);
