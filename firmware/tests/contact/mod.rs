//! A tool against a spring, in f64: sensor noise, 14-bit codes, the peak window, a drive, encoder
//! counts, friction.

use haptimill_firmware::force::admittance::{AdmittanceAxis, AdmittanceLaw, DrivingForce};
use haptimill_firmware::force::stability::{Sign, StabilityMonitor};
use haptimill_firmware::force::window_peak::{SlidingMinMax, Window};
use haptimill_firmware::force::{EnableCondition, LoopSettings};
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_math::{Coordinate, Length, Rate};

pub const PERIOD_US: u16 = 200;
pub const DELAY_US: u32 = 24_000;
pub const SETPOINT: f64 = 5.0;
const STEP: f64 = 200e-6;
const MM: f64 = 1_048_576.0;
const NEWTON: f64 = 65_536.0;

/// How the tool follows its reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// In the next period.
    Rigid,
    /// As two poles at `omega` 1/s without feed-forward: late by 2 / omega.
    Lag { omega: f64 },
    /// As a frictionless slide under K_P = 40,000 1/s^2 and K_D = 400 1/s on the rate of the error.
    Servo,
}

#[derive(Debug, Clone, Copy)]
pub struct Contact {
    pub stiffness: f64,
    pub approach: f64,
    pub drive: Drive,
    /// mm; 0 for none.
    pub count: f64,
    /// The tool follows within a band of this half width, mm: what friction leaves.
    pub stiction: f64,
    pub noise: f64,
    pub guarded: bool,
    pub mass: f64,
    pub damping: f64,
    pub time: f64,
    pub window: u32,
    /// Depth beyond the surface to which the commanded motion goes on.
    pub depth: f64,
}

impl Contact {
    pub fn new(stiffness: f64) -> Self {
        Self {
            stiffness,
            approach: 4.0,
            drive: Drive::Rigid,
            count: 0.0,
            stiction: 0.0,
            noise: 0.02,
            guarded: true,
            mass: 1.0,
            damping: 5.0,
            time: 12.0,
            window: 60,
            depth: 0.5 + SETPOINT / stiffness,
        }
    }
}

#[derive(Debug, Clone, Copy)]
pub struct ContactResult {
    pub first_peak: f64,
    pub largest: f64,
    pub oscillation: f64,
    pub mean: f64,
    /// Mean of the peak of a revolution, which is what the loop holds.
    pub mean_peak: f64,
    pub level: usize,
    pub sign: Sign,
}

pub fn settings(mass: f64, damping: f64) -> LoopSettings {
    LoopSettings {
        setpoint: Force((SETPOINT * NEWTON) as i32),
        mass: VirtualMass((mass * NEWTON) as u32),
        damping: VirtualDamping((damping * NEWTON) as u32),
        limit: Length::millimetres(10),
        rate: Rate(50 << 20),
        enable_condition: EnableCondition::Any,
    }
}

fn counted(position: f64, count: f64) -> f64 {
    if count > 0.0 {
        (position / count).round() * count
    } else {
        position
    }
}

struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        // xorshift64*, sum of 12 uniforms.
        let mut sum = -6.0;
        for _ in 0..12 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            sum +=
                (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / 9_007_199_254_740_992.0;
        }
        sum
    }
}

pub fn run(contact: &Contact, mut trace: impl FnMut(f64, f64, f64, usize)) -> ContactResult {
    let law = AdmittanceLaw::new(
        &settings(contact.mass, contact.damping),
        PERIOD_US,
        DELAY_US,
        Force::millinewtons(95_000),
    )
    .expect("sound settings");
    let mut compliance = AdmittanceAxis::new(law);
    let mut peaks = SlidingMinMax::new(Window::of(contact.window).expect("window"));
    let mut guard = StabilityMonitor::default();
    let mut noise = Noise(0x1234_5678_9abc_def1);
    let start = contact.approach * 0.1;
    let mut commanded = start;
    let (mut tool, mut speed, mut stuck) = (start, 0.0, start);
    let mut filtered = start;
    let mut reference = start;
    let mut reference_rate = 0.0;
    let (mut forces, mut peak_forces) = (Vec::new(), Vec::new());
    let mut rising = true;
    let (mut first_peak, mut largest) = (0.0f64, 0.0f64);
    let periods = (contact.time / STEP) as usize;
    let mut level = 0;
    for k in 0..periods {
        // The reference of the last period takes effect.
        match contact.drive {
            Drive::Rigid => tool = reference,
            Drive::Servo => {
                // The loop sees counts, once a period, and their rate through a filter of 1.5 ms.
                let seen = counted(tool, contact.count);
                let change = (seen - filtered) * (1.0 - libm::exp(-STEP / 1.5e-3));
                filtered += change;
                let acceleration =
                    40_000.0 * (reference - seen) + 400.0 * (reference_rate - change / STEP);
                tool += speed * STEP + acceleration * STEP * STEP / 2.0;
                speed += acceleration * STEP;
            }
            Drive::Lag { omega } => {
                for _ in 0..4 {
                    let h = STEP / 4.0;
                    let acceleration = omega * omega * (reference - tool) - 2.0 * omega * speed;
                    speed += acceleration * h;
                    tool += speed * h;
                }
            }
        }
        stuck = stuck.clamp(tool - contact.stiction, tool + contact.stiction);
        // A drive that only steps has the tool at whole counts; behind the servo it is where it is,
        // and only measured in counts.
        let measured = counted(stuck, contact.count);
        let place = if contact.drive == Drive::Servo {
            stuck
        } else {
            measured
        };
        let force = contact.stiffness * (-place).max(0.0);
        if rising && force > 1.0 {
            first_peak = first_peak.max(force);
            if force < first_peak - 1.0 {
                rising = false;
            }
        }
        largest = largest.max(force);
        forces.push(force);
        let code = ((force + contact.noise * noise.next()) / 0.0122)
            .round()
            .clamp(-8192.0, 8191.0);
        let measurement = Force((code * 0.0122 * NEWTON) as i32);
        let peak = peaks.push(measurement).peak();
        peak_forces.push(f64::from(peak.0) / NEWTON);
        guard.record_position(Coordinate((measured * MM) as i32));
        // Commanded motion.
        let end = -contact.depth;
        let rate = if commanded > end {
            -contact.approach
        } else {
            0.0
        };
        commanded = (commanded + rate * STEP).max(end);
        let push = DrivingForce {
            force: peak,
            commanded_rate: Rate((rate * MM) as i32),
            active: true,
            held: false,
            touching: guard.touching(),
            level: if contact.guarded { guard.level() } else { 0 },
        };
        level = push.level;
        let compliance_motion = compliance.advance(&push);
        reference = commanded + compliance_motion.displacement.length().0 as f64 / MM;
        reference_rate = rate + f64::from(compliance_motion.rate.0) / MM;
        if k % (contact.window as usize / 4) == 0 {
            guard.update(
                peak,
                compliance.law(),
                compliance_motion.displacement.0 != 0,
                0,
            );
        }
        trace(
            k as f64 * STEP,
            force,
            compliance_motion.displacement.length().0 as f64 / MM,
            level,
        );
    }
    let part = &forces[periods * 7 / 10..];
    let high = part.iter().copied().fold(f64::MIN, f64::max);
    let low = part.iter().copied().fold(f64::MAX, f64::min);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (oscillation, mean, mean_peak) = (
        high - low,
        mean(part),
        mean(&peak_forces[periods * 7 / 10..]),
    );
    ContactResult {
        first_peak,
        largest,
        oscillation,
        mean,
        mean_peak,
        level,
        sign: guard.sign(),
    }
}
