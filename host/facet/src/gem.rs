//! The gem of a design: the design cut out of its rough.

use crate::design::{Design, Facet, Stage};
use crate::problem::{Problems, Refused};
use haptimill_hil_sim::polyhedron::{Cut, Face, Plane, Polyhedron};
use haptimill_hil_sim::vector::{Vector, cross, dot, length, minus, plus, times};
use std::collections::BTreeMap;

/// Tag of the faces of the rough.
pub const ROUGH: usize = usize::MAX;

/// Vertices nearer than this are one meet point, mm: the bound of a meet point of a good stone.
/// Designs are written with five to eight decimals, which alone move a vertex by some micrometres
/// where facets meet at shallow angles; and a stone whose depths are off by a few has other short
/// edges there.
pub const MEET_MM: f64 = 0.02;

/// A face of a preform that is no larger is a rounding of the distances of the design, mm^2.
const MIN_AREA_MM2: f64 = 1e-3;

/// The stone before it is cut: a round preform about the spin axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rough {
    /// Diameter, mm.
    pub diameter_mm: f64,
    /// Height, mm.
    pub height_mm: f64,
}

/// A point in which facets of the gem meet.
#[derive(Debug, Clone, PartialEq)]
pub struct MeetPoint {
    /// Position, the mean of its vertices, mm.
    pub at: Vector,
    /// Vertices of the gem that are this point, mm.
    pub vertices: Vec<Vector>,
    /// Numbers of its facets.
    pub facets: Vec<usize>,
    /// Largest displacement of the point, mm, when each facet is off by at most 1 mm in depth. It
    /// is large where facets meet at shallow angles.
    pub gain: f64,
}

/// A design cut out of its rough, in mm.
#[derive(Debug, Clone)]
pub struct Gem {
    /// Name of the file of the design, for messages.
    pub file: String,
    /// The design.
    pub design: Design,
    /// Millimetres of a unit of the design.
    pub scale_mm: f64,
    /// The rough.
    pub rough: Rough,
    /// Height of the middle of the rough in the frame of the design, mm.
    pub rough_middle_mm: f64,
    /// The finished stone; the tag of a face is the number of its facet.
    pub body: Polyhedron,
    /// Meet points.
    pub meets: Vec<MeetPoint>,
}

/// Facets of a meet point whose triples give its gain. No stone of a cutter has more; of more in
/// one point these many are taken, evenly. The triples of 1899 facets take minutes.
const GAIN_FACETS: usize = 128;

/// Sides of the rough.
const SIDES: usize = 64;

/// Part of the size by which the rough is larger where it is not given.
const ALLOWANCE: f64 = 1.08;

/// Size of the rough in which facets that are not on the stone are looked for, as a part of the
/// stone's.
const TRIAL: f64 = 3.0;

/// Most cuts of a design that is cut once without each of its lines.
const TRIAL_CUTS: usize = 20_000;

/// Remedy for a facet that another one cuts away.
const EITHER: &str = "check both distances, remove one of them, or name it preform";

/// The design cut without the facets of one line, as often as that is asked for.
struct Trials {
    /// The rough.
    block: Polyhedron,
    /// Areas of the facets that stay without those of a line, by number, mm^2.
    kept: BTreeMap<Option<usize>, BTreeMap<usize, f64>>,
}

impl Trials {
    /// The facets that stay on the stone without the facets of a line.
    fn kept(&mut self, gem: &Gem, without: Option<usize>) -> &BTreeMap<usize, f64> {
        self.kept.entry(without).or_insert_with(|| {
            let mut body = self.block.clone();
            for (number, facet) in gem.design.facets.iter().enumerate() {
                if Some(facet.line) != without {
                    body.cut(gem.plane(number), number);
                }
            }
            let faces = body.faces().iter();
            faces.map(|face| (face.tag, body.area(face))).collect()
        })
    }

    /// Whether a facet stays on the stone that is cut whole.
    fn keeps(&mut self, gem: &Gem, number: usize) -> bool {
        self.kept(gem, None).contains_key(&number)
    }

