//! The controller on an emulated Cortex-M4F and M7 against the controller in this process: the same bits, what they cost, and how a run
//! ends that is ended from outside. Needs the feature `emulated`, a compiler for the chip and the emulator; `cargo xtask test` sees to that.

mod chip;

use chip::{BOARDS, results, root, run_counted};
use clap::{Args, FromArgMatches, Subcommand};
use haptimill::commands::CliError;
use haptimill::commands::run::{self, RunArgs};
use haptimill::commands::scenario::{self, ScenarioCommand};
use haptimill_client::port::Board;
use haptimill_client::session::pil::{self, Emulator, Instructions};
use haptimill_client::session::rig_around;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveCommand, Outputs};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::RigOptions;
use haptimill_hil_sim::process::ElasticWall;
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::remote::{Cost, RemoteController};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::force::{ForceLoop, Gate};
use haptimill_protocol::message::{Command as Say, Event, Source, State};
use haptimill_tests::{Bench, line_in_x};
use haptimill_trace::replay::replay;
use haptimill_trace::{Recording, difference};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Runs a part program as the command line does.
fn run(program: &Path, port: &str, out: &Path, more: &[&str]) -> Duration {
    let begun = Instant::now();
    let program = program.display().to_string();
    let out = out.display().to_string();
    let mut words = vec!["run", &program, "--port", port, "--out", &out, "--quiet"];
    words.extend(more);
    let command = RunArgs::augment_args(clap::Command::new("run"));
    let matches = command.try_get_matches_from(words).expect("arguments");
    run::run(RunArgs::from_arg_matches(&matches).expect("arguments")).expect("runs");
    begun.elapsed()
}

/// Runs a scenario as the command line does.
fn scenario(name: &str, port: &str, out: &Path) -> Result<(), CliError> {
    let out = out.display().to_string();
    let words = ["scenario", "run", name, "--port", port, "--out", &out];
    let command = ScenarioCommand::augment_subcommands(clap::Command::new("scenario"));
    let matches = command.try_get_matches_from(words).expect("arguments");
    scenario::run(ScenarioCommand::from_arg_matches(&matches).expect("arguments"))
}

/// Runs a program natively, on the M4F and on the M7, and compares what was recorded.
fn same_bits(name: &str, program: &Path) {
    let out = |port: &str| results(&format!("{name}-{port}"));
    run(program, "sim", &out("native"), &[]);
    let native = Recording::open(&out("native").join("recording.hmr")).expect("recorded");
    let seconds = native.records() as f64 * native.period_s();
    // Building it is no part of the job.
    pil::image(Board::Mps2).expect("builds");
    for (port, folder) in [("pil:mps2", "m4"), ("pil:mps2-m7", "m7")] {
        let took = run(program, port, &out(folder), &[]).as_secs_f64();
        let emulated = Recording::open(&out(folder).join("recording.hmr")).expect("recorded");
        let found = difference(&native, &emulated).expect("readable");
        assert!(
            found.is_none(),
            "{name}, native and {port}: {}",
            found.expect("differs")
        );
        let read =
            |folder: &str| std::fs::read(out(folder).join("recording.hmr")).expect("readable");
        assert!(
            read("native") == read(folder),
            "{name}, native and {port}: the headers differ"
        );
        // What the chip said is what a controller in this process says to the same inputs.
        let replayed = replay(&emulated).expect("has its periods");
        let replayed = replayed.unwrap_or_else(|difference| panic!("{name}, {port}: {difference}"));
        assert_eq!(replayed.records, native.records());
        println!(
            "{name}: {} control periods, the same bits natively and on {port}; {:.1} times real time",
            native.records(),
            seconds / took
        );
    }
}

/// The beginning of the dome: 5 axes, some seconds of it.
fn part_of_dome(blocks: usize) -> PathBuf {
    let text = std::fs::read_to_string(root().join("examples/dome.ngc")).expect("there");
    let beginning: Vec<&str> = text.lines().take(blocks).collect();
    let file = results(&format!("dome-{blocks}.ngc"));
    std::fs::write(&file, beginning.join("\n") + "\nM5\nM30\n").expect("written");
    file
}

#[test]
fn same_bits_in_the_slot() {
    same_bits("e7", &root().join("examples/e7-slot.ngc"));
}

#[test]
fn same_bits_in_the_pocket() {
    same_bits("e9", &root().join("examples/e9-pocket.ngc"));
}

