//! The identification finds the true values of the simulated machine, from a machine file with
//! wrong ones.

use haptimill_client::client::Options as ClientOptions;
use haptimill_client::session::{Session, SimLine, rig};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_identify::identify::{Identification, Identified, Options, inertia_of, lines};
use haptimill_identify::measure::count_of;
use haptimill_identify::tune::{Joint, Requirement};
use haptimill_identify::{edit, record};
use haptimill_machine_file::MachineFile;
use std::path::PathBuf;
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A machine file with keys replaced in the controller's part, and others in the plant's.
fn wrong(name: &str, controller: &[[&str; 2]], plant: &[[&str; 2]]) -> Result<MachineFile> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../machines")
        .join(name);
    let text = std::fs::read_to_string(&path)?;
    let at = text.find("[plant]").ok_or("no plant")?;
    let (mut first, mut second) = (text[..at].to_string(), text[at..].to_string());
    for (part, changes) in [(&mut first, controller), (&mut second, plant)] {
        for [from, to] in changes {
            assert!(part.contains(from), "{name} has no {from}");
            *part = part.replace(from, to);
        }
    }
    Ok(MachineFile::parse(name, &format!("{first}{second}"))?)
}

fn identify(machine: &MachineFile, options: Options) -> Result<Vec<Identified>> {
    let line = SimLine::new(rig(machine, None, None, Vec::new())?).unrecorded();
    let mut session = Session::new(line, machine, ClientOptions::default(), Arc::default());
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    let lines = lines(machine, &options)?;
    let mut identification = Identification::new(&mut session, machine, options)?;
    identification.home()?;
    let mut found = Vec::new();
    for line in &lines {
        found.extend(identification.measure(line, &mut |what| println!("{what}"))?);
    }
    Ok(found)
}

fn check(machine: &MachineFile) -> Result<()> {
    let plant: PlantConfig = machine.plant()?;
    let found = identify(machine, Options::default())?;
    let servos = machine.config.joints.iter();
    let servos = servos.filter(|joint| joint.encoder.is_some()).count();
    assert_eq!(found.len(), servos);
    let mut misses = Vec::new();
    for found in &found {
        let joint = &plant.joint[found.joint];
        let mut near = |what: &str, value: f64, truth: f64, absolute: f64| {
            println!("{:6} {what:12} {value:9.4}, true {truth:9.4}", found.name);
            if (value - truth).abs() > (0.05 * truth.abs()).max(absolute) {
                misses.push(format!("{} {what}: {value} and not {truth}", found.name));
            }
        };
        near("inertia", found.plant.inertia, joint.inertia, 0.0);
        near("forward", found.friction.coulomb[0], joint.coulomb, 0.0);
        near("backward", found.friction.coulomb[1], joint.coulomb, 0.0);
        // Where there is none: 1 % of the friction at the maximum rate.
        let none = 0.01 * joint.coulomb / machine.joints[found.joint].rate;
        near("viscous", found.friction.viscous, joint.viscous, none);
        match found.resonance {
            Ok(()) => near("mode", found.plant.mode_hz, joint.mode_hz, 0.0),
            // Its notch is beyond the sines.
            Err(highest) => {
                let notch = joint.mode_hz * joint.motor_share.sqrt();
                assert!(notch > 0.8 * highest, "{}: {highest} {notch}", found.name);
                assert!(found.plant.mode_hz < joint.mode_hz, "{}", found.name);
            }
        }
        println!(
            "       share {:.3} (true {:.3}), damping {:.4} ({:.4}), fit {:.2} %",
            found.plant.motor_share,
            joint.motor_share,
            found.plant.mode_damping,
            joint.mode_damping,
            found.error * 100.0
        );
    }
    assert!(misses.is_empty(), "{misses:#?}");
    written(machine, &plant, &found)
}

/// The results survive their files: the machine file then has the true values, and gains that the
/// record proposes keep their margins in it.
fn written(machine: &MachineFile, plant: &PlantConfig, found: &[Identified]) -> Result<()> {
    let text = record::write(&machine.config.name, "2026-11-23", found, &[], &[]);
    let found = record::read("identified.toml", &text, machine)?;
    let (text, changes) = edit::with_identified(machine, &found, &[], "2026-11-23")?;
    assert!(changes.len() >= found.len());
    let mut gains = Vec::new();
    let edited = MachineFile::parse("edited", &text)?;
    for found in &found {
        let truth = plant.joint[found.joint].inertia;
        let inertia = inertia_of(&edited, found.joint);
        assert!(
            (inertia / truth - 1.0).abs() < 0.05,
            "{}: {inertia}",
            found.name
        );
        let joint = Joint {
            plant: found.plant,
            period: 2e-4,
            count: count_of(machine, found.joint),
            limit: 36.0,
        };
        let requirement = Requirement {
            count_effort: 0.5,
            ..Requirement::default()
        };
        let proposed = joint.propose(&requirement).ok_or("no gains")?;
        let margins = joint.margins(&proposed);
        println!("{}: {proposed:?} {margins:?}", found.name);
        assert!(margins.closed.gain_db >= 6.0 && margins.closed.phase_deg >= 40.0);
        gains.push((found.name.clone(), proposed));
    }
    let (text, _) = edit::with_gains(&edited, &gains, "2026-11-23")?;
    // Comments stay.
    for line in machine.text.lines().filter(|line| line.starts_with('#')) {
        assert!(text.contains(line), "{line}");
    }
    // The tuned machine homes and moves.
    let tuned = MachineFile::parse("tuned", &text)?;
    let line = SimLine::new(rig(&tuned, None, None, Vec::new())?).unrecorded();
    let mut session = Session::new(line, &tuned, ClientOptions::default(), Arc::default());
    session.connect(1)?;
    session.configure(&tuned)?;
    session.enable()?;
    Identification::new(&mut session, &tuned, Options::default())?.home()?;
    Ok(())
}

#[test]
fn h4_with_wrong_inertia_and_friction() -> Result<()> {
    let controller = [
        ["inertia_kg = 40.0", "inertia_kg = 28.0"],
        ["inertia_kg_m2 = 0.2", "inertia_kg_m2 = 0.3"],
        ["coulomb_n = 32.0", "coulomb_n = 60.0"],
        ["coulomb_n_m = 1.6", "coulomb_n_m = 1.0"],
    ];
    let plant = [["viscous = 0.0", "viscous = 0.15"]];
    check(&wrong("h4.toml", &controller, &plant)?)
}

#[test]
fn mill_with_wrong_inertia_and_friction() -> Result<()> {
    let controller = [
        ["inertia_kg = 40.0", "inertia_kg = 55.0"],
        ["inertia_kg = 30.0", "inertia_kg = 20.0"],
        ["coulomb_n = 32.0", "coulomb_n = 10.0"],
    ];
    let plant = [
        ["viscous = 0.0", "viscous = 0.3"],
        ["mode_hz = 90.0", "mode_hz = 62.0"],
    ];
    check(&wrong("mill3-servo.toml", &controller, &plant)?)
}

/// A mode at 400 Hz is beyond the sines: none is reported in its place.
#[test]
fn vertical_mill_with_a_mode_beyond_the_sines() -> Result<()> {
    let machine = wrong("vmc3.toml", &[], &[])?;
    check(&machine)
}

/// A fast rotary axis beside slides with step motors.
#[test]
fn rotary_axis_of_a_four_axis_mill() -> Result<()> {
    check(&wrong("mill4.toml", &[], &[])?)
}
