//! The planner as a stream: the same motion as a plan, in bounded memory.

use crate::h4::{H4, HOME, settings};
use crate::spans::{spans_of, unit};
use haptimill_gcode::{Interpreter, Options, Program, Step, read};
use haptimill_planner::{CheckError, Plan, Planned, Planner, SharedTrack, check};
use std::io::Cursor;

/// A spiral of short blocks, with a dwell and a spindle command on the way.
fn spiral(blocks: u32) -> String {
    let mut text = String::from("G0 X0 Y0 Z25 G64 Q0\nM3 S1000\nG1 F900\n");
    for k in 0..blocks {
        let angle = f64::from(k) * 0.01;
        let radius = 5.0 + 30.0 * f64::from(k) / f64::from(blocks);
        text += &format!(
            "X{:.4} Y{:.4}\n",
            radius * angle.cos(),
            radius * angle.sin()
        );
        if k == blocks / 3 {
            text += "G4 P0.5\nM3 S2000\n";
        }
    }
    text
}

fn program(text: &str) -> Program {
    read(
        "test.ngc",
        text.as_bytes(),
        &Options::of_letters("XYZBA", HOME),
    )
    .expect("readable")
}

/// Setpoints of a stream, and the most that waited at once.
fn stream(program: &Program) -> (Vec<Planned>, usize) {
    let mut planner = Planner::new(program.start, settings(), H4);
    let (mut made, mut max) = (Vec::new(), 0);
    let mut take = |planner: &mut Planner<H4>| {
        let before = made.len();
        made.extend(planner.made());
        max = max.max(made.len() - before);
    };
    planner.check_start().expect("the start is reachable");
    for step in &program.steps {
        planner.step(step).expect("possible");
        take(&mut planner);
    }
    planner.finish(program.lines).expect("possible");
    take(&mut planner);
    (made, max)
}

fn setpoints(made: &[Planned]) -> Vec<haptimill_protocol::setpoint::Setpoint> {
    made.iter()
        .map(|planned| planned.setpoint.clone())
        .collect()
}

/// A program within the first look-ahead has the same bits as a plan.
#[test]
fn a_short_stream_is_the_plan() {
    let program = program(&spiral(200));
    let plan = Plan::new(&program, &settings(), &H4).expect("plannable");
    let (made, _) = stream(&program);
    assert_eq!(setpoints(&made), plan.setpoints);
    for (index, planned) in made.iter().enumerate() {
        assert_eq!(planned.place, plan.place_of(index));
    }
}

/// Across the ends of the look-ahead the limits hold, and nothing is lost or waits.
#[test]
fn a_long_stream_keeps_the_limits() {
    let blocks = 40_000;
    let program = program(&spiral(blocks));
    let plan = Plan::new(&program, &settings(), &H4).expect("plannable");
    let (made, max) = stream(&program);
    let settings = settings();
    let made = setpoints(&made);
    for (number, span) in spans_of(&plan.start, &made, plan.period_s)
        .iter()
        .enumerate()
    {
        for (k, (cubic, axis)) in span.axes.iter().zip(&settings.pose).enumerate() {
            let t = cubic.t;
            // Half a unit at each end: of the pose, and of the rate (256 units).
            let (step, rate) = (unit(k), 128.0 * unit(k));
            let rounding = 12.0 * step / (t * t * t) + 12.0 * rate / (t * t);
            assert!(cubic.peak_rate() <= axis.rate + rate + step / t);
            let [a, b] = cubic.acceleration();
            let largest = axis.acceleration + 6.0 * step / (t * t) + 6.0 * rate / t;
            assert!(
                a.abs().max(b.abs()) <= largest,
                "acceleration of {k} in {number}"
            );
            assert!(
                cubic.jerk().abs() <= axis.jerk + rounding,
                "jerk of {k} in {number}"
            );
        }
    }
    let last = made.last().expect("a setpoint");
    assert_eq!(last, plan.setpoints.last().expect("a setpoint"));
    assert!(last.rates.iter().all(|rate| *rate == 0));
    let actions = |all: &[haptimill_protocol::setpoint::Setpoint]| {
        let is_action = |setpoint: &&haptimill_protocol::setpoint::Setpoint| {
            setpoint.action != haptimill_protocol::message::Action::None
        };
        all.iter().filter(is_action).count()
    };
    assert_eq!(actions(&made), actions(&plan.setpoints));
    // A shorter look-ahead at the start costs little time.
    let time = |all: &[haptimill_protocol::setpoint::Setpoint]| {
        all.iter().map(|it| f64::from(it.periods)).sum::<f64>() * plan.period_s
    };
    assert!((time(&made) / time(&plan.setpoints) - 1.0).abs() < 0.002);
    assert!(
        max < made.len() / 3,
        "{max} of {} setpoints waited",
        made.len()
    );
}

