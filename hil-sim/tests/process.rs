//! The cut on the machine: joint loads, compliance of the structure, and the force sensor.

use crate::machine;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs};
use haptimill_hil_sim::joint::DriveConfig;
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::config::Area;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::process::structure::{Structure, StructureConfig};
use haptimill_hil_sim::process::{CuttingConfig, ElasticWall, SpindleConfig, WorkpieceConfig};
use haptimill_hil_sim::{Control, Plant, PlantConfig, Rig, RigOptions};

const PERIOD: f64 = 200e-6;

/// The reference machine without friction, start offsets and backlash.
fn smooth() -> PlantConfig {
    let mut config = machine::reference();
    for joint in &mut config.joint {
        joint.coulomb = 0.0;
        joint.backlash = 0.0;
        joint.start_spread = 0.0;
    }
    config
}

fn block(top_mm: f64, x: f64, y: f64) -> CuttingConfig {
    CuttingConfig {
        workpiece: WorkpieceConfig {
            stock: Area {
                x_min: x - 100.0,
                x_max: x + 100.0,
                y_min: y - 100.0,
                y_max: y + 100.0,
            },
            map: Area {
                x_min: x - 20.0,
                x_max: x + 20.0,
                y_min: y - 10.0,
                y_max: y + 10.0,
            },
            top_mm,
            bottom_mm: top_mm - 30.0,
            ..WorkpieceConfig::default()
        },
        ..CuttingConfig::default()
    }
}

/// Holds the slides at moving positions with a stiff position loop on the true positions.
struct Held {
    config: PlantConfig,
    plant: Plant,
    goal: [f64; 5],
    outputs: Outputs,
}

impl Held {
    fn new(config: &PlantConfig, process: &ProcessConfig) -> Self {
        let mut plant = Plant::new(config, 200).expect("a machine");
        plant.fit(process).expect("a process");
        let goal = core::array::from_fn(|joint| plant.bodies().motor[joint]);
        Self {
            config: config.clone(),
            plant,
            goal,
            outputs: Outputs::default(),
        }
    }

    /// Runs one period; the four slides move at `rate` mm/s along x together.
    fn step(&mut self, rate: f64, rpm: i16) {
        for index in 0..5 {
            if index < 4 {
                self.goal[index] += rate * PERIOD;
            }
            let bodies = self.plant.bodies();
            let rate = if index < 4 { rate } else { 0.0 };
            // 160 rad/s with damping 1.
            let joint = &self.config.joint[index];
            let DriveConfig::Torque(drive) = &joint.drive else {
                unreachable!("torque drives");
            };
            let effort = (25_600.0 * (self.goal[index] - bodies.motor[index])
                + 320.0 * (rate - bodies.motor_rate[index]))
                * joint.inertia
                / joint.kind.acceleration_unit();
            let code = (effort / drive.full_scale * 8192.0).clamp(-8192.0, 8191.0);
            self.outputs.joints[index] = DriveCommand::Torque(code as i16);
        }
        self.outputs.spindle_rpm = rpm;
        let outputs = self.outputs.clone();
        self.plant.advance(&outputs);
    }
}

#[test]
fn a_wall_force_maps_to_the_slides_by_virtual_work() {
    // Constant drives press the tool against a wall in -x, with the shares that hold the platform
    // level (from the table of dl/d(x, theta) at home: 350 mm for the upper pair, 150 mm for the
    // lower).
    let config = smooth();
    let mut plant = Plant::new(&config, 200).expect("a machine");
    let start = plant.truth().pose;
    plant
        .fit(&ProcessConfig {
            wall: Some(ElasticWall {
                point: [start[0] - 0.5, 0.0, 0.0],
                normal: [1.0, 0.0, 0.0],
                stiffness: 200.0,
                damping: 2.0,
                radius: 0.0,
            }),
            sensor: Some(SensorConfig::ideal()),
            ..ProcessConfig::default()
        })
        .expect("a wall");
    let mut outputs = Outputs::default();
    let shares = [-0.375, -0.375, 0.875, 0.875];
    for _ in 0..30_000 {
        for (axis, share) in shares.into_iter().enumerate() {
            let rate = plant.bodies().motor_rate[axis];
            // Damping of the test's own, to reach standstill.
            let effort: f64 = -20.0 * share - 2.0 * rate;
            outputs.joints[axis] = DriveCommand::Torque((effort / 800.0 * 8192.0).round() as i16);
        }
        plant.advance(&outputs);
    }
    // At standstill the wall balances the drives, to their codes of 0.1 N.
    let force = plant.truth().force;
    assert!((force[0] - 20.0).abs() < 0.3, "{force:?}");
    assert!(
        plant.truth().pose[3].abs() < 0.2,
        "level: {:?}",
        plant.truth().pose
    );
    assert_eq!((force[1], force[2]), (0.0, 0.0));
    let depth = start[0] - 0.5 - plant.truth().pose[0];
    assert!((depth * 200.0 - force[0]).abs() < 0.05, "{depth}");
    // The sensor measures the force on the workpiece.
    let codes = plant.force_codes().expect("a sensor");
    assert!(
        (f64::from(codes[0]) * 100.0 / 8192.0 + force[0]).abs() < 0.01,
        "{codes:?}"
    );
}

