//! Chips of the drives that the board sets over a bus of its own: TMC2209 on a one-wire UART, or
//! TMC5160 in a chain at an SPI.
//!
//! The controller gets a configuration in its control period; the main loop of the board talks to
//! the chips between the periods. [`Follower`] is the side of the control period: it passes the
//! settings on, and says which joints are not ready. [`Keeper`] is the side of the main loop: it
//! configures the chips, reads their state again and again, and says which joints are ready.
//!
//! A joint with a chip is not ready from the activation of its configuration until its chip has
//! read back what was written. It is not ready from then on when the chip is silent, was reset, or
//! has switched its motor off, until the chip was configured again with the drives off.

mod tmc2209;
mod tmc5160;

use core::convert::Infallible;
use core::sync::atomic::{AtomicU32, Ordering};
use haptimill_drivers::{Currents, Trouble, turn};
use haptimill_firmware::config::{ChipKind, DriveChip, JointSettings};
use haptimill_firmware::machine::Machine;
use haptimill_protocol::message::{Alarms, DriveAlarm, MAX_AXES};
use heapless::spsc::{Consumer, Producer, Queue};

/// Time between two rounds in which the state of all chips is read, us.
pub const INTERVAL_US: u32 = 20_000;

/// Attempts to read the state of a chip until it counts as silent. Noise on the wire costs one.
pub const ATTEMPTS: usize = 3;

/// Bits of the alarms in the state; those above number the configuration.
const ALARM_BITS: u32 = 4 * MAX_AXES as u32;

/// Why a chip is not ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Failure {
    /// The reason.
    pub alarm: DriveAlarm,
    /// Place of the chip that causes it: another one if that one interrupts the chain.
    pub place: u8,
}

/// A bus over which the main loop sets chips of one kind. Its functions never wait: their futures
/// return to the caller while bytes are under way.
#[allow(
    async_fn_in_trait,
    reason = "the main loop polls the futures itself: nothing sends them to a thread"
)]
pub trait DriveBus {
    /// Prepares the bus, before the first of the chips of a configuration is set.
    async fn prepare(&mut self, chips: usize);

    /// Checks that a chip answers, writes its settings, and reads them back.
    ///
    /// # Errors
    /// See [`Failure`].
    async fn configure(&mut self, chip: &DriveChip) -> Result<(), Failure>;

    /// What keeps a configured chip from driving its motor.
    ///
    /// # Errors
    /// The chip was not reached.
    async fn trouble(&mut self, chip: &DriveChip) -> Result<Option<DriveAlarm>, Failure>;
}

/// The chips of a configuration, for the main loop to set.
#[derive(Debug, Clone, Copy)]
struct Request {
    /// Number of the configuration, in the upper bits of the state.
    number: u32,
    chips: [Option<DriveChip>; MAX_AXES],
}

/// What both sides share.
#[derive(Debug, Default)]
pub struct Chips {
    requests: Queue<Request, 2>,
    /// Number of the configuration, and the alarms of the joints.
    state: AtomicU32,
}

impl Chips {
    /// No configuration is known.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            requests: Queue::new(),
            state: AtomicU32::new(0),
        }
    }

    /// The two sides, on a board with a bus for chips of this kind.
    pub fn split(&mut self, kind: ChipKind) -> (Follower<'_>, Keeper<'_>) {
        let (producer, requests) = self.requests.split();
        let state = &self.state;
        let follower = Follower {
            bus: Some((kind, producer)),
            state,
            crc: 0,
        };
        let keeper = Keeper {
            requests,
            state,
            number: 0,
            chips: [None; MAX_AXES],
            unset: 0,
        };
        (follower, keeper)
    }

    /// The side of the control period, on a board without the bus: no chip ever becomes ready.
    pub const fn without_bus(&mut self) -> Follower<'_> {
        Follower {
            bus: None,
            state: &self.state,
            crc: 0,
        }
    }
}

/// The side of the control period.
pub struct Follower<'a> {
    /// Kind of the chips at the bus of the board, and where their settings go.
    bus: Option<(ChipKind, Producer<'a, Request>)>,
    state: &'a AtomicU32,
    /// CRC of the configuration that was passed on.
    crc: u32,
}

impl Follower<'_> {
    /// Passes the chips of a new configuration on. Its joints with a chip are not ready from now
    /// on.
    #[inline]
    pub fn follow(&mut self, machine: Option<&Machine>) {
        if let Some(machine) = machine
            && machine.crc != self.crc
        {
            self.pass_on(&machine.config.joints, machine.crc);
        }
    }

    #[cold]
    #[inline(never)]
    fn pass_on(&mut self, joints: &[JointSettings], crc: u32) {
        let kind = self.bus.as_ref().map(|(kind, _)| *kind);
        let mut chips = [None; MAX_AXES];
        let mut waiting = Alarms::default();
        for (joint, (place, settings)) in chips.iter_mut().zip(joints).enumerate() {
            let chip = settings.chip().copied();
            *place = chip.filter(|chip| Some(chip.kind) == kind);
            let reason = match *place {
                Some(_) => DriveAlarm::Setting,
                None => DriveAlarm::NoBus,
            };
            waiting = waiting.with(joint, chip.map(|_| reason));
        }
        let number = (self.state.load(Ordering::Relaxed) >> ALARM_BITS).wrapping_add(1);
        let state = number << ALARM_BITS | waiting.bits();
        self.state.store(state, Ordering::Release);
        let number = state >> ALARM_BITS;
        // Without room the main loop has not taken the configuration before: the next control
        // period tries it again.
        let is_passed = self
            .bus
            .as_mut()
            .is_none_or(|(_, requests)| requests.enqueue(Request { number, chips }).is_ok());
        if is_passed {
            self.crc = crc;
        }
    }

    /// Joints that are not ready, and why.
    #[inline]
    #[must_use]
    pub fn alarms(&self) -> Alarms {
        Alarms::of_bits(self.state.load(Ordering::Acquire))
    }
}

