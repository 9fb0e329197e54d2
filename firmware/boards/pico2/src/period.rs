//! The control period.
//!
//! SysTick begins it: it hands the pulses over, latches the inputs, and serves the UART if that is
//! the line to the host. It then pends PendSV, which calls the controller and makes the words of
//! the next period. While PendSV still computes, SysTick counts a missed period and leaves the data
//! alone.

use crate::chips::Follower;
use crate::clocks::{PERIOD_CYCLES, PERIOD_US, cycles};
#[cfg(feature = "encoders")]
use crate::encoders::Encoders;
use crate::ending;
use crate::line::InPeriod;
use crate::link::Bytes;
use crate::pins::{self, JOINTS};
use crate::record::{self, Cycles, Start};
use crate::registers::{SYSTICK, read, write};
use crate::signals::{Levels, Signals};
use crate::steps::{Batch, Engine, Filler, requirements};
use crate::storage;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m_rt::exception;
use haptimill_board_common::spindle::SpindleLines;
use haptimill_board_cortex::shared::Shared;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveAlarm, DriveCommand, Inputs, Outputs};

/// Data of SysTick.
struct Front {
    engine: Engine,
    line: InPeriod,
    signals: Signals,
    #[cfg(feature = "encoders")]
    encoders: Encoders,
    spindle: SpindleLines,
    period: u64,
    missed: u16,
}

/// Data of PendSV, and of SysTick while PendSV does not run.
struct Back {
    controller: Controller,
    inputs: Inputs,
    outputs: Outputs,
    bytes: Bytes,
    /// Chips of the drives.
    chips: Follower,
    filler: Filler,
    /// Buffer for the words of the next period.
    buffer: usize,
    batch: Option<Batch>,
    /// Joints that this board cannot drive, one bit each.
    wrong: u8,
    /// Changes of the inputs that the noise filter suppressed.
    glitches: u32,
    start: Start,
}

// `start` writes both before SysTick is enabled. From then on only SysTick uses `FRONT`, and `BACK`
// belongs to PendSV while `BUSY` is set and to SysTick otherwise.
static FRONT: Shared<Front> = Shared::new();
static BACK: Shared<Back> = Shared::new();
/// PendSV computes.
static BUSY: AtomicBool = AtomicBool::new(false);

/// Starts the control periods.
pub fn start(line: InPeriod, bytes: Bytes, chips: Follower) {
    let Some(mut core) = cortex_m::Peripherals::take() else {
        return;
    };
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    // SysTick runs, without its interrupt: the pulses start in step with it.
    write(SYSTICK, 0x4, PERIOD_CYCLES - 1);
    write(SYSTICK, 0x8, 0);
    write(SYSTICK, 0x0, 0b101);
    // SAFETY: no handler runs yet, and this function runs once.
    unsafe {
        put(BACK.place(), bytes, chips);
        let controller = &mut BACK.get().controller;
        storage::load(|kept| controller.restore(kept));
        FRONT.place().write(Front {
            engine: Engine::start(),
            line,
            signals: Signals::start(),
            #[cfg(feature = "encoders")]
            encoders: Encoders::start(),
            spindle: SpindleLines::new(),
            period: 0,
            missed: 0,
        });
        // SysTick may interrupt PendSV.
        core.SCB.set_priority(SystemHandler::SysTick, 0x20);
        core.SCB.set_priority(SystemHandler::PendSV, 0xE0);
    }
    write(SYSTICK, 0x0, 0b111);
}

/// Creates the data, out of line: the compiler makes a copy on the stack, 47 KB, which is free
/// again before the first control period.
#[inline(never)]
fn put(place: &mut MaybeUninit<Back>, bytes: Bytes, chips: Follower) {
    place.write(Back {
        controller: Controller::new(PERIOD_US),
        inputs: Inputs::default(),
        outputs: Outputs::default(),
        bytes,
        chips,
        filler: Filler::new(),
        buffer: 0,
        batch: None,
        wrong: 0,
        glitches: 0,
        start: Start { at: 0, late: 0 },
    });
}

/// Cycles since the start of the period.
#[inline(always)]
fn elapsed() -> u32 {
    (PERIOD_CYCLES - 1).wrapping_sub(read(SYSTICK, 0x8))
}

