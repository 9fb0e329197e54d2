//! The loop through the hand: a hand on the arm, the mill that follows it into a contact, and the force that comes back, with a delay either way.
//!
//! The hand is a mass on spring and damper that follow an intention; the mill follows with the lag of its filter and of its drives and yields to the force like the force loop; the force is the peak of
//! a revolution. All in f64, but for law, walls and passivity, which are the firmware's. The intention goes 4 mm into the contact and stays.

use haptimill_firmware::reflection::law::Law;
use haptimill_firmware::reflection::passivity::{Passivity, PassivityConfig};
use haptimill_firmware::reflection::wall::{WallConfig, Walls};
use haptimill_firmware::units::force::Force;
use haptimill_firmware::units::{Length, Rate};
use haptimill_protocol::haptic::{ReflectAxis, Reflection};
use std::collections::VecDeque;

const T: f64 = 2e-4;
const PER_MM: f64 = 1_048_576.0;
const NEWTON: f64 = 65_536.0;
/// Each of the two stages of the following filter, 1/s.
const FOLLOW: f64 = 100.0;

fn settings() -> Reflection {
    let axis = ReflectAxis {
        percent: 40,
        most: (3.2 * NEWTON) as i32,
    };
    Reflection {
        axes: [axis; 3],
        boost: 6554,
        boost_below: 2 << 16,
    }
}

const PASSIVITY: PassivityConfig = PassivityConfig {
    credit: 32_768,
    debt: 65_536,
    damping: 19_661,
};

#[derive(Clone, Copy)]
struct Case {
    /// Of the hand, N/mm.
    grip: f64,
    /// N/mm.
    contact: f64,
    /// One way, s.
    delay: f64,
    wall: bool,
    passive: bool,
}

#[derive(Debug, Default, Clone, Copy)]
struct Outcome {
    /// Swing of the hand from peak to peak within 1.5 s, from 3 to 13.5 s and from there to 24 s, mm.
    early: f64,
    late: f64,
    /// Mean force at the hand, and mean of what the law makes of the force, in the last nine seconds, N.
    felt: f64,
    law: f64,
}

fn run(case: Case) -> Outcome {
    let mass = 0.8; // kg: hand and arm
    let stiffness = case.grip * 1000.0; // N/m
    let damping = 2.0 * 0.35 * (stiffness * mass).sqrt();
    let mut law = Law::new(&settings(), 200);
    let mut walls = Walls::new(
        &WallConfig {
            stiffness: 22_938,
            most: Force((5.5 * NEWTON) as i32),
        },
        Length::millimetres(5),
        200,
    );
    if case.wall {
        walls
            .set(0, false, Some((Length(1 << 19), Rate(0))))
            .unwrap();
    }
    let mut passivity = Passivity::new(&PASSIVITY, 200);
    let (mut x, mut v) = (10.0_f64, 0.0_f64);
    let mut measured = (x * PER_MM) as i32;
    let (mut first, mut second) = (x, x); // the two stages of the following filter
    let (mut tool, mut tool_rate) = (x, 0.0_f64);
    let (mut yielded, mut yield_rate) = (0.0_f64, 0.0_f64);
    let lag = (case.delay / T).round() as usize;
    let mut way_out: VecDeque<f64> = vec![x; lag + 1].into();
    let mut way_back: VecDeque<f64> = vec![0.0; lag + 1].into();
    let mut peaks: VecDeque<f64> = vec![0.0; 60].into();
    let mut rate = 0.0_f64;
    let mut hand = 0.0_f64;
    let total = (24.0 / T) as usize;
    let mut positions = Vec::with_capacity(total);
    let mut outcome = Outcome::default();
    // The force loop is damped for the contact as its guard would do it.
    let k_v = 5.0_f64.max(2.0 * case.contact * 0.03);
    let k_a = k_v / 5.0;
    for k in 0..total {
        let time = k as f64 * T;
        let intention = (10.0 - 14.0 * (time / 1.4).min(1.0)).max(-4.0);
        // Hand, in two steps of a period.
        for _ in 0..2 {
            let target_rate = if time < 1.4 { -0.01 } else { 0.0 };
            let force =
                stiffness * (intention - x) / 1000.0 + damping * (target_rate - v / 1000.0) + hand;
            v += force / mass * 1000.0 * T / 2.0;
            x += v * T / 2.0;
        }
        positions.push(x);
        // Encoders of 10 um.
        let now = ((x * 100.0).round() / 100.0 * PER_MM) as i32;
        let moved = now - measured;
        measured = now;
        rate += (f64::from(moved) / PER_MM / T - rate) * (T / 0.005);
        // To the mill.
        way_out.push_back(f64::from(measured) / PER_MM);
        let led = way_out.pop_front().unwrap();
        first += (led - first) * FOLLOW * T;
        second += (first - second) * FOLLOW * T;
        let reference = second + yielded;
        tool_rate += (250.0 * 250.0 * (reference - tool) - 2.0 * 250.0 * tool_rate) * T;
        tool += tool_rate * T;
        let force = (-case.contact * tool).max(0.0);
        peaks.push_back(force);
        peaks.pop_front();
        let peak = peaks.iter().fold(0.0_f64, |m, f| m.max(*f));
        yield_rate += (peak - 5.0 - k_v * yield_rate) / k_a * T;
        yielded += yield_rate * T;
        if yielded < 0.0 {
            (yielded, yield_rate) = (0.0, yield_rate.max(0.0));
        }
        // And back.
        way_back.push_back(peak);
        let felt = way_back.pop_front().unwrap();
        let rates = [Rate((rate * PER_MM) as i32), Rate(0), Rate(0)];
        let [reflected, ..] =
            law.reflect(&[Force((felt * NEWTON) as i32), Force(0), Force(0)], &rates);
        let [wall, ..] = walls.push(&[measured, 0, 0]);
        passivity.observe(
            &[Force((hand * NEWTON) as i32), Force(0), Force(0)],
            &[moved, 0, 0],
            walls.stored(),
        );
        let mut wanted = f64::from(reflected.0 + wall.0) / NEWTON;
        if case.passive {
            let [damp, ..] = passivity.damp(&rates);
            wanted += f64::from(damp.0) / NEWTON;
        }
        hand += (wanted - hand).clamp(-0.05, 0.05);
        if time >= 15.0 {
            outcome.felt += hand * T;
            let law = (0.4 * peak).min(3.2) + f64::from(wall.0) / NEWTON;
            outcome.law += law * T;
        }
    }
    // The largest swing within any second and a half of a range.
    let swing = |start: f64, end: f64| {
        let part = &positions[(start / T) as usize..(end / T) as usize];
        part.chunks((1.5 / T) as usize)
            .map(|chunk| {
                let (low, high) = chunk
                    .iter()
                    .fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
                high - low
            })
            .fold(0.0, f64::max)
    };
    outcome.early = swing(3.0, 13.5);
    outcome.late = swing(13.5, 24.0);
    outcome
}

