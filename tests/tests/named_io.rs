//! Named inputs and outputs on the simulated machine: probing, feed hold, door, outputs.

mod setup;

use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::named_io::config::{ContactReaction, InputFunction};
use haptimill_hil_sim::contact::InputCondition;
use haptimill_hil_sim::rig::RigOptions;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{
    Action, AxisValues, Command, Event, Fault, InputProblem, OutputProblem, Refusal, State,
};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::Bench;
use setup::{MM, line, state};

const MILL: &str = include_str!("../../machines/mill3-servo.toml");

/// Indices of the inputs in the machine file.
const PROBE: usize = 0;
const FEED_HOLD: usize = 2;
const DOOR: usize = 3;

/// Indices of the outputs.
const COOLANT: u8 = 0;
const CLAMP: u8 = 2;
const REVERSE: u8 = 3;
const LIGHT: u8 = 4;

/// Bound of the latched position against the true one, mm: the backlash that the controller assumes
/// (0.008) and that of the machine (0.005), the wind-up of the screw under friction (0.004), and
/// counts of 0.000625. The travel of a period is added to it.
const LATCH_BOUND: f64 = 0.018;

/// Returns the homed mill above its probe block: the top is at z = 0, the tool `height` above it.
fn above_block(edit: impl FnOnce(&mut MachineFile), height: f64) -> Bench {
    let mut machine = MachineFile::parse("mill3-servo.toml", MILL).expect("sound");
    edit(&mut machine);
    let period_us = machine.config.period_us;
    let options = RigOptions::default();
    let mut bench = Bench::of_machine(machine, &options, Controller::new(period_us));
    bench.make_ready();
    bench.steps(500);
    go(&mut bench, 0, 120.0);
    go(&mut bench, 1, 80.0);
    go(&mut bench, 2, height);
    bench.events.clear();
    bench
}

/// Moves one coordinate to a position, at up to 20 mm/s.
fn go(bench: &mut Bench, axis: usize, to: f64) {
    let start = bench.status().commanded;
    let way = to - f64::from(start[axis]) / MM;
    let spans = (way.abs() / 2.0).ceil() as usize;
    let speed = way / (0.1 * (spans + 1) as f64);
    bench.start_job(90, &line(&start, axis, speed, spans));
    assert!(bench.wait_for(State::Idle, 60_000));
}

fn down(bench: &mut Bench, speed: f64, spans: usize) -> Vec<Setpoint> {
    let start = bench.status().commanded;
    line(&start, 2, -speed, spans)
}

fn outputs(bench: &Bench) -> u32 {
    bench.rig.outputs().digital
}

fn is_on(bench: &Bench, output: u8) -> bool {
    let controller = bench.rig.control();
    controller.machine().expect("configured").io.outputs() >> output & 1 != 0
}

fn force(bench: &mut Bench, input: usize, level: Option<bool>) {
    let condition = InputCondition {
        level,
        bounce_hz: 0.0,
    };
    bench
        .rig
        .plant_mut()
        .inputs_mut()
        .set_condition(input, condition);
}

/// The latched coordinates of the newest contact: measured and commanded.
fn latched(bench: &Bench, axis: u8) -> Option<(f64, f64)> {
    bench.events.iter().find_map(|event| match event {
        Event::ProbedAt {
            axis: of,
            measured,
            commanded,
            ..
        } if *of == axis => Some((f64::from(*measured) / MM, f64::from(*commanded) / MM)),
        _ => None,
    })
}

