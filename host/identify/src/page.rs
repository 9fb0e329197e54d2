//! The offline page of an identification, and of a tuning.

use crate::complex::Complex;
use crate::edit::Change;
use crate::identify::Identified;
use crate::index_pulses::{IndexPulses, UNKNOWN};
use crate::lost_steps::{StepLimits, Trial};
use crate::servo_loop::Gains;
use crate::switch_test::Skipped;
use crate::tune::Joint;
use crate::two_mass::TwoMass;
use haptimill_firmware::config::AxisKind;
use haptimill_report::chart::{COLOURS, Chart, Line};
use haptimill_report::markup::{END, card, escape, head, put};

const STYLE: &str =
    "td.n,th.n{text-align:right}th{text-align:left;padding:7px 14px;font-size:13px;color:#3b4754}";

/// Units of effort, motion and inertia of a joint.
const fn units(kind: AxisKind) -> [&'static str; 3] {
    if kind.is_rotary() {
        ["N m", "deg", "kg m^2"]
    } else {
        ["N", "mm", "kg"]
    }
}

fn line(label: &str, colour: usize, width: f64, points: Vec<(f64, f64)>) -> Line {
    Line {
        label: label.to_string(),
        colour: COLOURS[colour % COLOURS.len()],
        width,
        pieces: vec![points],
    }
}

/// Each point as a short stroke: the chart has no markers.
fn marks(label: &str, colour: usize, points: &[(f64, f64)], size: f64) -> Line {
    Line {
        label: label.to_string(),
        colour: COLOURS[colour % COLOURS.len()],
        width: 5.0,
        pieces: points
            .iter()
            .map(|(x, y)| vec![(*x - size, *y), (*x + size, *y)])
            .collect(),
    }
}

fn chart(x: &str, y: String, lines: Vec<Line>) -> Chart {
    Chart {
        x_label: x.to_string(),
        y_label: y,
        lines,
        width: 560.0,
        height: 300.0,
        equal: false,
        from_zero: false,
        backdrop: None,
    }
}

const FREQUENCY: &str = "frequency, log10 Hz";

fn curve(low: f64, high: f64, value: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    (0..400)
        .map(|index| low * (high / low).powf(f64::from(index) / 399.0))
        .map(|frequency| (frequency.log10(), value(frequency)))
        .collect()
}

fn decibel(response: Complex) -> f64 {
    20.0 * response.abs().log10()
}

fn bode(joint: &Identified) -> [Chart; 2] {
    let [effort, motion, _] = units(joint.kind);
    let plant: TwoMass = joint.shown();
    let low = joint.points.first().map_or(1.0, |it| it.frequency);
    let high = joint.points.last().map_or(100.0, |it| it.frequency);
    let measured = |value: &dyn Fn(Complex) -> f64| -> Vec<(f64, f64)> {
        let points = joint.points.iter();
        points
            .map(|it| (it.frequency.log10(), value(it.response)))
            .collect()
    };
    // Between -360 and 0 degrees.
    let phase = |response: Complex| {
        let degrees = response.phase().to_degrees();
        if degrees > 30.0 {
            degrees - 360.0
        } else {
            degrees
        }
    };
    let size = (high / low).log10() / 400.0;
    [
        chart(
            FREQUENCY,
            format!("{motion}/{effort}, dB"),
            vec![
                line(
                    "model",
                    0,
                    1.6,
                    curve(low, high, |f| decibel(plant.response(f))),
                ),
                marks("measured", 1, &measured(&decibel), size),
            ],
        ),
        chart(
            FREQUENCY,
            "phase, deg".to_string(),
            vec![
                line(
                    "model",
                    0,
                    1.6,
                    curve(low, high, |f| phase(plant.response(f))),
                ),
                marks("measured", 1, &measured(&phase), size),
            ],
        ),
    ]
}

