//! The chips of the drives on a simulated wire: what the keeper makes of them, against the
//! registers of chips that follow the data sheet.

use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use haptimill_board_common::chips::{ATTEMPTS, Chips, Follower, INTERVAL_US};
use haptimill_drivers::tmc2209::Bus;
use haptimill_firmware::config::{ChipKind, Config, Drive, DriveChip};
use haptimill_firmware::io::{Alarms, DriveAlarm, Inputs};
use haptimill_firmware::machine::Machine;
use haptimill_hil_sim::tmc2209::{CHOPCONF, Chip, GCONF, GSTAT, Wire};
use haptimill_machine_file::MachineFile;
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::task::{Context, Waker};

/// Time of a bit at 115,200 baud, ns.
const BIT: u64 = 8681;
/// Time between two looks of the main loop, ns.
const LOOK: u64 = 10_000;
/// Longest reply time of the bus, us.
const SILENCE_US: u64 = 21_000;

/// The wire, the UART of the board, and the time.
#[derive(Default)]
struct World {
    now: u64,
    wire: Wire,
    sending: VecDeque<(u64, u8)>,
    arriving: VecDeque<(u64, u8)>,
    /// Bytes that arrive are inverted, as many as this.
    noise: usize,
}

impl World {
    fn advance(&mut self) {
        self.now += LOOK;
        while let Some((end, byte)) = self.sending.pop_front_if(|(end, _)| *end <= self.now) {
            self.wire.send(byte, end, BIT);
            self.arriving.push_back((end, byte));
        }
        let reply = self.wire.replies(self.now, BIT);
        for (count, byte) in reply.into_iter().enumerate() {
            let end = self.now + 10 * BIT * (count as u64 + 1);
            self.arriving.push_back((end, byte));
        }
    }
}

/// The UART, whose receiver holds 32 bytes.
#[derive(Clone)]
struct Uart(Rc<RefCell<World>>);

impl ErrorType for Uart {
    type Error = ErrorKind;
}

impl Read<u8> for Uart {
    fn read(&mut self) -> nb::Result<u8, ErrorKind> {
        let mut world = self.0.borrow_mut();
        let now = world.now;
        let here = world.arriving.iter().filter(|(end, _)| *end <= now).count();
        assert!(here <= 32, "the receiver overflows");
        let Some((_, byte)) = world.arriving.pop_front_if(|(end, _)| *end <= now) else {
            return Err(nb::Error::WouldBlock);
        };
        if world.noise > 0 {
            world.noise -= 1;
            return Ok(!byte);
        }
        Ok(byte)
    }
}

impl Write<u8> for Uart {
    fn write(&mut self, byte: u8) -> nb::Result<(), ErrorKind> {
        let mut world = self.0.borrow_mut();
        if world.sending.len() == 32 {
            return Err(nb::Error::WouldBlock);
        }
        let free = world.sending.back().map_or(world.now, |(end, _)| *end);
        let end = free.max(world.now) + 10 * BIT;
        world.sending.push_back((end, byte));
        Ok(())
    }

    fn flush(&mut self) -> nb::Result<(), ErrorKind> {
        Ok(())
    }
}

/// Settings of a chip with sense resistors of 0.11 Ohm.
fn chip(address: u8, microsteps: u16) -> DriveChip {
    DriveChip {
        kind: ChipKind::Tmc2209,
        place: address,
        microsteps,
        run_ma: 800,
        hold_ma: 400,
        sense_mohm: 110,
    }
}

/// A machine with three joints whose chips are these.
fn machine(chips: [Option<DriveChip>; 3], crc: u32) -> Machine {
    let text = include_str!("../../../../machines/bench.toml");
    let file = MachineFile::parse("bench.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let mut config: Config = file.config;
    for (joint, chip) in config.joints.iter_mut().zip(chips) {
        if let Drive::Steps { chip: place, .. } = &mut joint.drive {
            *place = chip;
        }
    }
    Machine::new(config, crc, &Inputs::default()).expect("a sound machine")
}

fn alarms(of: &[(usize, DriveAlarm)]) -> Alarms {
    let none = Alarms::default();
    of.iter()
        .fold(none, |all, (joint, alarm)| all.with(*joint, Some(*alarm)))
}

/// A board: its control periods and its main loop.
struct Board<'a> {
    world: Rc<RefCell<World>>,
    follower: Follower<'a>,
    keeper: Pin<&'a mut dyn Future<Output = core::convert::Infallible>>,
    are_off: Rc<Cell<bool>>,
}

