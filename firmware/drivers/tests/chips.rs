//! The bytes that the drivers exchange with their chips, against datagrams composed from the data
//! sheets.

use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as PinTransaction};
use embedded_hal_mock::eh1::pwm::{Mock as Pwm, Transaction as PwmTransaction};
use embedded_hal_mock::eh1::serial::{Mock as Serial, Transaction as SerialTransaction};
use embedded_hal_mock::eh1::spi::{Mock as Spi, Transaction as SpiTransaction};
use haptimill_drivers::ad5644::Ad5644;
use haptimill_drivers::ads8688::{self, Ads8688, Range};
use haptimill_drivers::shift_register::{read_inputs, write_outputs};
use haptimill_drivers::spindle::{Curve, CurveError, Spindle};
use haptimill_drivers::tmc2209::{self, Bus, Error, Settings, check_byte};
use haptimill_drivers::{CurrentError, Currents, MicrostepError, SettingError, Trouble};
use std::pin::pin;
use std::task::{Context, Poll, Waker};

/// The wire is silent before a datagram; the board then receives each byte that it sends.
fn echoed(bytes: &[u8]) -> Vec<SerialTransaction<u8>> {
    let mut all = bytes.to_vec();
    all.push(check_byte(bytes));
    let silence = SerialTransaction::read_error(nb::Error::WouldBlock);
    let sent = all.iter().copied().map(SerialTransaction::write);
    let seen = all.iter().copied().map(SerialTransaction::read);
    [silence].into_iter().chain(sent).chain(seen).collect()
}

fn reading(address: u8, register: u8, value: u32) -> Vec<SerialTransaction<u8>> {
    let mut all = echoed(&[0x05, address, register]);
    let [a, b, c, d] = value.to_be_bytes();
    let reply = [0x05, 0xFF, register, a, b, c, d];
    let check = check_byte(&reply);
    all.extend(
        reply
            .into_iter()
            .chain([check])
            .map(SerialTransaction::read),
    );
    all
}

fn writing(address: u8, register: u8, value: u32) -> Vec<SerialTransaction<u8>> {
    let [a, b, c, d] = value.to_be_bytes();
    echoed(&[0x05, address, register | 0x80, a, b, c, d])
}

/// Time between two looks at the clock, us: the wire is silent for 16 bit times at the first one.
const LOOK_US: u32 = 200;

fn bus(expected: &[SerialTransaction<u8>]) -> (Bus<Serial<u8>, impl FnMut() -> u32>, Serial<u8>) {
    bus_with(115_200, expected)
}

fn bus_with(
    baud: u32,
    expected: &[SerialTransaction<u8>],
) -> (Bus<Serial<u8>, impl FnMut() -> u32>, Serial<u8>) {
    let serial = Serial::new(expected);
    // The count wraps around soon.
    let mut now = u32::MAX - 10 * LOOK_US;
    let clock = move || {
        now = now.wrapping_add(LOOK_US);
        now
    };
    (Bus::new(serial.clone(), clock, 1, baud), serial)
}

/// Polls a future until it is ready, as a main loop does.
fn finish<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    for _ in 0..1000 {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
    }
    panic!("the future never ends")
}

const SMALL: Currents = Currents {
    run_ma: 800,
    hold_ma: 400,
    sense_mohm: 110,
};

#[test]
fn the_check_of_the_tmc2209_is_the_one_of_its_data_sheet() {
    // Bit by bit over the message, as in chapter 4.2 of the data sheet, written independently.
    let reference = |bytes: &[u8]| {
        let mut check = 0_u16;
        for bit in bytes
            .iter()
            .flat_map(|byte| (0..8).map(move |bit| byte >> bit & 1))
        {
            check = (check << 1)
                ^ if (check >> 7) as u8 & 1 != bit {
                    0x107
                } else {
                    0
                };
            check &= 0xFF;
        }
        check as u8
    };
    for bytes in [
        &[0x05_u8, 0, 0][..],
        &[5, 0, 0x80, 0, 0, 1, 0xC0],
        &[5, 3, 0x6F],
    ] {
        assert_eq!(check_byte(bytes), reference(bytes));
    }
    // A read of GCONF of driver 0, a datagram that is often printed.
    assert_eq!(check_byte(&[0x05, 0x00, 0x00]), 0x48);
    // A request and the reply of a real chip, as its users published them: IOIN with version 33.
    assert_eq!(check_byte(&[0x55, 0x00, 0x06]), 0xE8);
    assert_eq!(
        check_byte(&[0x05, 0xFF, 0x06, 0x21, 0x00, 0x02, 0x41]),
        0x9D
    );
}

