//! Forward kinematics of the H-4 arm: the closed loops of the four rods, solved by Newton's method.
//!
//! The simulator does not use the closed formulas of the controller, because a shared error would
//! cancel out. The only input is the geometry of the joints (docs/control.md 2.6): slide `i`
//! carries a joint at (l_i - s_i w, sigma_i (a - e), sigma_i d - g_e), the platform carries one at
//! tip + m_i (sin theta, 0, cos theta) + (0, sigma_i b, 0), and a rod of length R connects them.
//!
//! Units: mm and degrees. The unknowns are x, y, z of the tip and sin theta; |theta| < 90 degrees.
//! Each solution starts from the last one, so the machine stays on the assembly branch on which it
//! was built. At the parallel singularity the behaviour of the real machine is undetermined; the
//! solver returns an error there.

use super::{Geometry, GeometryConfig};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use crate::vector::Vector;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Lengths of the H-4 arm and its table in mm, under the names of docs/control.md 2.5-2.6.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmGeometry {
    /// Lateral distance of a slide's joint from the middle, before `e` is subtracted.
    pub a: f64,
    /// Lateral distance of a platform joint from the tool axis.
    pub b: f64,
    /// Half the distance of the platform's joint pairs along the tool axis.
    pub c: f64,
    /// Half the height difference of the rail pairs.
    pub d: f64,
    /// Lateral offset of the slide's joint from its rail.
    pub e: f64,
    /// Offset of the slide's joint along the rail.
    pub w: f64,
    /// Length of a rod (R).
    pub r: f64,
    /// Offset of the rails in z (g_e).
    pub ge: f64,
    /// Tool length from the lower platform joints to the tip (T_L).
    pub tl: f64,
    /// Offset of the table in x.
    pub p: f64,
    /// Height of the table's axis below the origin of the arm.
    pub h: f64,
    /// Offset of the workpiece origin in x (x_Ow^O1).
    pub x_off: f64,
    /// Offset of the workpiece origin in y (y_Ow^O1).
    pub y_off: f64,
    /// Offset of the workpiece origin in z (z_O1^O2).
    pub z_off: f64,
    /// Side of the rails on which the platform is assembled.
    pub branch: Branch,
}

/// Assembly branch of the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Branch {
    /// Platform below the rails.
    Below,
    /// Platform above the rails.
    Above,
}

impl ArmGeometry {
    /// Lengths of a geometry that is an H-4 arm; `None` for another one.
    #[must_use]
    pub const fn of(geometry: Option<&GeometryConfig>) -> Option<&Self> {
        match geometry {
            Some(GeometryConfig::H4(lengths)) => Some(lengths),
            _ => None,
        }
    }

    /// Checks lengths and joint kinds, and adds all problems to `check`.
    pub(crate) fn check(&self, kinds: &[JointKind], check: &mut Check) {
        use JointKind::{Linear, Rotary};
        if kinds != [Linear, Linear, Linear, Linear, Rotary] {
            check.refuse(
                "geometry: h4".into(),
                "needs four linear joints and then the rotary table; correct the kinds of the joints".into(),
            );
        }
        for (name, value) in [
            ("c", self.c),
            ("r", self.r),
            ("E = a - b - e", self.a - self.b - self.e),
        ] {
            check.within(format!("geometry: h4: {name}"), value, 1.0, 2000.0);
        }
        for (name, value) in [
            ("d", self.d),
            ("w", self.w),
            ("ge", self.ge),
            ("tl", self.tl),
            ("p", self.p),
            ("h", self.h),
            ("x_off", self.x_off),
            ("y_off", self.y_off),
            ("z_off", self.z_off),
        ] {
            check.within(format!("geometry: h4: {name}"), value, -2000.0, 2000.0);
        }
    }
}

/// Tolerance of the rod lengths, mm.
const TOLERANCE: f64 = 1e-11;

/// The inverse Jacobian is recomputed when the platform has moved this far since the last one, mm.
const REFRESH: f64 = 0.5;

const S: [f64; 4] = [1.0, -1.0, 1.0, -1.0];
const SIGMA: [f64; 4] = [1.0, 1.0, -1.0, -1.0];

