//! `haptimill kin`: tables of the kinematics.

use super::{haptimill, root, transcript};
use crate::scene;
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_machine_file::MachineFile;
use std::path::PathBuf;

/// A golden table as rows of cells, with its column names.
fn table(text: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names = reader
        .headers()
        .unwrap()
        .iter()
        .map(str::to_string)
        .collect();
    let rows = reader.records();
    let rows = rows.map(|row| row.unwrap().iter().map(str::to_string).collect());
    (names, rows.collect())
}

fn golden(name: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let path = root().join("tests/golden").join(name);
    table(&std::fs::read_to_string(path).unwrap())
}

#[test]
fn forward_kinematics_match_the_golden_table() {
    let (names, rows) = golden("h4_ik.csv");
    let ran = haptimill(
        &["kin", "ik", "--strokes", "--in", "tests/golden/h4_ik.csv"],
        "",
    );
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    let (header, results) = table(&ran.out);
    let columns = [
        "l1_mm",
        "l2_mm",
        "l3_mm",
        "l4_mm",
        "alpha_deg",
        "singularity_mm",
        "status",
    ];
    assert_eq!(header, columns);
    assert_eq!(results.len(), rows.len());
    // Ends of the strokes of machines/h4.toml.
    let ends = [
        (885.0, 1385.0),
        (235.0, 735.0),
        (885.0, 1385.0),
        (235.0, 735.0),
    ];
    let (mut inside, mut outside) = (0, 0);
    for (row, result) in rows.iter().zip(&results) {
        let alpha: f64 = row[4].parse().unwrap();
        let mut in_stroke = alpha.abs() <= 45.0;
        for slide in 0..4 {
            let column = names
                .iter()
                .position(|name| *name == header[slide])
                .unwrap();
            let commanded: f64 = row[column].parse().unwrap();
            let given: f64 = result[slide].parse().unwrap();
            assert!((commanded - given).abs() < 1e-4, "{row:?} gave {result:?}");
            assert_eq!(result[slide].split_once('.').unwrap().1.len(), 9);
            in_stroke &= commanded >= ends[slide].0 && commanded <= ends[slide].1;
        }
        let status = if in_stroke { "ok" } else { "out_of_stroke" };
        assert_eq!(result[6], status, "{row:?} gave {result:?}");
        // The rotary joint is the coordinate: the resolution is 84 ndeg.
        let turned: f64 = result[4].parse().unwrap();
        assert!((alpha - turned).abs() < 1e-7, "{row:?} gave {result:?}");
        let distance: f64 = result[5].parse().unwrap();
        assert!(distance > 0.0, "{row:?} gave {result:?}");
        *(if in_stroke { &mut inside } else { &mut outside }) += 1;
    }
    assert!(
        inside > 1000 && outside > 100,
        "{inside} inside, {outside} outside"
    );
}

#[test]
fn unreachable_poses_have_no_joint_positions() {
    let ran = haptimill(
        &["kin", "ik", "--in", "tests/golden/h4_unreachable.csv"],
        "",
    );
    let (_, results) = table(&ran.out);
    assert_eq!(results.len(), 200);
    for result in results {
        assert_eq!(result[..5], ["", "", "", "", ""]);
        assert_eq!(result[6], "unreachable");
    }
}

#[test]
fn inverse_kinematics_match_the_golden_table() {
    // The golden poses are in the frame of the base; machines/h4.toml has the origin of the work at
    // p + x_off = 810 mm along x, and at h = 600 mm below along z.
    let (_, rows) = golden("h4_fk.csv");
    let folder = scene::TestFolder::new();
    let mut joints = String::from("alpha_deg,l1_mm,l2_mm,l3_mm,l4_mm\n");
    for row in &rows {
        joints.push_str(&format!("0,{}\n", row[..4].join(",")));
    }
    let joints = folder.file("joints.csv", joints);
    let ran = haptimill(&["kin", "fk", "--in", &joints], "");
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    let (header, results) = table(&ran.out);
    let columns = [
        "x_mm",
        "y_mm",
        "z_mm",
        "theta_deg",
        "alpha_deg",
        "singularity_mm",
        "status",
    ];
    assert_eq!(header, columns);
    assert_eq!(results.len(), rows.len());
    for (row, result) in rows.iter().zip(&results) {
        assert_eq!(result[6], "ok", "{row:?}");
        for (column, offset) in [810.0, 0.0, -600.0, 0.0].into_iter().enumerate() {
            let commanded: f64 = row[4 + column].parse().unwrap();
            let value = offset + result[column].parse::<f64>().unwrap();
            // 0.1 um; 1 urad is 5.7e-5 degrees.
            let bound = if column < 3 { 1e-4 } else { 5.7e-5 };
            assert!((commanded - value).abs() < bound, "{row:?} gave {result:?}");
        }
    }
}