/// The side of the main loop.
pub struct Keeper<'a> {
    requests: Consumer<'a, Request>,
    state: &'a AtomicU32,
    number: u32,
    chips: [Option<DriveChip>; MAX_AXES],
    /// Joints whose chip must be configured, one bit each.
    unset: u8,
}

impl Keeper<'_> {
    /// Keeps the chips of the active configuration configured, for ever. The clock counts so many
    /// times in a microsecond, and wraps around. `start` prepares the pins of the bus, which a
    /// machine without chips does not use; `are_off` says whether the enable line of the drives has
    /// the level that switches them off.
    pub async fn keep<B: DriveBus>(
        mut self,
        bus: &mut B,
        mut clock: impl FnMut() -> u32,
        counts_per_us: u32,
        start: impl FnOnce(),
        are_off: impl Fn() -> bool,
    ) -> Infallible {
        while !self.has_chips() {
            turn().await;
            self.take_newest();
        }
        start();
        loop {
            self.take_newest();
            if self.unset != 0 && are_off() {
                self.configure(bus).await;
            }
            self.watch(bus).await;
            let begin = clock();
            while clock().wrapping_sub(begin) < INTERVAL_US * counts_per_us {
                turn().await;
            }
        }
    }

    fn has_chips(&self) -> bool {
        self.chips.iter().any(Option::is_some)
    }

    fn take_newest(&mut self) {
        while let Some(request) = self.requests.dequeue() {
            self.number = request.number;
            self.chips = request.chips;
            self.unset = self
                .joints()
                .fold(0, |unset, (joint, _)| unset | 1 << joint);
        }
    }

    /// Joints with a chip, and their chips.
    fn joints(&self) -> impl Iterator<Item = (usize, DriveChip)> + use<> {
        let chips = self.chips.into_iter().enumerate();
        chips.filter_map(|(joint, chip)| chip.map(|chip| (joint, chip)))
    }

    const fn is_unset(&self, joint: usize) -> bool {
        self.unset >> joint & 1 != 0
    }

    /// Configures the chips that are not configured.
    async fn configure<B: DriveBus>(&mut self, bus: &mut B) {
        bus.prepare(self.joints().count()).await;
        for (joint, chip) in self.joints() {
            if !self.is_unset(joint) || self.requests.ready() {
                continue;
            }
            match bus.configure(&chip).await {
                Ok(()) => {
                    self.unset &= !(1 << joint);
                    self.report([(joint, None); 2]);
                }
                Err(failure) => self.fail((joint, &chip), failure),
            }
        }
    }

    /// Reads the state of the chips that are configured.
    async fn watch<B: DriveBus>(&mut self, bus: &mut B) {
        for (joint, chip) in self.joints() {
            if self.is_unset(joint) || self.requests.ready() {
                continue;
            }
            let mut found = None;
            for _ in 0..ATTEMPTS {
                match bus.trouble(&chip).await {
                    Ok(trouble) => {
                        let place = chip.place;
                        found = trouble.map(|alarm| Failure { alarm, place });
                        break;
                    }
                    Err(failure) => found = Some(failure),
                }
            }
            if let Some(failure) = found {
                self.fail((joint, &chip), failure);
            }
        }
    }

    /// Sets why a joint is not ready. If another chip causes it, its joint gets the reason at the
    /// same moment.
    fn fail(&mut self, (joint, chip): (usize, &DriveChip), failure: Failure) {
        let cause = self.joints().find(|(_, it)| it.place == failure.place);
        let cause = cause.map_or(joint, |(joint, _)| joint);
        let own = if failure.place == chip.place {
            failure.alarm
        } else {
            DriveAlarm::Unreachable
        };
        self.unset |= 1 << joint | 1 << cause;
        self.report([(joint, Some(own)), (cause, Some(failure.alarm))]);
    }

    /// Sets why joints are not ready, or that they are, unless there is a newer configuration.
    fn report(&self, joints: [(usize, Option<DriveAlarm>); 2]) {
        let change = |state: u32| {
            let alarms = joints
                .into_iter()
                .fold(Alarms::of_bits(state), |alarms, (joint, alarm)| {
                    alarms.with(joint, alarm)
                });
            let own = state >> ALARM_BITS == self.number;
            own.then_some(self.number << ALARM_BITS | alarms.bits())
        };
        // A newer configuration has made all its joints with a chip not ready.
        let _ = self
            .state
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, change);
    }
}

const fn currents(chip: &DriveChip) -> Currents {
    Currents {
        run_ma: chip.run_ma,
        hold_ma: chip.hold_ma,
        sense_mohm: chip.sense_mohm,
    }
}

const fn of_trouble(trouble: Trouble) -> DriveAlarm {
    match trouble {
        Trouble::Reset => DriveAlarm::Reset,
        Trouble::Overheated => DriveAlarm::Overheated,
        Trouble::Shorted => DriveAlarm::Shorted,
        Trouble::SwitchedOff => DriveAlarm::SwitchedOff,
        Trouble::Undervoltage => DriveAlarm::Undervoltage,
    }
}
