//! The equations of the thesis against products of homogeneous matrices. Each equation that is
//! misprinted is tested as printed, which must fail, and as corrected.

use haptimill_volumetric::Vector;
use haptimill_volumetric::chain::{self, Model, THESIS_TOOL, small_motion, translation};
use haptimill_volumetric::errors::{Axis, ClosedForm, ErrorSet, Function, Shape};
use nalgebra::{Matrix4, Vector4};

/// Tolerance of equal places, mm: rounding errors of sums of lengths up to 1461 mm.
const TOLERANCE: f64 = 1e-12;

/// Offsets of the frames of the thesis's machine, mm. `z_r1` has the sign that closes the chain.
const R1: Vector = Vector::new(0.0, 0.0, -1461.0);
const W: Vector = Vector::new(-303.6865, 225.1953, 146.0);
const R2: Vector = Vector::new(-303.6865, 225.1953, -228.3009);
const A2: Vector = Vector::new(0.0, 0.0, -711.0);

fn tool() -> Vector {
    Vector::from(THESIS_TOOL)
}

fn point() -> Vector {
    Vector::new(70.0, -80.0, -10.0)
}

/// Translations and rotations of the three axes: 1 is y, 2 is x, 3 is z. All differ.
fn errors() -> [(Vector, Vector); 3] {
    let vector = |x, y, z| Vector::new(x, y, z);
    [
        (
            vector(1.1e-3, -2.3e-3, 3.7e-3),
            vector(4.1e-4, -5.3e-4, 6.1e-4),
        ),
        (
            vector(-7.3e-3, 8.9e-3, 9.7e-3),
            vector(1.3e-4, 2.9e-4, -3.1e-4),
        ),
        (
            vector(4.3e-3, -4.7e-3, 5.9e-3),
            vector(-6.7e-4, 7.1e-4, 7.9e-4),
        ),
    ]
}

fn at(matrix: Matrix4<f64>, point: Vector) -> Vector {
    (matrix * Vector4::new(point.x, point.y, point.z, 1.0)).xyz()
}

fn ideal_work() -> Vector {
    at(translation(R1) * translation(W), point())
}

fn actual_work() -> Vector {
    let (d, e) = errors()[0];
    at(translation(R1) * small_motion(W + d, e), point())
}

fn ideal_tool() -> Vector {
    at(
        translation(R2) * translation(A2) * translation(tool()),
        point(),
    )
}

fn actual_tool() -> Vector {
    let [_, (d2, e2), (d3, e3)] = errors();
    let chain = translation(R2) * small_motion(A2 + d2, e2) * small_motion(tool() + d3, e3);
    at(chain, point())
}

fn same(a: Vector, b: Vector) -> bool {
    (a - b).amax() < TOLERANCE
}

/// (2.5): the example of a translation.
#[test]
fn equation_2_5() {
    let moved = at(
        translation(Vector::new(10.0, 20.0, 30.0)),
        Vector::new(1.0, 2.0, 3.0),
    );
    assert_eq!(moved, Vector::new(11.0, 22.0, 33.0));
}

/// (2.1) is printed with the columns U, W, V of the axes of the turned frame: a mirror, and no
/// rotation. In the order U, V, W it is one.
#[test]
fn equation_2_1() {
    let turned = chain::rotation(Vector::new(0.3, -0.5, 0.7));
    let axes = turned.fixed_view::<3, 3>(0, 0).into_owned();
    let mut printed = axes;
    printed.swap_columns(1, 2);
    assert!((printed.determinant() + 1.0).abs() < TOLERANCE);
    assert!((axes.determinant() - 1.0).abs() < TOLERANCE);
}

/// (2.13) is Rx Ry Rz; (2.14) is its first order.
#[test]
fn equations_2_13_and_2_14() {
    let a = Vector::new(0.3, -0.5, 0.7);
    let (sx, cx) = a.x.sin_cos();
    let (sy, cy) = a.y.sin_cos();
    let (sz, cz) = a.z.sin_cos();
    let printed = Matrix4::new(
        cy * cz,
        -cy * sz,
        sy,
        0.0, //
        cx * sz + cz * sx * sy,
        cx * cz - sx * sy * sz,
        -cy * sx,
        0.0, //
        sx * sz - cx * cz * sy,
        cz * sx + cx * sy * sz,
        cx * cy,
        0.0, //
        0.0,
        0.0,
        0.0,
        1.0,
    );
    assert!((chain::rotation(a) - printed).amax() < 1e-15);
    // 100 urad about all axes and an arm of 650 mm: below 0.01 um.
    let small = Vector::repeat(1e-4);
    let exact = chain::rotation(small) - small_motion(Vector::zeros(), small);
    assert!(exact.amax() * 650.0 < 0.01e-3);
    assert!(exact.amax() * 650.0 > 0.005e-3);
}

