use super::*;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::snapshot::{ForceSnapshot, HapticSnapshot, IoSnapshot};
use haptimill_machine_file::MachineFile;
use proptest::prelude::*;
use sha2::{Digest, Sha256};
use std::path::PathBuf;
use std::time::Instant;

/// Temporary file; dropping it removes the file.
pub struct TemporaryFile(pub(crate) PathBuf);

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
        (0..State::ALL.len(), any::<u8>()),
        prop::array::uniform7(axes()),
        any::<[[i32; 3]; 4]>(),
        any::<(u16, u16, [i16; 4], [i16; 4])>(),
    )
        .prop_map(
            |(
                (period, setpoint, line, path_rate, spindle_rpm),
                (state, flags),
                rows,
                [high, low, displacement, true_force],
                (inputs, outputs, analog_inputs, analog_outputs),
            )| {
                let [
                    commanded,
                    joints_commanded,
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
                    state: State::ALL[state],
                    flags,
                    commanded,
                    joints_commanded,
                    joints,
                    following_error,
                    drive,
                    tool,
                    programmed,
                    force: ForceSnapshot {
                        high,
                        low,
                        displacement,
                    },
                    true_force,
                    io: IoSnapshot {
                        inputs,
                        outputs,
                        analog_inputs,
                        analog_outputs,
                    },
                    ..Record::default()
                }
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn record_decodes_to_itself(record in any_record()) {
        prop_assert_eq!(Record::decode(&record.encode()), Some(record));
    }

    #[test]
    fn haptic_values_are_recorded_only_with_a_haptic_arm(
        records in prop::collection::vec((any_record(), any::<([[i32; 3]; 4], [[i16; 3]; 2])>()), 1..5),
    ) {
        for has_haptic_arm in [false, true] {
            let file = TemporaryFile::new("haptic.hmr");
            let header = Header { has_haptic_arm, ..header() };
            let mut recorder = Recorder::create(&file.0, &header).unwrap();
            let mut expected = Vec::new();
            for (record, ([tip, force, feedback, fixture], axes)) in &records {
                let with = Record { haptic_flags: 3, haptic: HapticSnapshot { tip: *tip, force: *force, feedback: *feedback, fixture: *fixture, axes: *axes }, ..*record };
                recorder.record(&with);
                expected.push(if has_haptic_arm { with } else { *record });
            }
            recorder.finish().unwrap();
            let recording = Recording::open(&file.0).unwrap();
            prop_assert_eq!(recording.header(), &header);
            let version = std::fs::read(&file.0).unwrap()[8];
            prop_assert_eq!(version, if has_haptic_arm { 7 } else { 5 });
            let read: Vec<Record> = recording.iter().unwrap().map(|record| record.unwrap()).collect();
            prop_assert_eq!(&read, &expected);
            prop_assert_eq!(recording.last().unwrap(), expected.last().copied());
            let named = columns(&recording).iter().any(|column| column.name == "z_master_feedback_n");
            prop_assert_eq!(named, has_haptic_arm);
        }
    }

    #[test]
    fn periods_decode_to_themselves(periods in prop::collection::vec(any_period(), 0..40), steady in 0usize..9) {
        let file = TemporaryFile::new("periods.hmr");
        let mut recorder = Recorder::create(&file.0, &header()).unwrap();
        let mut io_log = IoLog::new();
        let (before, after) = periods.split_at(periods.len() / 2);
        before.iter().for_each(|period| io_log.add(&period.inputs, &period.outputs));
        recorder.start_io_log(io_log);
        after.iter().for_each(|period| recorder.period(&period.inputs, &period.outputs));
        // Counters at a constant rate, as most are.
        let mut last = periods.last().cloned().unwrap_or_default();
        let mut all = periods;
        for _ in 0..steady {
            last.inputs.period = last.inputs.period.wrapping_add(1);
            last.inputs.time_ns = last.inputs.time_ns.wrapping_add(200_000);
            recorder.period(&last.inputs, &last.outputs);
            all.push(last.clone());
        }
        recorder.finish().unwrap();
        let recording = Recording::open(&file.0).unwrap();
        prop_assert_eq!(recording.periods(), all.len() as u64);
        let read: Vec<Period> = recording.read_periods().unwrap().map(|period| period.unwrap()).collect();
        prop_assert_eq!(read, all);
    }

    #[test]
    fn damaged_recording_is_an_error_not_a_panic(
        at in any::<prop::sample::Index>(),
        flip in 1u8..=255,
        cut in any::<prop::sample::Index>(),
        how in 0..3,
    ) {
        let file = TemporaryFile::new("damaged.hmr");
        let whole = small_recording();
        let mut content = whole.clone();
        if how != 1 {
            content[at.index(whole.len())] ^= flip;
        }
        if how != 0 {
            content.truncate(cut.index(whole.len()));
        }
        std::fs::write(&file.0, &content).unwrap();
        let said = match read_all(&file.0) {
            Ok((records, periods, true)) => {
                prop_assert!(content == whole && records == 50 && periods == 70);
                return Ok(());
            }
            // Truncated: the complete blocks are unchanged.
            Ok((records, periods, false)) => {
                prop_assert!(content.len() < whole.len() && records <= 50 && periods <= 70);
                return Ok(());
            }
            Err(error) => error.to_string(),
        };
        // The message names the file and the place.
        prop_assert!(said.contains("damaged.hmr: "), "{}", said);
        let place = said.contains(" at byte ") || said.contains("before byte ") || said.contains("too short");
        let foreign = said.contains("not a recording of haptimill") || said.contains("of version");
        prop_assert!(place || foreign, "{}", said);
    }
}

/// A recording of 70 periods and 50 records, with an event.
fn small_recording() -> Vec<u8> {
    static SMALL: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    let make = || {
        let file = TemporaryFile::new("small.hmr");
        let mut recorder = Recorder::create(&file.0, &header()).unwrap();
        recorder.start_io_log(IoLog::new());
        recorder.event(3, 1, "the slide is warm");
        for number in 0..70_u64 {
            let mut period = Period::default();
            period.inputs.period = number;
            period.inputs.axes[2].counts = (number * number) as i32;
            recorder.period(&period.inputs, &period.outputs);
            if number >= 20 {
                recorder.record(&Record {
                    period: number,
                    ..Record::default()
                });
            }
        }
        recorder.finish().unwrap();
        std::fs::read(&file.0).unwrap()
    };
    SMALL.get_or_init(make).clone()
}

/// Returns records, periods, and whether the recording is complete.
fn read_all(path: &std::path::Path) -> Result<(u64, u64, bool), RecordingError> {
    let recording = Recording::open(path)?;
    let (mut records, mut periods) = (0, 0);
    for record in recording.iter()? {
        assert_eq!(record?.period, records + 20);
        records += 1;
    }
    for period in recording.read_periods()? {
        assert_eq!(period?.inputs.period, periods);
        periods += 1;
    }
    for event in recording.events()? {
        assert_eq!(
            (event.period, event.text.as_str()),
            (3, "the slide is warm")
        );
    }
    assert_eq!(
        (records, periods),
        (recording.records(), recording.periods())
    );
    Ok((records, periods, recording.is_whole()))
}

fn any_period() -> impl Strategy<Value = Period> {
    use haptimill_firmware::io::{AxisInputs, DriveCommand, Inputs, StepSegment};
    // Small and large differences, and half words.
    let word = || {
        prop_oneof![
            -3..3_i32,
            -40_000..40_000_i32,
            (-3..3_i32).prop_map(|value| value << 16),
            any::<i32>()
        ]
    };
    let axis = (word(), word(), any::<u16>(), any::<u8>(), any::<bool>()).prop_map(
        |(counts, edge, illegal, index_pulses, bit)| AxisInputs {
            counts,
            edge_time_ns: edge as u32,
            illegal,
            index_pulses,
            home: bit,
            drive_ready: !bit,
            ..AxisInputs::default()
        },
    );
    let command = prop_oneof![
        Just(DriveCommand::Off),
        any::<i16>().prop_map(DriveCommand::Torque),
        (any::<i16>(), word(), word()).prop_map(|(count, delay, ramp)| DriveCommand::Steps(
            StepSegment {
                count,
                delay: delay as u32,
                interval: 0,
                ramp,
            }
        )),
    ];
    let bytes = || prop::collection::vec(any::<u8>(), 0..=64);
    (
        (
            any::<u64>(),
            any::<u16>(),
            word(),
            any::<[i16; 3]>(),
            any::<(u16, u16, bool, bool)>(),
        ),
        prop::array::uniform6(axis),
        prop::array::uniform6(command),
        (any::<i16>(), bytes(), bytes()),
    )
        .prop_map(
            |(
                (period, missed, time, codes, line),
                axes,
                commands,
                (spindle_rpm, received, transmit),
            )| {
                let mut inputs = Inputs {
                    period,
                    missed,
                    time_ns: time as u32,
                    axes,
                    waiting: line.0,
                    lost_bytes: line.1,
                    out_of_band_stop: line.2,
                    emergency_stop: line.3,
                    received: heapless::Vec::from_slice(&received).unwrap(),
                    ..Inputs::default()
                };
                inputs.force.codes = codes;
                inputs.digital = u32::from(line.0) << 9;
                inputs.analog = [codes[0], 1, codes[1], -2];
                let mut period = Period {
                    inputs,
                    ..Period::default()
                };
                period.inputs.haptic.legs[1].counts = [period.inputs.axes[0].counts, 3, -7];
                period.outputs.haptic.currents[2] = [codes[1], codes[2]];
                period.outputs.axes = commands;
                period.outputs.spindle_rpm = spindle_rpm;
                period.outputs.digital = u32::from(line.1) << 3;
                period.outputs.analog = [-1, codes[2], 2, codes[0]];
                period.outputs.transmit = heapless::Vec::from_slice(&transmit).unwrap();
                period
            },
        )
}

#[test]
fn foreign_files_and_other_versions_are_named() {
    let file = TemporaryFile::new("foreign.hmr");
    let said = |content: &[u8]| {
        std::fs::write(&file.0, content).unwrap();
        let error = Recording::open(&file.0).unwrap_err().to_string();
        error.split_once(": ").unwrap().1.to_string()
    };
    let whole = small_recording();
    let mut old = whole.clone();
    old[8..10].copy_from_slice(&2_u16.to_le_bytes());
    let mut damaged = whole.clone();
    let last = damaged.len() - 60;
    damaged[last] ^= 1;
    let texts = [
        said(b"time_s,period\n"),
        said(b"time_s,period,state,setpoint\n0.0,1,Run,3\n"),
        said(&old),
        said(&whole[..100]),
        said(&[&whole[..], b"more"].concat()),
    ];
    insta::assert_snapshot!(texts.join("\n"));
    assert!(Recording::open(std::path::Path::new("/there/is/none.hmr")).is_err());
}

#[test]
fn constant_rates_of_clock_and_counters_compress_to_one_byte() {
    let file = TemporaryFile::new("even.hmr");
    let mut recorder = Recorder::create(&file.0, &header()).unwrap();
    recorder.start_io_log(IoLog::new());
    let mut period = Period::default();
    for number in 0..20_000_u64 {
        period.inputs.period = number;
        period.inputs.time_ns = (number * 200_000) as u32;
        period.inputs.axes[0].counts = number as i32 * 3;
        recorder.period(&period.inputs, &period.outputs);
    }
    recorder.finish().unwrap();
    let recording = Recording::open(&file.0).unwrap();
    let each = recording.period_bytes() as f64 / recording.periods() as f64;
    assert!(each < 1.1, "{each} bytes a period");
}

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