#[test]
fn the_machine_cuts_a_slot_and_measures_the_force() {
    let config = smooth();
    let plant = Plant::new(&config, 200).expect("a machine");
    let start = plant.truth().pose;
    // The tool is in a notch of the stock's edge: the workpiece begins 5 mm before it in -x and
    // reaches 2 mm above its tip.
    let mut cutting = block(start[2] + 2.0, start[0], start[1]);
    cutting.workpiece.stock.x_max = start[0] - 5.0;
    let process = ProcessConfig {
        spindle: SpindleConfig {
            time_constant_s: 0.05,
        },
        cutting: Some(cutting),
        structure: Some(StructureConfig::default()),
        sensor: Some(SensorConfig::ideal()),
        ..ProcessConfig::default()
    };
    let mut held = Held::new(&config, &process);
    for _ in 0..2000 {
        held.step(0.0, 5000);
    }
    assert_eq!(held.plant.truth().force, [0.0; 3]);
    // 9 mm at 4 mm/s: into the workpiece and on.
    let (mut mean, mut max) = ([0.0; 3], 0.0_f64);
    for step in 0..11_250 {
        held.step(-4.0, 5000);
        // 30 revolutions of the spindle.
        if step >= 11_250 - 1800 {
            let force = held.plant.truth().force;
            for i in 0..3 {
                mean[i] += force[i] / 1800.0;
            }
            max = max.max(force[0]);
            let process = held.plant.process().expect("a process");
            let codes = held.plant.force_codes().expect("a sensor");
            assert!((f64::from(codes[0]) * 100.0 / 8192.0 + process.force()[0]).abs() < 0.01);
        }
    }
    // The mean force of a slot of 2 mm at 4 mm/s. The peaks are higher than on a rigid machine,
    // because the slides oscillate.
    for (ours, rigid) in mean.into_iter().zip([2.76, -1.77, 3.69]) {
        assert!((ours - rigid).abs() < 0.2, "{mean:?}");
    }
    assert!(max > 5.0 && max < 8.0, "{max}");
    // The structure deflects by the mean force over its stiffness, and the ground truth contains
    // that.
    let deflection = held
        .plant
        .process()
        .and_then(|process| process.structure())
        .expect("a structure")
        .deflection();
    assert!(
        deflection[0] > 0.002 && deflection[0] < 0.012,
        "{deflection:?}"
    );

    let process = held.plant.process_mut().expect("a process");
    let cutting = process.cutting_mut().expect("a cut");
    cutting.settle();
    let piece = cutting.workpiece();
    // The edges removed what the map lost, although the tool oscillates.
    let (chips, lost) = (cutting.chips_mm3(), piece.removed_mm3());
    assert!((chips / lost - 1.0).abs() < 0.02, "{chips} {lost}");
    let groove = piece
        .groove(
            [start[0] - 7.0, start[1] - 8.0],
            [start[0] - 7.0, start[1] + 8.0],
            0.1,
        )
        .expect("a slot");
    assert!((groove.depth - 2.0).abs() < 0.05, "{groove:?}");
    assert!((groove.width() - 6.81).abs() < 0.1, "{groove:?}");

    // The spindle stops while the feed continues: the force grows until a slide stalls.
    for _ in 0..3000 {
        held.step(-4.0, 0);
    }
    assert!(
        held.plant.truth().force[0] > 50.0,
        "{:?}",
        held.plant.truth().force
    );
    let process = held.plant.process().expect("a process");
    assert!(process.cut().pressed && process.spindle().rpm() == 0.0);
    // After the retraction the tool is free.
    for _ in 0..6000 {
        held.step(4.0, 0);
    }
    assert!(
        held.plant.truth().force[0].abs() < 1.0,
        "{:?}",
        held.plant.truth().force
    );
}

