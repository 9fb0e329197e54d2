//! The end of a file: whether it was cut off.

use super::Design;
use crate::problem::{Problem, Problems};

impl Design {
    /// Checks the end of a file: a file that was cut off has no line end there, lacks facets of its
    /// last tier, or lacks the table. Two of them are a problem.
    pub(crate) fn check_end(&mut self, text: &str, problems: &mut Problems) {
        let line = text.lines().count();
        let Some(last) = self.facets.last() else {
            return;
        };
        // A list may have a row for each facet of a tier.
        let (number, angle_deg, distance, side) =
            (last.tier, last.angle_deg, last.distance, last.side);
        let alone = self.without_partners(self.gear);
        let alone = alone.iter().map(|it| &self.facets[it.facet]).find(|facet| {
            facet.tier == number
                || (facet.angle_deg == angle_deg
                    && facet.distance == distance
                    && facet.side == side)
        });
        let has_end = text.ends_with('\n');
        let mut signs = Vec::new();
        if !has_end {
            signs.push("its last line has no line end".to_string());
        }
        if let Some(alone) = alone {
            let name = &alone.name;
            signs.push(format!("facet {name} has no partner in its last tier"));
        }
        if !self.has_table() {
            signs.push("it has no table".to_string());
        }
        if signs.len() > 1 {
            let what = format!("the file is cut off: {}", signs.join(", and "));
            let remedy = "take the whole file; if it is whole, end its last line and correct the \
                          symmetry that it states";
            problems.report(line, None, what, remedy);
        } else if !has_end {
            self.notices.push(Problem {
                line,
                facet: None,
                what: "the last line has no line end".to_string(),
                remedy: "check that the file is complete".to_string(),
            });
        }
    }
}
