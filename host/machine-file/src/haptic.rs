//! The sections `[haptic]`, the haptic arm (docs/control.md 2.2, 3.4, 3.5), and `[follow]`, the
//! motion of the tool by a master.

use super::document::Section;
use super::scale::{PER_COUNT, PER_DEG, PER_EFFORT, PER_MM, to_i32, to_i64, to_u16, to_u32};
use haptimill_firmware::haptics::config::{Amplifier, Encoder, FollowConfig, HapticConfig};
use haptimill_firmware::haptics::fixture::FixtureConfig;
use haptimill_firmware::haptics::passivity::PassivityConfig;
use haptimill_firmware::io::LEGS;
use haptimill_kinematics::haptic_arm::HapticGeometry;
use haptimill_machine_keys::Key;
use haptimill_machine_keys::haptic as keys;
use haptimill_math::force::Force;
use haptimill_math::{Angle, Coordinate, Effort, Length};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis};

/// Converts newtons.
fn force(newtons: f64) -> Force {
    Force(to_i32(newtons * PER_EFFORT))
}

fn length(millimetres: f64) -> Length {
    Length(to_i32(millimetres * PER_MM))
}

/// Reads `[follow]`.
pub fn read_follow(section: &Section<'_, '_>) -> FollowConfig {
    let scale = section.value(keys::follow::scale);
    let gain = section.value(keys::follow::gain_per_s);
    let stale = section.value(keys::follow::stale_ms);
    section.finish();
    FollowConfig {
        scale: to_u16(scale * 4096.0),
        gain: to_u16(gain),
        stale_ms: to_u16(stale),
    }
}

/// Reads `[haptic]`.
pub fn read_haptic(section: &Section<'_, '_>) -> HapticConfig {
    let illegal = section.value(keys::haptic::illegal_transitions);
    let condition = section.value(keys::haptic::condition);
    let filter = section.value(keys::haptic::rate_filter_ms);
    let ball = section.value(keys::haptic::tip_ball_mm);
    let step = section.value(keys::haptic::force_step_n);
    let geometry = section.section("geometry").map(read_geometry);
    let ranges = section.section("range").map(read_ranges);
    let legs: Vec<_> = section.list("leg").into_iter().map(read_leg).collect();
    if !legs.is_empty() && legs.len() != LEGS {
        let what = format!("has {} sections, the arm has {LEGS} legs", legs.len());
        section.report("leg", what, "write one for each leg");
    }
    let feedback = section.section("feedback").map(read_feedback);
    let fixture = section.section("fixture").map(read_fixture);
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
        feedback: feedback.unwrap_or_default(),
        fixture: fixture.unwrap_or(FixtureConfig {
            stiffness: 0,
            max: Force::ZERO,
        }),
        passivity: passivity.unwrap_or(PassivityConfig {
            surplus: 0,
            deficit: 0,
            damping: 0,
        }),
    }
}

fn read_geometry(section: Section<'_, '_>) -> HapticGeometry {
    let (base, platform, link) = (
        section.value(keys::geometry::base_radius_mm),
        section.value(keys::geometry::platform_radius_mm),
        section.value(keys::geometry::link_mm),
    );
    let tilt = section.value(keys::geometry::tilt_deg);
    let tip = [
        keys::geometry::tip_x_mm,
        keys::geometry::tip_y_mm,
        keys::geometry::tip_z_mm,
    ]
    .map(|key| section.value(key));
    let side = section.value(keys::geometry::side_tolerance_mm);
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
    let range = |low: Key, high: Key, scale: f64| {
        let (first, last) = (section.value(low), section.value(high));
        if first >= last {
            let unit = high.values.unit();
            let what = format!("{last} {unit} is not above {} = {first}", low.name);
            section.report(high.name, what, "exchange them");
        }
        let coordinate = |value: f64| Coordinate(to_i32(value * scale));
        (coordinate(first), coordinate(last))
    };
    let ranges = [
        range(
            keys::range::slide_low_mm,
            keys::range::slide_high_mm,
            PER_MM,
        ),
        range(
            keys::range::turn_low_deg,
            keys::range::turn_high_deg,
            PER_DEG,
        ),
        range(
            keys::range::hinge_low_deg,
            keys::range::hinge_high_deg,
            PER_DEG,
        ),
    ];
    section.finish();
    ranges
}

