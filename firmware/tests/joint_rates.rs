//! A jog commands no joint rate above the configured maximum, from any pose and at any rates.
//!
//! The truth is the inverse kinematics of docs/control.md in f64, written here from the equations,
//! applied to the commanded poses.

use crate::reference;
use haptimill_firmware::config::{AxisKind, Config};
use haptimill_firmware::motion::jog::Jog;
use haptimill_firmware::motion::{Mode, Motion};
use haptimill_kinematics::{BoundedKinematics, Model};
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{MAX_AXES, Source};
use reference::{h4, mm};

const PERIOD_S: f64 = 2e-4;
const AXES: usize = 5;
/// Commanded poses are rounded to 2^-20 mm and 2^-32 turn; differences are taken over this many
/// periods.
const SPAN: usize = 8;

/// A generator of numbers with a seed (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    fn below(&mut self, count: u64) -> usize {
        (self.next() % count) as usize
    }
}

fn unit(config: &Config, axis: usize) -> f64 {
    match config.pose[axis].kind {
        AxisKind::Linear => f64::from(1 << 20),
        AxisKind::Rotary => 4_294_967_296.0 / 360.0,
        AxisKind::MultiTurn => 4_194_304.0 / 360.0,
    }
}

/// The joints of a pose in mm and degrees.
fn joints(config: &Config, pose: &[f64; AXES]) -> [f64; AXES] {
    let Model::H4(g) = &config.model else {
        panic!("an H-4 arm")
    };
    let length = |length: haptimill_math::Length| f64::from(length.0) / f64::from(1 << 20);
    let (theta, alpha) = (pose[3].to_radians(), pose[4].to_radians());
    let x = pose[0] + length(g.x_offset);
    let across = pose[1] + length(g.y_offset);
    let up = pose[2] + length(g.z_offset);
    let y = across * alpha.cos() - up * alpha.sin();
    let z = across * alpha.sin() + up * alpha.cos() - length(g.table_height);
    let slide = |s: f64, sigma: f64| {
        let m = length(g.tool) + length(g.half_spacing) * (1.0 + sigma);
        let u = length(g.lateral) - sigma * y;
        let v = -z - m * theta.cos() + sigma * length(g.half_height) - length(g.rail_offset);
        let root = (length(g.rod).powi(2) - u * u - v * v).sqrt();
        x + m * theta.sin() + s * (length(g.joint_offset) + root)
    };
    [
        slide(1.0, 1.0),
        slide(-1.0, 1.0),
        slide(1.0, -1.0),
        slide(-1.0, -1.0),
        pose[4],
    ]
}

/// Commanded poses and rates of one motion.
struct Trace<'a> {
    config: &'a Config,
    joints: Vec<[f64; AXES]>,
    before: Option<([f64; AXES], [f64; AXES])>,
    /// The largest part of its maximum rate that a joint was commanded, by rates and by differences
    /// of positions.
    by_rates: f64,
    by_differences: f64,
    /// The largest part of its maximum that an acceleration of a pose coordinate was.
    acceleration: f64,
}

impl<'a> Trace<'a> {
    fn new(config: &'a Config) -> Self {
        Self {
            config,
            joints: Vec::new(),
            before: None,
            by_rates: 0.0,
            by_differences: 0.0,
            acceleration: 0.0,
        }
    }

    fn limit(&self, joint: usize) -> f64 {
        f64::from(self.config.joints[joint].rate.0)
            / unit(self.config, if joint == 4 { 4 } else { 0 })
    }

    fn push(&mut self, pose: &Pose, rates: &[haptimill_math::Rate; MAX_AXES]) {
        let place: [f64; AXES] =
            std::array::from_fn(|axis| f64::from(pose.0[axis].0) / unit(self.config, axis));
        let speed: [f64; AXES] =
            std::array::from_fn(|axis| f64::from(rates[axis].0) / unit(self.config, axis));
        // The derivative along the commanded rates, by a central difference of 2 us.
        let step = 1e-6;
        let moved = |by: f64| {
            let pose = std::array::from_fn(|axis| place[axis] + by * speed[axis]);
            joints(self.config, &pose)
        };
        let (back, ahead) = (moved(-step), moved(step));
        for joint in 0..AXES {
            let rate = (ahead[joint] - back[joint]) / (2.0 * step);
            self.by_rates = self.by_rates.max(rate.abs() / self.limit(joint));
        }
        let here = joints(self.config, &place);
        self.joints.push(here);
        if let Some(index) = self.joints.len().checked_sub(SPAN + 1) {
            for (joint, (now, then)) in here.iter().zip(self.joints[index]).enumerate() {
                let rate = (now - then) / (SPAN as f64 * PERIOD_S);
                self.by_differences = self.by_differences.max(rate.abs() / self.limit(joint));
            }
        }
        if let Some((_, before)) = self.before {
            for axis in 0..AXES {
                let max = f64::from(self.config.pose[axis].acceleration.0) * 256.0
                    / unit(self.config, axis);
                let acceleration = (speed[axis] - before[axis]) / PERIOD_S;
                self.acceleration = self.acceleration.max(acceleration.abs() / max);
            }
        }
        self.before = Some((place, speed));
    }
}

