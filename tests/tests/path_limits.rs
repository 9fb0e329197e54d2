//! Speed, acceleration and jerk of tip and joints in every control period of the simulated machine,
//! by differences of what the controller commands, and the acceleration of the true tool.

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::settings;
use haptimill_machine_file::scale::per_unit;
use haptimill_tests::job;
use haptimill_trace::Record;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Commanded pose, commanded joints and true tool in a period, mm and degrees.
type Derivatives = [[f64; 6]; 3];

/// Runs a program from the home pose on the simulated machine.
fn run(machine: &MachineFile, text: &str) -> Vec<Derivatives> {
    let plan = job::plan(machine, text).unwrap_or_else(|refused| panic!("{refused}"));
    let mut session = job::homed(machine, vec![]);
    let folder = tempfile::tempdir().expect("a folder");
    let motion: Arc<Mutex<Vec<Derivatives>>> = Arc::default();
    let recorded = Arc::clone(&motion);
    let pose_units: Vec<f64> = settings(machine).pose.iter().map(|it| it.units).collect();
    let joint_units: Vec<f64> = machine
        .config
        .joints
        .iter()
        .map(|it| per_unit(it.kind))
        .collect();
    let observe = move |record: &Record| {
        let of = |values: &[i32; 6], units: &[f64]| {
            let mut out = [0.0; 6];
            for ((out, value), unit) in out.iter_mut().zip(values).zip(units) {
                *out = f64::from(*value) / unit;
            }
            out
        };
        recorded.lock().expect("no panic").push([
            of(&record.commanded, &pose_units),
            of(&record.joints_commanded, &joint_units),
            of(&record.tool, &pose_units),
        ]);
    };
    let path = folder.path().join("recording.hmr");
    job::begin_recording(&mut session, &path, &plan, machine, observe);
    job::run(&mut session, 2, machine, &plan);
    job::end_recording(&mut session);
    let motion = motion.lock().expect("no panic").clone();
    assert!(motion.len() > 1000, "{} periods", motion.len());
    motion
}

/// Largest difference of an order over steps of `apart` periods, divided by their time.
fn largest(values: &[f64], order: usize, apart: usize, period: f64) -> f64 {
    let mut values = values.to_vec();
    for _ in 0..order {
        values = values
            .iter()
            .zip(&values[apart..])
            .map(|(a, b)| b - a)
            .collect();
    }
    let time = (apart as f64 * period).powi(order as i32);
    values
        .iter()
        .fold(0.0f64, |max, value| max.max(value.abs()))
        / time
}

/// Lines, corners, arcs, short blocks, rapids and, where the machine has them, rotary moves.
fn program(rotary: &str) -> String {
    let mut text = format!(
        "G21 G90 G91.1 G64 P0.01\nG91\nG0 X8 Y6\nG1 F1200 X10\nY8\nX-5 Y5\nX-5 Y-9 {rotary}\n\
         G2 X6 Y0 I3 J0 F1500\nG3 X3 Y-3 I3 J0\nG1 X-6 Y1 Z2\nG61 G1 X2\nG64\n"
    );
    for number in 0..60 {
        let angle = f64::from(number) * 0.12;
        text += &format!("X{:.4} Y{:.4}\n", 0.5 * angle.cos(), 0.5 * angle.sin());
    }
    text + "G0 X-5 Y-5 Z3\nG0 Z-3 X-3\nM30\n"
}

