//! The command line of the fuzz test (docs/fuzzing.md); `cargo xtask fuzz` starts it.

use haptimill_tests::fuzz::episode::Episode;
use haptimill_tests::fuzz::machines::MACHINES;
use haptimill_tests::fuzz::report::{Summary, failure_line};
use haptimill_tests::fuzz::run::{capture_panics, run, trace_every};
use haptimill_tests::fuzz::shrink::shrink;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const HELP: &str = "\
fuzz [--minutes N] [--seed S] [--threads T] [--only] [--stop] [--episodes N] [--no-shrink]
      [--machine NAME]

  --minutes N    duration (2); fractions are allowed
  --seed S       first seed (the clock); episode i has the seed S + i
  --threads T    threads (all cores)
  --only         runs the episode of the seed alone, prints its script, and
                 shortens the script if a check fails
  --machine NAME every episode on this machine file, without its suffix: {MACHINES};
                 or h4 for the H-4 machines alone. Without the option every
                 fourth episode is on one of these files
  --stop         ends at the first failure
  --episodes N   number of episodes
  --no-shrink    leaves failing scripts as they are
  --trace N      with --only: state, commanded pose and motors every N periods
  --against-healthy   ignores failures that also occur without a
                 mutation (used by --mutations)
  --ignore A,B   ignores failures of these checks
";

fn help() -> String {
    HELP.replace("{MACHINES}", &MACHINES.join(", "))
}

struct Arguments {
    minutes: f64,
    seed: u64,
    threads: usize,
    only: bool,
    stop: bool,
    shrink: bool,
    episodes: u64,
    ignored: Vec<String>,
    against_healthy: bool,
    machine: Machines,
}

