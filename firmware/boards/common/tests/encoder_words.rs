//! The program of the encoders on a model of its state machine, against the count of the edges.

use haptimill_board_common::encoder_words::{EncoderCount, PROGRAM, START, WRAP};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// A state machine by the data sheet of the RP2350: each instruction a cycle and its delay, output
/// to the right, input to the left.
#[derive(Default)]
struct Machine {
    address: u32,
    x: u32,
    y: u32,
    isr: u32,
    osr: u32,
    delay: u16,
}

impl Machine {
    fn new(pins: u32) -> Self {
        let mut machine = Self::default();
        for word in START {
            machine.execute(word, pins);
        }
        machine
    }

    /// Executes an instruction; returns the word that it offers.
    fn execute(&mut self, word: u16, pins: u32) -> Option<u32> {
        let bits = u32::from(word & 31);
        let mut offered = None;
        let mut next = if self.address == WRAP.0 {
            WRAP.1
        } else {
            self.address + 1
        };
        match word >> 13 {
            0b000 => {
                let taken = match word >> 5 & 7 {
                    0 => true,
                    2 => {
                        self.x = self.x.wrapping_sub(1);
                        self.x != u32::MAX
                    }
                    4 => {
                        self.y = self.y.wrapping_sub(1);
                        self.y != u32::MAX
                    }
                    other => panic!("condition {other}"),
                };
                if taken {
                    next = bits;
                }
            }
            0b010 => {
                let source = match word >> 5 & 7 {
                    0 => pins,
                    1 => self.x,
                    2 => self.y,
                    other => panic!("source {other}"),
                };
                self.isr = self.isr << bits | source & (u32::MAX >> (32 - bits));
            }
            0b011 => {
                assert_eq!(word >> 5 & 7, 6, "out isr");
                self.isr = self.osr & (u32::MAX >> (32 - bits));
                self.osr >>= bits;
            }
            0b100 => {
                assert_eq!(word & 0xFF, 0, "push noblock");
                offered = Some(self.isr);
                self.isr = 0;
            }
            0b101 => {
                let source = match word & 7 {
                    0 => pins,
                    2 => self.y,
                    3 => 0,
                    6 => self.isr,
                    other => panic!("source {other}"),
                };
                let value = match word >> 3 & 3 {
                    0 => source,
                    1 => !source,
                    other => panic!("operation {other}"),
                };
                match word >> 5 & 7 {
                    1 => self.x = value,
                    2 => self.y = value,
                    5 => next = value & 31,
                    6 => self.isr = value,
                    7 => self.osr = value,
                    other => panic!("destination {other}"),
                }
            }
            other => panic!("instruction {other}"),
        }
        self.address = next;
        self.delay = word >> 8 & 31;
        offered
    }

    /// One cycle; the word that it offers.
    fn cycle(&mut self, pins: u32) -> Option<u32> {
        if self.delay > 0 {
            self.delay -= 1;
            return None;
        }
        self.execute(PROGRAM[self.address as usize], pins)
    }
}

/// Levels of A in bit 0 and B in bit 1 at a count.
const fn levels(count: i64) -> u32 {
    [0b00, 0b01, 0b11, 0b10][(count & 3) as usize]
}

/// Time of a cycle, ns.
fn ns(cycle: u64) -> u32 {
    (cycle * 20 / 3) as u32
}

/// Runs the machine along counts that begin at these cycles, and reads it every `period` cycles
/// until `end`. Returns the counts and the times of the last edges, and checks them.
fn follow(start: i64, edges: &[(u64, i64)], period: u64, end: u64) {
    let mut machine = Machine::new(levels(start));
    let mut count = EncoderCount::new();
    let (mut at, mut now) = (edges.iter().peekable(), start);
    let (mut last, mut waits) = (None, None);
    for cycle in 0..end {
        if let Some(&&(due, next)) = at.peek()
            && due <= cycle
        {
            now = next;
            last = Some(cycle);
            at.next();
        }
        // The FIFO is empty from here on, and its first word counts.
        if cycle % period == 0 {
            waits = Some((cycle, now, last));
        }
        let word = machine.cycle(levels(now));
        if let (Some(word), Some((since, then, edge))) = (word, waits) {
            waits = None;
            count.add(word, ns(since));
            let seen = i64::from(count.counts());
            // An edge within 20 cycles is seen or not.
            let near = edges.iter().any(|(due, _)| since.abs_diff(*due) <= 20);
            if !near {
                assert_eq!(seen, then - start, "at cycle {since}");
                if let Some(edge) = edge {
                    let error = count.edge_time_ns().wrapping_sub(ns(edge)).cast_signed();
                    assert!(error.abs() <= 100, "{error} ns at cycle {since}");
                }
            }
        }
    }
    assert_eq!(waits, None);
}

#[test]
fn counts_are_exact_in_both_directions_through_zero() {
    // 13 cycles an edge is the fastest: forward, back through zero, and forward.
    let path = (1..=200).chain((-300_i64..200).rev()).chain(-299..=0);
    let edges: Vec<(u64, i64)> = (50..).step_by(13).zip(path).collect();
    let end = edges.last().unwrap().0 + 5000;
    follow(0, &edges, 3000, end);
    let reversed: Vec<(u64, i64)> = edges.iter().map(|(at, count)| (*at, 1 - count)).collect();
    follow(1, &reversed, 3000, end);
}

/// The turns wrap around after 3.9 ms: a slow encoder keeps the time of its last edge.
#[test]
fn an_encoder_at_rest_keeps_the_time_of_its_last_edge() {
    let edges = [(40_000, 1), (5_000_000, 2), (5_000_500, 1)];
    follow(0, &edges, 30_000, 12_000_000);
    follow(0, &edges, 75_000, 12_000_000);
}

#[test]
fn a_transition_of_both_channels_is_not_counted() {
    let mut machine = Machine::new(0b00);
    let mut words = Vec::new();
    for cycle in 0..400 {
        words.extend(machine.cycle(if cycle < 200 { 0b00 } else { 0b11 }));
    }
    assert!(words.iter().all(|word| word >> 16 == 0));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Any motion whose edges are at least 13 cycles apart.
    #[test]
    fn any_motion_is_counted(
        start in -5_i64..5,
        steps in prop::collection::vec((13_u64..400, any::<bool>()), 1..400),
    ) {
        let (mut at, mut count) = (100, start);
        let edges: Vec<(u64, i64)> = steps
            .iter()
            .map(|(wait, up)| {
                at += wait;
                count += if *up { 1 } else { -1 };
                (at, count)
            })
            .collect();
        follow(start, &edges, 7_001, at + 20_000);
    }
}
