//! `haptimill probe edge`, `boss` and `tool` at the block and the tool setter of the simulator.

use crate::scene::{RunResult, SimServer, TestFolder, haptimill, number, root};
use haptimill_machine_file::work_data::WorkData;

/// A served mill with the block 100..140 x 60..95 up to Z0, and a setter up to Z20. Its ball has a
/// radius of 1 mm.
struct Scene {
    folder: TestFolder,
    machine: String,
    served: SimServer,
}

impl Scene {
    fn new() -> Self {
        let folder = TestFolder::new();
        let text = std::fs::read(root().join("machines/mill3-servo.toml")).unwrap();
        let machine = folder.file("mill.toml", text);
        let served = SimServer::on_tcp(&["--machine", &machine]);
        let scene = Self {
            folder,
            machine,
            served,
        };
        scene.run(&["home"]).expect_code(0);
        scene
    }

    fn run(&self, command: &[&str]) -> RunResult {
        let on = ["--machine", &self.machine];
        self.served.run(&[command, &on[..]].concat())
    }

    fn kept(&self) -> WorkData {
        WorkData::load(std::path::Path::new(&self.machine)).unwrap()
    }

    fn run_ok(&self, command: &[&str]) -> RunResult {
        self.run(command).expect_code(0)
    }
}

#[test]
fn edges_and_centres_become_the_zero_of_a_work_offset() {
    let scene = Scene::new();
    scene.run_ok(&["mdi", "G0 Z50", "G0 X122 Y75", "G0 Z6"]);
    let top = ["probe", "edge", "z=-20", "--radius", "0", "--set", "g54"];
    scene.run_ok(&[&top[..], &["--to", "2"]].concat());
    let z = scene.kept().offsets.systems[0].origin[2];
    assert!((z + 2.0).abs() < 0.02, "{z}");

    // From beside the middle: the cycle finds the middle all the same.
    let boss = [
        "probe", "boss", "--size", "40x35", "--depth", "8", "--radius", "1",
    ];
    let more = [
        "--search-feed",
        "1500",
        "--clearance",
        "4",
        "--set",
        "g55",
        "--json",
    ];
    let found = scene.run_ok(&[&boss[..], &more[..]].concat()).json();
    for (name, expected) in [
        ("x", 120.0),
        ("y", 77.5),
        ("size_x", 40.0),
        ("size_y", 35.0),
    ] {
        let value = number(&found, name);
        assert!((value - expected).abs() < 0.03, "{name} in {found:#}");
    }
    let status = scene.served.status_of(&scene.machine);
    assert!(
        (number(&status["commanded"], "x") - 120.0).abs() < 0.02,
        "{status:#}"
    );
    let offsets = scene.kept().offsets;
    assert!(
        (offsets.systems[1].origin[1] - 77.5).abs() < 0.02,
        "{offsets:?}"
    );
    assert_eq!(offsets.systems[0].origin[2], z);

    // Nothing within reach: an error, and the probe is back at its start.
    let missed = scene
        .run(&["probe", "edge", "z=-2", "--radius", "0"])
        .expect_code(8);
    assert!(
        missed.err.contains("without a contact of probe"),
        "{}",
        missed.err
    );
    let status = scene.served.status_of(&scene.machine);
    assert!(
        (number(&status["commanded"], "z") - 6.0).abs() < 1e-4,
        "{status:#}"
    );
}

#[test]
fn an_offset_that_cannot_be_set_is_refused_before_the_probe_moves() {
    let scene = Scene::new();
    // No contact within 1 mm: a cycle that moves ends with exit code 8.
    let probe = ["probe", "edge", "z=-1", "--radius", "0", "--set"];
    scene
        .folder
        .file("mill.offsets.toml", "[g55]\nrotation = 10.0\n");
    scene.folder.file("mill.offsets.toml.bak", "");
    for (system, code, why) in [
        ("g99", 2, "no work coordinate system"),
        ("g55", 4, "rotation=0"),
        ("g54", 8, "without a contact"),
    ] {
        let refused = scene.run(&[&probe[..], &[system]].concat());
        let refused = refused.expect_code(code);
        assert!(refused.err.contains(why), "{}", refused.err);
    }
}

#[test]
fn a_tool_is_measured_into_the_tool_table() {
    let scene = Scene::new();
    scene
        .folder
        .file("mill.tools.toml", "[t3]\nz = 5.0\ndiameter = 4.0\n");
    scene.run_ok(&["mdi", "G0 Z60", "G0 X-130 Y-85", "G0 Z28"]);
    let measure = ["probe", "tool", "--tool", "3", "--height", "-10"];
    scene.run_ok(&measure);
    let tool = scene.kept().tools[&3];
    assert!((tool.offset[2] - 30.0).abs() < 0.02, "{tool:?}");
    assert_eq!(tool.diameter, 4.0);
    // A damaged table is refused with its backup before anything moves.
    scene.folder.file("mill.tools.toml", "[t3");
    let refused = scene.run(&measure).expect_code(3);
    assert!(
        refused.err.contains("mill.tools.toml.bak"),
        "{}",
        refused.err
    );
}