/// Tables of every whole machine: forward kinematics of the joints of a grid of poses give the
/// poses, under the names of the descriptor.
#[test]
fn tables_of_every_machine_invert_each_other() {
    let folder = scene::TestFolder::new();
    for descriptor in haptimill_kinematics::DESCRIPTORS {
        let file = machine_of(descriptor.code);
        let machine = MachineFile::load(&root().join(&file)).unwrap();
        let mut arguments = vec!["kin".to_string(), "ik".to_string(), "--strokes".to_string()];
        arguments.extend(["--machine".to_string(), file.clone()]);
        // A hundred poses or more: the strokes leave out the corners of the grid.
        let axes = descriptor.pose.len() as u32;
        let levels = (4_usize..).find(|levels| levels.pow(axes) >= 100).unwrap();
        for axis in &machine.pose {
            // A coordinate that wraps around has no limits.
            let (low, high) = match axis.low.is_finite() {
                true => (axis.low, axis.high),
                false => (-150.0, 150.0),
            };
            let step = (high - low) / (levels - 1) as f64;
            arguments.push("--grid".to_string());
            arguments.push(format!("{}={low}:{high}:{step}", axis.name));
        }
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let ran = haptimill(&arguments, "");
        assert_eq!((ran.code, ran.err.as_str()), (0, ""), "{file}");
        let (header, results) = table(&ran.out);
        let axes = descriptor.pose.len();
        assert_eq!(results.len(), levels.pow(axes as u32), "{file}");
        let singular = usize::from(header.contains(&"singularity_mm".to_string()));
        assert_eq!(header.len(), 2 * axes + singular + 1, "{file}: {header:?}");
        let reached: Vec<_> = results
            .iter()
            .filter(|row| row.last().is_some_and(|status| status == "ok"))
            .collect();
        assert!(reached.len() > 20, "{file}: {} poses", reached.len());
        let unit = |kind| match kind {
            AxisKind::Linear => "mm",
            AxisKind::Rotary | AxisKind::MultiTurn => "deg",
        };
        let joints = descriptor.joints.iter();
        let names: Vec<_> = joints
            .map(|joint| format!("{}_{}", joint.name, unit(joint.kind)))
            .collect();
        let mut text = names.join(",") + "\n";
        for row in &reached {
            text.push_str(&(row[axes..2 * axes].join(",") + "\n"));
        }
        let joints = folder.file("joints.csv", text);
        let ran = haptimill(&["kin", "fk", "--machine", &file, "--in", &joints], "");
        assert_eq!((ran.code, ran.err.as_str()), (0, ""), "{file}");
        let (header, poses) = table(&ran.out);
        for (index, axis) in descriptor.pose.iter().enumerate() {
            assert_eq!(header[index], format!("{}_{}", axis.name, unit(axis.kind)));
        }
        for (row, pose) in reached.iter().zip(&poses) {
            assert_eq!(pose.last().unwrap(), "ok", "{file}: {row:?}");
            for index in 0..axes {
                let commanded: f64 = row[index].parse().unwrap();
                let value: f64 = pose[index].parse().unwrap();
                // 1 um and 60 urad: the joints have the resolution of the controller.
                let bound = if descriptor.pose[index].kind == AxisKind::Linear {
                    1e-3
                } else {
                    3.4e-3
                };
                assert!(
                    (commanded - value).abs() < bound,
                    "{file}: {row:?} {pose:?}"
                );
            }
        }
    }
}

