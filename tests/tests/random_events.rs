//! Random events in any order: the invariants of every period, whatever is requested and whatever
//! fails.

use crate::setup;
use haptimill_firmware::force::admittance::LARGEST_LIMIT;
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_hil_sim::plant::JointCondition;
use haptimill_hil_sim::process::ElasticWall;
use haptimill_hil_sim::process::sensor::SensorCondition;
use haptimill_protocol::force::{EnableCondition, ForceLoop};
use haptimill_protocol::message::{
    Action, AxisValues, Command, ConfigChunk, SetpointBatch, SetpointDelta, Source, State,
};
use haptimill_protocol::out_of_band::STOP;
use haptimill_tests::Bench;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use setup::{
    DEGREE, MM, circle, commanded, commands, drives_off, line, ready, send_available, state, tool,
};
use std::collections::VecDeque;

/// An event.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "a few of them")]
enum RandomEvent {
    /// The host sends a command, whatever the answer.
    Send(Command),
    /// The host starts a job at the present pose: a line of this axis and speed, or a circle.
    Job {
        axis: usize,
        speed: f64,
    },
    Circle,
    /// The host neither receives nor sends for this many periods.
    HostAway(usize),
    /// Another host opens a session.
    NewSession(u32),
    OutOfBandStop,
    Garbage(Vec<u8>),
    EmergencyInput(bool),
    Limit {
        joint: usize,
        active: bool,
    },
    Tripped {
        joint: usize,
        tripped: bool,
    },
    Noise {
        joint: usize,
        noisy: bool,
    },
    /// An elastic wall beside the tool, at a distance in mm towards -x; or none.
    VirtualFixture(Option<f64>),
    /// A channel of the force sensor fails, or works again.
    Sensor {
        component: usize,
        condition: SensorCondition,
    },
    /// The host recovers the machine.
    Recover,
}

fn rates() -> impl Strategy<Value = AxisValues> {
    prop::collection::vec(
        prop_oneof![3 => Just(0), 2 => -300_000_i32..300_000, 1 => any::<i32>()],
        4..7,
    )
    .prop_map(|values| values.into_iter().take(6).collect())
}

/// Valid settings, and any others.
fn force_loop() -> impl Strategy<Value = ForceLoop> {
    let enable_condition = prop_oneof![
        Just(EnableCondition::AgainstMotion),
        Just(EnableCondition::Any),
        Just(EnableCondition::Positive),
        Just(EnableCondition::Negative)
    ];
    let sound = (1_i32..20, 1_u32..200, 1_u32..40, 1_i32..20, 1_i32..20).prop_map(
        |(setpoint, mass, damping, limit, rate)| {
            (
                setpoint << 16,
                mass << 14,
                damping << 16,
                limit << 20,
                rate << 20,
            )
        },
    );
    let any = any::<(i32, u32, u32, i32, i32)>();
    (prop_oneof![4 => sound, 1 => any], enable_condition).prop_map(
        |((setpoint, mass, damping, limit, rate), enable_condition)| ForceLoop {
            setpoint,
            mass,
            damping,
            limit,
            rate,
            enable_condition,
        },
    )
}

fn command() -> impl Strategy<Value = Command> {
    let small = 0_u16..6;
    prop_oneof![
        1 => Just(Command::Ping),
        1 => Just(Command::Enable),
        1 => Just(Command::Disable),
        1 => Just(Command::Home),
        1 => Just(Command::Reset),
        1 => Just(Command::Hold),
        3 => Just(Command::Resume),
        1 => Just(Command::Stop),
        1 => Just(Command::EmergencyStop),
        1 => Just(Command::Status),
        1 => (any::<u16>(), any::<u32>()).prop_map(|(length, crc)| Command::Activate { length, crc, at_preset: false }),
        1 => (any::<u16>(), prop::collection::vec(any::<u8>(), 0..64))
            .prop_map(|(offset, bytes)| Command::Configure(ConfigChunk { offset, bytes: bytes.into_iter().collect() })),
        1 => (any::<u32>(), rates()).prop_map(|(job, pose)| Command::JobStart { job, pose }),
        1 => (0_u32..70).prop_map(|count| Command::JobEnd { count }),
        6 => (small.clone(), 1_u16..1100, rates())
            .prop_map(|(epoch, timeout_ms, rates)| Command::Jog { epoch, timeout_ms, rates }),
        1 => small.prop_map(|epoch| Command::JogCancel { epoch }),
        4 => (0_u8..7, prop_oneof![Just(Source::Program), Just(Source::Jog), Just(Source::Hold)])
            .prop_map(|(coordinate, source)| Command::Source { coordinate, source }),
        1 => any::<u8>().prop_map(|percent| Command::Override { percent }),
        1 => (0_u16..100).prop_map(|every| Command::Telemetry { every }),
        2 => (0_u8..9).prop_map(|mask| Command::ForceMask { mask }),
        2 => (0_u8..4, force_loop()).prop_map(|(axis, settings)| Command::ForceLoop { axis, settings }),
        1 => (0_u8..4).prop_map(|axis| Command::ForceSettings { axis }),
        2 => Just(Command::Tare),
        2 => (0_u32..70, prop::collection::vec((any::<u16>(), any::<u8>(), prop::collection::vec(any::<i32>(), 0..12)), 0..4))
            .prop_map(|(first, items)| Command::Setpoints(SetpointBatch {
                first,
                items: items
                    .into_iter()
                    .map(|(periods, moved, residuals)| SetpointDelta {
                        periods,
                        moved,
                        residuals: residuals.into_iter().collect(),
                        action: Action::Pause,
                    })
                    .collect(),
            })),
    ]
}

