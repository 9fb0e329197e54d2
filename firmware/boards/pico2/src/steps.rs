//! Pulses of the drives: one PIO state machine a joint, fed by one DMA channel with the words of
//! [`step_words`](haptimill_board_common::step_words).
//!
//! At the start of a control period [`Engine::begin`] hands over the words that [`Filler::fill`]
//! made in the period before. The state machines run [`LEAD`] cycles behind SysTick, with up to
//! eight words in their FIFO, so the hand-over does not delay a pulse. In a missed period each
//! joint gets one word that waits for the period: the pulses of later periods keep their times.
//!
//! The emergency stop ends the pulses in the state machines, each before its next pulse. A state
//! machine does not see a stop that is shorter than the pulse that it makes. [`Engine::begin`]
//! finds a stopped one, stops the others, counts the steps that did not leave, and starts all again
//! when the circuit is closed.

use crate::clocks::{CYCLES_PER_US, PERIOD_CYCLES, PERIOD_US};
use crate::pins::{self, JOINTS};
use crate::registers::{DMA, PIO, SYSTICK, clear, read, set, write};
use core::cell::UnsafeCell;
use haptimill_board_common::step_words::{
    CYCLES_PER_TICK, MAX, MIN_WIDTH, PROGRAM, PULSE, STOP, StepWords, WRAP, is_before_pulse,
    width_register,
};
#[cfg(feature = "encoders")]
use haptimill_firmware::config::Home;
use haptimill_firmware::config::{Drive, JointSettings};
use haptimill_firmware::io::{DriveCommand, StepSegment};
use haptimill_firmware::machine::Machine;
use haptimill_protocol::message::MAX_AXES;

/// Ticks of the step clock in a microsecond; a machine file must have the same.
pub const TICKS_PER_US: u32 = CYCLES_PER_US / CYCLES_PER_TICK;
const PERIOD_TICKS: u32 = TICKS_PER_US * PERIOD_US as u32;

/// Cycles from SysTick to the first word of a period.
const LEAD: u32 = 750;
/// Cycles after SysTick at which the hand-over is too late.
const TOO_LATE: u32 = 500;
/// Periods with a closed emergency stop after which the state machines start again: 10 ms.
const CLOSED: u16 = 10_000 / PERIOD_US;

/// Buffers: of this period, the one before, and the next one.
const BUFFERS: usize = 3;

/// Words that the DMA reads.
struct Words {
    buffers: UnsafeCell<[[[u32; MAX]; JOINTS]; BUFFERS]>,
    gaps: UnsafeCell<[u32; JOINTS]>,
}

// SAFETY: `Filler` writes the buffer that it was given, which neither `Engine` nor the DMA uses
// until it comes back in a `Batch`. Only `Engine` uses the gaps.
unsafe impl Sync for Words {}

static WORDS: Words = Words {
    buffers: UnsafeCell::new([[[0; MAX]; JOINTS]; BUFFERS]),
    gaps: UnsafeCell::new([0; JOINTS]),
};

/// Block and state machine of a joint: four joints in the first block.
const fn place(joint: usize) -> (usize, usize) {
    (joint / 4, joint % 4)
}

/// State machines of the joints in each block, one bit each.
const MACHINES: [u32; 2] = [0xF, (1 << (JOINTS - 4)) - 1];

/// Words of a control period.
#[derive(Clone, Copy)]
pub struct Batch {
    buffer: usize,
    used: [u16; JOINTS],
    steps: [i16; JOINTS],
    /// Word of each joint that only waits for a period.
    gaps: [u32; JOINTS],
    widths: [u16; JOINTS],
    /// Ticks into the next period at which the words of its batch begin; negative before it.
    next_begins: [i16; JOINTS],
    /// Joints whose steps did not fit, one bit each.
    unfit: u8,
}

/// What the state machines were given for a control period.
#[derive(Clone, Copy)]
struct HandedOver {
    /// `None`: each joint got a word that waits for the period.
    batch: Option<Batch>,
    /// Number of words of each joint.
    words: [u16; JOINTS],
}

const NOTHING: HandedOver = HandedOver {
    batch: None,
    words: [0; JOINTS],
};

/// Makes words; the side of the controller.
pub struct Filler {
    encoders: [StepWords; JOINTS],
}

impl Filler {
    /// Nothing is emitted yet.
    pub const fn new() -> Self {
        Self {
            encoders: [const { StepWords::new(PERIOD_TICKS, MIN_WIDTH) }; JOINTS],
        }
    }

