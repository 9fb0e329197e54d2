//! Outputs: actions of setpoints, commands, safe values, replay.

use super::*;

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

#[test]
fn the_spindle_does_not_start_with_an_open_clamp() {
    let mut bench = above_block(|_| (), 60.0);
    assert_eq!(bench.ask(set(CLAMP, false)), Ok(()));
    let mut setpoints = down(&mut bench, 5.0, 6);
    setpoints[1].action = Action::Spindle(1000);
    bench.start_job(1, &setpoints);
    for _ in 0..10_000 {
        bench.step();
        assert_eq!(bench.rig.outputs().spindle_rpm, 0);
        if state(&bench) == State::Idle {
            break;
        }
    }
    assert_eq!(state(&bench), State::Idle);
    let event = Event::OutputRefused {
        output: CLAMP,
        problem: OutputProblem::ClampOpen,
    };
    assert!(bench.events.contains(&event), "{:?}", bench.events);
    // With the clamp on, the same job runs to its end.
    assert_eq!(bench.ask(set(CLAMP, true)), Ok(()));
    let mut setpoints = down(&mut bench, 5.0, 6);
    setpoints[1].action = Action::Spindle(1000);
    bench.start_job(2, &setpoints);
    let mut turned = false;
    for _ in 0..10_000 {
        bench.step();
        turned |= bench.rig.outputs().spindle_rpm == 1000;
        if state(&bench) == State::Idle {
            break;
        }
    }
    assert!(turned);
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
