//! The image of checks: runs `haptimill-checks` on the chip, all of them or those named on the
//! image's command line.
//!
//! A failed check panics, which ends the image with its reason and a nonzero exit code. To find all
//! failures, run the image once for each name; it starts in some hundredths of a second. The word
//! `instructions` prints the cost of the kinematics instead.
#![no_std]
#![no_main]

use core::hint::black_box;
use haptimill_checks::kinematics::h4::{Arm, REFERENCE};
use haptimill_checks::kinematics::subject::{Sequence, Subject, raw_pose};
use haptimill_checks::{Check, FAILING, all};
use haptimill_kinematics::{Joints, Kinematics, Pose};
use haptimill_mps2::{counter, ending, semihosting};

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
        if name == "instructions" {
            instructions();
            continue;
        }
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

/// Number of poses measured.
const POSES: u32 = 1000;

/// Cost over all poses.
#[derive(Default)]
struct Taken {
    sum: u64,
    max: u32,
}

impl Taken {
    fn add<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let begun = counter::now();
        let between = counter::now();
        let done = work();
        let mark = counter::now();
        // The cost of reading the counter is not included.
        let took = mark
            .wrapping_sub(between)
            .wrapping_sub(between.wrapping_sub(begun));
        self.sum += u64::from(took);
        self.max = self.max.max(took);
        done
    }

    /// Prints mean and largest number of instructions. A count is 40/1024 of an instruction.
    fn say(&self, name: &str) {
        let mean = self.sum * 40 / 1024 / u64::from(POSES);
        let max = u64::from(self.max) * 40 / 1024;
        ending::say(format_args!("{name} {mean} {max}\n"));
    }
}

/// Measures inverse and forward kinematics of the H-4 arm over its whole reach.
fn instructions() {
    counter::start();
    let arm = Arm::new(REFERENCE);
    let machine = arm.machine();
    let mut sequence = Sequence(5);
    let (mut inverse, mut forward) = (Taken::default(), Taken::default());
    let mut left = POSES;
    while left > 0 {
        let pose: Pose = raw_pose(&arm, &arm.random_pose(&mut sequence));
        // Only poses in reach are measured.
        let Ok(joints): Result<Joints, _> = machine.inverse(&pose) else {
            continue;
        };
        left -= 1;
        let again = inverse.add(|| machine.inverse(black_box(&pose)));
        assert_eq!(again, Ok(joints));
        let back = forward.add(|| machine.forward(black_box(&joints)));
        assert!(back.is_ok(), "{pose:?}");
    }
    inverse.say("inverse");
    forward.say("forward");
}
