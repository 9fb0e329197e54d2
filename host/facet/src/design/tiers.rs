//! Tiers as cutters list them: facets of one name, angle and distance with their indices.

use super::{Design, Facet, Side, Stage, Symmetry};

/// A tier of a design.
#[derive(Debug, Clone, PartialEq)]
pub struct Tier {
    /// Names of its facets, without the indices; mostly one.
    pub name: String,
    /// Side from which it is cut.
    pub side: Side,
    /// Stage of the job.
    pub stage: Stage,
    /// Angle from the plane of the girdle, 0 to 90 degrees.
    pub angle_deg: f64,
    /// Numbers of its facets in the order of the cut.
    pub facets: Vec<usize>,
    /// Positions of the wheel, in the same order.
    pub indices: Vec<f64>,
    /// Note of the designer for the cutter.
    pub note: String,
}

impl Tier {
    /// The positions of the wheel as cutters write them, `96-12-24`.
    #[must_use]
    pub fn index_text(&self) -> String {
        let indices: Vec<String> = self.indices.iter().map(f64::to_string).collect();
        indices.join("-")
    }
}

/// Name of a facet without its index.
fn short_name(facet: &Facet) -> &str {
    facet.name.rsplit_once('@').map_or(&*facet.name, |it| it.0)
}

impl Design {
    /// The tiers in the order of the cut. A list may have a row for each facet of a tier.
    #[must_use]
    pub fn tiers(&self) -> Vec<Tier> {
        let same = |one: &Facet, next: &Facet| {
            let is_alike = short_name(one) == short_name(next)
                && one.angle_deg == next.angle_deg
                && one.distance == next.distance
                && one.note == next.note;
            (one.tier == next.tier || is_alike) && one.side == next.side && one.stage == next.stage
        };
        let mut tiers = Vec::new();
        let mut number = 0;
        for facets in self.facets.chunk_by(same) {
            let mut names: Vec<&str> = facets.iter().map(short_name).collect();
            names.dedup();
            tiers.push(Tier {
                name: names.join(", "),
                side: facets[0].side,
                stage: facets[0].stage,
                angle_deg: facets[0].angle_deg,
                facets: (number..number + facets.len()).collect(),
                indices: facets.iter().map(|facet| facet.index).collect(),
                note: facets[0].note.clone(),
            });
            number += facets.len();
        }
        tiers
    }

    /// The index wheel in words.
    #[must_use]
    pub fn wheel_text(&self) -> String {
        let way = if self.reversed {
            ", numbered clockwise"
        } else {
            ""
        };
        format!("index wheel of {} teeth{way}", self.gear)
    }

    /// The position of the wheel at an azimuth, as it is written on the wheel: 0 is the number of
    /// teeth.
    #[must_use]
    pub fn index_at(&self, azimuth_deg: f64) -> f64 {
        let teeth = f64::from(self.gear);
        let turn = azimuth_deg / 360.0 * teeth;
        let turn = if self.reversed { -turn } else { turn };
        let index = (self.reference + turn).rem_euclid(teeth);
        if index == 0.0 { teeth } else { index }
    }
}

impl Symmetry {
    /// The symmetry in words.
    #[must_use]
    pub fn text(&self) -> String {
        match (self.order, self.mirror) {
            (0, _) => "not stated".to_string(),
            (1, false) => "none".to_string(),
            (1, true) => "mirror-image".to_string(),
            (order, false) => format!("{order}-fold"),
            (order, true) => format!("{order}-fold, mirror-image"),
        }
    }
}
