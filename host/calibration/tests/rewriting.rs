//! Row 36: a program with corrected points against the correction in the controller, by the part
//! that the simulated machine cuts.

use haptimill_calibration::cut::{Cmm, PROGRAM, surface_of_path};
use haptimill_calibration::drive::Machine;
use haptimill_calibration::rewrite::rewritten_for;
use haptimill_calibration::scenario::{MACHINE, MACHINE_NAME, truth, with_exact_tables};
use haptimill_machine_file::MachineFile;

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
    for ((before, on_line), rewritten) in before.iter().zip(&on_line).zip(&rewritten) {
        let [before, on_line, um] = [before, on_line, rewritten].map(|row| row.value * 1e3);
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
