//! The sections `[haptic]`, the haptic arm (docs/control.md 2.2, 3.4, 3.5), and `[follow]`, the
//! motion of the tool by a master.

use super::document::{Section, real, whole};
use super::scale::{PER_COUNT, PER_DEG, PER_EFFORT, PER_MM, to_i32, to_i64, to_u16, to_u32};
use haptimill_firmware::haptics::config::{Amplifier, Encoder, FollowConfig, HapticConfig};
use haptimill_firmware::haptics::passivity::PassivityConfig;
use haptimill_firmware::haptics::walls::WallConfig;
use haptimill_firmware::io::LEGS;
use haptimill_kinematics::haptic_arm::HapticGeometry;
use haptimill_math::force::Force;
use haptimill_math::{Angle, Coordinate, Effort, Length};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis};

/// Components of a force, in order.
const AXES: [&str; 3] = ["x", "y", "z"];

/// Converts newtons.
fn force(newtons: f64) -> Force {
    Force(to_i32(newtons * PER_EFFORT))
}

fn length(millimetres: f64) -> Length {
    Length(to_i32(millimetres * PER_MM))
}

/// Reads `[follow]`.
pub fn read_follow(section: &Section<'_, '_>) -> FollowConfig {
    let scale = section.number("scale", real(0.1, 2.0, ""));
    let gain = section.number("gain_per_s", whole(10, 500, "1/s"));
    let stale = section.number("stale_ms", whole(5, 1000, "ms"));
    section.finish();
    FollowConfig {
        scale: to_u16(scale * 4096.0),
        gain: to_u16(gain),
        stale_ms: to_u16(stale),
    }
}

/// Reads `[haptic]`.
pub fn read_haptic(section: &Section<'_, '_>) -> HapticConfig {
    let illegal = section.number("illegal_transitions", whole(0, 1000, ""));
    let condition = section.number("condition", whole(2, 1000, ""));
    let filter = section.number("rate_filter_ms", real(0.5, 20.0, "ms"));
    let ball = section.number("ball_mm", real(0.0, 50.0, "mm"));
    let step = section.number("step_n", real(1e-4, 0.05, "N"));
    let geometry = section.section("geometry").map(read_geometry);
    let ranges = section.section("range").map(read_ranges);
    let legs: Vec<_> = section.list("leg").into_iter().map(read_leg).collect();
    if !legs.is_empty() && legs.len() != LEGS {
        let what = format!("has {} sections, the arm has {LEGS} legs", legs.len());
        section.report("leg", what, "write one for each leg");
    }
    let reflection = section.section("reflection").map(read_reflection);
    let wall = section.section("wall").map(read_wall);
    let passivity = section.section("passivity").map(read_passivity);
    section.finish();
    let place = |index: usize| legs.get(index).cloned().unwrap_or_else(placeholder_leg);
    HapticConfig {
        geometry: geometry.unwrap_or_else(placeholder_geometry),
        sensors: [0, 1, 2].map(|index| place(index).0),
        drives: [0, 1, 2].map(|index| place(index).1),
        ranges: ranges.unwrap_or([(Coordinate(0), Coordinate(0)); 3]),
        illegal_transitions: to_u16(illegal),
        condition: to_u16(condition),
        rate_filter_us: to_u16(filter * 1000.0),
        ball: length(ball),
        step: force(step),
        reflection: reflection.unwrap_or_default(),
        wall: wall.unwrap_or(WallConfig {
            stiffness: 0,
            most: Force::ZERO,
        }),
        passivity: passivity.unwrap_or(PassivityConfig {
            surplus: 0,
            deficit: 0,
            damping: 0,
        }),
    }
}

fn read_geometry(section: Section<'_, '_>) -> HapticGeometry {
    let radius = |key| section.number(key, real(10.0, 400.0, "mm"));
    let (base, platform, link) = (
        radius("base_radius_mm"),
        radius("platform_radius_mm"),
        radius("link_mm"),
    );
    let tilt = section.number("tilt_deg", real(-79.9, 79.9, "deg"));
    let tip = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
        .map(|key| section.number(key, real(-400.0, 400.0, "mm")));
    let side = section.number("side_tolerance_mm", real(0.001, 50.0, "mm"));
    if side * 8.0 >= platform {
        let what = format!("{side} mm is not below an eighth of platform_radius_mm = {platform}");
        section.report("side_tolerance_mm", what, "lower it");
    }
    section.finish();
    HapticGeometry {
        base_radius: length(base),
        platform_radius: length(platform),
        link: length(link),
        tilt: Angle(to_i32(tilt * PER_DEG)),
        tip: tip.map(length),
        side_tolerance: length(side),
    }
}

/// Reads the ranges of d, theta3 and theta4.
fn read_ranges(section: Section<'_, '_>) -> [(Coordinate, Coordinate); 3] {
    let range = |low_key, high_key, (low, high, unit), scale: f64| {
        let (first, last) = (
            section.number(low_key, real(low, high, unit)),
            section.number(high_key, real(low, high, unit)),
        );
        if first >= last {
            let what = format!("{last} {unit} is not above {low_key} = {first}");
            section.report(high_key, what, "exchange them");
        }
        let coordinate = |value: f64| Coordinate(to_i32(value * scale));
        (coordinate(first), coordinate(last))
    };
    let ranges = [
        range(
            "slide_low_mm",
            "slide_high_mm",
            (-800.0, 800.0, "mm"),
            PER_MM,
        ),
        range(
            "turn_low_deg",
            "turn_high_deg",
            (-179.0, 179.0, "deg"),
            PER_DEG,
        ),
        range(
            "lean_low_deg",
            "lean_high_deg",
            (-179.0, 179.0, "deg"),
            PER_DEG,
        ),
    ];
    section.finish();
    ranges
}

