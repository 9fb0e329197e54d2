//! `haptimill mdi` and `jog --by` on a served simulator.

use crate::scene::{SimServer, TestFolder, number, start_with};
use std::process::Stdio;

fn commanded(value: &serde_json::Value, name: &str) -> f64 {
    number(&value["commanded"], name)
}

fn near(value: f64, expected: f64) -> bool {
    (value - expected).abs() < 1e-4
}

#[test]
fn blocks_move_the_machine_and_keep_their_modes() {
    let served = SimServer::on_tcp(&[]);
    let refused = served.run(&["mdi", "G0 X1"]).expect_code(8);
    assert!(refused.err.contains("not homed"), "{}", refused.err);
    served.run_ok(&["home"]);
    let moved = served.run_ok(&["mdi", "G91 G20", "G1 F20 X0.1", "Y-0.1", "--json"]);
    let moved = moved.json();
    assert!(near(commanded(&moved, "x"), 2.54), "{moved:#}");
    assert!(near(commanded(&moved, "y"), -2.54), "{moved:#}");
    // A mistake names its place, and nothing moves.
    let refused = served.run(&["mdi", "G1 X5"]).expect_code(3);
    assert!(refused.err.starts_with("mdi:1:"), "{}", refused.err);
    assert!(refused.err.contains("feed"), "{}", refused.err);
    let refused = served.run(&["mdi", "G0 X3", "G0 X500"]).expect_code(4);
    assert!(refused.err.contains("mdi:2:"), "{}", refused.err);
    // Without a terminal nobody can fit a tool.
    let refused = served.run(&["mdi", "T3 M6"]).expect_code(2);
    assert!(refused.err.contains("M61 Q"), "{}", refused.err);
    // All blocks are checked before the first one runs.
    let status = served.status();
    assert!(near(commanded(&status, "x"), 2.54), "{status:#}");
    assert!(near(commanded(&status, "y"), -2.54), "{status:#}");
    // Also before the drives are switched on.
    served.run_ok(&["disable"]);
    for (blocks, code) in [(["G0 X1", "G1 X5"], 3), (["G0 X1", "G0 X500"], 4)] {
        let command = [&["mdi"], &blocks[..]].concat();
        let refused = served.run(&command).expect_code(code);
        assert!(refused.err.contains("mdi:2:"), "{}", refused.err);
        assert_eq!(served.status()["state"], "Disabled");
    }
    let moved = served.run_ok(&["mdi", "G91 G0 X1", "X1", "--json"]).json();
    assert!(near(commanded(&moved, "x"), 4.54), "{moved:#}");
}

#[test]
fn blocks_come_from_standard_input() {
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let folder = TestFolder::new();
    let lines = folder.file("lines", "#1=4 G91\n\nG0 X#1\nG0 X#1\nG0 X9999\nG0 Y1\n");
    let input = Stdio::from(std::fs::File::open(lines).unwrap());
    let ran = start_with(&["mdi", "--port", &served.port], input).end();
    // A script ends at the block that is refused.
    let ran = ran.expect_code(4);
    assert!(ran.out.contains("X8.0000 Y0.0000"), "{}", ran.out);
    assert!(ran.out.contains("G0 G17 G21 G91"), "{}", ran.out);
    let status = served.status();
    assert!(near(commanded(&status, "x"), 8.0), "{status:#}");
    assert!(near(commanded(&status, "y"), 0.0), "{status:#}");
}

#[test]
fn an_offset_of_a_block_is_kept_beside_the_machine_file() {
    let folder = TestFolder::new();
    let machine = folder.machine_with("");
    let served = SimServer::on_tcp(&["--machine", &machine]);
    let on = ["--machine", &machine];
    served.run_ok(&[&["home"], &on[..]].concat());
    served.run_ok(&[&["mdi", "G0 X5", "G10 L20 P1 X1"], &on[..]].concat());
    let kept = folder.read("own.offsets.toml");
    assert!(kept.contains("[g54]\nx = 4.0"), "{kept}");
    let ran = served.run_ok(&[&["mdi", "G54 G0 X0", "--json"], &on[..]].concat());
    assert!(near(commanded(&ran.json(), "x"), 4.0), "{}", ran.out);
    // So is a tool.
    served.run_ok(&[&["mdi", "G10 L1 P3 Z50 R2"], &on[..]].concat());
    let kept = folder.read("own.tools.toml");
    assert!(
        kept.contains("[t3]\nz = 50.0") && kept.contains("diameter = 4.0"),
        "{kept}"
    );
    // A damaged file is refused, with the name of its backup.
    served.run_ok(&[&["mdi", "G10 L2 P2 Y1"], &on[..]].concat());
    folder.file("own.offsets.toml", "[g54\nx = 1");
    served.run_ok(&["disable"]);
    let refused = served.run(&[&["mdi", "G0 X0"], &on[..]].concat());
    let refused = refused.expect_code(3);
    assert!(
        refused.err.contains("own.offsets.toml.bak"),
        "{}",
        refused.err
    );
    // Nor are the drives switched on.
    assert_eq!(served.status_of(&machine)["state"], "Disabled");
}

