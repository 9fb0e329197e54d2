//! The force loop on a contact.

mod contact;
use contact::*;
#[test]
fn explore() {
    for guarded in [false, true] {
        for drive in [Drive::Rigid, Drive::Lag { omega: 200.0 }] {
            for count in [0.0, 0.00125] {
                for k in [20.0, 50.0, 100.0, 200.0, 300.0, 383.0, 420.0, 500.0, 600.0, 800.0, 1000.0, 1500.0] {
                    for v in [1.0, 4.0] {
                    let c = Contact { guarded, drive, count, approach: v, ..Contact::new(k) };
                    let o = run(&c, |_, _, _, _| ());
                    let bound = DESIRED + 1.2 * (5.0 * v + v * k.sqrt());
                    let allowed = 0.2f64.max(2.0 * 0.00125 * k);
                    println!("{guarded} {drive:?} count {count} k {k} v {v}: first {:.1} / {bound:.1}, largest {:.1}, swing {:.3} (earlier {:.3}) / {allowed:.2}, mean {:.3}, level {} {}", o.first_peak, o.largest, o.swing, o.earlier_swing, o.mean, o.level,
                      if o.first_peak>bound || o.swing>allowed || (o.mean-5.0).abs()>0.25 {"XXX"} else {""});
                    }
                }
            }
        }
    }
}
