//! Feedback law, virtual fixtures, passivity observer, and master-to-tool mapping, each alone,
//! against docs/control.md 2.1 and 3.4-3.5.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

use crate::arm;
use arm::{M, Sequence, apply, rotation, times, transposed};
use haptimill_firmware::haptics::feedback_filter::{FeedbackFilter, SLOW_US};
use haptimill_firmware::haptics::feedback_law::FeedbackLaw;
use haptimill_firmware::haptics::fixture::{FixtureConfig, VirtualFixtures};
use haptimill_firmware::haptics::mapping::{HandleFrame, MasterMapping};
use haptimill_firmware::haptics::passivity::{COUNTED, Passivity, PassivityConfig, WHOLE};
use haptimill_math::force::Force;
use haptimill_math::trig::sin_cos;
use haptimill_math::{Angle, Coordinate, Length, Rate};
use haptimill_protocol::haptic::{ForceFeedback, ForceFeedbackAxis, MasterPose};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const NEWTON: f64 = 65_536.0;
const MM: f64 = 1_048_576.0;

fn force(newtons: f64) -> Force {
    Force((newtons * NEWTON) as i32)
}

fn settings(percent: [u8; 3], max: [f64; 3], damping: f64) -> ForceFeedback {
    ForceFeedback {
        axes: core::array::from_fn(|axis| ForceFeedbackAxis {
            percent: percent[axis],
            limit: force(max[axis]).0,
        }),
        damping: (damping * NEWTON) as u16,
        damping_below: force(2.0).0,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// sign * min(percent * |F|, most) to the last bits, for any force.
    #[test]
    fn force_share_keeps_sign_and_limit(forces: [i32; 3], percent in prop::array::uniform3(0_u8..=100), max in prop::array::uniform3(0.0_f64..10.0)) {
        let mut law = FeedbackLaw::new(&settings(percent, max, 0.0), 200);
        let feedback = law.feedback(&forces.map(Force), &[Rate(0); 3]);
        for axis in 0..3 {
            let want = (f64::from(forces[axis]) * f64::from(percent[axis]) / 100.0).abs().min(max[axis] * NEWTON);
            let want = want.copysign(f64::from(forces[axis]));
            prop_assert!((f64::from(feedback[axis].0) - want).abs() <= 2.0 + want.abs() * 1e-6, "{} {want}", feedback[axis].0);
        }
    }

    /// Whatever the settings become, the law changes by little between two periods. The damping
    /// term has no step, neither in the force nor in the rate.
    #[test]
    fn nothing_steps(
        newtons in -20.0_f64..20.0, rate in -25.0_f64..25.0, percents in prop::array::uniform2(1_u8..=100), max in 0.5_f64..8.0, dampings in prop::array::uniform2(0.0_f64..0.12),
    ) {
        let mut law = FeedbackLaw::new(&settings([percents[0]; 3], [max; 3], dampings[0]), 200);
        let at = |law: &mut FeedbackLaw, newtons: f64, rate: f64| law.feedback(&[force(newtons); 3], &[Rate((rate * MM) as i32); 3])[0].0;
        let mut before = at(&mut law, newtons, rate);
        law.set(&settings([percents[1]; 3], [max; 3], dampings[1]));
        for _ in 0..6000 {
            let now = at(&mut law, newtons, rate);
            // The whole range in a second: 2e-4 of 20 N and of 25 mm/s, by the slope of the fade.
            prop_assert!((now - before).abs() <= force(0.05).0, "{now} {before}");
            before = now;
        }
        // Settled: two forces that differ by a millinewton, with up to 0.12 N s/mm * 25 mm/s over
        // 0.5 N of fade.
        let slope = 1.0 + dampings[1] * rate.abs() / 0.5;
        let (low, high) = (at(&mut law, newtons, rate), at(&mut law, newtons + 0.001, rate));
        prop_assert!(f64::from((high - low).abs()) <= slope * 0.001 * NEWTON + 3.0);
    }

    /// However often they change, on the way or after a rest: within a second from the last change
    /// the law is that of the last settings.
    #[test]
    fn settings_arrive(
        changes in prop::collection::vec((prop::array::uniform3(0_u8..=100), prop::array::uniform3(0.0_f64..10.0), prop_oneof![Just(0.0), 0.0_f64..0.5], 0.5_f64..10.0, 1_usize..8000), 1..5),
        tool: [i32; 3], rates: [i32; 3],
    ) {
        let (tool, rates) = (tool.map(Force), rates.map(Rate));
        let mut law = FeedbackLaw::new(&settings([40; 3], [3.2; 3], 0.1), 200);
        let mut last = *law.settings();
        for (percent, max, damping, below, hold) in changes {
            last = ForceFeedback { damping_below: force(below).0, ..settings(percent, max, damping) };
            law.set(&last);
            for _ in 0..hold {
                law.feedback(&tool, &rates);
            }
        }
        for _ in 0..5002 {
            law.feedback(&tool, &rates);
        }
        prop_assert_eq!(law.feedback(&tool, &rates), FeedbackLaw::new(&last, 200).feedback(&tool, &rates));
        for axis in 0..3 {
            prop_assert_eq!(law.limit(axis), Force(last.axes[axis].limit));
        }
    }

    /// The damping term only dissipates energy: the force along the motion is never larger with it.
    #[test]
    fn velocity_damping_opposes_the_motion(newtons in -8.0_f64..8.0, rate in -60.0_f64..60.0) {
        let rates = [Rate((rate * MM) as i32); 3];
        let [plain, ..] = FeedbackLaw::new(&settings([40; 3], [3.2; 3], 0.0), 200).feedback(&[force(newtons); 3], &rates);
        let [damped, ..] = FeedbackLaw::new(&settings([40; 3], [3.2; 3], 0.1), 200).feedback(&[force(newtons); 3], &rates);
        let extra = f64::from(damped.0 - plain.0) / NEWTON;
        prop_assert!(extra * rate <= 1e-4 && extra.abs() <= 0.1 * rate.abs() + 1e-3);
        if (newtons * 0.4).abs() < 1.5 && rate.abs() < 12.0 {
            prop_assert!((extra + 0.1 * rate).abs() < 1e-3);
        }
        if (newtons * 0.4).abs() > 2.001 {
            prop_assert!(extra == 0.0);
        }
    }

    /// Feedback and damping have one limit together, to the last bit; a virtual fixture exceeds it
    /// by its own force and no more. The damping never adds along the
    /// motion; where it does not fit, the whole limit opposes the motion.
    #[test]
    fn feedback_and_damping_share_one_limit(tool: [i32; 3], damping: i32, fixture in -10.0_f64..10.0, max in prop::array::uniform3(0.0_f64..10.0), rates: [i32; 3]) {
        let mut law = FeedbackLaw::new(&settings([100; 3], max, 0.1), 200);
        let feedback = law.feedback(&tool.map(Force), &rates.map(Rate));
        for axis in 0..3 {
            let (limit, fixture) = (law.limit(axis).0, force(fixture));
            prop_assert_eq!(limit, force(max[axis]).0);
            prop_assert!(feedback[axis].0.abs() <= limit);
            let alone = law.combine(axis, feedback[axis], Force(damping), Force(0)).0;
            prop_assert!(alone.abs() <= limit);
            let all = law.combine(axis, feedback[axis], Force(damping), fixture).0;
            prop_assert!(all <= limit + fixture.0.max(0) && all >= -limit + fixture.0.min(0));
            let without = law.combine(axis, feedback[axis], Force(0), fixture).0;
            prop_assert_eq!(without, feedback[axis].0 + fixture.0);
            // Against a motion upwards the damping is downwards, and the sum not above what it was.
            if damping <= 0 {
                prop_assert!(all <= without);
                prop_assert!(i64::from(all) == i64::from(without) + i64::from(damping) || all == -limit + fixture.0.min(0));
            }
        }
    }

    /// Without an energy deficit the shares pass unchanged. With one they pass a first-order filter
    /// with a gain of 1, and never exceed the largest of them.
    #[test]
    fn deficit_low_passes_the_feedback(shares in prop::collection::vec(-10.0_f64..10.0, 3..20), deficit_of in 0_i32..4 * WHOLE, hold in 50_usize..4000) {
        let mut smoothing = FeedbackFilter::new(200);
        let constant = SLOW_US as f64 / 200.0 * (f64::from(deficit_of.min(COUNTED * WHOLE)) / f64::from(WHOLE));
        let (mut slow, mut max) = (0.0_f64, 0.0_f64);
        for share in shares {
            max = max.max(share.abs());
            for _ in 0..hold {
                slow += (share - slow) / (constant.floor() + 1.0);
                let got = smoothing.smooth(&[force(share), force(-share), Force(0)], &[deficit_of, deficit_of, 0]);
                prop_assert!((f64::from(got[0].0) / NEWTON - slow).abs() < 2e-4, "{} {slow}", got[0].0);
                prop_assert!(f64::from(got[1].0).abs() <= max * NEWTON + 1.0);
            }
            let plain = smoothing.smooth(&[Force(0), Force(0), force(share)], &[deficit_of, deficit_of, 0]);
            prop_assert_eq!(plain[2], force(share));
            slow -= slow / (constant.floor() + 1.0);
        }
    }

    /// Into a fixture and out again: it gives back no more than was put in, and says at any time
    /// how much that is.
    #[test]
    fn virtual_fixture_returns_no_more_energy_than_stored(stiffness in 0.05_f64..2.0, max in 0.5_f64..10.0, depth in 0.0_f64..40.0) {
        let config = FixtureConfig { stiffness: (stiffness * NEWTON) as u32, max: force(max) };
        let mut fixtures = VirtualFixtures::new(&config, Length::millimetres(5), 200);
        fixtures.set(1, true, Some((Length::millimetres(3), Rate(0)))).unwrap();
        let steps = 4000;
        let mut put = 0.0;
        let mut at = 0.0;
        for k in 0..=2 * steps {
            let part = 1.0 - (f64::from(k) / f64::from(steps) - 1.0).abs();
            let next = 3.0 + depth * part;
            let [x, push, z] = fixtures.push(&[0, (next * MM) as i32, 0]);
            prop_assert!(x.0 == 0 && z.0 == 0 && push.0 <= 0);
            let want = (stiffness * depth * part).min(max);
            prop_assert!((f64::from(-push.0) / NEWTON - want).abs() < 2e-3, "{} {want}", push.0);
            put -= f64::from(push.0) / NEWTON * (next - if k == 0 { 3.0 } else { at });
            at = next;
            let stored = fixtures.stored() as f64 / NEWTON / MM;
            prop_assert!((put - stored).abs() < 0.01 * max * (depth + 1.0), "{put} {stored}");
        }
    }

    /// R_sd = (R_m R_mr^T) R_sr for any handle and any tool: the tool's axis, and no jump at the
    /// latch. Position with its scale.
    #[test]
    fn tool_orientation_follows_the_handle(seed in 1_u64..u64::MAX, theta in -0.5_f64..0.5, alpha in -0.6_f64..0.6, scale in 410_u16..8192) {
        let mut sequence = Sequence(seed);
        let random = |sequence: &mut Sequence, max: f64| {
            let axis = [0; 3].map(|_| sequence.between(-1.0, 1.0));
            rotation(axis, sequence.between(0.0, max))
        };
        let (first, then) = (random(&mut sequence, 3.0), random(&mut sequence, 0.6));
        let frame = |m: M, tip: [f64; 3]| HandleFrame {
            tip: tip.map(|x| (x * MM) as i32),
            axes: transposed(m).map(|column| column.map(|x| libm::round(x * f64::from(1 << 30)) as i32)),
            enabling_switch: true,
        };
        let angle = |radians: f64| Coordinate(libm::round(radians / std::f64::consts::TAU * 4_294_967_296.0) as i32);
        let rest = [Coordinate((12.0 * MM) as i32), Coordinate((-7.0 * MM) as i32), Coordinate(0), angle(theta), angle(alpha)];
        let mut mapping = MasterMapping::new(scale);
        let tip = [30.0, -20.0, 590.0];
        mapping.follow(&frame(first, tip), 0b11111, |axis| rest[axis]);
        for axis in 0..5 {
            // 1 nm and 10 nrad: the rounding of sines and arc tangent.
            let off = mapping.targets()[axis].expect("moved").0.wrapping_sub(rest[axis].0);
            prop_assert!(off.abs() <= if axis < 3 { 0 } else { 12 }, "axis {axis} jumps by {off}");
        }
        let moved = [33.0, -22.5, 589.0];
        mapping.follow(&frame(times(then, first), moved), 0b11111, |_| unreachable!("latched"));
        for axis in 0..3 {
            let way = f64::from(mapping.targets()[axis].expect("moved").0 - rest[axis].0) / MM;
            prop_assert!((way - (moved[axis] - tip[axis]) * f64::from(scale) / 4096.0).abs() < 1e-5);
        }
        let tool = [libm::sin(theta), libm::cos(theta) * libm::sin(alpha), libm::cos(theta) * libm::cos(alpha)];
        let want = apply(then, tool);
        let sines = |axis: usize| sin_cos(Angle(mapping.targets()[axis].expect("moved").0));
        let ((s, c), (sa, ca)) = (sines(3), sines(4));
        let one = f64::from(1 << 30);
        let got = [f64::from(s) / one, f64::from(c) / one * f64::from(sa) / one, f64::from(c) / one * f64::from(ca) / one];
        for axis in 0..3 {
            prop_assert!((got[axis] - want[axis]).abs() < 1e-7, "{got:?} {want:?}");
        }
    }

    /// No sample of a remote master makes it panic.
    #[test]
    fn any_master_sample_is_accepted(tip: [i32; 3], rate: [i32; 3], axes: [[i16; 3]; 2], age: u32, scale in 410_u16..8192, rest: i32) {
        let master = MasterPose { tip, rate, axes, enabling_switch: true };
        let mut mapping = MasterMapping::new(scale);
        mapping.follow(&HandleFrame::of(&master, age, 5000), 0b11111, |_| Coordinate(rest));
        let other = MasterPose { tip: tip.map(|x| !x), ..master };
        mapping.follow(&HandleFrame::of(&other, age, 5000), 0b11111, |_| Coordinate(rest));
    }

    /// No force, displacement or rate overflows the observer; its energy stays within its limits.
    #[test]
    fn passivity_observer_stays_bounded(forces: [i32; 3], ways: [i32; 3], rates: [i32; 3], stored in 0_i64..1 << 45, surplus in 0_u32..100 << 16, deficit in 655_u32..100 << 16) {
        let mut watch = Passivity::new(&PassivityConfig { surplus, deficit, damping: 1 << 15 }, 200, 10_000_000);
        for _ in 0..20 {
            watch.observe(&forces.map(Force), &ways, stored);
            let damping = watch.damp(&rates.map(Rate));
            for axis in 0..3 {
                prop_assert!(i64::from(damping[axis].0) * i64::from(rates[axis]) <= 0);
            }
            prop_assert!(watch.energy() <= (i64::from(surplus) << 20) + stored && watch.energy() >= -3 * (i64::from(deficit) << 20));
        }
    }
}

/// The clamps of docs/control.md 3.4: 8 N and 6 N are where they begin.
#[test]
fn force_limits_of_the_experiments() {
    let mut law = FeedbackLaw::new(&settings([40, 10, 20], [3.2, 3.2, 1.2], 0.0), 200);
    let mut render = |x: f64, y: f64, z: f64| {
        law.feedback(&[force(x), force(y), force(z)], &[Rate(0); 3])
            .map(|feedback| (f64::from(feedback.0) / NEWTON * 1e3).round() / 1e3)
    };
    assert_eq!(render(10.0, -7.0, 7.0), [3.2, -0.7, 1.2]);
    assert_eq!(render(7.9, 0.0, 5.9), [3.16, 0.0, 1.18]);
    assert_eq!(render(-8.1, 0.0, -6.1), [-3.2, 0.0, -1.2]);
    // The damping term of E10: 12 mm/s are 1.2 N.
    let mut law = FeedbackLaw::new(&settings([40; 3], [3.2; 3], 0.1), 200);
    let rates = [Rate((-12.0 * MM) as i32), Rate(0), Rate(0)];
    let [feedback, ..] = law.feedback(&[force(2.5), force(0.0), force(0.0)], &rates);
    assert!((f64::from(feedback.0) / NEWTON - 2.2).abs() < 1e-3);
}

/// Free motion, or motion against a force, is never damped; motion driven by the arm is.
#[test]
fn only_active_behaviour_is_damped() {
    let config = PassivityConfig {
        surplus: 32_768,
        deficit: 65_536,
        damping: 19_661,
    };
    let mut watch = Passivity::new(&config, 200, 10_000_000);
    let rates = [Rate((20.0 * MM) as i32), Rate(0), Rate(0)];
    for k in 0..5000 {
        // 20 mm/s, freely, then against 2 N.
        let against = if k < 2000 { 0.0 } else { -2.0 };
        watch.observe(
            &[force(against), Force(0), Force(0)],
            &[(0.004 * MM) as i32, 0, 0],
            0,
        );
        assert_eq!(watch.damp(&rates)[0], Force(0));
    }
    // The same way with 2 N along it: half a newton millimetre is free, after a millimetre and a
    // half the damping is whole.
    let mut way = 0.0;
    while way < 0.25 {
        watch.observe(
            &[force(2.0), Force(0), Force(0)],
            &[(0.004 * MM) as i32, 0, 0],
            0,
        );
        way += 0.004;
    }
    assert!(watch.damp(&rates)[0].0 > force(-0.4).0);
    while way < 0.8 {
        watch.observe(
            &[force(2.0), Force(0), Force(0)],
            &[(0.004 * MM) as i32, 0, 0],
            0,
        );
        way += 0.004;
    }
    assert!((f64::from(watch.damp(&rates)[0].0) / NEWTON + 6.0).abs() < 0.01);
}
