//! The H-4 arm as a subject. Its reference values follow from the positions of its joints in space
//! and the length of its rods.
//!
//! Geometry of docs/control.md 2.6: slide i carries its joint at (l_i - s_i w, sigma_i (a - e),
//! sigma_i d - g_e). The platform's joint is at tip + m_i (sin theta, 0, cos theta) + (0, sigma_i
//! b, 0). A rod has the length R.

use super::subject::{MM, Margin, Margins, RADIAN, Reals, Sequence, Subject};
use core::f64::consts::{FRAC_PI_2, PI};
use haptimill_kinematics::h4::{H4, H4Geometry, TILT, near_reach_limit};
use haptimill_kinematics::{Joints, PoseError};
use haptimill_math::{Coordinate, Length};
use heapless::Vec;

const SIDES: [f64; 4] = [1.0, -1.0, 1.0, -1.0];
const PAIRS: [f64; 4] = [1.0, 1.0, -1.0, -1.0];

/// Lengths in mm, with the names of docs/control.md.
#[derive(Clone, Copy)]
pub struct Lengths {
    /// Half the distance of the rail pairs in y.
    pub a: f64,
    /// Half the distance of the platform's joints in y.
    pub b: f64,
    /// Offset of the slide's joint in y.
    pub e: f64,
    /// Half the distance of the platform's joints along the tool.
    pub c: f64,
    /// Half the height between the rail pairs.
    pub d: f64,
    /// Offset of the slide's joint along the rail.
    pub w: f64,
    /// Length of the rods.
    pub r: f64,
    /// Height offset of the rails.
    pub g_e: f64,
    /// Tool length.
    pub t_l: f64,
    /// Height of the table axis below the origin of the base frame.
    pub h: f64,
    /// Origin of the workpiece frame.
    pub offset: [f64; 3],
    /// The platform hangs below the rails.
    pub below: bool,
    /// Singularity margin.
    pub margin: f64,
}

/// REF-G of docs/control.md 7.2.
pub const REFERENCE: Lengths = Lengths {
    a: 400.0,
    b: 100.0,
    e: 50.0,
    c: 100.0,
    d: 100.0,
    w: 50.0,
    r: 480.0,
    g_e: 25.0,
    t_l: 150.0,
    h: 600.0,
    offset: [810.0, 0.0, 0.0],
    below: true,
    margin: 5.0,
};

/// Another arm: above its rails, with no round values, no equal values, and every offset in use.
pub const OTHER: Lengths = Lengths {
    a: 371.25,
    b: 83.5,
    e: 41.75,
    c: 88.125,
    d: 61.5,
    w: 37.25,
    r: 523.625,
    g_e: -31.5,
    t_l: 171.125,
    h: -480.25,
    offset: [755.5, -12.75, 33.5],
    below: false,
    margin: 5.0,
};

/// An arm with its reference values and its kinematics.
pub struct Arm {
    lengths: Lengths,
    machine: H4,
}

impl Arm {
    /// Creates the arm of these lengths.
    ///
    /// # Panics
    /// The firmware refuses them.
    #[must_use]
    pub fn new(lengths: Lengths) -> Self {
        let raw = |value: f64| Length(libm::round(value / MM) as i32);
        let geometry = H4Geometry {
            lateral: raw(lengths.a - lengths.b - lengths.e),
            half_spacing: raw(lengths.c),
            half_height: raw(lengths.d),
            joint_offset: raw(lengths.w),
            rod: raw(lengths.r),
            rail_offset: raw(lengths.g_e),
            tool: raw(lengths.t_l),
            x_offset: raw(lengths.offset[0]),
            y_offset: raw(lengths.offset[1]),
            z_offset: raw(lengths.offset[2]),
            table_height: raw(lengths.h),
            below: lengths.below,
            singularity_margin: raw(lengths.margin),
        };
        assert!(H4::is_sound(&geometry));
        Self {
            lengths,
            machine: H4::new(&geometry),
        }
    }