/// The track of a stream has the programmed poses and places of the plan, and forgets what is
/// passed.
#[test]
fn the_track_is_that_of_the_plan() {
    let program = program(&spiral(200));
    let plan = Plan::new(&program, &settings(), &H4).expect("plannable");
    let mut planner = Planner::new(program.start, settings(), H4);
    let track = SharedTrack::new(u32::from(settings().period_us));
    planner.follow(&track);
    let (mut cursor, mut setpoint, mut periods) = (haptimill_planner::Cursor::default(), 0, 0u64);
    let mut compared = 0;
    let mut follow = |planner: &mut Planner<H4>| {
        for planned in planner.made() {
            periods += u64::from(planned.setpoint.periods);
            let time_s = periods as f64 * plan.period_s;
            let mut track = track.lock();
            let (at, expected) = (
                track.programmed(time_s),
                plan.programmed(&mut cursor, time_s),
            );
            assert_eq!(at, expected, "setpoint {setpoint}");
            assert_eq!(track.place_of(setpoint), plan.place_of(setpoint as usize));
            track.discard(setpoint, time_s);
            setpoint += 1;
            compared += 1;
        }
    };
    for step in &program.steps {
        planner.step(step).expect("possible");
        follow(&mut planner);
    }
    planner.finish(program.lines).expect("possible");
    follow(&mut planner);
    assert_eq!(compared, plan.setpoints.len());
}

/// Where steps come late, the motion ends at standstill at the last one, within the limits, and
/// goes on from there.
#[test]
fn late_steps_end_at_standstill() {
    let program = program(&spiral(900));
    let settings = settings();
    let mut planner = Planner::new(program.start, settings.clone(), H4);
    let mut made = Vec::new();
    let mut stops = 0;
    for (number, step) in program.steps.iter().enumerate() {
        planner.step(step).expect("possible");
        made.extend(planner.made());
        match number % 90 {
            30 | 31 => planner.hurry(false).expect("possible"),
            60 => {
                planner.hurry(true).expect("possible");
                made.extend(planner.made());
                let last: &Planned = made.last().expect("a setpoint");
                assert!(
                    last.setpoint.rates.iter().all(|rate| *rate == 0),
                    "{number}"
                );
                assert_eq!(last.place.line, step.place().line);
                stops += 1;
            }
            _ => {}
        }
    }
    planner.finish(program.lines).expect("possible");
    made.extend(planner.made());
    assert!(stops > 5);
    let plan = Plan::new(&program, &settings, &H4).expect("plannable");
    let made = setpoints(&made);
    assert_eq!(
        made.last().map(|it| &it.pose),
        plan.setpoints.last().map(|it| &it.pose)
    );
    let actions = |all: &[haptimill_protocol::setpoint::Setpoint]| -> Vec<_> {
        let action = |it: &haptimill_protocol::setpoint::Setpoint| it.action;
        let spindle = |it: &haptimill_protocol::message::Action| {
            matches!(it, haptimill_protocol::message::Action::Spindle(_))
        };
        all.iter().map(action).filter(spindle).collect()
    };
    assert_eq!(actions(&made), actions(&plan.setpoints));
    for (number, span) in spans_of(&plan.start, &made, plan.period_s)
        .iter()
        .enumerate()
    {
        for (k, (cubic, axis)) in span.axes.iter().zip(&settings.pose).enumerate() {
            let t = cubic.t;
            let (step, rate) = (unit(k), 128.0 * unit(k));
            let [a, b] = cubic.acceleration();
            let largest = axis.acceleration + 6.0 * step / (t * t) + 6.0 * rate / t;
            assert!(
                a.abs().max(b.abs()) <= largest,
                "acceleration of {k} in {number}"
            );
            let rounding = 12.0 * step / (t * t * t) + 12.0 * rate / (t * t);
            assert!(
                cubic.jerk().abs() <= axis.jerk + rounding,
                "jerk of {k} in {number}"
            );
        }
    }
}

