//! Force loop against stiff contacts: stability limits without the monitor, against the analysis,
//! and stability with it.
//!
//! `cargo test -p haptimill-firmware --test all contact_stability -- --nocapture` prints the tables
//! of docs/decisions/0010.

use crate::contact;
use contact::{Contact, ContactResult, Drive, SETPOINT, run};
use haptimill_firmware::force::stability::Sign;

/// Resolution of the encoders at the tool, mm.
const COUNT: f64 = 0.00125;
const STIFFNESSES: [f64; 11] = [
    10.0, 20.0, 50.0, 100.0, 150.0, 200.0, 300.0, 420.0, 600.0, 800.0, 1000.0,
];

fn quiet(contact: &Contact) -> ContactResult {
    run(contact, |_, _, _, _| ())
}

/// The largest oscillation that counts as holding.
fn bearable(stiffness: f64) -> f64 {
    (2.0 * COUNT * stiffness).max(0.2)
}

/// The stiffness at which K_A s^2 + K_V s + k e^(-s tau) has roots on the imaginary axis: (K_V /
/// tau) y / sin y with y tan y = K_V tau / K_A.
fn analytic_limit(mass: f64, damping: f64, delay: f64) -> f64 {
    let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
    for _ in 0..60 {
        let y = (low + high) / 2.0;
        if y * libm::tan(y) < damping * delay / mass {
            low = y
        } else {
            high = y
        }
    }
    damping / delay * low / libm::sin(low)
}

/// The stiffness, to 2 %, above which the loop without guard does not come to rest.
fn found_limit(make: impl Fn(f64) -> Contact) -> f64 {
    let (mut low, mut high) = (20.0f64, 2000.0f64);
    while high / low > 1.02 {
        let middle = (low * high).sqrt();
        let outcome = quiet(&Contact {
            guarded: false,
            time: 30.0,
            approach: 1.0,
            ..make(middle)
        });
        if outcome.oscillation > bearable(middle) {
            high = middle
        } else {
            low = middle
        }
    }
    low
}

/// The formula is the root of the characteristic equation.
#[test]
fn analytic_stability_limit_is_on_the_imaginary_axis() {
    for (mass, damping, delay) in [
        (1.0, 5.0, 0.0132),
        (1.0, 5.0, 0.012),
        (0.25, 0.5, 0.02),
        (1.0, 20.0, 0.022),
        (0.01, 5.0, 0.03),
    ] {
        let limit = analytic_limit(mass, damping, delay);
        // |j w (K_V + j w K_A)| = k gives w; its phase must be that of -e^(-j w tau).
        let (square, half) = (limit * limit, damping * damping / (mass * mass) / 2.0);
        let w = (((half * half + square / (mass * mass)).sqrt()) - half).sqrt();
        let phase = std::f64::consts::FRAC_PI_2 - libm::atan(w * mass / damping) - w * delay;
        assert!(phase.abs() < 1e-6, "{phase}");
        assert!(limit >= damping / delay);
    }
    assert!((analytic_limit(1.0, 5.0, 0.0132) - 383.0).abs() < 1.0);
}

/// A window of the peak follows a rising force at once and a falling one a revolution late: half of
/// it counts as delay for an oscillation. The delay of the whole window gives the safe limit.
#[test]
fn limits_without_monitor_match_the_analysis() {
    let rigid = found_limit(Contact::new);
    let (half, whole) = (
        analytic_limit(1.0, 5.0, 0.0062),
        analytic_limit(1.0, 5.0, 0.0132),
    );
    println!(
        "K_A 1, K_V 5, window 12 ms: limit found with a rigid drive {rigid:.0} N/mm; analytic {half:.0} for half the window, {whole:.0} for the whole"
    );
    assert!(
        rigid > whole && (rigid / half - 1.0).abs() < 0.1,
        "{rigid} {half} {whole}"
    );
    let lag = found_limit(|stiffness| Contact {
        drive: Drive::Lag { omega: 200.0 },
        ..Contact::new(stiffness)
    });
    let (half, whole) = (
        analytic_limit(1.0, 5.0, 0.0162),
        analytic_limit(1.0, 5.0, 0.0232),
    );
    println!("  with a drive that lags by 10 ms {lag:.0} N/mm; analytic {half:.0} and {whole:.0}");
    assert!(
        lag > whole && (lag / half - 1.0).abs() < 0.15,
        "{lag} {half} {whole}"
    );
    let servo = found_limit(|stiffness| Contact {
        drive: Drive::Servo,
        ..Contact::new(stiffness)
    });
    println!("  with the servo of the arm {servo:.0} N/mm");
    for stiction in [0.002, 0.005] {
        let limit = found_limit(|stiffness| Contact {
            stiction,
            ..Contact::new(stiffness)
        });
        println!(
            "  rigid, friction that leaves +-{:.0} um: {limit:.0} N/mm",
            stiction * 1e3
        );
        assert!(limit < rigid);
    }
    let (gentle, strong) = (
        found_limit(|stiffness| Contact {
            mass: 0.25,
            damping: 0.5,
            ..Contact::new(stiffness)
        }),
        found_limit(|stiffness| Contact {
            damping: 20.0,
            ..Contact::new(stiffness)
        }),
    );
    println!("  K_A 0.25, K_V 0.5: {gentle:.0} N/mm; K_A 1, K_V 20: {strong:.0} N/mm");
    assert!(gentle > analytic_limit(0.25, 0.5, 0.0132));
}

