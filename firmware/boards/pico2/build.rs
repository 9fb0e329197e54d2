//! Where the linker finds the script of this image, and its control period.

use std::env;

/// The variable of the environment with the control period, us.
const VARIABLE: &str = "HAPTIMILL_PERIOD_US";
/// Control periods that an image can have; the first is the one without the variable. Each is a
/// whole part of a second, which the controller requires, and its steps at 1,000,000 steps/s fit
/// into the buffers of `step_words`.
const PERIODS: [&str; 5] = ["200", "250", "320", "400", "500"];
/// Longest control period with the UART, which receives 25 bytes of its FIFO's 32 in it.
const LONGEST_WITH_UART: u32 = 250;

fn main() {
    let here = env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo:rustc-link-arg-bins=-T{here}/image.x");
    if env::var_os("CARGO_FEATURE_LOG").is_some() {
        // The texts of the log have a section of their own, which is in the image's file and not in
        // the flash.
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    println!("cargo:rerun-if-changed=image.x");
    println!("cargo:rerun-if-env-changed={VARIABLE}");
    println!("cargo:rerun-if-changed=build.rs");
    let period = env::var(VARIABLE).unwrap_or_else(|_| PERIODS[0].to_string());
    if !PERIODS.contains(&period.as_str()) {
        println!(
            "cargo::error={VARIABLE} is '{period}'; control periods of this image are {} us",
            PERIODS.join(", ")
        );
    }
    let is_long = period.parse().is_ok_and(|us: u32| us > LONGEST_WITH_UART);
    if env::var_os("CARGO_FEATURE_UART").is_some() && is_long {
        println!(
            "cargo::error={VARIABLE} is {period}; with the UART the control period is at most \
             {LONGEST_WITH_UART} us, in which its FIFO does not overflow"
        );
    }
    println!("cargo:rustc-env={VARIABLE}={period}");
}
