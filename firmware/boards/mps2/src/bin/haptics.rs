//! The image for a machine with a haptic arm.
#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    haptimill_mps2::wiring::run()
}
