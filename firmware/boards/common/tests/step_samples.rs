//! Samples of step and direction lines: a port that obeys them, against the times of the segments.

use haptimill_board_common::step_samples::{
    Lines, SLOTS, Samples, StepSamples, Unfit, missed, rises,
};
use haptimill_firmware::config::AxisKind;
use haptimill_firmware::io::StepSegment;
use haptimill_firmware::joint::step_gen::{PulseTiming, StepPlanner};
use haptimill_math::{Coordinate, Rate};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Ticks of the step clock in a slot: 84 MHz, slots of 0.5 us.
const TICKS: u32 = 42;
const PERIOD: u32 = TICKS * SLOTS as u32;

/// Words of a period in which no line changes.
const NONE: Samples = [0; SLOTS];

const LINES: [Lines; 3] = [
    Lines {
        step: 4,
        direction: 10,
    },
    Lines {
        step: 8,
        direction: 2,
    },
    Lines {
        step: 0,
        direction: 15,
    },
];

/// A port that obeys words as the register of the chip does: bits of the upper half reset pins,
/// bits of the lower half set them, and setting wins.
#[derive(Default)]
struct Port {
    levels: u32,
    slot: u64,
    /// Slot, pin, and its new level.
    edges: Vec<(u64, u8, bool)>,
}

impl Port {
    fn obey(&mut self, samples: &Samples) {
        for word in samples {
            let before = self.levels;
            self.levels = self.levels & !(word >> 16) | word & 0xFFFF;
            for pin in 0..16 {
                if (before ^ self.levels) >> pin & 1 != 0 {
                    self.edges
                        .push((self.slot, pin, self.levels >> pin & 1 != 0));
                }
            }
            self.slot += 1;
        }
    }

    fn of(&self, pin: u8, rising: bool) -> Vec<u64> {
        let edges = self.edges.iter();
        let edges = edges.filter(|edge| edge.1 == pin && edge.2 == rising);
        edges.map(|edge| edge.0).collect()
    }
}

/// Times of the steps of a segment by its definition, in ticks from the start of its period.
fn times(segment: &StepSegment) -> impl Iterator<Item = i64> {
    let (delay, interval) = (i64::from(segment.delay), i64::from(segment.interval));
    let ramp = i64::from(segment.ramp);
    let count = i64::from(segment.count.unsigned_abs());
    (0..count).map(move |k| delay + k * interval + ramp * (k * (k - 1) / 2))
}

/// The port of the board against the planned segments of a joint.
fn compare(port: &Port, lines: Lines, width: u32, setup: u32, hold: u32, plan: &[StepSegment]) {
    let rising = port.of(lines.step, true);
    let falling = port.of(lines.step, false);
    let planned: Vec<(i64, bool)> = plan
        .iter()
        .enumerate()
        .flat_map(|(period, segment)| {
            let start = period as i64 * i64::from(PERIOD);
            times(segment).map(move |time| (start + time, segment.count > 0))
        })
        .collect();
    assert_eq!(rising.len(), planned.len(), "number of steps");
    assert_eq!(falling.len(), planned.len(), "number of pulses");
    // The level of the direction line over the time.
    let direction: Vec<(u64, bool)> = port
        .edges
        .iter()
        .filter(|edge| edge.1 == lines.direction)
        .map(|edge| (edge.0, edge.2))
        .collect();
    for (k, (time, up)) in planned.iter().enumerate() {
        let at = rising[k] as i64 * i64::from(TICKS);
        assert!(
            (0..i64::from(TICKS)).contains(&(time - at)),
            "step {k} at {at}, planned at {time}"
        );
        assert_eq!(
            falling[k] - rising[k],
            u64::from(width),
            "width of pulse {k}"
        );
        if let Some(next) = rising.get(k + 1) {
            assert!(
                next - falling[k] >= u64::from(width),
                "pause after pulse {k}"
            );
        }
        let before = direction.iter().rev().find(|change| change.0 <= rising[k]);
        assert_eq!(
            before.is_some_and(|change| change.1),
            *up,
            "direction of {k}"
        );
        for (change, _) in &direction {
            assert!(
                rising[k].abs_diff(*change) >= u64::from(setup) || *change > rising[k],
                "set-up of step {k}"
            );
            assert!(
                *change <= rising[k] || *change >= falling[k] + u64::from(hold),
                "hold of step {k}"
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, rng_seed: RngSeed::Fixed(37), failure_persistence: None, ..ProptestConfig::default() })]

    /// The planner of the controller, three joints in one word, at random speeds with reversals.
    #[test]
    fn every_step_rises_in_the_slot_of_its_time(
        width in 1_u32..12,
        setup in 1_u32..40,
        hold in 0_u32..40,
        moves in proptest::collection::vec(
            ([-210_000_i32..210_000, -90_000_i32..90_000, -1_000_i32..1_000], 1_usize..10), 3..12),
    ) {
        let timing = PulseTiming {
            period: PERIOD,
            pulse: (width * TICKS) as u16,
            setup: (setup * TICKS) as u16,
            hold: (hold * TICKS) as u16,
        };
        // 1000 axis units a step.
        let planner = StepPlanner::new(AxisKind::Linear, 1000 << 24, timing, 200);
        let mut planners = LINES.map(|_| planner.clone());
        let mut encoders = LINES.map(|lines| StepSamples::new(lines, TICKS, width));
        let (mut port, mut plans) = (Port::default(), [vec![], vec![], vec![]]);
        let mut at = [0_i32; 3];
        for (speeds, periods) in moves {
            for _ in 0..periods {
                let mut samples = NONE;
                for joint in 0..3 {
                    at[joint] += speeds[joint];
                    let rate = Rate(speeds[joint].saturating_mul(5000));
                    let segment = planners[joint].plan(Coordinate(at[joint]), rate).segment;
                    prop_assert_eq!(encoders[joint].add(&segment, &mut samples), Ok(()));
                    let early = times(&segment).filter(|t| t / i64::from(TICKS) < SLOTS as i64 / 3);
                    let early = early.count();
                    prop_assert_eq!(usize::from(rises(&samples, LINES[joint], SLOTS / 3)), early);
                    plans[joint].push(segment);
                }
                port.obey(&samples);
            }
        }
        let mut last = NONE;
        for encoder in &mut encoders {
            prop_assert_eq!(encoder.add(&StepSegment::default(), &mut last), Ok(()));
        }
        port.obey(&last);
        for joint in 0..3 {
            compare(&port, LINES[joint], width, setup, hold, &plans[joint]);
        }
    }

    /// Any segment: what does not keep the width, the pause and the period is refused, and leaves
    /// the words as they were.
    #[test]
    fn a_segment_that_does_not_fit_adds_nothing(
        width in 1_u32..12,
        count: i16,
        delay in 0_u32..20_000,
        interval in 0_u32..2_000,
        ramp in -40_i32..40,
    ) {
        let segment = StepSegment { count, delay, interval, ramp };
        let mut samples = NONE;
        let mut encoder = StepSamples::new(LINES[0], TICKS, width);
        let pulse = i64::from(width * TICKS);
        let all: Vec<i64> = times(&segment).collect();
        let fits = all.windows(2).all(|pair| pair[1] - pair[0] >= 2 * pulse)
            && all.last().is_none_or(|last| *last < i64::from(PERIOD));
        let result = encoder.add(&segment, &mut samples);
        prop_assert_eq!(result.is_ok(), fits, "{:?}", segment);
        if fits {
            let mut port = Port::default();
            port.obey(&samples);
            let mut after = NONE;
            prop_assert_eq!(encoder.add(&StepSegment::default(), &mut after), Ok(()));
            port.obey(&after);
            compare(&port, LINES[0], width, 0, 0, &[segment]);
        } else {
            // The line of a joint without a pulse is low, and may be set so.
            samples[0] &= !LINES[0].fall();
            prop_assert_eq!(samples, NONE);
        }
    }
}

