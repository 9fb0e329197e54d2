//! The places of the index pulses of the simulated machines, from machine files with wrong ones.

use haptimill_client::client::Options as ClientOptions;
use haptimill_client::session::{Session, SimLine, rig};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::Fault;
use haptimill_identify::index_pulses::{IndexPulses, IndexTest, TIMES, index_joints};
use haptimill_identify::{edit, page};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::State;
use std::path::PathBuf;
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A machine file with lines replaced. The simulated operator places the joints exactly.
fn edited(name: &str, changes: &[[&str; 2]]) -> Result<MachineFile> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../machines")
        .join(name);
    let text = std::fs::read_to_string(&path)?;
    let placed = |line: &str| {
        if line.starts_with("start_spread = ") {
            "start_spread = 0.0\n".to_string()
        } else {
            format!("{line}\n")
        }
    };
    let mut text: String = text.lines().map(placed).collect();
    for [from, to] in changes {
        assert!(text.contains(from), "{name} has no {from}");
        text = text.replace(from, to);
    }
    Ok(MachineFile::parse(name, &text)?)
}

fn session(machine: &MachineFile, faults: &[&str]) -> Result<Session<SimLine>> {
    let faults = faults.iter().map(|it| it.parse::<Fault>());
    let faults = faults.collect::<std::result::Result<Vec<_>, _>>()?;
    let line = SimLine::new(rig(machine, None, None, faults)?).unrecorded();
    let mut session = Session::new(line, machine, ClientOptions::default(), Arc::default());
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    Ok(session)
}

fn measure(machine: &MachineFile, session: &mut Session<SimLine>) -> Result<Vec<IndexPulses>> {
    let (joints, _) = index_joints(machine, 80.0);
    let mut test = IndexTest::new(session, machine, &joints, None)?;
    let found = test.measure(&mut |what| println!("{what}"))?;
    for it in &found {
        println!("{}", it.summary());
    }
    Ok(found)
}

/// The slack covers every pass, and is at most 3 counts larger than that takes.
fn check_slack(found: &IndexPulses) {
    let [up, down] = found.directions();
    assert_eq!([up, down], [TIMES, TIMES], "{}", found.name);
    let places = found.passes.iter().map(|it| it.at / found.count);
    let high = places.clone().fold(f64::NEG_INFINITY, f64::max);
    let needed = high - places.fold(f64::INFINITY, f64::min);
    let slack = f64::from(found.slack());
    assert!(slack >= needed && slack <= needed + 3.0, "{found:?}");
}

/// A place that the plant has, or whole turns of the motor from it.
fn check_place(machine: &MachineFile, plant: &PlantConfig, found: &IndexPulses) {
    let encoder = plant.joint[found.joint].encoder.as_ref();
    let truth = encoder.map_or(f64::NAN, |it| it.index);
    let off = found.place() - truth;
    let off = off - (off / found.pitch).round() * found.pitch;
    println!("{} {:.5}, true {truth:.5}", found.name, found.place());
    // A millionth is an axis unit, to which positions are rounded.
    let within = found.count + 1e-6 + 0.05 * (found.before - truth).abs();
    assert!(off.abs() <= within, "{}: {off}", machine.file);
}

#[test]
fn places_of_the_h4_arm_from_wrong_ones() -> Result<()> {
    let changes = [
        ["index_mm = 1136.2 ", "index_mm = 1135.4 "],
        ["index_mm = 483.7 ", "index_mm = 484.5 "],
        ["index_deg = 0.5\n", "index_deg = 0.2\n"],
    ];
    let machine = edited("h4.toml", &changes)?;
    let plant: PlantConfig = machine.plant()?;
    let mut session = session(&machine, &[])?;
    let found = measure(&machine, &mut session)?;
    assert_eq!(found.len(), 5);
    for found in &found {
        assert!(found.from_presets);
        check_place(&machine, &plant, found);
        check_slack(found);
    }
    let (text, changes) = edit::with_index_pulses(&machine, &found, "2026-11-29")?;
    let keys: Vec<&str> = changes.iter().map(|it| it.key.as_str()).collect();
    for key in ["l1: index_mm", "l4: index_mm", "alpha: index_deg"] {
        assert!(keys.contains(&key), "{keys:?}");
    }
    assert!(
        text.contains("; identified 2026-11-29\n") && text.contains("index_slack_counts = 1  #"),
        "{text}"
    );
    let shown = page::index_pulses("h4", "2026-11-29", &found, &[], &changes);
    for part in [
        "Passes over the index pulse",
        "upwards",
        "downwards",
        "instrument",
    ] {
        assert!(shown.contains(part), "{part}");
    }
    // The machine homes by what is written, and its coordinates then are those of the plant.
    let corrected = MachineFile::parse("corrected", &text)?;
    let mut session = self::session(&corrected, &[])?;
    session.home()?;
    let status = session.status()?;
    let measured = session.model().unwound_joints(&status);
    let truth = session.line().rig().plant().truth();
    for (index, (measured, truth)) in measured.iter().zip(&truth.joints).enumerate() {
        // Half of the lost motion, and the following error.
        assert!(
            (measured - truth).abs() < 0.025,
            "{index} {measured} {truth}"
        );
    }
    Ok(())
}

