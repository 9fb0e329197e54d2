//! The lost motion of the joints of the default machine, by a simulated gauge at the slides.

use haptimill_client::Error;
use haptimill_client::client::Options as ClientOptions;
use haptimill_client::session::{Line as _, Session, SimLine, find_home_pose, rig};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_identify::{edit, lost_motion};
use haptimill_machine_file::{BUILT_IN, MachineFile};
use std::f64::consts::TAU;
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Measures l1 and the table from a machine file with another backlash of the slides.
fn check(backlash: &str) -> Result<()> {
    let text = BUILT_IN.replace("backlash_mm = 0.0258", &format!("backlash_mm = {backlash}"));
    assert_ne!(text, BUILT_IN);
    let machine = MachineFile::parse("h4.toml", &text)?;
    let plant: PlantConfig = machine.plant()?;
    let line = SimLine::new(rig(&machine, None, None, Vec::new())?).unrecorded();
    let mut session = Session::new(line, &machine, ClientOptions::default(), Arc::default());
    session.connect(1)?;
    session.configure(&machine)?;
    session.enable()?;
    let home = find_home_pose(&machine, session.model())?;
    session.go_home(&machine, &home)?;
    let mut found = Vec::new();
    for index in [0, 4] {
        let mut gauge =
            |session: &mut Session<SimLine>, _: &str| -> std::result::Result<f64, Error> {
                Ok(session
                    .line()
                    .truth()
                    .map_or(f64::NAN, |it| it.joints[index]))
            };
        found.push(lost_motion::measure(
            &mut session,
            &machine,
            index,
            &mut gauge,
        )?);
    }
    for (found, count) in found.iter().zip([0.001_25, f64::NAN]) {
        // The backlash, and the wind-up by the friction of the slide in both directions.
        let joint = &plant.joint[found.joint];
        let omega = TAU * joint.mode_hz;
        let share = joint.motor_share * (1.0 - joint.motor_share);
        let stiffness = omega * omega * joint.inertia * share / joint.kind.acceleration_unit();
        let friction = joint.coulomb * joint.friction_slide_share;
        let truth = joint.backlash + 2.0 * friction / stiffness;
        println!("{}, true {truth:.4}", found.summary());
        let within = (0.05 * truth).max(count);
        assert!((found.value() - truth).abs() < within, "{}", found.name);
    }
    let (text, changes) = edit::with_lost_motion(&machine, &found, "2026-11-27")?;
    let edited = MachineFile::parse("edited", &text)?;
    assert!(
        changes.iter().any(|it| it.key == "l1: backlash_mm"),
        "{changes:?}"
    );
    let written = f64::from(edited.config.joints[0].backlash.0);
    let ratio = written / f64::from(machine.config.joints[0].backlash.0);
    let expected = found[0].value() / found[0].before;
    assert!((ratio / expected - 1.0).abs() < 0.005);
    Ok(())
}

#[test]
fn lost_motion_from_a_backlash_that_is_too_small() -> Result<()> {
    check("0.010")
}

#[test]
fn lost_motion_from_a_backlash_that_is_too_large() -> Result<()> {
    check("0.060")
}
