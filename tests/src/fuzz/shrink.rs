//! Shortens the script of a failing episode.

use super::episode::{Episode, Step};
use super::run::run;

/// Returns the episode with the shortest script found for which the same check still fails.
#[must_use]
pub fn shrink(episode: &Episode, check: &str, tries: usize) -> Episode {
    let mut best = episode.clone();
    let mut left = tries;
    let fails = |script: &[Step], left: &mut usize| {
        *left = left.saturating_sub(1);
        let candidate = Episode {
            script: script.to_vec(),
            ..episode.clone()
        };
        run(&candidate)
            .violation
            .is_some_and(|violation| violation.check == check)
    };
    let mut size = best.script.len().div_ceil(2);
    while size > 0 && left > 0 {
        let mut at = 0;
        let mut shorter = false;
        while at < best.script.len() && left > 0 {
            let mut script = best.script.clone();
            script.drain(at..(at + size).min(script.len()));
            if fails(&script, &mut left) {
                best.script = script;
                shorter = true;
            } else {
                at += size;
            }
        }
        if !shorter || size > 1 {
            size /= 2;
        }
    }
    best
}
