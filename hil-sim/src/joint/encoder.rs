//! Incremental encoder on a motor shaft, from its disc to the counter that the controller reads.
//!
//! The disc is ideal: it divides the shaft's coordinate into count states of equal width. A count
//! state has the levels of two channels (A leads B upwards) and of the index line, which is high in
//! one state per turn. A healthy encoder is counted directly from the count states. From the first
//! fault on, every edge passes as a pair of levels through the fault model and then through the x4
//! decoder of the boards, which counts illegal transitions. A test checks that both methods give
//! the same numbers for a healthy encoder.
//!
//! Units: coordinates in axis units, times in ns of virtual time. The model assumes a constant rate
//! of the shaft between two integration steps, so it times an edge to a fraction of a step.

use crate::joint::mechanics::JointArray;
use crate::joint::{EncoderConfig, JointConfig};
use crate::random::Random;
use haptimill_firmware::io::JointInputs;
use haptimill_firmware::joint::quadrature::Quadrature;

/// Reading of the counter hardware.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EncoderReading {
    /// x4 counter, wraps around.
    pub counts: i32,
    /// Time of the last counted edge, ns, wraps around.
    pub edge_time_ns: u32,
    /// Illegal transitions, wraps around.
    pub illegal: u16,
    /// Counter at the last index pulse.
    pub index_counts: i32,
    /// Index pulses, wraps around.
    pub index_pulses: u8,
}

/// Motion of one shaft in a control period: its coordinate at evenly spaced samples. The first
/// sample is the end of the motion before.
#[derive(Debug, Clone, Copy)]
pub struct Track<'a> {
    rows: &'a [JointArray],
    lane: usize,
    low: f64,
    high: f64,
}

impl<'a> Track<'a> {
    /// Track of joint `lane` from the samples of all shafts; `low` and `high` are its smallest and
    /// largest coordinate.
    pub const fn new(rows: &'a [JointArray], lane: usize, low: f64, high: f64) -> Self {
        Self {
            rows,
            lane,
            low,
            high,
        }
    }

    #[inline(always)]
    fn at(&self, sample: usize) -> f64 {
        self.rows[sample][self.lane]
    }
}

/// Levels of the three lines.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Levels {
    /// Channel A.
    pub a: bool,
    /// Channel B.
    pub b: bool,
    /// Index.
    pub index: bool,
}

impl Levels {
    const fn of(count: i64, counts_per_turn: i64) -> Self {
        let quarter = count & 3;
        Self {
            a: quarter == 1 || quarter == 2,
            b: quarter >= 2,
            index: count.rem_euclid(counts_per_turn) == 0,
        }
    }
}

/// Levels of both channels from a time on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Time of the edge, ns.
    pub time_ns: u64,
    /// Channel A.
    pub a: bool,
    /// Channel B.
    pub b: bool,
}

/// Counter of an encoder that is simulated edge by edge: the decoder of a board without an encoder
/// timer.
#[derive(Debug, Clone)]
struct EdgeCounter {
    decoder: Quadrature,
    levels: Levels,
    /// Reading of the counter when the decoder started.
    before: EncoderReading,
    edge_time_ns: u32,
    /// Edges of the channels, if they are recorded.
    recorded: Option<Vec<Edge>>,
}

impl EdgeCounter {
    fn new(levels: Levels, before: EncoderReading) -> Self {
        let mut decoder = Quadrature::new(before.counts);
        // The first call sets the initial levels of the decoder.
        decoder.feed(levels.a, levels.b, levels.index, before.edge_time_ns);
        Self {
            decoder,
            levels,
            before,
            edge_time_ns: before.edge_time_ns,
            recorded: None,
        }
    }

    fn sample(&mut self, levels: Levels, time_ns: u64) {
        let counts = self.decoder.counts();
        self.decoder
            .feed(levels.a, levels.b, levels.index, time_ns as u32);
        if self.decoder.counts() != counts {
            self.edge_time_ns = time_ns as u32;
        }
        let Levels { a, b, .. } = levels;
        if (a, b) != (self.levels.a, self.levels.b)
            && let Some(recorded) = &mut self.recorded
        {
            recorded.push(Edge { time_ns, a, b });
        }
        self.levels = levels;
    }

    fn reading(&self) -> EncoderReading {
        let mut seen = JointInputs::default();
        self.decoder.latch(&mut seen);
        EncoderReading {
            counts: seen.counts,
            edge_time_ns: self.edge_time_ns,
            illegal: self.before.illegal.wrapping_add(seen.illegal),
            index_counts: if seen.index_pulses == 0 {
                self.before.index_counts
            } else {
                seen.index_counts
            },
            index_pulses: self.before.index_pulses.wrapping_add(seen.index_pulses),
        }
    }
}

