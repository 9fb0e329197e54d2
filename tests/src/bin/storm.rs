//! The storm on the command line; `cargo xtask storm` starts it. docs/storm.md says what it does.

use haptimill_tests::storm::script::Episode;
use haptimill_tests::storm::watch::Violation;
use haptimill_tests::storm::{Outcome, TRACE, keep_panics, run, shrink};
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const HELP: &str = "\
storm [--minutes N] [--seed S] [--threads T] [--only] [--stop] [--episodes N] [--no-shrink]

  --minutes N    runs for so long (2); fractions are allowed
  --seed S       first seed (the clock); episode i has the seed S + i
  --threads T    threads (all cores)
  --only         runs the episode of the seed alone, prints its script, and shortens that if a check fails
  --stop         ends at the first failure
  --episodes N   ends after so many episodes
  --no-shrink    leaves failing scripts as they are
  --trace N      with --only: state, commanded pose and motors every N periods
  --against-healthy   what fails without a planted bug as well counts as none (used by --planted)
  --ignore A,B   failures of these checks count as none
";

struct Arguments {
    minutes: f64,
    seed: u64,
    threads: usize,
    only: bool,
    stop: bool,
    shrink: bool,
    episodes: u64,
    ignored: Vec<String>,
    against: bool,
}

/// Whether this storm fails in the same check with this seed when no bug is planted.
fn also_fails(seed: u64, check: &str) -> bool {
    let Ok(own) = std::env::current_exe() else {
        return false;
    };
    let seed = seed.to_string();
    let output = std::process::Command::new(own)
        .env_remove("HAPTIMILL_PLANTED")
        .args(["--only", "--no-shrink", "--seed", &seed])
        .output();
    let mark = format!("check \"{check}\"");
    output.is_ok_and(|output| {
        String::from_utf8_lossy(&output.stdout)
            .lines()
            .any(|line| line.starts_with("FAILED") && line.contains(&mark))
    })
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
        against: false,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        let bad = |text: &str| format!("'{text}' is no value for {word}");
        match word.as_str() {
            "--minutes" => parsed.minutes = value()?.parse().map_err(|_| bad("that"))?,
            "--seed" => parsed.seed = value()?.parse().map_err(|_| bad("that"))?,
            "--threads" => parsed.threads = value()?.parse().map_err(|_| bad("that"))?,
            "--episodes" => parsed.episodes = value()?.parse().map_err(|_| bad("that"))?,
            "--against-healthy" => parsed.against = true,
            "--ignore" => parsed.ignored = value()?.split(',').map(str::to_string).collect(),
            "--trace" => {
                let every = value()?.parse().map_err(|_| bad("that"))?;
                TRACE.store(every, Ordering::Relaxed);
            }
            "--help" => {
                print!("{HELP}");
                std::process::exit(0);
            }
            "--only" => parsed.only = true,
            "--stop" => parsed.stop = true,
            "--no-shrink" => parsed.shrink = false,
            _ => return Err(format!("there is no option '{word}'\n\n{HELP}")),
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
            eprintln!("storm: {problem}");
            return ExitCode::from(2);
        }
    };
    keep_panics();
    if arguments.only {
        return only(arguments.seed, arguments.shrink);
    }
    storm(&arguments)
}

fn only(seed: u64, shorten: bool) -> ExitCode {
    let episode = Episode::of(seed);
    print!("{}", episode.describe());
    let outcome = run(&episode);
    println!("{} periods", outcome.periods);
    for (what, value) in &outcome.largest {
        println!("  largest {what}: {value:.5}");
    }
    let Some(violation) = outcome.violation else {
        println!("seed {seed}: all checks hold");
        return ExitCode::SUCCESS;
    };
    tell(seed, &violation);
    if shorten {
        let short = shrink(&episode, violation.check, 150);
        if let Some(violation) = run(&short).violation {
            println!("shortened to {} steps:", short.script.len());
            print!("{}", short.describe());
            println!("  {}: {}", violation.check, violation.text);
        }
    }
    ExitCode::FAILURE
}

