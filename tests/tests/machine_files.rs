//! Every machine file of `machines/` runs: check, home, a program with all letters, recording and
//! replay. A new machine file needs no row here.

use haptimill_hil_sim::config::PlantConfig;
use haptimill_kinematics::descriptor::{AxisKind, CoordinateDescriptor};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_tests::job;
use haptimill_trace::{Recording, replay};
use std::path::{Path, PathBuf};

/// Largest distance of the simulated tool from the end of the program, mm and degrees. The errors
/// are those of the drives, of backlash and of the home position.
const TOLERANCE: f64 = 0.05;

/// The files of `machines/` that are whole machines with a tool; the others are sections to append.
fn machines() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| {
            let text = std::fs::read_to_string(path).expect("text");
            text.contains("\n[kinematics]")
        })
        .collect();
    files.sort();
    files
}

/// A program that moves every coordinate of the machine away from its home pose and back to 1 mm
/// and 1 degree from it, along lines and an arc. It moves upwards where the home pose is close to
/// the lower soft limit, and no faster than the slowest linear coordinate.
fn program(machine: &MachineFile, home: &[f64]) -> String {
    let axes = machine.config.model.descriptor().pose;
    let point = |is_away: bool| -> String {
        let limits = machine.pose.iter();
        let values = axes
            .iter()
            .zip(home)
            .zip(limits)
            .map(|((axis, at), limits)| {
                let by = match (is_away, axis.kind) {
                    (false, _) => 1.0,
                    (true, AxisKind::Linear) if at - 9.0 < limits.low => 8.0,
                    (true, AxisKind::Linear) => -8.0,
                    (true, AxisKind::Rotary | AxisKind::MultiTurn) => -4.0,
                };
                if limits.wraps() {
                    // The sign is the direction.
                    let sign = if by < 0.0 { "-" } else { "" };
                    return format!(" {}{sign}{:.4}", axis.letter, (at + by).rem_euclid(360.0));
                }
                format!(" {}{:.4}", axis.letter, at + by)
            });
        values.collect()
    };
    let linear = axes.iter().zip(&machine.pose);
    let linear = linear.filter(|(axis, _)| axis.kind == AxisKind::Linear);
    let slowest = linear.map(|(_, limits)| limits.rate).fold(15.0, f64::min);
    format!(
        "G21 G90 F{:.0}\nG1{}\n{}G1{}\nM30\n",
        slowest * 60.0,
        point(true),
        arc(machine, home),
        point(false),
    )
}

/// A half circle in the first plane whose two coordinates the machine has; nothing where it has no
/// plane.
fn arc(machine: &MachineFile, home: &[f64]) -> String {
    let axes = machine.config.model.descriptor().pose;
    let find = |letter: char| {
        let is_it = |axis: &CoordinateDescriptor| axis.letter == letter;
        axes.iter().position(is_it)
    };
    let planes = [
        ("G17", 'X', 'Y', 'I'),
        ("G18", 'Z', 'X', 'K'),
        ("G19", 'Y', 'Z', 'J'),
    ];
    let mut planes = planes.into_iter();
    let found = planes.find_map(|(plane, first, second, centre)| {
        Some((
            plane,
            (first, find(first)?),
            (second, find(second)?),
            centre,
        ))
    });
    let Some((plane, (first, one), (second, two), to_centre)) = found else {
        return String::new();
    };
    let centre = |index: usize| {
        let (at, low) = (home[index], machine.pose[index].low);
        if at - 5.0 < low { at + 5.0 } else { at }
    };
    let (u, v) = (centre(one), centre(two));
    format!(
        "{plane} G1 {first}{:.4} {second}{v:.4}\nG2 {first}{:.4} {second}{v:.4} {to_centre}5\n",
        u - 5.0,
        u + 5.0,
    )
}

#[test]
fn every_machine_file_homes_runs_and_replays() {
    let files = machines();
    assert!(files.len() >= 3, "{files:?}");
    for file in files {
        let machine = MachineFile::load(&file).unwrap_or_else(|problems| panic!("{problems}"));
        let name = machine.config.name.to_string();
        let start = Model::new(&machine).to_engineering_units(&job::home(&machine));
        let plan = job::plan(&machine, &program(&machine, &start))
            .unwrap_or_else(|refused| panic!("{name}: {refused}"));
        let mut session = job::homed(&machine, vec![]);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("recording.hmr");
        job::begin_recording(&mut session, &path, &plan, &machine, |_| ());
        let end = job::run(&mut session, 2, &machine, &plan);
        assert!(end.status.homed, "{name}");
        job::end_recording(&mut session);

        // The simulated tool is at the end of the program.
        let line = session.into_line();
        let truth = line.rig().plant().truth();
        let axes = machine.config.model.descriptor().pose;
        for (index, axis) in axes.iter().enumerate() {
            let off = truth.pose[index] - (start[index] + 1.0);
            println!("{name}: {} {off:+.4}", axis.name);
            assert!(
                off.abs() < TOLERANCE,
                "{name}: {} is off by {off}",
                axis.name
            );
        }
        let recording = Recording::open(&path).expect("readable");
        let equal = replay::replay(&recording).expect("replayable");
        assert!(equal.is_ok(), "{name}: the replay differs");
    }
}

/// The simulated geometry is named in the file; without it the file is refused, and the tool of a
/// machine does not silently become its joint positions.
#[test]
fn a_machine_file_without_a_simulated_geometry_is_refused() {
    for file in machines() {
        let text = std::fs::read_to_string(&file).expect("text");
        let plant: PlantConfig = MachineFile::load(&file)
            .expect("valid")
            .plant()
            .expect("a plant");
        let model = plant.geometry.expect("a geometry").model();
        let key = format!("[plant.geometry.{model}]");
        let start = text.find(&key).expect("the section");
        let length = text[start + 1..].find("\n[").expect("a section behind") + 1;
        let without = format!("{}{}", &text[..start], &text[start + length..]);
        let problems = MachineFile::parse("without", &without).expect_err("refused");
        assert!(
            problems.to_string().contains("[plant.geometry.MODEL]"),
            "{problems}"
        );
    }
}
