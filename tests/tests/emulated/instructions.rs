//! Instructions of a control period on the emulated chips, with ceilings.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

use crate::emulator;
use emulator::{BOARDS, helix, part_of_dome, results, root, run_counted, run_timed, scenario};
use haptimill_client::port::Board;
use haptimill_client::session::pil::{self, Instructions};
use haptimill_hil_sim::RigOptions;
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::remote::Cost;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command as Say, Source};
use haptimill_tests::{Bench, line_in_x};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// The file of the built-in machine without its force sensor. It is written once: the tests of this
/// file may run at the same time.
static WITHOUT_FORCE: LazyLock<PathBuf> = LazyLock::new(|| {
    let text = std::fs::read_to_string(root().join("machines/h4.toml")).expect("there");
    let section = |name: &str| text.find(&format!("\n[{name}]")).expect("there");
    let without = text[..section("force")].to_string() + &text[section("plant")..];
    written("without-force.toml", &without)
});

/// That file without integral action and adaptation of the friction.
static WITHOUT_OBSERVERS: LazyLock<PathBuf> = LazyLock::new(|| {
    let text = std::fs::read_to_string(&*WITHOUT_FORCE).expect("there");
    let is_kept = |line: &&str| !line.starts_with("ki =") && !line.starts_with("friction_adapt");
    let without: Vec<&str> = text.lines().filter(is_kept).collect();
    assert_eq!(
        text.lines().count(),
        without.len() + 10,
        "two keys of five joints"
    );
    written("without-observers.toml", &without.join("\n"))
});

fn written(name: &str, text: &str) -> PathBuf {
    std::fs::create_dir_all(results("")).expect("made");
    let file = results(name);
    std::fs::write(&file, text).expect("written");
    file
}

/// A job of the table of instructions. A period must not cost more than the ceilings, mean and
/// worst. The goals are in the text of the table.
struct Job {
    title: &'static str,
    name: &'static str,
    what: What,
    ceilings: [f64; 2],
}