/// Checks rates, accelerations and jerks of what was commanded. Returns the largest share of each
/// kind of limit.
fn check_limits(name: &str, machine: &MachineFile, motion: &[Derivatives]) -> [f64; 3] {
    let settings = settings(machine);
    let period = f64::from(settings.period_us) * 1e-6;
    let mut used = [0.0f64; 3];
    let mut check = |what: &str, kind: usize, k: usize, limits: [f64; 3], unit: f64| {
        let values: Vec<f64> = motion.iter().map(|all| all[kind][k]).collect();
        // Half a unit of rounding at each of 2, 4 and 8 values.
        for (order, (limit, apart)) in limits.into_iter().zip([5, 10, 20]).enumerate() {
            let time = apart as f64 * period;
            let rounding = f64::from(1 << order) / unit / time.powi(order as i32 + 1);
            let found = largest(&values, order + 1, apart, period);
            let kind = ["rate", "acceleration", "jerk"][order];
            println!("{name} {what}: {kind} {found:.2} of {limit}, rounding {rounding:.3}");
            assert!(
                found <= limit * 1.01 + rounding,
                "{name} {what}: {kind} {found} of {limit}"
            );
            used[order] = used[order].max(found / limit);
        }
    };
    for (k, axis) in settings.pose.iter().enumerate() {
        let limits = [axis.rate, axis.acceleration, axis.jerk];
        check(&axis.letter.to_string(), 0, k, limits, axis.units);
    }
    for (k, joint) in settings.joints.iter().enumerate() {
        let limits = [joint.rate, joint.acceleration, joint.jerk];
        let unit = per_unit(machine.config.joints[k].kind);
        check(&joint.name, 1, k, limits, unit);
    }
    used
}

fn machine(name: &str) -> MachineFile {
    let machines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines");
    MachineFile::load(&machines.join(name)).unwrap_or_else(|problems| panic!("{problems}"))
}

#[test]
fn the_commanded_motion_keeps_its_limits_in_every_period() {
    for (name, rotary, tool) in [
        ("h4.toml", "B3 A-4", ""),
        ("mill3-servo.toml", "", ""),
        ("trunnion5.toml", "A12 C50", ""),
        // A longer tool turns the pose of the machine about the tip.
        ("trunnion5.toml", "A12 C50", "G43.1 Z40\n"),
        ("h4.toml", "B3 A-4", "G43.1 Z50\n"),
    ] {
        let machine = machine(name);
        let motion = run(&machine, &format!("{tool}{}", program(rotary)));
        let used = check_limits(name, &machine, &motion);
        // The bounds are tight: the program uses the limits of the machine.
        assert!(used[1] > 0.9 && used[2] > 0.75, "{name} uses {used:?}");
        // The true tool follows, with the backlash and the noise of the drives.
        let settings = settings(&machine);
        let period = f64::from(settings.period_us) * 1e-6;
        for (k, axis) in settings.pose.iter().enumerate().take(3) {
            let values: Vec<f64> = motion.iter().map(|all| all[2][k]).collect();
            let found = largest(&values, 2, 100, period);
            println!("{name} true {}: acceleration {found:.1}", axis.letter);
            assert!(
                found <= 1.05 * axis.acceleration,
                "{name}: true {} {found}",
                axis.letter
            );
        }
    }
}

/// Paths that touch the soft limits: rounded corners and whole circles, with and without blending.
#[test]
fn a_path_along_the_soft_limits_is_run() {
    let frame = |mode: &str, radius: f64| {
        let (x, y) = (150.0 - radius, 100.0 - radius);
        format!(
            "G21 G90 {mode} F4000\nG0 Z90\nG1 X150 Y-{y}\nG1 Y{y}\nG3 X{x} Y100 I-{radius}\n\
             G1 X-{x}\nG3 X-150 Y{y} J-{radius}\nG1 Y-{y}\nG3 X-{x} Y-100 I{radius}\n\
             G1 X{x}\nG3 X150 Y-{y} J{radius}\nG1 Y0\nG3 X150 Y0 I-30 J0\nG2 X150 Y0 I-7 J0\nM30\n"
        )
    };
    for (name, mode, radius) in [
        ("mill3.toml", "G64", 20.0),
        ("mill3.toml", "G61", 3.0),
        ("mill3.toml", "G64 P1", 35.0),
        ("mill3-servo.toml", "G64", 5.0),
        ("mill3-servo.toml", "G64 P0.5", 11.0),
    ] {
        let machine = machine(name);
        let motion = run(&machine, &frame(mode, radius));
        for [pose, ..] in motion {
            assert!(
                pose[0].abs() <= 150.001 && pose[1].abs() <= 100.001,
                "{pose:?}"
            );
        }
    }
}

