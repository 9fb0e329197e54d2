//! The driver of the TMC5160 against a chain of chips that follow the data sheet, bit by bit.

use embedded_hal::digital::{self, OutputPin};
use embedded_hal_nb::spi::{self, FullDuplex};
use haptimill_drivers::tmc5160::{Chain, Error, Settings, Status};
use haptimill_drivers::{CurrentError, Currents, MicrostepError, SettingError, Trouble};
use haptimill_hil_sim::tmc5160::{
    self, CHOPCONF, COOLCONF, Chip, Cut, GCONF, GLOBALSCALER, GSTAT, IHOLD_IRUN, TCOOLTHRS,
};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::pin::pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

/// The chain, and the bytes that the SPI has received and the board has not taken.
struct World {
    chain: tmc5160::Chain,
    received: VecDeque<u8>,
    /// A received byte is inverted, counted from this many on.
    noise: Option<usize>,
}

/// The SPI and the chip select of the board. A byte takes two looks at the receiver.
#[derive(Clone)]
struct Board {
    world: Rc<RefCell<World>>,
    looked: bool,
}

impl spi::ErrorType for Board {
    type Error = Infallible;
}

impl FullDuplex<u8> for Board {
    fn read(&mut self) -> nb::Result<u8, Infallible> {
        self.looked = !self.looked;
        if self.looked {
            return Err(nb::Error::WouldBlock);
        }
        let mut world = self.world.borrow_mut();
        world.received.pop_front().ok_or(nb::Error::WouldBlock)
    }

    fn write(&mut self, byte: u8) -> nb::Result<(), Infallible> {
        let mut world = self.world.borrow_mut();
        assert!(world.received.len() < 4, "the receiver overflows");
        let mut byte = world.chain.exchange(byte);
        world.noise = match world.noise {
            Some(0) => {
                byte = !byte;
                None
            }
            noise => noise.map(|count| count - 1),
        };
        world.received.push_back(byte);
        Ok(())
    }
}

impl digital::ErrorType for Board {
    type Error = Infallible;
}

impl OutputPin for Board {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.world.borrow_mut().chain.select(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.world.borrow_mut().chain.select(true);
        Ok(())
    }
}

/// A driver that expects a number of chips, and the chain with as many as there are.
fn with_chain(expected: usize, chips: usize) -> (Chain<Board, Board>, Rc<RefCell<World>>) {
    let world = World {
        chain: tmc5160::Chain::new(vec![Chip::default(); chips]),
        received: VecDeque::new(),
        noise: None,
    };
    let world = Rc::new(RefCell::new(world));
    let board = Board {
        world: Rc::clone(&world),
        looked: false,
    };
    (Chain::new(board.clone(), board, expected), world)
}

/// Polls a future until it is ready, as a main loop does.
fn finish<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    for _ in 0..10_000 {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
    }
    panic!("the future never ends")
}

const CURRENTS: Currents = Currents {
    run_ma: 2000,
    hold_ma: 1000,
    sense_mohm: 75,
};

fn settings(microsteps: u16) -> Settings {
    Settings::new(CURRENTS, microsteps).expect("settings of the chip")
}

#[test]
fn each_chip_of_a_chain_gets_its_own_settings() {
    for chips in 1..=5 {
        let (mut chain, world) = with_chain(chips, chips);
        for position in 0..chips {
            let microsteps = 1 << (3 + position);
            let result = finish(chain.configure(position as u8, &settings(microsteps)));
            assert_eq!(result, Ok(()), "{position} of {chips}");
        }
        assert_eq!(world.borrow().chain.mode_errors, 0);
        let there = world.borrow().chain.chips.clone();
        for (position, chip) in there.iter().enumerate() {
            assert_eq!(chip.microsteps(), 8 << position, "{position} of {chips}");
            // 325 mV / 75 mOhm / sqrt 2 = 3064 mA at scaler 256. 2000 mA: scaler 167 is 1998 mA,
            // 168 is 2010 mA. Hold 1000 mA: 62.4 mA (c + 1), code 15 is 999 mA.
            assert_eq!(chip.register(GLOBALSCALER), 167);
            assert_eq!(chip.register(IHOLD_IRUN), 6 << 16 | 31 << 8 | 15);
            let [run, hold] = chip.currents(0.075);
            assert!((1.998..2.0).contains(&run), "{run}");
            assert!((0.998..1.0).contains(&hold), "{hold}");
            assert_eq!((chip.register(GCONF), chip.register(GSTAT)), (8, 0));
            // Off time 3, hysteresis start 4, end 1, blank time 2, interpolation.
            let chopper = 3 | 4 << 4 | 4 << 7 | 2 << 15 | 1 << 28;
            assert_eq!(chip.register(CHOPCONF) & !(0xF << 24), chopper);
            assert_eq!(finish(chain.trouble(position as u8)), Ok(None));
        }
    }
}

