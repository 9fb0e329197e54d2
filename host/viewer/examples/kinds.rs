//! A page with every kind of layer, on standard output.

use haptimill_viewer::{Layer, Map, Scale, Scene, Shape, page};

fn main() {
    let turn = |k: u32| f64::from(k) * 0.05;
    let points = (0..400).map(|k| {
        let (sin, cos) = turn(k).sin_cos();
        [(30.0 * cos) as f32, (30.0 * sin) as f32, turn(k) as f32]
    });
    let scale = |label: &str, low: f64, high: f64, map| Scale {
        label: label.into(),
        low,
        high,
        map,
    };
    let helix = Layer::new(
        "helix",
        "#2f6fb3",
        Shape::Lines {
            points: points.collect(),
            starts: vec![],
            times: (0..400).map(|k| k as f32 * 0.1).collect(),
            lines: (1..401).collect(),
            width: 2.5,
        },
    )
    .with_values(
        (0..400)
            .map(|k| 600.0 * (k as f32 * 0.02).sin().abs())
            .collect(),
        scale("feed, mm/min", 0.0, 600.0, Map::Sequential),
    );
    let mesh = Layer::new(
        "pyramid",
        "#c9a25c",
        Shape::Mesh {
            points: vec![
                [-15.0, -15.0, 0.0],
                [15.0, -15.0, 0.0],
                [15.0, 15.0, 0.0],
                [-15.0, 15.0, 0.0],
                [0.0, 0.0, 18.0],
            ],
            triangles: vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
            opacity: 0.8,
        },
    );
    let grid = (0..36).map(|k| [(k % 6 * 16 - 40) as f32, (k / 6 * 16 - 40) as f32, -10.0]);
    let grid: Vec<[f32; 3]> = grid.collect();
    let vectors = grid
        .iter()
        .map(|p| [p[1] * 1e-4, -p[0] * 1e-4, 2e-3])
        .collect();
    let errors = grid.iter().map(|p| p[0] * 0.1).collect();
    let arrows = Layer::new(
        "errors, 2000 times",
        "#a3191f",
        Shape::Arrows {
            points: grid,
            vectors,
            magnify: 2000.0,
            width: 1.5,
        },
    )
    .with_values(errors, scale("error, um", -4.0, 4.0, Map::Diverging));
    let scene = Scene {
        layers: vec![helix, mesh, arrows],
        ..Scene::default()
    };
    print!(
        "{}",
        page("kinds of layers", "body{margin:20px}", &scene.fragment())
    );
}
