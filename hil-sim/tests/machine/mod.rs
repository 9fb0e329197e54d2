//! Machines of the tests.
use haptimill_hil_sim::PlantConfig;
use haptimill_hil_sim::joint::{DriveConfig, JointConfig, StepDrive};
use haptimill_hil_sim::machines::GeometryConfig;

#[derive(serde::Deserialize)]
struct File {
    plant: PlantConfig,
}

/// The REF-G machine.
pub fn reference() -> PlantConfig {
    toml::from_str::<File>(include_str!("../refg.toml"))
        .expect("a plant")
        .plant
}

/// One of its slides alone, at 0 with a long stroke.
pub fn slide() -> PlantConfig {
    let mut config = reference();
    config.geometry = Some(GeometryConfig::Joints(Default::default()));
    config.joint.truncate(1);
    let joint = &mut config.joint[0];
    joint.low = -500.0;
    joint.high = 500.0;
    joint.preset = 0.0;
    joint.start_spread = 0.0;
    joint.encoder.as_mut().expect("an encoder").index = 0.0;
    joint.limit_low = None;
    joint.limit_high = None;
    config
}

/// The same without friction, damping and backlash.
pub fn ideal_slide() -> PlantConfig {
    let mut config = slide();
    let joint = &mut config.joint[0];
    joint.coulomb = 0.0;
    joint.viscous = 0.0;
    joint.backlash = 0.0;
    joint.mode_damping = 0.0;
    config
}

/// The slide with a step motor of 2 N m on the 10 mm screw.
pub fn stepped_slide() -> PlantConfig {
    let mut config = slide();
    let joint: &mut JointConfig = &mut config.joint[0];
    joint.drive = DriveConfig::Steps(StepDrive {
        full_steps: 200,
        phases: 2,
        microsteps: 16,
        pull_out: 1200.0,
        damping: 2.0,
        reversed: false,
        ticks_per_us: 16,
        pulse_ns: 2000.0,
        min_high_ns: 1000.0,
        min_low_ns: 1000.0,
        setup_ns: 5000.0,
        hold_ns: 5000.0,
    });
    config
}
