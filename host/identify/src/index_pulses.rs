//! Places of index pulses and their spread, by repeated reference searches.
//!
//! A controller does not report where it latched an index pulse. It reports the commanded position,
//! which shifts at the end of a reference search by the distance between the place of the pulse in
//! the machine file and its place by the coordinate before. After a search that coordinate comes
//! from the pulse before, so the sum of all shifts gives the place of every pulse in the coordinate
//! before the first search. On a machine that is not homed that is the preset.
//!
//! A search goes upwards, and downwards in the upper quarter of the range of its coordinate. For
//! searches in the other direction the controller gets soft limits that are nearer to the home
//! pose, so that this lies in the other part of the range. The limits become narrower only. The
//! index monitor is off in the test: it would refuse the pulses whose spread is to be found.
//!
//! A new configuration needs the drives off. Where a step motor without encoder would lose its
//! position meanwhile, the controller keeps its configuration: the searches go in one direction,
//! and the index monitor bounds the spread.

use crate::identify::FRAME_BYTES;
use crate::measure::count_of;
use crate::switch_test::Skipped;
use haptimill_client::session::{self, Session, find_home_pose};
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::{AxisKind, Home};
use haptimill_kinematics::{Kinematics as _, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{per_unit, to_i32};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{AxisValues, Command, State, Telemetry};

/// Searches in each direction.
pub const TIMES: usize = 5;

/// Time for which a search may last longer than the motion of 1.2 turns takes, and a stop, seconds.
const REST: f64 = 1.0;

/// Time between two telemetry frames, seconds. A scale with counts of 0.02 um needs less than 1 ms.
const INTERVAL: f64 = 4e-4;

/// Part of the room beside the home pose that the soft limits keep on the side which the search
/// leaves. A quarter decides on the direction; a fifth of the other side is a sixth of the range.
const KEPT: f64 = 0.2;

/// A joint whose index pulses are sought.
#[derive(Debug, Clone)]
pub struct IndexJoint {
    /// Index of the joint.
    pub joint: usize,
    /// Coordinate of the pose that moves in its search.
    pub coordinate: usize,
    /// Largest distance that the search moves this coordinate to each side of the home pose, mm or
    /// degrees.
    pub reach: f64,
}

/// A pass over an index pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pass {
    /// Place of the pulse in the coordinate before the first search, mm or degrees.
    pub at: f64,
    /// The joint moved upwards.
    pub upwards: bool,
}

/// Index pulses of a joint; mm or degrees.
#[derive(Debug, Clone)]
pub struct IndexPulses {
    /// Index of the joint.
    pub joint: usize,
    /// Its name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Size of a count.
    pub count: f64,
    /// Distance between two pulses.
    pub pitch: f64,
    /// Preset of the joint.
    pub preset: f64,
    /// The place in the machine file.
    pub before: f64,
    /// The slack in the machine file, counts.
    pub slack_before: u16,
    /// The places come from the presets. If not, the machine was homed before, and they come from
    /// the pulses in the machine file.
    pub from_presets: bool,
    /// Why the passes are in one direction only, if they are.
    pub one_way: &'static str,
    /// The passes, in their order.
    pub passes: Vec<Pass>,
}

impl IndexPulses {
    /// Mean place of the pulse that is nearest to the preset.
    #[must_use]
    pub fn place(&self) -> f64 {
        let sum: f64 = self.passes.iter().map(|it| it.at).sum();
        let mean = sum / self.passes.len().max(1) as f64;
        mean - ((mean - self.preset) / self.pitch).round() * self.pitch
    }

    /// The place for the machine file: none where the machine was homed by it.
    #[must_use]
    pub fn proposed(&self) -> Option<f64> {
        // A tenth of a micrometre is less than a count of any machine.
        self.from_presets
            .then(|| (self.place() * 1e4).round() / 1e4)
    }

    /// Distance of a pass from the mean of all, counts.
    #[must_use]
    pub fn deviation(&self, pass: &Pass) -> f64 {
        let sum: f64 = self.passes.iter().map(|it| it.at).sum();
        (pass.at - sum / self.passes.len().max(1) as f64) / self.count
    }

    /// Largest distance between two passes, counts.
    #[must_use]
    pub fn spread(&self) -> f64 {
        let places = self.passes.iter().map(|it| it.at);
        let high = places.clone().fold(f64::NEG_INFINITY, f64::max);
        let low = places.fold(f64::INFINITY, f64::min);
        ((high - low) / self.count).max(0.0)
    }

