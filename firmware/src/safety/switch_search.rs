//! Search of one joint for its home switch, in the coordinate of the joint.
//!
//! ```text
//! off the switch if it is active | to the switch, fast | off it, and back off |
//! to the switch, slowly: its place counts | [index pulse, moving off] | back off
//! ```
//!
//! The position of the joint is unknown, so its stroke bounds nothing: the largest travel, the
//! release distance and the back-off bound the search. A level of the switch counts when it has
//! lasted for [`STEADY_US`]; its place is where it began, so contacts may bounce.
//!
//! Distances are axis units. A rate changes by the acceleration of the configuration per period.

use crate::config::SwitchHome;
use haptimill_math::Coordinate;
use haptimill_protocol::message::HomingProblem;

/// A level of the switch counts when it has lasted for this time, microseconds.
pub const STEADY_US: u32 = 2_000;

/// Parts of an axis unit in which motion adds up: the mean of two rates times microseconds.
const FRACTION: i64 = 2_000_000;

/// What the joint does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum SearchPhase {
    /// At rest, until the level of the switch is steady.
    #[default]
    Start,
    /// Off a switch that was active at the start, or was just found.
    Off,
    /// Away from the released switch by the back-off.
    Clear,
    /// To the switch, fast.
    Seek,
    /// To the switch, slowly.
    Touch,
    /// Away from it, to the next index pulse.
    Index,
    /// Away from the switch by the back-off, at the end.
    Retreat,
    /// Found and at rest.
    Done,
}

/// Search of one joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SwitchSearch {
    phase: SearchPhase,
    /// The joint only moves off the switch on which it stands.
    is_move_off: bool,
    /// The joint comes to rest before the phase begins.
    halting: bool,
    /// It has come to rest, and the other motor of its gantry has not.
    at_rest: bool,
    /// Distance from the start of the search, and its fraction.
    moved: i64,
    part: i64,
    /// Where the phase began.
    begun: i64,
    /// Rate, axis units per second, and its change in the last period.
    rate: i64,
    change: i64,
    /// Steady level of the switch, periods since the start, periods for which the level differs,
    /// and the coordinate where that began.
    level: bool,
    waited: u32,
    differs: u32,
    edge: Coordinate,
    /// Coordinate of the fast touch, and of the slow one.
    first: Option<Coordinate>,
    touched: Coordinate,
    /// Motor coordinate of the index pulse.
    index: Option<Coordinate>,
}

/// Inputs of a search in a period.
pub struct SearchInputs<'a> {
    /// Configuration of the search.
    pub config: &'a SwitchHome,
    /// Search of the other motor of a gantry, as it was a period ago. The two wait for each other
    /// before each phase that begins at rest.
    pub partner: Option<&'a SwitchSearch>,
    /// The switch is active.
    pub active: bool,
    /// Coordinate of the joint.
    pub place: Coordinate,
    /// Motor coordinate of an index pulse of this period.
    pub index: Option<Coordinate>,
    /// Distance in which an index pulse must come; `None` without a search for it.
    pub index_travel: Option<i64>,
    /// Control period, microseconds.
    pub period_us: u16,
}

impl SwitchSearch {
    /// A search that ends off the switch on which the joint stands.
    #[must_use]
    pub fn moving_off() -> Self {
        Self {
            is_move_off: true,
            ..Self::default()
        }
    }

    /// Moves on from where the joint has come to rest off the switch, by the back-off.
    pub const fn move_on(&mut self) {
        self.phase = SearchPhase::Clear;
        self.begun = self.moved;
    }

    /// Distance from the start of the search.
    #[must_use]
    pub const fn moved(&self) -> i64 {
        self.moved
    }

    /// Rate, axis units per second.
    #[must_use]
    pub const fn rate(&self) -> i64 {
        self.rate
    }

    /// Change of the rate in the last period.
    #[must_use]
    pub const fn change(&self) -> i64 {
        self.change
    }

