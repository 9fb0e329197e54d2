//! Streams the setpoints of a job, with credit-based flow control.

use super::ending::JobEnding;
use super::requests::Requests;
use super::{ClientError, RequestError, Ticket};
use haptimill_protocol::link::HostLink;
use haptimill_protocol::message::{
    AxisValues, Command, Event, Refusal, Request, SETPOINT_BATCH, SetpointBatch, State, Telemetry,
    Welcome,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use std::fmt;
use std::task::Poll;

/// Unacknowledged batches at most: half the window of the link, so that a hold or a stop waits for
/// a few frames only.
const BATCHES: usize = 4;

/// Progress of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JobStatus {
    /// The job.
    pub job: u32,
    /// Setpoints passed to the link.
    pub sent: u32,
    /// Setpoints that the controller accepts, counted from the start of the job.
    pub credit: u32,
    /// The target setpoint of the motion.
    pub reached: u32,
    /// All setpoints are sent.
    pub complete: bool,
}

/// Setpoints that are made while the job runs.
pub trait SetpointSource: Send {
    /// Returns the next setpoint without waiting: pending while it is not made yet, `None` after
    /// the last one.
    fn next_setpoint(&mut self) -> Poll<Option<Setpoint>>;
}

impl SetpointSource for std::vec::IntoIter<Setpoint> {
    fn next_setpoint(&mut self) -> Poll<Option<Setpoint>> {
        Poll::Ready(self.next())
    }
}

/// The setpoints of a job: all of them, or a source.
pub struct Setpoints {
    source: Box<dyn SetpointSource>,
    /// The next one, once the source was asked; `None` after the last one.
    next: Poll<Option<Setpoint>>,
}

impl Setpoints {
    /// Creates the setpoints of a source.
    pub fn of(source: impl SetpointSource + 'static) -> Self {
        Self {
            source: Box::new(source),
            next: Poll::Pending,
        }
    }

    /// Asks the source for the next setpoint.
    fn peek(&mut self) -> Poll<Option<&Setpoint>> {
        if self.next.is_pending() {
            self.next = self.source.next_setpoint();
        }
        match &self.next {
            Poll::Ready(next) => Poll::Ready(next.as_ref()),
            Poll::Pending => Poll::Pending,
        }
    }

    /// Takes the next setpoint, if there is one now.
    fn take(&mut self) -> Option<Setpoint> {
        self.peek().is_ready().then_some(())?;
        match std::mem::replace(&mut self.next, Poll::Pending) {
            Poll::Ready(Some(setpoint)) => Some(setpoint),
            end => {
                self.next = end;
                None
            }
        }
    }
}

impl From<Vec<Setpoint>> for Setpoints {
    fn from(setpoints: Vec<Setpoint>) -> Self {
        Self::of(setpoints.into_iter())
    }
}

impl fmt::Debug for Setpoints {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Setpoints").finish_non_exhaustive()
    }
}

/// A job that is being streamed.
pub(super) struct Stream {
    job: u32,
    start: Ticket,
    phase: StreamPhase,
    /// The start was acknowledged.
    started: bool,
    /// Setpoints in a batch: at most the size of the controller's queue.
    batch: usize,
    setpoints: Setpoints,
    coder: SetpointCoder,
    /// An encoded batch that did not fit into the window of the link.
    ready: Option<SetpointBatch>,
    sent: u32,
    credit: u32,
    reached: u32,
    end: Option<Ticket>,
    /// Program time of the last telemetry, if the motion stood then.
    standing: Option<u32>,
    /// The motion has begun and stands: the controller waits for setpoints.
    starved: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StreamPhase {
    /// The start is requested.
    Starting,
    /// Setpoints are sent.
    Streaming,
    /// The end is requested; the controller completes the job.
    Ending,
    /// Nothing more is sent: the job is being stopped.
    Abandoned,
}

impl fmt::Debug for Stream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stream")
            .field("phase", &self.phase)
            .field("progress", &self.progress())
            .finish_non_exhaustive()
    }
}

impl Stream {
    pub(super) fn new(
        job: u32,
        start: Ticket,
        pose: &AxisValues,
        welcome: &Welcome,
        setpoints: Setpoints,
    ) -> Self {
        Self {
            job,
            start,
            phase: StreamPhase::Starting,
            started: false,
            batch: SETPOINT_BATCH.min(usize::from(welcome.queue)).max(1),
            setpoints,
            coder: SetpointCoder::new(welcome.period_us, pose),
            ready: None,
            sent: 0,
            // The queue of a job that begins is empty.
            credit: u32::from(welcome.queue),
            reached: 0,
            end: None,
            standing: None,
            starved: false,
        }
    }

    pub(super) fn progress(&self) -> JobStatus {
        JobStatus {
            job: self.job,
            sent: self.sent,
            credit: self.credit,
            reached: self.reached,
            complete: self.phase == StreamPhase::Ending,
        }
    }

    /// Sends nothing more.
    pub(super) fn abandon(&mut self) {
        self.phase = StreamPhase::Abandoned;
    }

