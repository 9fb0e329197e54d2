//! The measured stone: facet by facet and point by point against the design.

use crate::design::Stage;
use crate::gem::{Gem, MEET_MM};
use crate::job::{angle_between, angles};
use haptimill_hil_sim::polyhedron::{Face, Polyhedron};
use haptimill_hil_sim::process::grinding::Ground;
use haptimill_hil_sim::vector::{Vector, length, minus};

/// A facet of the stone.
#[derive(Debug, Clone, PartialEq)]
pub struct FacetResult {
    /// Number of the facet.
    pub facet: usize,
    /// Angle between its normal and that of the design, degrees.
    pub error_deg: f64,
    /// Measured less designed angle, degrees.
    pub angle_deg: f64,
    /// Measured less designed azimuth, degrees; 0 for a facet of angle 0.
    pub azimuth_deg: f64,
    /// Measured less designed distance along the normal, mm.
    pub depth_mm: f64,
    /// Area, mm^2.
    pub area_mm2: f64,
    /// Height of a hard spot above it, mm.
    pub proud_mm: f64,
}

/// A meet point of the stone.
#[derive(Debug, Clone, PartialEq)]
pub struct MeetResult {
    /// Number of the point in the gem.
    pub meet: usize,
    /// Largest distance between the vertices of the point on the stone and on the gem, mm. If the
    /// stone has none: that of the nearest vertex that has two facets of the point, or of the
    /// nearest vertex. 0 if the stone has no vertex.
    pub error_mm: f64,
    /// The stone has a vertex whose facets are all of this point.
    pub is_found: bool,
}

/// A measured stone.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Facets that the stone has.
    pub facets: Vec<FacetResult>,
    /// Numbers of facets of the design that it lacks.
    pub missing: Vec<usize>,
    /// Faces that are no facet of the design: of the rough, or cut by mistake.
    pub strange: usize,
    /// Meet points.
    pub meets: Vec<MeetResult>,
    /// Volume, mm^3.
    pub volume_mm3: f64,
    /// Part of the rough that became the stone.
    pub yield_part: f64,
}

/// Largest angle between a facet of a good stone and its design, degrees. That of a meet point is
/// [`MEET_MM`].
pub const ANGLE_DEG: f64 = 0.02;

/// A face belongs to a facet whose normal is nearer than this, degrees.
const NEAR_DEG: f64 = 1.0;
/// And whose plane is nearer than this, mm.
const NEAR_MM: f64 = 0.2;

impl Measured {
    /// Measures a stone in the frame of the design.
    #[must_use]
    pub fn new(gem: &Gem, stone: &Polyhedron, ground: &[Ground]) -> Self {
        let mut facets: Vec<FacetResult> = Vec::new();
        let mut strange = 0;
        // The facet of each face.
        let owners: Vec<Option<usize>> =
            stone.faces().iter().map(|face| owner(gem, face)).collect();
        for (face, owner) in stone.faces().iter().zip(&owners) {
            let Some(facet) = *owner else {
                strange += 1;
                continue;
            };
            if facets.iter().any(|other| other.facet == facet) {
                strange += 1;
                continue;
            }
            let plane = gem.plane(facet);
            let [angle, azimuth] = angles(face.plane.normal);
            let [angle_then, azimuth_then] = angles(plane.normal);
            let turn = azimuth - azimuth_then;
            let is_flat = gem.design.facets[facet].angle_deg == 0.0;
            facets.push(FacetResult {
                facet,
                error_deg: angle_between(face.plane.normal, plane.normal),
                angle_deg: angle - angle_then,
                azimuth_deg: if is_flat {
                    0.0
                } else {
                    turn - 360.0 * libm::round(turn / 360.0)
                },
                depth_mm: depth(stone, face, &plane),
                area_mm2: stone.area(face),
                proud_mm: ground.get(face.tag).map_or(0.0, |ground| ground.proud_mm),
            });
        }
        facets.sort_by_key(|result| result.facet);
        let has = |facet: usize| facets.iter().any(|result| result.facet == facet);
        let mut missing: Vec<usize> = due(gem).filter(|facet| !has(*facet)).collect();
        missing.sort_unstable();
        let meets = (0..gem.meets.len())
            .map(|meet| meet_result(gem, meet, stone, &owners))
            .collect();
        Self {
            missing,
            strange,
            meets,
            volume_mm3: stone.volume(),
            yield_part: stone.volume() / gem.rough_body().volume(),
            facets,
        }
    }

    /// Whether the stone has the facets of the design, and no other faces.
    #[must_use]
    pub fn is_design(&self) -> bool {
        self.missing.is_empty() && self.strange == 0
    }

