//! Symmetry that a design states, and the facets that it lacks by it.

use super::{Design, Stage};
use crate::problem::Problems;

/// Symmetry that the file states. The facets are compared with it; the plane of a facet does not
/// depend on it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Symmetry {
    /// Number of equal sectors; 0 if it is not stated.
    pub order: u32,
    /// Whether each sector is its own mirror image.
    pub mirror: bool,
}

/// A facet without all its partners under the symmetry of the design.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Alone {
    /// Number of the facet.
    pub facet: usize,
    /// Positions of the wheel at which a facet of the same angle and distance is missing.
    pub missing: Vec<f64>,
}

/// Facets of one tier have angles that differ by less than this, degrees.
const SAME_DEG: f64 = 0.005;

/// And distances that differ by less than this part of the largest distance.
const SAME_PART: f64 = 1e-4;

/// Positions of partners are this near, teeth, where the teeth divide by the order.
const SAME_TOOTH: f64 = 0.02;

/// And this near where they do not: partners are at the nearest teeth.
const NEAR_TOOTH: f64 = 0.51;

/// Listed notices of facets without partners; the others are counted.
const LISTED_ALONE: usize = 5;

/// Wheels that a cutter may have in place of the stated one.
const USUAL_GEARS: [u32; 10] = [32, 48, 64, 72, 77, 80, 84, 88, 96, 120];

impl Design {
    /// The facets that lack partners under the stated symmetry on a wheel of these teeth.
    /// Preforms and facets of angle 0 do not count.
    pub(crate) fn without_partners(&self, teeth: u32) -> Vec<Alone> {
        let order = self.symmetry.order;
        if order == 0 || (order == 1 && !self.symmetry.mirror) {
            return Vec::new();
        }
        let near = if teeth.is_multiple_of(order) {
            SAME_TOOTH
        } else {
            NEAR_TOOTH
        };
        let (teeth, step) = (f64::from(teeth), f64::from(teeth) / f64::from(order));
        let distances = self.facets.iter().map(|facet| facet.distance.abs());
        let same = SAME_PART * distances.fold(0.0, f64::max);
        // Facets of one angle and distance.
        let mut tiers: Vec<Vec<usize>> = Vec::new();
        for (number, facet) in self.facets.iter().enumerate() {
            if facet.stage == Stage::Preform || facet.angle_deg == 0.0 {
                continue;
            }
            let of = |tier: &&mut Vec<usize>| {
                let first = &self.facets[tier[0]];
                (first.side == facet.side || facet.angle_deg == 90.0)
                    && (first.angle_deg - facet.angle_deg).abs() < SAME_DEG
                    && (first.distance - facet.distance).abs() <= same
            };
            match tiers.iter_mut().find(of) {
                Some(tier) => tier.push(number),
                None => tiers.push(vec![number]),
            }
        }
        let apart = |a: f64, b: f64| {
            let off = (a - b).rem_euclid(teeth);
            off.min(teeth - off)
        };
        let mut alone = Vec::new();
        for tier in tiers {
            let mut seen = vec![false; tier.len()];
            for at in 0..tier.len() {
                if seen[at] {
                    continue;
                }
                let index = self.facets[tier[at]].index;
                let mut orbit: Vec<f64> = Vec::new();
                for turn in 0..order {
                    let by = f64::from(turn) * step;
                    let images = [index + by, by - index];
                    let count = if self.symmetry.mirror { 2 } else { 1 };
                    for image in &images[..count] {
                        let image = image.rem_euclid(teeth);
                        if !orbit.iter().any(|other| apart(*other, image) < near) {
                            orbit.push(image);
                        }
                    }
                }
                let mut missing = Vec::new();
                let mut present = Vec::new();
                for image in orbit {
                    let mut found = false;
                    for (number, facet) in tier.iter().enumerate() {
                        if apart(self.facets[*facet].index, image) < near {
                            found = true;
                            if !seen[number] {
                                seen[number] = true;
                                present.push(*facet);
                            }
                        }
                    }
                    if !found {
                        missing.push(image);
                    }
                }
                // Where most are there, one notice is enough.
                if present.len() > missing.len() {
                    present.truncate(1);
                }
                missing.sort_by(f64::total_cmp);
                if !missing.is_empty() {
                    let missing = &missing;
                    alone.extend(present.into_iter().map(|facet| Alone {
                        facet,
                        missing: missing.clone(),
                    }));
                }
            }
        }
        alone.sort_by_key(|it| it.facet);
        alone
    }

    /// The line of the symmetry as in a GemCad file.
    fn symmetry_text(&self) -> String {
        let mirror = if self.symmetry.mirror { "y" } else { "n" };
        format!("y {} {mirror}", self.symmetry.order)
    }

    /// Compares the facets with the symmetry that the file states.
    pub(super) fn check_symmetry(&mut self, problems: &mut Problems) {
        if self.is_gear_refused {
            return;
        }
        let alone = self.without_partners(self.gear);
        if alone.is_empty() {
            return;
        }
        let max = self.facets.iter().map(|facet| facet.index);
        let max = max.fold(0.0, f64::max);
        let fits = |teeth: &&u32| {
            f64::from(**teeth) >= max
                && **teeth != self.gear
                && teeth.is_multiple_of(self.symmetry.order)
                && self.without_partners(**teeth).is_empty()
        };
        if let Some(teeth) = USUAL_GEARS.iter().find(fits) {
            let what = format!(
                "the indices have the symmetry `{}` on a wheel of {teeth} teeth, and not on one \
                 of {}",
                self.symmetry_text(),
                self.gear
            );
            let remedy = "correct the gear; if it is right, state the symmetry `y 1 n`";
            problems.report(self.gear_line, None, what, remedy);
            return;
        }
        let text = self.symmetry_text();
        for it in alone.iter().take(LISTED_ALONE) {
            let shown: Vec<String> = it.missing.iter().take(4).map(|at| tooth(*at)).collect();
            let more = if it.missing.len() > 4 { ", ..." } else { "" };
            let what = format!(
                "has no partner at index {}{more}, which the symmetry `{text}` asks for",
                shown.join(", ")
            );
            let remedy = "check its index, angle and distance, or the symmetry";
            self.notice(Some(it.facet), 0, what, remedy);
        }
        if alone.len() > LISTED_ALONE {
            let more = alone.len() - LISTED_ALONE;
            let what = format!("{more} more facets have no partner under the symmetry `{text}`");
            let line = self.facets[alone[LISTED_ALONE].facet].line;
            self.notice(None, line, what, "check the symmetry");
        }
    }
}

/// A position of the wheel, in teeth.
fn tooth(index: f64) -> String {
    let text = format!("{index:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}