/// Reads encoders and amplifiers of a leg.
fn read_leg(section: Section<'_, '_>) -> ([Encoder; 3], [Amplifier; 2]) {
    let encoder = |counts_key, home_key, is_rotary: bool| {
        let (unit, most) = if is_rotary {
            ("counts/turn", 1e8)
        } else {
            ("counts/mm", 1e6)
        };
        let counts = section.number(counts_key, real(-most, most, unit));
        if counts == 0.0 {
            section.report(
                counts_key,
                "0 counts are not allowed",
                "write the counts of the encoder",
            );
        }
        let (home, scale) = if is_rotary {
            (
                section.number(home_key, real(-179.0, 179.0, "deg")),
                PER_DEG,
            )
        } else {
            (section.number(home_key, real(-800.0, 800.0, "mm")), PER_MM)
        };
        let per_unit = if is_rotary { 360.0 * PER_DEG } else { PER_MM };
        let per_count = per_unit / counts * PER_COUNT;
        if counts != 0.0 && !(4096.0..2f64.powi(40)).contains(&per_count.abs()) {
            let what = format!("{counts} {unit} are beyond the number range of the controller");
            let remedy = if per_count.abs() < 4096.0 {
                "lower it"
            } else {
                "raise it"
            };
            section.report(counts_key, what, remedy);
        }
        Encoder {
            per_count: to_i64(per_count),
            preset: Coordinate(to_i32(home * scale)),
        }
    };
    let sensors = [
        encoder("slide_counts_per_mm", "slide_home_mm", false),
        encoder("turn_counts_per_turn", "turn_home_deg", true),
        encoder("lean_counts_per_turn", "lean_home_deg", true),
    ];
    let amplifier = |full_key, limit_key, unit, scale: f64| {
        let full = section.number(full_key, real(-30_000.0, 30_000.0, unit));
        let limit = section.number(limit_key, real(1e-3, 30_000.0, unit));
        if limit > full.abs() {
            let what = format!("{limit} {unit} is above {full_key} = {full}");
            section.report(limit_key, what, "lower it");
        }
        Amplifier {
            full_scale: Effort(to_i32(full * scale)),
            limit: Effort(to_i32(limit * scale)),
        }
    };
    let drives = [
        amplifier("slide_full_scale_n", "slide_limit_n", "N", PER_EFFORT),
        amplifier(
            "turn_full_scale_n_mm",
            "turn_limit_n_mm",
            "N mm",
            PER_EFFORT / 1000.0,
        ),
    ];
    section.finish();
    (sensors, drives)
}

fn read_reflection(section: Section<'_, '_>) -> ForceFeedback {
    let mut axes = [ForceFeedbackAxis::default(); 3];
    let keys = [
        ("x_percent", "x_most_n"),
        ("y_percent", "y_most_n"),
        ("z_percent", "z_most_n"),
    ];
    for ((axis, (percent, most)), _) in axes.iter_mut().zip(keys).zip(AXES) {
        let percent = section.number(percent, whole(0, 100, "%"));
        let most = section.number(most, real(0.0, 10.0, "N"));
        *axis = ForceFeedbackAxis {
            percent: to_u16(percent).min(100) as u8,
            limit: force(most).0,
        };
    }
    let boost = section.number("boost_n_s_per_mm", real(0.0, 0.99, "N s/mm"));
    let below = section.number("boost_below_n", real(0.5, 10.0, "N"));
    section.finish();
    ForceFeedback {
        axes,
        damping: to_u16(boost * PER_EFFORT),
        damping_below: force(below).0,
    }
}

fn read_wall(section: Section<'_, '_>) -> WallConfig {
    let stiffness = section.number("stiffness_n_per_mm", real(0.05, 2.0, "N/mm"));
    let most = section.number("most_n", real(0.5, 10.0, "N"));
    section.finish();
    WallConfig {
        stiffness: to_u32(stiffness * PER_EFFORT),
        most: force(most),
    }
}

fn read_passivity(section: Section<'_, '_>) -> PassivityConfig {
    let credit = section.number("credit_n_mm", real(0.0, 100.0, "N mm"));
    let debt = section.number("debt_n_mm", real(0.01, 100.0, "N mm"));
    let damping = section.number("damping_n_s_per_mm", real(0.0, 0.5, "N s/mm"));
    section.finish();
    PassivityConfig {
        surplus: to_u32(credit * PER_EFFORT),
        deficit: to_u32(debt * PER_EFFORT),
        damping: to_u32(damping * PER_EFFORT),
    }
}

/// Placeholder for a leg that is missing or has problems; a problem is reported with it.
const fn placeholder_leg() -> ([Encoder; 3], [Amplifier; 2]) {
    let encoder = Encoder {
        per_count: 0,
        preset: Coordinate(0),
    };
    let amplifier = Amplifier {
        full_scale: Effort(0),
        limit: Effort(0),
    };
    ([encoder; 3], [amplifier; 2])
}

/// As [`placeholder_leg`].
const fn placeholder_geometry() -> HapticGeometry {
    let zero = Length(0);
    HapticGeometry {
        base_radius: zero,
        platform_radius: zero,
        link: zero,
        tilt: Angle(0),
        tip: [zero; 3],
        side_tolerance: zero,
    }
}