/// The machines of a run.
#[derive(Clone, Copy)]
enum Machines {
    /// Every fourth episode is on a machine file, the others on the H-4 machines.
    All,
    /// The H-4 machines.
    H4,
    /// A machine file.
    File(&'static str),
}

impl Machines {
    /// Returns the episode of a seed.
    fn episode(self, seed: u64, index: u64) -> Episode {
        match self {
            Self::All if index % 4 == 3 => {
                let machine = (index / 4) as usize % MACHINES.len();
                Episode::on(seed, MACHINES[machine])
            }
            Self::All | Self::H4 => Episode::of(seed),
            Self::File(name) => Episode::on(seed, name),
        }
    }
}

fn machines(name: &str) -> Result<Machines, String> {
    if name == "h4" {
        return Ok(Machines::H4);
    }
    let known = MACHINES.iter().find(|other| **other == name);
    known.map(|name| Machines::File(name)).ok_or_else(|| {
        format!(
            "there is no machine '{name}'; write h4 or one of {}",
            MACHINES.join(", ")
        )
    })
}

/// Returns whether the same check fails with this seed without a mutation.
fn also_fails(episode: &Episode, check: &str) -> bool {
    let Ok(own) = std::env::current_exe() else {
        return false;
    };
    let seed = episode.seed.to_string();
    let machine = episode.kind.file().unwrap_or("h4");
    let output = std::process::Command::new(own)
        .env_remove("HAPTIMILL_MUTATION")
        .args(["--only", "--no-shrink", "--seed", &seed])
        .args(["--machine", machine])
        .output();
    let mark = format!("check \"{check}\"");
    output.is_ok_and(|output| {
        String::from_utf8_lossy(&output.stdout)
            .lines()
            .any(|line| line.starts_with("FAILED") && line.contains(&mark))
    })
}

fn number<T: FromStr>(option: &str, text: &str) -> Result<T, String> {
    text.parse()
        .map_err(|_| format!("'{text}' is not a valid value for {option}"))
}

fn arguments() -> Result<Arguments, String> {
    let clock = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(1, |since| since.as_secs() * 1000);
    let mut parsed = Arguments {
        minutes: 2.0,
        seed: clock,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        only: false,
        stop: false,
        shrink: true,
        episodes: u64::MAX,
        ignored: vec![],
        against_healthy: false,
        machine: Machines::All,
    };
    let mut options = std::env::args().skip(1);
    while let Some(option) = options.next() {
        let mut value = || options.next().ok_or(format!("{option} needs a value"));
        match option.as_str() {
            "--minutes" => parsed.minutes = number(&option, &value()?)?,
            "--seed" => parsed.seed = number(&option, &value()?)?,
            "--threads" => parsed.threads = number(&option, &value()?)?,
            "--episodes" => parsed.episodes = number(&option, &value()?)?,
            "--against-healthy" => parsed.against_healthy = true,
            "--ignore" => parsed.ignored = value()?.split(',').map(str::to_string).collect(),
            "--trace" => {
                trace_every(number(&option, &value()?)?);
            }
            "--help" => {
                print!("{}", help());
                std::process::exit(0);
            }
            "--machine" => parsed.machine = machines(&value()?)?,
            "--only" => parsed.only = true,
            "--stop" => parsed.stop = true,
            "--no-shrink" => parsed.shrink = false,
            _ => return Err(format!("there is no option '{option}'\n\n{}", help())),
        }
    }
    if !(parsed.minutes > 0.0 && parsed.minutes <= 1e5) || parsed.threads == 0 {
        return Err("minutes must be more than 0 and threads at least 1".to_owned());
    }
    Ok(parsed)
}

fn main() -> ExitCode {
    let arguments = match arguments() {
        Ok(arguments) => arguments,
        Err(problem) => {
            eprintln!("fuzz: {problem}");
            return ExitCode::from(2);
        }
    };
    capture_panics();
    if arguments.only {
        return only(
            &arguments.machine.episode(arguments.seed, 0),
            arguments.shrink,
        );
    }
    fuzz(&arguments)
}

fn only(episode: &Episode, shorten: bool) -> ExitCode {
    let seed = episode.seed;
    print!("{}", episode.describe());
    let outcome = run(episode);
    println!("{} periods", outcome.periods);
    for (name, value) in &outcome.largest {
        println!("  largest {name}: {value:.5}");
    }
    let Some(violation) = outcome.violation else {
        println!("seed {seed}: all checks hold");
        return ExitCode::SUCCESS;
    };
    println!("{}", failure_line(episode, &violation));
    if shorten {
        let short = shrink(episode, violation.check, 150);
        if let Some(violation) = run(&short).violation {
            println!("shortened to {} steps:", short.script.len());
            print!("{}", short.describe());
            println!("  {}: {}", violation.check, violation.text);
        }
    }
    ExitCode::FAILURE
}

fn fuzz(arguments: &Arguments) -> ExitCode {
    println!(
        "fuzz: seeds from {}, {} minutes, {} threads",
        arguments.seed, arguments.minutes, arguments.threads
    );
    let start = Instant::now();
    let end = start + Duration::from_secs_f64(arguments.minutes * 60.0);
    let (next, done) = (AtomicU64::new(0), AtomicBool::new(false));
    let summary = Mutex::new(Summary::default());
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) && Instant::now() < end {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= arguments.episodes {
                        break;
                    }
                    let seed = arguments.seed.wrapping_add(index);
                    let episode = arguments.machine.episode(seed, index);
                    let mut outcome = run(&episode);
                    outcome.violation = outcome
                        .violation
                        .filter(|found| !arguments.ignored.iter().any(|name| name == found.check));
                    if arguments.against_healthy
                        && let Some(found) = &outcome.violation
                        && also_fails(&episode, found.check)
                    {
                        outcome.violation = None;
                    }
                    if arguments.stop && outcome.violation.is_some() {
                        done.store(true, Ordering::Relaxed);
                    }
                    if let Ok(mut summary) = summary.lock() {
                        summary.add(&episode, outcome);
                    }
                }
            });
        }
    });
    let seconds = start.elapsed().as_secs_f64();
    let Ok(summary) = summary.into_inner() else {
        eprintln!("fuzz: a thread of the fuzz test itself panicked");
        return ExitCode::FAILURE;
    };
    summary.print(seconds, arguments.threads);
    if summary.failures.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
