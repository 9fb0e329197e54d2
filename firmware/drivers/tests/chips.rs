//! The bytes that the drivers exchange with their chips, against datagrams composed from the data
//! sheets.

use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as PinTransaction};
use embedded_hal_mock::eh1::pwm::{Mock as Pwm, Transaction as PwmTransaction};
use embedded_hal_mock::eh1::serial::{Mock as Serial, Transaction as SerialTransaction};
use embedded_hal_mock::eh1::spi::{Mock as Spi, Transaction as SpiTransaction};
use haptimill_drivers::ad5644::Ad5644;
use haptimill_drivers::ads8688::{self, Ads8688, Range};
use haptimill_drivers::shift_register::{read_inputs, write_outputs};
use haptimill_drivers::spindle::{Curve, CurveError, Spindle};
use haptimill_drivers::tmc2209::{self, Tmc2209, check_byte};
use haptimill_drivers::tmc5160::{self, Tmc5160};
use haptimill_drivers::{CurrentError, MicrostepError};

/// A datagram to the driver: the board receives each byte that it sends.
fn echoed(bytes: &[u8]) -> Vec<SerialTransaction<u8>> {
    let mut all = bytes.to_vec();
    all.push(check_byte(bytes));
    let both = |byte: u8| {
        [
            SerialTransaction::write(byte),
            SerialTransaction::read(byte),
        ]
    };
    all.into_iter().flat_map(both).collect()
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

fn writing(address: u8, register: u8, value: u32, count: u8) -> Vec<SerialTransaction<u8>> {
    let mut all = reading(address, 0x02, u32::from(count));
    let [a, b, c, d] = value.to_be_bytes();
    all.extend(echoed(&[0x05, address, register | 0x80, a, b, c, d]));
    all.extend(reading(address, 0x02, u32::from(count.wrapping_add(1))));
    all
}

fn tmc2209(expected: &[SerialTransaction<u8>]) -> (Tmc2209<Serial<u8>, NoopDelay>, Serial<u8>) {
    let serial = Serial::new(expected);
    (Tmc2209::new(serial.clone(), NoopDelay::new(), 2), serial)
}

const SMALL: tmc2209::Currents = tmc2209::Currents {
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
}

#[test]
fn the_tmc2209_is_configured() {
    // 800 mA in the range of 180 mV: (c + 1) / 32 * 180 mV / 130 mOhm / sqrt 2 = 30.6 mA (c + 1),
    // so code 25 is 795 mA, and code 12 is 397 mA.
    let mut expected = reading(2, 0x06, 0x2100_0000);
    expected.extend(writing(2, 0x00, 0x1C0, 254));
    // 16 microsteps are code 4; vsense is bit 17.
    expected.extend(writing(2, 0x6C, 0x1402_0053, 255));
    expected.extend(writing(2, 0x10, 6 << 16 | 25 << 8 | 12, 0));
    expected.extend(writing(2, 0x01, 0b111, 1));
    let (mut driver, mut serial) = tmc2209(&expected);
    driver.configure(SMALL, 16).unwrap();
    serial.done();
}

#[test]
fn faults_of_the_one_wire_uart_are_told_apart() {
    let read = |expected: &[SerialTransaction<u8>]| {
        let (mut driver, mut serial) = tmc2209(expected);
        let error = driver.status().unwrap_err();
        serial.done();
        error
    };
    let changed = |at: usize, byte: u8| {
        let mut all = reading(2, 0x6F, 0x8000_0000);
        all[at] = SerialTransaction::read(byte);
        all
    };
    // A wrong first echo ends the attempt.
    assert_eq!(read(&changed(1, 0)[..2]), tmc2209::Error::Echo);
    assert_eq!(read(&changed(12, 1)), tmc2209::Error::Check);
    // A correct reply of another register.
    let mut other = echoed(&[0x05, 2, 0x6F]);
    other.extend(reading(2, 0x6C, 7).drain(8..));
    assert_eq!(read(&other), tmc2209::Error::WrongReply);
    // Silence.
    let mut silent = echoed(&[0x05, 2, 0x6F]);
    silent.extend((0..1000).map(|_| SerialTransaction::read_error(nb::Error::WouldBlock)));
    assert_eq!(read(&silent), tmc2209::Error::NoReply);
}

#[test]
fn a_write_that_the_tmc2209_does_not_take_is_found() {
    let mut expected = reading(2, 0x02, 7);
    expected.extend(echoed(&[0x05, 2, 0xC0, 0, 0, 0, 50]));
    expected.extend(reading(2, 0x02, 7));
    let (mut driver, mut serial) = tmc2209(&expected);
    assert_eq!(driver.write(0x40, 50), Err(tmc2209::Error::NotTaken));
    serial.done();
}

#[test]
fn settings_that_a_driver_does_not_have_are_refused() {
    let (mut driver, mut serial) = tmc2209(&[]);
    let error = driver.configure(SMALL, 10).unwrap_err();
    assert_eq!(error, tmc2209::Error::Microsteps(MicrostepError(10)));
    let strong = tmc2209::Currents {
        run_ma: 5000,
        ..SMALL
    };
    let limits = CurrentError {
        wanted_ma: 5000,
        range_ma: (30, 1767),
    };
    let error = driver.configure(strong, 16).unwrap_err();
    assert_eq!(error, tmc2209::Error::Current(limits));
    let holding = tmc2209::Currents {
        hold_ma: 900,
        ..SMALL
    };
    let error = driver.configure(holding, 16).unwrap_err();
    assert!(matches!(error, tmc2209::Error::Current(_)));
    serial.done();
    let (mut driver, mut serial) = tmc2209(&reading(2, 0x06, 0x2000_0000));
    assert_eq!(
        driver.configure(SMALL, 16),
        Err(tmc2209::Error::Version(0x20))
    );
    serial.done();
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

/// A datagram of the TMC5160 that writes.
fn sent(bytes: [u8; 5]) -> [SpiTransaction<u8>; 3] {
    [
        SpiTransaction::transaction_start(),
        SpiTransaction::write_vec(bytes.to_vec()),
        SpiTransaction::transaction_end(),
    ]
}

fn spi_reading(register: u8, value: u32) -> Vec<SpiTransaction<u8>> {
    let [a, b, c, d] = value.to_be_bytes();
    let mut all = sent([register, 0, 0, 0, 0]).to_vec();
    all.extend([
        SpiTransaction::transaction_start(),
        SpiTransaction::transfer_in_place(vec![register, 0, 0, 0, 0], vec![9, a, b, c, d]),
        SpiTransaction::transaction_end(),
    ]);
    all
}

#[test]
fn the_tmc5160_is_configured() {
    // 325 mV / 75 mOhm / sqrt 2 = 3064 mA at scaler 256. 2000 mA: scaler 167 is 1998 mA, 168 is
    // 2010 mA. Hold 1000 mA: 62.4 mA (c + 1), code 15 is 999 mA.
    let chopper: u32 = 3 | 4 << 4 | 4 << 7 | 2 << 15 | 1 << 28 | 3 << 24;
    let [a, b, c, d] = chopper.to_be_bytes();
    let mut expected = spi_reading(0x04, 0x3000_0040);
    expected.extend(sent([0x80, 0, 0, 0, 8]));
    expected.extend(sent([0x8B, 0, 0, 0, 167]));
    expected.extend(sent([0x90, 0, 6, 31, 15]));
    expected.extend(sent([0xEC, a, b, c, d]));
    expected.extend(spi_reading(0x6C, chopper));
    expected.extend(sent([0x81, 0, 0, 0, 7]));
    let mut spi = Spi::new(&expected);
    let currents = tmc5160::Currents {
        run_ma: 2000,
        hold_ma: 1000,
        sense_mohm: 75,
    };
    Tmc5160::new(spi.clone()).configure(currents, 32).unwrap();
    spi.done();
}

#[test]
fn a_missing_tmc5160_and_a_lost_write_are_found() {
    let currents = tmc5160::Currents {
        run_ma: 3064,
        hold_ma: 0,
        sense_mohm: 75,
    };
    let mut spi = Spi::new(&spi_reading(0x04, 0xFFFF_FFFF));
    let error = Tmc5160::new(spi.clone()).configure(currents, 256);
    assert_eq!(error, Err(tmc5160::Error::Version(255)));
    spi.done();

    let chopper: u32 = 3 | 4 << 4 | 4 << 7 | 2 << 15 | 1 << 28;
    let [a, b, c, d] = chopper.to_be_bytes();
    let mut expected = spi_reading(0x04, 0x3000_0000);
    expected.extend(sent([0x80, 0, 0, 0, 8]));
    // The full scale is scaler 256, written as 0.
    expected.extend(sent([0x8B, 0, 0, 0, 0]));
    expected.extend(sent([0x90, 0, 6, 31, 0]));
    expected.extend(sent([0xEC, a, b, c, d]));
    expected.extend(spi_reading(0x6C, 0));
    let mut spi = Spi::new(&expected);
    let error = Tmc5160::new(spi.clone()).configure(currents, 256);
    let lost = tmc5160::Error::NotTaken {
        register: 0x6C,
        found: 0,
    };
    assert_eq!(error, Err(lost));
    spi.done();
}

#[test]
fn stalls_of_the_tmc5160_are_detected_and_states_decoded() {
    let mut expected = sent([0xED, 0, 0x7D, 0, 0]).to_vec();
    expected.extend(sent([0x94, 0, 0x0F, 0xFF, 0xFF]));
    expected.extend(sent([0x80, 0, 0, 0, 0x88]));
    expected.extend(spi_reading(0x6F, 0x8100_0123));
    let mut spi = Spi::new(&expected);
    let mut driver = Tmc5160::new(spi.clone());
    driver.detect_stalls(-3, u32::MAX).unwrap();
    let status = driver.status().unwrap();
    assert_eq!(status.load_measure(), 0x123);
    assert!(status.is_stalled() && status.is_standing() && !status.is_alarm());
    spi.done();
    for bit in [12, 13, 25, 27, 28] {
        assert!(tmc5160::Status(1 << bit).is_alarm(), "bit {bit}");
    }
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
