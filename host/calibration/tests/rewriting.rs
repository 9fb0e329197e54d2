//! Row 36: a program with corrected points against the correction in the controller, by the part
//! that the simulated machine cuts.

use haptimill_calibration::cut::{Cmm, PROGRAM, surface_of_path};
use haptimill_calibration::drive::Machine;
use haptimill_calibration::rewrite::rewritten_for;
use haptimill_calibration::scenario::{MACHINE, MACHINE_NAME, truth, with_exact_tables};
use haptimill_machine_file::MachineFile;
use haptimill_volumetric::errors::{Approach, Function};
use haptimill_volumetric::{Vector, chain};

/// Samples of 1 ms: at 20 mm/s the tool moves straight between them within 0.01 um.
const EVERY: u64 = 5;

/// Errors along another chain have other arms: such a program would be wrong.
#[test]
fn another_chain_is_refused() {
    let file = MachineFile::parse(MACHINE_NAME, MACHINE).unwrap();
    let (text, errors) = truth(&file).unwrap();
    let program = "G21 G90\nG1 X1 F600\nM30\n";
    let other = file.with_errors("e.csv", &text, "wXYbZt").unwrap();
    let refused = rewritten_for(&other, "a.ngc", program, &errors).unwrap_err();
    assert!(
        refused.message.contains("compensation.chain is not"),
        "{refused}"
    );
    let same = file.with_errors("e.csv", &text, "w Y b X Z t").unwrap();
    assert!(rewritten_for(&same, "a.ngc", program, &errors).is_ok());
}

/// Where the tables of a machine state at which points its axes were measured, its program is
/// corrected with the arms from these points: the rotations of the x axis act from the height of
/// its point, those of the table from its point.
#[test]
fn the_points_of_measurement_count() {
    let file = MachineFile::parse(MACHINE_NAME, MACHINE).unwrap();
    let (text, errors) = truth(&file).unwrap();
    let with = file.with_errors("e.csv", &text, "wYbXZt").unwrap().text;
    let points = "x_measured_at_mm = [5.0, 6.0, -30.0]\ny_measured_at_mm = [10.0, 20.0, -40.0]\n\
                  z_measured_at_mm = [1.0, 2.0, 3.0]\nchain =";
    let moved = with.replacen("chain =", points, 1);
    assert_ne!(moved, with);
    let last = |text: &str| {
        let machine = MachineFile::parse("m.toml", text).unwrap();
        let program = "G21 G90\nG1 X80 Y70 Z-10 F600\nM30\n";
        let out = rewritten_for(&machine, "a.ngc", program, &errors).unwrap();
        corrected_points(&out).pop().unwrap()
    };
    let difference = last(&moved) - last(&with);
    let rotation = |name: &str, at: f64| {
        errors
            .function(Function::of_name(name).unwrap())
            .value(at, Approach::Any)
    };
    let turn = |axis: &str, at: f64| {
        Vector::from(["A", "B", "C"].map(|of| rotation(&format!("E{of}{axis}"), at)))
    };
    let expected = turn("X", 80.0).cross(&Vector::new(0.0, 0.0, -30.0))
        + turn("Y", 70.0).cross(&Vector::new(10.0, 20.0, -40.0));
    assert!(expected.norm() > 0.5e-3, "{expected}");
    // A coordinate of a program has six decimals.
    assert!(
        (difference - expected).amax() < 1.5e-6,
        "{difference} {expected}"
    );
}

/// A rewritten move has overrides where the programmed one has them: not in tapping, nor after M49.
#[test]
fn moves_without_overrides_stay_so() {
    let file = MachineFile::parse(MACHINE_NAME, MACHINE).unwrap();
    let (_, errors) = truth(&file).unwrap();
    let program =
        "G21 G90\nG1 X1 F600\nM49\nX2\nM48\nX3\nS300 M3\nG84 X4 Z-1 R2\nG80\nG1 X5\nM30\n";
    let out = rewritten_for(&file, "a.ngc", program, &errors).unwrap();
    let mut is_off = false;
    let mut fixed = Vec::new();
    for line in out.lines() {
        match line {
            "M49" => is_off = true,
            "M48" => is_off = false,
            _ if line.starts_with("G1 ") => fixed.push(is_off),
            _ => {}
        }
    }
    // Runs of moves with and without: X2, and the tapped hole.
    fixed.dedup();
    assert_eq!(fixed, [false, true, false, true, false], "{out}");
}

/// End points of the moves of a program.
fn corrected_points(program: &str) -> Vec<Vector> {
    let moves = program
        .lines()
        .filter(|line| line.starts_with("G0 ") || line.starts_with("G1 "));
    let number = |line: &str, letter: char| -> f64 {
        let words = line.split_whitespace();
        let word = words.clone().find(|word| word.starts_with(letter));
        word.unwrap()[1..].parse().unwrap()
    };
    moves
        .map(|line| Vector::from(['X', 'Y', 'Z'].map(|letter| number(line, letter))))
        .collect()
}