#[test]
fn same_bits_on_the_circle() {
    same_bits("e11", &root().join("examples/e11-circle.ngc"));
}

#[test]
fn same_bits_in_five_axes() {
    same_bits("dome", &part_of_dome(500));
}

/// A tool under force control runs into a wall, in a machine around any controller: what the controller knew and did in every period.
fn against_a_wall<C: haptimill_hil_sim::Control>(control: C) -> Vec<(Snapshot, Outputs)> {
    let mut bench = Bench::with(&RigOptions::default(), control);
    bench.make_ready();
    bench.steps(500);
    let pose = bench.rig.truth().pose;
    let process = ProcessConfig {
        wall: Some(ElasticWall {
            point: [pose[0] - 0.4, pose[1], pose[2]],
            normal: [1.0, 0.0, 0.0],
            stiffness: 300.0,
            damping: 0.03,
            radius: 0.0,
        }),
        sensor: Some(SensorConfig::default()),
        ..ProcessConfig::default()
    };
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    bench.ask(Say::Tare).expect("begun");
    bench.steps(1500);
    assert!(bench.events.contains(&Event::Tared), "{:?}", bench.events);
    let raw = |value: f64| (value * 65_536.0) as u32;
    let settings = ForceLoop {
        desired: raw(5.0) as i32,
        mass: raw(0.8),
        damping: raw(4.0),
        limit: 10 << 20,
        rate: 20 << 20,
        gate: Gate::Any,
    };
    bench
        .ask(Say::ForceLoop { axis: 0, settings })
        .expect("taken");
    bench.ask(Say::ForceMask { mask: 5 }).expect("taken");
    let start = bench.status().commanded;
    bench.start_job(1, &line_in_x(&start, -1.0, 15));
    let mut seen = Vec::new();
    for _ in 0..9000 {
        bench.step();
        let snapshot = bench.rig.control().snapshot(bench.rig.inputs());
        seen.push((snapshot.expect("configured"), bench.rig.outputs().clone()));
    }
    seen
}

#[test]
fn same_bits_with_a_force() {
    let machine = MachineFile::built_in().expect("sound");
    let native = against_a_wall(Controller::new(machine.config.period_us));
    let yielded = native.iter().map(|(snapshot, _)| snapshot.force.yielded[0]);
    let most = yielded.max().unwrap_or(0);
    assert!(most > 1 << 19, "the tool yielded by {most} units only");
    let image = pil::image(Board::Mps2).expect("builds");
    let emulator = Emulator::start(Board::Mps2, &image).expect("starts");
    let remote = RemoteController::begin(emulator, machine.config.period_us).expect("begins");
    let cost = remote.cost();
    let emulated = against_a_wall(remote);
    for (period, (native, emulated)) in native.iter().zip(&emulated).enumerate() {
        assert_eq!(native, emulated, "period {period}");
    }
    assert_eq!(native.len(), emulated.len());
    let cost = Instructions::of(&cost.lock().expect("not poisoned"));
    println!(
        "force control against a wall, {} periods: {cost:?}",
        native.len()
    );
}

/// How many times faster than the machine's own time a job on the chip goes, with telemetry every so many periods or without.
fn times_real_time(every: u16) -> (f64, u64) {
    let image = pil::image(Board::Mps2).expect("builds");
    let mut bench = Bench::with(
        &RigOptions::default(),
        chip::remote(Board::Mps2, &image, &[]),
    );
    bench.make_ready();
    bench.steps(500);
    let start = bench.status().commanded;
    bench.ask(Say::Telemetry { every }).expect("taken");
    bench.start_job(1, &line_in_x(&start, -10.0, 40));
    bench.steps(500);
    let (mut told, mut last) = (0, 0);
    let periods = 15_000;
    let begun = Instant::now();
    for _ in 0..periods {
        bench.step();
        let newest = bench
            .telemetry
            .as_ref()
            .map_or(0, |telemetry| telemetry.period);
        told += u64::from(newest != last);
        last = newest;
    }
    let took = begun.elapsed().as_secs_f64();
    let machine = f64::from(periods) * f64::from(bench.rig.plant().period_us()) * 1e-6;
    assert_eq!(bench.status().state, State::Run);
    (machine / took, told)
}