/// (3.1): the last row is printed as 0 0 1 1. With it a point has another weight than 1.
#[test]
fn equation_3_1() {
    let mut printed = translation(R1);
    printed[(3, 2)] = 1.0;
    let weight = |matrix: Matrix4<f64>| (matrix * Vector4::new(1.0, 2.0, 3.0, 1.0)).w;
    assert_ne!(weight(printed), 1.0);
    assert_eq!(weight(translation(R1)), 1.0);
}

/// (3.4) and (3.11): without errors work and tool coincide, with `z_r1` = -1461 and not +1461.
#[test]
fn closure() {
    assert!((ideal_work() - ideal_tool()).amax() < 1e-9);
    let printed = Vector::new(0.0, 0.0, 1461.0);
    let work = at(translation(printed) * translation(W), point());
    assert!((work - ideal_tool()).amax() > 1000.0);
}

fn table(sign: f64) -> Vector {
    let (d, e) = errors()[0];
    let p = point();
    let turned = Vector::new(
        e.y * p.z - e.z * p.y,
        e.z * p.x - e.x * p.z,
        e.x * p.y - e.y * p.x,
    );
    d + turned * sign
}

/// (3.6) is printed with the signs of all angles reversed; (3.7) is right.
#[test]
fn equations_3_6_and_3_7() {
    let corrected = ideal_work() + table(1.0);
    let printed = ideal_work() + table(-1.0);
    assert!(same(corrected, actual_work()));
    assert!(!same(printed, actual_work()));
    assert!(same(table(1.0), actual_work() - ideal_work()));
}

/// (3.15), term by term. `x_row` is the factor beside `eps_z3` in the x row, which (3.14) prints as
/// `eps_z3`; `z_row` the one beside `eps_x2` in the z row, which (3.16) prints as `eps_x3`.
fn spindle(x_row: f64, z_row: f64) -> Vector {
    let [_, (d2, e2), (d3, e3)] = errors();
    let (p, r) = (point(), tool());
    Vector::new(
        d2.x + d3.x + p.z * (e2.y + e3.y + e3.x * e2.z)
            - p.y * (e2.z + e3.z - e3.x * e2.y)
            - p.x * (e2.y * e3.y + x_row * e3.z)
            - e2.z * (r.y + d3.y)
            + e2.y * (r.z + d3.z),
        d2.y + d3.y + p.x * (e2.z + e3.z + e2.x * e3.y)
            - p.z * (e2.x + e3.x - e3.y * e2.z)
            - p.y * (e2.x * e3.x + e2.z * e3.z)
            + e2.z * (r.x + d3.x)
            - e2.x * (r.z + d3.z),
        d2.z + d3.z + p.y * (e2.x + e3.x + e2.y * e3.z)
            - p.x * (e2.y + e3.y - e2.x * z_row)
            - p.z * (e2.x * e3.x + e2.y * e3.y)
            - e2.y * (r.x + d3.x)
            + e2.x * (r.y + d3.y),
    )
}

/// (3.14) is printed with `x_r1` for `x_r2` and `eps_z3 eps_z3` for `eps_z2 eps_z3` in its x row.
#[test]
fn equations_3_14_and_3_15() {
    let [_, (_, e2), (_, e3)] = errors();
    let right = spindle(e2.z, e3.z);
    assert!(same(ideal_tool() + right, actual_tool()));
    assert!(same(right, actual_tool() - ideal_tool()));
    assert!(!same(ideal_tool() + spindle(e3.z, e3.z), actual_tool()));
    let wrong_frame = Vector::new(R1.x - R2.x, 0.0, 0.0);
    assert!(!same(ideal_tool() + right + wrong_frame, actual_tool()));
}

/// (3.16) is printed with `eps_x2 eps_x3` for `eps_x2 eps_z3` in its z row. The model of the crate
/// is the corrected one.
#[test]
fn equation_3_16() {
    let [_, (_, e2), (_, e3)] = errors();
    let total = (actual_work() - ideal_work()) + (actual_tool() - ideal_tool());
    assert!(same(table(1.0) + spindle(e2.z, e3.z), total));
    assert!(!same(table(1.0) + spindle(e2.z, e3.x), total));
    assert!(same(Model::thesis().error(&constant_set(), point()), total));
}

