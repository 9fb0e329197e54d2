//! Tests of machine files; here those of the built-in ones.

mod damage;
mod mistakes;
mod simulated;

use super::*;
use haptimill_firmware::config::{Drive, ServoForm};
use haptimill_math::Length;

const STEP: &str = include_str!("../../../machines/h4-step.toml");

#[test]
fn built_in_machine_is_valid() {
    let machine = MachineFile::built_in().unwrap_or_else(|problems| panic!("\n{problems}"));
    let config = &machine.config;
    let Model::H4(geometry) = &config.model else {
        panic!("an H-4 arm");
    };
    assert_eq!(geometry.lateral, Length(250 << 20));
    assert_eq!(geometry.x_offset, Length(810 << 20));
    assert_eq!(geometry.singularity_margin, Length(5 << 20));
    assert!(geometry.below);
    let slide = &config.joints[0];
    assert_eq!(slide.preset, Coordinate(1135 << 20));
    assert_eq!(slide.low, Coordinate(885 << 20));
    // 10 mm / 8000 counts = 1.25 um, times 2^44.
    assert_eq!(
        slide.encoder.as_ref().expect("an encoder").per_count,
        (0.00125_f64 * 2_f64.powi(44)).round() as i64
    );
    assert_eq!(slide.law.kp.0, 40_000 << 8);
    assert_eq!(slide.law.rate_filter_us, 1500);
    // 40 kg * 1 mm/s^2 = 0.04 N.
    let effort = f64::from(slide.law.inertia) / 2_f64.powi(20) * 4096.0 / 65_536.0;
    assert!((effort - 0.04).abs() < 1e-7, "{effort}");
    assert_eq!(
        slide.encoder.as_ref().expect("an encoder").following_lag,
        655
    );
    let table = &config.joints[4];
    // 0.2 kg m^2 at 1 turn/s^2 is 0.4 pi N m.
    let effort = f64::from(table.law.inertia) / 2_f64.powi(20) * 2_f64.powi(24) / 65_536.0;
    assert!(
        (effort / (0.4 * std::f64::consts::PI) - 1.0).abs() < 2e-4,
        "{effort}"
    );
    // One turn of the table is 720000 counts.
    let turn =
        table.encoder.as_ref().expect("an encoder").per_count as f64 / 2_f64.powi(24) * 720_000.0;
    assert!((turn / 2_f64.powi(32) - 1.0).abs() < 1e-11);
    assert_eq!(
        table.high,
        Coordinate((45.0 / 360.0 * 2_f64.powi(32)) as i32)
    );
    assert_eq!(table.law.form, ServoForm::ModelBased);
    assert_eq!(config.pose[0].jerk, 80_000);
    let (bytes, crc) = machine.encoded().unwrap();
    let decoded: Config = postcard::from_bytes(&bytes).unwrap();
    assert_eq!(&decoded, config);
    assert_ne!(crc, 0);
}

#[test]
fn step_drive_machine_is_valid() {
    let machine =
        MachineFile::parse("h4-step.toml", STEP).unwrap_or_else(|problems| panic!("\n{problems}"));
    let Drive::Steps {
        per_step, pulse, ..
    } = machine.config.joints[0].drive
    else {
        panic!("not steps")
    };
    assert_eq!(per_step, (10.0 / 3200.0 * 2_f64.powi(44)).round() as i64);
    assert_eq!(pulse, 210);
    assert!(matches!(
        machine.config.joints[4].drive,
        Drive::Torque { .. }
    ));
}

/// Returns the problems of a text, one per line.
fn problems(text: &str) -> String {
    match MachineFile::parse("broken.toml", text) {
        Ok(_) => "no problem\n".to_string(),
        Err(problems) => format!("{problems}\n"),
    }
}

/// Replaces the first occurrence of a text in the built-in file and returns the problems.
fn broken(from: &str, to: &str) -> String {
    assert!(BUILT_IN.contains(from), "the file has no {from:?}");
    let text = BUILT_IN.replacen(from, to, 1);
    format!(
        "## {} -> {}\n{}",
        from.trim().replace('\n', " / "),
        to.trim().replace('\n', " / "),
        problems(&text)
    )
}