/// What a job runs: a program with options of `run`, or the one pass of a scenario.
enum What {
    Program(PathBuf, Vec<String>),
    Scenario(&'static str),
}

impl What {
    /// Runs the job. Returns its cost.
    fn cost(&self, port: &str, out: &Path) -> serde_json::Value {
        let folder = match self {
            Self::Program(program, more) => {
                let mut words = vec!["--baud", "1000000"];
                words.extend(more.iter().map(String::as_str));
                run_timed(program, port, out, &words);
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

/// Cost of the kinematics alone, over 1000 poses of the whole workspace, on both chips.
fn the_kinematics_stay_within_their_instructions() -> String {
    let image = emulator::image("checks");
    let [console, other] = BOARDS.map(|board| {
        let (code, console) = run_counted(board, &image, &["instructions"]);
        assert_eq!(code, Some(0), "{console}");
        console
    });
    assert_eq!(console, other);
    let mut table = String::from(
        "\n## Kinematics of the H-4 arm alone, 1000 poses of the whole reach\n\n| | mean | worst |\n| --- | ---: | ---: |\n",
    );
    let ceilings = [("inverse", [600, 1_175]), ("forward", [720, 720])];
    for (line, (name, max)) in console.lines().zip(ceilings) {
        let words: Vec<&str> = line.split(' ').collect();
        assert!(words.len() == 3 && words[0] == name, "{console}");
        let counts = [words[1], words[2]].map(|word| word.parse::<u32>().expect("a number"));
        assert!(counts[0] < max[0] && counts[1] < max[1], "{console}");
        table += &format!("| {name} | {} | {} |\n", counts[0], counts[1]);
    }
    assert_eq!(console.lines().count(), 2, "{console}");
    table
}

/// Cost of a control period; `cargo xtask instructions` writes the table.
#[test]
fn a_period_stays_within_its_instructions() {
    let circle = root().join("examples/e11-circle.ngc");
    let dome = part_of_dome(500);
    // Compensation moves every joint, and a joint in motion costs more: so does the program.
    let helix = helix();
    let path = |path: PathBuf| path.display().to_string();
    let bare = || vec!["--machine".to_string(), path(WITHOUT_FORCE.clone())];
    let plain = || vec!["--machine".to_string(), path(WITHOUT_OBSERVERS.clone())];
    let compliance = || {
        let block = path(root().join("examples/block.toml"));
        let words = ["--force", "x,z", "--force-setpoint", "5", "--stock", &block];
        words.map(String::from).to_vec()
    };
    let option = |name: &str, file: &str| [name.to_string(), path(root().join(file))];
    let mill = option("--machine", "machines/vmc3.toml");
    let errors = option("--errors", "host/volumetric/data/vmc3_errors.csv");
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
            [8_500.0, 14_000.0],
        ),
        job(
            "dome, 5 axes, a machine without a force sensor and without integral action",
            "dome-plain",
            &dome,
            plain(),
            [8_000.0, 14_000.0],
        ),
        job(
            "E11 circle, a machine without a force sensor",
            "e11-bare",
            &circle,
            bare(),
            [8_100.0, 14_000.0],
        ),
        job(
            "dome, 5 axes, with a force sensor, nothing under force control",
            "dome",
            &dome,
            Vec::new(),
            [10_660.0, 16_120.0],
        ),
        job(
            "E11 circle, cut under force control of x and z",
            "e11-force",
            &circle,
            compliance(),
            [11_320.0, 17_780.0],
        ),
        job(
            "E11 circle on the vertical mill, without error tables",
            "vmc-circle-bare",
            &circle,
            mill.to_vec(),
            [4_490.0, 8_460.0],
        ),
        job(
            "E11 circle on the vertical mill, with error tables",
            "vmc-circle",
            &circle,
            [mill.clone(), errors.clone()].concat(),
            [5_240.0, 9_430.0],
        ),
        job(
            "Helix on the vertical mill, without error tables",
            "vmc-bare",
            &helix,
            mill.to_vec(),
            [4_770.0, 8_340.0],
        ),
        job(
            "Helix on the vertical mill, with error tables",
            "vmc",
            &helix,
            [mill, errors].concat(),
            [5_350.0, 9_350.0],
        ),
        Job {
            title: "E8, teleoperation with force feedback, force control of x, y and z, the image with the haptic arm",
            name: "e8",
            what: What::Scenario("e8"),
            ceilings: [23_300.0, 32_000.0],
        },
    ];
    let mut table = String::from(TABLE_HEAD) + &the_kinematics_stay_within_their_instructions();
    let mut beyond = Vec::new();
    let mut costs = std::collections::BTreeMap::new();
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
        // Both chips run the same image, so the instructions are those of both.
        for (what, one) in [("mean", mean), ("worst", worst)] {
            let two = number(&other[what]);
            assert!(
                (one - two).abs() < 3.0,
                "{title}: {what} {one} on the M4F, {two} on the M7"
            );
        }
        assert!(number(&cost["stack_bytes"]) > 0.0, "no report at the end");
        println!("{title}: {mean:.0} in the mean, {worst:.0} at worst");
        table += &format!("| whole period | {mean:.0} | {worst:.0} |\n\n");
        table += &wrapped(&format!(
            "{} control periods in which a program ran. Worst period of all, activating the configuration included: {:.0}. Stack used: {} bytes. \
             Most bytes in the receive ring: {} of {}. Setpoints in the queue: at most {} of 256{}.\n",
            cost["periods"],
            number(&cost["worst_of_all"]),
            cost["stack_bytes"],
            cost["ring_peak"],
            haptimill_firmware::comm::rx_ring::RING_BYTES,
            cost["queue_high"],
            // With a master as the source there are no setpoints to receive.
            cost["queue_low"]
                .as_u64()
                .map_or_else(String::new, |low| format!(
                    ", then at least {low} while more were to come"
                ))
        ));
        costs.insert(name, [mean, worst]);
        if mean >= mean_ceiling || worst >= worst_ceiling {
            beyond.push(format!("{title}: {mean:.0} and {worst:.0} instructions"));
        }
    }
    println!("{table}");
    let file = root().join("docs/instructions.md");
    if std::env::var_os("HAPTIMILL_WRITE").is_some() {
        std::fs::create_dir_all(root().join("docs")).expect("made");
        std::fs::write(&file, &table).expect("written");
    }
    if std::fs::read_to_string(&file).unwrap_or_default() != table {
        println!("docs/instructions.md differs; `cargo xtask instructions` writes it anew");
    }
    assert!(beyond.is_empty(), "{beyond:#?}");
    // On the circle the correction moves z, which rests without it.
    for (what, program, bare, max) in [
        (
            "integral action and friction adaptation",
            "dome-bare",
            "dome-plain",
            1_000.0,
        ),
        (
            "volumetric compensation",
            "vmc-circle",
            "vmc-circle-bare",
            1_000.0,
        ),
        ("volumetric compensation", "vmc", "vmc-bare", 1_000.0),
    ] {
        let [mean, worst] = [0, 1].map(|which| costs[program][which] - costs[bare][which]);
        println!("{what}, {program}: {mean:.0} in the mean, {worst:.0} at worst");
        assert!(mean <= max && worst <= max, "{what}: {mean} {worst}");
    }
}

/// Cost of a control period in a jog of all five coordinates, far from standstill and near the
/// bounds: with and without sensor, under force control, and beside a program.
#[test]
fn a_jog_period_stays_within_its_instructions() {
    let built_in = || MachineFile::built_in().expect("sound");
    let bare = || MachineFile::load(&WITHOUT_FORCE).expect("sound");
    // The measured cost plus 3 %. The budget is 8,000 and 14,000, under force control 12,000 and
    // 18,000: jogs of many coordinates exceed it.
    let jobs: [(&str, MachineFile, u8, bool, [f64; 2]); 4] = [
        (
            "a jog, a machine without a force sensor",
            bare(),
            0,
            false,
            [22_700.0, 27_240.0],
        ),
        (
            "a jog, with a force sensor",
            built_in(),
            0,
            false,
            [24_920.0, 29_970.0],
        ),
        (
            "a jog under force control of x and z",
            built_in(),
            5,
            false,
            [25_870.0, 30_770.0],
        ),
        (
            "a jog of y, z and the table beside a program",
            built_in(),
            0,
            true,
            [30_780.0, 38_920.0],
        ),
    ];
    let mut too_many = Vec::new();
    for (title, machine, mask, beside, ceilings) in jobs {
        let image = pil::image(Board::Mps2).expect("builds");
        let control = emulator::remote(Board::Mps2, &image, &[]);
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
            bench.ask(Say::ForceMask { mask }).expect("accepted");
        }
        if beside {
            let start = bench.status().commanded;
            bench.start_part(1, &start, &line_in_x(&start, 2.0, 200));
            bench.ask(Say::Hold).expect("holds");
            bench.steps(2500);
            for coordinate in [1, 2, 4] {
                let source = Source::Jog;
                bench
                    .ask(Say::Source { coordinate, source })
                    .expect("chosen");
            }
            bench.ask(Say::Resume).expect("goes on");
            bench.steps(1000);
        }
        *cost.lock().expect("not poisoned") = Cost::default();
        // Towards a bound, back, and across the middle.
        for (epoch, sign) in [(1, 1.0), (2, -1.0), (3, 1.0)] {
            let rates = [30.0, 40.0, 25.0].map(|rate| rate * f64::from(1 << 12) * sign);
            let angles = [15.0, 15.0].map(|rate| rate * sign * 4_294_967_296.0 / 360.0 / 256.0);
            let rates = rates.into_iter().chain(angles).map(|rate| rate as i32);
            let jog = Say::Jog {
                epoch,
                timeout_ms: 1000,
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

/// Breaks a line of words at 100 columns.
fn wrapped(line: &str) -> String {
    let (mut text, mut column) = (String::new(), 0);
    for word in line.split_whitespace() {
        if column > 0 && column + 1 + word.len() > 100 {
            text.push('\n');
            column = 0;
        } else if column > 0 {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += word.len();
    }
    text.push('\n');
    text
}

const TABLE_HEAD: &str = "# Instructions of a control period

Counted on an emulated Cortex-M4F (QEMU, mps2-an386), release build, overflow checks on. Made by
`cargo xtask instructions`; do not edit.

The same image was run on an emulated Cortex-M7 (mps2-an500) as well: it takes the same
instructions.

Instructions are not cycles: no wait states, no caches, no latency of divisions and loads. A board's
factor has to be measured on that board. At one cycle an instruction and 168 MHz a period of 200 us
has 33,600.

Budget of a period without the haptic arm, mean and worst: 8,000 and 14,000 without force control,
12,000 and 18,000 with it; 1,000 more for the integrators with friction adaptation, and 1,000 more
for volumetric compensation. The integrators of five joints take 780 in the mean and 748 at worst:
the difference of the tables of the dome with and without them. A machine with a force sensor is
above the budget while no axis is under force control, and so are jogs of several coordinates, which
the test `a_jog_period_stays_within_its_instructions` bounds by what they take now.

Without a force sensor the measured pose is computed on request: in periods with telemetry, and
while the references are searched. With one it is part of *measure* in every period, and so are the
forces, their peaks and the monitors of the sensor, also when no axis is under force control.
";