/// What a chip answers to the configuration with [`SMALL`] and 16 microsteps.
fn configuring(address: u8, general: u32, chopper: u32, count: u8) -> Vec<SerialTransaction<u8>> {
    let mut all = reading(address, 0x06, 0x2100_0000);
    all.extend(reading(address, 0x02, 254));
    // Replies 3 * 8 bit times after their requests.
    all.extend(writing(address, 0x03, 0x200));
    all.extend(writing(address, 0x00, 0x1C0));
    // 16 microsteps are code 4; vsense is bit 17.
    all.extend(writing(address, 0x6C, 0x1402_0053));
    // 800 mA in the range of 180 mV: (c + 1) / 32 * 180 mV / 130 mOhm / sqrt 2 = 30.6 mA (c + 1),
    // so code 25 is 795 mA, and code 12 is 397 mA.
    all.extend(writing(address, 0x10, 6 << 16 | 25 << 8 | 12));
    all.extend(writing(address, 0x01, 0b111));
    all.extend(reading(address, 0x02, u32::from(count)));
    all.extend(reading(address, 0x00, general));
    all.extend(reading(address, 0x6C, chopper));
    all
}

fn small() -> Settings {
    Settings::new(SMALL, 16).expect("settings of the chip")
}

#[test]
fn the_tmc2209_is_configured() {
    let mut expected = configuring(2, 0x1C0, 0x1402_0053, 3);
    expected.extend(reading(2, 0x01, 0));
    expected.extend(reading(2, 0x6F, 0x8000_0000));
    let (mut bus, mut serial) = bus(&expected);
    assert_eq!(finish(bus.configure(2, &small())), Ok(()));
    serial.done();
}

#[test]
fn a_tmc2209_that_does_not_take_its_settings_is_found() {
    let configured = |expected: &[SerialTransaction<u8>]| {
        let (mut bus, mut serial) = bus(expected);
        let error = finish(bus.configure(2, &small())).unwrap_err();
        serial.done();
        error
    };
    // The counter of writes is one too low: the last two reads are not made.
    let lost = configuring(2, 0x1C0, 0x1402_0053, 2);
    let reads = 2 * reading(2, 0, 0).len();
    assert_eq!(configured(&lost[..lost.len() - reads]), Error::NotTaken);
    let found = Error::ReadBack {
        register: 0x6C,
        found: 0x1000_0053,
    };
    assert_eq!(configured(&configuring(2, 0x1C0, 0x1000_0053, 3)), found);
    let general = configuring(2, 0x101, 0, 3);
    let found = Error::ReadBack {
        register: 0,
        found: 0x101,
    };
    let read = general.len() - reads / 2;
    assert_eq!(configured(&general[..read]), found);
    // A chip that was reset meanwhile.
    let mut reset = configuring(2, 0x1C0, 0x1402_0053, 3);
    reset.extend(reading(2, 0x01, 1));
    reset.extend(reading(2, 0x6F, 0));
    assert_eq!(configured(&reset), Error::Trouble(Trouble::Reset));
    let other = reading(2, 0x06, 0x2000_0000);
    assert_eq!(configured(&other), Error::Version(0x20));
}

#[test]
fn the_replies_of_all_chips_are_separated_without_a_read() {
    let expected: Vec<_> = (0..4).flat_map(|it| writing(it, 0x03, 0x200)).collect();
    let (mut bus, mut serial) = bus(&expected);
    assert_eq!(finish(bus.separate_replies()), Ok(()));
    serial.done();
}

#[test]
fn faults_of_the_one_wire_uart_are_told_apart() {
    let read = |expected: &[SerialTransaction<u8>]| {
        let (mut bus, mut serial) = bus(expected);
        let error = finish(bus.status(2)).unwrap_err();
        serial.done();
        error
    };
    // Silence, 4 bytes sent, 4 echoes, 8 bytes of the reply.
    let changed = |at: usize, byte: u8| {
        let mut all = reading(2, 0x6F, 0x8000_0000);
        all[at] = SerialTransaction::read(byte);
        all
    };
    // A wrong first echo ends the attempt.
    assert_eq!(read(&changed(5, 0)[..6]), Error::Echo);
    assert_eq!(read(&changed(12, 1)), Error::Check);
    // A correct reply of another register.
    let mut other = echoed(&[0x05, 2, 0x6F]);
    other.extend(reading(2, 0x6C, 7).drain(9..));
    assert_eq!(read(&other), Error::WrongReply);
    let silence = || SerialTransaction::read_error(nb::Error::WouldBlock);
    // No reply for 20 ms.
    let mut silent = echoed(&[0x05, 2, 0x6F]);
    silent.extend((0..101).map(|_| silence()));
    assert_eq!(read(&silent), Error::NoReply);
    // A wire that is never silent for 16 bit times, which are two looks at this baud rate. The
    // clock is read twice for each byte.
    let noise: Vec<_> = (0..51).map(|_| SerialTransaction::read(0)).collect();
    let (mut bus, mut serial) = bus_with(50_000, &noise);
    assert_eq!(finish(bus.status(2)).unwrap_err(), Error::Noise);
    serial.done();
}

