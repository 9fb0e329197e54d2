//! Pose coordinates and joints of a machine file.

use super::document::{Allowed, Section, real, whole};
use super::scale::{
    self, PER_COUNT, PER_EFFORT, PER_GAIN, per_unit, to_i32, to_i64, to_u16, to_u32,
};
use super::stability::{Gains, spectral_radius};
use haptimill_firmware::config::{AxisKind, Drive, JointAxis, PoseAxis, ServoConfig, ServoForm};
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};

/// Limits of an axis in engineering units: mm for a linear axis, degrees for a rotary one.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisLimits {
    /// Name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Lower limit, mm or deg.
    pub low: f64,
    /// Upper limit, mm or deg.
    pub high: f64,
    /// Largest rate, mm/s or deg/s.
    pub rate: f64,
    /// Largest acceleration, mm/s^2 or deg/s^2.
    pub acceleration: f64,
    /// Largest jerk, mm/s^3 or deg/s^3; infinite for a joint, which has no jerk limit.
    pub jerk: f64,
}

/// Keys and ranges that differ between a linear and a rotary axis.
pub(super) struct Keys {
    pub(super) low: &'static str,
    pub(super) high: &'static str,
    pub(super) rate: &'static str,
    acceleration: &'static str,
    jerk: &'static str,
    travel: &'static str,
    backlash: &'static str,
    following: &'static str,
    still: &'static str,
    preset: &'static str,
    index: &'static str,
    search: &'static str,
    lost: &'static str,
    full_scale: &'static str,
    limit: &'static str,
    inertia: &'static str,
    viscous: &'static str,
    coulomb: &'static str,
    coulomb_rate: &'static str,
    pub(super) unit: &'static str,
    /// Coordinates of a limit.
    coordinate: Allowed,
    rate_range: Allowed,
    acceleration_range: Allowed,
    jerk_range: Allowed,
    /// Small distances: errors, backlash.
    distance: Allowed,
    travel_range: Allowed,
    effort: Allowed,
    inertia_range: Allowed,
    viscous_range: Allowed,
}

pub(super) fn keys(kind: AxisKind) -> Keys {
    match kind {
        AxisKind::Linear => Keys {
            low: "low_mm",
            high: "high_mm",
            rate: "rate_mm_s",
            acceleration: "acceleration_mm_s2",
            jerk: "jerk_mm_s3",
            travel: "lead_mm",
            backlash: "backlash_mm",
            following: "following_error_mm",
            still: "still_mm",
            preset: "preset_mm",
            index: "index_mm",
            search: "search_mm",
            lost: "lost_mm",
            full_scale: "full_scale_n",
            limit: "limit_n",
            inertia: "inertia_kg",
            viscous: "viscous_n_per_mm_s",
            coulomb: "coulomb_n",
            coulomb_rate: "coulomb_rate_mm_s",
            unit: "mm",
            coordinate: real(-2047.0, 2047.0, "mm"),
            rate_range: real(0.001, 2000.0, "mm/s"),
            acceleration_range: real(0.1, 100_000.0, "mm/s^2"),
            jerk_range: real(1.0, 1e8, "mm/s^3"),
            distance: real(0.0, 100.0, "mm"),
            travel_range: real(0.01, 200.0, "mm/turn"),
            effort: real(0.01, 32_000.0, "N"),
            inertia_range: real(0.001, 10_000.0, "kg"),
            viscous_range: real(0.0, 1_000.0, "N per mm/s"),
        },
        AxisKind::Rotary => Keys {
            low: "low_deg",
            high: "high_deg",
            rate: "rate_deg_s",
            acceleration: "acceleration_deg_s2",
            jerk: "jerk_deg_s3",
            travel: "gear_ratio",
            backlash: "backlash_deg",
            following: "following_error_deg",
            still: "still_deg",
            preset: "preset_deg",
            index: "index_deg",
            search: "search_deg",
            lost: "lost_deg",
            full_scale: "full_scale_n_m",
            limit: "limit_n_m",
            inertia: "inertia_kg_m2",
            viscous: "viscous_n_m_per_deg_s",
            coulomb: "coulomb_n_m",
            coulomb_rate: "coulomb_rate_deg_s",
            unit: "deg",
            coordinate: real(-179.0, 179.0, "deg"),
            rate_range: real(0.001, 179.0, "deg/s"),
            acceleration_range: real(0.1, 40_000.0, "deg/s^2"),
            jerk_range: real(1.0, 1e8, "deg/s^3"),
            distance: real(0.0, 30.0, "deg"),
            travel_range: real(0.1, 1_000.0, "motor turns per turn"),
            effort: real(0.01, 32_000.0, "N m"),
            inertia_range: real(0.001, 10_000.0, "kg m^2"),
            viscous_range: real(0.0, 1_000.0, "N m per deg/s"),
        },
    }
}