    /// The facet that cuts another one away: without the facets of its line the other one stays. A
    /// lost facet may stay without one of several lines; then the line is at fault without which
    /// most lost facets stay, or, of equal ones, that without which this one is largest. Of its
    /// facets the one that is nearest to the lost one.
    fn culprit<'g>(&mut self, gem: &'g Gem, lost: usize) -> Option<&'g Facet> {
        let facets = &gem.design.facets;
        let mut lines: Vec<usize> = facets.iter().map(|facet| facet.line).collect();
        lines.dedup();
        let own = facets[lost].line;
        if lines.len() * facets.len() > TRIAL_CUTS || self.keeps(gem, lost) {
            return None;
        }
        let whole = self.kept(gem, None);
        let is_lost = |(number, facet): &(usize, &Facet)| {
            facet.stage != Stage::Preform && !whole.contains_key(number)
        };
        let all_lost: Vec<usize> = facets
            .iter()
            .enumerate()
            .filter(is_lost)
            .map(|it| it.0)
            .collect();
        let mut best: Option<(usize, f64, usize)> = None;
        for line in lines.into_iter().filter(|line| *line != own) {
            let kept = self.kept(gem, Some(line));
            let Some(&area) = kept.get(&lost) else {
                continue;
            };
            let count = all_lost
                .iter()
                .filter(|other| kept.contains_key(other))
                .count();
            if best.is_none_or(|(max, largest, _)| (count, area) > (max, largest)) {
                best = Some((count, area, line));
            }
        }
        let (_, _, line) = best?;
        let normal = gem.design.normal(&facets[lost]);
        let near = |facet: &&Facet| dot(gem.design.normal(facet), normal);
        let of_line = facets.iter().filter(|facet| facet.line == line);
        of_line.max_by(|a, b| near(a).total_cmp(&near(b)))
    }
}

impl Gem {
    /// Cuts a design of this width, mm, out of its rough. A list in mm has its own size. Without a
    /// rough it is a little larger than the stone.
    ///
    /// # Errors
    /// Every facet that cannot be cut, by line and name.
    pub fn new(
        file: &str,
        design: Design,
        width_mm: f64,
        rough: Option<Rough>,
    ) -> Result<Self, Refused> {
        let mut problems = Problems::new(file);
        let gem = Self::cut(file, design, width_mm, rough, &mut problems);
        problems.finish(gem)
    }

    fn cut(
        file: &str,
        design: Design,
        width_mm: f64,
        rough: Option<Rough>,
        problems: &mut Problems,
    ) -> Option<Self> {
        let max = design
            .facets
            .iter()
            .map(|facet| facet.distance.abs())
            .fold(1e-3, f64::max);
        let reach = 100.0 * max;
        let mut ideal = Polyhedron::block([-reach; 3], [reach; 3], ROUGH);
        for (number, facet) in design.facets.iter().enumerate() {
            ideal.cut(design.plane(facet), number);
        }
        if ideal.is_empty() {
            let what = "the facets leave nothing of the stone";
            problems.report(
                0,
                None,
                what,
                "check the distances; all are from one origin",
            );
            return None;
        }
        if ideal.faces().iter().any(|face| face.tag == ROUGH) {
            let what = "the facets do not close the stone";
            problems.report(
                0,
                None,
                what,
                "add the facets that are missing, often table or girdle",
            );
            return None;
        }
        let ends =
            |direction: Vector| [-ideal.reach(times(direction, -1.0)), ideal.reach(direction)];
        let [left, right] = ends([1.0, 0.0, 0.0]);
        let [front, back] = ends([0.0, 1.0, 0.0]);
        let scale_mm = if design.is_in_mm {
            1.0
        } else {
            width_mm / (right - left).min(back - front)
        };
        let [low, high] = ends([0.0, 0.0, 1.0]).map(|end| end * scale_mm);
        let widest = ideal
            .vertices()
            .iter()
            .map(|at| scale_mm * libm::hypot(at[0], at[1]))
            .fold(0.0, f64::max);
        let given = rough.is_some();
        let rough = rough.unwrap_or(Rough {
            diameter_mm: 2.0 * widest * ALLOWANCE,
            height_mm: (high - low) * ALLOWANCE,
        });
        let mut gem = Self {
            file: file.to_string(),
            design,
            scale_mm,
            rough,
            rough_middle_mm: 0.5 * (low + high),
            body: Polyhedron::block([-1.0; 3], [1.0; 3], ROUGH),
            meets: Vec::new(),
        };
        gem.body = gem.rough_body();
        let trial = Rough {
            diameter_mm: (2.0 * widest * TRIAL).max(rough.diameter_mm),
            height_mm: ((high - low) * TRIAL).max(rough.height_mm),
        };
        gem.cut_facets(trial, problems);
        let left = gem.body.faces().iter().any(|face| face.tag == ROUGH);
        if left && !gem.body.is_empty() {
            let what = format!(
                "the design is larger than the rough: it is {:.3} mm wide and {:.3} mm high, the \
                 rough {:.3} x {:.3} mm",
                2.0 * widest,
                high - low,
                rough.diameter_mm,
                rough.height_mm
            );
            let remedy = if given {
                "take a larger rough, or a smaller --width"
            } else {
                "check the distances of the facets"
            };
            problems.report(0, None, what, remedy);
        }
        gem.keep_preforms();
        gem.meets = meet_points(&gem.body);
        Some(gem)
    }

