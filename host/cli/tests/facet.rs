//! `haptimill facet`: a stone that is not the design, and outputs that are inputs.

use super::scene::{TestFolder, haptimill};

/// A list of five facets for one lap.
const DESIGN: &str = "# gear = 64\n-90,0,1,G\n-90,16,1,G\n-90,32,1,G\n-90,48,1,G\n-0,0,0.4,P\n\
transfer\n0,0,0.4,T\n";

const LAPS: &str = "[[lap]]\nname = \"600\"\nrpm = 600.0\nstock_mm = 0.0\nfeed_mm_s = 0.08\n\
force_n = 3.0\nspark_out_s = 0.5\npreston_mm2_n = 4e-5\n";

const MACHINE: &str = include_str!("../../../machines/facet.toml");

/// The arm of the simulated machine is tilted by two degrees against the machine file: no facet of
/// the stone is one of the design. The results are written, and the exit code is that of lost
/// steps.
#[test]
fn a_stone_that_is_not_the_design_is_an_error() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("laps.toml", LAPS);
    let zero = "theta2_zero_deg = 180.0\n\n[plant.spindle]";
    assert!(MACHINE.contains(zero));
    for (name, zero_deg, code) in [("true", 180.0, 0), ("tilted", 178.0, 6)] {
        let other = format!("theta2_zero_deg = {zero_deg:.1}\n\n[plant.spindle]");
        let machine = folder.file(&format!("{name}.toml"), MACHINE.replace(zero, &other));
        for json in [false, true] {
            let out = folder.path(&format!("{name}-{json}"));
            let mut arguments = vec![
                "facet",
                "run",
                &design,
                "--laps",
                &laps,
                "--machine",
                &machine,
                "--out",
                &out,
                "--quiet",
            ];
            arguments.extend(json.then_some("--json"));
            let run = haptimill(&arguments);
            assert_eq!(run.code, code, "{name}: {}", run.err);
            for file in ["report.html", "stone.json", "job.ngc"] {
                let path = std::path::Path::new(&out).join(file);
                assert!(path.is_file(), "{name}: {file}");
            }
            if json {
                let figures: serde_json::Value = serde_json::from_str(&run.out).unwrap();
                let missing = figures["missing"].as_array().unwrap().len();
                assert_eq!(missing, if code == 0 { 0 } else { 6 });
            }
            let expected = format!(
                "{design}: the stone is not the design: 6 facets are missing, and 6 faces are \
                 not facets"
            );
            let is_told = run.err.contains(&expected) && run.err.contains("report.html");
            assert_eq!(is_told, code == 6, "{name}: {}", run.err);
        }
    }
}

/// No output takes the place of an input.
#[test]
fn inputs_are_not_overwritten() {
    let folder = TestFolder::new();
    let design = folder.file("stone.csv", DESIGN);
    let laps = folder.file("stone.json", LAPS);
    let machine = folder.file("job.ngc", MACHINE);
    let options = ["--laps", &laps, "--machine", &machine];
    for (out, what, text) in [
        (&design, "design", DESIGN),
        (&laps, "file of laps", LAPS),
        (&machine, "machine file", MACHINE),
    ] {
        let run = haptimill(&[&["facet", "plan", &design, "--out", out], &options[..]].concat());
        assert_eq!(run.code, 2, "{}", run.err);
        let expected = format!("{out}: the {what} would be overwritten; name another file");
        assert!(run.err.contains(&expected), "{}", run.err);
        assert_eq!(std::fs::read_to_string(out).unwrap(), text);
    }
    let out = folder.path("");
    let run = haptimill(&[&["facet", "run", &design, "--out", &out], &options[..]].concat());
    assert_eq!(run.code, 2, "{}", run.err);
    assert!(run.err.contains("would be overwritten"), "{}", run.err);
    assert_eq!(std::fs::read_to_string(&laps).unwrap(), LAPS);
}
