//! Speeds at the junctions of a run of blocks: as fast as the corners allow and the blocks between them have room for.

use super::block::Block;
use super::corner::Corner;
use super::limits::Settings;

/// Junctions of blocks that follow each other without a wait: their corners and speeds, one more than there are blocks.
pub(crate) struct Junctions {
    pub corners: Vec<Corner>,
    pub speeds: Vec<f64>,
}

impl Junctions {
    /// Finds the corners and the speeds; the run begins and ends at rest.
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
        // Backward: no faster into a block than it can slow down in. Forward: no faster out than it can speed up in. Lowering a speed in the
        // forward pass leaves what the backward pass made sure of: a smaller change of speed takes less room.
        for (index, block) in blocks.iter().enumerate().rev() {
            junctions.lower(block, index, index + 1);
        }
        for (index, block) in blocks.iter().enumerate() {
            junctions.lower(block, index + 1, index);
        }
        junctions
    }

    /// Lowers the speed at junction `fast` to what the block can reach from the speed at its other end, `fixed`.
    fn lower(&mut self, block: &Block, fast: usize, fixed: usize) {
        let slow = self.speeds[fixed];
        let wanted = self.speeds[fast];
        let room = block.path.length - self.corners[fixed].reach(slow);
        let corner = &self.corners[fast];
        let fits = |speed: f64| block.along.ramp_length(slow, speed) + corner.reach(speed) <= room;
        if wanted <= slow || fits(wanted) {
            return;
        }
        let (mut low, mut high) = (slow, wanted);
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
