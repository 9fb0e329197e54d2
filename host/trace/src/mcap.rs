//! Export of a recording as MCAP, for Foxglove and PlotJuggler.
//!
//! Each group of columns is a channel: `/state`, `/pose/commanded`, `/joints/error`, `/drives`,
//! `/force/high`, for a haptic arm `/master`. A sample is a JSON message with a JSON schema, which
//! both programs read without a plug-in. Events are on `/events` as `foxglove.Log`. Times count
//! from the power-on of the controller. Machine file, part program and configuration are
//! attachments; versions and hash are metadata.
//!
//! Chunks have checks and are not compressed: zstd and lz4 would need a C compiler to build this
//! program.

use super::{Column, McapWritten, Recording, RecordingError, Thinning, Value, columns};
use haptimill_protocol::message::State;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, WriteOptions, Writer};
use serde_json::{Map, json};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{self, Seek, SeekFrom, Write};

/// Topic of the events.
const EVENTS: &str = "/events";

/// An open channel.
struct Topic {
    id: u16,
    sequence: u32,
    columns: Vec<(String, Column)>,
}

/// Returns the topic of a group of columns.
fn topic(group: &str) -> String {
    match group {
        "commanded" | "programmed" | "tool" => format!("/pose/{group}"),
        "joint_commanded" => "/joints/commanded".to_string(),
        "joint_measured" => "/joints/measured".to_string(),
        "joint_error" => "/joints/error".to_string(),
        "drive" => "/drives".to_string(),
        "force_high" => "/force/high".to_string(),
        "force_low" => "/force/low".to_string(),
        "force_true" => "/force/true".to_string(),
        "master_axes" => "/master/axes".to_string(),
        "master_force" => "/master/force".to_string(),
        "master_feedback" => "/master/feedback".to_string(),
        "master_fixture" => "/master/fixture".to_string(),
        other => format!("/{other}"),
    }
}

/// Returns the schema of Foxglove's log panel.
fn log_schema() -> serde_json::Value {
    json!({
        "title": "foxglove.Log",
        "type": "object",
        "properties": {
            "timestamp": {
                "type": "object",
                "title": "time",
                "properties": {
                    "sec": {"type": "integer", "minimum": 0},
                    "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}
                }
            },
            "level": {
                "title": "foxglove.LogLevel",
                "oneOf": [
                    {"title": "UNKNOWN", "const": 0}, {"title": "DEBUG", "const": 1}, {"title": "INFO", "const": 2},
                    {"title": "WARNING", "const": 3}, {"title": "ERROR", "const": 4}, {"title": "FATAL", "const": 5}
                ]
            },
            "message": {"type": "string"},
            "name": {"type": "string"},
            "file": {"type": "string"},
            "line": {"type": "integer", "minimum": 0}
        }
    })
}

/// Returns the JSON schema of a channel.
fn schema(title: &str, fields: &[(String, Column)]) -> serde_json::Value {
    let mut properties = Map::new();
    for (name, column) in fields {
        let kind = match (column.name.as_str(), column.unit) {
            ("state", _) => json!({"type": "string"}),
            ("homed" | "master_enabling_switch", _) => json!({"type": "boolean"}),
            ("setpoint" | "line" | "spindle_rpm" | "period", _) => json!({"type": "integer"}),
            (_, "") => json!({"type": "number"}),
            (_, unit) => json!({"type": "number", "description": unit}),
        };
        properties.insert(name.clone(), kind);
        if column.name == "state" {
            let states = State::ALL.map(|state| format!("{} {state:?}", state.number()));
            let description = states.join(", ");
            properties.insert(
                STATE_NUMBER.to_string(),
                json!({"type": "integer", "description": description}),
            );
        }
    }
    json!({"title": title, "type": "object", "properties": properties})
}

/// Field with the state as a number, for plots.
const STATE_NUMBER: &str = "state_number";

