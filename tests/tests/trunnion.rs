//! The trunnion mill of `machines/trunnion5.toml`: the geometry of the simulator against the
//! kinematics of the controller, misalignment, and a cut with the workpiece turned about both axes.

use haptimill_client::session::Line as _;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::trunnion::{Trunnion, TrunnionConfig};
use haptimill_hil_sim::machines::{Geometry, GeometryConfig};
use haptimill_hil_sim::process::{Area, WorkpieceConfig};
use haptimill_kinematics::{Joints, Kinematics};
use haptimill_machine_file::MachineFile;
use haptimill_math::Coordinate;
use haptimill_tests::job;
use proptest::prelude::*;
use std::path::Path;
use std::sync::LazyLock;

static MACHINE: LazyLock<MachineFile> = LazyLock::new(|| {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines/trunnion5.toml");
    MachineFile::load(&file).unwrap_or_else(|problems| panic!("{problems}"))
});

static PLANT: LazyLock<PlantConfig> = LazyLock::new(|| MACHINE.plant().expect("a plant"));

fn geometry() -> TrunnionConfig {
    match &PLANT.geometry {
        Some(GeometryConfig::Trunnion(config)) => config.clone(),
        other => panic!("{other:?}"),
    }
}

/// Axis units of a joint position in mm or degrees.
fn raw(axis: usize, value: f64) -> Coordinate {
    let unit = if axis < 3 {
        f64::from(1 << 20)
    } else {
        4_294_967_296.0 / 360.0
    };
    Coordinate((value * unit).round() as i32)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2000,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Two derivations of one machine agree within the resolution of the angles: 400 mm turned by
    /// half a unit is 3e-7 mm.
    #[test]
    fn controller_and_plant_have_the_same_pose(
        slides in prop::array::uniform3(-150.0..150.0_f64),
        a in -65.0..65.0_f64,
        c in -165.0..165.0_f64,
    ) {
        let [x, y, z] = slides;
        let joints = [x, y, z.max(-60.0), a, c, 0.0];
        let mut pose = [0.0; 6];
        let mut plant = Trunnion::new(&geometry(), &joints).expect("a mill");
        prop_assert!(plant.follow(&joints, &mut pose));
        let mut units = Joints::default();
        for (joint, unit) in units.0.iter_mut().enumerate() {
            *unit = raw(joint, joints[joint]);
        }
        let measured = MACHINE.config.kinematics().forward(&units).expect("a pose");
        for (joint, (measured, truth)) in measured.0.iter().zip(pose).take(3).enumerate() {
            let off = f64::from(measured.0) / f64::from(1 << 20) - truth;
            prop_assert!(off.abs() < 5e-6, "joint {joint} is off by {off}");
        }
        prop_assert_eq!(&pose[3..5], &joints[3..5]);
    }

    /// Power is conserved: a force times the motion of its point on the workpiece is the loads
    /// times the motion of the joints, also with every error of assembly.
    #[test]
    fn joint_loads_conserve_power(
        joints in prop::array::uniform5(-60.0..60.0_f64),
        rates in prop::array::uniform5(-1.0..1.0_f64),
        force in prop::array::uniform3(-50.0..50.0_f64),
        errors in prop::array::uniform4(-4.0..4.0_f64),
        above in 0.0..8.0_f64,
    ) {
        let config = TrunnionConfig {
            tilt_about_y_deg: errors[0],
            tilt_about_z_deg: errors[1],
            table_about_x_deg: errors[2],
            table_about_y_deg: errors[3],
            squareness_xy: 0.02,
            squareness_xz: -0.01,
            squareness_yz: 0.03,
            ..geometry()
        };
        let at = |time: f64| -> [f64; 6] {
            std::array::from_fn(|joint| {
                if joint < 5 { joints[joint] + time * rates[joint] } else { 0.0 }
            })
        };
        let mut mill = Trunnion::new(&config, &at(0.0)).expect("a mill");
        let point = |mill: &mut Trunnion, time: f64| -> [f64; 3] {
            let mut pose = [0.0; 6];
            mill.follow(&at(time), &mut pose);
            let tool = mill.tool_pose(&pose);
            std::array::from_fn(|i| tool.tip[i] + above * tool.axis[i])
        };
        let step = 1e-4;
        let (before, after) = (point(&mut mill, -step), point(&mut mill, step));
        let outside: f64 = (0..3)
            .map(|i| force[i] * (after[i] - before[i]) / (2.0 * step))
            .sum();
        let mut pose = [0.0; 6];
        mill.follow(&at(0.0), &mut pose);
        let loads = mill.joint_loads(&at(0.0), &pose, force, above).expect("regular");
        // N m and degrees per second to N mm per second.
        let unit = |joint: usize| if joint < 3 { 1.0 } else { 1e3_f64.to_radians() };
        let inside: f64 = (0..5).map(|joint| loads[joint] * rates[joint] * unit(joint)).sum();
        prop_assert!((outside - inside).abs() < 1e-4, "{outside} {inside}");
    }
}

