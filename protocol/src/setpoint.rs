//! Compact coding of timed setpoints.
//!
//! Consecutive setpoints of a smooth path are predictable. Both endpoints keep the same
//! [`SetpointCoder`], which predicts each axis from the setpoints before. Only residuals are sent
//! ([`SetpointDelta`]). An axis at standstill costs nothing.
//!
//! The prediction uses the segment polynomial, a cubic. Over a segment duration h, from p0 with
//! rate v0 to p1 with rate v1, the cubic has the acceleration a at its end and the constant jerk j:
//!
//! ```text
//! a h   = 2 v0 + 4 v1 - 6 (p1 - p0) / h
//! j h^2 = 6 (v0 + v1) - 12 (p1 - p0) / h
//! ```
//!
//! The next coordinate is predicted as p + v h + a h^2 / 2. Once that coordinate is known, the next
//! rate is predicted as the one that a constant jerk from (p, v, a) through the coordinate gives:
//! v + a h + 3 (p' - prediction) / h. On the motions of the test `wire_cost` a setpoint costs 11 to
//! 18 bytes on the line. With p + v h alone it costs 13 to 25. Predicting with the jerk as well
//! gains nothing (18.1 for 18.4 bytes, but 17.3 for 17.0): it magnifies the rounding of the
//! coordinates, and a planner changes the jerk at its setpoints.
//!
//! All arithmetic is integer and the same on both endpoints. The coding is exact: residuals of
//! coordinate and rate are taken modulo 2^32, so decoding returns every bit of every possible
//! setpoint, also where a rotary axis wraps around.
//!
//! Callers must pass the same setpoints in the same order, from the same start, to both coders. A
//! refused setpoint leaves the coder unchanged. A setpoint from [`BatchReader`] changes the coder
//! only with [`SetpointCoder::take`].

use crate::message::{Action, AxisValues, MAX_AXES, RATE_SHIFT, SETPOINT_BATCH, SetpointDelta};

/// A setpoint: pose and rates at the end of a segment duration.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setpoint {
    /// Segment duration: control periods since the setpoint before; at least 1.
    pub periods: u16,
    /// Pose, axis units.
    pub pose: AxisValues,
    /// Rates, axis units per second divided by 2^[`crate::message::RATE_SHIFT`].
    pub rates: AxisValues,
    /// Action when the setpoint is reached.
    pub action: Action,
}

/// Reason why a setpoint cannot be coded or decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetpointError {
    /// The segment duration is zero.
    NoTime,
    /// The number of positions, rates or residuals is not that of the coordinates.
    CoordinateCount,
}

impl core::fmt::Display for SetpointError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoTime => {
                f.write_str("a setpoint must be at least one period after the one before")
            }
            Self::CoordinateCount => {
                f.write_str("a setpoint must have one position and one rate for each coordinate")
            }
        }
    }
}

impl core::error::Error for SetpointError {}

/// Decodes a request with setpoints one setpoint at a time, so that no control period has to decode
/// all of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BatchReader {
    /// Number of the request.
    pub id: u8,
    /// Number of the next setpoint in the job.
    pub number: u32,
    /// Number of setpoints left.
    pub left: u8,
    /// Offset of the next setpoint in the payload.
    at: u16,
}

impl BatchReader {
    /// Returns whether the payload is a request with setpoints: its second byte is the number of
    /// [`Command::Setpoints`](crate::message::Command::Setpoints).
    pub fn fits(payload: &[u8]) -> bool {
        payload.get(1) == Some(&0)
    }

    /// Reads the beginning of such a request. Returns `None` when it cannot be read.
    pub fn open(payload: &[u8]) -> Option<Self> {
        // Request number, command, number of the first setpoint, number of setpoints.
        let ((id, kind, number, left), rest) =
            postcard::take_from_bytes::<(u8, u32, u32, u32)>(payload).ok()?;
        let whole = kind == 0 && left as usize <= SETPOINT_BATCH;
        whole.then_some(Self {
            id,
            number,
            left: left as u8,
            at: (payload.len() - rest.len()) as u16,
        })
    }

    /// Reads the next setpoint of the same payload. Returns false when none is left, when it cannot
    /// be read, or when it does not fit the coder. The coder changes only with
    /// [`SetpointCoder::take`].
    pub fn next(&mut self, payload: &[u8], coder: &SetpointCoder, setpoint: &mut Setpoint) -> bool {
        self.read(payload, coder, setpoint).is_some()
    }

