//! The format of a recording: values decode to themselves, damage is an error.

use super::values::{any_period, any_record};
use super::{TemporaryFile, header};
use crate::*;
use haptimill_firmware::snapshot::HapticSnapshot;
use proptest::prelude::*;

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
            period.inputs.joints[2].counts = (number * number) as i32;
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
        period.inputs.joints[0].counts = number as i32 * 3;
        recorder.period(&period.inputs, &period.outputs);
    }
    recorder.finish().unwrap();
    let recording = Recording::open(&file.0).unwrap();
    let each = recording.period_bytes() as f64 / recording.periods() as f64;
    assert!(each < 1.1, "{each} bytes a period");
}
