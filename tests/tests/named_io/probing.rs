//! Probing: the latched position of a contact, missed contacts, and contacts in other motions.

use super::*;

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
        assert!(bench.rig.control().safety().homed());
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
    // A refused command keeps the probe that was armed before.
    assert_eq!(bench.ask(arm(input)), Ok(()));
    let probing = |bench: &Bench| {
        let machine = bench.rig.control().machine().expect("configured");
        machine.io.probing()
    };
    let armed = probing(&bench);
    force(&mut bench, DOOR, Some(false));
    bench.steps(50);
    let door = InputProblem::DoorOpen { input: DOOR as u8 };
    assert_eq!(bench.ask(arm(input)), Err(Refusal::Input(door)));
    assert!(armed.is_some() && probing(&bench) == armed);
    force(&mut bench, DOOR, None);
    bench.steps(50);
    // It gets its contact between the command and the motion.
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
            timeout_ms: 300,
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
    assert!(safety.homed() && safety.drives_on());
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