/// A machine with friction stops in the middle of a slot: the chips end, and only the load of the
/// wound-up screws remains.
#[test]
fn a_stopped_feed_in_material_has_no_cutting_force() {
    let mut config = machine::reference();
    for joint in &mut config.joint {
        joint.start_spread = 0.0;
    }
    let plant = Plant::new(&config, 200).expect("a machine");
    let start = plant.truth().pose;
    let mut cutting = block(start[2] + 2.0, start[0], start[1]);
    cutting.workpiece.stock.x_max = start[0] - 5.0;
    let process = ProcessConfig {
        spindle: SpindleConfig {
            time_constant_s: 0.05,
        },
        cutting: Some(cutting),
        structure: Some(StructureConfig::default()),
        ..ProcessConfig::default()
    };
    let mut held = Held::new(&config, &process);
    for _ in 0..10_000 {
        held.step(-4.0, 5000);
    }
    assert!(held.plant.truth().force[0].abs() > 0.1);
    for _ in 0..5000 {
        held.step(0.0, 5000);
    }
    let mut max = 0.0_f64;
    for _ in 0..2500 {
        held.step(0.0, 5000);
        for part in held.plant.truth().force {
            max = max.max(part.abs());
        }
    }
    assert!(max < 0.05, "{max}");
}

#[test]
fn an_emergency_stop_switches_the_spindle_off() {
    let config = smooth();
    let mut held = Held::new(&config, &ProcessConfig::default());
    for _ in 0..10_000 {
        held.step(0.0, 5000);
    }
    let rpm = |held: &Held| held.plant.process().expect("a process").spindle().rpm();
    assert!((rpm(&held) - 5000.0).abs() < 10.0);
    held.plant.set_emergency_stop(true);
    for _ in 0..20_000 {
        held.step(0.0, 5000);
    }
    assert_eq!(rpm(&held), 0.0);
}

#[test]
fn a_machine_without_a_process_is_unchanged() {
    let config = machine::reference();
    let mut plain = Plant::new(&config, 200).expect("a machine");
    let mut fitted = plain.clone();
    fitted.fit(&ProcessConfig::default()).expect("a spindle");
    assert!(plain.process().is_none() && plain.force_codes().is_none());
    assert!(fitted.force_codes().is_none());
    let mut outputs = Outputs::default();
    for step in 0..2000_i16 {
        outputs.joints[..5].fill(DriveCommand::Torque(step % 700 - 350));
        plain.advance(&outputs);
        fitted.advance(&outputs);
        assert_eq!(plain.bodies(), fitted.bodies());
        assert_eq!(plain.truth(), fitted.truth());
    }
}

#[test]
fn three_slides_carry_a_tool_and_fewer_are_refused() {
    let mut config = machine::slide();
    let process = ProcessConfig {
        wall: Some(ElasticWall {
            point: [0.0, 0.0, -1.0],
            normal: [0.0, 0.0, 1.0],
            stiffness: 100.0,
            damping: 0.0,
            radius: 0.0,
        }),
        ..ProcessConfig::default()
    };
    let mut lonely = Plant::new(&config, 200).expect("a slide");
    assert!(lonely.fit(&process).is_err());
    let joint = config.joint[0].clone();
    config.joint = vec![joint.clone(), joint.clone(), joint];
    let mut plant = Plant::new(&config, 200).expect("three slides");
    plant.fit(&process).expect("three slides");
    let mut outputs = Outputs::default();
    // The third drives into the wall with 100 N, of which friction may hold 40 N.
    outputs.joints[2] = DriveCommand::Torque(-1024);
    for _ in 0..20_000 {
        plant.advance(&outputs);
    }
    let force = plant.truth().force;
    assert!(force[0] == 0.0 && force[1] == 0.0);
    assert!((50.0..150.0).contains(&force[2]), "{force:?}");
}

/// A slide without friction rebounds from a wall: a damping of k T / 2 compensates the force that
/// is held for a period.
#[test]
fn a_sampled_wall_adds_the_energy_of_half_a_period_of_damping() {
    let bounce = |damping: f64| {
        let mut config = machine::ideal_slide();
        let joint = config.joint[0].clone();
        config.joint = vec![joint.clone(), joint.clone(), joint];
        let mut plant = Plant::new(&config, 200).expect("three slides");
        let process = ProcessConfig {
            wall: Some(ElasticWall {
                point: [0.0, 0.0, -4.0],
                normal: [0.0, 0.0, 1.0],
                stiffness: 1000.0,
                damping,
                radius: 0.0,
            }),
            ..ProcessConfig::default()
        };
        plant.fit(&process).expect("a wall");
        // A push for 20 ms, then free motion.
        let mut outputs = Outputs::default();
        outputs.joints[2] = DriveCommand::Torque(-1000);
        for _ in 0..100 {
            plant.advance(&outputs);
        }
        outputs.joints[2] = DriveCommand::Torque(0);
        plant.advance(&outputs);
        let energy = |plant: &Plant| plant.mechanics().energy(plant.bodies(), 2);
        let before = energy(&plant);
        let mut touched = false;
        for _ in 0..5000 {
            plant.advance(&outputs);
            let force = plant.truth().force[2];
            touched |= force > 0.0;
            if touched && force == 0.0 && plant.bodies().slide[2] > -3.0 {
                return energy(&plant) / before;
            }
        }
        panic!("no bounce: {:?}", plant.bodies());
    };
    let (bare, made_up) = (bounce(0.0), bounce(0.1));
    assert!(bare > 1.01, "{bare}");
    assert!(
        (made_up - 1.0).abs() < 0.2 * (bare - 1.0),
        "{made_up} {bare}"
    );
}