/// Injected faults of an encoder.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EncoderCondition {
    /// Channel A is stuck at this level.
    pub stuck_a: Option<bool>,
    /// Channel B is stuck at this level.
    pub stuck_b: Option<bool>,
    /// The channels are swapped.
    pub swapped: bool,
    /// The index line is dead.
    pub index_missing: bool,
    /// Rate of noise pulses, 1/s; each flips A, B or both briefly.
    pub noise_hz: f64,
}

/// An encoder with its counter.
#[derive(Debug, Clone)]
pub struct Encoder {
    /// Counts per axis unit.
    scale: f64,
    /// Coordinate of the lower edge of count state 0, which is an index state.
    origin: f64,
    counts_per_turn: i64,
    /// Index state at or below the present count state.
    turn_start: i64,
    reversed: bool,
    /// True count state of the shaft.
    state: i64,
    /// Count state in which the counter was 0.
    zero: i64,
    reading: EncoderReading,
    condition: EncoderCondition,
    /// Edge-by-edge simulation, from the first fault on.
    edges: Option<EdgeCounter>,
    random: Random,
}

/// Count states per turn of an encoder whose index is not used.
const NO_TURN: i64 = 1 << 60;

/// Rounds down; valid for every coordinate that a joint can have.
#[inline(always)]
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole - i64::from((whole as f64) > value)
}

impl Encoder {
    /// Creates the encoder of a joint whose motor is at `motor`; the counter starts at 0.
    pub fn new(joint: &JointConfig, encoder: &EncoderConfig, motor: f64, random: Random) -> Self {
        let scale = 1.0 / joint.per_count(encoder);
        let origin = encoder.index;
        let state = floor((motor - origin) * scale);
        let counts_per_turn = i64::from(encoder.counts_per_turn);
        Self {
            scale,
            origin,
            counts_per_turn,
            turn_start: state.div_euclid(counts_per_turn) * counts_per_turn,
            reversed: encoder.reversed,
            state,
            zero: state,
            reading: EncoderReading::default(),
            condition: EncoderCondition::default(),
            edges: None,
            random,
        }
    }

    /// Creates an encoder of `scale` counts per axis unit without an index line, on a shaft at
    /// `start`; the counter starts at 0.
    pub fn without_index(scale: f64, reversed: bool, start: f64, random: Random) -> Self {
        let state = floor(start * scale);
        Self {
            scale,
            origin: 0.0,
            // Longer than any travel of a shaft, so no index pulse occurs within it.
            counts_per_turn: NO_TURN,
            turn_start: -NO_TURN / 2,
            reversed,
            state,
            zero: state,
            reading: EncoderReading::default(),
            condition: EncoderCondition::default(),
            edges: None,
            random,
        }
    }

    /// Present reading of the counter.
    #[inline]
    pub fn reading(&self) -> EncoderReading {
        self.edges
            .as_ref()
            .map_or(self.reading, EdgeCounter::reading)
    }

    /// Sets the injected faults of the encoder.
    pub fn set_condition(&mut self, condition: EncoderCondition) {
        if condition == self.condition {
            return;
        }
        self.condition = condition;
        let healthy = self.healthy_levels(self.state);
        self.edges
            .get_or_insert_with(|| EdgeCounter::new(healthy, self.reading));
    }

    /// Records the edges of both channels from now on, as a board sees them at its pins. Returns
    /// the present levels of A and B.
    pub fn record_edges(&mut self) -> (bool, bool) {
        let healthy = self.healthy_levels(self.state);
        let edges = self
            .edges
            .get_or_insert_with(|| EdgeCounter::new(healthy, self.reading));
        edges.recorded = Some(Vec::new());
        (edges.levels.a, edges.levels.b)
    }

    /// Takes the edges since the last call, oldest first; none without
    /// [`Encoder::record_edges`].
    pub fn take_edges(&mut self) -> Vec<Edge> {
        let recorded = self.edges.as_mut().and_then(|it| it.recorded.as_mut());
        recorded.map(std::mem::take).unwrap_or_default()
    }

    /// Adds a slip of `counts` to the counter.
    pub fn slip(&mut self, counts: i32) {
        self.reading.counts = self.reading.counts.wrapping_add(counts);
        self.zero -= i64::from(if self.reversed { -counts } else { counts });
        if let Some(edges) = &mut self.edges {
            let reading = edges.reading();
            let recorded = edges.recorded.take();
            *edges = EdgeCounter::new(
                edges.levels,
                EncoderReading {
                    counts: reading.counts.wrapping_add(counts),
                    ..reading
                },
            );
            edges.recorded = recorded;
        }
    }

