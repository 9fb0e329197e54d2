//! Look-ahead: the largest speeds at the junctions of a run of blocks that corners and block
//! lengths allow.

use super::block::Block;
use super::corner::Corner;
use super::limits::Settings;

/// Junctions of blocks without a standstill between them: corners and speeds, one more than blocks.
pub(crate) struct Junctions {
    pub corners: Vec<Corner>,
    pub speeds: Vec<f64>,
}

impl Junctions {
    /// Finds corners and speeds; the run begins and ends at standstill.
    pub(crate) fn of(blocks: &[Block], settings: &Settings) -> Junctions {
        let mut corners = Vec::with_capacity(blocks.len() + 1);
        corners.push(Corner::stop());
        corners.extend(
            blocks
                .windows(2)
                .map(|pair| Corner::between(&pair[0], &pair[1], settings)),
        );
        corners.push(Corner::stop());
        let speeds = corners.iter().map(|corner| corner.speed).collect();
        let mut junctions = Junctions { corners, speeds };
        // Backward pass: the entry speed of a block allows its deceleration. Forward pass: the exit
        // speed allows its acceleration. Lowering a speed in the forward pass keeps the result of
        // the backward pass: a smaller change of speed needs less length.
        for (index, block) in blocks.iter().enumerate().rev() {
            junctions.lower(block, index, index + 1);
        }
        for (index, block) in blocks.iter().enumerate() {
            junctions.lower(block, index + 1, index);
        }
        junctions
    }

    /// Lowers the speed at junction `fast` to the largest one that the block can reach from the
    /// speed at its other end, `fixed`.
    fn lower(&mut self, block: &Block, fast: usize, fixed: usize) {
        let slow = self.speeds[fixed];
        let speed = self.speeds[fast];
        let room = block.path.length - self.corners[fixed].reach(slow);
        let corner = &self.corners[fast];
        let fits = |speed: f64| block.along.ramp_length(slow, speed) + corner.reach(speed) <= room;
        if speed <= slow || fits(speed) {
            return;
        }
        let (mut low, mut high) = (slow, speed);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if fits(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.speeds[fast] = low;
    }
}
