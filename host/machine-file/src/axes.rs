//! Pose coordinates and joints of a machine file.

use super::document::Section;
use super::place::{Place, unit};
use super::scale::{
    self, PER_COUNT, PER_EFFORT, PER_GAIN, per_unit, to_i32, to_i64, to_u16, to_u32,
};
use super::stability::{Gains, spectral_radius};
use super::{drive_chip, encoder, homing};
use haptimill_firmware::config::{
    AxisKind, BACKLASH_NODES, BACKLASH_SLOPE_SHIFT, Drive, GantryAxis, JointSettings, PoseAxis,
    ServoConfig, ServoForm,
};
use haptimill_machine_keys::Key;
use haptimill_machine_keys::controller::{joint, joint_drive, joint_law, pose};
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};

/// Limits of an axis in engineering units: mm for a linear axis, degrees for a rotary one.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisLimits {
    /// Name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Lower limit, mm or deg; minus infinity where the axis wraps around.
    pub low: f64,
    /// Upper limit, mm or deg; infinity where the axis wraps around.
    pub high: f64,
    /// Maximum rate, mm/s or deg/s.
    pub rate: f64,
    /// Maximum acceleration, mm/s^2 or deg/s^2.
    pub acceleration: f64,
    /// Maximum jerk, mm/s^3 or deg/s^3; infinite for a joint, which has no jerk limit.
    pub jerk: f64,
}

const KINDS: [(&str, AxisKind); 2] = [("linear", AxisKind::Linear), ("rotary", AxisKind::Rotary)];

/// Reads name and kind, which must be those of the model at this place.
fn read_identity(section: &Section<'_, '_>, place: Option<(&str, AxisKind)>) -> (String, AxisKind) {
    let name = section.text("name", "write the name").unwrap_or_default();
    let kind = section.choice(joint::kind, &KINDS);
    let Some((expected_name, expected_kind)) = place else {
        let kind = kind.unwrap_or(AxisKind::Linear);
        section.set_kind(kind);
        return (name.to_string(), kind);
    };
    if !name.is_empty() && name != expected_name {
        let what = format!("\"{name}\" is not the coordinate of the model at this place");
        section.report("name", what, format!("write \"{expected_name}\""));
    }
    if kind.is_some_and(|kind| kind.is_rotary() != expected_kind.is_rotary()) {
        let word = KINDS[usize::from(expected_kind.is_rotary())].0;
        let what = "is not the kind of the model at this place";
        section.report("kind", what, format!("write \"{word}\""));
    }
    section.set_kind(expected_kind);
    // The other values are read with the kind of the model, so that a wrong kind is reported once.
    (name.to_string(), expected_kind)
}

impl AxisLimits {
    /// Whether the axis wraps around: it has no limits, and a turn leads to the same place.
    #[must_use]
    pub fn wraps(&self) -> bool {
        self.low == f64::NEG_INFINITY && self.high == f64::INFINITY
    }
}

/// Reads stroke or soft limits; infinite with `wrap = true`.
fn read_limits(
    section: &Section<'_, '_>,
    kind: AxisKind,
    low_key: Key,
    high_key: Key,
) -> (f64, f64) {
    let wrap = joint::wrap.name;
    if kind.is_rotary() && section.has(wrap) && section.flag(wrap) == Some(true) {
        if !kind.is_circular() {
            let what = "has no meaning here: turns are counted, and have limits";
            section.report(wrap, what, "remove it");
        }
        for key in [low_key, high_key] {
            if section.has(section.key(key).name) {
                let what = "is a limit, and with `wrap` there is none";
                section.refuse(key, what, "remove it, or `wrap`");
            }
        }
        return (f64::NEG_INFINITY, f64::INFINITY);
    }
    let (low, high) = (section.value(low_key), section.value(high_key));
    if low >= high {
        let what = format!("{low} is not below {} = {high}", section.key(high_key).name);
        section.refuse(low_key, what, "exchange them");
    }
    (low, high)
}

