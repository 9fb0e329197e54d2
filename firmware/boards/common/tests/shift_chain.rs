//! The order of the inputs of the shift registers.

use haptimill_board_common::shift_chain::{Inputs, outputs};

/// What is seen of all joints and of the digital inputs.
fn seen(inputs: Inputs) -> Vec<bool> {
    let joints = (0..5).flat_map(|joint| {
        [
            inputs.home(joint),
            inputs.limit_low(joint),
            inputs.limit_high(joint),
            inputs.alarm(joint),
        ]
    });
    joints
        .chain((0..4).map(|channel| inputs.digital() >> channel & 1 != 0))
        .collect()
}

#[test]
fn each_bit_is_one_input() {
    let mut found = vec![0; 24];
    for bit in 0..24 {
        let word = 1 << (bit + 8) | 0xFF;
        let active: Vec<usize> = (0..24).filter(|at| seen(Inputs::of(word))[*at]).collect();
        assert_eq!(active.len(), 1, "bit {bit}");
        found[active[0]] += 1;
    }
    assert_eq!(found, vec![1; 24]);
    assert!(!Inputs::ALL.home(5), "there is no sixth joint");
}

#[test]
fn a_word_without_its_last_bits_is_a_broken_chain() {
    assert_eq!(seen(Inputs::of(0xFF)), vec![false; 24]);
    for word in [0, 0x7F, 0xFE, 0xFFFF_FF7F, u32::MAX] {
        assert_eq!(seen(Inputs::of(word)), vec![true; 24], "{word:#x}");
    }
}

#[test]
fn the_direction_of_the_spindle_is_the_first_output() {
    assert_eq!(outputs(true, 0), 1);
    assert_eq!(outputs(false, 0b101), 0b1010);
    assert_eq!(outputs(false, u32::MAX), 0xFE);
}