impl Board<'_> {
    /// Runs the main loop for a time, us. The enable line follows the controller, which wants the
    /// drives on where `on` says so, and the joints that are not ready.
    fn run(&mut self, us: u64, on: bool) {
        let end = self.world.borrow().now + us * 1000;
        while self.world.borrow().now < end {
            let on = on && self.follower.alarms().joints() == 0;
            self.are_off.set(!on);
            self.world.borrow_mut().advance();
            for chip in &mut self.world.borrow_mut().wire.chips {
                chip.set_enabled(on);
            }
            let mut context = Context::from_waker(Waker::noop());
            assert!(self.keeper.as_mut().poll(&mut context).is_pending());
        }
    }

    fn chip<R>(&self, place: usize, act: impl FnOnce(&mut Chip) -> R) -> R {
        act(&mut self.world.borrow_mut().wire.chips[place])
    }
}

/// A board with chips at these addresses.
fn with_board(addresses: &[u8], act: impl FnOnce(&mut Board<'_>)) {
    let chips = addresses.iter().map(|address| Chip::new(*address));
    let world = World {
        wire: Wire::new(chips.collect()),
        ..World::default()
    };
    let world = Rc::new(RefCell::new(world));
    let are_off = Rc::new(Cell::new(true));
    let mut shared = Chips::new();
    let (follower, keeper) = shared.split(ChipKind::Tmc2209);
    let now = Rc::clone(&world);
    let clock = move || (now.borrow().now / 1000) as u32;
    let mut bus = Bus::new(Uart(Rc::clone(&world)), clock.clone(), 1, 115_200);
    let off = Rc::clone(&are_off);
    let kept = pin!(keeper.keep(&mut bus, clock, 1, || {}, move || off.get()));
    act(&mut Board {
        world,
        follower,
        keeper: kept,
        are_off,
    });
}

const THREE: [Option<DriveChip>; 3] = [None, None, None];

/// Three joints, of which the first one has its chip at address 2 and the last one at address 0.
fn two_chips() -> [Option<DriveChip>; 3] {
    [Some(chip(2, 16)), None, Some(chip(0, 64))]
}

#[test]
fn chips_get_their_settings_before_the_joints_are_ready() {
    with_board(&[0, 2], |board| {
        board.run(100_000, false);
        assert_eq!(board.world.borrow().wire.sent, 0, "no machine is known");
        let machine = machine(two_chips(), 7);
        board.follower.follow(Some(&machine));
        assert_eq!(
            board.follower.alarms(),
            alarms(&[(0, DriveAlarm::Setting), (2, DriveAlarm::Setting)])
        );
        // Long before the enable line may go on: 56 exchanges of some 2 ms.
        board.run(120_000, true);
        assert_eq!(board.follower.alarms().joints(), 0);
        for (place, microsteps) in [(0, 64), (1, 16)] {
            board.chip(place, |chip| {
                assert_eq!(chip.microsteps(), microsteps);
                let [run, hold] = chip.currents(0.11).expect("the internal reference");
                // The largest currents up to those of the machine file; a code is 31 mA.
                assert!(run <= 0.8 && run > 0.769, "{run}");
                assert!(hold <= 0.4 && hold > 0.369, "{hold}");
                assert_eq!(chip.register(GSTAT), 0);
                assert!(chip.drives());
            });
        }
        let early = board.world.borrow().wire.early_replies;
        assert_eq!(early, 0, "no reply disturbs the other chip");
        // Nothing changes as long as the chips are sound, and they are asked again and again.
        let sent = board.world.borrow().wire.sent;
        board.run(1_000_000, true);
        assert_eq!(board.follower.alarms().joints(), 0);
        let asked = board.world.borrow().wire.sent - sent;
        // Two chips, two requests of four bytes.
        let rounds = asked / 16;
        assert!((20..=50).contains(&rounds), "{rounds} rounds in a second");
    });
}

#[test]
fn a_silent_chip_and_one_that_keeps_a_register_name_their_joints() {
    with_board(&[0, 2], |board| {
        board.chip(0, |chip| chip.set_powered(false));
        board.chip(1, |chip| chip.set_stuck(Some(CHOPCONF)));
        let mut chips = two_chips();
        // The value of the reset has 256 microsteps.
        chips[1] = Some(chip(1, 8));
        board.follower.follow(Some(&machine(chips, 7)));
        board.run(1_000_000, true);
        assert_eq!(
            board.follower.alarms(),
            alarms(&[
                (0, DriveAlarm::NotSet),
                (1, DriveAlarm::Silent),
                (2, DriveAlarm::Silent)
            ])
        );
        assert!(board.are_off.get());
        // The chip gets its supply, the other one loses its fault: both are configured.
        board.chip(0, |chip| chip.set_powered(true));
        board.chip(1, |chip| chip.set_stuck(None));
        board.run(300_000, true);
        assert_eq!(
            board.follower.alarms().joints(),
            0b010,
            "no chip has address 1"
        );
        board.chip(1, |chip| chip.set_stuck(Some(GCONF)));
        board.run(300_000, true);
        assert_eq!(board.follower.alarms().joints(), 0b010, "it is configured");
    });
}

/// Time in which a trouble of a chip is seen: a round of two chips with some 4 ms each.
const SEEN_US: u64 = INTERVAL_US as u64 + 10_000;

#[test]
fn trouble_of_a_running_chip_switches_off_until_it_is_sound_again() {
    with_board(&[0, 2], |board| {
        board.follower.follow(Some(&machine(two_chips(), 7)));
        board.run(200_000, true);
        assert!(!board.are_off.get());
        // Above its limit the chip switches its motor off.
        board.chip(1, |chip| chip.set_temperature(150.0));
        board.run(SEEN_US, true);
        assert_eq!(
            board.follower.alarms(),
            alarms(&[(0, DriveAlarm::Overheated)])
        );
        assert!(board.are_off.get());
        board.run(300_000, true);
        assert_eq!(board.follower.alarms().joints(), 0b001, "it is still hot");
        board.chip(1, |chip| chip.set_temperature(130.0));
        board.run(300_000, true);
        assert_eq!(board.follower.alarms().joints(), 0b001, "it must cool down");
        board.chip(1, |chip| chip.set_temperature(100.0));
        board.run(300_000, true);
        assert_eq!(board.follower.alarms().joints(), 0);
        board.chip(0, |chip| chip.set_shorted(true));
        board.run(SEEN_US, true);
        assert_eq!(board.follower.alarms(), alarms(&[(2, DriveAlarm::Shorted)]));
        board.chip(0, |chip| chip.set_shorted(false));
        board.run(200_000, true);
        assert_eq!(board.follower.alarms().joints(), 0);
        // A moment without the supply of the motors: the chip answers, with the currents of the
        // factory.
        board.chip(0, |chip| {
            chip.set_powered(false);
            chip.set_powered(true);
            assert_eq!(chip.currents(0.11), None);
        });
        board.run(SEEN_US, true);
        assert_eq!(board.follower.alarms(), alarms(&[(2, DriveAlarm::Reset)]));
        board.run(200_000, true);
        assert_eq!(board.follower.alarms().joints(), 0);
        assert_eq!(board.chip(0, |chip| chip.microsteps()), 64);
        // A chip that is silent is asked again before it counts.
        board.chip(1, |chip| chip.set_powered(false));
        board.run(
            u64::from(INTERVAL_US) + ATTEMPTS as u64 * SILENCE_US + 10_000,
            true,
        );
        assert_eq!(board.follower.alarms(), alarms(&[(0, DriveAlarm::Silent)]));
    });
}

#[test]
fn noise_on_the_wire_costs_attempts_and_no_alarm() {
    with_board(&[0, 2], |board| {
        board.follower.follow(Some(&machine(two_chips(), 7)));
        board.run(200_000, true);
        for _ in 0..20 {
            // Bytes of one exchange.
            board.world.borrow_mut().noise = 12;
            board.run(100_000, true);
            assert_eq!(board.follower.alarms().joints(), 0);
        }
    });
}

#[test]
fn a_new_configuration_replaces_the_chips() {
    with_board(&[0, 2, 3], |board| {
        let first = machine(two_chips(), 7);
        board.follower.follow(Some(&first));
        // In the middle of the configuration of the first chip.
        board.run(12_000, false);
        let second = machine([None, Some(chip(3, 8)), None], 8);
        board.follower.follow(Some(&second));
        assert_eq!(board.follower.alarms().joints(), 0b010);
        board.run(200_000, true);
        assert_eq!(board.follower.alarms().joints(), 0);
        assert_eq!(board.chip(2, |chip| chip.microsteps()), 8);
        board.follower.follow(Some(&second));
        assert_eq!(board.follower.alarms().joints(), 0, "it is the same one");
        board.follower.follow(Some(&machine(THREE, 9)));
        assert_eq!(board.follower.alarms().joints(), 0);
        // Two configurations before the main loop takes one.
        board.follower.follow(Some(&first));
        board.follower.follow(Some(&second));
        assert_eq!(board.follower.alarms().joints(), 0b010);
        // Each control period tries to pass it on.
        for _ in 0..1000 {
            board.run(200, true);
            board.follower.follow(Some(&second));
        }
        assert_eq!(board.follower.alarms().joints(), 0);
    });
}

#[test]
fn without_a_bus_a_joint_with_a_chip_is_never_ready() {
    let mut shared = Chips::new();
    let mut follower = shared.without_bus();
    follower.follow(None);
    assert_eq!(follower.alarms().joints(), 0);
    follower.follow(Some(&machine(two_chips(), 7)));
    assert_eq!(
        follower.alarms(),
        alarms(&[(0, DriveAlarm::NoBus), (2, DriveAlarm::NoBus)])
    );
    follower.follow(Some(&machine(THREE, 8)));
    assert_eq!(follower.alarms().joints(), 0);
}
