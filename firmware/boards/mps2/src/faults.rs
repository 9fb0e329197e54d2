//! Something that goes wrong on purpose, in a stage of a period: `faults WHAT STAGE PERIOD` on the image's command line.
//!
//! | what | |
//! | --- | --- |
//! | `panic` | a panic |
//! | `fault` | a read from where there is nothing |
//! | `recurse` | a stack that overflows by calls that never end |
//! | `frame` | a stack that overflows by one large frame |
//! | `hang` | it goes round for ever |
//!
//! `STAGE` is the name of a [`Stage`], or `main`: between two periods, where no exception is active.

use crate::semihosting;
use core::hint::black_box;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use haptimill_firmware::profiler::{STAGES, Stage};

/// The stages by name.
const NAMES: [&str; STAGES + 1] = [
    "receive",
    "measure",
    "supervise",
    "command",
    "interpolate",
    "comply",
    "solve",
    "servo",
    "render",
    "report",
    "interlock",
    "main",
];
/// The place between two periods.
pub const MAIN: usize = STAGES;

const WHAT: [&str; 5] = ["panic", "fault", "recurse", "frame", "hang"];

static CHOSEN: AtomicU8 = AtomicU8::new(u8::MAX);
static STAGE: AtomicU8 = AtomicU8::new(0);
static PERIOD: AtomicU32 = AtomicU32::new(0);
/// The period that runs.
static NOW: AtomicU32 = AtomicU32::new(0);

/// Reads the image's command line.
///
/// # Panics
/// It has words that mean nothing.
pub fn read() {
    let mut line = [0; 128];
    let mut words = semihosting::command_line(&mut line)
        .split_ascii_whitespace()
        .skip(1);
    let (Some(what), Some(stage), Some(period)) = (words.next(), words.next(), words.next()) else {
        return;
    };
    let place = |names: &[&str], word: &str| names.iter().position(|name| *name == word);
    let (Some(what), Some(stage), Ok(period)) = (
        place(&WHAT, what),
        place(&NAMES, stage),
        period.parse::<u32>(),
    ) else {
        panic!("faults: '{what} {stage} {period}' means nothing");
    };
    STAGE.store(stage as u8, Ordering::Relaxed);
    PERIOD.store(period, Ordering::Relaxed);
    CHOSEN.store(what as u8, Ordering::Relaxed);
}

/// A period begins.
pub fn begin(period: u64) {
    NOW.store(period as u32, Ordering::Relaxed);
}

/// A stage has ended.
#[inline(never)]
pub fn mark(stage: Stage) {
    reached(stage as usize);
}

/// A place was reached in the period that runs.
pub fn reached(place: usize) {
    let chosen = CHOSEN.load(Ordering::Relaxed);
    if usize::from(STAGE.load(Ordering::Relaxed)) == place
        && chosen != u8::MAX
        && NOW.load(Ordering::Relaxed) >= PERIOD.load(Ordering::Relaxed)
    {
        happen(usize::from(chosen), place);
    }
}

fn happen(what: usize, place: usize) {
    match what {
        0 => panic!(
            "injected in stage {} of period {}",
            NAMES[place],
            NOW.load(Ordering::Relaxed)
        ),
        1 => {
            // SAFETY: it is not safe; the fault that it raises is what this is for.
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
    // Looked at after the call, so that it must be kept, and the calls cannot become a loop.
    black_box(&mut room)[(depth & 15) as usize].wrapping_add(sum)
}

#[inline(never)]
fn wide() {
    // More than the stack has.
    let mut room = [0_u8; 100 * 1024];
    black_box(&mut room);
}
