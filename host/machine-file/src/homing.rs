//! How a joint finds its reference, and the levels of its switches.

use super::document::Section;
use super::place::{Place, unit};
use super::scale::{self, per_unit, to_i32, to_u16};
use haptimill_firmware::config::{AxisKind, Home, SwitchHome, SwitchInput};
use haptimill_machine_keys::controller::{joint, joint_switch as keys};
use haptimill_math::{Acceleration, Coordinate, Rate};

/// The ways to find a reference.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    Index,
    Switch,
    SwitchAndIndex,
    None,
}

const WAYS: [(&str, Way); 4] = [
    ("index", Way::Index),
    ("switch", Way::Switch),
    ("switch_and_index", Way::SwitchAndIndex),
    ("none", Way::None),
];

/// Reads how the joint finds its reference. `rate` and `acceleration` are the joint's.
pub(super) fn read_home(
    section: &Section<'_, '_>,
    place: &Place,
    rate: f64,
    acceleration: f64,
    has_encoder: bool,
) -> Home {
    let way = if has_encoder && !section.has(joint::home.name) {
        Some(Way::Index)
    } else {
        section.choice(joint::home, &WAYS)
    };
    if matches!(way, Some(Way::Index | Way::SwitchAndIndex)) && !has_encoder {
        let what = "needs an encoder with an index pulse, and the joint has no counts_per_turn";
        section.refuse(joint::home, what, "write \"switch\" or \"none\"");
    }
    let switch = match way {
        Some(Way::Switch | Way::SwitchAndIndex) => section
            .section("switch")
            .map(|switch| read_switch(&switch, place, rate, acceleration)),
        _ => {
            if section.has("switch") && way.is_some() {
                let what = "has no meaning: the joint does not home by a switch";
                section.report("switch", what, "remove it, or write home = \"switch\"");
            }
            None
        }
    };
    match (way, switch) {
        (Some(Way::Switch), Some(switch)) => Home::Switch(switch),
        (Some(Way::SwitchAndIndex), Some(switch)) => Home::SwitchAndIndex(switch),
        (Some(Way::None), _) => Home::Preset,
        _ => Home::Index,
    }
}

/// Reads the section of a search for a switch.
fn read_switch(
    section: &Section<'_, '_>,
    place: &Place,
    joint_rate: f64,
    acceleration: f64,
) -> SwitchHome {
    let inputs = [
        ("home", SwitchInput::Home),
        ("limit_low", SwitchInput::LimitLow),
        ("limit_high", SwitchInput::LimitHigh),
    ];
    let input = if section.has(keys::input.name) {
        section.choice(keys::input, &inputs)
    } else {
        Some(SwitchInput::Home)
    };
    let towards = section.choice(keys::towards, &[("down", true), ("up", false)]);
    let downwards = towards == Some(true);
    let wrong = match input {
        Some(SwitchInput::LimitLow) => towards == Some(false),
        Some(SwitchInput::LimitHigh) => towards == Some(true),
        _ => false,
    };
    if wrong {
        let what = "leads away from the limit switch of `input`";
        section.refuse(keys::towards, what, "reverse it, or name the other limit");
    }
    let order = section.value(keys::home_order);
    let at = section.value(keys::at);
    let rate = section.value(keys::rate);
    let touch_rate = section.value(keys::touch_rate);
    let back_off = section.value(keys::back_off);
    // The joint may stand on its switch, as far as the end of its stroke, when homing begins.
    let beyond = if downwards {
        at - place.low
    } else {
        place.high - at
    };
    let farthest = match place.kind {
        AxisKind::Linear => 200.0,
        AxisKind::Rotary | AxisKind::MultiTurn => 60.0,
    };
    let enough = (beyond + back_off).min(farthest).max(3.0 * back_off);
    let release = section.value_or(keys::release, Some(enough));
    if release < beyond.min(farthest) {
        let what = format!(
            "{release} does not release the switch from the end of the stroke, {beyond} behind it"
        );
        section.refuse(
            keys::release,
            what,
            "raise it, or move the end of the stroke",
        );
    }
    let stroke = place.high - place.low;
    let max = match place.kind {
        AxisKind::Linear => 1900.0,
        AxisKind::Rotary => 166.0,
        AxisKind::MultiTurn => 170_000.0,
    };
    let usual = (1.2 * stroke + 2.0 * release).min(max);
    let travel = section.value_or(keys::travel, Some(usual));
    check_switch(section, place, (at, back_off, downwards));
    let unit = unit(place.kind);
    if rate > joint_rate {
        let what = format!("{rate} is above the joint's rate {joint_rate}");
        section.refuse(keys::rate, what, "lower it");
    }
    if touch_rate > rate {
        let what = format!("{touch_rate} is above the rate to the switch, {rate}");
        section.refuse(keys::touch_rate, what, "lower it");
    }
    let stop = rate * rate / (2.0 * acceleration);
    if stop > release {
        let what = format!(
            "from {rate} {unit}/s the joint stops {stop:.3} {unit} behind the switch, more than the \
             release distance {release} {unit}"
        );
        section.refuse(keys::rate, what, "lower it");
    }
    section.finish();
    let scale = per_unit(place.kind);
    let coordinate = |value: f64| Coordinate(to_i32(value * scale));
    SwitchHome {
        input: input.unwrap_or(SwitchInput::Home),
        order: to_u16(order) as u8,
        downwards,
        coordinate: coordinate(at),
        rate: Rate(to_i32(rate * scale)),
        touch_rate: Rate(to_i32(touch_rate * scale)),
        acceleration: Acceleration(scale::acceleration(acceleration, place.kind)),
        back_off: coordinate(back_off),
        release: coordinate(release),
        travel: coordinate(travel),
    }
}