fn random_event() -> impl Strategy<Value = (RandomEvent, usize)> {
    let what = prop_oneof![
        14 => command().prop_map(RandomEvent::Send),
        4 => (0_usize..5, -20.0_f64..20.0).prop_map(|(axis, speed)| RandomEvent::Job { axis, speed }),
        2 => Just(RandomEvent::Circle),
        1 => (100_usize..4000).prop_map(RandomEvent::HostAway),
        1 => any::<u32>().prop_map(RandomEvent::NewSession),
        1 => Just(RandomEvent::OutOfBandStop),
        1 => prop::collection::vec(any::<u8>(), 0..200).prop_map(RandomEvent::Garbage),
        1 => any::<bool>().prop_map(RandomEvent::EmergencyInput),
        1 => (0_usize..5, any::<bool>()).prop_map(|(joint, active)| RandomEvent::Limit { joint, active }),
        1 => (0_usize..5, any::<bool>()).prop_map(|(joint, tripped)| RandomEvent::Tripped { joint, tripped }),
        1 => (0_usize..5, any::<bool>()).prop_map(|(joint, noisy)| RandomEvent::Noise { joint, noisy }),
        2 => prop::option::of(-0.5_f64..2.0).prop_map(RandomEvent::VirtualFixture),
        1 => (0_usize..3, any::<bool>(), any::<bool>(), prop_oneof![4 => Just(1.0), 1 => Just(-1.0)])
            .prop_map(|(component, stuck, dropped, gain)| RandomEvent::Sensor {
                component,
                condition: SensorCondition { stuck, dropped, gain, ..SensorCondition::default() },
            }),
        4 => Just(RandomEvent::Recover),
    ];
    (
        what,
        prop_oneof![3 => 1_usize..50, 2 => 50_usize..800, 1 => 800_usize..3000],
    )
}

/// Returns whether a state may follow another in one period; several events may coincide.
fn is_allowed_transition(from: State, to: State) -> bool {
    use State::{Disabled, EmergencyStop, Fault, Hold, Homing, Idle, Jog, Run};
    from == to
        || to == EmergencyStop
        || match from {
            Disabled => matches!(to, Idle | Fault),
            Idle => matches!(to, Disabled | Homing | Run | Jog | Fault),
            Homing | Jog => matches!(to, Idle | Fault),
            Run => matches!(to, Hold | Idle | Fault),
            Hold => matches!(to, Run | Idle | Fault),
            Fault => matches!(to, Disabled | Idle),
            EmergencyStop => matches!(to, Disabled),
        }
}

/// The machine, and its state of the period before.
struct Invariants {
    bench: Bench,
    before: State,
    commanded: [i32; 6],
    rates: [i32; 6],
    drives_on: bool,
    job: VecDeque<Command>,
}

impl Invariants {
    fn rates(bench: &Bench) -> [i32; 6] {
        let machine = bench.rig.control().machine().expect("configured");
        machine.motion.commanded().rates.map(|rate| rate.0)
    }