/// A set whose functions are constant, with the values of `errors`.
fn constant_set() -> ErrorSet {
    let [y, x, z] = errors();
    let mut set = ErrorSet::default();
    for function in Function::all() {
        let (d, e) = match function.moving {
            Axis::X => x,
            Axis::Y => y,
            Axis::Z => z,
        };
        let part = if function.rotates { e } else { d };
        let mean = part[function.direction.index()];
        set.set(
            function,
            Shape::ClosedForm(ClosedForm {
                mean,
                ..ClosedForm::default()
            }),
        );
    }
    set
}

/// The physical model against the chain itself: tool less work, in matrices, with the signs of the
/// table turned because its errors are those of the tool relative to the workpiece.
#[test]
fn physical_model() {
    let [y, x, z] = errors();
    let small = 1e-3;
    let tip = Vector::new(0.0, 0.0, -228.3009);
    let p = point();
    let (d, e) = (
        |of: (Vector, Vector)| of.0 * small,
        |of: (Vector, Vector)| of.1 * small,
    );
    // x carriage, then z, then the tool; the tip without errors is at the work point.
    let carriage = p - tip - Vector::new(0.0, 0.0, p.z);
    let tool_tip = translation(carriage)
        * small_motion(d(x), e(x))
        * translation(Vector::new(0.0, 0.0, p.z))
        * small_motion(d(z), e(z));
    let of_tool = at(tool_tip, tip) - p;
    let of_work = at(small_motion(-d(y), -e(y)), p) - p;
    let chain = of_tool - of_work;
    // Measured at the gauge point: arms reach from there.
    let mut set = constant_set().scaled(small);
    set.squareness = Default::default();
    let model = Model::Physical(chain::Arms {
        x_height: -tip.z,
        tool: tip,
        ..chain::Arms::default()
    });
    let difference = (model.error(&set, p) - chain).amax();
    // The chain has second orders: 1e-6 times 1e-6 times 300 mm.
    assert!(difference < 1e-9, "{difference}");
}

/// A constant yaw of the table turns the part as a whole: the sides keep their angle.
#[test]
fn constant_yaw_is_no_squareness() {
    let mut set = ErrorSet::default();
    let yaw = Function {
        moving: Axis::Y,
        direction: Axis::Z,
        rotates: true,
    };
    set.set(
        yaw,
        Shape::ClosedForm(ClosedForm {
            mean: 1e-5,
            ..ClosedForm::default()
        }),
    );
    let error = |x, y| Model::default().error(&set, Vector::new(x, y, 0.0));
    let slope_x = (error(80.0, 0.0).y - error(-80.0, 0.0).y) / 160.0;
    let slope_y = (error(0.0, 80.0).x - error(0.0, -80.0).x) / 160.0;
    assert!((slope_x - 1e-5).abs() < 1e-12 && (slope_x + slope_y).abs() < 1e-12);
}

/// Sensitivities of the literal model: the arm of 375.6991 mm plus the depth.
#[test]
fn arm_of_the_literal_model() {
    let p = point();
    let of = |direction, value| {
        let mut set = ErrorSet::default();
        let function = Function {
            moving: Axis::X,
            direction,
            rotates: true,
        };
        set.set(
            function,
            Shape::ClosedForm(ClosedForm {
                mean: value,
                ..ClosedForm::default()
            }),
        );
        Model::thesis().error(&set, p) / value
    };
    assert!((of(Axis::Y, 1e-6).x + 385.6991).abs() < 1e-3);
    assert!((of(Axis::X, 1e-6).y - 385.6991).abs() < 1e-3);
}

/// With the signs of the table turned only the terms of the table change.
#[test]
fn sign_convention() {
    let set = constant_set();
    let mut turned = set.clone();
    for function in Function::all().filter(|function| function.moving == Axis::Y) {
        let Shape::ClosedForm(form) = set.function(function) else {
            unreachable!()
        };
        let form = ClosedForm {
            mean: -form.mean,
            ..*form
        };
        turned.set(function, Shape::ClosedForm(form));
    }
    let only_table = set.without(|function| function.moving != Axis::Y);
    let p = point();
    let model = Model::thesis();
    let difference = model.error(&set, p) - model.error(&turned, p);
    assert!(same(difference, model.error(&only_table, p) * 2.0));
}
