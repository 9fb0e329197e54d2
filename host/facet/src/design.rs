//! A design: its index wheel, its symmetry and its facets, in the order in which they are cut.

use crate::MAX_FACETS;
use crate::problem::{Problem, Problems};
use haptimill_hil_sim::polyhedron::Plane;
use haptimill_hil_sim::vector::Vector;

/// Teeth of index wheels.
const GEARS: core::ops::RangeInclusive<u32> = 32..=120;

/// Side of the girdle from which a facet is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// Below the girdle: the dop holds the side of the table.
    Pavilion,
    /// Above the girdle: the dop holds the pavilion.
    Crown,
}

/// Stage of the job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Facets that shape the rough; later facets may cut them away.
    Preform,
    /// Facets of the girdle: angle 90 degrees.
    Girdle,
    /// Facets below the girdle.
    Pavilion,
    /// Facets above the girdle.
    Crown,
    /// The facet on top: angle 0.
    Table,
}

impl Stage {
    /// Name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Preform => "preform",
            Self::Girdle => "girdle",
            Self::Pavilion => "pavilion",
            Self::Crown => "crown",
            Self::Table => "table",
        }
    }
}

/// Symmetry that the file states. The facets are compared with it; the plane of a facet does not
/// depend on it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Symmetry {
    /// Number of equal sectors; 0 if it is not stated.
    pub order: u32,
    /// Whether each sector is its own mirror image.
    pub mirror: bool,
}

/// A facet.
#[derive(Debug, Clone, PartialEq)]
pub struct Facet {
    /// Name of its tier, and its index.
    pub name: String,
    /// Number of its tier, from 0.
    pub tier: usize,
    /// Line of the file, from 1.
    pub line: usize,
    /// Side from which it is cut.
    pub side: Side,
    /// Stage of the job.
    pub stage: Stage,
    /// Angle from the plane of the girdle, 0 to 90 degrees.
    pub angle_deg: f64,
    /// Position of the index wheel, 0 to the number of teeth.
    pub index: f64,
    /// Distance of the plane from the origin, units of the design.
    pub distance: f64,
    /// Note of the designer for the cutter.
    pub note: String,
}

/// A tier as it is in a file: facets of one angle and distance.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tier {
    pub line: usize,
    /// Negative below the girdle; -0 is the culet.
    pub angle_deg: f64,
    pub distance: f64,
    /// Positions and names.
    pub indices: Vec<(f64, Option<String>)>,
    pub note: String,
    pub preform: bool,
}

