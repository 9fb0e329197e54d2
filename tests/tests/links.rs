//! Links of arms for pictures: they end at the tip, and keep their lengths while the joints move.

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
            let lines = geometry.links(&joints);
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
    // Slides and dials have no links.
    let (geometry, presets) = geometry("mill3.toml");
    let mut joints = [0.0; 6];
    joints
        .iter_mut()
        .zip(presets)
        .for_each(|(slot, preset)| *slot = preset);
    assert!(geometry.links(&joints).is_empty());
}
