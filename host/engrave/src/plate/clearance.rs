//! Clearance of a tool between contours, finer than the grid of a plate.

use super::Plate;
use crate::curves::distance_to_segment;
use crate::geometry::{Path, Point, Segment};
use cavalier_contours::static_aabb2d_index::{StaticAABB2DIndex, StaticAABB2DIndexBuilder};

/// Points along a side of a cell at which the clearance is measured.
const FINER: usize = 8;

/// Least clearance that counts, cells. With [`FINER`] a slot that is a quarter
/// of a cell wider than the tool has such a point in each row of cells.
const MARGIN: f64 = 1.0 / 20.0;

/// Cells around a point of much clearance in which no other is looked for.
const KNOWN: f64 = 2.0;

/// Contours, for distances from them.
struct Contours {
    segments: Vec<Segment>,
    index: Option<StaticAABB2DIndex<f64>>,
}

impl Contours {
    fn of(paths: &[Path]) -> Self {
        let closed = paths.iter().filter(|path| path.closed);
        let segments: Vec<Segment> = closed.flat_map(Path::segments).collect();
        let mut builder = StaticAABB2DIndexBuilder::new(segments.len());
        for [low, high] in segments.iter().map(Segment::bounds) {
            builder.add(low[0], low[1], high[0], high[1]);
        }
        let index = builder.build().ok();
        Self { segments, index }
    }

    /// Whether no contour is nearer to a point than `limit`, mm.
    fn are_beyond(&self, at: Point, limit: f64) -> bool {
        let Some(index) = &self.index else {
            return false;
        };
        let (low, high) = (at.map(|one| one - limit), at.map(|one| one + limit));
        let near = index.query(low[0], low[1], high[0], high[1]);
        let off = |index: usize| distance_to_segment(at, &self.segments[index]);
        near.into_iter().all(|index| off(index) >= limit)
    }
}

/// Where the centre of a tool may be.
pub(super) struct Clearance {
    /// Points with a clearance of more than a cell: the grid resolves it.
    pub wide: Vec<bool>,
    /// Points with less, in slots that are little wider than the tool: within half a cell of
    /// the tool's centre.
    pub narrow: Vec<bool>,
}

impl Plate {
    /// Where a tool has clearance in `inside`, whose borders are the closed ones of these paths.
    /// `off` are the distances of the points from the rest.
    pub(super) fn clearance(
        &self,
        inside: &[bool],
        off: &[f64],
        paths: &[Path],
        radius: f64,
    ) -> Clearance {
        let wide: Vec<bool> = off.iter().map(|off| *off > radius + self.cell).collect();
        let to_wide = self.distances(&wide);
        let contours = Contours::of(paths);
        let limit = radius + MARGIN * self.cell;
        let finer = |place: usize| ((place as f64 + 0.5) / FINER as f64 - 0.5) * self.cell;
        let is_narrow = |slot: usize| {
            let [x, y] = self.at(slot % self.columns, slot / self.columns);
            let mut all = (0..FINER).flat_map(|column| (0..FINER).map(move |row| (column, row)));
            all.any(|(column, row)| contours.are_beyond([x + finer(column), y + finer(row)], limit))
        };
        // By the grid a point is at most a cell farther from the rest than it is.
        let narrow = (0..inside.len()).map(|slot| {
            inside[slot]
                && off[slot] > radius - self.cell
                && to_wide[slot] > KNOWN * self.cell
                && is_narrow(slot)
        });
        Clearance {
            narrow: narrow.collect(),
            wide,
        }
    }
}