/// The worst of all grips and contacts.
#[derive(Clone, Copy, Default)]
struct Worst {
    early: f64,
    late: f64,
    growth: f64,
    least: f64,
    most: f64,
}

fn worst(contacts: &[f64], delay: f64, wall: bool, passive: bool) -> Worst {
    let mut worst = Worst {
        least: f64::MAX,
        ..Worst::default()
    };
    for grip in [0.1, 0.3, 1.0, 2.0] {
        for &contact in contacts {
            let outcome = run(Case {
                grip,
                contact,
                delay,
                wall,
                passive,
            });
            worst.early = worst.early.max(outcome.early);
            worst.late = worst.late.max(outcome.late);
            worst.growth = worst.growth.max(outcome.late - outcome.early);
            worst.least = worst.least.min(outcome.felt / outcome.law);
            worst.most = worst.most.max(outcome.felt / outcome.law);
        }
    }
    worst
}

/// Hands of 0.1 to 2 N/mm on contacts of 1 to 20 N/mm, 0 to 50 ms either way: nothing grows, and the hand feels what the law says.
#[test]
fn the_loop_through_the_hand_does_not_swing_up() {
    println!("contact       wall  delay  swing mm: free -> watched   felt / law");
    for (name, contacts) in [
        ("1-20 N/mm", &[2.0, 10.0, 20.0][..]),
        ("50-200 N/mm", &[50.0, 200.0][..]),
    ] {
        for wall in [false, true] {
            for delay in [0.0, 0.01, 0.05] {
                let (free, watched) = (
                    worst(contacts, delay, wall, false),
                    worst(contacts, delay, wall, true),
                );
                println!(
                    "{name:12}  {wall:5} {:3.0} ms  {:6.2} -> {:5.2}  {:4.2} .. {:4.2}",
                    delay * 1e3,
                    free.late,
                    watched.late,
                    watched.least,
                    watched.most
                );
                // Swings get smaller, or are below what a finger feels as motion.
                assert!(
                    watched.growth < 0.05 + 0.15 * watched.late,
                    "{name} {delay} {}",
                    watched.growth
                );
                if contacts[0] < 50.0 {
                    assert!(
                        watched.late < 0.2 + 20.0 * delay,
                        "{name} {delay} {}",
                        watched.late
                    );
                    assert!(
                        watched.least >= if delay == 0.0 { 0.95 } else { 0.5 },
                        "{name} {delay} {}",
                        watched.least
                    );
                    assert!(
                        watched.most <= if delay == 0.0 { 1.05 } else { 1.6 },
                        "{name} {delay} {}",
                        watched.most
                    );
                }
            }
        }
    }
    // The watch is what does it: without it the same hands swing by centimetres.
    assert!(worst(&[10.0, 20.0], 0.05, false, false).late > 4.0);
}
