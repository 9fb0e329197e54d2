//! The picture is not mirrored: the axes on the screen are right-handed from every side. Needs
//! Node.js, and passes with a note without it.

use serde_json::Value;
use std::io::ErrorKind;
use std::process::Command;

fn numbers(value: &Value) -> [f64; 3] {
    std::array::from_fn(|k| value[k].as_f64().expect("a number"))
}

fn determinant([a, b, c]: [[f64; 3]; 3]) -> f64 {
    a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

#[test]
fn the_view_is_right_handed_from_every_side() {
    let folder = env!("CARGO_MANIFEST_DIR");
    let ran = Command::new("node")
        .arg(format!("{folder}/tests/projection.js"))
        .arg(format!("{folder}/src/viewer.js"))
        .output();
    let out = match ran {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            println!("not tested: Node.js is not installed");
            return;
        }
        ran => ran.expect("node runs"),
    };
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let rows: Vec<Value> = serde_json::from_slice(&out.stdout).expect("JSON");
    assert_eq!(rows.len(), 20);
    for row in &rows {
        let changes = std::array::from_fn(|k| numbers(&row["changes"][k]));
        assert!(determinant(changes) > 0.0, "mirrored: {row}");
        let (yaw, pitch) = (row["yaw"].as_f64(), row["pitch"].as_f64());
        let [x, y, z] = changes;
        if (yaw, pitch) == (Some(0.0), Some(0.0)) {
            // From the front: x to the right, z up, y away from the eye.
            assert!(x[0] > 0.0 && z[1] > 0.0 && y[2] < 0.0, "{row}");
        }
        if yaw == Some(0.0) && pitch.is_some_and(|pitch| pitch > 1.5) {
            // From above: x to the right, y up, z towards the eye.
            assert!(x[0] > 0.0 && y[1] > 0.0 && z[2] > 0.0, "{row}");
        }
    }
}
