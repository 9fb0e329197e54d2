//! Volumetric compensation against an independent sum in f64: positions, rates, accelerations, the
//! fade, and the bounds of the tables.

use haptimill_firmware::config::volumetric::{
    CORRECTION, ERRORS, ErrorAxis, LARGEST, VolumetricConfig,
};
use haptimill_firmware::motion::PoseCommand;
use haptimill_firmware::volumetric::{Compensation, Fade};
use haptimill_math::{Acceleration, Coordinate, Rate};
use proptest::prelude::*;

const MM: f64 = (1 << 20) as f64;
const PERIOD_US: u16 = 200;

fn mm(value: f64) -> Coordinate {
    Coordinate((value * MM).round() as i32)
}

/// Tables with a node every 10 mm from -100 to 100 mm; values walk by the steps of `seeds`.
fn config(seeds: &[i16], squareness: [i32; 3], measured_at: [f64; 3]) -> VolumetricConfig {
    let nodes = 21;
    let mut values = heapless::Vec::new();
    let mut seed = seeds.iter().cycle();
    for _ in 0..3 {
        let mut walk = [0_i16; ERRORS];
        for _ in 0..nodes {
            for value in &mut walk {
                *value += seed.next().unwrap() % 500;
                *value = (*value).clamp(-8000, 8000);
                values.push(*value).unwrap();
            }
        }
    }
    let axis = |arm| ErrorAxis {
        first: mm(-100.0),
        pitch: mm(10.0),
        nodes,
        arm,
        measured_at: measured_at.map(mm),
    };
    VolumetricConfig {
        // The chain w Y b X Z t.
        axes: [axis(0b100), axis(0b111), axis(0b000)],
        values,
        shift: 1,
        squareness,
    }
}

/// The error at a point, mm, written from the definition.
fn error(config: &VolumetricConfig, p: [f64; 3]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for axis in 0..3 {
        let tables = &config.axes[axis];
        let place = (p[axis] + 100.0) / 10.0;
        let place = place.clamp(0.0, 20.0);
        let node = (place.floor() as usize).min(19);
        let part = place - node as f64;
        let value = |node: usize, function: usize| {
            let at = config.start(axis) + node * ERRORS + function;
            f64::from(config.values[at]) * 2.0
        };
        let of = |f: usize| (1.0 - part) * value(node, f) + part * value(node + 1, f);
        let t = [of(0), of(1), of(2)].map(|nm| nm * 1e-6);
        let r = [of(3), of(4), of(5)].map(|nrad| nrad * 1e-9);
        let a: [f64; 3] = core::array::from_fn(|i| {
            let bit = f64::from(tables.arm >> i & 1);
            bit * (p[i] - f64::from(tables.measured_at[i].0) / MM)
        });
        sum[0] += t[0] + r[1] * a[2] - r[2] * a[1];
        sum[1] += t[1] + r[2] * a[0] - r[0] * a[2];
        sum[2] += t[2] + r[0] * a[1] - r[1] * a[0];
    }
    let [c0y, b0z, a0z] = config.squareness.map(|angle| f64::from(angle) * 1e-9);
    sum[0] += -c0y * p[1] + b0z * p[2];
    sum[1] += -a0z * p[2];
    sum
}

fn command(p: [f64; 3], v: [f64; 3], a: [f64; 3]) -> PoseCommand {
    let mut command = PoseCommand::default();
    for i in 0..3 {
        command.pose.0[i] = mm(p[i]);
        command.rates[i] = Rate((v[i] * MM).round() as i32);
        command.accelerations[i] = Acceleration((a[i] * MM / 256.0).round() as i32);
    }
    command
}

fn faded_in(config: &VolumetricConfig) -> Compensation {
    let mut compensation = Compensation::new(config, PERIOD_US);
    for _ in 0..5000 {
        compensation.advance(Fade::In);
    }
    assert!(compensation.is_complete());
    compensation
}

fn coordinate() -> impl Strategy<Value = f64> {
    -99.0..99.0_f64
}