#[test]
fn a_step_too_soon_after_the_period_before_is_refused() {
    let at = |slots: u32| StepSegment {
        count: 1,
        delay: slots * TICKS,
        ..StepSegment::default()
    };
    for begins in [395, 397, 399] {
        let mut encoder = StepSamples::new(LINES[0], TICKS, 5);
        assert_eq!(encoder.add(&at(begins), &mut [0; SLOTS]), Ok(()));
        let ready = begins + 10 - 400;
        let (mut again, mut refused) = (encoder.clone(), encoder.clone());
        assert_eq!(
            refused.add(&at(ready - 1), &mut [0; SLOTS]),
            Err(Unfit),
            "{begins}"
        );
        assert_eq!(again.add(&at(ready), &mut [0; SLOTS]), Ok(()), "{begins}");
        // A period without steps is time enough.
        for delay in [None, Some(0)] {
            let segment = delay.map_or(StepSegment::default(), at);
            assert_eq!(encoder.add(&segment, &mut [0; SLOTS]), Ok(()));
        }
    }
}

/// A pulse that the end of its period cuts has its whole width: before a period with steps, before
/// one without, before a refused segment and before another width. A missed period makes it longer.
#[test]
fn a_pulse_ends_in_the_next_period() {
    let step = |slot: u32| StepSegment {
        count: 1,
        delay: slot * TICKS,
        ..StepSegment::default()
    };
    let too_soon = step(1);
    for begins in 390..400 {
        for next in [StepSegment::default(), step(20), too_soon] {
            let mut encoder = StepSamples::new(LINES[1], TICKS, 8);
            let (mut first, mut second) = (NONE, NONE);
            assert_eq!(encoder.add(&step(begins), &mut first), Ok(()));
            assert_eq!(encoder.add(&next, &mut second).is_err(), next == too_soon);
            let mut other = StepSamples::new(LINES[1], TICKS, 8);
            let mut wider = NONE;
            assert_eq!(other.add(&step(begins), &mut [0; SLOTS]), Ok(()));
            let mut other = other.with_width(10);
            assert_eq!(other.add(&StepSegment::default(), &mut wider), Ok(()));
            for after in [&second, &wider] {
                let mut port = Port::default();
                port.obey(&first);
                port.obey(after);
                let begins = u64::from(begins);
                assert_eq!(port.of(LINES[1].step, true)[0], begins);
                assert_eq!(port.of(LINES[1].step, false)[0], begins + 8);
            }
            let mut port = Port::default();
            port.obey(&first);
            port.obey(&missed(&LINES));
            let rose = port.of(LINES[1].step, true);
            let fell = port.of(LINES[1].step, false);
            assert_eq!((rose.len(), fell.len()), (1, 1));
            assert!((8..=210).contains(&(fell[0] - rose[0])));
        }
    }
}
