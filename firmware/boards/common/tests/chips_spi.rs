//! The chain of the chips of the drives: what the keeper makes of it, against the registers of
//! chips that follow the data sheet.

use embedded_hal::digital::{self, OutputPin};
use embedded_hal_nb::spi::{self, FullDuplex};
use haptimill_board_common::chips::{Chips, Follower, INTERVAL_US};
use haptimill_drivers::tmc5160::Chain;
use haptimill_firmware::config::{ChipKind, Drive, DriveChip};
use haptimill_firmware::io::{Alarms, DriveAlarm, Inputs};
use haptimill_firmware::machine::Machine;
use haptimill_hil_sim::tmc5160::{self, CHOPCONF, Chip, Cut, GSTAT};
use haptimill_machine_file::MachineFile;
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::task::{Context, Waker};

/// Time between two looks of the main loop, us: a byte at 1 MHz.
const LOOK_US: u64 = 8;

/// The chain, the receiver of the SPI, and the time.
#[derive(Default)]
struct World {
    now_us: u64,
    chain: tmc5160::Chain,
    arriving: VecDeque<(u64, u8)>,
}

/// The SPI and the chip select.
#[derive(Clone)]
struct Spi(Rc<RefCell<World>>);

impl spi::ErrorType for Spi {
    type Error = Infallible;
}

impl FullDuplex<u8> for Spi {
    fn read(&mut self) -> nb::Result<u8, Infallible> {
        let mut world = self.0.borrow_mut();
        let now = world.now_us;
        let arrived = world.arriving.pop_front_if(|(end, _)| *end <= now);
        arrived.map(|(_, byte)| byte).ok_or(nb::Error::WouldBlock)
    }

    fn write(&mut self, byte: u8) -> nb::Result<(), Infallible> {
        let mut world = self.0.borrow_mut();
        assert!(world.arriving.len() < 8, "the receiver overflows");
        let received = world.chain.exchange(byte);
        let free = world.arriving.back().map_or(world.now_us, |(end, _)| *end);
        let end = free.max(world.now_us) + 8;
        world.arriving.push_back((end, received));
        Ok(())
    }
}

impl digital::ErrorType for Spi {
    type Error = Infallible;
}

impl OutputPin for Spi {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().chain.select(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().chain.select(true);
        Ok(())
    }
}

/// Settings of a chip with sense resistors of 0.075 Ohm.
const fn chip(place: u8, microsteps: u16) -> Option<DriveChip> {
    Some(DriveChip {
        kind: ChipKind::Tmc5160,
        place,
        microsteps,
        run_ma: 2000,
        hold_ma: 1000,
        sense_mohm: 75,
    })
}

/// Three joints with a chip each, in another order than that of the chain.
const THREE: [Option<DriveChip>; 3] = [chip(1, 16), chip(2, 64), chip(0, 8)];

/// A machine with three joints whose chips are these.
fn machine(chips: [Option<DriveChip>; 3], crc: u32) -> Machine {
    let text = include_str!("../../../../machines/bench.toml");
    let file = MachineFile::parse("bench.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let mut config = file.config;
    for (joint, chip) in config.joints.iter_mut().zip(chips) {
        if let Drive::Steps { chip: place, .. } = &mut joint.drive {
            *place = chip;
        }
    }
    Machine::new(config, crc, &Inputs::default()).expect("a sound machine")
}

fn alarms(of: [Option<DriveAlarm>; 3]) -> Alarms {
    let joints = of.into_iter().enumerate();
    joints.fold(Alarms::default(), |all, (joint, alarm)| {
        all.with(joint, alarm)
    })
}

/// A board: its control periods and its main loop.
struct Board<'a> {
    world: Rc<RefCell<World>>,
    follower: Follower<'a>,
    keeper: Pin<&'a mut dyn Future<Output = Infallible>>,
    are_off: Rc<Cell<bool>>,
    /// All alarms that were seen since the last configuration, in their order.
    seen: Vec<Alarms>,
}