    /// Words of these commands, in a buffer that [`Engine::free`] gave.
    pub fn fill(
        &mut self,
        buffer: usize,
        commands: &[DriveCommand; MAX_AXES],
        widths: &[u16; JOINTS],
    ) -> Batch {
        let mut batch = Batch {
            buffer,
            used: [0; JOINTS],
            steps: [0; JOINTS],
            gaps: [0; JOINTS],
            widths: *widths,
            next_begins: [0; JOINTS],
            unfit: 0,
        };
        // SAFETY: see `Words`.
        let words = unsafe { &mut (*WORDS.buffers.get())[buffer] };
        for joint in 0..JOINTS {
            let encoder = &mut self.encoders[joint];
            if encoder.width() != widths[joint] {
                *encoder = StepWords::new(PERIOD_TICKS, widths[joint]);
            }
            let segment = match commands[joint] {
                DriveCommand::Steps(segment) => segment,
                DriveCommand::Off | DriveCommand::Torque(_) => StepSegment::default(),
            };
            let used = encoder.fill(&segment, &mut words[joint]);
            match used {
                Ok(used) => {
                    batch.used[joint] = used as u16;
                    batch.steps[joint] = segment.count;
                }
                Err(_) => {
                    // The words are those of a period without steps.
                    batch.used[joint] = 1;
                    batch.unfit |= 1 << joint;
                }
            }
            batch.gaps[joint] = encoder.wait(PERIOD_TICKS);
            // At most the width of a pulse, which is below half a period.
            batch.next_begins[joint] = encoder.begins() as i16;
        }
        batch
    }
}

/// Widths of the pulses of a machine; and the joints that this board cannot drive, one bit each.
pub fn requirements(machine: Option<&Machine>) -> ([u16; JOINTS], u8) {
    let mut widths = [MIN_WIDTH; JOINTS];
    let mut wrong = 0;
    let joints = machine.map_or(&[][..], |machine| &machine.config.joints[..]);
    for (joint, settings) in joints.iter().enumerate() {
        match &settings.drive {
            Drive::Steps {
                ticks_per_us,
                pulse,
                ..
            } if joint < JOINTS
                && u32::from(*ticks_per_us) == TICKS_PER_US
                && has_inputs(joint, settings) =>
            {
                widths[joint] = (*pulse).max(MIN_WIDTH);
            }
            _ => wrong |= 1 << joint,
        }
    }
    (widths, wrong)
}

/// The board has the inputs that a joint needs.
#[cfg(feature = "encoders")]
fn has_inputs(joint: usize, settings: &JointSettings) -> bool {
    (settings.encoder.is_none() || joint < crate::encoders::ENCODERS)
        && !matches!(settings.home, Home::Index | Home::SwitchAndIndex(_))
}

#[cfg(not(feature = "encoders"))]
fn has_inputs(_: usize, settings: &JointSettings) -> bool {
    settings.encoder.is_none() && !settings.needs_limit_switches()
}

