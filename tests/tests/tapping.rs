//! Tapping and M49: the feed belongs to the speed of the spindle, whatever the overrides are.

use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::settings;
use haptimill_protocol::message::Command;
use haptimill_tests::job;
use haptimill_trace::Record;
use std::sync::{Arc, Mutex};

/// A tapped hole 8 mm deep at 1 mm a turn in line 6, a move at feed before it and one behind it.
const PROGRAM: &str = "G21 G90 G64 P0.01\nG0 Z5\nG1 X5 F600\nS300 M3\nF300\nG84 X10 Z-8 R2\nG80\n\
                       G1 X20 F600\nM5\nM30\n";

/// Z and spindle in a control period of the tapped hole below its retract plane, mm and rev/min.
type Tapped = Vec<(f64, i16)>;

/// Runs the program with overrides, percent; returns the tapped hole, and the number of periods of
/// the whole job.
fn tap(feed: u8, rapid: u8, spindle: u8) -> (Tapped, usize) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../machines/mill3.toml");
    let machine = MachineFile::load(path.as_ref()).unwrap();
    let plan = job::plan(&machine, PROGRAM).unwrap_or_else(|refused| panic!("{refused}"));
    let mut session = job::homed(&machine, vec![]);
    for command in [
        Command::Override { percent: feed },
        Command::RapidOverride { percent: rapid },
        Command::SpindleOverride { percent: spindle },
    ] {
        session.ask(command).unwrap();
    }
    let unit = settings(&machine).pose[2].units;
    let seen: Arc<Mutex<(Tapped, usize)>> = Arc::default();
    let recorded = Arc::clone(&seen);
    let observe = move |record: &Record| {
        let (tapped, periods) = &mut *recorded.lock().unwrap();
        *periods += 1;
        let z = f64::from(record.commanded[2]) / unit;
        if record.line == 6 && z < 1.999 {
            tapped.push((z, record.spindle_rpm));
        }
    };
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("recording.hmr");
    job::begin_recording(&mut session, &recording, &plan, &machine, observe);
    job::run(&mut session, 2, &machine, &plan);
    job::end_recording(&mut session);
    let seen = seen.lock().unwrap();
    (seen.0.clone(), seen.1)
}

#[test]
fn tapping_has_no_overrides() {
    let (plain, whole) = tap(100, 100, 100);
    // 10 mm down and up at 5 mm/s.
    assert!(plain.len() > 15_000, "{} periods", plain.len());
    assert!(plain.iter().any(|(_, rpm)| *rpm == 300) && plain.iter().any(|(_, rpm)| *rpm == -300));
    for (feed, rapid, spindle) in [(40, 100, 150), (200, 30, 60)] {
        let (overridden, periods) = tap(feed, rapid, spindle);
        assert!(
            periods.abs_diff(whole) > 500,
            "{periods} of {whole}: no override"
        );
        // The rapid move to the retract plane ends within a period of it.
        let difference = overridden.len().abs_diff(plain.len());
        assert!(difference <= 2, "{feed} {rapid} {spindle}: {difference}");
        for (index, (z, rpm)) in overridden.iter().enumerate() {
            // To two periods: 5 mm/s in a period of 200 us is 0.001 mm.
            let near = &plain[index.saturating_sub(2)..(index + 3).min(plain.len())];
            let is_near = |it: &(f64, i16)| it.1 == *rpm && (it.0 - z).abs() < 2e-3;
            assert!(near.iter().any(is_near), "{index}: {z} {rpm}, {near:?}");
        }
    }
}
