//! Curves that show the cause of a result outside its band, chosen by name in its reason.

use super::admittance::{Push, compliant_displacement, factor, interpolated};
use super::context::Context;
use super::revolution::shares;
use super::row_curve::RowCurve;
use super::statistics::Point;
use crate::definition::{ExpectedResult, Experiment, Pass, Reason};
use crate::pass_data::PassData;
use haptimill_client::session::HapticTraceSample;

/// Samples on either side over which a rate is taken: a revolution of the spindle in all, which
/// leaves out the tooth passing frequency, and 50 ms for an acceleration.
const RATE_SAMPLES: usize = 6;
const SLOW_SAMPLES: usize = 25;

/// Speed and force below which the angle between them is not shown, mm/s and N.
const CLEAR_SPEED: f64 = 0.5;
const CLEAR_FORCE: f64 = 0.5;

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Curves over time, or over the angle of a revolution.
pub struct CauseCurves {
    pub caption: String,
    /// Label of the horizontal axis; that of the curve of the result without it.
    pub x_label: Option<&'static str>,
    pub y_label: String,
    /// Range of the horizontal axis.
    pub x: (f64, f64),
    /// Labels and points.
    pub lines: Vec<(String, Vec<Point>)>,
}

/// What a pass must have for a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Needs {
    Cut,
    Operator,
    ForceControl,
}

/// A kind of curves.
struct Cause {
    name: &'static str,
    needs: Needs,
    curves: fn(&Context, &RowCurve, &Reason) -> CauseCurves,
}

const fn cause(
    name: &'static str,
    needs: Needs,
    curves: fn(&Context, &RowCurve, &Reason) -> CauseCurves,
) -> Cause {
    Cause {
        name,
        needs,
        curves,
    }
}

/// All causes.
const CAUSES: &[Cause] = &[
    // Commanded and true speed of the tool along the path.
    cause("feed", Needs::Cut, feed),
    // Speed of the hand and of the tool.
    cause("hand", Needs::Operator, hand),
    // Measured force and true force.
    cause("true_force", Needs::Cut, true_force),
    // p_c by (3.30) with the recorded force and with another one.
    cause("admittance", Needs::ForceControl, admittance),
    // Measured force, and the force that the motion of p_c needs by (3.30).
    cause("admittance_force", Needs::ForceControl, admittance_force),
    // Force feedback, and its part of the measured force.
    cause("feedback", Needs::Operator, feedback),
    // Angle between the force and the direction opposite to the motion.
    cause("angle", Needs::Cut, angle),
    // Radial, tangential and axial share of the force within a revolution.
    cause("revolution", Needs::Cut, revolution),
];

impl Cause {
    /// The cause of a reason; none if it names none.
    fn of(reason: &Reason) -> Option<&'static Self> {
        let name = reason.cause.as_ref()?;
        CAUSES.iter().find(|cause| cause.name == *name)
    }
}

/// The curves of the cause of a result; none if its reason names none.
pub fn cause_curves(
    experiment: &Experiment,
    passes: &[PassData],
    expected: &ExpectedResult,
    row: &RowCurve,
) -> Option<CauseCurves> {
    let reason = experiment.reason_of(expected)?;
    let context = Context::new(experiment, passes, &expected.measure)?;
    Some((Cause::of(reason)?.curves)(&context, row, reason))
}

/// Checks that the cause of a reason is known, and that a pass has what it needs.
///
/// # Errors
/// The key, and what is wrong with it.
pub fn check_cause(reason: &Reason, pass: &Pass) -> Result<(), String> {
    let Some(name) = &reason.cause else {
        return Ok(());
    };
    let cause = Cause::of(reason).ok_or_else(|| format!("cause: there is no cause \"{name}\""))?;
    let (has, what) = match cause.needs {
        Needs::Cut => (pass.has_cutting(), "cut"),
        Needs::Operator => (pass.teleoperation.is_some(), "operator"),
        Needs::ForceControl => (pass.force_control.is_some(), "force control"),
    };
    if has {
        Ok(())
    } else {
        Err(format!("cause: \"{name}\": the pass has no {what}"))
    }
}

/// What programmed and teleoperated passes have in common.
#[derive(Debug, Clone, Copy)]
struct Motion {
    time: f64,
    commanded: [f64; 3],
    tool: [f64; 3],
    peak_force: [f64; 3],
    displacement: [f64; 3],
}

