//! Force control in the whole machine: the simulated arm with its friction and backlash, a cutter or an elastic wall, the sensor with its noise, and the link.

mod scene;

use haptimill::machine::{BUILT_IN, MachineFile};
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::RigOptions;
use haptimill_hil_sim::cutting::{
    Area, Coefficients, CutterConfig, CuttingConfig, ElasticWall, WorkpieceConfig,
};
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::sensor::{End, SensorCondition, SensorConfig};
use haptimill_protocol::force::{ForceLoop, ForceParameter, ForceProblem, ForceRefusal, Gate};
use haptimill_protocol::message::{Action, AxisValues, Command, Event, Fault, Refusal, State};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::Bench;
use scene::{MM, distance, line, rest, state, told, tool};

/// Raw units of a newton, and of a gain.
const NEWTON: f64 = 65_536.0;

/// A control period, s.
const PERIOD: f64 = 2e-4;

const RPM: i16 = 5000;

/// The loop of the machine file, with another gate and other gains.
fn loop_of(mass: f64, damping: f64, gate: Gate) -> ForceLoop {
    ForceLoop {
        desired: (5.0 * NEWTON) as i32,
        mass: (mass * NEWTON) as u32,
        damping: (damping * NEWTON) as u32,
        limit: (10.0 * MM) as i32,
        rate: (20.0 * MM) as i32,
        gate,
    }
}