/// The slides are at positions that no platform pose fits, or the branch cannot be determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoopClosureError;

impl fmt::Display for LoopClosureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the rods do not close: no platform pose fits the slide positions, or the pose is singular")
    }
}

impl core::error::Error for LoopClosureError {}

/// Tip of the tool in the arm's base frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tip {
    /// Coordinate x, mm.
    pub x: f64,
    /// Coordinate y, mm.
    pub y: f64,
    /// Coordinate z, mm.
    pub z: f64,
    /// Sine of the tilt about y.
    pub sin_theta: f64,
}

/// The arm, with its last solution.
#[derive(Debug, Clone)]
pub struct Arm {
    geometry: ArmGeometry,
    lever: [f64; 4],
    /// Last solution: x, y, z, sin theta.
    last: [f64; 4],
    before: [f64; 4],
    inverse: [[f64; 4]; 4],
    made_at: [f64; 4],
    /// Sign of the Jacobian's determinant on the assembly branch.
    orientation: f64,
}

impl Arm {
    /// Builds the arm with its slides at `slides`, on the branch of the geometry.
    ///
    /// # Errors
    /// The rods do not close at `slides`.
    pub fn new(geometry: &ArmGeometry, slides: &[f64; 4]) -> Result<Self, LoopClosureError> {
        let mut arm = Self {
            lever: SIGMA.map(|sigma| geometry.tl + geometry.c * (1.0 + sigma)),
            geometry: geometry.clone(),
            last: [0.0; 4],
            before: [0.0; 4],
            inverse: [[0.0; 4]; 4],
            made_at: [0.0; 4],
            orientation: 0.0,
        };
        arm.assemble(slides)?;
        Ok(arm)
    }

    /// Solves from a first guess well inside the branch with full Newton steps.
    fn assemble(&mut self, slides: &[f64; 4]) -> Result<(), LoopClosureError> {
        let g = &self.geometry;
        let sin = (slides[0] + slides[1] - slides[2] - slides[3]) / (4.0 * g.c);
        if sin.is_nan() || sin.abs() >= 1.0 {
            return Err(LoopClosureError);
        }
        let cos = libm::sqrt(1.0 - sin * sin);
        let reach = (slides[0] - slides[1] + slides[2] - slides[3]) / 4.0 - g.w;
        let lateral = g.a - g.b - g.e;
        let drop = libm::sqrt((g.r * g.r - reach * reach - lateral * lateral).max(1.0));
        let side = if g.branch == Branch::Below { -1.0 } else { 1.0 };
        let lever = g.c + g.tl;
        let guess = [
            slides.iter().sum::<f64>() / 4.0 - lever * sin,
            0.0,
            side * drop - g.ge - lever * cos,
            sin,
        ];
        // Far below (above) the rails the sign of the determinant is that of the branch.
        let (_, rods, _) = self.residuals(&guess, slides);
        self.orientation = invert(&self.jacobian(&guess, &rods))
            .ok_or(LoopClosureError)?
            .1
            .signum();
        let solved = self.newton(guess, slides)?;
        self.last = solved;
        self.before = solved;
        Ok(())
    }

    /// Errors of the rod lengths (to first order, mm), the rod vectors, and the largest error.
    #[inline(always)]
    fn residuals(&self, q: &[f64; 4], slides: &[f64; 4]) -> ([f64; 4], [[f64; 3]; 4], f64) {
        let g = &self.geometry;
        let cos = libm::sqrt(1.0 - q[3] * q[3]);
        let mut errors = [0.0; 4];
        let mut rods = [[0.0; 3]; 4];
        let mut worst = 0.0;
        for i in 0..4 {
            let rod = [
                q[0] + self.lever[i] * q[3] - (slides[i] - S[i] * g.w),
                q[1] + SIGMA[i] * g.b - SIGMA[i] * (g.a - g.e),
                q[2] + self.lever[i] * cos - (SIGMA[i] * g.d - g.ge),
            ];
            let error =
                (rod[0] * rod[0] + rod[1] * rod[1] + rod[2] * rod[2] - g.r * g.r) * (0.5 / g.r);
            errors[i] = error;
            rods[i] = rod;
            let size = error.abs();
            worst = if size > worst { size } else { worst };
        }
        (errors, rods, worst)
    }

