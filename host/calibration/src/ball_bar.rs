//! Double ball bar: the circle test of ISO 230-4.
//!
//! The machine drives a circle in both directions, each with half a circle before and after the one
//! that counts. The bar reads the distance of the tool from a ball on the table.

use crate::drive::Machine;
use crate::noise::Noise;
use crate::observed::Sample;
use haptimill_client::{Error, ErrorKind};
use haptimill_volumetric::circle_readings::CircleReadings;
use haptimill_volumetric::gdt::fit_circle;

/// A circle test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CircleTest {
    /// Centre in x and y, mm; the height is z = 0.
    pub centre: [f64; 2],
    /// Nominal length of the bar, mm.
    pub radius: f64,
    /// Feed, mm/s.
    pub feed: f64,
    /// Two standard deviations of a reading, mm.
    pub noise: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl CircleTest {
    /// A bar of 100 mm at a feed.
    #[must_use]
    pub const fn at(feed: f64) -> Self {
        Self {
            centre: [0.0, 0.0],
            radius: 100.0,
            feed,
            noise: 0.2e-3,
            seed: 1,
        }
    }

    /// The part program.
    #[must_use]
    pub fn program(&self) -> String {
        let ([x, y], r) = (self.centre, self.radius);
        let feed = self.feed * 60.0;
        let (left, right) = (x - r, x + r);
        // Half a circle, a whole one, half a circle; then the other way.
        let turn = |arc: &str| {
            format!(
                "{arc} X{right} Y{y} I{r} J0\n{arc} X{right} Y{y} I-{r} J0\n\
                 {arc} X{left} Y{y} I-{r} J0\n"
            )
        };
        format!(
            "G21 G90 G17 G94 G64 F{feed}\nG0 X{left} Y{y} Z0\nG4 P0.5\n{}G4 P0.5\n{}G4 P0.5\nM30\n",
            turn("G3"),
            turn("G2"),
        )
    }
}

/// Result of a circle test, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct CircleResult {
    /// Circular deviation G counter-clockwise and clockwise: range of the distance from the centre
    /// of the least squares circle.
    pub deviation: [f64; 2],
    /// Circular hysteresis H: largest difference between the directions at one angle.
    pub hysteresis: f64,
    /// Largest and smallest radial deviation F over both directions, from the nominal radius.
    pub radial: [f64; 2],
    /// Angle between the axes, less 90 degrees, from the elliptic part, radians, in the sign of
    /// `EC0Y`.
    pub squareness: f64,
    /// Radial deviations by angle in steps of a degree, counter-clockwise and clockwise, mm.
    pub profile: [Vec<f64>; 2],
}

/// Runs a circle test.
///
/// # Errors
/// The circle is out of reach, or the run fails.
pub fn run(machine: &mut Machine, test: &CircleTest) -> Result<CircleResult, Error> {
    let samples = machine.run("circle test", &test.program())?;
    evaluate(&samples, test).ok_or_else(|| {
        Error::new(
            ErrorKind::Command,
            "the circle test has angles without a reading; use a slower feed or a larger circle",
        )
    })
}

/// Points of a circle at standstill.
const STANDSTILLS: u32 = 36;

/// Circular deviation G of the tool at standstill at 36 points of the circle, mm: without the
/// dynamics of the machine and without noise.
///
/// # Errors
/// As [`run`].
pub fn at_standstill(machine: &mut Machine, test: &CircleTest) -> Result<f64, Error> {
    let [x, y] = test.centre;
    let point = |step| {
        let angle = core::f64::consts::TAU * f64::from(step) / f64::from(STANDSTILLS);
        let (sine, cosine) = angle.sin_cos();
        [x + test.radius * cosine, y + test.radius * sine, 0.0]
    };
    let targets: Vec<[f64; 3]> = (0..STANDSTILLS).map(point).collect();
    let stood = machine.visit(&targets, test.feed, 1.2, 0.3)?;
    let points: Vec<[f64; 2]> = stood
        .iter()
        .map(|sample| [sample.tool[0], sample.tool[1]])
        .collect();
    let circle = fit_circle(&points)
        .map_err(|problem| Error::new(ErrorKind::Internal, format!("circle test: {problem}")))?;
    Ok(circle.roundness())
}

/// Steps of the profile.
const STEPS: usize = 360;

