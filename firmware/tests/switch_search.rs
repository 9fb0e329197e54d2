//! Search for a home switch, with a joint that follows its command exactly.

use haptimill_firmware::config::{SwitchHome, SwitchInput};
use haptimill_firmware::safety::switch_search::{SearchInputs, SwitchSearch};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::HomingProblem;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const MM: f64 = (1 << 20) as f64;
const PERIOD_US: u16 = 200;

fn mm(value: f64) -> Coordinate {
    Coordinate((value * MM) as i32)
}

fn config(downwards: bool) -> SwitchHome {
    SwitchHome {
        input: SwitchInput::Home,
        order: 1,
        downwards,
        coordinate: mm(0.0),
        rate: Rate((20.0 * MM) as i32),
        touch_rate: Rate(MM as i32),
        acceleration: Acceleration((1000.0 * MM / 256.0) as i32),
        back_off: mm(3.0),
        release: mm(9.0),
        travel: mm(300.0),
    }
}

/// A switch that is active on one side of a place.
struct Switch {
    at: f64,
    hysteresis: f64,
    /// Periods for which the contact bounces after a change, and those that are left.
    bounce: u32,
    left: u32,
    pressed: bool,
    /// What is wrong with it, if anything.
    stuck: Option<bool>,
    inverted: bool,
}

impl Switch {
    fn level(&mut self, place: f64, downwards: bool, random: bool) -> bool {
        // Distance beyond the switch.
        let beyond = if downwards {
            self.at - place
        } else {
            place - self.at
        };
        let slack = if self.pressed { self.hysteresis } else { 0.0 };
        let pressed = beyond >= -slack;
        if pressed != self.pressed {
            self.pressed = pressed;
            self.left = self.bounce;
        }
        let level = if self.left > 0 { random } else { pressed };
        self.left = self.left.saturating_sub(1);
        self.stuck.unwrap_or(level != self.inverted)
    }
}

/// Runs a search from `start`; the place of the touch, the place at the end, and the places that
/// the joint reached.
fn search(
    config: &SwitchHome,
    switch: &mut Switch,
    start: f64,
) -> (Result<(f64, f64), HomingProblem>, [f64; 2]) {
    let mut search = SwitchSearch::default();
    let mut reached = [start; 2];
    let mut noise = 1_u32;
    for _ in 0..500_000 {
        let place = start + search.moved() as f64 / MM;
        reached = [reached[0].min(place), reached[1].max(place)];
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let search_inputs = SearchInputs {
            config,
            partner: None,
            active: switch.level(place, config.downwards, noise >> 31 != 0),
            place: mm(place),
            index: None,
            index_travel: None,
            period_us: PERIOD_US,
        };
        let rate = search.rate();
        if let Err(problem) = search.advance(&search_inputs) {
            return (Err(problem), reached);
        }
        // The acceleration holds.
        assert!((search.rate() - rate).abs() <= (0.2 * MM) as i64 + 1);
        if search.is_done() {
            assert_eq!(search.rate(), 0);
            let touched = f64::from(search.found().0.0) / MM;
            return (Ok((touched, start + search.moved() as f64 / MM)), reached);
        }
    }
    panic!("the search does not end");
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(5), cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// A healthy switch is found to its bounce, from either side of it, and released at the end.
    #[test]
    fn a_switch_is_found(
        downwards: bool, at in -100.0..100.0f64, distance in -8.0..250.0f64,
        hysteresis in 0.0..0.5f64, bounce in 0u32..60,
    ) {
        let config = config(downwards);
        let start = if downwards { at + distance } else { at - distance };
        let mut switch = Switch { at, hysteresis, bounce, left: 0, pressed: distance <= 0.0, stuck: None, inverted: false };
        let (found, _) = search(&config, &mut switch, start);
        let (touched, end) = found.expect("found");
        // 1 mm/s: the bounce, and a period.
        let slack = f64::from(bounce + 2) * 2e-4 + 1e-5;
        prop_assert!((touched - at).abs() <= slack, "{touched} for {at}");
        let off = if downwards { end - at } else { at - end };
        prop_assert!((2.9..4.0).contains(&off), "{off} off the switch");
    }

    /// A defective switch ends the search with its name, and the joint stays within its bounds.
    #[test]
    fn a_defective_switch_is_named(downwards: bool, active: bool, inverted: bool, start in -50.0..50.0f64) {
        let config = config(downwards);
        let at = if downwards { -1000.0 } else { 1000.0 };
        let stuck = if inverted { None } else { Some(active) };
        let mut switch = Switch { at, hysteresis: 0.0, bounce: 0, left: 0, pressed: false, stuck, inverted };
        let (found, [low, high]) = search(&config, &mut switch, start);
        let (problem, [below, above]) = if inverted || active {
            (HomingProblem::SwitchStuck, [9.1, 9.1])
        } else {
            (HomingProblem::NoSwitch, [300.1, 300.1])
        };
        prop_assert_eq!(found, Err(problem));
        prop_assert!(low >= start - below && high <= start + above, "{low} to {high} from {start}");
    }
}

/// A switch that sticks when it is pressed.
#[test]
fn a_switch_that_stays_pressed_is_named() {
    let config = config(true);
    let mut switch = Switch {
        at: 0.0,
        hysteresis: 20.0,
        bounce: 0,
        left: 0,
        pressed: false,
        stuck: None,
        inverted: false,
    };
    let (found, _) = search(&config, &mut switch, 50.0);
    assert_eq!(found, Err(HomingProblem::SwitchStuck));
}
