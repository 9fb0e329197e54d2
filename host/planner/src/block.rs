//! Check of a move: every pose must be reachable, and the limits give its maximum speed.

use super::limits::{MachineModel, PoseProblem, Settings};
use super::profile::Along;
use super::samples::{JointDerivatives, Samples};
use haptimill_gcode::{Coordinates, Feed, Move, Path, Place, Problem, ToolLength, WordKind};

/// Planned share of the acceleration limit; the rest is for rounding to periods and units.
pub(super) const ACCELERATION_SHARE: f64 = 0.95;
/// See [`ACCELERATION_SHARE`].
pub(super) const JERK_SHARE: f64 = 0.9;
/// On an arc, shares of the acceleration in the plane: across and along the path (together 0.99).
const CENTRIPETAL_SHARE: f64 = 0.5;
const TANGENTIAL_SHARE: f64 = 0.85;
/// On an arc, shares of the jerk in the plane: v^3 / r^2 and the ramp along the path, 3 v a / r
/// across (together 0.9).
const ARC_SPEED_JERK: f64 = 0.25;
const ARC_RAMP_JERK: f64 = 0.5;
const ARC_ACROSS_JERK: f64 = 0.5;
/// Shares of a joint's acceleration: for the curvature of its path, and for the ramp or a corner.
const JOINT_CURVATURE_SHARE: f64 = 0.4;
pub(super) const JOINT_RAMP_SHARE: f64 = 0.5;
/// Shares of a joint's jerk: speed^3 times the third derivative of its path, 3 times speed and
/// acceleration times the second one, or a corner. The ramp has the rest of [`JERK_SHARE`].
const JOINT_SPEED_JERK: f64 = 0.2;
const JOINT_ACROSS_JERK: f64 = 0.3;
pub(super) const JOINT_CORNER_JERK: f64 = 0.5;
/// A move that the joints slow down below this share of the speed of its fastest part is divided.
const EVEN_SPEED: f64 = 0.7;
/// Shortest part of a divided move, mm or degrees.
const SHORTEST_PART: f64 = 1.0;

/// A checked move.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    pub place: Place,
    /// Places of the moves that are joined, by the length from which they hold; none for one move.
    pub places: Vec<(f64, Place)>,
    /// Number of messages of the program before it.
    pub messages: u32,
    /// Path of the tip, and the tool that makes the pose of the machine from it.
    pub path: Path,
    pub tool: ToolLength,
    pub is_rapid: bool,
    /// Whether the overrides have no effect.
    pub is_fixed: bool,
    pub exact_stop: bool,
    /// Whether the next block is the next part of the same move.
    pub continues: bool,
    /// Whether the limits of the machine keep it below its feed.
    pub is_slowed: bool,
    /// Largest distance of a corner from the path, mm, if the program gives one.
    pub tolerance: Option<f64>,
    /// Share of the tolerance of rotary coordinates that its corners have.
    pub turns: f64,
    /// Limits along the path.
    pub along: Along,
    /// Maximum speed without the feed.
    pub max: f64,
    /// Derivatives of pose and joints by length, at start and end.
    pub tangents: [Coordinates; 2],
    pub joint_tangents: [[f64; 6]; 2],
    /// Those of the machine's pose, which differ from those of the tip if the tool turns.
    pub machine_tangents: [Coordinates; 2],
}

impl Block {
    /// Returns a bound of the fourth time derivative of the machine's motion, for the error of a
    /// cubic; 0 on a line without a turning tool.
    pub(crate) fn fourth_derivative(&self, speed: f64, acceleration: f64, jerk: f64) -> f64 {
        // d^4/dt^4 of r e^(i phi), phi' = w v.
        let turning = |radius: f64, w: f64| {
            radius
                * (w.powi(4) * speed.powi(4)
                    + 6.0 * w.powi(3) * speed * speed * acceleration
                    + w * w * (3.0 * acceleration * acceleration + 4.0 * speed * jerk))
        };
        let along_arc = self.path.arc.as_ref().map_or(0.0, |arc| {
            // A tenth for a changing radius.
            let radius = 1.1 * arc.radius[0].max(arc.radius[1]);
            turning(radius, (arc.sweep / self.path.length).abs())
        });
        let tool = self.tool.turn_per_length(&self.path);
        along_arc + turning(self.tool.length.abs(), tool)
    }
}

