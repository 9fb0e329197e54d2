//! Values of sensors against the exact formulas in f64, and the filters against plain models.

use haptimill_drivers::input_filter::InputFilter;
use haptimill_drivers::supply::{Divider, SupplyMonitor};
use haptimill_drivers::thermistor::{SensorFault, Thermistor};

const SENSOR: Thermistor = Thermistor {
    at_25_ohm: 10_000.0,
    beta_k: 3950.0,
    pull_up_ohm: 4_700.0,
    full_scale: 4095,
};

#[test]
fn temperatures_are_within_a_tenth_of_a_degree() {
    let mut largest: f64 = 0.0;
    let mut checked = 0;
    for code in 41..=4054_u16 {
        let share = f64::from(code) / 4095.0;
        let resistance = 4700.0 * share / (1.0 - share);
        let exact = 1.0 / (1.0 / 298.15 + (resistance / 10_000.0).ln() / 3950.0) - 273.15;
        if !(-20.0..=120.0).contains(&exact) {
            continue;
        }
        let found = SENSOR.celsius(code).unwrap();
        largest = largest.max((f64::from(found) - exact).abs());
        checked += 1;
    }
    assert!(checked > 3000 && largest < 0.1, "{largest} in {checked}");
}

#[test]
fn a_broken_sensor_is_no_temperature() {
    assert_eq!(SENSOR.celsius(0), Err(SensorFault::Shorted));
    assert_eq!(SENSOR.celsius(4095), Err(SensorFault::Open));
    assert_eq!(SENSOR.celsius(u16::MAX), Err(SensorFault::Open));
}

#[test]
fn a_brown_out_has_a_hysteresis() {
    let divider = Divider {
        upper_ohm: 100_000.0,
        lower_ohm: 10_000.0,
        reference_v: 3.3,
        full_scale: 4095,
    };
    assert!((divider.volts(4095) - 36.3).abs() < 1e-4);
    let mut monitor = SupplyMonitor::new(20.0, 22.0);
    assert_eq!(monitor.volts(), None);
    assert!(!monitor.add(24.0));
    // One bad reading of 10 V counts a quarter: 20.5 V.
    assert!(!monitor.add(10.0));
    assert!(monitor.add(10.0));
    // 21 V is above the low limit, but not good again.
    for _ in 0..50 {
        assert!(monitor.add(21.0));
    }
    for _ in 0..50 {
        monitor.add(24.0);
    }
    assert!(!monitor.add(24.0));
}

#[test]
fn levels_that_do_not_last_are_counted() {
    let mut filter = InputFilter::new(3, 0b01);
    // Input 1 chatters, input 0 changes for good.
    for (sample, level) in [
        (0b10, 0b01),
        (0b00, 0b01),
        (0b10, 0b00),
        (0b10, 0b00),
        (0b10, 0b10),
        (0b00, 0b10),
        (0b10, 0b10),
    ] {
        assert_eq!(filter.add(sample), level, "{sample:b}");
    }
    assert_eq!((filter.glitches(0), filter.glitches(1)), (0, 2));
    assert_eq!((filter.glitches(31), filter.glitches(32)), (0, 0));
    assert_eq!(filter.all_glitches(), 2);
    assert_eq!(InputFilter::new(0, 0).add(u32::MAX), u32::MAX);
}
