//! `haptimill run` from a line on, dry and block by block; zeros; a served stock.

use crate::scene::{SimServer, TestFolder, haptimill, number, start};

const PART: &str = "G21 G90\nS500 M3\nG0 Z30\nG0 X10\nG1 Z20 F600\nX20\nY5\nG0 Z30\nM30\n";

/// Messages of a program reach the operator, planned and streamed; the comment of a pause once.
#[test]
fn messages_of_a_program_are_shown() {
    let folder = TestFolder::new();
    let text = "G21 G90\n(MSG, clamp checked)\nG1 X1 F600\n#1=7\n(PRINT, pass #1)\nX2\n\
                M0 (turn the part)\nX0\n(MSG, all done)\nM30\n";
    let part = folder.file("part.ngc", text);
    let out = folder.path("out");
    for more in [&[][..], &["--stream"], &["--quiet"]] {
        let run = [&["run", &part, "--skip-pauses", "--out", &out], more].concat();
        let ran = haptimill(&run).expect_code(0);
        let shown: Vec<&str> = ran
            .out
            .lines()
            .filter(|line| ["clamp checked", "pass 7", "turn the part", "all done"].contains(line))
            .collect();
        assert_eq!(
            shown,
            ["clamp checked", "pass 7", "all done"],
            "{}",
            ran.out
        );
        let silent = [&run[..], &["--json"]].concat();
        let silent = haptimill(&silent).expect_code(0);
        assert_eq!(silent.json()["completed"], true);
    }
}

#[test]
fn a_program_begins_in_the_middle() {
    let folder = TestFolder::new();
    let part = folder.file("part.ngc", PART);
    let whole = haptimill(&["run", &part, "--check", "--json"])
        .expect_code(0)
        .json();
    let check = haptimill(&["run", &part, "--check", "--from-line", "6"]).expect_code(0);
    assert!(
        check.out.contains("from line 6, at X10.000 Y0.000 Z20.000"),
        "{}",
        check.out
    );
    assert!(check.out.contains("spindle 500 rev/min"), "{}", check.out);
    let out = folder.path("out");
    haptimill(&["run", &part, "--from-line", "6", "--out", &out]).expect_code(0);
    let summary = folder.summary("out");
    assert_eq!(summary["completed"], true, "{summary:#}");
    assert_eq!(number(&whole, "blocks"), 6.0, "{whole:#}");
    // Behind a port the approach is asked, and nobody can answer here.
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let run = ["run", &part, "--from-line", "6", "--out", &out];
    let refused = served.run(&run).expect_code(2);
    assert!(refused.err.contains("add --yes"), "{}", refused.err);
    let ran = served.run_ok(&[&run[..], &["--yes"]].concat());
    assert!(ran.out.contains("Approach: up to Z30.000"), "{}", ran.out);
    let beyond = haptimill(&["run", &part, "--from-line", "60"]).expect_code(3);
    assert!(
        beyond.err.contains("nothing is to be done from line 60"),
        "{}",
        beyond.err
    );
}

#[test]
fn a_dry_run_behind_a_port_names_its_height() {
    let folder = TestFolder::new();
    let part = folder.file("part.ngc", PART);
    let served = SimServer::on_tcp(&[]);
    let run = ["run", &part, "--dry", "--out", &folder.path("out")];
    let refused = served.run(&run).expect_code(2);
    assert!(refused.err.contains("--lift"), "{}", refused.err);
    served.run_ok(&[&run[..], &["--lift", "5"]].concat());
    let status = served.status();
    assert!(
        (number(&status["commanded"], "z") - 35.0).abs() < 1e-4,
        "{status:#}"
    );
    // Without a terminal nobody can press Enter after each block.
    let single = ["run", &part, "--single", "--out", &folder.path("out")];
    let refused = served.run(&single).expect_code(2);
    assert!(refused.err.contains("no terminal"), "{}", refused.err);
    haptimill(&single).expect_code(2);
}

