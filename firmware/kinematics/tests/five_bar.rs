//! The other assembly and sound lengths of the five-bar arm: what the conformance suite does not
//! check.

use haptimill_kinematics::five_bar::{FiveBar, FiveBarGeometry};
use haptimill_kinematics::{Joints, Kinematics, Machine, Pose, PoseError};
use haptimill_math::{Coordinate, Length};

fn geometry(half_base: i32, proximal: i32, distal: i32) -> FiveBarGeometry {
    FiveBarGeometry {
        half_base: Length::millimetres(half_base),
        proximal: Length::millimetres(proximal),
        distal: Length::millimetres(distal),
        origin: [Length::millimetres(-35), Length::millimetres(120)],
        singularity_margin: Length::millimetres(20),
    }
}

fn arms() -> [FiveBar; 3] {
    [(80, 220, 280), (0, 250, 190), (140, 200, 200)].map(|(half_base, proximal, distal)| {
        let geometry = geometry(half_base, proximal, distal);
        assert!(FiveBar::is_sound(&geometry));
        FiveBar::new(&geometry)
    })
}

/// Degrees as a joint position.
fn degrees(value: f64) -> Coordinate {
    Coordinate((value / 360.0 * 4_294_967_296.0) as i32)
}

/// Elbows that the distal links cannot span, and arms bent inwards, have no pose.
#[test]
fn joints_of_another_assembly_are_refused() {
    let [arm, ..] = arms();
    let mut joints = Joints::default();
    for (theta1, theta2, found) in [
        (46.0, -46.0, true),
        (80.0, -80.0, false),
        // The tip is beyond the line of both left links: its elbow is on the right of it.
        (-60.0, -60.0, false),
        (60.0, 60.0, false),
    ] {
        joints.0[0] = degrees(theta1);
        joints.0[1] = degrees(theta2);
        let pose = arm.forward(&joints);
        assert_eq!(pose.is_ok(), found, "{theta1} {theta2}: {pose:?}");
        if !found {
            let near = matches!(pose, Err(PoseError::NearSingularity { .. }));
            assert!(near, "{pose:?}");
        }
    }
}

/// Lengths outside of the range of the arithmetic are unsound, and such a machine has no pose.
#[test]
fn unsound_lengths_have_no_pose() {
    let sound = geometry(80, 220, 280);
    let far = FiveBarGeometry {
        origin: [Length::millimetres(1501), sound.origin[1]],
        ..sound.clone()
    };
    let longest = FiveBarGeometry {
        distal: Length(i32::MAX),
        ..sound.clone()
    };
    let pose = Pose::default();
    assert!(FiveBar::new(&sound).inverse(&pose).is_ok());
    for geometry in [
        geometry(501, 220, 280),
        geometry(-1, 220, 280),
        geometry(80, 15, 280),
        geometry(80, 220, 1001),
        far,
        longest,
    ] {
        assert!(!FiveBar::is_sound(&geometry), "{geometry:?}");
        let arm = FiveBar::new(&geometry);
        assert!(arm.inverse(&pose).is_err(), "{geometry:?}");
        assert!(arm.forward(&Joints::default()).is_err(), "{geometry:?}");
    }
}