/// A check has the figures of the plan, and sees every step.
#[test]
fn a_check_has_the_figures_of_the_plan() {
    let text = spiral(20_000);
    let program = program(&text);
    let plan = Plan::new(&program, &settings(), &H4).expect("plannable");
    let options = Options::of_letters("XYZBA", HOME);
    let mut interpreter = Interpreter::new(Cursor::new(text.as_bytes()), &options);
    let mut moves = 0;
    let figures = check("t", &mut interpreter, HOME, &settings(), &H4, |step| {
        moves += usize::from(matches!(step, Step::Move(_)));
    })
    .expect("possible");
    assert_eq!(figures.blocks, plan.figures.blocks);
    assert_eq!(moves, figures.blocks);
    assert_eq!(figures.path_length_mm, plan.figures.path_length_mm);
    assert!((figures.duration_s - plan.figures.duration_s).abs() < 1e-9);
    assert_eq!(figures.setpoints, 0);
}

/// A check plans a probe move to its programmed end, from and to standstill. A plan refuses it: as
/// a plain move the tool would go through the part.
#[test]
fn a_check_plans_probe_moves_to_their_ends() {
    let seconds = |text: &str| {
        let options = Options {
            outputs: true,
            ..Options::of_letters("XYZBA", HOME)
        };
        let mut interpreter = Interpreter::new(Cursor::new(text.as_bytes()), &options);
        check("t", &mut interpreter, HOME, &settings(), &H4, |_| {}).map(|it| it.duration_s)
    };
    let probed = seconds("G0 X5\nG38.2 X10 F120\nM66 P0 L3 Q1\nG0 X0\n").expect("possible");
    let stopped = seconds("G61\nG0 X5\nG1 X10 F120\nG0 X0\n").expect("possible");
    // Each standstill ends with a whole control period of 0.2 ms.
    assert!((probed - stopped).abs() < 5e-4, "{probed} for {stopped}");
    let CheckError::Impossible(refused) = seconds("G38.2 X999 F120\n").expect_err("outside") else {
        panic!("readable");
    };
    assert_eq!(refused.problems[0].place.line, 1);
    let refused = Plan::new(&program("G38.2 X10 F120"), &settings(), &H4).expect_err("no probe");
    assert!(refused.to_string().contains("no probe moves"), "{refused}");
}

/// Problems of reading come before those of the machine; each has its line.
#[test]
fn a_check_reports_problems_of_reading_first() {
    let problems = |text: &str| {
        let options = Options::of_letters("XYZBA", HOME);
        let mut interpreter = Interpreter::new(Cursor::new(text.as_bytes()), &options);
        check("t", &mut interpreter, HOME, &settings(), &H4, |_| {}).expect_err("refused")
    };
    let CheckError::Impossible(refused) = problems("G0 X1000\nX0\nG1 X1 F600\nX-999\n") else {
        panic!("readable");
    };
    let lines = refused.problems.iter().map(|it| it.place.line);
    assert_eq!(lines.collect::<Vec<_>>(), [1, 4]);
    let CheckError::Unreadable(refused) = problems("G0 X1000\nG7777\n") else {
        panic!("unreadable");
    };
    assert_eq!(refused.problems.len(), 1);
    assert_eq!(refused.problems[0].place.line, 2);
}

/// A message is due in the motion after it, also in a loop whose passes have the same places, and
/// the last one at the end.
#[test]
fn messages_are_due_before_their_motion() {
    let text = "G21 G90 F600\n(MSG, first)\nG1 X1\n#1=0\nO1 WHILE [#1 LT 3]\n#1=[#1+1]\n\
                (PRINT, pass #1)\nG91 G1 X4\nO1 ENDWHILE\nG4 P0.1\n(MSG, dwelt)\nG90 G1 X0\n\
                (MSG, end)\nM30\n";
    let program = program(text);
    let plan = Plan::new(&program, &settings(), &H4).expect("plannable");
    let mm = settings().pose[0].units;
    // Positions of x between which the machine moves while a message is due.
    let x = |pose: &[i32]| f64::from(pose[0]) / mm;
    let span_of = |setpoint: usize| match setpoint.checked_sub(1) {
        Some(before) => [before, setpoint].map(|index| x(&plan.setpoints[index].pose)),
        None => [x(&plan.start), x(&plan.setpoints[0].pose)],
    };
    let due: Vec<(&str, [f64; 2])> = plan
        .messages()
        .iter()
        .map(|(setpoint, text)| (text.as_str(), span_of(*setpoint as usize)))
        .collect();
    let expected = [
        ("first", 0.0),
        ("pass 1", 1.0),
        ("pass 2", 5.0),
        ("pass 3", 9.0),
        ("dwelt", 13.0),
    ];
    let (last, others) = due.split_last().expect("messages");
    // A setpoint at a corner may be a period late: 0.002 mm at this feed.
    for ((text, [from, to]), (name, at)) in others.iter().zip(expected) {
        assert_eq!(*text, name);
        assert!(
            from.min(*to) < at + 0.002 && from.max(*to) > at - 0.002,
            "{text} from {from} to {to}, not at {at}"
        );
    }
    assert_eq!((others.len(), last.0), (expected.len(), "end"));
    assert_eq!(plan.messages()[5].0 as usize, plan.setpoints.len() - 1);
    // A stream has them at the same setpoints.
    let mut planner = Planner::new(program.start, settings(), H4);
    let track = SharedTrack::new(u32::from(settings().period_us));
    planner.follow(&track);
    let (mut streamed, mut number) = (Vec::new(), 0);
    let mut take = |planner: &mut Planner<H4>| {
        for _ in planner.made() {
            let message = || track.lock().take_message(number);
            streamed.extend(std::iter::from_fn(message).map(|text| (number, text)));
            number += 1;
        }
    };
    for step in &program.steps {
        planner.step(step).expect("possible");
        take(&mut planner);
    }
    planner.finish(program.lines).expect("possible");
    take(&mut planner);
    assert_eq!(streamed, plan.messages());
}