impl Board<'_> {
    /// Runs the main loop for a time, us. The enable line follows the controller, and the joints
    /// that are not ready.
    fn run(&mut self, us: u64) {
        let end = self.world.borrow().now_us + us;
        while self.world.borrow().now_us < end {
            let alarms = self.follower.alarms();
            if self.seen.last() != Some(&alarms) {
                self.seen.push(alarms);
            }
            let on = alarms.is_empty();
            self.are_off.set(!on);
            self.world.borrow_mut().now_us += LOOK_US;
            for chip in &mut self.world.borrow_mut().chain.chips {
                chip.set_enabled(on);
            }
            let mut context = Context::from_waker(Waker::noop());
            assert!(self.keeper.as_mut().poll(&mut context).is_pending());
        }
    }

    fn chip<R>(&self, position: usize, act: impl FnOnce(&mut Chip) -> R) -> R {
        act(&mut self.world.borrow_mut().chain.chips[position])
    }
}

/// A board with this many chips in its chain, with a machine.
fn with_board(count: usize, machine: &Machine, act: impl FnOnce(&mut Board<'_>)) {
    let chain = tmc5160::Chain::new(vec![Chip::default(); count]);
    let world = World {
        chain,
        ..World::default()
    };
    let world = Rc::new(RefCell::new(world));
    let are_off = Rc::new(Cell::new(true));
    let mut shared = Chips::new();
    let (follower, keeper) = shared.split(ChipKind::Tmc5160);
    let now = Rc::clone(&world);
    let clock = move || now.borrow().now_us as u32;
    let spi = Spi(Rc::clone(&world));
    let mut bus = Chain::new(spi.clone(), spi, 0);
    let off = Rc::clone(&are_off);
    let kept = pin!(keeper.keep(&mut bus, clock, 1, || {}, move || off.get()));
    let mut board = Board {
        world,
        follower,
        keeper: kept,
        are_off,
        seen: Vec::new(),
    };
    board.run(50_000);
    assert_eq!(board.world.borrow().chain.transfers, 0, "no machine");
    board.follower.follow(Some(machine));
    act(&mut board);
}

/// What happens to a chip.
type Change = fn(&mut Chip);

/// Time in which a trouble of a chip is seen: three chips with three transfers of 20 bytes each,
/// three times if they fail.
const SEEN_US: u64 = INTERVAL_US as u64 + 3 * 3 * 3 * 20 * 10;

#[test]
fn chips_get_their_settings_before_the_joints_are_ready() {
    with_board(3, &machine(THREE, 7), |board| {
        let setting = Some(DriveAlarm::Setting);
        assert_eq!(board.follower.alarms(), alarms([setting; 3]));
        board.run(100_000);
        assert!(board.follower.alarms().is_empty());
        for (position, microsteps) in [(0, 8), (1, 16), (2, 64)] {
            board.chip(position, |chip| {
                assert_eq!(chip.microsteps(), microsteps);
                let [run, hold] = chip.currents(0.075);
                assert!((1.98..=2.0).contains(&run), "{run}");
                assert!((0.93..=1.0).contains(&hold), "{hold}");
                assert_eq!(chip.register(GSTAT), 0);
                assert!(chip.drives());
            });
        }
        // Nothing changes as long as the chips are sound, and they are asked again and again: three
        // chips, three transfers each.
        let transfers = board.world.borrow().chain.transfers;
        board.run(1_000_000);
        assert!(board.follower.alarms().is_empty());
        let rounds = (board.world.borrow().chain.transfers - transfers) / 9;
        assert!((30..=50).contains(&rounds), "{rounds} rounds in a second");
    });
}

/// The chip that interrupts the chain is known from the first moment on, and the joints of the
/// others wait for it.
#[test]
fn a_chip_that_interrupts_the_chain_is_named() {
    let silent = Some(DriveAlarm::Silent);
    let cut_off = Some(DriveAlarm::Unreachable);
    let at_y = alarms([cut_off, silent, cut_off]);
    with_board(3, &machine(THREE, 7), |board| {
        board.chip(2, |chip| chip.set_powered(false));
        board.run(200_000);
        assert_eq!(board.follower.alarms(), at_y);
        board.chip(2, |chip| chip.set_powered(true));
        board.run(200_000);
        assert!(board.follower.alarms().is_empty());
        // With the drives on.
        for (position, joint, level) in [(2, 1, true), (2, 1, false), (0, 2, true), (1, 0, false)] {
            board.seen.clear();
            board.world.borrow_mut().chain.cut = Some(Cut { position, level });
            board.run(SEEN_US);
            let mut expected = [cut_off; 3];
            expected[joint] = silent;
            assert_eq!(board.follower.alarms(), alarms(expected));
            let first = board.seen[1];
            assert_eq!(first.of(joint), silent, "{:?}", board.seen);
            board.world.borrow_mut().chain.cut = None;
            board.run(200_000);
            assert!(board.follower.alarms().is_empty());
        }
    });
}

#[test]
fn a_chain_of_another_length_is_reported_by_all_joints() {
    for count in [2, 4] {
        with_board(count, &machine(THREE, 7), |board| {
            board.run(200_000);
            let disturbed = Some(DriveAlarm::Disturbed);
            assert_eq!(board.follower.alarms(), alarms([disturbed; 3]), "{count}");
            for position in 0..count {
                let chopper = board.chip(position, |chip| chip.register(CHOPCONF));
                assert_eq!(chopper & 0xF, 0, "no power stage is on");
            }
        });
    }
}

#[test]
fn trouble_of_a_chip_switches_off_until_it_is_sound_again() {
    with_board(3, &machine(THREE, 7), |board| {
        board.run(100_000);
        assert!(!board.are_off.get());
        let only = |alarm| alarms([None, None, Some(alarm)]);
        let changes: [(Change, Change, DriveAlarm); 4] = [
            (
                |chip| chip.set_temperature(155.0),
                |chip| chip.set_temperature(100.0),
                DriveAlarm::Overheated,
            ),
            (
                |chip| chip.set_shorted(true),
                |chip| chip.set_shorted(false),
                DriveAlarm::Shorted,
            ),
            (
                |chip| chip.set_pump_low(true),
                |chip| chip.set_pump_low(false),
                DriveAlarm::Undervoltage,
            ),
            (
                |chip| {
                    chip.set_powered(false);
                    chip.set_powered(true);
                },
                |_| {},
                DriveAlarm::Reset,
            ),
        ];
        for (fail, mend, alarm) in changes {
            board.seen.clear();
            board.chip(0, fail);
            board.run(SEEN_US);
            assert_eq!(board.seen.get(1), Some(&only(alarm)));
            board.chip(0, mend);
            board.run(200_000);
            assert!(board.follower.alarms().is_empty(), "{alarm:?}");
            assert_eq!(board.chip(0, |chip| chip.microsteps()), 8);
        }
    });
}

#[test]
fn a_new_configuration_changes_the_length_of_the_chain() {
    with_board(3, &machine(THREE, 7), |board| {
        board.run(100_000);
        assert!(board.follower.alarms().is_empty());
        let two = machine([chip(1, 32), None, chip(0, 32)], 8);
        board.follower.follow(Some(&two));
        board.run(200_000);
        let disturbed = Some(DriveAlarm::Disturbed);
        let expected = alarms([disturbed, None, disturbed]);
        assert_eq!(board.follower.alarms(), expected, "a chip is left over");
        board.world.borrow_mut().chain.chips.pop();
        board.run(200_000);
        assert!(board.follower.alarms().is_empty());
        assert_eq!(board.chip(1, |chip| chip.microsteps()), 32);
    });
}

/// A chip for another bus never becomes ready.
#[test]
fn a_chip_of_the_other_bus_has_none() {
    let other = THREE.map(|chip| {
        chip.map(|chip| DriveChip {
            kind: ChipKind::Tmc2209,
            run_ma: 800,
            hold_ma: 400,
            sense_mohm: 110,
            ..chip
        })
    });
    with_board(3, &machine(other, 7), |board| {
        board.run(200_000);
        assert_eq!(
            board.follower.alarms(),
            alarms([Some(DriveAlarm::NoBus); 3])
        );
        assert_eq!(board.world.borrow().chain.transfers, 0);
    });
}