fn motions(context: &Context, (from, to): (f64, f64)) -> Vec<Motion> {
    if context.pass.teleoperation.is_some() {
        let samples = context.teleoperation().between(from, to).iter();
        let motion = |s: &HapticTraceSample| Motion {
            time: s.time,
            commanded: s.commanded,
            tool: s.tool,
            peak_force: s.high,
            displacement: s.displacement,
        };
        return samples.map(motion).collect();
    }
    let samples = context.data.trace.between(from, to).iter();
    let motions = samples.map(|s| Motion {
        time: s.time,
        commanded: s.commanded,
        tool: s.tool,
        peak_force: s.peak_force,
        displacement: s.compliant_displacement,
    });
    motions.collect()
}

/// Rate of a value over `span` samples on either side; the ends have none.
fn rate<T, V>(
    samples: &[T],
    span: usize,
    value: impl Fn(&T) -> (f64, [f64; 3]),
    of: impl Fn([f64; 3]) -> V,
) -> Vec<(f64, V)> {
    let pairs = samples.windows(2 * span + 1);
    let rates = pairs.map(|pair| {
        let (first, last) = (value(&pair[0]), value(&pair[2 * span]));
        let duration = last.0 - first.0;
        let rate = std::array::from_fn(|axis| (last.1[axis] - first.1[axis]) / duration);
        ((first.0 + last.0) / 2.0, of(rate))
    });
    rates.collect()
}

