//! A design: its index wheel, its symmetry and its facets, in the order in which they are cut.

mod end;
mod sides;
mod symmetry;
mod tiers;

pub use symmetry::Symmetry;
pub use tiers::Tier;

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
    /// Stage of a facet that is no preform, from its angle of 0 to 90 degrees.
    const fn of(side: Side, angle_deg: f64) -> Self {
        match side {
            _ if angle_deg == 90.0 => Self::Girdle,
            Side::Pavilion => Self::Pavilion,
            Side::Crown if angle_deg == 0.0 => Self::Table,
            Side::Crown => Self::Crown,
        }
    }

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

/// A position of a tier, and the name that begins there.
#[derive(Debug, Clone)]
pub(crate) struct Position {
    pub index: f64,
    pub name: Option<String>,
    pub line: usize,
}

/// A tier as it is in a file: facets of one angle and distance.
#[derive(Debug, Clone, Default)]
pub(crate) struct RawTier {
    pub line: usize,
    /// Negative below the girdle; -0 is the culet.
    pub angle_deg: f64,
    pub distance: f64,
    pub indices: Vec<Position>,
    pub note: String,
    pub preform: bool,
}

/// A row of a list at which the stone is turned over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transfer {
    /// Number of the facet behind it.
    pub before: usize,
    /// Line of the file, from 1.
    pub line: usize,
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
    /// The transfers of a list; `None` for a format without such rows.
    pub transfer: Option<Vec<Transfer>>,
    /// Facets in the order of the cut.
    pub facets: Vec<Facet>,
    /// What a cutter should look at; the design can be cut. In the order of the file.
    pub notices: Vec<Problem>,
    /// Line of the gear in the file, from 1; 0 if there is none.
    pub(crate) gear_line: usize,
    /// The file has no gear or an impossible one, which was reported: `gear` is not of the file.
    pub(crate) is_gear_refused: bool,
    /// A facet beyond the largest number was reported.
    pub(crate) is_full: bool,
}

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
            is_gear_refused: false,
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

    /// Adds the facets of a tier, as far as they are valid. Whether all are.
    pub(crate) fn add(&mut self, tier: RawTier, problems: &mut Problems) -> bool {
        let mut is_whole = true;
        let number = self.facets.last().map_or(0, |last| last.tier + 1);
        if self.is_full {
            return false;
        }
        let first_name = tier.indices.iter().find_map(|at| at.name.clone());
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
            return false;
        }
        if !tier.distance.is_finite() || tier.distance.abs() > 1e4 {
            let what = format!("a distance of {} is impossible", tier.distance);
            problems.report(
                tier.line,
                Some(&shown),
                what,
                "write the distance of its plane",
            );
            return false;
        }
        let below = tier.angle_deg.is_sign_negative();
        // A girdle is cut from the side on which the stone is.
        let side = match self.facets.last() {
            Some(last) if angle == 90.0 && !tier.preform => last.side,
            _ if below => Side::Pavilion,
            _ if angle == 90.0 => Side::Pavilion,
            _ => Side::Crown,
        };
        let stage = match tier.preform {
            true => Stage::Preform,
            false => Stage::of(side, angle),
        };
        let teeth = f64::from(self.gear);
        for Position {
            index,
            name: own,
            line,
        } in tier.indices
        {
            name = own.unwrap_or(name);
            // Positions repeat after a turn. GemCad writes that of 0 as the number of teeth, with
            // the sign of the gear.
            let index = match index {
                _ if !(-teeth..0.0).contains(&index) => index,
                _ if index == -teeth => teeth,
                _ => index + teeth,
            };
            let full = format!("{name}@{index}");
            // Without a gear the wheel is not known.
            if self.gear_line > 0 && !(0.0..=teeth).contains(&index) {
                let what = format!("index {index} is off the wheel of {} teeth", self.gear);
                let remedy = format!("write 0 to {}, or another gear", self.gear);
                problems.report(line, Some(&full), what, remedy);
                is_whole = false;
                continue;
            }
            if self.facets.len() == MAX_FACETS {
                let what = format!("the design has more than {MAX_FACETS} facets");
                problems.report(tier.line, Some(&full), what, "remove some");
                self.is_full = true;
                return false;
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
        is_whole
    }

    /// Sets the gear of the wheel; negative where its numbers run clockwise.
    pub(crate) fn set_gear(&mut self, teeth: f64, line: usize, problems: &mut Problems) {
        if teeth.fract() != 0.0 || !GEARS.contains(&(teeth.abs() as u32)) {
            let what = format!("an index wheel of {teeth} teeth");
            let remedy = format!("write a gear of {} to {} teeth", GEARS.start(), GEARS.end());
            problems.report(line, None, what, remedy);
            self.is_gear_refused = true;
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
        let max = f64::from(*GEARS.end());
        if order.fract() != 0.0 || !(1.0..=max).contains(&order) {
            let what = format!("a symmetry of order {order}");
            let remedy = format!("write a whole number of 1 to {max}; 1 is none");
            problems.report(line, None, what, remedy);
            return;
        }
        self.symmetry = Symmetry {
            order: order as u32,
            mirror,
        };
    }

    /// Makes preforms that stay on the stone facets, with a notice for each tier.
    pub(crate) fn keep_preforms(&mut self, mut stay: Vec<usize>) {
        stay.sort_unstable();
        for &number in &stay {
            let facet = &mut self.facets[number];
            facet.stage = Stage::of(facet.side, facet.angle_deg);
        }
        for of_tier in stay.chunk_by(|a, b| self.facets[*a].tier == self.facets[*b].tier) {
            let more = match of_tier.len() - 1 {
                0 => String::new(),
                more => format!(", as are {more} more of its tier"),
            };
            let facet = &self.facets[of_tier[0]];
            self.notices.push(Problem {
                line: facet.line,
                facet: Some(facet.name.clone()),
                what: format!(
                    "is a preform that no later facet cuts away{more}; it is ground on all laps"
                ),
                remedy: "check the later facets, or remove the mark of the preform".to_string(),
            });
        }
        self.notices.sort_by_key(|notice| notice.line);
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

    /// Whether the design has a facet of angle 0 on its crown.
    pub(crate) fn has_table(&self) -> bool {
        self.facets
            .iter()
            .any(|facet| facet.angle_deg == 0.0 && facet.side == Side::Crown)
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
}