const KINDS: [(&str, AxisKind); 2] = [("linear", AxisKind::Linear), ("rotary", AxisKind::Rotary)];

/// Reads name and kind, which must be those of the model at this place.
fn read_identity(section: &Section<'_, '_>, place: Option<(&str, AxisKind)>) -> (String, AxisKind) {
    let name = section.text("name", "name the axis").unwrap_or_default();
    let kind = section.choice("kind", &KINDS);
    let Some((expected_name, expected_kind)) = place else {
        return (name.to_string(), kind.unwrap_or(AxisKind::Linear));
    };
    if !name.is_empty() && name != expected_name {
        let what = format!("\"{name}\" is not the axis of the model at this place");
        section.report("name", what, format!("write \"{expected_name}\""));
    }
    if kind.is_some_and(|kind| kind != expected_kind) {
        let word = KINDS[usize::from(expected_kind == AxisKind::Rotary)].0;
        let what = "is not the kind of the model at this place";
        section.report("kind", what, format!("write \"{word}\""));
    }
    // The other values are read with the kind of the model, so that a wrong kind is reported once.
    (name.to_string(), expected_kind)
}

/// Reads stroke or soft limits.
fn read_limits(section: &Section<'_, '_>, keys: &Keys) -> (f64, f64) {
    let low = section.number(keys.low, keys.coordinate);
    let high = section.number(keys.high, keys.coordinate);
    if low >= high {
        let what = format!("{low} is not below {} = {high}", keys.high);
        section.report(keys.low, what, "exchange them");
    }
    (low, high)
}

/// Reads a pose coordinate.
pub fn read_pose_axis(
    section: &Section<'_, '_>,
    place: Option<(&str, AxisKind)>,
) -> (PoseAxis, AxisLimits) {
    let (name, kind) = read_identity(section, place);
    let keys = keys(kind);
    let (low, high) = read_limits(section, &keys);
    let limits = AxisLimits {
        name,
        kind,
        low,
        high,
        rate: section.number(keys.rate, keys.rate_range),
        acceleration: section.number(keys.acceleration, keys.acceleration_range),
        jerk: section.number(keys.jerk, keys.jerk_range),
    };
    section.finish();
    let unit = per_unit(kind);
    let axis = PoseAxis {
        kind,
        low: Coordinate(to_i32(low * unit)),
        high: Coordinate(to_i32(high * unit)),
        rate: Rate(to_i32(limits.rate * unit)),
        acceleration: Acceleration(scale::acceleration(limits.acceleration, kind)),
        jerk: scale::jerk(limits.jerk, kind),
    };
    (axis, limits)
}

