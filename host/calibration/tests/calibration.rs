//! The laser measures the simulated machine through the controller.

use haptimill_calibration::calibrate::{Measured, Plan, calibrate};
use haptimill_calibration::comparison::{side_table, table_5_1};
use haptimill_calibration::cut::{Cmm, PROGRAM, surface};
use haptimill_calibration::drive::{Machine, SLOW};
use haptimill_calibration::laser::LaserOptions;
use haptimill_calibration::scenario::{Volume, machine, measure_volume, travel, truth, worn};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::compensation::CHAIN;
use haptimill_volumetric::chain::Model;
use haptimill_volumetric::errors::{
    Approach, Axis, ErrorSet, Function, Kind, Shape, Table, interpolate,
};
use haptimill_volumetric::file;
use haptimill_volumetric::gdt::fit_line;
use haptimill_volumetric::grid::Grid;

fn plan(laser: LaserOptions) -> Plan {
    Plan {
        interval: 60.0,
        wait: 0.8,
        laser,
        ..Plan::default()
    }
}

/// Instruments without noise find the errors of the machine: the volumes differ by a motion of the
/// whole workpiece and by what the drives leave at standstill, at points whose coordinates are
/// targets.
#[test]
fn exact_instruments_find_the_errors() {
    let file = machine().unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let found = calibrate(&mut powered, &file, &plan(LaserOptions::ideal()), |_| ()).unwrap();
    let (_, errors) = truth(&file).unwrap();
    let places = |axis: usize| {
        let targets = found.axes[axis].targets.iter().copied();
        targets.filter(|place| place.abs() < 150.0).collect()
    };
    let grid = Grid {
        places: [places(0), places(1), places(2)],
    };
    let model = Model::default();
    let volume = Volume::of(grid.points(), |point| {
        model.error(&found.errors, point) - model.error(&errors, point)
    });
    let (raw, rest) = (volume.sizes(), volume.without_motion().sizes());
    println!("{raw:?}, without motion {rest:?}");
    assert!(rest.largest < 0.05e-3, "{rest:?}");
    let report = found.report();
    assert!(report.contains("the machine has none"), "{report}");
    assert!(
        report.contains("by another instrument than the laser"),
        "{report}"
    );
    // Every channel shows 0 at its first target.
    for measured in found.axes.iter().flat_map(|axis| &axis.functions) {
        assert_eq!(measured.up[0][0], 0.0, "{}", measured.function);
    }
}

/// A compensated machine is measured too: a beam between tool and table reads what the compensation
/// leaves of the translations, and the whole of the rotations. The report says so.
#[test]
fn a_compensated_machine_reads_what_is_left() {
    let file = machine().unwrap();
    let compensated = haptimill_calibration::scenario::with_exact_tables(&file).unwrap();
    let coarse = Plan {
        interval: 100.0,
        ..plan(LaserOptions::ideal())
    };
    let mut powered = Machine::new(&compensated, SLOW, &Default::default()).unwrap();
    let mut ranges = |on| {
        powered.compensate(on).unwrap();
        let found = calibrate(&mut powered, &compensated, &coarse, |_| ()).unwrap();
        let all = found.axes.iter().flat_map(|axis| &axis.functions);
        let range = |measured: &Measured| {
            let readings = measured.up.iter().chain(&measured.down).flatten();
            let [low, high] =
                [f64::min, f64::max].map(|of| readings.clone().copied().fold(0.0, of));
            (measured.function, high - low)
        };
        (all.map(range).collect::<Vec<_>>(), found.report())
    };
    let (off, report) = ranges(false);
    assert!(report.contains("compensation off"), "{report}");
    let (on, report) = ranges(true);
    assert!(report.contains("ON (100 %)"), "{report}");
    for ((function, off), (_, on)) in off.into_iter().zip(on) {
        let unit = function.file_unit();
        println!("{function} off {:.3} on {:.3}", off / unit, on / unit);
        if function.rotates {
            // At another place by the correction.
            assert!((on - off).abs() < 0.01e-6, "{function}: {off} {on}");
        } else {
            // Twice the goal of 0.1 um: a range has two ends.
            assert!(off > 0.5e-3, "{function}: {off}");
            assert!(on < 0.2e-3, "{function}: {on}");
        }
    }
}

