//! The USB of the image: what a host sees of it, and what it does with a host that errs.

mod common;

use common::image;
use haptimill_emulator::chip::Chip;
use rp2350_emu::peripherals::usb::UsbAnswer;

/// Address that the host of the emulator gives.
const ADDRESS: u8 = 5;
/// Cycles within which a device must have answered.
const PATIENCE: u64 = 150 * 50_000;

/// Standard requests.
const DEVICE_DESCRIPTOR: [u8; 8] = [0x80, 6, 0, 1, 0, 0, 18, 0];
const CONFIGURATION: [u8; 8] = [0x80, 6, 0, 2, 0, 0, 255, 0];
/// Hosts ask a device of USB 2.1 for it.
const CAPABILITIES: [u8; 8] = [0x80, 6, 0, 15, 0, 0, 5, 0];
/// A device that is only full-speed has none, and must refuse it.
const QUALIFIER: [u8; 8] = [0x80, 6, 0, 6, 0, 0, 10, 0];
const GET_LINE_CODING: [u8; 8] = [0xA1, 0x21, 0, 0, 0, 0, 7, 0];
const SET_LINE_CODING: [u8; 8] = [0x21, 0x20, 0, 0, 0, 0, 7, 0];

/// A chip whose serial port is open, with this number.
fn open(number: u64) -> Chip {
    let mut chip = Chip::with_quantum(&image(), 2).expect("an emulator");
    chip.set_register(0x4013_0000, number as u32);
    chip.set_register(0x4013_0004, (number >> 32) as u32);
    let end = 150 * 200_000;
    while !chip.usb_host.is_open() {
        chip.cycle().expect("the emulator runs");
        assert!(chip.cycles() < end, "the host has not opened the port");
    }
    chip.usb_host.pause();
    chip
}

fn run(chip: &mut Chip, microseconds: u64) {
    let end = chip.cycles() + 150 * microseconds;
    while chip.cycles() < end {
        chip.cycle().expect("the emulator runs");
    }
}

/// Repeats a transaction while the device is not ready.
fn settle(chip: &mut Chip, act: impl Fn(&mut Chip) -> UsbAnswer) -> UsbAnswer {
    let end = chip.cycles() + PATIENCE;
    loop {
        match act(chip) {
            UsbAnswer::Nak => assert!(chip.cycles() < end, "the device is never ready"),
            answer => return answer,
        }
        run(chip, 5);
    }
}

fn setup(chip: &mut Chip, packet: [u8; 8]) {
    let answer = chip.usb(|device| device.setup(ADDRESS, packet));
    assert_eq!(answer, UsbAnswer::Ack);
}

/// The data of an IN request; `None` if the device refuses it.
fn read(chip: &mut Chip, packet: [u8; 8]) -> Option<Vec<u8>> {
    setup(chip, packet);
    // A host that has given up a transfer takes longer than that for its next packet.
    run(chip, 50);
    let requested = usize::from(packet[6]);
    let mut data = Vec::new();
    let mut expected = true;
    loop {
        match settle(chip, |chip| chip.usb(|device| device.transmit(ADDRESS, 0))) {
            UsbAnswer::Data { toggle, bytes } => {
                assert_eq!(toggle, expected);
                expected = !expected;
                data.extend(&bytes);
                if bytes.len() < 64 || data.len() >= requested {
                    break;
                }
            }
            UsbAnswer::Stall => return None,
            answer => panic!("{answer:?}"),
        }
    }
    let status = settle(chip, |chip| {
        chip.usb(|device| device.receive(ADDRESS, 0, true, &[]))
    });
    assert_eq!(status, UsbAnswer::Ack);
    Some(data)
}

#[test]
fn a_host_finds_a_serial_port_with_the_number_of_the_chip() {
    let mut chip = open(0x0123_4567_89AB_CDEF);
    let description = &chip.usb_host.description;
    assert_eq!(description.ids, (0x2E8A, 0x0009));
    let names: Vec<&str> = description.names.iter().map(String::as_str).collect();
    assert_eq!(names, ["Haptimill", "Haptimill Pico 2", "0123456789ABCDEF"]);
    assert_eq!(chip.wrong_usb_writes(), 0);
    // The number of the same descriptor as a whole: 18 bytes, 64 in a packet, one configuration.
    let device = read(&mut chip, DEVICE_DESCRIPTOR).expect("a device descriptor");
    assert_eq!((device.len(), device[7], device[17]), (18, 64, 1));
    let capabilities = read(&mut chip, CAPABILITIES).expect("device capabilities");
    assert_eq!(capabilities[..2], [5, 15]);
    let configuration = read(&mut chip, CONFIGURATION).expect("a configuration");
    assert_eq!(
        configuration.len(),
        usize::from(u16::from_le_bytes([configuration[2], configuration[3]]))
    );
}