/// A probing job stops on its path; the latched position is that of the plant at the contact,
/// within the stated bound, at every speed.
#[test]
fn a_probing_job_latches_the_position_of_the_contact() {
    for (height, speed) in [(3.0, 0.5), (5.3, 2.0), (8.7, 10.0), (12.1, 30.0)] {
        let mut bench = above_block(|_| (), height);
        let spans = (20.0 / speed * 10.0) as usize;
        let setpoints: Vec<_> = down(&mut bench, speed, spans.min(200));
        let arm = Command::ArmProbe {
            input: PROBE as u8,
            active: true,
        };
        assert_eq!(bench.ask(arm), Ok(()));
        bench.start_job(7, &setpoints);
        let mut truth = None;
        for _ in 0..200_000 {
            let contact = bench.rig.plant().inputs().has_contact(PROBE);
            bench.step();
            if contact && truth.is_none() {
                truth = Some((bench.rig.inputs().period, bench.rig.truth().pose[2]));
            }
            if state(&bench) == State::Idle {
                break;
            }
        }
        bench.steps(200);
        let (period, true_z) = truth.expect("a contact");
        let (measured, commanded) = latched(&bench, 2).expect("latched");
        let travel = speed * 200e-6;
        let error = (measured - true_z).abs();
        println!("{speed} mm/s: latched {measured:.4}, true {true_z:.4}, commanded {commanded:.4}");
        assert!(error <= LATCH_BOUND, "{speed} mm/s: {measured} of {true_z}");
        assert!(
            measured.abs() <= LATCH_BOUND + travel,
            "{speed} mm/s: {measured}"
        );
        assert!((commanded - measured).abs() < 0.1, "{commanded} {measured}");
        let probed = bench.events.iter().find_map(|event| match event {
            Event::Probed {
                input,
                period,
                is_measured,
            } => Some((*input, *period, *is_measured)),
            _ => None,
        });
        assert_eq!(probed, Some((PROBE as u8, period, true)));
        // The stop takes 300 ms from the programmed speed.
        let rest = bench.rig.truth().pose[2];
        assert!(
            rest < true_z && rest > true_z - 0.3 * speed - 0.02,
            "{rest}"
        );
        assert_eq!(state(&bench), State::Idle);
        assert!(bench.rig.control().safety().position_kept());
        let dropped = |event: &Event| matches!(event, Event::JobDropped { job: 7, .. });
        assert!(bench.events.iter().any(dropped), "{:?}", bench.events);
        assert!(
            !bench
                .events
                .contains(&Event::NoContact { input: PROBE as u8 })
        );
    }
}

/// The filter delays the stop, not the latched position; a bounce is no contact.
#[test]
fn the_latch_does_not_wait_for_the_filter() {
    let mut bench = above_block(|machine| machine.config.io.inputs[PROBE].filter = 100, 2.0);
    let setpoints = down(&mut bench, 5.0, 10);
    let arm = Command::ArmProbe {
        input: PROBE as u8,
        active: true,
    };
    assert_eq!(bench.ask(arm), Ok(()));
    bench.start_job(7, &setpoints);
    bench.steps(300);
    // 10 ms of contact are less than the filter of 20 ms.
    force(&mut bench, PROBE, Some(true));
    bench.steps(50);
    force(&mut bench, PROBE, None);
    assert!(bench.wait_for(State::Idle, 20_000));
    let (measured, _) = latched(&bench, 2).expect("latched");
    assert!(measured.abs() <= LATCH_BOUND + 5.0 * 200e-6, "{measured}");
}

#[test]
fn probing_is_refused_missed_and_ended() {
    let mut bench = above_block(|_| (), 3.0);
    let arm = |input| Command::ArmProbe {
        input,
        active: true,
    };
    let input = PROBE as u8;
    assert_eq!(
        bench.ask(arm(FEED_HOLD as u8)),
        Err(Refusal::NoProbe { input: 2 })
    );
    assert_eq!(bench.ask(arm(15)), Err(Refusal::NoProbe { input: 15 }));
    // No contact before the end of the move.
    assert_eq!(bench.ask(arm(input)), Ok(()));
    let setpoints = down(&mut bench, 5.0, 2);
    bench.start_job(1, &setpoints);
    assert!(bench.wait_for(State::Idle, 10_000));
    assert!(bench.events.contains(&Event::NoContact { input }));
    assert!(latched(&bench, 2).is_none());
    // The probe has its contact already.
    force(&mut bench, PROBE, Some(true));
    bench.steps(10);
    let refused = Err(Refusal::Input(InputProblem::ProbeContact { input }));
    assert_eq!(bench.ask(arm(input)), refused);
    force(&mut bench, PROBE, None);
    bench.steps(10);
    // It gets its contact between the command and the motion.
    assert_eq!(bench.ask(arm(input)), Ok(()));
    force(&mut bench, PROBE, Some(true));
    bench.steps(10);
    let setpoints = down(&mut bench, 1.0, 2);
    assert_eq!(bench.try_job(2, &setpoints), refused);
    force(&mut bench, PROBE, None);
    // Drives off disarm it: the next contact was not asked for.
    assert_eq!(bench.ask(Command::Disable), Ok(()));
    assert_eq!(bench.ask(Command::Enable), Ok(()));
    let setpoints = down(&mut bench, 5.0, 20);
    bench.start_job(3, &setpoints);
    assert!(bench.wait_for(State::Fault, 20_000));
    let fault = bench.rig.control().safety().fault();
    assert_eq!(fault, Some(Fault::ProbeContact { input }));
}

