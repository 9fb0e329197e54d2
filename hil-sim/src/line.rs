//! Serial line model: one direction of the line between host and machine, with rate, delay, errors,
//! losses and cuts.
//!
//! Bytes enter with the virtual time at which they are written and leave when their last bit has
//! arrived. A UART byte takes ten bit times (start, eight data, stop). All random numbers are
//! seeded and drawn byte by byte in order, so a run is repeatable.

use crate::random::Random;
use std::collections::VecDeque;

/// Injected faults of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineCondition {
    /// Probability that a bit is flipped.
    pub bit_error_rate: f64,
    /// Probability that a byte is lost.
    pub drop_rate: f64,
    /// Probability that a byte is duplicated.
    pub duplicate_rate: f64,
    /// Additional delay of every byte, ns.
    pub delay_ns: u64,
    /// The line is cut: no byte arrives.
    pub cut: bool,
}

impl LineCondition {
    /// A line without faults.
    pub const HEALTHY: Self = Self {
        bit_error_rate: 0.0,
        drop_rate: 0.0,
        duplicate_rate: 0.0,
        delay_ns: 0,
        cut: false,
    };
}

impl Default for LineCondition {
    fn default() -> Self {
        Self::HEALTHY
    }
}

/// Counters of a line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LineCounters {
    /// Bytes that were written.
    pub written: u64,
    /// Bytes that were read, including damaged ones.
    pub delivered: u64,
    /// Bits that were flipped.
    pub flipped: u64,
    /// Bytes that were lost.
    pub dropped: u64,
    /// Bytes that were duplicated.
    pub duplicated: u64,
}

/// One direction of a serial line.
#[derive(Debug, Clone)]
pub struct SerialLine {
    /// Time of a byte on the line, ns times 2^16; 0 is an unlimited line.
    byte_time: u64,
    /// Time at which the line becomes free, ns times 2^16.
    free_at: u64,
    queue: VecDeque<(u64, u8)>,
    condition: LineCondition,
    random: Random,
    count: LineCounters,
}

impl SerialLine {
    /// Creates a line of this rate in baud; `None` is unlimited.
    pub fn new(baud: Option<u32>, random: Random) -> Self {
        Self {
            byte_time: baud.map_or(0, |baud| {
                (10_000_000_000_u64 << 16) / u64::from(baud.max(1))
            }),
            free_at: 0,
            queue: VecDeque::new(),
            condition: LineCondition::HEALTHY,
            random,
            count: LineCounters::default(),
        }
    }

    /// Sets the injected faults for all bytes that are written from now on.
    pub const fn set_condition(&mut self, condition: LineCondition) {
        self.condition = condition;
    }

    /// Counters so far.
    pub const fn count(&self) -> LineCounters {
        self.count
    }

    /// Bytes that were written and not yet read.
    pub fn in_flight(&self) -> usize {
        self.queue.len()
    }

    /// Bytes that were written and have not left the sender by `time_ns`.
    pub fn unsent(&self, time_ns: u64) -> usize {
        let waiting = self.free_at.saturating_sub(time_ns << 16);
        waiting.div_ceil(self.byte_time.max(1)) as usize
    }

    /// Writes bytes at `time_ns`; they leave when the line is free.
    pub fn write(&mut self, bytes: &[u8], time_ns: u64) {
        for &byte in bytes {
            self.count.written += 1;
            self.free_at = self.free_at.max(time_ns << 16) + self.byte_time;
            if self.condition.cut || self.draw(self.condition.drop_rate) {
                self.count.dropped += 1;
                continue;
            }
            let byte = self.damage(byte);
            // Bytes keep their order when the delay becomes shorter.
            let arrival = (self.free_at >> 16) + self.condition.delay_ns;
            let arrival = arrival.max(self.queue.back().map_or(0, |last| last.0));
            self.queue.push_back((arrival, byte));
            if self.draw(self.condition.duplicate_rate) {
                self.count.duplicated += 1;
                self.queue.push_back((arrival, byte));
            }
        }
    }

    /// Reads the next byte that has arrived by `time_ns`.
    pub fn read(&mut self, time_ns: u64) -> Option<u8> {
        let (arrival, byte) = *self.queue.front()?;
        if arrival > time_ns {
            return None;
        }
        self.queue.pop_front();
        self.count.delivered += 1;
        Some(byte)
    }

    const fn draw(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.random.happens(probability)
    }

    fn damage(&mut self, byte: u8) -> u8 {
        let mut damaged = byte;
        if self.condition.bit_error_rate > 0.0 {
            for bit in 0..8 {
                if self.random.happens(self.condition.bit_error_rate) {
                    self.count.flipped += 1;
                    damaged ^= 1 << bit;
                }
            }
        }
        damaged
    }
}
