//! A convex polyhedron that planes cut: a gem, and the stone that becomes one.
//!
//! The polyhedron is kept by its faces and its vertices, in f64. [`Polyhedron::cut`] removes what
//! is beyond a plane. A vertex within [`Polyhedron::tolerance`] of the plane counts as on it, so
//! facets that meet in a point keep one vertex there. The faces stay planar and the surface stays
//! closed: faces share vertices by index, and the new face gets the vertices on the plane in order
//! of their angle, which is right for a convex body.

use crate::vector::{Vector, cross, dot, length, minus, plus, times};

/// A plane with a unit normal; the body is on the side `normal . x <= distance`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Unit vector, out of the body.
    pub normal: Vector,
    /// Distance from the origin along the normal, mm; negative where the origin is outside.
    pub distance: f64,
}

impl Plane {
    /// Signed distance of a point, mm; positive outside.
    #[must_use]
    pub fn height(&self, point: Vector) -> f64 {
        dot(self.normal, point) - self.distance
    }
}

/// A face.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// Plane of the face.
    pub plane: Plane,
    /// Indices of the vertices, counter-clockwise as seen from outside.
    pub ring: Vec<usize>,
    /// Number that the caller gave the cut.
    pub tag: usize,
}

/// A convex polyhedron, possibly empty.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyhedron {
    vertices: Vec<Vector>,
    faces: Vec<Face>,
    tolerance: f64,
}

/// Result of a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cut {
    /// The plane misses the body.
    Missed,
    /// The plane made a face.
    Cut,
    /// Nothing is left.
    Nothing,
}

/// Two unit vectors that make a right-handed frame with a unit vector.
#[must_use]
pub fn across(normal: Vector) -> [Vector; 2] {
    let min = (0..3)
        .min_by(|a, b| normal[*a].abs().total_cmp(&normal[*b].abs()))
        .unwrap_or(0);
    let mut axis = [0.0; 3];
    axis[min] = 1.0;
    let first = cross(normal, axis);
    let first = times(first, 1.0 / length(first));
    [first, cross(normal, first)]
}

impl Polyhedron {
    /// A block with these corners and one tag on all six faces. Cuts of less than 1e-9 of its size
    /// count as missed.
    #[must_use]
    pub fn block(low: Vector, high: Vector, tag: usize) -> Self {
        let corner = |i: usize| {
            core::array::from_fn(|axis| {
                if i >> axis & 1 == 1 {
                    high[axis]
                } else {
                    low[axis]
                }
            })
        };
        let face = |axis: usize, positive: bool, ring: [usize; 4]| {
            let mut normal = [0.0; 3];
            normal[axis] = if positive { 1.0 } else { -1.0 };
            let distance = if positive { high[axis] } else { -low[axis] };
            Face {
                plane: Plane { normal, distance },
                ring: ring.to_vec(),
                tag,
            }
        };
        Self {
            vertices: (0..8).map(corner).collect(),
            faces: vec![
                face(0, false, [0, 4, 6, 2]),
                face(0, true, [1, 3, 7, 5]),
                face(1, false, [0, 1, 5, 4]),
                face(1, true, [2, 6, 7, 3]),
                face(2, false, [0, 2, 3, 1]),
                face(2, true, [4, 5, 7, 6]),
            ],
            tolerance: 1e-9 * length(minus(high, low)),
        }
    }

    /// An upright prism about the z axis with this many sides, between two heights. Its sides touch
    /// a cylinder of this diameter from outside.
    #[must_use]
    pub fn prism(sides: usize, diameter: f64, heights: [f64; 2], tag: usize) -> Self {
        let reach = diameter;
        let mut body = Self::block(
            [-reach, -reach, heights[0]],
            [reach, reach, heights[1]],
            tag,
        );
        for side in 0..sides {
            let (y, x) = libm::sincos(core::f64::consts::TAU * side as f64 / sides as f64);
            let plane = Plane {
                normal: [x, y, 0.0],
                distance: 0.5 * diameter,
            };
            body.cut(plane, tag);
        }
        body
    }

    /// Distance within which a vertex counts as on a plane, mm.
    #[must_use]
    pub const fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Vertices.
    #[must_use]
    pub fn vertices(&self) -> &[Vector] {
        &self.vertices
    }

    /// Faces.
    #[must_use]
    pub fn faces(&self) -> &[Face] {
        &self.faces
    }