#[test]
fn settings_that_the_chip_does_not_have_are_refused() {
    let error = Settings::new(CURRENTS, 10).unwrap_err();
    assert_eq!(error, SettingError::Microsteps(MicrostepError(10)));
    for (run_ma, hold_ma, range_ma) in [
        (3065, 0, (383, 3064)),
        (382, 0, (383, 3064)),
        (2000, 2001, (0, 2000)),
    ] {
        let currents = Currents {
            run_ma,
            hold_ma,
            ..CURRENTS
        };
        let limits = CurrentError {
            wanted_ma: if hold_ma > run_ma { hold_ma } else { run_ma },
            range_ma,
        };
        let error = Settings::new(currents, 16).unwrap_err();
        assert_eq!(error, SettingError::Current(limits));
    }
    // The full scale is scaler 256, written as 0.
    let (mut chain, world) = with_chain(1, 1);
    let full = Currents {
        run_ma: 3064,
        ..CURRENTS
    };
    let full = Settings::new(full, 256).expect("settings of the chip");
    assert_eq!(finish(chain.configure(0, &full)), Ok(()));
    let [run, _] = world.borrow().chain.chips[0].currents(0.075);
    assert!((3.063..3.065).contains(&run), "{run}");
}

/// A wire that is broken behind any chip, at either level, is found at its place by every command,
/// also of chips before it and behind it.
#[test]
fn a_broken_wire_and_a_chip_without_supply_are_found_at_their_place() {
    for position in 0..3_u8 {
        for other in 0..3 {
            for level in [false, true] {
                let (mut chain, world) = with_chain(3, 3);
                for chip in 0..3 {
                    assert_eq!(finish(chain.configure(chip, &settings(16))), Ok(()));
                }
                world.borrow_mut().chain.cut = Some(Cut {
                    position: usize::from(position),
                    level,
                });
                let broken = Err(Error::NoReply(position));
                assert_eq!(finish(chain.trouble(other)), broken.map(|()| None));
                assert_eq!(finish(chain.configure(other, &settings(16))), broken);
                world.borrow_mut().chain.cut = None;
                assert_eq!(finish(chain.trouble(other)), Ok(None), "the wire is whole");
            }
            let (mut chain, world) = with_chain(3, 3);
            let chips = |world: &Rc<RefCell<World>>, powered: bool| {
                world.borrow_mut().chain.chips[usize::from(position)].set_powered(powered);
            };
            chips(&world, false);
            let broken = Err(Error::NoReply(position));
            assert_eq!(finish(chain.configure(other, &settings(16))), broken);
            chips(&world, true);
            assert_eq!(finish(chain.configure(other, &settings(16))), Ok(()));
        }
    }
}

/// A moving chip without any flag replies with zeros, and is no broken wire.
#[test]
fn a_moving_chip_is_not_taken_for_a_broken_wire() {
    let (mut chain, world) = with_chain(2, 2);
    for position in 0..2 {
        assert_eq!(finish(chain.configure(position, &settings(16))), Ok(()));
    }
    for chip in &mut world.borrow_mut().chain.chips {
        chip.set_standing(false);
    }
    for position in 0..2 {
        assert_eq!(finish(chain.trouble(position)), Ok(None));
    }
}