    /// Preforms that stay on the stone are facets of it.
    fn keep_preforms(&mut self) {
        let stays = |face: &&Face| {
            let facet = self.design.facets.get(face.tag);
            facet.is_some_and(|facet| facet.stage == Stage::Preform)
                && self.body.area(face) > MIN_AREA_MM2
        };
        let stay: Vec<usize> = self
            .body
            .faces()
            .iter()
            .filter(stays)
            .map(|it| it.tag)
            .collect();
        self.design.keep_preforms(stay);
    }

    /// The rough in the frame of the design.
    #[must_use]
    pub fn rough_body(&self) -> Polyhedron {
        self.body_of(self.rough)
    }

    fn body_of(&self, rough: Rough) -> Polyhedron {
        let half = 0.5 * rough.height_mm;
        let heights = [self.rough_middle_mm - half, self.rough_middle_mm + half];
        Polyhedron::prism(SIDES, rough.diameter_mm, heights, ROUGH)
    }

    /// Cuts the facets in their order, and reports those that cannot be cut.
    /// Why a facet is not on the stone is found with a larger rough.
    fn cut_facets(&mut self, trial: Rough, problems: &mut Problems) {
        let mut trials = Trials {
            block: self.body_of(trial),
            kept: BTreeMap::new(),
        };
        let wholly = |by: &Facet| {
            format!(
                "is wholly cut away by facet {} of line {}",
                by.name, by.line
            )
        };
        for (number, facet) in self.design.facets.iter().enumerate() {
            let plane = plane_mm(&self.design, facet, self.scale_mm);
            let before: Vec<usize> = self.body.faces().iter().map(|face| face.tag).collect();
            match self.body.cut(plane, number) {
                Cut::Cut => {}
                Cut::Missed => {
                    let mut remedy = "lower its distance, or remove it";
                    let what = if let Some(twin) = self.twin(facet, number) {
                        format!("is the plane of facet {} of line {}", twin.name, twin.line)
                    } else if let Some(by) = trials.culprit(self, number) {
                        remedy = EITHER;
                        wholly(by)
                    } else if trials.keeps(self, number) {
                        // The rough does not reach there: it is too small, and reported.
                        continue;
                    } else {
                        "the plane misses the stone".to_string()
                    };
                    problems.report(facet.line, Some(&facet.name), what, remedy);
                    continue;
                }
                Cut::Nothing => {
                    let what = "the plane cuts the whole stone away";
                    problems.report(facet.line, Some(&facet.name), what, "raise its distance");
                    return;
                }
            }
            let after = |tag: usize| self.body.faces().iter().any(|face| face.tag == tag);
            for gone in before
                .into_iter()
                .filter(|tag| *tag != ROUGH && !after(*tag))
            {
                let lost = &self.design.facets[gone];
                if lost.stage == Stage::Preform {
                    continue;
                }
                let what = wholly(trials.culprit(self, gone).unwrap_or(facet));
                problems.report(lost.line, Some(&lost.name), what, EITHER);
            }
        }
    }