    fn read(
        &mut self,
        payload: &[u8],
        coder: &SetpointCoder,
        setpoint: &mut Setpoint,
    ) -> Option<()> {
        let left = self.left.checked_sub(1)?;
        // A delta as postcard writes it, decoded in place: decoding it as a value takes three times
        // as long.
        let mut bytes = payload.get(usize::from(self.at)..)?;
        let periods = u16::try_from(number(&mut bytes)?).ok()?;
        let (&moved, rest) = bytes.split_first()?;
        bytes = rest;
        if number(&mut bytes)? != 2 * moved.count_ones() {
            return None;
        }
        let residual =
            || number(&mut bytes).map(|coded| (coded >> 1) as i32 ^ -((coded & 1) as i32));
        coder.predict(periods, moved, residual, setpoint).ok()?;
        let (action, rest) = postcard::take_from_bytes(bytes).ok()?;
        setpoint.action = action;
        self.at = (payload.len() - rest.len()) as u16;
        self.left = left;
        self.number = self.number.wrapping_add(1);
        Some(())
    }
}

/// Decodes a number of at most 32 bits, seven bits a byte, lowest first.
#[inline(never)]
fn number(bytes: &mut &[u8]) -> Option<u32> {
    let (mut number, mut shift) = (0, 0);
    loop {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u32::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            // The fifth byte has four bits of the number.
            return (shift < 28 || byte < 16).then_some(number);
        }
        if shift == 28 {
            return None;
        }
        shift += 7;
    }
}

/// Times of the prediction are in 2^-24 s.
const TIME_SHIFT: u32 = 24;
/// Longest time of the prediction: 4 s. A longer segment duration is coded exactly too, with more
/// bytes.
const LONGEST: i64 = 4 << TIME_SHIFT;
/// Shortest time of the prediction: 2^-14 s, a little more than the shortest control period.
const SHORTEST: i64 = 1 << (TIME_SHIFT - 14);
/// Extra fraction bits of rates inside the prediction.
const FINE: u32 = 4;
/// Bound of every change of rate inside the prediction. It keeps all products within 63 bits.
const RATE_BOUND: i64 = 1 << 34;
/// Bound of the ratio of two segment durations, in 2^-16: 16 times longer than the one before.
const RATIO_BOUND: i64 = 16 << 16;

/// State of one axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct CodedAxis {
    /// Coordinate of the last setpoint.
    pose: i32,
    /// Its rate, wire units.
    rate: i32,
    /// Its acceleration times the last segment duration: the change of rate that would continue, in
    /// rate units divided by 2^[`FINE`].
    gain: i64,
}

/// A segment duration with the values that the prediction needs, so that two divisions serve all
/// axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Span {
    /// Duration, 2^-24 s.
    time: i64,
    /// 2^40 / duration.
    reciprocal: i64,
}

impl Span {
    /// Creates the duration from microseconds.
    fn new(micros: u64) -> Self {
        // 2^24 / 10^6 = 2^18 / 15625; the clamp to 5 s keeps the product small.
        let micros = micros.min(5_000_000) as u32;
        let time = quotient(micros, 15_625, 18).clamp(SHORTEST as u32, LONGEST as u32);
        Self {
            time: i64::from(time),
            reciprocal: i64::from(quotient(1 << 31, time, 9)),
        }
    }

    /// Returns the mean rate over a displacement, in rate units divided by 2^[`FINE`]. |way| <=
    /// 2^33 and reciprocal <= 2^30, so |product| < 2^63.
    fn mean_rate(&self, way: i64) -> i64 {
        // way / time is in axis units per 2^-24 s. The result is in 2^(RATE_SHIFT - FINE) axis
        // units per second.
        way.wrapping_mul(self.reciprocal) >> (40 - TIME_SHIFT + RATE_SHIFT - FINE)
    }
}

/// Returns number * 2^bits / by, rounded down, by divisions of one word. `by` is at most 2^26 and
/// the result below 2^32.
fn quotient(number: u32, by: u32, bits: u32) -> u32 {
    let (mut quotient, mut rest) = (number / by, number % by);
    let mut left = bits;
    while left > 0 {
        // The remainder is below 2^26.
        let shift = left.min(6);
        rest <<= shift;
        quotient = (quotient << shift).wrapping_add(rest / by);
        rest %= by;
        left -= shift;
    }
    quotient
}

