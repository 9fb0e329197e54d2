//! Programs of one coordinate, and the path that the interpolator commands.

use crate::reference::mm;
use haptimill_firmware::config::Config;
use haptimill_firmware::motion::interpolator::Interpolator;
use haptimill_kinematics::Pose;
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::Action;
use haptimill_protocol::setpoint::Setpoint;

pub const PERIOD_S: f64 = 2e-4;

pub const UNIT_MM: f64 = 1.0 / (1 << 20) as f64;

/// A setpoint with x moving at `speed` mm/s, standing at `x` mm.
pub fn setpoint(x: f64, speed: f64, periods: u16) -> Setpoint {
    Setpoint {
        periods,
        pose: [mm(x), 0, mm(20.0), 0, 0].into_iter().collect(),
        rates: [(speed * 4096.0) as i32, 0, 0, 0, 0].into_iter().collect(),
        action: Action::None,
    }
}

/// A run at constant speed in x: from rest up, along, and down to rest.
pub fn straight(speed: f64, count: u16, periods: u16) -> Vec<Setpoint> {
    let span = f64::from(periods) * PERIOD_S;
    let mut x = speed * span / 2.0;
    let mut points = vec![setpoint(x, speed, periods)];
    for _ in 0..count {
        x += speed * span;
        points.push(setpoint(x, speed, periods));
    }
    x += speed * span / 2.0;
    points.push(setpoint(x, 0.0, periods));
    points
}

pub fn start(config: &Config) -> Interpolator {
    // The runs here start within 20 ms: an acceleration that a jog is not allowed.
    let mut config = config.clone();
    config.pose[0].acceleration = Acceleration(mm(2000.0 / 256.0));
    let mut program = Interpolator::new(&config);
    let mut pose = Pose::default();
    pose.0[2] = Coordinate(mm(20.0));
    program.begin(&pose);
    program
}

/// x (mm) and its rate (mm/s) of every period.
#[derive(Default)]
pub struct Path {
    pub x: Vec<f64>,
    pub rate: Vec<f64>,
    pub finished: bool,
}

impl Path {
    pub fn push(&mut self, x: Coordinate, rate: Rate) {
        self.x.push(f64::from(x.0) * UNIT_MM);
        self.rate.push(f64::from(rate.0) * UNIT_MM);
    }

    /// What comes after.
    pub fn take(&mut self, then: Self) {
        self.x.extend(then.x);
        self.rate.extend(then.rate);
        self.finished |= then.finished;
    }

    /// The rate is the derivative of the position: its trapezoidal sum is the distance.
    pub fn assert_consistent(&self) {
        let mut integral = self.x[0];
        for (x, rates) in self.x[1..].iter().zip(self.rate.windows(2)) {
            integral += (rates[0] + rates[1]) / 2.0 * PERIOD_S;
            assert!(
                (integral - x).abs() < 2e-5,
                "position {x} integral of the rate {integral}"
            );
        }
    }

    /// Largest acceleration and jerk in mm/s^2 and mm/s^3, from differences of the rate over 8 and
    /// 16 periods.
    pub fn dynamics(&self, from: usize, to: usize) -> (f64, f64) {
        let slope = |values: &[f64], span: usize| -> Vec<f64> {
            values
                .windows(span + 1)
                .map(|w| (w[span] - w[0]) / (span as f64 * PERIOD_S))
                .collect()
        };
        let acceleration = slope(
            &self.rate[from.min(self.rate.len())..to.min(self.rate.len())],
            8,
        );
        let jerk = slope(&acceleration, 16);
        let peak = |values: &[f64]| {
            values
                .iter()
                .fold(0.0_f64, |max, value| max.max(value.abs()))
        };
        (peak(&acceleration), peak(&jerk))
    }
}

pub fn walk(program: &mut Interpolator, periods: usize, halt: impl Fn(usize) -> bool) -> Path {
    let mut path = Path::default();
    for period in 0..periods {
        let (commanded, progress) = program.advance(halt(period));
        path.push(commanded.pose.0[0], commanded.rates[0]);
        assert!(!progress.queue_empty);
        if progress.finished {
            path.finished = true;
            break;
        }
    }
    path
}
