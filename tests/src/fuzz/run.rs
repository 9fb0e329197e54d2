//! Runs an episode, and collects the panics of its thread.

use super::checks::Violation;
use super::episode::Episode;
use super::player::{Player, TRACE};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;

/// The result of an episode.
#[derive(Debug, Clone, Default)]
pub struct EpisodeResult {
    /// The check that failed.
    pub violation: Option<Violation>,
    /// Control periods.
    pub periods: u64,
    /// Stimuli by kind.
    pub counts: BTreeMap<&'static str, u64>,
    /// Largest values of what is compared with a bound.
    pub largest: Vec<(&'static str, f64)>,
    /// Faults that were latched, by kind.
    pub faults: BTreeMap<String, u64>,
}

thread_local! {
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Keeps the panics of each thread for the report instead of printing them.
pub fn capture_panics() {
    std::panic::set_hook(Box::new(|info| {
        let place = info
            .location()
            .map_or_else(String::new, |at| format!("{}:{}", at.file(), at.line()));
        let what = info
            .payload()
            .downcast_ref::<String>()
            .cloned()
            .or_else(|| {
                info.payload()
                    .downcast_ref::<&str>()
                    .map(ToString::to_string)
            })
            .unwrap_or_default();
        PANIC.with(|slot| *slot.borrow_mut() = Some(format!("{place}: {what}")));
    }));
}

/// Prints the state of each episode at this interval, in periods; 0 prints nothing.
pub fn trace_every(periods: u64) {
    TRACE.store(periods, Ordering::Relaxed);
}

/// Runs an episode to its end, or to the first check that fails.
#[must_use]
pub fn run(episode: &Episode) -> EpisodeResult {
    let mut player = Player::new(episode);
    let played = catch_unwind(AssertUnwindSafe(|| player.play(episode)));
    let violation = match played {
        Ok(Ok(())) => None,
        Ok(Err(violation)) => Some(violation),
        Err(_) => Some(Violation {
            check: "panic",
            text: PANIC
                .with(|slot| slot.borrow_mut().take())
                .unwrap_or_default(),
            period: player.bench.period,
        }),
    };
    // A load before the configuration makes the position wrong from the start.
    let violation = violation.map(|found| Violation {
        check: match (episode.initial_load, found.check) {
            (Some(_), "position wrong" | "following" | "runaway" | "rest") => {
                "pushed before configuration"
            }
            (_, check) => check,
        },
        ..found
    });
    let mut counts = player.counts;
    for (name, count) in &player.bench.counts {
        *counts.entry(name).or_default() += count;
    }
    EpisodeResult {
        violation,
        periods: player.bench.period,
        counts,
        largest: player.checks.largest,
        faults: player.faults,
    }
}