/// Evaluates the samples of a circle test; `None` where an angle has no reading.
#[must_use]
pub fn evaluate(samples: &[Sample], test: &CircleTest) -> Option<CircleResult> {
    let mut noise = Noise::new(test.seed, 3000);
    let [cx, cy] = test.centre;
    // The turn so far, by the commanded angle; a whole circle counts from half a turn on.
    let mut profile: [Vec<Vec<[f64; 2]>>; 2] = [vec![vec![]; STEPS], vec![vec![]; STEPS]];
    let mut turned = 0.0_f64;
    let mut before: Option<f64> = None;
    let mut direction = 0.0_f64;
    for sample in samples {
        let (x, y) = (sample.commanded[0] - cx, sample.commanded[1] - cy);
        if (x.hypot(y) - test.radius).abs() > 0.01 {
            before = None;
            continue;
        }
        let angle = y.atan2(x);
        let step = before.map_or(0.0, |before| wrapped(angle - before));
        before = Some(angle);
        if step != 0.0 && step.signum() != direction {
            direction = step.signum();
            turned = 0.0;
        }
        turned += step.abs();
        if step == 0.0 || !(0.5..1.5).contains(&(turned / core::f64::consts::TAU)) {
            continue;
        }
        let tool = [sample.tool[0] - cx, sample.tool[1] - cy];
        let length = tool[0].hypot(tool[1]);
        let read = length + noise.normal(0.5 * test.noise);
        let tool = tool.map(|part| part * read / length);
        let place = (angle.to_degrees().rem_euclid(360.0)) as usize % STEPS;
        profile[usize::from(direction < 0.0)][place].push(tool);
    }
    // The mean of the places is inside the arc, by 1.3 um for a degree of 100 mm: the mean length
    // counts.
    let mean = |points: &Vec<[f64; 2]>| {
        let count = points.len() as f64;
        let sum = |part: usize| points.iter().map(|point| point[part]).sum::<f64>() / count;
        let lengths = points.iter().map(|point| point[0].hypot(point[1]));
        let length = lengths.sum::<f64>() / count;
        let [x, y] = [sum(0), sum(1)];
        let inside = x.hypot(y);
        (!points.is_empty()).then(|| [x, y].map(|part| part * length / inside))
    };
    let of = |points: &[Vec<[f64; 2]>]| points.iter().map(mean).collect::<Option<Vec<_>>>();
    result([of(&profile[0])?, of(&profile[1])?], test.radius)
}

/// Evaluates the readings of a real bar of a nominal length, mm. Between readings the deviation is
/// linear.
///
/// `None` where the readings make no circle.
#[must_use]
pub fn of_readings(readings: &CircleReadings, radius: f64) -> Option<CircleResult> {
    let at = |readings: &[[f64; 2]], angle: f64| {
        let after = readings.partition_point(|[place, _]| *place <= angle);
        let count = readings.len();
        let [low, from] = *readings.get((after + count - 1) % count)?;
        let [high, to] = *readings.get(after % count)?;
        let share = (angle - low).rem_euclid(360.0) / (high - low).rem_euclid(360.0);
        Some(from + (to - from) * share)
    };
    let points = |readings: &[[f64; 2]]| -> Option<Vec<[f64; 2]>> {
        let point = |step: usize| {
            let angle = step as f64 + 0.5;
            let length = radius + at(readings, angle)?;
            let (sine, cosine) = angle.to_radians().sin_cos();
            Some([cosine, sine].map(|part| part * length))
        };
        (0..STEPS).map(point).collect()
    };
    result([points(&readings[0])?, points(&readings[1])?], radius)
}

/// Figures of two circles, one point for each degree.
fn result(both: [Vec<[f64; 2]>; 2], radius: f64) -> Option<CircleResult> {
    let radii = |points: &[[f64; 2]]| -> Vec<f64> {
        let lengths = points.iter().map(|point| point[0].hypot(point[1]) - radius);
        lengths.collect()
    };
    let radial = [radii(&both[0]), radii(&both[1])];
    let all = || radial.iter().flatten().copied();
    let round = |points: &[[f64; 2]]| fit_circle(points).ok().map(|circle| circle.roundness());
    let pairs = radial[0].iter().zip(&radial[1]);
    // A squareness moves x by -c0y y: the radius by -c0y r sin cos.
    let elliptic = |radii: &[f64]| {
        let parts = radii.iter().enumerate().map(|(step, deviation)| {
            let angle = (step as f64 + 0.5).to_radians();
            deviation * (2.0 * angle).sin()
        });
        -4.0 / radius * parts.sum::<f64>() / STEPS as f64
    };
    Some(CircleResult {
        deviation: [round(&both[0])?, round(&both[1])?],
        hysteresis: pairs
            .map(|(up, down)| (up - down).abs())
            .fold(0.0, f64::max),
        radial: [
            all().fold(f64::NEG_INFINITY, f64::max),
            all().fold(f64::INFINITY, f64::min),
        ],
        squareness: 0.5 * (elliptic(&radial[0]) + elliptic(&radial[1])),
        profile: radial,
    })
}

fn wrapped(angle: f64) -> f64 {
    let turn = core::f64::consts::TAU;
    angle - (angle / turn).round() * turn
}
