//! Gantries: a second motor, with its own screw and home switch, moves the other end of the beam
//! that a joint of the model moves.
//!
//! The kinematics know the first motor only. The second one gets the same joint motion, plus the
//! distance that was left between the two when the commanded position was set last. That distance
//! decays at the touch rate of homing, so the command does not step. Before homing it is constant,
//! because the correct one of the two motors is unknown.
//!
//! Racking is the second motor minus the first one. Homing moves each motor to its own switch, and
//! so squares the beam; the motors wait for each other before each step of the search.

use super::Machine;
use crate::config::{Config, GantryAxis, JointSettings};
use crate::joint::encoder::{difference, sum};
use haptimill_kinematics::Joints;
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::{Event, Fault, MAX_AXES};

/// Second motors of gantries.
#[derive(Debug, Default)]
pub(super) struct Gantries {
    /// Joints that are second motors, one bit each.
    seconds: u8,
    /// Commanded distance of each second motor from its first one.
    offsets: [Coordinate; MAX_AXES],
}

impl Gantries {
    /// The second motors of a configuration, square.
    pub(super) fn new(config: &Config) -> Self {
        let joints = config.joints.iter().rev();
        Self {
            seconds: joints.fold(0, |bits, joint| {
                bits << 1 | u8::from(joint.gantry.is_some())
            }),
            ..Self::default()
        }
    }

    /// Joints that are second motors, one bit each.
    pub(super) const fn seconds(&self) -> u8 {
        self.seconds
    }

    /// Whether the machine has a gantry.
    #[inline]
    pub(super) const fn exist(&self) -> bool {
        self.seconds != 0
    }
}

/// A second motor: its joint, the joint of the first motor, and their configuration.
struct Second<'a> {
    joint: usize,
    first: usize,
    settings: &'a JointSettings,
    gantry: &'a GantryAxis,
}

/// The second motors of a configuration.
fn seconds(config: &Config) -> impl Iterator<Item = Second<'_>> {
    let joints = config.joints.iter().enumerate();
    joints.filter_map(|(joint, settings)| {
        let gantry = settings.gantry.as_ref()?;
        let first = usize::from(gantry.of).min(MAX_AXES - 1);
        Some(Second {
            joint,
            first,
            settings,
            gantry,
        })
    })
}

impl Config {
    /// The other motors of the gantry of a joint, for each joint: its first motor, or its second
    /// one.
    pub(super) fn partner(&self, joint: usize) -> Option<usize> {
        seconds(self).find_map(|second| match joint {
            _ if joint == second.joint => Some(second.first),
            _ if joint == second.first => Some(second.joint),
            _ => None,
        })
    }
}

impl Machine {
    /// Takes over the distances of the second motors from commanded joints.
    pub(super) fn place_gantries(&mut self, joints: &Joints) {
        for second in seconds(&self.config) {
            let (at, first) = (joints.0[second.joint], joints.0[second.first]);
            self.gantries.offsets[second.joint] = difference(second.settings.kind, at, first);
        }
    }

    /// Commands the second motors of this period. `known` is true while the machine is homed with
    /// its position kept.
    #[inline]
    pub fn follow_gantries(&mut self, known: bool) {
        if self.gantries.exist() && !self.searches_switches() {
            self.command_seconds(known);
        }
    }

    #[cold]
    #[inline(never)]
    fn command_seconds(&mut self, known: bool) {
        let period = i64::from(self.config.period_us);
        for second in seconds(&self.config) {
            let offset = &mut self.gantries.offsets[second.joint];
            let rate = second
                .settings
                .home
                .switch()
                .map_or(0, |it| it.touch_rate.0);
            let max = (i64::from(rate) * period / 1_000_000).max(1);
            let closes = if known {
                -i64::from(offset.0).clamp(-max, max)
            } else {
                0
            };
            offset.0 = offset.0.wrapping_add(closes as i32);
            let (offset, target) = (*offset, &mut self.target);
            let closing = Rate::saturating_from(closes * 1_000_000 / period.max(1));
            target.joints.0[second.joint] =
                sum(second.settings.kind, target.joints.0[second.first], offset);
            let first = target.rates[second.first];
            target.rates[second.joint] = Rate(first.0.saturating_add(closing.0));
            target.accelerations[second.joint] = target.accelerations[second.first];
        }
    }

    /// The fault of a gantry whose motors were measured too far apart. `known` is true while the
    /// machine is homed: the coordinates of two motors that are not homed cannot be compared.
    #[inline]
    pub fn racked(&self, known: bool) -> Option<Fault> {
        if !known || !self.gantries.exist() {
            return None;
        }
        self.racking(|joint| i64::from(self.measured.0[joint].0))
    }

    /// The fault of a gantry whose motors moved by distances too different in the present search of
    /// their switches.
    pub(super) fn racked_in_search(&self) -> Option<Fault> {
        if !self.gantries.exist() {
            return None;
        }
        self.racking(|joint| self.switches.moved(joint))
    }

    #[cold]
    #[inline(never)]
    fn racking(&self, place: impl Fn(usize) -> i64) -> Option<Fault> {
        seconds(&self.config).find_map(|second| {
            let by = place(second.joint) - place(second.first);
            (by.abs() > i64::from(second.gantry.racking.0)).then_some(Fault::Racking {
                joint: second.joint as u8,
                by: by.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32,
            })
        })
    }

    /// What homing found, one event after the other: how far joints that home by a switch were off
    /// their positions, where these were known, and how far gantries were squared.
    pub fn homing_events(&self) -> impl Iterator<Item = Event> + '_ {
        let (shifts, known) = (self.switches.shifts(), self.switches.was_known());
        let moved = shifts.iter().enumerate().filter(move |_| known);
        let shifted = moved.filter(|(_, shift)| shift.0 != 0);
        let shifted = shifted.map(|(joint, shift)| Event::ReferenceShift {
            joint: joint as u8,
            by: shift.0,
        });
        let squared = seconds(&self.config).map(|second| {
            let (own, first) = (shifts[second.joint], shifts[second.first]);
            Event::Squared {
                joint: second.joint as u8,
                // The coordinate rises where the motor was behind.
                by: difference(second.settings.kind, first, own).0,
            }
        });
        shifted.chain(squared)
    }
}