/// On a tilted table the setter does not measure the length of a tool.
#[test]
fn a_tool_is_measured_only_along_z() {
    let folder = TestFolder::new();
    let text = std::fs::read_to_string(root().join("machines/trunnion5.toml")).unwrap();
    let (controller, plant) = text.split_once("\n[plant]\n").unwrap();
    let text = format!(
        "{controller}\n[[input]]\nname = \"setter\"\nfunction = \"tool_setter\"\nchannel = 1\n\
         active = \"high\"\nfilter_ms = 0\ncontact = \"fault\"\n\n[plant]\n{plant}\n\
         [[plant.input]]\nname = \"setter\"\nchannel = 1\n\n[plant.tool_setter]\n\
         input = \"setter\"\nlow = [-80.0, -60.0, -60.0]\nhigh = [-40.0, -20.0, 20.0]\n\
         radius = 0.0\n"
    );
    // The true tool is 5 mm longer than that of the machine file.
    let (before, after) = text.rsplit_once("\ntl = 100.0").unwrap();
    let machine = folder.file("own.toml", format!("{before}\ntl = 105.0{after}"));
    let served = SimServer::on_tcp(&["--machine", &machine]);
    let run = |command: &[&str]| served.run(&[command, &["--machine", &machine]].concat());
    run(&["home"]).expect_code(0);
    let measure = |height: &str| run(&["probe", "tool", "--tool", "1", "--height", height]);
    run(&["mdi", "G0 Z60", "G0 X-60 Y-40", "G0 Z40"]).expect_code(0);
    measure("20").expect_code(0);
    let kept = WorkData::load(std::path::Path::new(&machine)).unwrap();
    let length = kept.tools[&1].offset[2];
    assert!((length - 5.0).abs() < 0.02, "{length}");
    run(&["mdi", "G0 A30"]).expect_code(0);
    let refused = measure("20").expect_code(8);
    assert!(
        refused.err.contains("does not stand along Z"),
        "{}",
        refused.err
    );
}

#[test]
fn cycles_refuse_what_they_cannot_use() {
    let served = SimServer::on_tcp(&[]);
    served.run_ok(&["home"]);
    let no_probe = served
        .run(&["probe", "edge", "z=-2", "--radius", "0"])
        .expect_code(2);
    assert!(no_probe.err.contains("has no probe"), "{}", no_probe.err);
    let scene = Scene::new();
    let edge = |axis: &str| {
        let ran = scene.run(&["probe", "edge", axis, "--radius", "0"]);
        ran.expect_code(2).err
    };
    assert!(edge("q=1").contains("no coordinate 'q'"));
    assert!(edge("z=0").contains("largest distance"));
    scene
        .run(&["probe", "bore", "--reach", "-1"])
        .expect_code(2);
    scene
        .run(&["probe", "boss", "--size", "0", "--depth", "2"])
        .expect_code(2);
}

/// A part program probes the top of the block, goes on from the contact, and waits for an input
/// that does not come.
#[test]
fn a_program_with_probe_moves_runs_in_parts() {
    let machine = "machines/mill3-servo.toml";
    let served = SimServer::on_tcp(&["--machine", machine]);
    let folder = TestFolder::new();
    let text = "G21 G90\nG0 Z50\nG0 X120 Y75\nG0 Z10\nG38.2 Z-20 F120\n#1=#5063\nG0 Z[#1+5]\n\
                G38.3 Z[#1+2] F120\nO1 if [#5070 EQ 0]\nG0 Z[#1+7]\nO1 endif\n\
                M66 P4 L4 Q0.2\nG0 X[120+#5399]\nM30\n";
    let file = folder.file("probe.ngc", text);
    let run = [
        "run",
        &file,
        "--machine",
        machine,
        "--out",
        &folder.path("out"),
        "--json",
    ];
    // Nothing is recorded, so there are no figures; standard output is a document all the same.
    let document = served.run_ok(&run).json();
    assert_eq!(document["program"], "probe.ngc", "{document:#}");
    assert_eq!(document["completed"], true, "{document:#}");
    let status = served.status_of(machine);
    let at = |name: &str| number(&status["commanded"], name);
    // The top is Z0. The second move found nothing, and the input stayed on: #5399 is -1.
    assert!((at("z") - 7.0).abs() < 0.05, "{status:#}");
    assert!((at("x") - 119.0).abs() < 1e-3, "{status:#}");
    // The program ends at a probe move without a contact, with its place.
    let file = folder.file("missed.ngc", "G90 G0 Z20\nG38.2 Z15 F120\nG0 X0\nM30\n");
    let run = [
        "run",
        &file,
        "--machine",
        machine,
        "--out",
        &folder.path("out"),
    ];
    let missed = served.run(&run).expect_code(8);
    assert!(
        missed.err.contains("missed.ngc:2:7: the probe move ended"),
        "{}",
        missed.err
    );
    // A machine without a probe refuses it before anything moves; a check as well.
    for more in [&[][..], &["--check"]] {
        let file = folder.file("none.ngc", "G38.2 Z15 F120\n");
        let refused = haptimill(&[&["run", &file][..], more].concat()).expect_code(4);
        assert!(
            refused.err.contains("none.ngc:1:7: G38.2: "),
            "{}",
            refused.err
        );
        assert!(refused.err.contains("has no probe"), "{}", refused.err);
    }
}
