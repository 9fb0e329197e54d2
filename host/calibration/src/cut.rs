//! The test piece, cut in the simulator and measured by a virtual coordinate measuring machine.

use crate::noise::Noise;
use crate::observed::Sample;
use haptimill_client::{Error, ErrorKind};
use haptimill_volumetric::Vector;
use haptimill_volumetric::part::{Features, ProbePoint, Row, characteristics, probe_points};

/// The part program.
pub const PROGRAM: &str = include_str!("../../../examples/a160.ngc");

/// Largest distance of a programmed tool centre from the nominal one of a probe point, mm: the
/// chord of an arc between two samples.
const NEAR: f64 = 0.02;

/// The surface points of the part that the tool cut, at the points that are probed.
///
/// The last pass of the tool at a point counts. Between two samples the tool moves straight.
///
/// # Errors
/// The program does not cut a feature.
pub fn surface(samples: &[Sample]) -> Result<Features<Vector>, Error> {
    let grid = Grid::new(samples, commanded);
    find(|point| cut_at(samples, &grid, point))
}

/// As [`surface`], from the positions of the tool alone: for a program whose points are not those
/// of the part. The deepest pass of the tool at a point counts. Between two samples the tool moves
/// straight, so samples must be close.
///
/// # Errors
/// The program does not cut a feature.
pub fn surface_of_path(samples: &[Sample]) -> Result<Features<Vector>, Error> {
    let grid = Grid::new(samples, tool);
    find(|point| deepest_at(samples, &grid, point))
}

fn find(cut_at: impl Fn(&ProbePoint) -> Option<Vector>) -> Result<Features<Vector>, Error> {
    let nominal = probe_points();
    let mut missing = None;
    let points = nominal.map(|point| {
        cut_at(point).unwrap_or_else(|| {
            missing.get_or_insert(*point);
            Vector::zeros()
        })
    });
    match missing {
        None => Ok(points),
        Some(point) => {
            let place = point.surface;
            let what = format!(
                "the program cuts nothing at x = {:.1}, y = {:.1}, z = {:.1}: add the pass that \
                 cuts this surface of the test piece",
                place.x, place.y, place.z
            );
            Err(Error::new(ErrorKind::BadInput, what))
        }
    }
}

/// Samples by cells of 5 mm, so that those near a point are found at once.
struct Grid(std::collections::HashMap<[i32; 3], Vec<usize>>);

const CELL: f64 = 5.0;

fn cell(place: Vector) -> [i32; 3] {
    [place.x, place.y, place.z].map(|part| (part / CELL).floor() as i32)
}

fn commanded(sample: &Sample) -> Vector {
    Vector::new(
        sample.commanded[0],
        sample.commanded[1],
        sample.commanded[2],
    )
}

fn tool(sample: &Sample) -> Vector {
    Vector::new(sample.tool[0], sample.tool[1], sample.tool[2])
}

fn error(sample: &Sample) -> Vector {
    tool(sample) - commanded(sample)
}

impl Grid {
    fn new(samples: &[Sample], path: fn(&Sample) -> Vector) -> Self {
        let mut cells: std::collections::HashMap<_, Vec<usize>> = Default::default();
        for (index, sample) in samples.iter().enumerate() {
            cells.entry(cell(path(sample))).or_default().push(index);
        }
        Self(cells)
    }

    fn near(&self, place: Vector) -> impl Iterator<Item = usize> + '_ {
        let [x, y, z] = cell(place);
        let offsets = (-1..=1).flat_map(move |dx| {
            (-1..=1).flat_map(move |dy| (-1..=1).map(move |dz| [x + dx, y + dy, z + dz]))
        });
        offsets
            .filter_map(|cell| self.0.get(&cell))
            .flatten()
            .copied()
    }
}

/// Where the tool centre was when it should have been at the nominal point, as the surface point.
fn cut_at(samples: &[Sample], grid: &Grid, point: &ProbePoint) -> Option<Vector> {
    let centre = point.tool_centre();
    let mut best: Option<(f64, usize, Vector)> = None;
    for index in grid.near(centre) {
        let Some(next) = samples.get(index + 1) else {
            continue;
        };
        let here = &samples[index];
        let (part, nearest) = nearest(commanded(here), commanded(next), centre);
        let distance = (nearest - centre).norm();
        let (own, other) = (error(here), error(next));
        let reached = centre + own + (other - own) * part;
        let closer = best.as_ref().is_none_or(|(min, last, _)| {
            // The last pass counts among those at the point.
            distance < NEAR && (index > *last || *min >= NEAR) || distance < *min
        });
        if closer {
            best = Some((distance, index, reached));
        }
    }
    let (distance, _, reached) = best?;
    (distance < NEAR).then(|| point.cut_by(reached))
}

