//! Chips of step drives that the board sets.

use haptimill_firmware::config::{ChipKind, Config, Drive, DriveChip};
use haptimill_machine_file::MachineFile;

const BENCH: &str = include_str!("../../../machines/bench.toml");

/// The chip of a joint of the bench.
fn chip(address: u8) -> String {
    format!(
        "\n[joint.drive.tmc2209]\naddress = {address}\nmicrosteps = 16\nrun_current_a = 0.8\n\
         hold_current_a = 0.4\n"
    )
}

/// The chip of a joint of the bench, in a chain.
fn link(position: u8) -> String {
    format!(
        "\n[joint.drive.tmc5160]\nposition = {position}\nmicrosteps = 16\nrun_current_a = 1.8\n\
         hold_current_a = 0.9\n"
    )
}

/// The bench with chips at these addresses, for the joints from the first one on.
fn bench(addresses: &[u8]) -> String {
    let chips: Vec<String> = addresses.iter().map(|address| chip(*address)).collect();
    bench_with(&chips)
}

/// The bench with chips at these positions of a chain.
fn chain(positions: &[u8]) -> String {
    let chips: Vec<String> = positions.iter().map(|position| link(*position)).collect();
    bench_with(&chips)
}

/// The bench with these sections behind the drives of its joints.
fn bench_with(sections: &[String]) -> String {
    let mut parts = BENCH.split("hold_us = 5.0\ndirection = 1\n");
    let mut text = parts.next().expect("a first part").to_string();
    for (joint, part) in parts.enumerate() {
        text.push_str("hold_us = 5.0\ndirection = 1\n");
        text.push_str(sections.get(joint).map_or("", String::as_str));
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
    let chips: Vec<_> = sent.joints.iter().map(|joint| joint.chip()).collect();
    let first = DriveChip {
        kind: ChipKind::Tmc2209,
        place: 3,
        microsteps: 16,
        run_ma: 800,
        hold_ma: 250,
        sense_mohm: 150,
    };
    let second = DriveChip {
        place: 0,
        hold_ma: 400,
        sense_mohm: 110,
        ..first
    };
    assert_eq!(chips, [Some(&first), Some(&second), None]);
    // A joint without a chip costs a byte.
    let plain = MachineFile::parse("bench.toml", BENCH).expect("the file of the repository");
    let (plain, _) = plain.encoded().expect("an encoding");
    assert!(bytes.len() <= plain.len() + 2 * 11, "{}", bytes.len());
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

/// A chain has other keys, and the controller gets the same kind of settings.
#[test]
fn the_settings_of_a_chain_reach_the_configuration() {
    let text = chain(&[1, 2, 0]).replacen(
        "hold_current_a = 0.9\n",
        "hold_current_a = 0.25\nsense_resistor_ohm = 0.05\n",
        1,
    );
    let machine = MachineFile::parse("bench.toml", &text).unwrap_or_else(|it| panic!("{it}"));
    let joints = machine.config.joints.iter();
    let chips: Vec<_> = joints.filter_map(|joint| joint.chip().copied()).collect();
    let first = DriveChip {
        kind: ChipKind::Tmc5160,
        place: 1,
        microsteps: 16,
        run_ma: 1800,
        hold_ma: 250,
        sense_mohm: 50,
    };
    let other = |place| DriveChip {
        place,
        hold_ma: 900,
        sense_mohm: 75,
        ..first
    };
    assert_eq!(chips, [first, other(2), other(0)]);
    assert_eq!(machine.config.check(), Ok(()));
}

/// Each mistake in a chain is one problem, at its last line with the text.
#[test]
fn problems_of_a_chain_are_named() {
    let sound = chain(&[0, 1, 2]);
    let refused = |text: &str, from: &str, to: &str, what: &str| {
        let at = text.rfind(from).expect("the text");
        let line = text[..at].matches('\n').count() + 1;
        let column = from.find(" = ").map_or(1, |key| key + 4);
        let text = format!("{}{to}{}", &text[..at], &text[at + from.len()..]);
        let expected = format!("bench.toml:{line}:{column}: joint[3].drive.{what}");
        assert_eq!(problems(&text), [expected]);
    };
    for (from, to, what) in [
        (
            "position = 2",
            "position = 5",
            "tmc5160.position: 5 is out of range, allowed is 0 to 4; lower it",
        ),
        (
            "position = 2",
            "position = 1",
            "tmc5160.position: 1 is the position of joint y; write another one",
        ),
        (
            "position = 2",
            "position = 3",
            "tmc5160.position: 3 is behind a gap: no joint has the chip at position 2; number the \
             chips from 0 on, and leave those without a joint out of the chain",
        ),
        (
            "microsteps = 16\nrun",
            "microsteps = 12\nrun",
            "tmc5160.microsteps: 12 is no power of two; write 1, 2, 4, 8, 16, 32, 64, 128 or 256",
        ),
        (
            "run_current_a = 1.8",
            "run_current_a = 3.1",
            "tmc5160.run_current_a: 3.1 A is beyond what the chip regulates with 0.075 ohm, 0.383 \
             to 3.064 A; correct it, or sense_resistor_ohm",
        ),
        (
            "hold_current_a = 0.9",
            "hold_current_a = 1.9",
            "tmc5160.hold_current_a: 1.9 A is above run_current_a = 1.8; lower it",
        ),
    ] {
        refused(&sound, from, to, what);
    }
    // Both kinds, of two joints and of one joint.
    let mixed = bench_with(&[link(0), link(1), chip(0)]);
    let at = mixed.find("[joint.drive.tmc2209]").expect("the section");
    let line = mixed[..at].matches('\n').count() + 1;
    assert_eq!(
        problems(&mixed),
        [format!(
            "bench.toml:{line}:1: joint[3].drive.tmc2209: is another kind of chip than \
             [joint.drive.tmc5160] of x; no board has the buses of both: use chips of one kind, \
             and set the others by their switches"
        )]
    );
    let both = bench_with(&[chip(0) + &link(0)]);
    let both = problems(&both);
    assert_eq!(both.len(), 1, "{both:?}");
    assert!(
        both[0].contains(
            "joint[1].drive.tmc5160: is a second chip beside [joint.drive.tmc2209]; remove one"
        ),
        "{both:?}"
    );
    let kept = sound.replacen(
        "direction = 1\n",
        "direction = 1\nkeeps_position = true\n",
        1,
    );
    let kept = problems(&kept);
    assert_eq!(kept.len(), 1, "{kept:?}");
    assert!(
        kept[0].contains("and a TMC5160 loses its electrical angle with its supply"),
        "{kept:?}"
    );
}

/// Changes the chip of the first joint of a sound configuration; the controller refuses it.
fn assert_refused(sound: &Config, changes: &[fn(&mut DriveChip)]) {
    assert!(sound.check().is_ok());
    for (index, change) in changes.iter().enumerate() {
        let mut config = sound.clone();
        if let Drive::Steps {
            chip: Some(chip), ..
        } = &mut config.joints[0].drive
        {
            change(chip);
        }
        assert_ne!(config, *sound);
        assert!(config.check().is_err(), "change {index}");
    }
}

/// The controller checks what it gets, whoever made it.
#[test]
fn the_controller_refuses_settings_that_a_chip_does_not_have() {
    let config = |text: &str| {
        let machine = MachineFile::parse("bench.toml", text);
        machine.unwrap_or_else(|it| panic!("{it}")).config
    };
    assert_refused(
        &config(&bench(&[0, 1])),
        &[
            |chip| chip.place = 4,
            |chip| chip.place = 1,
            |chip| chip.microsteps = 0,
            |chip| chip.microsteps = 512,
            |chip| chip.run_ma = 1768,
            |chip| chip.run_ma = 30,
            |chip| chip.hold_ma = 801,
            |chip| chip.sense_mohm = 0,
            |chip| chip.kind = ChipKind::Tmc5160,
        ],
    );
    assert_refused(
        &config(&chain(&[0, 1])),
        &[
            |chip| chip.place = 1,
            |chip| chip.place = 2,
            |chip| chip.run_ma = 3065,
            |chip| chip.run_ma = 383,
            |chip| chip.hold_ma = 1801,
            |chip| chip.kind = ChipKind::Tmc2209,
        ],
    );
}