    fn jacobian(&self, q: &[f64; 4], rods: &[[f64; 3]; 4]) -> [[f64; 4]; 4] {
        let cos = libm::sqrt(1.0 - q[3] * q[3]);
        let mut rows = [[0.0; 4]; 4];
        for i in 0..4 {
            let [x, y, z] = rods[i].map(|component| component / self.geometry.r);
            rows[i] = [x, y, z, self.lever[i] * (x - z * q[3] / cos)];
        }
        rows
    }

    /// Computes the inverse Jacobian at `q`. Fails for a singular one and for one of the other
    /// branch.
    fn refresh(&mut self, q: &[f64; 4], rods: &[[f64; 3]; 4]) -> Result<(), LoopClosureError> {
        let (inverse, determinant) = invert(&self.jacobian(q, rods)).ok_or(LoopClosureError)?;
        if determinant * self.orientation <= 0.0 {
            return Err(LoopClosureError);
        }
        self.inverse = inverse;
        self.made_at = *q;
        Ok(())
    }

    #[inline(always)]
    fn correct(&self, q: &mut [f64; 4], errors: &[f64; 4]) {
        for (value, row) in q.iter_mut().zip(&self.inverse) {
            *value -=
                row[0] * errors[0] + row[1] * errors[1] + row[2] * errors[2] + row[3] * errors[3];
        }
    }

    fn newton(&mut self, mut q: [f64; 4], slides: &[f64; 4]) -> Result<[f64; 4], LoopClosureError> {
        for _ in 0..30 {
            if q[3].is_nan() || q[3].abs() >= 1.0 {
                return Err(LoopClosureError);
            }
            let (errors, rods, worst) = self.residuals(&q, slides);
            // Rods reach outwards from the platform (1, 3 up, 2, 4 down). The opposite is another
            // assembly.
            if worst < TOLERANCE {
                let right_way = (0..4).all(|i| S[i] * rods[i][0] < 0.0);
                return if right_way {
                    Ok(q)
                } else {
                    Err(LoopClosureError)
                };
            }
            self.refresh(&q, &rods)?;
            self.correct(&mut q, &errors);
        }
        Err(LoopClosureError)
    }

    /// Follows the slides from their last positions, for moves of up to some 10 mm.
    ///
    /// # Errors
    /// The rods do not close, or the move crosses a singularity. The arm keeps the last valid
    /// solution and continues from it.
    #[inline]
    pub fn follow(&mut self, slides: &[f64; 4]) -> Result<Tip, LoopClosureError> {
        let mut q = [0.0; 4];
        for (guess, (last, before)) in q.iter_mut().zip(self.last.iter().zip(&self.before)) {
            *guess = last + (last - before);
        }
        let near = (0..3).all(|i| (q[i] - self.made_at[i]).abs() < REFRESH)
            && (q[3] - self.made_at[3]).abs() < 2e-3;
        let mut solved = None;
        if near {
            // The old inverse is sufficient: each iteration gains three digits and costs a quarter
            // of a full one.
            for _ in 0..5 {
                let (errors, rods, worst) = self.residuals(&q, slides);
                if worst < TOLERANCE {
                    solved = (0..4).all(|i| S[i] * rods[i][0] < 0.0).then_some(q);
                    break;
                }
                self.correct(&mut q, &errors);
            }
        }
        let q = match solved {
            Some(q) => q,
            None => {
                let solved = self.newton(self.last, slides)?;
                let (_, rods, _) = self.residuals(&solved, slides);
                self.refresh(&solved, &rods)?;
                solved
            }
        };
        self.before = self.last;
        self.last = q;
        Ok(Tip {
            x: q[0],
            y: q[1],
            z: q[2],
            sin_theta: q[3],
        })
    }

    /// Largest difference of a rod length from R at this tip, mm.
    pub fn residual(&self, tip: &Tip, slides: &[f64; 4]) -> f64 {
        self.residuals(&[tip.x, tip.y, tip.z, tip.sin_theta], slides)
            .2
    }

