//! The `[force]` section of a machine file: the force sensor and the force loops of x, y and z of
//! the workpiece (docs/control.md 1.3, 3.3, 7.1 items 20 to 26).

use super::document::Section;
use super::scale::{PER_EFFORT, PER_MM, to_i32, to_u16, to_u32};
use haptimill_firmware::force::admittance::AdmittanceLaw;
use haptimill_firmware::force::sensor::{COMPONENTS, Channel, ForceSensor};
use haptimill_firmware::force::{
    Design, EnableCondition, ForceConfig, ForceParameter, LoopSettings,
};
use haptimill_machine_keys::controller::{force as keys, force_axis, force_sensor};
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_math::{Length, Rate};
use haptimill_protocol::force::COMPONENT_NAMES;

/// Components of the force with their numbers, in order.
pub const AXES: [(&str, usize); COMPONENTS] = [
    (COMPONENT_NAMES[0], 0),
    (COMPONENT_NAMES[1], 1),
    (COMPONENT_NAMES[2], 2),
];

/// Enable conditions, with their names in machine files and on the command line.
pub const ENABLE_CONDITIONS: [(&str, EnableCondition); 4] = [
    ("against_motion", EnableCondition::AgainstMotion),
    ("any", EnableCondition::Any),
    ("positive", EnableCondition::Positive),
    ("negative", EnableCondition::Negative),
];

/// Codes of a 14-bit converter from 0 to the end of its range.
const CODES: f64 = 8192.0;

/// Converts newtons.
fn force(newtons: f64) -> Force {
    Force(to_i32(newtons * PER_EFFORT))
}

/// Axis of the force: its sensor channel and its loop.
struct AxisSections<'d, 'i> {
    section: Section<'d, 'i>,
    channel: Channel,
    settings: LoopSettings,
    /// Whether all values of the axis are valid.
    is_valid: bool,
}

/// Reads force sensor and force control; `period_us` is NaN if it is not known.
pub fn read_force(section: &Section<'_, '_>, period_us: f64) -> ForceConfig {
    let slowest = section.value(keys::slowest_rpm);
    let lag = section.value(keys::drive_lag_ms);
    let creep = section.value(keys::creep_mm_s);
    let mask = section
        .words(keys::under_control, &AXES)
        .into_iter()
        .fold(0, |mask, axis| mask | 1 << axis);
    let sections = section.list("axis");
    if !sections.is_empty() && sections.len() != COMPONENTS {
        let what = format!(
            "has {} sections, force control needs {COMPONENTS}",
            sections.len()
        );
        section.report("axis", what, "write one for each of x, y, z");
    }
    let sensor = section
        .section("sensor")
        .map(|sensor| read_sensor(&sensor, period_us));
    let (volts, saturation) = sensor.as_ref().map_or((f64::NAN, f64::NAN), |sensor| {
        (sensor.volts, sensor.saturation)
    });
    let sensor_is_valid = sensor.as_ref().is_some_and(|sensor| sensor.is_valid);
    let axes: Vec<AxisSections<'_, '_>> = sections
        .into_iter()
        .enumerate()
        .map(|(place, section)| read_axis(section, place, volts, saturation))
        .collect();
    section.finish();
    let place = |index: usize| axes.get(index);
    let channels = [0, 1, 2]
        .map(|index| place(index).map_or_else(placeholder_channel, |axis| axis.channel.clone()));
    let config = ForceConfig {
        sensor: ForceSensor {
            channels,
            ..sensor.map_or_else(placeholder_sensor, |section| section.sensor)
        },
        axes: [0, 1, 2]
            .map(|index| place(index).map_or_else(placeholder_loop, |axis| axis.settings.clone())),
        mask,
        drive_lag_us: to_u16(lag * 1000.0),
        creep: Rate(to_i32(creep * PER_MM)),
        slowest_rpm: to_u16(slowest),
    };
    let is_valid = sensor_is_valid
        && [slowest, lag, creep, period_us]
            .iter()
            .all(|value| !value.is_nan());
    if is_valid && axes.len() == COMPONENTS {
        check(section, &axes, &config, to_u16(period_us));
    }
    config
}

/// Reports the parameters that the controller refuses, with their bounds and keys.
fn check(
    section: &Section<'_, '_>,
    axes: &[AxisSections<'_, '_>],
    config: &ForceConfig,
    period_us: u16,
) {
    let mut is_valid = true;
    for (index, axis) in axes.iter().enumerate() {
        is_valid &= axis.is_valid;
        if !axis.is_valid {
            continue;
        }
        let range = config.sensor.range(index);
        let law = AdmittanceLaw::new(&axis.settings, period_us, config.delay_us(period_us), range);
        if let Err(refusal) = law {
            is_valid = false;
            axis.section
                .report(key(refusal.parameter), refusal.to_string(), "");
        }
    }
    if !is_valid {
        return;
    }
    if let Err((_, refusal)) = Design::new(config, period_us) {
        section.report(key(refusal.parameter), refusal.to_string(), "");
    }
}

/// Returns the key of a parameter of the controller.
const fn key(parameter: ForceParameter) -> &'static str {
    match parameter {
        ForceParameter::SetpointTooSmall | ForceParameter::SetpointTooLarge => "setpoint_n",
        ForceParameter::DampingTooSmall | ForceParameter::DampingTooLarge => "damping_n_s_per_mm",
        ForceParameter::MassTooSmall | ForceParameter::MassTooLarge => "mass_n_s2_per_mm",
        ForceParameter::Limit => "limit_mm",
        ForceParameter::Rate => "rate_mm_s",
        ForceParameter::Sensor => "sensor",
        ForceParameter::SlowestSpindle => "slowest_rpm",
        ForceParameter::Axis | ForceParameter::Busy => "under_control",
    }
}

