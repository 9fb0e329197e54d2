//! Decodes the log of a chip. The image contains the texts; the log line contains only their
//! numbers and values.

use defmt_decoder::{DecodeError, Table};

/// Returns the lines of a log: timestamp (the control period), level, text.
///
/// # Errors
/// The image has no texts, or the log belongs to another image.
pub fn decode(image: &[u8], log: &[u8]) -> Result<Vec<String>, String> {
    let table = Table::parse(image)
        .map_err(|error| format!("the texts of the image cannot be read: {error}"))?
        .ok_or("the image does not log; it has no section .defmt")?;
    let mut decoder = table.new_stream_decoder();
    decoder.received(log);
    let mut lines = Vec::new();
    loop {
        match decoder.decode() {
            Ok(frame) => {
                let stamp = frame.display_timestamp();
                let stamp = stamp.map_or_else(String::new, |stamp| stamp.to_string());
                let level = frame.level().map_or("", |level| level.as_str());
                let text = frame.display_message();
                lines.push(format!("{stamp:>10} {level:5} {text}"));
            }
            Err(DecodeError::UnexpectedEof) => return Ok(lines),
            Err(DecodeError::Malformed) => {
                return Err(format!(
                    "the log is not of this image, from line {} on",
                    lines.len() + 1
                ));
            }
        }
    }
}