fn friction(joint: &Identified) -> Chart {
    let [effort, motion, _] = units(joint.kind);
    let points: Vec<(f64, f64)> = joint
        .friction
        .points
        .iter()
        .map(|it| (it.rate, it.effort))
        .collect();
    let top = points.iter().map(|it| it.0.abs()).fold(0.0, f64::max);
    let [forward, backward] = joint.friction.coulomb;
    let slope = joint.friction.viscous;
    let mut model = line(
        "model",
        0,
        1.6,
        vec![(-top, -backward - slope * top), (0.0, -backward)],
    );
    model
        .pieces
        .push(vec![(0.0, forward), (top, forward + slope * top)]);
    chart(
        &format!("rate, {motion}/s"),
        format!("effort, {effort}"),
        vec![model, marks("measured", 1, &points, top / 200.0)],
    )
}

/// Rates and accelerations with and without loss.
fn lost_steps(joint: &StepLimits) -> Chart {
    let trials = joint.rates.iter().chain(&joint.accelerations);
    let trials: Vec<&Trial> = trials.chain(&joint.proposal).collect();
    let size = joint.bounds.rate[1] / 200.0;
    let points = |is_lost: bool| -> Vec<(f64, f64)> {
        let chosen = trials.iter().filter(|it| it.is_lost == is_lost);
        chosen
            .map(|it| (it.motion.rate, it.motion.acceleration))
            .collect()
    };
    let [rate, acceleration] = joint.units();
    chart(
        &format!("rate, {rate}"),
        format!("acceleration, {acceleration}"),
        vec![
            marks("no loss", 0, &points(false), size),
            marks("steps lost", 1, &points(true), size),
        ],
    )
}

/// Rows of what changed.
fn table(page: &mut String, changes: &[Change]) {
    page.push_str(
        "<table><tr><th>key</th><th class=\"n\">before</th><th class=\"n\">after</th></tr>",
    );
    for change in changes {
        let before = change.before.map_or("-".to_string(), |it| it.to_string());
        put(
            page,
            format_args!(
                "<tr><td>{}</td><td class=\"n\">{before}</td><td class=\"n\">{}</td></tr>",
                escape(&change.key),
                change.after
            ),
        );
    }
    page.push_str("</table>");
}

/// One line for each joint.
#[must_use]
pub fn summary(joint: &Identified) -> String {
    let [effort, motion, inertia] = units(joint.kind);
    let [forward, backward] = joint.friction.coulomb;
    let plant = joint.plant;
    let resonance = match joint.resonance {
        Ok(()) => format!(
            "resonance {:.1} Hz (damping {:.3}, {:.0} % of the inertia at the motor)",
            plant.mode_hz,
            plant.mode_damping,
            plant.motor_share * 100.0
        ),
        Err(highest) => format!(
            "no resonance below {highest:.0} Hz (gains are proposed for one at {:.0} Hz)",
            plant.mode_hz
        ),
    };
    format!(
        "{}: inertia {:.4} {inertia}, Coulomb friction {forward:.3} {effort} forward and \
         {backward:.3} {effort} backward, viscous {:.4} {effort} s/{motion}, {resonance}, \
         median misfit {:.1} %",
        joint.name,
        plant.inertia,
        joint.friction.viscous,
        joint.error * 100.0
    )
}

/// The page of an identification.
#[must_use]
pub fn identification(
    machine: &str,
    date: &str,
    joints: &[Identified],
    steps: &[StepLimits],
    skipped: &[Skipped],
    changes: &[Change],
) -> String {
    let title = format!("Identification of {machine}");
    let mut page = head(&title, STYLE);
    put(
        &mut page,
        format_args!(
            "<h1>{}</h1><p class=\"sub\">{date}, by haptimill identify. Effort is that of the \
             drive, motion that of the encoder.</p>",
            escape(&title)
        ),
    );
    table(&mut page, changes);
    for joint in joints {
        put(
            &mut page,
            format_args!("<h2>Joint {}</h2>", escape(&joint.name)),
        );
        put(
            &mut page,
            format_args!("<p>{}</p>", escape(&summary(joint))),
        );
        let [gain, phase] = bode(joint);
        page.push_str("<div class=\"pair\">");
        card(&mut page, "Motion for effort: gain", &gain.svg());
        card(&mut page, "Phase", &phase.svg());
        card(
            &mut page,
            "Effort at a constant rate",
            &friction(joint).svg(),
        );
        page.push_str("</div>");
    }
    for joint in steps {
        put(
            &mut page,
            format_args!(
                "<h2>Joint {}</h2><p>{}</p><div class=\"pair\">",
                escape(&joint.name),
                escape(&joint.summary())
            ),
        );
        let caption = "Tests for lost steps";
        card(&mut page, caption, &lost_steps(joint).svg());
        page.push_str("</div>");
    }
    not_measured(&mut page, skipped);
    page.push_str(END);
    page
}

