//! Words of step generators against the checker of pulses: a model of the state machine draws the
//! lines, instruction by instruction.

use haptimill_board_common::step_words::{
    CYCLES_PER_TICK, MAX, MIN_SETUP, PROGRAM, STOP, StepWords, Unfit, WRAP, width_register,
};
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::StepSegment;
use haptimill_firmware::joint::step_gen::{PulseTiming, StepPlanner};
use haptimill_math::{Coordinate, Rate};
use haptimill_pulses::{AxisSignals, Capture, Clock, Planned, Rules, Signal, check};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const PERIOD: u32 = 15_000;
const CLOCK: Clock = Clock {
    ticks_per_us: 75,
    period_us: 200,
};

/// A state machine by the data sheet of the RP2350: each instruction a cycle, side-set applied in
/// it, autopull of 32 bits, shift to the right.
struct Machine {
    address: u32,
    x: u32,
    y: u32,
    isr: u32,
    osr: u32,
    left: u32,
    step: bool,
    direction: bool,
}

impl Machine {
    fn new(width: u16) -> Self {
        Self {
            address: 0,
            x: 0,
            y: 0,
            isr: width_register(width),
            osr: 0,
            left: 0,
            step: false,
            direction: false,
        }
    }

    fn take(&mut self, bits: u32, words: &mut impl Iterator<Item = u32>) -> Option<u32> {
        if self.left == 0 {
            self.osr = words.next()?;
            self.left = 32;
        }
        let value = self.osr & (u32::MAX >> (32 - bits));
        self.osr = self.osr.checked_shr(bits).unwrap_or(0);
        self.left -= bits;
        Some(value)
    }

    /// One cycle; `None` when no word is left.
    fn cycle(&mut self, stop: bool, words: &mut impl Iterator<Item = u32>) -> Option<()> {
        let word = PROGRAM[self.address as usize];
        let target = u32::from(word & 31);
        let mut next = if self.address == WRAP {
            0
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
                    3 => self.y == 0,
                    4 => {
                        self.y = self.y.wrapping_sub(1);
                        self.y != u32::MAX
                    }
                    6 => stop,
                    other => panic!("condition {other}"),
                };
                if taken {
                    next = target;
                }
            }
            0b011 => {
                let value = self.take(u32::from(word & 31), words)?;
                match word >> 5 & 7 {
                    0 => self.direction = value != 0,
                    1 => self.x = value,
                    2 => self.y = value,
                    other => panic!("destination {other}"),
                }
            }
            0b101 => {
                assert_eq!(word & 0xFF, 0b0100_0110, "mov y, isr");
                self.y = self.isr;
            }
            other => panic!("instruction {other}"),
        }
        self.step = word >> 12 & 1 != 0;
        self.address = next;
        Some(())
    }
}