/// What is left of the errors of a worn machine is what the stated uncertainty of the instruments
/// leaves, not the distance of the targets: in each of ten readings of a target the instruments are
/// off by their uncertainty, and a coordinate of the tool has two straightness errors, one
/// positioning error and the one at the origin. A scale error is the same in all ten.
#[test]
fn measured_errors_are_as_exact_as_the_instruments() {
    let file = worn(&machine().unwrap(), 10.0).unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let plan = Plan::default();
    let found = calibrate(&mut powered, &file, &plan, |_| ()).unwrap();
    let (_, errors) = truth(&file).unwrap();
    let model = Model::default();
    let volume = Volume::of(Grid::part().points(), |point| {
        model.error(&found.errors, point) - model.error(&errors, point)
    });
    let rest = volume.without_motion().sizes();
    // The options are two standard deviations.
    let mean_of_ten = |two: f64| (0.5 * two).powi(2) / 10.0;
    let laser = plan.laser;
    let coordinate = 2.0 * mean_of_ten(laser.straightness.1) + 2.0 * mean_of_ten(laser.resolution);
    let point = (3.0 * coordinate).sqrt();
    println!("expected {point} mm, {rest:?}");
    assert!((0.3 * point..1.5 * point).contains(&rest.rms), "{rest:?}");
    assert!(rest.largest < 3.0 * point, "{rest:?}");
    // The same through the whole chain: the measured tables in the controller, the tool at
    // standstill at some points of the grid, where the drives are off by 0.1 um at most.
    let text = file::write(&found.errors, "measured");
    let compensated = file.with_errors("measured errors", &text, CHAIN).unwrap();
    let mut powered = Machine::new(&compensated, SLOW, &Default::default()).unwrap();
    powered.compensate(true).unwrap();
    let side = vec![-80.0, -20.0, 40.0, 80.0];
    let grid = Grid {
        places: [side.clone(), side, vec![0.0, -38.0]],
    };
    let stood = measure_volume(&mut powered, &grid)
        .unwrap()
        .without_motion();
    println!("through the chain {:?}", stood.sizes());
    assert!(stood.sizes().rms < 1.5 * point, "{:?}", stood.sizes());
    assert!(
        stood.sizes().largest < 3.0 * point + 0.1e-3,
        "{:?}",
        stood.sizes()
    );
    // The readings of a target scatter by the resolution and the drives alone: the ten runs of an
    // axis share their scale error, which 650 mm would make 0.23 um.
    for axis in &found.axes {
        let of_axis = axis.functions.iter();
        let positioning = of_axis.filter(|measured| measured.function.kind() == Kind::Positioning);
        for last in positioning.filter_map(|measured| measured.up.last()) {
            let mean = last.iter().sum::<f64>() / last.len() as f64;
            let square = |reading: &f64| (reading - mean).powi(2);
            let scatter = (last.iter().map(square).sum::<f64>() / (last.len() - 1) as f64).sqrt();
            println!("{:?} scatters by {:.3} um", axis.axis, 1e3 * scatter);
            let expected = (0.5 * laser.resolution).hypot(STILL);
            assert!(scatter < 2.2 * expected, "{:?} {scatter}", axis.axis);
        }
    }
    // Every function over the whole travel, but for what no instrument sees: the value at the
    // origin, or the line of a straightness. A reading has its own noise and the scale of its run.
    for function in Function::all() {
        let Shape::Table(table) = found.errors.function(function) else {
            panic!("a table");
        };
        assert_eq!(table.down, None, "{function}");
        let nodes = &table.nodes;
        let shape = errors.function(function);
        let mut truth: Vec<f64> = nodes
            .iter()
            .map(|at| shape.value(*at, Approach::Any))
            .collect();
        let points: Vec<[f64; 2]> = nodes.iter().zip(&truth).map(|(u, v)| [*u, *v]).collect();
        let (reading, scale, still) = match function.kind() {
            Kind::Straightness => (laser.straightness.1, laser.straightness.0, STILL),
            Kind::Positioning => (laser.resolution, laser.linear, STILL),
            Kind::Roll => (laser.roll.unwrap(), 0.0, 0.0),
            _ => (laser.angle.1, laser.angle.0, 0.0),
        };
        let mut variance = 2.0 * mean_of_ten(reading);
        if function.kind() == Kind::Straightness {
            variance = mean_of_ten(reading);
            truth = fit_line(&points).unwrap().residuals;
            if function.moving == Axis::Y {
                // The straight edge turns with the table: a measured rotation on the whole arm.
                variance += 2.0 * mean_of_ten(250.0 * laser.angle.1);
            }
        } else {
            let origin = interpolate(nodes, &truth, 0.0);
            truth.iter_mut().for_each(|value| *value -= origin);
        }
        let range = truth
            .iter()
            .fold(0.0_f64, |max, value| max.max(value.abs()));
        let deviation = |at: f64| {
            let of_scale = match function.kind() {
                Kind::Positioning => 0.5 * scale * at,
                _ => 0.5 * scale * 2.0 * range,
            };
            (variance + of_scale * of_scale + still * still).sqrt()
        };
        let ratios: Vec<f64> = nodes
            .iter()
            .zip(table.up.iter().zip(&truth))
            .map(|(at, (found, truth))| (found - truth) / deviation(*at))
            .collect();
        let largest = ratios
            .iter()
            .fold(0.0_f64, |max, ratio| max.max(ratio.abs()));
        let squares = ratios.iter().map(|ratio| ratio * ratio).sum::<f64>();
        let rms = (squares / ratios.len() as f64).sqrt();
        let unit = function.file_unit();
        println!(
            "{function} range {:.2}, deviation {:.3}: rms {rms:.2}, largest {largest:.2}",
            range / unit,
            deviation(200.0) / unit
        );
        // What is found is much more than what is not.
        assert!(range > 8.0 * deviation(200.0), "{function}");
        assert!(largest < 3.5, "{function}: {largest}");
        assert!(rms < 1.5, "{function}: {rms}");
    }
}

