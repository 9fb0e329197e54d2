//! The test for lost steps finds the pull-out of the simulated step motors. The truth comes from
//! the section `[plant]` alone: the load that friction, damping and inertia put on the motor,
//! against its pull-out effort.

use haptimill_client::client::Options as ClientOptions;
use haptimill_client::session::{Session, SimLine, rig};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::joint::{DriveConfig, JointConfig};
use haptimill_identify::lost_steps::{Highest, StepLimits};
use haptimill_identify::switch_test::{BEYOND, StepOptions, SwitchTest, step_joints};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;
use std::f64::consts::TAU;
use std::path::PathBuf;
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A machine file whose lines are replaced, the `at`-th of each first part.
fn edited(name: &str, changes: &[(&str, usize, &str)]) -> Result<MachineFile> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../machines")
        .join(name);
    let text = std::fs::read_to_string(&path)?;
    let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
    for (from, at, to) in changes {
        let mut found = lines.iter_mut().filter(|line| line.starts_with(from));
        let line = found
            .nth(*at)
            .ok_or_else(|| format!("{name} has no {from}"))?;
        *line = (*to).to_string();
    }
    Ok(MachineFile::parse(name, &lines.join("\n"))?)
}

/// Measures the first joint.
fn measure(machine: &MachineFile, options: &StepOptions) -> Result<Vec<StepLimits>> {
    let (mut joints, _) = step_joints(machine, options);
    joints.truncate(1);
    let line = SimLine::new(rig(machine, None, None, Vec::new())?).unrecorded();
    let mut session = Session::new(line, machine, ClientOptions::default(), Arc::default());
    session.connect(1)?;
    session.configure(&SwitchTest::<SimLine>::raised(machine, &joints))?;
    session.enable()?;
    let mut test = SwitchTest::new(&mut session, machine, &joints);
    let found = test.measure(&mut |what| println!("{what}"))?;
    session.ask(Command::Disable)?;
    session.configure(machine)?;
    for joint in &found {
        println!("{}", joint.summary());
    }
    Ok(found)
}

/// A motion of the field from standstill to standstill.
struct Stroke {
    /// 1 or -1.
    sign: f64,
    rate: f64,
    acceleration: f64,
}

impl Stroke {
    /// Time of a change of the rate, and of the build-up of the acceleration in it.
    fn times(&self) -> (f64, f64) {
        let build_up = BUILD_UP.min(self.rate / self.acceleration);
        (self.rate / self.acceleration + build_up, build_up)
    }

    fn duration(&self) -> f64 {
        2.0 * self.times().0 + 0.3
    }

    fn acceleration(&self, t: f64) -> f64 {
        let (ramp, build_up) = self.times();
        let change = |t: f64| (t / build_up).min((ramp - t) / build_up).clamp(0.0, 1.0);
        self.sign * self.acceleration * (change(t) - change(t - ramp - 0.3))
    }
}

/// Whether the motor loses steps in strokes with rests between them: the equations of motion of
/// rotor and slide on the spring of the screw, without backlash and with a field that turns evenly.
fn loses(joint: &JointConfig, strokes: &[Stroke]) -> bool {
    const STEP: f64 = 1e-5;
    let DriveConfig::Steps(drive) = &joint.drive else {
        return false;
    };
    let inertia = joint.inertia / joint.kind.acceleration_unit();
    let masses = [joint.motor_share, 1.0 - joint.motor_share].map(|share| inertia * share);
    let omega = TAU * joint.mode_hz;
    let reduced = masses[0] * masses[1] / inertia;
    let (spring, loss) = (
        omega * omega * reduced,
        2.0 * joint.mode_damping * omega * reduced,
    );
    // Two full steps of each phase are an electrical turn.
    let turn = 2.0 * f64::from(drive.phases) * joint.lead / f64::from(drive.full_steps);
    let friction = [1.0 - joint.friction_slide_share, joint.friction_slide_share];
    let (mut field, mut field_rate) = (0.0, 0.0);
    let (mut x, mut v) = ([0.0; 2], [0.0; 2]);
    for stroke in strokes {
        let mut t = 0.0;
        while t < stroke.duration() + 0.15 {
            field_rate += STEP * stroke.acceleration(t);
            field += STEP * field_rate;
            t += STEP;
            let lag: f64 = TAU * (field - x[0]) / turn;
            let magnet = drive.pull_out * lag.sin() - drive.damping * v[0];
            let screw = spring * (x[0] - x[1]) + loss * (v[0] - v[1]);
            for (side, force) in [magnet - screw, screw].into_iter().enumerate() {
                let part = friction[side];
                v[side] += STEP * (force - part * joint.viscous * v[side]) / masses[side];
                let max: f64 = STEP * part * joint.coulomb / masses[side];
                v[side] -= v[side].clamp(-max, max);
                x[side] += STEP * v[side];
            }
        }
    }
    (field - x[0]).abs() > turn / 2.0
}

