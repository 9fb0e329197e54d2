//! The image of the product with logging over UART2.
#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    haptimill_mps2::wiring::run()
}
