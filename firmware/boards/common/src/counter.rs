//! Counters of 16 bits, extended to 32.

/// The value of 32 bits next to `known` whose lower half is `low`. Right as long as the counter
/// moves by less than 2^15 from one reading to the next.
#[must_use]
pub const fn extended(known: i32, low: u16) -> i32 {
    let moved = low.wrapping_sub(known as u16).cast_signed();
    known.wrapping_add(moved as i32)
}
