//! The control period.
//!
//! TIM1 begins it: its interrupt hands the words of the pulses over, latches the inputs, and pends
//! PendSV, which calls the controller and makes the words of the next period. While PendSV still
//! computes, the interrupt counts a missed period and leaves the data alone.

use crate::clocks::{CYCLES_PER_US, PERIOD_CYCLES, PERIOD_US, cycles};
use crate::encoders::Encoders;
use crate::ending;
use crate::line::Line;
use crate::pins::{self, JOINTS, Levels};
use crate::record;
use crate::registers::timer::{
    CONTROL, COUNT, ENABLES, EVENTS, OVERFLOW_ONLY, PRESCALER, RELOAD, RUN, STATUS, UPDATE,
    UPDATE_INTERRUPT, UPDATED,
};
use crate::registers::{TIM1, TIM1_UPDATE_INTERRUPT, read, write};
use crate::steps::{Batch, Engine, Filler, requirements};
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::{NVIC, SCB};
use cortex_m_rt::exception;
use haptimill_board_common::spindle::SpindleLines;
use haptimill_board_cortex::shared::Shared;
use haptimill_drivers::input_filter::InputFilter;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveAlarm, DriveCommand, Inputs, Outputs};

/// Priorities: the line to the host is more urgent than the period, its computation less.
const URGENT: u8 = 0x80;
const COMPUTATION: u8 = 0xF0;

/// Data of the interrupt.
struct Front {
    engine: Engine,
    encoders: Encoders,
    filter: InputFilter,
    spindle: SpindleLines,
    /// Number of the present period.
    period: u64,
    missed: u16,
    /// Cycle at which the interrupt ran last.
    last: u32,
}

/// Data of PendSV, and of the interrupt while PendSV does not run.
struct Back {
    controller: Controller,
    inputs: Inputs,
    outputs: Outputs,
    line: Line,
    filler: Filler,
    /// Buffer for the words of the next period.
    buffer: usize,
    batch: Option<Batch>,
    /// Joints that this board cannot drive, one bit each.
    wrong: u8,
    /// Changes of the inputs that the noise filter suppressed.
    glitches: u32,
    /// Cycle at which the period began.
    start: u32,
}

// `start` writes both before the interrupt is enabled. From then on only the interrupt uses
// `FRONT`, and `BACK` belongs to PendSV while `BUSY` is set and to the interrupt otherwise.
static FRONT: Shared<Front> = Shared::new();
static BACK: Shared<Back> = Shared::new();
/// PendSV computes.
static BUSY: AtomicBool = AtomicBool::new(false);

/// Starts the control periods.
pub fn start(scb: &mut SCB, nvic: &mut NVIC, line: Line) {
    pins::start_spindle();
    write(TIM1, CONTROL, OVERFLOW_ONLY);
    write(TIM1, PRESCALER, 0);
    write(TIM1, RELOAD, PERIOD_CYCLES - 1);
    write(TIM1, EVENTS, UPDATE);
    write(TIM1, STATUS, 0);
    write(TIM1, ENABLES, UPDATE_INTERRUPT);
    // SAFETY: no handler runs yet, and this function runs once.
    unsafe {
        put(BACK.place(), line);
        FRONT.place().write(Front {
            engine: Engine::start(),
            encoders: Encoders::start(),
            filter: Levels::read().filter(),
            spindle: SpindleLines::new(),
            period: 0,
            missed: 0,
            last: cycles(),
        });
        // The interrupt may interrupt PendSV.
        scb.set_priority(SystemHandler::PendSV, COMPUTATION);
        nvic.set_priority(TIM1_UPDATE_INTERRUPT, URGENT);
        NVIC::unmask(TIM1_UPDATE_INTERRUPT);
    }
    write(TIM1, CONTROL, OVERFLOW_ONLY | RUN);
}

/// Creates the data, out of line: the compiler makes a copy on the stack, which is free again
/// before the first control period.
#[inline(never)]
fn put(place: &mut MaybeUninit<Back>, line: Line) {
    place.write(Back {
        controller: Controller::new(PERIOD_US),
        inputs: Inputs::default(),
        outputs: Outputs::default(),
        line,
        filler: Filler::new(),
        buffer: 0,
        batch: None,
        wrong: 0,
        glitches: 0,
        start: 0,
    });
}