/// Reads a pose coordinate.
pub fn read_pose_axis(
    section: &Section<'_, '_>,
    place: Option<(&str, AxisKind)>,
) -> (PoseAxis, AxisLimits) {
    let (name, kind) = read_identity(section, place);
    let (low, high) = read_limits(section, kind, pose::low, pose::high);
    let limits = AxisLimits {
        name,
        kind,
        low,
        high,
        rate: section.value(pose::rate),
        acceleration: section.value(pose::acceleration),
        jerk: section.value(pose::jerk),
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

/// Reads the lost motion of a joint: the largest one, and its table where it depends on the place.
fn read_backlash(
    section: &Section<'_, '_>,
    kind: AxisKind,
    low: f64,
    high: f64,
) -> (f64, Vec<f64>) {
    let backlash = section.value(joint::backlash);
    let table = section.number_list(joint::backlash_table, 2, BACKLASH_NODES, joint::backlash);
    if table.is_empty() {
        return (backlash, table);
    }
    let refuse = |what: &str, remedy: &str| {
        section.refuse(joint::backlash_table, what, remedy);
        (backlash, Vec::new())
    };
    let constant = section.key(joint::backlash).name;
    if section.has(constant) {
        return refuse(
            &format!("is given with `{constant}`"),
            "keep one of the two",
        );
    }
    if !(high - low).is_finite() {
        return refuse("needs a stroke, and the joint wraps", "remove it");
    }
    let pitch = (high - low) / (table.len() - 1) as f64;
    let slope = f64::from(1_u32 << BACKLASH_SLOPE_SHIFT).recip();
    let steep = |pair: &[f64]| (pair[1] - pair[0]).abs() > slope * pitch;
    if let Some(at) = table.windows(2).position(steep) {
        let what = format!(
            "{} to {} in {pitch:.3} {} is steeper than 1/256",
            table[at],
            table[at + 1],
            unit(kind)
        );
        return refuse(&what, "correct the two values");
    }
    (table.iter().copied().fold(0.0, f64::max), table)
}

/// Reads a joint; `period` in seconds is NaN if it is not known. `of` is the joint whose gantry it
/// is the second motor of.
pub fn read_joint_axis(
    section: &Section<'_, '_>,
    place: Option<(&str, AxisKind)>,
    of: Option<usize>,
    period: f64,
) -> (JointSettings, AxisLimits) {
    let (name, kind) = read_identity(section, place);
    let scale = per_unit(kind);
    let unit = unit(kind);
    let coordinate = |value: f64| Coordinate(to_i32(value * scale));
    let (low, high) = read_limits(section, kind, joint::low, joint::high);
    let rate = section.value(joint::rate);
    let acceleration = section.value(joint::acceleration);

    // Travel per motor turn, without its sign.
    let travel = section.value(joint::travel);
    let turn = if kind.is_rotary() {
        360.0 / travel
    } else {
        travel
    };
    let (backlash, backlash_table) = read_backlash(section, kind, low, high);
    let preset = section.value(joint::preset);
    if preset < low || preset > high {
        let what = format!("{preset} {unit} is outside the stroke {low} to {high}");
        section.refuse(joint::preset, what, "correct it, or the stroke");
    }
    let place = Place {
        kind,
        low,
        high,
        turn,
        preset,
    };
    // Without the kind of its drive it is not known which keys the joint has.
    let kind_of_drive = section.peek_text_of("drive", joint_drive::kind.name);
    let is_known = kind_of_drive.is_some_and(|kind| DRIVES.iter().any(|(name, _)| *name == kind));
    let encoder = is_known
        .then(|| encoder::read_encoder(section, &place))
        .flatten();
    let has_encoder = encoder.is_some() || !is_known;
    let home = homing::read_home(section, &place, rate, acceleration, has_encoder);
    let active_low = homing::read_active_low(section);
    let ((drive, keeps_position), limit) = match section.section("drive") {
        Some(drive_section) => read_drive(drive_section, &place, rate, encoder.is_some()),
        None => ((placeholder_drive(), false), f64::NAN),
    };
    let law = match &drive {
        // A step drive has its own servo loop.
        Drive::Steps { .. } => {
            if section.has("law") {
                let what = "has no meaning for a step drive, which has its own servo loop";
                section.report("law", what, "remove it");
            }
            NO_LAW
        }
        Drive::Torque { .. } if !is_known => NO_LAW,
        Drive::Torque { .. } => match section.section("law") {
            Some(law_section) => read_law(law_section, kind, period, acceleration, limit),
            None => NO_LAW,
        },
    };
    let gantry = of.map(|of| GantryAxis {
        of: of as u8,
        racking: coordinate(section.value(joint::racking)),
    });
    if is_known {
        section.finish();
    }
    let axis = JointSettings {
        kind,
        low: coordinate(low),
        high: coordinate(high),
        rate: Rate(to_i32(rate * scale)),
        backlash: coordinate(backlash),
        backlash_table: backlash_table.into_iter().map(coordinate).collect(),
        drive,
        law,
        preset: coordinate(preset),
        home,
        encoder,
        active_low,
        keeps_position,
        gantry,
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

/// The servo loop of a step drive, and of a joint whose law has problems.
const NO_LAW: ServoConfig = ServoConfig {
    form: ServoForm::ModelBased,
    kp: Gain(0),
    kd: Gain(0),
    rate_filter_us: 0,
    inertia: 0,
    viscous: 0,
    coulomb: Effort(0),
    coulomb_rate: Rate(0),
    ki: Gain(0),
    friction_adaptation_ms: 0,
};

#[derive(Debug, Clone, Copy)]
enum DriveKind {
    Torque,
    Step,
}

const DRIVES: [(&str, DriveKind); 2] = [("torque", DriveKind::Torque), ("step", DriveKind::Step)];

/// Reads the drive; returns it, whether it keeps the position of an open-loop joint, and its effort
/// limit (infinite for step drives, NaN if not known).
fn read_drive(
    section: Section<'_, '_>,
    place: &Place,
    rate: f64,
    has_encoder: bool,
) -> ((Drive, bool), f64) {
    let result = match section.choice(joint_drive::kind, &DRIVES) {
        Some(DriveKind::Torque) => {
            let direction = section.value(joint_drive::direction);
            let full_scale = section.value(joint_drive::full_scale);
            let limit = section.value(joint_drive::limit);
            if limit > full_scale {
                let what = format!(
                    "{limit} is above {} = {full_scale}",
                    section.key(joint_drive::full_scale).name
                );
                section.refuse(joint_drive::limit, what, "lower it");
            }
            let drive = Drive::Torque {
                full_scale: Effort(to_i32(direction * full_scale * PER_EFFORT)),
                limit: Effort(to_i32(limit * PER_EFFORT)),
            };
            ((drive, false), limit)
        }
        Some(DriveKind::Step) => {
            let drive = read_step_drive(&section, place, rate, has_encoder);
            (drive, f64::INFINITY)
        }
        // The other keys depend on the kind.
        None => return ((placeholder_drive(), false), f64::NAN),
    };
    section.finish();
    result
}

/// Reads the keys of a step drive.
fn read_step_drive(
    section: &Section<'_, '_>,
    place: &Place,
    rate: f64,
    has_encoder: bool,
) -> (Drive, bool) {
    let Place { kind, turn, .. } = *place;
    let direction = section.value(joint_drive::direction);
    let steps = section.value(joint_drive::steps_per_turn);
    let ticks = section.value(joint_drive::ticks_per_us);
    let pulse = section.value(joint_drive::pulse_us);
    let setup = section.value(joint_drive::setup_us);
    let hold = section.value(joint_drive::hold_us);
    let (lost, keeps_position) = if has_encoder {
        (section.value(joint_drive::lost), false)
    } else {
        let key = joint_drive::keeps_position.name;
        (0.0, section.has(key) && section.flag(key) == Some(true))
    };
    for (key, value) in [
        (joint_drive::pulse_us, pulse),
        (joint_drive::setup_us, setup),
        (joint_drive::hold_us, hold),
    ] {
        if value * ticks > 65_535.0 {
            let what = format!("{value} us is more than 65535 ticks");
            section.refuse(key, what, "lower it, or `ticks_per_us`");
        }
        if value > 0.0 && value * ticks < 0.5 {
            let what = format!("{value} us is less than a tick of the step clock");
            section.refuse(key, what, "raise it, or `ticks_per_us`");
        }
    }
    let step = turn / steps;
    let ceiling = step * 1e6 / (2.0 * pulse);
    if rate > ceiling {
        let what = format!(
            "pulses of {pulse} us allow {ceiling:.3} {}/s, less than the rate of the joint",
            unit(kind)
        );
        section.refuse(
            joint_drive::pulse_us,
            what,
            "shorten the pulse, or lower the rate",
        );
    }
    if has_encoder && lost < 2.0 * step {
        let what = format!("{lost} {} is less than 2 steps", unit(kind));
        section.refuse(joint_drive::lost, what, "raise it");
    }
    let chip = drive_chip::read(section, steps);
    if let Some(chip) = chip.filter(|_| keeps_position) {
        let name = drive_chip::name(chip.kind);
        let what = format!("is true, and a {name} loses its electrical angle with its supply");
        section.refuse(joint_drive::keeps_position, what, "remove it");
    }
    // Rounded up, because a shorter pulse may be lost.
    let in_ticks = |us: f64| to_u16((us * ticks).ceil());
    let drive = Drive::Steps {
        per_step: to_i64(direction * step * per_unit(kind) * PER_COUNT),
        ticks_per_us: to_u16(ticks),
        pulse: in_ticks(pulse),
        setup: in_ticks(setup),
        hold: in_ticks(hold),
        lost: Coordinate(to_i32(lost * per_unit(kind))),
        chip,
    };
    (drive, keeps_position)
}

/// Reads the servo loop.
fn read_law(
    section: Section<'_, '_>,
    kind: AxisKind,
    period: f64,
    acceleration: f64,
    limit: f64,
) -> ServoConfig {
    let forms = [("model", ServoForm::ModelBased), ("pd", ServoForm::Pd)];
    let form = section.choice(joint_law::form, &forms);
    let gains = Gains {
        kp: section.value(joint_law::kp),
        kd: section.value(joint_law::kd),
        ki: section.value(joint_law::ki),
        rate_filter: section.value(joint_law::rate_filter_ms) / 1000.0,
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
        section.refuse(
            joint_law::kp,
            what,
            "lower the gains, raise kd, or shorten the period",
        );
    }
    let inertia = section.value(joint_law::inertia);
    let viscous = section.value(joint_law::viscous);
    let coulomb = section.value(joint_law::coulomb);
    let coulomb_rate = section.value(joint_law::coulomb_rate);
    let adaptation = section.value(joint_law::friction_adaptation_ms);
    if adaptation > 0.0 && gains.ki == 0.0 {
        let what = "needs the integrator, and ki is 0";
        let remedy = "set ki, or remove the key";
        section.refuse(joint_law::friction_adaptation_ms, what, remedy);
    }
    // kg mm/s^2 is mN; kg m^2 deg/s^2 is pi/180 N m.
    let demand = inertia * acceleration * (newtons_per_inertia(kind)) + coulomb;
    if demand > limit {
        let what = format!(
            "with the joint's acceleration of {acceleration} {}/s^2 and friction the drive needs {demand:.1}, more than {} = {limit}",
            unit(kind),
            section.key(joint_drive::limit).name
        );
        section.refuse(
            joint_law::inertia,
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
        friction_adaptation_ms: to_u16(adaptation),
    };
    section.finish();
    law
}

/// Returns the newtons (or newton metres) for one unit of inertia at 1 mm/s^2 (or deg/s^2).
fn newtons_per_inertia(kind: AxisKind) -> f64 {
    if kind.is_rotary() {
        std::f64::consts::PI / 180.0
    } else {
        1e-3
    }
}
