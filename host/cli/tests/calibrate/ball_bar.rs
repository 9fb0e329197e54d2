//! Readings of a ball bar.

use super::{error_of, machine, value};
use crate::scene::{self, TestFolder, haptimill as run};

/// Readings of a real ball bar, evaluated without a machine that moves: the squareness becomes an
/// error file, which a controller takes, and whose effect the operator switches.
#[test]
fn readings_of_a_ball_bar_make_an_error_file() {
    let folder = TestFolder::new();
    let machine = machine();
    let (bar, errors) = (folder.path("bar.csv"), folder.path("errors.csv"));
    let evaluate = |text: &str| {
        std::fs::write(&bar, text).unwrap();
        let command = ["calibrate", "ball-bar", "--machine", &machine];
        let files = ["--radius", "150", "--readings", &bar, "--out", &errors];
        run(&[&command[..], &files].concat())
    };
    // y out of square by 30 urad moves x by -30e-6 y, a long bar adds 2 um, and the clockwise
    // circle is 1 um smaller.
    let mut text = String::from("angle_deg,direction,reading_um\n");
    for (direction, offset) in [("ccw", 2.0), ("cw", 1.0)] {
        for step in 0..=240 {
            let angle = f64::from(step) * 1.5;
            let (sine, cosine) = angle.to_radians().sin_cos();
            let reading = offset - 30e-6 * 150e3 * sine * cosine;
            text += &format!("{angle},{direction},{reading:.4}\n");
        }
    }
    let out = evaluate(&text).expect_code(0).out;
    let close = |name: &str, expected: f64| {
        let found = value(&out, name);
        assert!((found - expected).abs() < 0.02, "{name} {expected}: {out}");
    };
    close("squareness", 30.0);
    // The radius changes by up to 15e-6 of 150 mm in both directions.
    close("G ccw", 4.5);
    close("G cw", 4.5);
    close("H", 1.0);
    close("F", -1.25);
    let written = std::fs::read_to_string(&errors).unwrap();
    let [x, y, z] = error_of(&written, [0.0, 100.0, 0.0]);
    assert!(
        (x + 3e-3).abs() < 2e-6 && y == 0.0 && z == 0.0,
        "{x} {y} {z}"
    );

    // The same squareness as a result, beside no readings of a laser.
    let laser = folder.path("laser.csv");
    let header = "function,target_mm,run,direction,reading,unit";
    std::fs::write(&laser, format!("{header}\nEC0Y,,,,30,urad\n")).unwrap();
    let command = ["calibrate", "laser", "--machine", &machine];
    let files = ["--readings", &laser, "--out", &errors];
    run(&[&command[..], &files].concat()).expect_code(0);
    let alone = std::fs::read_to_string(&errors).unwrap();
    assert!((error_of(&alone, [0.0, 100.0, 0.0])[0] + 3e-3).abs() < 1e-9);

    // What is wrong is named, and nothing is written.
    std::fs::remove_file(&errors).unwrap();
    let without = |part: &str| -> String {
        let lines = text.lines().filter(|line| !line.starts_with(part));
        lines.map(|line| format!("{line}\n")).collect()
    };
    for (text, expected) in [
        (
            without("3"),
            "ccw has no reading between 28.5 and 40.5 degrees",
        ),
        (
            text.replace(",cw,", ",ccw,"),
            "no readings with direction cw",
        ),
        (text.replace(",cw,", ",back,"), "write ccw or cw"),
        (text.replace("4.5,cw,", "4.5,cw,x"), "is not a number"),
        (
            text.replace("_um", "_mm"),
            "write \"angle_deg,direction,reading_um\"",
        ),
    ] {
        let refused = evaluate(&text).expect_code(3);
        assert!(
            refused.err.contains(expected),
            "{expected}: {}",
            refused.err
        );
        assert!(refused.err.contains("bar.csv"), "{}", refused.err);
        assert!(!std::path::Path::new(&errors).exists());
    }
    // A file of what compensation left is marked as such, and refused as the errors of a machine.
    let marked = folder.path("marked.csv");
    std::fs::write(&bar, &text).unwrap();
    let command = ["calibrate", "ball-bar", "--machine", &machine];
    let files = ["--readings", &bar, "--compensation", "on", "--out", &marked];
    run(&[&command[..], &files].concat()).expect_code(0);
    let of_rest = [&command[..], &["--errors", &marked]].concat();
    let refused = run(&of_rest).expect_code(3);
    assert!(refused.err.contains("compensat"), "{}", refused.err);
    let both = ["--readings", &bar, "--feed", "20"];
    run(&[&["calibrate", "ball-bar"][..], &both].concat()).expect_code(2);

    // The controller compensates from homing on, until the operator ends it.
    let plain = std::fs::read_to_string(&machine).unwrap();
    let compensated = folder.path("compensated.toml");
    let section = format!("\n[compensation]\nchain = \"wYbXZt\"\nerrors = '''\n{written}'''\n");
    std::fs::write(&compensated, plain + &section).unwrap();
    let served = scene::SimServer::on_tcp(&["--machine", &compensated]);
    let run = |command: &[&str]| served.run(&[command, &["--machine", &compensated]].concat());
    run(&["home"]).expect_code(0);
    let faded = |expected: i64| {
        let shown =
            || run(&["status", "--json"]).expect_code(0).json()["compensation_percent"].clone();
        let mut tries = 0;
        while shown() != expected {
            tries += 1;
            assert!(tries < 100, "{} instead of {expected}", shown());
        }
    };
    faded(100);
    run(&["compensation", "off"]).expect_code(0);
    faded(0);
    let reported = run(&["compensation", "on"]).expect_code(0).out;
    assert!(reported.contains("compensation fades in"), "{reported}");
    faded(100);
    let shown = run(&["status"]).expect_code(0).out;
    assert!(shown.contains("compensation  100 %"), "{shown}");
    // A machine without error tables.
    let refused = scene::SimServer::on_tcp(&[]).run(&["compensation", "off"]);
    assert!(refused.err.contains("no error tables"), "{refused:?}");
}
