use super::context::settled;
use super::statistics::Point;
use super::*;

fn points(values: &[f64]) -> Vec<Point> {
    let times = (0_u32..).map(f64::from);
    times.zip(values.iter().copied()).collect()
}

#[test]
fn statistics_agree_with_hand_calculations() {
    let values = points(&[3.0, -1.0, 2.0, 4.0]);
    assert_eq!(mean(&values), 2.0);
    assert_eq!((smallest(&values), largest(&values)), (-1.0, 4.0));
    assert_eq!(time_of_max(&values, 1.0), 3.0);
    assert_eq!(time_of_max(&values, -1.0), 1.0);
    assert_eq!(first_time(&values, |value| value < 0.0), 1.0);
    assert!((slope(&points(&[1.0, 3.0, 5.0, 7.0])) - 2.0).abs() < 1e-12);
}

#[test]
fn nothing_measured_is_not_a_number() {
    for value in [mean(&[]), largest(&[]), smallest(&[]), slope(&[])] {
        assert!(value.is_nan());
    }
    assert!(time_of_max(&[], 1.0).is_nan() && first_time(&[], |_| true).is_nan());
    assert!(worst(std::iter::empty()).is_nan());
    for values in [[f64::NAN, 1.0], [1.0, f64::NAN]] {
        assert!(worst(values.into_iter()).is_nan());
    }
    assert_eq!(worst([1.0, 3.0, 2.0].into_iter()), 3.0);
}

#[test]
fn a_settled_window_omits_both_ends() {
    let times: Vec<f64> = (0..=20).map(|n| f64::from(n) * 0.1).collect();
    let inner = settled(&times, |time| *time);
    assert!(inner.iter().all(|time| (0.29..1.71).contains(time)));
    assert!((14..=15).contains(&inner.len()), "{}", inner.len());
    assert!(settled(&times[..3], |time| *time).is_empty());
}

#[test]
fn names_of_measures_and_quantities_are_unique() {
    let measures = MEASURES.iter().map(|measure| measure.name);
    let quantities = QUANTITIES.iter().map(|quantity| quantity.name);
    for names in [measures.collect::<Vec<_>>(), quantities.collect()] {
        for (index, name) in names.iter().enumerate() {
            assert!(!names[..index].contains(name), "{name}");
        }
    }
}