/// Joined blocks (G64 Q) have the same motion in a plan, a stream and a check, with messages
/// between them as well; late steps end at the last block.
#[test]
fn joined_blocks_are_the_same_in_plan_stream_and_check() {
    let text = spiral(900).replace("G1 F900\n", "G64 P0.003 Q0.002\nG1 F900\n");
    let text: String = text
        .lines()
        .enumerate()
        .map(|(number, line)| match number % 70 {
            69 => format!("{line} (MSG, line {number})\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    let program = program(&text);
    let plan = Plan::new(&program, &settings(), &H4).expect("plannable");
    let apart = text.replace("Q0.002", "Q0");
    let apart = Plan::new(&self::program(&apart), &settings(), &H4).expect("plannable");
    assert!(
        plan.setpoints.len() < apart.setpoints.len() / 2,
        "nothing is joined"
    );
    let (made, _) = stream(&program);
    assert_eq!(setpoints(&made).last(), plan.setpoints.last());
    let options = Options::of_letters("XYZBA", HOME);
    let mut interpreter = Interpreter::new(Cursor::new(text.as_bytes()), &options);
    let figures = check("t", &mut interpreter, HOME, &settings(), &H4, |_| {}).expect("possible");
    assert_eq!(figures.blocks, plan.figures.blocks);
    assert!((figures.duration_s - plan.figures.duration_s).abs() < 1e-9);
    let seconds = made
        .iter()
        .map(|it| f64::from(it.setpoint.periods) * plan.period_s);
    assert!((seconds.sum::<f64>() / plan.figures.duration_s - 1.0).abs() < 0.01);
    // Every block so far is done where the next one is late.
    let mut planner = Planner::new(program.start, settings(), H4);
    let mut last = None;
    for (number, step) in program.steps.iter().enumerate() {
        planner.step(step).expect("possible");
        if number % 90 == 60 {
            planner.hurry(true).expect("possible");
        }
        last = planner.made().next_back().or(last);
        if let (60, Step::Move(step)) = (number % 90, step) {
            let pose = &last.as_ref().expect("a setpoint").setpoint.pose;
            for k in 0..3 {
                let off = f64::from(pose[k]) * unit(k) - step.path.to[k];
                assert!(off.abs() < 1e-6, "block {number} ends {off} mm off");
            }
        }
    }
}

/// A block that cannot be done is named by its own place where others are joined to it, and the
/// motion ends at standstill within the limits of the machine.
#[test]
fn an_impossible_block_among_joined_ones_has_its_place() {
    let mut text = String::from("G0 X148 Y0 Z25\nG64 Q0.002\nG1 F900\n");
    for block in 1..=60 {
        text += &format!("X{:.2}\n", 148.0 + 0.05 * f64::from(block));
    }
    let program = program(&text);
    let mut planner = Planner::new(program.start, settings(), H4);
    let mut problems = Vec::new();
    for step in &program.steps {
        problems.extend(planner.step(step).err());
    }
    problems.extend(planner.finish(program.lines).err());
    // X150.05 is beyond the soft limit of 150 mm.
    assert_eq!(
        problems.first().map(|it| it.place.line),
        Some(3 + 41),
        "{problems:?}"
    );
    let made: Vec<Planned> = planner.made().collect();
    let last = &made.last().expect("the motion before it").setpoint;
    assert!(last.rates.iter().all(|rate| *rate == 0));
    let x = f64::from(last.pose[0]) * unit(0);
    assert!(x <= 150.0 && x > 147.9, "{x}");
}
