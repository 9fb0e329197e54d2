//! The haptic arm in f64, from the geometry of docs/control.md 2.2-2.3: an independent truth for
//! the tests.
use haptimill_kinematics::haptic_arm::{HapticGeometry, LegReading};
use haptimill_math::{Angle, Length};

pub const PER_MM: f64 = 1_048_576.0;
pub const PER_RADIAN: f64 = 4_294_967_296.0 / std::f64::consts::TAU;

pub type V = [f64; 3];
pub type M = [V; 3];

/// REF-M of docs/control.md 7.2, with the tip 150 mm beyond the platform.
pub fn reference() -> HapticGeometry {
    HapticGeometry {
        base_radius: Length::millimetres(150),
        platform_radius: Length::millimetres(50),
        link: Length::millimetres(200),
        tilt: Angle::degrees(30),
        tip: [Length::ZERO, Length::ZERO, Length::millimetres(150)],
        side_tolerance: Length::nanometres(400_000),
    }
}

pub fn add(a: V, b: V) -> V {
    std::array::from_fn(|k| a[k] + b[k])
}

pub fn sub(a: V, b: V) -> V {
    std::array::from_fn(|k| a[k] - b[k])
}

pub fn scaled(a: V, s: f64) -> V {
    a.map(|x| x * s)
}

pub fn dot(a: V, b: V) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

pub fn norm(a: V) -> f64 {
    libm::sqrt(dot(a, a))
}

pub fn cross(a: V, b: V) -> V {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub fn apply(m: M, v: V) -> V {
    m.map(|row| dot(row, v))
}

pub fn transposed(m: M) -> M {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}

pub fn times(a: M, b: M) -> M {
    let b = transposed(b);
    a.map(|row| b.map(|column| dot(row, column)))
}

/// Rotation by `angle` about `axis` (Rodrigues).
pub fn rotation(axis: V, angle: f64) -> M {
    let k = scaled(axis, 1.0 / norm(axis));
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    let v = 1.0 - c;
    [
        [
            k[0] * k[0] * v + c,
            k[0] * k[1] * v - k[2] * s,
            k[0] * k[2] * v + k[1] * s,
        ],
        [
            k[0] * k[1] * v + k[2] * s,
            k[1] * k[1] * v + c,
            k[1] * k[2] * v - k[0] * s,
        ],
        [
            k[0] * k[2] * v - k[1] * s,
            k[1] * k[2] * v + k[0] * s,
            k[2] * k[2] * v + c,
        ],
    ]
}

/// Readings (d in mm, theta3, theta4 in rad) of a pose, by loop closure (2.3); `None` out of reach.
pub fn inverse(centre: V, turn: M) -> Option<[[f64; 3]; 3]> {
    let (rb, rp, l, t2) = (150.0, 50.0, 200.0, std::f64::consts::PI / 6.0);
    let mut all = [[0.0; 3]; 3];
    for (j, leg) in all.iter_mut().enumerate() {
        let azimuth = j as f64 * std::f64::consts::TAU / 3.0;
        let out = rotation([0.0, 0.0, 1.0], azimuth);
        let joint = add(centre, apply(turn, apply(out, [rp, 0.0, 0.0])));
        let q = sub(apply(transposed(out), joint), [rb, 0.0, 0.0]);
        let q = apply(rotation([0.0, 1.0, 0.0], t2), q);
        let sine = libm::hypot(q[0], q[1]) / l;
        if sine > 1.0 {
            return None;
        }
        let cosine = libm::sqrt(1.0 - sine * sine);
        *leg = [
            q[2] - l * cosine,
            libm::atan2(q[1], q[0]),
            libm::atan2(sine, cosine),
        ];
    }
    Some(all)
}

pub fn reading(leg: [f64; 3]) -> LegReading {
    LegReading {
        slide: Length(libm::round(leg[0] * PER_MM) as i32),
        turn: Angle(libm::round(leg[1] * PER_RADIAN) as i64 as i32),
        hinge: Angle(libm::round(leg[2] * PER_RADIAN) as i64 as i32),
    }
}

pub fn readings(legs: [[f64; 3]; 3]) -> [LegReading; 3] {
    legs.map(reading)
}

/// Seeded numbers.
pub struct Sequence(pub u64);

impl Sequence {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// A pose of the +-40 mm, 20 degree workspace of docs/control.md 7.2.
pub fn random_pose(sequence: &mut Sequence) -> (V, M) {
    let centre = [
        sequence.between(-40.0, 40.0),
        sequence.between(-40.0, 40.0),
        450.0 + sequence.between(-40.0, 40.0),
    ];
    let axis = [
        sequence.between(-1.0, 1.0),
        sequence.between(-1.0, 1.0),
        sequence.between(-1.0, 1.0),
    ];
    let angle = sequence.between(0.0, 20.0_f64.to_radians());
    (centre, rotation(axis, angle))
}