    fn step(&mut self, inject: impl FnOnce(&mut Vec<u8>)) {
        self.bench.step_with_fault(inject);
        let safety = self.bench.rig.control().safety();
        let now = safety.state();
        let drives_on = safety.drives_on();
        assert!(
            is_allowed_transition(self.before, now),
            "{:?} -> {now:?}",
            self.before
        );
        assert_eq!(drives_off(&self.bench), !drives_on, "{now:?}");
        assert!(!matches!(now, State::Disabled | State::EmergencyStop) || !drives_on);
        assert_eq!(
            now == State::Fault,
            safety.fault().is_some() && now != State::EmergencyStop
        );
        let place = commanded(&self.bench);
        let rates = Self::rates(&self.bench);
        let placed = !self.drives_on || (self.before == State::Homing && now == State::Idle);
        if drives_on && !placed {
            let moving =
                |state| matches!(state, State::Run | State::Hold | State::Jog | State::Homing);
            for axis in 0..5 {
                let limits = &self.bench.machine.config.pose[axis];
                let step = i64::from(place[axis].wrapping_sub(self.commanded[axis]));
                // Rounding may make a setpoint 2 % faster. Between setpoints a cubic may be half as
                // fast again.
                let max = i64::from(limits.rate.0) / 5000 * 153 / 100 + 2;
                assert!(step.abs() <= max, "axis {axis} jumped by {step} in {now:?}");
                // The rate is the derivative: its mean over the period is the step, except for
                // rounding and the curvature within the period.
                let mean = (i64::from(rates[axis]) + i64::from(self.rates[axis])) / 2 / 5000;
                if moving(now) && moving(self.before) {
                    assert!(
                        (step - mean).abs() <= 8 + step.abs() / 100,
                        "axis {axis}: moved by {step}, by its rate {mean} in {now:?}"
                    );
                }
                if !moving(now) && !moving(self.before) {
                    assert_eq!(step, 0, "axis {axis} moves in {now:?}");
                }
            }
        }
        // The compliant displacement stays within its limit, and is 0 with the drives off.
        let machine = self.bench.rig.control().machine().expect("configured");
        let force = machine.force.as_ref().expect("has a sensor");
        let reference = machine.reference();
        for (axis, by) in force.displacements().iter().enumerate() {
            let displacement = i64::from(by.length().0);
            assert!(displacement.abs() <= i64::from(LARGEST_LIMIT.0));
            assert!(drives_on || displacement == 0, "{now:?}: {displacement}");
            let limits = &self.bench.machine.config.pose[axis];
            let (low, high) = (limits.low.0, limits.high.0);
            let inside = (low..=high).contains(&place[axis]);
            assert!(!inside || (low..=high).contains(&reference.pose.0[axis].0));
        }
        (self.before, self.commanded, self.rates, self.drives_on) = (now, place, rates, drives_on);
    }