/// Writes a recording with `rate` samples per second, rounded to whole control periods. The caller
/// must flush `out`.
///
/// # Errors
///
/// Returns an error if the recording cannot be read or `out` cannot be written.
pub fn write_mcap(
    recording: &Recording,
    out: &mut (impl Write + Seek),
    rate: f64,
) -> Result<McapWritten, RecordingError> {
    let every = (1.0 / (rate * recording.period_s())).round().max(1.0);
    let mut export = Export {
        writer: WriteOptions::new()
            .compression(None)
            .library(concat!("haptimill ", env!("CARGO_PKG_VERSION")))
            .calculate_chunk_crcs(true)
            .create(&mut *out)
            .map_err(failed)?,
        period_ns: u64::from(recording.config().period_us) * 1000,
        messages: 0,
        text: String::new(),
    };
    let thinning = Thinning {
        every: every as u32,
        ..Thinning::default()
    };
    let channels = export.export(recording, &thinning)?;
    let messages = export.messages;
    drop(export);
    Ok(McapWritten {
        channels,
        messages,
        bytes: out.seek(SeekFrom::End(0)).map_err(RecordingError::Write)?,
    })
}

fn failed(error: McapError) -> RecordingError {
    RecordingError::Write(match error {
        McapError::Io(error) => error,
        other => io::Error::other(other.to_string()),
    })
}

struct Export<W: Write + Seek> {
    writer: Writer<W>,
    period_ns: u64,
    messages: u64,
    text: String,
}

impl<W: Write + Seek> Export<W> {
    fn export(
        &mut self,
        recording: &Recording,
        thinning: &Thinning,
    ) -> Result<usize, RecordingError> {
        self.describe(recording, thinning)?;
        let mut topics: Vec<Topic> = Vec::new();
        let mut all = columns(recording);
        all.retain(|column| column.group != "time");
        for columns in all.chunk_by(|one, next| one.group == next.group) {
            let group = columns[0].group;
            let fields: Vec<(String, Column)> = columns
                .iter()
                .map(|column| {
                    let name = column.name.replace(&format!("_{group}_"), "_");
                    (name, column.clone())
                })
                .collect();
            let topic = topic(group);
            let title = format!("haptimill{}", topic.replace('/', "."));
            let schema = schema(&title, &fields).to_string();
            let none = BTreeMap::new();
            let schema = self
                .writer
                .add_schema(&title, "jsonschema", schema.as_bytes());
            let id =
                schema.and_then(|schema| self.writer.add_channel(schema, &topic, "json", &none));
            topics.push(Topic {
                id: id.map_err(failed)?,
                sequence: 0,
                columns: fields,
            });
        }
        let log = log_schema().to_string();
        let log = self
            .writer
            .add_schema("foxglove.Log", "jsonschema", log.as_bytes());
        let log = log.and_then(|log| {
            self.writer
                .add_channel(log, EVENTS, "json", &BTreeMap::new())
        });
        let log = log.map_err(failed)?;
        let events = recording.events()?;
        let mut events = (0_u32..).zip(events).peekable();
        thinning.apply(recording, |record, time_s| {
            while let Some((sequence, event)) =
                events.next_if(|(_, event)| event.period <= record.period)
            {
                self.event(log, sequence, &event)?;
            }
            for topic in &mut topics {
                let is_used = topic
                    .columns
                    .first()
                    .is_some_and(|(_, column)| column.value(record, time_s).is_some());
                if is_used {
                    self.sample(topic, record, time_s)?;
                }
            }
            Ok(())
        })?;
        for (sequence, event) in events {
            self.event(log, sequence, &event)?;
        }
        self.writer.finish().map_err(failed)?;
        Ok(topics.len() + 1)
    }