/// Largest magnitude of a coordinate in the protocol, axis units: a little below 2^31.
const NUMBER_RANGE: f64 = 2_146_435_072.0;

/// Problem and remedy.
type Refusal = (String, String);

/// Checks a pose against soft limits, the number range of the protocol, and the machine.
pub(super) fn check_pose(
    pose: &Coordinates,
    settings: &Settings,
    model: &impl MachineModel,
) -> Result<[f64; 6], Refusal> {
    check_soft_limits(pose, None, settings)?;
    let joints = model.joints(pose);
    joints.map_err(|problem| out_of_reach(&problem, pose, settings))
}

/// Checks the end of a move as [`check_pose`]: what its block has in words.
fn check_end(step: &Move, settings: &Settings, model: &impl MachineModel) -> Result<(), Refusal> {
    let end = step.tool.machine_pose(&step.path.to);
    check_soft_limits(&end, Some(&step.programmed), settings)?;
    check_pose(&end, settings, model).map(|_| ())
}

/// Whether the problem of a move is that of its start, which an earlier move has: the same
/// coordinate is outside its limits, or the machine cannot reach either.
pub(super) fn fails_as_at_its_start(
    step: &Move,
    settings: &Settings,
    model: &impl MachineModel,
) -> bool {
    let outside = |pose: &Coordinates, k: usize| {
        let axis = &settings.pose[k];
        !(axis.low..=axis.high).contains(&pose[k])
    };
    let [from, to] = [&step.path.from, &step.path.to].map(|tip| step.tool.machine_pose(tip));
    let mut axes = 0..settings.pose.len();
    if axes.clone().any(|k| outside(&to, k)) {
        return axes.all(|k| !outside(&to, k) || outside(&from, k));
    }
    check_pose(&from, settings, model).is_err()
}

/// Checks a pose as [`check_pose`], and returns the joint rates for rates of the pose.
pub(super) fn check_motion(
    pose: &Coordinates,
    rates: &Coordinates,
    settings: &Settings,
    model: &impl MachineModel,
) -> Result<[f64; 6], Refusal> {
    check_soft_limits(pose, None, settings)?;
    let rates = model.checked_joint_rates(pose, rates);
    rates.map_err(|problem| out_of_reach(&problem, pose, settings))
}

fn out_of_reach(problem: &PoseProblem, pose: &Coordinates, settings: &Settings) -> Refusal {
    // The message of the model may have a remedy.
    let problem = problem.to_string();
    let (what, remedy) = problem.rsplit_once("; ").unwrap_or((
        &problem,
        "move the workpiece, or keep the tool nearer to the middle of the workspace",
    ));
    (
        format!(
            "the machine cannot reach {}: {what}",
            format_pose(pose, settings)
        ),
        remedy.to_owned(),
    )
}

/// Checks a pose against soft limits and the number range of the protocol. `programmed` is the pose
/// in the coordinates of the program.
fn check_soft_limits(
    pose: &Coordinates,
    programmed: Option<&Coordinates>,
    settings: &Settings,
) -> Result<(), Refusal> {
    for (k, (value, axis)) in pose.iter().zip(&settings.pose).enumerate() {
        let unit = match axis.kind {
            WordKind::Linear => "mm",
            WordKind::Rotary => "deg",
        };
        let is_in_range = (value * axis.units).abs() < NUMBER_RANGE * (1.0 - 1e-12);
        let tolerance = axis.limit_tolerance();
        if is_in_range && (axis.low - tolerance..=axis.high + tolerance).contains(value) {
            continue;
        }
        // One that wraps around has no range.
        let range = if axis.high == f64::INFINITY {
            f64::INFINITY
        } else {
            NUMBER_RANGE / axis.units
        };
        let (low, high) = (axis.low.max(-range), axis.high.min(range));
        if !(low..=high).contains(value) {
            let letter = axis.letter;
            let limits = format!("the soft limits of {letter} ({low} to {high} {unit})");
            let pose = format_pose(pose, settings);
            let word = programmed.map(|programmed| programmed[k]);
            return Err(match word.filter(|word| (word - value).abs() > 5e-5) {
                // The word of the block is its place.
                None if programmed.is_some() => (
                    format!("{letter}{value:.4} is outside {limits}"),
                    format!("keep {letter} within {low} to {high} {unit}"),
                ),
                None => (
                    format!("{letter}{value:.4} is outside {limits} at {pose}"),
                    format!("keep {letter} within {low} to {high} {unit}"),
                ),
                Some(word) => (
                    format!(
                        "{letter}{word:.4} with the offsets in force is {letter}{value:.4} of the \
                         machine, outside {limits}"
                    ),
                    format!(
                        "change {letter} by {:.4} {unit}, or the work offset or tool length",
                        value.clamp(low, high) - value
                    ),
                ),
            });
        }
    }
    Ok(())
}