    fn apply(&mut self, what: &RandomEvent) {
        let bench = &mut self.bench;
        let start: AxisValues = commanded(bench)[..5].iter().copied().collect();
        match what {
            RandomEvent::Send(command) => {
                bench.send(command.clone());
            }
            RandomEvent::Job { axis, speed } => {
                self.job = commands(1, &start, &line(&start, *axis, *speed, 10))
            }
            RandomEvent::Circle => self.job = commands(2, &start, &circle(&start, 5.0, 60)),
            RandomEvent::HostAway(periods) => {
                for _ in 0..*periods {
                    self.step(Vec::clear);
                }
            }
            RandomEvent::NewSession(session) => {
                bench.link.open(*session, bench.rig.time_ns() / 1000);
            }
            RandomEvent::OutOfBandStop => self.step(|bytes| bytes.extend(STOP)),
            RandomEvent::Garbage(garbage) => self.step(|bytes| bytes.extend(garbage)),
            RandomEvent::EmergencyInput(open) => bench.rig.plant_mut().set_emergency_stop(*open),
            RandomEvent::Limit { joint, active } => {
                let mut condition = JointCondition::default();
                condition.switches[1].stuck = active.then_some(true);
                bench.rig.plant_mut().set_condition(*joint, condition);
            }
            RandomEvent::Tripped { joint, tripped } => {
                let condition = JointCondition {
                    drive_tripped: *tripped,
                    ..JointCondition::default()
                };
                bench.rig.plant_mut().set_condition(*joint, condition);
            }
            RandomEvent::Noise { joint, noisy } => {
                let noise_hz = if *noisy { 2000.0 } else { 0.0 };
                let condition = EncoderCondition {
                    noise_hz,
                    ..EncoderCondition::default()
                };
                bench
                    .rig
                    .plant_mut()
                    .set_encoder_condition(*joint, condition);
            }
            RandomEvent::VirtualFixture(gap) => {
                let at = tool(bench);
                let wall = gap.map(|gap| ElasticWall {
                    point: [at[0] - gap, at[1], at[2]],
                    normal: [1.0, 0.0, 0.0],
                    stiffness: 20.0,
                    damping: 0.002,
                    radius: 0.0,
                });
                let process = bench.rig.plant_mut().process_mut().expect("there");
                process.set_wall(wall);
            }
            RandomEvent::Sensor {
                component,
                condition,
            } => {
                let process = bench.rig.plant_mut().process_mut().expect("there");
                let sensor = process.sensor_mut().expect("has one");
                sensor.set_condition(*component, *condition);
            }
            RandomEvent::Recover => {
                bench.rig.plant_mut().set_emergency_stop(false);
                let process = bench.rig.plant_mut().process_mut().expect("there");
                process.set_wall(None);
                for component in 0..3 {
                    let sensor = process.sensor_mut().expect("has one");
                    sensor.set_condition(component, SensorCondition::default());
                }
                for joint in 0..5 {
                    bench
                        .rig
                        .plant_mut()
                        .set_condition(joint, JointCondition::default());
                    bench
                        .rig
                        .plant_mut()
                        .set_encoder_condition(joint, EncoderCondition::default());
                }
                for command in [
                    Command::Reset,
                    Command::Enable,
                    Command::Override { percent: 100 },
                ] {
                    bench.send(command);
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, rng_seed: RngSeed::Fixed(11), failure_persistence: None, max_shrink_iters: 300, ..ProptestConfig::default() })]

    #[test]
    fn random_events_violate_no_invariant(events in prop::collection::vec(random_event(), 10..60)) {
        let bench = ready();
        let mut invariants = Invariants {
            before: state(&bench),
            commanded: commanded(&bench),
            rates: Invariants::rates(&bench),
            drives_on: true,
            job: VecDeque::new(),
            bench,
        };
        for (what, periods) in &events {
            invariants.apply(what);
            for _ in 0..*periods {
                send_available(&mut invariants.bench, &mut invariants.job);
                invariants.step(|_| ());
            }
        }
        prop_assert!(f64::from(invariants.commanded[0]).abs() < 400.0 * MM && f64::from(invariants.commanded[4]).abs() < 90.0 * DEGREE);
    }
}

#[test]
fn a_refused_command_changes_nothing() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::{Config, TestRunner};
    let mut runner = TestRunner::new(Config {
        rng_seed: RngSeed::Fixed(12),
        ..Config::default()
    });
    let mut refused = 0;
    for situation in 0..4 {
        let mut bench = ready();
        match situation {
            0 => {}
            1 => bench.ask(Command::Disable).expect("off"),
            2 => {
                let start = bench.status().commanded;
                bench.start_job(1, &line(&start, 0, 4.0, 20));
                bench.steps(2000);
                bench.ask(Command::Hold).expect("holds");
                bench.steps(2000);
            }
            _ => bench.ask(Command::EmergencyStop).expect("off"),
        }
        bench.steps(1000);
        let summary = |bench: &mut Bench| {
            let status = bench.status();
            let machine = bench.rig.control().machine().expect("configured");
            let sources: Vec<_> = (0..5).map(|axis| machine.motion.source(axis)).collect();
            let force = machine.force.as_ref().expect("has a sensor");
            let loops = [0, 1, 2].map(|axis| force.settings(axis).cloned());
            (
                (force.mask(), force.conditioner().tared(), loops),
                (
                    status.state,
                    status.homed,
                    status.credit,
                    status.setpoint,
                    status.speed_factor,
                ),
                (
                    status.commanded,
                    status.fault,
                    sources,
                    machine.motion.program.accepted(),
                ),
            )
        };
        for _ in 0..150 {
            let command = command()
                .new_tree(&mut runner)
                .expect("a command")
                .current();
            let before = summary(&mut bench);
            let harmless = matches!(
                command,
                Command::Telemetry { .. } | Command::Configure(_) | Command::Status
            );
            // Only refused commands are of interest; an accepted one would change the situation.
            let would_move = matches!(
                (&command, situation),
                (Command::EmergencyStop | Command::Reset | Command::Stop, _)
                    | (
                        Command::Disable
                            | Command::Home
                            | Command::Jog { .. }
                            | Command::Source { .. },
                        0
                    )
                    | (Command::Enable, 1)
                    | (
                        Command::Resume | Command::Source { .. } | Command::JobEnd { .. },
                        2
                    )
            );
            if harmless || would_move {
                continue;
            }
            if bench.ask(command.clone()).is_err() {
                refused += 1;
                assert_eq!(summary(&mut bench), before, "{command:?}");
            }
        }
    }
    assert!(refused > 200, "{refused}");
}