/// Handler of TIM1.
pub extern "C" fn begin() {
    write(TIM1, STATUS, !UPDATED);
    // SAFETY: only this handler uses it.
    let front = unsafe { FRONT.get() };
    let busy = BUSY.load(Ordering::Acquire);
    // SAFETY: the data belong to this handler while PendSV does not run.
    let mut back = (!busy).then(|| unsafe { BACK.get() });
    let levels = Levels::read();
    let batch = back.as_mut().and_then(|back| back.batch.take());
    front.engine.begin(batch, levels.emergency_stop());
    front.encoders.read();
    let levels = levels.filtered(&mut front.filter);
    front.count();
    match back {
        None => front.missed = front.missed.saturating_add(1),
        Some(back) => {
            apply(front, &back.outputs);
            latch(front, back, levels);
            front.missed = 0;
            back.glitches = front.filter.all_glitches();
            back.buffer = front.engine.free();
            back.start = front.last;
            BUSY.store(true, Ordering::Release);
            SCB::set_pendsv();
        }
    }
}

impl Front {
    /// Counts the periods since the last call: one, and those in which the interrupt did not run.
    fn count(&mut self) {
        let now = cycles();
        let passed = now
            .wrapping_sub(self.last)
            .saturating_add(PERIOD_CYCLES / 2)
            / PERIOD_CYCLES;
        self.last = now;
        let passed = passed.max(1);
        self.period += u64::from(passed);
        let missed = u16::try_from(passed - 1).unwrap_or(u16::MAX);
        self.missed = self.missed.saturating_add(missed);
    }

    /// Time of the free-running clock, ns.
    fn time_ns(&self) -> u32 {
        let start = (self.period as u32).wrapping_mul(u32::from(PERIOD_US) * 1000);
        start.wrapping_add(read(TIM1, COUNT) * 1000 / CYCLES_PER_US)
    }
}

/// Applies the outputs of the call before, besides the pulses.
fn apply(front: &mut Front, outputs: &Outputs) {
    let on = outputs
        .joints
        .iter()
        .any(|command| *command != DriveCommand::Off);
    pins::enable_drives(on && !front.engine.is_stopped());
    if !on {
        front.engine.clear_lost_steps();
    }
    pins::set_spindle(&mut front.spindle, outputs.spindle_rpm);
    pins::set_outputs(outputs.digital);
}

/// Latches the inputs of the period.
fn latch(front: &mut Front, back: &mut Back, levels: Levels) {
    let inputs = &mut back.inputs;
    inputs.period = front.period;
    inputs.missed = front.missed;
    inputs.time_ns = front.time_ns();
    front.encoders.latch(&mut inputs.joints, inputs.time_ns);
    for joint in 0..JOINTS {
        let input = &mut inputs.joints[joint];
        input.steps = front.engine.emitted(joint);
        input.home = levels.home(joint);
        input.limit_low = levels.limit_low(joint);
        input.limit_high = levels.limit_high(joint);
    }
    let (lost, wrong) = (front.engine.lost(), back.wrong);
    for (joint, input) in inputs.joints.iter_mut().enumerate() {
        let alarm = match (wrong >> joint & 1 != 0, lost >> joint & 1 != 0) {
            (true, _) => Some(DriveAlarm::Unsupported),
            (_, true) => Some(DriveAlarm::StepsCut),
            _ => (!levels.drives_ready()).then_some(DriveAlarm::Input),
        };
        input.drive_ready = alarm.is_none();
        input.alarm = alarm.unwrap_or_default();
    }
    inputs.digital = levels.digital();
    inputs.emergency_stop = levels.emergency_stop() || front.engine.is_stopped();
}

#[exception]
fn PendSV() {
    // SAFETY: the data belong to this handler while `BUSY` is set.
    let back = unsafe { BACK.get() };
    let Back {
        controller,
        inputs,
        outputs,
        line,
        ..
    } = back;
    #[cfg(feature = "log")]
    haptimill_board_cortex::log::begin(inputs.period);
    line.waiting.take(inputs);
    inputs.transmit_room = line.room();
    outputs.transmit.clear();
    controller.tick(inputs, outputs, &mut ());
    line.transmit(&outputs.transmit);
    let (widths, wrong) = requirements(controller.machine());
    back.wrong = wrong;
    back.batch = Some(back.filler.fill(back.buffer, outputs, &widths));
    let busy = cycles().wrapping_sub(back.start);
    record::write(&back.inputs, &back.outputs, back.glitches, busy);
    ending::feed_watchdog();
    pins::pump();
    BUSY.store(false, Ordering::Release);
}
