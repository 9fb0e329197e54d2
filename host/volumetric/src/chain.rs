//! The kinematic chain [w Y b X Z t]: the table moves along y, and the spindle along x, then z.
//!
//! Two models give the error of the tool relative to the workpiece:
//! - [`Model::Physical`], the default. First order. The rotation of an axis acts on the arm from
//!   the point where the axis was measured to the tool tip: z alone for the x axis, because z is
//!   the only axis between its carriage and the tool; the whole work point for the table; the
//!   difference of the tools for the z axis.
//! - [`Model::Thesis`], as in Sratong-on, *The effect of error parameters of vertical machining
//!   center on geometric dimensioning and tolerance of machined part*, Thai-Nichi Institute of
//!   Technology, 2012, equation (3.16): all three rotations act on the whole work point, and the
//!   squareness errors do not appear. It reproduces the thesis and nothing else.

use crate::Vector;
use crate::errors::{Approach, Axis, AxisError, ErrorSet, Squareness};
use nalgebra::Matrix4;

/// Constants of the physical model: where the axes were measured, and the tool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arms {
    /// Height of the tool tip, in work coordinates, at which the x axis was measured, mm.
    pub x_height: f64,
    /// Point of the work at which the table was measured, mm.
    pub table_point: Vector,
    /// From the gauge point of the spindle to the tip of the tool in use, mm.
    pub tool: Vector,
    /// The same for the tool, or the instrument, with which the z axis was measured, mm.
    pub measured_tool: Vector,
}

impl Default for Arms {
    /// Measured at the origin of the work, with the tool in use.
    fn default() -> Self {
        Self {
            x_height: 0.0,
            table_point: Vector::zeros(),
            tool: Vector::zeros(),
            measured_tool: Vector::zeros(),
        }
    }
}

/// From the z carriage to the tool tip, mm: the constants a_3, b_3, c_3 of the thesis's machine.
pub const THESIS_TOOL: [f64; 3] = [0.0, 0.0, -375.6991];

/// A model of the chain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Model {
    /// First order, with the arms of the chain and the squareness errors.
    Physical(Arms),
    /// Equation (3.16) of the thesis, with its exact products; the vector is a_3, b_3, c_3, mm.
    Thesis(Vector),
}

impl Default for Model {
    fn default() -> Self {
        Self::Physical(Arms::default())
    }
}

impl Model {
    /// The model of the thesis with the constants of its machine.
    #[must_use]
    pub fn thesis() -> Self {
        Self::Thesis(Vector::from(THESIS_TOOL))
    }

    /// Error of the tool relative to the workpiece at a work point, mm.
    #[must_use]
    pub fn error(&self, errors: &ErrorSet, point: Vector) -> Vector {
        self.error_from(errors, point, [Approach::Any; 3])
    }

    /// The same, where each axis came to its position from a known direction.
    #[must_use]
    pub fn error_from(&self, errors: &ErrorSet, point: Vector, from: [Approach; 3]) -> Vector {
        let [x, y, z] =
            Axis::ALL.map(|axis| errors.of_axis(axis, point[axis.index()], from[axis.index()]));
        match self {
            Self::Physical(arms) => physical(&[x, y, z], &errors.squareness, point, arms),
            Self::Thesis(tool) => thesis(&[x, y, z], point, *tool),
        }
    }
}

fn physical(
    [x, y, z]: &[AxisError; 3],
    squareness: &Squareness,
    point: Vector,
    arms: &Arms,
) -> Vector {
    let square = Vector::new(
        squareness.b0z * point.z - squareness.c0y * point.y,
        -squareness.a0z * point.z,
        0.0,
    );
    let height = Vector::new(0.0, 0.0, point.z - arms.x_height);
    x.translation
        + y.translation
        + z.translation
        + y.rotation.cross(&(point - arms.table_point))
        + x.rotation.cross(&height)
        + z.rotation.cross(&(arms.tool - arms.measured_tool))
        + square
}

/// (3.16) with its misprints corrected, as one sum of vector products.
fn thesis([x, y, z]: &[AxisError; 3], point: Vector, tool: Vector) -> Vector {
    x.translation
        + y.translation
        + z.translation
        + (x.rotation + y.rotation + z.rotation).cross(&point)
        + x.rotation.cross(&tool)
        + x.rotation.cross(&z.translation)
        + x.rotation.cross(&z.rotation.cross(&point))
}

/// Homogeneous matrix of a translation, mm: equation (2.2) of the thesis.
#[must_use]
pub fn translation(by: Vector) -> Matrix4<f64> {
    Matrix4::new_translation(&by)
}

/// Homogeneous matrix of a small rotation, radians, and a translation, mm: equations (2.6), (2.14)
/// and (3.5). It is of first order: three rotations of 1e-4 on a 650 mm arm err by 0.0065 um.
#[must_use]
pub fn small_motion(translation: Vector, rotation: Vector) -> Matrix4<f64> {
    let (r, t) = (rotation, translation);
    Matrix4::new(
        1.0, -r.z, r.y, t.x, //
        r.z, 1.0, -r.x, t.y, //
        -r.y, r.x, 1.0, t.z, //
        0.0, 0.0, 0.0, 1.0,
    )
}

/// Homogeneous matrix of three rotations, radians, about x, then y, then z of the turned frame:
/// equation (2.13).
#[must_use]
pub fn rotation(angles: Vector) -> Matrix4<f64> {
    let about = |axis: Vector, angle: f64| Matrix4::new_rotation(axis * angle);
    about(Vector::x(), angles.x) * about(Vector::y(), angles.y) * about(Vector::z(), angles.z)
}