/// Reads a joint; `period` in seconds is NaN if it is not known.
pub fn read_joint_axis(
    section: &Section<'_, '_>,
    place: Option<(&str, AxisKind)>,
    period: f64,
) -> (JointAxis, AxisLimits) {
    let (name, kind) = read_identity(section, place);
    let keys = keys(kind);
    let unit = per_unit(kind);
    let coordinate = |value: f64| Coordinate(to_i32(value * unit));
    let (low, high) = read_limits(section, &keys);
    let rate = section.number(keys.rate, keys.rate_range);
    let acceleration = section.number(keys.acceleration, keys.acceleration_range);

    // Travel per motor turn, without its sign.
    let travel = section.number(keys.travel, keys.travel_range);
    let turn = match kind {
        AxisKind::Linear => travel,
        AxisKind::Rotary => 360.0 / travel,
    };
    let counts = section.number("counts_per_turn", whole(4, 10_000_000, "counts"));
    let direction = section.direction("direction");
    let backlash = section.number_or(keys.backlash, 0.0, keys.distance);
    let following = section.number(keys.following, keys.distance);
    if following <= 0.0 {
        section.report(keys.following, "0 is always exceeded", "raise it");
    }
    let lag = section.number("following_error_lag_ms", real(0.0, 1000.0, "ms"));
    let still = section.number(keys.still, keys.distance);
    let resolution = turn / counts;
    if still < 4.0 * resolution {
        let what = format!("{still} {} is less than 4 encoder counts", keys.unit);
        let remedy = format!("raise it to {} or more", 4.0 * resolution);
        section.report(keys.still, what, remedy);
    }
    let preset = section.number(keys.preset, keys.coordinate);
    let index = section.number(keys.index, keys.coordinate);
    let search = section.number(keys.search, keys.distance);
    // One line of the encoder, or less for a coarse encoder.
    let usual = ((counts - 1.0) / 4.0).floor().clamp(0.0, 4.0);
    let slack = section.number_or("index_slack_counts", usual, whole(0, 65_535, "counts"));
    if slack * 4.0 >= counts {
        let what = format!("{slack} is a quarter of the {counts} counts of a turn, or more");
        section.report("index_slack_counts", what, "lower it");
    }
    for (key, value) in [(keys.preset, preset), (keys.index, index)] {
        if value < low || value > high {
            let what = format!(
                "{value} {} is outside the stroke {low} to {high}",
                keys.unit
            );
            section.report(key, what, "correct it, or the stroke");
        }
    }
    if (index - preset).abs() > search {
        let what = format!(
            "{search} {} does not reach from the preset {preset} to the index {index}",
            keys.unit
        );
        section.report(keys.search, what, "raise it, or correct the index");
    }
    if search > turn / 2.0 {
        let what = format!(
            "{search} {} is more than half a motor turn ({} {}): the search could find the index of the next turn",
            keys.unit,
            turn / 2.0,
            keys.unit
        );
        section.report(keys.search, what, "lower it");
    }

    let (drive, limit) = match section.section("drive") {
        Some(drive_section) => read_drive(drive_section, &keys, kind, turn, rate),
        None => (placeholder_drive(), f64::NAN),
    };
    let law = match section.section("law") {
        Some(law_section) => read_law(law_section, &keys, kind, period, acceleration, limit),
        None => placeholder_law(),
    };
    section.finish();
    let axis = JointAxis {
        kind,
        low: coordinate(low),
        high: coordinate(high),
        rate: Rate(to_i32(rate * unit)),
        per_count: to_i64(direction * resolution * unit * PER_COUNT),
        backlash: coordinate(backlash),
        drive,
        law,
        following: coordinate(following),
        following_lag: to_u32(lag * 65.536),
        still: coordinate(still),
        preset: coordinate(preset),
        index: coordinate(index),
        index_pitch: coordinate(turn),
        index_slack: to_u32(slack).min(u32::from(u16::MAX)) as u16,
        search: coordinate(search),
    };
    let limits = AxisLimits {
        name,
        kind,
        low,
        high,
        rate,
        acceleration,
        jerk: f64::INFINITY,
    };
    (axis, limits)
}

/// Placeholder for a drive that is missing or has problems; a problem is reported with it.
fn placeholder_drive() -> Drive {
    Drive::Torque {
        full_scale: Effort(0),
        limit: Effort(0),
    }
}

/// As [`placeholder_drive`], for the servo loop.
fn placeholder_law() -> ServoConfig {
    ServoConfig {
        form: ServoForm::ModelBased,
        kp: Gain(0),
        kd: Gain(0),
        rate_filter_us: 0,
        inertia: 0,
        viscous: 0,
        coulomb: Effort(0),
        coulomb_rate: Rate(0),
        ki: Gain(0),
    }
}

/// Reads the drive; returns it and its effort limit (infinite for step drives, NaN if not known).
fn read_drive(
    section: Section<'_, '_>,
    keys: &Keys,
    kind: AxisKind,
    turn: f64,
    rate: f64,
) -> (Drive, f64) {
    #[derive(Clone, Copy)]
    enum DriveKind {
        Torque,
        Step,
    }
    let result = match section.choice(
        "kind",
        &[("torque", DriveKind::Torque), ("step", DriveKind::Step)],
    ) {
        Some(DriveKind::Torque) => {
            let direction = section.direction("direction");
            let full_scale = section.number(keys.full_scale, keys.effort);
            let limit = section.number(keys.limit, keys.effort);
            if limit > full_scale {
                let what = format!("{limit} is above {} = {full_scale}", keys.full_scale);
                section.report(keys.limit, what, "lower it");
            }
            let drive = Drive::Torque {
                full_scale: Effort(to_i32(direction * full_scale * PER_EFFORT)),
                limit: Effort(to_i32(limit * PER_EFFORT)),
            };
            (drive, limit)
        }
        Some(DriveKind::Step) => (
            read_step_drive(&section, keys, kind, turn, rate),
            f64::INFINITY,
        ),
        // The other keys depend on the kind.
        None => return (placeholder_drive(), f64::NAN),
    };
    section.finish();
    result
}

