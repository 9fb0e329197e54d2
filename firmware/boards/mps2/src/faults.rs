//! Fault injection in a stage of a control period: `faults WHAT STAGE PERIOD` on the image's
//! command line.
//!
//! | what | |
//! | --- | --- |
//! | `panic` | a panic |
//! | `fault` | a read from an address without memory |
//! | `recurse` | a stack overflow by endless recursion |
//! | `frame` | a stack overflow by one large frame |
//! | `hang` | an endless loop |
//!
//! `STAGE` is the name of a [`Stage`], or `main`, the place between two periods, where no
//! exception is active.

use crate::semihosting;
use core::hint::black_box;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use haptimill_firmware::profiler::{STAGES, Stage};

/// Name of the place between two periods.
const MAIN_NAME: &str = "main";
/// Index of the place between two periods.
pub const MAIN: usize = STAGES;

const WHAT: [&str; 5] = ["panic", "fault", "recurse", "frame", "hang"];

static CHOSEN: AtomicU8 = AtomicU8::new(u8::MAX);
static STAGE: AtomicU8 = AtomicU8::new(0);
static PERIOD: AtomicU32 = AtomicU32::new(0);
/// Number of the present control period.
static NOW: AtomicU32 = AtomicU32::new(0);

/// Reads the image's command line.
///
/// # Panics
/// The command line has unknown words.
pub fn read() {
    let mut line = [0; 128];
    let mut words = semihosting::command_line(&mut line)
        .split_ascii_whitespace()
        .skip(1);
    let (Some(what), Some(stage), Some(period)) = (words.next(), words.next(), words.next()) else {
        return;
    };
    let (Some(what), Some(place), Ok(period)) = (
        WHAT.iter().position(|name| *name == what),
        (0..=MAIN).find(|place| place_name(*place) == stage),
        period.parse::<u32>(),
    ) else {
        panic!("faults: '{what} {stage} {period}' means nothing");
    };
    STAGE.store(place as u8, Ordering::Relaxed);
    PERIOD.store(period, Ordering::Relaxed);
    CHOSEN.store(what as u8, Ordering::Relaxed);
}

/// Records the start of a control period.
pub fn begin(period: u64) {
    NOW.store(period as u32, Ordering::Relaxed);
}

/// Reports the end of a stage.
#[inline(never)]
pub fn mark(stage: Stage) {
    reached(stage as usize);
}

/// Injects the fault if this place and period are selected.
pub fn reached(place: usize) {
    let chosen = CHOSEN.load(Ordering::Relaxed);
    if usize::from(STAGE.load(Ordering::Relaxed)) == place
        && chosen != u8::MAX
        && NOW.load(Ordering::Relaxed) >= PERIOD.load(Ordering::Relaxed)
    {
        happen(usize::from(chosen), place);
    }
}

/// Name of a stage, or of the place between two periods.
fn place_name(place: usize) -> &'static str {
    Stage::ALL
        .get(place)
        .map_or(MAIN_NAME, |stage| stage.name())
}

fn happen(what: usize, place: usize) {
    match what {
        0 => panic!(
            "injected in stage {} of period {}",
            place_name(place),
            NOW.load(Ordering::Relaxed)
        ),
        1 => {
            // SAFETY: unsound on purpose. The read raises the processor fault that is to be
            // injected.
            unsafe { (0x3000_0000 as *const u32).read_volatile() };
        }
        2 => {
            deeper(1);
        }
        3 => wide(),
        _ => loop {
            cortex_m::asm::nop();
        },
    }
}

#[inline(never)]
#[allow(
    unconditional_recursion,
    reason = "a stack that overflows is what this is for"
)]
fn deeper(depth: u32) -> u32 {
    let mut room = [depth; 16];
    black_box(&mut room);
    let sum = deeper(depth.wrapping_add(1));
    // The use after the call prevents the compiler from turning the recursion into a loop.
    black_box(&mut room)[(depth & 15) as usize].wrapping_add(sum)
}

#[inline(never)]
fn wide() {
    // Larger than the stack.
    let mut room = [0_u8; 160 * 1024];
    black_box(&mut room);
}
