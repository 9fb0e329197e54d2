//! The image of the product with fault injection: see [`haptimill_mps2::faults`].
#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    haptimill_mps2::wiring::run()
}