#[test]
fn a_request_that_is_refused_does_not_disturb_the_next() {
    let mut chip = open(0);
    assert_eq!(read(&mut chip, QUALIFIER), None);
    assert_eq!(read(&mut chip, QUALIFIER), None);
    // The host of the emulator has set 1,000,000 baud, 8 bits, no parity.
    let coding = [0x40, 0x42, 0x0F, 0, 0, 0, 8];
    assert_eq!(
        read(&mut chip, GET_LINE_CODING).as_deref(),
        Some(&coding[..])
    );
    assert_eq!(chip.wrong_usb_writes(), 0);
}

/// A host may give up a transfer at any packet, and begin the next one.
#[test]
fn a_transfer_that_the_host_gives_up_does_not_disturb_the_next() {
    let mut chip = open(0);
    // After SETUP; also before the device has seen it.
    for pause in [0, 3, 400] {
        setup(&mut chip, CONFIGURATION);
        run(&mut chip, pause);
        assert_eq!(
            read(&mut chip, DEVICE_DESCRIPTOR).map(|it| it.len()),
            Some(18)
        );
    }
    // After the first packet of two.
    setup(&mut chip, CONFIGURATION);
    let first = settle(&mut chip, |chip| chip.usb(|it| it.transmit(ADDRESS, 0)));
    assert!(matches!(first, UsbAnswer::Data { bytes, .. } if bytes.len() == 64));
    run(&mut chip, 400);
    assert_eq!(
        read(&mut chip, DEVICE_DESCRIPTOR).map(|it| it.len()),
        Some(18)
    );
    // Data to the device that never come.
    setup(&mut chip, SET_LINE_CODING);
    run(&mut chip, 400);
    assert_eq!(
        read(&mut chip, DEVICE_DESCRIPTOR).map(|it| it.len()),
        Some(18)
    );
    // Data that come right after SETUP, before the device has seen either.
    let coding = [0x80, 0x25, 0, 0, 0, 0, 7];
    setup(&mut chip, SET_LINE_CODING);
    let taken = settle(&mut chip, |chip| {
        chip.usb(|it| it.receive(ADDRESS, 0, true, &coding))
    });
    assert_eq!(taken, UsbAnswer::Ack);
    let status = settle(&mut chip, |chip| chip.usb(|it| it.transmit(ADDRESS, 0)));
    assert_eq!(
        status,
        UsbAnswer::Data {
            toggle: true,
            bytes: vec![]
        }
    );
    assert_eq!(
        read(&mut chip, GET_LINE_CODING).as_deref(),
        Some(&coding[..])
    );
    assert_eq!(chip.wrong_usb_writes(), 0);
}

/// A cleared halt begins with the first data toggle, and the port works on.
#[test]
fn a_halt_of_the_serial_port_is_cleared() {
    let mut chip = open(0);
    let (into, from) = chip.usb_host.description.data;
    for (feature, expected) in [(3, true), (1, false)] {
        for endpoint in [into | 0x80, from] {
            setup(&mut chip, [0x02, feature, 0, 0, endpoint, 0, 0, 0]);
            let status = settle(&mut chip, |chip| chip.usb(|it| it.transmit(ADDRESS, 0)));
            assert_eq!(
                status,
                UsbAnswer::Data {
                    toggle: true,
                    bytes: vec![]
                }
            );
            let state = read(&mut chip, [0x82, 0, 0, 0, endpoint, 0, 2, 0]);
            assert_eq!(state, Some(vec![u8::from(expected), 0]));
        }
    }
    let sent = settle(&mut chip, |chip| {
        chip.usb(|it| it.receive(ADDRESS, from, false, &[0; 3]))
    });
    assert_eq!(sent, UsbAnswer::Ack);
}