/// The worst of all cases.
#[derive(Default)]
struct Worst {
    by_rates: (f64, String),
    by_differences: (f64, String),
    acceleration: (f64, String),
}

impl Worst {
    fn take(&mut self, trace: &Trace<'_>, case: &str) {
        for (worst, value) in [
            (&mut self.by_rates, trace.by_rates),
            (&mut self.by_differences, trace.by_differences),
            (&mut self.acceleration, trace.acceleration),
        ] {
            if value > worst.0 {
                *worst = (value, case.to_owned());
            }
        }
    }

    fn assert_within(&self) {
        let Self {
            by_rates,
            by_differences,
            acceleration,
        } = self;
        println!(
            "of their maxima: joint rates {:.5}, differences of joint positions {:.5}, accelerations of the pose {:.5}",
            by_rates.0, by_differences.0, acceleration.0
        );
        assert!(by_rates.0 <= 1.0002, "joint rates: {by_rates:?}");
        assert!(
            by_differences.0 <= 1.0005,
            "differences of joint positions: {by_differences:?}"
        );
        assert!(
            acceleration.0 <= 1.001,
            "accelerations of the pose: {acceleration:?}"
        );
    }
}

/// A pose that the machine can take, within its soft limits. A third of them lie less than 15 mm
/// from where it cannot.
fn start(config: &Config, machine: &BoundedKinematics, random: &mut Random) -> Pose {
    loop {
        let mut pose = Pose::default();
        for axis in 0..AXES {
            let (low, high) = (config.pose[axis].low.0, config.pose[axis].high.0);
            pose.0[axis] = Coordinate(random.uniform(f64::from(low), f64::from(high)) as i32);
        }
        if machine.inverse(&pose).is_err() {
            continue;
        }
        if random.below(3) > 0 {
            return pose;
        }
        let axis = 1 + random.below(2);
        let mut edge = pose;
        let step = if random.below(2) == 0 {
            mm(1.0)
        } else {
            mm(-1.0)
        };
        while (config.pose[axis].low..=config.pose[axis].high).contains(&edge.0[axis])
            && machine.inverse(&edge).is_ok()
        {
            edge.0[axis].0 += step;
        }
        edge.0[axis].0 -= step * (1 + random.below(15) as i32);
        if (config.pose[axis].low..=config.pose[axis].high).contains(&edge.0[axis])
            && machine.inverse(&edge).is_ok()
        {
            return edge;
        }
    }
}

/// Rates of some coordinates; a half of them at their maximum.
fn asked(config: &Config, random: &mut Random) -> [i64; MAX_AXES] {
    let mut rates = [0; MAX_AXES];
    for (axis, rate) in rates.iter_mut().enumerate().take(AXES) {
        let max = f64::from(config.pose[axis].rate.0);
        *rate = match random.below(4) {
            0 | 1 => 0,
            2 => (max * if random.below(2) == 0 { 1.0 } else { -1.0 }) as i64,
            _ => random.uniform(-max, max) as i64,
        };
    }
    rates
}

