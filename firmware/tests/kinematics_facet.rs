//! The chain of the faceting machine: the table of positions and rotations, every quadrant, both
//! branches, frames out of its reach, turns of the spin, and how it holds the height.

use core::f64::consts::{FRAC_1_SQRT_2, PI};
use haptimill_checks::kinematics::facet::{Lengths, Matrix, SHORT};
use haptimill_checks::kinematics::subject::{MM, RADIAN, Sequence};
use haptimill_kinematics::facet::chain::{Chain, ChainJoints, ChainPose, OutOfReach, unwrap};
use haptimill_kinematics::facet::{Facet, FacetGeometry};
use haptimill_kinematics::{Kinematics, Machine, Pose};
use haptimill_math::{Angle, Coordinate, Length};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Lengths A: as printed, in mm.
const A: Lengths = SHORT;
/// Lengths B: all three in dm.
const B: Lengths = Lengths {
    l3: 24.0,
    l4: 166.0,
    ..SHORT
};

fn geometry(lengths: &Lengths) -> FacetGeometry {
    lengths.geometry()
}

fn mm(value: f64) -> Coordinate {
    Coordinate((value / MM).round() as i32)
}

fn degrees(value: f64) -> Angle {
    Angle((value * PI / 180.0 / RADIAN).round() as i64 as i32)
}

fn joints(d1: f64, theta2: f64, theta3: f64) -> ChainJoints {
    ChainJoints {
        d1: mm(d1),
        theta2: degrees(theta2),
        theta3: degrees(theta3),
    }
}

/// d1, theta2, theta3, then p_x and p_z with lengths A and with lengths B; mm and degrees.
const TABLE: [([f64; 3], [f64; 2], [f64; 2]); 8] = [
    ([0.0, 0.0, 0.0], [280.24, 1.66], [304.0, 166.0]),
    ([50.0, 0.0, 90.0], [280.24, 51.66], [304.0, 216.0]),
    (
        [50.0, 30.0, 0.0],
        [281.037846, 51.317602],
        [383.784610, 181.760217],
    ),
    (
        [50.0, 45.0, 60.0],
        [281.343503, 51.004092],
        [414.350288, 150.409163],
    ),
    ([100.0, 90.0, 0.0], [281.66, 99.76], [446.0, 76.0]),
    (
        [100.0, -35.0, -120.0],
        [279.244460, 101.497451],
        [204.445961, 249.745074],
    ),
    (
        [25.0, 135.0, 150.0],
        [281.004092, 23.656497],
        [380.409163, -109.350288],
    ),
    ([0.0, 180.0, 45.0], [279.76, -1.66], [256.0, -166.0]),
];

#[test]
fn the_table_of_positions() {
    for (lengths, column) in [(A, 1), (B, 2)] {
        let chain = Chain::new(&geometry(&lengths));
        for ([d1, theta2, theta3], a, b) in TABLE {
            let frame = chain.forward(&joints(d1, theta2, theta3)).unwrap();
            let [x, y, z] = frame.position.map(|at| f64::from(at.0) * MM);
            let [px, pz] = if column == 1 { a } else { b };
            // The table has six decimals; the unit of a coordinate is 0.95 nm.
            assert!((x - px).abs() < 3e-6, "x {x} {px}");
            assert!((z - pz).abs() < 3e-6, "z {z} {pz}");
            assert_eq!(y, 0.0);
        }
    }
}

fn matrix(frame: &ChainPose) -> [[f64; 3]; 3] {
    frame
        .rotation
        .map(|row| row.map(|entry| f64::from(entry) / f64::from(1 << 30)))
}

fn determinant(m: &[[f64; 3]; 3]) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
}

/// Rows 4 and 7 of the table; a mirrored second row, as it was once printed, is no rotation.
#[test]
fn the_rotations_of_the_table() {
    let chain = Chain::new(&geometry(&A));
    let (h, q, r) = (0.612_372, 0.353_553, FRAC_1_SQRT_2);
    for (at, expected) in [
        (
            joints(50.0, 45.0, 60.0),
            [[q, -h, r], [0.866_025, 0.5, 0.0], [-q, h, r]],
        ),
        (
            joints(25.0, 135.0, 150.0),
            [[h, q, r], [0.5, -0.866_025, 0.0], [h, q, -r]],
        ),
    ] {
        let frame = chain.forward(&at).unwrap();
        let rotation = matrix(&frame);
        for (row, expected) in rotation.iter().zip(expected) {
            for (entry, expected) in row.iter().zip(expected) {
                assert!((entry - expected).abs() < 1e-6);
            }
        }
        assert!((determinant(&rotation) - 1.0).abs() < 1e-8);
        let mut mirrored = frame;
        mirrored.rotation[1] = mirrored.rotation[1].map(|entry| -entry);
        assert!((determinant(&matrix(&mirrored)) + 1.0).abs() < 1e-8);
        assert!(matches!(
            chain.inverse(&mirrored),
            Err(OutOfReach::Rotation(..))
        ));
    }
}