/// Whether it loses steps after a slow stroke, in the direction of that stroke or back.
fn loses_either_way(joint: &JointConfig, rate: f64, acceleration: f64) -> bool {
    [1.0, -1.0].iter().any(|sign| {
        let slow = Stroke {
            sign: 1.0,
            rate: 10.0,
            acceleration: GENTLE,
        };
        let stroke = Stroke {
            sign: *sign,
            rate,
            acceleration,
        };
        loses(joint, &[slow, stroke])
    })
}

/// The value above which `loses` is true.
fn truth(mut low: f64, mut high: f64, loses: impl Fn(f64) -> bool) -> f64 {
    assert!(!loses(low) && loses(high));
    while high / low > 1.01 {
        let middle = (low * high).sqrt();
        if loses(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    low
}

/// Quick homing, which makes the tests shorter.
const QUICK: [(&str, usize, &str); 10] = [
    ("touch_rate_mm_s", 0, "touch_rate_mm_s = 4.0"),
    ("touch_rate_mm_s", 1, "touch_rate_mm_s = 4.0"),
    ("touch_rate_mm_s", 2, "touch_rate_mm_s = 4.0"),
    ("back_off_mm", 0, "back_off_mm = 1.0"),
    ("back_off_mm", 1, "back_off_mm = 1.0"),
    ("back_off_mm", 2, "back_off_mm = 1.0"),
    ("home_order = 2", 0, "home_order = 1"),
    ("home_order = 2", 0, "home_order = 1"),
    ("preset_mm", 0, "preset_mm = -60.0"),
    ("preset = ", 0, "preset = -60.0"),
];

/// The acceleration of the pose in mill3.toml: 300 mm/s^2 with a jerk of 10,000 mm/s^3.
const GENTLE: f64 = 300.0;
const BUILD_UP: f64 = 0.03;

#[test]
fn pull_out_of_a_weak_motor() -> Result<()> {
    let weak = [
        ("pull_out", 0, "pull_out = 150.0"),
        ("backlash_mm", 0, "backlash_mm = 0.0"),
        ("backlash =", 0, "backlash = 0.0"),
    ];
    let machine = edited("mill3.toml", &[&QUICK[..], &weak].concat())?;
    let plant: PlantConfig = machine.plant()?;
    let options = StepOptions {
        travel: 80.0,
        beyond: 2.0,
    };
    let found = measure(&machine, &options)?;

    let joint = &plant.joint[0];
    let near = |found: Option<Highest>, truth: f64, within: f64| {
        let Some(Highest::Between(kept, lost)) = found else {
            panic!("{found:?} and not {truth}")
        };
        println!("{kept:.1} to {lost:.1}, true {truth:.1}");
        assert!(kept < truth * (1.0 + within) && lost > truth * (1.0 - within));
        // The search ends within 5 %.
        assert!(lost / kept < 1.051);
    };
    let rate = truth(10.0, 1000.0, |it| loses_either_way(joint, it, GENTLE));
    near(found[0].rate(), rate, 0.02);
    let at = found[0].working_rate().ok_or("no rate")?;
    let acceleration = truth(400.0, 1e4, |it| loses_either_way(joint, at, it));
    near(found[0].acceleration(), acceleration, 0.03);
    let [Some(proposed_rate), Some(proposed)] = found[0].proposed() else {
        panic!("{:?}", found[0])
    };
    assert!((0.66..0.71).contains(&(proposed_rate / rate)));
    assert!((0.64..0.72).contains(&(proposed / acceleration)));
    assert!(found[0].resonances().is_empty());
    Ok(())
}

/// In full steps the field jumps by a quarter of an electrical turn, and excites the rotor on its
/// magnetic spring and the screw.
#[test]
fn resonance_of_a_motor_in_full_steps() -> Result<()> {
    let full_steps = [
        ("steps_per_turn", 0, "steps_per_turn = 200"),
        ("microsteps", 0, "microsteps = 1"),
        ("pull_out", 0, "pull_out = 300.0"),
        ("damping", 0, "damping = 0.5"),
        // Below the resonance.
        ("touch_rate_mm_s", 0, "touch_rate_mm_s = 1.0"),
    ];
    let machine = edited("mill3.toml", &[&QUICK[..], &full_steps].concat())?;
    let plant: PlantConfig = machine.plant()?;
    let options = StepOptions {
        travel: 80.0,
        beyond: BEYOND,
    };
    let found = measure(&machine, &options)?;

    // Small oscillations of the rotor: N/mm, t, full steps of 0.025 mm.
    let joint = &plant.joint[0];
    let magnetic = 300.0 * TAU / 0.1;
    let omega = TAU * joint.mode_hz;
    let screw = omega * omega * joint.inertia * joint.motor_share * joint.motor_share / 1000.0;
    let rotor = joint.inertia * joint.motor_share / 1000.0;
    let hz = ((magnetic + screw) / rotor).sqrt() / TAU;
    let rate = hz * 0.025;
    let bands = found[0].resonances();
    println!("{bands:?}, true {rate:.2} mm/s");
    let [[low, high]] = bands[..] else {
        panic!("{bands:?}")
    };
    assert!((low..high).contains(&rate) && high / low < 2.1);
    // Above the resonance the motor is strong enough.
    let max = found[0].bounds.rate[1];
    assert_eq!(found[0].rate(), Some(Highest::NoLossUpTo(max)));
    Ok(())
}