/// The length of a tool turns with the table: the tip keeps its place in the workpiece. A program
/// with tools of two lengths runs, also from a line behind the change.
#[test]
fn a_tool_length_turns_with_the_table() {
    let machine = "machines/trunnion5.toml";
    let folder = TestFolder::new();
    let own = folder.path("own.toml");
    std::fs::copy(crate::scene::root().join(machine), &own).unwrap();
    folder.file("own.tools.toml", "[t1]\nz = 30.0\n\n[t2]\nz = -12.0\n");
    let served = SimServer::on_tcp(&["--machine", &own]);
    let on = ["--machine", &own];
    served.run_ok(&[&["home"], &on[..]].concat());
    let home = served.status_of(&own);
    let [y, z] = ["y", "z"].map(|name| commanded(&home, name));
    let turned = ["mdi", "G43 H1", "G0 A30", "(PRINT,tip #5421 #5422)"];
    let turned = served.run_ok(&[&turned[..], &on[..]].concat());
    let tip = format!("tip {y:.2} {:.0}", z - 30.0);
    assert!(turned.out.contains(&tip), "{tip}: {}", turned.out);
    let now = served.status_of(&own);
    let angle = 30.0_f64.to_radians();
    assert!(
        near(commanded(&now, "y"), y + 30.0 * angle.sin()),
        "{now:#}"
    );
    let raised = z - 30.0 + 30.0 * angle.cos();
    assert!(near(commanded(&now, "z"), raised), "{now:#}");
    let text = "G21 G90\nT1 M6\nG43 H1\nG0 X10 A20\nT2 M6\nG43 H2\nG0 Z5 A10 C30\n\
                G1 X12 Y3 A-10 F300\nM30\n";
    let part = folder.file("part.ngc", text);
    // A change of the length without a pause, after more setpoints than the look-ahead holds.
    let long = "G21 G90 G43.1 Z40\nG0 Z20\nG1 X40 F240\nX-20 A10\nG49\nG0 Z90\nX0\nM30\n";
    let long = folder.file("long.ngc", long);
    let out = folder.path("out");
    for (program, more) in [
        (&part, &[][..]),
        (&part, &["--stream"]),
        (&part, &["--from-line", "8"]),
        (&long, &[]),
    ] {
        let run = [
            "run",
            program,
            "--machine",
            &own,
            "--skip-pauses",
            "--out",
            &out,
        ];
        crate::scene::haptimill(&[&run[..], more].concat()).expect_code(0);
        let summary = folder.summary("out");
        assert_eq!(summary["completed"], true, "{summary:#}");
        let error = number(&summary, "tool_error_rms_mm");
        assert!(error < 0.02, "{summary:#}");
    }
}

#[test]
fn a_probe_block_finds_the_simulated_block() {
    let machine = "machines/mill3-servo.toml";
    let served = SimServer::on_tcp(&["--machine", machine]);
    let on = ["--machine", machine];
    served.run_ok(&[&["home"], &on[..]].concat());
    // The top of the block is Z0.
    let above = ["mdi", "G0 Z50", "G0 X120 Y75", "G0 Z10"];
    served.run_ok(&[&above[..], &on[..]].concat());
    let probe = ["mdi", "G38.2 Z-20 F120", "G90 G0 Z[#5063+5]"];
    let found = served.run_ok(&[&probe[..], &on[..]].concat());
    assert!(found.out.starts_with("contact at  x 1"), "{}", found.out);
    let z = commanded(&served.status_of(machine), "z");
    assert!((z - 5.0).abs() < 0.05, "{z} in {}", found.out);
    let fast = served.run_ok(&[&["mdi", "G1 Z6 F99999"], &on[..]].concat());
    let notice = "notice: the limits of the machine keep 1 block below the feed";
    assert!(fast.out.contains(notice), "{}", fast.out);
    let missed = served.run(&[&["mdi", "G38.2 Z30 F600"], &on[..]].concat());
    let missed = missed.expect_code(8);
    assert!(
        missed
            .err
            .contains("mdi:1:7: the probe move ended without a change of probe"),
        "{}",
        missed.err
    );
    // A move away from a contact begins in contact.
    let away = served.run(&[&["mdi", "G38.4 Z40 F600"], &on[..]].concat());
    let away = away.expect_code(8).err;
    let what =
        "mdi:1:7: the probe move away begins with probe not in contact; move it into contact";
    assert!(away.contains(what), "{away}");
    // M66: input 4 is on, and is never off within the time.
    let wait = [
        "mdi",
        "M66 P4 L0",
        "G0 X[100+#5399]",
        "M66 P4 L4 Q0.2",
        "G0 Y[70+#5399]",
    ];
    served.run_ok(&[&wait[..], &on[..]].concat());
    let status = served.status_of(machine);
    assert!((commanded(&status, "x") - 101.0).abs() < 1e-3, "{status:#}");
    assert!((commanded(&status, "y") - 69.0).abs() < 1e-3, "{status:#}");
}

#[test]
fn a_jog_by_a_distance_is_exact() {
    let served = SimServer::on_tcp(&[]);
    served.run(&["jog", "--by", "x=5"]).expect_code(8);
    served.run_ok(&["home"]);
    let moved = served
        .run_ok(&["jog", "--by", "x=5", "y=-2.5", "--json"])
        .json();
    assert!(near(commanded(&moved, "x"), 5.0), "{moved:#}");
    assert!(near(commanded(&moved, "y"), -2.5), "{moved:#}");
    let moved = served
        .run_ok(&["jog", "--by", "x=-5", "--feed", "600", "--json"])
        .json();
    assert!(near(commanded(&moved, "x"), 0.0), "{moved:#}");
    served.run(&["jog", "--by", "x=500"]).expect_code(4);
    served.run(&["jog", "--by", "q=5"]).expect_code(2);
    served.run(&["jog", "x=5", "--by", "y=5"]).expect_code(2);
    served
        .run(&["jog", "--by", "x=5", "--feed", "0"])
        .expect_code(2);
}
