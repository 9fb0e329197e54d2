//! Remote controller: the rig's end of the plant link to a controller on a board or emulator (PIL).
//!
//! [`RemoteController`] implements [`Control`] like a controller in this process, with no
//! difference for plant and scenario. It exchanges frames of [`haptimill_firmware::pil`] over a
//! [`PlantLink`]; the bytes of the host use the board's serial line beside it.
//!
//! The controller reports the bytes that it received, and the rig compares them with the bytes that
//! it sent. A missing or additional byte is a failure of the link, so it never changes the
//! simulation silently.

use crate::rig::Control;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs, TRANSMIT_BYTES};
use haptimill_firmware::pil::{
    Done, FROM_BOARD_BYTES, FromBoard, LineInputs, TO_BOARD_BYTES, ToBoard,
};
use haptimill_firmware::profiler::STAGES;
use haptimill_firmware::snapshot::Snapshot;
use haptimill_protocol::message::State;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Transport of frames and serial bytes to a board and back.
///
/// Every call returns. It returns an error when the board has terminated or does not answer within
/// the time limit.
pub trait PlantLink {
    /// Sends a frame.
    ///
    /// # Errors
    /// The board has terminated.
    fn send(&mut self, frame: &[u8; TO_BOARD_BYTES]) -> io::Result<()>;

    /// Waits for a frame.
    ///
    /// # Errors
    /// The board has terminated.
    fn receive(&mut self, frame: &mut [u8; FROM_BOARD_BYTES]) -> io::Result<()>;

    /// Writes bytes to the board's serial line.
    ///
    /// # Errors
    /// The board has terminated.
    fn put_serial(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Reads exactly `bytes.len()` bytes from the board's serial line.
    ///
    /// # Errors
    /// The board has terminated.
    fn take_serial(&mut self, bytes: &mut [u8]) -> io::Result<()>;

    /// Reason for the end of the board, from its own messages after it has terminated, or else from
    /// the operating system.
    fn last_words(&mut self) -> Option<String>;
}

/// Cost of the control periods of a run, as counted by the board.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cost {
    /// Number of periods in which a program ran; only these are counted.
    pub periods: u64,
    /// Sum over these periods of each stage's counts, in the order of
    /// [`haptimill_firmware::profiler::Stage`].
    pub sums: [u64; STAGES],
    /// Largest count of each stage in one of these periods.
    pub worst: [u32; STAGES],
    /// Largest count of a whole one of these periods.
    pub worst_period: u32,
    /// Largest count of a whole period in any state.
    pub worst_of_all: u32,
    /// Smallest number of setpoints in the queue after its maximum while more were to come; `None`
    /// if none were.
    pub queue_low: Option<u16>,
    /// Largest number of setpoints in the queue.
    pub queue_high: u16,
    /// Number of control periods missed because one exceeded its budget.
    pub missed: u64,
    /// Bytes of stack used at most; known at the end of the run.
    pub stack_bytes: u32,
    /// Largest number of bytes in the receive ring; known at the end of the run.
    pub ring_peak: u32,
}

/// Controller of a board, behind a link.
#[derive(Debug)]
pub struct RemoteController<L: PlantLink> {
    link: L,
    arrived: u32,
    snapshot: Option<Snapshot>,
    failure: Option<String>,
    cost: Arc<Mutex<Cost>>,
    /// Budget of a control period in counts, if it is enforced.
    budget: Option<u32>,
    overrun: u16,
}

impl<L: PlantLink> RemoteController<L> {
    /// Begins a run: the board creates a new controller.
    ///
    /// # Errors
    /// The board does not answer, or has another version.
    pub fn begin(mut link: L, period_us: u16) -> Result<Self, String> {
        let mut frame = [0; FROM_BOARD_BYTES];
        let gone =
            |link: &mut L, error: io::Error| link.last_words().unwrap_or_else(|| error.to_string());
        if let Err(error) = link.receive(&mut frame) {
            return Err(gone(&mut link, error));
        }
        match FromBoard::decode(&frame) {
            Ok(FromBoard::Hello) => {}
            Ok(_) => return Err("the board began in the middle".into()),
            Err(error) => return Err(error.to_string()),
        }
        if let Err(error) = link.send(&ToBoard::Begin { period_us }.encode()) {
            return Err(gone(&mut link, error));
        }
        Ok(Self {
            link,
            arrived: 0,
            snapshot: None,
            failure: None,
            cost: Arc::default(),
            budget: None,
            overrun: 0,
        })
    }

    /// Sets the budget of a control period: a period that exceeds `counts` misses the next ones
    /// while a drive is on.
    ///
    /// The budget does not apply while all drives are off. The activation of a configuration, which
    /// takes some periods on any chip, happens in this state and delays nothing.
    pub const fn set_budget(&mut self, counts: u32) {
        self.budget = Some(counts);
    }

