//! Result files of a run: earlier results are kept by a failed start, and options without effect
//! are reported.

use crate::scene;
use scene::{TestFolder, haptimill};

const SHORT: &str = "G1 X1 F600\nM30\n";

#[test]
fn failed_start_keeps_earlier_results() {
    let folder = TestFolder::new();
    let (short, out) = (folder.file("short.ngc", SHORT), folder.path("out"));
    let files = ["recording.hmr", "trace.csv", "summary.json", "report.html"];
    haptimill(&["run", &short, "--out", &out]).expect_code(0);
    let before = files.map(|name| std::fs::read(folder.path(&format!("out/{name}"))).unwrap());
    for (more, code) in [
        (["--port", "tcp:127.0.0.1:1"], 5),
        (["--fault", "link-cut"], 5),
        (["--fault", "index-missing joint=l1"], 6),
        (
            [
                "--fault",
                "switch-stuck joint=alpha switch=limit-low active=yes",
            ],
            8,
        ),
    ] {
        haptimill(&["run", &short, "--out", &out, more[0], more[1]]).expect_code(code);
        let after = files.map(|name| std::fs::read(folder.path(&format!("out/{name}"))).unwrap());
        assert!(before == after, "{more:?}");
    }
}

#[test]
fn late_fault_injection_is_reported() {
    let folder = TestFolder::new();
    let (short, out) = (folder.file("short.ngc", SHORT), folder.path("out"));
    let fault = ["--fault", "emergency-stop at=60s"];
    let ran = haptimill(&["run", &short, "--out", &out, fault[0], fault[1]]).expect_code(0);
    let message = "--fault \"emergency-stop at=60s\" was not injected: the run ended at";
    assert!(ran.err.contains(message), "{}", ran.err);
    // It is not listed as injected.
    assert_eq!(folder.summary("out")["injected"], serde_json::json!([]));
    assert!(!folder.read("out/report.html").contains("Injected faults"));
}

#[test]
fn invalid_options_are_refused_before_the_run() {
    let folder = TestFolder::new();
    let short = folder.file("short.ngc", SHORT);
    for (more, code, said) in [
        (&["--check", "--stock", "no.toml"][..], 3, "no.toml"),
        (
            &["--image", "x"],
            2,
            "--image is for --port pil:mps2 or emu:pico2",
        ),
        (&["--log", "x"], 2, "--log is for --port pil:mps2"),
        (&["--budget", "5000"], 2, "--budget is for --port pil:mps2"),
        (
            &["--force", "none", "--force-setpoint", "5"],
            2,
            "--force names none",
        ),
        (
            &["--fault", "drive-weak joint=l1 gain=1e99"],
            2,
            "allowed is -100 to 100",
        ),
        (
            &["--fault", "push joint=l1 effort=1e30"],
            2,
            "allowed is -100000 to 100000",
        ),
        (
            &["--fault", "missed-periods count=0"],
            2,
            "allowed is 1 to 1000000",
        ),
        (
            &["--fault", "emergency-stop for=0s"],
            2,
            "allowed is above 0",
        ),
    ] {
        let words = [&["run", short.as_str()][..], more].concat();
        let ran = haptimill(&words).expect_code(code);
        assert!(ran.err.contains(said), "{}", ran.err);
    }
}

#[test]
fn haptic_arm_is_refused_as_machine() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let arm = ["--machine", "machines/haptic-master.toml"];
    let run = ["run", "examples/e7-slot.ngc", "--out", &out];
    // The port must not be opened.
    let jog = ["jog", "x=1", "--port", "tcp:127.0.0.1:1"];
    for command in [&run[..], &jog] {
        let ran = haptimill(&[command, &arm].concat()).expect_code(3);
        let what = "machines/haptic-master.toml: a haptic arm alone";
        assert!(ran.err.contains(what), "{}", ran.err);
    }
    assert!(!std::path::Path::new(&out).exists());
}