#[test]
fn the_structure_deflects_with_its_stiffness_and_time_constant() {
    let config = StructureConfig {
        stiffness: [400.0, f64::INFINITY, 1000.0],
        time_constant_s: 0.002,
    };
    config.check().expect("a structure");
    let mut structure = Structure::new(&config, PERIOD);
    for step in 1..=50 {
        let deflection = structure.advance([8.0, 8.0, -5.0]);
        let part = 1.0 - (-f64::from(step) * PERIOD / 0.002).exp();
        assert!((deflection[0] - 0.02 * part).abs() < 1e-12);
        assert_eq!(deflection[1], 0.0);
        assert!((deflection[2] + 0.005 * part).abs() < 1e-12);
    }
}

#[test]
fn a_contact_ten_times_as_stiff_as_the_structure_is_stable() {
    let mut structure = Structure::new(&StructureConfig::default(), PERIOD);
    let wall = ElasticWall {
        point: [0.0, 0.0, 0.0],
        normal: [1.0, 0.0, 0.0],
        stiffness: 4_900.0,
        damping: 0.0,
        radius: 0.0,
    };
    // The slides hold the tool 0.1 mm inside the wall: both springs in series.
    let mut deflection = [0.0; 3];
    for _ in 0..500 {
        let pose = haptimill_hil_sim::process::ToolPose::upright([-0.1 + deflection[0], 0.0, 0.0]);
        deflection = structure.advance(wall.force(&pose, [0.0; 3]));
    }
    let exact = 0.1 * 4900.0 / (4900.0 + 500.0);
    assert!(
        (deflection[0] - exact).abs() < 1e-6,
        "{deflection:?} {exact}"
    );
}

/// Faults of sensor and spindle start and end on time.
#[test]
fn faults_of_sensor_and_spindle_start_and_end_on_time() {
    struct Pressed;
    impl Control for Pressed {
        fn tick(&mut self, _: &Inputs, outputs: &mut Outputs) {
            outputs.spindle_rpm = 5000;
        }
    }
    let config = smooth();
    let options = RigOptions {
        faults: [
            "sensor-saturated along=x level=high at=100ms for=100ms",
            "sensor-dropped along=y at=100ms for=100ms",
            "sensor-reversed along=z at=100ms for=100ms",
            "spindle-stalled at=100ms for=100ms",
            "sensor-drift along=x rate=50 at=300ms for=100ms",
            "sensor-stuck along=z at=300ms for=100ms",
        ]
        .map(|line| line.parse().expect(line))
        .to_vec(),
        ..RigOptions::default()
    };
    let mut rig = Rig::new(&config, &options, Pressed).expect("a rig");
    rig.plant_mut()
        .fit(&ProcessConfig {
            // Its drift looks like a force.
            sensor: Some(SensorConfig {
                drift_n_s: [8.0, 8.0, 8.0],
                ..SensorConfig::ideal()
            }),
            ..ProcessConfig::default()
        })
        .expect("a sensor");
    let at = |ms: usize, rig: &mut Rig<Pressed>| {
        while rig.time_ns() < ms as u64 * 1_000_000 {
            rig.step();
        }
        let process = rig.plant().process().expect("a process");
        (
            rig.plant().force_codes().expect("a sensor"),
            process.spindle().rpm(),
        )
    };
    // 8 N/s is 65.5 codes in 100 ms.
    let (codes, rpm) = at(99, &mut rig);
    assert!(
        codes.iter().all(|code| (60..70).contains(code)),
        "{codes:?}"
    );
    assert!(rpm > 1000.0);
    let (codes, rpm) = at(150, &mut rig);
    assert_eq!((codes[0], codes[1], rpm), (8191, 0, 0.0));
    assert!((-105..-90).contains(&codes[2]), "{codes:?}");
    let (codes, rpm) = at(290, &mut rig);
    assert!(
        codes.iter().all(|code| (180..200).contains(code)),
        "{codes:?}"
    );
    assert!(rpm > 500.0);
    let (codes, _) = at(399, &mut rig);
    assert!(
        (630..690).contains(&codes[0]) && (190..200).contains(&codes[2]),
        "{codes:?}"
    );
    let (codes, _) = at(410, &mut rig);
    assert!((260..280).contains(&codes[2]), "{codes:?}");
}
