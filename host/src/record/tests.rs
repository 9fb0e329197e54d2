use super::*;
use crate::machine::MachineFile;
use haptimill_firmware::reading::ForceReading;
use proptest::prelude::*;
use sha2::{Digest, Sha256};
use std::path::PathBuf;
use std::time::Instant;

/// A file in the system's folder for temporary ones, removed at the end.
pub(crate) struct TemporaryFile(pub(crate) PathBuf);

impl TemporaryFile {
    pub(crate) fn new(name: &str) -> Self {
        let name = format!("haptimill-{}-{name}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

pub(crate) fn header() -> Header {
    Header::of(&MachineFile::built_in().unwrap(), "circle.ngc").unwrap()
}

fn any_record() -> impl Strategy<Value = Record> {
    let axes = || prop::array::uniform6(any::<i32>());
    (
        (
            any::<u64>(),
            any::<u32>(),
            any::<u32>(),
            any::<u16>(),
            any::<u16>(),
        ),
        (0..STATES.len(), any::<u8>()),
        prop::array::uniform7(axes()),
        any::<[[i32; 3]; 4]>(),
    )
        .prop_map(
            |(
                (period, setpoint, line, path_rate, spindle_rpm),
                (state, flags),
                rows,
                [high, low, yielded, true_force],
            )| {
                let [
                    wanted,
                    joints_wanted,
                    joints,
                    following_error,
                    drive,
                    tool,
                    programmed,
                ] = rows;
                Record {
                    period,
                    setpoint,
                    line,
                    path_rate,
                    spindle_rpm: spindle_rpm as i16,
                    state: STATES[state],
                    flags,
                    wanted,
                    joints_wanted,
                    joints,
                    following_error,
                    drive,
                    tool,
                    programmed,
                    force: ForceReading { high, low, yielded },
                    true_force,
                }
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn a_record_comes_back_as_it_was(record in any_record()) {
        prop_assert_eq!(Record::decode(&record.encode()), Some(record));
    }

    #[test]
    fn a_damaged_recording_is_an_error_not_a_panic(
        at in 0usize..400,
        bytes in prop::collection::vec(any::<u8>(), 1..20),
        cut in 0usize..1000,
    ) {
        let file = TemporaryFile::new("damaged.hmr");
        let mut content = header().encode();
        content.extend_from_slice(&Record::default().encode());
        let at = at.min(content.len());
        let end = (at + bytes.len()).min(content.len());
        content[at..end].copy_from_slice(&bytes[..end - at]);
        content.truncate(content.len().saturating_sub(cut));
        std::fs::write(&file.0, &content).unwrap();
        if let Ok(recording) = Recording::open(&file.0) {
            let _ = recording.iter().unwrap().count();
        }
    }
}

#[test]
fn states_keep_their_numbers() {
    for (number, state) in STATES.iter().enumerate() {
        assert_eq!(usize::from(state_number(*state)), number);
    }
}

#[test]
fn what_was_spilled_is_on_disk_while_the_recorder_lives() {
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
    // The writing thread takes its time; nothing else is waited for.
    let whole = (header().encode().len() + 24 * RECORD_BYTES) as u64;
    while std::fs::metadata(&file.0).unwrap().len() < whole {
        std::thread::yield_now();
    }
    let recording = Recording::open(&file.0).unwrap();
    assert_eq!((recording.records(), recording.cut_bytes()), (24, 0));
    // A recorder that spills is hashed like any other.
    let recorded = recorder.finish().unwrap();
    assert_eq!(recorded.records, 30);
    let digest = Sha256::digest(std::fs::read(&file.0).unwrap());
    let expected: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(recorded.sha256, expected);
}

#[test]
fn a_recording_comes_back_whole_hashed_and_cut() {
    let file = TemporaryFile::new("whole.hmr");
    let header = header();
    let mut recorder = Recorder::create(&file.0, &header).unwrap();
    // More than one block, and not a whole number of them.
    let count = 10_000_u64;
    let make = |period: u64| Record {
        period,
        line: 7,
        wanted: [period as i32; 6],
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

    // Cut off in the middle of a record.
    std::fs::write(&file.0, &bytes[..bytes.len() - 100]).unwrap();
    let recording = Recording::open(&file.0).unwrap();
    assert_eq!(recording.records(), count - 1);
    assert_eq!(recording.cut_bytes(), RECORD_BYTES as u64 - 100);
    assert!(recording.iter().unwrap().all(|record| record.is_ok()));
}

#[test]
fn a_recorder_that_is_dropped_leaves_what_it_had() {
    let file = TemporaryFile::new("dropped.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    recorder.record(&Record::default());
    drop(recorder);
    assert_eq!(Recording::open(&file.0).unwrap().records(), 1);
}

#[test]
fn the_trace_has_units_and_every_nth_row() {
    let file = TemporaryFile::new("trace.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    for period in 0..101 {
        recorder.record(&Record {
            period: 1000 + period,
            state: State::Run,
            wanted: [1 << 20, 0, 0, 1 << 30, 0, 0],
            drive: [4096, 0, 0, 0, -4096, 0],
            flags: flag::HOMED | if period > 50 { flag::PROGRAMMED } else { 0 },
            ..Record::default()
        });
    }
    recorder.finish().unwrap();
    let recording = Recording::open(&file.0).unwrap();
    let mut csv = Vec::new();
    export_csv(&recording, &mut csv, 25).unwrap();
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
    assert_eq!(cell(0, "x_wanted_mm"), "1.000000");
    assert_eq!(cell(0, "theta_wanted_deg"), "90.000000");
    assert_eq!(cell(0, "l1_drive_n"), "400.000000");
    assert_eq!(cell(0, "alpha_drive_n_m"), "-20.000000");
    assert_eq!(cell(0, "x_programmed_mm"), "");
    assert_eq!(cell(4, "x_programmed_mm"), "0.000000");
    assert_eq!(cell(4, "x_tool_mm"), "");
    assert_eq!(cell(4, "state"), "Run");
}

/// Not a benchmark, a fence.
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