/// Counts that are lost and gained between the passes are a spread of the pulses.
#[test]
fn slack_covers_a_spread() -> Result<()> {
    let machine = edited("mill3-servo.toml", &[])?;
    let faults = [
        "encoder-slip joint=x counts=6 at=10s",
        "encoder-slip joint=x counts=-4 at=25s",
        "encoder-slip joint=x counts=3 at=40s",
    ];
    let mut session = session(&machine, &faults)?;
    let found = measure(&machine, &mut session)?;
    let x = &found[0];
    check_slack(x);
    assert!((4..=8).contains(&x.slack()), "{x:?}");
    assert_eq!(found[1].slack(), 1);
    Ok(())
}

/// A homed machine has its places from the machine file: only the slack is proposed.
#[test]
fn a_homed_machine_keeps_its_places() -> Result<()> {
    let machine = edited("mill3-servo.toml", &[])?;
    let mut session = session(&machine, &[])?;
    session.home()?;
    let found = measure(&machine, &mut session)?;
    let (_, changes) = edit::with_index_pulses(&machine, &found, "2026-11-29")?;
    let keys: Vec<&str> = changes.iter().map(|it| it.key.as_str()).collect();
    assert!(keys.iter().all(|it| it.ends_with("index_slack_counts")));
    assert!(found.iter().all(|it| it.proposed().is_none()));
    Ok(())
}

#[test]
fn a_missing_pulse_ends_safely() -> Result<()> {
    let machine = edited("h4.toml", &[])?;
    let mut session = session(&machine, &["index-missing joint=l3 at=20s"])?;
    let error = measure(&machine, &mut session).err().ok_or("no error")?;
    let text = error.to_string();
    println!("{text}");
    assert!(
        text.contains("l3") && text.contains("wire of the index (Z)"),
        "{text}"
    );
    let state = session.status()?.state;
    assert!(matches!(state, State::Fault | State::Disabled), "{state:?}");
    // The controller has the machine file again.
    let (_, crc) = machine.encoded()?;
    assert_eq!(session.configuration_crc(), crc);
    Ok(())
}

#[test]
fn joints_without_an_index_are_named() -> Result<()> {
    let (joints, skipped) = index_joints(&edited("mill4.toml", &[])?, 1000.0);
    assert_eq!(joints.len(), 1);
    let reasons: Vec<String> = skipped
        .iter()
        .map(|it| format!("{}: {}", it.name, it.reason))
        .collect();
    let no = "it has no encoder with an index pulse";
    assert_eq!(reasons, ["x", "y", "z"].map(|name| format!("{name}: {no}")));
    let (joints, skipped) = index_joints(&edited("h4.toml", &[])?, 20.0);
    assert_eq!(joints.len(), 1);
    assert!(skipped[0].reason.contains("more than --travel"));
    Ok(())
}
/// Scales with counts of 0.02 um, and a machine whose step motors lose their position with the
/// drives off: that one is searched in one direction.
#[test]
fn fine_scales_and_step_motors() -> Result<()> {
    let machine = edited("vmc3.toml", &[])?;
    let plant: PlantConfig = machine.plant()?;
    let found = measure(&machine, &mut session(&machine, &[])?)?;
    for found in &found {
        check_place(&machine, &plant, found);
        check_slack(found);
        assert!(found.spread() < 1.0, "{found:?}");
    }
    let machine = edited("mill4.toml", &[])?;
    let plant: PlantConfig = machine.plant()?;
    let found = measure(&machine, &mut session(&machine, &[])?)?;
    let [a] = &found[..] else {
        return Err(format!("{found:?}").into());
    };
    check_place(&machine, &plant, a);
    assert_eq!(a.directions(), [TIMES, 0]);
    assert!(a.summary().contains("a step motor without encoder"));
    Ok(())
}