    /// Writes metadata and attachments.
    fn describe(
        &mut self,
        recording: &Recording,
        thinning: &Thinning,
    ) -> Result<(), RecordingError> {
        let header = recording.header();
        let about = [
            ("machine", header.machine.clone()),
            ("program", header.program.clone()),
            ("recorded_by", format!("haptimill {}", header.software)),
            (
                "written_by",
                concat!("haptimill ", env!("CARGO_PKG_VERSION")).to_string(),
            ),
            ("message_schema", format!("{:016x}", header.schema)),
            ("configuration_crc", format!("{:08x}", header.config_crc)),
            (
                "control_period_us",
                recording.config().period_us.to_string(),
            ),
            ("every_control_periods", thinning.every.to_string()),
            ("records", recording.records().to_string()),
            ("recording_whole", recording.is_whole().to_string()),
            ("recording_sha256", recording.sha256()?),
        ];
        let metadata = Metadata {
            name: "haptimill".to_string(),
            metadata: about.map(|(name, value)| (name.to_string(), value)).into(),
        };
        let program = match header.program.as_str() {
            "" => "program",
            name => name,
        };
        let attachments = [
            (
                "machine.toml",
                "application/toml",
                header.machine_text.as_bytes(),
            ),
            (program, "text/plain", header.program_text.as_slice()),
            (
                "configuration.postcard",
                "application/octet-stream",
                header.config.as_slice(),
            ),
        ];
        let mut done = self.writer.write_metadata(&metadata);
        for (name, media_type, data) in attachments {
            if data.is_empty() {
                continue;
            }
            let attachment = Attachment {
                log_time: 0,
                create_time: 0,
                name: name.to_string(),
                media_type: media_type.to_string(),
                data: Cow::Borrowed(data),
            };
            done = done.and_then(|()| self.writer.attach(&attachment));
        }
        done.map_err(failed)
    }

    fn sample(
        &mut self,
        topic: &mut Topic,
        record: &super::Record,
        time_s: f64,
    ) -> Result<(), RecordingError> {
        self.text.clear();
        self.text.push('{');
        for (index, (name, column)) in topic.columns.iter().enumerate() {
            if index > 0 {
                self.text.push(',');
            }
            let text = &mut self.text;
            // Writing to a string cannot fail; no name has a character that JSON escapes.
            let _ = match column.value(record, time_s) {
                Some(Value::Real(value, decimals)) => {
                    let from = text.len();
                    let done = write!(text, "{}:{value:.decimals$}", quoted(name));
                    shorten(text, from);
                    done
                }
                Some(Value::Whole(value)) => write!(text, "{}:{value}", quoted(name)),
                Some(Value::Flag(set)) => write!(text, "{}:{set}", quoted(name)),
                Some(Value::State(state)) => write!(
                    text,
                    "{}:\"{state:?}\",\"{STATE_NUMBER}\":{}",
                    quoted(name),
                    state.number()
                ),
                None => write!(text, "{}:null", quoted(name)),
            };
        }
        self.text.push('}');
        let time = record.period * self.period_ns;
        let sequence = topic.sequence;
        topic.sequence += 1;
        self.message(topic.id, sequence, time)
    }

    fn event(
        &mut self,
        log: u16,
        sequence: u32,
        event: &super::RecordedEvent,
    ) -> Result<(), RecordingError> {
        let time = event.period * self.period_ns;
        self.text = json!({
            "timestamp": {"sec": time / 1_000_000_000, "nsec": time % 1_000_000_000},
            "level": event.level + 2,
            "message": event.text,
            "name": "controller",
            "file": "",
            "line": 0,
        })
        .to_string();
        self.message(log, sequence, time)
    }

    fn message(&mut self, channel_id: u16, sequence: u32, time: u64) -> Result<(), RecordingError> {
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        self.messages += 1;
        let written = self
            .writer
            .write_to_known_channel(&header, self.text.as_bytes());
        written.map_err(failed)
    }
}

/// Removes zeros from the end of a decimal fraction that begins after `from`: a third of all
/// digits.
fn shorten(text: &mut String, from: usize) {
    if text[from..].contains('.') {
        let kept = text.trim_end_matches('0').trim_end_matches('.').len();
        text.truncate(kept);
    }
}

/// Returns a name in quotes.
fn quoted(name: &str) -> String {
    json!(name).to_string()
}
