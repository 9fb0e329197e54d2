//! Chip of a step drive that the board sets.

use super::axes::AxisLimits;
use super::document::Section;
use super::scale::to_u16;
use haptimill_firmware::config::{JointSettings, TMC2209_MOHM, TMC2209_UV, Tmc2209};
use haptimill_machine_keys::controller::joint_tmc2209 as keys;

/// Name of the section below that of the drive.
const SECTION: &str = "tmc2209";

/// Reads the chip of a drive with these steps per motor turn; `None` if the drive is set by its
/// switches.
pub(super) fn read(drive: &Section<'_, '_>, steps_per_turn: f64) -> Option<Tmc2209> {
    let section = drive
        .has(SECTION)
        .then(|| drive.section(SECTION))
        .flatten()?;
    let address = section.value(keys::address);
    let microsteps = section.value(keys::microsteps);
    let full_steps = section.value(keys::full_steps_per_turn);
    let run = section.value(keys::run_current_a);
    let hold = section.value(keys::hold_current_a);
    let sense = section.value(keys::sense_resistor_ohm);
    section.finish();
    // What a wrong value would be compared with is not known: one report is enough.
    if (address + microsteps + full_steps + run + hold + sense).is_nan() {
        return None;
    }
    let chip = Tmc2209 {
        address: to_u16(address) as u8,
        microsteps: to_u16(microsteps),
        run_ma: to_u16(run * 1e3),
        hold_ma: to_u16(hold * 1e3),
        sense_mohm: to_u16(sense * 1e3),
    };
    let product = microsteps * full_steps;
    if !chip.microsteps.is_power_of_two() {
        let what = format!("{microsteps} is no power of two");
        let remedy = "write 1, 2, 4, 8, 16, 32, 64, 128 or 256";
        section.refuse(keys::microsteps, what, remedy);
    } else if (product - steps_per_turn).abs() > 0.0 {
        let what = format!(
            "{microsteps} microsteps of {full_steps} full steps are {product} steps per turn, not \
             steps_per_turn = {steps_per_turn}"
        );
        let remedy = "correct it, full_steps_per_turn, or steps_per_turn of [joint.drive]";
        section.refuse(keys::microsteps, what, remedy);
    }
    if !chip.has_current() {
        let resistance = f64::from(chip.sense_mohm + TMC2209_MOHM);
        let [low, high] = [TMC2209_UV.start(), TMC2209_UV.end()];
        let [low, high] = [low, high].map(|microvolts| *microvolts as f64 / resistance / 1e3);
        let what = format!(
            "{run} A is beyond what the chip regulates with {sense} ohm, {low:.3} to {high:.3} A"
        );
        let remedy = "correct it, or sense_resistor_ohm";
        section.refuse(keys::run_current_a, what, remedy);
    }
    if hold > run {
        let what = format!("{hold} A is above run_current_a = {run}");
        section.refuse(keys::hold_current_a, what, "lower it");
    }
    Some(chip)
}

/// Reports each chip whose address a chip before it has.
pub(super) fn check_addresses<'s, 'd: 's, 'i: 'd + 's>(
    sections: impl Iterator<Item = &'s Section<'d, 'i>>,
    joints: &[(JointSettings, AxisLimits)],
) {
    let mut taken: [Option<&str>; 4] = [None; 4];
    for (section, (joint, limits)) in sections.zip(joints) {
        let Some(chip) = joint.tmc2209() else {
            continue;
        };
        let place = taken.get_mut(usize::from(chip.address));
        let Some(place) = place else {
            continue;
        };
        match place {
            None => *place = Some(&limits.name),
            Some(other) => {
                let chip_section = section
                    .section("drive")
                    .and_then(|drive| drive.section(SECTION));
                if let Some(chip_section) = chip_section {
                    let what = format!("{} is the address of joint {other}", chip.address);
                    let remedy =
                        "write another one, and set the pins MS1 and MS2 of the chip to it";
                    chip_section.refuse(keys::address, what, remedy);
                }
            }
        }
    }
}
