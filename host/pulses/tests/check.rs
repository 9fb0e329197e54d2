//! The checker against lines that are drawn from the definition of a segment, and against the same
//! lines with one fault each.

use haptimill_firmware::io::StepSegment;
use haptimill_pulses::{
    AxisSignals, Capture, Clock, FaultKind, NANOSECOND, Planned, Report, Rules, Signal, check,
    picture,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const CLOCK: Clock = Clock {
    ticks_per_us: 75,
    period_us: 200,
};
/// Ticks of a pulse.
const WIDTH: i64 = 30;
/// Ticks by which the direction changes before the period of its pulses begins.
const EARLY: i64 = 10;

const RULES: Rules = Rules {
    clock: CLOCK,
    tolerance: 2000,
    width: 400 * NANOSECOND,
    pause: 100 * NANOSECOND,
    setup: 200 * NANOSECOND,
    hold: 100 * NANOSECOND,
    exact_width: Some(30),
};

fn time(ticks: i64) -> i64 {
    (i128::from(ticks) * 1_000_000_000 / 75) as i64
}

/// Lines of a board that emits the segments, written as the formula of the segment says, with
/// period 0 at `offset` fs.
fn lines(planned: &[Planned], offset: i64) -> (Signal, Signal) {
    let mut step = Signal {
        name: "board.x_step".into(),
        ..Signal::default()
    };
    let mut direction = Signal {
        name: "board.x_dir".into(),
        ..Signal::default()
    };
    for Planned { period, segment } in planned {
        let start = *period as i64 * 15_000;
        let up = segment.count > 0;
        let level = direction.changes.len() % 2 == 1;
        if segment.count != 0 && up != level {
            direction.changes.push(time(start - EARLY) + offset);
        }
        let (mut at, mut interval) = (i64::from(segment.delay), i64::from(segment.interval));
        for _ in 0..segment.count.unsigned_abs() {
            step.changes.push(time(start + at) + offset);
            step.changes.push(time(start + at + WIDTH) + offset);
            at += interval;
            interval += i64::from(segment.ramp);
        }
    }
    (step, direction)
}

fn capture(step: &Signal, direction: &Signal) -> Capture {
    let times = step.changes.iter().chain(&direction.changes);
    Capture {
        resolution: 1000,
        start: times.clone().copied().min().unwrap_or(0) - 1000 * NANOSECOND,
        end: times.copied().max().unwrap_or(0) + 1000 * NANOSECOND,
        signals: vec![step.clone(), direction.clone()],
    }
}

fn run(step: &Signal, direction: &Signal, planned: &[Planned]) -> Report {
    let capture = capture(step, direction);
    let axis = AxisSignals {
        name: "x",
        step,
        direction,
        planned: Some(planned),
    };
    check(&capture, &[axis], None, &RULES)
}

fn kinds(report: &Report) -> Vec<FaultKind> {
    let faults = report.axes.iter().flat_map(|axis| &axis.faults);
    faults.map(|fault| fault.kind).collect()
}

/// Segments that a drive with these rules accepts.
fn segments() -> impl Strategy<Value = Vec<Planned>> {
    let one = (
        1_i16..60,
        any::<bool>(),
        60_u32..200,
        80_u32..180,
        -1_i32..=1,
    );
    proptest::collection::vec(one, 2..30).prop_map(|drawn| {
        let segment = |(count, up, delay, interval, ramp): (i16, bool, u32, u32, i32)| {
            let interval = if ramp < 0 { interval + 60 } else { interval };
            StepSegment {
                count: if up { count } else { -count },
                delay,
                interval,
                ramp,
            }
        };
        let numbered = drawn.into_iter().zip(3..);
        numbered
            .map(|(drawn, period)| Planned {
                period,
                segment: segment(drawn),
            })
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn lines_by_the_formula_have_no_fault(planned in segments(), offset in 0_i64..1 << 40) {
        let (step, direction) = lines(&planned, offset);
        let report = run(&step, &direction, &planned);
        prop_assert_eq!(kinds(&report), []);
        prop_assert_eq!(report.offset.map(|found| (found - offset).abs() <= 2), Some(true));
        let pulses: u64 = planned.iter().map(|plan| u64::from(plan.segment.count.unsigned_abs())).sum();
        prop_assert_eq!(report.compared(), 2 * pulses);
        let count: i64 = planned.iter().map(|plan| i64::from(plan.segment.count)).sum();
        prop_assert_eq!((report.axes[0].count, report.axes[0].commanded), (count, Some(count)));
    }

    #[test]
    fn an_edge_one_tick_off_is_found(planned in segments(), which: prop::sample::Index, late: bool) {
        let (mut step, direction) = lines(&planned, 0);
        let at = which.index(step.changes.len());
        step.changes[at] += if late { 13_333_333 } else { -13_333_333 };
        let report = run(&step, &direction, &planned);
        let displaced = kinds(&report).iter().filter(|kind| **kind == FaultKind::Displaced).count();
        prop_assert_eq!(displaced, 1, "{:?}", report);
    }

    #[test]
    fn a_lost_pulse_is_found(planned in segments(), which: prop::sample::Index) {
        let (mut step, direction) = lines(&planned, 0);
        let at = which.index(step.changes.len() / 2) * 2;
        step.changes.drain(at..at + 2);
        let report = run(&step, &direction, &planned);
        prop_assume!(!step.changes.is_empty());
        // The first and the last pulse lie outside of a capture that ends at the others.
        prop_assume!(at != 0 && at != step.changes.len());
        prop_assert_eq!(kinds(&report), [FaultKind::Missing]);
        prop_assert!(report.axes[0].commanded != Some(report.axes[0].count));
    }

    #[test]
    fn a_pulse_too_many_is_found(planned in segments(), which: prop::sample::Index) {
        let (mut step, direction) = lines(&planned, 0);
        // Free time before each period's first pulse.
        let plan = planned[which.index(planned.len() - 1) + 1];
        let at = time(plan.period as i64 * 15_000 - 150);
        let place = step.changes.partition_point(|change| *change < at);
        step.changes.splice(place..place, [at, at + time(WIDTH)]);
        let report = run(&step, &direction, &planned);
        prop_assert!(kinds(&report).contains(&FaultKind::Extra), "{:?}", report);
    }

    #[test]
    fn a_capture_that_begins_in_the_motion_is_aligned(planned in segments(), from in 1_usize..8) {
        let (mut step, mut direction) = lines(&planned, 12_345);
        let cut = step.changes.len().min(2 * from * 7);
        prop_assume!(step.changes.len() - cut > 100);
        step.changes.drain(..cut);
        let first = step.changes[0] - 1;
        direction.initial = direction.changes_until(first) % 2 == 1;
        let passed = direction.changes_until(first);
        direction.changes.drain(..passed);
        let report = run(&step, &direction, &planned);
        prop_assert_eq!(report.offset, Some(12_345), "{:?}", report);
    }
}

fn steady() -> Vec<Planned> {
    let segment = |count| StepSegment {
        count,
        delay: 100,
        interval: 150,
        ramp: 0,
    };
    [20, 20, -20, -20, 20]
        .into_iter()
        .zip(1..)
        .map(|(count, period)| Planned {
            period,
            segment: segment(count),
        })
        .collect()
}

#[test]
fn each_rule_of_the_data_sheet_is_checked() {
    let planned = steady();
    let (step, direction) = lines(&planned, 0);
    assert_eq!(kinds(&run(&step, &direction, &planned)), []);
    // Without the commanded width only the data sheet counts.
    let rules = Rules {
        exact_width: None,
        ..RULES
    };
    let broken = |step: &Signal, direction: &Signal| {
        let capture = capture(step, direction);
        let axis = AxisSignals {
            name: "x",
            step,
            direction,
            planned: Some(&planned),
        };
        kinds(&check(&capture, &[axis], None, &rules))
    };
    let mut narrow = step.clone();
    narrow.changes[7] -= NANOSECOND;
    assert_eq!(broken(&narrow, &direction), [FaultKind::Narrow]);

    let mut wide = step.clone();
    wide.changes[7] = wide.changes[8] - 99 * NANOSECOND;
    assert_eq!(broken(&wide, &direction), [FaultKind::ShortPause]);

    // The change to period 3 is moved to just before its first pulse, then into the pulse.
    let mut late = direction.clone();
    late.changes[1] = time(3 * 15_000 + 100) - 199 * NANOSECOND;
    assert_eq!(broken(&step, &late), [FaultKind::Setup]);
    late.changes[1] = time(3 * 15_000 + 101);
    assert_eq!(
        broken(&step, &late)[..2],
        [FaultKind::WrongDirection, FaultKind::Hold]
    );

    // The change after period 2 is moved to just after its last pulse.
    let mut early = direction.clone();
    early.changes[1] = step.changes[79] + 99 * NANOSECOND;
    assert_eq!(broken(&step, &early), [FaultKind::Hold]);
}

#[test]
fn pulses_of_disabled_drives_are_found() {
    let planned = steady();
    let (step, direction) = lines(&planned, 0);
    let enable = Signal {
        name: "enable".into(),
        initial: true,
        changes: vec![step.changes[190]],
    };
    let axis = AxisSignals {
        name: "x",
        step: &step,
        direction: &direction,
        planned: Some(&planned),
    };
    let capture = capture(&step, &direction);
    let report = check(&capture, &[axis], Some(&enable), &RULES);
    assert_eq!(kinds(&report), [FaultKind::Disabled; 5]);
}

const VCD: &str = "\
$timescale 1 ns $end
$scope module board $end
$var wire 1 ! x_step $end
$var wire 1 \" x_dir $end
$var wire 8 # bus $end
$upscope $end
$enddefinitions $end
#0
0!
x\"
b00000000 #
#5
1\"
#10
1!
#15
1!
#20
0!
#30
";

#[test]
fn a_vcd_file_is_read() {
    let capture = Capture::read_vcd(VCD.as_bytes()).unwrap();
    assert_eq!(capture.names(), "board.x_step, board.x_dir");
    assert_eq!((capture.start, capture.end), (0, 30 * NANOSECOND));
    let step = capture.find("x_step").unwrap();
    assert_eq!(step.changes, [10 * NANOSECOND, 20 * NANOSECOND]);
    // Unknown at the start is no change.
    let direction = capture.find("board.x_dir").unwrap();
    assert_eq!((direction.initial, direction.changes.len()), (true, 0));
    let error = capture.find("y_step").unwrap_err();
    assert!(error.contains("board.x_step"), "{error}");
}

#[test]
fn a_bad_vcd_file_is_refused_with_its_line() {
    for (from, to, part) in [
        ("#20", "#9", "line 18: the time is before"),
        ("1!\n#15", "x!\n#15", "line 15: the level of 'board.x_step'"),
        ("$timescale 1 ns $end\n", "", "no $timescale"),
        (
            "$timescale 1 ns $end\n",
            "$timescale 0 ns $end\n",
            "no $timescale",
        ),
        ("#30", "#99999999999999999", "beyond 2.5 hours"),
        ("#10", "%", "line 14"),
        ("$var wire 1", "$var wire 4", "no line of one bit"),
    ] {
        let text = VCD.replace(from, to);
        assert_ne!(text, VCD);
        let error = Capture::read_vcd(text.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    assert!(Capture::read_vcd(&b"\x7fELF"[..]).is_err());
    assert!(Capture::read_vcd(&b""[..]).is_err());
}

#[test]
fn a_picture_shows_each_change() {
    let (step, direction) = lines(&steady(), 0);
    let marks = vec![vec![step.changes[0]]];
    let (from, to) = (time(15_000), time(16_000));
    let svg = picture(&[&step, &direction], &marks, from, to).unwrap();
    let inside = step.changes.iter().filter(|at| (from..=to).contains(*at));
    let line = svg.lines().find(|line| line.starts_with("<path")).unwrap();
    assert_eq!(line.matches('V').count(), inside.count());
    assert!(svg.contains("x_step") && svg.ends_with("</svg>\n"));
    assert!(picture(&[&step], &[], to, from).is_err());
    let many = Signal {
        changes: (0..10_000).collect(),
        ..Signal::default()
    };
    let error = picture(&[&many], &[], 0, 10_000).unwrap_err();
    assert!(error.contains("shorter"), "{error}");
}