/// A table that leans by one degree about y moves a point 80 mm above it by 80 mm sin(1 deg) in x
/// while it turns by half a turn.
#[test]
fn a_leaning_table_shows_in_the_true_pose() {
    let config = TrunnionConfig {
        table_about_y_deg: 1.0,
        ..geometry()
    };
    let at = |c: f64| {
        let joints = [config.table_x, config.table_y, 80.0, 0.0, c, 0.0];
        let mut pose = [0.0; 6];
        let mut mill = Trunnion::new(&config, &joints).expect("a mill");
        mill.follow(&joints, &mut pose);
        pose
    };
    // The tip is 80 - tl + 120 mm above the trunnion's axis, about which the table leans.
    let lever = (80.0 - config.tl - config.tilt_z) * 1.0_f64.to_radians().sin();
    let (ahead, back) = (at(0.0)[0], at(180.0)[0]);
    assert!((ahead - back + 2.0 * lever).abs() < 1e-6, "{ahead} {back}");
}

/// A groove with the workpiece tilted by 20 degrees and turned by 30: the ball of radius R, whose
/// centre is R above the tip along the tool, leaves its lowest point R (1 - cos a) below the tip.
#[test]
fn a_tilted_and_turned_workpiece_is_cut_where_the_program_says() {
    let machine = &*MACHINE;
    let text = "G21 G90 G17\nS9000 M3\nG0 A20 C30\nG0 X-12 Y5\nG1 Z2 F600\nG1 Z-1 F200\n\
                G1 X12 F300\nG1 Z20 F600\nG0 A0 C0\nM5\nM30\n";
    let plan = job::plan(machine, text).unwrap_or_else(|refused| panic!("{refused}"));

    let area = |x: f64, y: f64| Area {
        x_min: -x,
        x_max: x,
        y_min: -y,
        y_max: y,
    };
    let stock = PLANT.cutting(WorkpieceConfig {
        stock: area(30.0, 20.0),
        map: area(25.0, 15.0),
        cell_mm: 0.1,
        top_mm: 0.0,
        rise_x_deg: 0.0,
        rise_y_deg: 0.0,
        bottom_mm: -20.0,
    });
    let radius = stock.cutter.radius_mm;
    let mut session = job::homed(machine, vec![]);
    session.line_mut().clamp(&stock).expect("a stock");
    job::run(&mut session, 2, machine, &plan);

    let line = session.into_line();
    let process = line.rig().plant().process().expect("a process");
    let surface = process.cutting().expect("a stock").workpiece();
    let tilt = 20.0_f64.to_radians();
    let (sin, cos) = tilt.sin_cos();
    let (turn_sin, turn_cos) = 30.0_f64.to_radians().sin_cos();
    // The axis of the tool in the workpiece frame: upwards, turned back by a, then by c.
    let axis = [sin * turn_sin, sin * turn_cos, cos];
    let floor = -1.0 + radius * (cos - 1.0);
    for x in [-8.0, -3.0, 0.0, 4.0, 9.0] {
        let height = surface.height(x + radius * axis[0], 5.0 + radius * axis[1]);
        assert!(
            (height - floor).abs() < 0.02,
            "at {x} the floor is {height}, not {floor}"
        );
    }
    // Beside the groove nothing is cut.
    assert!(surface.height(0.0, -8.0).abs() < 1e-6);
    assert!(surface.removed_mm3() > 50.0, "{}", surface.removed_mm3());
}
