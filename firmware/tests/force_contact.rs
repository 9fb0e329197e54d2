//! The force loop on a contact.

mod contact;
use contact::*;
#[test]
fn explore() {
    println!("unguarded rigid");
    for k in [100.0, 200.0, 300.0, 340., 360., 383.0, 400., 420.0, 450., 500.0, 600.0, 800.0, 1000.0] {
        let c = Contact { guarded:false, approach: 1.0, time: 40.0, ..Contact::new(k) };
        let o = run(&c, |_, _, _, _| ());
        println!("k {k}: swing {:.3} earlier {:.3} mean {:.3}", o.swing, o.earlier_swing, o.mean);
    }
    for (m, d) in [(0.25, 0.5), (1.0, 5.0), (1.0,20.0), (1.0, 2.0)] {
    for stiction in [0.0, 0.002, 0.005] {
    for guarded in [true] {
        for drive in [Drive::Rigid, Drive::Servo, Drive::Lag { omega: 200.0 }] {
            for count in [0.0, 0.00125] {
                let mut worst = String::new();
                for k in [10.0, 20.0, 50.0, 100.0, 200.0, 300.0, 420.0, 500.0, 600.0, 800.0, 1000.0] {
                    for v in [1.0, 4.0] {
                    let c = Contact { guarded, drive, count, approach: v, mass: m, damping: d, stiction, ..Contact::new(k) };
                    let o = run(&c, |_, _, _, _| ());
                    let bound = DESIRED + 1.2 * (d * v + v * (m*k).sqrt());
                    let allowed = 0.2f64.max(2.0 * 0.00125 * k);
                      if o.first_peak>bound || o.swing>allowed || (o.mean-5.0).abs()>0.25 {
                    worst += &format!("   k {k} v {v}: first {:.1} / {bound:.1}, largest {:.1}, swing {:.3} (earlier {:.3}) / {allowed:.2}, mean {:.3}, level {}\n", o.first_peak, o.largest, o.swing, o.earlier_swing, o.mean, o.level);
                    if !guarded && k>=100.0 {break}
                    }
                    }
                }
                println!("{m} {d} stiction {stiction} guard {guarded} {drive:?} {count}:\n{worst}");
            }
        }
    }}}
}