    /// The slack for the machine file: the monitor compares a pulse with that of the reference
    /// search, which can be any of them. One count more is the margin.
    #[must_use]
    pub fn slack(&self) -> u16 {
        to_i32(self.spread()).clamp(0, i32::from(u16::MAX) - 1) as u16 + 1
    }

    /// Passes upwards, and downwards.
    #[must_use]
    pub fn directions(&self) -> [usize; 2] {
        let up = self.passes.iter().filter(|it| it.upwards).count();
        [up, self.passes.len() - up]
    }

    /// One line for the joint.
    #[must_use]
    pub fn summary(&self) -> String {
        let unit = if self.kind.is_rotary() { "deg" } else { "mm" };
        let [up, down] = self.directions();
        let from = if self.from_presets {
            "by the preset"
        } else {
            "by the reference of the machine file, which stays"
        };
        let one_way = if up == 0 || down == 0 {
            format!("; one direction only: {}", self.one_way)
        } else {
            String::new()
        };
        format!(
            "{}: index pulse at {:.4} {unit} {from} (machine file {:.4} {unit}), {up} passes \
             upwards and {down} downwards within {:.1} counts, slack {} counts (machine file \
             {}){one_way}",
            self.name,
            self.place(),
            self.before,
            self.spread(),
            self.slack(),
            self.slack_before
        )
    }
}

/// What no measurement of the controller can show, and what to do about it.
pub const UNKNOWN: &str = "The places are relative to the presets: an error of the joints at power-on \
                           is in each of them. Place the joints at their presets with an instrument \
                           before power-on.";

/// The joints whose index pulses are sought, and the others with their reasons. `travel` is the
/// longest motion, mm or degrees.
#[must_use]
pub fn index_joints(machine: &MachineFile, travel: f64) -> (Vec<IndexJoint>, Vec<Skipped>) {
    let (mut joints, mut skipped) = (Vec::new(), Vec::new());
    for joint in 0..machine.joints.len() {
        match index_joint(machine, joint, travel) {
            Ok(found) => joints.push(found),
            Err(reason) => skipped.push(Skipped {
                name: machine.joints[joint].name.clone(),
                reason,
            }),
        }
    }
    (joints, skipped)
}

fn index_joint(machine: &MachineFile, joint: usize, travel: f64) -> Result<IndexJoint, String> {
    let axis = &machine.config.joints[joint];
    let Some(encoder) = &axis.encoder else {
        return Err("it has no encoder with an index pulse".to_string());
    };
    match axis.home {
        Home::Index => {}
        Home::SwitchAndIndex(_) => {
            return Err(
                "its index pulse is sought behind the home switch, from one side only".into(),
            );
        }
        Home::Switch(_) | Home::Preset => {
            return Err("it does not home by an index pulse".to_string());
        }
    }
    if axis.gantry.is_some() {
        return Err("it is the second motor of a gantry, which follows the first one".to_string());
    }
    let homing = &machine.config.homing;
    let rate = match axis.kind {
        AxisKind::Linear => f64::from(homing.rate.0),
        AxisKind::Rotary => f64::from(homing.rotary_rate.0),
        AxisKind::MultiTurn => f64::from(homing.multi_turn_rate()),
    };
    let reach = (1.2 * f64::from(encoder.index_pitch.0) + REST * rate) / per_unit(axis.kind);
    if 2.0 * reach > travel {
        return Err(format!(
            "its searches move up to {:.1} mm or degrees, more than --travel",
            2.0 * reach
        ));
    }
    let coordinate = machine.config.kinematics().search_coordinate(joint);
    Ok(IndexJoint {
        joint,
        coordinate,
        reach,
    })
}

/// Soft limits with which a search from `home` goes in the other direction than with `low` and
/// `high`; all in axis units. `None` without room for `reach`.
fn turned(low: i32, high: i32, home: i32, reach: f64) -> Option<(i32, i32)> {
    let [low, high, home] = [low, high, home].map(f64::from);
    let is_downwards = home > high - (high - low) / 4.0;
    let room = if is_downwards {
        high - home
    } else {
        home - low
    };
    if room < reach {
        return None;
    }
    // The room on the side that the search leaves becomes a part of that on the other side.
    let kept = KEPT * room;
    let limits = if is_downwards {
        (low.max(home - kept), high)
    } else {
        (low, high.min(home + kept))
    };
    Some((to_i32(limits.0), to_i32(limits.1)))
}

/// Whether the machine keeps its position while the drives are off, as they are for a new
/// configuration. A step motor without encoder moves unseen then.
fn keeps_position(machine: &MachineFile) -> bool {
    let mut joints = machine.config.joints.iter();
    joints.all(|joint| joint.encoder.is_some() || joint.keeps_position)
}