    /// Whether the reference is found and the joint at rest.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        matches!(self.phase, SearchPhase::Done) && !self.halting
    }

    /// Whether the joint is at rest before a phase, or was and has begun it.
    fn awaits(&self, phase: SearchPhase) -> bool {
        self.phase == phase && (self.at_rest || !self.halting)
    }

    /// Coordinates of the joint at the slow touch, and of the motor at the index pulse.
    #[must_use]
    pub const fn found(&self) -> (Coordinate, Option<Coordinate>) {
        (self.touched, self.index)
    }

    /// Decelerates; returns whether the joint is at rest.
    pub fn halt(&mut self, config: &SwitchHome, period_us: u16) -> bool {
        self.drive(0, config, period_us);
        self.rate == 0
    }

    /// One period of the search.
    ///
    /// # Errors
    /// The problem that ends the homing of all joints.
    pub fn advance(&mut self, inputs: &SearchInputs<'_>) -> Result<(), HomingProblem> {
        self.supervise(inputs);
        let config = inputs.config;
        if self.halting {
            let rest = self.halt(config, inputs.period_us);
            self.begun = self.moved;
            let together = inputs
                .partner
                .is_none_or(|partner| partner.awaits(self.phase));
            if !rest || !together {
                self.at_rest = rest;
                return Ok(());
            }
            self.halting = false;
            self.at_rest = false;
            return self.begin_at_rest();
        }
        let towards = if config.downwards { -1 } else { 1 };
        let (rate, slow) = (i64::from(config.rate.0), i64::from(config.touch_rate.0));
        let back_off = i64::from(config.back_off.0);
        let release = i64::from(config.release.0);
        let gone = (self.moved - self.begun).abs();
        let requested = match self.phase {
            SearchPhase::Start => {
                self.waited += 1;
                if self.waited > 2 * steady(inputs.period_us) {
                    // The motors of a gantry move off together if one of them is on its switch.
                    let pressed = self.level || inputs.partner.is_some_and(|it| it.level);
                    self.phase = match pressed {
                        true => SearchPhase::Off,
                        false if self.is_move_off => SearchPhase::Clear,
                        false => SearchPhase::Seek,
                    };
                }
                0
            }
            SearchPhase::Seek if self.level => {
                self.first = Some(self.edge);
                self.halt_before(SearchPhase::Off)
            }
            SearchPhase::Seek if gone > i64::from(config.travel.0) => {
                return Err(HomingProblem::NoSwitch);
            }
            SearchPhase::Seek => towards * rate,
            SearchPhase::Off if !self.level => {
                self.begun = self.moved;
                self.phase = SearchPhase::Clear;
                -towards * rate
            }
            SearchPhase::Off if gone > release => return Err(HomingProblem::SwitchStuck),
            SearchPhase::Off => -towards * rate,
            SearchPhase::Clear if gone >= back_off => self.halt_before(match self.is_move_off {
                true => SearchPhase::Done,
                false => SearchPhase::Touch,
            }),
            SearchPhase::Clear => -towards * rate,
            SearchPhase::Touch if self.level => {
                self.touched = self.edge;
                // The touches differ by less than the bounce, unless steps were lost or the switch
                // is loose.
                let off = self.first.map_or(0, |first| {
                    i64::from(first.0.wrapping_sub(self.edge.0)).abs()
                });
                if off > back_off / 4 {
                    return Err(HomingProblem::SwitchUnsteady);
                }
                self.halt_before(match inputs.index_travel {
                    Some(_) => SearchPhase::Index,
                    None => SearchPhase::Retreat,
                })
            }
            SearchPhase::Touch if gone > 2 * back_off + release => {
                return Err(HomingProblem::NoSwitch);
            }
            SearchPhase::Touch => towards * slow,
            SearchPhase::Index if inputs.index.is_some() => {
                self.index = inputs.index;
                self.begun = self.moved;
                self.phase = SearchPhase::Retreat;
                -towards * slow
            }
            SearchPhase::Index if inputs.index_travel.is_some_and(|max| gone > max) => {
                return Err(HomingProblem::NoIndex);
            }
            SearchPhase::Index => -towards * slow,
            SearchPhase::Retreat if gone >= back_off => self.halt_before(SearchPhase::Done),
            SearchPhase::Retreat => -towards * rate,
            SearchPhase::Done => 0,
        };
        self.drive(requested, config, inputs.period_us);
        Ok(())
    }

    /// Checks the switch where the joint has come to rest before a phase.
    fn begin_at_rest(&self) -> Result<(), HomingProblem> {
        match self.phase {
            // The switch was released and came again within the back-off.
            SearchPhase::Touch if self.level => Err(HomingProblem::SwitchUnsteady),
            SearchPhase::Done if self.level => Err(HomingProblem::SwitchStuck),
            _ => Ok(()),
        }
    }

    /// Comes to rest, then begins a phase.
    const fn halt_before(&mut self, phase: SearchPhase) -> i64 {
        self.phase = phase;
        self.halting = true;
        0
    }

    /// Follows the level of the switch.
    fn supervise(&mut self, inputs: &SearchInputs<'_>) {
        if inputs.active == self.level {
            self.differs = 0;
            return;
        }
        if self.differs == 0 {
            self.edge = inputs.place;
        }
        self.differs += 1;
        if self.differs >= steady(inputs.period_us) {
            self.level = inputs.active;
            self.differs = 0;
        }
    }

    /// Moves by one period, with the rate going to `requested`.
    fn drive(&mut self, requested: i64, config: &SwitchHome, period_us: u16) {
        let period = i64::from(period_us);
        // The unit of an acceleration is 2^8 axis units per second squared.
        let max = (i64::from(config.acceleration.0) * 256 * period / 1_000_000).max(1);
        self.change = (requested - self.rate).clamp(-max, max);
        let before = self.rate;
        self.rate += self.change;
        self.part += (before + self.rate) * period;
        self.moved += self.part.div_euclid(FRACTION);
        self.part = self.part.rem_euclid(FRACTION);
    }
}

/// Periods for which a level must last.
fn steady(period_us: u16) -> u32 {
    STEADY_US / u32::from(period_us.max(1)) + 1
}