/// A design.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Title.
    pub title: String,
    /// Further lines of text: headers and footnotes.
    pub remarks: Vec<String>,
    /// Teeth of the index wheel.
    pub gear: u32,
    /// The numbers of the wheel run clockwise.
    pub reversed: bool,
    /// Position of the wheel that is azimuth 0, teeth.
    pub reference: f64,
    /// Symmetry.
    pub symmetry: Symmetry,
    /// Refractive index of the material.
    pub refractive_index: f64,
    /// Whether distances are in mm; otherwise the size of the stone gives their unit.
    pub is_in_mm: bool,
    /// The list has a row for the transfer, before the facet of this number; `None` for a format
    /// without such rows.
    pub transfer: Option<Vec<usize>>,
    /// Facets in the order of the cut.
    pub facets: Vec<Facet>,
    /// What a cutter should look at; the design can be cut. In the order of the file.
    pub notices: Vec<Problem>,
    /// Line of the gear in the file, from 1; 0 if there is none.
    pub(crate) gear_line: usize,
    /// A facet beyond the largest number was reported.
    pub(crate) is_full: bool,
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
    /// An empty design.
    pub(crate) const fn empty() -> Self {
        Self {
            title: String::new(),
            remarks: Vec::new(),
            gear: 96,
            reversed: false,
            reference: 0.0,
            symmetry: Symmetry {
                order: 0,
                mirror: false,
            },
            refractive_index: 1.54,
            is_in_mm: false,
            transfer: None,
            facets: Vec::new(),
            notices: Vec::new(),
            gear_line: 0,
            is_full: false,
        }
    }

    /// Azimuth of a position of the wheel, degrees.
    #[must_use]
    pub fn azimuth_deg(&self, index: f64) -> f64 {
        let turn = 360.0 * (index - self.reference) / f64::from(self.gear);
        if self.reversed { -turn } else { turn }
    }

    /// Plane of a facet, in units of the design.
    #[must_use]
    pub fn plane(&self, facet: &Facet) -> Plane {
        Plane {
            normal: self.normal(facet),
            distance: facet.distance,
        }
    }

    /// Unit normal of a facet, out of the stone.
    #[must_use]
    pub fn normal(&self, facet: &Facet) -> Vector {
        let radian = core::f64::consts::PI / 180.0;
        let (sin, cos) = libm::sincos(facet.angle_deg * radian);
        let (y, x) = libm::sincos(self.azimuth_deg(facet.index) * radian);
        // The cosine of 90 degrees is not 0 in f64, but a girdle facet is upright.
        let up = if facet.angle_deg == 90.0 { 0.0 } else { cos };
        let up = match facet.side {
            Side::Pavilion => -up,
            Side::Crown => up,
        };
        [sin * x, sin * y, up]
    }

    /// Adds the facets of a tier, as far as they are valid.
    pub(crate) fn add(&mut self, tier: Tier, problems: &mut Problems) {
        let number = self.facets.last().map_or(0, |last| last.tier + 1);
        if self.is_full {
            return;
        }
        let first_name = tier.indices.iter().find_map(|(_, name)| name.clone());
        let mut name = first_name.unwrap_or_else(|| (number + 1).to_string());
        let shown = name.clone();
        let angle = tier.angle_deg.abs();
        if !tier.angle_deg.is_finite() || angle > 90.0 {
            let what = format!("an angle of {} deg is impossible", tier.angle_deg);
            problems.report(
                tier.line,
                Some(&shown),
                what,
                "write -90 to 90; below the girdle it is negative",
            );
            return;
        }
        if !tier.distance.is_finite() || tier.distance.abs() > 1e4 {
            let what = format!("a distance of {} is impossible", tier.distance);
            problems.report(
                tier.line,
                Some(&shown),
                what,
                "write the distance of its plane",
            );
            return;
        }
        let below = tier.angle_deg.is_sign_negative();
        // A girdle is cut from the side on which the stone is.
        let side = match self.facets.last() {
            Some(last) if angle == 90.0 && !tier.preform => last.side,
            _ if below => Side::Pavilion,
            _ if angle == 90.0 => Side::Pavilion,
            _ => Side::Crown,
        };
        let stage = match side {
            _ if tier.preform => Stage::Preform,
            _ if angle == 90.0 => Stage::Girdle,
            Side::Pavilion => Stage::Pavilion,
            Side::Crown if angle == 0.0 => Stage::Table,
            Side::Crown => Stage::Crown,
        };
        let teeth = f64::from(self.gear);
        for (index, own) in tier.indices {
            name = own.unwrap_or(name);
            // Positions repeat after a turn. GemCad writes that of 0 as the number of teeth, with
            // the sign of the gear.
            let index = match index {
                _ if !(-teeth..0.0).contains(&index) => index,
                _ if index == -teeth => teeth,
                _ => index + teeth,
            };
            let full = format!("{name}@{index}");
            if !(0.0..=teeth).contains(&index) {
                let what = format!("index {index} is off the wheel of {} teeth", self.gear);
                let remedy = format!("write 0 to {}, or another gear", self.gear);
                problems.report(tier.line, Some(&full), what, remedy);
                continue;
            }
            if self.facets.len() == MAX_FACETS {
                let what = format!("the design has more than {MAX_FACETS} facets");
                problems.report(tier.line, Some(&full), what, "remove some");
                self.is_full = true;
                return;
            }
            self.facets.push(Facet {
                name: full,
                tier: number,
                line: tier.line,
                side,
                stage,
                angle_deg: angle,
                index,
                distance: tier.distance,
                note: tier.note.clone(),
            });
        }
    }

    /// Sets the gear of the wheel; negative where its numbers run clockwise.
    pub(crate) fn set_gear(&mut self, teeth: f64, line: usize, problems: &mut Problems) {
        if teeth.fract() != 0.0 || !GEARS.contains(&(teeth.abs() as u32)) {
            let what = format!("an index wheel of {teeth} teeth");
            let remedy = format!("write a gear of {} to {} teeth", GEARS.start(), GEARS.end());
            problems.report(line, None, what, remedy);
            return;
        }
        self.gear_line = line;
        self.gear = teeth.abs() as u32;
        self.reversed = teeth < 0.0;
    }

    /// Sets the position of azimuth 0.
    pub(crate) fn set_reference(&mut self, at: f64, line: usize, problems: &mut Problems) {
        let teeth = f64::from(self.gear);
        if at.is_finite() && at.abs() <= teeth {
            self.reference = at;
            return;
        }
        let what = format!("azimuth 0 is at {at} of {teeth} teeth");
        let remedy = format!("write a position of 0 to {teeth}");
        problems.report(line, None, what, remedy);
    }

    pub(crate) fn set_refractive_index(
        &mut self,
        value: f64,
        line: usize,
        problems: &mut Problems,
    ) {
        if !(1.0..=4.0).contains(&value) {
            let what = format!("a refractive index of {value}");
            problems.report(line, None, what, "write 1 to 4; quartz has 1.54");
        }
        self.refractive_index = value;
    }

    /// Sets the symmetry: its order, and whether a sector is its own mirror image.
    pub(crate) fn set_symmetry(
        &mut self,
        order: f64,
        mirror: bool,
        line: usize,
        problems: &mut Problems,
    ) {
        let most = f64::from(*GEARS.end());
        if order.fract() != 0.0 || !(1.0..=most).contains(&order) {
            let what = format!("a symmetry of order {order}");
            let remedy = format!("write a whole number of 1 to {most}; 1 is none");
            problems.report(line, None, what, remedy);
            return;
        }
        self.symmetry = Symmetry {
            order: order as u32,
            mirror,
        };
    }

    fn notice(&mut self, facet: Option<usize>, line: usize, what: String, remedy: &str) {
        let facet = facet.map(|number| &self.facets[number]);
        self.notices.push(Problem {
            line: facet.map_or(line, |facet| facet.line),
            facet: facet.map(|facet| facet.name.clone()),
            what,
            remedy: remedy.to_string(),
        });
    }

    /// Facets after which the side changes.
    fn transfers(&self) -> Vec<usize> {
        (1..self.facets.len())
            .filter(|next| self.facets[*next].side != self.facets[next - 1].side)
            .collect()
    }

    /// Orders the facets of a format without transfers by side: such a file lists planes, and its
    /// order may go between the sides. The girdle is cut with the first side.
    fn group_by_side(&mut self) {
        let [_, again, ..] = self.transfers()[..] else {
            return;
        };
        let first = self.facets[0].side;
        for facet in &mut self.facets {
            if facet.stage == Stage::Girdle {
                facet.side = first;
            }
        }
        let name = match first {
            Side::Pavilion => "pavilion",
            Side::Crown => "crown",
        };
        let what = format!(
            "is behind facets of the other side; the stone is turned over once, and the side of \
             the {name} is cut first"
        );
        self.notice(Some(again), 0, what, "check the order of the cut");
        self.facets.sort_by_key(|facet| facet.side != first);
    }

    /// Removes facets that have the plane of an earlier one: GemCad cuts it again, and nothing
    /// happens.
    fn remove_twins(&mut self) {
        let mut kept: Vec<Facet> = Vec::new();
        for facet in core::mem::take(&mut self.facets) {
            let turn = |other: &Facet| {
                let teeth = f64::from(self.gear);
                (other.index - facet.index).rem_euclid(teeth) == 0.0
            };
            let twin = kept.iter().find(|other| {
                other.angle_deg == facet.angle_deg
                    && other.distance == facet.distance
                    && (other.side == facet.side || facet.angle_deg == 90.0)
                    && (turn(other) || facet.angle_deg == 0.0)
            });
            match twin {
                Some(twin) => self.notices.push(Problem {
                    line: facet.line,
                    what: format!("is the plane of facet {} and is not cut again", twin.name),
                    remedy: "remove it".to_string(),
                    facet: Some(facet.name),
                }),
                None => kept.push(facet),
            }
        }
        self.facets = kept;
    }

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

    /// Whether the design has a facet of angle 0 on its crown.
    pub(crate) fn has_table(&self) -> bool {
        self.facets
            .iter()
            .any(|facet| facet.angle_deg == 0.0 && facet.side == Side::Crown)
    }

    /// The line of the symmetry as in a GemCad file.
    fn symmetry_text(&self) -> String {
        let mirror = if self.symmetry.mirror { "y" } else { "n" };
        format!("y {} {mirror}", self.symmetry.order)
    }

    /// Compares the facets with the symmetry that the file states.
    fn check_symmetry(&mut self, problems: &mut Problems) {
        let alone = self.without_partners(self.gear);
        if alone.is_empty() {
            return;
        }
        let most = self.facets.iter().map(|facet| facet.index);
        let most = most.fold(0.0, f64::max);
        let fits = |teeth: &&u32| {
            f64::from(**teeth) >= most
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

    /// Checks the order of the sides, the symmetry and the table. The stone is turned over once.
    pub(crate) fn check(&mut self, problems: &mut Problems) {
        if self.transfer.is_none() {
            self.remove_twins();
            self.group_by_side();
        }
        self.check_sides(problems);
        self.check_symmetry(problems);
        if !self.facets.is_empty() && !self.has_table() {
            let what = "the design has no table: no facet of angle 0 on the crown".to_string();
            self.notice(None, 0, what, "add it, if the file is not complete");
        }
        self.notices.sort_by_key(|notice| notice.line);
    }

    fn check_sides(&self, problems: &mut Problems) {
        let transfers = self.transfers();
        if let [_, again, ..] = transfers[..] {
            let facet = &self.facets[again];
            let what = "is cut from a side that the stone was already taken from";
            let remedy = "cut all facets of one side before the transfer";
            problems.report(facet.line, Some(&facet.name), what, remedy);
            return;
        }
        let Some(stated) = &self.transfer else {
            return;
        };
        for next in &transfers {
            if !stated.contains(next) {
                let facet = &self.facets[*next];
                let what = "is on the other side of the girdle, and no transfer is before it";
                let remedy = "add a row `transfer` before it";
                problems.report(facet.line, Some(&facet.name), what, remedy);
            }
        }
        for at in stated.iter().filter(|at| !transfers.contains(at)) {
            let line = self.facets.get(*at).or(self.facets.last());
            let line = line.map_or(0, |facet| facet.line);
            let what = "the transfer is not between two sides of the girdle";
            problems.report(line, None, what, "remove it, or move it");
        }
    }

    /// Number of the first facet behind the transfer; `None` if all are cut from one side.
    #[must_use]
    pub fn first_after_transfer(&self) -> Option<usize> {
        (1..self.facets.len()).find(|next| self.facets[*next].side != self.facets[next - 1].side)
    }
}

/// A position of the wheel, in teeth.
fn tooth(index: f64) -> String {
    let text = format!("{index:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}