fn norm([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

fn speed(motions: &[Motion], position: fn(&Motion) -> [f64; 3]) -> Vec<Point> {
    rate(motions, RATE_SAMPLES, |m| (m.time, position(m)), norm)
}

fn line(label: impl Into<String>, points: Vec<Point>) -> (String, Vec<Point>) {
    (label.into(), points)
}

fn feed(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let motions = motions(context, row.x);
    CauseCurves {
        caption: "Speed along the path".to_string(),
        x_label: None,
        y_label: "speed, mm/s".to_string(),
        x: row.x,
        lines: vec![
            line("commanded", speed(&motions, |m| m.commanded)),
            line("tool", speed(&motions, |m| m.tool)),
        ],
    }
}

fn hand(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let samples = context.teleoperation().between(row.x.0, row.x.1);
    let hand = samples.iter().map(|s| (s.time, norm(s.velocity)));
    let mut lines = vec![line("hand", hand.collect())];
    if context.pass.has_cutting() {
        let motions = motions(context, row.x);
        lines.push(line("tool", speed(&motions, |m| m.tool)));
    }
    CauseCurves {
        caption: "Speed of the hand, which the force follows".to_string(),
        x_label: None,
        y_label: "speed, mm/s".to_string(),
        x: row.x,
        lines,
    }
}

fn true_force(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let axis = context.axis();
    let offset = context.trace_offset();
    let samples = context
        .data
        .trace
        .between(row.x.0 + offset, row.x.1 + offset);
    let over_time = |value: fn(&crate::Sample, usize) -> f64| -> Vec<Point> {
        let points = samples.iter().map(|s| (s.time - offset, value(s, axis)));
        points.collect()
    };
    CauseCurves {
        caption: "Measured force and true force of the simulated cut, peaks of a revolution"
            .to_string(),
        x_label: None,
        y_label: format!("F{}, N", AXES[axis].to_lowercase()),
        x: row.x,
        lines: vec![
            line("measured", over_time(|s, axis| s.peak_force[axis])),
            line("true", over_time(|s, axis| s.true_force[axis])),
        ],
    }
}

fn admittance(context: &Context, row: &RowCurve, reason: &Reason) -> CauseCurves {
    let axis = context.axis();
    let motions = motions(context, (f64::NEG_INFINITY, row.x.1));
    let label = format!("p_c in {}, mm", AXES[axis]);
    let recorded: Vec<Point> = motions
        .iter()
        .map(|m| (m.time, m.displacement[axis]))
        .collect();
    let mut lines = vec![line("recorded", recorded)];
    let rates = rate(&motions, 1, |m| (m.time, m.commanded), |rate| rate[axis]);
    let inner = motions.get(1..).unwrap_or_default();
    let pushes: Vec<Push> = rates
        .iter()
        .zip(inner)
        .map(|((_, rate), m)| Push {
            time: m.time,
            rate: *rate,
            force: m.peak_force[axis],
        })
        .collect();
    if let Some(control) = &context.pass.force_control {
        lines.push(line("(3.30)", compliant_displacement(control, &pushes)));
        let with = |force: &dyn Fn(&Push) -> f64| {
            let changed = pushes.iter().map(|push| Push {
                force: force(push),
                ..*push
            });
            compliant_displacement(control, &changed.collect::<Vec<_>>())
        };
        if !reason.stated_force.is_empty() {
            let stated = with(&|push| interpolated(&reason.stated_force, push.time));
            lines.push(line("(3.30), stated force", stated));
        } else if let Some(goal) = row.goal.filter(|_| row.is_displacement) {
            let (from, to) = row.measured;
            let reached = |factor: f64| {
                let points = with(&|push| factor * push.force);
                let inside = points.iter().filter(|(t, _)| (from..=to).contains(t));
                inside.fold(0.0, |max: f64, (_, value)| max.max(value.abs()))
            };
            let factor = factor(reached, goal.abs());
            let label = format!("(3.30), {factor:.2} times the force");
            lines.push(line(label, with(&|push| factor * push.force)));
        }
    }
    CauseCurves {
        caption: "Compliant displacement by (3.30), the integral of force minus f_d".to_string(),
        x_label: None,
        y_label: label,
        x: row.x,
        lines,
    }
}

fn admittance_force(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let axis = context.axis();
    let motions = motions(context, row.x);
    let measured = motions.iter().map(|m| (m.time, m.peak_force[axis]));
    let mut lines = vec![line("measured", measured.collect())];
    if let Some(control) = &context.pass.force_control {
        let rates = rate(
            &motions,
            SLOW_SAMPLES,
            |m| (m.time, m.displacement),
            |rate| rate,
        );
        let inner = motions.get(2 * SLOW_SAMPLES..).unwrap_or_default();
        let accelerations = rate(&rates, SLOW_SAMPLES, |r| (r.0, r.1), |a| a[axis]);
        let inner_rates = rates.get(SLOW_SAMPLES..).unwrap_or_default();
        let needed = accelerations.iter().zip(inner_rates).zip(inner);
        let needed = needed.map(|(((time, acceleration), (_, rate)), m)| {
            let sign = m.displacement[axis].signum();
            let force = sign * control.setpoint_n
                + control.virtual_damping * rate[axis]
                + control.virtual_mass * acceleration;
            (*time, force)
        });
        lines.push(line("needed", needed.collect()));
        let setpoint = [row.x.0, row.x.1].map(|time| (time, control.setpoint_n));
        lines.push(line("f_d", setpoint.to_vec()));
    }
    CauseCurves {
        caption: "Measured force, and the one that the motion of the tool needs by (3.30): f_d, K_V times \
                  the rate of p_c, and K_A times its acceleration".to_string(),
        x_label: None,
        y_label: format!("F{}, N", AXES[axis].to_lowercase()),
        x: row.x,
        lines,
    }
}

fn feedback(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let axis = context.axis();
    let samples = context.teleoperation().between(row.x.0, row.x.1);
    let over_time = |value: &dyn Fn(&HapticTraceSample) -> f64| -> Vec<Point> {
        samples.iter().map(|s| (s.time, value(s))).collect()
    };
    let mut lines = vec![line("force feedback", over_time(&|s| s.feedback[axis]))];
    if let Some(settings) = &context.pass.teleoperation {
        let percent = settings.feedback.axes()[axis].percent;
        let part = f64::from(percent) / 100.0;
        lines.push(line(
            format!("{percent} % of the measured force"),
            over_time(&|s| part * s.high[axis]),
        ));
    }
    CauseCurves {
        caption: "Force feedback and the measured force".to_string(),
        x_label: None,
        y_label: format!("force in {}, N", AXES[axis]),
        x: row.x,
        lines,
    }
}

/// Angle from the direction opposite to a motion to a force, degrees, counter-clockwise.
fn angle_to_opposite([vx, vy, _]: [f64; 3], [fx, fy, _]: [f64; 3]) -> f64 {
    let (along, across) = (-vx * fx - vy * fy, -vx * fy + vy * fx);
    across.atan2(along).to_degrees()
}

fn angle(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let motions = motions(context, row.x);
    let rates = rate(
        &motions,
        RATE_SAMPLES,
        |m| (m.time, m.commanded),
        |rate| rate,
    );
    let inner = motions.get(RATE_SAMPLES..).unwrap_or_default();
    let clear = rates.iter().zip(inner).filter(|((_, rate), m)| {
        let [x, y, _] = m.peak_force;
        norm(*rate) > CLEAR_SPEED && x.hypot(y) > CLEAR_FORCE
    });
    let angles = clear.map(|((time, rate), m)| (*time, angle_to_opposite(*rate, m.peak_force)));
    CauseCurves {
        caption: "Angle of the peak force in the plane against the direction opposite to the \
                  motion; at 0 it opposes the motion"
            .to_string(),
        x_label: None,
        y_label: "angle, degrees".to_string(),
        x: row.x,
        lines: vec![
            line("force", angles.collect()),
            line(
                "opposite to the motion",
                vec![(row.x.0, 0.0), (row.x.1, 0.0)],
            ),
        ],
    }
}

fn revolution(context: &Context, row: &RowCurve, _: &Reason) -> CauseCurves {
    let axis = context.axis();
    let trace = &context.data.trace;
    let at = row.mark.map_or(f64::NAN, |mark| mark.0) + context.trace_offset();
    let last = ((at - trace.first_period) / trace.period_s).max(0.0) as usize;
    let last = last.min(trace.periods.len());
    // Periods of the last revolution before the time.
    let mut turns = 0.0;
    let before = trace.periods[..last].iter().rev().take_while(|period| {
        turns += period.turns.abs();
        period.turns != 0.0 && turns <= 1.0 + 1e-9
    });
    let first = last - before.count();
    let count = (last - first).max(1) as f64;
    let over_angle = |force: &dyn Fn(usize) -> f64| -> Vec<Point> {
        let points = (first..last).map(|index| {
            let angle = 360.0 * (index - first) as f64 / count;
            (angle, force(index))
        });
        points.collect()
    };
    let shares = shares(context.data);
    let share = |of: &[[f64; 3]], index: usize| of.get(index).map_or(f64::NAN, |f| f[axis]);
    let parts = [
        ("radial", &shares.radial),
        ("tangential", &shares.tangential),
        ("axial", &shares.axial),
    ];
    // The angle of the spindle in these simulations is not that of the recording.
    let sum = |index| parts.iter().map(|(_, of)| share(of, index)).sum();
    let mut lines = vec![line("force", over_angle(&sum))];
    for (label, of) in parts {
        lines.push(line(label, over_angle(&|index| share(of, index))));
    }
    let time = row.mark.map_or(f64::NAN, |mark| mark.0);
    CauseCurves {
        caption: format!(
            "Force on the tool within the revolution before {time:.2} s, and the shares of the \
             radial, the tangential and the axial force"
        ),
        x_label: Some("angle of the spindle within the revolution, degrees"),
        y_label: format!("F{}, N", AXES[axis].to_lowercase()),
        x: (0.0, 360.0),
        lines,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::definition::{ForceControl, WorkAxis};

    const CONTROL: ForceControl = ForceControl {
        axes: Vec::new(),
        setpoint_n: 5.0,
        virtual_mass: 1.0,
        virtual_damping: 5.0,
    };

    #[test]
    fn angles_count_from_the_direction_opposite_to_the_motion() {
        let towards = [-4.0, 0.0, 0.0];
        for (force, angle) in [
            ([5.0, 0.0, 9.0], 0.0),
            ([0.0, 5.0, 0.0], 90.0),
            ([0.0, -5.0, 0.0], -90.0),
        ] {
            assert!((angle_to_opposite(towards, force) - angle).abs() < 1e-9);
        }
    }

    #[test]
    fn the_speed_of_a_uniform_motion_is_its_feed() {
        let motion = |n: u32| Motion {
            time: f64::from(n) * 1e-3,
            commanded: [-3e-3 * f64::from(n), 4e-3 * f64::from(n), 0.0],
            tool: [0.0; 3],
            peak_force: [0.0; 3],
            displacement: [0.0; 3],
        };
        let motions: Vec<Motion> = (0..100).map(motion).collect();
        let speeds = speed(&motions, |m| m.commanded);
        assert_eq!(speeds.len(), 100 - 2 * RATE_SAMPLES);
        assert!(speeds.iter().all(|(_, speed)| (speed - 5.0).abs() < 1e-9));
        assert!((speeds[0].0 - 6e-3).abs() < 1e-12);
    }

    #[test]
    fn a_cause_needs_a_pass_that_has_it() {
        let mut experiment = crate::all().unwrap().swap_remove(0);
        let pass = &mut experiment.passes[0];
        let reason = |name: &str| Reason {
            text: String::new(),
            cause: Some(name.to_string()),
            stated_force: Vec::new(),
        };
        assert_eq!(check_cause(&reason("feed"), pass), Ok(()));
        for (name, problem) in [
            ("wind", "cause: there is no cause \"wind\""),
            ("hand", "cause: \"hand\": the pass has no operator"),
            (
                "admittance",
                "cause: \"admittance\": the pass has no force control",
            ),
        ] {
            assert_eq!(check_cause(&reason(name), pass), Err(problem.to_string()));
        }
        let axes = vec![WorkAxis::X];
        pass.force_control = Some(ForceControl { axes, ..CONTROL });
        assert_eq!(check_cause(&reason("admittance"), pass), Ok(()));
    }
}