#[test]
fn a_chain_of_another_length_is_found() {
    for (expected, chips) in [(2, 3), (2, 1), (3, 2), (1, 2), (4, 5), (1, 0)] {
        let (mut chain, world) = with_chain(expected, chips);
        for position in 0..expected {
            let result = finish(chain.configure(position as u8, &settings(16)));
            assert!(
                matches!(result, Err(Error::Length | Error::NoReply(_))),
                "{position} of {expected}, {chips} there: {result:?}"
            );
        }
        // No chip was written.
        for chip in &world.borrow().chain.chips {
            assert_eq!(chip.register(CHOPCONF), 0x1041_0150);
        }
    }
    // A position beyond the chain.
    let (mut chain, _) = with_chain(2, 2);
    assert_eq!(finish(chain.trouble(2)), Err(Error::Length));
}

#[test]
fn a_disturbed_transfer_is_found() {
    // The marker comes back behind the replies of two chips.
    for byte in 10..15 {
        let (mut chain, world) = with_chain(2, 2);
        world.borrow_mut().noise = Some(byte);
        assert_eq!(finish(chain.trouble(0)), Err(Error::Length), "byte {byte}");
    }
}

#[test]
fn a_chip_that_does_not_take_its_settings_is_found() {
    let configured = |change: fn(&mut Chip)| {
        let (mut chain, world) = with_chain(2, 2);
        change(&mut world.borrow_mut().chain.chips[1]);
        finish(chain.configure(1, &settings(16)))
    };
    assert_eq!(
        configured(|chip| chip.set_takes_steps(false)),
        Err(Error::NoStepInputs)
    );
    let found = 0x1041_0150;
    let register = CHOPCONF;
    assert_eq!(
        configured(|chip| chip.set_stuck(Some(CHOPCONF))),
        Err(Error::ReadBack { register, found })
    );
    assert_eq!(
        configured(|chip| chip.set_stuck(Some(GSTAT))),
        Err(Error::Trouble(Trouble::Reset))
    );
    // The first write: behind the two datagrams that read the pins, and its own, each with that of
    // the marker.
    let (mut chain, world) = with_chain(2, 2);
    world.borrow_mut().noise = Some(3 * 15 + 4);
    let register = GCONF;
    let found = 8 ^ 0xFF;
    assert_eq!(
        finish(chain.configure(1, &settings(16))),
        Err(Error::NotTaken { register, found })
    );
}

#[test]
fn the_trouble_of_a_configured_chip_is_named() {
    let trouble = |change: fn(&mut Chip)| {
        let (mut chain, world) = with_chain(2, 2);
        assert_eq!(finish(chain.configure(1, &settings(16))), Ok(()));
        change(&mut world.borrow_mut().chain.chips[1]);
        finish(chain.trouble(1)).expect("the chain is whole")
    };
    assert_eq!(trouble(|chip| chip.set_enabled(true)), None);
    assert_eq!(trouble(|chip| chip.set_temperature(130.0)), None, "hot");
    assert_eq!(
        trouble(|chip| chip.set_temperature(151.0)),
        Some(Trouble::Overheated)
    );
    assert_eq!(
        trouble(|chip| {
            chip.set_temperature(151.0);
            chip.set_temperature(80.0);
        }),
        Some(Trouble::SwitchedOff)
    );
    assert_eq!(
        trouble(|chip| {
            chip.set_enabled(true);
            chip.set_shorted(true);
        }),
        Some(Trouble::Shorted)
    );
    assert_eq!(
        trouble(|chip| chip.set_pump_low(true)),
        Some(Trouble::Undervoltage)
    );
    assert_eq!(
        trouble(|chip| {
            chip.set_powered(false);
            chip.set_powered(true);
        }),
        Some(Trouble::Reset)
    );
}

#[test]
fn stalls_are_detected_and_states_decoded() {
    let (mut chain, world) = with_chain(2, 2);
    assert_eq!(finish(chain.detect_stalls(1, -3, u32::MAX)), Ok(()));
    let chip = &world.borrow().chain.chips[1];
    assert_eq!(chip.register(COOLCONF), 0x7D << 16);
    assert_eq!(chip.register(TCOOLTHRS), 0xF_FFFF);
    assert_eq!(chip.register(GCONF), 0x88);
    let status = Status(0x8100_0123);
    assert_eq!(status.load_measure(), 0x123);
    assert!(status.is_stalled() && status.is_standing() && !status.is_alarm());
    for bit in [12, 13, 25, 27, 28] {
        assert!(Status(1 << bit).is_alarm(), "bit {bit}");
    }
}
