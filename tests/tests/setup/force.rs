//! Set-ups for force control: a tared machine with a wall or a workpiece at its tool.

use super::{MM, line, rest, state};
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::process::{
    Area, Coefficients, CutterConfig, CuttingConfig, ElasticWall, WorkpieceConfig,
};
use haptimill_hil_sim::rig::Control;
use haptimill_protocol::force::{EnableCondition, ForceLoop};
use haptimill_protocol::message::{Action, AxisValues, Command, Event, State};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::Bench;

/// Raw units of a newton, and of a gain.
pub const NEWTON: f64 = 65_536.0;

/// A control period, s.
pub const PERIOD: f64 = 2e-4;

pub const RPM: i16 = 5000;

/// Settings of the machine file, with another enable condition and other gains.
pub fn force_settings(mass: f64, damping: f64, enable_condition: EnableCondition) -> ForceLoop {
    ForceLoop {
        setpoint: (5.0 * NEWTON) as i32,
        mass: (mass * NEWTON) as u32,
        damping: (damping * NEWTON) as u32,
        limit: (10.0 * MM) as i32,
        rate: (20.0 * MM) as i32,
        enable_condition,
    }
}

/// Returns a homed, tared machine with something at its tool.
pub fn tared_machine(process: &ProcessConfig) -> Bench {
    let mut bench = super::ready();
    bench.rig.plant_mut().fit(process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    bench
}

pub fn tare<C: Control>(bench: &mut Bench<C>) {
    bench.events.clear();
    bench.ask(Command::Tare).expect("begun");
    bench.steps(1500);
    assert!(bench.events.contains(&Event::Tared), "{:?}", bench.events);
}

pub fn sensor_alone() -> ProcessConfig {
    ProcessConfig {
        sensor: Some(SensorConfig::default()),
        ..ProcessConfig::default()
    }
}

/// Returns a wall `gap` mm away towards -x.
pub fn wall(at: [f64; 3], gap: f64, stiffness: f64) -> ProcessConfig {
    ProcessConfig {
        wall: Some(ElasticWall {
            point: [at[0] - gap, at[1], at[2]],
            normal: [1.0, 0.0, 0.0],
            stiffness,
            damping: stiffness * PERIOD / 2.0,
            radius: 0.0,
        }),
        ..sensor_alone()
    }
}

/// Returns a workpiece whose edge is 5 mm from the tool towards -x, with its top 2 mm above the
/// tip.
pub fn block(at: [f64; 3], force_scale: f64) -> ProcessConfig {
    let [x, y, z] = at;
    ProcessConfig {
        cutting: Some(CuttingConfig {
            cutter: CutterConfig {
                coefficients: Coefficients::P2,
                force_scale,
                ..CutterConfig::default()
            },
            workpiece: WorkpieceConfig {
                stock: Area {
                    x_min: x - 80.0,
                    x_max: x - 5.0,
                    y_min: y - 30.0,
                    y_max: y + 30.0,
                },
                map: Area {
                    x_min: x - 45.0,
                    x_max: x - 4.0,
                    y_min: y - 8.0,
                    y_max: y + 8.0,
                },
                cell_mm: 0.1,
                top_mm: z + 2.0,
                bottom_mm: z - 20.0,
                ..WorkpieceConfig::default()
            },
        }),
        ..sensor_alone()
    }
}

/// Turns the table by `degrees` and waits for the end of the job.
pub fn turn_table(bench: &mut Bench, degrees: f64) {
    let start = bench.status().commanded;
    // `line` moves for 0.1 s per segment, and for 0.1 s more.
    bench.start_job(1, &line(&start, 4, degrees / 0.4, 3));
    while state(bench) == State::Run {
        bench.step();
    }
    assert_eq!(state(bench), State::Idle, "{:?}", bench.events);
}

/// A job: spindle to its speed, a line in x at `speed`, and a pause of some seconds with the
/// spindle on.
pub fn job<C: Control>(bench: &mut Bench<C>, speed: f64, spans: usize, rest_s: f64) -> AxisValues {
    let start = bench.status().commanded;
    let spun = Setpoint {
        action: Action::Spindle(RPM),
        ..rest(&start, 50)
    };
    let mut setpoints = vec![spun, rest(&start, 5000)];
    setpoints.extend(line(&start, 0, speed, spans));
    let end = setpoints.last().expect("there").pose.clone();
    let mut left = (rest_s / PERIOD) as u32;
    while left > 0 {
        let part = left.min(50_000);
        setpoints.push(rest(&end, part as u16));
        left -= part;
    }
    bench.start_job(1, &setpoints);
    end
}

pub fn force(bench: &Bench) -> haptimill_firmware::snapshot::ForceSnapshot {
    let control = bench.rig.control();
    control
        .snapshot(bench.rig.inputs())
        .expect("configured")
        .force
}

/// Peak of the force in x, N.
pub fn peak(bench: &Bench) -> f64 {
    f64::from(force(bench).high[0]) / NEWTON
}

/// p_c in x, mm.
pub fn displacement(bench: &Bench) -> f64 {
    let control = &bench.rig.control().machine().expect("configured").force;
    let compliance = control.as_ref().expect("has a sensor").compliance()[0];
    compliance.displacement.0 as f64 / f64::exp2(40.0)
}

/// p_c' in x, mm/s.
pub fn displacement_rate(bench: &Bench) -> f64 {
    let control = &bench.rig.control().machine().expect("configured").force;
    let compliance = control.as_ref().expect("has a sensor").compliance()[0];
    f64::from(compliance.rate.0) / MM
}

/// Damping levels.
pub fn levels(bench: &Bench) -> [u8; 3] {
    let machine = bench.rig.control().machine().expect("configured");
    machine.force.as_ref().expect("has a sensor").levels()
}

pub fn control<C: Control>(bench: &mut Bench<C>, axis: u8, settings: ForceLoop) {
    bench
        .ask(Command::ForceLoop { axis, settings })
        .expect("accepted");
    bench
        .ask(Command::ForceMask { mask: 1 << axis })
        .expect("accepted");
}
