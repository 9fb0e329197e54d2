//! From planned blocks to the pieces of the trajectory.

use super::{Keep, Planner};
use crate::block::Block;
use crate::corner::Corner;
use crate::limits::MachineModel;
use crate::lookahead::Run;
use crate::profile::Phase;
use crate::trajectory::{Bump, Knot, Leg, Piece, longest_on};
use haptimill_gcode::{Coordinates, Problem};

/// Largest change of rate without rounding: the resolution of the setpoints (2^-12 mm/s, 2^-24
/// turn/s).
const NO_CORNER: f64 = 2e-5;

/// Largest change of acceleration without a bump, mm/s^2 or deg/s^2.
const NO_BEND: f64 = 1e-3;

/// Longest plan, seconds: a hundred hours.
const LONGEST_PLAN_S: f64 = 360_000.0;

impl<M: MachineModel> Planner<M> {
    /// Lays the first blocks of the look-ahead.
    ///
    /// # Errors
    ///
    /// The program takes too long.
    pub(super) fn lay_blocks(&mut self, count: usize) -> Result<(), Problem> {
        if !self.run.moves {
            let first = &self.run.blocks[0];
            let slows = self.ended_rapid && !first.is_rapid || first.is_fixed;
            let from = first.tool.machine_pose(&first.path.from);
            self.time = self
                .emitter
                .begin(&self.trajectory, slows, &from, &self.settings);
            self.run.moves = true;
        }
        let blocks = std::mem::take(&mut self.run.blocks);
        for (index, block) in blocks[..count].iter().enumerate() {
            self.lay(block, index);
            if self.time > LONGEST_PLAN_S {
                self.refused = true;
                self.run = Run::default();
                return Err(Problem {
                    place: block.place,
                    what: "at its feeds the program takes more than 100 hours up to here".into(),
                    remedy: "write higher feeds, or divide the program".into(),
                });
            }
        }
        self.run.blocks = blocks;
        self.run.discard(count);
        Ok(())
    }

    /// Adds the pieces of a block and the rounding at its end; a check only counts them.
    fn lay(&mut self, block: &Block, index: usize) {
        let speeds = [self.run.speeds[index], self.run.speeds[index + 1]];
        let corners = [&self.run.corners[index], &self.run.corners[index + 1]];
        let [into, out] = speeds;
        let reach = [corners[0].reach(into), corners[1].reach(out)];
        self.figures.path_length_mm += block.path.tip_length();
        self.figures.blocks += usize::from(!block.continues);
        let mut phases = std::mem::take(&mut self.phases);
        phases.clear();
        let steady = |length: f64, speed: f64| Phase {
            duration: length / speed,
            acceleration: 0.0,
            jerk: 0.0,
        };
        if reach[0] > 0.0 {
            phases.push(steady(reach[0], into));
        }
        let peak = block.along.phases(
            block.path.length - reach[0] - reach[1],
            into,
            out,
            &mut phases,
        );
        if reach[1] > 0.0 {
            phases.push(steady(reach[1], out));
        }
        if block.path.tip_length() > 0.0 {
            self.figures.peak_tip_mm_s = self.figures.peak_tip_mm_s.max(peak);
        }
        if self.keep == Keep::Nothing {
            for phase in &phases {
                self.time += phase.duration;
            }
        } else {
            self.lay_phases(block, index, &phases);
        }
        if block.is_rapid {
            for phase in &phases {
                self.figures.rapid_s += phase.duration;
            }
        }
        self.run.follows_rapid = block.is_rapid;
        self.phases = phases;
    }

    /// Adds a piece for each phase of a block, and the rounding at its end.
    fn lay_phases(&mut self, block: &Block, index: usize, phases: &[Phase]) {
        let [into, out] = [self.run.speeds[index], self.run.speeds[index + 1]];
        let corners = [&self.run.corners[index], &self.run.corners[index + 1]];
        self.trajectory.paths.push(Leg {
            place: block.place,
            places: block.places.clone(),
            messages: block.messages,
            path: block.path.clone(),
            tool: block.tool,
            is_rapid: block.is_rapid,
            is_fixed: block.is_fixed,
        });
        let path = self.trajectory.last_path();
        let is_rounded = |corner: &Corner, speed: f64| {
            let above = |parts: &Coordinates, factor: f64, min: f64| {
                parts.iter().any(|part| part.abs() * factor > min)
            };
            above(&corner.change, speed, NO_CORNER) || above(&corner.bend, speed * speed, NO_BEND)
        };
        let rounded = [is_rounded(corners[0], into), is_rounded(corners[1], out)];
        let is_arc = block.path.arc.is_some();
        let bends = is_arc || self.run.follows_arc;
        self.run.follows_arc = is_arc;
        let (mut s, mut speed) = (0.0, into);
        let last = phases.len() - 1;
        for (number, phase) in phases.iter().enumerate() {
            let Phase {
                duration,
                acceleration,
                jerk,
            } = *phase;
            let steady_before = self
                .trajectory
                .pieces
                .last()
                .is_some_and(|piece| piece.jerk == 0.0);
            // A rounding begins in the last phase of its block, has its middle between the blocks,
            // and ends in the first phase of the next block.
            let rounding = (rounded[0] && number <= 1) || (rounded[1] && number == last);
            let knot = if number == 0 && bends {
                Knot::Step
            } else if rounding || !steady_before || jerk != 0.0 {
                Knot::Jerk
            } else {
                Knot::None
            };
            let mut piece = Piece {
                time: self.time,
                s,
                speed,
                acceleration,
                jerk,
                longest: f64::INFINITY,
                path,
                knot,
                max: 100,
            };
            if !block.is_rapid && acceleration == 0.0 && jerk == 0.0 && speed > 0.0 {
                let mut max = block.max / speed;
                if rounded[0] && number == 0 {
                    max = max.min(corners[0].max_factor(into));
                }
                if rounded[1] && number == last {
                    max = max.min(corners[1].max_factor(out));
                }
                // Below, for the rounding of setpoints.
                piece.max = (max.min(2.0) * 100.0 + 1e-3).max(100.0) as u8;
            }
            self.time += duration;
            piece.longest = longest_on(&piece, self.time - piece.time, block);
            self.trajectory.pieces.push(piece);
            s += duration * (speed + duration * (0.5 * acceleration + duration * jerk / 6.0));
            speed += duration * (acceleration + 0.5 * duration * jerk);
        }
        if rounded[1] {
            let change = corners[1].change.map(|part| part * out);
            let bend = corners[1].bend.map(|part| part * out * out);
            self.trajectory.bumps.push(Bump {
                time: self.time,
                half: corners[1].reach(out) / out,
                change,
                bend,
            });
        }
    }
}