/// The searches in a session. The drives must be on.
pub struct IndexTest<'a, L> {
    session: &'a mut Session<L>,
    machine: &'a MachineFile,
    joints: &'a [IndexJoint],
    home: AxisValues,
    every: u16,
}

impl<'a, L: session::Line> IndexTest<'a, L> {
    /// A test of joints of a machine. `line_rate` is that of the line, bytes per second.
    ///
    /// # Errors
    /// The machine has no home pose.
    pub fn new(
        session: &'a mut Session<L>,
        machine: &'a MachineFile,
        joints: &'a [IndexJoint],
        line_rate: Option<u32>,
    ) -> Result<Self, Error> {
        let home = find_home_pose(machine, session.model())?;
        // Half of the line for telemetry.
        let interval = line_rate.map_or(0.0, |rate| 2.0 * FRAME_BYTES / f64::from(rate.max(1)));
        let period = f64::from(machine.config.period_us) * 1e-6;
        let every = (interval.max(INTERVAL) / period).round().clamp(1.0, 1000.0) as u16;
        session.keep_telemetry(every);
        Ok(Self {
            session,
            machine,
            joints,
            home,
            every,
        })
    }

    /// The machine file for the searches. The direction of those of the measured joints is the
    /// other one if `is_turned`, where there is room for it.
    fn configuration(&self, is_turned: bool) -> MachineFile {
        let mut test = self.machine.clone();
        for it in self.joints {
            if let Some(encoder) = &mut test.config.joints[it.joint].encoder {
                encoder.index_slack = 0;
            }
            let axis = &mut test.config.pose[it.coordinate];
            let before = &self.machine.config.pose[it.coordinate];
            if !is_turned || before.wraps() {
                continue;
            }
            let reach = it.reach * per_unit(self.machine.pose[it.coordinate].kind);
            let home = self.home[it.coordinate];
            if let Some((low, high)) = turned(before.low.0, before.high.0, home, reach) {
                (axis.low, axis.high) = (Coordinate(low), Coordinate(high));
            }
        }
        test
    }

    /// Searches in both directions. The controller has another configuration meanwhile, and its own
    /// one afterwards, also after an error; the drives are then off.
    ///
    /// # Errors
    /// A search fails, or the telemetry is too slow to show its shift.
    pub fn measure(&mut self, progress: &mut dyn FnMut(&str)) -> Result<Vec<IndexPulses>, Error> {
        let from_presets = !self.session.status()?.homed;
        let found = self.search_both_ways(from_presets, progress);
        // A fault has switched the drives off, and then this is refused.
        let disabled = self.session.ask(Command::Disable);
        let restored = self.session.configure(self.machine);
        let found = found?;
        disabled?;
        restored.map_err(|error| {
            let what = format!(
                "{error}; the controller still has the soft limits of the test: any command with \
                 --machine and --replace-machine gives it those of the machine file"
            );
            Error::new(error.kind, what)
        })?;
        Ok(found)
    }

