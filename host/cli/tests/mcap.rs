//! MCAP export, checked with the reference MCAP reader; a build without MCAP refuses before motion.

use crate::scene;
#[cfg(feature = "mcap")]
mod built {
    use super::scene::{TestFolder, haptimill};
    use haptimill_trace::Recording;
    use mcap::read::Options as ReadOptions;
    use mcap::{MessageStream, Summary};
    use serde_json::Value;
    use std::collections::BTreeMap;
    use std::path::Path;

    /// The messages of an MCAP file, with verified checksums.
    fn read_with_checks(bytes: &[u8]) -> MessageStream<'_> {
        MessageStream::new_with_options(bytes, ReadOptions::ValidateChunkCrcs.into()).unwrap()
    }

    #[test]
    fn haptic_arm_has_channels() {
        let folder = TestFolder::new();
        let out = folder.path("out");
        haptimill(&[
            "teleop", "--master", "sim", "--for", "1.5", "--quiet", "--out", &out,
        ])
        .expect_code(0);
        let (trace, file) = (folder.path("out/master.hmr"), folder.path("master.mcap"));
        haptimill(&["trace", "mcap", &trace, "--out", &file]).expect_code(0);
        let bytes = std::fs::read(&file).unwrap();
        let recording = Recording::open(Path::new(&trace)).unwrap();
        let mut records = recording.iter().unwrap().map(Result::unwrap);
        let mut held = 0;
        let mut seen = 0;
        for message in read_with_checks(&bytes) {
            let message = message.unwrap();
            if message.channel.topic != "/master" {
                continue;
            }
            let period = message.log_time / 200_000;
            let record = records.find(|record| record.period == period).unwrap();
            let value: Value = serde_json::from_slice(&message.data).unwrap();
            let tip = f64::from(record.haptic.tip[2]) / f64::from(1 << 20);
            assert!(
                (value["z_mm"].as_f64().unwrap() - tip).abs() < 1e-6,
                "{value}"
            );
            held += u64::from(value["master_enabling_switch"] == true);
            seen += 1;
        }
        assert!(seen > 1000 && held > 500 && held < seen, "{held} of {seen}");
        let summary = Summary::read(&bytes).unwrap().unwrap();
        for topic in ["/master/force", "/master/feedback", "/master/fixture"] {
            assert!(
                summary
                    .channels
                    .values()
                    .any(|channel| channel.topic == topic)
            );
        }
    }

    #[test]
    fn mcap_is_complete_and_valid() {
        let folder = TestFolder::new();
        let out = folder.path("out");
        let program = "examples/e7-slot.ngc";
        haptimill(&["run", program, "--quiet", "--mcap", "--out", &out]).expect_code(0);
        let trace = folder.path("out/recording.hmr");
        let again = folder.path("again.mcap");
        haptimill(&["trace", "mcap", &trace, "--out", &again]).expect_code(0);
        let bytes = std::fs::read(folder.path("out/recording.mcap")).unwrap();
        assert!(
            bytes == std::fs::read(&again).unwrap(),
            "not the same when it is made again"
        );

        let recording = Recording::open(Path::new(&trace)).unwrap();
        let summary = Summary::read(&bytes).unwrap().unwrap();
        let statistics = summary.stats.as_ref().unwrap();
        assert_eq!(statistics.attachment_count, 3);
        assert!(summary.channels.values().all(|channel| {
            channel.message_encoding == "json"
                && channel.schema.as_ref().unwrap().encoding == "jsonschema"
        }));
        for channel in summary.channels.values() {
            let schema: Value =
                serde_json::from_slice(&channel.schema.as_ref().unwrap().data).unwrap();
            assert_eq!(schema["type"], "object", "{}", channel.topic);
        }
        let mut topics: BTreeMap<String, Vec<(u64, Value)>> = BTreeMap::new();
        for message in read_with_checks(&bytes) {
            let message = message.unwrap();
            let value = serde_json::from_slice(&message.data).unwrap();
            topics
                .entry(message.channel.topic.clone())
                .or_default()
                .push((message.log_time, value));
        }
        let names: Vec<&str> = topics.keys().map(String::as_str).collect();
        assert_eq!(
            names,
            [
                "/displacement",
                "/drives",
                "/events",
                "/force/high",
                "/force/low",
                "/force/true",
                "/joints/commanded",
                "/joints/error",
                "/joints/measured",
                "/pose/commanded",
                "/pose/programmed",
                "/pose/tool",
                "/state"
            ]
        );
        // 1000 messages per second, with the values of the recording.
        let state = &topics["/state"];
        assert_eq!(
            state.len() as u64,
            recording.records().div_ceil(5) + u64::from(recording.records() % 5 != 1)
        );
        let tool = &topics["/pose/tool"];
        let scale = f64::from(1 << 20);
        let mut compared = 0;
        for record in recording.iter().unwrap() {
            let record = record.unwrap();
            let time = record.period * 200_000;
            if let Ok(at) = tool.binary_search_by_key(&time, |(time, _)| *time) {
                let x = tool[at].1["x_mm"].as_f64().unwrap();
                assert!((x - f64::from(record.tool[0]) / scale).abs() < 1e-6);
                compared += 1;
            }
        }
        assert_eq!(compared, tool.len());
        assert!(
            state
                .iter()
                .any(|(_, value)| value["state"] == "Run" && value["state_number"] == 3)
        );
        let events = &topics["/events"];
        let done = events
            .iter()
            .find(|(_, event)| event["message"].as_str().unwrap().contains("done"));
        let (time, event) = done.expect("the job was done");
        assert_eq!(
            event["timestamp"]["sec"].as_u64().unwrap(),
            time / 1_000_000_000
        );
        let times: Vec<u64> = events.iter().map(|(time, _)| *time).collect();
        assert!(times.is_sorted());
        // A changed digit in the middle of the file is detected.
        let mut damaged = bytes.clone();
        let middle = damaged.len() / 2;
        let name = b"\"x_mm\":";
        let at = damaged[middle..]
            .windows(name.len())
            .position(|part| part == name)
            .unwrap();
        let digit = damaged[middle + at..]
            .iter()
            .position(u8::is_ascii_digit)
            .unwrap();
        damaged[middle + at + digit] ^= 1;
        assert!(read_with_checks(&damaged).any(|message| message.is_err()));
        let ran =
            haptimill(&["trace", "mcap", &trace, "--out", "/there/is/none.mcap"]).expect_code(9);
        assert!(ran.err.contains("/there/is/none.mcap: "), "{}", ran.err);
    }
}

#[cfg(not(feature = "mcap"))]
#[test]
fn build_without_mcap_refuses_before_motion() {
    let folder = scene::TestFolder::new();
    let out = folder.path("out");
    let program = "examples/e7-slot.ngc";
    let ran =
        scene::haptimill(&["run", program, "--quiet", "--mcap", "--out", &out]).expect_code(2);
    assert!(ran.err.contains("--features mcap"), "{}", ran.err);
    assert!(!std::path::Path::new(&out).exists());
}