#[test]
fn the_stall_threshold_and_the_load_measure_are_those_of_the_chip() {
    let mut expected = reading(2, 0x02, 7);
    expected.extend(writing(2, 0x14, 0xF_FFFF));
    expected.extend(writing(2, 0x40, 50));
    expected.extend(reading(2, 0x02, 9));
    expected.extend(reading(2, 0x41, 0x1FE));
    let (mut bus, mut serial) = bus(&expected);
    assert_eq!(finish(bus.set_stall_threshold(2, 50, u32::MAX)), Ok(()));
    assert_eq!(finish(bus.load_measure(2)), Ok(0x1FE));
    serial.done();
}

#[test]
fn settings_that_a_driver_does_not_have_are_refused() {
    let error = Settings::new(SMALL, 10).unwrap_err();
    assert_eq!(error, SettingError::Microsteps(MicrostepError(10)));
    let strong = Currents {
        run_ma: 5000,
        ..SMALL
    };
    let limits = CurrentError {
        wanted_ma: 5000,
        range_ma: (30, 1767),
    };
    let error = Settings::new(strong, 16).unwrap_err();
    assert_eq!(error, SettingError::Current(limits));
    let holding = Currents {
        hold_ma: 900,
        ..SMALL
    };
    let error = Settings::new(holding, 16).unwrap_err();
    assert!(matches!(error, SettingError::Current(_)));
}

#[test]
fn the_trouble_of_a_configured_tmc2209_is_named() {
    for (flags, status, trouble) in [
        (0, 0x8000_0000, None),
        // Hot, and open phases, which a standing motor reports, are no trouble.
        (0, 0xC1, None),
        (1, 0, Some(Trouble::Reset)),
        (0b10, 0b11, Some(Trouble::Overheated)),
        (0b10, 1 << 2, Some(Trouble::Shorted)),
        (0b10, 1 << 3, Some(Trouble::Shorted)),
        (0b10, 1 << 4, Some(Trouble::Shorted)),
        (0b10, 1 << 5, Some(Trouble::Shorted)),
        (0b10, 0, Some(Trouble::SwitchedOff)),
        (0b100, 0, Some(Trouble::Undervoltage)),
    ] {
        let mut expected = reading(3, 0x01, flags);
        expected.extend(reading(3, 0x6F, status));
        let (mut bus, mut serial) = bus(&expected);
        assert_eq!(finish(bus.trouble(3)), Ok(trouble), "{flags:b} {status:b}");
        serial.done();
    }
}

#[test]
fn states_of_the_tmc2209_are_decoded() {
    let status = tmc2209::Status(0x8000_0001);
    assert!(status.is_hot() && status.is_standing());
    assert!(!status.is_alarm() && !status.is_open());
    for bit in [1, 2, 3, 4, 5] {
        assert!(tmc2209::Status(1 << bit).is_alarm(), "bit {bit}");
    }
    assert!(tmc2209::Status(1 << 7).is_open());
}

#[test]
fn the_outputs_of_the_ad5644_change_at_one_moment() {
    let mut expected = Vec::new();
    // Reset, reference on, all outputs to the middle; then 8191, -8192, 0, 1.
    for word in [
        [0x28, 0, 1],
        [0x38, 0, 1],
        [0x1F, 0x80, 0x00],
        [0x00, 0xFF, 0xFC],
        [0x01, 0x00, 0x00],
        [0x02, 0x80, 0x00],
        [0x13, 0x80, 0x04],
    ] {
        expected.push(SpiTransaction::transaction_start());
        expected.push(SpiTransaction::write_vec(word.to_vec()));
        expected.push(SpiTransaction::transaction_end());
    }
    let mut spi = Spi::new(&expected);
    let mut outputs = Ad5644::new(spi.clone());
    outputs.configure().unwrap();
    outputs.set([i16::MAX, i16::MIN, 0, 1]).unwrap();
    spi.done();
}