/// A probing jog stops at the contact, and its epoch has ended.
#[test]
fn a_jog_probes_too() {
    let mut bench = above_block(|_| (), 1.5);
    let input = PROBE as u8;
    let arm = Command::ArmProbe {
        input,
        active: true,
    };
    assert_eq!(bench.ask(arm), Ok(()));
    let rates: AxisValues = [0, 0, (-4.0 * 4096.0) as i32].into_iter().collect();
    let mut refused = None;
    for _ in 0..60 {
        let jog = Command::Jog {
            epoch: 1,
            deadline_ms: 300,
            rates: rates.clone(),
        };
        if let Err(refusal) = bench.ask(jog) {
            refused = Some(refusal);
            break;
        }
        bench.steps(200);
    }
    assert!(
        matches!(refused, Some(Refusal::OldEpoch | Refusal::State(_))),
        "{refused:?}"
    );
    assert!(bench.wait_for(State::Idle, 5000));
    let (measured, _) = latched(&bench, 2).expect("latched");
    assert!(measured.abs() <= LATCH_BOUND + 4.0 * 200e-6, "{measured}");
}

/// A contact that was not asked for: a controlled fault with drives that hold, or a warning.
#[test]
fn unasked_contacts_are_a_fault_or_a_warning() {
    let input = PROBE as u8;
    let mut bench = above_block(|_| (), 3.0);
    let setpoints = down(&mut bench, 5.0, 20);
    bench.start_job(3, &setpoints);
    assert!(bench.wait_for(State::Fault, 20_000));
    let safety = bench.rig.control().safety();
    assert_eq!(safety.fault(), Some(Fault::ProbeContact { input }));
    assert!(safety.position_kept() && safety.drives_on());
    assert_eq!(bench.ask(Command::Reset), Ok(()));
    // The way off is free: only a new contact counts.
    go(&mut bench, 2, 3.0);

    let warn = |machine: &mut MachineFile| {
        machine.config.io.inputs[PROBE].function = InputFunction::Probe(ContactReaction::Warning);
    };
    let mut bench = above_block(warn, 3.0);
    let setpoints = down(&mut bench, 5.0, 8);
    bench.start_job(3, &setpoints);
    assert!(bench.wait_for(State::Idle, 20_000));
    assert!(bench.events.contains(&Event::ProbeContact { input }));
    let done = |event: &Event| matches!(event, Event::JobDone { job: 3, .. });
    assert!(bench.events.iter().any(done));
}

#[test]
fn a_feed_hold_holds_the_job_until_resume() {
    let mut bench = above_block(|_| (), 60.0);
    let input = FEED_HOLD as u8;
    let setpoints = down(&mut bench, 5.0, 10);
    bench.start_job(4, &setpoints);
    bench.steps(1500);
    force(&mut bench, FEED_HOLD, Some(true));
    bench.steps(11 + 1500 + 50);
    assert_eq!(state(&bench), State::Hold);
    assert!(bench.events.contains(&Event::InputHold { input }));
    let still = bench.status().commanded;
    let refused = Err(Refusal::Input(InputProblem::FeedHold { input }));
    assert_eq!(bench.ask(Command::Resume), refused);
    assert_eq!(bench.status().commanded, still);
    force(&mut bench, FEED_HOLD, None);
    bench.steps(20);
    assert_eq!(
        state(&bench),
        State::Hold,
        "the release alone moves nothing"
    );
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    assert!(bench.wait_for(State::Idle, 20_000));
    let done = |event: &Event| matches!(event, Event::JobDone { job: 4, .. });
    assert!(bench.events.iter().any(done));
}