fn tell(seed: u64, violation: &Violation) {
    println!(
        "FAILED  seed {seed}  check \"{}\"  period {}\n        {}\n        to reproduce: cargo xtask storm --seed {seed} --only",
        violation.check, violation.period, violation.text
    );
}

#[derive(Default)]
struct Sum {
    episodes: u64,
    periods: u64,
    counts: BTreeMap<&'static str, u64>,
    themes: BTreeMap<String, u64>,
    faults: BTreeMap<String, u64>,
    largest: BTreeMap<&'static str, (f64, u64)>,
    failures: BTreeMap<&'static str, Vec<(u64, String)>>,
}

impl Sum {
    fn add(&mut self, episode: &Episode, outcome: Outcome) {
        self.episodes += 1;
        self.periods += outcome.periods;
        for (name, count) in outcome.counts {
            *self.counts.entry(name).or_default() += count;
        }
        for (name, count) in outcome.faults {
            *self.faults.entry(name).or_default() += count;
        }
        for (name, value) in outcome.largest {
            let slot = self.largest.entry(name).or_insert((0.0, 0));
            if value > slot.0 {
                *slot = (value, episode.seed);
            }
        }
        *self
            .themes
            .entry(format!("{:?} on {:?}", episode.theme, episode.kind))
            .or_default() += 1;
        if let Some(violation) = outcome.violation {
            let seeds = self.failures.entry(violation.check).or_default();
            if seeds.len() < 3 {
                tell(episode.seed, &violation);
            }
            seeds.push((episode.seed, violation.text));
        }
    }
}

fn storm(arguments: &Arguments) -> ExitCode {
    println!(
        "storm: seeds from {}, {} minutes, {} threads",
        arguments.seed, arguments.minutes, arguments.threads
    );
    let begun = Instant::now();
    let end = begun + Duration::from_secs_f64(arguments.minutes * 60.0);
    let (next, over) = (AtomicU64::new(0), AtomicBool::new(false));
    let sum = Mutex::new(Sum::default());
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) && Instant::now() < end {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= arguments.episodes {
                        break;
                    }
                    let episode = Episode::of(arguments.seed.wrapping_add(index));
                    let mut outcome = run(&episode);
                    outcome.violation = outcome
                        .violation
                        .filter(|found| !arguments.ignored.iter().any(|name| name == found.check));
                    if arguments.against
                        && let Some(found) = &outcome.violation
                        && also_fails(episode.seed, found.check)
                    {
                        outcome.violation = None;
                    }
                    if arguments.stop && outcome.violation.is_some() {
                        over.store(true, Ordering::Relaxed);
                    }
                    if let Ok(mut sum) = sum.lock() {
                        sum.add(&episode, outcome);
                    }
                }
            });
        }
    });
    let took = begun.elapsed().as_secs_f64();
    let Ok(sum) = sum.into_inner() else {
        eprintln!("storm: a thread of the storm itself panicked");
        return ExitCode::FAILURE;
    };
    report(&sum, took, arguments.threads);
    if sum.failures.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn report(sum: &Sum, took: f64, threads: usize) {
    println!("\nepisodes by theme and machine:");
    for (name, count) in &sum.themes {
        println!("  {count:>8}  {name}");
    }
    println!("stimuli:");
    for (name, count) in &sum.counts {
        println!("  {count:>8}  {name}");
    }
    println!("faults latched:");
    for (name, count) in &sum.faults {
        println!("  {count:>8}  {name}");
    }
    println!("largest values, and the seed of each:");
    for (name, (value, seed)) in &sum.largest {
        println!("  {value:>12.5}  {name} (seed {seed})");
    }
    println!("failures:");
    for (check, seeds) in &sum.failures {
        let listed: Vec<String> = seeds
            .iter()
            .take(5)
            .map(|(seed, _)| seed.to_string())
            .collect();
        println!("  {:>8}  {check}: seeds {}", seeds.len(), listed.join(" "));
    }
    println!(
        "{} episodes, {} periods in {took:.0} s on {threads} threads: {:.0} periods per second and thread; {} failures",
        sum.episodes,
        sum.periods,
        sum.periods as f64 / took / threads as f64,
        sum.failures.values().map(Vec::len).sum::<usize>()
    );
}
