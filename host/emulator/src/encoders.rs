//! Wires of the encoders: edges that come at their times.

use crate::chip::CLOCK_HZ;
use haptimill_hil_sim::plant::Plant;
use std::collections::VecDeque;

/// Joints with an encoder, and channel A of the first one, as in
/// `firmware/boards/pico2/src/encoders.rs`.
pub const ENCODERS: usize = 4;
const FIRST: u32 = 15;

/// All pins of the encoders.
pub const PINS: u32 = 0xFF << FIRST;

/// Levels of an encoder from a cycle on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Cycle of the chip.
    pub cycle: u64,
    /// Joint.
    pub joint: usize,
    /// Channel A.
    pub a: bool,
    /// Channel B.
    pub b: bool,
}

/// The wires.
#[derive(Debug, Clone, Default)]
pub struct Encoders {
    levels: u32,
    /// Edges that are still to come, in the order of their cycles.
    edges: VecDeque<Edge>,
}

impl Encoders {
    /// Wires of the encoders of a machine, which records their edges from now on.
    pub fn of(plant: &mut Plant) -> Self {
        let mut encoders = Self::default();
        for joint in 0..ENCODERS {
            if let Some((a, b)) = plant.record_encoder_edges(joint) {
                encoders.set(joint, a, b);
            }
        }
        encoders
    }

    fn set(&mut self, joint: usize, a: bool, b: bool) {
        let pin = FIRST + 2 * joint as u32;
        self.levels &= !(3 << pin);
        self.levels |= (u32::from(a) | u32::from(b) << 1) << pin;
    }

    /// Adds edges.
    pub fn add(&mut self, edges: impl IntoIterator<Item = Edge>) {
        self.edges.extend(edges);
        self.edges.make_contiguous().sort_by_key(|edge| edge.cycle);
    }

    /// Adds the edges of the last control period of a machine, which began at `start_ns` of its
    /// time, from this cycle on.
    pub fn follow(&mut self, plant: &mut Plant, start_ns: u64, cycle: u64) {
        let mut edges = Vec::new();
        for joint in 0..ENCODERS {
            for edge in plant.take_encoder_edges(joint) {
                let after = edge.time_ns.saturating_sub(start_ns);
                edges.push(Edge {
                    cycle: cycle + after * (CLOCK_HZ / 1_000_000) / 1000,
                    joint,
                    a: edge.a,
                    b: edge.b,
                });
            }
        }
        self.add(edges);
    }

    /// Levels of the pins at a cycle.
    pub fn levels(&mut self, cycle: u64) -> u32 {
        while let Some(edge) = self.edges.front().copied()
            && edge.cycle <= cycle
        {
            self.set(edge.joint, edge.a, edge.b);
            self.edges.pop_front();
        }
        self.levels
    }
}