/// Reads the keys of a step drive.
fn read_step_drive(
    section: &Section<'_, '_>,
    keys: &Keys,
    kind: AxisKind,
    turn: f64,
    rate: f64,
) -> Drive {
    let direction = section.direction("direction");
    let steps = section.number("steps_per_turn", whole(1, 10_000_000, "steps"));
    let ticks = section.number("ticks_per_us", whole(1, 1000, "ticks/us"));
    let pulse = section.number("pulse_us", real(0.01, 1000.0, "us"));
    let setup = section.number("setup_us", real(0.0, 1000.0, "us"));
    let hold = section.number("hold_us", real(0.0, 1000.0, "us"));
    let lost = section.number(keys.lost, keys.distance);
    for (key, value) in [("pulse_us", pulse), ("setup_us", setup), ("hold_us", hold)] {
        if value * ticks > 65_535.0 {
            let what = format!("{value} us is more than 65535 ticks");
            section.report(key, what, "lower it, or `ticks_per_us`");
        }
        if value > 0.0 && value * ticks < 0.5 {
            let what = format!("{value} us is less than a tick of the step clock");
            section.report(key, what, "raise it, or `ticks_per_us`");
        }
    }
    let step = turn / steps;
    let ceiling = step * 1e6 / (2.0 * pulse);
    if rate > ceiling {
        let what = format!(
            "pulses of {pulse} us allow {ceiling:.3} {}/s, less than the rate of the joint",
            keys.unit
        );
        section.report("pulse_us", what, "shorten the pulse, or lower the rate");
    }
    if lost < 2.0 * step {
        let what = format!("{lost} {} is less than 2 steps", keys.unit);
        section.report(keys.lost, what, "raise it");
    }
    // Rounded up, because a shorter pulse may be lost.
    let in_ticks = |us: f64| to_u16((us * ticks).ceil());
    Drive::Steps {
        per_step: to_i64(direction * step * per_unit(kind) * PER_COUNT),
        ticks_per_us: to_u16(ticks),
        pulse: in_ticks(pulse),
        setup: in_ticks(setup),
        hold: in_ticks(hold),
        lost: Coordinate(to_i32(lost * per_unit(kind))),
    }
}

/// Reads the servo loop.
fn read_law(
    section: Section<'_, '_>,
    keys: &Keys,
    kind: AxisKind,
    period: f64,
    acceleration: f64,
    limit: f64,
) -> ServoConfig {
    let forms = [("model", ServoForm::ModelBased), ("pd", ServoForm::Pd)];
    let form = section.choice("form", &forms);
    let gains = Gains {
        kp: section.number("kp", real(1.0, 4e6, "1/s^2")),
        kd: section.number("kd", real(0.0, 1e5, "1/s")),
        ki: section.number_or("ki", 0.0, real(0.0, 1.6e7, "1/s^3")),
        rate_filter: section.number_or("rate_filter_ms", 0.0, real(0.0, 60.0, "ms")) / 1000.0,
    };
    let known = gains.kp + gains.kd + gains.ki + gains.rate_filter + period;
    let radius = spectral_radius(gains, period);
    if !known.is_nan() && radius >= 1.0 {
        let what = format!(
            "kp = {}, kd = {}, ki = {}, rate_filter_ms = {} make the loop unstable at this control period (an error grows by {:.2} % per period)",
            gains.kp,
            gains.kd,
            gains.ki,
            gains.rate_filter * 1000.0,
            (radius - 1.0) * 100.0
        );
        section.report(
            "kp",
            what,
            "lower the gains, raise kd, or shorten the period",
        );
    }
    let inertia = section.number(keys.inertia, keys.inertia_range);
    let viscous = section.number_or(keys.viscous, 0.0, keys.viscous_range);
    let friction = Allowed {
        low: 0.0,
        ..keys.effort
    };
    let coulomb = section.number_or(keys.coulomb, 0.0, friction);
    let coulomb_rate = section.number(keys.coulomb_rate, keys.rate_range);
    // kg mm/s^2 is mN; kg m^2 deg/s^2 is pi/180 N m.
    let demand = inertia * acceleration * (newtons_per_inertia(kind)) + coulomb;
    if demand > limit {
        let what = format!(
            "with the joint's acceleration of {acceleration} {}/s^2 and friction the drive needs {demand:.1}, more than {} = {limit}",
            keys.unit, keys.limit
        );
        section.report(
            keys.inertia,
            what,
            "lower the joint's acceleration, or use a stronger drive",
        );
    }
    let law = ServoConfig {
        form: form.unwrap_or(ServoForm::ModelBased),
        kp: Gain(to_u32(gains.kp * PER_GAIN)),
        kd: Gain(to_u32(gains.kd * PER_GAIN)),
        rate_filter_us: to_u16(gains.rate_filter * 1e6),
        inertia: scale::inertia(inertia, kind),
        viscous: scale::viscous(viscous, kind),
        coulomb: Effort(to_i32(coulomb * PER_EFFORT)),
        coulomb_rate: Rate(to_i32(coulomb_rate * per_unit(kind))),
        ki: Gain(to_u32(gains.ki * PER_GAIN)),
    };
    section.finish();
    law
}

/// Returns the newtons (or newton metres) for one unit of inertia at 1 mm/s^2 (or deg/s^2).
fn newtons_per_inertia(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => 1e-3,
        AxisKind::Rotary => std::f64::consts::PI / 180.0,
    }
}