proptest! {
    /// Along p + v t + a t^2 / 2, in the last of five periods: position within 2 nm of the error at
    /// the corrected pose, rate within 1e-5 mm/s of the one in the middle of the period, and
    /// acceleration within 0.05 mm/s^2 of the one at its beginning, away from the nodes.
    #[test]
    fn correction(
        seeds in prop::collection::vec(any::<i16>(), 40..80),
        squareness in prop::array::uniform3(-50_000..50_000_i32),
        measured_at in prop::array::uniform3(-50.0..50.0_f64),
        p in prop::array::uniform3(coordinate()),
        v in prop::array::uniform3(-100.0..100.0_f64),
        a in prop::array::uniform3(-2000.0..2000.0_f64),
    ) {
        let config = config(&seeds, squareness, measured_at);
        let mut compensation = faded_in(&config);
        let period = f64::from(PERIOD_US) * 1e-6;
        let place = |t: f64| core::array::from_fn(|i| p[i] + v[i] * t + 0.5 * a[i] * t * t);
        let mut out = PoseCommand::default();
        for number in -4..=0 {
            let t = f64::from(number) * period;
            let rates = core::array::from_fn(|i| v[i] + a[i] * t);
            compensation.advance(Fade::In);
            out = *compensation.correct(&config, &command(place(t), rates, a));
        }
        // c = p - Delta(c) contracts: the slope is at most 0.001.
        let exact = |t: f64| {
            let p = place(t);
            let mut at = p;
            for _ in 0..4 {
                let error = error(&config, at);
                at = core::array::from_fn(|i| p[i] - error[i]);
            }
            core::array::from_fn::<f64, 3, _>(|i| p[i] - at[i])
        };
        let error = exact(0.0);
        for (axis, coordinate) in out.pose.0.iter().enumerate().take(3) {
            let corrected = f64::from(coordinate.0) / MM;
            prop_assert!((corrected - (p[axis] - error[axis])).abs() < 2e-6);
        }
        let clear = (0..3).all(|i| {
            let place = (p[i] + 100.0) / 10.0;
            (place - place.round()).abs() > 0.02
        });
        prop_assume!(clear);
        let dt = 1e-5;
        let derivative = |f: &dyn Fn(f64) -> [f64; 3], t: f64, axis: usize| {
            (f(t + dt)[axis] - f(t - dt)[axis]) / (2.0 * dt)
        };
        for axis in 0..3 {
            let rate = derivative(&exact, -0.5 * period, axis);
            let own = f64::from(out.rates[axis].0) / MM - v[axis];
            prop_assert!((own + rate).abs() < 1e-5, "{} {}", own, rate);
            let rate = |t: f64| core::array::from_fn(|axis| derivative(&exact, t, axis));
            let acceleration = derivative(&rate, -period, axis);
            let own = f64::from(out.accelerations[axis].0) * 256.0 / MM - a[axis];
            prop_assert!((own + acceleration).abs() < 0.05, "{} {}", own, acceleration);
        }
    }

    /// Across a node of x, where the slopes of its tables change at once: the rate of the
    /// correction is the change of its position in every period, it follows the exact one, and it
    /// goes from the value before the node to the one behind it, never beyond these two.
    #[test]
    fn nodes(
        seeds in prop::collection::vec(any::<i16>(), 40..80),
        node in 1..20_i32,
        between in prop::array::uniform2((0..20_i32, 2.0..8.0_f64)),
        speed in prop::array::uniform3(20.0..100.0_f64),
        direction in any::<bool>(),
        early in 0.0..1.0_f64,
    ) {
        let config = config(&seeds, [25_000, -6_000, 5_000], [0.0; 3]);
        let mut compensation = faded_in(&config);
        let period = f64::from(PERIOD_US) * 1e-6;
        let place_of = |node: i32| f64::from(node) * 10.0 - 100.0;
        let [y, z] = between.map(|(node, beyond)| place_of(node) + beyond);
        let mut v = speed;
        v[0] = if direction { v[0] } else { -v[0] };
        // The node is passed within the period that ends at early.
        let start = [place_of(node) + v[0] * early * period, y, z];
        let place = |t: f64| core::array::from_fn(|i| start[i] + v[i] * t);
        let exact = |t: f64| {
            let p: [f64; 3] = place(t);
            let mut at = p;
            for _ in 0..4 {
                let error = error(&config, at);
                at = core::array::from_fn(|i| p[i] - error[i]);
            }
            core::array::from_fn::<f64, 3, _>(|i| at[i] - p[i])
        };
        let change = |t: f64| {
            let (now, before) = (exact(t), exact(t - period));
            core::array::from_fn::<f64, 3, _>(|i| (now[i] - before[i]) / period)
        };
        let (far, near) = (change(-10.0 * period), change(12.0 * period));
        let mut last: Option<([f64; 3], [f64; 3])> = None;
        for number in -20..=20 {
            let t = f64::from(number) * period;
            let command = command(place(t), v, [0.0; 3]);
            compensation.advance(Fade::In);
            let out = *compensation.correct(&config, &command);
            let by = |out: i32, command: i32| (f64::from(out) - f64::from(command)) / MM;
            let corrected =
                core::array::from_fn::<f64, 3, _>(|i| by(out.pose.0[i].0, command.pose.0[i].0));
            let rates =
                core::array::from_fn::<f64, 3, _>(|i| by(out.rates[i].0, command.rates[i].0));
            let Some((corrected_before, _)) = last.replace((corrected, rates)) else {
                continue;
            };
            // The correction is settled a few periods after the start.
            if number < -15 {
                continue;
            }
            let change = change(t);
            for axis in 0..3 {
                // Two roundings of 1 nm.
                let moved = corrected[axis] - corrected_before[axis];
                prop_assert!((moved - rates[axis] * period).abs() < 2.5e-6);
                // Both poses are rounded to 1 nm: the exact change of the rounded path differs.
                prop_assert!(
                    (rates[axis] - change[axis]).abs() < 1e-4,
                    "{} {} {}", number, rates[axis], change[axis]
                );
                let (low, high) =
                    (far[axis].min(near[axis]), far[axis].max(near[axis]));
                prop_assert!(
                    (low - 1e-4..high + 1e-4).contains(&rates[axis]),
                    "{} {} {} {}", number, rates[axis], low, high
                );
            }
        }
    }

    /// A measured pose gets back what the corrected one lost: the tool is where a machine with
    /// these errors has it, within the following error times the slope of the errors, here 0.2 um
    /// per mm.
    #[test]
    fn the_measured_pose_gets_it_back(
        seeds in prop::collection::vec(any::<i16>(), 40..80),
        p in prop::array::uniform3(-98.0..98.0_f64),
        part in 0..6000_u32,
        behind in prop::array::uniform3(-0.3..0.3_f64),
    ) {
        let config = config(&seeds, [20_000, -6_000, 5_000], [0.0; 3]);
        let mut compensation = Compensation::new(&config, PERIOD_US);
        let command = command(p, [0.0; 3], [0.0; 3]);
        let mut out = command;
        for _ in 0..part {
            compensation.advance(Fade::In);
            out = *compensation.correct(&config, &command);
        }
        let taken = compensation.taken();
        for (axis, taken) in taken.iter().enumerate() {
            prop_assert_eq!(out.pose.0[axis].0 + taken, command.pose.0[axis].0);
        }
        // The fade begins and ends with rate zero.
        let part = f64::from(part.min(5000)) / 5000.0;
        let weight = 3.0 * part.powi(2) - 2.0 * part.powi(3);
        let measured: [f64; 3] =
            core::array::from_fn(|axis| f64::from(out.pose.0[axis].0) / MM + behind[axis]);
        let exact = error(&config, measured).map(|error| error * weight);
        let far = behind.iter().map(|part| part.abs()).sum::<f64>();
        for axis in 0..3 {
            let off = f64::from(taken[axis]) / MM - exact[axis];
            prop_assert!(off.abs() < 2e-4 * far + 3e-6, "{} {}", off, far);
        }
    }

    /// The fade has no step: position and rate of the correction change little from one period to
    /// the next, and the rate is the change of the position.
    #[test]
    fn fade(seeds in prop::collection::vec(any::<i16>(), 40..80), p in prop::array::uniform3(coordinate())) {
        let config = config(&seeds, [20_000, -6_000, 5_000], [0.0; 3]);
        let mut compensation = Compensation::new(&config, PERIOD_US);
        let still = command(p, [0.0; 3], [0.0; 3]);
        let full = error(&config, p);
        let mut before: Option<PoseCommand> = None;
        for on in [true, false] {
            compensation.request(on);
            for _ in 0..5000 {
                compensation.advance(Fade::In);
                let out = *compensation.correct(&config, &still);
                if let Some(before) = before {
                    for (axis, full) in full.iter().enumerate().take(3) {
                        let moved = f64::from(out.pose.0[axis].0 - before.pose.0[axis].0) / MM;
                        let rate = 0.5 * f64::from(out.rates[axis].0 + before.rates[axis].0) / MM;
                        // 1 nm of rounding.
                        prop_assert!((moved - rate * 2e-4).abs() < 3e-6);
                        // 3 s^2 - 2 s^3 has the largest rate 1.5.
                        prop_assert!(rate.abs() <= 1.51 * full.abs() + 1e-5);
                    }
                }
                before = Some(out);
            }
        }
        prop_assert!(!compensation.is_active());
    }
}

