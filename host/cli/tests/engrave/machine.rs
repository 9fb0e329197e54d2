//! The engraver cuts a drawing in the simulator: times, the path of the tool, lost steps.

use super::{Folder, plate, root};
use haptimill_machine_file::MachineFile;
use haptimill_trace::{Recording, flag};
use std::process::Command;

/// The machine is that of section 2 of the thesis: 0.005 mm a step in x and y, 0.001 mm in z, 5
/// mm/s at 120 rev/min, 110 x 250 mm, no encoder.
#[test]
fn the_engraver_is_the_machine_of_the_thesis() {
    let machine = MachineFile::load(&root().join("machines/engraver.toml")).unwrap();
    let area: Vec<[f64; 2]> = machine.pose[..2]
        .iter()
        .map(|one| [one.low, one.high])
        .collect();
    assert_eq!(area, [[0.0, 110.0], [0.0, 250.0]]);
    let file: toml::Table = toml::from_str(&machine.text).unwrap();
    let joints = file["joint"].as_array().unwrap();
    let steps: Vec<f64> = joints
        .iter()
        .map(|joint| {
            assert!(
                joint.get("encoder").is_none() && joint["drive"]["kind"].as_str() == Some("step")
            );
            let turn = joint["drive"]["steps_per_turn"].as_integer().unwrap();
            joint["lead_mm"].as_float().unwrap() / turn as f64
        })
        .collect();
    assert_eq!(steps, [0.005, 0.005, 0.001]);
    assert_eq!(5.0 / joints[0]["lead_mm"].as_float().unwrap() * 60.0, 120.0);
    for plant in file["plant"]["joint"].as_array().unwrap() {
        assert_eq!(plant["drive"]["steps"]["phases"].as_integer(), Some(5));
    }
}

/// A circle of 10 mm at 5 mm/s, from the program to the commanded positions: it takes the time of
/// its length, 12.566 s, and that of starting and stopping; its radius is kept within a step.
#[test]
fn the_time_of_a_circle_is_that_of_its_length() {
    let folder = Folder::new("circle");
    folder.write(
        "circle.ngc",
        "G21 G90 G17 G94\nG0 X40 Y30 Z1\nG1 Z0.5 F60\nG3 X40 Y30 I-10 J0 F300\nG0 Z2\nM2\n",
    );
    let machine = root().join("machines/engraver.toml");
    let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(["run", "circle.ngc", "--out", "out", "--quiet", "--machine"])
        .arg(&machine)
        .current_dir(&folder.0)
        .output()
        .unwrap();
    assert!(
        ran.status.success(),
        "{}",
        String::from_utf8_lossy(&ran.stderr)
    );
    let recording = Recording::open(&folder.0.join("out/recording.hmr")).unwrap();
    let units = recording.pose_units();
    let (mut periods, mut worst, mut turned, mut last) = (0_u32, 0.0_f64, 0.0_f64, None);
    let mut steady = 0_u32;
    for record in recording.iter().unwrap() {
        let record = record.unwrap();
        let at: [f64; 2] = std::array::from_fn(|k| f64::from(record.commanded[k]) * units[k]);
        let off = [at[0] - 30.0, at[1] - 30.0];
        if record.line != 4 {
            continue;
        }
        worst = worst.max((off[0].hypot(off[1]) - 10.0).abs());
        let angle = off[1].atan2(off[0]);
        if let Some(before) = last {
            let step: f64 = angle - before;
            let step = step - (step / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            periods += u32::from(step != 0.0);
            turned += step;
            steady += u32::from((0.5..5.5).contains(&turned));
        }
        last = Some(angle);
    }
    let seconds = f64::from(periods) * 200e-6;
    assert!((turned - std::f64::consts::TAU).abs() < 1e-3, "{turned}");
    assert!(worst <= 0.005, "{worst}");
    // 50 mm of the circle at the full feed, within a period; the whole with start and stop.
    assert!(
        (f64::from(steady) * 200e-6 - 10.0).abs() <= 200e-6,
        "{steady}"
    );
    assert!(seconds > 12.566 && seconds < 12.566 + 0.2, "{seconds}");
}

/// Distance of a point from the frame of the plate: a rectangle with rounded corners.
fn off_path(paths: &[haptimill_engrave::geometry::Path], at: [f64; 2]) -> f64 {
    let segments = paths
        .iter()
        .flat_map(haptimill_engrave::geometry::Path::segments);
    segments
        .map(|one| {
            let near = one.point(one.nearest(at));
            (near[0] - at[0]).hypot(near[1] - at[1])
        })
        .fold(f64::INFINITY, f64::min)
}

/// The simulated path of the tool against the entities of the drawing, lines and arcs, in both
/// directions. The commanded path and the steps that leave the controller are within a step of
/// 0.005 mm; the tool is within that and what friction and the swing of the motors add.
#[test]
fn the_tool_of_the_simulator_is_on_the_drawing() {
    let folder = Folder::new("frame");
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--layer",
        "FRAME",
        "--depth",
        "0.2",
        "-o",
        "frame.ngc",
        "--run",
    ]);
    assert_eq!(code, 0, "{result:#}");
    let bytes = std::fs::read(&plate).unwrap();
    let mut drawing =
        haptimill_engrave::read::read(&bytes, &haptimill_engrave::read::ReadOptions::default())
            .unwrap();
    let choice = haptimill_engrave::drawing::LayerChoice {
        only: vec!["FRAME".into()],
        without: Vec::new(),
    };
    drawing.select_layers(&choice).unwrap();
    let recording = Recording::open(&folder.0.join("frame.out/recording.hmr")).unwrap();
    let (units, joint_units) = (recording.pose_units(), recording.joint_units());
    let (mut tool, mut commanded, mut steps) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut cut = Vec::new();
    for record in recording.iter().unwrap() {
        let record = record.unwrap();
        if !record.has(flag::TOOL_TRUE) {
            continue;
        }
        let at: [f64; 3] = std::array::from_fn(|k| f64::from(record.tool[k]) * units[k]);
        let asked: [f64; 2] = std::array::from_fn(|k| f64::from(record.commanded[k]) * units[k]);
        if at[2] < -0.1 {
            tool = tool.max(off_path(&drawing.paths, [at[0], at[1]]));
            commanded = commanded.max(off_path(&drawing.paths, asked));
            // x and y are joints of this machine.
            let made = std::array::from_fn(|k| f64::from(record.joints[k]) * joint_units[k]);
            steps = steps.max(off_path(&drawing.paths, made));
            cut.push([at[0], at[1]]);
        }
    }
    let points = drawing.paths.iter().flat_map(|path| path.points(0.1));
    let missed = points
        .map(|at| {
            let off = cut
                .iter()
                .map(|one: &[f64; 2]| (one[0] - at[0]).hypot(one[1] - at[1]));
            off.fold(f64::INFINITY, f64::min)
        })
        .fold(0.0, f64::max);
    assert!(commanded <= 0.001, "{commanded}");
    // Half a step on each axis is 0.0035 mm across.
    assert!(steps > 0.0 && steps <= 0.0036, "{steps}");
    // Friction and the cutting force turn the motors by a part of a step.
    assert!(tool <= 0.006 && missed <= 0.005, "{tool} {missed}");
}

