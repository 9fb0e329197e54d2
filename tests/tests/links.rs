//! Links for pictures: they end at the tip, and keep their lengths while the joints move.

use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_machine_file::MachineFile;

fn geometry(file: &str) -> (GeometryConfig, Vec<f64>) {
    let path = format!("{}/../machines/{file}", env!("CARGO_MANIFEST_DIR"));
    let machine = MachineFile::load(path.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    let plant: PlantConfig = machine.plant().expect("a plant");
    let presets = plant.joint.iter().map(|joint| joint.preset).collect();
    (plant.geometry.expect("a geometry"), presets)
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3)
        .map(|axis| (a[axis] - b[axis]).powi(2))
        .sum::<f64>()
        .sqrt()
}

fn links(geometry: &GeometryConfig, joints: &[f64; 6]) -> Vec<Vec<[f64; 3]>> {
    geometry.picture(joints).expect("a picture").links
}

/// Lengths of all segments.
fn lengths(lines: &[Vec<[f64; 3]>]) -> Vec<f64> {
    let pairs = lines.iter().flat_map(|line| line.windows(2));
    pairs.map(|pair| distance(&pair[0], &pair[1])).collect()
}

#[test]
fn links_keep_their_lengths_and_end_at_the_tip() {
    // The last segment of the arms with a vertical slide is the slide.
    for (file, rigid) in [
        ("h4.toml", 8),
        ("scara.toml", 2),
        ("fivebar.toml", 4),
        ("delta3.toml", 3),
        // The cradle, the axis, the stands, the table and the head.
        ("trunnion5.toml", 31),
        // From the lift over the tilt axis to the tip.
        ("facet.toml", 2),
        // The edge of the table.
        ("polar3.toml", 24),
    ] {
        let (geometry, presets) = geometry(file);
        let mut first: Option<Vec<f64>> = None;
        let mut seen = 0;
        for step in -4_i32..=4 {
            let mut joints = [0.0; 6];
            for (index, (slot, preset)) in joints.iter_mut().zip(&presets).enumerate() {
                let by = f64::from(step) * [1.3, -0.9, 0.7, 1.1, 4.0, 0.0][index];
                *slot = preset + by;
            }
            let Some(pose) = geometry.pose(&joints) else {
                continue;
            };
            seen += 1;
            let lines = links(&geometry, &joints);
            let tip = [pose[0], pose[1], pose[2]];
            let ends = lines.iter().filter_map(|line| line.last());
            assert!(
                ends.clone().any(|end| distance(end, &tip) < 1e-6),
                "{file}: {lines:?} {tip:?}"
            );
            let now = lengths(&lines);
            let first = first.get_or_insert_with(|| now.clone());
            assert_eq!(now.len(), first.len(), "{file}");
            for (now, first) in now.iter().zip(first.iter()).take(rigid) {
                assert!((now - first).abs() < 1e-6, "{file}: {now} was {first}");
                assert!(*now > 1.0, "{file}: {now}");
            }
        }
        assert!(seen > 6, "{file}: {seen}");
    }
    // Slides of the tool have no links.
    let (geometry, presets) = geometry("mill3.toml");
    let mut joints = [0.0; 6];
    joints
        .iter_mut()
        .zip(presets)
        .for_each(|(slot, preset)| *slot = preset);
    assert!(links(&geometry, &joints).is_empty());
}

/// Without a tilt the tool is upright; with the trunnion at 30 degrees it leans by 30 degrees, and
/// the stands of the trunnion with it.
#[test]
fn a_table_that_tilts_shows_the_tilt() {
    let (geometry, _) = geometry("trunnion5.toml");
    let mut seen = Vec::new();
    for tilt in [0.0, 30.0] {
        let joints = [0.0, 0.0, 50.0, tilt, 0.0, 0.0];
        let picture = geometry.picture(&joints).expect("a picture");
        let [_, y, z] = picture.tool_axis;
        assert!(
            (y.atan2(z).to_degrees() - tilt).abs() < 1e-6,
            "{tilt}: {y} {z}"
        );
        let stand = &picture.links[2];
        let up: Vec<f64> = (0..3).map(|k| stand[1][k] - stand[0][k]).collect();
        let cosine = (0..3).map(|k| up[k] * picture.tool_axis[k]).sum::<f64>();
        assert!((cosine / distance(&stand[0], &stand[1]) - 1.0).abs() < 1e-9);
        seen.push(stand.clone());
    }
    assert!(distance(&seen[0][0], &seen[1][0]) > 10.0);
}

/// The arm of the picture has the lengths of its machine file wherever the handle is.
#[test]
fn a_haptic_arm_keeps_its_lengths() {
    let path = format!(
        "{}/../machines/haptic-master.toml",
        env!("CARGO_MANIFEST_DIR")
    );
    let machine = MachineFile::load(path.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    let plant: PlantConfig = machine.plant().expect("a plant");
    let arm = plant.haptic.expect("an arm").geometry;
    for (by, lean) in [([0.0; 3], 0.0_f64), ([20.0, -15.0, 30.0], 0.2)] {
        let tip: [f64; 3] = std::array::from_fn(|k| arm.home_mm[k] + arm.tip_mm[k] + by[k]);
        let axes = [
            [lean.cos(), 0.0, -lean.sin()],
            [lean.sin(), 0.0, lean.cos()],
        ];
        let lines = arm.links(tip, axes);
        assert_eq!(lines.len(), 6);
        for leg in &lines[..3] {
            assert!((distance(&leg[1], &leg[2]) - arm.link_mm).abs() < 1e-9);
        }
        let side = 3.0_f64.sqrt() * arm.platform_radius_mm;
        for pair in lines[4].windows(2) {
            assert!((distance(&pair[0], &pair[1]) - side).abs() < 1e-9);
        }
        let handle = &lines[5];
        assert!((distance(&handle[0], &handle[1]) - arm.tip_mm[2]).abs() < 1e-9);
        assert_eq!(handle[1], tip);
    }
    // Farther to the side than a link.
    assert!(
        arm.links([500.0, 0.0, 600.0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            .is_empty()
    );
}