#[test]
fn an_open_door_stops_motion_and_spindle() {
    let mut bench = above_block(|_| (), 60.0);
    let input = DOOR as u8;
    let mut setpoints = down(&mut bench, 5.0, 10);
    setpoints[0].action = Action::Spindle(-3000);
    bench.start_job(5, &setpoints);
    bench.steps(1500);
    assert_eq!(bench.rig.outputs().spindle_rpm, -3000);
    assert!(is_on(&bench, REVERSE));
    force(&mut bench, DOOR, Some(false));
    bench.steps(12);
    assert_eq!(bench.rig.outputs().spindle_rpm, 0);
    assert!(!is_on(&bench, REVERSE));
    bench.steps(1600);
    assert_eq!(state(&bench), State::Hold);
    let refused = Err(Refusal::Input(InputProblem::DoorOpen { input }));
    assert_eq!(bench.ask(Command::Resume), refused);
    force(&mut bench, DOOR, None);
    bench.steps(50);
    assert_eq!(bench.rig.outputs().spindle_rpm, 0, "closing starts nothing");
    let still = bench.status().commanded;
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    // The spindle has 1500 ms before the motion; a second command does not shorten it.
    bench.steps(3000);
    assert_eq!(bench.rig.outputs().spindle_rpm, -3000);
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    assert_eq!(bench.status().commanded, still);
    assert_eq!(state(&bench), State::Hold);
    assert!(bench.wait_for(State::Idle, 20_000));
    let done = |event: &Event| matches!(event, Event::JobDone { job: 5, .. });
    assert!(bench.events.iter().any(done));

    // Nothing starts while it is open, and a jog and homing stop.
    let rates: AxisValues = [0, 0, 4096].into_iter().collect();
    let jog = |epoch| Command::Jog {
        epoch,
        deadline_ms: 1000,
        rates: rates.clone(),
    };
    assert_eq!(bench.ask(jog(1)), Ok(()));
    bench.steps(100);
    force(&mut bench, DOOR, Some(false));
    bench.steps(2500);
    assert_eq!(state(&bench), State::Idle);
    let setpoints = down(&mut bench, 5.0, 1);
    assert_eq!(bench.try_job(6, &setpoints), refused);
    assert_eq!(bench.ask(jog(2)), refused);
    assert_eq!(bench.ask(Command::Home), refused);
    force(&mut bench, DOOR, None);
    bench.steps(20);
    assert_eq!(bench.ask(Command::Home), Ok(()));
    bench.steps(200);
    force(&mut bench, DOOR, Some(false));
    assert!(bench.wait_for(State::Idle, 5000));
    assert!(!bench.rig.control().safety().homed());
}

/// The door opens while the restarted spindle runs up: the job stays on hold, the spindle stops.
#[test]
fn the_door_may_open_again_during_the_wait_for_the_spindle() {
    let mut bench = above_block(|_| (), 60.0);
    let mut setpoints = down(&mut bench, 5.0, 10);
    setpoints[0].action = Action::Spindle(3000);
    bench.start_job(5, &setpoints);
    bench.steps(1500);
    force(&mut bench, DOOR, Some(false));
    bench.steps(2000);
    force(&mut bench, DOOR, None);
    bench.steps(50);
    assert_eq!(bench.ask(Command::Resume), Ok(()));
    bench.steps(1000);
    force(&mut bench, DOOR, Some(false));
    bench.steps(50);
    force(&mut bench, DOOR, None);
    bench.steps(10_000);
    assert_eq!(state(&bench), State::Hold);
    assert_eq!(bench.rig.outputs().spindle_rpm, 0);
    assert_eq!(bench.ask(Command::Stop), Ok(()));
    assert!(bench.wait_for(State::Idle, 5000));
}

fn set(output: u8, on: bool) -> Command {
    Command::SetOutput { output, on }
}