fn frame(sent: &[u8], received: &[u8]) -> [SpiTransaction<u8>; 3] {
    [
        SpiTransaction::transaction_start(),
        SpiTransaction::transfer_in_place(sent.to_vec(), received.to_vec()),
        SpiTransaction::transaction_end(),
    ]
}

#[test]
fn the_ads8688_gives_each_code_a_frame_later() {
    let mut expected = frame(&[0x85, 0, 0, 0], &[0; 4]).to_vec();
    for register in [0x05, 0x06, 0x07] {
        expected.extend(frame(&[register << 1 | 1, 1, 0], &[0, 0, 1]));
    }
    expected.extend(frame(&[0xC0, 0, 0, 0], &[0, 0, 0x12, 0x34]));
    expected.extend(frame(&[0xC4, 0, 0, 0], &[0, 0, 0x80, 0x00]));
    expected.extend(frame(&[0xC8, 0, 0, 0], &[0, 0, 0xFF, 0xFF]));
    expected.extend(frame(&[0, 0, 0, 0], &[0, 0, 0x00, 0x00]));
    let mut spi = Spi::new(&expected);
    let mut converter = Ads8688::new(spi.clone());
    converter.configure(Range::Volt5).unwrap();
    assert_eq!(converter.sample(), Ok([0, 8191, -8192]));
    spi.done();
    let mut expected = frame(&[0x85, 0, 0, 0], &[0; 4]).to_vec();
    expected.extend(frame(&[0x0B, 0, 0], &[0xFF; 3]));
    let mut spi = Spi::new(&expected);
    let error = Ads8688::new(spi.clone()).configure(Range::Volt10);
    assert_eq!(error, Err(ads8688::Error::NotTaken(0xFF)));
    spi.done();
}

#[test]
fn shift_registers_are_latched_and_shifted() {
    let mut spi = Spi::new(&[SpiTransaction::read_vec(vec![0xA5, 0x01])]);
    let levels = [
        PinTransaction::set(State::Low),
        PinTransaction::set(State::High),
    ];
    let mut load = Pin::new(&levels);
    assert_eq!(
        read_inputs::<2, _, _>(&mut spi, &mut load),
        Ok([0xA5, 0x01])
    );
    spi.done();
    load.done();
    let written = [
        SpiTransaction::write_vec(vec![1, 2, 3]),
        SpiTransaction::flush(),
    ];
    let mut spi = Spi::new(&written);
    let mut latch = Pin::new(&levels);
    write_outputs(&mut spi, &mut latch, &[1, 2, 3]).unwrap();
    spi.done();
    latch.done();
}

#[test]
fn the_spindle_turns_its_direction_at_no_duty() {
    let curve = Curve::new(&[(1000.0, 0.1), (3000.0, 0.5), (6000.0, 1.0)]).unwrap();
    let pwm = [
        PwmTransaction::max_duty_cycle(1000),
        PwmTransaction::set_duty_cycle(300),
        PwmTransaction::set_duty_cycle(0),
        PwmTransaction::max_duty_cycle(1000),
        PwmTransaction::set_duty_cycle(1000),
        PwmTransaction::max_duty_cycle(1000),
        PwmTransaction::set_duty_cycle(0),
    ];
    let mut pwm = Pwm::new(&pwm);
    let mut direction = Pin::new(&[PinTransaction::set(State::High)]);
    let mut spindle = Spindle::new(pwm.clone(), direction.clone(), curve);
    spindle.set_speed(2000).unwrap();
    spindle.set_speed(-9000).unwrap();
    spindle.set_speed(0).unwrap();
    pwm.done();
    direction.done();
}

#[test]
fn curves_are_straight_between_their_points() {
    let points = [(1000.0, 0.1), (3000.0, 0.5), (6000.0, 1.0)];
    let curve = Curve::new(&points).unwrap();
    for (speed, duty) in [
        (0, 0.0),
        (1, 0.1),
        (1000, 0.1),
        (1500, 0.2),
        (4500, 0.75),
        (60000, 1.0),
    ] {
        assert!((curve.duty(speed) - duty).abs() < 1e-6, "{speed}");
    }
    assert_eq!(Curve::new(&[]), Err(CurveError::Count(0)));
    assert_eq!(Curve::new(&[(1.0, 0.5); 9]), Err(CurveError::Count(9)));
    for bad in [
        (1000.0, 0.2),
        (2000.0, 1.1),
        (f32::NAN, 0.2),
        (2000.0, f32::NAN),
    ] {
        let error = Curve::new(&[(1000.0, 0.1), bad]);
        assert_eq!(error, Err(CurveError::Point(1)), "{bad:?}");
    }
}
