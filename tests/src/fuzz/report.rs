//! Sums over all episodes of a run, and the report on standard output.

use super::checks::Violation;
use super::episode::Episode;
use super::run::EpisodeResult;
use std::collections::BTreeMap;

/// Returns the lines that report a failure; `cargo xtask fuzz --mutations` reads the first one.
#[must_use]
pub fn failure_line(episode: &Episode, violation: &Violation) -> String {
    let seed = episode.seed;
    let machine = episode.kind.file();
    let machine = machine.map_or_else(String::new, |name| format!(" --machine {name}"));
    format!(
        "FAILED  seed {seed}  check \"{}\"  period {}\n        {}\n        \
         to reproduce: cargo xtask fuzz --seed {seed} --only{machine}",
        violation.check, violation.period, violation.text
    )
}

/// Sums of the episodes of a run.
#[derive(Default)]
pub struct Summary {
    episodes: u64,
    periods: u64,
    counts: BTreeMap<&'static str, u64>,
    themes: BTreeMap<String, u64>,
    faults: BTreeMap<String, u64>,
    largest: BTreeMap<&'static str, (f64, u64)>,
    /// Failed checks, each with seeds and texts.
    pub failures: BTreeMap<&'static str, Vec<(u64, String)>>,
}

impl Summary {
    /// Adds an episode, and prints the first failures of each check.
    pub fn add(&mut self, episode: &Episode, outcome: EpisodeResult) {
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
                println!("{}", failure_line(episode, &violation));
            }
            seeds.push((episode.seed, violation.text));
        }
    }

    /// Prints the sums of a run of this duration.
    pub fn print(&self, seconds: f64, threads: usize) {
        println!("\nepisodes by theme and machine:");
        for (name, count) in &self.themes {
            println!("  {count:>8}  {name}");
        }
        println!("stimuli:");
        for (name, count) in &self.counts {
            println!("  {count:>8}  {name}");
        }
        println!("faults latched:");
        for (name, count) in &self.faults {
            println!("  {count:>8}  {name}");
        }
        println!("largest values, and the seed of each:");
        for (name, (value, seed)) in &self.largest {
            println!("  {value:>12.5}  {name} (seed {seed})");
        }
        println!("failures:");
        for (check, seeds) in &self.failures {
            // All of them: a seed that is not printed cannot be repeated.
            let listed: Vec<String> = seeds.iter().map(|(seed, _)| seed.to_string()).collect();
            println!("  {:>8}  {check}: seeds {}", seeds.len(), listed.join(" "));
        }
        println!(
            "{} episodes, {} periods in {seconds:.0} s on {threads} threads: {:.0} periods per second and thread; {} failures",
            self.episodes,
            self.periods,
            self.periods as f64 / seconds / threads as f64,
            self.failures.values().map(Vec::len).sum::<usize>()
        );
    }
}