    /// Returns the tip in the base frame.
    fn tip(&self, pose: &Reals) -> [f64; 3] {
        let g = &self.lengths;
        let (y, z) = (pose[1] + g.offset[1], pose[2] + g.offset[2]);
        let (s, c) = (libm::sin(pose[4]), libm::cos(pose[4]));
        [pose[0] + g.offset[0], y * c - z * s, y * s + z * c - g.h]
    }

    /// The same, turned round.
    fn on_the_table(&self, tip: [f64; 3], theta: f64, alpha: f64) -> Reals {
        let g = &self.lengths;
        let (y, z) = (tip[1], tip[2] + g.h);
        let (s, c) = (libm::sin(alpha), libm::cos(alpha));
        [
            tip[0] - g.offset[0],
            y * c + z * s - g.offset[1],
            z * c - y * s - g.offset[2],
            theta,
            alpha,
            0.0,
        ]
    }

    /// Distance of the platform's joint i from the tip along the tool.
    fn up(&self, i: usize) -> f64 {
        self.lengths.t_l + self.lengths.c * (1.0 + PAIRS[i])
    }

    /// Position of the platform's joint i, relative to the line of its slide's joint (that line has
    /// y = z = 0).
    fn platform(&self, tip: [f64; 3], theta: f64, i: usize) -> [f64; 3] {
        let g = &self.lengths;
        [
            tip[0] + self.up(i) * libm::sin(theta),
            tip[1] + PAIRS[i] * g.b - PAIRS[i] * (g.a - g.e),
            tip[2] + self.up(i) * libm::cos(theta) - (PAIRS[i] * g.d - g.g_e),
        ]
    }

    /// Returns S^2 of rod i, which decides where the rods of a pair meet the rails.
    fn reach_square(&self, tip: [f64; 3], theta: f64, i: usize) -> f64 {
        let [_, y, z] = self.platform(tip, theta, i);
        self.lengths.r * self.lengths.r - y * y - z * z
    }

    /// Signed distance from the parallel singularity: the platform's joints, drawn together by the
    /// spacing, relative to the plane in which the rods of both pairs lie flat. It is measured in
    /// the plane of y and z, from the line through +-(E, D).
    fn distance(&self, tip: [f64; 3], theta: f64) -> f64 {
        let g = &self.lengths;
        let upper = self.platform(tip, theta, 0);
        let lower = self.platform(tip, theta, 2);
        // Both vectors point from a rail to its joint; they are parallel at the singularity.
        let cross = upper[1] * lower[2] - upper[2] * lower[1];
        let base = libm::hypot(upper[1] - lower[1], upper[2] - lower[2]);
        // For D = y = 0 and E > 0 this cross product is -2 E Z: positive below the rails.
        let side = if g.below { 1.0 } else { -1.0 };
        side * cross / base * if g.a - g.b - g.e < 0.0 { -1.0 } else { 1.0 }
    }

    /// Returns a pose from theta and the platform's position (t, q) along and across the line of
    /// centres.
    fn on_line(&self, theta: f64, t: f64, q: f64, x: f64, alpha: f64) -> Reals {
        let g = &self.lengths;
        let (e, d) = (g.a - g.b - g.e, g.d - g.c * libm::cos(theta));
        let base = libm::hypot(e, d);
        let q = if g.below { -q } else { q };
        let y = (e * t - d * q) / base;
        let z = (d * t + e * q) / base - g.g_e - (g.c + g.t_l) * libm::cos(theta);
        self.on_the_table([x, y, z], theta, alpha)
    }
}