/// Formats a pose as program words.
pub(super) fn format_pose(pose: &Coordinates, settings: &Settings) -> String {
    let words: Vec<String> = pose
        .iter()
        .zip(&settings.pose)
        .map(|(value, axis)| format!("{}{value:.3}", axis.letter))
        .collect();
    words.join(" ")
}

/// Checks a move, finds its limits, and adds its blocks. A move whose joints allow very different
/// speeds, as near a singularity, is divided.
///
/// # Errors
///
/// Returns what the machine cannot do. Some blocks of the move may have been added.
pub(super) fn prepare(
    step: &Move,
    settings: &Settings,
    model: &impl MachineModel,
    blocks: &mut Vec<Block>,
) -> Result<(), Problem> {
    let first = blocks.len();
    divide(step, settings, model, blocks)?;
    if let Some((last, others)) = blocks[first..].split_last_mut() {
        last.exact_stop = step.exact_stop;
        for block in others {
            block.continues = true;
        }
    }
    Ok(())
}

fn divide(
    step: &Move,
    settings: &Settings,
    model: &impl MachineModel,
    blocks: &mut Vec<Block>,
) -> Result<(), Problem> {
    let (block, allowed) = examine(step, settings, model)?;
    // The speed that the fastest part of the move allows is at most the one that feed and rates of
    // the pose allow.
    let is_even = |fastest: f64| block.along.speed >= EVEN_SPEED * fastest;
    if is_even(allowed)
        || block.path.length < 2.0 * SHORTEST_PART
        || is_even(fastest(step, settings, model).min(allowed))
    {
        blocks.push(block);
        return Ok(());
    }
    for path in step.path.halves() {
        let half = Move {
            path,
            ..step.clone()
        };
        divide(&half, settings, model, blocks)?;
    }
    Ok(())
}

/// Returns the maximum speed that the joints allow at a sample of a move that was examined.
fn fastest(step: &Move, settings: &Settings, model: &impl MachineModel) -> f64 {
    let path = &step.path;
    let samples = Samples::of(path, settings);
    let mut fastest = 0.0_f64;
    let mut before = JointDerivatives::default();
    let mut machine_before = JointDerivatives::default();
    let turns = step.tool.turn_per_length(path) > 0.0;
    for index in 0..=samples.intervals {
        let s = samples.length(index, path);
        let (pose, tangent) = path.at_with_tangent(s);
        let (machine, rates) = (
            step.tool.machine_pose(&pose),
            step.tool.machine_rates(&pose, &tangent),
        );
        let joints = model.joint_rates(&machine, &rates);
        before.sample_alone(s, &joints, &samples);
        if turns {
            machine_before.sample_alone(s, &rates, &samples);
        }
        let bounds = bounds(settings, &before, &machine_before);
        fastest = fastest.max(joint_speed(bounds));
    }
    fastest
}

