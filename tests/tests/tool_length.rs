//! Tools that are longer than that of the machine file, where tool and workpiece turn against each
//! other. The truth is the geometry with the other length: that of the controller, and the true
//! tool of the simulated machine.

use haptimill_gcode::ToolLength;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, settings, tool_axis};
use haptimill_planner::MachineModel;
use haptimill_tests::job;
use haptimill_trace::Record;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A machine file, and which of its two tools are longer: that of the controller, and that of the
/// simulated machine.
fn machine(name: &str, longer: [f64; 2]) -> MachineFile {
    let machines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines");
    let text = std::fs::read_to_string(machines.join(name)).expect("a machine file");
    let mut lengths = longer.into_iter();
    let lines = text.lines().map(|line| match line.strip_prefix("tl = ") {
        Some(rest) => {
            let number = rest.split_whitespace().next().expect("a number");
            let length: f64 = number.parse().expect("a number");
            format!("tl = {:.1}\n", length + lengths.next().expect("two tools"))
        }
        None => format!("{line}\n"),
    });
    let text: String = lines.collect();
    assert!(lengths.next().is_none(), "{name} has not two tools");
    MachineFile::parse(name, &text).unwrap_or_else(|problems| panic!("{problems}"))
}

/// The joints of a pose with a longer tool are those of the machine whose file has that length.
#[test]
fn a_length_is_that_of_a_machine_with_such_a_tool() {
    for (name, turns) in [
        ("h4.toml", [[12.0, 0.0], [0.0, -20.0], [-9.0, 31.0]]),
        (
            "trunnion5.toml",
            [[35.0, 0.0], [0.0, 130.0], [-28.0, -77.0]],
        ),
    ] {
        for longer in [37.5, -20.0] {
            let (file, other) = (machine(name, [0.0; 2]), machine(name, [longer; 2]));
            let tool = ToolLength {
                axis: tool_axis(file.config.model.descriptor()),
                length: longer,
            };
            let home = Model::new(&file).to_engineering_units(&job::home(&file));
            for [first, second] in turns {
                let mut tip = home;
                for (value, part) in tip.iter_mut().zip([7.0, -4.0, 3.0, first, second]) {
                    *value += part;
                }
                let joints = Model::new(&file).joints(&tool.machine_pose(&tip));
                let truth = Model::new(&other).joints(&tip);
                let (joints, truth) = (joints.expect("in reach"), truth.expect("in reach"));
                for (joint, truth) in joints.iter().zip(truth) {
                    assert!((joint - truth).abs() < 1e-4, "{name}: {joint} {truth}");
                }
                let rates = [3.0, -2.0, 1.0, 8.0, -11.0, 0.0];
                let machine_rates = tool.machine_rates(&tip, &rates);
                let joints =
                    Model::new(&file).joint_rates(&tool.machine_pose(&tip), &machine_rates);
                let truth = Model::new(&other).joint_rates(&tip, &rates);
                for (joint, truth) in joints.iter().zip(truth) {
                    assert!((joint - truth).abs() < 1e-3, "{name}: rate {joint} {truth}");
                }
            }
        }
    }
}

/// Runs a program from the home pose; returns the commanded pose and the true tool of each period.
fn run(machine: &MachineFile, text: &str) -> Vec<[[f64; 6]; 2]> {
    let plan = job::plan(machine, text).unwrap_or_else(|refused| panic!("{refused}"));
    let mut session = job::homed(machine, vec![]);
    let folder = tempfile::tempdir().expect("a folder");
    let units: Vec<f64> = settings(machine).pose.iter().map(|it| it.units).collect();
    let motion: Arc<Mutex<Vec<[[f64; 6]; 2]>>> = Arc::default();
    let recorded = Arc::clone(&motion);
    let observe = move |record: &Record| {
        let of = |values: &[i32; 6]| {
            let mut out = [0.0; 6];
            for ((out, value), unit) in out.iter_mut().zip(values).zip(&units) {
                *out = f64::from(*value) / unit;
            }
            out
        };
        let poses = [of(&record.commanded), of(&record.tool)];
        recorded.lock().expect("no panic").push(poses);
    };
    let path = folder.path().join("recording.hmr");
    job::begin_recording(&mut session, &path, &plan, machine, observe);
    job::run(&mut session, 2, machine, &plan);
    job::end_recording(&mut session);
    motion.lock().expect("no panic").clone()
}

/// The true tool, 9.5 mm longer than that of the machine file, keeps its line in the workpiece
/// while the tool turns by many degrees: within the accuracy of the drives, as the tool of the file
/// does. A machine file whose simulated tool is more than 10 mm longer is refused.
#[test]
fn the_true_tip_of_a_longer_tool_keeps_its_line() {
    for (name, turned, back) in [
        ("h4.toml", "B12 A20", "B-10 A-15"),
        ("trunnion5.toml", "A30 C60", "A-15 C-40"),
    ] {
        let off_line = |longer: f64| {
            let machine = machine(name, [0.0, longer]);
            let home = Model::new(&machine).to_engineering_units(&job::home(&machine));
            let [x, y, z] = [home[0], home[1], home[2] + 5.0];
            let text = format!(
                "G21 G90 G61\nG43.1 Z{longer}\nG0 X{x} Y{y} Z{z}\n\
                 G1 X{} Y{} {turned} F300\nX{x} Y{y} {back}\nG49\nM30\n",
                x + 8.0,
                y + 6.0,
            );
            let motion = run(&machine, &text);
            let is_turned = |pose: &[f64; 6]| (3..5).any(|k| (pose[k] - home[k]).abs() > 0.01);
            let turning = motion.iter().filter(|[commanded, _]| is_turned(commanded));
            let length = ToolLength {
                axis: tool_axis(machine.config.model.descriptor()),
                length: longer,
            };
            let mut max = [0.0f64; 3];
            let mut count = 0;
            for [commanded, tool] in turning {
                // The line has the direction (0.8, 0.6, 0).
                let off = |at: &[f64; 6], z: f64| {
                    let (along, across) = (at[0] - x, at[1] - y);
                    (0.8 * across - 0.6 * along).hypot(at[2] - z)
                };
                let tip = length.tip_pose(commanded);
                let off = [off(commanded, z + longer), off(tool, z), off(&tip, z)];
                max = std::array::from_fn(|k| max[k].max(off[k]));
                count += 1;
            }
            assert!(count > 1000, "{name}: {count} periods");
            println!("{name}, {longer} mm longer: {max:.4?}");
            max
        };
        let (file, longer) = (off_line(0.0), off_line(9.5));
        // The pose of the machine is no line along Z from that of the tip.
        assert!(longer[0] > 1.0, "{name}: {longer:?}");
        // The setpoints and the cubic between them are within 0.2 um of the line of the tip.
        assert!(
            longer[2] < 2e-4 && file[2] < 2e-4,
            "{name}: {longer:?}, {file:?}"
        );
        assert!(longer[1] < file[1] + 0.005, "{name}: {longer:?}, {file:?}");
        assert!(file[1] < 0.05, "{name}: {file:?}");
    }
}
