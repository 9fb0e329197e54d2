//! The convex polyhedron, against the vertices of all triples of planes, and against volumes.

use haptimill_hil_sim::polyhedron::{Cut, Plane, Polyhedron};
use haptimill_hil_sim::vector::{Vector, cross, dot, length, minus, plus, times};
use proptest::prelude::*;

const ROUGH: usize = usize::MAX;

fn cube() -> Polyhedron {
    Polyhedron::block([-10.0; 3], [10.0; 3], ROUGH)
}

fn plane(normal: Vector, distance: f64) -> Plane {
    Plane {
        normal: times(normal, 1.0 / length(normal)),
        distance,
    }
}

/// Every point where three planes meet that no plane cuts away.
fn meets(planes: &[Plane]) -> Vec<Vector> {
    let mut points: Vec<Vector> = Vec::new();
    for (i, a) in planes.iter().enumerate() {
        for (j, b) in planes.iter().enumerate().skip(i + 1) {
            for c in &planes[j + 1..] {
                let bc = cross(b.normal, c.normal);
                let volume = dot(a.normal, bc);
                if volume.abs() < 1e-9 {
                    continue;
                }
                let ca = cross(c.normal, a.normal);
                let ab = cross(a.normal, b.normal);
                let sum = plus(
                    plus(times(bc, a.distance), times(ca, b.distance)),
                    times(ab, c.distance),
                );
                let point = times(sum, 1.0 / volume);
                let is_new = |at: &Vector| length(minus(*at, point)) > 1e-7;
                if planes.iter().all(|plane| plane.height(point) < 1e-8)
                    && points.iter().all(is_new)
                {
                    points.push(point);
                }
            }
        }
    }
    points
}

/// Panics unless the surface is closed, convex and planar.
fn check(body: &Polyhedron) {
    let mut edges: Vec<(usize, usize)> = Vec::new();
    for face in body.faces() {
        assert!(face.ring.len() >= 3);
        for (place, &a) in face.ring.iter().enumerate() {
            edges.push((a, face.ring[(place + 1) % face.ring.len()]));
        }
        for vertex in body.vertices() {
            assert!(face.plane.height(*vertex) < 1e-6);
        }
        for corner in body.corners(face) {
            assert!(face.plane.height(corner).abs() < 1e-6);
        }
    }
    for (a, b) in &edges {
        assert!(edges.contains(&(*b, *a)), "edge {a} {b} has one face");
    }
    let (v, e, f) = (body.vertices().len(), edges.len() / 2, body.faces().len());
    assert_eq!(v + f, e + 2, "Euler");
    let sum = body.faces().iter().fold([0.0; 3], |sum, face| {
        plus(sum, times(face.plane.normal, body.area(face)))
    });
    assert!(
        length(sum) < 1e-6,
        "the areas of a closed surface add up to 0"
    );
}

fn planes() -> impl Strategy<Value = Vec<Plane>> {
    let one = (-1.0..1.0, -1.0..1.0, -1.0..1.0, 2.0..11.0)
        .prop_filter("a direction", |(x, y, z, _)| length([*x, *y, *z]) > 0.1)
        .prop_map(|(x, y, z, distance)| plane([x, y, z], distance));
    prop::collection::vec(one, 0..25)
}

proptest! {
    #[test]
    fn the_vertices_are_the_meets_of_the_planes(planes in planes()) {
        let mut body = cube();
        for (tag, plane) in planes.iter().enumerate() {
            body.cut(*plane, tag);
        }
        check(&body);
        let mut all = planes.clone();
        all.extend(cube().faces().iter().map(|face| face.plane));
        let meets = meets(&all);
        prop_assert_eq!(body.vertices().len(), meets.len());
        for vertex in body.vertices() {
            let near = meets.iter().any(|meet| length(minus(*meet, *vertex)) < 1e-6);
            prop_assert!(near, "{:?}", vertex);
        }
    }

    #[test]
    fn the_order_of_the_cuts_does_not_count(planes in planes()) {
        let (mut one, mut other) = (cube(), cube());
        for plane in &planes {
            one.cut(*plane, 0);
        }
        for plane in planes.iter().rev() {
            other.cut(*plane, 0);
        }
        prop_assert!((one.volume() - other.volume()).abs() < 1e-7 * one.volume());
    }

    /// Both parts of a cut add up to the whole.
    #[test]
    fn a_cut_divides_the_volume(planes in planes(), last in planes()) {
        let mut body = cube();
        for plane in &planes {
            body.cut(*plane, 0);
        }
        for plane in &last {
            let (mut near, mut far) = (body.clone(), body.clone());
            let back = Plane { normal: times(plane.normal, -1.0), distance: -plane.distance };
            near.cut(*plane, 1);
            far.cut(back, 1);
            let whole = body.volume();
            prop_assert!((near.volume() + far.volume() - whole).abs() < 1e-9 * whole);
            let section = body.section(plane);
            let face = near.faces().iter().find(|face| face.tag == 1);
            if let Some(face) = face {
                prop_assert!((near.area(face) - area(&section, plane.normal)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_motion_keeps_the_volume(planes in planes(), angle in -4.0..4.0_f64) {
        let mut body = cube();
        for plane in &planes {
            body.cut(*plane, 0);
        }
        let (s, c) = angle.sin_cos();
        let moved = body.moved(&[[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], [1.0, 2.0, 3.0]);
        check(&moved);
        prop_assert!((moved.volume() - body.volume()).abs() < 1e-9 * body.volume());
    }
}

fn area(corners: &[Vector], normal: Vector) -> f64 {
    0.5 * dot(haptimill_hil_sim::polyhedron::area_vector(corners), normal)
}

#[test]
fn a_cube_has_its_volume_and_a_corner_is_a_sixth() {
    let mut body = cube();
    check(&body);
    assert!((body.volume() - 8000.0).abs() < 1e-9);
    let corner = plane([1.0; 3], 15.0 / 3.0_f64.sqrt());
    assert_eq!(body.cut(corner, 7), Cut::Cut);
    check(&body);
    assert!((8000.0 - body.volume() - 15.0_f64.powi(3) / 6.0).abs() < 1e-8);
    assert_eq!(body.cut(corner, 8), Cut::Missed);
    assert_eq!(body.cut(plane([1.0, 0.0, 0.0], -10.0), 9), Cut::Nothing);
    assert!(body.is_empty());
}

/// Sixteen planes through one point keep one vertex there.
#[test]
fn facets_that_meet_in_a_point_have_one_vertex() {
    let mut body = cube();
    for i in 0..16 {
        let (s, c) = (core::f64::consts::TAU * f64::from(i) / 16.0).sin_cos();
        let normal = [0.6 * c, 0.6 * s, 0.8];
        body.cut(plane(normal, 0.8 * 5.0), i as usize);
    }
    check(&body);
    let top = body.vertices().iter().filter(|at| at[2] > 4.999);
    assert_eq!(top.count(), 1);
}

#[test]
fn a_prism_has_the_area_of_its_polygon() {
    let body = Polyhedron::prism(64, 8.0, [-3.0, 2.0], 0);
    check(&body);
    let polygon = 64.0 * 16.0 * (core::f64::consts::PI / 64.0).tan();
    assert!((body.volume() - 5.0 * polygon).abs() < 1e-6);
}