/// Lines that the state machine draws for these words, times in fs.
fn lines(words: &[u32], width: u16) -> (Signal, Signal, u64) {
    let mut machine = Machine::new(width);
    let mut words = words.iter().copied();
    let mut step = Signal::default();
    let mut direction = Signal::default();
    let mut cycles = 0_u64;
    let (mut step_level, mut direction_level) = (false, false);
    while machine.cycle(false, &mut words).is_some() {
        let time = (i128::from(cycles) * 20_000_000 / 3) as i64;
        if machine.step != step_level {
            step_level = machine.step;
            step.changes.push(time);
        }
        if machine.direction != direction_level {
            direction_level = machine.direction;
            direction.changes.push(time);
        }
        cycles += 1;
    }
    (step, direction, cycles)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// The controller's own planner, at random speeds with reversals, up to 1 M steps a second.
    #[test]
    fn pulses_leave_when_the_planner_says(
        width in 2_u16..38,
        setup in MIN_SETUP..400,
        hold in MIN_SETUP..400,
        moves in proptest::collection::vec((-210_000_i32..210_000, 1_usize..12), 3..12),
    ) {
        let timing = PulseTiming { period: PERIOD, pulse: width, setup, hold };
        // 1000 axis units a step.
        let mut planner = StepPlanner::new(AxisKind::Linear, 1000 << 24, timing, 200);
        let mut encoder = StepWords::new(PERIOD, width);
        let (mut words, mut planned) = (Vec::new(), Vec::new());
        let mut at = 0_i32;
        let mut period = 1;
        words.push(encoder.wait(PERIOD));
        for (speed, periods) in moves {
            for _ in 0..periods {
                at += speed;
                let rate = Rate(i32::try_from(i64::from(speed) * 5000).unwrap_or(i32::MAX));
                let segment = planner.plan(Coordinate(at), rate).segment;
                let mut buffer = [0; MAX];
                let used = encoder.fill(&segment, &mut buffer);
                prop_assert!(used.is_ok(), "{segment:?}");
                words.extend(&buffer[..used.unwrap()]);
                if segment.count != 0 {
                    planned.push(Planned { period, segment });
                }
                period += 1;
            }
        }
        let mut last = [0; MAX];
        let used = encoder.fill(&StepSegment::default(), &mut last).unwrap();
        words.extend(&last[..used]);
        let (step, direction, cycles) = lines(&words, width);
        // The words fill the periods exactly.
        prop_assert_eq!(cycles, (period + 1) * u64::from(PERIOD * CYCLES_PER_TICK));
        let capture = Capture { resolution: 1, start: 0, end: i64::MAX, signals: Vec::new() };
        let axis = AxisSignals { name: "x", step: &step, direction: &direction, planned: Some(&planned) };
        let ticks = |ticks: u16| CLOCK.femtoseconds(i64::from(ticks)) - 2;
        let rules = Rules {
            clock: CLOCK,
            tolerance: 2,
            width: ticks(width),
            pause: ticks(width),
            setup: ticks(setup),
            hold: ticks(hold),
            exact_width: Some(u32::from(width)),
        };
        let report = check(&capture, &[axis], None, &rules);
        prop_assert_eq!(report.fault_count(), 0, "{:?}", report);
        let steps: u64 = planned.iter().map(|plan| u64::from(plan.segment.count.unsigned_abs())).sum();
        prop_assert_eq!(report.compared(), 2 * steps);
    }
}

#[test]
fn a_segment_that_does_not_fit_is_a_period_without_steps() {
    let mut encoder = StepWords::new(PERIOD, 30);
    for (count, delay, interval, ramp) in [
        (3, 100, 20, 0),
        (2, 14_990, 60, 0),
        (1, u32::MAX, 0, 0),
        (600, 1, 24, 0),
        (3, 100, 60, i32::MIN),
    ] {
        let segment = StepSegment {
            count,
            delay,
            interval,
            ramp,
        };
        let mut words = [0; MAX];
        assert_eq!(
            encoder.fill(&segment, &mut words),
            Err(Unfit),
            "{segment:?}"
        );
        assert_eq!(words[0], (PERIOD - 3) << 2, "{segment:?}");
    }
}

#[test]
fn the_emergency_stop_ends_the_pulses_in_the_state_machine() {
    let mut encoder = StepWords::new(PERIOD, 30);
    let segment = StepSegment {
        count: 199,
        delay: 75,
        interval: 75,
        ramp: 0,
    };
    // At each cycle of two steps, the stop opens for one cycle of the state machine and longer.
    for open in 1000..1300 {
        let mut words = [0; MAX];
        let used = encoder.fill(&segment, &mut words).unwrap();
        let mut machine = Machine::new(30);
        let mut words = words[..used].iter().copied();
        let mut last_high = 0;
        for cycle in 0..20_000 {
            if machine.cycle(cycle >= open, &mut words).is_none() {
                break;
            }
            if machine.step {
                last_high = cycle;
            }
        }
        assert_eq!(machine.address, STOP);
        // At most the pulse that had begun: 60 cycles of 6.7 ns.
        assert!(last_high <= open + 62, "{open} {last_high}");
    }
}
