//! The control period, in the handler of the SysTick exception.
//!
//! The timer behind the exception stands still: the simulator says when a period begins, and the exception is pended by hand. So a period is the
//! product's own, interrupts and all, and yet depends on nothing but what it is given.

use crate::counter::StageCounter;
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m_rt::exception;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::pil::{FROM_BOARD_WORDS, Heard, Says, Told};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_firmware::comm::rx_ring::Waiting;

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

/// Zeros before the start, so that the image does not carry them: a place, and whether it was filled.
struct Shared {
    started: AtomicBool,
    place: UnsafeCell<MaybeUninit<Period>>,
}

// SAFETY: the handler runs only when `run` has pended it, and `with` is not under way then (both belong to the main program).
unsafe impl Sync for Shared {}

static PERIOD: Shared = Shared {
    started: AtomicBool::new(false),
    place: UnsafeCell::new(MaybeUninit::zeroed()),
};

impl Shared {
    /// The period, if `start` was called.
    ///
    /// # Safety
    /// Nobody else may use it meanwhile: the main program and the handler take turns.
    #[allow(
        clippy::mut_from_ref,
        reason = "that is what the cell is for; see Safety"
    )]
    unsafe fn get(&self) -> Option<&mut Period> {
        if !self.started.load(Ordering::Relaxed) {
            return None;
        }
        // SAFETY: it was filled before `started` was set; the caller vouches for the rest.
        Some(unsafe { (*self.place.get()).assume_init_mut() })
    }
}

/// Puts everything in its place; the receive interrupt is more urgent than the period.
pub fn start(scb: &mut SCB, waiting: Waiting<'static>) {
    // SAFETY: nothing depends on priorities yet.
    unsafe { scb.set_priority(SystemHandler::SysTick, 0x80) };
    // SAFETY: the handler has not been pended yet, and finds nothing before `started` is set.
    let place = unsafe { &mut *PERIOD.place.get() };
    place.write(Period {
        controller: None,
        waiting: Some(waiting),
        inputs: Inputs::default(),
        outputs: Outputs::default(),
        counter: StageCounter::default(),
    });
    PERIOD.started.store(true, Ordering::Relaxed);
}

/// A run begins, with a new controller.
pub fn begin(period_us: u16) {
    with(|period| put(&mut period.controller, period_us));
    #[cfg(feature = "defmt")]
    defmt::info!("a run begins, {=u16} us a period", period_us);
}

/// Makes a controller in its place: on the way over the stack it would be the largest thing there.
#[inline(never)]
fn put(place: &mut Option<Controller>, period_us: u16) {
    *place = Some(Controller::new(period_us));
}

/// Looks at the period from the main program, between two of them.
pub fn with<T>(look: impl FnOnce(&mut Period) -> T) -> Option<T> {
    // SAFETY: the main program is one thread, the closure cannot get hold of `with` a second time without recursion that this crate does
    // not have, and the handler is not pending.
    unsafe { PERIOD.get() }.map(look)
}

/// One control period, in its handler.
pub fn run() {
    SCB::set_pendst();
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Writes the frame of the period that was run last; `snapshot` is a place for how the controller stands.
#[inline(always)]
pub fn tell(period: &Period, snapshot: &mut Snapshot, frame: &mut [u32; FROM_BOARD_WORDS]) {
    let configured = match &period.controller {
        Some(controller) => controller.read(&period.inputs, snapshot),
        None => false,
    };
    Says::Done(Told {
        period: period.inputs.period,
        outputs: &period.outputs,
        said: period.outputs.transmit.len() as u16,
        heard: Heard::of(&period.inputs),
        stages: &period.counter.stages,
        snapshot: configured.then_some(&*snapshot),
    })
    .write(frame);
}

#[exception]
fn SysTick() {
    // SAFETY: see `Shared`.
    let Some(period) = (unsafe { PERIOD.get() }) else {
        return;
    };
    // Its address is not to be built into every function that is called from here: a field that is far from the one register costs two instructions more.
    let period = core::hint::black_box(period);
    let (Some(controller), Some(waiting)) = (&mut period.controller, &mut period.waiting) else {
        return;
    };
    #[cfg(feature = "faults")]
    crate::faults::begin(period.inputs.period);
    #[cfg(feature = "defmt")]
    crate::log::begin(period.inputs.period);
    period.counter = StageCounter::begin();
    waiting.take(&mut period.inputs);
    controller.tick(&period.inputs, &mut period.outputs, &mut period.counter);
}
