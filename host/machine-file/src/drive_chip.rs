//! Chip of a step drive that the board sets.

use super::axes::AxisLimits;
use super::document::Section;
use super::scale::to_u16;
use haptimill_firmware::config::{ChipKind, DriveChip, JointSettings};
use haptimill_machine_keys::Key;
use haptimill_machine_keys::controller::{joint_tmc2209, joint_tmc5160};

/// The section of a kind of chip, and its keys.
struct Keys {
    section: &'static str,
    kind: ChipKind,
    place: Key,
    microsteps: Key,
    full_steps: Key,
    run: Key,
    hold: Key,
    sense: Key,
}

const TMC2209: Keys = Keys {
    section: "tmc2209",
    kind: ChipKind::Tmc2209,
    place: joint_tmc2209::address,
    microsteps: joint_tmc2209::microsteps,
    full_steps: joint_tmc2209::full_steps_per_turn,
    run: joint_tmc2209::run_current_a,
    hold: joint_tmc2209::hold_current_a,
    sense: joint_tmc2209::sense_resistor_ohm,
};

const TMC5160: Keys = Keys {
    section: "tmc5160",
    kind: ChipKind::Tmc5160,
    place: joint_tmc5160::position,
    microsteps: joint_tmc5160::microsteps,
    full_steps: joint_tmc5160::full_steps_per_turn,
    run: joint_tmc5160::run_current_a,
    hold: joint_tmc5160::hold_current_a,
    sense: joint_tmc5160::sense_resistor_ohm,
};

impl Keys {
    const fn of(kind: ChipKind) -> Self {
        match kind {
            ChipKind::Tmc2209 => TMC2209,
            ChipKind::Tmc5160 => TMC5160,
        }
    }
}

/// Name of a kind of chip.
pub(super) const fn name(kind: ChipKind) -> &'static str {
    match kind {
        ChipKind::Tmc2209 => "TMC2209",
        ChipKind::Tmc5160 => "TMC5160",
    }
}

/// Reads the chip of a drive with these steps per motor turn; `None` if the drive is set by its
/// switches.
pub(super) fn read(drive: &Section<'_, '_>, steps_per_turn: f64) -> Option<DriveChip> {
    let [first, second] = [TMC2209, TMC5160].map(|keys| drive.has(keys.section).then_some(keys));
    if first.is_some() && second.is_some() {
        let what = "is a second chip beside [joint.drive.tmc2209]";
        drive.report(TMC5160.section, what, "remove one of the two sections");
    }
    let keys = first.or(second)?;
    let section = drive.section(keys.section)?;
    let place = section.value(keys.place);
    let microsteps = section.value(keys.microsteps);
    let full_steps = section.value(keys.full_steps);
    let run = section.value(keys.run);
    let hold = section.value(keys.hold);
    let sense = section.value(keys.sense);
    section.finish();
    // What a wrong value would be compared with is not known: one report is enough.
    if (place + microsteps + full_steps + run + hold + sense).is_nan() {
        return None;
    }
    let chip = DriveChip {
        kind: keys.kind,
        place: to_u16(place) as u8,
        microsteps: to_u16(microsteps),
        run_ma: to_u16(run * 1e3),
        hold_ma: to_u16(hold * 1e3),
        sense_mohm: to_u16(sense * 1e3),
    };
    let product = microsteps * full_steps;
    if !chip.microsteps.is_power_of_two() {
        let what = format!("{microsteps} is no power of two");
        let remedy = "write 1, 2, 4, 8, 16, 32, 64, 128 or 256";
        section.refuse(keys.microsteps, what, remedy);
    } else if (product - steps_per_turn).abs() > 0.0 {
        let what = format!(
            "{microsteps} microsteps of {full_steps} full steps are {product} steps per turn, not \
             steps_per_turn = {steps_per_turn}"
        );
        let remedy = "correct it, full_steps_per_turn, or steps_per_turn of [joint.drive]";
        section.refuse(keys.microsteps, what, remedy);
    }
    if !chip.has_current() {
        let resistance = f64::from(chip.sense_mohm + chip.kind.internal_mohm());
        let range = chip.kind.microvolts();
        let [low, high] = [range.start(), range.end()];
        let [low, high] = [low, high].map(|microvolts| *microvolts as f64 / resistance / 1e3);
        let what = format!(
            "{run} A is beyond what the chip regulates with {sense} ohm, {low:.3} to {high:.3} A"
        );
        let remedy = "correct it, or sense_resistor_ohm";
        section.refuse(keys.run, what, remedy);
    }
    if hold > run {
        let what = format!("{hold} A is above run_current_a = {run}");
        section.refuse(keys.hold, what, "lower it");
    }
    Some(chip)
}

/// Reports each chip of another kind than the first one, each whose place a chip before it has, and
/// each behind a gap in a chain.
pub(super) fn check_places<'s, 'd: 's, 'i: 'd + 's>(
    sections: impl Iterator<Item = &'s Section<'d, 'i>>,
    joints: &[(JointSettings, AxisLimits)],
) {
    let chips: Vec<_> = sections
        .zip(joints)
        .filter_map(|(section, (joint, limits))| Some((section, *joint.chip()?, &limits.name)))
        .collect();
    for (index, (section, chip, _)) in chips.iter().enumerate() {
        let keys = Keys::of(chip.kind);
        let drive = section.section("drive");
        let Some(chip_section) = drive.as_ref().and_then(|it| it.section(keys.section)) else {
            continue;
        };
        let before = || chips.iter().take(index);
        let place = chip.place;
        if let Some((_, other, name)) = before().find(|(_, it, _)| it.kind != chip.kind) {
            let section = Keys::of(other.kind).section;
            let what = format!("is another kind of chip than [joint.drive.{section}] of {name}");
            let remedy = "no board has the buses of both: use chips of one kind, and set the \
                          others by their switches";
            if let Some(drive) = &drive {
                drive.report(keys.section, what, remedy);
            }
        } else if let Some((.., name)) = before().find(|(_, it, _)| it.place == place) {
            let (what, remedy) = match chip.kind {
                ChipKind::Tmc2209 => (
                    "address",
                    "write another one, and set the pins MS1 and MS2 of the chip to it",
                ),
                ChipKind::Tmc5160 => ("position", "write another one"),
            };
            let what = format!("{place} is the {what} of joint {name}");
            chip_section.refuse(keys.place, what, remedy);
        } else if chip.kind == ChipKind::Tmc5160
            && let Some(gap) =
                (0..place).find(|gap| chips.iter().all(|(_, it, _)| it.place != *gap))
        {
            let what = format!("{place} is behind a gap: no joint has the chip at position {gap}");
            let remedy = "number the chips from 0 on, and leave those without a joint out of the \
                          chain";
            chip_section.refuse(keys.place, what, remedy);
        }
    }
}
