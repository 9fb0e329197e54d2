//! Chips of the drives that the board sets: TMC2209 on a one-wire bus.
//!
//! The controller gets a configuration in its control period; the main loop of the board talks to
//! the chips between the periods. [`Follower`] is the side of the control period: it passes the
//! settings on, and says which joints are not ready. [`Keeper`] is the side of the main loop: it
//! configures the chips, reads their state again and again, and says which joints are ready.
//!
//! A joint with a chip is not ready from the activation of its configuration until its chip has
//! read back what was written. It is not ready from then on when the chip is silent, was reset, or
//! has switched its motor off, until the chip was configured again with the drives off.

use core::convert::Infallible;
use core::sync::atomic::{AtomicU32, Ordering};
use embedded_hal_nb::serial::{Read, Write};
use haptimill_drivers::tmc2209::{Bus, Currents, Error, Settings, Trouble, turn};
use haptimill_firmware::config::{JointSettings, Tmc2209};
use haptimill_firmware::machine::Machine;
use haptimill_protocol::message::{Alarms, DriveAlarm, MAX_AXES};
use heapless::spsc::{Consumer, Producer, Queue};

/// Time between two rounds in which the state of all chips is read, us.
pub const INTERVAL_US: u32 = 20_000;

/// Attempts to read the state of a chip until it counts as silent. Noise on the wire costs one.
pub const ATTEMPTS: usize = 3;

/// Bits of the alarms in the state; those above number the configuration.
const ALARM_BITS: u32 = 4 * MAX_AXES as u32;

/// The chips of a configuration, for the main loop to set.
#[derive(Debug, Clone, Copy)]
struct Request {
    /// Number of the configuration, in the upper bits of the state.
    number: u32,
    chips: [Option<Tmc2209>; MAX_AXES],
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

    /// The two sides.
    pub fn split(&mut self) -> (Follower<'_>, Keeper<'_>) {
        let (producer, requests) = self.requests.split();
        let state = &self.state;
        let follower = Follower {
            requests: Some(producer),
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
            requests: None,
            state: &self.state,
            crc: 0,
        }
    }
}

/// The side of the control period.
pub struct Follower<'a> {
    requests: Option<Producer<'a, Request>>,
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
        let reason = match self.requests {
            Some(_) => DriveAlarm::Setting,
            None => DriveAlarm::NoBus,
        };
        let mut chips = [None; MAX_AXES];
        let mut waiting = Alarms::default();
        for (joint, (chip, axis)) in chips.iter_mut().zip(joints).enumerate() {
            *chip = axis.tmc2209().copied();
            waiting = waiting.with(joint, chip.is_some().then_some(reason));
        }
        let number = (self.state.load(Ordering::Relaxed) >> ALARM_BITS).wrapping_add(1);
        let state = number << ALARM_BITS | waiting.bits();
        self.state.store(state, Ordering::Release);
        let number = state >> ALARM_BITS;
        // Without room the main loop has not taken the configuration before: the next control
        // period tries it again.
        let is_passed = self
            .requests
            .as_mut()
            .is_none_or(|requests| requests.enqueue(Request { number, chips }).is_ok());
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
    chips: [Option<Tmc2209>; MAX_AXES],
    /// Joints whose chip must be configured, one bit each.
    unset: u8,
}

impl Keeper<'_> {
    /// Keeps the chips of the active configuration configured, for ever. `start` prepares the pins
    /// of the bus, which a machine without chips does not use; `are_off` says whether the enable
    /// line of the drives has the level that switches them off.
    pub async fn keep<S, C, E>(
        mut self,
        bus: &mut Bus<S, C>,
        start: impl FnOnce(),
        are_off: impl Fn() -> bool,
    ) -> Infallible
    where
        S: Read<u8, Error = E> + Write<u8, Error = E>,
        C: FnMut() -> u32,
    {
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
            bus.wait_us(INTERVAL_US).await;
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
    fn joints(&self) -> impl Iterator<Item = (usize, Tmc2209)> + use<> {
        let chips = self.chips.into_iter().enumerate();
        chips.filter_map(|(joint, chip)| chip.map(|chip| (joint, chip)))
    }

    const fn is_unset(&self, joint: usize) -> bool {
        self.unset >> joint & 1 != 0
    }

    /// Configures the chips that are not configured.
    async fn configure<S, C, E>(&mut self, bus: &mut Bus<S, C>)
    where
        S: Read<u8, Error = E> + Write<u8, Error = E>,
        C: FnMut() -> u32,
    {
        // Each chip reports for itself whether it has taken its settings.
        let _ = bus.separate_replies().await;
        for (joint, chip) in self.joints() {
            if !self.is_unset(joint) || self.requests.ready() {
                continue;
            }
            let currents = Currents {
                run_ma: chip.run_ma,
                hold_ma: chip.hold_ma,
                sense_mohm: chip.sense_mohm,
            };
            let Ok(settings) = Settings::new(currents, chip.microsteps) else {
                continue;
            };
            let result = bus.configure(chip.address, &settings).await;
            if result.is_ok() {
                self.unset &= !(1 << joint);
            }
            self.report(joint, result.err().map(alarm));
        }
    }

    /// Reads the state of the chips that are configured.
    async fn watch<S, C, E>(&mut self, bus: &mut Bus<S, C>)
    where
        S: Read<u8, Error = E> + Write<u8, Error = E>,
        C: FnMut() -> u32,
    {
        for (joint, chip) in self.joints() {
            if self.is_unset(joint) || self.requests.ready() {
                continue;
            }
            let mut found = None;
            for _ in 0..ATTEMPTS {
                match bus.trouble(chip.address).await {
                    Ok(trouble) => {
                        found = trouble.map(of_trouble);
                        break;
                    }
                    Err(error) => found = Some(alarm(error)),
                }
            }
            if found.is_some() {
                self.unset |= 1 << joint;
                self.report(joint, found);
            }
        }
    }

    /// Sets why a joint is not ready, or that it is, unless there is a newer configuration.
    fn report(&self, joint: usize, alarm: Option<DriveAlarm>) {
        let change = |state: u32| {
            let alarms = Alarms::of_bits(state).with(joint, alarm);
            let own = state >> ALARM_BITS == self.number;
            own.then_some(self.number << ALARM_BITS | alarms.bits())
        };
        // A newer configuration has made all its joints with a chip not ready.
        let _ = self
            .state
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, change);
    }
}

/// Why a chip that failed a command is not ready.
fn alarm<E>(error: Error<E>) -> DriveAlarm {
    match error {
        Error::NoReply => DriveAlarm::Silent,
        Error::Serial(_) | Error::Echo | Error::Noise | Error::Check | Error::WrongReply => {
            DriveAlarm::Disturbed
        }
        Error::NotTaken | Error::ReadBack { .. } | Error::Version(_) => DriveAlarm::NotSet,
        Error::Trouble(trouble) => of_trouble(trouble),
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