impl Arm {
    /// Returns the distances of a pose from each bound, with the reach limit at this fraction of R.
    fn margins_with_reach(&self, pose: &Reals, reach: f64) -> Margins {
        let g = &self.lengths;
        let tip = self.tip(pose);
        let tilt = |error: &PoseError| *error == TILT;
        let mut margins: Vec<Margin, 12> = Vec::new();
        let unreachable = |error: &PoseError| *error == PoseError::Unreachable;
        margins.extend([
            // The tilt must be below a quarter turn.
            Margin::rad(FRAC_PI_2 - pose[3].abs() - RADIAN, tilt),
            Margin::rad(FRAC_PI_2 - pose[4].abs() + RADIAN, tilt),
            // N = 4 c sin(theta) is rounded to a raw unit before it is compared with 4 c.
            Margin::mm((1.0 - libm::sin(pose[3]).abs()) * 4.0 * g.c, unreachable),
            Margin::mm(self.distance(tip, pose[3]) - g.margin, |error| {
                matches!(error, PoseError::NearSingularity { .. })
            }),
        ]);
        for (i, names) in [
            (0, (|error| *error == near_reach_limit(0)) as fn(&_) -> bool),
            (2, |error| *error == near_reach_limit(1)),
        ] {
            let square = self.reach_square(tip, pose[3], i);
            margins.extend([
                Margin::mm(libm::sqrt(square.max(0.0)) - reach * g.r, names),
                // The root is steep here. The square divided by 2 R is a length.
                Margin::mm(square / (2.0 * g.r), unreachable),
            ]);
        }
        Margins(margins)
    }
}

impl Subject for Arm {
    type Machine = H4;

    fn machine(&self) -> &H4 {
        &self.machine
    }

    fn random_pose(&self, sequence: &mut Sequence) -> Reals {
        let theta = sequence.between(-1.2, 1.2);
        let alpha = sequence.between(-1.5, 1.5);
        let t = sequence.between(-200.0, 200.0);
        let q = sequence.between(-20.0, 420.0);
        let x = sequence.between(600.0, 1000.0);
        self.on_line(theta, t, q, x, alpha)
    }

    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals {
        let g = &self.lengths;
        let mut theta = sequence.between(-1.2, 1.2);
        let alpha = sequence.between(-1.5, 1.5);
        let x = sequence.between(600.0, 1000.0);
        let near = sequence.logarithmic(-7.0, 1.0);
        let t = sequence.between(-200.0, 200.0);
        let q = sequence.between(10.0, 400.0);
        match sequence.below(4) {
            // The singularity margin, from both sides, and the branch beyond.
            0 => self.on_line(theta, t, g.margin + near, x, alpha),
            1 => self.on_line(theta, t, near, x, alpha),
            2 => {
                // The tilt: 1 - sin(theta) is proportional to the square of this.
                theta = FRAC_PI_2 - near.abs().min(1.0);
                theta = if near < 0.0 { -theta } else { theta };
                self.on_line(theta, t, q, x, alpha)
            }
            _ => {
                // A rod pair at the reach limit: y, Z on the circle of that radius about the pair's
                // rail.
                let s = (0.1 * g.r + near).max(0.0);
                let radius = libm::sqrt(g.r * g.r - s * s);
                let turn = sequence.between(-PI, PI);
                let side = if sequence.next() & 1 == 0 { 1.0 } else { -1.0 };
                let (e, d) = (g.a - g.b - g.e, g.d - g.c * libm::cos(theta));
                let y = side * e + radius * libm::cos(turn);
                let z = side * d + radius * libm::sin(turn);
                let z = z - g.g_e - (g.c + g.t_l) * libm::cos(theta);
                self.on_the_table([x, y, z], theta, alpha)
            }
        }
    }

    fn random_joints(&self, sequence: &mut Sequence) -> Joints {
        let g = &self.lengths;
        let mut joints = Joints::default();
        let middle = sequence.between(600.0, 1000.0);
        let mut lean = sequence.between(-1.1, 1.1);
        let mut reach = [0.0; 2];
        for reach in &mut reach {
            // Beyond both bounds, or near one of them, sometimes with the wrong sign.
            *reach = match sequence.below(4) {
                0 => 0.09 * g.r + sequence.logarithmic(-6.5, 1.5),
                1 => g.r + sequence.logarithmic(-6.5, 1.5),
                _ => sequence.between(-0.2 * g.r, 1.05 * g.r),
            };
        }
        if sequence.below(4) == 0 {
            lean = libm::copysign(1.0 - sequence.logarithmic(-8.0, -0.5), lean);
        }
        for i in 0..4 {
            let tilt = PAIRS[i] * g.c * lean;
            let slide = middle + tilt + SIDES[i] * (g.w + reach[i / 2]);
            joints.0[i] = Coordinate(libm::round(slide / MM) as i32);
        }
        joints.0[4] = Coordinate(libm::round(sequence.between(-1.6, 1.6) / RADIAN) as i32);
        joints
    }