/// Blended corners of short lines that turn a longer tool: the machine turns about the tip there.
#[test]
fn blended_corners_with_a_longer_tool_keep_the_limits() {
    for (length, tolerance) in [(50, 0.05), (80, 0.2)] {
        let mut text = format!("G21 G90 G64 P{tolerance}\nG43.1 Z{length}\nG0 X0 Y0 Z5\nF2500\n");
        for number in 0..60 {
            let angle = f64::from(number) * 0.12;
            let at = [
                20.0 * angle.sin(),
                15.0 * (1.3 * angle).cos(),
                20.0 * (0.9 * angle).sin(),
                20.0 * (0.7 * angle).cos(),
            ];
            let [x, y, tilt, rotation] = at;
            text += &format!("G1 X{x:.4} Y{y:.4} B{tilt:.4} A{rotation:.4}\n");
        }
        let machine = machine("h4.toml");
        let motion = run(&machine, &(text + "M30\n"));
        check_limits(&format!("h4.toml, Z{length}"), &machine, &motion);
    }
}

/// With the tool half a degree from the table's axis, a small change of its direction is half a
/// turn of the table: the feed falls to what table and slides can do, and the tip stays on its
/// line.
#[test]
fn past_the_vertical_tool_the_feed_falls() {
    let machine = machine("trunnion5.toml");
    let text = "G21 G90 G61\nG0 X80 Y0 Z5 A0.5\nG91 G0 C-90\nG1 X2 Y1 C180 F3000\nM30\n";
    let planned = job::plan(&machine, text).expect("possible");
    assert_eq!(planned.figures.slowed, 1);
    let motion = run(&machine, text);
    let used = check_limits("trunnion5", &machine, &motion);
    assert!(used[0] > 0.9, "no rate is near its limit: {used:?}");
    // At its feed the move would take 45 ms. The table carries the tip with at most 150 mm/s of a
    // slide, 80 mm from its axis.
    let begin = motion.iter().position(|all| all[0][4] < -89.999);
    let turning = &motion[begin.expect("the table turns")..];
    let turning: Vec<_> = turning
        .iter()
        .filter(|all| all[0][4].abs() < 89.999)
        .collect();
    let seconds = turning.len() as f64 * f64::from(machine.config.period_us) * 1e-6;
    let min = 80.0 * 80.0_f64.to_radians() / 150.0;
    assert!(seconds > min, "{seconds} s");
    for [commanded, _, tool] in turning {
        // From the line, in the workpiece.
        let off = |place: &[f64; 6]| (place[1] - 0.5 * (place[0] - 80.0)).abs() * 0.8_f64.sqrt();
        assert!(off(commanded) < 5e-4, "{} mm off the line", off(commanded));
        assert!(
            off(tool) < 0.05,
            "the tool is {} mm off the line",
            off(tool)
        );
    }
}

/// A polar mill, whose pole is at X-110: a line that passes it keeps the limits of the table, one
/// through it is refused with its place and a remedy.
#[test]
fn a_line_through_the_pole_is_refused_by_its_place() {
    let machine = machine("polar3.toml");
    let past = "G21 G90 G61\nG0 X-88 Y60 Z5\nG1 Y-60 F2400\nM30\n";
    let used = check_limits("polar3", &machine, &run(&machine, past));
    assert!(used[0] > 0.9, "{used:?}");
    let through = "G21 G90\nG0 X-60 Y0 Z5\nG1 X-80 F1800\nX-140\nM30\n";
    let refused = job::plan(&machine, through).map(|plan| plan.figures.duration_s);
    let refused = refused.expect_err("refused");
    assert!(refused.starts_with("test:4:"), "{refused}");
    assert!(
        refused.contains("cannot reach") && refused.contains("; "),
        "{refused}"
    );
}