/// Values of `[force.sensor]`.
struct SensorSection {
    /// The sensor without its channels.
    sensor: ForceSensor,
    /// Range of the converter, V.
    volts: f64,
    /// Usable fraction of the range.
    saturation: f64,
    /// Whether all values are valid.
    is_valid: bool,
}

/// Reads the sensor.
fn read_sensor(section: &Section<'_, '_>, period_us: f64) -> SensorSection {
    let volts = section.value(force_sensor::converter_v);
    let saturation = section.value(force_sensor::saturation_part);
    // The caller raises a time of less than one period to one.
    let periods = |ms: f64| (ms * 1000.0 / period_us).round();
    let silent = section.value(force_sensor::silent_ms);
    let stuck = section.value(force_sensor::stuck_ms);
    let tare = section.value(force_sensor::tare_ms);
    let drift = section.value(force_sensor::drift_n);
    let limit = section.value(force_sensor::limit_n);
    let spread = section.value(force_sensor::tare_spread_codes);
    let weight = section.value(force_sensor::weight_n);
    let samples = periods(tare);
    if !samples.is_nan() && !(16.0..=32_768.0).contains(&samples) {
        let what = format!("{tare} ms are {samples} control periods, allowed are 16 to 32768");
        let remedy = if samples < 16.0 {
            "raise it"
        } else {
            "lower it"
        };
        section.report("tare_ms", what, remedy);
    }
    let is_valid = [
        volts, saturation, silent, stuck, drift, limit, spread, weight, samples,
    ]
    .iter()
    .all(|value| !value.is_nan())
        && (16.0..=32_768.0).contains(&samples);
    section.finish();
    let sensor = ForceSensor {
        silent_samples: to_u16(periods(silent).max(1.0)),
        stuck_samples: to_u16(periods(stuck)),
        drift: force(drift),
        limit: force(limit),
        tare_samples: to_u16(samples),
        tare_spread: to_u16(spread),
        weight: force(weight),
        ..placeholder_sensor()
    };
    SensorSection {
        sensor,
        volts,
        saturation,
        is_valid,
    }
}

/// Reads an axis.
fn read_axis<'d, 'i>(
    section: Section<'d, 'i>,
    place: usize,
    volts: f64,
    saturation: f64,
) -> AxisSections<'d, 'i> {
    let name = section.text("name", "name the axis");
    let expected = AXES.get(place).map_or("", |(name, _)| name);
    if let Some(name) = name
        && name != expected
    {
        let what = format!("\"{name}\" is not the axis at this place");
        section.report("name", what, format!("write \"{expected}\""));
    }
    let newtons = section.value(force_axis::newtons_per_volt);
    let sign = section.value(force_axis::sign);
    let setpoint = section.value(force_axis::setpoint_n);
    let mass = section.value(force_axis::mass_n_s2_per_mm);
    let damping = section.value(force_axis::damping_n_s_per_mm);
    let limit = section.value(force_axis::limit_mm);
    let rate = section.value(force_axis::rate_mm_s);
    let enable_condition = section.choice(force_axis::enable_condition, &ENABLE_CONDITIONS);
    section.finish();
    let per_code = sign * newtons * volts / CODES;
    if per_code.abs() > 0.5 {
        let magnitude = per_code.abs();
        let what = format!("{newtons} N/V is {magnitude:.3} N a code, at most 0.5 are allowed");
        section.report("newtons_per_volt", what, "lower it");
    }
    let is_scaled = per_code.abs() <= 0.5;
    let numbers = [
        newtons, sign, setpoint, mass, damping, limit, rate, volts, saturation,
    ];
    AxisSections {
        is_valid: is_scaled
            && enable_condition.is_some()
            && numbers.iter().all(|value| !value.is_nan()),
        channel: Channel {
            per_code: to_i32(per_code * 4_294_967_296.0),
            saturation: to_u16(saturation * CODES).min(8191) as i16,
        },
        settings: LoopSettings {
            setpoint: force(setpoint),
            mass: VirtualMass(to_u32(mass * PER_EFFORT)),
            damping: VirtualDamping(to_u32(damping * PER_EFFORT)),
            limit: Length(to_i32(limit * PER_MM)),
            rate: Rate(to_i32(rate * PER_MM)),
            enable_condition: enable_condition.unwrap_or_default(),
        },
        section,
    }
}

/// Placeholder for a channel that is missing or has problems; a problem is reported with it.
const fn placeholder_channel() -> Channel {
    Channel {
        per_code: 0,
        saturation: 0,
    }
}

/// As [`placeholder_channel`].
const fn placeholder_sensor() -> ForceSensor {
    ForceSensor {
        channels: [
            placeholder_channel(),
            placeholder_channel(),
            placeholder_channel(),
        ],
        silent_samples: 0,
        stuck_samples: 0,
        drift: Force::ZERO,
        limit: Force::ZERO,
        tare_samples: 0,
        tare_spread: 0,
        weight: Force::ZERO,
    }
}

/// As [`placeholder_channel`].
const fn placeholder_loop() -> LoopSettings {
    LoopSettings {
        setpoint: Force::ZERO,
        mass: VirtualMass(0),
        damping: VirtualDamping(0),
        limit: Length::ZERO,
        rate: Rate::ZERO,
        enable_condition: EnableCondition::AgainstMotion,
    }
}