/// Without permission nothing is corrected, and a homed machine that loses it fades out.
#[test]
fn permission() {
    let config = config(&[100, -50], [0; 3], [0.0; 3]);
    let mut compensation = Compensation::new(&config, PERIOD_US);
    for _ in 0..100 {
        compensation.advance(Fade::Out);
    }
    assert!(!compensation.is_active());
    for _ in 0..6000 {
        compensation.advance(Fade::In);
    }
    assert_eq!(compensation.percent(), 100);
    for _ in 0..2500 {
        compensation.advance(Fade::Out);
    }
    assert_eq!(compensation.percent(), 50);
    for _ in 0..2500 {
        compensation.advance(Fade::Frozen);
    }
    assert_eq!(compensation.percent(), 50);
}

/// Bounds: travel, nodes, size, slope, number of values.
#[test]
fn unsound_tables_are_found() {
    let travel = [(mm(-100.0), mm(100.0)); 3];
    let sound = config(&[100, -50, 70], [25_000, 6_000, -5_000], [0.0; 3]);
    assert_eq!(sound.unsound_axis(&travel), None);
    let refused = |change: &dyn Fn(&mut VolumetricConfig)| {
        let mut changed = sound.clone();
        change(&mut changed);
        changed.unsound_axis(&travel)
    };
    assert_eq!(refused(&|c| c.axes[1].first = mm(-99.0)), Some(1));
    assert_eq!(refused(&|c| c.axes[2].pitch = mm(9.9)), Some(2));
    assert_eq!(refused(&|c| c.axes[0].pitch = Coordinate(1000)), Some(0));
    assert_eq!(refused(&|c| c.axes[0].arm = 8), Some(0));
    assert_eq!(refused(&|c| c.squareness[1] = 2_000_000), Some(1));
    assert_eq!(refused(&|c| c.shift = 6), Some(0));
    assert_eq!(refused(&|c| c.values.truncate(c.values.len() - 1)), Some(0));
    // 1 um per mm over 10 mm is 10 um: 5000 of 2 nm.
    let steep = |by: i16| {
        move |c: &mut VolumetricConfig| {
            let start = c.start(1);
            for node in 0..21 {
                c.values[start + node * ERRORS] = if node < 7 { 0 } else { by };
            }
        }
    };
    assert_eq!(refused(&steep(5_000)), None);
    assert_eq!(refused(&steep(5_001)), Some(1));
    let large = |c: &mut VolumetricConfig| {
        c.shift = 5;
        c.values.iter_mut().for_each(|value| *value = 0);
        let start = c.start(2);
        for node in 0..21 {
            c.values[start + node * ERRORS] = 15_626;
        }
    };
    assert!(15_626 << 5 > LARGEST[0]);
    assert_eq!(refused(&large), Some(2));
}

/// The largest values that are allowed correct by no more than the joints have room for.
#[test]
fn the_largest_tables_stay_within_the_correction() {
    let mut config = config(&[0], [1_000_000; 3], [0.0; 3]);
    config.shift = 5;
    for (place, value) in config.values.iter_mut().enumerate() {
        *value = (LARGEST[place % ERRORS / 3] >> 5) as i16;
    }
    let mut compensation = faded_in(&config);
    for x in [-2000.0, -100.0, 0.0, 100.0, 2000.0] {
        for a in [-500_000.0, 500_000.0] {
            let command = command([x, -x, x], [-x, x, x], [a, -a, a]);
            let out = *compensation.correct(&config, &command);
            for axis in 0..3 {
                let by = i64::from(out.pose.0[axis].0) - i64::from(command.pose.0[axis].0);
                assert!(by.abs() <= i64::from(CORRECTION));
            }
        }
    }
}
