//! `haptimill machine`: files of earlier formats, fragments, the first cut of a new machine.

use haptimill_client::client::Options;
use haptimill_client::session::{self, Line, NoObserver, Session, SimLine};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

const OLD: &str = include_str!("../../machine-file/tests/data/format-1/h4.toml");

/// A folder of a test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("haptimill-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Runs the command in the folder; returns exit code, standard output and error.
    fn run(&self, arguments: &[&str]) -> (i32, String, String) {
        let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
            .args(arguments)
            .current_dir(&self.0)
            .output()
            .unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (
            ran.status.code().unwrap(),
            text(ran.stdout),
            text(ran.stderr),
        )
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.join(name), text).unwrap();
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.0.join(name)).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn an_old_file_is_refused_with_the_command_that_migrates_it() {
    let folder = Folder::new("migrate");
    folder.write("old.toml", OLD);
    let program = root().join("examples/e11-circle.ngc");
    let remedy = "run `haptimill machine migrate old.toml`";
    for command in [
        &["machine", "check", "old.toml"][..],
        &[
            "run",
            program.to_str().unwrap(),
            "--machine",
            "old.toml",
            "--check",
        ],
        &["kin", "ik", "--machine", "old.toml"],
    ] {
        let (code, _, err) = folder.run(command);
        assert_eq!(code, 3, "{command:?}: {err}");
        assert!(err.contains(remedy), "{command:?}: {err}");
    }

    let (code, out, err) = folder.run(&["machine", "migrate", "old.toml"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("plant.arm became plant.geometry.h4"), "{out}");
    assert!(out.contains("written, no problem"), "{out}");
    assert_eq!(folder.read("old.toml.bak"), OLD);
    let (code, _, err) = folder.run(&["machine", "check", "old.toml"]);
    assert_eq!(code, 0, "{err}");

    // A file of this format is left alone.
    let text = folder.read("old.toml");
    let (code, out, _) = folder.run(&["machine", "migrate", "old.toml"]);
    assert_eq!(code, 0);
    assert!(out.contains("nothing to change"), "{out}");
    assert_eq!(folder.read("old.toml"), text);
}

#[test]
fn migrate_overwrites_neither_a_backup_nor_another_file() {
    let folder = Folder::new("backup");
    folder.write("old.toml", OLD);
    folder.write("old.toml.bak", "mine");
    let (code, _, err) = folder.run(&["machine", "migrate", "old.toml"]);
    assert_eq!(code, 2);
    assert!(err.contains("old.toml.bak: the file exists"), "{err}");
    let (code, _, err) = folder.run(&["machine", "migrate", "old.toml", "-o", "old.toml.bak"]);
    assert_eq!(code, 2, "{err}");
    assert_eq!(folder.read("old.toml.bak"), "mine");
    assert_eq!(folder.read("old.toml"), OLD);

    let (code, _, err) = folder.run(&["machine", "migrate", "old.toml", "-o", "new.toml"]);
    assert_eq!(code, 0, "{err}");
    assert_eq!(folder.read("old.toml"), OLD);
    let (code, _, err) = folder.run(&["machine", "check", "new.toml"]);
    assert_eq!(code, 0, "{err}");
    let (code, _, err) = folder.run(&["machine", "migrate", "none.toml"]);
    assert_eq!(code, 3, "{err}");
}

#[test]
fn a_fragment_is_named_as_one() {
    let file = root().join("machines/follow.toml");
    let (code, _, err) = Folder::new("fragment").run(&["machine", "check", file.to_str().unwrap()]);
    assert_eq!(code, 3);
    assert!(
        err.contains("is a fragment of a machine file: it has [follow] only"),
        "{err}"
    );
    assert!(err.contains("1 problem\n"), "{err}");
    // Nor does `migrate` take sections that every machine file has for a machine file.
    let folder = Folder::new("sections");
    for section in [
        "[[joint]]\nname = \"x\"",
        "[planner]\ncorner_tolerance_mm = 0.01",
    ] {
        let name = section.trim_matches(['[', ']']).split(']').next().unwrap();
        folder.write("part.toml", section);
        let (code, _, err) = folder.run(&["machine", "check", "part.toml"]);
        assert_eq!(code, 3);
        assert!(err.contains(&format!("it has [{name}] only")), "{err}");
        let (code, _, err) = folder.run(&["machine", "migrate", "part.toml"]);
        assert_eq!(code, 0, "{err}");
        let migrated = std::fs::read_to_string(folder.0.join("part.toml")).unwrap();
        assert!(!migrated.contains("format"), "{migrated}");
    }
}

/// First use of a plain mill: template, check, first cut in the simulator.
#[test]
fn a_new_machine_cuts_its_first_pocket() {
    let folder = Folder::new("first-cut");
    let (code, printed, err) = folder.run(&["machine", "init", "mine"]);
    assert_eq!(code, 0, "{err}");
    let (code, out, err) = folder.run(&["machine", "check", "mine.toml"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("mine.toml: no problem"), "{out}");
    // The commands that `init` prints.
    let (mut commands, mut said) = (0, String::new());
    for line in printed.lines() {
        if let Some(command) = line.strip_prefix("  haptimill ") {
            let (code, out, err) = folder.run(&command.split(' ').collect::<Vec<_>>());
            assert_eq!(code, 0, "{command}: {out}{err}");
            commands += 1;
            said += &out;
            said += &err;
        }
    }
    assert_eq!(commands, 2, "{printed}");
    let counted = "position kept (x, y, z: counted steps, not measured)";
    assert!(said.contains(counted), "{said}");
    assert!(folder.0.join("mill3-pocket.out/report.html").exists());
    let (code, out, err) = folder.run(&["replay", "mill3-pocket.out/recording.hmr"]);
    assert_eq!(code, 0, "{out}{err}");

    // The same in this process, to see the stock.
    let machine = MachineFile::load(&folder.0.join("mine.toml")).unwrap();
    let [program, stock] =
        ["mill3-pocket.ngc", "mill3-block.toml"].map(|name| folder.0.join("examples").join(name));
    let removed = removed_mm3(&machine, &program, &stock);
    let swept = swept_mm3();
    assert!(
        (removed / swept - 1.0).abs() < 0.02,
        "{removed} mm^3, not {swept}"
    );
}

/// The example of the four-axis mill turns its rotary axis by ten turns in each pass, and the
/// recording has the degrees.
#[test]
fn the_thread_example_winds_the_axis() {
    let folder = Folder::new("thread");
    let path = |name: &str| root().join(name).to_str().unwrap().to_string();
    let (program, machine) = (
        path("examples/mill4-thread.ngc"),
        path("machines/mill4.toml"),
    );
    let (code, out, err) = folder.run(&["run", &program, "--machine", &machine, "--quiet"]);
    assert_eq!(code, 0, "{out}{err}");
    let trace = std::fs::read_to_string(folder.0.join("mill4-thread.out/trace.csv")).unwrap();
    let mut rows = trace.lines();
    let names: Vec<&str> = rows.next().unwrap().split(',').collect();
    let column = names.iter().position(|name| *name == "a_tool_deg");
    let column = column.unwrap_or_else(|| panic!("{names:?}"));
    let angle = |row: &str| row.split(',').nth(column).unwrap().parse::<f64>().unwrap();
    let max = rows.map(angle).fold(0.0, f64::max);
    assert!((max - 3600.0).abs() < 0.05, "{max}");
}

/// Volume under the ball of 4 mm radius along the path of the program at a depth of 2 mm, summed
/// over cells of 0.1 mm.
fn swept_mm3() -> f64 {
    let beyond = |value: f64, half: f64| (value.abs() - half).max(0.0);
    let mut volume = 0.0;
    for column in -160..160 {
        for row in -110..110 {
            let (x, y) = (
                (f64::from(column) + 0.5) * 0.1,
                (f64::from(row) + 0.5) * 0.1,
            );
            let rows = [-6.0, -2.0, 2.0, 6.0].map(|at| beyond(x, 11.0).hypot(y - at));
            let ends = [-11.0, 11.0].map(|at| (x - at).hypot(beyond(y, 6.0)));
            let distance = rows.into_iter().chain(ends).fold(f64::INFINITY, f64::min);
            let depth = (16.0 - distance * distance).max(0.0).sqrt() - 2.0;
            volume += depth.max(0.0) * 0.01;
        }
    }
    volume
}

/// Volume that a program removes from a stock.
fn removed_mm3(machine: &MachineFile, program: &Path, stock: &Path) -> f64 {
    let model = Model::new(machine);
    let home = session::find_home_pose(machine, &model).unwrap();
    let options = program_options(machine, model.to_engineering_units(&home));
    let text = std::fs::read(program).unwrap();
    let read = haptimill_gcode::read("pocket", &text, &options).unwrap();
    let plan = Plan::new(&read, &settings(machine), &model).unwrap();
    let rig = session::rig(machine, None, None, vec![]).unwrap();
    let mut session = Session::new(
        SimLine::new(rig),
        machine,
        Options::default(),
        Arc::default(),
    );
    session.connect(1).unwrap();
    session.configure(machine).unwrap();
    session.enable().unwrap();
    session.go_home(machine, &home).unwrap();
    let plant: PlantConfig = machine.plant().unwrap();
    let stock = plant.cutting(haptimill_machine_file::stock::load(stock).unwrap());
    session.line_mut().clamp(&stock).unwrap();
    let end = session
        .run_job(2, home, plan.setpoints, &mut NoObserver)
        .unwrap();
    session.check_completed(&end).unwrap();
    let line = session.into_line();
    line.rig()
        .plant()
        .process()
        .unwrap()
        .cutting()
        .unwrap()
        .workpiece()
        .removed_mm3()
}

#[test]
fn the_keys_of_a_section_are_listed() {
    let folder = Folder::new("keys");
    let (code, out, _) = folder.run(&["machine", "keys", "joint.law"]);
    assert_eq!(code, 0);
    assert!(
        out.contains("  rate_filter_ms\n      filter of the rate of the error\n"),
        "{out}"
    );
    assert!(
        out.contains("      ms, 0 to 60; to 50 for the controller, default 0\n"),
        "{out}"
    );
    let (_, all, _) = folder.run(&["machine", "keys"]);
    assert!(all.contains(out.trim_end()), "{all}");
    let (code, _, err) = folder.run(&["machine", "keys", "joints"]);
    assert_eq!(code, 2);
    assert!(err.contains("there is no section `joints`"), "{err}");
}