/// With the guard, the default gains hold every contact up to 1000 N/mm: on any drive, with and
/// without encoder counts, with and without friction.
#[test]
fn monitor_stabilises_contacts_up_to_1000_n_mm() {
    for drive in [Drive::Rigid, Drive::Servo, Drive::Lag { omega: 200.0 }] {
        for count in [0.0, COUNT] {
            for stiction in [0.0, 0.002, 0.005] {
                let (mut worst_oscillation, mut worst_mean, mut worst_first) =
                    (0.0f64, 0.0f64, 0.0f64);
                for stiffness in STIFFNESSES {
                    for approach in [0.2, 1.0, 4.0] {
                        let contact = Contact {
                            drive,
                            count,
                            stiction,
                            approach,
                            ..Contact::new(stiffness)
                        };
                        let outcome = quiet(&contact);
                        let first = SETPOINT + 1.2 * (5.0 * approach + approach * stiffness.sqrt());
                        assert!(
                            outcome.oscillation <= bearable(stiffness),
                            "{contact:?} {outcome:?}"
                        );
                        assert!(
                            outcome.first_peak <= first && outcome.largest <= first,
                            "{contact:?} {outcome:?} {first}"
                        );
                        assert_eq!(outcome.sign, Sign::Right, "{contact:?}");
                        assert!(
                            stiction > 0.0 || (outcome.mean - SETPOINT).abs() <= 0.25,
                            "{contact:?} {outcome:?}"
                        );
                        worst_oscillation =
                            worst_oscillation.max(outcome.oscillation / bearable(stiffness));
                        worst_mean = worst_mean.max((outcome.mean - SETPOINT).abs());
                        worst_first = worst_first
                            .max((outcome.first_peak - SETPOINT) / (first - SETPOINT) * 1.2);
                    }
                }
                println!(
                    "{drive:?}, counts {count} mm, friction +-{stiction} mm: oscillation {worst_oscillation:.2} of what is allowed, |mean - f_d| {worst_mean:.3} N, first peak f_d + {worst_first:.2} (K_V v + v sqrt(K_A k))"
                );
            }
        }
    }
}

/// Stability limits with the monitor, by the oscillation alone.
#[test]
fn limits_with_monitor_exceed_1000_n_mm() {
    for drive in [Drive::Rigid, Drive::Servo, Drive::Lag { omega: 200.0 }] {
        let holds = |stiffness: f64| {
            let contact = Contact {
                drive,
                count: COUNT,
                approach: 0.5,
                ..Contact::new(stiffness)
            };
            quiet(&contact).oscillation <= bearable(stiffness)
        };
        let mut limit = 500.0;
        while limit < 8000.0 && holds(limit * 1.05) {
            limit *= 1.05;
        }
        println!("{drive:?}: held with the guard up to {limit:.0} N/mm");
        assert!(limit > 1000.0, "{drive:?} {limit}");
    }
}