    /// Whether nothing is left.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// The largest distance of the body from a plane through the origin, along a direction;
    /// negative infinity for an empty body.
    #[must_use]
    pub fn reach(&self, direction: Vector) -> f64 {
        self.vertices
            .iter()
            .map(|vertex| dot(*vertex, direction))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// Removes what is beyond a plane, and gives the new face a tag.
    pub fn cut(&mut self, plane: Plane, tag: usize) -> Cut {
        let heights: Vec<f64> = self.vertices.iter().map(|at| plane.height(*at)).collect();
        let outside = |index: usize| heights[index] > self.tolerance;
        let inside = |index: usize| heights[index] < -self.tolerance;
        if !(0..heights.len()).any(outside) {
            return Cut::Missed;
        }
        if !(0..heights.len()).any(inside) {
            self.vertices.clear();
            self.faces.clear();
            return Cut::Nothing;
        }
        // Vertices where an edge passes the plane, by the edge: both of its faces share them.
        let mut made: Vec<((usize, usize), usize)> = Vec::new();
        let mut vertices = self.vertices.clone();
        let mut faces = Vec::with_capacity(self.faces.len() + 1);
        let mut on_plane: Vec<usize> = Vec::new();
        for face in &self.faces {
            let mut ring = Vec::with_capacity(face.ring.len() + 1);
            for (place, &a) in face.ring.iter().enumerate() {
                let b = face.ring[(place + 1) % face.ring.len()];
                if !outside(a) {
                    ring.push(a);
                }
                if (outside(a) && inside(b)) || (inside(a) && outside(b)) {
                    let edge = (a.min(b), a.max(b));
                    let known = made.iter().find(|(of, _)| *of == edge);
                    let at = known.map_or(vertices.len(), |(_, at)| *at);
                    if at == vertices.len() {
                        // The same order of the ends gives the same bits.
                        let (a, b) = edge;
                        let part = heights[a] / (heights[a] - heights[b]);
                        let way = minus(self.vertices[b], self.vertices[a]);
                        vertices.push(plus(self.vertices[a], times(way, part)));
                        made.push((edge, at));
                    }
                    ring.push(at);
                }
            }
            let is_cut = |index: &usize| *index >= heights.len() || !inside(*index);
            // A face that only touches the plane has no inner vertex left.
            if ring.len() < 3 || ring.iter().all(is_cut) {
                continue;
            }
            on_plane.extend(ring.iter().copied().filter(|index| is_cut(index)));
            faces.push(Face {
                ring,
                ..face.clone()
            });
        }
        on_plane.sort_unstable();
        on_plane.dedup();
        if on_plane.len() >= 3 {
            faces.push(Face {
                ring: ordered(&vertices, on_plane, plane.normal),
                plane,
                tag,
            });
        }
        self.vertices = vertices;
        self.faces = faces;
        self.forget_unused();
        Cut::Cut
    }

    /// Removes vertices that no face has.
    fn forget_unused(&mut self) {
        let mut places = vec![usize::MAX; self.vertices.len()];
        let mut kept = Vec::new();
        for face in &mut self.faces {
            for index in &mut face.ring {
                if places[*index] == usize::MAX {
                    places[*index] = kept.len();
                    kept.push(self.vertices[*index]);
                }
                *index = places[*index];
            }
        }
        self.vertices = kept;
    }

    /// Corners of a face, in the order of its ring.
    pub fn corners<'a>(&'a self, face: &'a Face) -> impl Iterator<Item = Vector> + 'a {
        face.ring.iter().map(|index| self.vertices[*index])
    }

    /// Area of a face, mm^2.
    #[must_use]
    pub fn area(&self, face: &Face) -> f64 {
        let corners: Vec<Vector> = self.corners(face).collect();
        0.5 * dot(area_vector(&corners), face.plane.normal)
    }

    /// Volume, mm^3.
    #[must_use]
    pub fn volume(&self) -> f64 {
        let mut six = 0.0;
        for face in &self.faces {
            let corners: Vec<Vector> = self.corners(face).collect();
            for pair in corners.windows(2).skip(1) {
                six += dot(corners[0], cross(pair[0], pair[1]));
            }
        }
        six / 6.0
    }

    /// Corners of the section by a plane, in order; empty where the plane misses the body.
    #[must_use]
    pub fn section(&self, plane: &Plane) -> Vec<Vector> {
        let mut corners: Vec<Vector> = Vec::new();
        let heights: Vec<f64> = self.vertices.iter().map(|at| plane.height(*at)).collect();
        for face in &self.faces {
            for (place, &a) in face.ring.iter().enumerate() {
                let b = face.ring[(place + 1) % face.ring.len()];
                // Each edge is in two faces, once in each direction.
                if a < b && (heights[a] > 0.0) != (heights[b] > 0.0) {
                    let part = heights[a] / (heights[a] - heights[b]);
                    let way = minus(self.vertices[b], self.vertices[a]);
                    corners.push(plus(self.vertices[a], times(way, part)));
                }
            }
        }
        let indices = (0..corners.len()).collect();
        ordered(&corners, indices, plane.normal)
            .into_iter()
            .map(|index| corners[index])
            .collect()
    }

    /// The body after a rigid motion: axes are the images of x, y and z.
    #[must_use]
    pub fn moved(&self, axes: &[Vector; 3], by: Vector) -> Self {
        let turn = |v: Vector| {
            let [x, y, z] = [0, 1, 2].map(|i| times(axes[i], v[i]));
            plus(plus(x, y), z)
        };
        let faces = self.faces.iter().map(|face| {
            let normal = turn(face.plane.normal);
            let distance = face.plane.distance + dot(normal, by);
            Face {
                plane: Plane { normal, distance },
                ..face.clone()
            }
        });
        Self {
            vertices: self.vertices.iter().map(|at| plus(turn(*at), by)).collect(),
            faces: faces.collect(),
            tolerance: self.tolerance,
        }
    }
}

/// Sum of the cross products around a ring: twice its area, along its normal.
#[must_use]
pub fn area_vector(corners: &[Vector]) -> Vector {
    let Some(first) = corners.first() else {
        return [0.0; 3];
    };
    corners.windows(2).skip(1).fold([0.0; 3], |sum, pair| {
        plus(sum, cross(minus(pair[0], *first), minus(pair[1], *first)))
    })
}

/// Indices of points of a plane in the order of their angle about their middle.
fn ordered(points: &[Vector], indices: Vec<usize>, normal: Vector) -> Vec<usize> {
    let count = indices.len().max(1) as f64;
    let sum = indices
        .iter()
        .fold([0.0; 3], |sum, index| plus(sum, points[*index]));
    let middle = times(sum, 1.0 / count);
    let [u, v] = across(normal);
    let mut keyed: Vec<(f64, usize)> = indices
        .into_iter()
        .map(|index| {
            let away = minus(points[index], middle);
            (libm::atan2(dot(away, v), dot(away, u)), index)
        })
        .collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0));
    keyed.into_iter().map(|(_, index)| index).collect()
}
