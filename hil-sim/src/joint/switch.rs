//! A switch at a place of the stroke: hysteresis, bounce, wiring.
//!
//! The slide presses the switch from its place on. It releases it a hysteresis before that. After
//! either the contact bounces for some time: its level is random in each control period.

use crate::joint::SwitchSide;
use crate::random::Random;

/// Mechanics of a switch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SwitchPlace {
    /// Trip coordinate, axis units.
    pub at: f64,
    /// Side on which the slide presses the switch.
    pub side: SwitchSide,
    /// Distance from the trip coordinate to the release, axis units.
    pub hysteresis: f64,
    /// Time for which the contact bounces, ms.
    pub bounce_ms: f64,
}

/// Injected faults of a switch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SwitchCondition {
    /// The contact is stuck in this state.
    pub stuck: Option<bool>,
    /// The contact is wired the wrong way: closed for open.
    pub inverted: bool,
    /// The switch is not connected: its line is low.
    pub missing: bool,
    /// Additional time for which the contact bounces, ms.
    pub bounce_ms: f64,
}

/// A switch.
#[derive(Debug, Clone)]
pub struct Switch {
    place: Option<SwitchPlace>,
    /// The line is low where the contact is active.
    active_low: bool,
    pressed: bool,
    /// Time of the last press or release, ns.
    changed_ns: Option<u64>,
    /// Level of a contact that bounces.
    bouncing: Option<bool>,
    random: Random,
}

impl Switch {
    /// Creates a switch with the slide at `slide`. Without a place nothing presses it.
    pub fn new(place: Option<SwitchPlace>, active_low: bool, slide: f64, random: Random) -> Self {
        let mut switch = Self {
            place,
            active_low,
            pressed: false,
            changed_ns: None,
            bouncing: None,
            random,
        };
        switch.pressed = switch.is_pressed(slide);
        switch
    }

    fn is_pressed(&self, slide: f64) -> bool {
        let Some(place) = self.place else {
            return false;
        };
        let slack = if self.pressed { place.hysteresis } else { 0.0 };
        match place.side {
            SwitchSide::Below => slide <= place.at + slack,
            SwitchSide::Above => slide >= place.at - slack,
        }
    }

    /// Follows the slide at the end of a control period.
    pub fn follow(&mut self, slide: f64, time_ns: u64, condition: &SwitchCondition) {
        let Some(place) = self.place else {
            return;
        };
        let pressed = self.is_pressed(slide);
        if pressed != self.pressed {
            self.pressed = pressed;
            self.changed_ns = Some(time_ns);
        }
        let bounce_ns = (place.bounce_ms + condition.bounce_ms) * 1e6;
        let bounces = self
            .changed_ns
            .is_some_and(|changed| ((time_ns - changed) as f64) < bounce_ns);
        self.bouncing = bounces.then(|| self.random.happens(0.5));
    }

    /// Level of the line.
    pub fn level(&self, condition: &SwitchCondition) -> bool {
        if condition.missing {
            return false;
        }
        let active = self.bouncing.unwrap_or(self.pressed);
        let active = condition.stuck.unwrap_or(active);
        active != (self.active_low != condition.inverted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 200_000;

    fn switch(active_low: bool) -> Switch {
        let place = SwitchPlace {
            at: 10.0,
            side: SwitchSide::Above,
            hysteresis: 0.5,
            bounce_ms: 2.0,
        };
        Switch::new(Some(place), active_low, 0.0, Random::new(1, 1))
    }

    /// Levels of a switch whose slide stays at a place for some periods.
    fn stay(switch: &mut Switch, slide: f64, time_ns: &mut u64, periods: usize) -> Vec<bool> {
        let healthy = SwitchCondition::default();
        let levels = (0..periods).map(|_| {
            *time_ns += PERIOD_NS;
            switch.follow(slide, *time_ns, &healthy);
            switch.level(&healthy)
        });
        levels.collect()
    }

    #[test]
    fn a_switch_bounces_when_it_is_pressed_and_released_after_its_hysteresis() {
        let mut switch = switch(false);
        let mut time = 0;
        assert!(!stay(&mut switch, 9.9, &mut time, 20).contains(&true));
        let levels = stay(&mut switch, 10.0, &mut time, 30);
        assert!(levels[..10].contains(&true) && levels[..10].contains(&false));
        assert!(!levels[10..].contains(&false), "{levels:?}");
        assert!(!stay(&mut switch, 9.6, &mut time, 20).contains(&false));
        let levels = stay(&mut switch, 9.4, &mut time, 30);
        assert!(levels[..10].contains(&true));
        assert!(!levels[10..].contains(&true), "{levels:?}");
    }

    #[test]
    fn wiring_and_defects_set_the_level() {
        let level = |active_low: bool, slide: f64, condition: SwitchCondition| {
            let mut switch = switch(active_low);
            let mut time = 0;
            stay(&mut switch, slide, &mut time, 50);
            switch.level(&condition)
        };
        let healthy = SwitchCondition::default();
        let inverted = SwitchCondition {
            inverted: true,
            ..healthy
        };
        let missing = SwitchCondition {
            missing: true,
            ..healthy
        };
        let stuck = SwitchCondition {
            stuck: Some(true),
            ..healthy
        };
        for active_low in [false, true] {
            for (slide, pressed) in [(0.0, false), (11.0, true)] {
                assert_eq!(level(active_low, slide, healthy), pressed != active_low);
                assert_eq!(level(active_low, slide, inverted), pressed == active_low);
                assert!(!level(active_low, slide, missing));
                assert_eq!(level(active_low, slide, stuck), !active_low);
            }
        }
    }
}
