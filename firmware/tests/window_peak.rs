//! The peak of a revolution against a plain scan, and on milling forces at speeds whose revolution
//! is no whole number of samples.

use haptimill_firmware::force::window_peak::{LEAVES, SlidingMinMax, Window};
use haptimill_math::force::Force;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::collections::VecDeque;

const NEWTON: f64 = 65_536.0;

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, rng_seed: RngSeed::Fixed(5), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn extremes_match_a_full_scan(samples in 1u32..=LEAVES as u32, forces in prop::collection::vec(any::<i32>(), 1..600)) {
        let mut peaks = SlidingMinMax::new(Window::of(samples).expect("fits"));
        let mut window: VecDeque<i32> = (0..samples).map(|_| 0).collect();
        for force in forces {
            window.pop_front();
            window.push_back(force);
            let found = peaks.push(Force(force));
            prop_assert_eq!(found.high.0, *window.iter().max().expect("some"));
            prop_assert_eq!(found.low.0, *window.iter().min().expect("some"));
            let largest = window.iter().map(|force| force.unsigned_abs()).max().expect("some");
            prop_assert_eq!(found.peak().magnitude(), largest);
            prop_assert_eq!(found, peaks.extremes());
        }
    }

    /// A long window is divided into groups: never shorter than requested, longer by less than a
    /// group.
    #[test]
    fn long_window_covers_the_requested_samples(samples in 1u32..=2048, forces in prop::collection::vec(any::<i32>(), 2100..4500)) {
        let window = Window::of(samples).expect("fits");
        prop_assert!(window.min_samples() >= samples && window.samples() < samples + 2 * samples.div_ceil(100).max(1) + 1, "{window:?} {samples}");
        let mut peaks = SlidingMinMax::new(window);
        for (k, force) in forces.iter().enumerate() {
            let found = peaks.push(Force(*force));
            if k % 37 == 0 && k > window.samples() as usize {
                let scan = |length: u32| {
                    let part = &forces[k + 1 - length as usize..=k];
                    (part.iter().copied().max().expect("some"), part.iter().copied().min().expect("some"))
                };
                let (min, max) = (scan(window.min_samples()), scan(window.samples()));
                prop_assert!(found.high.0 >= min.0 && found.high.0 <= max.0);
                prop_assert!(found.low.0 <= min.1 && found.low.0 >= max.1);
            }
        }
    }

    /// After any changes of the window the peak is at least that of the last revolution.
    #[test]
    fn window_change_keeps_the_last_revolution(changes in prop::collection::vec((1u32..=300, 1usize..400), 1..12), seed: u64) {
        let mut peaks = SlidingMinMax::new(Window::of(60).expect("fits"));
        let (mut seen, mut random) = (vec![0; 60], seed | 1);
        for (samples, pushes) in changes {
            let window = Window::of(samples).expect("fits");
            if window != peaks.window() {
                seen = vec![peaks.extremes().high.0; samples as usize];
            }
            peaks.set_window(window);
            for _ in 0..pushes {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let force = (random >> 40) as i32 - (1 << 23);
                seen.push(force);
                let high = peaks.push(Force(force)).high.0;
                let since = seen.len().saturating_sub(samples as usize);
                prop_assert!(high >= *seen[since..].iter().max().expect("some"));
            }
        }
    }
}

/// 60 samples at 5000 rev/min and 200 us, 12 at 1 ms (docs/control.md 7.1 item 17); other speeds
/// are rounded up.
#[test]
fn window_is_rounded_up_to_a_revolution() {
    let samples = |rpm, period| Window::revolution(rpm, period).map(Window::samples);
    assert_eq!(samples(5000, 200), Some(60));
    assert_eq!(samples(-5000, 200), Some(60));
    assert_eq!(samples(5000, 1000), Some(12));
    assert_eq!(samples(5100, 200), Some(59));
    assert_eq!(samples(4999, 200), Some(61));
    assert_eq!(samples(0, 200), None);
    assert_eq!(samples(100, 200), None);
    for rpm in 150..=i16::MAX {
        let Some(window) = Window::revolution(rpm, 200) else {
            continue;
        };
        let exact = 60.0 / f64::from(rpm) / 200e-6;
        assert!(f64::from(window.min_samples()) >= exact - 1e-9, "{rpm}");
        assert!(
            f64::from(window.min_samples()) < exact * (1.0 + 2.0 / 63.0) + 1.0,
            "{rpm}"
        );
    }
}

/// Two teeth with run-out at speeds between whole windows: the peak moves by no more than sampling
/// a crest allows. One sample less than rounded up would lose the crest.
#[test]
fn steady_cut_has_a_steady_peak() {
    for rpm in [
        4000.0, 4357.0, 5000.0, 5099.0, 5100.0, 6151.0, 12_345.0, 1017.0,
    ] {
        let turn = rpm / 60.0 * 200e-6;
        let force = |sample: f64| {
            let angle = 2.0 * std::f64::consts::PI * (sample * turn + 0.137);
            // Teeth of 6 N and 5 N.
            6.0 * libm::sin(angle).max(0.0) + 5.0 * libm::sin(-angle).max(0.0)
        };
        let window = Window::revolution(rpm as i16, 200).expect("fits");
        // A crest lies at most half a sample from the nearest one.
        let crest = 6.0 * libm::cos(std::f64::consts::PI * turn);
        let dip = |window: Window| {
            let mut peaks = SlidingMinMax::new(window);
            (0..40_000)
                .map(|k| peaks.push(Force((force(f64::from(k)) * NEWTON) as i32)))
                .skip(4000)
                .map(|found| f64::from(found.peak().0) / NEWTON)
                .fold(f64::MAX, f64::min)
        };
        assert!(
            dip(window) >= crest - 1e-4,
            "{rpm}: {} {crest}",
            dip(window)
        );
        if window.samples() > 1 && window.samples() as usize <= LEAVES {
            let half = Window::of(window.samples() / 2).expect("fits");
            assert!(
                dip(half) < crest - 0.5,
                "the test must see a window that is too short"
            );
        }
    }
}

/// The sign is kept, and the other end is the low force.
#[test]
fn the_sign_is_kept() {
    let mut peaks = SlidingMinMax::new(Window::of(4).expect("fits"));
    peaks.push(Force(5));
    let found = peaks.push(Force(-7));
    assert_eq!((found.peak(), found.other()), (Force(-7), Force(5)));
    for force in [1, 1, 1] {
        peaks.push(Force(force));
    }
    assert_eq!(peaks.push(Force(1)).peak(), Force(1));
    peaks.push(Force(9));
    peaks.clear();
    assert_eq!(peaks.extremes().peak(), Force(0));
}