/// Row 7: arc tangents of one argument give d1 = 22.312994, theta2 = -45, theta3 = -30.
#[test]
fn the_tilt_beyond_a_quarter_turn_is_found() {
    let chain = Chain::new(&geometry(&A));
    let at = joints(25.0, 135.0, 150.0);
    let found = chain.inverse(&chain.forward(&at).unwrap()).unwrap();
    assert!((f64::from(found.d1.0) * MM - 25.0).abs() < 1e-5);
    assert!((f64::from(found.theta2.0) * RADIAN - 135.0_f64.to_radians()).abs() < 1e-8);
    assert!((f64::from(found.theta3.0) * RADIAN - 150.0_f64.to_radians()).abs() < 1e-8);
}

/// The general link transform with the rows of the D-H table is each of the four link transforms
/// as they are printed.
#[test]
fn the_links_of_the_table() {
    let mut sequence = Sequence(30);
    for _ in 0..1000 {
        let [d1, theta2, theta3] = random(&mut sequence);
        let ((s2, c2), (s3, c3)) = (theta2.sin_cos(), theta3.sin_cos());
        let printed: [Matrix; 4] = [
            [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, d1],
                [0.0, 0.0, 0.0, 1.0],
            ],
            [
                [c2, -s2, 0.0, B.l2],
                [0.0, 0.0, 1.0, 0.0],
                [-s2, -c2, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ],
            [
                [c3, -s3, 0.0, B.l3],
                [0.0, 0.0, -1.0, 0.0],
                [s3, c3, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ],
            [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, B.l4],
                [0.0, 0.0, 0.0, 1.0],
            ],
        ];
        for (link, printed) in B.links(d1, theta2, theta3).iter().zip(&printed) {
            for (entry, printed) in link.as_flattened().iter().zip(printed.as_flattened()) {
                assert!((entry - printed).abs() < 1e-12, "{link:?} {printed:?}");
            }
        }
    }
}

/// The rotation of the chain is a turn about y by theta2 after a turn about z by theta3.
#[test]
fn the_rotation_is_a_tilt_about_y_and_a_spin_about_z() {
    let mut sequence = Sequence(31);
    let chain = Chain::new(&geometry(&B));
    for _ in 0..20_000 {
        let at = ChainJoints {
            theta2: Angle(sequence.next() as i32),
            theta3: Angle(sequence.next() as i32),
            ..ChainJoints::default()
        };
        let [tilt, spin] = [at.theta2, at.theta3].map(|angle| f64::from(angle.0) * RADIAN);
        let about_y = Rotation3::from_axis_angle(&Vector3::y_axis(), tilt);
        let about_z = Rotation3::from_axis_angle(&Vector3::z_axis(), spin);
        let expected = (about_y * about_z).into_inner();
        let rotation = matrix(&chain.forward(&at).unwrap());
        for (i, row) in rotation.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                assert!((entry - expected[(i, j)]).abs() < 1e-8, "{rotation:?}");
            }
        }
    }
}

