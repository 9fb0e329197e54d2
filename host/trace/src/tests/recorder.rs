//! The recorder: what is on disk and when, its cost, and the export of a recording.

use super::{TemporaryFile, header};
use crate::*;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_machine_file::MachineFile;
use sha2::{Digest, Sha256};
use std::time::Instant;

#[test]
fn spilled_records_are_on_disk_before_the_end() {
    let file = TemporaryFile::new("spilled.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    recorder.spill();
    for period in 0..30 {
        recorder.record(&Record {
            period,
            ..Record::default()
        });
        if period == 11 || period == 23 {
            recorder.spill();
        }
    }
    // Waits only for the writing thread.
    let whole = (header().encode().len() + 2 * (blocks::HEAD_BYTES + 12 * RECORD_BYTES)) as u64;
    while std::fs::metadata(&file.0).unwrap().len() < whole {
        std::thread::yield_now();
    }
    let recording = Recording::open(&file.0).unwrap();
    assert_eq!((recording.records(), recording.cut_bytes()), (24, 0));
    assert!(!recording.is_whole());
    // Spilled records are hashed, too.
    let recorded = recorder.finish().unwrap();
    assert_eq!(recorded.records, 30);
    let digest = Sha256::digest(std::fs::read(&file.0).unwrap());
    let expected: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(recorded.sha256, expected);
}

#[test]
fn recording_is_complete_hashed_and_readable_if_truncated() {
    let file = TemporaryFile::new("whole.hmr");
    let header = header();
    let mut recorder = Recorder::create(&file.0, &header).unwrap();
    // More than one block, the last one not full.
    let count = 10_000_u64;
    let make = |period: u64| Record {
        period,
        line: 7,
        commanded: [period as i32; 6],
        ..Record::default()
    };
    for period in 0..count {
        recorder.record(&make(period));
    }
    let recorded = recorder.finish().unwrap();
    let bytes = std::fs::read(&file.0).unwrap();
    assert_eq!(recorded.records, count);
    assert_eq!(recorded.bytes, bytes.len() as u64);
    let expected: Vec<String> = Sha256::digest(&bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    assert_eq!(recorded.sha256, expected.concat());

    let recording = Recording::open(&file.0).unwrap();
    assert_eq!(recording.header(), &header);
    assert_eq!(recording.records(), count);
    assert_eq!(recording.cut_bytes(), 0);
    let mut seen = 0;
    for (period, record) in recording.iter().unwrap().enumerate() {
        assert_eq!(record.unwrap(), make(period as u64));
        seen += 1;
    }
    assert_eq!(seen, count);

    // Truncated within its last block of 1808 records: the blocks before it are readable.
    let end = bytes.len() - blocks::HEAD_BYTES;
    std::fs::write(&file.0, &bytes[..end - 100]).unwrap();
    let recording = Recording::open(&file.0).unwrap();
    assert!(!recording.is_whole());
    assert_eq!(recording.records(), count - 1808);
    let rest = blocks::HEAD_BYTES + 1808 * RECORD_BYTES - 100;
    assert_eq!(recording.cut_bytes(), rest as u64);
    assert!(recording.iter().unwrap().all(|record| record.is_ok()));
}

#[test]
fn dropped_recorder_leaves_a_readable_recording() {
    let file = TemporaryFile::new("dropped.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    recorder.record(&Record::default());
    drop(recorder);
    assert_eq!(Recording::open(&file.0).unwrap().records(), 1);
}

#[test]
fn trace_has_units_and_every_nth_row() {
    let file = TemporaryFile::new("trace.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    for period in 0..101 {
        recorder.record(&Record {
            period: 1000 + period,
            state: State::Run,
            commanded: [1 << 20, 0, 0, 1 << 30, 0, 0],
            drive: [4096, 0, 0, 0, -4096, 0],
            flags: flag::HOMED | if period > 50 { flag::PROGRAMMED } else { 0 },
            ..Record::default()
        });
    }
    recorder.finish().unwrap();
    let recording = Recording::open(&file.0).unwrap();
    let mut csv = Vec::new();
    write_csv(&recording, &mut csv, 25).unwrap();
    let mut reader = csv::Reader::from_reader(csv.as_slice());
    let heading: Vec<String> = reader
        .headers()
        .unwrap()
        .iter()
        .map(str::to_string)
        .collect();
    let rows: Vec<csv::StringRecord> = reader.records().map(|row| row.unwrap()).collect();
    assert_eq!(rows.len(), 5);
    let cell = |row: usize, name: &str| {
        let column = heading.iter().position(|h| h == name).unwrap();
        rows[row][column].to_string()
    };
    assert_eq!(cell(1, "time_s"), "0.005000");
    assert_eq!(cell(4, "period"), "1100");
    assert_eq!(cell(0, "x_commanded_mm"), "1.000000");
    assert_eq!(cell(0, "theta_commanded_deg"), "90.000000");
    assert_eq!(cell(0, "l1_drive_n"), "400.000000");
    assert_eq!(cell(0, "alpha_drive_n_m"), "-20.000000");
    assert_eq!(cell(0, "x_programmed_mm"), "");
    assert_eq!(cell(4, "x_programmed_mm"), "0.000000");
    assert_eq!(cell(4, "x_tool_mm"), "");
    assert_eq!(cell(4, "state"), "Run");
}

/// An upper bound, not a benchmark.
#[test]
fn recording_is_cheap_for_the_caller() {
    let file = TemporaryFile::new("speed.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    let count = 200_000_u32;
    let mut record = Record::default();
    let before = Instant::now();
    for period in 0..count {
        record.period = u64::from(period);
        recorder.record(&record);
    }
    let each = before.elapsed() / count;
    recorder.finish().unwrap();
    println!("{each:?} a record");
    assert!(each.as_micros() < 5, "{each:?} a record");
}

/// The disk fills during a job: the recording ends early, is complete, and leaves the reserve free.
#[test]
fn recording_ends_before_the_disk_is_full() {
    use super::writer::RESERVE_BYTES;
    // Three checks find space, the fourth one does not; a check follows each megabyte.
    fn space(file: &std::fs::File) -> Option<u64> {
        let written = file.metadata().unwrap().len();
        Some((RESERVE_BYTES + (3 << 20)).saturating_sub(written))
    }
    let machine = MachineFile::built_in().unwrap();
    let header = Header::of(&machine, "long").unwrap();
    let path = std::env::temp_dir().join(format!("haptimill-full-{}.hmr", std::process::id()));
    let mut recorder = Recorder::create_with(&path, &header, space).unwrap();
    let mut ended_at = None;
    for period in 0..200_000 {
        recorder.record(&Record {
            period,
            ..Record::default()
        });
        if recorder.is_broken() && ended_at.is_none() {
            ended_at = Some(period);
        }
    }
    let recorded = recorder.finish().unwrap();
    assert!(recorded.disk_full);
    assert!(ended_at.is_some_and(|at| at < 200_000), "{ended_at:?}");
    assert!(recorded.bytes < 3 * RESERVE_BYTES / 2, "{recorded:?}");
    assert!(recorded.bytes >= 3 << 20, "{recorded:?}");
    let recording = Recording::open(&path).unwrap();
    assert!(recording.is_whole());
    assert_eq!(recording.records(), recorded.records);
    std::fs::remove_file(path).unwrap();
}

fn periods_of(path: &std::path::Path) -> Vec<u64> {
    let recording = Recording::open(path).unwrap();
    let records = recording.iter().unwrap();
    records.map(|record| record.unwrap().period).collect()
}

#[test]
fn a_part_of_the_records_is_kept_and_all_are_observed() {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};
    let write = |file: &TemporaryFile, keep: Keep, periods: u64, seen: &Arc<AtomicU64>| {
        let count = Arc::clone(seen);
        let mut recorder = Recorder::create_thinned(&file.0, &header(), keep)
            .unwrap()
            .observed(move |_| {
                count.fetch_add(1, Ordering::SeqCst);
            });
        recorder.start_io_log(IoLog::new());
        recorder.event(5, 1, "the first event");
        for period in 1000..1000 + periods {
            recorder.period(&Inputs::default(), &Outputs::default());
            recorder.record(&Record {
                period,
                ..Record::default()
            });
        }
        recorder.event(9, 1, "the last event");
        recorder
    };
    for (keep, periods, expected) in [
        (
            Keep::Every(10),
            95,
            (0..10).map(|k| 1000 + 10 * k).collect::<Vec<u64>>(),
        ),
        (Keep::Last(300), 200, (1000..1200).collect()),
        (Keep::Last(300), 300, (1000..1300).collect()),
        (Keep::Last(300), 301, (1001..1301).collect()),
        (Keep::Last(300), 1000, (1700..2000).collect()),
        (Keep::Last(3000), 20_000, (18_000..21_000).collect()),
    ] {
        let file = TemporaryFile::new(&format!("part-{periods}.hmr"));
        let seen = Arc::default();
        let recorded = write(&file, keep, periods, &seen).finish().unwrap();
        assert_eq!(seen.load(Ordering::SeqCst), periods);
        assert_eq!(periods_of(&file.0), expected, "{keep:?} of {periods}");
        assert_eq!(recorded.records, expected.len() as u64);
        let recording = Recording::open(&file.0).unwrap();
        assert!(recording.is_whole() && !recorder::earlier_file(&file.0).exists());
        assert_eq!(recorded.sha256, recording.sha256().unwrap());
        // The inputs are not kept, so nothing can be replayed.
        assert_eq!(recording.periods(), 0);
        assert!(
            replay::why_not_replayable(&recording)
                .unwrap()
                .contains("--record")
        );
        let events: Vec<String> = recording
            .events()
            .unwrap()
            .into_iter()
            .map(|it| it.text)
            .collect();
        assert_eq!(
            events,
            ["the first event", "the last event"],
            "{keep:?} of {periods}"
        );
    }
    // Of a process that ended in the middle both files are readable.
    let file = TemporaryFile::new("part-killed.hmr");
    drop(write(&file, Keep::Last(300), 700, &Arc::default()));
    let earlier = TemporaryFile(recorder::earlier_file(&file.0));
    assert_eq!(periods_of(&earlier.0), (1300..1600).collect::<Vec<u64>>());
    assert_eq!(periods_of(&file.0), (1600..1700).collect::<Vec<u64>>());
}