    /// Tip in the workpiece frame with the table at `alpha` degrees: x_w, y_w, z_w in mm, theta and
    /// alpha in degrees.
    ///
    /// The table axis lies along x at (p, 0, -h), and the workpiece turns with it (docs/control.md
    /// (3.14)-(3.16); the offsets have the sign that makes the equations the inverse of
    /// (3.23)-(3.26)).
    #[inline]
    pub fn in_work(&self, tip: &Tip, alpha: f64) -> [f64; 5] {
        let g = &self.geometry;
        let (sin, cos) = libm::sincos(alpha * (core::f64::consts::PI / 180.0));
        // Tip relative to the table axis.
        let (across, up) = (tip.y, tip.z + g.h);
        [
            tip.x - g.p - g.x_off,
            across * cos + up * sin - g.y_off,
            up * cos - across * sin - g.z_off,
            libm::asin(tip.sin_theta) * (180.0 / core::f64::consts::PI),
            alpha,
        ]
    }

    /// A point of the arm's base frame in the workpiece frame.
    fn point_in_work(&self, [x, y, z]: Vector, alpha: f64) -> Vector {
        let tip = Tip {
            x,
            y,
            z,
            sin_theta: 0.0,
        };
        let [x, y, z, ..] = self.in_work(&tip, alpha);
        [x, y, z]
    }

    /// The rods, and the platform down to the tip, in the workpiece frame.
    fn links(&self, tip: &Tip, slides: &[f64; 4], alpha: f64) -> Vec<Vec<Vector>> {
        let g = &self.geometry;
        let cos = libm::sqrt(1.0 - tip.sin_theta * tip.sin_theta);
        let on_axis = |lever: f64| [tip.x + lever * tip.sin_theta, tip.y, tip.z + lever * cos];
        let platform = |rod: usize| {
            let [x, y, z] = on_axis(self.lever[rod]);
            [x, y + SIGMA[rod] * g.b, z]
        };
        let slide = |rod: usize| {
            [
                slides[rod] - S[rod] * g.w,
                SIGMA[rod] * (g.a - g.e),
                SIGMA[rod] * g.d - g.ge,
            ]
        };
        let mut lines: Vec<Vec<Vector>> =
            (0..4).map(|rod| vec![slide(rod), platform(rod)]).collect();
        // The two joint pairs of the platform, and the tool.
        let (upper, lower) = (on_axis(self.lever[0]), on_axis(self.lever[2]));
        lines.push(vec![platform(0), upper, lower, platform(2)]);
        lines.push(vec![lower, on_axis(0.0)]);
        for point in lines.iter_mut().flatten() {
            *point = self.point_in_work(*point, alpha);
        }
        lines
    }

    /// Joint loads of a force between tool and workpiece: N on each slide, N m on the table.
    ///
    /// `force` acts on the tool, and its opposite on the workpiece, in N along x_w, y_w, z_w. The
    /// point of application is on the tool axis, `above` mm above the tip. The loads follow from
    /// virtual work on the loops: with the rows A of the rods' lengths by the tip's coordinates, A
    /// dq = diag(rod_x / R) dl, so f = diag(rod_x / R) A^-T F. Power is conserved: force times the
    /// velocity of the point in the workpiece frame equals the sum of loads times rates.
    ///
    /// `None` at the parallel singularity.
    pub fn joint_loads(
        &self,
        tip: &Tip,
        slides: &[f64; 4],
        alpha: f64,
        force: [f64; 3],
        above: f64,
    ) -> Option<[f64; 5]> {
        let g = &self.geometry;
        let q = [tip.x, tip.y, tip.z, tip.sin_theta];
        let (_, rods, _) = self.residuals(&q, slides);
        let (inverse, _) = invert(&self.jacobian(&q, &rods))?;
        let (sin, cos) = libm::sincos(alpha * (core::f64::consts::PI / 180.0));
        let [x, y, z] = [
            force[0],
            force[1] * cos - force[2] * sin,
            force[1] * sin + force[2] * cos,
        ];
        let cos_theta = libm::sqrt(1.0 - tip.sin_theta * tip.sin_theta);
        // Derivative by sin theta: the point moves by `above` along x and descends with the cosine.
        let turning = above * (x - z * tip.sin_theta / cos_theta);
        let mut loads = [0.0; 5];
        for i in 0..4 {
            let tension =
                inverse[0][i] * x + inverse[1][i] * y + inverse[2][i] * z + inverse[3][i] * turning;
            loads[i] = tension * rods[i][0] / g.r;
        }
        // Point relative to the table axis.
        let (across, up) = (tip.y, tip.z + above * cos_theta + g.h);
        let (across, up) = (across * cos + up * sin, up * cos - across * sin);
        loads[4] = (force[1] * up - force[2] * across) * 1e-3;
        Some(loads)
    }
}