    /// An earlier facet of the same plane.
    fn twin(&self, facet: &Facet, number: usize) -> Option<&Facet> {
        let normal = self.design.normal(facet);
        self.design.facets[..number].iter().find(|other| {
            length(minus(self.design.normal(other), normal)) < 1e-7
                && (other.distance - facet.distance).abs() < 1e-7
        })
    }

    /// Plane of a facet, mm.
    #[must_use]
    pub fn plane(&self, number: usize) -> Plane {
        plane_mm(&self.design, &self.design.facets[number], self.scale_mm)
    }

    /// `file:line: facet NAME`, the place of a facet in messages.
    #[must_use]
    pub fn place(&self, number: usize) -> String {
        let facet = &self.design.facets[number];
        format!("{}:{}: facet {}", self.file, facet.line, facet.name)
    }

    /// Part of the rough that becomes the stone.
    #[must_use]
    pub fn yield_part(&self) -> f64 {
        self.body.volume() / self.rough_body().volume()
    }
}

fn plane_mm(design: &Design, facet: &Facet, scale_mm: f64) -> Plane {
    let plane = design.plane(facet);
    Plane {
        distance: plane.distance * scale_mm,
        ..plane
    }
}

/// The meet points of a body: its vertices, where those that are chained by short distances are one
/// point.
fn meet_points(body: &Polyhedron) -> Vec<MeetPoint> {
    let mut points: Vec<MeetPoint> = Vec::new();
    for (index, at) in body.vertices().iter().enumerate() {
        let facets = body
            .faces()
            .iter()
            .filter(|face| face.ring.contains(&index));
        let mut point = MeetPoint {
            at: *at,
            vertices: vec![*at],
            facets: facets.map(|face| face.tag).collect(),
            gain: 0.0,
        };
        // Joins all points that the vertex connects.
        let (near, far): (Vec<_>, Vec<_>) = points.into_iter().partition(|other| {
            let mut vertices = other.vertices.iter();
            vertices.any(|other| length(minus(*other, *at)) < MEET_MM)
        });
        for other in near {
            point.vertices.extend(other.vertices);
            point.facets.extend(other.facets);
        }
        points = far;
        points.push(point);
    }
    for point in &mut points {
        let sum = point
            .vertices
            .iter()
            .fold([0.0; 3], |sum, at| plus(sum, *at));
        point.at = times(sum, 1.0 / point.vertices.len() as f64);
    }
    for point in &mut points {
        point.facets.sort_unstable();
        point.facets.dedup();
        point.gain = gain(body, &point.facets);
    }
    points
}

/// Largest displacement of a vertex of three of these facets when each is off by 1 in depth.
///
/// A triple counts if its vertex can appear on the stone: three facets that are off become a vertex
/// when the other facets of the point lie a little deeper. Every triple of the point can, so the
/// largest of all triples is the bound. Of more than [`GAIN_FACETS`] facets these many are taken.
fn gain(body: &Polyhedron, facets: &[usize]) -> f64 {
    let count = facets.len().min(GAIN_FACETS);
    let normals: Vec<Vector> = (0..count)
        .map(|number| facets[number * facets.len() / count])
        .filter_map(|tag| body.faces().iter().find(|face| face.tag == tag))
        .map(|face| face.plane.normal)
        .collect();
    let mut max = 0.0_f64;
    for (i, a) in normals.iter().enumerate() {
        for (j, b) in normals.iter().enumerate().skip(i + 1) {
            for c in &normals[j + 1..] {
                let columns = [cross(*b, *c), cross(*c, *a), cross(*a, *b)];
                let volume = dot(*a, columns[0]);
                // Planes through one line have no point of their own.
                if volume.abs() < 1e-3 {
                    continue;
                }
                for signs in 0..4 {
                    let sign = |i: usize| if signs >> i & 1 == 1 { -1.0 } else { 1.0 };
                    let sum = plus(
                        times(columns[0], sign(0)),
                        plus(times(columns[1], sign(1)), columns[2]),
                    );
                    max = max.max(length(sum) / volume.abs());
                }
            }
        }
    }
    max
}
