//! A design: its index wheel, its symmetry and its facets, in the order in which they are cut.

use crate::MAX_FACETS;
use crate::problem::Problems;
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

/// Symmetry that the file states; nothing depends on it.
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
        for (index, own) in tier.indices {
            name = own.unwrap_or(name);
            let full = format!("{name}@{index}");
            if !(0.0..=f64::from(self.gear)).contains(&index) {
                let what = format!("index {index} is off the wheel of {} teeth", self.gear);
                let remedy = format!("write 0 to {}, or another gear", self.gear);
                problems.report(tier.line, Some(&full), what, remedy);
                continue;
            }
            if self.facets.len() == MAX_FACETS {
                let what = format!("the design has more than {MAX_FACETS} facets");
                problems.report(tier.line, Some(&full), what, "remove some");
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
        self.gear = teeth.abs() as u32;
        self.reversed = teeth < 0.0;
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

    /// Checks the order of the sides: the stone is turned over once.
    pub(crate) fn check(&self, problems: &mut Problems) {
        let transfers: Vec<usize> = (1..self.facets.len())
            .filter(|next| self.facets[*next].side != self.facets[next - 1].side)
            .collect();
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