/// Reads encoders and amplifiers of a leg.
fn read_leg(section: Section<'_, '_>) -> ([Encoder; 3], [Amplifier; 2]) {
    let encoder = |counts_key: Key, home_key: Key, is_rotary: bool| {
        let unit = counts_key.values.unit();
        let counts = section.value(counts_key);
        if counts == 0.0 {
            section.report(
                counts_key.name,
                "0 counts are not allowed",
                "write the counts of the encoder",
            );
        }
        let home = section.value(home_key);
        let scale = if is_rotary { PER_DEG } else { PER_MM };
        let per_unit = if is_rotary { 360.0 * PER_DEG } else { PER_MM };
        let per_count = per_unit / counts * PER_COUNT;
        if counts != 0.0 && !(4096.0..2f64.powi(40)).contains(&per_count.abs()) {
            let what = format!("{counts} {unit} are beyond the number range of the controller");
            let remedy = if per_count.abs() < 4096.0 {
                "lower it"
            } else {
                "raise it"
            };
            section.report(counts_key.name, what, remedy);
        }
        Encoder {
            per_count: to_i64(per_count),
            preset: Coordinate(to_i32(home * scale)),
        }
    };
    use keys::leg;
    let sensors = [
        encoder(leg::slide_counts_per_mm, leg::slide_home_mm, false),
        encoder(leg::turn_counts_per_turn, leg::turn_home_deg, true),
        encoder(leg::hinge_counts_per_turn, leg::hinge_home_deg, true),
    ];
    let amplifier = |full_key: Key, limit_key: Key, scale: f64| {
        let (full, limit) = (section.value(full_key), section.value(limit_key));
        if limit > full.abs() {
            let unit = limit_key.values.unit();
            let what = format!("{limit} {unit} is above {} = {full}", full_key.name);
            section.report(limit_key.name, what, "lower it");
        }
        Amplifier {
            full_scale: Effort(to_i32(full * scale)),
            limit: Effort(to_i32(limit * scale)),
        }
    };
    let drives = [
        amplifier(leg::slide_full_scale_n, leg::slide_limit_n, PER_EFFORT),
        amplifier(
            leg::turn_full_scale_n_mm,
            leg::turn_limit_n_mm,
            PER_EFFORT / 1000.0,
        ),
    ];
    section.finish();
    (sensors, drives)
}

fn read_feedback(section: Section<'_, '_>) -> ForceFeedback {
    let mut axes = [ForceFeedbackAxis::default(); 3];
    use keys::feedback as row;
    let rows = [
        (row::x_percent, row::x_limit_n),
        (row::y_percent, row::y_limit_n),
        (row::z_percent, row::z_limit_n),
    ];
    for (axis, (percent, max)) in axes.iter_mut().zip(rows) {
        let (percent, max) = (section.value(percent), section.value(max));
        *axis = ForceFeedbackAxis {
            percent: to_u16(percent).min(100) as u8,
            limit: force(max).0,
        };
    }
    let damping = section.value(keys::feedback::damping_n_s_per_mm);
    let below = section.value(keys::feedback::damping_below_n);
    section.finish();
    ForceFeedback {
        axes,
        damping: to_u16(damping * PER_EFFORT),
        damping_below: force(below).0,
    }
}

fn read_fixture(section: Section<'_, '_>) -> FixtureConfig {
    let stiffness = section.value(keys::fixture::stiffness_n_per_mm);
    let max = section.value(keys::fixture::limit_n);
    section.finish();
    FixtureConfig {
        stiffness: to_u32(stiffness * PER_EFFORT),
        max: force(max),
    }
}

fn read_passivity(section: Section<'_, '_>) -> PassivityConfig {
    let surplus = section.value(keys::passivity::surplus_n_mm);
    let deficit = section.value(keys::passivity::deficit_n_mm);
    let damping = section.value(keys::passivity::damping_n_s_per_mm);
    section.finish();
    PassivityConfig {
        surplus: to_u32(surplus * PER_EFFORT),
        deficit: to_u32(deficit * PER_EFFORT),
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
