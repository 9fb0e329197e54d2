//! The file `identified.toml`: what was measured, for `haptimill tune` and for later comparisons.

use crate::complex::complex;
use crate::identify::{Identified, acceleration_unit};
use crate::index_pulses::IndexPulses;
use crate::lost_motion::LostMotion;
use crate::lost_steps::{Highest, StepLimits, Trial};
use crate::measure::{Friction, Steady};
use crate::switch_test::Skipped;
use crate::tune::rounded;
use crate::two_mass::{Point, TwoMass};
use haptimill_client::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, value};

/// Date of a time in seconds since 1970, UTC, as 2026-11-23.
#[must_use]
pub fn date(seconds: u64) -> String {
    // Days in eras of 400 years, which begin on the first of March.
    let days = (seconds / 86_400) as i64 + 719_468;
    let era = days / 146_097;
    let day = days - era * 146_097;
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Date of today, UTC.
#[must_use]
pub fn today() -> String {
    let now = std::time::SystemTime::now();
    let since = now.duration_since(std::time::UNIX_EPOCH);
    date(since.map_or(0, |since| since.as_secs()))
}

fn row(numbers: impl IntoIterator<Item = f64>) -> Array {
    numbers.into_iter().collect()
}

/// A test for lost steps: rate, acceleration, steps.
fn trial(trial: &Trial) -> Array {
    row([trial.motion.rate, trial.motion.acceleration, trial.steps])
}

/// The largest value without loss, and the lowest one above it with loss.
fn highest(table: &mut Table, key: &str, highest: Option<Highest>) {
    let (kept, lost) = match highest {
        Some(Highest::NoLossUpTo(kept)) => (Some(kept), None),
        Some(Highest::Between(kept, lost)) => (Some(kept), Some(lost)),
        Some(Highest::AllLost(lost)) => (None, Some(lost)),
        None => (None, None),
    };
    for (end, number) in [("without_loss", kept), ("with_loss", lost)] {
        if let Some(number) = number {
            table[&format!("{key}_{end}")] = value(number);
        }
    }
}

/// The limits of step motors as tables.
fn step_tables(joints: &[StepLimits]) -> ArrayOfTables {
    let mut list = ArrayOfTables::new();
    for joint in joints {
        let mut table = Table::new();
        table["name"] = value(&joint.name);
        table["threshold_steps"] = value(joint.threshold);
        highest(&mut table, "rate", joint.rate());
        highest(&mut table, "acceleration", joint.acceleration());
        if let Some(rate) = joint.working_rate() {
            table["acceleration_at_rate"] = value(rate);
        }
        let bands: Array = joint.resonances().into_iter().map(row).collect();
        table["resonances"] = value(bands);
        for (key, proposed) in ["proposed_rate", "proposed_acceleration"]
            .into_iter()
            .zip(joint.proposed())
        {
            if let Some(proposed) = proposed {
                table[key] = value(rounded(proposed));
            }
        }
        let trials = joint.rates.iter().chain(&joint.accelerations);
        let trials: Array = trials.chain(&joint.proposal).map(trial).collect();
        table["trials"] = value(trials);
        list.push(table);
    }
    list
}

/// Encodes the joints, and those that were not measured.
#[must_use]
pub fn write(
    machine: &str,
    date: &str,
    joints: &[Identified],
    steps: &[StepLimits],
    skipped: &[Skipped],
) -> String {
    let mut document = DocumentMut::new();
    document["machine"] = value(machine);
    document["date"] = value(date);
    let mut list = ArrayOfTables::new();
    for joint in joints {
        let mut table = Table::new();
        table["name"] = value(&joint.name);
        table["inertia"] = value(joint.plant.inertia);
        table["motor_share"] = value(joint.plant.motor_share);
        table["mode_hz"] = value(joint.plant.mode_hz);
        table["mode_damping"] = value(joint.plant.mode_damping);
        if let Err(highest) = joint.resonance {
            table["no_resonance_below_hz"] = value(highest);
        }
        table["viscous"] = value(joint.plant.viscous);
        table["coulomb"] = value(row(joint.friction.coulomb));
        table["fit_error"] = value(joint.error);
        let steady = joint.friction.points.iter();
        let steady: Array = steady.map(|it| row([it.rate, it.effort])).collect();
        table["steady"] = value(steady);
        let points = joint.points.iter();
        let points: Array = points
            .map(|it| row([it.frequency, it.response.re, it.response.im, it.deviation]))
            .collect();
        table["response"] = value(points);
        list.push(table);
    }
    document["joint"] = Item::ArrayOfTables(list);
    document["step_joint"] = Item::ArrayOfTables(step_tables(steps));
    let mut list = ArrayOfTables::new();
    for joint in skipped {
        let mut table = Table::new();
        table["name"] = value(&joint.name);
        table["reason"] = value(&joint.reason);
        list.push(table);
    }
    document["not_measured"] = Item::ArrayOfTables(list);
    format!(
        "# Written by haptimill identify. Units: kg, N, mm or kg m^2, N m, deg; s.\n\
         # steady: rate, effort. response: Hz, real and imaginary part of motion for effort, \
         deviation.\n# trials: rate, acceleration, steps by which the switch tripped at another \
         count.\n{document}"
    )
}

/// Encodes lost motions.
#[must_use]
pub fn write_lost_motion(machine: &str, date: &str, joints: &[LostMotion]) -> String {
    let mut document = DocumentMut::new();
    document["machine"] = value(machine);
    document["date"] = value(date);
    let mut list = ArrayOfTables::new();
    for joint in joints {
        let mut table = Table::new();
        table["name"] = value(&joint.name);
        table["lost_motion"] = value(joint.value());
        table["before"] = value(joint.before);
        table["rests"] = value(row(joint.rests.iter().copied()));
        list.push(table);
    }
    document["joint"] = Item::ArrayOfTables(list);
    format!(
        "# Written by haptimill identify --lost-motion. Units: mm or deg.\n\
         # rests: what the gauge saw beyond the backlash before, each time.\n{document}"
    )
}

/// Encodes the places of index pulses.
#[must_use]
pub fn write_index_pulses(machine: &str, date: &str, joints: &[IndexPulses]) -> String {
    let mut document = DocumentMut::new();
    document["machine"] = value(machine);
    document["date"] = value(date);
    let mut list = ArrayOfTables::new();
    for joint in joints {
        let mut table = Table::new();
        table["name"] = value(&joint.name);
        table["index"] = value(joint.place());
        table["before"] = value(joint.before);
        table["from_presets"] = value(joint.from_presets);
        table["spread_counts"] = value(joint.spread());
        table["slack_counts"] = value(i64::from(joint.slack()));
        for (key, upwards) in [("upwards", true), ("downwards", false)] {
            let passes = joint.passes.iter().filter(|it| it.upwards == upwards);
            table[key] = value(row(passes.map(|it| it.at)));
        }
        list.push(table);
    }
    document["joint"] = Item::ArrayOfTables(list);
    format!(
        "# Written by haptimill identify --index. Units: mm or deg.\n\
         # upwards, downwards: place of the pulse in each pass.\n{document}"
    )
}

/// Decodes the joints, for a machine.
///
/// # Errors
/// The text is not such a file, or it belongs to another machine.
pub fn read(file: &str, text: &str, machine: &MachineFile) -> Result<Vec<Identified>, Error> {
    let refuse = |what: String| Error::new(ErrorKind::BadInput, format!("{file}: {what}"));
    let document: DocumentMut = text.parse().map_err(|error: toml_edit::TomlError| {
        refuse(format!("{error}; run `haptimill identify` again"))
    })?;
    let name = document.get("machine").and_then(Item::as_str);
    let expected = machine.config.name.as_str();
    if name != Some(expected) {
        let what = format!(
            "is of the machine \"{}\" and not of \"{expected}\"; give its machine file with \
             --machine",
            name.unwrap_or_default()
        );
        return Err(refuse(what));
    }
    let list = document.get("joint").and_then(Item::as_array_of_tables);
    let list = list.ok_or_else(|| {
        refuse("has no [[joint]]: no joint has gains that can be tuned".to_string())
    })?;
    list.iter()
        .enumerate()
        .map(|(index, table)| {
            joint(table, machine).ok_or_else(|| {
                refuse(format!(
                    "joint[{}] is not complete; run `haptimill identify` again",
                    index + 1
                ))
            })
        })
        .collect()
}

fn joint(table: &Table, machine: &MachineFile) -> Option<Identified> {
    let number = |key: &str| {
        let number = table.get(key)?.as_float()?;
        number.is_finite().then_some(number)
    };
    let numbers = |item: &toml_edit::Value| -> Option<Vec<f64>> {
        item.as_array()?.iter().map(|it| it.as_float()).collect()
    };
    let rows = |key: &str| -> Option<Vec<Vec<f64>>> {
        table.get(key)?.as_array()?.iter().map(numbers).collect()
    };
    let name = table.get("name")?.as_str()?;
    let index = machine.joints.iter().position(|axis| axis.name == name)?;
    let kind = machine.joints[index].kind;
    let viscous = number("viscous")?;
    let [forward, backward] = numbers(table.get("coulomb")?.as_value()?)?
        .try_into()
        .ok()?;
    let steady = rows("steady")?.into_iter().map(|row| match row[..] {
        [rate, effort] => Some(Steady { rate, effort }),
        _ => None,
    });
    let points = rows("response")?.into_iter().map(|row| match row[..] {
        [frequency, re, im, deviation] => Some(Point {
            frequency,
            response: complex(re, im),
            deviation,
        }),
        _ => None,
    });
    let positive = |value: f64| (value > 0.0).then_some(value);
    Some(Identified {
        joint: index,
        name: name.to_string(),
        kind,
        friction: Friction {
            coulomb: [forward, backward],
            viscous,
            points: steady.collect::<Option<_>>()?,
            rms: 0.0,
        },
        plant: TwoMass {
            inertia: positive(number("inertia")?)?,
            motor_share: number("motor_share").filter(|share| *share > 0.0 && *share < 1.0)?,
            mode_hz: positive(number("mode_hz")?)?,
            mode_damping: positive(number("mode_damping")?)?,
            viscous,
            unit: acceleration_unit(kind),
        },
        resonance: number("no_resonance_below_hz").map_or(Ok(()), Err),
        points: points.collect::<Option<_>>()?,
        error: number("fit_error")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, expected) in [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (951_868_800, "2000-03-01"),
            (1_735_689_599, "2024-12-31"),
            (4_102_444_800, "2100-01-01"),
        ] {
            assert_eq!(date(seconds), expected);
        }
    }
}