/// Every output has its safe value in a fault and in an emergency stop, and keeps it after the
/// reset; those with `without_host = "safe"` also while the host is silent.
#[test]
fn outputs_are_safe_in_every_latched_state() {
    let safe = 1 << CLAMP;
    // The clamp is on at level 0.
    let level_safe = 0;
    let prepare = |bench: &mut Bench| {
        for (output, on) in [(COOLANT, true), (CLAMP, false), (LIGHT, true)] {
            assert_eq!(bench.ask(set(output, on)), Ok(()));
        }
        let code = Command::SetAnalogOutput {
            output: 0,
            code: 12_000,
        };
        assert_eq!(bench.ask(code), Ok(()));
        assert_eq!(outputs(bench), 0b1_0101);
        assert_eq!(bench.rig.outputs().analog, [12_000, 0, 0, 0]);
    };
    let check = |bench: &mut Bench, at: &str| {
        assert_eq!(outputs(bench), level_safe, "{at}");
        assert_eq!(bench.rig.outputs().analog, [0; 4], "{at}");
        assert!(bench.events.contains(&Event::OutputsSafe), "{at}");
        assert_eq!(
            bench.status().io.expect("has outputs").outputs,
            safe,
            "{at}"
        );
        let now = state(bench);
        assert_eq!(
            bench.ask(set(LIGHT, true)),
            Err(Refusal::State(now)),
            "{at}"
        );
    };

    let mut bench = above_block(|_| (), 60.0);
    assert_eq!(outputs(&bench), level_safe);
    prepare(&mut bench);
    bench.rig.plant_mut().set_emergency_stop(true);
    bench.step();
    assert_eq!(
        outputs(&bench),
        level_safe,
        "in the period of the emergency stop"
    );
    bench.steps(500);
    check(&mut bench, "emergency stop");
    bench.rig.plant_mut().set_emergency_stop(false);
    bench.steps(5000);
    assert_eq!(bench.ask(Command::Reset), Ok(()));
    bench.steps(100);
    assert_eq!(outputs(&bench), level_safe);

    // Outputs stay through disable and enable.
    prepare(&mut bench);
    assert_eq!(bench.ask(Command::Enable), Ok(()));
    assert_eq!(bench.ask(Command::Disable), Ok(()));
    bench.steps(10);
    assert_eq!(outputs(&bench), 0b1_0101);
    assert_eq!(bench.ask(Command::Enable), Ok(()));

    // A controlled fault: coolant goes on until it latches at standstill.
    let setpoints = down(&mut bench, 5.0, 30);
    bench.start_job(1, &setpoints);
    bench.steps(1000);
    bench.events.clear();
    force(&mut bench, PROBE, Some(true));
    bench.steps(100);
    assert_eq!(state(&bench), State::Hold);
    assert_eq!(outputs(&bench), 0b1_0101);
    assert!(bench.wait_for(State::Fault, 5000));
    check(&mut bench, "controlled fault");
    force(&mut bench, PROBE, None);
    assert_eq!(bench.ask(Command::Reset), Ok(()));

    // An immediate fault: safe in its period.
    prepare(&mut bench);
    bench.events.clear();
    let mut condition = bench.rig.plant().condition(0);
    condition.drive_tripped = true;
    bench.rig.plant_mut().set_condition(0, condition);
    for _ in 0..10 {
        bench.step();
        if state(&bench) == State::Fault {
            break;
        }
        assert_eq!(outputs(&bench), 0b1_0101);
    }
    assert_eq!(state(&bench), State::Fault);
    assert_eq!(outputs(&bench), level_safe, "in the period of the fault");
    bench.steps(500);
    check(&mut bench, "immediate fault");
}

/// A silent host: outputs with `without_host = "safe"` take their safe values, the others keep
/// theirs, in idle and in a job.
#[test]
fn a_silent_host_makes_its_outputs_safe() {
    let mut bench = above_block(|_| (), 60.0);
    for (output, on) in [(COOLANT, true), (CLAMP, false), (LIGHT, true)] {
        assert_eq!(bench.ask(set(output, on)), Ok(()));
    }
    // 500 ms are 2500 periods; the host says nothing.
    for _ in 0..2300 {
        bench.rig.step();
    }
    assert_eq!(outputs(&bench), 0b1_0101);
    for _ in 0..500 {
        bench.rig.step();
    }
    assert_eq!(outputs(&bench), 0b1_0100);
    assert_eq!(state(&bench), State::Idle);
}

/// Actions set outputs in the period in which their setpoint is reached, and coolant ends with the
/// job.
#[test]
fn actions_set_outputs_at_their_setpoint() {
    let mut bench = above_block(|_| (), 60.0);
    let mut setpoints = down(&mut bench, 5.0, 6);
    setpoints[1].action = Action::Output {
        output: COOLANT,
        on: true,
    };
    setpoints[2].action = Action::AnalogOutput {
        output: 0,
        code: 777,
    };
    setpoints[3].action = Action::Output {
        output: LIGHT,
        on: true,
    };
    bench.start_job(1, &setpoints);
    let mut seen = [None; 3];
    for _ in 0..10_000 {
        bench.step();
        let controller = bench.rig.control();
        let reached = controller
            .machine()
            .expect("configured")
            .motion
            .program
            .reached();
        let on = [
            is_on(&bench, COOLANT),
            bench.rig.outputs().analog[0] == 777,
            is_on(&bench, LIGHT),
        ];
        for (seen, on) in seen.iter_mut().zip(on) {
            if on && seen.is_none() {
                *seen = Some(reached);
            }
        }
        if state(&bench) == State::Idle {
            break;
        }
    }
    // `reached` counts setpoints: setpoint 1 is the second one.
    assert_eq!(seen, [Some(2), Some(3), Some(4)]);
    bench.steps(5);
    assert!(!is_on(&bench, COOLANT), "coolant ends with the job");
    assert!(is_on(&bench, LIGHT));
}

