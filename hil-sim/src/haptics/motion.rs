//! Motion state of the handle: position, attitude, twist. The attitude is a unit quaternion that is
//! turned by the exact rotation of each step.
//!
//! Units: mm, rad, s; base frame.

use super::geometry::{HandlePose, Matrix, Twist};
use crate::vector::{Vector, cross, dot, plus, times};

/// Pose and twist of the handle.
#[derive(Debug, Clone)]
pub struct HandleMotion {
    /// Centre of the platform, mm.
    pub centre: Vector,
    /// Unit quaternion: w, x, y, z.
    attitude: [f64; 4],
    /// Velocity of the centre, mm/s, then angular velocity, rad/s.
    pub twist: Twist,
}

impl HandleMotion {
    /// Standstill at a pose.
    pub fn at(pose: &HandlePose) -> Self {
        Self {
            centre: pose.centre,
            attitude: attitude(&pose.frame),
            twist: [0.0; 6],
        }
    }

    /// The frame of the platform.
    pub fn frame(&self) -> Matrix {
        let [w, x, y, z] = self.attitude;
        [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ]
    }

    /// Centre and frame of the platform.
    pub fn pose(&self) -> HandlePose {
        HandlePose {
            centre: self.centre,
            frame: self.frame(),
        }
    }

    /// Velocity of the centre.
    pub fn velocity(&self) -> Vector {
        [self.twist[0], self.twist[1], self.twist[2]]
    }

    /// Angular velocity.
    pub fn spin(&self) -> Vector {
        [self.twist[3], self.twist[4], self.twist[5]]
    }

    /// Velocity of a point `lever` from the centre.
    pub fn of_point(&self, lever: Vector) -> Vector {
        plus(self.velocity(), cross(self.spin(), lever))
    }

    /// Rotation from upright, as a rotation vector. Its length is 2 sin(angle / 2), which equals
    /// the angle within the range of an operator or a rail.
    pub fn turned(&self) -> Vector {
        let [w, x, y, z] = self.attitude;
        times([x, y, z], if w < 0.0 { -2.0 } else { 2.0 })
    }

    /// Moves for `dt` seconds at the present twist.
    pub fn drift(&mut self, dt: f64) {
        self.centre = plus(self.centre, times(self.velocity(), dt));
        let half = times(self.spin(), 0.5 * dt);
        let square = dot(half, half);
        let (sin, cos) = if square < 1e-4 {
            // Exact to the last bit at such angles, and four times as fast.
            let sinc = 1.0 - square / 6.0 * (1.0 - square / 20.0);
            (sinc, 1.0 - square / 2.0 * (1.0 - square / 12.0))
        } else {
            let angle = libm::sqrt(square);
            (libm::sin(angle) / angle, libm::cos(angle))
        };
        let [x, y, z] = times(half, sin);
        let [w, a, b, c] = self.attitude;
        let turned = [
            cos * w - x * a - y * b - z * c,
            cos * a + x * w + y * c - z * b,
            cos * b - x * c + y * w + z * a,
            cos * c + x * b - y * a + z * w,
        ];
        let square: f64 = turned.iter().map(|part| part * part).sum();
        // One Newton step for the inverse square root of a number near 1.
        self.attitude = turned.map(|part| part * (1.5 - 0.5 * square));
    }
}

/// The quaternion of a frame.
fn attitude(frame: &Matrix) -> [f64; 4] {
    let [[a, b, c], [d, e, f], [g, h, i]] = *frame;
    // Of the four equivalent formulas, the one with the largest root.
    let traces = [a + e + i, a - e - i, e - a - i, i - a - e];
    let first = (1..4).fold(0, |best, k| if traces[k] > traces[best] { k } else { best });
    let root = libm::sqrt(1.0 + traces[first]);
    let by = 0.5 / root;
    let half = 0.5 * root;
    match first {
        0 => [half, (h - f) * by, (c - g) * by, (d - b) * by],
        1 => [(h - f) * by, half, (b + d) * by, (c + g) * by],
        2 => [(c - g) * by, (b + d) * by, half, (f + h) * by],
        _ => [(d - b) * by, (c + g) * by, (f + h) * by, half],
    }
}