    /// Follows the motion of the shaft from `time_ns` on, with samples `step_ns` apart.
    #[inline]
    pub fn follow(&mut self, track: &Track<'_>, time_ns: u64, step_ns: u64) {
        if self.edges.is_some() {
            self.follow_edges(track, time_ns, step_ns);
            return;
        }
        let (low, high) = (self.state_at(track.low), self.state_at(track.high));
        if low == high && low == self.state {
            return;
        }
        if low <= self.turn_start || high >= self.turn_start + self.counts_per_turn {
            self.follow_index(track);
        }
        self.follow_states(track, time_ns, step_ns);
    }

    #[inline(always)]
    fn place(&self, coordinate: f64) -> f64 {
        (coordinate - self.origin) * self.scale
    }

    #[inline(always)]
    fn state_at(&self, coordinate: f64) -> i64 {
        floor(self.place(coordinate))
    }

    #[inline]
    fn counts_of(&self, state: i64) -> i32 {
        let counts = (state - self.zero) as i32;
        if self.reversed {
            counts.wrapping_neg()
        } else {
            counts
        }
    }

    /// Direct method: the counter takes the final count state, and only its last edge is timed.
    #[inline]
    fn follow_states(&mut self, track: &Track<'_>, time_ns: u64, step_ns: u64) {
        let last = track.rows.len() - 1;
        let mut place = self.place(track.at(last));
        let end = floor(place);
        for sample in (0..last).rev() {
            let before = self.place(track.at(sample));
            let state = floor(before);
            if state != end {
                let edge = if end > state { end } else { end + 1 };
                let part = (edge as f64 - before) / (place - before);
                let offset = sample as u64 * step_ns + (part * step_ns as f64) as u64;
                self.reading.edge_time_ns = (time_ns + offset) as u32;
                break;
            }
            place = before;
        }
        self.state = end;
        self.reading.counts = self.counts_of(end);
    }

    /// Checks every sample of the motion for index states.
    #[cold]
    fn follow_index(&mut self, track: &Track<'_>) {
        let mut from = self.state;
        for sample in 1..track.rows.len() {
            let to = self.state_at(track.at(sample));
            if to != from {
                self.pass_index(from, to);
            }
            from = to;
        }
    }

    /// Latches the counter at every index state that the motion enters.
    fn pass_index(&mut self, from: i64, to: i64) {
        let turn = self.counts_per_turn;
        let (low, high) = if to > from {
            (from + 1, to)
        } else {
            (to, from - 1)
        };
        let (first, last) = (-(-low).div_euclid(turn), high.div_euclid(turn));
        if first <= last {
            let latched = if to > from { last } else { first };
            self.reading.index_counts = self.counts_of(latched * turn);
            self.reading.index_pulses = self
                .reading
                .index_pulses
                .wrapping_add((last - first + 1) as u8);
        }
        self.turn_start = to.div_euclid(turn) * turn;
    }

    fn healthy_levels(&self, state: i64) -> Levels {
        let levels = Levels::of(state, self.counts_per_turn);
        if self.reversed {
            Levels {
                a: levels.b,
                b: levels.a,
                ..levels
            }
        } else {
            levels
        }
    }

    fn levels(&self, state: i64) -> Levels {
        let mut levels = self.healthy_levels(state);
        if self.condition.swapped {
            levels = Levels {
                a: levels.b,
                b: levels.a,
                ..levels
            };
        }
        levels.a = self.condition.stuck_a.unwrap_or(levels.a);
        levels.b = self.condition.stuck_b.unwrap_or(levels.b);
        levels.index &= !self.condition.index_missing;
        levels
    }

    /// Edge-by-edge method: every edge passes as levels through the decoder.
    fn follow_edges(&mut self, track: &Track<'_>, time_ns: u64, step_ns: u64) {
        let Some(mut edges) = self.edges.take() else {
            return;
        };
        // A fault that began or ended may have changed the levels at standstill.
        edges.sample(self.levels(self.state), time_ns);
        let mut before = self.place(track.at(0));
        for sample in 1..track.rows.len() {
            let place = self.place(track.at(sample));
            let start_ns = time_ns + (sample as u64 - 1) * step_ns;
            if self.condition.noise_hz > 0.0
                && self
                    .random
                    .happens(self.condition.noise_hz * step_ns as f64 * 1e-9)
            {
                let quiet = self.levels(self.state);
                let which = self.random.draw() % 3;
                edges.sample(
                    Levels {
                        a: quiet.a ^ (which != 1),
                        b: quiet.b ^ (which != 0),
                        ..quiet
                    },
                    start_ns,
                );
                edges.sample(quiet, start_ns);
            }
            let target = floor(place);
            while self.state != target {
                let up = target > self.state;
                let edge = if up { self.state + 1 } else { self.state };
                self.state += if up { 1 } else { -1 };
                let part = ((edge as f64 - before) / (place - before)).clamp(0.0, 1.0);
                edges.sample(
                    self.levels(self.state),
                    start_ns + (part * step_ns as f64) as u64,
                );
            }
            before = place;
        }
        self.edges = Some(edges);
    }
}
