//! Homing finds every index pulse from any pose inside the soft limits.

use crate::setup;
use haptimill_firmware::config::Config;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::h4::ArmGeometry;
use haptimill_hil_sim::random::Random;
use haptimill_protocol::message::{AxisValues, State};
use haptimill_tests::Bench;
use setup::{DEGREE, MM, jog, ready, rest, state};

/// Returns the joints of a pose (mm and degrees) in f64 from the closed loops of the rods
/// (docs/control.md), or `None` outside the reach.
fn joints(arm: &ArmGeometry, config: &Config, pose: &[f64; 5]) -> Option<[f64; 5]> {
    let [x, y, z, theta, alpha] = *pose;
    let (tilt, turn) = (theta.to_radians(), alpha.to_radians());
    let (across, up) = (y + arm.y_off, z + arm.z_off);
    let x = x + arm.p + arm.x_off;
    let y = across * turn.cos() - up * turn.sin();
    let z = across * turn.sin() + up * turn.cos() - arm.h;
    let lateral = arm.a - arm.b - arm.e;
    let drop = arm.d - arm.c * tilt.cos();
    let height = z + (arm.c + arm.tl) * tilt.cos() + arm.ge;
    // Returns the singularity distance, positive below the rails; the margin of the machine file is
    // 5 mm.
    let distance = -(lateral * height - y * drop) / lateral.hypot(drop);
    if distance < 5.2 {
        return None;
    }
    let mut joints = [0.0; 5];
    joints[4] = alpha;
    for joint in 0..4 {
        let side = [1.0, -1.0, 1.0, -1.0][joint];
        let sigma = if joint < 2 { 1.0 } else { -1.0 };
        let m = arm.tl + arm.c * (1.0 + sigma);
        let u = lateral - sigma * y;
        let v = -z - m * tilt.cos() + sigma * arm.d - arm.ge;
        let square = arm.r * arm.r - u * u - v * v;
        if square < (0.101 * arm.r).powi(2) {
            return None;
        }
        joints[joint] = x + m * tilt.sin() + side * (arm.w + square.sqrt());
    }
    (0..5)
        .all(|joint| {
            let unit = if joint < 4 { MM } else { DEGREE };
            let limits = &config.joints[joint];
            (f64::from(limits.low.0) / unit..=f64::from(limits.high.0) / unit)
                .contains(&joints[joint])
        })
        .then_some(joints)
}

/// Returns the travel of a search from a pose, in steps of a tenth of `travel`, at most `travel`.
/// The search of the table moves the tool with the workpiece.
fn travel_of_search(
    arm: &ArmGeometry,
    config: &Config,
    pose: &[f64; 5],
    axis: usize,
    travel: f64,
) -> f64 {
    for step in 1..=10 {
        let way = travel * f64::from(step) / 10.0;
        let mut at = *pose;
        at[axis] += way;
        if axis == 4 {
            let (across, up) = (pose[1] + arm.y_off, pose[2] + arm.z_off);
            let (sin, cos) = way.to_radians().sin_cos();
            at[1] = across * cos + up * sin - arm.y_off;
            at[2] = up * cos - across * sin - arm.z_off;
        }
        if joints(arm, config, &at).is_none() {
            return travel * f64::from(step - 1) / 10.0;
        }
    }
    travel
}

/// From every pose of a grid each search has the travel of an index pitch: to the end of the
/// workspace, and back.
#[test]
fn each_search_has_the_travel_of_an_index_pitch() {
    let bench = Bench::new();
    let config = &bench.machine.config;
    let plant: PlantConfig = bench.machine.plant().expect("has a plant");
    let arm = ArmGeometry::of(plant.geometry.as_ref()).expect("has an arm");
    let (mut poses, mut worst) = (0, [(f64::INFINITY, [0.0; 5]); 2]);
    let grid = |axis: usize, count: i32| {
        let [low, high] = limits(config, axis);
        (0..=count).map(move |step| low + (high - low) * f64::from(step) / f64::from(count))
    };
    for x in grid(0, 10) {
        for y in grid(1, 12) {
            for z in grid(2, 10) {
                for theta in grid(3, 10) {
                    for alpha in grid(4, 10) {
                        let pose = [x, y, z, theta, alpha];
                        if joints(arm, config, &pose).is_none() {
                            continue;
                        }
                        poses += 1;
                        for (worst, (axis, pitch)) in worst.iter_mut().zip([(0, 10.0), (4, 4.0)]) {
                            let up = travel_of_search(arm, config, &pose, axis, pitch * 1.2);
                            let down = travel_of_search(arm, config, &pose, axis, -pitch * 1.2);
                            let all = (up - down) / pitch;
                            if all < worst.0 {
                                *worst = (all, pose);
                            }
                        }
                    }
                }
            }
        }
    }
    println!("{poses} poses; least room in pitches: {worst:?}");
    assert!(poses > 10_000 && worst.iter().all(|(all, _)| *all > 1.1));
}

