//! Encoder of a joint: its scale, its index pulse, and the supervision that needs it.

use super::document::Section;
use super::place::{Place, unit};
use super::scale::{PER_COUNT, per_unit, to_i32, to_i64, to_u32};
use haptimill_firmware::config::EncoderSettings;
use haptimill_machine_keys::controller::joint as keys;
use haptimill_math::Coordinate;

/// Reads the encoder of a joint. `None` if the joint has none: it has a step drive and no
/// `counts_per_turn`, and the other keys of an encoder are refused.
pub(super) fn read_encoder(section: &Section<'_, '_>, joint: &Place) -> Option<EncoderSettings> {
    let steps = section.peek_text_of("drive", "kind") == Some("step");
    if steps && !section.has(keys::counts_per_turn.name) {
        refuse_keys(section);
        return None;
    }
    let counts = section.value_or(keys::counts_per_turn, None);
    let direction = section.value(keys::direction);
    let following = section.value(keys::following_error);
    if following <= 0.0 {
        section.refuse(keys::following_error, "0 is always exceeded", "raise it");
    }
    let lag = section.value(keys::following_error_lag_ms);
    let stuck = section.value(keys::encoder_stuck);
    let resolution = joint.turn / counts;
    if stuck < 4.0 * resolution {
        let unit = unit(joint.kind);
        let what = format!("{stuck} {unit} is less than 4 encoder counts");
        let remedy = format!("raise it to {} or more", 4.0 * resolution);
        section.refuse(keys::encoder_stuck, what, remedy);
    }
    let index = section.value(keys::index);
    let search = section.value(keys::search);
    // One line of the encoder, or less for a coarse encoder.
    let usual = ((counts - 1.0) / 4.0).floor().clamp(0.0, 4.0);
    let slack = section.value_or(keys::index_slack_counts, Some(usual));
    if slack * 4.0 >= counts {
        let what = format!("{slack} is a quarter of the {counts} counts of a turn, or more");
        section.refuse(keys::index_slack_counts, what, "lower it");
    }
    check_index(section, joint, index, search);
    let scale = per_unit(joint.kind);
    let coordinate = |value: f64| Coordinate(to_i32(value * scale));
    Some(EncoderSettings {
        per_count: to_i64(direction * resolution * scale * PER_COUNT),
        following: coordinate(following),
        following_lag: to_u32(lag * 65.536),
        stuck_distance: coordinate(stuck),
        index: coordinate(index),
        index_pitch: coordinate(joint.turn),
        index_slack: to_u32(slack).min(u32::from(u16::MAX)) as u16,
        search: coordinate(search),
    })
}

/// Reports the keys of an encoder on a joint without one.
fn refuse_keys(section: &Section<'_, '_>) {
    for key in [
        keys::direction,
        keys::following_error,
        keys::following_error_lag_ms,
        keys::encoder_stuck,
        keys::index,
        keys::search,
        keys::index_slack_counts,
    ] {
        if section.has(section.key(key).name) {
            let what = "has no meaning without an encoder";
            section.refuse(key, what, "remove it, or add `counts_per_turn`");
        }
    }
}

/// Checks the place of the index pulse against stroke, preset and motor turn.
fn check_index(section: &Section<'_, '_>, joint: &Place, index: f64, search: f64) {
    let Place {
        kind,
        low,
        high,
        turn,
        preset,
        ..
    } = *joint;
    let unit = unit(kind);
    if index < low || index > high {
        let what = format!("{index} {} is outside the stroke {low} to {high}", unit);
        section.refuse(keys::index, what, "correct it, or the stroke");
    }
    if (index - preset).abs() > search {
        let what = format!(
            "{search} {} does not reach from the preset {preset} to the index {index}",
            unit
        );
        section.refuse(keys::search, what, "raise it, or correct the index");
    }
    if search > turn / 2.0 {
        let what = format!(
            "{search} {} is more than half a motor turn ({} {}): the search could find the index of the next turn",
            unit,
            turn / 2.0,
            unit
        );
        section.refuse(keys::search, what, "lower it");
    }
}
