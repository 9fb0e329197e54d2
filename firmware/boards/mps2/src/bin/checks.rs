//! The checks of `haptimill-checks` on the chip: all of them, or those whose names are on the image's command line.
//!
//! One that fails panics, which ends the image with its reason and a code that is not zero. Whoever wants to know of all that fail runs the image once for
//! each name; it starts in some hundredths of a second.
#![no_std]
#![no_main]

use haptimill_checks::{Check, FAILING, all};
use haptimill_mps2::{ending, semihosting};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut core) = cortex_m::Peripherals::take() else {
        semihosting::exit(ending::PANIC);
    };
    ending::watch(&mut core.SCB, &mut core.MPU);
    let mut room = [0; 512];
    let names = semihosting::command_line(&mut room);
    let names = || names.split_ascii_whitespace().skip(1);
    if names().next().is_none() {
        all().for_each(run);
    }
    for name in names() {
        let mut every = all().chain([&FAILING]);
        match every.find(|check| check.name == name) {
            Some(check) => run(check),
            None => panic!("there is no check '{name}'"),
        }
    }
    semihosting::exit(0)
}

fn run(check: &Check) {
    ending::say(format_args!("test {} ... ", check.name));
    (check.run)();
    ending::say(format_args!("ok\n"));
}
