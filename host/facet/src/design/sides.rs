//! Order of the cut by sides: the transfer, twins of facets, and facets listed out of order.

use super::{Design, Facet, Side, Stage};
use crate::problem::{Problem, Problems};

impl Design {
    /// Facets after which the side changes.
    fn transfers(&self) -> Vec<usize> {
        (1..self.facets.len())
            .filter(|next| self.facets[*next].side != self.facets[next - 1].side)
            .collect()
    }

    /// Orders the facets of a format without transfers by side: such a file lists planes, and its
    /// order may go between the sides. The girdle is cut with the first side.
    pub(super) fn group_by_side(&mut self) {
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
    pub(super) fn remove_twins(&mut self) {
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
                    what: format!(
                        "is the plane of facet {} of line {} and is not cut again",
                        twin.name, twin.line
                    ),
                    remedy: "remove it".to_string(),
                    facet: Some(facet.name),
                }),
                None => kept.push(facet),
            }
        }
        self.facets = kept;
    }

    pub(super) fn check_sides(&self, problems: &mut Problems) {
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
            if !stated.iter().any(|it| it.before == *next) {
                let facet = &self.facets[*next];
                let what = "is on the other side of the girdle, and no transfer is before it";
                let remedy = "add a row `transfer` before it";
                problems.report(facet.line, Some(&facet.name), what, remedy);
            }
        }
        for it in stated.iter().filter(|it| !transfers.contains(&it.before)) {
            let what = "the transfer is not between two sides of the girdle";
            problems.report(it.line, None, what, "remove it, or move it");
        }
    }

    /// Number of the first facet behind the transfer; `None` if all are cut from one side.
    #[must_use]
    pub fn first_after_transfer(&self) -> Option<usize> {
        (1..self.facets.len()).find(|next| self.facets[*next].side != self.facets[next - 1].side)
    }
}