/// The H-4 arm with its table, as the plant moves it.
#[derive(Debug, Clone)]
pub struct H4 {
    arm: Arm,
    /// Tip in the arm's base frame, without the deflection of the structure.
    tip: Tip,
}

/// Pose coordinate and joint of the table.
const ALPHA: usize = 4;

fn slides(joints: &JointArray) -> [f64; 4] {
    [joints[0], joints[1], joints[2], joints[3]]
}

impl Geometry for H4 {
    type Config = ArmGeometry;

    fn check(config: &ArmGeometry, kinds: &[JointKind], check: &mut Check) {
        config.check(kinds, check);
    }

    fn new(config: &ArmGeometry, joints: &JointArray) -> Result<Self, String> {
        let mut machine = Self {
            arm: Arm::new(config, &slides(joints)).map_err(|error| error.to_string())?,
            tip: Tip::default(),
        };
        let mut pose = JointArray::default();
        if machine.follow(joints, &mut pose) {
            Ok(machine)
        } else {
            Err(LoopClosureError.to_string())
        }
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let Ok(tip) = self.arm.follow(&slides(joints)) else {
            return false;
        };
        self.tip = tip;
        pose[..5].copy_from_slice(&self.arm.in_work(&tip, joints[ALPHA]));
        true
    }

    fn links(&self, joints: &JointArray, pose: &JointArray) -> Vec<Vec<Vector>> {
        self.arm.links(&self.tip, &slides(joints), pose[ALPHA])
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        let [x, y, z, theta, alpha, _] = *pose;
        ToolPose::leaning([x, y, z], theta, alpha)
    }

    fn workpiece_axes(&self, pose: &JointArray) -> [Vector; 3] {
        let (sin, cos) = libm::sincos(pose[ALPHA] * (core::f64::consts::PI / 180.0));
        [[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]]
    }

    fn joint_loads(
        &self,
        joints: &JointArray,
        pose: &JointArray,
        force: [f64; 3],
        above: f64,
    ) -> Option<JointArray> {
        let arm = &self.arm;
        let mut loads = JointArray::default();
        loads[..5].copy_from_slice(&arm.joint_loads(
            &self.tip,
            &slides(joints),
            pose[ALPHA],
            force,
            above,
        )?);
        Some(loads)
    }
}

/// Inverse and determinant by Gauss-Jordan with row pivots; `None` for a numerically singular
/// matrix.
fn invert(matrix: &[[f64; 4]; 4]) -> Option<([[f64; 4]; 4], f64)> {
    let mut left = *matrix;
    let mut right = [[0.0; 4]; 4];
    for (i, row) in right.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    let mut determinant = 1.0;
    for column in 0..4 {
        let mut pivot = column;
        for row in column + 1..4 {
            if left[row][column].abs() > left[pivot][column].abs() {
                pivot = row;
            }
        }
        if pivot != column {
            left.swap(pivot, column);
            right.swap(pivot, column);
            determinant = -determinant;
        }
        let value = left[column][column];
        determinant *= value;
        if value.is_nan() || value.abs() <= 1e-6 {
            return None;
        }
        let scale = 1.0 / value;
        for k in 0..4 {
            left[column][k] *= scale;
            right[column][k] *= scale;
        }
        for row in 0..4 {
            if row != column {
                let factor = left[row][column];
                for k in 0..4 {
                    left[row][k] -= factor * left[column][k];
                    right[row][k] -= factor * right[column][k];
                }
            }
        }
    }
    Some((right, determinant))
}