/// The Jacobian against differences of the products of the links: speeds, and turning rates by R'
/// R^T. Its rank is 3 everywhere: det(J^T J) = 1 + (L4 c2 - L3 s2)^2.
#[test]
fn the_jacobian_of_the_chain() {
    const STEP: f64 = 1e-5;
    let mut sequence = Sequence(32);
    for lengths in [A, B] {
        let chain = Chain::new(&geometry(&lengths));
        for _ in 0..2000 {
            let [d1, theta2, theta3] = random(&mut sequence);
            let raw = chain.jacobian(Angle((theta2 / RADIAN).round() as i64 as i32));
            let q32 = |entry: i64| entry as f64 / 4_294_967_296.0;
            // Columns of the angles: 2^-20 mm per 2^-32 turn to mm per radian.
            let speed = |row: usize, column: usize| match column {
                0 => q32(raw[row][0]),
                _ => q32(raw[row][column]) * MM / RADIAN,
            };
            let is: [[f64; 3]; 6] = core::array::from_fn(|row| {
                core::array::from_fn(|column| match row {
                    0..3 => speed(row, column),
                    _ => q32(raw[row][column]),
                })
            });
            for column in 0..3 {
                let at = |by: f64| {
                    let mut joints = [d1, theta2, theta3];
                    joints[column] += by;
                    lengths.frame(joints[0], joints[1], joints[2])
                };
                let (before, here, after) = (at(-STEP), at(0.0), at(STEP));
                let rate = |i: usize, j: usize| (after[i][j] - before[i][j]) / (2.0 * STEP);
                // R' R^T is the matrix of the cross product with the turning rate.
                let turning =
                    |i: usize, j: usize| -> f64 { (0..3).map(|k| rate(i, k) * here[j][k]).sum() };
                let expected = [
                    rate(0, 3),
                    rate(1, 3),
                    rate(2, 3),
                    turning(2, 1),
                    turning(0, 2),
                    turning(1, 0),
                ];
                for (row, expected) in is.iter().zip(expected) {
                    assert!((row[column] - expected).abs() < 1e-5, "{is:?} {column}");
                }
            }
            let gram: Matrix3<f64> =
                Matrix3::from_fn(|i, j| is.iter().map(|row| row[i] * row[j]).sum());
            let along = lengths.l4 * theta2.cos() - lengths.l3 * theta2.sin();
            let expected = 1.0 + along * along;
            assert!((gram.determinant() / expected - 1.0).abs() < 1e-5, "{gram}");
        }
    }
}

fn random(sequence: &mut Sequence) -> [f64; 3] {
    [
        sequence.between(-200.0, 200.0),
        sequence.between(-PI, PI),
        sequence.between(-PI, PI),
    ]
}

/// Over all quadrants, against products of the link transforms: at most 0.1 um and 1 urad.
#[test]
fn both_directions_agree_with_the_table_of_links() {
    let mut sequence = Sequence(22);
    let (mut worst_mm, mut worst_rad) = (0.0_f64, 0.0_f64);
    for lengths in [A, B] {
        let chain = Chain::new(&geometry(&lengths));
        for count in 0..100_000 {
            let [d1, mut theta2, mut theta3] = random(&mut sequence);
            if count % 10 == 0 {
                theta2 = (theta2 / (PI / 2.0)).round() * PI / 2.0;
                theta3 = (theta3 / (PI / 2.0)).round() * PI / 2.0;
            }
            let at = ChainJoints {
                d1: mm(d1),
                theta2: Angle((theta2 / RADIAN).round() as i64 as i32),
                theta3: Angle((theta3 / RADIAN).round() as i64 as i32),
            };
            let [d1, theta2, theta3] = [
                f64::from(at.d1.0) * MM,
                f64::from(at.theta2.0) * RADIAN,
                f64::from(at.theta3.0) * RADIAN,
            ];
            let truth = lengths.frame(d1, theta2, theta3);
            let frame = chain.forward(&at).unwrap();
            for (row, truth) in matrix(&frame).iter().zip(&truth) {
                for (entry, truth) in row.iter().zip(truth) {
                    worst_rad = worst_rad.max((entry - truth).abs());
                }
            }
            for (at, truth) in frame.position.iter().zip(&truth) {
                worst_mm = worst_mm.max((f64::from(at.0) * MM - truth[3]).abs());
            }
            // The frame of the links, rounded: what a host sends.
            let sent = ChainPose {
                rotation: core::array::from_fn(|i| {
                    core::array::from_fn(|j| (truth[i][j] * f64::from(1 << 30)).round() as i32)
                }),
                position: [0, 1, 2].map(|i| mm(truth[i][3])),
            };
            let found = chain.inverse(&sent).unwrap();
            let apart = |a: Angle, b: f64| {
                let error = f64::from(a.0) * RADIAN - b;
                (error - 2.0 * PI * (error / (2.0 * PI)).round()).abs()
            };
            worst_rad = worst_rad.max(apart(found.theta2, theta2));
            worst_rad = worst_rad.max(apart(found.theta3, theta3));
            worst_mm = worst_mm.max((f64::from(found.d1.0) * MM - d1).abs());
        }
    }
    println!(
        "largest error {:.4} um, {:.4} urad",
        worst_mm * 1e3,
        worst_rad * 1e6
    );
    assert!(worst_mm < 1e-4 && worst_rad < 1e-6);
}