/// Returns the soft limits of a coordinate, mm or degrees.
fn limits(config: &Config, axis: usize) -> [f64; 2] {
    let unit = if axis < 3 { MM } else { DEGREE };
    [config.pose[axis].low, config.pose[axis].high].map(|end| f64::from(end.0) / unit)
}

/// Moves the machine from standstill to a pose (mm, degrees). Returns false if the controller
/// refuses the path.
fn move_to(bench: &mut Bench, pose: &[f64; 5]) -> bool {
    let start = bench.status().commanded;
    let mut end: AxisValues = start.clone();
    for (axis, slot) in end.iter_mut().enumerate() {
        *slot = (pose[axis] * if axis < 3 { MM } else { DEGREE }) as i32;
    }
    // A cubic from standstill to standstill, in segments of 0.2 s.
    let periods = 1000_u16;
    let total = f64::from(periods) * 36.0 * 2e-4;
    let setpoints: Vec<_> = (1..=36)
        .map(|span| {
            let t = f64::from(span) / 36.0;
            let mut setpoint = rest(&end, periods);
            for axis in 0..5 {
                let way = f64::from(end[axis]) - f64::from(start[axis]);
                let place = f64::from(start[axis]) + way * t * t * (3.0 - 2.0 * t);
                setpoint.pose[axis] = place as i32;
                setpoint.rates[axis] = (way * 6.0 * t * (1.0 - t) / total / 256.0) as i32;
            }
            setpoint
        })
        .collect();
    if let Err(refusal) = bench.try_job(1, &setpoints) {
        println!("{refusal:?}");
        return false;
    }
    for _ in 0..60_000 {
        bench.step();
        if state(bench) != State::Run {
            break;
        }
    }
    state(bench) == State::Idle
}

fn home(bench: &mut Bench, pose: &[f64; 5]) {
    bench
        .ask(haptimill_protocol::message::Command::Home)
        .expect("homing");
    let joints = bench.rig.truth().joints;
    // Jogs that were sent before may still wait at the controller.
    let begun = (0..500).any(|_| {
        bench.step();
        state(bench) == State::Homing
    });
    assert!(begun, "{pose:?}: homing has not begun");
    for _ in 0..80_000 {
        bench.step();
        if state(bench) != State::Homing {
            break;
        }
    }
    let fault = bench.rig.control().safety().fault();
    assert_eq!(
        state(bench),
        State::Idle,
        "{pose:?}, joints {joints:?}: {fault:?}"
    );
    bench.steps(500);
    let status = bench.status();
    assert!(status.homed, "{pose:?}: {status:?}");
    let truth = bench.rig.truth().pose;
    for (axis, truth) in truth.iter().enumerate().take(5) {
        let unit = if axis < 3 { MM } else { DEGREE };
        let off = (f64::from(status.measured[axis]) / unit - truth).abs();
        assert!(off < 0.03, "{pose:?}: coordinate {axis} is {off} off");
    }
}

