//! Contacts under force control that are pressed and not cut, from soft to stiff, with and without
//! friction and backlash.

use crate::setup;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::RigOptions;
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::process::structure::StructureConfig;
use haptimill_machine_file::{BUILT_IN, MachineFile};
use haptimill_protocol::force::EnableCondition;
use haptimill_protocol::message::State;
use haptimill_tests::Bench;
use setup::force::{PERIOD, control, force_settings, job, levels, tare, turn_table, wall};
use setup::{state, tool};

/// Returns the built-in machine, or one without friction and backlash.
///
/// Without them the encoder counts remain. The servo oscillates across a count while the reference
/// creeps by less than six counts per second.
fn machine(ideal: bool) -> Bench {
    let mut text = BUILT_IN.to_string();
    if ideal {
        for (from, to) in [
            ("coulomb = 40.0", "coulomb = 0.0"),
            ("coulomb = 2.0", "coulomb = 0.0"),
            ("coulomb_n = 32.0", "coulomb_n = 0.0"),
            ("coulomb_n_m = 1.6", "coulomb_n_m = 0.0"),
            ("backlash = 0.010", "backlash = 0.0"),
            ("backlash = 0.005", "backlash = 0.0"),
            ("backlash_mm = 0.0258", "backlash_mm = 0.0"),
            ("backlash_deg = 0.0123", "backlash_deg = 0.0"),
            ("creep_mm_s = 0.030", "creep_mm_s = 0.010"),
        ] {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
    }
    let machine = MachineFile::parse("machine.toml", &text).expect("sound");
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    bench.make_ready();
    bench.steps(500);
    bench
}

/// Stiffness of the servo along x: K_P times the mass of four slides.
const SERVO: f64 = 4.0 * 1600.0;

/// Forces of a contact, N: the first peak; then over the last `LOOKED` seconds the largest
/// oscillation within `SPAN`, and the mean.
struct Held {
    first: f64,
    oscillation: f64,
    mean: f64,
    level: u8,
}

/// Seconds from the end of the commanded motion to the end, and seconds of the evaluated part.
const TIME: f64 = 16.0;
const LOOKED: f64 = 12.0;

/// Seconds in which an oscillation is evaluated; the slowest observed one takes two.
const SPAN: f64 = 4.0;

/// Angles of the table, degrees; each puts the slides at another place within an encoder count.
const TABLES_DEG: [f64; 5] = [3.0, 3.3, 3.6, 3.9, 4.2];

/// A count of a slide's encoder, mm.
const COUNT_MM: f64 = 10.0 / 8000.0;

/// Presses the tool 2 mm into a wall of this stiffness, and holds it there.
///
/// The sensor has noise and quantisation. Its drift is off: 0.01 N/s would exceed the bound of the
/// mean.
fn press(ideal: bool, stiffness: f64, structure: bool, speed: f64, table: f64) -> Held {
    let mut bench = machine(ideal);
    turn_table(&mut bench, table);
    let process = ProcessConfig {
        sensor: Some(SensorConfig {
            drift_n_s: [0.0; 3],
            ..SensorConfig::default()
        }),
        structure: structure.then(StructureConfig::default),
        ..wall(tool(&bench), 0.5, stiffness)
    };
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(
        &mut bench,
        0,
        force_settings(1.0, 5.0, EnableCondition::Any),
    );
    let spans = (20.0 / speed) as usize;
    job(&mut bench, -speed, spans, TIME);
    // The spindle takes 1 s to its speed.
    let motion = 1.0 + 0.1 * (spans + 2) as f64;
    let (end, looked) = (
        ((motion + TIME) / PERIOD) as usize,
        (LOOKED / PERIOD) as usize,
    );
    let (mut first, mut forces) = (0.0_f64, Vec::with_capacity(looked));
    for period in 0..end {
        bench.step();
        let force = bench.rig.truth().force[0];
        first = first.max(force);
        if period >= end - looked {
            forces.push(force);
        }
        assert_ne!(
            state(&bench),
            State::Fault,
            "{stiffness} N/mm: {:?}",
            bench.events
        );
    }
    let oscillation = |part: &[f64]| {
        let (low, high) = part
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(*value), high.max(*value))
            });
        high - low
    };
    // The intervals overlap by half.
    let span = (SPAN / PERIOD) as usize;
    let oscillations = (0..=looked - span)
        .step_by(span / 2)
        .map(|from| oscillation(&forces[from..from + span]));
    Held {
        first,
        oscillation: oscillations.fold(0.0, f64::max),
        mean: forces.iter().sum::<f64>() / looked as f64,
        level: levels(&bench)[0],
    }
}

/// The commanded motion presses on contacts of up to 1000 N/mm (wall, structure and servo in
/// series), with and without friction and backlash.
///
/// The force reaches its setpoint. Result and oscillation depend on the place within an encoder
/// count, so five places are tried: the first peak is the largest, error and oscillation are
/// medians. With friction the tool rests within a count, so the error is at most 0.5 N, or the
/// force of a count.
#[test]
fn the_force_setpoint_is_held_up_to_1000_n_per_mm() {
    for (wall, structure, speed) in [
        (10.0, false, 2.0),
        (20.0, false, 1.0),
        (50.0, false, 1.0),
        (100.0, false, 1.0),
        (100.0, false, 4.0),
        (300.0, false, 1.0),
        (600.0, false, 0.5),
        (1185.0, false, 1.0),
        (100.0, true, 1.0),
        (1000.0, true, 1.0),
    ] {
        let compliance = if structure { 1.0 / 500.0 } else { 0.0 };
        let stiffness = 1.0 / (1.0 / wall + compliance + 1.0 / SERVO);
        for ideal in [false, true] {
            let held = TABLES_DEG.map(|table| press(ideal, wall, structure, speed, table));
            let median = |value: fn(&Held) -> f64| {
                let mut values = held.each_ref().map(value);
                values.sort_by(f64::total_cmp);
                values[values.len() / 2]
            };
            let max = |value: fn(&Held) -> f64| held.iter().map(value).fold(0.0, f64::max);
            let held = Held {
                first: max(|held| held.first),
                oscillation: median(|held| held.oscillation),
                mean: 5.0 + median(|held| (held.mean - 5.0).abs()),
                level: held[0].level,
            };
            let first = 5.0 + 1.2 * (5.0 * speed + speed * stiffness.sqrt());
            let oscillation = f64::max(0.2, 0.0025 * stiffness);
            let off = if ideal {
                0.25
            } else {
                f64::max(0.5, COUNT_MM * stiffness)
            };
            println!(
                "{}, {stiffness:.0} N/mm at {speed} mm/s: first peak {:.2} N (at most {first:.2}), oscillation {:.3} N (at most {oscillation:.3}), mean {:.3} N, level {}",
                if ideal {
                    "no friction"
                } else {
                    "friction and backlash"
                },
                held.first,
                held.oscillation,
                held.mean,
                held.level
            );
            assert!(held.first <= first, "{}", held.first);
            assert!(held.oscillation <= oscillation, "{}", held.oscillation);
            assert!((held.mean - 5.0).abs() <= off, "{}", held.mean);
        }
    }
}