/// The same contacts oscillate without the monitor.
#[test]
fn same_contacts_oscillate_without_monitor() {
    for (drive, stiffness) in [
        (Drive::Rigid, 1000.0),
        (Drive::Servo, 1000.0),
        (Drive::Lag { omega: 200.0 }, 420.0),
    ] {
        for count in [0.0, COUNT] {
            let contact = Contact {
                guarded: false,
                drive,
                count,
                ..Contact::new(stiffness)
            };
            let (without, with) = (
                quiet(&contact),
                quiet(&Contact {
                    guarded: true,
                    ..contact
                }),
            );
            println!(
                "{drive:?}, counts {count} mm, {stiffness} N/mm: oscillation {:.1} N without, {:.2} N with the guard (level {})",
                without.oscillation, with.oscillation, with.level
            );
            assert!(
                without.oscillation > 3.0 * bearable(stiffness)
                    && with.oscillation <= bearable(stiffness)
            );
        }
    }
}

/// The other gains of the thesis and the gentle set, with the servo of the arm.
#[test]
fn other_gains_are_stable() {
    for (mass, damping) in [(0.25, 0.5), (0.25, 5.0), (1.0, 2.0), (1.0, 20.0)] {
        for stiffness in STIFFNESSES {
            // K_V / k is the time constant of a soft contact.
            let time = 12.0 + 20.0 * damping / stiffness;
            let contact = Contact {
                mass,
                damping,
                drive: Drive::Servo,
                approach: 1.0,
                time,
                ..Contact::new(stiffness)
            };
            let outcome = quiet(&contact);
            assert!(
                outcome.oscillation <= bearable(stiffness)
                    && (outcome.mean - SETPOINT).abs() <= 0.25,
                "{contact:?} {outcome:?}"
            );
            assert!(
                outcome.first_peak <= SETPOINT + 1.2 * (damping + (mass * stiffness).sqrt()),
                "{contact:?} {outcome:?}"
            );
        }
    }
}
/// A commanded motion that goes on for 3 s into the contact: the force is f_d + K_V v, whatever the
/// guard adds.
#[test]
fn steady_push_force_matches_the_equation() {
    for stiffness in [50.0, 200.0, 600.0, 1000.0] {
        for approach in [0.2, 1.0, 2.0] {
            let contact = Contact {
                drive: Drive::Servo,
                count: COUNT,
                approach,
                depth: 3.0 * approach,
                time: 3.0,
                ..Contact::new(stiffness)
            };
            let outcome = quiet(&contact);
            let steady = SETPOINT + 5.0 * approach;
            assert!(
                (outcome.mean - steady).abs() < 0.05 * steady + COUNT * stiffness / 2.0,
                "{contact:?} {outcome:?} {steady}"
            );
            assert!(
                outcome.oscillation <= 2.0 * bearable(stiffness),
                "{contact:?} {outcome:?}"
            );
        }
    }
}
/// The mean force over all stiffnesses. What the loop holds is the peak of a revolution. A tool
/// that sits on whole counts alone goes to and fro between two of them (1.1 N apart at 879 N/mm),
/// and the peak shows the higher one for a revolution longer than it is there: the mean of the peak
/// is f_d, that of the force is below it. An arm behind a servo does not sit on counts.
#[test]
fn mean_force_is_the_force_setpoint() {
    for (drive, count, max) in [
        (Drive::Rigid, 0.0, 0.25),
        (Drive::Servo, COUNT, 0.25),
        (Drive::Lag { omega: 200.0 }, COUNT, 0.25),
        (Drive::Rigid, COUNT, 0.4),
    ] {
        let (mut stiffness, mut worst, mut worst_peak) = (50.0, (0.0f64, 0.0), 0.0f64);
        while stiffness < 1000.0 {
            let contact = Contact {
                drive,
                count,
                approach: 0.5,
                ..Contact::new(stiffness)
            };
            let outcome = quiet(&contact);
            assert!(
                outcome.oscillation <= bearable(stiffness),
                "{contact:?} {outcome:?}"
            );
            let off = (outcome.mean - SETPOINT).abs();
            if off > worst.0 {
                worst = (off, stiffness);
            }
            worst_peak = worst_peak.max((outcome.mean_peak - SETPOINT).abs());
            stiffness *= 1.03;
        }
        println!(
            "{drive:?}, counts {count} mm: |mean - f_d| at most {:.3} N, at {:.0} N/mm; of the peak {worst_peak:.3} N",
            worst.0, worst.1
        );
        assert!(worst.0 <= max, "{drive:?} {worst:?}");
        assert!(worst_peak <= 0.25, "{drive:?} {worst_peak}");
    }
}