/// A homed machine with something at its tool, tared.
fn ready_at(process: &ProcessConfig) -> Bench {
    let mut bench = scene::ready();
    bench.rig.plant_mut().fit(process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    bench
}

fn tare(bench: &mut Bench) {
    bench.events.clear();
    bench.ask(Command::Tare).expect("begun");
    bench.steps(1500);
    assert!(bench.events.contains(&Event::Tared), "{:?}", bench.events);
}

fn sensor_alone() -> ProcessConfig {
    ProcessConfig {
        sensor: Some(SensorConfig::default()),
        ..ProcessConfig::default()
    }
}

/// A wall `gap` mm away in the direction of -x.
fn wall(at: [f64; 3], gap: f64, stiffness: f64) -> ProcessConfig {
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

/// A block whose edge lies 5 mm from the tool in the direction of -x, with its top 2 mm above the tip.
fn block(at: [f64; 3], force_scale: f64) -> ProcessConfig {
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

/// A job: spindle on and up to speed, a line in x at `speed`, and a rest of so many seconds with the spindle on.
fn job(bench: &mut Bench, speed: f64, spans: usize, rest_s: f64) -> AxisValues {
    let start = bench.status().wanted;
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

fn force(bench: &Bench) -> haptimill_firmware::reading::ForceReading {
    let control = bench.rig.control();
    control
        .reading(bench.rig.inputs())
        .expect("configured")
        .force
}

/// Peak of the force in x, N.
fn peak(bench: &Bench) -> f64 {
    f64::from(force(bench).high[0]) / NEWTON
}

/// p_c in x, mm.
fn yielded(bench: &Bench) -> f64 {
    let control = &bench.rig.control().machinery().expect("configured").force;
    let yielding = control.as_ref().expect("has a sensor").yielding()[0];
    yielding.displacement.0 as f64 / f64::exp2(40.0)
}

/// p_c' in x, mm/s.
fn yield_rate(bench: &Bench) -> f64 {
    let control = &bench.rig.control().machinery().expect("configured").force;
    let yielding = control.as_ref().expect("has a sensor").yielding()[0];
    f64::from(yielding.rate.0) / MM
}

/// Levels of damping.
fn levels(bench: &Bench) -> [u8; 3] {
    let machinery = bench.rig.control().machinery().expect("configured");
    machinery.force.as_ref().expect("has a sensor").levels()
}

fn control(bench: &mut Bench, axis: u8, settings: ForceLoop) {
    bench
        .ask(Command::ForceLoop { axis, settings })
        .expect("taken");
    bench
        .ask(Command::ForceMask { mask: 1 << axis })
        .expect("taken");
}

/// The integral of F - f_d is K_V times the change of p_c, and K_A times that of its rate; afterwards the tool returns.
#[test]
fn the_loop_is_the_equation_and_the_tool_returns() {
    for (mass, damping) in [(1.0, 5.0), (0.25, 0.5)] {
        let mut bench = scene::ready();
        let process = block(tool(&bench), 3.0);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        tare(&mut bench);
        control(&mut bench, 0, loop_of(mass, damping, Gate::AgainstMotion));
        let end = job(&mut bench, -4.0, 40, 20.0);
        let mut before = 0.0;
        while yielded(&bench) < 0.02 {
            before = peak(&bench);
            bench.step();
            assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
        }
        assert!(before > 5.0);
        let (from, rate_from) = (yielded(&bench), yield_rate(&bench));
        let (mut pushed, mut most) = (0.0, 0.0_f64);
        for _ in 0..7500 {
            bench.step();
            pushed += (peak(&bench) - 5.0) * PERIOD;
            most = most.max(peak(&bench));
        }
        let gone = damping * (yielded(&bench) - from) + mass * (yield_rate(&bench) - rate_from);
        println!(
            "K_A {mass}, K_V {damping}: pushed {pushed:.4} N s, gone {gone:.4} N s, peak {most:.2} N, p_c {:.3} mm",
            yielded(&bench)
        );
        assert!(pushed.abs() > 0.2, "nothing was felt");
        assert!(
            (pushed - gone).abs() <= 0.01 * pushed.abs(),
            "{pushed} and {gone}"
        );
        // Levels of damping are for stiff contacts: a cut is left to the equation.
        let levels = levels(&bench);
        assert_eq!(levels[0], 0, "{levels:?}");
        while state(&bench) == State::Run {
            bench.step();
        }
        assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
        let desired = [0, 1, 2].map(|axis| f64::from(end[axis]) / MM);
        let off = distance(&bench, desired);
        println!("20 s after the stop the tool is {off:.4} mm from where it is desired");
        assert!(off <= 0.05, "{off}");
    }
}

/// Gains, f_d and mask change in the middle of a cut: the step from one period to the next changes by no more than the acceleration of the law.
#[test]
fn the_tool_does_not_jump_when_parameters_change() {
    let mut bench = scene::ready();
    let process = block(tool(&bench), 3.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(&mut bench, 0, loop_of(1.0, 5.0, Gate::AgainstMotion));
    job(&mut bench, -4.0, 80, 0.0);
    while yielded(&bench) < 0.3 {
        bench.step();
        assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
    }
    let soft = loop_of(0.25, 0.5, Gate::AgainstMotion);
    let stiff = loop_of(4.0, 40.0, Gate::Any);
    let eager = ForceLoop {
        desired: (2.0 * NEWTON) as i32,
        ..loop_of(1.0, 5.0, Gate::Any)
    };
    let changes = [
        Command::ForceLoop {
            axis: 0,
            settings: soft,
        },
        Command::ForceLoop {
            axis: 0,
            settings: stiff,
        },
        Command::ForceLoop {
            axis: 0,
            settings: eager,
        },
        Command::ForceMask { mask: 0 },
        Command::ForceMask { mask: 5 },
    ];
    let mut worst = 0.0_f64;
    for change in changes {
        let id = bench.say(change.clone()).expect("room");
        let (mut before, mut step_before) = (yielded(&bench), f64::NAN);
        for _ in 0..1500 {
            bench.step();
            let step = yielded(&bench) - before;
            if step_before.is_finite() {
                worst = worst.max((step - step_before).abs());
            }
            (before, step_before) = (yielded(&bench), step);
            assert_eq!(state(&bench), State::Run, "{change:?}: {:?}", bench.events);
        }
        let answers = bench.take_answers();
        assert!(answers.contains(&(id, Ok(()))), "{change:?}: {answers:?}");
    }
    // 30 N on the lightest mass are 120 mm/s^2: 4.8e-6 mm from one period to the next.
    println!(
        "largest change of the step between two periods: {:.2} nm",
        worst * 1e6
    );
    assert!(worst < 1e-5, "{worst} mm");
}

/// The built-in machine, or one without friction and backlash.
fn machine(ideal: bool) -> Bench {
    let mut text = BUILT_IN.to_string();
    if ideal {
        for (from, to) in [
            ("coulomb = 40.0", "coulomb = 0.0"),
            ("coulomb = 2.0", "coulomb = 0.0"),
            ("coulomb_n = 32.0", "coulomb_n = 0.0"),
            ("coulomb_n_m = 1.6", "coulomb_n_m = 0.0"),
            ("backlash = 0.010", "backlash = 0.0"),
            ("backlash = 0.005", "backlash = 0.0"),
            ("backlash_mm = 0.018", "backlash_mm = 0.0"),
            ("backlash_deg = 0.005", "backlash_deg = 0.0"),
        ] {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
    }
    let machine = MachineFile::parse("machine.toml", &text).expect("sound");
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    bench.make_ready();
    bench.steps(500);
    bench
}

/// A contact that is pressed by the desired motion, up to 1000 N/mm, on the plant with and without friction and backlash.
#[test]
fn stiff_contacts_are_held() {
    for (stiffness, speed, ideal) in [
        (10.0, 2.0, false),
        (100.0, 1.0, false),
        (300.0, 1.0, false),
        (1000.0, 1.0, false),
        (10.0, 2.0, true),
        (100.0, 1.0, true),
        (300.0, 1.0, true),
        (1000.0, 1.0, true),
    ] {
        let mut bench = machine(ideal);
        let process = wall(tool(&bench), 0.5, stiffness);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        tare(&mut bench);
        control(&mut bench, 0, loop_of(1.0, 5.0, Gate::Any));
        job(&mut bench, -speed, 25, 8.0);
        let mut first = 0.0_f64;
        let (mut low, mut high, mut sum) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
        for period in 0..60_000 {
            bench.step();
            let felt = bench.rig.truth().force[0];
            first = first.max(felt);
            if period >= 40_000 {
                low = low.min(felt);
                high = high.max(felt);
                sum += felt;
            }
            assert_ne!(
                state(&bench),
                State::Fault,
                "{stiffness} N/mm: {:?}",
                bench.events
            );
        }
        let mean = sum / 20_000.0;
        let bound = 5.0 + 1.2 * (5.0 * speed + speed * stiffness.sqrt());
        let levels = levels(&bench);
        println!(
            "{stiffness} N/mm at {speed} mm/s, {}: first peak {first:.2} N (at most {bound:.2}), then {mean:.2} N, from {low:.2} to {high:.2}, level {}",
            if ideal {
                "no friction"
            } else {
                "friction and backlash"
            },
            levels[0]
        );
        assert!(first <= bound, "{first} and {bound}");
        // Two encoder counts; and the backlash of 10 um, which no encoder sees.
        let unseen = if ideal { 0.0025 } else { 0.0125 };
        let swing = f64::max(0.2, unseen * stiffness);
        assert!(high - low <= swing, "{stiffness} N/mm: {low} to {high} N");
        let off = if ideal { 0.25 } else { 0.5 };
        assert!((mean - 5.0).abs() <= off, "{mean}");
    }
}

/// What breaks the sensor, and what it must be called.
fn broken(bench: &mut Bench, condition: SensorCondition) {
    let process = bench.rig.plant_mut().process_mut().expect("there");
    process
        .sensor_mut()
        .expect("there")
        .set_condition(0, condition);
}

/// Waits for the end, and sees to it that it is a controlled stop: drives holding, position kept, nothing jumps, the tool stays.
fn controlled_stop(bench: &mut Bench) -> ForceProblem {
    let mut fastest = 0.0_f64;
    // A saturated channel may be a force: then it goes back along its path first, slowly.
    for _ in 0..50_000 {
        let before = tool(bench);
        bench.step();
        fastest = fastest.max(distance(bench, before));
        if state(bench) == State::Fault {
            break;
        }
    }
    assert_eq!(state(bench), State::Fault, "{:?}", bench.events);
    assert!(fastest < 0.02, "{fastest} mm in a period");
    let latched = tool(bench);
    bench.steps(5000);
    assert!(distance(bench, latched) < 0.05, "the tool went on");
    assert!(bench.rig.control().safety().position_kept());
    assert!(bench.rig.control().safety().drives_on());
    let told = told(bench);
    let [Event::Fault(Fault::Force(problem))] = told[..] else {
        panic!("{told:?}")
    };
    *problem
}

#[test]
fn every_sensor_fault_ends_in_a_controlled_stop_with_its_name() {
    let healthy = SensorCondition::default();
    let scene = |gap: f64, gate: Gate| {
        let mut bench = scene::ready();
        let process = wall(tool(&bench), gap, 100.0);
        bench.rig.plant_mut().fit(&process).expect("sound");
        bench.steps(100);
        tare(&mut bench);
        control(&mut bench, 0, loop_of(1.0, 5.0, gate));
        job(&mut bench, -1.0, 40, 0.0);
        // Spindle up to speed, and into the contact.
        bench.steps(6000);
        assert_eq!(state(&bench), State::Run);
        bench
    };
    let mut bench = scene(0.2, Gate::AgainstMotion);
    broken(
        &mut bench,
        SensorCondition {
            saturated: Some(End::High),
            ..healthy
        },
    );
    let problem = controlled_stop(&mut bench);
    assert!(
        matches!(problem, ForceProblem::Overload { .. }),
        "{problem:?}"
    );

    let mut bench = scene(0.2, Gate::AgainstMotion);
    broken(
        &mut bench,
        SensorCondition {
            stuck: true,
            ..healthy
        },
    );
    assert_eq!(
        controlled_stop(&mut bench),
        ForceProblem::Stuck { component: 0 }
    );

    // A lost signal is the code of nothing, again and again.
    let mut bench = scene(0.2, Gate::AgainstMotion);
    broken(
        &mut bench,
        SensorCondition {
            dropped: true,
            ..healthy
        },
    );
    assert_eq!(
        controlled_stop(&mut bench),
        ForceProblem::Stuck { component: 0 }
    );

    // The converter says nothing more.
    let mut bench = scene(0.2, Gate::AgainstMotion);
    bench
        .rig
        .plant_mut()
        .fit(&ProcessConfig::default())
        .expect("sound");
    assert_eq!(controlled_stop(&mut bench), ForceProblem::Silent);

    for gate in [Gate::AgainstMotion, Gate::Any] {
        let mut bench = scene(3.0, gate);
        broken(
            &mut bench,
            SensorCondition {
                gain: -1.0,
                ..healthy
            },
        );
        assert_eq!(
            controlled_stop(&mut bench),
            ForceProblem::WrongSign { component: 0 },
            "{gate:?}"
        );
    }

    // In the air with the spindle off.
    let mut bench = ready_at(&sensor_alone());
    control(&mut bench, 0, loop_of(1.0, 5.0, Gate::AgainstMotion));
    let start = bench.status().wanted;
    bench.start_job(1, &line(&start, 0, -1.0, 60));
    bench.steps(3000);
    broken(
        &mut bench,
        SensorCondition {
            drift_n_s: 2.0,
            ..healthy
        },
    );
    let problem = controlled_stop(&mut bench);
    assert!(
        matches!(problem, ForceProblem::Drift { component: 0, force } if force.abs() >= 3 << 15),
        "{problem:?}"
    );
}

/// After a fault of the force the tool stays where it yielded to, a reset moves nothing, and a jog leads out of it.
#[test]
fn after_a_fault_the_tool_stays_and_can_be_jogged_away() {
    let mut bench = scene::ready();
    let process = wall(tool(&bench), 0.2, 100.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(&mut bench, 0, loop_of(1.0, 5.0, Gate::AgainstMotion));
    job(&mut bench, -1.0, 60, 0.0);
    while yielded(&bench) < 0.5 {
        bench.step();
    }
    bench
        .rig
        .plant_mut()
        .process_mut()
        .expect("there")
        .sensor_mut()
        .expect("there")
        .set_condition(
            0,
            SensorCondition {
                stuck: true,
                ..SensorCondition::default()
            },
        );
    controlled_stop(&mut bench);
    assert!(yielded(&bench) > 0.4);
    let before = tool(&bench);
    broken(&mut bench, SensorCondition::default());
    bench.steps(1000);
    bench.ask(Command::Reset).expect("reset");
    bench.steps(2500);
    assert_eq!(state(&bench), State::Idle);
    assert!(
        distance(&bench, before) < 0.02,
        "the tool moved by {} mm",
        distance(&bench, before)
    );
    assert_eq!(yielded(&bench), 0.0);
    let rates = [4096, 0, 0, 0, 0].into_iter().collect();
    bench
        .ask(Command::Jog {
            epoch: 1,
            deadline_ms: 1000,
            rates,
        })
        .expect("jogged");
    bench.steps(7500);
    assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
    assert!(tool(&bench)[0] - before[0] > 0.5);
}

/// The spindle stops in the cut, without force control: the force limit trips, and the tool goes back by the way it came.
#[test]
fn a_spindle_that_stands_trips_the_force_limit() {
    let mut bench = scene::ready();
    let process = block(tool(&bench), 1.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    job(&mut bench, -4.0, 80, 0.0);
    bench.steps(20_000);
    assert_eq!(state(&bench), State::Run, "{:?}", bench.events);
    bench
        .rig
        .plant_mut()
        .process_mut()
        .expect("there")
        .spindle_mut()
        .set_stalled(true);
    let mut most = 0.0_f64;
    let mut farthest = f64::INFINITY;
    for _ in 0..40_000 {
        bench.step();
        most = most.max(bench.rig.truth().force[0].abs());
        farthest = farthest.min(tool(&bench)[0]);
        if state(&bench) == State::Fault {
            break;
        }
    }
    bench.steps(500);
    let told = told(&bench);
    assert!(
        matches!(
            told[..],
            [Event::Fault(Fault::Force(ForceProblem::Limit { .. }))]
        ),
        "{told:?}"
    );
    let left = bench.rig.truth().force[0].abs();
    let back = tool(&bench)[0] - farthest;
    println!("at most {most:.1} N; {back:.3} mm back, {left:.1} N left");
    assert!(back > 0.5 && left < 40.0);
    assert!(bench.rig.control().safety().position_kept());
}

#[test]
fn settings_that_cannot_be_are_refused_with_their_bound() {
    let mut bench = ready_at(&sensor_alone());
    let good = loop_of(1.0, 5.0, Gate::AgainstMotion);
    let newtons = |value: f64| ForceLoop {
        desired: (value * NEWTON) as i32,
        ..good
    };
    let cases = [
        (newtons(0.0), ForceParameter::DesiredTooSmall, 0.5),
        (newtons(-5.0), ForceParameter::DesiredTooSmall, 0.5),
        (
            newtons(90.0),
            ForceParameter::DesiredTooLarge,
            0.75 * 0.95 * 100.0,
        ),
        // K_V >= 20 N/mm * (15 ms + 5 ms + 0.3 ms).
        (
            loop_of(1.0, 0.2, Gate::Any),
            ForceParameter::DampingTooSmall,
            20.0 * 0.0203,
        ),
        (
            loop_of(0.001, 5.0, Gate::Any),
            ForceParameter::MassTooSmall,
            f64::NAN,
        ),
        (
            ForceLoop {
                mass: u32::MAX,
                ..good
            },
            ForceParameter::MassTooLarge,
            f64::NAN,
        ),
        (
            ForceLoop {
                damping: u32::MAX,
                ..good
            },
            ForceParameter::DampingTooLarge,
            1024.0,
        ),
    ];
    for (settings, parameter, bound) in cases {
        let refused = bench.ask(Command::ForceLoop { axis: 0, settings });
        let Err(Refusal::Force {
            axis: 0,
            refusal:
                ForceRefusal {
                    parameter: what,
                    bound: found,
                },
        }) = refused
        else {
            panic!("{settings:?}: {refused:?}")
        };
        assert_eq!(what, parameter);
        let found = f64::from(found) / NEWTON;
        assert!(
            bound.is_nan() || (found - bound).abs() < 0.02 * bound,
            "{parameter:?}: {found} and {bound}"
        );
    }
    let limit = ForceLoop { limit: 0, ..good };
    let rate = ForceLoop { rate: 0, ..good };
    for (settings, parameter) in [(limit, ForceParameter::Limit), (rate, ForceParameter::Rate)] {
        let refused = bench.ask(Command::ForceLoop { axis: 2, settings });
        assert!(
            matches!(refused, Err(Refusal::Force { axis: 2, refusal }) if refusal.parameter == parameter),
            "{refused:?}"
        );
    }
    let refused = bench.ask(Command::ForceLoop {
        axis: 3,
        settings: good,
    });
    assert!(
        matches!(refused, Err(Refusal::Force { axis: 3, refusal }) if refusal.parameter == ForceParameter::Axis),
        "{refused:?}"
    );
    assert_eq!(
        bench.ask(Command::ForceMask { mask: 8 }),
        Err(Refusal::Range)
    );
}

/// A tare is for a machine at rest with nothing at its tool; a job under force control is for a sensor with a zero.
#[test]
fn tares_and_jobs_have_their_order() {
    let mut bench = scene::ready();
    bench.rig.plant_mut().fit(&sensor_alone()).expect("sound");
    bench.ask(Command::ForceMask { mask: 1 }).expect("taken");
    let start = bench.status().wanted;
    let begin = Command::JobStart {
        job: 1,
        pose: start.clone(),
    };
    assert_eq!(bench.ask(begin.clone()), Err(Refusal::NotTared));
    tare(&mut bench);
    bench.start_job(1, &line(&start, 0, -1.0, 20));
    bench.steps(200);
    assert_eq!(bench.ask(Command::Tare), Err(Refusal::State(State::Run)));
    bench.ask(Command::Stop).expect("stopped");
    assert!(bench.wait_for(State::Idle, 5000));
    // A tare that is overtaken by a motion ends without a zero.
    bench.events.clear();
    bench.ask(Command::Tare).expect("begun");
    let rates = [4096, 0, 0, 0, 0].into_iter().collect();
    bench
        .ask(Command::Jog {
            epoch: 1,
            deadline_ms: 100,
            rates,
        })
        .expect("jogged");
    bench.steps(2000);
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, Event::TareRefused(_))),
        "{:?}",
        bench.events
    );
    let status = bench.status();
    let force = status.force.expect("has a sensor");
    assert!(force.tared && force.mask == 1);
}

/// The tool yields as far as it may and no further, which is told once; soft limits hold for the reference as for the program.
#[test]
fn the_tool_yields_no_further_than_it_may() {
    let mut bench = scene::ready();
    let at = tool(&bench);
    bench
        .rig
        .plant_mut()
        .fit(&wall(at, 0.2, 20.0))
        .expect("sound");
    bench.steps(100);
    tare(&mut bench);
    let short = ForceLoop {
        limit: (0.5 * MM) as i32,
        ..loop_of(1.0, 5.0, Gate::AgainstMotion)
    };
    control(&mut bench, 0, short);
    bench.events.clear();
    job(&mut bench, -1.0, 15, 1.0);
    let mut most = 0.0_f64;
    for _ in 0..20_000 {
        bench.step();
        most = most.max(yielded(&bench));
    }
    let limited = bench
        .events
        .iter()
        .filter(|event| **event == Event::YieldLimited { axis: 0 })
        .count();
    println!(
        "yielded at most {most:.4} mm, told {limited} times: {:?}",
        bench.events
    );
    assert!((0.49..=0.5).contains(&most), "{most}");
    assert_eq!(limited, 1);
    assert!(told(&bench).is_empty());
}

/// A force pushes the tool towards a soft limit, at rest: the reference stands at the limit, whatever the force; the tool comes back when it is gone.
#[test]
fn soft_limits_hold_for_the_reference() {
    let text = BUILT_IN.replacen("high_mm = 200.0", "high_mm = 1.0", 1);
    let machine = MachineFile::parse("machine.toml", &text).expect("sound");
    let mut bench = Bench::of_machine(machine, &RigOptions::default(), Controller::new(200));
    bench.make_ready();
    // From where homing ended, to 1 mm before the limit.
    let start = bench.status().wanted;
    let way = -f64::from(start[0]) / MM;
    bench.start_job(1, &line(&start, 0, way / 2.0, 19));
    assert!(bench.wait_for(State::Idle, 20_000));
    let at = tool(&bench);
    bench.rig.plant_mut().fit(&sensor_alone()).expect("sound");
    bench.steps(100);
    tare(&mut bench);
    control(&mut bench, 0, loop_of(1.0, 5.0, Gate::Any));
    bench.events.clear();
    let face = |x: f64| wall([x, at[1], at[2]], 0.0, 10.0).wall;
    let process = bench.rig.plant_mut().process_mut().expect("there");
    // Softly first: the sensor has to show its sign before a body may push that comes by itself.
    process.set_wall(face(at[0] + 0.95));
    bench.steps(5000);
    let process = bench.rig.plant_mut().process_mut().expect("there");
    process.set_wall(face(at[0] + 3.0));
    let mut most = f64::NEG_INFINITY;
    for _ in 0..20_000 {
        bench.step();
        let reference = bench.rig.control().machinery().expect("there").reference();
        most = most.max(f64::from(reference.pose.0[0].0) / MM);
    }
    assert_eq!(most, 1.0);
    // 20 N push the arm on its servo by some hundredths.
    assert!((tool(&bench)[0] - 1.0).abs() < 0.1, "{}", tool(&bench)[0]);
    assert_eq!(state(&bench), State::Idle, "{:?}", bench.events);
    assert_eq!(bench.events, [Event::YieldLimited { axis: 0 }]);
    assert_eq!(bench.ask(Command::Tare), Err(Refusal::Yielding));
    let process = bench.rig.plant_mut().process_mut().expect("there");
    process.set_wall(None);
    bench.steps(15_000);
    assert_eq!(yielded(&bench), 0.0);
    assert!((tool(&bench)[0] - at[0]).abs() < 0.03);
}