    /// The end of an abandoned job whose start was never sent.
    pub(super) fn withdrawn(&self, requests: &Requests) -> Option<JobEnding> {
        let never = !self.started && !requests.is_pending(self.start);
        never.then_some(JobEnding::Refused {
            job: self.job,
            error: RequestError::Withdrawn,
        })
    }

    pub(super) fn lost(&self, error: ClientError) -> JobEnding {
        JobEnding::Lost {
            job: self.job,
            error,
        }
    }

    /// The start or the end of the job was acknowledged.
    pub(super) fn answered(
        &mut self,
        ticket: Ticket,
        result: Result<(), Refusal>,
    ) -> Option<JobEnding> {
        match result {
            Err(refusal) => self.failed(ticket, RequestError::Refused(refusal)),
            Ok(()) => {
                if ticket == self.start {
                    self.started = true;
                    if self.phase == StreamPhase::Starting {
                        self.phase = StreamPhase::Streaming;
                    }
                }
                None
            }
        }
    }

    /// A request failed; the job with it if it was the start or the end.
    pub(super) fn failed(&mut self, ticket: Ticket, error: RequestError) -> Option<JobEnding> {
        let ours = ticket == self.start || self.end == Some(ticket);
        ours.then_some(JobEnding::Refused {
            job: self.job,
            error,
        })
    }

    /// A message without acknowledgement was refused: a batch, if one was sent.
    pub(super) fn refused(&mut self, refusal: Refusal) -> Option<JobEnding> {
        let streaming = self.sent > 0 && self.phase != StreamPhase::Abandoned;
        streaming.then_some(JobEnding::Refused {
            job: self.job,
            error: RequestError::Refused(refusal),
        })
    }

    pub(super) fn event(&mut self, event: &Event) -> Option<JobEnding> {
        match *event {
            Event::JobDone { job, setpoints } if job == self.job => {
                Some(JobEnding::Done { job, setpoints })
            }
            Event::JobDropped { job, setpoints } if job == self.job => {
                Some(JobEnding::Dropped { job, setpoints })
            }
            _ => None,
        }
    }

    pub(super) fn telemetry(&mut self, telemetry: &Telemetry) {
        // Before the start is acknowledged, a report may belong to the previous job.
        if matches!(self.phase, StreamPhase::Streaming | StreamPhase::Ending) {
            self.credit = self.credit.max(telemetry.credit);
            self.reached = telemetry.setpoint;
            let begun = telemetry.state == State::Run && telemetry.program_periods > 0;
            let standing =
                (begun && telemetry.speed_factor == 0).then_some(telemetry.program_periods);
            self.starved = standing.is_some() && standing == self.standing;
            self.standing = standing;
        }
    }

    /// Passes batches to the link as far as the credit allows, then ends the job.
    pub(super) fn send(
        &mut self,
        link: &mut HostLink,
        requests: &mut Requests,
    ) -> Result<(), JobEnding> {
        while self.phase == StreamPhase::Streaming
            && requests.is_idle()
            && link.under_way() < BATCHES
        {
            let Some(batch) = self.next_batch()? else {
                return Ok(());
            };
            if batch.items.is_empty() {
                self.end = Some(requests.ask(Command::JobEnd { count: self.sent }));
                self.phase = StreamPhase::Ending;
                return Ok(());
            }
            let count = batch.items.len() as u32;
            let request = Request {
                id: 0,
                command: Command::Setpoints(batch),
            };
            if link.send(&request).is_err() {
                if let Command::Setpoints(batch) = request.command {
                    self.ready = Some(batch);
                }
                return Ok(());
            }
            self.sent += count;
        }
        Ok(())
    }

    /// The next batch: a full one, or fewer setpoints at the end of the job, where no further one
    /// is made yet, and where the controller waits for a full queue before it resumes an underrun.
    /// It is empty when all are sent, and `None` when the credit is used up or none is made yet.
    fn next_batch(&mut self) -> Result<Option<SetpointBatch>, JobEnding> {
        if let Some(batch) = self.ready.take() {
            return Ok(Some(batch));
        }
        let free = self.credit.saturating_sub(self.sent) as usize;
        let min = if self.starved { 1 } else { self.batch };
        match self.setpoints.peek() {
            Poll::Pending => return Ok(None),
            Poll::Ready(Some(_)) if free < min => return Ok(None),
            Poll::Ready(_) => {}
        }
        let mut batch = SetpointBatch {
            first: self.sent,
            items: Default::default(),
        };
        while batch.items.len() < self.batch.min(free)
            && let Some(setpoint) = self.setpoints.take()
        {
            let delta = self
                .coder
                .encode(&setpoint)
                .map_err(|error| JobEnding::Setpoint {
                    job: self.job,
                    setpoint: self.sent + batch.items.len() as u32,
                    error,
                })?;
            // At most SETPOINT_BATCH: the push cannot fail.
            let _ = batch.items.push(delta);
        }
        Ok(Some(batch))
    }
}