/// Stops the state machines of all joints.
pub fn halt() {
    for (block, machines) in PIO.into_iter().zip(MACHINES) {
        clear(block, 0x0, machines);
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Running,
    /// The emergency stop ended the pulses; periods since its circuit was closed.
    Stopped(u16),
}

/// Hands words over to the state machines; the side of SysTick.
pub struct Engine {
    state: State,
    widths: [u16; JOINTS],
    /// Of the last batch.
    next_begins: [i16; JOINTS],
    /// Words of this period and the one before.
    handed_over: [HandedOver; 2],
    emitted: [i32; JOINTS],
    /// Joints that lost steps since the last enable, one bit each.
    lost: u8,
}

impl Engine {
    /// Prepares state machines, DMA and pins, and starts the state machines.
    pub fn start() -> Self {
        halt();
        for block in PIO {
            for (at, word) in PROGRAM.iter().enumerate() {
                write(block, 0x48 + 4 * at, u32::from(*word));
            }
        }
        let mut engine = Self {
            state: State::Running,
            widths: [MIN_WIDTH; JOINTS],
            next_begins: [0; JOINTS],
            handed_over: [NOTHING; 2],
            emitted: [0; JOINTS],
            lost: 0,
        };
        engine.restart();
        for joint in 0..JOINTS {
            pins::give_to_pio(joint, place(joint).0);
        }
        engine
    }

    /// A buffer that is free until its batch is handed over.
    pub fn free(&self) -> usize {
        let taken = |buffer| {
            let mut batches = self.handed_over.iter().filter_map(|it| it.batch.as_ref());
            batches.any(|batch| batch.buffer == buffer)
        };
        (0..BUFFERS).find(|buffer| !taken(*buffer)).unwrap_or(0)
    }

    /// Steps of each joint so far, with those of the period that begins now excluded.
    pub const fn emitted(&self, joint: usize) -> i32 {
        self.emitted[joint]
    }

    /// The emergency stop has ended the pulses.
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

    /// Begins a period with these words; without them it has no steps. `late` are the cycles since
    /// SysTick.
    pub fn begin(&mut self, batch: Option<Batch>, late: u32) {
        // What was handed over before has been emitted, unless the emergency stop ended it.
        if let Some(before) = &self.handed_over[0].batch {
            for joint in 0..JOINTS {
                self.emitted[joint] = self.emitted[joint].wrapping_add(before.steps[joint].into());
            }
        }
        if let Some(batch) = &batch {
            self.next_begins = batch.next_begins;
        }
        match self.state {
            State::Running if (0..JOINTS).any(has_stopped) => {
                self.stop();
                self.handed_over = [NOTHING; 2];
            }
            State::Running => match batch {
                Some(batch) if batch.widths != self.widths || late > TOO_LATE => {
                    self.lose(&batch);
                    // The restart ends the last pulses of the period before.
                    if let Some(before) = self.handed_over[0].batch {
                        self.lose(&before);
                    }
                    self.widths = batch.widths;
                    self.restart();
                    self.handed_over = [NOTHING; 2];
                }
                Some(batch) => {
                    self.lost |= batch.unfit;
                    let now = if self.hand_over(&batch) {
                        HandedOver {
                            batch: Some(batch),
                            words: batch.used,
                        }
                    } else {
                        NOTHING
                    };
                    self.handed_over = [now, self.handed_over[0]];
                }
                None => {
                    let mut now = NOTHING;
                    for joint in 0..JOINTS {
                        // SAFETY: only this function uses the gaps; an address is taken here.
                        let gap = unsafe { &raw const (*WORDS.gaps.get())[joint] };
                        now.words[joint] = trigger(joint, gap, 1).into();
                    }
                    self.handed_over = [now, self.handed_over[0]];
                }
            },
            State::Stopped(closed) => {
                for joint in 0..JOINTS {
                    // The pulses that the stop found have their width by now.
                    execute(joint, 0xA042); // mov y, y  side 0
                }
                self.state = if pins::emergency_stop() {
                    State::Stopped(0)
                } else if closed < CLOSED {
                    State::Stopped(closed + 1)
                } else {
                    self.restart();
                    State::Running
                };
                if let Some(batch) = batch {
                    self.lose(&batch);
                }
            }
        }
    }

    /// The steps of a batch are not emitted.
    fn lose(&mut self, batch: &Batch) {
        for joint in 0..JOINTS {
            if batch.steps[joint] != 0 {
                self.lost |= 1 << joint;
            }
        }
    }

    /// Gives the words to the DMA. False if it still has words of the period before.
    fn hand_over(&mut self, batch: &Batch) -> bool {
        for joint in 0..JOINTS {
            // SAFETY: see `Words`; an address is taken here.
            let words = unsafe { &raw const (*WORDS.buffers.get())[batch.buffer][joint] };
            if !trigger(joint, words.cast(), u32::from(batch.used[joint])) {
                self.lose(batch);
                return false;
            }
        }
        // SAFETY: only this module uses the gaps, and the DMA has read those of the last period.
        unsafe { *WORDS.gaps.get() = batch.gaps };
        true
    }

    /// Stops all joints after an emergency stop, and subtracts the steps that did not leave.
    fn stop(&mut self) {
        self.state = State::Stopped(0);
        halt();
        for joint in 0..JOINTS {
            let mut unsent = usize::from(unsent_words(joint));
            let mut steps = 0_i32;
            for period in &self.handed_over {
                let used = usize::from(period.words[joint]);
                let from = used - unsent.min(used);
                unsent -= used - from;
                if let Some(batch) = &period.batch {
                    // SAFETY: see `Words`.
                    let words =
                        unsafe { &(&(*WORDS.buffers.get())[batch.buffer])[joint][from..used] };
                    let pulses = words.iter().filter(|word| **word & 2 != 0).count() as i32;
                    steps += pulses * i32::from(batch.steps[joint].signum());
                }
            }
            self.emitted[joint] = self.emitted[joint].wrapping_sub(steps);
        }
    }

    /// Starts the state machines with the present widths; the next period begins in time.
    fn restart(&mut self) {
        halt();
        for joint in 0..JOINTS {
            let (block, machine) = place(joint);
            let (block, own) = (PIO[block], 0xC8 + 0x18 * machine);
            let step = pins::FIRST_STEP + 2 * joint as u32;
            write(block, own, 1 << 16);
            // Wrap from the last instruction to the first; JMP PIN tests the emergency stop.
            write(block, own + 0x4, pins::EMERGENCY_STOP << 24 | WRAP << 12);
            // Both sizes of the FIFO in turn, which empties it; without autopull at first.
            write(block, own + 0x8, 0);
            write(block, own + 0x8, 1 << 30 | 1 << 19);
            // One side-set pin, two set pins, one output pin.
            let pins = 1 << 29 | 2 << 26 | 1 << 20 | step << 10 | step << 5 | (step + 1);
            write(block, own + 0x14, pins);
            // Restart of the state machine and of its clock divider.
            set(block, 0x0, 0x11 << (4 + machine));
            write(
                block,
                0x10 + 4 * machine,
                width_register(self.widths[joint]),
            );
            execute(joint, 0xE000); // set pins, 0
            execute(joint, 0xE083); // set pindirs, 3
            execute(joint, 0x80A0); // pull
            execute(joint, 0xA0C7); // mov isr, osr
            execute(joint, 0x6060); // out null, 32
            execute(joint, 0x0000); // jmp 0
            write(block, own + 0x8, 1 << 30 | 1 << 19 | 1 << 17);
            let channel = 0x40 * joint;
            write(DMA, channel + 0x4, (block + 0x10 + 4 * machine) as u32);
            let request = 8 * place(joint).0 as u32 + machine as u32;
            // Enabled, high priority, words, reading onwards, chained to itself, quiet.
            let control = 0b1_1011 | (joint as u32) << 13 | request << 17 | 1 << 23;
            write(DMA, channel + 0x10, control);
            // SAFETY: only this module uses the gaps, and no DMA reads them now.
            unsafe { (*WORDS.gaps.get())[joint] = (PERIOD_TICKS - 3) << 2 };
        }
        // The first word lasts to the start of the words of the next period.
        let left = (read(SYSTICK, 0x8) + LEAD) / CYCLES_PER_TICK;
        for joint in 0..JOINTS {
            let (block, machine) = place(joint);
            let ticks = left.saturating_add_signed(self.next_begins[joint].into());
            write(PIO[block], 0x10 + 4 * machine, ticks.saturating_sub(3) << 2);
        }
        // All state machines of both blocks in the same cycle.
        write(PIO[0], 0x0, MACHINES[0] | 1 << 24 | MACHINES[1] << 20);
    }
}

/// Executes an instruction in the state machine of a joint, also while it is stopped.
fn execute(joint: usize, instruction: u16) {
    let (block, machine) = place(joint);
    write(PIO[block], 0xD8 + 0x18 * machine, u32::from(instruction));
}

/// Address of the next instruction of the state machine of a joint.
fn address(joint: usize) -> u32 {
    let (block, machine) = place(joint);
    read(PIO[block], 0xD4 + 0x18 * machine)
}

/// The state machine of a joint has seen the emergency stop.
fn has_stopped(joint: usize) -> bool {
    address(joint) == STOP
}

/// Ends the DMA of a joint whose state machine is stopped; the words that it did not emit. A step
/// line that is high stays high.
fn unsent_words(joint: usize) -> u16 {
    let (block, machine) = place(joint);
    let channel = 0x40 * joint;
    let queued = || (read(PIO[block], 0xC) >> (8 * machine) & 0xF) as u16;
    let is_busy = || read(DMA, channel + 0x10) >> 26 & 1 != 0;
    // The DMA fills the FIFO of 8 words, which no one empties now.
    for _ in 0..64 {
        if queued() == 8 || !is_busy() {
            break;
        }
    }
    let left = (read(DMA, channel + 0x8) & 0x0FFF_FFFF) as u16;
    let queued = queued();
    clear(DMA, channel + 0x10, 1);
    write(DMA, 0x464, 1 << joint);
    while is_busy() {}
    let stopped_at = address(joint);
    // The output shift register may hold the next word, or a part of this one: a state machine
    // refills it as soon as it is empty. Only its own condition shows that.
    let line = if stopped_at == PULSE { 0x1000 } else { 0 };
    execute(joint, line); // jmp 0
    execute(joint, line | 0x00E0 | STOP as u16); // jmp !osre, stop
    let shifting = u16::from(address(joint) == STOP);
    left + queued + shifting + u16::from(is_before_pulse(stopped_at))
}

/// Gives words to the DMA of a joint. False if it still has others.
fn trigger(joint: usize, words: *const u32, count: u32) -> bool {
    let channel = 0x40 * joint;
    // The last words of a period enter the FIFO within a few cycles.
    for _ in 0..16 {
        if read(DMA, channel + 0x10) >> 26 & 1 == 0 {
            write(DMA, channel + 0x8, count);
            write(DMA, channel + 0x3C, words as u32);
            return true;
        }
    }
    false
}

const _: () = assert!(PERIOD_CYCLES == PERIOD_TICKS * CYCLES_PER_TICK);
