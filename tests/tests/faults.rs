mod scene;
use scene::*;
use haptimill_hil_sim::encoder::EncoderCondition;
use haptimill_hil_sim::plant::JointCondition;

#[test]
fn explore() {
    for joint in [0, 3, 4] {
        for speed in [0.0, 4.0, 40.0, -40.0] {
            for what in 0..10 {
                let mut bench = moving(speed);
                let plant = bench.rig.plant_mut();
                let enc = |c| c;
                let e: EncoderCondition = Default::default();
                let c: JointCondition = Default::default();
                let name = match what {
                    0 => { plant.set_encoder_condition(joint, enc(EncoderCondition { swapped: true, ..e })); "swapped" }
                    1 => { plant.set_encoder_condition(joint, EncoderCondition { stuck_a: Some(true), ..e }); "stuck a" }
                    2 => { plant.set_encoder_condition(joint, EncoderCondition { stuck_b: Some(false), ..e }); "stuck b" }
                    3 => { plant.set_encoder_condition(joint, EncoderCondition { noise_hz: 5000.0, ..e }); "noise" }
                    4 => { plant.set_condition(joint, JointCondition { drive_gain: 0.0, ..c }); "dead" }
                    5 => { plant.set_condition(joint, JointCondition { drive_gain: -1.0, ..c }); "reversed drive" }
                    6 => { plant.set_condition(joint, JointCondition { jam: f64::INFINITY, ..c }); "jam" }
                    7 => { plant.set_condition(joint, JointCondition { jam: 400.0, ..c }); "jam400" }
                    8 => { plant.set_load(joint, if joint == 4 {25.0} else {600.0}); "push" }
                    _ => { plant.set_condition(joint, JointCondition { drive_tripped: true, ..c }); "trip" }
                };
                let (mut off, mut at) = (0.0_f64, None);
                let mut coast = 0.0_f64;
                for p in 0..4000 {
                    bench.step();
                    coast = coast.max(joint_off(&bench, joint));
                    if at.is_none() { off = off.max(joint_off(&bench, joint)); if drives_off(&bench) { at = Some(p); } }
                }
                println!("{joint} {speed:4} {name:10} at {at:?} off {off:.3} coasted to {coast:.3} kept {} {:?}", bench.rig.control().safety().position_kept(), bench.rig.control().safety().fault());
            }
        }
    }
}