fn not_measured(page: &mut String, skipped: &[Skipped]) {
    if skipped.is_empty() {
        return;
    }
    page.push_str("<h2>Not measured</h2><ul>");
    for joint in skipped {
        let (name, reason) = (escape(&joint.name), escape(&joint.reason));
        put(page, format_args!("<li>{name}: {reason}</li>"));
    }
    page.push_str("</ul>");
}

/// Distance of each pass from the mean, in both directions.
fn passes(joint: &IndexPulses) -> Chart {
    let size = joint.passes.len() as f64 / 200.0;
    let numbered = joint.passes.iter().enumerate();
    let points = |upwards: bool| -> Vec<(f64, f64)> {
        let chosen = numbered.clone().filter(|(_, it)| it.upwards == upwards);
        chosen
            .map(|(number, it)| (number as f64 + 1.0, joint.deviation(it)))
            .collect()
    };
    // The proposed slack gives the scale: without it, rounding would fill the chart.
    let last = joint.passes.len() as f64 + 1.0;
    let deviations = joint.passes.iter().map(|it| joint.deviation(it));
    let high = deviations.fold(f64::NEG_INFINITY, f64::max);
    let middle = high - joint.spread() / 2.0;
    let ends = [-0.5, 0.5].map(|part| middle + part * f64::from(joint.slack()));
    let mut slack = line("slack", 2, 1.0, Vec::new());
    slack.pieces = ends.map(|end| vec![(0.0, end), (last, end)]).to_vec();
    chart(
        "pass",
        "distance from the mean, counts".to_string(),
        vec![
            slack,
            marks("upwards", 0, &points(true), size),
            marks("downwards", 1, &points(false), size),
        ],
    )
}

/// The page of index pulses.
#[must_use]
pub fn index_pulses(
    machine: &str,
    date: &str,
    joints: &[IndexPulses],
    skipped: &[Skipped],
    changes: &[Change],
) -> String {
    let title = format!("Index pulses of {machine}");
    let mut page = head(&title, STYLE);
    put(
        &mut page,
        format_args!(
            "<h1>{}</h1><p class=\"sub\">{date}, by haptimill identify --index, from the shifts of \
             repeated reference searches. {UNKNOWN}</p>",
            escape(&title)
        ),
    );
    table(&mut page, changes);
    for joint in joints {
        put(
            &mut page,
            format_args!(
                "<h2>Joint {}</h2><p>{}</p><div class=\"pair\">",
                escape(&joint.name),
                escape(&joint.summary())
            ),
        );
        card(
            &mut page,
            "Passes over the index pulse",
            &passes(joint).svg(),
        );
        page.push_str("</div>");
    }
    not_measured(&mut page, skipped);
    page.push_str(END);
    page
}

/// A joint before and after tuning.
pub struct Tuned {
    /// Its name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// The joint.
    pub joint: Joint,
    /// Gains of the machine file, and proposed ones.
    pub gains: [Gains; 2],
    /// Coulomb friction, N or N m: size of the step of the load.
    pub coulomb: f64,
    /// What the gains of the machine file miss of the requirement.
    pub misses: Vec<String>,
}

impl Tuned {
    /// Whether the gains of the machine file keep the requirement, as a sentence.
    #[must_use]
    pub fn verdict(&self) -> String {
        if self.misses.is_empty() {
            return "the gains of the machine file keep all requirements".to_string();
        }
        let misses = self.misses.join("; ");
        format!("the gains of the machine file miss: {misses}")
    }
}