/// Every point of a rewritten program is one of the programmed path less the error there, to the
/// last digit, and the points are at most 1 mm apart: on a line, an arc and a helix.
#[test]
fn every_point_of_a_path_is_corrected() {
    let file = MachineFile::parse(MACHINE_NAME, MACHINE).unwrap();
    let (_, errors) = truth(&file).unwrap();
    // From the point of the program back to that of the path: the error there, found by repetition.
    let model = chain::Model::default();
    let path_of = |corrected: &Vector| {
        let mut at = *corrected;
        for _ in 0..5 {
            at = corrected + model.error(&errors, at);
        }
        at
    };
    let start = Vector::new(60.0, 0.0, -5.0);
    let points = |last: &str| -> Vec<Vector> {
        let program = format!("G21 G90 G17\nG1 X60 Y0 Z-5 F600\n{last}\nM30\n");
        let out = rewritten_for(&file, "a.ngc", &program, &errors).unwrap();
        let all: Vec<Vector> = corrected_points(&out).iter().map(path_of).collect();
        let first = all.iter().position(|at| (at - start).norm() < 1e-5);
        all[first.unwrap()..].to_vec()
    };
    // One pass of the correction leaves 0.2 nm, six decimals 0.5 nm a coordinate.
    let exact = 1.2e-6;
    for (last, count, end) in [
        ("G1 X-70 Y80 Z-38", 150, [-70.0, 80.0, -38.0]),
        ("G3 X60 Y0 I-60 J0", 300, [60.0, 0.0, -5.0]),
        ("G2 X60 Y0 Z-35 I-60 J0", 300, [60.0, 0.0, -35.0]),
    ] {
        let all = points(last);
        assert!(all.len() > count, "{last} {}", all.len());
        for pair in all.windows(2) {
            assert!((pair[1] - pair[0]).norm() < 1.0 + 1e-5, "{last} {pair:?}");
        }
        for at in &all {
            if last.starts_with("G1") {
                let along = Vector::new(-130.0, 80.0, -33.0);
                let off = (at - start).cross(&along.normalize());
                assert!(off.norm() < 2.0 * exact, "{last} {at}");
            } else {
                assert!((at.x.hypot(at.y) - 60.0).abs() < 2.0 * exact, "{last} {at}");
            }
        }
        let last_point = all[all.len() - 1];
        assert!(
            (last_point - Vector::from(end)).amax() < exact,
            "{last} {last_point}"
        );
    }
}

/// Bound of the contour error at 5 mm/s in a characteristic, um, where reversals of two axes are in
/// it; 0 elsewhere.
fn contour_error(characteristic: &str) -> f64 {
    match characteristic {
        "circle 108 roundness" => 0.3,
        "centre hole cylindricity" => 0.5,
        _ => 0.0,
    }
}

#[test]
fn a_rewritten_program_gives_the_same_part() {
    let file = MachineFile::parse(MACHINE_NAME, MACHINE).unwrap();
    // Slow, as the contour error counts as well, and short moves run slower than arcs.
    let original = PROGRAM.replace("#<feed> = 1200", "#<feed> = 300");
    assert_ne!(original, PROGRAM);
    let original = format!("(MSG,part A160)\n{original}");
    let (_, errors) = truth(&file).unwrap();
    let compensated = with_exact_tables(&file).unwrap();
    let mut machine = Machine::new(&compensated, EVERY, &Default::default()).unwrap();
    let cut = |machine: &mut Machine, program: &str| {
        let samples = machine.run("a160.ngc", program).unwrap();
        Cmm::ideal()
            .measure(&surface_of_path(&samples).unwrap())
            .unwrap()
    };
    machine.compensate(true).unwrap();
    let on_line = cut(&mut machine, &original);
    machine.compensate(false).unwrap();
    let before = cut(&mut machine, &original);
    let program = rewritten_for(&file, "a160.ngc", &original, &errors).unwrap();
    assert!(program.contains("(MSG,part A160)"));
    let rewritten = cut(&mut machine, &program);
    let mut improved = 0;
    // What another program, in Python, finds for these errors without dynamics.
    let golden = include_str!("../../volumetric/tests/data/golden_a160_gdt.csv");
    let golden = golden.lines().filter(|line| !line.starts_with('#')).skip(1);
    let physical = golden.map(|line| line.rsplit(',').nth(1).unwrap().parse::<f64>().unwrap());
    let physical: Vec<f64> = physical.collect();
    assert_eq!(physical.len(), before.len());
    for (row, expected) in before.iter().zip(&physical) {
        let um = row.value * 1e3;
        println!(
            "{:<48} {um:>8.3} {expected:>8.3} {:>8.3}",
            row.name,
            um - expected
        );
        let bound = contour_error(&row.name).max(0.05);
        assert!(
            (um - expected).abs() < bound,
            "{}: {um} {expected}",
            row.name
        );
    }
    for ((before, on_line), rewritten) in before.iter().zip(&on_line).zip(&rewritten) {
        let [before, on_line, um] = [before, on_line, rewritten].map(|row| row.value * 1e3);
        // What exact tables leave is the contour error alone.
        let bound = contour_error(&rewritten.name).max(0.1);
        assert!(on_line.abs() < bound, "{}: {on_line}", rewritten.name);
        println!(
            "{:<48} {before:>8.3} {on_line:>8.3} {um:>8.3}",
            rewritten.name
        );
        assert!(
            (um - on_line).abs() < 0.2,
            "{}: {um} {on_line}",
            rewritten.name
        );
        improved += usize::from(before > on_line + 1.0);
    }
    assert!(improved >= 10, "{improved}");
}
