//! The control period, in the handler of the SysTick exception.
//!
//! The timer behind the exception stands still: the simulator says when a period begins, and the exception is pended by hand. So a period is the
//! product's own, interrupts and all, and yet depends on nothing but what it is given.

use crate::counter::StageCounter;
use core::cell::UnsafeCell;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m_rt::exception;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::lockstep::{Done, Heard};
use haptimill_firmware::receive::Waiting;

/// All that a control period works on.
pub struct Period {
    /// The controller, once a run has begun.
    pub controller: Option<Controller>,
    /// The line from the host.
    pub waiting: Option<Waiting<'static>>,
    /// What is sensed.
    pub inputs: Inputs,
    /// What is to be done.
    pub outputs: Outputs,
    /// What it cost.
    pub counter: StageCounter,
}

struct Shared(UnsafeCell<Option<Period>>);

// SAFETY: the handler runs only when `run` has pended it, and `with` is not under way then (both belong to the main program).
unsafe impl Sync for Shared {}

static PERIOD: Shared = Shared(UnsafeCell::new(None));

/// Puts everything in its place; the receive interrupt is more urgent than the period.
pub fn start(scb: &mut SCB, waiting: Waiting<'static>) {
    // SAFETY: nothing depends on priorities yet.
    unsafe { scb.set_priority(SystemHandler::SysTick, 0x80) };
    // SAFETY: the handler has not been pended yet.
    unsafe {
        *PERIOD.0.get() = Some(Period {
            controller: None,
            waiting: Some(waiting),
            inputs: Inputs::default(),
            outputs: Outputs::default(),
            counter: StageCounter::default(),
        });
    }
}

/// Looks at the period from the main program, between two of them.
pub fn with<T>(look: impl FnOnce(&mut Period) -> T) -> Option<T> {
    // SAFETY: the main program is one thread, the closure cannot get hold of `with` a second time without recursion that this crate does
    // not have, and the handler is not pending.
    unsafe { (*PERIOD.0.get()).as_mut().map(look) }
}

/// One control period, in its handler.
pub fn run() {
    SCB::set_pendst();
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// What is told of the period that was run last.
#[must_use]
pub fn done(period: &Period) -> Done {
    Done {
        period: period.inputs.period,
        outputs: Outputs {
            axes: period.outputs.axes,
            spindle_rpm: period.outputs.spindle_rpm,
            ..Outputs::default()
        },
        said: period.outputs.transmit.len() as u16,
        heard: Heard::of(&period.inputs),
        stages: period.counter.stages,
        reading: period
            .controller
            .as_ref()
            .and_then(|controller| controller.reading(&period.inputs)),
    }
}

#[exception]
fn SysTick() {
    // SAFETY: see `Shared`.
    let Some(period) = (unsafe { (*PERIOD.0.get()).as_mut() }) else {
        return;
    };
    let (Some(controller), Some(waiting)) = (&mut period.controller, &mut period.waiting) else {
        return;
    };
    waiting.take(&mut period.inputs);
    period.counter = StageCounter::begin();
    controller.tick(&period.inputs, &mut period.outputs, &mut period.counter);
}
