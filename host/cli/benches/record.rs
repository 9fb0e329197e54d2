//! Processor time per recorded control period in the recording thread. Another thread writes the
//! file and computes the hash.
//!
//! `cargo bench -p haptimill --bench record`

use haptimill_machine_file::MachineFile;
use haptimill_trace::{Header, Record, Recorder, Recording};
use std::time::{Duration, Instant};

/// Processor time of this thread, where the system reports it.
fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds = text.split_whitespace().next()?.parse().ok()?;
    Some(Duration::from_nanos(nanoseconds))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let machine = MachineFile::built_in()?;
    let header = Header::of(&machine, "bench.ngc")?;
    let path = std::env::temp_dir().join(format!("haptimill-bench-{}.hmr", std::process::id()));
    let count = 1_000_000_u32;
    let mut recorder = Recorder::create(&path, &header)?;
    let mut record = Record::default();
    let (wall, before) = (Instant::now(), processor_time());
    for period in 0..count {
        record.period = u64::from(period);
        record.commanded = [period as i32; 6];
        recorder.record(&record);
    }
    let (wall, after) = (wall.elapsed(), processor_time());
    let recorded = recorder.finish()?;
    if let (Some(before), Some(after)) = (before, after) {
        println!(
            "recording: {:?} of processor time per period",
            (after - before) / count
        );
    }
    println!(
        "recording: {:?} of real time per period, with disk and hash",
        wall / count
    );
    let begin = Instant::now();
    let sum: u64 = Recording::open(&path)?
        .iter()?
        .filter_map(|record| record.ok())
        .map(|record| record.period)
        .sum();
    println!("reading: {:?} per period ({sum})", begin.elapsed() / count);
    println!("{} MB", recorded.bytes / 1_000_000);
    std::fs::remove_file(&path)?;
    Ok(())
}