/// A machine that accelerates its motors beyond their torque loses steps, and the command says so.
#[test]
fn lost_steps_are_found() {
    let folder = Folder::new("lost");
    let machine = std::fs::read_to_string(root().join("machines/engraver.toml")).unwrap();
    let machine = machine
        .replace("acceleration_mm_s2 = 200.0", "acceleration_mm_s2 = 1500.0")
        .replace("acceleration_mm_s2 = 500.0", "acceleration_mm_s2 = 1600.0")
        .replace("jerk_mm_s3 = 4000.0", "jerk_mm_s3 = 900000.0")
        .replace("\nrate_mm_s = 20.0", "\nrate_mm_s = 60.0")
        .replace("\nrate_mm_s = 25.0", "\nrate_mm_s = 65.0");
    folder.write("fast.toml", &machine);
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--operation",
        "drill",
        "--layer",
        "HOLES",
        "--depth",
        "1",
        "--machine",
        "fast.toml",
        "-o",
        "holes.ngc",
        "--run",
    ]);
    assert_eq!(code, 6, "{result:#}");
    let off = result["off_mm"].as_array().unwrap();
    assert!(
        off.iter().any(|off| off.as_f64().unwrap().abs() > 0.05),
        "{result:#}"
    );
}

/// A cutting load beyond the pull-out force of the motors loses whole electrical turns, which are
/// ten full steps of a 5-phase motor; a load within it loses none. The command says where.
#[test]
fn a_load_beyond_the_motors_loses_steps() {
    let folder = Folder::new("load");
    folder.write(
        "hook.dxf",
        "0\nSECTION\n2\nENTITIES\n0\nLINE\n8\n0\n10\n10\n20\n10\n11\n22\n21\n10\n\
         0\nLINE\n8\n0\n10\n22\n20\n10\n11\n22\n21\n18\n0\nENDSEC\n0\nEOF\n",
    );
    let machine = std::fs::read_to_string(root().join("machines/engraver.toml")).unwrap();
    // The largest force is 1.2 N times the scale; 130 N less 20 N of friction move a slide.
    for (scale, is_lost) in [("60.0", false), ("400.0", true)] {
        let loaded = machine.replace("force_scale = 1.0", &format!("force_scale = {scale}"));
        assert_ne!(loaded, machine);
        folder.write("loaded.toml", &loaded);
        let (code, result) = folder.run(&[
            "hook.dxf",
            "--depth",
            "0.5",
            "--machine",
            "loaded.toml",
            "-o",
            "hook.ngc",
            "--run",
        ]);
        let off: Vec<f64> = result["off_mm"]
            .as_array()
            .unwrap()
            .iter()
            .map(|off| off.as_f64().unwrap())
            .collect();
        if !is_lost {
            assert_eq!(code, 0, "{result:#}");
            assert!(off.iter().all(|off| off.abs() < 0.008), "{result:#}");
            assert!(result["lost_at"].is_null(), "{result:#}");
            continue;
        }
        assert_eq!(code, 6, "{result:#}");
        assert!(off[..2].iter().any(|off| off.abs() > 1.0), "{result:#}");
        for off in &off[..2] {
            // 2 * 5 steps of 0.005 mm; friction holds the slide off by a part of a step.
            let turns = (off / 0.05).round();
            assert!((off - turns * 0.05).abs() < 0.008, "{result:#}");
        }
        assert!(
            result["lost_at"]["line"].as_u64().unwrap() > 0,
            "{result:#}"
        );
    }
}
