//! A program over standard input on a machine behind a port: it runs as it comes.

use crate::scene::{SimServer, TestFolder, number, start_with};
use haptimill_trace::Recording;
use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

/// X of the last record, mm; `None` as long as there is none.
pub fn last_x(recording: &str) -> Option<f64> {
    let recording = Recording::open(Path::new(recording)).ok()?;
    let last = recording.iter().ok()?.map_while(Result::ok).last()?;
    Some(f64::from(last.commanded[0]) / 1_048_576.0)
}

#[test]
fn blocks_run_before_the_next_ones_come() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let (input, mut lines) = std::io::pipe().expect("a pipe");
    let out = folder.path("out");
    let run = [
        "run",
        "-",
        "--stream",
        "--out",
        &out,
        "--port",
        &served.port,
    ];
    let running = start_with(&run, input.into());
    let recording = folder.path("out/recording.hmr");
    // Each move ends although its successor is not there yet.
    for x in [2.0, 3.5, -1.0] {
        writeln!(lines, "G1 F900 X{x} Y0").expect("it reads");
        let start = Instant::now();
        while last_x(&recording).is_none_or(|at| (at - x).abs() > 1e-3) {
            assert!(
                start.elapsed() < Duration::from_secs(60),
                "X{x}: {}",
                running.errors()
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }
    writeln!(lines, "G1 X1\nM30").expect("it reads");
    drop(lines);
    running.end().expect_code(0);
    assert_eq!(folder.summary("out")["completed"], true);
    let status = served.status();
    assert!(
        (number(&status["commanded"], "x") - 1.0).abs() < 1e-4,
        "{status:#}"
    );
}