#[test]
fn the_present_position_becomes_a_zero() {
    let folder = TestFolder::new();
    let machine = folder.machine_with("");
    let served = SimServer::on_tcp(&["--machine", &machine]);
    let on = ["--machine", &machine];
    let touch = [&["offset", "touch", "g55", "x=1", "y=-2"], &on[..]].concat();
    let refused = served.run(&touch).expect_code(8);
    assert!(refused.err.contains("not homed"), "{}", refused.err);
    served.run_ok(&[&["home"], &on[..]].concat());
    served.run_ok(&[&["jog", "--by", "x=5"], &on[..]].concat());
    served.run_ok(&touch);
    let kept = folder.read("own.offsets.toml");
    assert!(kept.contains("[g55]\nx = 4.0\ny = 2.0\n"), "{kept}");
    let built_in = SimServer::on_tcp(&[]);
    built_in.run_ok(&["home"]);
    let refused = built_in
        .run(&["offset", "touch", "g54", "x=0"])
        .expect_code(2);
    assert!(refused.err.contains("--machine"), "{}", refused.err);
}

#[test]
fn a_served_machine_gets_a_stock_after_homing() {
    let mut served = SimServer::on_tcp(&["--stock", "examples/block.toml"]);
    served.run_ok(&["home"]);
    served.process.wait_for_error("the stock is clamped");
    // The sensor measures the force of the cut, as its peak in each revolution of the spindle. The
    // controller reports no speed: that is the one of the program.
    let folder = TestFolder::new();
    let slot = "G21 G90 G17\nM3 S5000\nG1 Z20.232 F120\nX-6 F240\nG0 Z23.232\nM5\nM30\n";
    let slot = folder.file("slot.ngc", slot);
    let ran = served.run_ok(&["run", &slot, "--out", &folder.path("out")]);
    let summary = folder.summary("out");
    assert!(number(&summary, "force_max_n") > 1.0, "{summary:#}");
    assert_eq!(summary["tool_is_true"], false);
    assert_eq!(summary["spindle_rpm"], 5000);
    let reported = "\npeak force per revolution (measured): ";
    assert!(ran.out.contains(reported), "{}", ran.out);
    let page = folder.read("out/report.html");
    for part in [
        "Peak force per revolution (measured), rms / largest",
        "<span>peak force, largest</span>",
    ] {
        assert!(page.contains(part), "{part}");
    }
}

/// An installed command has no copy of the repository beside it.
#[test]
fn a_missing_example_or_machine_file_is_told_how_to_write_it() {
    let folder = TestFolder::new();
    let examples = "check the path; `haptimill examples --out .` writes the examples";
    let machines = "check the path; `haptimill machine init` writes a machine file";
    let missing = "examples/nothere.ngc";
    let run = |more: &[&str], code: i32| {
        let out = folder.path("out");
        let run = [&["run"], more, &["--out", &out]].concat();
        haptimill(&run).expect_code(code).err
    };
    for more in [
        &[missing][..],
        &[missing, "--check"],
        &[missing, "--stream"],
    ] {
        let reported = run(more, 3);
        assert!(
            reported.contains("nothere.ngc") && reported.contains(examples),
            "{reported}"
        );
    }
    let part = folder.file("part.ngc", "G21 G90 G1 X1 F100\nM30\n");
    let reported = run(&[&part, "--stock", "examples/nothere.toml"], 3);
    assert!(reported.contains(examples), "{reported}");
    let reported = run(&[&part, "--machine", "machines/nothere.toml"], 3);
    assert!(reported.contains(machines), "{reported}");
    // Elsewhere the path is wrong.
    let reported = run(&[&folder.path("examples/nothere.ngc")], 3);
    assert!(
        reported.contains("check the path") && !reported.contains("writes"),
        "{reported}"
    );
}

#[test]
fn examples_are_written_out_once() {
    let folder = TestFolder::new();
    let listed = start(&["examples"]).end().expect_code(0);
    assert!(listed.out.contains("e11-circle.ngc"), "{}", listed.out);
    let out = folder.path("");
    haptimill(&["examples", "e7-slot.ngc", "--out", &out]).expect_code(0);
    folder.file("examples/e7-slot.ngc", "mine");
    let again = haptimill(&["examples", "--out", &out]).expect_code(0);
    assert!(again.out.contains("exists and is kept"), "{}", again.out);
    assert_eq!(folder.read("examples/e7-slot.ngc"), "mine");
    assert!(folder.read("examples/block.toml").len() > 100);
    haptimill(&["examples", "nothing.ngc"]).expect_code(2);
}