/// Returns the limits of the joints with their largest derivatives by length, and those of the
/// machine's pose, which are 0 if that is the pose of the tip: rate, acceleration, jerk.
fn bounds<'a>(
    settings: &'a Settings,
    joints: &'a JointDerivatives,
    machine: &'a JointDerivatives,
) -> impl Iterator<Item = ([f64; 3], [f64; 3])> + 'a {
    let limits = settings.joints.iter();
    let of_joints = limits.map(|axis| [axis.rate, axis.acceleration, axis.jerk]);
    let limits = settings.pose.iter();
    let of_machine = limits.map(|axis| [axis.rate, axis.acceleration, axis.jerk]);
    (of_joints.zip(joints.largest)).chain(of_machine.zip(machine.largest))
}

/// Returns the maximum speed that rates, accelerations and jerks of the joints allow.
fn joint_speed(bounds: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> f64 {
    let mut speed = f64::INFINITY;
    // Its square, and its cube: roots keep the order.
    let (mut square, mut cube) = (f64::INFINITY, f64::INFINITY);
    for ([rate, acceleration, jerk], [first, second, third]) in bounds {
        if first > 1e-12 {
            speed = speed.min(rate / first);
        }
        if second > 1e-12 {
            square = square.min(JOINT_CURVATURE_SHARE * acceleration / second);
        }
        if third > 1e-9 {
            cube = cube.min(JOINT_SPEED_JERK * jerk / third);
        }
    }
    speed.min(square.sqrt()).min(libm::cbrt(cube))
}

/// Returns the block of a move, and the speed that its feed and the rates of the pose allow.
fn examine(
    step: &Move,
    settings: &Settings,
    model: &impl MachineModel,
) -> Result<(Block, f64), Problem> {
    let problem = |(what, remedy): Refusal| Problem {
        place: step.place,
        what,
        remedy,
    };
    let path = &step.path;
    let samples = Samples::of(path, settings);
    let mut limits = Search::new(settings, &samples);
    // Without a turn the machine moves as the tip.
    let turns = step.tool.turn_per_length(path) > 0.0;
    let mut tangents = [[0.0; 6]; 2];
    let mut joint_tangents = [[0.0; 6]; 2];
    let mut machine_tangents = [[0.0; 6]; 2];
    for index in 0..=samples.intervals {
        let s = samples.length(index, path);
        let (pose, tangent) = path.at_with_tangent(s);
        let machine = step.tool.machine_pose(&pose);
        let rates = step.tool.machine_rates(&pose, &tangent);
        let joints = check_motion(&machine, &rates, settings, model).map_err(|refusal| {
            // The end of the move is what its block has in words.
            problem(check_end(step, settings, model).err().unwrap_or(refusal))
        })?;
        limits.sample(s, &tangent, &joints);
        if turns {
            limits.machine.sample(s, &rates, &samples);
        }
        if index == 0 {
            (tangents[0], joint_tangents[0]) = (tangent, joints);
            machine_tangents[0] = rates;
        }
        (tangents[1], joint_tangents[1]) = (tangent, joints);
        machine_tangents[1] = rates;
    }
    if let Feed::PerMinute(feed) = step.feed {
        limits.speed = feed / 60.0;
    }
    limits.limit_joints();
    let (along, max) = limits.along(path);
    let allowed = limits.speed.min(limits.rate_speed);
    let block = Block {
        place: step.place,
        places: Vec::new(),
        messages: 0,
        path: path.clone(),
        tool: step.tool,
        is_rapid: step.feed == Feed::Rapid,
        is_fixed: step.fixed,
        exact_stop: false,
        continues: false,
        is_slowed: limits.is_slowed(),
        tolerance: step.tolerance,
        turns: 1.0,
        along,
        max,
        tangents,
        joint_tangents,
        machine_tangents,
    };
    Ok((block, allowed))
}

/// Search for the limits of a move over its samples.
struct Search<'a> {
    settings: &'a Settings,
    samples: &'a Samples,
    /// Maximum speed that the rates of the pose allow, and the axis that limits it: its index, rate
    /// per speed, and pose.
    rate_speed: f64,
    /// Maximum speed that rates, accelerations and jerks of the joints allow.
    joint_speed: f64,
    acceleration: f64,
    jerk: f64,
    /// Programmed speed.
    speed: f64,
    /// Derivatives of the pose by length at the sample before.
    before: Option<Coordinates>,
    joints: JointDerivatives,
    /// Pose of the machine, if the length of the tool makes another one of that of the tip.
    machine: JointDerivatives,
}