/// What the drives leave at standstill, mm.
const STILL: f64 = 0.03e-3;

/// Row 33: the whole pipeline of the experiment. The laser finds the errors, the machine cuts the
/// part without compensation at 20 mm/s, the measuring machine probes two sides in 3 runs, and the
/// trend of the model explains their profiles. Over 40 seeds of the measuring machine, the medians
/// of R squared are within the bands of a replay without a machine.
#[test]
fn the_model_explains_the_measured_sides() {
    let file = machine().unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let found = calibrate(&mut powered, &file, &Plan::default(), |_| ()).unwrap();
    let cut = surface(&powered.run("a160.ngc", PROGRAM).unwrap()).unwrap();
    let of_seed = |seed: u64| {
        let runs = Cmm {
            seed,
            ..Cmm::default()
        }
        .probe(&cut);
        let lines = table_5_1(&found.errors, &[0, 3].map(|side| side_table(&runs, side)));
        [0, 1].map(|side| lines[side].r_squared)
    };
    let all: Vec<[f64; 2]> = (1..=40).map(of_seed).collect();
    println!("seed 1: {:?}", all[0]);
    for (side, low, high) in [(0, 0.81, 0.95), (1, 0.41, 0.84)] {
        let mut values: Vec<f64> = all.iter().map(|pair| pair[side]).collect();
        values.sort_by(f64::total_cmp);
        let [min, median, max] = [2, 20, 37].map(|place| values[place]);
        println!("side {side}: R2 {min:.2} to {max:.2}, median {median:.2}");
        assert!((low..high).contains(&median), "{side}: {values:?}");
    }
}

/// Values by direction are a reversal error of the machine: the laser reads it, and the tables of
/// its axis have a value for each direction.
#[test]
fn errors_by_direction_are_a_reversal() {
    let plain = machine().unwrap();
    let (text, errors) = truth(&plain).unwrap();
    let mut errors = errors.tabulated(&travel(&plain), [64; 3]);
    let name = |name: &str| Function::of_name(name).unwrap();
    let exx = name("EXX");
    let mean = |set: &ErrorSet, at: f64| set.function(exx).value(at, Approach::default());
    let before = errors.clone();
    let Shape::Table(table) = errors.function(exx).clone() else {
        panic!("a table");
    };
    let moved = |by: f64| table.up.iter().map(|value| value + by).collect();
    let pair = Table {
        nodes: table.nodes.clone(),
        up: moved(-1e-3),
        down: Some(moved(1e-3)),
    };
    errors.set(exx, Shape::Table(pair));
    let pairs = file::write(&errors, "pairs");
    let text = plain.text.replace(text.trim_end(), pairs.trim_end());
    let file = MachineFile::parse("pairs.toml", &text).unwrap();
    let mut powered = Machine::new(&file, SLOW, &Default::default()).unwrap();
    let coarse = Plan {
        interval: 100.0,
        ..plan(LaserOptions::ideal())
    };
    let found = calibrate(&mut powered, &file, &coarse, |_| ()).unwrap();
    let reversal = |function: Function| {
        let mut all = found.axes.iter().flat_map(|axis| &axis.functions);
        let measured = all.find(|measured| measured.function == function);
        measured.unwrap().result.reversal
    };
    assert!((reversal(exx) - 2e-3).abs() < 0.15e-3, "{}", reversal(exx));
    assert!(reversal(name("EYY")) < 0.15e-3);
    for target in &found.axes[0].targets {
        let off = mean(&found.errors, *target) - (mean(&before, *target) - mean(&before, 0.0));
        assert!(off.abs() < 0.15e-3, "{target}: {off}");
        let shape = found.errors.function(exx);
        let lost = shape.value(*target, Approach::Down) - shape.value(*target, Approach::Up);
        assert!((lost - 2e-3).abs() < 0.15e-3, "{target}: {lost}");
    }
    let Shape::Table(table) = found.errors.function(name("EYY")) else {
        panic!("a table");
    };
    assert_eq!(table.down, None);
}

/// A machine that is not homed is refused, and nothing moves.
#[test]
fn an_unhomed_machine_is_refused() {
    let file = machine().unwrap();
    let mut powered = Machine::without_homing(&file, SLOW, &Default::default()).unwrap();
    let before = powered.status().unwrap().joints;
    let refused = calibrate(&mut powered, &file, &Plan::default(), |_| ()).unwrap_err();
    assert!(
        refused.message.contains("home it first; nothing moved"),
        "{refused:?}"
    );
    assert_eq!(powered.status().unwrap().joints, before);
}