#[test]
fn jog_keeps_joint_rate_limits() {
    let config = h4();
    let machine = config.kinematics();
    let mut random = Random(4);
    let mut worst = Worst::default();
    for case in 0..1500 {
        let pose = start(&config, &machine, &mut random);
        let mut jog = Jog::new(&config);
        jog.begin(&pose, true);
        let mut trace = Trace::new(&config);
        // Up to three commands one after the other, each while the one before still moves, or after
        // it.
        for _ in 0..=random.below(3) {
            jog.set_rates(&asked(&config, &mut random), 1 + random.below(8000) as u32);
            for _ in 0..200 + random.below(8000) {
                let (commanded, _) = jog.advance(&machine);
                trace.push(&commanded.pose, &commanded.rates);
                if jog.is_at_standstill() {
                    break;
                }
            }
        }
        jog.release();
        for _ in 0..4000 {
            let (commanded, _) = jog.advance(&machine);
            trace.push(&commanded.pose, &commanded.rates);
        }
        assert!(jog.is_at_standstill());
        worst.take(&trace, &format!("case {case}, from {pose:?}"));
    }
    worst.assert_within();
}

/// How far beyond a pose, along one axis, the machine still could go: to its soft limit, or to
/// where it refuses; mm or degrees.
fn left(config: &Config, machine: &BoundedKinematics, from: &Pose, axis: usize, sign: i32) -> f64 {
    let step = unit(config, axis) as i32 / 100 * sign;
    let mut pose = *from;
    let mut steps = 0;
    while (config.pose[axis].low..=config.pose[axis].high).contains(&pose.0[axis])
        && machine.inverse(&pose).is_ok()
    {
        pose.0[axis].0 += step;
        steps += 1;
    }
    f64::from(steps) / 100.0
}

/// A jog of one coordinate reaches the workspace boundary, although it is slowed before it.
#[test]
fn jog_reaches_the_workspace_boundary() {
    let config = h4();
    let machine = config.kinematics();
    let mut random = Random(5);
    let mut farthest = (0.0_f64, String::new());
    let mut worst = Worst::default();
    for case in 0..300 {
        let pose = start(&config, &machine, &mut random);
        let axis = random.below(5);
        let sign = if random.below(2) == 0 { 1 } else { -1 };
        let mut rates = [0; MAX_AXES];
        rates[axis] = i64::from(config.pose[axis].rate.0) * i64::from(sign);
        let mut jog = Jog::new(&config);
        jog.begin(&pose, true);
        let mut trace = Trace::new(&config);
        let mut commanded = Default::default();
        for _ in 0..200_000 {
            jog.set_rates(&rates, 1000);
            let limited;
            (commanded, limited) = jog.advance(&machine);
            trace.push(&commanded.pose, &commanded.rates);
            if limited.is_some() && commanded.rates[axis].0 == 0 {
                break;
            }
        }
        worst.take(&trace, &format!("case {case}, from {pose:?}"));
        let short = left(&config, &machine, &commanded.pose, axis, sign);
        if short > farthest.0 {
            farthest = (short, format!("case {case}, axis {axis}, from {pose:?}"));
        }
    }
    println!("farthest from the bound: {farthest:?}");
    worst.assert_within();
    assert!(farthest.0 <= 0.1, "stops short of its bound: {farthest:?}");
}

/// A master moves three coordinates beside a jog of the table or the tilt: the same limit holds for
/// all of them together.
#[test]
fn master_beside_jog_keeps_joint_rate_limits() {
    let mut config = h4();
    config.follow = Some(reference::follow());
    let machine = config.kinematics();
    let mut random = Random(6);
    let mut worst = Worst::default();
    for case in 0..300 {
        let pose = start(&config, &machine, &mut random);
        let mut motion = Motion::default();
        motion.configure(&config);
        motion.set_position(&pose);
        motion.begin_program();
        let moved = 1 + random.below(7);
        for axis in 0..AXES {
            let source = match axis {
                0..=2 if moved & (1 << axis) != 0 => Source::Master,
                3 | 4 if random.below(2) == 0 => Source::Jog,
                _ => Source::Program,
            };
            motion.set_source(axis, source);
        }
        let mut trace = Trace::new(&config);
        for _ in 0..6 {
            motion.jog.set_rates(&asked(&config, &mut random), 4000);
            let targets = std::array::from_fn(|axis| {
                let (low, high) = match config.pose.get(axis) {
                    Some(axis) => (f64::from(axis.low.0), f64::from(axis.high.0)),
                    None => return None,
                };
                Some(Coordinate(random.uniform(low, high) as i32))
            });
            for _ in 0..5000 {
                motion.set_master_targets(&targets);
                let _ = motion.advance(Mode::Program { halt: false }, &machine);
                trace.push(&motion.commanded().pose, &motion.commanded().rates);
            }
        }
        worst.take(&trace, &format!("case {case}, from {pose:?}"));
    }
    worst.assert_within();
}