impl<'a> Search<'a> {
    fn new(settings: &'a Settings, samples: &'a Samples) -> Self {
        let infinite = f64::INFINITY;
        Self {
            settings,
            samples,
            rate_speed: infinite,
            joint_speed: infinite,
            acceleration: infinite,
            jerk: infinite,
            speed: infinite,
            before: None,
            joints: JointDerivatives::default(),
            machine: JointDerivatives::default(),
        }
    }

    fn sample(&mut self, s: f64, tangent: &Coordinates, joints: &[f64; 6]) {
        let before = self.before.as_ref().unwrap_or(tangent);
        let tangents = before.iter().zip(tangent);
        for (axis, (before, tangent)) in self.settings.pose.iter().zip(tangents) {
            let part = self.samples.peak(*before, *tangent);
            if part > 1e-12 {
                self.rate_speed = self.rate_speed.min(axis.rate / part);
                self.acceleration = self
                    .acceleration
                    .min(ACCELERATION_SHARE * axis.acceleration / part);
                self.jerk = self.jerk.min(JERK_SHARE * axis.jerk / part);
            }
        }
        self.before = Some(*tangent);
        self.joints.sample(s, joints, self.samples);
    }

    /// Applies the limits of the joints, after the last sample.
    fn limit_joints(&mut self) {
        for ([_, acceleration, _], [first, ..]) in
            bounds(self.settings, &self.joints, &self.machine)
        {
            if first > 1e-12 {
                let max = JOINT_RAMP_SHARE * acceleration / first;
                self.acceleration = self.acceleration.min(max);
            }
        }
        self.joint_speed = joint_speed(bounds(self.settings, &self.joints, &self.machine));
    }

    /// Whether the limits of the machine lower the programmed feed.
    fn is_slowed(&self) -> bool {
        let max = self.rate_speed.min(self.joint_speed);
        // A feed at the limit is not lowered, whatever its rounding.
        self.speed < f64::INFINITY && max < self.speed * (1.0 - 1e-9)
    }

    /// Returns the limits along the path, and the maximum speed without the feed.
    fn along(&self, path: &Path) -> (Along, f64) {
        let mut max = self.rate_speed.min(self.joint_speed);
        let (mut acceleration, mut jerk) = (self.acceleration, self.jerk);
        let mut speed = self.speed.min(max);
        if let Some(arc) = &path.arc {
            let axes = arc.plane.map(|k| &self.settings.pose[k]);
            let plane_acceleration =
                ACCELERATION_SHARE * axes[0].acceleration.min(axes[1].acceleration);
            let plane_jerk = JERK_SHARE * axes[0].jerk.min(axes[1].jerk);
            let turn = (arc.sweep / path.length).abs();
            let share = turn * arc.radius[0].max(arc.radius[1]);
            let curvature = share * turn;
            max = max
                .min((CENTRIPETAL_SHARE * plane_acceleration / curvature).sqrt())
                .min(libm::cbrt(ARC_SPEED_JERK * plane_jerk / (curvature * turn)));
            speed = speed.min(max);
            acceleration = acceleration
                .min(TANGENTIAL_SHARE * plane_acceleration / share)
                .min(ARC_ACROSS_JERK * plane_jerk / (3.0 * speed * curvature));
            jerk = jerk.min(ARC_RAMP_JERK * plane_jerk / share);
        }
        for ([_, _, max], [first, second, third]) in
            bounds(self.settings, &self.joints, &self.machine)
        {
            let across = 3.0 * second * speed;
            if across > 1e-9 {
                acceleration = acceleration.min(JOINT_ACROSS_JERK * max / across);
            }
            if first > 1e-12 {
                let rest = JERK_SHARE * max - across * acceleration;
                let rest = rest - third * speed * speed * speed;
                jerk = jerk.min(rest / first);
            }
        }
        // One more period, for rounding.
        let hold = self.settings.shortest_span_s + f64::from(self.settings.period_us) * 1e-6;
        let along = Along {
            speed,
            acceleration,
            jerk: jerk.min(acceleration / hold),
            hold,
        };
        (along, max)
    }
}
