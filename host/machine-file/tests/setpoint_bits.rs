//! Setpoints of plans keep their bits: changes for speed must not move a machine otherwise.

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use std::fmt::Write as _;

/// Lines with and without a tilt, half circles, a helix, rapid moves, exact stops, corners. `word`
/// is Q of G64 or nothing.
fn program(letters: &str, height: f64, word: &str) -> String {
    let mut text = format!("G21 G90 G17 G64 {word}\nG0 X0 Y0 Z{height}\nG1 F900\n");
    for block in 0..600 {
        let angle = f64::from(block) * 0.05;
        let radius = 10.0 + 5.0 * libm::sin(0.13 * angle);
        let (sin, cos) = libm::sincos(angle);
        let (x, y) = (radius * cos, radius * sin);
        let z = height + 0.5 * libm::sin(0.7 * angle);
        // Writing to a string cannot fail.
        let _ = match block % 50 {
            40 => writeln!(text, "G3 X{:.4} Y{y:.4} R2.5", x + 4.0),
            41 => writeln!(text, "G2 X{x:.4} Y{y:.4} Z{z:.4} R2.5"),
            42 => writeln!(text, "G0 X{:.4} Y{y:.4}", x + 6.0),
            43 => writeln!(text, "G61 G1 X{x:.4} Y{:.4}", y + 3.0),
            44 => writeln!(text, "G64 P0.02 {word} G1 X{x:.4} Y{y:.4}"),
            45.. if letters.len() > 3 => {
                let turn = 0.4 * libm::sin(0.31 * angle);
                let letter = &letters[3..4];
                writeln!(text, "G1 X{x:.4} Y{y:.4} Z{z:.4} {letter}{turn:.4}")
            }
            _ => writeln!(text, "G1 X{x:.4} Y{y:.4} Z{z:.4}"),
        };
    }
    text + "M2\n"
}

/// FNV-1a of the values, without the names of types and fields.
fn digest(plan: &Plan) -> u64 {
    let mut values = Vec::new();
    for setpoint in &plan.setpoints {
        let of_setpoint = (setpoint.periods, &setpoint.pose, &setpoint.rates);
        values.extend(postcard::to_stdvec(&(of_setpoint, setpoint.action)).expect("values"));
    }
    values
        .iter()
        .copied()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        })
}

/// Number of setpoints and digest of the plan on some machines.
fn digests(word: &str) -> Vec<String> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../machines/");
    let mut found = Vec::new();
    for (name, height) in [
        ("h4", 30.0),
        ("mill3-servo", -20.0),
        ("trunnion5", 30.0),
        ("delta3", 30.0),
    ] {
        let path = format!("{folder}{name}.toml");
        let machine = MachineFile::load(std::path::Path::new(&path)).expect("a machine");
        let letters: String = settings(&machine)
            .pose
            .iter()
            .map(|axis| axis.letter)
            .collect();
        let mut start = [0.0; 6];
        start[2] = height;
        let options = program_options(&machine, start);
        let text = program(&letters, height, word);
        let read = haptimill_gcode::read("bits.ngc", text.as_bytes(), &options)
            .unwrap_or_else(|refused| panic!("{name}: {refused}"));
        let plan = Plan::new(&read, &settings(&machine), &Model::new(&machine))
            .unwrap_or_else(|refused| panic!("{name}: {refused}"));
        found.push(format!(
            "{name} {} {:016x}",
            plan.setpoints.len(),
            digest(&plan)
        ));
    }
    found
}

#[test]
fn setpoints_keep_their_bits() {
    // Short lines are not joined.
    assert_eq!(
        digests("Q0"),
        [
            "h4 2700 3ce44aa5a1aed6e9",
            "mill3-servo 2527 ddd00c836d131a7f",
            "trunnion5 2536 ea29ab3d17d9efe5",
            "delta3 2675 6216765a108b5c6a",
        ]
    );
    // They are joined within half of P.
    assert_eq!(
        digests(""),
        [
            "h4 1475 b57c659480462a5e",
            "mill3-servo 1373 cf754c9a8e321038",
            "trunnion5 1376 03517ffe96a0dd09",
            "delta3 1762 8ef9f9fdd8d380d2",
        ]
    );
}