    /// Cost of the periods; the shared value remains valid after this controller is dropped.
    #[must_use]
    pub fn cost(&self) -> Arc<Mutex<Cost>> {
        Arc::clone(&self.cost)
    }

    fn exchange(&mut self, inputs: &Inputs) -> io::Result<Done> {
        let transmitted = ToBoard::Period {
            inputs: inputs.clone(),
            arrived: core::mem::take(&mut self.arrived),
        };
        self.link.send(&transmitted.encode())?;
        let mut done = match self.receive_frame()? {
            FromBoard::Done(done) => done,
            _ => return Err(io::Error::other("the board sent an unexpected frame")),
        };
        let (should, line_inputs) = (LineInputs::of(inputs), done.line_inputs);
        if done.period != inputs.period || line_inputs != should {
            return Err(io::Error::other(format!(
                "period {}: the board received {line_inputs:?} in its period {}, and expected {should:?}",
                inputs.period, done.period
            )));
        }
        let count = usize::from(done.transmitted);
        let mut bytes = [0; TRANSMIT_BYTES];
        let Some(bytes) = bytes.get_mut(..count) else {
            return Err(io::Error::other(
                "the board sent more bytes than a period allows",
            ));
        };
        self.link.take_serial(bytes)?;
        // The call cannot fail: the bytes do not exceed the capacity.
        let _ = done.outputs.transmit.extend_from_slice(bytes);
        Ok(done)
    }

    fn receive_frame(&mut self) -> io::Result<FromBoard> {
        let mut frame = [0; FROM_BOARD_BYTES];
        self.link.receive(&mut frame)?;
        FromBoard::decode(&frame).map_err(io::Error::other)
    }

    fn account(&mut self, done: &Done) {
        let total = done.stages.iter().sum::<u32>();
        let driven = done
            .outputs
            .joints
            .iter()
            .any(|&axis| axis != DriveCommand::Off);
        self.overrun = self.budget.filter(|_| driven).map_or(0, |budget| {
            (total.saturating_sub(1) / budget.max(1)).min(1000) as u16
        });
        let mut cost = self.cost.lock().unwrap_or_else(PoisonError::into_inner);
        cost.worst_of_all = cost.worst_of_all.max(total);
        cost.missed += u64::from(self.overrun);
        let counted = |snapshot: &Snapshot| matches!(snapshot.state, State::Run | State::Jog);
        let Some(snapshot) = done.snapshot.filter(counted) else {
            return;
        };
        if snapshot.queued > cost.queue_high {
            cost.queue_high = snapshot.queued;
            cost.queue_low = None;
        } else if snapshot.more {
            let low = cost.queue_low.unwrap_or(snapshot.queued);
            cost.queue_low = Some(low.min(snapshot.queued));
        }
        cost.periods += 1;
        cost.worst_period = cost.worst_period.max(total);
        for (stage, &counts) in done.stages.iter().enumerate() {
            cost.sums[stage] += u64::from(counts);
            cost.worst[stage] = cost.worst[stage].max(counts);
        }
    }

    fn fail(&mut self, error: &io::Error) {
        let words = self.link.last_words();
        self.failure = Some(words.unwrap_or_else(|| error.to_string()));
    }
}

impl<L: PlantLink> Control for RemoteController<L> {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.overrun = 0;
        if self.failure.is_some() {
            outputs.make_safe();
            return;
        }
        match self.exchange(inputs) {
            Ok(done) => {
                self.account(&done);
                self.snapshot = done.snapshot;
                *outputs = done.outputs;
            }
            Err(error) => {
                self.fail(&error);
                self.snapshot = None;
                outputs.make_safe();
            }
        }
    }

    fn arrived(&mut self, bytes: &[u8]) {
        if bytes.is_empty() || self.failure.is_some() {
            return;
        }
        self.arrived = self.arrived.wrapping_add(bytes.len() as u32);
        if let Err(error) = self.link.put_serial(bytes) {
            self.fail(&error);
        }
    }

    fn snapshot(&self, _: &Inputs) -> Option<Snapshot> {
        self.snapshot
    }

    fn overrun(&self) -> u16 {
        self.overrun
    }

    fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }
}

impl<L: PlantLink> Drop for RemoteController<L> {
    fn drop(&mut self) {
        if self.failure.is_some() || self.link.send(&ToBoard::End.encode()).is_err() {
            return;
        }
        if let Ok(FromBoard::Ended {
            stack_bytes,
            ring_peak,
        }) = self.receive_frame()
        {
            let mut cost = self.cost.lock().unwrap_or_else(PoisonError::into_inner);
            cost.stack_bytes = stack_bytes;
            cost.ring_peak = ring_peak;
        }
    }
}