#[test]
fn outputs_that_cannot_be_set_are_refused() {
    let mut bench = above_block(|_| (), 60.0);
    let refused = |output, problem| Err(Refusal::Output { output, problem });
    assert_eq!(bench.ask(set(9, true)), refused(9, OutputProblem::Unknown));
    assert_eq!(
        bench.ask(set(REVERSE, true)),
        refused(REVERSE, OutputProblem::FollowsSpindle)
    );
    let range = Command::SetAnalogOutput {
        output: 0,
        code: -1,
    };
    let problem = OutputProblem::Range;
    assert_eq!(
        bench.ask(range),
        Err(Refusal::AnalogOutput { output: 0, problem })
    );
    // In a job: refused with the setpoint, or, for the clamp, when it is reached.
    let mut setpoints = down(&mut bench, 5.0, 6);
    setpoints[2].action = Action::Output {
        output: 9,
        on: true,
    };
    assert_eq!(
        bench.try_job(1, &setpoints),
        refused(9, OutputProblem::Unknown)
    );
    assert_eq!(bench.ask(Command::Stop), Ok(()));
    assert!(bench.wait_for(State::Idle, 5000));
    let mut setpoints = down(&mut bench, 5.0, 6);
    setpoints[0].action = Action::Spindle(1000);
    setpoints[2].action = Action::Output {
        output: CLAMP,
        on: false,
    };
    bench.start_job(2, &setpoints);
    bench.steps(700);
    let problem = OutputProblem::SpindleTurns;
    assert_eq!(bench.ask(set(CLAMP, false)), refused(CLAMP, problem));
    assert!(bench.wait_for(State::Idle, 10_000));
    let event = Event::OutputRefused {
        output: CLAMP,
        problem,
    };
    assert!(bench.events.contains(&event), "{:?}", bench.events);
    assert!(is_on(&bench, CLAMP));
}

/// A new controller gives the same outputs for the same inputs, bit by bit.
#[test]
fn a_replay_gives_the_same_outputs() {
    let machine = MachineFile::parse("mill3-servo.toml", MILL).expect("sound");
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    let mut log: Vec<(Inputs, Outputs)> = Vec::new();
    let mut steps = |bench: &mut Bench, count: usize| {
        for _ in 0..count {
            bench.step();
            log.push((bench.rig.inputs().clone(), bench.rig.outputs().clone()));
        }
    };
    // Only `steps` records, so every command is sent without waiting.
    steps(&mut bench, 500);
    let (bytes, crc) = bench.machine.encoded().expect("encodes");
    let mut commands: Vec<Command> = bytes
        .chunks(64)
        .enumerate()
        .map(|(index, chunk)| {
            Command::Configure(haptimill_protocol::message::ConfigChunk {
                offset: (index * 64) as u16,
                bytes: chunk.iter().copied().collect(),
            })
        })
        .collect();
    commands.push(Command::Activate {
        length: bytes.len() as u16,
        crc,
        at_preset: false,
    });
    commands.extend([
        Command::Enable,
        Command::Telemetry { every: 50 },
        set(COOLANT, true),
        set(LIGHT, true),
        Command::SetAnalogOutput {
            output: 0,
            code: 20_000,
        },
        Command::ArmProbe {
            input: 0,
            active: true,
        },
        Command::Home,
    ]);
    for command in commands {
        while bench.send(command.clone()).is_none() {
            steps(&mut bench, 1);
        }
        steps(&mut bench, 60);
    }
    assert!(is_on(&bench, COOLANT) && is_on(&bench, LIGHT));
    force(&mut bench, PROBE, Some(true));
    steps(&mut bench, 400);
    force(&mut bench, DOOR, Some(false));
    steps(&mut bench, 400);
    bench.rig.plant_mut().set_emergency_stop(true);
    steps(&mut bench, 400);
    assert_eq!(outputs(&bench), 0);
    let mut controller = Controller::new(200);
    let mut replayed = Outputs::default();
    for (inputs, recorded) in &log {
        replayed.transmit.clear();
        controller.tick(inputs, &mut replayed, &mut ());
        assert_eq!(&replayed, recorded, "period {}", inputs.period);
    }
}