#[exception]
fn SysTick() {
    let late = elapsed();
    let at = cycles().wrapping_sub(late);
    // SAFETY: only this handler uses it.
    let front = unsafe { FRONT.get() };
    #[cfg(feature = "encoders")]
    let latched = {
        front.encoders.latch();
        elapsed()
    };
    let busy = BUSY.load(Ordering::Acquire);
    // SAFETY: the data belong to this handler while PendSV does not run.
    let mut back = (!busy).then(|| unsafe { BACK.get() });
    let batch = back.as_mut().and_then(|back| back.batch.take());
    front.engine.begin(batch, late);
    // 20/3 ns a cycle.
    #[cfg(feature = "encoders")]
    front
        .encoders
        .read(time_ns(front.period).wrapping_add(latched * 20 / 3));
    let levels = front.signals.read();
    front.line.exchange();
    if let Some(back) = &back {
        apply(front, back);
    }
    front.signals.transfer();
    match back {
        None => front.missed = front.missed.saturating_add(1),
        Some(back) => {
            latch(front, back, levels);
            back.glitches = front.signals.glitches();
            front.missed = 0;
            back.buffer = front.engine.free();
            back.start = Start { at, late };
            BUSY.store(true, Ordering::Release);
            SCB::set_pendsv();
        }
    }
    front.period += 1;
}

/// Applies the outputs of the call before, besides the pulses.
fn apply(front: &mut Front, back: &Back) {
    let outputs = &back.outputs;
    let on = outputs
        .joints
        .iter()
        .any(|command| *command != DriveCommand::Off);
    // The controller sees a joint that is not ready one period later.
    let ready = back.chips.alarms().is_empty();
    pins::enable_drives(on && ready && !front.engine.is_stopped());
    if !on {
        front.engine.clear_lost_steps();
    }
    let spindle = front.spindle.update(outputs.spindle_rpm, pins::PWM_COUNTS);
    front.signals.write(spindle.is_clockwise, outputs.digital);
    pins::set_duty(spindle.duty);
}

/// Time of the start of a period, which wraps around.
const fn time_ns(period: u64) -> u32 {
    (period as u32).wrapping_mul(PERIOD_US as u32 * 1000)
}

/// Latches the inputs of the period.
fn latch(front: &Front, back: &mut Back, levels: Levels) {
    let inputs = &mut back.inputs;
    inputs.period = front.period;
    inputs.missed = front.missed;
    inputs.time_ns = time_ns(front.period);
    let (lost, wrong, chips) = (front.engine.lost(), back.wrong, back.chips.alarms());
    for joint in 0..JOINTS {
        let input = &mut inputs.joints[joint];
        input.steps = front.engine.emitted(joint);
        input.home = levels.home(joint);
        (input.limit_low, input.limit_high) = levels.limits(joint);
    }
    #[cfg(feature = "encoders")]
    front.encoders.write(&mut inputs.joints);
    let broken = lost | wrong | if chips.is_empty() { 0 } else { chips.joints() };
    for (joint, input) in inputs.joints.iter_mut().enumerate() {
        input.drive_ready = levels.is_ready(joint) && broken >> joint & 1 == 0;
        // The reason is looked for only where there is one: this runs in every control period.
        if !input.drive_ready {
            input.alarm = match chips.of(joint) {
                _ if wrong >> joint & 1 != 0 => DriveAlarm::Unsupported,
                Some(alarm) => alarm,
                None if lost >> joint & 1 != 0 => DriveAlarm::StepsCut,
                None => DriveAlarm::Input,
            };
        }
    }
    inputs.digital = levels.digital();
    inputs.storage = storage::state();
    inputs.emergency_stop = pins::emergency_stop() || front.engine.is_stopped();
}

#[exception]
fn PendSV() {
    let mut profile = Cycles::begin(cycles());
    // SAFETY: the data belong to this handler while `BUSY` is set.
    let back = unsafe { BACK.get() };
    let Back {
        controller,
        inputs,
        outputs,
        bytes,
        chips,
        filler,
        ..
    } = back;
    #[cfg(feature = "log")]
    haptimill_board_cortex::log::begin(inputs.period);
    bytes.waiting.take(inputs);
    inputs.transmit_room = bytes.room();
    outputs.transmit.clear();
    controller.tick(inputs, outputs, &mut profile);
    bytes.send(&outputs.transmit);
    if let Some(config) = controller.to_store() {
        storage::order(config);
    }
    chips.follow(controller.machine());
    let (widths, wrong) = requirements(controller.machine());
    back.wrong = wrong;
    back.batch = Some(filler.fill(back.buffer, &outputs.joints, &widths));
    profile.end(cycles());
    record::write(
        &back.inputs,
        &back.outputs,
        &profile,
        back.glitches,
        back.start,
    );
    ending::feed_watchdog();
    pins::pump();
    BUSY.store(false, Ordering::Release);
}