/// Checks that the joint is within its stroke at the switch, and at the end of its homing.
fn check_switch(section: &Section<'_, '_>, place: &Place, switch: (f64, f64, bool)) {
    let (at, back_off, downwards) = switch;
    let (low, high, unit) = (place.low, place.high, unit(place.kind));
    let end = if downwards {
        at + back_off
    } else {
        at - back_off
    };
    if at < low || at > high {
        let what = format!("{at} {unit} is outside the stroke {low} to {high}");
        section.refuse(keys::at, what, "correct it, or the stroke");
    } else if end < low || end > high {
        let what = format!("homing would end at {end} {unit}, outside the stroke {low} to {high}");
        section.refuse(keys::back_off, what, "lower it, or correct `towards`");
    }
}

/// Reads the levels at which the switches of a joint are active; bits of those that are low.
pub(super) fn read_active_low(section: &Section<'_, '_>) -> u8 {
    let levels = [("high", false), ("low", true)];
    let switches = [
        (joint::home_active, SwitchInput::Home),
        (joint::limit_low_active, SwitchInput::LimitLow),
        (joint::limit_high_active, SwitchInput::LimitHigh),
    ];
    switches.into_iter().fold(0, |bits, (key, input)| {
        let low = section.has(key.name) && section.choice(key, &levels) == Some(true);
        if low { bits | input.bit() } else { bits }
    })
}

#[cfg(test)]
mod tests {
    use crate::MachineFile;

    /// A joint may stand anywhere behind its switch when homing begins.
    #[test]
    fn release_reaches_the_end_of_the_stroke() {
        let text = include_str!("../../../machines/delta3.toml");
        let machine = MachineFile::parse("delta3.toml", text).expect("sound");
        let joint = &machine.config.joints[0];
        let switch = joint.home.switch().expect("a switch");
        // From the switch at 195 mm to the end of the stroke at 225 mm, and 3 mm of back-off.
        assert_eq!(switch.release.0, 33 << 20);
        let short = text.replacen("back_off_mm = 3.0", "back_off_mm = 3.0\nrelease_mm = 29", 1);
        let problems = MachineFile::parse("delta3.toml", &short).expect_err("too short");
        let problems = problems.to_string();
        assert!(
            problems.contains("release_mm: 29 does not release"),
            "{problems}"
        );
    }
}
