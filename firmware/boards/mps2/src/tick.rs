//! Period handler, in the SysTick exception.
//!
//! The timer behind the exception stands still. The simulator decides when a period begins, and
//! software pends the exception. A period therefore runs as in the product, including interrupts,
//! and depends only on its inputs.

use crate::counter::StageCounter;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m_rt::exception;
use haptimill_board_cortex::shared::Shared;
use haptimill_firmware::comm::rx_ring::Waiting;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::pil::{DoneRef, FROM_BOARD_WORDS, FromBoardRef, LineInputs};
use haptimill_firmware::snapshot::Snapshot;

/// Data of the control period.
pub struct Period {
    /// The controller, once a run has begun.
    pub controller: Option<Controller>,
    /// Bytes received from the host.
    pub waiting: Option<Waiting<'static>>,
    /// Inputs of the period.
    pub inputs: Inputs,
    /// Outputs of the period.
    pub outputs: Outputs,
    /// Stage profiler.
    pub counter: StageCounter,
}

// The handler runs only when `run` has pended it. `with` is not active then, because both belong to
// the main program.
static PERIOD: Shared<Period> = Shared::new();
/// `start` was called.
static STARTED: AtomicBool = AtomicBool::new(false);

/// Returns the period, if `start` was called.
///
/// # Safety
/// No other code may use the period meanwhile: the main program and the handler take turns.
unsafe fn period() -> Option<&'static mut Period> {
    if !STARTED.load(Ordering::Relaxed) {
        return None;
    }
    // SAFETY: it was written before `STARTED` was set; the caller guarantees the rest.
    Some(unsafe { PERIOD.get() })
}

/// Initialises the period. The receive interrupt gets a higher priority than the period.
pub fn start(scb: &mut SCB, waiting: Waiting<'static>) {
    // SAFETY: nothing depends on priorities yet.
    unsafe { scb.set_priority(SystemHandler::SysTick, 0x80) };
    // SAFETY: the handler has not been pended yet, and does nothing before `STARTED` is set.
    let place = unsafe { PERIOD.place() };
    place.write(Period {
        controller: None,
        waiting: Some(waiting),
        inputs: Inputs::default(),
        outputs: Outputs::default(),
        counter: StageCounter::default(),
    });
    STARTED.store(true, Ordering::Relaxed);
}

/// Starts a run with a new controller.
pub fn begin(period_us: u16) {
    with(|period| put(&mut period.controller, period_us));
    #[cfg(feature = "defmt")]
    defmt::info!("a run begins, {=u16} us a period", period_us);
}

/// Creates a controller in place: on the stack it would be the largest object.
#[inline(never)]
fn put(place: &mut Option<Controller>, period_us: u16) {
    *place = Some(Controller::new(period_us));
}

/// Accesses the period from the main program, between two periods.
pub fn with<T>(look: impl FnOnce(&mut Period) -> T) -> Option<T> {
    // SAFETY: the main program is one thread. The closure can call `with` again only by recursion,
    // which this crate does not have. The handler is not pending.
    unsafe { period() }.map(look)
}

/// Runs one control period in its handler.
pub fn run() {
    SCB::set_pendst();
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Writes the frame of the last period; `snapshot` is a buffer for the state of the controller.
#[inline(always)]
pub fn report(period: &Period, snapshot: &mut Snapshot, frame: &mut [u32; FROM_BOARD_WORDS]) {
    let configured = match &period.controller {
        Some(controller) => controller.read(&period.inputs, snapshot),
        None => false,
    };
    FromBoardRef::Done(DoneRef {
        period: period.inputs.period,
        outputs: &period.outputs,
        transmitted: period.outputs.transmit.len() as u16,
        line_inputs: LineInputs::of(&period.inputs),
        stages: &period.counter.stages,
        snapshot: configured.then_some(&*snapshot),
    })
    .write(frame);
}

#[exception]
fn SysTick() {
    // SAFETY: see `PERIOD`.
    let Some(period) = (unsafe { period() }) else {
        return;
    };
    // Keeps the address opaque: built into every function called from here, a field far from the
    // base register costs two instructions more.
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
