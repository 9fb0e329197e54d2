//! Programs rewritten by an error file.

use super::{error_of, machine};
use crate::scene::{TestFolder, haptimill as run};

/// A program is rewritten by an error file; what cannot be rewritten is refused with its line.
#[test]
fn a_program_is_rewritten() {
    let folder = TestFolder::new();
    let errors = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let errors = errors
        .join("../volumetric/data/vmc3_errors.csv")
        .display()
        .to_string();
    let (machine, program, out) = (machine(), folder.path("a.ngc"), folder.path("b.ngc"));
    std::fs::write(&program, "G21 G90\n(MSG,go)\nG1 X80 Y80 Z-10 F600\nM30\n").unwrap();
    let command = ["calibrate", "rewrite", &program, "--machine", &machine];
    let command = [&command[..], &["--errors", &errors, "--out", &out]].concat();
    run(&command).expect_code(0);
    let text = std::fs::read_to_string(&out).unwrap();
    assert!(text.contains("(MSG,go)"), "{text}");
    let last = text.lines().rfind(|line| line.starts_with("G1")).unwrap();
    let words: Vec<f64> = last
        .split_whitespace()
        .filter_map(|word| word[1..].parse().ok())
        .collect();
    let [.., x, y, z] = words[..] else {
        panic!("{last}")
    };
    // The point less the error there, to the last digit of the program.
    let truth = include_str!("../../../volumetric/data/vmc3_errors.csv");
    let point = [80.0, 80.0, -10.0];
    for ((point, error), word) in point.iter().zip(error_of(truth, point)).zip([x, y, z]) {
        assert!((point - error - word).abs() < 1e-6, "{last} {error}");
    }
    let checked = ["run", &out, "--machine", &machine, "--check"];
    run(&checked).expect_code(0);
    // The test piece, with its tools.
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let part = root.join("../../examples/a160.ngc").display().to_string();
    let of_part = ["calibrate", "rewrite", &part, "--machine", &machine];
    run(&[&of_part[..], &["--errors", &errors, "--out", &out]].concat()).expect_code(0);
    let text = std::fs::read_to_string(&out).unwrap();
    let tools: Vec<&str> = text.lines().filter(|line| line.contains("M6")).collect();
    assert_eq!(tools, ["T3 M6", "T2 M6", "T3 M6", "T4 M6"]);
    for program in [&part, &out] {
        run(&["run", program, "--machine", &machine, "--check"]).expect_code(0);
    }
    std::fs::write(&program, "G21 G90\nG1 X10 F600\nG38.2 X20 F60\nM30\n").unwrap();
    let refused = run(&command).expect_code(3);
    assert!(refused.err.contains("a.ngc:3: "), "{}", refused.err);
}

/// Machines with other joints than x, y and z are refused, and no file is written.
#[test]
fn a_program_is_rewritten_for_three_axes_only() {
    let folder = TestFolder::new();
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let errors = root.join("../volumetric/data/vmc3_errors.csv");
    let (errors, out) = (errors.display().to_string(), folder.path("b.ngc"));
    let program = folder.path("a.ngc");
    std::fs::write(&program, "G21 G90\nG1 X1 F600\nM30\n").unwrap();
    for (name, model) in [
        ("h4", "h4"),
        ("mill4", "four_axis"),
        ("trunnion5", "trunnion"),
    ] {
        let machine = root.join(format!("../../machines/{name}.toml"));
        let machine = machine.display().to_string();
        let command = ["calibrate", "rewrite", &program, "--machine", &machine];
        let refused = run(&[&command[..], &["--errors", &errors, "--out", &out]].concat());
        let err = refused.expect_code(3).err;
        let expected =
            format!("{name}.toml: the joints of the model \"{model}\" are not x, y and z");
        assert!(err.contains(&expected), "{err}");
        assert!(!std::path::Path::new(&out).exists());
    }
}