/// The figures of speed. How busy the computer is is no fault of this program, so only what is said is held, and a tenth of what is aimed at (3 and 0.5 times).
#[test]
fn speed_of_an_emulated_job() {
    for (every, words, least) in [(0, "setpoints only", 0.3), (5, "telemetry at 1 kHz", 0.05)] {
        let (times, told) = times_real_time(every);
        println!("{words}: {times:.2} times real time, {told} telemetry frames in 3 s");
        assert!(if every == 0 { told <= 1 } else { told > 2_950 }, "{told}");
        assert!(times > least);
    }
}

/// A scenario cuts, feels and measures with the controller on the chip as it does with the one in this process.
#[test]
fn a_scenario_runs_on_the_chip() {
    let out = results("scenario-m4");
    scenario("e7", "pil:mps2", &out).expect("runs");
    let summary = std::fs::read_to_string(out.join("e7/summary.json")).expect("written");
    let summary: serde_json::Value = serde_json::from_str(&summary).expect("JSON");
    let claims = summary["claims"].as_array().expect("a table");
    assert!(claims.len() > 5, "{summary:#}");
    for claim in claims {
        assert_eq!(claim["inside"], true, "{claim:#}");
    }
    let begun = Instant::now();
    let refused = scenario("e7", "tcp:localhost:1", &out).expect_err("has no simulated work");
    assert!(refused.message.contains("pil:mps2"), "{refused}");
    assert!(begun.elapsed() < Duration::from_secs(2));
}

/// A hand leads the tool, and feels what it cuts: the haptic arm's kinematics, statics and reflection, and the following, on the chip.
#[test]
fn same_bits_where_a_hand_leads() {
    let out = |port: &str| results(&format!("e8-{port}"));
    scenario("e8", "sim", &out("native")).expect("runs");
    scenario("e8", "pil:mps2", &out("m4")).expect("runs");
    let recording = |folder: &str| out(folder).join("e8/cut/recording.hmr");
    let open = |folder: &str| Recording::open(&recording(folder)).expect("recorded");
    let (native, emulated) = (open("native"), open("m4"));
    assert!(native.records() > 40_000, "{}", native.records());
    if let Some(found) = difference(&native, &emulated).expect("readable") {
        panic!("{found}");
    }
    let read = |folder: &str| std::fs::read(recording(folder)).expect("readable");
    assert!(read("native") == read("m4"), "the headers differ");
}

/// The tool that explains a difference finds the one that was made, and no other.
#[test]
fn a_difference_is_named() {
    let program = root().join("examples/e7-slot.ngc");
    let (one, other) = (results("seed-1"), results("seed-2"));
    run(&program, "sim", &one, &["--seed", "1"]);
    run(&program, "sim", &other, &["--seed", "2"]);
    let open = |folder: &Path| Recording::open(&folder.join("recording.hmr")).expect("recorded");
    let found = difference(&open(&one), &open(&other))
        .expect("readable")
        .expect("differs");
    let mut records = open(&one)
        .iter()
        .expect("readable")
        .zip(open(&other).iter().expect("readable"));
    let first = records.position(|(one, other)| one.expect("whole") != other.expect("whole"));
    assert_eq!(first, Some(found.record as usize));
    assert_ne!(found.first, found.second, "{found}");
}

/// A rig around the emulated board, in the middle of nothing, and the emulator's process.
fn idle_rig() -> (haptimill_hil_sim::Rig<RemoteController<Emulator>>, u32) {
    let machine = MachineFile::built_in().expect("sound");
    let image = pil::image(Board::Mps2).expect("builds");
    let emulator = Emulator::start(Board::Mps2, &image).expect("starts");
    let process = emulator.process();
    let remote = RemoteController::begin(emulator, machine.config.period_us).expect("begins");
    let mut rig = rig_around(remote, &machine, None, None, Vec::new()).expect("sound");
    for _ in 0..1000 {
        assert!(rig.step());
    }
    assert_eq!(haptimill_hil_sim::Control::failure(rig.control()), None);
    (rig, process)
}

