//! Calibration of the arm.

use super::{machine, value};
use crate::scene::{TestFolder, haptimill as run};

/// The written machine file of an arm is calibrated: a second calibration finds nothing more.
#[test]
fn a_calibrated_arm_stays_calibrated() {
    let folder = TestFolder::new();
    let (first, second) = (folder.path("a.toml"), folder.path("b.toml"));
    let command = ["calibrate", "arm", "--perturb", "0.1", "--out", &first];
    let elsewhere =
        |out: &str, when: &str| value(out, &format!("error of the tip elsewhere, {when}"));
    let out = run(&command).expect_code(0).out;
    println!("{out}");
    assert!(elsewhere(&out, "before") > 100.0, "{out}");
    assert!(elsewhere(&out, "after") < 5.0, "{out}");
    assert!(
        out.contains("Readings of the tip do not distinguish w from x_off"),
        "{out}"
    );
    run(&["machine", "check", &first]).expect_code(0);
    let again = ["calibrate", "arm", "--machine", &first, "--out", &second];
    let out = run(&[&again[..], &["--seed", "2"]].concat())
        .expect_code(0)
        .out;
    assert!(elsewhere(&out, "before") < 5.0, "{out}");
    assert!(elsewhere(&out, "after") < 5.0, "{out}");
    let mill = [
        "calibrate",
        "arm",
        "--machine",
        &machine(),
        "--out",
        &second,
    ];
    let refused = run(&mill).expect_code(3);
    assert!(refused.err.contains("is no H-4 arm"), "{}", refused.err);
    let refused = run(&["calibrate", "arm", "--perturb", "3"]).expect_code(2);
    assert!(
        refused.err.contains("write mm from 0 to 0.2"),
        "{}",
        refused.err
    );
}