/// The first file of `machines/` of a model.
fn machine_of(model: &str) -> String {
    let mut files: Vec<PathBuf> = std::fs::read_dir(root().join("machines"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let found = files.iter().find(|path| {
        let text = std::fs::read_to_string(path).unwrap();
        text.contains(&format!("\nmodel = \"{model}\"\n"))
    });
    let found = found.unwrap_or_else(|| panic!("no machine file of the model {model}"));
    format!("machines/{}", found.file_name().unwrap().to_str().unwrap())
}

#[test]
fn invalid_grids_name_the_axis() {
    let mut text = transcript(
        &["kin", "ik", "--grid", "x=-10:10:10", "--grid", "b=0:1:1"],
        "",
    );
    for grid in ["x=1", "x=5:1:1", "x=0:1:0", "x=0:inf:1", "x=0:a:1"] {
        text += &transcript(&["kin", "ik", "--grid", grid], "");
    }
    text += &transcript(
        &["kin", "fk", "--grid", "l1=0:1:1", "--grid", "l1=0:1:1"],
        "",
    );
    text += &transcript(&["kin", "fk", "--grid", "l1=0:1:1e-9"], "");
    text += &transcript(
        &[
            "kin",
            "ik",
            "--grid",
            "x=-10:10:10",
            "--grid",
            "theta=0:6:3",
        ],
        "",
    );
    insta::assert_snapshot!("kin_grid", text);
}

#[test]
fn invalid_tables_report_line_and_column() {
    let ik = |input: &str| transcript(&["kin", "ik"], input);
    let header = "x_mm,y_mm,z_mm,theta_deg,alpha_deg\n";
    let mut text = ik(&format!(
        "{header}0,0,21.232,0,0\n10,-5,40,10,0\n10,-5,40,0,15\n"
    ));
    text += &ik(&format!(
        "{header}0,0,21.232,95,0\n0,0,9999,0,0\n0,0,21.232,0,200\n0,0,21.232,0,50\n"
    ));
    text += &ik(&format!("{header}0,0,x,0,0\n0,0,inf,0\n1,2,3,4,5\n"));
    text += &ik(&format!("{header}0,0,21,232,0,0\n1,0,2,5,40,0,1,0,0,0\n"));
    text += &ik("x_mm,y_mm,z_mm,theta_deg\n0,0,0,0\n");
    text += &ik("x_mm,y_mm,z_mm,theta_deg,alpha_deg,note,note,x_mm\n0,0,0,0,0,,,1\n");
    text += &ik("");
    text +=
        &ik("alpha_deg, theta_deg, z_mm, y_mm, x_mm, note\r\n15, 0, 40, -5, 10, turned round\r\n");
    text += &transcript(
        &["kin", "ik", "--strokes"],
        &format!(
            "{header}0,0,21.232,0,50\n0,0,21.232,0,-180\n0,0,21.232,0,180\n0,0,21.232,0,3600\n"
        ),
    );
    let fk = |input: &str| transcript(&["kin", "fk"], input);
    text += &fk(
        "l1_mm,l2_mm,l3_mm,l4_mm,alpha_deg\n1135,485,1135,485,0\n1120,480,1110,470,10\n1135,485,1135,9485,0\n1135,1135,485,485,0\n",
    );
    text += &transcript(&["kin", "fk", "--in", "there-is-none.csv"], "");
    text += &transcript(
        &["kin", "fk", "--out", "/there/is/none.csv"],
        "l1_mm,l2_mm,l3_mm,l4_mm,alpha_deg\n",
    );
    insta::assert_snapshot!("kin", text);
}

#[test]
fn input_table_is_not_overwritten() {
    let folder = scene::TestFolder::new();
    let slides = "l1_mm,l2_mm,l3_mm,l4_mm,alpha_deg\n1135,485,1135,485,0\n";
    let table = folder.file("b.csv", slides);
    let other = folder.path("./b.csv");
    for arguments in [
        ["kin", "fk", "--in", &table, "--out", &table],
        ["kin", "ik", "--in", &table, "--out", &other],
    ] {
        let ran = haptimill(&arguments, "");
        assert!(
            ran.code == 2 && ran.err.contains("would be overwritten"),
            "{}",
            ran.err
        );
        assert_eq!(folder.read("b.csv"), slides);
    }
    let ran = haptimill(
        &["kin", "fk", "--in", &table, "--out", &folder.path("c.csv")],
        "",
    );
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(folder.read("c.csv").ends_with(",ok\n"));
}