/// A frame that differs in one number by ten times the tolerance is refused.
#[test]
fn frames_out_of_reach_are_refused() {
    let mut sequence = Sequence(23);
    for lengths in [A, B] {
        let chain = Chain::new(&geometry(&lengths));
        for _ in 0..2000 {
            let [d1, theta2, theta3] = random(&mut sequence);
            let frame = chain
                .forward(&joints(d1, theta2.to_degrees(), theta3.to_degrees()))
                .unwrap();
            // r23 and p_y are 0, p_x belongs to the tilt.
            let mut turned = frame;
            turned.rotation[1][2] += 10_740;
            assert_eq!(chain.inverse(&turned), Err(OutOfReach::Rotation(1, 2)));
            for axis in 0..2 {
                let mut moved = frame;
                moved.position[axis].0 += 104_860;
                assert_eq!(chain.inverse(&moved), Err(OutOfReach::Position(axis as u8)));
            }
        }
    }
}

/// Frames near the tolerance of 1e-6 are refused as the residuals of the links say, but for the
/// rounding of 4 units of 2^-30.
#[test]
fn frames_at_the_tolerance_are_refused_by_their_residuals() {
    let mut sequence = Sequence(29);
    let (mut taken, mut refused) = (0, 0);
    for lengths in [A, B] {
        let chain = Chain::new(&geometry(&lengths));
        for _ in 0..20_000 {
            let [d1, theta2, theta3] = random(&mut sequence);
            let at = joints(d1, theta2.to_degrees(), theta3.to_degrees());
            let mut frame = chain.forward(&at).unwrap();
            for entry in frame.rotation.as_flattened_mut() {
                *entry += sequence.between(-1300.0, 1300.0) as i32;
            }
            let sent = matrix(&frame);
            let theta2 = sent[0][2].atan2(sent[2][2]);
            let theta3 = sent[1][0].atan2(sent[1][1]);
            let reached = lengths.frame(d1, theta2, theta3);
            let residual = (sent.iter().zip(&reached))
                .flat_map(|(sent, reached)| sent.iter().zip(reached))
                .map(|(sent, reached)| (sent - reached).abs() * f64::from(1 << 30))
                .fold(0.0, f64::max);
            match chain.inverse(&frame) {
                Ok(_) => {
                    taken += 1;
                    assert!(residual < 1078.0, "{residual}");
                }
                Err(OutOfReach::Rotation(..)) => {
                    refused += 1;
                    assert!(residual > 1070.0, "{residual}");
                }
                other => panic!("{other:?}"),
            }
        }
    }
    println!("{taken} taken, {refused} refused");
    assert!(taken > 1000 && refused > 1000);
}

/// Both branches bring the tip to its place, and meet at the singular angle.
#[test]
fn both_branches_reach_the_position() {
    let mut sequence = Sequence(24);
    for lengths in [A, B] {
        let chain = Chain::new(&geometry(&lengths));
        let [singular, other] = chain.singular_angles().map(|at| f64::from(at.0) * RADIAN);
        assert!((singular.to_degrees() - 81.7733).abs() < 1e-4);
        assert!((other.to_degrees() + 98.2267).abs() < 1e-4);
        for _ in 0..20_000 {
            let [d1, theta2, _] = random(&mut sequence);
            let at = joints(d1, theta2.to_degrees(), 0.0);
            let frame = chain.forward(&at).unwrap();
            let [x, _, z] = frame.position;
            let branches = chain.branches(x, z).unwrap();
            let near = (theta2 - singular).sin().abs();
            let allowed = 3.0 * MM * (1.0 + lengths.l3.hypot(lengths.l4)) / near.max(1e-3);
            let mut is_one_of_them = false;
            for branch in branches {
                let reached = chain.forward(&branch).unwrap();
                for axis in [0, 2] {
                    let error = reached.position[axis].0 - frame.position[axis].0;
                    assert!(f64::from(error).abs() * MM < 1e-4, "{error} {theta2}");
                }
                let apart = branch.theta2.wrapping_sub(at.theta2).0;
                let arm = lengths.l3.hypot(lengths.l4);
                is_one_of_them |= f64::from(apart).abs() * RADIAN * arm < allowed.max(1e-4);
            }
            assert!(is_one_of_them, "{theta2} {branches:?}");
        }
        let arm = lengths.l3.hypot(lengths.l4);
        assert_eq!(
            chain.branches(mm(280.0 + arm + 0.01), mm(0.0)),
            Err(OutOfReach::Arm)
        );
        let [one, two] = chain.branches(mm(280.0 + arm - 1e-6), mm(0.0)).unwrap();
        assert!(f64::from(one.theta2.wrapping_sub(two.theta2).0).abs() * RADIAN < 0.01);
    }
}

