//! The haptic arm in the rig: its sensors, its motors and its faults as a controller sees them.

use crate::machine;
use haptimill_firmware::io::{HapticOutputs, Inputs, Outputs};
use haptimill_hil_sim::haptics::HapticConfig;
use haptimill_hil_sim::operator::{OperatorConfig, Stroke, Trajectory};
use haptimill_hil_sim::{Control, Fault, PlantConfig, Rig, RigOptions};

/// A controller that records its inputs and puts fixed codes on the first leg.
#[derive(Default)]
struct Remembers {
    code: i16,
    seen: Vec<haptimill_firmware::io::HapticInputs>,
}

impl Control for Remembers {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.seen.push(inputs.haptic);
        outputs.haptic = HapticOutputs {
            enabled: true,
            ..HapticOutputs::default()
        };
        outputs.haptic.currents[0][0] = self.code;
    }
}

fn config() -> PlantConfig {
    PlantConfig {
        haptic: Some(HapticConfig::default()),
        operator: Some(OperatorConfig::default()),
        ..machine::slide()
    }
}

fn rig(code: i16, faults: &[&str]) -> Rig<Remembers> {
    let options = RigOptions {
        faults: faults
            .iter()
            .map(|text| text.parse::<Fault>().expect(text))
            .collect(),
        ..RigOptions::default()
    };
    let control = Remembers {
        code,
        ..Remembers::default()
    };
    let mut rig = Rig::new(&config(), &options, control).expect("fine");
    let arm = rig.plant_mut().haptic_mut().expect("has one");
    arm.set_enabling_switch(true);
    arm.set_trajectory(Trajectory::Strokes(vec![Stroke {
        at_s: 0.05,
        to_mm: [8.0, 5.0, -6.0],
        pace_mm_s: 20.0,
        quarters: [1.0; 4],
        ramp_s: 0.1,
        stop_s: 0.0,
    }]));
    rig
}

fn run(mut rig: Rig<Remembers>, seconds: f64) -> Rig<Remembers> {
    for _ in 0..(seconds / 200e-6) as usize {
        rig.step();
    }
    rig
}

#[test]
fn the_controller_measures_the_motion_of_the_hand() {
    let rig = run(rig(0, &[]), 1.0);
    let seen = &rig.control().seen;
    assert_eq!(seen[0].legs[0].counts, [0; 3]);
    assert!(seen[0].enabling_switch && seen[0].drives_ready);
    let last = seen.last().expect("some");
    let truth = rig.plant().haptic().expect("has one").truth();
    assert!((truth.tip[0] - 8.0).abs() < 1.0, "{:?}", truth.tip);
    for leg in last.legs {
        assert!(
            leg.counts[0].abs() > 200 && leg.illegal == [0; 3],
            "{leg:?}"
        );
    }
}

/// Outputs take effect in the next period.
#[test]
fn codes_take_effect_a_period_later() {
    let pushes = |periods: usize| {
        let mut rig = rig(4096, &[]);
        for _ in 0..periods {
            rig.step();
        }
        rig.plant().haptic().expect("has one").truth().motors[0][0]
    };
    assert_eq!(pushes(1), 0.0);
    assert!(pushes(2) > 1.0);
    // 4096 of 8192 codes are half of the full scale of 20 N.
    assert!((pushes(40) - 10.0).abs() < 1e-3, "{}", pushes(40));
}

#[test]
fn faults_act_on_their_encoder_only() {
    let healthy = run(rig(0, &[]), 1.0);
    let faulty = run(
        rig(
            0,
            &[
                "haptic-encoder-stuck leg=1 sensor=slide channel=a level=low at=100ms",
                "haptic-encoder-swapped leg=2 sensor=turn",
                "haptic-encoder-slip leg=3 sensor=hinge counts=-700 at=0.5s",
                "haptic-encoder-dropped leg=3 sensor=slide at=0.3s",
                "haptic-encoder-noise leg=1 sensor=turn per-second=2000",
                "haptic-amplifiers-tripped at=0.6s for=0.1s",
            ],
        ),
        1.0,
    );
    let (reference, ours) = (&healthy.control().seen, &faulty.control().seen);
    let counts = |seen: &[haptimill_firmware::io::HapticInputs],
                  at: usize,
                  leg: usize,
                  sensor: usize| { seen[at].legs[leg].counts[sensor] };
    let end = reference.len() - 1;
    let before = counts(ours, 500, 0, 0);
    assert!(
        (counts(ours, end, 0, 0) - before).abs() <= 2
            && (counts(reference, end, 0, 0) - before).abs() > 50
    );
    assert!(
        (counts(ours, end, 1, 1) + counts(reference, end, 1, 1)).abs() <= 2
            && counts(reference, end, 1, 1).abs() > 50
    );
    assert_eq!(counts(ours, 2400, 2, 2), counts(reference, 2400, 2, 2));
    assert_eq!(counts(ours, end, 2, 2), counts(reference, end, 2, 2) - 700);
    assert!((counts(ours, end, 2, 0) - counts(ours, 1505, 2, 0)).abs() <= 1);
    assert!(
        ours[end].legs[0].illegal[1] > 100,
        "noise on both channels at once"
    );
    assert!(reference.iter().all(|seen| seen.drives_ready));
    assert!(ours[2999].drives_ready && !ours[3200].drives_ready && ours[3600].drives_ready);
}

#[test]
fn an_emergency_stop_removes_the_force_at_the_hand() {
    let mut rig = run(rig(4096, &["emergency-stop at=20ms"]), 0.05);
    rig.step();
    let arm = rig.plant().haptic().expect("has one");
    assert!(arm.truth().motors[0][0].abs() < 1e-6);
    assert!(!rig.control().seen.last().expect("some").drives_ready);
}

#[test]
fn invalid_sections_are_reported() {
    let refused = |text: &str| -> String {
        let options = RigOptions {
            faults: vec![text.parse::<Fault>().expect(text)],
            ..RigOptions::default()
        };
        let error = Rig::new(&config(), &options, Remembers::default()).err();
        error.expect(text).to_string()
    };
    assert!(refused("haptic-encoder-swapped leg=4 sensor=turn").contains("no leg 4"));
    assert!(refused("haptic-encoder-noise leg=1 sensor=turn per-second=-1").contains("-1"));
    assert!(
        "haptic-encoder-stuck leg=1 sensor=wrist channel=a level=low"
            .parse::<Fault>()
            .is_err()
    );
    let lonely = PlantConfig {
        haptic: None,
        ..config()
    };
    let problems = lonely.check(200).expect_err("nothing to hold");
    assert!(problems[0].problem.contains("plant.haptic"), "{problems:?}");
}

#[test]
fn sections_of_a_machine_file_are_parsed() {
    let mut text = include_str!("refg.toml").to_owned();
    text.push_str(
        "\n[plant.haptic]\nbalance = 0.9\n[plant.haptic.geometry]\nlink_mm = 201.0\n[plant.operator]\nmass_kg = 0.3\n",
    );
    #[derive(serde::Deserialize)]
    struct File {
        plant: PlantConfig,
    }
    let plant = toml::from_str::<File>(&text).expect("reads").plant;
    let haptic = plant.haptic.expect("there");
    assert_eq!(
        (
            haptic.balance,
            haptic.geometry.link_mm,
            haptic.geometry.base_radius_mm
        ),
        (0.9, 201.0, 150.0)
    );
    assert_eq!(plant.operator.expect("there").mass_kg, 0.3);
}