/// The part of a line from one point to another that is nearest to a place, and that point.
fn nearest(from: Vector, to: Vector, place: Vector) -> (f64, Vector) {
    let along = to - from;
    let length = along.norm_squared();
    let part = if length > 0.0 {
        ((place - from).dot(&along) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (part, from + along * part)
}

/// The deepest place of the tool centre at a nominal point, as the surface point.
fn deepest_at(samples: &[Sample], grid: &Grid, point: &ProbePoint) -> Option<Vector> {
    let centre = point.tool_centre();
    let height = |place: &Vector| (place - centre).dot(&point.normal);
    let passes = grid.near(centre).filter_map(|index| {
        let (_, place) = nearest(tool(&samples[index]), tool(samples.get(index + 1)?), centre);
        let beside = (place - centre - point.normal * height(&place)).norm();
        (beside < NEAR && height(&place).abs() < NEAR).then_some(place)
    });
    let deepest = passes.min_by(|a, b| height(a).total_cmp(&height(b)))?;
    Some(point.cut_by(deepest))
}

/// A coordinate measuring machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cmm {
    /// Standard deviation of a point along the normal of sides along x, and of all others, mm.
    pub noise: [f64; 2],
    /// Largest turn of a set-up, radians, and its largest shift, mm.
    pub set_up: (f64, f64),
    /// Runs, each in a set-up of its own.
    pub runs: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for Cmm {
    /// As found in the published tables: 0.455 um and 0.389 um, up to 0.3 degrees and 0.4 mm.
    fn default() -> Self {
        Self {
            noise: [0.455e-3, 0.389e-3],
            set_up: (0.3 * core::f64::consts::PI / 180.0, 0.4),
            runs: 3,
            seed: 1,
        }
    }
}

/// Limit of the probing error of the machine, MPE_P, mm.
pub const MPE_P: f64 = 1.9e-3;

/// Limit of the length error MPE_E of the machine at a length, mm.
#[must_use]
pub fn mpe_e(length: f64) -> f64 {
    1.9e-3 + 3e-6 * length
}

impl Cmm {
    /// A machine without noise, on a part that is set up exactly.
    #[must_use]
    pub const fn ideal() -> Self {
        Self {
            noise: [0.0; 2],
            set_up: (0.0, 0.0),
            runs: 1,
            seed: 0,
        }
    }

    /// Points of every run: the surface as it is set up, probed along the normals.
    #[must_use]
    pub fn probe(&self, surface: &Features<Vector>) -> Vec<Features<Vector>> {
        let nominal = probe_points();
        let runs = 0..self.runs as u64;
        runs.map(|run| {
            let mut noise = Noise::new(self.seed, 2000 + run);
            let turn = self.set_up.0 * noise.uniform();
            let shift = Vector::new(noise.uniform(), noise.uniform(), 0.0) * self.set_up.1;
            let mut normals = Vec::new();
            nominal.map(|point| normals.push(point.normal));
            let mut normals = normals.into_iter();
            let (sine, cosine) = turn.sin_cos();
            surface.map(|point| {
                let normal = normals.next().unwrap_or_default();
                let deviation = if normal.y.abs() > 0.999 {
                    self.noise[0]
                } else {
                    self.noise[1]
                };
                let read = point + normal * noise.normal(deviation);
                let turned = Vector::new(
                    cosine * read.x - sine * read.y,
                    sine * read.x + cosine * read.y,
                    read.z,
                );
                turned + shift
            })
        })
        .collect()
    }

    /// Mean of every characteristic over the runs.
    ///
    /// # Errors
    /// A feature without enough points.
    pub fn measure(&self, surface: &Features<Vector>) -> Result<Vec<Row>, Error> {
        let mut mean: Vec<Row> = Vec::new();
        let runs = self.probe(surface);
        let count = runs.len() as f64;
        for points in &runs {
            let rows = characteristics(points).map_err(|(feature, problem)| {
                Error::new(ErrorKind::BadInput, format!("{feature}: {problem}"))
            })?;
            if mean.is_empty() {
                mean = rows;
                continue;
            }
            for (mean, row) in mean.iter_mut().zip(rows) {
                mean.value += row.value;
                mean.zone = mean.zone.zip(row.zone).map(|(a, b)| a + b);
            }
        }
        for row in &mut mean {
            row.value /= count;
            row.zone = row.zone.map(|zone| zone / count);
        }
        Ok(mean)
    }
}
