//! Flashes of a lamp.

use haptimill_board_common::lamp::Lamp;

/// Times in ms at which the lamp goes on, and off.
fn changes(flashes: u32, until: u32) -> (Vec<u32>, Vec<u32>) {
    let mut lamp = Lamp::new(flashes, 168_000);
    let (mut on, mut off, mut lit) = (vec![], vec![], false);
    for time in 0..until {
        // A counter of 32 bits wraps around after 25 s.
        let now = (u64::from(time) * 168_000) as u32;
        match lamp.update(now) {
            Some(true) => on.push(time),
            Some(false) if lit => off.push(time),
            _ => {}
        }
        lit = on.len() > off.len();
    }
    (on, off)
}

#[test]
fn a_number_is_shown_as_flashes() {
    let (on, off) = changes(3, 3000);
    assert_eq!(on[..4], [700, 1000, 1300, 2300]);
    assert_eq!(off[..3], [800, 1100, 1400]);
}

#[test]
fn one_flash_a_second_goes_on_while_the_counter_wraps() {
    let (on, _) = changes(1, 60_000);
    assert!(on.windows(2).all(|pair| pair[1] - pair[0] == 1000));
    assert_eq!(on.len(), 60);
}