    fn margins(&self, pose: &Reals) -> Margins {
        self.margins_with_reach(pose, 0.1)
    }

    fn measured_margins(&self, pose: &Reals) -> Margins {
        self.margins_with_reach(pose, 0.09)
    }

    fn close(&self, pose: &Reals) -> Option<Reals> {
        let tip = self.tip(pose);
        let mut joints = [0.0; 6];
        for i in 0..4 {
            let square = self.reach_square(tip, pose[3], i);
            if square < 0.0 {
                return None;
            }
            // The sphere of radius R about the platform's joint intersects the rail twice, and s_i
            // selects the intersection. The slide is w farther out.
            let joint = self.platform(tip, pose[3], i)[0] + SIDES[i] * libm::sqrt(square);
            joints[i] = joint + SIDES[i] * self.lengths.w;
        }
        joints[4] = pose[4];
        Some(joints)
    }

    fn solve(&self, joints: &Reals, guess: &Reals) -> Option<Reals> {
        let g = &self.lengths;
        let tip = self.tip(guess);
        let mut q = [tip[0], tip[1], tip[2], guess[3]];
        for _ in 0..20 {
            // Half of |rod|^2 - R^2 and its gradient: rod . d(platform joint).
            let mut rows = [[0.0; 5]; 4];
            for (i, row) in rows.iter_mut().enumerate() {
                let joint = self.platform([q[0], q[1], q[2]], q[3], i);
                let rod = [joint[0] - (joints[i] - SIDES[i] * g.w), joint[1], joint[2]];
                let lever = [self.up(i) * libm::cos(q[3]), -self.up(i) * libm::sin(q[3])];
                let length = rod[0] * rod[0] + rod[1] * rod[1] + rod[2] * rod[2];
                *row = [
                    rod[0],
                    rod[1],
                    rod[2],
                    rod[0] * lever[0] + rod[2] * lever[1],
                    0.5 * (g.r * g.r - length),
                ];
            }
            let step = eliminate(rows)?;
            for (value, step) in q.iter_mut().zip(step) {
                *value += step;
            }
            let size = step[..3]
                .iter()
                .fold(350.0 * step[3].abs(), |size, step| size.max(step.abs()));
            // Near a quarter turn the tilt is ill conditioned, and the noise of the step grows with
            // 1 / cos(theta).
            if size * libm::cos(q[3]).abs() < 1e-10 {
                return Some(self.on_the_table([q[0], q[1], q[2]], q[3], joints[4]));
            }
        }
        None
    }
}

/// Gaussian elimination with pivoting.
fn eliminate(mut rows: [[f64; 5]; 4]) -> Option<[f64; 4]> {
    for i in 0..4 {
        let pivot = (i..4).max_by(|&a, &b| rows[a][i].abs().total_cmp(&rows[b][i].abs()))?;
        rows.swap(i, pivot);
        let head = rows[i];
        if head[i] == 0.0 {
            return None;
        }
        for row in &mut rows[i + 1..] {
            let factor = row[i] / head[i];
            for (value, head) in row.iter_mut().zip(head) {
                *value -= factor * head;
            }
        }
    }
    let mut solution = [0.0; 4];
    for i in (0..4).rev() {
        let rest: f64 = (i + 1..4).map(|j| rows[i][j] * solution[j]).sum();
        solution[i] = (rows[i][4] - rest) / rows[i][i];
    }
    Some(solution)
}
