//! Look-ahead: the maximum speeds at the junctions of a run of blocks that corners and block
//! lengths allow.

use super::block::Block;
use super::corner::Corner;
use super::limits::Settings;
use super::profile::largest_within;

/// Blocks without a standstill between them, of which the first may be planned already.
#[derive(Debug)]
pub(crate) struct Run {
    /// Blocks that are not planned.
    pub blocks: Vec<Block>,
    /// Moves of the program that are joined to them.
    pub joined: usize,
    /// Corners before each of them, and a stop after the last one when they are planned.
    pub corners: Vec<Corner>,
    /// Speeds at the corners; the first one is final.
    pub speeds: Vec<f64>,
    /// Whether a part of the run is planned.
    pub moves: bool,
    /// Whether the last planned block is an arc.
    pub follows_arc: bool,
    /// Whether the last planned block is a rapid move.
    pub follows_rapid: bool,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            blocks: Vec::new(),
            joined: 0,
            corners: vec![Corner::stop()],
            speeds: vec![0.0],
            moves: false,
            follows_arc: false,
            follows_rapid: false,
        }
    }
}

impl Run {
    /// Adds a block.
    pub(crate) fn push(&mut self, block: Block, settings: &Settings) {
        if let Some(before) = self.blocks.last() {
            self.corners.push(Corner::between(before, &block, settings));
        }
        self.joined += block.places.len();
        self.blocks.push(block);
    }

    /// Finds the speeds at all corners, so that the motion can stop after the last block.
    pub(crate) fn plan(&mut self) {
        let entry = self.speeds[0];
        self.corners.truncate(self.blocks.len().max(1));
        self.corners.push(Corner::stop());
        self.speeds.clear();
        self.speeds
            .extend(self.corners.iter().map(|corner| corner.speed));
        // Backward pass: the entry speed of a block allows its deceleration. Forward pass: the exit
        // speed allows its acceleration. Lowering a speed in the forward pass keeps the result of
        // the backward pass: a smaller change of speed needs less length.
        for index in (0..self.blocks.len()).rev() {
            self.lower(index, index, index + 1);
        }
        // The run could stop in the look-ahead in which this speed was planned.
        self.speeds[0] = entry;
        for index in 0..self.blocks.len() {
            self.lower(index, index + 1, index);
        }
    }

    /// Removes the first blocks, which are planned.
    pub(crate) fn discard(&mut self, count: usize) {
        let places = |block: Block| block.places.len();
        self.joined -= self.blocks.drain(..count).map(places).sum::<usize>();
        self.corners.drain(..count);
        // The stop after the last block.
        self.corners.truncate(self.blocks.len().max(1));
        self.speeds.drain(..count);
    }

    /// Lowers the speed at junction `fast` to the largest one that the block can reach from the
    /// speed at its other end, `fixed`.
    fn lower(&mut self, block: usize, fast: usize, fixed: usize) {
        let block = &self.blocks[block];
        let slow = self.speeds[fixed];
        let speed = self.speeds[fast];
        let room = block.path.length - self.corners[fixed].reach(slow);
        let corner = &self.corners[fast];
        let excess = |speed: f64| block.along.ramp_length(slow, speed) + corner.reach(speed) - room;
        if speed <= slow || excess(speed) <= 0.0 {
            return;
        }
        self.speeds[fast] = largest_within(slow, speed, 50, excess);
    }
}