/// Encodes setpoints as deltas, and decodes deltas.
///
/// ```
/// use haptimill_protocol::message::Action;
/// use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
/// let start = [0, 1 << 20].into_iter().collect();
/// let mut host = SetpointCoder::new(200, &start);
/// let mut controller = host.clone();
/// let setpoint = Setpoint {
///     periods: 100,
///     pose: [1000, 1 << 20].into_iter().collect(),
///     rates: [390, 0].into_iter().collect(),
///     action: Action::None,
/// };
/// let delta = host.encode(&setpoint).unwrap();
/// assert_eq!(delta.moved, 0b01);
/// assert_eq!(controller.decode(&delta).unwrap(), setpoint);
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SetpointCoder {
    /// Control period, microseconds.
    period_us: u16,
    /// Axes in use.
    axes: usize,
    /// Periods of the last setpoint, and its duration.
    last: (u16, Span),
    /// State of each axis.
    state: [CodedAxis; MAX_AXES],
}

impl SetpointCoder {
    /// Creates a coder for the start of a job, at standstill in `pose` (axis units). `period_us` is
    /// the control period in microseconds.
    pub fn new(period_us: u16, pose: &AxisValues) -> Self {
        let mut state = [CodedAxis::default(); MAX_AXES];
        for (axis, &pose) in state.iter_mut().zip(pose) {
            axis.pose = pose;
        }
        Self {
            period_us,
            axes: pose.len(),
            last: (0, Span::new(0)),
            state,
        }
    }

    /// Number of axes of the setpoints.
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// Encodes the next setpoint.
    ///
    /// # Errors
    ///
    /// [`SetpointError`] when the setpoint takes no time or has the wrong number of coordinates;
    /// the coder is then unchanged.
    pub fn encode(&mut self, setpoint: &Setpoint) -> Result<SetpointDelta, SetpointError> {
        if setpoint.pose.len() != self.axes || setpoint.rates.len() != self.axes {
            return Err(SetpointError::CoordinateCount);
        }
        let (span, ratio) = self.span(setpoint.periods)?;
        let mut delta = SetpointDelta {
            periods: setpoint.periods,
            action: setpoint.action,
            ..SetpointDelta::default()
        };
        let commanded = setpoint.pose.iter().zip(&setpoint.rates);
        for (index, (axis, (&pose, &rate))) in self.state.iter_mut().zip(commanded).enumerate() {
            let (predicted, gain) = axis.predict(span, ratio);
            let pose_residual = pose.wrapping_sub(predicted);
            let rate_residual = rate.wrapping_sub(axis.predict_rate(span, gain, pose_residual));
            if (pose_residual, rate_residual) != (0, 0) {
                delta.moved |= 1 << index;
                // At most MAX_AXES pairs: the residuals always fit.
                let _ = delta.residuals.push(pose_residual);
                let _ = delta.residuals.push(rate_residual);
            }
            axis.advance(span, pose, rate);
        }
        self.last = (setpoint.periods, span);
        Ok(delta)
    }

    /// Decodes the next delta.
    ///
    /// # Errors
    ///
    /// [`SetpointError`] when the delta takes no time or has residuals of axes that do not exist;
    /// the coder is then unchanged.
    pub fn decode(&mut self, delta: &SetpointDelta) -> Result<Setpoint, SetpointError> {
        if delta.residuals.len() != 2 * delta.moved.count_ones() as usize {
            return Err(SetpointError::CoordinateCount);
        }
        let mut setpoint = Setpoint::default();
        let mut residuals = delta.residuals.iter().copied();
        self.predict(
            delta.periods,
            delta.moved,
            || residuals.next(),
            &mut setpoint,
        )?;
        setpoint.action = delta.action;
        self.take(&setpoint);
        Ok(setpoint)
    }

