//! Checks of memory copy, move and fill: a board may have its own implementation.

use crate::Check;
use core::hint::black_box;

/// The checks of this module.
pub const CHECKS: &[Check] = &[
    Check {
        name: "memory::copies_of_every_length_and_place",
        run: copies,
    },
    Check {
        name: "memory::moves_of_every_distance",
        run: moves,
    },
    Check {
        name: "memory::fills_of_every_length_and_place",
        run: fills,
    },
];

/// Longer than two rounds of the longest loop plus a remainder.
const LONGEST: usize = 100;
/// With space on both sides.
const ROOM: usize = LONGEST + 32;

/// Word-aligned, so that the offsets below are relative to a word.
#[repr(align(8))]
struct Aligned([u8; ROOM]);

/// Byte at an offset before any operation.
const fn mark(place: usize) -> u8 {
    (place as u8).wrapping_mul(37).wrapping_add(11)
}

fn marked() -> Aligned {
    let mut bytes = Aligned([0; ROOM]);
    for (place, byte) in bytes.0.iter_mut().enumerate() {
        *byte = mark(place);
    }
    bytes
}

/// Asserts that every byte equals `commanded` of its offset.
fn assert_all(bytes: &Aligned, what: [usize; 3], commanded: impl Fn(usize) -> u8) {
    for (place, byte) in bytes.0.iter().enumerate() {
        assert!(*byte == commanded(place), "{what:?}, byte {place}: {byte}");
    }
}

fn copies() {
    let source = marked();
    for [from, to] in (0..64).map(|k| [k / 8, k % 8]) {
        for length in 0..=LONGEST {
            let mut target = Aligned([0xA5; ROOM]);
            let copied = black_box(&source).0.get(from..from + length);
            let place = target.0.get_mut(to..to + black_box(length));
            place.expect("room").copy_from_slice(copied.expect("room"));
            assert_all(&target, [from, to, length], |place| {
                if (to..to + length).contains(&place) {
                    mark(place - to + from)
                } else {
                    0xA5
                }
            });
        }
    }
}

fn moves() {
    for [from, to] in (0..24 * 24).map(|k| [k / 24, k % 24]) {
        for length in (0..=LONGEST).step_by(3) {
            let mut bytes = marked();
            let range = from..from + black_box(length);
            bytes.0.copy_within(range, black_box(to));
            assert_all(&bytes, [from, to, length], |place| {
                if (to..to + length).contains(&place) {
                    mark(place - to + from)
                } else {
                    mark(place)
                }
            });
        }
    }
}

fn fills() {
    for to in 0..8 {
        for length in 0..=LONGEST {
            for byte in [0, 0x5B] {
                let mut bytes = marked();
                let place = bytes.0.get_mut(to..to + black_box(length));
                place.expect("room").fill(black_box(byte));
                assert_all(&bytes, [to, length, usize::from(byte)], |place| {
                    if (to..to + length).contains(&place) {
                        byte
                    } else {
                        mark(place)
                    }
                });
            }
        }
    }
}