    /// The facet with the largest angle error and the meet point with the largest error, if they
    /// are beyond [`ANGLE_DEG`] and [`MEET_MM`]; `None` if both are within.
    #[must_use]
    pub fn beyond(&self, gem: &Gem) -> Option<String> {
        let name = |facet: &usize| gem.design.facets[*facet].name.as_str();
        let mut parts = Vec::new();
        let facets = self.facets.iter();
        let worst = facets.max_by(|a, b| a.error_deg.total_cmp(&b.error_deg));
        if let Some(worst) = worst.filter(|it| it.error_deg > ANGLE_DEG) {
            parts.push(format!(
                "the angle of facet {} is off by {:.4} deg, and {ANGLE_DEG} deg is the most",
                name(&worst.facet),
                worst.error_deg
            ));
        }
        let meets = self.meets.iter();
        let worst = meets.max_by(|a, b| a.error_mm.total_cmp(&b.error_mm));
        if let Some(worst) = worst.filter(|it| it.error_mm > MEET_MM) {
            let facets = gem.meets[worst.meet].facets.iter().map(name);
            parts.push(format!(
                "the meet point of {} is off by {:.4} mm, and {MEET_MM} mm is the most",
                facets.collect::<Vec<_>>().join(", "),
                worst.error_mm
            ));
        }
        (!parts.is_empty()).then(|| parts.join("; "))
    }

    /// Largest angle between a facet and its design, degrees.
    #[must_use]
    pub fn worst_angle_deg(&self) -> f64 {
        self.facets
            .iter()
            .map(|facet| facet.error_deg)
            .fold(0.0, f64::max)
    }

    /// Largest error of depth, mm.
    #[must_use]
    pub fn worst_depth_mm(&self) -> f64 {
        self.facets
            .iter()
            .map(|facet| facet.depth_mm.abs())
            .fold(0.0, f64::max)
    }

    /// Largest error of a meet point, mm; see [`MeetResult::error_mm`].
    #[must_use]
    pub fn worst_meet_mm(&self) -> f64 {
        self.meets.iter().map(|it| it.error_mm).fold(0.0, f64::max)
    }

    /// Numbers of the meet points of which the stone has no vertex.
    pub fn lost_meets(&self) -> impl Iterator<Item = usize> {
        self.meets
            .iter()
            .filter(|it| !it.is_found)
            .map(|it| it.meet)
    }
}

/// The facets that a stone must have: what is left of a preform is a rounding.
fn due(gem: &Gem) -> impl Iterator<Item = usize> {
    let goal = gem.body.faces().iter().map(|face| face.tag);
    goal.filter(|facet| gem.design.facets[*facet].stage != Stage::Preform)
}

/// The facet of the gem to which a face belongs.
fn owner(gem: &Gem, face: &Face) -> Option<usize> {
    let near = |tag: &usize| {
        let plane = gem.plane(*tag);
        let turn = angle_between(plane.normal, face.plane.normal);
        let away = (plane.distance - face.plane.distance).abs();
        (turn < NEAR_DEG && away < NEAR_MM).then_some(turn)
    };
    gem.body
        .faces()
        .iter()
        .map(|face| face.tag)
        .filter_map(|tag| near(&tag).map(|turn| (turn, tag)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, tag)| tag)
}

/// Mean height of the corners of a face above a plane, mm.
fn depth(stone: &Polyhedron, face: &Face, plane: &haptimill_hil_sim::polyhedron::Plane) -> f64 {
    let sum: f64 = stone.corners(face).map(|at| plane.height(at)).sum();
    sum / face.ring.len() as f64
}

/// Compares a meet point with the vertices of the stone between facets of the point only.
fn meet_result(gem: &Gem, meet: usize, stone: &Polyhedron, owners: &[Option<usize>]) -> MeetResult {
    let point = &gem.meets[meet];
    let nearest = |from: &Vector, to: &[Vector]| {
        let distances = to.iter().map(|at| length(minus(*at, *from)));
        distances.fold(f64::INFINITY, f64::min)
    };
    let mut own: Vec<Vector> = Vec::new();
    let mut shared: Vec<Vector> = Vec::new();
    for (index, at) in stone.vertices().iter().enumerate() {
        let around = stone.faces().iter().zip(owners);
        let around = around.filter(|(face, _)| face.ring.contains(&index));
        let (mut inside, mut outside) = (0, 0);
        for (_, owner) in around {
            match owner {
                Some(facet) if point.facets.contains(facet) => inside += 1,
                _ => outside += 1,
            }
        }
        if inside >= 2 {
            shared.push(*at);
        }
        if inside > 0 && outside == 0 {
            own.push(*at);
        }
    }
    let error_mm = if own.is_empty() {
        let from = if shared.is_empty() {
            stone.vertices()
        } else {
            &shared
        };
        let error = nearest(&point.at, from);
        if error.is_finite() { error } else { 0.0 }
    } else {
        let of_stone = own.iter().map(|at| nearest(at, &point.vertices));
        let of_gem = point.vertices.iter().map(|at| nearest(at, &own));
        of_stone.chain(of_gem).fold(0.0, f64::max)
    };
    MeetResult {
        meet,
        error_mm,
        is_found: !own.is_empty(),
    }
}