/// A pose with a constant height, while the angle moves: the lift moves by (p_x - L2) for each
/// radian, and the tip stays where it is.
#[test]
fn the_height_is_held_while_the_arm_tilts() {
    for lengths in [A, B] {
        let geometry = geometry(&lengths);
        let machine = Facet::new(&geometry);
        let chain = Chain::new(&geometry);
        let mut before: Option<(f64, f64)> = None;
        for step in 0..=20_000 {
            let angle = -PI + 2.0 * PI * f64::from(step) / 20_001.0;
            let mut pose = Pose::default();
            pose.0[2] = mm(7.25);
            pose.0[3] = Coordinate((angle / RADIAN).round() as i32);
            let joints = machine.inverse(&pose).unwrap();
            let frame = chain.forward(&machine.chain(&joints)).unwrap();
            let [x, _, z] = frame.position.map(|at| f64::from(at.0) * MM);
            assert!((z - lengths.z_lap - 7.25).abs() < 1e-5, "{z}");
            assert!((x - f64::from(joints.0[0].0) * MM).abs() < 1e-5);
            let d1 = f64::from(joints.0[2].0) * MM;
            if let Some((d1_before, x_before)) = before {
                let by = 2.0 * PI / 20_001.0;
                let rate = 0.5 * (x + x_before) - lengths.l2;
                assert!((d1 - d1_before - rate * by).abs() < 2e-8 * lengths.l4 + 3e-6);
            }
            before = Some((d1, x));
        }
    }
}

/// A spin that turns on keeps its direction over several turns.
#[test]
fn a_spin_is_unwrapped_over_turns() {
    let mut spin = 0_i64;
    for step in 0..1000_i64 {
        let angle = degrees(f64::from((step * 50 % 360) as i32));
        let next = unwrap(spin, angle);
        assert!(step == 0 || next > spin, "{step}");
        assert_eq!(Angle(next as i32), angle);
        spin = next;
    }
    let turns = spin as f64 / 4_294_967_296.0;
    assert!((turns - 999.0 * 50.0 / 360.0).abs() < 1e-6);
    assert_eq!(unwrap(spin, Angle(spin as i32)), spin);
}

/// Facet normals on the lap: the normal (sin b cos a, sin b sin a, cos b) of frame 4 points to the
/// lap with angle = b, index = 180 - a, and with angle = -b, index = -a, on either side of the lap.
#[test]
fn a_facet_is_on_the_lap_in_both_branches() {
    let mut sequence = Sequence(25);
    for lap_dir in [1.0, -1.0] {
        let lengths = Lengths { lap_dir, ..B };
        let geometry = geometry(&lengths);
        let (machine, chain) = (Facet::new(&geometry), Chain::new(&geometry));
        for _ in 0..5000 {
            let (b, a) = (sequence.between(0.0, PI / 2.0), sequence.between(-PI, PI));
            let distance = sequence.between(0.5, 8.0);
            let normal = [b.sin() * a.cos(), b.sin() * a.sin(), b.cos()];
            for (angle, index) in [(b, PI - a), (-b, -a)] {
                let raw = |angle: f64| Coordinate((angle / RADIAN).round() as i64 as i32);
                let mut pose = Pose::default();
                pose.0[2] = mm(distance);
                pose.0[3] = raw(angle);
                pose.0[4] = raw(index);
                let joints = machine.inverse(&pose).unwrap();
                let frame = chain.forward(&machine.chain(&joints)).unwrap();
                let to_base = matrix(&frame)
                    .map(|row| row[0] * normal[0] + row[1] * normal[1] + row[2] * normal[2]);
                for (is, goal) in to_base.iter().zip([0.0, 0.0, lap_dir]) {
                    assert!((is - goal).abs() < 1e-8, "{to_base:?}");
                }
                // The plane of the facet is the lap.
                let z = f64::from(frame.position[2].0) * MM + distance * to_base[2];
                assert!((z - lengths.z_lap).abs() < 1e-5);
                // And the frame has these joints only.
                let found = chain.inverse(&frame).unwrap();
                let apart = found.theta2.wrapping_sub(machine.chain(&joints).theta2).0;
                assert!(apart.abs() < 16);
            }
        }
    }
}

/// Lengths that the arithmetic does not hold are refused.
#[test]
fn an_arm_of_more_than_1024_mm_is_not_sound() {
    let long = FacetGeometry {
        l4: Length::millimetres(1025),
        ..geometry(&A)
    };
    assert!(!Facet::is_sound(&long));
    assert!(Facet::is_sound(&geometry(&B)));
}