#[test]
fn homing_succeeds_from_any_pose() {
    let mut random = Random::new(1, 77);
    let mut poses: Vec<[f64; 5]> = vec![
        [0.0, 36.0, 0.0, 0.0, 0.0],
        [0.0, 36.0, 0.0, 0.0, 25.0],
        [0.0, -36.0, 0.0, 0.0, 0.0],
        [0.0, 100.0, 0.0, 0.0, 0.0],
    ];
    let bench = Bench::new();
    let config = bench.machine.config.clone();
    let plant: PlantConfig = bench.machine.plant().expect("has a plant");
    let arm = ArmGeometry::of(plant.geometry.as_ref())
        .cloned()
        .expect("has an arm");
    // Random poses, half of them near the end of the workspace along a ray from the middle.
    while poses.len() < 60 {
        let aim: [f64; 5] = core::array::from_fn(|axis| {
            let [low, high] = limits(&config, axis);
            low + (high - low) * (0.001 + 0.998 * random.fraction())
        });
        let far = poses.len().is_multiple_of(2);
        let reach = (1..=200)
            .map(|step| f64::from(step) / 200.0)
            .take_while(|part| joints(&arm, &config, &aim.map(|place| place * part)).is_some())
            .last()
            .unwrap_or(0.0);
        let part = if far {
            reach * 0.99
        } else {
            reach * random.fraction()
        };
        poses.push(aim.map(|place| place * part));
    }
    let mut reached = 0;
    for pose in &poses {
        let mut bench = ready();
        if move_to(&mut bench, pose) {
            reached += 1;
            home(&mut bench, pose);
        } else {
            println!("not reached: {pose:?}");
        }
    }
    println!("{reached} of {} poses", poses.len());
    assert!(reached * 4 > poses.len() * 3);
}

/// The search of the slides ends with l4 at 0.15 mm from the upper end of its stroke. With S34 at
/// 88 mm the stopping envelope of the full search rate of the table is longer than that.
#[test]
fn the_table_is_searched_with_a_slide_at_the_end_of_its_stroke() {
    let mut bench = ready();
    let pose = [56.5401, 119.7868, 4.7, -0.3, 11.4];
    assert!(move_to(&mut bench, &pose));
    let end = f64::from(bench.machine.config.joints[3].high.0) / MM;
    home(&mut bench, &pose);
    let left = end - bench.rig.plant().bodies().motor[3];
    assert!((0.05..0.2).contains(&left), "{left}");
}

/// A load holds a slide some micrometres beyond the end of its stroke, while its commanded position
/// is within.
#[test]
fn homing_works_from_the_end_of_a_stroke() {
    let mut bench = at_the_end_of_a_stroke();
    // Friction holds the slide there under a smaller load.
    bench.rig.plant_mut().set_load(0, -45.0);
    let config = &bench.machine.config;
    let again = f64::from(config.joints[0].low.0) / MM - bench.rig.plant().bodies().motor[0];
    assert!(again > 0.0, "{again}");
    home(&mut bench, &[0.0; 5]);
}

/// The load that pushed the slide stays.
#[test]
fn homing_works_under_a_load_at_the_end_of_a_stroke() {
    let mut bench = at_the_end_of_a_stroke();
    home(&mut bench, &[0.0; 5]);
    bench.steps(20_000);
    assert_eq!(state(&bench), State::Idle);
}

/// Returns a machine with a slide that a load of 60 N holds some micrometres beyond its stroke.
fn at_the_end_of_a_stroke() -> Bench {
    let mut bench = ready();
    let config = bench.machine.config.clone();
    let rate = |axis: usize, part: f64| {
        let unit = if axis < 3 { MM } else { DEGREE };
        (axis, part * f64::from(config.pose[axis].rate.0) / unit)
    };
    let all = [rate(0, -0.4), rate(1, 0.39), rate(2, -0.43), rate(3, -0.4)];
    for (rates, times) in [(&all[..], 340), (&[rate(4, -0.5)], 150)] {
        for _ in 0..times {
            bench.send(jog(1, 300, rates));
            bench.steps(50);
        }
        assert!(bench.wait_for(State::Idle, 20_000));
    }
    bench.rig.plant_mut().set_load(0, -60.0);
    bench.steps(2000);
    let end = f64::from(config.joints[0].low.0) / MM;
    let beyond = end - bench.rig.plant().bodies().motor[0];
    println!("{beyond:.4} mm beyond the end of the stroke");
    assert!((0.001..0.1).contains(&beyond), "{beyond}");
    bench
}