fn exists(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

/// The shell's own `kill`: a bare machine has no other.
fn signal(name: &str, process: u32) {
    let status = Command::new("sh")
        .args(["-c", &format!("kill {name} {process}")])
        .status();
    assert!(status.expect("a shell").success());
}

/// Steps until the controller is seen to have failed; the reason, and how long that took.
fn until_failure(
    rig: &mut haptimill_hil_sim::Rig<RemoteController<Emulator>>,
) -> (String, Duration) {
    let begun = Instant::now();
    loop {
        rig.step();
        if let Some(reason) = haptimill_hil_sim::Control::failure(rig.control()) {
            assert!(
                rig.outputs()
                    .axes
                    .iter()
                    .all(|axis| *axis == DriveCommand::Off)
            );
            return (reason.to_string(), begun.elapsed());
        }
        assert!(begun.elapsed() < Duration::from_secs(5), "nobody noticed");
    }
}

#[test]
fn a_killed_emulator_is_noticed_at_once() {
    let (mut rig, process) = idle_rig();
    signal("-KILL", process);
    let (reason, after) = until_failure(&mut rig);
    println!("after {after:?}: {reason}");
    assert!(reason.contains("emulator"), "{reason}");
    assert!(after < Duration::from_secs(2));
}

#[test]
fn a_stalled_emulator_is_given_up_and_leaves_nothing() {
    let (mut rig, process) = idle_rig();
    signal("-STOP", process);
    let (reason, after) = until_failure(&mut rig);
    println!("after {after:?}: {reason}");
    assert!(after < Duration::from_millis(2500));
    assert!(exists(process));
    drop(rig);
    assert!(!exists(process), "the emulator is still there");
}

#[test]
fn a_run_that_is_over_leaves_nothing() {
    let (rig, process) = idle_rig();
    let cost = rig.control().cost();
    drop(rig);
    assert!(!exists(process), "the emulator is still there");
    let cost = cost.lock().expect("not poisoned");
    assert!(cost.stack_bytes > 0, "the image did not end by itself");
}

/// The built-in machine without its force sensor.
fn machine_without_force() -> PathBuf {
    let text = std::fs::read_to_string(root().join("machines/h4.toml")).expect("there");
    let section = |name: &str| text.find(&format!("\n[{name}]")).expect("there");
    let file = results("without-force.toml");
    std::fs::create_dir_all(results("")).expect("made");
    let without = text[..section("force")].to_string() + &text[section("plant")..];
    std::fs::write(&file, without).expect("written");
    file
}

/// A job of the table of instructions: its title, the folder of its results, what is run, and the ceilings: a period that costs more in the mean, or at worst, is a
/// mistake. What is aimed at stands in the table's text.
struct Job {
    title: &'static str,
    name: &'static str,
    what: What,
    ceilings: [f64; 2],
}

/// What a job runs: a program and what else is said to `run`, or the one pass of a scenario.
enum What {
    Program(PathBuf, Vec<String>),
    Scenario(&'static str),
}

impl What {
    /// Runs it; what it cost.
    fn cost(&self, port: &str, out: &Path) -> serde_json::Value {
        let folder = match self {
            Self::Program(program, more) => {
                let mut words = vec!["--baud", "1000000"];
                words.extend(more.iter().map(String::as_str));
                run(program, port, out, &words);
                out.to_path_buf()
            }
            Self::Scenario(name) => {
                scenario(name, port, out).expect("runs");
                out.join(name).join("cut")
            }
        };
        let file = folder.join(pil::INSTRUCTIONS_FILE);
        let text = std::fs::read_to_string(file).expect("written");
        serde_json::from_str(&text).expect("JSON")
    }
}

/// What the kinematics alone cost: over 1000 poses of the whole reach, on either chip.
fn instructions_of_the_kinematics() -> String {
    let image = chip::image("checks");
    let [said, other] = BOARDS.map(|board| {
        let (code, said) = run_counted(board, &image, &["instructions"]);
        assert_eq!(code, Some(0), "{said}");
        said
    });
    assert_eq!(said, other);
    let mut table = String::from(
        "\n## Kinematics of the H-4 arm alone, 1000 poses of the whole reach\n\n| | mean | worst |\n| --- | ---: | ---: |\n",
    );
    let ceilings = [("inverse", [600, 1_175]), ("forward", [720, 720])];
    for (line, (name, most)) in said.lines().zip(ceilings) {
        let words: Vec<&str> = line.split(' ').collect();
        assert!(words.len() == 3 && words[0] == name, "{said}");
        let counts = [words[1], words[2]].map(|word| word.parse::<u32>().expect("a number"));
        assert!(counts[0] < most[0] && counts[1] < most[1], "{said}");
        table += &format!("| {name} | {} | {} |\n", counts[0], counts[1]);
    }
    assert_eq!(said.lines().count(), 2, "{said}");
    table
}

/// What a period costs; `cargo xtask instructions` writes the table.
#[test]
fn instructions_of_a_period() {
    let circle = root().join("examples/e11-circle.ngc");
    let dome = part_of_dome(500);
    let path = |path: PathBuf| path.display().to_string();
    let bare = || vec!["--machine".to_string(), path(machine_without_force())];
    let yielding = || {
        let block = path(root().join("examples/block.toml"));
        let words = ["--force", "x,z", "--force-setpoint", "5", "--stock", &block];
        words.map(String::from).to_vec()
    };
    let job = |title, name, program: &PathBuf, more, ceilings| Job {
        title,
        name,
        what: What::Program(program.clone(), more),
        ceilings,
    };
    let jobs = [
        job(
            "dome, 5 axes, a machine without a force sensor",
            "dome-bare",
            &dome,
            bare(),
            [6_450.0, 14_000.0],
        ),
        job(
            "E11 circle, a machine without a force sensor",
            "e11-bare",
            &circle,
            bare(),
            [6_450.0, 14_000.0],
        ),
        job(
            "dome, 5 axes, with a force sensor, nothing under force control",
            "dome",
            &dome,
            Vec::new(),
            [8_470.0, 15_120.0],
        ),
        job(
            "E11 circle, cut under force control of x and z",
            "e11-force",
            &circle,
            yielding(),
            [9_380.0, 16_780.0],
        ),
        Job {
            title: "E8, a hand leads and feels the cut, force control of x, y and z, the image with the haptic arm",
            name: "e8",
            what: What::Scenario("e8"),
            ceilings: [22_100.0, 30_520.0],
        },
    ];
    let mut table = String::from(TABLE_HEAD) + &instructions_of_the_kinematics();
    for Job {
        title,
        name,
        what,
        ceilings: [mean_ceiling, worst_ceiling],
    } in jobs
    {
        let [cost, other] = ["pil:mps2", "pil:mps2-m7"].map(|port| {
            let out = results(&format!("cost-{name}-{}", &port[4..]));
            what.cost(port, &out)
        });
        let number = |value: &serde_json::Value| value.as_f64().expect("a number");
        table += &format!("\n## {title}\n\n| stage | mean | worst |\n| --- | ---: | ---: |\n");
        for stage in cost["stages"].as_array().expect("stages") {
            table += &format!(
                "| {} | {:.0} | {:.0} |\n",
                stage[0].as_str().expect("name"),
                number(&stage[1]),
                number(&stage[2])
            );
        }
        let (mean, worst) = (number(&cost["mean"]), number(&cost["worst"]));
        // The same image: what the table says of one chip, it says of both.
        for (what, one) in [("mean", mean), ("worst", worst)] {
            let two = number(&other[what]);
            assert!(
                (one - two).abs() < 3.0,
                "{title}: {what} {one} on the M4F, {two} on the M7"
            );
        }
        println!("{title}: {mean:.0} in the mean, {worst:.0} at worst");
        table += &format!("| whole period | {mean:.0} | {worst:.0} |\n\n");
        table += &format!(
            "{} control periods in which a program ran. Worst period of all, activating the configuration included: {:.0}. Stack used: {} bytes. \
             Most bytes in the receive ring: {} of {}. Setpoints in the queue: at most {} of 256{}.\n",
            cost["periods"],
            number(&cost["worst_of_all"]),
            cost["stack_bytes"],
            cost["ring_peak"],
            haptimill_firmware::comm::rx_ring::RING_BYTES,
            cost["queue_high"],
            // Where a hand leads nothing waits to come.
            cost["queue_low"]
                .as_u64()
                .map_or_else(String::new, |low| format!(
                    ", then at least {low} while more were to come"
                ))
        );
        assert!(
            mean < mean_ceiling && worst < worst_ceiling,
            "{title}: {mean:.0} and {worst:.0} instructions"
        );
    }
    println!("{table}");
    let file = root().join("docs/instructions.md");
    if std::env::var_os("HAPTIMILL_WRITE").is_some() {
        std::fs::create_dir_all(root().join("docs")).expect("made");
        std::fs::write(&file, &table).expect("written");
    }
    if std::fs::read_to_string(&file).unwrap_or_default() != table {
        println!(
            "docs/instructions.md says something else; `cargo xtask instructions` writes it anew"
        );
    }
}

/// What a period of a jog costs, in which all five coordinates move, far from rest and near the bounds: with a sensor or without, under force control, and beside a program.
#[test]
fn instructions_of_a_jog() {
    let built_in = || MachineFile::built_in().expect("sound");
    let bare = || MachineFile::load(&machine_without_force()).expect("sound");
    // Measured, and 3 %. The budget of a period is 8,000 and 14,000, under force control 12,000 and 18,000: jogs of many coordinates are above it.
    let jobs: [(&str, MachineFile, u8, bool, [f64; 2]); 4] = [
        (
            "a jog, a machine without a force sensor",
            bare(),
            0,
            false,
            [32_600.0, 40_100.0],
        ),
        (
            "a jog, with a force sensor",
            built_in(),
            0,
            false,
            [34_800.0, 42_300.0],
        ),
        (
            "a jog under force control of x and z",
            built_in(),
            5,
            false,
            [35_800.0, 43_900.0],
        ),
        (
            "a jog of y, z and the table beside a program",
            built_in(),
            0,
            true,
            [34_100.0, 54_800.0],
        ),
    ];
    let mut too_many = Vec::new();
    for (title, machine, mask, beside, ceilings) in jobs {
        let image = pil::image(Board::Mps2).expect("builds");
        let control = chip::remote(Board::Mps2, &image, &[]);
        let cost = control.cost();
        let mut bench = Bench::of_machine(machine, &RigOptions::default(), control);
        bench.make_ready();
        bench.steps(500);
        if mask != 0 {
            let sensor = ProcessConfig {
                sensor: Some(SensorConfig::default()),
                ..ProcessConfig::default()
            };
            bench.rig.plant_mut().fit(&sensor).expect("sound");
            bench.ask(Say::Tare).expect("begun");
            bench.steps(1500);
            bench.ask(Say::ForceMask { mask }).expect("taken");
        }
        if beside {
            let start = bench.status().commanded;
            bench.start_part(1, &start, &line_in_x(&start, 2.0, 200));
            bench.ask(Say::Hold).expect("holds");
            bench.steps(2500);
            for axis in [1, 2, 4] {
                let source = Source::Jog;
                bench.ask(Say::Source { axis, source }).expect("chosen");
            }
            bench.ask(Say::Resume).expect("goes on");
            bench.steps(1000);
        }
        *cost.lock().expect("not poisoned") = Cost::default();
        // Towards a bound, back, and over the middle again.
        for (epoch, sign) in [(1, 1.0), (2, -1.0), (3, 1.0)] {
            let rates = [30.0, 40.0, 25.0].map(|rate| rate * f64::from(1 << 12) * sign);
            let angles = [15.0, 15.0].map(|rate| rate * sign * 4_294_967_296.0 / 360.0 / 256.0);
            let rates = rates.into_iter().chain(angles).map(|rate| rate as i32);
            let jog = Say::Jog {
                epoch,
                deadline_ms: 1000,
                rates: rates.collect(),
            };
            bench.ask(jog).expect("jogs");
            bench.steps(7000);
        }
        let cost = Instructions::of(&cost.lock().expect("not poisoned"));
        println!("{title}: {cost:?}");
        assert!(cost.periods > 9_000, "{title}: {} periods", cost.periods);
        if cost.mean >= ceilings[0] || cost.worst >= ceilings[1] {
            too_many.push(format!("{title}: {:.0} and {:.0}", cost.mean, cost.worst));
        }
    }
    assert!(too_many.is_empty(), "{too_many:?}");
}

const TABLE_HEAD: &str = "# Instructions of a control period

Counted on an emulated Cortex-M4F (QEMU, mps2-an386), release build, overflow checks on. Made by `cargo xtask instructions`; do not edit.

The same image was run on an emulated Cortex-M7 (mps2-an500) as well: it takes the same instructions.

Instructions are not cycles: no wait states, no caches, no latency of divisions and loads. A board's factor has to be measured on that board. At
one cycle an instruction and 168 MHz a period of 200 us has 33,600.

Aims: inverse kinematics at most 900, forward at most 1,200; a whole period in 5 axes without the force loop 5,000 in the mean and 8,000 at worst, a
quarter of the period. What is above its aim is to be worked on.

Without a force sensor the measured pose is worked out for whoever asks: in periods with telemetry, and while the references are looked for. With one it
is part of *sense* in every period, and so are forces, their peaks and the watches of the sensor, also when no axis is under force control.
";
