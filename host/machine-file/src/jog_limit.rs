//! Why a jog ended before its timeout: the soft limit, or what lies beyond the pose.

use crate::model::Model;
use crate::place::unit;
use crate::{AxisLimits, MachineFile};
use haptimill_gcode::Coordinates;
use haptimill_machine_keys::Key;
use haptimill_machine_keys::controller::pose as keys;
use haptimill_planner::MachineModel;

/// Longest motion beyond the pose that is examined, in seconds at the rates of the jog.
const LONGEST_S: f64 = 4.0;

/// Returns the sentence why a jog of `axis` with `rates` (mm/s and deg/s) ended at the pose `at`
/// (mm and degrees): the limit and its unit, and what to do.
///
/// # Panics
///
/// If the machine has no such pose coordinate.
#[must_use]
pub fn jog_limit(
    machine: &MachineFile,
    model: &Model,
    axis: usize,
    at: &Coordinates,
    rates: &Coordinates,
) -> String {
    let limits = &machine.pose[axis];
    let (name, unit, place) = (&limits.name, unit(limits.kind), at[axis]);
    let (side, limit, key): (_, _, Key) = if rates[axis] < 0.0 {
        ("lower", limits.low, keys::low)
    } else {
        ("upper", limits.high, keys::high)
    };
    // The controller checks once a period whether another period of motion would pass the limit.
    let period_s = f64::from(machine.config.period_us) * 1e-6;
    if (limit - place).abs() <= 2.0 * rates[axis].abs() * period_s + 1e-3 {
        let key = key.of(limits.kind).name;
        return format!(
            "{name} stopped at its {side} soft limit of {limit} {unit}; jog it the other way, or \
             change `{key}` of its [[pose]] in the machine file"
        );
    }
    let before = match limits.wraps() {
        true => String::new(),
        false => format!(", before its {side} soft limit of {limit} {unit}"),
    };
    let reason = match beyond(machine, model, at, rates) {
        Some(problem) => format!(": farther on, {problem}"),
        None => ": the machine has no room to stop farther on".to_string(),
    };
    format!("{name} stopped at {place:.3} {unit}{before}{reason}; jog it the other way")
}

/// Soft limits of a pose coordinate with their unit, for messages.
#[must_use]
pub fn soft_limits(axis: &AxisLimits) -> String {
    if axis.wraps() {
        return "no soft limits".to_string();
    }
    format!(
        "soft limits {} to {} {}",
        axis.low,
        axis.high,
        unit(axis.kind)
    )
}

/// What refuses the first pose beyond `at` along the rates, within the soft limits.
fn beyond(
    machine: &MachineFile,
    model: &Model,
    at: &Coordinates,
    rates: &Coordinates,
) -> Option<String> {
    let mut time_s = 1e-3;
    while time_s <= LONGEST_S {
        let mut pose = *at;
        let axes = pose.iter_mut().zip(rates).zip(&machine.pose);
        for ((value, rate), limits) in axes {
            *value = (*value + rate * time_s).clamp(limits.low, limits.high);
        }
        if let Err(problem) = model.joints(&pose) {
            let text = problem.to_string();
            // The remedy of the sentence is that of a program.
            let reason = text.split(';').next().unwrap_or(&text);
            return Some(reason.to_string());
        }
        time_s *= 1.25;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(machine: &MachineFile, axis: usize, at: Coordinates, rate: f64) -> String {
        let mut rates = Coordinates::default();
        rates[axis] = rate;
        jog_limit(machine, &Model::new(machine), axis, &at, &rates)
    }

    #[test]
    fn a_soft_limit_is_named_with_its_unit() {
        let text = include_str!("../../../machines/mill4.toml");
        let machine = MachineFile::parse("mill4.toml", text).expect("sound");
        let [x, a] = [&machine.pose[0], &machine.pose[3]];
        let low = [x.low, 0.0, 0.0, 0.0, 0.0, 0.0];
        let expected = format!("x stopped at its lower soft limit of {} mm; ", x.low);
        let text = sentence(&machine, 0, low, -20.0);
        assert!(text.starts_with(&expected), "{text}");
        assert!(text.contains("`low_mm`"), "{text}");
        let high = [0.0, 0.0, 0.0, a.high - 0.001, 0.0, 0.0];
        let expected = format!("a stopped at its upper soft limit of {} deg; ", a.high);
        let text = sentence(&machine, 3, high, 20.0);
        assert!(text.starts_with(&expected), "{text}");
        assert!(text.contains("`high_deg`"), "{text}");
        let expected = format!("soft limits {} to {} deg", a.low, a.high);
        assert_eq!(soft_limits(a), expected);
    }

    /// The arm tilts to 35 degrees by its soft limit. At the home pose the slide that runs out of
    /// stroke first is known from the inverse kinematics of the sweep.
    #[test]
    fn a_stroke_before_the_soft_limit_is_named_with_its_joint() {
        let machine = MachineFile::built_in().expect("sound");
        let model = Model::new(&machine);
        let home = model.home(&machine).expect("a pose");
        let mut at = model.to_engineering_units(&home);
        // The last tilt, in steps of 0.01 degrees, at which all joints are within their strokes.
        let is_reached = |at: &Coordinates| {
            let Ok(joints) = model.joints(at) else {
                return false;
            };
            let mut joints = machine.joints.iter().zip(joints);
            joints.all(|(limits, value)| (limits.low..=limits.high).contains(&value))
        };
        while is_reached(&at) && at[3] < 35.0 {
            at[3] += 0.01;
        }
        at[3] -= 0.01;
        assert!((20.0..34.9).contains(&at[3]), "{at:?}");
        let text = sentence(&machine, 3, at, 20.0);
        let joints = model.joints(&at).expect("reached");
        let rest =
            |(limits, value): (&AxisLimits, f64)| (value - limits.low).min(limits.high - value);
        let rests: Vec<f64> = machine.joints.iter().zip(joints).map(rest).collect();
        let first = (0..5)
            .min_by(|a, b| rests[*a].total_cmp(&rests[*b]))
            .expect("a joint");
        let expected = format!(
            "theta stopped at {:.3} deg, before its upper soft limit of 35 deg: farther on, {} ",
            at[3], machine.joints[first].name
        );
        assert!(text.starts_with(&expected), "{text}");
        assert!(text.contains("would leave its stroke by"), "{text}");
        assert!(text.ends_with("; jog it the other way"), "{text}");
    }
}