/// Margins of both sets of gains as a line of text.
#[must_use]
pub fn margins(tuned: &Tuned) -> [String; 2] {
    tuned.gains.map(|gains| {
        let margins = tuned.joint.margins(&gains);
        format!(
            "kp {}, kd {}, ki {}, rate filter {} ms: gain margin {:.1} dB ({:.1} dB with the gap \
             open), phase margin {:.0} deg ({:.0} deg), sensitivity {:.2} ({:.2}), crossover \
             {:.1} Hz",
            gains.kp,
            gains.kd,
            gains.ki,
            crate::tune::rounded(gains.rate_filter * 1e3),
            margins.closed.gain_db,
            margins.open.gain_db,
            margins.closed.phase_deg,
            margins.open.phase_deg,
            margins.closed.peak,
            margins.open.peak,
            margins.closed.crossover_hz
        )
    })
}

/// The page of a tuning.
#[must_use]
pub fn tuning(machine: &str, date: &str, joints: &[Tuned], changes: &[Change]) -> String {
    const NAMES: [&str; 2] = ["before", "after"];
    let title = format!("Gains of {machine}");
    let mut page = head(&title, STYLE);
    put(
        &mut page,
        format_args!(
            "<h1>{}</h1><p class=\"sub\">{date}, by haptimill tune, on the identified joints. The \
             step responses are computed, without friction and backlash.</p>",
            escape(&title)
        ),
    );
    table(&mut page, changes);
    for tuned in joints {
        let [effort, motion, _] = units(tuned.kind);
        let plant = tuned.joint.plant;
        let period = tuned.joint.period;
        put(
            &mut page,
            format_args!("<h2>Joint {}</h2>", escape(&tuned.name)),
        );
        for (name, text) in NAMES.iter().zip(margins(tuned)) {
            put(&mut page, format_args!("<p>{name}: {}</p>", escape(&text)));
        }
        put(
            &mut page,
            format_args!("<p>{}</p>", escape(&tuned.verdict())),
        );
        let both = |value: &dyn Fn(&Gains) -> Vec<(f64, f64)>| -> Vec<Line> {
            let curves = tuned.gains.iter().zip(NAMES).enumerate();
            curves
                .map(|(index, (gains, name))| line(name, index, 1.6, value(gains)))
                .collect()
        };
        // The slowest response of both: eight times the slowest pole.
        let slow = tuned
            .gains
            .iter()
            .map(|it| 24.0 / it.kp.max(1.0).sqrt())
            .fold(0.1, f64::max);
        let half = |gains: &Gains, load: bool| -> Vec<(f64, f64)> {
            let curve = gains.steps(&plant, period, 2.0 * slow, tuned.coulomb);
            let part = curve.len() / 2;
            let points = if load { &curve[part..] } else { &curve[..part] };
            let start = points.first().map_or(0.0, |it| it.0);
            let offset = if load { 1.0 } else { 0.0 };
            points
                .iter()
                .map(|(time, x)| ((time - start) * 1e3, x - offset))
                .collect()
        };
        page.push_str("<div class=\"pair\">");
        let lines = both(&|gains| half(gains, false));
        let step = chart("ms", format!("driven mass, {motion}"), lines);
        card(
            &mut page,
            &format!("Step of the setpoint of 1 {motion}"),
            &step.svg(),
        );
        let lines = both(&|gains| half(gains, true));
        let load = chart("ms", format!("driven mass, {motion}"), lines);
        let caption = format!(
            "Step of a load of {:.3} {effort} (the Coulomb friction) on the driven mass",
            tuned.coulomb
        );
        card(&mut page, &caption, &load.svg());
        let lines = both(&|gains| {
            curve(1.0, 0.45 / period, |f| {
                decibel(gains.open_loop(plant.response(f), plant.unit, f, period)).max(-80.0)
            })
        });
        let open = chart(FREQUENCY, "open loop, dB".to_string(), lines);
        card(&mut page, "Gain of the open loop", &open.svg());
        page.push_str("</div>");
    }
    page.push_str(END);
    page
}