    fn search_both_ways(
        &mut self,
        from_presets: bool,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Vec<IndexPulses>, Error> {
        let mut found: Vec<IndexPulses> = self
            .joints
            .iter()
            .filter_map(|it| self.empty(it.joint, from_presets))
            .collect();
        // Before the first search the pulse of the machine file is the reference.
        let mut places: Vec<f64> = found.iter().map(|it| it.before).collect();
        for is_turned in [false, true] {
            if keeps_position(self.machine) {
                let configuration = self.configuration(is_turned);
                self.session.ask(Command::Disable)?;
                self.session.configure(&configuration)?;
                self.session.enable()?;
            } else if is_turned {
                break;
            }
            let way = if is_turned { "the other" } else { "one" };
            progress(&format!(
                "index pulses: {TIMES} searches in {way} direction"
            ));
            for _ in 0..TIMES {
                let shifts = self.pass(&found)?;
                for ((pulses, place), (shift, upwards)) in
                    found.iter_mut().zip(&mut places).zip(shifts)
                {
                    *place -= shift;
                    let at = *place;
                    pulses.passes.push(Pass { at, upwards });
                }
            }
        }
        Ok(found)
    }

    fn empty(&self, joint: usize, from_presets: bool) -> Option<IndexPulses> {
        let (axis, config) = (
            &self.machine.joints[joint],
            &self.machine.config.joints[joint],
        );
        let encoder = config.encoder.as_ref()?;
        let units = per_unit(axis.kind);
        Some(IndexPulses {
            joint,
            name: axis.name.clone(),
            kind: axis.kind,
            count: count_of(self.machine, joint),
            pitch: f64::from(encoder.index_pitch.0) / units,
            preset: f64::from(config.preset.0) / units,
            before: f64::from(encoder.index.0) / units,
            slack_before: encoder.index_slack,
            from_presets,
            one_way: if keeps_position(self.machine) {
                "its coordinate has no limits, or no room for a search in the other one"
            } else {
                "a new configuration needs the drives off, and a step motor without encoder would \
                 lose its position"
            },
            passes: Vec::new(),
        })
    }

    /// One search, and the motion back to the home pose: the shift of each joint, and whether it
    /// moved upwards.
    fn pass(&mut self, joints: &[IndexPulses]) -> Result<Vec<(f64, bool)>, Error> {
        self.session.take_telemetry();
        self.session.ask(Command::Telemetry { every: self.every })?;
        let searched = self.session.home();
        searched.map_err(|error| {
            // A stop by the user, or a refusal, has its own remedy.
            if error.kind != ErrorKind::Fault {
                return error;
            }
            let what = format!(
                "{}; if no pulse came, check the wire of the index (Z) of this joint, and that the \
                 joint is free to move over 1.2 turns of its motor; if it is too far from its \
                 place, place the joint at its preset before power-on, or raise `search_mm` or \
                 `search_deg`",
                error.message
            );
            Error::new(error.kind, what)
        })?;
        let after = self.session.status()?;
        let frames = self.session.take_telemetry();
        let mut searching = frames.iter().filter(|it| it.state == State::Homing);
        let first = searching.next();
        let last: Vec<&Telemetry> = searching.rev().take(2).collect();
        let (Some(first), [last, previous]) = (first, &last[..]) else {
            return Err(slow("there is no telemetry of a search"));
        };
        let first = self.commanded(first)?;
        let previous = self.commanded(previous)?;
        let last = self.commanded(last)?;
        let after = self.commanded(&after)?;
        let shifts = joints.iter().map(|it| {
            let turn = |distance: f64| {
                if it.kind.is_rotary() {
                    distance - (distance / 360.0).round() * 360.0
                } else {
                    distance
                }
            };
            // The end of a stop is the third power of the time that is left: after the last frame
            // comes less than a seventh of what was between it and the frame before.
            let left = turn(last[it.joint] - previous[it.joint]).abs() / 7.0;
            if left > 0.25 * it.count {
                let what = format!("joint {} was still moving in the last frame", it.name);
                return Err(slow(&what));
            }
            let shift = turn(after[it.joint] - last[it.joint]);
            Ok((shift, turn(last[it.joint] - first[it.joint]) > 0.0))
        });
        let shifts = shifts.collect::<Result<Vec<_>, Error>>()?;
        self.session.move_to_home(self.machine, &self.home)?;
        Ok(shifts)
    }

    /// Commanded position of each joint, mm or degrees.
    fn commanded(&self, frame: &Telemetry) -> Result<Vec<f64>, Error> {
        let mut pose = Pose::default();
        for (slot, value) in pose.0.iter_mut().zip(&frame.commanded) {
            *slot = Coordinate(*value);
        }
        let kinematics = self.machine.config.kinematics();
        let joints = kinematics.inverse(&pose).map_err(|_| {
            let what = "the controller reports a commanded pose that the joints cannot reach";
            Error::new(ErrorKind::Internal, what)
        })?;
        let joints = joints.0.iter().zip(&self.machine.joints);
        Ok(joints
            .map(|(value, axis)| f64::from(value.0) / per_unit(axis.kind))
            .collect())
    }
}

fn slow(what: &str) -> Error {
    let what = format!(
        "{what}: the telemetry is too slow to show the shift at the end of a search; use a faster \
         line, 1000000 baud or more"
    );
    Error::new(ErrorKind::Port, what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrower_limits_turn_the_direction() {
        let is_downwards = |low: i32, high: i32, home: i32| home > high - (high - low) / 4;
        for (low, high, home) in [
            (-200, 200, 0),
            (-200, 200, 150),
            (0, 1000, 760),
            (-60, 140, 20),
        ] {
            let (new_low, new_high) = turned(low, high, home, 20.0).unwrap_or_default();
            assert!(new_low >= low && new_high <= high);
            assert!((new_low..new_high).contains(&home));
            let before = is_downwards(low, high, home);
            assert_ne!(
                before,
                is_downwards(new_low, new_high, home),
                "{low} {high}"
            );
        }
        assert_eq!(turned(-10, 200, 0, 20.0), None);
    }
}