    /// Writes the setpoint with these residuals to `setpoint`, except for its action.
    fn predict(
        &self,
        periods: u16,
        moved: u8,
        mut residual: impl FnMut() -> Option<i32>,
        setpoint: &mut Setpoint,
    ) -> Result<(), SetpointError> {
        if u32::from(moved) >> self.axes != 0 {
            return Err(SetpointError::CoordinateCount);
        }
        let (span, ratio) = self.span(periods)?;
        setpoint.periods = periods;
        setpoint.pose.clear();
        setpoint.rates.clear();
        let mut moved = moved;
        for axis in self.state.iter().take(self.axes) {
            let (mut pose, gain) = axis.predict(span, ratio);
            let mut rate = 0;
            let mut pose_residual = 0;
            if moved & 1 != 0 {
                pose_residual = residual().ok_or(SetpointError::CoordinateCount)?;
                rate = residual().ok_or(SetpointError::CoordinateCount)?;
                pose = pose.wrapping_add(pose_residual);
            }
            moved >>= 1;
            rate = axis
                .predict_rate(span, gain, pose_residual)
                .wrapping_add(rate);
            let _ = setpoint.pose.push(pose);
            let _ = setpoint.rates.push(rate);
        }
        Ok(())
    }

    /// Accepts the setpoint that was read last: the next one is relative to it.
    pub fn take(&mut self, setpoint: &Setpoint) {
        let (last_periods, mut span) = self.last;
        if setpoint.periods != last_periods {
            span = self.span_of(setpoint.periods);
        }
        self.last = (setpoint.periods, span);
        let values = setpoint.pose.iter().zip(&setpoint.rates);
        for (axis, (&pose, &rate)) in self.state.iter_mut().zip(values) {
            axis.advance(span, pose, rate);
        }
    }

    fn span_of(&self, periods: u16) -> Span {
        Span::new(u64::from(periods) * u64::from(self.period_us))
    }

    /// Returns the duration of the next setpoint, and its ratio to the last one, in 2^-16.
    fn span(&self, periods: u16) -> Result<(Span, i64), SetpointError> {
        let (last_periods, last) = self.last;
        if periods == 0 {
            return Err(SetpointError::NoTime);
        }
        if periods == last_periods {
            return Ok((last, 1 << 16));
        }
        let span = self.span_of(periods);
        // Every time is at most 2^26.
        let (time, last) = (span.time as u32, last.time as u32);
        let ratio = if time / last < (RATIO_BOUND >> 16) as u32 {
            i64::from(quotient(time, last, 16))
        } else {
            RATIO_BOUND
        };
        Ok((span, ratio))
    }
}

impl CodedAxis {
    /// Returns the predicted coordinate after a duration, and the change of rate.
    fn predict(&self, span: Span, ratio: i64) -> (i32, i64) {
        // |gain| <= 2^40 and ratio <= 2^20.
        let gain = (self.gain.wrapping_mul(ratio) >> 16).clamp(-RATE_BOUND, RATE_BOUND);
        // |rate| <= 2^31 + 2^29 wire units, 2^35 + 2^33 fine ones; time <= 2^26: |product| < 2^62.
        let mean = (i64::from(self.rate) << FINE).wrapping_add(gain / 2);
        let way = mean.wrapping_mul(span.time) >> (TIME_SHIFT - RATE_SHIFT + FINE);
        // Modulo 2^32 by intent: a rotary axis wraps around, and the residual is modulo 2^32 as
        // well.
        (i64::from(self.pose).wrapping_add(way) as i32, gain)
    }

    /// Returns the predicted rate for a coordinate that is `residual` beyond its prediction.
    fn predict_rate(&self, span: Span, gain: i64, residual: i32) -> i32 {
        // |gain| <= 2^34, the mean rate is below 2^61.
        let fine = gain.wrapping_add(span.mean_rate(i64::from(residual)).wrapping_mul(3));
        // Half is added so that the shift rounds to nearest; modulo 2^32 by intent, as above.
        i64::from(self.rate).wrapping_add(fine.wrapping_add(1 << (FINE - 1)) >> FINE) as i32
    }

    /// Accepts the setpoint that was reached.
    fn advance(&mut self, span: Span, pose: i32, rate: i32) {
        // Modulo 2^32: the shorter way round for an axis that wraps.
        let mean = span.mean_rate(i64::from(pose.wrapping_sub(self.pose)));
        let rates = (i64::from(self.rate) << 1).wrapping_add(i64::from(rate) << 2);
        let gain = (rates << FINE).wrapping_sub(mean.wrapping_mul(6));
        self.gain = gain.clamp(-(1 << 40), 1 << 40);
        self.pose = pose;
        self.rate = rate;
    }
}

#[cfg(test)]
mod tests;
