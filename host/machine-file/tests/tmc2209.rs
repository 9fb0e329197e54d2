//! Chips of step drives that the board sets.

use haptimill_firmware::config::{Config, Tmc2209};
use haptimill_machine_file::MachineFile;

const BENCH: &str = include_str!("../../../machines/bench.toml");

/// The chip of a joint of the bench.
fn chip(address: u8) -> String {
    format!(
        "\n[joint.drive.tmc2209]\naddress = {address}\nmicrosteps = 16\nrun_current_a = 0.8\n\
         hold_current_a = 0.4\n"
    )
}

/// The bench with chips at these addresses, for the joints from the first one on.
fn bench(addresses: &[u8]) -> String {
    let mut parts = BENCH.split("hold_us = 5.0\ndirection = 1\n");
    let mut text = parts.next().expect("a first part").to_string();
    for (joint, part) in parts.enumerate() {
        text.push_str("hold_us = 5.0\ndirection = 1\n");
        text.push_str(
            &addresses
                .get(joint)
                .map_or_else(String::new, |it| chip(*it)),
        );
        text.push_str(part);
    }
    text
}

fn problems(text: &str) -> Vec<String> {
    let problems = MachineFile::parse("bench.toml", text).expect_err("a mistake");
    problems.0.iter().map(ToString::to_string).collect()
}

#[test]
fn the_settings_of_a_chip_reach_the_configuration_of_its_joint() {
    let text = bench(&[3, 0]).replacen(
        "hold_current_a = 0.4\n",
        "hold_current_a = 0.25\nsense_resistor_ohm = 0.15\n",
        1,
    );
    let machine = MachineFile::parse("bench.toml", &text).unwrap_or_else(|it| panic!("{it}"));
    let (bytes, _) = machine.encoded().expect("an encoding");
    let sent: Config = postcard::from_bytes(&bytes).expect("the same type");
    let chips: Vec<_> = sent.joints.iter().map(|joint| joint.tmc2209()).collect();
    let first = Tmc2209 {
        address: 3,
        microsteps: 16,
        run_ma: 800,
        hold_ma: 250,
        sense_mohm: 150,
    };
    let second = Tmc2209 {
        address: 0,
        hold_ma: 400,
        sense_mohm: 110,
        ..first
    };
    assert_eq!(chips, [Some(&first), Some(&second), None]);
    // A joint without a chip costs a byte.
    let plain = MachineFile::parse("bench.toml", BENCH).expect("the file of the repository");
    let (plain, _) = plain.encoded().expect("an encoding");
    assert!(bytes.len() <= plain.len() + 2 * 10, "{}", bytes.len());
}

/// Each mistake is one problem, with its line, its key and its remedy.
#[test]
fn problems_of_a_chip_are_named() {
    let text = bench(&[0, 1]);
    let line = |key: &str| {
        text[..text.find(key).expect("the key")]
            .matches('\n')
            .count()
            + 1
    };
    for (from, to, column, expected) in [
        (
            "address = 0",
            "address = 4",
            11,
            "joint[1].drive.tmc2209.address: 4 is out of range, allowed is 0 to 3; lower it",
        ),
        (
            "microsteps = 16",
            "microsteps = 12",
            14,
            "joint[1].drive.tmc2209.microsteps: 12 is no power of two; write 1, 2, 4, 8, 16, 32, \
             64, 128 or 256",
        ),
        (
            "microsteps = 16",
            "microsteps = 8",
            14,
            "joint[1].drive.tmc2209.microsteps: 8 microsteps of 200 full steps are 1600 steps per \
             turn, not steps_per_turn = 3200; correct it, full_steps_per_turn, or steps_per_turn \
             of [joint.drive]",
        ),
        (
            "run_current_a = 0.8",
            "run_current_a = 1.9",
            17,
            "joint[1].drive.tmc2209.run_current_a: 1.9 A is beyond what the chip regulates with \
             0.11 ohm, 0.031 to 1.768 A; correct it, or sense_resistor_ohm",
        ),
        (
            "run_current_a = 0.8",
            "run_current_a = 2.1",
            17,
            "joint[1].drive.tmc2209.run_current_a: 2.1 is out of range, allowed is 0.01 to 2 A; \
             lower it",
        ),
        (
            "hold_current_a = 0.4",
            "hold_current_a = 0.9",
            18,
            "joint[1].drive.tmc2209.hold_current_a: 0.9 A is above run_current_a = 0.8; lower it",
        ),
    ] {
        let found = problems(&text.replacen(from, to, 1));
        let key = from.split(" = ").next().expect("a key");
        let place = line(&format!("\n{key}")) + 1;
        assert_eq!(found, [format!("bench.toml:{place}:{column}: {expected}")]);
    }
    // A motor of 400 full steps, in its own key.
    let fine = text.replacen(
        "microsteps = 16\nrun",
        "microsteps = 8\nfull_steps_per_turn = 400\nrun",
        1,
    );
    assert!(MachineFile::parse("bench.toml", &fine).is_ok());
    let missing = problems(&text.replacen("run_current_a = 0.8\n", "", 1));
    assert_eq!(missing.len(), 1, "{missing:?}");
    assert!(missing[0].contains("run_current_a: is missing"));
    let unknown = problems(&text.replacen("run_current_a", "run_current_ma", 1));
    assert_eq!(unknown.len(), 1, "{unknown:?}");
    // Without power the chip loses what a joint needs that keeps its position.
    let kept = text.replacen(
        "direction = 1\n",
        "direction = 1\nkeeps_position = true\n",
        1,
    );
    let place = line("direction = 1\n") + 1;
    assert_eq!(
        problems(&kept),
        [format!(
            "bench.toml:{place}:18: joint[1].drive.keeps_position: is true, and a TMC2209 loses its \
             electrical angle with its supply; remove it"
        )]
    );
    // A torque drive has no such chip.
    const MILL: &str = include_str!("../../../machines/h4.toml");
    let torque = MILL.replacen("\n[joint.law]", &format!("{}\n[joint.law]", chip(0)), 1);
    let torque = problems(&torque);
    assert_eq!(torque.len(), 1, "{torque:?}");
    assert!(torque[0].contains("joint[1].drive.tmc2209: is not a known key"));
}

#[test]
fn two_chips_with_one_address_are_refused_at_the_second_one() {
    let text = bench(&[2, 0, 2]);
    let at = text.rfind("address = 2").expect("the address of z");
    let line = text[..at].matches('\n').count() + 1;
    assert_eq!(
        problems(&text),
        [format!(
            "bench.toml:{line}:11: joint[3].drive.tmc2209.address: 2 is the address of joint x; \
             write another one, and set the pins MS1 and MS2 of the chip to it"
        )]
    );
}

/// The controller checks what it gets, whoever made it.
#[test]
fn the_controller_refuses_settings_that_a_chip_does_not_have() {
    let machine = MachineFile::parse("bench.toml", &bench(&[0, 1]));
    let sound = machine.unwrap_or_else(|it| panic!("{it}")).config;
    assert!(sound.check().is_ok());
    let changes: [fn(&mut Tmc2209); 8] = [
        |chip| chip.address = 4,
        |chip| chip.address = 1,
        |chip| chip.microsteps = 0,
        |chip| chip.microsteps = 512,
        |chip| chip.run_ma = 1768,
        |chip| chip.run_ma = 30,
        |chip| chip.hold_ma = 801,
        |chip| chip.sense_mohm = 0,
    ];
    for (index, change) in changes.iter().enumerate() {
        let mut config = sound.clone();
        if let haptimill_firmware::config::Drive::Steps {
            tmc2209: Some(chip),
            ..
        } = &mut config.joints[0].drive
        {
            change(chip);
        }
        assert_ne!(config, sound);
        assert!(config.check().is_err(), "change {index}");
    }
}
